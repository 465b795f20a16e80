"""Property tests draw the same examples in every run, unless EXPLORE=1 asks for new ones."""

import gc
import os
from collections.abc import Callable, Iterator
from functools import wraps
from typing import Any

import pytest
from bare_numbers import bare_numbers
from hypothesis import HealthCheck, settings

from exact_mdp.mdp.report import Report

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
    """Ignore that a scenario cuts off chances at 1; mdp/care/test_scenario.py tests the warning.

    And that Hypothesis does not see who holds its generator, which is frozen below.
    """
    for item in items:
        item.add_marker(pytest.mark.filterwarnings("ignore::exact_mdp.ScenarioWarning"))
        item.add_marker(pytest.mark.filterwarnings("ignore:It looks like .register_random"))


def pytest_collection() -> None:
    """Look for no garbage while the tests are collected."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage again, but not among what was collected."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True, scope="session")
def no_report_shows_a_bare_number() -> Iterator[None]:
    """Let every report that a test shows be looked through: no number stands without a claim."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("json", "lines"):
            patch.setattr(Report, name, looked_through(getattr(Report, name)))
        yield


def looked_through(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method of reports that first fails where a number of the report has no claim."""

    @wraps(method)
    def looked(report: Report, **more: Any) -> Any:
        assert bare_numbers(report) == [], f"of a report {report.title!r}: give it a claim"
        return method(report, **more)

    return looked
