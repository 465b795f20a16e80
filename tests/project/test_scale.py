"""Large scenarios: sizes, memory, and agreement with a recursion over one subtask."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from exact_mdp import Scenario, solve

MEASURE = """
import resource
from exact_mdp import Scenario
mdp = Scenario.load("yuan2025").with_(tasks=[10_000]).compile()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(mdp.n_states, mdp.n_transitions, peak)
"""


def by_subtasks(count: int) -> float:
    """The start value of one task of `count` subtasks, by a recursion over 16 statuses.

    One subtask is compiled at its place inside a task and at the end of it; what follows is worth
    a vector over the status that the next subtask starts with.
    """
    two, block = Scenario.load("yuan2025").with_(tasks=[2]).compile(), 5 * 16
    after = np.zeros(1)
    for first in (block, *[0] * (count - 1)):
        value = np.zeros(two.n_states)
        value[first + block : first + block + len(after)] = after
        for _ in range(5):
            q = two.reward + two.transition @ value
            best = np.maximum.reduceat(q, two.pair_offsets[:-1])
            value[first : first + block] = best[first : first + block]
        after = value[first : first + 16]
    return float(after[0])


def test_a_thousand_subtasks_agree_with_the_recursion() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1_000]).compile()
    assert mdp.n_states == 16 * 5 * 1_000 + 1
    solution = solve(mdp)
    assert solution.start_value == pytest.approx(by_subtasks(1_000), rel=1e-11)
    assert solution.error_bound < 1e-9 * solution.start_value


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
