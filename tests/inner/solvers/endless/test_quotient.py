"""Models made of parts of another: what is merged, what stops are worth, what is left out."""

from fractions import Fraction as F

import numpy as np
from oracle import every_policy_ends, rows_of

from exact_mdp import MDP
from exact_mdp.mdp.graph import PairGraph
from exact_mdp.solvers.endless.quotient import (
    build_quotient,
    choose_first_pairs,
    choose_nearer_pairs,
    extract_components,
    of_pairs,
    stop_in_components,
)

# 0 ⇄ 1 by a pair each, 1 may leave for 2 or 3, 2 stays; 3 leads back to 0.
ROWS = [
    (0, 0, [(1, 1, 2)]),
    (1, 0, [(1, 0, -2)]),
    (1, 1, [("1/3", 2, 5), ("2/3", 3, "1/2")]),
    (2, 0, [(1, 2, 0)]),
    (3, 0, [(1, 0, 7)]),
]
MODEL = MDP.from_outcomes(ROWS, 1)


def test_merged_states_share_their_pairs() -> None:
    """0 and 1 become 0, 3 becomes 1, and 2 is the end; a stop in 0 is worth 9."""
    found = build_quotient(MODEL, np.array([2, 4]), np.array([0, 0, -1, 1]))
    assert rows_of(found.mdp) == [
        (0, 0, F(2), {2: F(1, 3), 1: F(2, 3)}),
        (1, 0, F(7), {0: F(1)}),
        (2, 0, F(0), {2: F(1)}),
    ]
    assert found.new_state.tolist() == [0, 0, 2, 1]
    assert found.source.tolist() == [2, 4, 5]
    free = build_quotient(
        MODEL, np.array([2, 4]), np.array([0, 0, -1, 1]), zero_rewards=True, stops=[(0, F(9))]
    )
    assert rows_of(free.mdp) == [
        (0, 0, F(0), {2: F(1, 3), 1: F(2, 3)}),
        (0, 1, F(9), {2: F(1)}),
        (1, 0, F(0), {0: F(1)}),
        (2, 0, F(0), {2: F(1)}),
    ]
    assert free.source.tolist() == [2, -1, 4, 5]


def test_components_are_a_model_of_their_own() -> None:
    component, inside = np.array([0, 0, 1, -1]), np.array([True, True, False, True, False])
    found = extract_components(MODEL, component, inside)
    assert rows_of(found.mdp) == [
        (0, 0, F(2), {1: F(1)}),
        (1, 0, F(-2), {0: F(1)}),
        (2, 0, F(0), {2: F(1)}),
        (3, 0, F(0), {3: F(1)}),
    ]
    assert (found.new_state.tolist(), found.source.tolist()) == ([0, 1, 2, 3], [0, 1, 3, 5])


def test_a_component_is_left_for_nothing_or_stops_for_its_worth() -> None:
    outside = np.array([False, False, True, False, True])
    found = stop_in_components(MODEL, np.array([0, 0, 1, -1]), outside, np.array([0.5, -3.0]))
    assert rows_of(found.mdp) == [
        (0, 0, F(0), {1: F(1, 3), 2: F(2, 3)}),
        (0, 1, F(1, 2), {3: F(1)}),
        (1, 0, F(-3), {3: F(1)}),
        (2, 0, F(0), {0: F(1)}),
        (3, 0, F(0), {3: F(1)}),
    ]
    assert (found.new_state.tolist(), found.source.tolist()) == ([0, 0, 1, 2], [2, -1, -2, 4, 5])


def test_pairs_that_lose_in_circles_are_left_out_and_no_more() -> None:
    """1 may go round with 0 at a loss of 1, or on for nothing; 0 has one way."""
    rows = [(0, 0, [(1, 1, -1)]), (1, 0, [(1, 0, 0)]), (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)])]
    whole = build_quotient(MDP.from_outcomes(rows, 1), np.array([0, 1, 2]), np.array([0, 1, -1]))
    part = whole.omit_losing_pairs()
    assert part.source.tolist() == [0, 2, 4]
    assert every_policy_ends(3, rows_of(part.mdp))
    assert part.omit_losing_pairs() is part


def test_a_model_of_some_pairs_has_their_rows() -> None:
    assert rows_of(of_pairs(MODEL, np.array([0, 2, 3, 4]))) == rows_of(MODEL, [0, 2, 3, 4])


def test_pairs_toward_a_target_come_nearer_with_each_step() -> None:
    graph, every = PairGraph.of(MODEL), np.ones(5, dtype=bool)
    chosen = np.full(4, -7)
    choose_nearer_pairs(graph, np.arange(4) == 2, every, chosen)
    assert chosen.tolist() == [0, 2, -7, 4]
    choose_first_pairs(graph, np.array([True, False, True, False, False]), chosen)
    assert chosen.tolist() == [0, 2, -7, 4]
    choose_first_pairs(graph, np.array([False, True, True, False, False]), chosen)
    assert chosen.tolist() == [0, 1, -7, 4]
