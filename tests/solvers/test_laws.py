"""Laws of every solver: its answers lie within its own bounds, in every form of every model.

A view is another form of a drawn model, whose values follow from its own. A door is a way to ask
for the optimum. What is right says the oracle: no policy has more, in rational arithmetic.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from fractions import Fraction as F
from itertools import chain, product
from math import inf, prod
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from made_models import in_copies
from model_contents import is_acyclic
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
from strategies import Pairs, Row, Rows, any_models, model_of, models

from exact_mdp import (
    MDP,
    SOLVERS,
    GaussSeidel,
    Intervals,
    LinearProgram,
    ModelError,
    ModifiedPolicyIteration,
    PolicyIteration,
    SolverError,
    Status,
    ValueIteration,
    certify,
    check,
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


VIEWS: list[View] = [as_drawn, renumbered, scaled, costs, shaped, leaking, copied]
views = st.sampled_from(VIEWS)


# ---- doors ---------------------------------------------------------------------------------------

MOST = 600  # bounds hold wherever sweeps are stopped
DOORS: dict[str, Callable[[MDP], Any]] = {
    "default": solve,
    **{name: lambda mdp, name=name: solve(mdp, name) for name in SOLVERS},
    "value-iteration": lambda mdp: solve(mdp, ValueIteration(max_iterations=MOST)),
    "gauss-seidel": lambda mdp: solve(mdp, GaussSeidel(max_iterations=MOST)),
    "clarabel": lambda mdp: solve(mdp, LinearProgram(solver="CLARABEL")),
    "highs": lambda mdp: solve(mdp, LinearProgram(solver="HIGHS")),
    "certify": certify,
    "bounded": lambda mdp: certify(mdp, bounded=True),
    "robust": lambda mdp: solve_robust(mdp, Intervals.relative(mdp, 0)),
    "evaluate": lambda mdp: evaluate(mdp, "optimal"),
}
DIRECT = ("backward-induction", "policy-iteration", "clarabel", "highs", "certify")


def asked(door: str, mdp: MDP) -> Any:
    """The answer; that of a run that was stopped; None where the door is not for the model."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return DOORS[door](mdp)
    except SolverError as error:
        if door in ("value-iteration", "gauss-seidel") and error.status is Status.ITERATION_LIMIT:
            return error.solution
        raise
    except ModelError:
        if door == "backward-induction" and not is_acyclic(mdp):
            return None
        raise


def errors_of(answer: Any) -> Iterable[F]:
    if answer.claim == "certified":
        return [F(0)] * len(answer.value)
    error = answer.error if hasattr(answer, "error") else answer.error_bound
    return map(F, np.broadcast_to(error, len(answer.value)).tolist())


def taken(mdp: MDP, answer: Any) -> list[int]:
    return [mdp.pair(s, int(a)) for s, a in enumerate(answer.policy)]


def holds(answer: Any, exact: Iterable[Any]) -> None:
    """Infinite values are said, and the others are no further away than their errors."""
    for right, value, error in zip(exact, answer.value, errors_of(answer), strict=True):
        assert value == right or abs(F(value) - right) <= error


@pytest.mark.parametrize("door", DOORS)
@given(rows=models(), view=views)
def test_the_optimum_lies_within_the_bounds(door: str, rows: Rows, view: View) -> None:
    mdp, exact = view(rows, solve_exact(rows.n_states, rows.pairs, rows.discount)[0])
    answer = asked(door, mdp)
    if answer is None:
        return
    holds(answer, exact)
    best = sum((weight * exact[s] for s, weight in mdp.start), F(0))
    if door == "certify":
        assert answer.violations() == []
        assert answer.start_value == best
    elif door != "bounded":
        assert abs(F(answer.start_value) - best) <= F(answer.start.error)
    else:
        assert answer.violations() == []
    if door != "evaluate":
        over = set(np.flatnonzero(mdp.terminal).tolist())
        own = policy_values(rows_of(mdp, taken(mdp, answer)), mdp.discount_exact, over)
        holds(answer, own)
        if hasattr(answer, "regret_bound"):
            lost = max(abs(v - x) for v, x in zip(exact, own, strict=True))
            assert lost <= F(answer.regret_bound)
    if door in DIRECT:
        size = max(map(abs, exact)) + max((abs(r) for _, _, r, _ in rows_of(mdp)), default=F(0))
        assert (
            max(errors_of(answer)) <= F(1, 10**9) * size + F(2) ** -900
        )  # underflow may cost that


NUMBERS = st.sampled_from([0.0, 1e9, -1e9, 1e-9, 1 / 3, 1e15, 2.0**-1060, -7.5])


@pytest.mark.parametrize("kind", [ValueIteration, GaussSeidel, ModifiedPolicyIteration])
@given(rows=models(), view=views, data=st.data())
def test_bounds_hold_around_any_values(kind: Any, rows: Rows, view: View, data: Any) -> None:
    """However wrong they are, and whatever sweep is the last."""
    mdp, exact = view(rows, solve_exact(rows.n_states, rows.pairs, rows.discount)[0])
    start = data.draw(st.lists(NUMBERS, min_size=mdp.n_states, max_size=mdp.n_states))
    solver = kind(max_iterations=data.draw(st.integers(1, 3)), start=np.array(start))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solution = solver.solve(mdp)
    except SolverError as error:
        solution = error.solution
    if solution is not None:
        holds(solution, exact)


STARTS: dict[str, Callable[[MDP], Any]] = {
    "under limits": lambda mdp: solve(mdp, subject_to={"steps": ">= 0"}).start_value,
    "the gate": lambda mdp: check(mdp, "optimal").regret.optimal.value,
}


@pytest.mark.parametrize("door", STARTS)
@settings(max_examples=40)
@given(rows=models(), view=views)
def test_the_start_has_one_value_at_every_exact_door(door: str, rows: Rows, view: View) -> None:
    mdp, exact = view(rows, solve_exact(rows.n_states, rows.pairs, rows.discount)[0])
    assert STARTS[door](mdp) == exact[mdp.start[0][0]]


# ---- horizons ------------------------------------------------------------------------------------


@pytest.mark.parametrize("door", ["default", "certify", "policy-iteration", "clarabel"])
@settings(max_examples=40)
@given(
    rows=models(),
    view=st.sampled_from([as_drawn, costs, shaped]),
    steps=st.integers(1, 4),
    data=st.data(),
)
def test_a_horizon_is_a_recursion(door: str, rows: Rows, view: View, steps: int, data: Any) -> None:
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
    answer, n = asked(door, unrolled), mdp.n_states
    times = zip(answer.value[: n * steps], errors_of(answer), strict=False)
    for (value, error), right in zip(times, chain(*values[:-1]), strict=True):
        assert abs(F(value) - right) <= error


# ---- totals and averages without end -------------------------------------------------------------

ENDLESS: list[View] = [as_drawn, renumbered, scaled, costs, copied]


@pytest.mark.parametrize("door", ["default", "certify"])
@given(model=any_models(), view=st.sampled_from(ENDLESS))
def test_totals_are_the_best_of_all_policies(door: str, model: Pairs, view: View) -> None:
    mdp, exact = view(Rows(n_states=model[0], pairs=model[1], discount=F(1)), best_total(model[1]))
    answer = asked(door, mdp)
    holds(answer, exact)
    holds(answer, total(rows_of(mdp, taken(mdp, answer))))
    assert max(errors_of(answer)) < F(1, 10**6)
    if door == "certify":
        assert answer.violations() == []
        assert answer.start_value == exact[mdp.start[0][0]]


@pytest.mark.parametrize("door", ["default", "certify"])
@settings(max_examples=5)
@given(model=any_models())
def test_totals_of_large_models_are_those_of_their_parts(door: str, model: Pairs) -> None:
    small = model_of(*model, F(1))
    mdp, exact = in_copies(small, 1 + 22_000 // small.n_transitions)
    holds(asked(door, mdp), exact)


AVERAGE: dict[str, Callable[[MDP], Any]] = {
    "default": lambda mdp: solve(mdp, criterion="average"),
    "linear-program": lambda mdp: solve(mdp, "linear-program", criterion="average"),
    "value-iteration": lambda mdp: solve(mdp, "value-iteration", tol=1e-6, criterion="average"),
    "certify": lambda mdp: certify(mdp, criterion="average"),
    "evaluate": lambda mdp: evaluate(mdp, "optimal", criterion="average"),
}


@pytest.mark.parametrize("door", AVERAGE)
@settings(max_examples=40)
@given(rows=models(discounts=[F(1, 2)]), view=st.sampled_from(ENDLESS[:-1]))
def test_averages_are_the_best_of_all_policies(door: str, rows: Rows, view: View) -> None:
    counts = np.bincount([s for s, *_ in rows.pairs])
    assume(prod(counts.tolist()) <= 40 and rows.n_states <= 5)
    if door in ("linear-program", "value-iteration"):
        assume(max(abs(r) for _, _, r, _ in rows.pairs) < 10)
    gain, bias = best_average(rows.pairs)
    mdp, exact = view(rows, list(gain))
    try:
        answer = AVERAGE[door](mdp)
    except ModelError:
        assert door == "value-iteration"  # several end components
        return
    holds(answer, exact)
    size = 1 + max(abs(r) for _, _, r, _ in rows_of(mdp))
    assert max(errors_of(answer)) <= F(1, 10 ** (6 if door == "value-iteration" else 9)) * size
    if door == "evaluate":
        return
    own, ahead = gain_and_bias(rows_of(mdp, taken(mdp, answer)))
    holds(answer, own)
    if door == "certify":
        assert answer.violations() == []
        assert answer.bias.tolist() == view(rows, list(bias))[1] == list(ahead)
    else:
        for value, error, right in zip(answer.bias, answer.bias_error, ahead, strict=True):
            assert abs(F(value) - right) <= F(error)


@pytest.mark.parametrize("criterion", ["average", "total"])
@settings(max_examples=30)
@given(model=any_models(4))
def test_discounted_values_approach_gain_and_bias(criterion: str, model: Pairs) -> None:
    """V = g / (1 - γ) + h + terms of order 1 - γ; of a total g decides, unless it is 0."""
    rate, mdp = F(1, 10**20), model_of(*model, F(1))
    far, near = certify(mdp, criterion=criterion), certify(mdp.with_(discount=1 - rate))
    for s, v in enumerate(near.value):
        if criterion == "average":
            assert abs(v * rate - far.value[s] - far.bias[s] * rate) <= rate ** F(3, 2)
        elif abs(far.value[s]) < inf:
            assert abs(v - far.value[s]) < 1e-6
        else:
            assert v > 1e10 if far.value[s] > 0 else v < -1e10


@given(rows=models(discounts=[F(1)]))
@settings(max_examples=30)
def test_where_every_policy_ends_the_bias_is_the_total(rows: Rows) -> None:
    optimum = certify(rows.model(), criterion="average")
    assert optimum.value.tolist() == [0] * rows.n_states
    assert optimum.bias.tolist() == certify(rows.model()).value.tolist()


# ---- numbers of floats ---------------------------------------------------------------------------

KINDS: list[Any] = [ModifiedPolicyIteration, ValueIteration, GaussSeidel, PolicyIteration]


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


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), tol=st.sampled_from([None, 1e-3]), large=st.integers(0, 5))
def test_no_number_breaks_a_bound(kind: Any, seed: int, tol: Any, large: int) -> None:
    mdp, exact = in_copies(attacked(seed), 1 if large else 1500)
    chosen = {} if kind is PolicyIteration else {"tol": tol}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solution = solve(mdp, kind(max_iterations=3000, **chosen))
    except SolverError as error:  # an honest refusal has an honest bound
        solution = error.solution
    if solution is not None:
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
