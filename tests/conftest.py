"""Property tests draw the same examples in every run, unless EXPLORE=1 asks for new ones."""

import os

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "fixed", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "explore", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
for name in ("GITHUB_ACTIONS", "GITHUB_STEP_SUMMARY"):  # tests that need them set them
    os.environ.pop(name, None)

settings.load_profile("explore" if os.environ.get("EXPLORE") else "fixed")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Ignore that a scenario cuts off chances at 1; mdp/care/test_scenario.py tests the warning."""
    for item in items:
        item.add_marker(pytest.mark.filterwarnings("ignore::exact_mdp.ScenarioWarning"))
