"""Robust values: published answers, rationals, linear programs, closed forms, and laws of any."""

from fractions import Fraction
from math import exp, inf, log, sqrt
from typing import Any

import numpy as np
import pytest
from answers import holds
from cases.intervals import INTERVAL_CASES, IntervalCase, total_reward
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from strategies import Rows, models

from exact_mdp import (
    MDP,
    Intervals,
    ModelError,
    PrecisionWarning,
    Scenario,
    SolverError,
    evaluate,
    robust,
    solve,
    solve_robust,
)

F = Fraction
SETS = ("interval", "l1", "kl")
SMALL = Scenario.load("yuan2025").with_(tasks=[1, 1], max_trial=3)
fewer = settings(max_examples=40)


def interval_model(case: IntervalCase) -> tuple[MDP, Intervals]:
    """A model with a law inside the intervals of each row, and these."""
    outcomes, bounds = [], {}
    for state, action, row in case.rows:
        least = sum(low for low, *_ in row)
        room = sum(high for _, high, *_ in row) - least
        share = (1 - least) / room if room else F(0)
        outcomes.append((state, action, [(a + share * (b - a), to, r) for a, b, to, r in row]))
        bounds |= {(state, action, to, gain): (low, high) for low, high, to, gain in row}
    mdp = MDP.from_outcomes(outcomes, case.discount, start=case.start)
    both = [
        bounds[int(mdp.pair_state[pair]), int(mdp.pair_action[pair]), to, gain]
        for pair in range(mdp.n_pairs)
        for _, to, gain in mdp.table.row(pair)
    ]
    lower, upper = np.array(both, dtype=float).T
    return mdp, Intervals(lower=lower, upper=upper)


def cases(mdp: MDP, kind: str, radius: float | F, policy: Any = "optimal") -> Any:
    """Both natures, against the best policy and a given one, in sets of one kind."""
    return robust(mdp, kind, radius=radius, policy=policy)


def side(both: Any, nature: str) -> Any:
    """The solution of one nature."""
    return both.robust if nature == "worst" else both.optimistic


def earned(solution: Any) -> Any:
    """What the chain that is returned earns."""
    system = np.eye(solution.mdp.n_states) - solution.mdp.discount * solution.transition.toarray()
    return np.linalg.solve(system, solution.reward)


@pytest.mark.parametrize("case", INTERVAL_CASES, ids=str)
def test_published_answers(case: IntervalCase) -> None:
    mdp, intervals = interval_model(case)
    for (objective, nature), values in case.values.items():
        solution = solve_robust(mdp.with_(sense=objective), intervals, nature=nature)
        assert solution.error_bound < 1e-5
        for state, value in values.items():
            room = solution.state_error[state] + case.tolerance
            assert abs(solution.value[state] - float(value)) <= room, (objective, nature, state)
        assert earned(solution) == pytest.approx(
            solution.value, abs=1e-7 + 2 * solution.error_bound
        )


# ---- nature's choice within one row --------------------------------------------------------------


@st.composite
def rows(draw: st.DrawFn) -> tuple[MDP, np.ndarray, np.ndarray, str]:
    """State 0 has one row: outcome k earns gains[k] and leads to state k + 1; p, gains, nature."""
    weights = draw(st.lists(st.integers(1, 50), min_size=1, max_size=7))
    size, n = draw(st.sampled_from([1e-6, 1.0, 1e6])), len(weights)
    sixty_fourths = draw(st.lists(st.integers(-300, 300), min_size=n, max_size=n))
    gains = [k / 64 * size for k in sixty_fourths]
    nature = draw(st.sampled_from(["worst", "best"]))
    return row_model(weights, gains), np.array(weights) / sum(weights), np.array(gains), nature


def row_model(weights: list[int], gains: list[float]) -> MDP:
    both = enumerate(zip(weights, gains, strict=True))
    outcomes = [(F(w, sum(weights)), k + 1, g) for k, (w, g) in both]
    ends = [(k + 1, 0, [(1, k + 1, 0)]) for k in range(len(weights))]
    return MDP.from_outcomes([(0, 0, outcomes), *ends])


@fewer
@given(rows(), st.sampled_from(["interval", "l1"]),
       st.sampled_from([0.0, 0.1, 0.2, 0.9, 1.0, 3.0]))  # fmt: skip
def test_intervals_and_balls_against_a_linear_program(row: Any, kind: str, radius: float) -> None:
    """Over q and |q - p|."""
    mdp, p, gains, nature = row
    n, size = len(p), np.abs(gains).max() or 1.0  # the program's tolerances are absolute
    eye, none = np.eye(n), np.zeros((1, n))
    bounds, most = [(0.0, 1.0)] * n, float(radius)
    if kind != "l1":
        far = radius * p
        bounds, most = [*zip(np.maximum(p - far, 0), np.minimum(p + far, 1), strict=True)], 2.0
    sign = 1 if nature == "worst" else -1
    done = linprog(
        np.concatenate([sign * gains / size, np.zeros(n)]),
        A_eq=np.concatenate([np.ones((1, n)), none], axis=1),
        b_eq=[1.0],
        A_ub=np.block([[eye, -eye], [-eye, -eye], [none, np.ones((1, n))]]),
        b_ub=np.concatenate([p, -p, [most]]),
        bounds=[*bounds, *[(0, None)] * n],
    )
    start = side(cases(mdp, kind, radius), nature).start
    assert abs(start.value - sign * size * done.fun) <= start.error + 1e-7 * size
    assert start.error <= 1e-7 * size


def divergence(p: np.ndarray, q: np.ndarray) -> float:
    return float(sum(a * log(a / b) for a, b in zip(p, q, strict=True)))


@pytest.mark.filterwarnings("ignore::exact_mdp.PrecisionWarning")
@fewer
@given(
    row=rows(),
    radius=st.sampled_from([0.0, 1e-14, 1e-9, 1e-4, 0.01, 0.1, 0.5, 1.0, 1.9, 5.0]),
    seed=st.integers(0, 99),
)
def test_likelihood_sets_hold_what_they_return_and_no_member_beats_the_bound(
    row: Any, radius: float, seed: int
) -> None:
    mdp, p, gains, nature = row
    solution, n = side(cases(mdp, "kl", radius), nature), len(p)
    low, high = solution.start.interval
    q = solution.transition.toarray()[0, 1 : n + 1]
    q = q / q.sum()
    if not (q == 0).any():
        assert divergence(p, q) <= radius + 1e-13
    # A proven gap: the tolerance, and the edge of the divergence, which is left out by 1e-13.
    edge = min(1e-13 * (1 + radius) / sqrt(radius), sqrt(2 * radius)) if radius else 0.0
    room = 1e-12 * np.abs(gains).max()
    assert high - low <= 2e-9 * max(1, np.abs(gains).max()) + 10 * edge * np.ptp(gains)
    rng = np.random.default_rng(seed)
    for other in (rng.dirichlet(np.ones(n)), rng.dirichlet(0.2 * np.ones(n)) + 1e-12):
        other = other / other.sum()
        near, far = 0.0, 1.0  # towards `other` until the edge
        for _ in range(60):
            middle = (near + far) / 2
            inside = divergence(p, p + middle * (other - p)) <= radius - 1e-14
            near, far = (middle, far) if inside else (near, middle)
        earned = (p + near * (other - p)) @ gains
        assert earned >= low - room if nature == "worst" else earned <= high + room


def test_two_outcomes_have_closed_forms() -> None:
    mdp = row_model([1, 1], [0.0, 1.0])
    for radius in (1e-6, 1e-3, 0.1, 0.5, 2.0):
        start = cases(mdp, "kl", radius).worst
        right = (1 - sqrt(1 - exp(-2 * radius))) / 2  # 4 q (1 - q) = e^-2β
        assert abs(start.value - right) <= start.error < 1e-9


# ---- whole models --------------------------------------------------------------------------------


def exact_values(mdp: MDP, share: Fraction, nature: str, weights: Any) -> list[Fraction]:
    """Backward induction in rationals: outcomes in order of worth get their upper bounds."""
    value = [F(0)] * mdp.n_states
    least, choose = (nature == "worst") == (mdp.sense == "max"), max if mdp.sense == "max" else min
    for state in np.flatnonzero(~mdp.terminal)[::-1].tolist():
        values = []
        for pair in mdp.pairs_of(state):
            outcomes = [(p, g + mdp.discount_exact * value[t]) for p, t, g in mdp.table.row(pair)]
            left, total = share, F(0)
            for p, x in sorted(outcomes, key=lambda each: each[1], reverse=not least):
                more = min(left, min(p * (1 + share), F(1)) - p * (1 - share))
                left, total = left - more, total + (p * (1 - share) + more) * x
            values.append(total)
        if weights is None:
            value[state] = choose(values)
        else:
            chosen = weights[list(mdp.pairs_of(state))].tolist()
            value[state] = sum((F(w) * x for w, x in zip(chosen, values, strict=True)), F(0))
    return value


@pytest.mark.parametrize("nature", ["worst", "best"])
@pytest.mark.parametrize("objective", ["max", "min"])
@pytest.mark.parametrize("share", [F(1, 5), F(9, 10)])
def test_the_care_model_in_rationals(objective: str, nature: Any, share: Fraction) -> None:
    mdp = SMALL.compile().with_(sense=objective)
    for policy in (None, "random"):
        weights = None if policy is None else evaluate(mdp, policy).chain.weights
        right = exact_values(mdp, share, nature, weights)
        intervals = Intervals.relative(mdp, share)
        solution = solve_robust(mdp, intervals, nature=nature, policy=policy)
        holds(solution, right)
        assert solution.error_bound < 1e-9


@pytest.mark.filterwarnings("ignore::exact_mdp.PrecisionWarning")
@settings(max_examples=12)
@given(models(), st.sampled_from([F(0), F(1, 5), F(1, 2)]))
def test_order_of_values(rows: Rows, share: Fraction) -> None:
    mdp = rows.model()
    nominal = solve(mdp)
    for kind in SETS:
        try:
            both = cases(mdp, kind, share)
            again = cases(mdp, kind, share, both.robust.policy)
        except (ModelError, SolverError):  # a set lets an episode go on, or floats do not suffice
            assert kind != "interval" or rows.discount > 0.9
            continue
        worst, best = both.robust, both.optimistic
        room = worst.state_error + best.state_error + nominal.state_error
        assert (worst.value <= nominal.value + room).all()
        assert (nominal.value <= best.value + room).all()
        assert both.worst.interval[0] <= worst.start.interval[1]
        assert abs(again.worst.value - worst.start.value) <= again.worst.error + worst.start.error
        if share == 0:
            assert (np.abs(worst.value - nominal.value) <= room + 1e-9 * np.abs(worst.value)).all()


def test_discount_near_1_ends_with_honest_bounds() -> None:
    rng = np.random.default_rng(0)
    matrix = np.zeros((3, 60, 60))
    for action, state in np.ndindex(3, 60):
        matrix[action, state, rng.choice(60, 5, replace=False)] = rng.dirichlet(np.ones(5))
    mdp = MDP.from_arrays(list(matrix), rng.normal(size=(60, 3)), "9999/10000")
    for kind in SETS:
        solution = cases(mdp, kind, F(1, 10)).robust
        assert np.abs(earned(solution) - solution.value).max() <= 3 * solution.error_bound + 1e-6
        assert solution.iterations < 30


def test_a_way_out_that_nature_can_close() -> None:
    mdp = MDP.from_arrays([[["9/10", "1/10"], [0, 1]]], [-1, 0])
    assert cases(mdp, "l1", 0.1).worst.value == pytest.approx(-20)
    with pytest.raises(ModelError, match=r"(?s)every episode to end.*state \d"):
        cases(mdp, "l1", 0.3)
    assert cases(mdp.with_(discount="9/10"), "l1", 0.3).worst.value == pytest.approx(-10)


def test_states_that_earn_forever_have_infinite_totals() -> None:
    """State 2, behind 0, earns forever; 0 may stop with 100, and 4 ends with 2000 or 10000."""
    mdp, intervals = interval_model(total_reward(F(1)))
    for sense, nature, first, fourth in (
        ("max", "worst", inf, 4400),
        ("max", "best", inf, 7600),
        ("min", "worst", 100, 7600),
        ("min", "best", 100, 4400),
    ):
        found = solve_robust(mdp.with_(sense=sense), intervals, nature=nature)
        wanted = [first, 0, inf, 0, fourth, 2000, 10000, 0]
        assert found.value.tolist() == pytest.approx(wanted, rel=1e-9)
        assert found.state_error[2] == 0


def test_a_limit_of_iterations_and_a_tolerance_beyond_floats() -> None:
    mdp = MDP.from_arrays([[["1/3", "2/3"], ["1/7", "6/7"]]], [1, 0], "9/10")
    sets = Intervals.relative(mdp, 0.1)
    with pytest.raises(SolverError, match="iteration limit"):
        solve_robust(mdp, sets, max_iterations=1, tol=1e-9)
    with pytest.warns(PrecisionWarning, match=r"larger tol in solve_robust\(\), or keep") as told:
        assert "certify" not in str(solve_robust(mdp, sets, tol=1e-17))
    assert told[0].filename == __file__


HALF, HUGE, LATE = (
    MDP.from_arrays([[[1 - p, p], [0, 1]]], [reward, 0])
    for p, reward in ((F(1, 2), 1), (F(1, 2), F(10) ** 308), (F(1, 10**15), 1))
)


@pytest.mark.parametrize(
    "mdp, asked, advice, changed, then",
    [
        (HALF, {"max_iterations": 1}, "raise max_iterations", HALF, {"max_iterations": 9}),
        (HALF, {"max_iterations": 1}, "allow a larger tol", HALF, {"max_iterations": 1, "tol": 9}),
        (HUGE, {}, "scale the rewards if they are large", HALF, {}),
        (LATE, {}, "a lower discount", LATE.with_(discount="99/100"), {}),
    ],
)
def test_what_is_advised_works_with_sets(
    mdp: MDP, asked: Any, advice: str, changed: MDP, then: Any
) -> None:
    """certify() takes no sets."""
    with pytest.raises(SolverError, match=advice) as caught:
        solve_robust(mdp, Intervals.relative(mdp, "1/10"), **asked)
    assert "certify" not in str(caught.value)
    assert solve_robust(changed, Intervals.relative(changed, "1/10"), **then).start.error >= 0


@pytest.mark.parametrize("discount", ["99/100", "99999/100000"])
def test_sides_that_undo_each_other_settle_soon(discount: str) -> None:
    """To go is worth -1 + γ (γ x + (1 - γ) …): one round of both gains a factor γ alone."""
    rows = [(0, 0, [(1, 1, -1)]), (0, 1, [(1, 0, 0)]), (1, 0, [(1, 0, 0)]), (2, 0, [(1, 2, 0)]),
            (1, 1, [("1/4", 0, 9), ("1/6", 1, 9), ("7/12", 2, 9)])]  # fmt: skip
    mdp = MDP.from_outcomes(rows, discount)
    chance = mdp.table.compute_probabilities()
    sets = Intervals(lower=chance / 2, upper=np.minimum(1, 2 * chance))
    solution = solve_robust(mdp, sets, tol=1e-6)
    # Nature sends 1/8, 1/12 and 19/24 of what goes on: x = 9 + γ (y / 8 + x / 12), y = -1 + γ x.
    rate = F(discount)
    exact = (9 - rate / 8) / (1 - rate / 12 - rate**2 / 8)
    assert solution.iterations < 50
    assert abs(solution.value[1] - float(exact)) <= 1e-5


@pytest.mark.parametrize("kind", ["l1", "kl"])
def test_values_beyond_the_range_of_floats_have_no_bound(kind: str) -> None:
    most, half = 1.5e308, "1/2"
    mdp = MDP.from_outcomes([(0, 0, [(half, 0, most), (half, 1, most)]),
                             (0, 1, [(half, 0, most), (half, 1, -most)]),
                             (1, 0, [(1, 1, 0)])], "1/10")  # fmt: skip
    with pytest.raises(SolverError, match="beyond the range of floats"):
        cases(mdp, kind, 0.5, [0, 0])


# ---- the analysis --------------------------------------------------------------------------------

# Safe earns 1; risky earns 3 with probability 1/2, and so 3/2 on average.
RISKY = MDP.from_outcomes(
    [(0, 0, [(1, 1, 1)]), (0, 1, [("1/2", 1, 3), ("1/2", 2, 0)]), (1, 0, [(1, 1, 0)]),
     (2, 0, [(1, 2, 0)])],
    actions=("safe", "risky"),
)  # fmt: skip


def test_the_price_of_robustness() -> None:
    both = robust(RISKY, Intervals.relative(RISKY, "1/2"))
    assert both.value.value == 1.5
    assert (both.price.value, both.gain.value) == pytest.approx((0.5, 0.25))
    assert both.changed.tolist() == [0]
    taken = both.mdp.pair_action[both.robust.pairs[both.changed]]
    assert [both.mdp.actions[action] for action in taken] == ["safe"]
    rare = Fraction(1, 10**13)
    mixed = {0: {"safe": 1 - rare, "risky": rare}, 1: "safe", 2: "safe"}
    held = robust(RISKY, Intervals.relative(RISKY, "1/2"), policy=mixed)
    assert held.changed.tolist() == [0]
    values = [1.5, 0.75, 2.25, 1, 1, 1, 2.25]
    assert both.frame()["value (reward)"].tolist() == pytest.approx(values)
    costs = robust(RISKY.with_(sense="min"), Intervals.relative(RISKY, "1/2"))
    assert (costs.value.value, costs.worst.value) == (1, 1)


def test_sets_that_would_not_fit_in_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.solvers.robust.robust.MOST_BYTES", 1000)
    with pytest.raises(ModelError, match="robust values of 5 outcomes") as refused:
        robust(RISKY)
    assert "at most 2 outcomes" in refused.value.fix
