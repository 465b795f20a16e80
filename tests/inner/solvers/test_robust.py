"""Robust values: published answers, exact rationals, linear programs, and what must hold of any."""

from fractions import Fraction

import numpy as np
import pytest
from cases.intervals import INTERVAL_CASES, IntervalCase, total_reward
from cli_runner import run
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
    robust_curve,
    solve,
    solve_robust,
)
from exact_mdp.analysis.plots.sensitivity import plot_robust_curve
from exact_mdp.analysis.vary.robust import SETS, ambiguity_of
from exact_mdp.solvers.robust.divergence import Likelihood, RelativeEntropy
from exact_mdp.solvers.robust.robust import RobustSolution
from exact_mdp.solvers.robust.sets import L1Ball
from exact_mdp.solvers.values.policy_chain import PolicyChain

F = Fraction
GAMES = [(o, n) for o in ("max", "min") for n in ("worst", "best")]
SMALL = Scenario.load("yuan2025").with_(tasks=[1, 1], max_trial=3)
SHARES = (F(0), F(1, 5), F(1, 2))
moderate = settings(max_examples=12)


def exact_inner(outcomes, share: Fraction, least: bool) -> Fraction:
    """Give outcomes in order of worth their upper bounds, in rationals."""
    rows = sorted(outcomes, key=lambda each: each[1], reverse=not least)
    lower = [p * (1 - share) for p, _ in rows]
    left, total = 1 - sum(lower), F(0)
    for (p, worth), low in zip(rows, lower, strict=True):
        more = min(left, min(p * (1 + share), F(1)) - low)
        left -= more
        total += (low + more) * worth
    assert left == 0
    return total


def exact_values(mdp: MDP, share: Fraction, objective: str, nature: str, weights=None):
    """Backward induction in rationals, states numbered along the transitions."""
    value = [F(0)] * mdp.n_states
    least = (nature == "worst") == (objective == "max")
    for state in reversed(range(mdp.n_states)):
        if mdp.terminal[state]:
            continue
        worths = []
        for pair in mdp.pairs_of(state):
            outcomes = [(p, g + mdp.discount_exact * value[t]) for p, t, g in mdp.table.row(pair)]
            worths.append(exact_inner(outcomes, share, least))
        if weights is not None:
            chosen = [F(float(weights[pair])) for pair in mdp.pairs_of(state)]
            value[state] = sum(w * x for w, x in zip(chosen, worths, strict=True))
        else:
            value[state] = (max if objective == "max" else min)(worths)
    return value


@pytest.mark.parametrize(("objective", "nature"), GAMES)
@pytest.mark.parametrize("share", [F(1, 5), F(9, 10)])
def test_the_care_model_in_rationals(objective, nature, share) -> None:
    mdp = SMALL.compile()
    right = exact_values(mdp, share, objective, nature)
    mdp = mdp.with_(sense=objective)
    found = solve_robust(mdp, Intervals.relative(mdp, share), nature=nature)
    off = np.array([float(abs(F(v) - r)) for v, r in zip(found.value.tolist(), right, strict=True)])
    assert (off <= found.state_error).all()
    assert found.error_bound < 1e-9
    held = PolicyChain.of(mdp, "random").weights
    right = exact_values(mdp, share, objective, nature, held)
    found = solve_robust(mdp, Intervals.relative(mdp, share), nature=nature, policy="random")
    assert abs(found.start.value - float(right[0])) <= found.start.error


def sets(mdp: MDP, share: Fraction) -> list:
    return [
        Intervals.relative(mdp, share),
        L1Ball(radius=float(share)),
        Likelihood(radius=float(share)),
        RelativeEntropy(radius=float(share)),
    ]


def solved(mdp: MDP, kind, **choices) -> RobustSolution | None:
    """The solution; None where a set lets an episode go on for ever, or floats do not suffice."""
    try:
        return solve_robust(mdp, kind, **choices)
    except (ModelError, SolverError):
        return None


@pytest.mark.filterwarnings("ignore::exact_mdp.PrecisionWarning")
@moderate
@given(models(), st.sampled_from(SHARES))
def test_order_of_values(rows: Rows, share: Fraction) -> None:
    mdp = rows.model()
    nominal = solve(mdp)
    for kind in sets(mdp, share):
        worst, best = solved(mdp, kind), solved(mdp, kind, nature="best")
        if worst is None or best is None:
            assert isinstance(kind, L1Ball | RelativeEntropy | Likelihood) or rows.discount > 0.9
            continue
        room = worst.state_error + best.state_error + nominal.state_error
        assert (worst.value <= nominal.value + room).all()
        assert (nominal.value <= best.value + room).all()
        held = solved(mdp, kind, policy=nominal)
        own = solved(mdp, kind, policy=worst.policy)
        assert held is not None
        assert own is not None
        assert (held.value <= worst.value + held.state_error + worst.state_error).all()
        assert (np.abs(own.value - worst.value) <= own.state_error + worst.state_error).all()
        if share == 0:
            assert (np.abs(worst.value - nominal.value) <= room + 1e-9 * np.abs(worst.value)).all()


@pytest.mark.filterwarnings("ignore::exact_mdp.PrecisionWarning")
@moderate
@given(models(discounts=[F(1, 2), F(9, 10), F(1)]), st.sampled_from(GAMES))
def test_bellman_equations_by_linear_programs(rows: Rows, game: tuple[str, str]) -> None:
    mdp, (objective, nature) = rows.model(), game
    kind = Intervals.relative(mdp, F(1, 3))
    mdp = mdp.with_(sense=objective)
    found = solved(mdp, kind, nature=nature)
    if found is None:
        return
    table, gains = mdp.table, mdp.table.gains()
    sign = 1 if (nature == "worst") == (objective == "max") else -1
    size = float(np.abs(found.value).max() + np.abs(gains).max()) or 1.0
    for state in np.flatnonzero(~mdp.terminal).tolist():
        worths = []
        for pair in mdp.pairs_of(state):
            part = slice(int(table.offsets[pair]), int(table.offsets[pair + 1]))
            cost = (gains[part] + mdp.discount * found.value[table.next[part]]) / size
            bounds = list(zip(kind.lower[part], kind.upper[part], strict=True))
            done = linprog(sign * cost, A_eq=np.ones((1, len(cost))), b_eq=[1.0], bounds=bounds)
            worths.append(sign * done.fun * size)
        best = max(worths) if objective == "max" else min(worths)
        assert found.value[state] == pytest.approx(best, abs=1e-6 * size + 2 * found.error_bound)


def test_discount_near_1_ends_with_honest_bounds() -> None:
    rng = np.random.default_rng(0)
    laws = rng.dirichlet(np.ones(5), (3, 60))
    matrix = np.zeros((3, 60, 60))
    for action in range(3):
        for state in range(60):
            matrix[action, state, rng.choice(60, 5, replace=False)] = laws[action, state]
    mdp = MDP.from_arrays(list(matrix), rng.normal(size=(60, 3)), "9999/10000")
    for kind in sets(mdp, F(1, 10)):
        found = solve_robust(mdp, kind)
        system = np.eye(60) - mdp.discount * found.transition.toarray()
        earned = np.linalg.solve(system, found.reward)
        assert np.abs(earned - found.value).max() <= 3 * found.error_bound + 1e-6
        assert found.iterations < 30


def test_a_way_out_that_nature_can_close() -> None:
    mdp = MDP.from_arrays([[["9/10", "1/10"], [0, 1]]], [-1, 0])
    assert solve_robust(mdp, L1Ball(radius=0.1)).start.value == pytest.approx(-20)
    with pytest.raises(ModelError, match="every episode to end"):
        solve_robust(mdp, L1Ball(radius=0.3))
    assert solve_robust(mdp.with_(discount="9/10"), L1Ball(radius=0.3)).start.value == (
        pytest.approx(-10)
    )


def test_a_limit_of_iterations_and_a_tolerance_beyond_floats() -> None:
    mdp = MDP.from_arrays([[["1/3", "2/3"], ["1/7", "6/7"]]], [1, 0], "9/10")
    with pytest.raises(SolverError, match="iteration limit"):
        solve_robust(mdp, L1Ball(radius=0.1), max_iterations=1, tol=1e-9)
    with pytest.warns(PrecisionWarning):
        solve_robust(mdp, L1Ball(radius=0.1), tol=1e-17)


# ---- the analysis ----------------------------------------------------------------------------


def risky() -> MDP:
    """Safe earns 1; risky earns 3 with probability 1/2, and so 3/2 on average."""
    return MDP.from_outcomes(
        [
            (0, 0, [(1, 1, 1)]),
            (0, 1, [("1/2", 1, 3), ("1/2", 2, 0)]),
            (1, 0, [(1, 1, 0)]),
            (2, 0, [(1, 2, 0)]),
        ],
        actions=("safe", "risky"),
    )


def test_the_price_of_robustness() -> None:
    found = robust(risky(), Intervals.relative(risky(), "1/2"))
    assert found.value.value == 1.5
    assert found.worst.value == pytest.approx(0.75)
    assert found.best.value == pytest.approx(2.25)
    assert found.robust.start.value == pytest.approx(1)
    assert found.price.value == pytest.approx(0.5)
    assert found.gain.value == pytest.approx(0.25)
    assert found.changed.tolist() == [0]
    taken = found.mdp.pair_action[found.robust.pairs[found.changed]]
    assert [found.mdp.actions[action] for action in taken] == ["safe"]
    assert found.frame()["value (reward)"].tolist() == pytest.approx(
        [1.5, 0.75, 2.25, 1, 1, 1, 2.25]
    )
    costs = robust(risky().with_(sense="min"), Intervals.relative(risky(), "1/2"))
    assert (costs.value.value, costs.worst.value) == (1, 1)


@pytest.mark.parametrize("kind", SETS)
def test_every_kind_of_set_on_the_care_model(kind: str) -> None:
    mdp = SMALL.compile()
    found = robust(mdp, ambiguity_of(mdp, kind, "1/20"), policy="always:directive")
    assert found.worst.value < found.value.value < found.best.value
    assert found.value.value == pytest.approx(evaluate(mdp, "always:directive").mean)
    assert found.gain.value > 0


def test_a_box_needs_a_parameter_that_moves(tmp_path) -> None:
    risky().save(tmp_path / "model.npz")
    done = run("robust", tmp_path / "model.npz", "--set-kind", "box")
    assert (done.status, done.out) == (2, "")
    assert "no parameter moves" in done.err


def test_the_curve_and_its_figure() -> None:
    curve = robust_curve(risky(), "interval", [0, "1/4", "1/2", 1])
    frame = curve.frame()
    assert frame["nominal policy, worst (reward)"].tolist() == pytest.approx([1.5, 1.125, 0.75, 0])
    assert frame["robust policy, worst (reward)"].tolist() == pytest.approx([1.5, 1.125, 1, 1])
    assert frame["price of robustness (reward)"].tolist() == pytest.approx([0, 0, 0.5, 0.5])
    ax = plot_robust_curve(curve)
    assert len(ax.lines) == 4
    assert "reward" in ax.get_ylabel()
    with pytest.raises(ModelError):
        robust_curve(risky(), "interval", [])


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


@pytest.mark.parametrize("case", INTERVAL_CASES, ids=str)
def test_published_answer(case: IntervalCase) -> None:
    mdp, intervals = interval_model(case)
    for (objective, nature), values in case.values.items():
        found = solve_robust(mdp.with_(sense=objective), intervals, nature=nature)
        assert found.error_bound < 1e-5
        for state, value in values.items():
            room = found.state_error[state] + case.tolerance
            assert abs(found.value[state] - float(value)) <= room, (objective, nature, state)


@pytest.mark.parametrize("case", INTERVAL_CASES, ids=str)
def test_the_chain_it_returns_earns_what_it_says(case: IntervalCase) -> None:
    mdp, intervals = interval_model(case)
    for objective, nature in case.values:
        found = solve_robust(mdp.with_(sense=objective), intervals, nature=nature)
        matrix = np.eye(mdp.n_states) - mdp.discount * found.transition.toarray()
        earned = np.linalg.solve(matrix, found.reward)
        assert earned == pytest.approx(found.value, abs=1e-7 + 2 * found.error_bound)


def test_an_infinite_total_is_refused() -> None:
    case = total_reward(F(1))
    mdp, intervals = interval_model(case)
    with pytest.raises(ModelError, match="every episode to end") as caught:
        solve_robust(mdp, intervals)
    assert "state 2" in str(caught.value)
