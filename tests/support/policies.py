"""Models with few states, and what it means to follow a policy in them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from exact_mdp.mdp import MDP, Policy, Scenario

CARE = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2)
MDP_1 = CARE.compile()
OWN_SKIP = CARE.with_(readings={"skip_timestep": "own"}).compile()
FLAGGED = CARE.with_(readings={"task_bonus": "no-subtask-skipped"}).compile()
PLAIN = MDP.from_outcomes(
    [(0, 0, [(1, 1, 0)]), (0, 2, [(1, 0, 1)]), (1, 1, [(1, 1, 0)]), (2, 0, [(1, 1, 5)]),
     (2, 1, [(1, 0, 0)])],
    "1/2", actions=["a", "b", "c"], states=["x", "y", "z"],
)  # fmt: skip
ACTIONS = list(MDP_1.actions)
STATUSES = [format(number, "04b") for number in range(16)]
by_status = st.lists(st.integers(0, 3), min_size=16, max_size=16)
numbers = st.floats(-1e6, 1e6)


def status_of(mdp: MDP) -> Any:
    return mdp.space.values("status")


def check_follows(mdp: MDP, policy: Policy, chosen: list[int]) -> None:
    """The policy takes chosen[status] wherever there is a choice, in a model that may have more."""
    weights, status = policy.weights(mdp), status_of(mdp)
    assert np.add.reduceat(weights, mdp.pair_offsets[:-1]) == pytest.approx(1)
    for pair in range(mdp.n_pairs):
        state = mdp.pair_state[pair]
        wanted = mdp.forced[state] or mdp.pair_action[pair] == chosen[status[state]]
        assert weights[pair] == float(wanted)
    actions = policy.choices(mdp)
    free = ~mdp.forced
    assert actions[free].tolist() == [chosen[s] for s in status[free]]
    first = mdp.pair_action[mdp.pair_offsets[:-1]]
    assert actions[~free].tolist() == first[~free].tolist()
