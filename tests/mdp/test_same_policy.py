"""One policy in every form that is taken: read as it is, or refused; never as another.

Models of up to four states are drawn with every kind of name for states and actions, in any order,
as rewards or costs, built or loaded. The policy itself is drawn by what states and actions *are*;
its weights are worked out here without the code that reads policies, its regret by the oracle.
"""

import json
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_models import policy_by
from oracle import evaluate_exact, solve_exact

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
Forms = Iterator[tuple[str, Any]]


class Case:
    """A model by what its states and actions are, and a policy: `takes[k]` in `states[k]`."""

    def __init__(self, data: st.DataObject, folder: Path) -> None:
        draw, kinds = data.draw, ["numbers from 0", *sorted(THINGS)]
        states, actions = (THINGS[draw(st.sampled_from(kinds))] for _ in range(2))
        n, a = draw(st.integers(2, min(4, len(states)))), draw(st.integers(2, min(3, len(actions))))
        self.folder = folder
        self.states = list(draw(st.permutations(states)))[:n]
        self.actions = list(draw(st.permutations(actions)))[:a]
        self.sense = draw(st.sampled_from(["max", "min"]))
        self.gain = [draw(st.lists(st.integers(0, 5), min_size=a, max_size=a)) for _ in range(n)]
        self.after = [[draw(st.integers(0, n - 1)) for _ in range(a)] for _ in range(n)]
        self.takes = [draw(st.integers(0, a - 1)) for _ in range(n)]
        self.explored, self.loaded = draw(st.booleans()), draw(st.booleans())
        self.model = self._explored() if self.explored else self._listed()
        if self.loaded:
            path = folder / draw(st.sampled_from(["m.npz", "m.umb"]))
            self.model.save(path)
            self.model = MDP.load(path)
        # Where each state and action stands in the model, by its printed name.
        labels = [self.model.space.as_dict(s)["state"] for s in range(n)]
        self.state_at = self._places(self.states, labels)
        self.action_at = self._places(self.actions, list(self.model.actions))
        self.at = [
            (self.states[k], self.actions[self.takes[k]]) for k in draw(st.permutations(range(n)))
        ]
        printed = (
            [labels[s] for s in self.state_at],
            [self.model.actions[a] for a in self.action_at],
        )
        self.printed = [(s, printed[1][a]) for s, a in zip(printed[0], self.takes, strict=True)]
        by_state = dict(zip(self.state_at, self.takes, strict=True))
        self.in_order = [by_state[s] for s in range(n)]  # numbers in self.actions
        self.numbers = [self.action_at[a] for a in self.in_order]  # numbers in the model

    def _outcomes(self, s: int, a: int) -> list[tuple[Fraction, int, int]]:
        after = (s + 1) % len(self.states), self.after[s][a]
        return [(HALF, t, self.gain[s][a]) for t in after]

    def _explored(self) -> MDP:
        def outcomes(state: Any, action: Any) -> list[Any]:
            s, a = place(self.states, state), place(self.actions, action)
            return [(p, self.states[t], r) for p, t, r in self._outcomes(s, a)]

        first = self.states[0]
        return MDP.from_function(first, lambda s: self.actions, outcomes, HALF, sense=self.sense)

    def _listed(self) -> MDP:
        pairs = [(s, a) for s in range(len(self.states)) for a in range(len(self.actions))]
        rows = [(s, a, self._outcomes(s, a)) for s, a in pairs]
        states, actions = texts(self.states), texts(self.actions)
        return MDP.from_outcomes(rows, HALF, states=states, actions=actions, sense=self.sense)

    def _places(self, things: list[Any], names: list[str]) -> list[int]:
        if self.explored and all(map(is_number, things)):
            numbers = range(len(things))
            if {*map(float, things)} == {*map(float, numbers)} and {*names} == {*map(str, numbers)}:
                return [int(thing) for thing in things]
            if all(float(thing).is_integer() for thing in things):
                return [names.index(str(int(thing))) for thing in things]
        return [names.index(text) for text in texts(things)]

    @property
    def unmistaken(self) -> bool:
        return all(len(set(map(str, each))) == len(each) for each in (self.states, self.actions))

    def regret(self) -> Fraction:
        sign, n = (-1 if self.sense == "min" else 1), len(self.states)
        rows = []
        for s in range(n):
            for a in range(len(self.actions)):
                law: dict[int, Fraction] = defaultdict(Fraction)
                for p, t, _ in self._outcomes(s, a):
                    law[t] += p
                rows.append((s, a, Fraction(sign * self.gain[s][a]), law))
        start = self.state_at.index(self.model.start[0][0])
        best, _ = solve_exact(n, rows, HALF)
        return best[start] - evaluate_exact(n, rows, HALF, dict(enumerate(self.takes)))[start]

    # ---- forms -----------------------------------------------------------------------------------

    def function(self, at: list[tuple[Any, Any]], *default: Any) -> Callable[[Any], Any]:
        return lambda state: next((a for s, a in at if s == state and alike(s, state)), *default)

    def by_object(self) -> Forms:
        """The policy by what states and actions are, as the model was built."""
        if not self.explored and not self.unmistaken:
            return
        at = self.at
        yield "objects", dict(at)
        yield "objects, mixed", {s: {a: 1} for s, a in at}
        yield "objects, by default", defaultdict(lambda: at[0][1], at[1:] + at[:1])
        yield "function", lambda state: next(a for s, a in at if s == state and alike(s, state))
        if not self.loaded:
            equal = [(what_equals(s), what_equals(a)) for s, a in at]
            yield "what equals objects", dict(equal)
            yield "function to what equals", self.function([(s, what_equals(a)) for s, a in at])
            for make in (list, np.array):
                if all(isinstance(a, tuple) for _, a in at):
                    yield "rows", {s: make(a) for s, a in at}
                    yield "rows of what equals", {s: make(a) for s, a in equal}
        if all(isinstance(x, bool | tuple | str) for x in self.actions):
            objects = [self.actions[a] for a in self.in_order]
            yield "list of objects", objects
            if isinstance(objects[0], bool):
                yield "array of truth", np.array(objects)

    def by_text(self) -> Forms:
        """The policy by the names that the model prints."""
        names = [self.model.actions[a] for a in self.numbers]
        yield "text", dict(self.printed)
        yield "list of names", names
        yield "array of names", np.array(names)
        yield "json", self._json(dict(self.printed))
        path = self.folder / "p.csv"
        pd.DataFrame(self.printed, columns=["state", "action"]).to_csv(path, index=False)
        yield "csv", path

    def by_order(self) -> Forms:
        """The policy by numbers in the model's order."""
        numbers, table = self.numbers, self._table()
        yield "numbers", numbers
        yield "Q-table", table
        yield "array", np.array(numbers)
        yield "column", np.array(numbers)[:, None]
        np.save(self.folder / "q.npy", table)
        yield "npy", self.folder / "q.npy"
        np.savez(self.folder / "q.npz", table)
        yield "npz", self.folder / "q.npz"
        if any(map(is_number, [*self.model.space.columns[0].objects, *self.model.action_objects])):
            return  # a number is what a state or an action is: it says nothing of the order
        yield "rows", dict(enumerate(table))
        yield "dictionary", dict(enumerate(numbers))
        yield (
            "dictionary of NumPy",
            dict(zip(np.arange(len(numbers)), np.array(numbers), strict=True)),
        )
        yield "function by number", lambda s: numbers[s]
        yield "function to numbers", lambda s: np.int64(numbers[s])
        yield "json by number", self._json({str(s): a for s, a in enumerate(numbers)})

    def _table(self) -> np.ndarray:
        return np.eye(len(self.actions))[self.numbers] * (-2.5 if self.sense == "min" else 2.5)

    def _json(self, content: Any) -> Path:
        path = self.folder / f"{len(list(self.folder.iterdir()))}.json"
        path.write_text(json.dumps(content), encoding="utf-8")
        return path

    def surely(self) -> Forms:
        """Forms that have to be taken, whatever the names."""
        policy = policy_by(self.model, ["state"], self.numbers)
        yield "policy", policy
        if self.unmistaken:
            policy.write(self.folder / "w.csv")
            yield "written", self.folder / "w.csv"
        if not {"state a", "state b"} & {word for each in self.printed for word in each}:
            yield "printed", {f"state {s}": f"action {a}" for s, a in self.printed}
        # Row 1 may be of state (1,), or of the second one: refused where they differ.
        if not (self.explored and all(isinstance(s, tuple) and len(s) == 1 for s in self.states)):
            yield "Q-table", self._table()
        known = self.model.space.columns[0].objects and self.model.action_objects
        if self.explored and self.unmistaken and (known or not self.loaded):
            first = self.at[0][1]
            yield "function", self.function(self.at)
            others = [(s, a) for s, a in self.at if a != first]
            yield "function that has a default", self.function(others, first)
            pairs = all(isinstance(s, tuple) and is_number(a) for s, a in self.at)
            if not self.loaded and not pairs:  # they may be {(state, action): number}
                yield "dictionary of objects", dict(self.at)


def alike(one: Any, other: Any) -> bool:
    return all(isinstance(one, kind) == isinstance(other, kind) for kind in (str, bool))


def place(things: list[Any], thing: Any) -> int:
    return next(k for k, x in enumerate(things) if x == thing and alike(x, thing))


def is_number(thing: Any) -> bool:
    return isinstance(thing, int | float | np.number | Fraction) and not isinstance(thing, bool)


def what_equals(thing: Any) -> Any:
    """What equals a thing and is of another kind: 1 for True, (1.0, 0.0) for (1, 0)."""
    if isinstance(thing, tuple):
        return tuple(float(x) if isinstance(x, int | np.integer) else x for x in thing)
    return int(thing) if isinstance(thing, bool) else thing


def texts(things: list[Any]) -> list[str]:
    """The text of each, or its `repr` where two have the same; NumPy's are plain numbers."""
    plain = [
        tuple(x.item() if isinstance(x, np.generic) else x for x in thing)
        if isinstance(thing, tuple)
        else thing
        for thing in things
    ]
    names = [str(thing) for thing in plain]
    return names if len(set(names)) == len(names) else [repr(thing) for thing in plain]


def agrees(case: Case, name: str, form: Any, *, has_to: bool = False) -> bool:
    """Whether a form is read as the policy that it is; False where it is refused."""
    try:
        with warnings.catch_warnings():  # a grid may have more states than the model
            warnings.filterwarnings("ignore", message=r"\d+ of \d+ rows are not read")
            policy = Policy.of(case.model, form)
    except (ModelError, LookupError, StopIteration, TypeError) as error:
        refused = isinstance(error, ModelError) and bool(error.fix)
        if has_to or not (refused or callable(form)):  # a function may raise an error of its own
            raise
        return False
    matters = ~case.model.ends.alike[case.model.pair_state]
    wanted = np.eye(len(case.actions))[case.numbers].ravel()
    assert (policy.weights(case.model) * matters).tolist() == (wanted * matters).tolist(), name
    return True


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_no_form_is_read_as_another_policy(tmp_path_factory: Any, data: st.DataObject) -> None:
    case = Case(data, tmp_path_factory.mktemp("m"))
    assert all(agrees(case, name, form, has_to=True) for name, form in case.surely())
    forms = [*case.by_object(), *case.by_text(), *case.by_order()]
    taken = [form for name, form in forms if agrees(case, name, form)]
    audit = check(case.model, data.draw(st.sampled_from(taken)))
    assert audit.value.value == case.regret()
    assert audit.passed == (case.regret() == 0)
