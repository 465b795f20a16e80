"""One policy in every form that is taken: read as it is, or refused; never as another.

Models of up to four states are drawn with every kind of name for states and actions, in any order,
as rewards or costs, built or loaded. The policy itself is drawn by what states and actions *are*;
its weights, and its regret, are worked out here without the code that reads policies.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, Policy, check

HALF = Fraction(1, 2)
THINGS: dict[str, list[Any]] = {
    "numbers from 0": [0, 1, 2, 3],
    "numbers from 1": [1, 2, 3, 4],
    "some numbers": [3, 0, 1, 7],
    "floats": [0.5, 2.0, 1.0, 0.0],
    "fractions": [HALF, Fraction(1), Fraction(0), Fraction(2)],
    "of NumPy": [np.int64(2), np.int64(5), np.int64(0), np.int64(1)],
    "digits": ["3", "1", "2", "0"],
    "bits": ["01", "10", "00", "11"],
    "words": ["b", "a", "state a", "state b"],
    "hostile": ["<script>", " a", "$x$", "action 1"],
    "tuples": [(0, 1), (1, 0), (0, 0), (1, 1)],
    "tuples of NumPy": [(np.int64(1), "l"), (np.int64(0), "r"), (np.int64(0), "l"), (1, "r")],
    "singles": [(2,), (0,), (1,), (3,)],
    "truth": [True, False],
    "both": [1, "1", 0, "0"],
    "text from 0": ["0", "1"],
    "pairs": [(0, 1), (1, 0)],
    "pairs and more": [(1, 0), (0, 1), (1, 1)],
}


class Case:
    """A model by what its states and actions are, its policy, and what that is worth."""

    def __init__(self, data: st.DataObject, folder: Path) -> None:
        draw, kinds = data.draw, ["numbers from 0", *sorted(THINGS)]
        self.folder = folder
        states, actions = (THINGS[draw(st.sampled_from(kinds))] for _ in range(2))
        n, a = draw(st.integers(2, min(4, len(states)))), draw(st.integers(2, min(3, len(actions))))
        self.states = list(draw(st.permutations(states)))[:n]
        self.actions = list(draw(st.permutations(actions)))[:a]
        self.sense = draw(st.sampled_from(["max", "min"]))
        self.sign = -2.5 if self.sense == "min" else 2.5
        self.gain = [draw(st.lists(st.integers(0, 5), min_size=a, max_size=a)) for _ in range(n)]
        self.after = [[draw(st.integers(0, n - 1)) for _ in range(a)] for _ in range(n)]
        self.takes = [draw(st.integers(0, a - 1)) for _ in range(n)]
        self.explored = draw(st.booleans())
        self.model = self._explored() if self.explored else self._listed()
        self.loaded = draw(st.booleans())
        if self.loaded:
            path = folder / draw(st.sampled_from(["m.npz", "m.umb"]))
            self.model.save(path)
            self.model = MDP.load(path)
        self.order = draw(st.permutations(range(n)))
        self.seat = self._seats()

    def _outcomes(self, s: int, a: int) -> list[tuple[Fraction, int, int]]:
        n = len(self.states)
        return [(HALF, (s + 1) % n, self.gain[s][a]), (HALF, self.after[s][a], self.gain[s][a])]

    def _explored(self) -> MDP:
        def outcomes(state: Any, action: Any) -> list[Any]:
            s = next(k for k, x in enumerate(self.states) if x == state and self._alike(x, state))
            a = next(
                k for k, x in enumerate(self.actions) if x == action and self._alike(x, action)
            )
            return [(p, self.states[t], r) for p, t, r in self._outcomes(s, a)]

        return MDP.from_function(
            self.states[0], lambda s: self.actions, outcomes, HALF, sense=self.sense
        )

    @staticmethod
    def _alike(one: Any, other: Any) -> bool:
        return all(isinstance(one, kind) == isinstance(other, kind) for kind in (str, bool))

    def _listed(self) -> MDP:
        rows = [
            (s, a, self._outcomes(s, a))
            for s in range(len(self.states)) for a in range(len(self.actions))
        ]  # fmt: skip
        names = [_names(self.states), _names(self.actions)]
        return MDP.from_outcomes(rows, HALF, states=names[0], actions=names[1], sense=self.sense)

    def _seats(self) -> tuple[list[int], list[int]]:
        """Return where each state and action stands in the model, by its printed name."""
        labels = [self.model.space.as_dict(s)["state"] for s in range(self.model.n_states)]
        found = []
        for things, names in ((self.states, labels), (self.actions, list(self.model.actions))):
            whole = {*map(str, range(len(things)))} == set(names) and _whole(things)
            if self.explored and all(_number(x) and float(x).is_integer() for x in things):
                said = [str(int(x)) for x in things]
            else:
                said = _names(things)
            found.append([
                int(thing) if whole and self.explored else names.index(name)
                for thing, name in zip(things, said, strict=True)
            ])  # fmt: skip
        return found[0], found[1]

    def by_place(self) -> list[int]:
        """Return the number of the action in each state, both in the model's order."""
        found = dict(zip(self.seat[0], (self.seat[1][a] for a in self.takes), strict=True))
        return [found[s] for s in range(len(self.states))]

    def weights(self) -> list[float]:
        return [float(a == b) for b in self.by_place() for a in range(len(self.actions))]

    @property
    def unmistaken(self) -> bool:
        """Whether no name is the text of two things."""
        return all(len(set(map(str, each))) == len(each) for each in (self.states, self.actions))

    @property
    def numbers_are_objects(self) -> bool:
        """Whether a number is what a state or an action is, so that it says nothing of order."""
        things = [*self.model.space.columns[0].objects, *self.model.action_objects]
        return any(isinstance(x, int | float | np.number | Fraction) for x in things)

    def regret(self) -> Fraction:
        """Return what the policy loses from the start: all policies are tried."""
        n, sign = len(self.states), -1 if self.sense == "min" else 1
        start = self.seat[0].index(self.model.start[0][0])
        best = max(
            sign * self._worth(policy)[start]
            for policy in product(range(len(self.actions)), repeat=n)
        )
        return best - sign * self._worth(tuple(self.takes))[start]

    def _worth(self, policy: tuple[int, ...]) -> list[Fraction]:
        """Solve (I - P/2) v = r by elimination."""
        n = len(policy)
        rows = [[Fraction(s == t) for t in range(n)] for s in range(n)]
        for s, a in enumerate(policy):
            for p, t, _ in self._outcomes(s, a):
                rows[s][t] -= p / 2
            rows[s].append(Fraction(self.gain[s][a]))
        for k in range(n):  # diagonally dominant: no pivot is 0
            rows[k] = [x / rows[k][k] for x in rows[k]]
            for s in range(n):
                if s != k:
                    rows[s] = [x - rows[s][k] * y for x, y in zip(rows[s], rows[k], strict=True)]
        return [row[-1] for row in rows]

    # ---- forms -----------------------------------------------------------------------------------

    def by_object(self) -> Iterator[tuple[str, Any]]:
        """Yield the policy by what states and actions are, as the model was built."""
        if not self.explored and not self.unmistaken:
            return
        at = [(self.states[k], self.actions[self.takes[k]]) for k in self.order]
        yield "objects", dict(at)
        yield "objects, mixed", {s: {a: 1} for s, a in at}
        yield "objects, by default", defaultdict(lambda: at[0][1], at[1:] + at[:1])
        equal = [(_equal(s), _equal(a)) for s, a in at]
        if not self.loaded:
            yield "what equals objects", dict(equal)
            yield "what equals objects, told", self._told([(s, _equal(a)) for s, a in at])
            for make in (list, np.array):
                if all(isinstance(a, tuple) for _, a in at):
                    yield "rows", {s: make(a) for s, a in at}
                    yield "rows of what equals", {s: make(a) for s, a in equal}
        yield "function", self._told(at)
        if all(isinstance(x, bool | tuple | str) for x in self.actions):
            act = [self.actions[self.seat[1].index(a)] for a in self.by_place()]
            yield "list of objects", act
            if isinstance(act[0], bool):
                yield "array of truth", np.array(act)

    def _told(self, at: list[tuple[Any, Any]]) -> Callable[[Any], Any]:
        def ask(state: Any) -> Any:
            return next(a for s, a in at if s == state and self._alike(s, state))

        return ask

    def _default(self, at: list[tuple[Any, Any]], state: Any, other: Any) -> Any:
        return next((a for s, a in at if s == state and self._alike(s, state)), other)

    def by_text(self) -> Iterator[tuple[str, Any]]:
        """Yield the policy by the names that the model prints."""
        states, actions = self.printed()
        at = [(states[k], actions[self.takes[k]]) for k in self.order]
        yield "text", dict(at)
        by_place = [actions[self.seat[1].index(a)] for a in self.by_place()]
        yield "list of names", by_place
        yield "array of names", np.array(by_place)
        (self.folder / "p.json").write_text(json.dumps(dict(at)), encoding="utf-8")
        yield "json", self.folder / "p.json"
        pd.DataFrame(at, columns=["state", "action"]).to_csv(self.folder / "p.csv", index=False)
        yield "csv", self.folder / "p.csv"

    def printed(self) -> tuple[list[str], list[str]]:
        names = [self.model.space.as_dict(s)["state"] for s in self.seat[0]]
        return names, [self.model.actions[a] for a in self.seat[1]]

    def by_order(self) -> Iterator[tuple[str, Any]]:
        """Yield the policy by numbers in the model's order."""
        numbers = self.by_place()
        table = np.eye(len(self.actions))[numbers] * self.sign
        yield "numbers", numbers
        yield "array", np.array(numbers)
        yield "column", np.array(numbers)[:, None]
        yield "Q-table", table
        np.save(self.folder / "q.npy", table)
        yield "npy", self.folder / "q.npy"
        np.savez(self.folder / "q.npz", table)
        yield "npz", self.folder / "q.npz"
        if self.numbers_are_objects:
            return
        yield "rows", dict(enumerate(table))
        yield "dictionary", dict(enumerate(numbers))
        yield (
            "dictionary of NumPy",
            dict(zip(np.arange(len(numbers)), np.array(numbers), strict=True)),
        )
        yield "function by number", lambda s: numbers[s]
        yield "function to numbers", lambda s: np.int64(numbers[s])
        yield "json by number", self._json({str(s): a for s, a in enumerate(numbers)})

    def _json(self, content: Any) -> Path:
        (self.folder / "n.json").write_text(json.dumps(content), encoding="utf-8")
        return self.folder / "n.json"

    def surely(self) -> Iterator[tuple[str, Any]]:
        """Yield forms that have to be taken, whatever the names."""
        policy = Policy.from_choices(self.model, self.by_place())
        yield "policy", policy
        for ending in ("csv", "json") if self.unmistaken else ():
            policy.write(self.folder / f"w.{ending}")
            yield ending, self.folder / f"w.{ending}"
        states, actions = self.printed()
        at = list(zip(states, [actions[a] for a in self.takes], strict=True))
        if not {"state a", "state b"} & {*states, *actions}:
            yield "printed", {f"state {s}": f"action {a}" for s, a in at}
        yield "Q-table", np.eye(len(actions))[self.by_place()] * self.sign
        kept = self.model.space.columns[0].objects and self.model.action_objects
        if self.explored and self.unmistaken and (kept or not self.loaded):
            at = [(self.states[k], self.actions[self.takes[k]]) for k in self.order]
            yield "function", self._told(at)
            others = [(s, a) for s, a in at if a != at[0][1]]
            yield "function that has a default", lambda s: self._default(others, s, at[0][1])
            if not self.loaded:
                yield "dictionary of objects", dict(at)


def _number(thing: Any) -> bool:
    return isinstance(thing, int | float | np.number | Fraction) and not isinstance(thing, bool)


def _whole(things: list[Any]) -> bool:
    return all(map(_number, things)) and {*map(float, things)} == {*map(float, range(len(things)))}


def _equal(thing: Any) -> Any:
    """Return what equals a thing and is of another kind: 1 for True, (1.0, 0.0) for (1, 0)."""
    if isinstance(thing, tuple):
        return tuple(float(x) if isinstance(x, int | np.integer) else x for x in thing)
    return int(thing) if isinstance(thing, bool) else thing


def _names(things: list[Any]) -> list[str]:
    """Return the text of each, or its `repr` where two have the same; NumPy's are plain numbers."""
    plain = [
        tuple(x.item() if isinstance(x, np.generic) else x for x in thing)
        if isinstance(thing, tuple) else thing
        for thing in things
    ]  # fmt: skip
    texts = [str(thing) for thing in plain]
    return texts if len(set(texts)) == len(texts) else [repr(thing) for thing in plain]


def agrees(case: Case, name: str, form: Any, *, has_to: bool = False) -> bool:
    """Return whether a form is read as the policy that it is; False where it is refused."""
    try:
        found = Policy.of(case.model, form)
    except (ModelError, LookupError, StopIteration, TypeError) as error:
        refused = isinstance(error, ModelError) and bool(error.fix)
        if has_to or not (refused or callable(form)):  # a function may raise an error of its own
            raise
        return False
    same = case.model.indifferent[case.model.pair_state]  # where it does not matter
    weights = np.where(same, 0, found.weights(case.model)).tolist()
    assert weights == np.where(same, 0, case.weights()).tolist(), (name, form)
    return True


def examples(most: int) -> Any:
    return settings(max_examples=most, deadline=None, suppress_health_check=list(HealthCheck))


def every_form(data: st.DataObject, folder: Path) -> None:
    case = Case(data, folder)
    for name, form in case.surely():
        assert agrees(case, name, form, has_to=True)
    forms = [*case.by_object(), *case.by_text(), *case.by_order()]
    taken = [form for name, form in forms if agrees(case, name, form)]
    found = check(case.model, data.draw(st.sampled_from(taken)))
    assert found.value.value == case.regret()
    assert found.passed == (case.regret() == 0)


@examples(60)
@given(st.data())
def test_no_form_is_read_as_another_policy(tmp_path_factory: Any, data: st.DataObject) -> None:
    every_form(data, tmp_path_factory.mktemp("m"))


@pytest.mark.slow
@examples(3000)
@given(st.data())
def test_no_form_of_many_is_read_as_another_policy(
    tmp_path_factory: Any, data: st.DataObject
) -> None:
    every_form(data, tmp_path_factory.mktemp("m"))
