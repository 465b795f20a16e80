"""What solvers refuse: each call, with words of what is said; all say where, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from made_models import garnet
from policy_cases import coin, geometric

from exact_mdp import (
    MDP,
    SOLVERS,
    Constant,
    Exponential,
    GaussSeidel,
    Intervals,
    ModelError,
    PolicyIteration,
    QLearning,
    Scenario,
    best_cvar,
    certify,
    evaluate,
    outcomes,
    return_distribution,
    simulate,
    solve,
    solve_robust,
    tradeoff,
    train,
)

nan, inf = float("nan"), float("inf")
CARE = Scenario.load("yuan2025").compile()
LINE = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])  # without cycles
LOOP = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
MODEL = garnet(9, seed=1, discount="0.99")
SWING = MDP.from_outcomes([(0, 0, [(1, 1, -1)]), (1, 0, [(1, 0, 1)])])
APART = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])], start=["1/2", "1/2"])
STAYS = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])])
BESIDE = MDP.from_outcomes(
    [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])],
    labels={"goal": [False, True, False]},
).until("goal")
FINE = MDP.from_outcomes(
    [
        (2, 0, [("1/2", 1, 0), ("1/2", 0, 2 + F(1, 10**30))]),
        (2, 1, [("1/2", 0, 1), ("1/2", 0, 2)]),
        *[(1, 0, [(1, 0, 1)]), (0, 0, [(1, 0, 0)])],
    ],
    start=2,
)
HIDDEN = MDP.from_outcomes(
    [
        (0, 0, [(1, 1, 0)]),
        (0, 1, [(1, 1, 0)]),
        (1, 1, [(1, 2, 0)]),
        (1, 2, [(1, 2, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
)
SETTINGS: dict[str, Any] = {
    "tol": [0, -1.0, nan, inf],
    "max_iterations": [0, -3, 1.5, True],
    "solver": ["HIGH"],
}
Refused = tuple[str, Callable[[], object]]


def each(words: str, call: Callable[..., object], *values: Any) -> list[Refused]:
    """The same call with one value after another."""
    return [(words, lambda value=value: call(value)) for value in values]


def given(words: str, call: Callable[..., object], **arguments: Any) -> Refused:
    return words, lambda: call(**arguments)


def solving(mdp: MDP) -> Callable[..., object]:
    return lambda solver="auto", **more: solve(mdp, solver, **more)


REFUSED: list[Refused] = [
    # ---- which solver, and how
    *each("did you mean policy-iteration", solving(MODEL), "policy-iterations"),
    *each("tol is", lambda tol: solve(MODEL, tol=tol), "x", True, 0, -1.0, inf, nan),
    *each("tol is", lambda tol: solve(LINE, tol=tol), "x", 0),
    *[
        refused
        for kind in SOLVERS.values()
        for name, values in SETTINGS.items()
        if name in getattr(kind, "__dataclass_fields__", {})
        for refused in each(name, lambda v, kind=kind, name=name: kind(**{name: v}), *values)
    ],
    # ---- what the search begins with
    given("takes no start", solving(LINE), solver="backward-induction", start=[0, 0]),
    given("takes no start", solving(MODEL), solver="linear-program", start=np.zeros(9)),
    given("values of shape", solving(MODEL), solver="value-iteration", start=np.zeros(3)),
    *each(
        "not finite",
        lambda start: solve(MODEL, "policy-iteration", start=start),
        *(np.full(9, inf), [nan] * 9, [inf] * 9),
    ),
    *each(
        "there is no action 9",
        lambda start: solve(MODEL, "policy-iteration", start=start),
        *(np.full(9, 9), [9] * 9),
    ),
    given("does not hold real numbers", solving(MODEL), start=[[1, 2], [3]]),
    given("mixed", solving(MODEL), start="random"),
    # ---- horizons
    given("terminal_value", solving(MODEL), horizon=3, start=[1.0] * 9),
    given("give a horizon", solving(MODEL), terminal_value=[1] * 9),
    given("for each state", solving(MODEL), horizon=3, terminal_value=5),
    given("2 entries for 9 states", solving(MODEL), horizon=3, terminal_value=[1, 2]),
    given("finite", solving(MODEL), horizon=3, terminal_value=[nan] * 9),
    given("nowhere", solving(MODEL), horizon=3, terminal_value={"nowhere": 1}),
    *each("1 or more", MODEL.within, True, 0, -3, 2.0, "5", None, F(3), nan),
    given("states and .* fewer steps", solving(MODEL), horizon=10**18),
    *each("time_limit is", lambda limit: MODEL.with_(time_limit=limit), 0, True, 2.5),
    # ---- averages
    *each("unknown criterion 'averge'.*average", lambda c: certify(MODEL, criterion=c), "averge"),
    given("not an average", certify, model=MODEL, criterion="average", bounded=True),
    *each(
        "does not apply to an average",
        lambda solver: solve(MODEL, solver, criterion="average"),
        *(GaussSeidel(), "backward-induction"),
    ),
    given(
        "has no use for start=", solving(MODEL), solver=PolicyIteration(start=[0] * 9),
        criterion="average",
    ),
    given("no horizon", solving(MODEL), horizon=3, criterion="average"),
    given("no horizon", evaluate, model=MODEL, policy="random", horizon=3, criterion="average"),
    # ---- proofs
    given("apply only to bounds", certify, model=MODEL, tol=1e-3),
    given("another model", certify, model=MODEL, bounded=True, solution=solve(LOOP)),
    given("one does not.*leave out bounded=True", certify, model=STAYS, bounded=True),
    given("at the goal.*beside the goal in .state 2", certify, model=BESIDE, bounded=True),
    *each("from one state of the start and -∞ from another", lambda f: f(APART), certify, solve),
    *each("drawn among", lambda mdp: certify(mdp).optimal_policy(), STAYS),
    # ---- policies
    *[
        (words, lambda weights=weights: evaluate(LOOP.with_(discount="1/2"), np.array(weights)))
        for words, weights in (("shape", [1.0]), ("sum to 2", [2.0, 1]), ("negative", [-1.0, 1]))
    ],
    ("nan", lambda: evaluate(LOOP, np.array([nan, 1.0]))),
    ("another model", lambda: evaluate(LOOP, evaluate(LINE, "random").chain)),
    *each("n is", lambda n: simulate(LOOP, "random", n, 0), 0, 1.5, True),
    *each("is not a source", lambda rng: simulate(LOOP, "random", 5, rng), None, -1, "0"),
    *each("max_steps is 0", lambda most: simulate(LOOP, "random", 5, 0, max_steps=most), 0),
    ("after 1 steps.*max_steps", lambda: simulate(LOOP, "random", 100, 0, max_steps=1)),
    ("cancel for ever", lambda: simulate(SWING, [0, 0], 10, rng=0)),
    ("cancel for ever", lambda: return_distribution(SWING, "random")),
    ("lattice.*evaluate", lambda: return_distribution(LINE.with_(discount="9/10"), "random")),
    ("lead back", lambda: return_distribution(geometric("1/2"), "random", exact=True)),
    ("1.5", lambda: return_distribution(coin(0, 1), "random").quantile(1.5)),
    ("after 100 sweeps.*max_sweeps",
     lambda: return_distribution(geometric("999/1000"), "random", max_sweeps=100)),
    *each("is (True|0|1.5)", lambda n: return_distribution(LINE, "random", max_sweeps=n), True, 0),
    *each("is (True|0|1.5)",
          lambda n: solve_robust(LOOP, Intervals.relative(LOOP, 0), max_iterations=n), True, 1.5),
    # ---- limits and risk
    *[
        (words, lambda limits=limits: solve(CARE, subject_to=limits))
        for words, limits in (
            ("'3' is no limit", {"skip": "3"}),
            ("is no limit", {"skip": "> 3"}),
            ("not a finite rational", {"skip": ">= x"}),
            ("states no limit", {}),
            ("states no limit", "skip >= 3"),
            ("nothing to count is called 'angst'", {"angst": ">= 3"}),
            ("limit", {"anger": []}),
            ("limit", {"anger": ""}),
            ("limit", ["anger <= 1"]),
        )
    ],
    *each("give texts", lambda texts: tradeoff(CARE, texts), [1, "anger"]),
    *each("an empty name", lambda texts: tradeoff(CARE, texts), ["=anger", "skip"]),
    *each("no part of a sum", lambda texts: tradeoff(CARE, texts), ["anger*2", "skip"]),
    *each("did you mean anger", lambda texts: tradeoff(CARE, texts), ["angers", "skip"]),
    ("have one solver", lambda: solve(MODEL, "value-iteration", subject_to={"steps": "<= 1"})),
    ("rounder rewards", lambda: best_cvar(FINE, "1/2")),
    ("give a horizon", lambda: best_cvar(LOOP, "1/2")),
    ("choose discount 1", lambda: best_cvar(MODEL, "1/2", horizon=3)),
    # ---- sets of laws
    *[(words, lambda choice=choice: solve_robust(LOOP, Intervals.relative(LOOP, 0), **choice))
      for words, choice in (
          ("unknown nature 'bad'", {"nature": "bad"}),
          ("tol is 0", {"tol": 0}),
          ("tol is nan", {"tol": nan}),
      )],
    *[
        (words, lambda low=low, high=high: solve_robust(LOOP, Intervals(lower=low, upper=high)))
        for words, low, high in (
            ("bounds of shapes", [0.5], [1.0]),
            ("lower bounds sum to 1.2", [0.6, 0.6, 1], [1.0, 1, 1]),
            ("upper bounds to 0.6", [0, 0, 1], [0.3, 0.3, 1]),
            ("lower bounds sum to nan", [nan, 0, 1], [1, 1, 1]),
            ("no law lies within", [0.9, 0, 1], [0.8, 1, 1]),
        )
    ],
    ("a relative radius of -1", lambda: Intervals.relative(LOOP, -1)),
    # ---- learning
    *[
        (name, lambda name=name, value=value: QLearning(**{name: value}))
        for name, value in (
            ("method", "q-leaning"), ("ties", "none"), ("epochs", 0), ("epochs", 2.0),
            ("episodes", True), ("snapshot_episode", 31), ("last", 0), ("max_steps", 0),
            ("discount", 1.5), ("exploration", Constant(1.5)), ("exploration", Constant(nan)),
            ("rate", Constant(-0.1)), ("initial", inf),
        )
    ],
    *each(
        "no decay", lambda v: Exponential.through(v, at=300, minimum=0.03), 0.03, 0.0, 1.0, 2.0
    ),
    *each(
        "source of random numbers",
        lambda seed: QLearning(epochs=1).train(LOOP, seed),
        *(-1, 1.5, "0", None, True),
    ),
    *each("n is", lambda n: train(LOOP, QLearning(epochs=1), n, rng=0), 0, -1, 1.5, True),
    *each(
        "n_jobs is",
        lambda jobs: train(LOOP, QLearning(epochs=1), 2, rng=0, n_jobs=jobs),
        *(0, -1, True, "2"),
    ),
    ("share a row", lambda: QLearning(columns=()).train(HIDDEN, 0)),
    ("too many",
     lambda: QLearning(columns=("subtask", "trial", "status"))
     .train(Scenario.load("yuan2025").with_(tasks=[1000]).compile(), 0)),
    ("no run of training", lambda: outcomes(CARE, [])),
    ("other states",
     lambda: outcomes(Scenario.load("tea").compile(), train(CARE, QLearning(epochs=1), 1, rng=0))),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_refused(number: int) -> None:
    words, call = REFUSED[number]
    with pytest.raises(ModelError, match=f"(?s){words}") as caught:
        call()
    assert caught.value.where
    assert caught.value.fix
