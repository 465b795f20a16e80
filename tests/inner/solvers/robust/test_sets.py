"""What nature picks from a set of laws, against linear programs over the same set."""

import numpy as np
import pytest
from scipy.optimize import linprog

from exact_mdp import MDP, Intervals
from exact_mdp.solvers.robust.likelihood import Likelihood
from exact_mdp.solvers.robust.sets import (
    Ambiguity,
    L1Ball,
    RowBlock,
    list_entries,
    side_by_side,
    solve_inner_problem,
)

RNG = np.random.default_rng(3)


def drawn(seed: int) -> MDP:
    rng = np.random.default_rng(seed)
    return MDP.from_arrays(rng.dirichlet(np.ones(5), (2, 5)), rng.normal(size=(5, 2)), "9/10")


def asked(mdp: MDP, ambiguity: object, value: np.ndarray, against: bool) -> tuple:
    offsets = mdp.table.offsets
    chances = mdp.transition.data
    gain = np.repeat(mdp.reward, np.diff(offsets))
    rows = offsets[:-1], np.diff(offsets)
    blocks = side_by_side(np.arange(10), rows, (mdp.table.next, chances, gain))
    return solve_inner_problem(ambiguity, blocks, value, discount=0.9, against=against), blocks


@pytest.mark.parametrize("against", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_intervals_and_l1_balls_are_the_programs_over_them(seed: int, against: bool) -> None:
    mdp, value = drawn(seed), np.random.default_rng(seed + 50).normal(size=5)
    p, radius = mdp.transition.toarray(), 0.3
    sign = 1 if against else -1
    own, blocks = asked(mdp, Intervals.relative(mdp, 0.25), value, against)
    ball, _ = asked(mdp, L1Ball(radius=radius), value, against)
    for pair in range(10):
        cost = sign * (0.9 * value + mdp.reward[pair])
        ends = list(zip(0.75 * p[pair], np.minimum(1.25 * p[pair], 1), strict=True))
        least = sign * linprog(cost, A_eq=np.ones((1, 5)), b_eq=[1], bounds=ends).fun
        assert own.low[pair] - 1e-9 <= least <= own.high[pair] + 1e-9
        assert own.value[pair] == pytest.approx(least)
        # |q - p| as u + v with q = p + u - v
        above = np.vstack([np.ones(10), np.hstack([-np.eye(5), np.eye(5)])])
        both = linprog([*cost, *-cost], A_ub=above, b_ub=[radius, *p[pair]],
                       A_eq=[[1] * 5 + [-1] * 5], b_eq=[0])  # fmt: skip
        wanted = sign * (both.fun + cost @ p[pair])
        assert ball.value[pair] == pytest.approx(wanted)
    place, following, weight, earned = list_entries(blocks, own.distributions)
    law = np.zeros((10, 5))
    np.add.at(law, (place, following), weight)
    assert law.sum(axis=1) == pytest.approx(np.ones(10))
    assert earned == pytest.approx(mdp.reward)
    assert 0.9 * law @ value + earned == pytest.approx(own.value)


def test_relative_intervals_end_at_0_and_1() -> None:
    mdp = MDP.from_outcomes([(0, 0, [("9/10", 0, 1), ("1/10", 1, 0)]), (1, 0, [(1, 1, 0)])], "1/2")
    found = Intervals.relative(mdp, "1/2")
    assert np.asarray(found.lower, float) == pytest.approx([0.45, 0.05, 0.5])
    assert np.asarray(found.upper, float) == pytest.approx([1, 0.15, 1])


class Whole(Ambiguity):
    """Every distribution: the least payoff is certain."""

    def check(self, model: MDP) -> None:
        pass

    def minimise(self, block: RowBlock, payoff: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        least = payoff.argmin(axis=1)[:, None] == np.arange(payoff.shape[1])
        return least.astype(float), np.zeros(len(payoff))


def test_sets_say_of_which_pairs_all_outcomes_remain_possible() -> None:
    """Rows of 1/10, 9/10; of 1/2, 1/2; and of one outcome."""
    rows = [(0, 0, [("1/10", 0, 1), ("9/10", 1, 0)]), (0, 1, [("1/2", 0, 1), ("1/2", 1, 0)])]
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], "1/2")
    chances = mdp.table.compute_probabilities()
    for sets, kept in (
        (Intervals.relative(mdp, "9/10"), [True, True]),
        (Intervals.relative(mdp, 1), [False, False]),
        (Intervals(lower=np.where(chances < 0.2, 0, chances), upper=np.ones(5)), [False, True]),
        (L1Ball(radius="1/10"), [True, True]),
        (L1Ball(radius="1/5"), [False, True]),
        (L1Ball(radius=["1/10", 1, 2]), [True, False]),
        (L1Ball(radius=["1/5", "99/100", 2]), [False, True]),
        (Likelihood(radius=5), [True, True]),
        (Whole(), [False, False]),
    ):
        assert sets.keeps_outcomes(mdp).tolist() == [*kept, True]


def test_a_single_outcome_is_certain() -> None:
    rows = [(0, 0, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, "9/10")
    blocks = side_by_side(
        np.arange(2), (np.arange(2), np.ones(2, int)), (mdp.table.next, np.ones(2), mdp.reward)
    )
    for against in (True, False):
        sets = Intervals(lower=np.full(2, 0.9), upper=np.ones(2))
        found = solve_inner_problem(
            sets, blocks, np.array([5.0, 10.0]), discount=0.9, against=against
        )
        assert found.value.tolist() == [12, 9]
        assert (found.low <= [12, 9]).all()
        assert (found.high >= [12, 9]).all()
