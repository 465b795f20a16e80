"""Laws of every solver: its answers lie within its own bounds, in every form of every model.

A view is another form of a drawn model, whose values follow from its own. A method is a way to ask
for the optimum. The oracle says what is right: in rational arithmetic no policy has more.
"""

from collections.abc import Callable
from fractions import Fraction as F
from itertools import chain, product
from math import inf, prod
from typing import Any

import numpy as np
import pytest
from answers import SWEEPING, errors_of, holds, near, quietly, within
from hypothesis import assume, given, note, settings
from hypothesis import strategies as st
from made_models import in_copies
from oracle import (
    best_average,
    best_total,
    gain_and_bias,
    mean,
    policy_values,
    rows_by_state,
    rows_of,
    solve_exact,
    total,
)
from strategies import Pairs, Row, Rows, any_models, exact_gains, model_of, models

from exact_mdp import (
    MDP,
    SOLVERS,
    Certificate,
    Intervals,
    LinearProgram,
    ModelError,
    Solution,
    SolverError,
    Status,
    certify,
    evaluate,
    solve,
    solve_robust,
)

Values = list[Any]
View = Callable[[Rows, Values], tuple[MDP, Values]]


# ---- views: another form of a model, and its values ----------------------------------------------


def as_drawn(rows: Rows, value: Values) -> tuple[MDP, Values]:
    return rows.model(), value


def renumbered(rows: Rows, value: Values) -> tuple[MDP, Values]:
    """States in another order, actions by other numbers."""
    n = rows.n_states
    place = [(s * 5 + 2) % n if n % 5 else n - 1 - s for s in range(n)]
    pairs = [
        (place[s], 7 - a, r, {place[t]: p for t, p in law.items()}) for s, a, r, law in rows.pairs
    ]
    return model_of(n, sorted(pairs, key=lambda row: row[:2]), rows.discount), [
        value[place.index(s)] for s in range(n)
    ]


def scaled(rows: Rows, value: Values) -> tuple[MDP, Values]:
    by = F(2) ** -37
    pairs = [(s, a, by * r, law) for s, a, r, law in rows.pairs]
    return model_of(rows.n_states, pairs, rows.discount), [by * v for v in value]


def costs(rows: Rows, value: Values) -> tuple[MDP, Values]:
    pairs = [(s, a, -r, law) for s, a, r, law in rows.pairs]
    mdp = model_of(rows.n_states, pairs, rows.discount)
    return mdp.with_(sense="min"), [-v for v in value]


def shaped(rows: Rows, value: Values) -> tuple[MDP, Values]:
    """r + γ φ(t) - φ(s): each value is less by φ, which is 0 where all is over."""
    over = rows.model().terminal
    more = [F(0) if over[s] else F(3 * s % 7 - 2, 3) for s in range(rows.n_states)]
    outcomes = [
        (s, a, [(p, t, r + rows.discount * more[t] - more[s]) for t, p in law.items()])
        for s, a, r, law in rows.pairs
    ]
    mdp = MDP.from_outcomes(outcomes, rows.discount)
    return mdp, [v - m for v, m in zip(value, more, strict=True)]


def leaking(rows: Rows, value: Values) -> tuple[MDP, Values]:
    """The discount as the chance of an end."""
    end, rate = rows.n_states, rows.discount
    pairs: list[Row] = []
    for s, a, r, law in rows.pairs:
        onward = {t: rate * p for t, p in law.items()} | {end: 1 - rate}
        pairs.append((s, a, r, {t: p for t, p in onward.items() if p}))
    return model_of(end + 1, [*pairs, (end, 0, F(0), {end: F(1)})], F(1)), [*value, F(0)]


def copied(rows: Rows, value: Values) -> tuple[MDP, Values]:
    """Two of each state, of which either may come next, and two of each action."""
    n, over = rows.n_states, rows.model().terminal
    pairs: list[Row] = []
    for copy, (s, a, r, law), twin in product((0, 1), rows.pairs, (0, 1)):
        both = {t + n * k: p / 2 for t, p in law.items() for k in (0, 1)}
        pairs.append((s + n * copy, 2 * a + twin, r, {s + n * copy: F(1)} if over[s] else both))
    return model_of(2 * n, pairs, rows.discount), [*value, *value]


def spread(rows: Rows, value: Values) -> tuple[MDP, Values]:
    """A start that is drawn among all states, the last one most often."""
    n = rows.n_states
    weights = {s: F(2 * s + 1, n * n) for s in range(n)}
    return rows.model().with_(start=weights), value


VIEWS: list[View] = [as_drawn, renumbered, scaled, costs, shaped, leaking, copied, spread]
views = st.sampled_from(VIEWS)


# ---- methods -------------------------------------------------------------------------------------

MOST = 600  # bounds hold wherever sweeps are stopped
METHODS: dict[str, Callable[[MDP], Any]] = {
    "default": solve,
    **{name: lambda mdp, name=name: solve(mdp, name) for name in SOLVERS},
    **{
        f"{name}, stopped": lambda mdp, name=name: solve(mdp, SOLVERS[name](max_iterations=MOST))
        for name in SWEEPING
    },
    "highs": lambda mdp: LinearProgram(solver="HIGHS").solve(mdp),
    "certify": certify,
    "bounded": lambda mdp: certify(mdp, bounded=True),
    "robust": lambda mdp: solve_robust(mdp, Intervals.relative(mdp, 0)),
    "evaluate": lambda mdp: evaluate(mdp, "optimal"),
}
BACKWARD = "backward-induction"
DIRECT = (BACKWARD, "policy-iteration", "linear-program", "highs", "certify", "bounded")
# The methods of a group answer for the same drawn models, whose oracle is asked once.
GROUPS = {
    "sweeping": [name for name in METHODS if name.startswith(tuple(SWEEPING))],
    "others": [name for name in METHODS if not name.startswith(tuple(SWEEPING))],
}


def asked(method: str, mdp: MDP) -> Any:
    """The answer; that of a run that was stopped; None where the method is not for the model."""
    try:
        return quietly(METHODS[method], mdp)
    except SolverError as error:
        if method.endswith(", stopped") and error.status is Status.ITERATION_LIMIT:
            return error.solution
        raise
    except ModelError as error:
        if method == BACKWARD and "without cycles" in str(error):
            return None
        raise


def taken(mdp: MDP, answer: Any) -> list[int]:
    return [mdp.pair(s, int(a)) for s, a in enumerate(np.asarray(answer.policy).tolist())]


def at_start(mdp: MDP, value: Values) -> F:
    return sum((weight * value[s] for s, weight in mdp.start), F(0))


def proven(proof: Certificate, mdp: MDP) -> None:
    """Everything that a certificate claims, computed anew from the model's own rational table."""
    assert proof.violations() == []
    value, sign = list(proof.value), -1 if mdp.sense == "max" else 1
    gaps = [sign * gain for gain in exact_gains(mdp, value)]
    best = [[a for a in mdp.pairs_of(s) if not gaps[a]] for s in range(mdp.n_states)]
    for s, over in enumerate(mdp.terminal.tolist()):
        losses = [0 if over else gaps[a] for a in mdp.pairs_of(s)]
        assert min(losses) == 0
        assert proof.optimal_pairs[list(mdp.pairs_of(s))].tolist() == [x == 0 for x in losses]
        assert proof.gaps[s] == min((x for x in losses if x), default=None)
        assert over or mdp.pair(s, int(proof.policy[s])) == best[s][0]
    todo = [s for s, weight in mdp.start if weight]
    reached = set(todo)
    while todo:
        new = {t for a in best[todo.pop()] for _, t, _ in mdp.table.row(a)} - reached
        reached |= new
        todo += new
    assert proof.unique == all(len(best[s]) == 1 for s in reached if not mdp.terminal[s])
    assert proof.value_float.tolist() == [float(x) for x in value]


@pytest.mark.parametrize("group", GROUPS)
@given(rows=models(), view=views)
def test_the_optimum_lies_within_the_bounds(group: str, rows: Rows, view: View) -> None:
    mdp, exact = view(rows, solve_exact(rows.n_states, rows.pairs, rows.discount)[0])
    for method in GROUPS[group]:
        note(method)
        lies_within_the_bounds(method, mdp, exact)


def lies_within_the_bounds(method: str, mdp: MDP, exact: Values) -> None:
    answer = asked(method, mdp)
    if answer is None:
        return
    holds(answer, exact)
    best = at_start(mdp, exact)
    if method == "certify":
        assert answer.start_value == best
        proven(answer, mdp)
    else:
        assert within(answer.start, best)
    if method != "evaluate":
        over = set(np.flatnonzero(mdp.terminal).tolist())
        own = policy_values(rows_of(mdp, taken(mdp, answer)), mdp.discount_exact, over)
        holds(answer, own)
        if hasattr(answer, "regret_bound"):
            lost = max(abs(v - x) for v, x in zip(exact, own, strict=True))
            assert lost <= F(answer.regret_bound)
    if method == "bounded":
        assert answer.violations() == []
        ends = (own, exact) if mdp.sense == "max" else (exact, own)
        between = zip(answer.lower, *ends, answer.upper, strict=True)
        assert all(F(low) <= least <= most <= F(high) for low, least, most, high in between)
    if method in DIRECT:
        size = max(map(abs, exact)) + max((abs(r) for _, _, r, _ in rows_of(mdp)), default=F(0))
        assert (
            max(errors_of(answer)) <= F(1, 10**9) * size + F(2) ** -900
        )  # underflow may cost that


NUMBERS = st.sampled_from([0.0, 1e9, -1e9, 1e-9, 1 / 3, 1e15, 2.0**-1060, -7.5])


@given(rows=models(), view=views, steps=st.integers(1, 3), data=st.data())
def test_bounds_hold_around_any_values(rows: Rows, view: View, steps: int, data: Any) -> None:
    """However wrong they are, and whatever sweep is the last."""
    mdp, exact = view(rows, solve_exact(rows.n_states, rows.pairs, rows.discount)[0])
    start = np.array(data.draw(st.lists(NUMBERS, min_size=mdp.n_states, max_size=mdp.n_states)))
    for kind in SOLVERS.values():
        if hasattr(kind, "tol"):
            note(kind.name)
            solution = solution_of(kind(max_iterations=steps, start=start).solve, mdp)
            if solution is not None:
                holds(solution, exact)


def solution_of(method: Callable[..., Solution], *words: Any) -> Solution | None:
    """Return what was reached, also where it is refused for not being near enough."""
    try:
        return quietly(method, *words)
    except SolverError as error:
        return error.solution


# ---- horizons ------------------------------------------------------------------------------------


EACH_SOLVER = ["default", "certify", *SOLVERS]


@settings(max_examples=40)
@given(
    rows=models(),
    view=st.sampled_from([as_drawn, costs, shaped]),
    steps=st.integers(1, 4),
    data=st.data(),
)
def test_a_horizon_is_a_recursion(rows: Rows, view: View, steps: int, data: Any) -> None:
    """With what states are worth at its end, from every state at every time."""
    mdp, _ = view(rows, [F(0)] * rows.n_states)
    last = data.draw(st.lists(st.sampled_from([F(0), F(-3), F(22, 7)]), min_size=mdp.n_states,
                              max_size=mdp.n_states))  # fmt: skip
    best = max if mdp.sense == "max" else min
    values = [last]
    for _ in range(steps):
        after = values[0]
        values.insert(0, [best(r + mdp.discount_exact * mean(law, after) for *_, r, law in each)
                          for each in rows_by_state(mdp)])  # fmt: skip
    unrolled = mdp.within(steps, terminal_value=last if any(last) else None)
    last_time = mdp.n_states * steps
    for method in EACH_SOLVER:
        note(method)
        answer = asked(method, unrolled)
        near(answer.value[:last_time], errors_of(answer)[:last_time], chain(*values[:-1]))


# ---- totals and averages without end -------------------------------------------------------------

ENDLESS: list[View] = [as_drawn, renumbered, scaled, costs, copied]


@settings(max_examples=40)
@given(model=any_models(), view=st.sampled_from(ENDLESS))
def test_totals_are_the_best_of_all_policies(model: Pairs, view: View) -> None:
    mdp, exact = view(Rows(n_states=model[0], pairs=model[1], discount=F(1)), best_total(model[1]))
    for method in EACH_SOLVER:
        note(method)
        is_the_best_total(method, mdp, exact)


def is_the_best_total(method: str, mdp: MDP, exact: Values) -> None:
    answer = asked(method, mdp)
    if answer is None:
        return
    holds(answer, exact)
    holds(answer, total(rows_of(mdp, taken(mdp, answer))))
    if getattr(answer, "status", None) is not Status.ITERATION_LIMIT:
        assert max(errors_of(answer)) < F(1, 10**6)
    if method == "certify":
        assert answer.violations() == []
        assert answer.start_value == exact[mdp.start[0][0]]


@settings(max_examples=5)
@given(model=any_models())
def test_totals_of_large_models_are_those_of_their_parts(model: Pairs) -> None:
    small = model_of(*model, F(1))
    mdp, exact = in_copies(small, 1 + 22_000 // small.n_transitions)
    for method in ("default", "certify"):
        note(method)
        holds(asked(method, mdp), exact)


AVERAGE: dict[str, Callable[[MDP], Any]] = {
    "default": lambda mdp: solve(mdp, criterion="average"),
    "linear-program": lambda mdp: solve(mdp, "linear-program", criterion="average"),
    "value-iteration": lambda mdp: solve(mdp, "value-iteration", tol=1e-6, criterion="average"),
    "certify": lambda mdp: certify(mdp, criterion="average"),
    "evaluate": lambda mdp: evaluate(mdp, "optimal", criterion="average"),
}


@settings(max_examples=40)
@given(rows=models(discounts=[F(1, 2)]), view=st.sampled_from(ENDLESS[:-1]))
def test_averages_are_the_best_of_all_policies(rows: Rows, view: View) -> None:
    counts = np.bincount([s for s, *_ in rows.pairs])
    assume(prod(counts.tolist()) <= 40 and rows.n_states <= 5)
    large = max(abs(r) for _, _, r, _ in rows.pairs) >= 10
    gain, bias = (list(numbers) for numbers in best_average(rows.pairs))
    mdp, exact = view(rows, gain)
    for method in AVERAGE:
        if not (large and method in ("linear-program", "value-iteration")):
            note(method)
            is_the_best_average(method, mdp, exact, view(rows, bias)[1])


def is_the_best_average(method: str, mdp: MDP, exact: Values, bias: Values) -> None:
    try:
        answer = AVERAGE[method](mdp)
    except ModelError:
        assert method == "value-iteration"  # several end components
        return
    holds(answer, exact)
    size = 1 + max(abs(r) for _, _, r, _ in rows_of(mdp))
    assert max(errors_of(answer)) <= F(1, 10 ** (6 if method == "value-iteration" else 9)) * size
    if method == "evaluate":
        return
    own, ahead = gain_and_bias(rows_of(mdp, taken(mdp, answer)))
    holds(answer, own)
    if method == "certify":
        assert answer.violations() == []
        assert answer.bias.tolist() == bias == list(ahead)
    else:
        near(answer.bias, answer.bias_error, ahead)


# ---- tables and tied actions ---------------------------------------------------------------------

HALF = models(discounts=[F(1, 2), F(9, 10)])


@given(HALF, st.booleans())
def test_tables_by_state_and_action(drawn: Rows, costs: bool) -> None:
    mdp = drawn.model().with_(sense="min" if costs else "max")
    solution, sign, never = solve(mdp), -1 if costs else 1, inf if costs else -inf
    certificate, chances = certify(mdp), evaluate(mdp, "random")

    def table(pairs: Any, elsewhere: object) -> Any:
        whole = np.full((mdp.n_states, mdp.n_actions), elsewhere)
        whole[mdp.pair_state, mdp.pair_action] = pairs
        return whole

    laws = np.zeros((mdp.n_actions, mdp.n_states, mdp.n_states))
    laws[mdp.pair_action, mdp.pair_state] = mdp.transition.toarray()
    assert [mdp.P(a).toarray().tolist() for a in range(mdp.n_actions)] == laws.tolist()
    assert mdp.R.tolist() == table(mdp.reward, never).tolist()
    assert certificate.optimal.tolist() == table(certificate.optimal_pairs, False).tolist()
    np.testing.assert_array_equal(chances.occupancy_table, table(chances.occupancy, np.nan))
    q = mdp.reward + mdp.discount * (mdp.transition @ solution.value)
    assert solution.q == pytest.approx(table(q, never), rel=1e-9, abs=1e-9)
    gaps = table(sign * (solution.value[mdp.pair_state] - q), np.nan)
    assert solution.gap_table == pytest.approx(gaps, rel=1e-6, abs=1e-6, nan_ok=True)
    best = sign * (sign * solution.q).max(axis=1)
    assert best == pytest.approx(solution.value, rel=1e-6, abs=1e-6)


@given(HALF)
def test_the_policy_of_all_optimal_actions(drawn: Rows) -> None:
    """It is worth the optimum, exactly, and takes tied actions equally often."""
    mdp = drawn.model()
    certificate = certify(mdp)
    policy = certificate.optimal_policy()
    weights = policy.weights_exact(mdp)
    weights = policy.weights(mdp).astype(np.int64) if weights is None else weights
    live = ~mdp.terminal[mdp.pair_state]
    assert ((weights > 0) == certificate.optimal_pairs)[live].all()
    for state in np.flatnonzero(~mdp.terminal):
        assert len({int(weights[pair]) for pair in mdp.pairs_of(state)} - {0}) == 1
    evaluation = evaluate(mdp, policy)
    assert abs(evaluation.mean - float(certificate.start_value)) <= evaluation.start.error + 1e-9


def test_ties_are_not_shared_where_a_policy_may_never_end() -> None:
    """Staying costs 1: leaving alone is optimal. (Where both are, who only stays never leaves.)"""
    rows = [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    optimum = certify(MDP.from_outcomes(rows))
    assert optimum.optimal_policy().weights(optimum.mdp).tolist() == [0, 1, 1]


# ---- numbers of floats ---------------------------------------------------------------------------

KINDS: list[Any] = [kind for kind in SOLVERS.values() if hasattr(kind, "max_iterations")]


def attacked(seed: int) -> MDP:
    """Rows off by up to 1e-10, discounts up to 1 - 1e-12, rewards over 300 orders of magnitude."""
    rng = np.random.default_rng(seed)
    states, actions = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    chances = rng.dirichlet(np.full(states, 0.5), (actions, states))
    if seed % 3 == 0:  # in parts between which nothing leads
        chances = np.eye(states)[rng.integers(states, size=(2, actions, states))].mean(axis=0)
    chances *= 1 + rng.choice([0.0, -1e-10, 1e-10], size=(actions, states, 1))
    reward = rng.normal(size=(states, actions))
    if seed % 2:
        reward *= 10.0 ** rng.integers(-150, 150, reward.shape)
    if seed % 5 == 0:
        chances[:, -1], reward[-1] = np.eye(states)[-1], 0.0
    rate = rng.choice([0.5, 0.99, 1 - 1e-6, 1 - 1e-9, 1 - 1e-12])
    return MDP.from_arrays(chances, reward, rate, layout="ass")


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), tol=st.sampled_from([None, 1e-3]), large=st.integers(0, 5))
def test_no_number_breaks_a_bound(seed: int, tol: Any, large: int) -> None:
    mdp, exact = in_copies(attacked(seed), 1 if large else 1500)
    for kind in KINDS:
        note(kind.name)
        chosen = {"tol": tol} if hasattr(kind, "tol") else {}
        solution = solution_of(solve, mdp, kind(max_iterations=3000, **chosen))
        if solution is not None:  # an honest refusal has an honest bound
            holds(solution, exact)


@given(seed=st.integers(0, 10**6), power=st.integers(-30, 30))
def test_signs_and_scales_change_no_digit(seed: int, power: int) -> None:
    rng = np.random.default_rng(seed)
    chances, reward = rng.dirichlet(np.ones(5), (3, 5)), rng.normal(size=(5, 3))
    solution = solve(MDP.from_arrays(chances, reward, 0.9, layout="ass"), tol=1e-9)
    least = solve(MDP.from_arrays(chances, -reward, 0.9, layout="ass", sense="min"), tol=1e-9)
    assert (least.value == -solution.value).all()
    more = MDP.from_arrays(chances, reward * 2.0**power, 0.9, layout="ass")
    assert (solve(more, tol=1e-9 * 2.0**power).value == solution.value * 2.0**power).all()
