"""Beliefs and their bounds, against whole trees of beliefs in fractions and against sampling."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import ACTIONS, Oracle

from exact_mdp.analysis.perception.policies import best_perceived_policy, place_by_place
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.care.perception import independent, perceived
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.pomdp.pomdp import BeliefProblem, solve_beliefs
from exact_mdp.solvers.pomdp.values import (
    acting,
    at_start,
    fast_informed,
    rounding,
    values,
    visits,
)

F = Fraction
Rows = Mapping[tuple[Any, Any, str], Sequence[tuple[Fraction, Any, Fraction, Hashable]]]
Belief = dict[Any, Fraction]


class Hidden:
    """A slow, exact reference, by no code of the toolkit: the optimum with memory and without.

    rows[place, status, action] is a list of (probability, next, reward, signal), where next is
    (place, status) or None at the end. What is seen of a step is the next place and the signal;
    then the status is perceived with probability confusion[true][seen].
    """

    def __init__(
        self,
        rows: Rows,
        confusion: Mapping[Any, Mapping[Any, Fraction]],
        start: tuple[Any, Belief],
        discount: Fraction,
    ) -> None:
        self.rows, self.confusion, self.start, self.discount = rows, confusion, start, discount
        self.seen = sorted({z for row in confusion.values() for z in row})

    def actions(self, place: Any) -> list[str]:
        return sorted({a for p, _, a in self.rows if p == place})

    def best(self) -> Fraction:
        """The greatest value of any controller, by the whole tree of beliefs."""
        return self._before(*self.start)

    def _before(self, place: Any, belief: Belief) -> Fraction:
        total = Fraction(0)
        for z in self.seen:
            after = {s: b * self.confusion[s].get(z, Fraction(0)) for s, b in belief.items()}
            after = {s: b for s, b in after.items() if b}
            if after:
                total += max(self._acting(place, after, a) for a in self.actions(place))
        return total

    def _acting(self, place: Any, belief: Belief, action: str) -> Fraction:
        worth = Fraction(0)
        onward: dict[tuple[Any, Hashable], dict[Any, Fraction]]
        onward = defaultdict(lambda: defaultdict(Fraction))
        for s, b in belief.items():
            for p, following, reward, signal in self.rows[place, s, action]:
                worth += b * p * reward
                if following is not None:
                    onward[following[0], signal][following[1]] += b * p
        for (there, _), moved in onward.items():
            worth += self.discount * self._before(there, dict(moved))
        return worth

    def value(self, policy: Mapping[tuple[Any, Any], str]) -> Fraction:
        """The value of a policy from (place, perceived status) to an action."""
        place, belief = self.start
        return sum((b * self._following(place, s, policy) for s, b in belief.items()), Fraction(0))

    def _following(self, place: Any, s: Any, policy: Mapping[tuple[Any, Any], str]) -> Fraction:
        total = Fraction(0)
        for z, chance in self.confusion[s].items():
            for p, following, reward, _ in self.rows[place, s, policy[place, z]] if chance else ():
                later = Fraction(0)
                if following is not None:
                    later = self._following(following[0], following[1], policy)
                total += chance * p * (reward + self.discount * later)
        return total

    def best_fixed(self, *, by_place: bool) -> Fraction:
        """The greatest value of a deterministic policy on what is perceived."""
        places = sorted({p for p, _, _ in self.rows})
        keys = list(product(places, self.seen)) if by_place else [(None, z) for z in self.seen]
        found = []
        for chosen in product(self.actions(places[0]), repeat=len(keys)):
            table = dict(zip(keys, chosen, strict=True))
            policy = {
                (p, z): table[(p, z) if by_place else (None, z)] for p in places for z in self.seen
            }
            found.append(self.value(policy))
        return max(found)


LABELS = [f"{status:04b}" for status in range(16)]
# Exact in binary, so that the reference has the same numbers.
ROUGH = independent([7 / 8, 3 / 4, 5 / 8, 15 / 16], [7 / 8, 7 / 8, 3 / 4, 5 / 8])


def plan(status: str) -> str:
    return ACTIONS[(3 * int(status, 2) + 2) % 4]


def exact(matrix: np.ndarray) -> dict[str, dict[str, Fraction]]:
    """The matrix in fractions."""
    rows = [[F(x) for x in row] for row in matrix.tolist()]
    assert all(sum(row) == 1 for row in rows)
    return {
        s: {z: x for z, x in zip(LABELS, row, strict=True) if x}
        for s, row in zip(LABELS, rows, strict=True)
    }


SHARPER = independent([7 / 8, 3 / 4, 1, 1], [7 / 8, 5 / 8, 1, 1])


def care(oracle: Oracle, *, noticed: bool = True) -> Hidden:
    """The reference care model with its status hidden."""
    states = oracle.reachable()
    rows: dict[Any, Any] = {}
    for state in states:
        if isinstance(state, str):
            continue
        here = state[:3], "".join(map(str, state[3]))
        for action in oracle.actions(state):
            rows[(*here, action)] = [
                (
                    p,
                    None if isinstance(to, str) else (to[:3], "".join(map(str, to[3]))),
                    sum(gains.values()),
                    skipped and noticed,
                )
                for p, to, gains, skipped in oracle.outcomes(state, action)
            ]
    start = oracle.start
    assert isinstance(start, tuple)
    return Hidden(rows, exact(SHARPER), (start[:3], {"0000": F(1)}), oracle.discount)


CASES = [
    ({"tasks": [1], "max_trial": 2}, {}, True),
    ({"tasks": [2], "max_trial": 1}, {}, True),
    ({"tasks": [2], "max_trial": 1}, {}, False),
    ({"tasks": [1], "max_trial": 1}, {"skip_timestep": "own", "status_cost": "current"}, True),
]


@pytest.mark.parametrize(("settings_", "readings", "noticed"), CASES)
def test_the_best_controller_of_the_reference_model(settings_, readings, noticed) -> None:
    mdp = Scenario.load("yuan2025").with_(readings=readings, **settings_).compile()
    process = Process.of(mdp, SHARPER, events=None if noticed else ())
    wanted = care(Oracle(readings=readings, **settings_), noticed=noticed).best()
    found = solve_beliefs(process, tol=1e-7, seconds=20)
    assert found.closed
    assert found.lower <= wanted <= found.upper


def test_not_noticing_a_skip_costs_something() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=1).compile()
    aware, unaware = (
        solve_beliefs(Process.of(mdp, ROUGH, events=events), tol=1e-6) for events in (None, ())
    )
    assert unaware.upper < aware.lower


@st.composite
def hidden_models(draw: st.DrawFn) -> tuple[MDP, np.ndarray, Hidden]:
    """Two statuses, two actions, up to three places in a row, some of them left out."""
    places = draw(st.integers(1, 3))
    discount = draw(st.sampled_from([F(1), F(1, 2), F(9, 10)]))
    weight, gain = st.integers(0, 4), st.integers(-5, 5)
    rows, outcomes = {}, []
    end = 2 * places
    for place in range(places):
        later = [(p, s) for p in range(place + 1, places) for s in (0, 1)]
        for status in (0, 1):
            for action in (0, 1):
                weights = [draw(weight) for _ in later] + [draw(st.integers(1, 3))]
                row = [
                    (F(w, sum(weights)), to, F(draw(gain)))
                    for w, to in zip(weights, [*later, None], strict=True)
                    if w
                ]
                rows[place, status, str(action)] = [(p, to, r, 0) for p, to, r in row]
                flat = [(p, end if to is None else 2 * to[0] + to[1], r) for p, to, r in row]
                outcomes.append((2 * place + status, action, flat))
    outcomes.append((end, 0, [(F(1), end, F(0))]))
    begin = draw(st.sampled_from([F(0), F(1, 4), F(1)]))
    mdp = MDP.from_outcomes(outcomes, discount, start={0: 1 - begin, 1: begin}).with_(
        space=StateSpace(
            columns=(Column(name="place", size=places), Column(name="status", size=2, bits=1)),
            extra=("end",),
        )
    )
    hits = [draw(st.sampled_from([F(1), F(7, 8), F(1, 2), F(1, 4)])) for _ in range(2)]
    matrix = np.array([[float(hits[0]), float(1 - hits[0])], [float(1 - hits[1]), float(hits[1])]])
    confusion = {0: {0: hits[0], 1: 1 - hits[0]}, 1: {0: 1 - hits[1], 1: hits[1]}}
    belief = {s: b for s, b in ((0, 1 - begin), (1, begin)) if b}
    return mdp, matrix, Hidden(rows, confusion, (0, belief), discount)


@settings(max_examples=60)
@given(hidden_models())
def test_tiny_models(case: tuple[MDP, np.ndarray, Hidden]) -> None:
    mdp, matrix, reference = case
    process = Process.of(mdp, matrix)
    best = reference.best()
    found = solve_beliefs(process, tol=1e-8)
    assert found.closed
    assert found.lower <= best <= found.upper
    informed = (process.start * process.confusion.T) @ fast_informed(process)[0].T
    slack = 4 * rounding(process)
    assert best <= informed.max(axis=1).sum() + slack
    assert informed.max(axis=1).sum() <= solve(mdp).start_value + slack + 1e-9
    for columns, by_place in ((("status",), False), (("place", "status"), True)):
        wanted = reference.best_fixed(by_place=by_place)
        fixed = best_perceived_policy(mdp, process, columns)
        assert fixed.proven
        assert fixed.value.interval[0] <= wanted <= fixed.value.interval[1]
        assert wanted <= fixed.upper_bound <= fixed.mixed_upper_bound + slack
    improved = process.table(place_by_place(process, ["random"]))
    worth = at_start(process, values(process, acting(process, improved))[0])[0]
    assert evaluate(mdp, perceived(mdp, "random", matrix)).mean <= worth + slack <= best + 2 * slack


def test_values_and_visits_are_those_of_the_mixed_policy() -> None:
    mdp = Scenario.load("yuan2025").with_(discount="19/20", tasks=[2]).compile()
    process = Process.of(mdp, ROUGH)
    policy = {label: plan(label) for label in LABELS}
    chain = evaluate(mdp, perceived(mdp, policy, ROUGH))
    weights = acting(process, process.table(policy))
    value, _ = values(process, weights)
    assert at_start(process, value)[0] == pytest.approx(chain.mean, abs=2 * rounding(process))
    reached = list(process.order)
    met = visits(process, weights)[reached, :, 0].sum()
    assert met == pytest.approx(chain.occupancy[~mdp.terminal[mdp.pair_state]].sum(), rel=1e-12)
    batch = np.stack([np.eye(16), ROUGH, np.full((16, 16), 1 / 16)])
    together = at_start(process, values(process, acting(process, process.table(policy), batch))[0])
    alone = [evaluate(mdp, perceived(mdp, policy, matrix)).mean for matrix in batch]
    assert together == pytest.approx(alone, rel=1e-12)


def test_solve_takes_a_belief_problem() -> None:
    mdp = Scenario.load("yuan2025").compile()
    matrix = independent([0.9] * 4, [0.9] * 4)
    found = solve(BeliefProblem(model=mdp, confusion=matrix, max_trials=1, seconds=60))
    same = solve_beliefs(Process.of(mdp, matrix), max_trials=1, seconds=60)
    assert found.interval == same.interval
    assert found.start.interval[0] <= found.lower <= found.upper <= found.start.interval[1]
    assert found.action(0, np.eye(16)[0]) == "non-directive"
    assert found.frame()["closed"].tolist() == [False]
    with pytest.raises(ModelError, match="one algorithm"):
        solve(BeliefProblem(model=mdp, confusion=matrix), "value-iteration")


def test_perfect_perception_is_worth_the_optimum() -> None:
    mdp = Scenario.load("yuan2025").compile()
    process = Process.of(mdp, np.eye(16))
    found = solve_beliefs(process, tol=1e-6)
    optimum = solve(mdp).start
    assert found.closed
    assert found.lower <= optimum.value + optimum.error
    assert found.upper >= optimum.value - optimum.error


def test_a_limit_leaves_sound_bounds() -> None:
    process = Process.of(Scenario.load("yuan2025").compile(), ROUGH)
    early = solve_beliefs(process, tol=1e-9, max_trials=1)
    late = solve_beliefs(process, tol=1e-9, max_trials=30, seconds=60)
    assert not early.closed
    assert early.lower <= late.lower <= late.upper <= early.upper
    for limit in ({"seconds": 0}, {"tol": -1.0}, {"max_trials": 0}):
        with pytest.raises(ModelError, match="more than 0"):
            solve_beliefs(process, **limit)


def test_the_bounds_say_the_same_twice() -> None:
    process = Process.of(Scenario.load("yuan2025").compile(), ROUGH)
    first, second = (solve_beliefs(process, max_trials=5, seconds=60) for _ in range(2))
    assert first.interval == second.interval


def test_models_that_cannot_be_tracked() -> None:
    with pytest.raises(ModelError, match="no statuses"):
        Process.of(MDP.from_arrays([[[1]]], [0]), np.eye(1))
    column = Column(name="status", size=2, bits=1)
    rows = [(s, 0, [(1, 1 - s, 1)]) for s in (0, 1)]
    round_and_round = MDP.from_outcomes(rows, "1/2").with_(space=StateSpace(columns=(column,)))
    with pytest.raises(ModelError, match="a place can recur"):
        Process.of(round_and_round, np.eye(2))
    mdp = Scenario.load("yuan2025").compile()
    with pytest.raises(ModelError, match="unknown event"):
        Process.of(mdp, np.eye(16), events=["fire"])
    with pytest.raises(ModelError, match="does not read the status"):
        best_perceived_policy(mdp, np.eye(16), ("trial",))


@pytest.mark.parametrize("tiny", [5e-324, 1e-310, 1e-160])
def test_chances_near_nothing_leave_the_bounds_as_they_are(tiny: float) -> None:
    """Their inverses overflow, and products with them are no numbers; warnings are errors."""
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    number = np.arange(16)
    far = (number[:, None] ^ number) & 8 > 0
    found = []
    for least in (0.0, tiny):
        matrix = np.where(far, 0.0, independent([0.7] * 4, [0.8] * 4))
        matrix = np.where(far, least, matrix / matrix.sum(axis=1, keepdims=True))
        found.append(solve_beliefs(Process.of(mdp, matrix), tol=1e-3, seconds=30))
    assert all(each.closed and np.isfinite(each.interval).all() for each in found)
    none, some = found
    assert some.lower <= none.upper
    assert none.lower <= some.upper


def test_bounds_that_are_no_numbers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from exact_mdp.solvers.pomdp.search import Search

    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=1).compile()
    monkeypatch.setattr(Search, "upper", np.nan)
    with pytest.raises(ModelError, match="bounds came out as"):
        solve_beliefs(Process.of(mdp, ROUGH))
