"""Robust average rewards: all policies against all vertices, in fractions, and closed forms."""

from fractions import Fraction as F
from random import Random
from typing import Any

import numpy as np
import pytest
from inner.solvers.robust.test_improper import (
    SIZE,
    Row,
    assert_same,
    draw_mixed_policy,
    set_of,
    under_nature,
)
from questions import oracle
from questions.oracle import Problem

from exact_mdp import MDP, Intervals, ModelError, SolverError, robust, solve, solve_robust
from exact_mdp.solvers.endless.quotient import Quotient, build_quotient
from exact_mdp.solvers.robust.average import bound_gains
from exact_mdp.solvers.robust.game import Game
from exact_mdp.solvers.robust.likelihood import Likelihood
from exact_mdp.solvers.robust.sets import L1Ball

NATURES = ("worst", "best")


def random_problem(rng: Random, *, returning: bool) -> Problem:
    """Return a problem of averages; pairs of a `returning` one lead up, or back to state 0."""
    moves = list[list[Row]]()
    for state in range(SIZE):
        actions, among = list[Row](), [*range(SIZE)]
        if returning:
            among = [0, *range(state + 1, SIZE)]
        elif state >= 2 and rng.random() < 0.6:
            among = [state]
        for _ in range(rng.choice((1, 2, 2))):
            targets = sorted(rng.sample(among, min(len(among), rng.choice((1, 2, 2)))))
            weights = [rng.randint(1, 3) for _ in targets]
            once, apart = F(rng.randint(-3, 3)), rng.random() < 0.3
            amounts = [F(rng.randint(-3, 3)) if apart else once for _ in targets]
            actions.append(
                [
                    (F(w, sum(weights)), *each)
                    for w, *each in zip(weights, targets, amounts, strict=True)
                ]
            )
        moves.append(actions)
    return Problem(moves, F(1), {0: F(1)}, rng.choice(("max", "min")), average=True)


def model_of(problem: Problem) -> MDP:
    rows = [
        (s, a, outcomes) for s, each in enumerate(problem.moves) for a, outcomes in enumerate(each)
    ]
    return MDP.from_outcomes(rows, "1/2", sense=problem.sense)


def averages_of(found: Any) -> np.ndarray:
    """Return the long-run averages of a solution's transitions and rewards."""
    chain = found.transition.toarray() + np.diag(found.mdp.terminal.astype(float))
    often = np.linalg.matrix_power((np.eye(len(chain)) + chain) / 2, 2**20)
    return np.asarray(often @ found.reward)


@pytest.mark.parametrize("nature", NATURES)
@pytest.mark.parametrize("kind", ["interval", "l1", "wide"])
def test_values_are_those_of_all_policies_against_all_vertices(kind: str, nature: str) -> None:
    """In a wide set outcomes may be impossible; state 0 is then met again whatever happens."""
    several = 0
    for seed in range(30):
        problem = random_problem(Random(seed), returning=kind == "wide")
        mdp = model_of(problem)
        policies = [oracle.pure(problem, choice) for choice in problem.choices()]
        values = [under_nature(problem, kind, nature, policy) for policy in policies]
        wanted = [problem.best(column) for column in zip(*values, strict=True)]
        found = solve_robust(mdp, set_of(mdp, kind), nature=nature, criterion="average")
        taken = [int(found.policy.rule[state]) for state in range(SIZE)]
        own = under_nature(problem, kind, nature, oracle.pure(problem, taken))
        for state in range(SIZE):
            assert_same(found, wanted, state)
            assert own[state] == wanted[state]
        assert averages_of(found) == pytest.approx(found.value, abs=1e-7)
        assert found.iterations <= 20
        several += len({*wanted}) > 1
    assert several >= (0 if kind == "wide" else 3)


@pytest.mark.parametrize("nature", NATURES)
@pytest.mark.parametrize("kind", ["interval", "l1", "wide"])
def test_a_policy_is_worth_what_nature_leaves_it(kind: str, nature: str) -> None:
    mixes = 0
    for seed in range(20):
        rng = Random(f"policy {seed}")
        problem = random_problem(rng, returning=kind == "wide")
        mdp = model_of(problem)
        policy, mixed = draw_mixed_policy(problem, rng)
        asked = {"nature": nature, "policy": mixed, "criterion": "average"}
        found = solve_robust(mdp, set_of(mdp, kind), **asked)
        wanted = under_nature(problem, kind, nature, policy)
        for state in range(SIZE):
            assert_same(found, wanted, state)
        assert found.pairs is None
        assert averages_of(found) == pytest.approx(found.value, abs=1e-7)
        mixes += any(len(shares) > 1 and 0 < shares[0] < 1 for shares in policy)
    assert mixes >= 4


@pytest.mark.parametrize("sense", ["max", "min"])
def test_sets_of_one_row_leave_the_average_of_the_model(sense: str) -> None:
    for seed in range(12):
        mdp = model_of(random_problem(Random(f"one {seed}"), returning=False)).with_(sense=sense)
        best = solve(mdp, criterion="average")
        found = robust(mdp, radius=0, criterion="average")
        for each in (found.robust, found.optimistic):
            assert each.value == pytest.approx(best.value, abs=1e-8)
        for each in (found.value, found.worst, found.best, found.robust_value, found.robust_best):
            assert each.value == pytest.approx(best.start.value, abs=1e-8)


def two_states(p: Any, q: Any, gain: Any = 1) -> MDP:
    """State 0, which earns, is left with probability p, and state 1 with probability q."""
    rows = [(0, 0, [(p, 1, gain), (1 - F(p), 0, gain)]), (1, 0, [(q, 0, 0), (1 - F(q), 1, 0)])]
    return MDP.from_outcomes(rows)


def test_the_share_of_time_in_a_state_has_a_closed_form() -> None:
    """It is q / (p + q), with p and q within 1/2 ± 1/10, or at the edge of a likelihood region."""
    mdp, edge = two_states("1/2", "1/2"), np.sqrt(1 - np.exp(-2 * 0.01)) / 2
    for sets, off in (
        (Intervals.relative(mdp, "1/5"), 0.1),
        (L1Ball(radius="1/5"), 0.1),
        (Likelihood(radius="1/100"), edge),
    ):
        for nature, q in (("worst", 0.5 - off), ("best", 0.5 + off)):
            found = solve_robust(mdp, sets, nature=nature, criterion="average")
            assert found.value == pytest.approx([q, q], abs=1e-9)
            assert found.transition.toarray()[:, 0] == pytest.approx([q, q])
            assert averages_of(found) == pytest.approx(found.value, abs=1e-9)
            assert "start average reward 0." in str(found)


def test_a_discount_does_not_count() -> None:
    mdp = two_states("1/3", "1/2")
    each = [
        solve_robust(mdp.with_(discount=rate), Intervals.relative(mdp, "1/5"), criterion="average")
        for rate in ("1/2", 1)
    ]
    assert each[0].value.tolist() == each[1].value.tolist()


def test_where_a_run_ends_up_may_be_natures_choice() -> None:
    """From state 0 a step leads to a state that earns 1 or to one that earns 0; waiting earns 1/2.

    The first has the probability 3/5 ± 1/10: it is worth the step if nature helps, or leaves it.
    """
    rows = [
        (0, 0, [("3/5", 1, 9), ("2/5", 2, 9)]),
        (0, 1, [(1, 0, F(1, 2))]),
        (1, 0, [(1, 1, 1)]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp, share = MDP.from_outcomes(rows), F(1, 3)
    sets = Intervals.relative(mdp, share)  # 2/5 ± 2/15 binds: from 7/15 to 11/15
    for nature, value, taken in (("worst", F(1, 2), 1), ("best", F(11, 15), 0)):
        found = solve_robust(mdp, sets, nature=nature, criterion="average")
        assert found.value == pytest.approx([float(value), 1, 0], abs=1e-9)
        assert found.policy.rule[0] == taken
        held = solve_robust(mdp, sets, nature=nature, policy=[0, 0, 0], criterion="average")
        assert held.value[0] == pytest.approx(7 / 15 if nature == "worst" else 11 / 15, abs=1e-9)
        assert held.transition.toarray()[0, 1] == pytest.approx(held.value[0])


def test_sets_that_make_outcomes_impossible_need_a_state_that_is_always_met_again() -> None:
    mdp = two_states("1/2", "1/2")
    for sets in (L1Ball(radius=1), Intervals.relative(mdp, 1)):
        with pytest.raises(ModelError, match="no state is visited again and again"):
            solve_robust(mdp, sets, criterion="average")
    # From state 1 all ways lead back, so that nature may keep the run in state 0.
    back = two_states("1/2", 1)
    for nature, value in (("worst", F(1, 2)), ("best", F(1))):
        found = solve_robust(back, L1Ball(radius=1), nature=nature, criterion="average")
        assert found.value == pytest.approx([float(value)] * 2, abs=1e-9)
    # State 0 keeps a chance of 1/8 in every row, and yet this is refused, in words that are true.
    kept = MDP.from_outcomes([(s, 0, [("5/8", 0, s), ("3/8", 1, s)]) for s in (0, 1)])
    with pytest.raises(ModelError, match="if they may leave any single one, no state"):
        solve_robust(kept, L1Ball(radius="3/4"), criterion="average")
    mixed = solve_robust(mdp.with_(sense="min"), L1Ball(radius="1/2"), criterion="average")
    assert mixed.value == pytest.approx([0.75] * 2, abs=1e-9)


def test_places_that_earn_the_same_do_not_take_turns() -> None:
    """Forty states in a ring, of which every tenth may be stayed in for 5."""
    rng, rows = Random(1), []
    for state in range(40):
        ahead, back = (state + 1) % 40, (state - 1) % 40
        rows.append((state, 0, [("1/3", ahead, rng.randint(-5, 4)), ("2/3", back, 1)]))
        rows.append((state, 1, [("2/3", ahead, rng.randint(-5, 4)), ("1/3", back, 0)]))
        if state % 10 == 0:
            rows.append((state, 2, [(1, state, 5)]))
    mdp = MDP.from_outcomes(rows)
    for nature in NATURES:
        found = solve_robust(
            mdp, Intervals.relative(mdp, "1/2"), nature=nature, criterion="average"
        )
        assert found.value == pytest.approx(np.full(40, 5), abs=1e-8)
        assert found.iterations <= 20
        assert averages_of(found) == pytest.approx(np.full(40, 5), abs=1e-6)


def whole(mdp: MDP) -> Quotient:
    """Return the whole model, with an end that none reaches."""
    return build_quotient(mdp, np.arange(mdp.n_pairs), np.arange(mdp.n_states))


def test_bounds_hold_from_the_first_step_on() -> None:
    """The least and the greatest T h - h enclose the gain, whatever h is."""
    mdp = two_states("1/2", "1/3", 6).with_(discount=1)
    game = Game(mdp, Intervals.relative(mdp, "1/5"), against=True, weights=None, part=whole(mdp))
    widths = []
    for steps in (1, 2, 3):
        found = bound_gains(game, np.array([0, 0, 1]), 0.0, steps)
        # q / (p + q) at p = 3/5 and q = 4/15.
        assert found.low[0] - 1e-12 <= 6 * 4 / 13 <= found.high[0] + 1e-12
        assert found.iterations <= steps
        widths.append(float(found.high[0] - found.low[0]))
    assert widths[0] > 1 > 1e-9 > widths[2]


def test_a_limit_of_iterations_and_a_tolerance() -> None:
    mdp = two_states("1/2", "1/3", 6)
    sets = Intervals.relative(mdp, "1/5")
    with pytest.raises(SolverError, match="after 1 iterations"):
        solve_robust(mdp, sets, criterion="average", max_iterations=1)
    rough = solve_robust(mdp, sets, criterion="average", tol=20)
    assert rough.error_bound <= 20
    assert abs(rough.value[0] - 24 / 13) <= rough.state_error[0]
    assert solve_robust(mdp, sets, criterion="average").error_bound < 1e-9


@pytest.mark.parametrize("ask", [lambda m: m.until("goal"), lambda m: m.within(2)])
def test_an_average_has_neither_a_target_nor_a_horizon(ask: Any) -> None:
    mdp = ask(two_states("1/2", "1/3").with_(labels={"goal": [1]}))
    for call in (
        lambda: solve_robust(mdp, Intervals.relative(mdp, "1/5"), criterion="average"),
        lambda: robust(mdp, criterion="average"),
    ):
        with pytest.raises(ModelError, match="an average reward per step has no"):
            call()


@pytest.mark.parametrize("radius", [30, 2000])
def test_a_way_that_floats_cannot_keep_open_has_no_bound(radius: int) -> None:
    """Nature may leave e^-30 of a probability, or less than floats hold."""
    rows = [
        (0, 0, [(1, 0, 1)]),
        (0, 1, [("1/2", 1, 0), ("1/2", 0, 0)]),
        (1, 0, [(1, 1, 2)]),
        (1, 1, [("1/2", 0, 0), ("1/2", 1, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    with pytest.raises(SolverError, match="cannot bound the error"):
        solve_robust(mdp, Likelihood(radius=radius), criterion="average")
    found = solve_robust(mdp, Likelihood(radius=radius), nature="best", criterion="average")
    assert found.value == pytest.approx([2, 2], abs=1e-9)
