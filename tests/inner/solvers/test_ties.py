"""Of two actions that float values can tell apart, the better one is taken."""

from dataclasses import replace

import numpy as np

from exact_mdp import MDP, solve
from exact_mdp.solvers.ties import break_near_ties

# In state 0 all three actions lead to 1 and 2 by half; what they earn differs by 1e-12.
ROWS = [(0, a, [("1/2", 1, r), ("1/2", 2, r)]) for a, r in enumerate(["0", "1e-12", "0"])]
ROWS += [(s, 0, [(1, s, 1000 * s)]) for s in (1, 2)]
MDP_OF_TIES = MDP.from_outcomes(ROWS, "9/10")


def test_the_better_action_is_found_though_values_are_known_less_well() -> None:
    solution = solve(MDP_OF_TIES)
    for pair in (0, 1, 2):
        chosen = np.array([pair, 3, 4])
        loose = replace(solution, pairs=chosen, state_error=np.full(3, 1e-3))
        assert break_near_ties(loose).pairs.tolist() == [1, 3, 4]


def test_actions_of_one_worth_stay() -> None:
    mdp = MDP_OF_TIES.with_(discount="0")
    solution = replace(solve(mdp), pairs=np.array([2, 3, 4]), state_error=np.full(3, 1.0))
    assert break_near_ties(solution).pairs.tolist() == [1, 3, 4]
    twins = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 1)])], "1/2")
    for pair in (0, 1):
        solution = replace(solve(twins), pairs=np.array([pair]))
        assert break_near_ties(solution).pairs.tolist() == [pair]


def test_infinite_values_are_left_alone() -> None:
    solution = replace(solve(MDP_OF_TIES), value=np.array([np.inf, 1.0, 2.0]))
    assert break_near_ties(solution) is solution
