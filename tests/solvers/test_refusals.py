"""What solvers refuse: each call, with words of what is said; all say where, and what to do."""

from fractions import Fraction as F
from typing import Any

import numpy as np  # noqa: F401
import pytest
from made_models import garnet
from policy_cases import coin, geometric  # noqa: F401

import exact_mdp
from exact_mdp import MDP, SOLVERS, Intervals, ModelError, QLearning, Scenario

nan, inf = float("nan"), float("inf")
CARE = Scenario.load("yuan2025").compile()
LINE = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])  # without cycles
LOOP = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
HALF = LOOP.with_(discount="1/2")
NO = Intervals.relative(LOOP, 0)
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
    [(s, a, [(1, min(s + 1, 2), 0)]) for s, a in ((0, 0), (0, 1), (1, 1), (1, 2), (2, 0))]
)
COSTS = MDP.from_arrays(
    [[[0, 1, 0], [0, 0, 1], [0, 0, 1]]] * 2, [[2, 7], [1, 3], [0, 0]], sense="min"
)
TEA = Scenario.load("tea").compile()
LONG = Scenario.load("yuan2025").with_(tasks=[1000]).compile()
QUICK = QLearning(epochs=1)
SWEEPING = [kind for kind in SOLVERS.values() if hasattr(kind, "tol")]
ITERATING = [kind for kind in SOLVERS.values() if hasattr(kind, "max_iterations")]
REFUSED = """
solve(MODEL, "policy-iterations") -> did you mean policy-iteration
solve(MODEL, tol=X) for "x", True, 0, -1.0, inf, nan -> tol is
solve(LINE, tol=X) for "x", 0 -> tol is
X(tol=0) for *SWEEPING -> tol
X(tol=-1.0) for *SWEEPING -> tol
X(tol=nan) for *SWEEPING -> tol
X(tol=inf) for *SWEEPING -> tol
X(max_iterations=0) for *ITERATING -> max_iterations
X(max_iterations=-3) for *ITERATING -> max_iterations
X(max_iterations=1.5) for *ITERATING -> max_iterations
X(max_iterations=True) for *ITERATING -> max_iterations

solve(LINE, "backward-induction", start=[0, 0]) -> takes no start
solve(MODEL, "linear-program", start=np.zeros(9)) -> takes no start
solve(MODEL, "value-iteration", start=np.zeros(3)) -> values of shape
solve(MODEL, "policy-iteration", start=X) for np.full(9, inf), [nan] * 9, [inf] * 9 -> not finite
solve(MODEL, "policy-iteration", start=X) for np.full(9, 9), [9] * 9 -> there is no action 9
solve(MODEL, start=[[1, 2], [3]]) -> does not hold real numbers
solve(MODEL, start="random") -> mixed

solve(MODEL, horizon=3, start=[1.0] * 9) -> terminal_value
solve(MODEL, terminal_value=[1] * 9) -> give a horizon
solve(MODEL, horizon=3, terminal_value=5) -> for each state
solve(MODEL, horizon=3, terminal_value=[1, 2]) -> 2 entries for 9 states
solve(MODEL, horizon=3, terminal_value=[nan] * 9) -> finite
solve(MODEL, horizon=3, terminal_value={"nowhere": 1}) -> nowhere
solve(MODEL, horizon=10**18) -> states and .* fewer steps
MODEL.within(X) for True, 0, -3, 2.0, "5", None, F(3), nan -> 1 or more
MODEL.with_(time_limit=X) for 0, True, 2.5 -> time_limit is

certify(MODEL, criterion="averge") -> unknown criterion 'averge'.*average
certify(MODEL, criterion="average", bounded=True) -> not an average
solve(MODEL, X, criterion="average") for GaussSeidel(), "backward-induction" -> does not apply
solve(MODEL, PolicyIteration(start=[0] * 9), criterion="average") -> has no use for start=
solve(MODEL, horizon=3, criterion="average") -> no horizon
evaluate(MODEL, "random", horizon=3, criterion="average") -> no horizon

LinearProgram(solver="HIGH") -> solver
certify(MODEL, solution=solve(MODEL)) -> applies only to bounds
certify(MODEL, bounded=True, solution=solve(LOOP)) -> another model
certify(STAYS, bounded=True) -> one does not.*leave out bounded=True
certify(BESIDE, bounded=True) -> at the goal.*beside the goal in .state 2
X(APART) for certify, solve -> from one state of the start and -∞ from another
certify(STAYS).optimal_policy() -> drawn among

evaluate(HALF, np.array([1.0])) -> whole numbers
evaluate(HALF, np.array([2.0, 1])) -> sum to 2
evaluate(HALF, np.array([-1.0, 1])) -> negative
evaluate(LOOP, np.array([nan, 1.0])) -> nan
evaluate(LOOP, evaluate(LINE, "random").chain) -> another model
check(COSTS, [[-inf, 1], [1, 2], [0, 0]], kind="q") -> an action value is -inf.*\\+inf for one never
simulate(LOOP, "random", X, 0) for 0, 1.5, True -> n is
simulate(LOOP, "random", 5, X) for None, -1, "0" -> is not a source
simulate(LOOP, "random", 5, 0, max_steps=0) -> max_steps is 0
simulate(LOOP, "random", 100, 0, max_steps=1) -> after 1 steps.*max_steps
simulate(SWING, [0, 0], 10, rng=0) -> cancel for ever
return_distribution(SWING, "random") -> cancel for ever
return_distribution(LINE.with_(discount="9/10"), "random") -> lattice.*evaluate
return_distribution(geometric("1/2"), "random", exact=True) -> lead back
return_distribution(coin(0, 1), "random").quantile(1.5) -> 1.5

solve(CARE, subject_to={"skip": "3"}) -> '3' is no limit
solve(CARE, subject_to={"skip": "> 3"}) -> is no limit
solve(CARE, subject_to={"skip": ">= x"}) -> not a finite rational
solve(CARE, subject_to=X) for {}, "skip >= 3" -> states no limit
solve(CARE, subject_to={"angst": ">= 3"}) -> nothing to count is called 'angst'
solve(CARE, subject_to=X) for {"anger": []}, {"anger": ""}, ["anger <= 1"] -> limit
solve(MODEL, "value-iteration", subject_to={"steps": "<= 1"}) -> have one solver
tradeoff(CARE, [1, "anger"]) -> give texts
tradeoff(CARE, ["=anger", "skip"]) -> an empty name
tradeoff(CARE, ["anger*2", "skip"]) -> no part of a sum
tradeoff(CARE, ["angers", "skip"]) -> did you mean anger
best_cvar(FINE, "1/2") -> rounder rewards
best_cvar(LOOP, "1/2") -> give a horizon
best_cvar(MODEL.within(3), "1/2") -> choose discount 1

solve_robust(LOOP, NO, max_iterations=X) for True, 1.5 -> is (True|1.5)
solve_robust(LOOP, NO, nature="bad") -> unknown nature 'bad'
solve_robust(LOOP, NO, tol=0) -> tol is 0
solve_robust(LOOP, NO, tol=nan) -> tol is nan
solve_robust(LOOP, Intervals(lower=[0.5], upper=[1.0])) -> bounds of shapes
solve_robust(LOOP, Intervals(lower=[0.6, 0.6, 1], upper=[1.0, 1, 1])) -> lower bounds sum to 1.2
solve_robust(LOOP, Intervals(lower=[0, 0, 1], upper=[0.3, 0.3, 1])) -> upper bounds to 0.6
solve_robust(LOOP, Intervals(lower=[nan, 0, 1], upper=[1, 1, 1])) -> lower bounds sum to nan
solve_robust(LOOP, Intervals(lower=[0.9, 0, 1], upper=[0.8, 1, 1])) -> no law lies within
Intervals.relative(LOOP, -1) -> a relative radius of -1

QLearning(method="q-leaning") -> method
QLearning(ties="none") -> ties
QLearning(epochs=X) for 0, 2.0 -> epochs
QLearning(episodes=True) -> episodes
QLearning(snapshot_episode=31) -> snapshot_episode
QLearning(last=0) -> last
QLearning(max_steps=0) -> max_steps
QLearning(discount=1.5) -> discount
QLearning(exploration=Constant(X)) for 1.5, nan -> exploration
QLearning(rate=Constant(-0.1)) -> rate
QLearning(initial=inf) -> initial
Exponential.through(X, at=300, minimum=0.03) for 0.03, 0.0, 1.0, 2.0 -> no decay
QUICK.train(LOOP, X) for -1, 1.5, "0", None, True -> source of random numbers
train(LOOP, QUICK, X, rng=0) for 0, -1, 1.5, True -> n is
train(LOOP, QUICK, 2, rng=0, n_jobs=X) for 0, -1, True, "2" -> n_jobs is
QLearning(columns=()).train(HIDDEN, 0) -> share a row
QLearning(columns=("subtask", "trial", "status")).train(LONG, 0) -> too many
outcomes(CARE, []) -> no run of training
outcomes(TEA, train(CARE, QUICK, 1, rng=0)) -> other states
"""


NAMES = {name: getattr(exact_mdp, name) for name in exact_mdp.__all__} | globals()


def each_call(table: str) -> list[tuple[str, Any, str]]:
    """The calls of a table, where X is one value after another, and what is said of them."""
    rows = [line.rpartition(" -> ") for line in table.splitlines() if line]
    calls = [(*call.partition(" for "), said) for call, _, said in rows]
    return [(form, value, said) for form, _, listed, said in calls
            for value in eval(f"[{listed or None}]", NAMES)]  # fmt: skip


@pytest.mark.parametrize(("call", "value", "said"), each_call(REFUSED))
def test_refused(call: str, value: Any, said: str) -> None:
    with pytest.raises(ModelError, match=f"(?s){said}") as caught:
        eval(call, NAMES | {"X": value})
    assert caught.value.where
    assert caught.value.fix
