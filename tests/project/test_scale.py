"""Large scenarios: sizes, memory, and agreement with a recursion over one subtask."""

import subprocess
import sys

import pytest

MEASURE = """
import resource
from exact_mdp import Scenario
mdp = Scenario.load("yuan2025").with_(tasks=[10_000]).compile()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(mdp.n_states, mdp.n_transitions, peak)
"""


@pytest.mark.slow
def test_ten_thousand_subtasks_compile_within_four_gigabytes() -> None:
    pytest.importorskip("resource")  # Unix alone has it
    done = subprocess.run(
        [sys.executable, "-c", MEASURE], capture_output=True, text=True, check=True
    )
    states, transitions, peak = map(int, done.stdout.split())
    assert states == 800_001
    assert transitions > 28_000_000
    assert peak < 4 * 2**30
