"""What is no model, at every door: the call, what is said, where, and how to put it right."""

from collections.abc import Callable
from fractions import Fraction
from inspect import signature
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from refusal_tables import refused

import exact_mdp
from exact_mdp import (
    MDP,
    DistributionError,
    ModelError,
    NegativeError,
    Scenario,
    ShapeError,
    StateSpace,
    solve,
)

HALF, INF = Fraction(1, 2), float("inf")
P = np.array([[[0.5, 0.5, 0.0], [0, 0.25, 0.75], [0, 0, 1]], [[0, 1, 0], [0.5, 0, 0.5], [0, 0, 1]]])
R = np.array([[1.0, 2.0], [3.0, -4.0], [0.0, 0.0]])
EYE = np.eye(2)
SPARSE = sp.csr_array(EYE)
STAYS = sp.csr_array(np.array([[1.0, 0], [1, 0]]))
ALIKE = [np.array([[1.0, 0], [1, 0]])] * 2  # the same in both layouts
TWO = {"a": {"x": {"a": 1}, "y": {"a": 1}}, "b": {"x": {"b": 1}}}
QUADRUPLES = [(0, 0, 1, 1), (0, 1, 0, 1), (1, 0, 1, 1)]
RAGGED = [[[0.5, 0.5], [0, 1]], [[1, 0]]]
CYCLE = [(0, 0, 1, 1), (1, 1, 2, 1), (2, 2, 0, 1)]
THIRDS = np.full((2, 3, 3), 1 / 3)
SINGLE = np.random.default_rng(0).random((1, 9, 9)).astype(np.float32)
SINGLE /= SINGLE.sum(axis=-1, keepdims=True)
ENDS = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]


def spoiled(action: int, state: int, following: int, value: float) -> Any:
    array = P.copy()
    array[action, state, following] = value
    return array


def damaged(place: int) -> sp.csr_array:
    matrix = sp.csr_array(EYE)
    matrix.indices[1] = place
    return matrix


class Nameless:
    def __repr__(self) -> str:
        return "one"


ARRAYS: list[Any] = [  # P, R, what is said, and perhaps where, and how to put it right
    (spoiled(1, 1, 0, 0.4), R, "transition probabilities sum to 0.9, not 1", "state 1, action 1",
     "add the missing outcome"),
    (spoiled(0, 2, 2, 0), R, "sum to 0, not 1"),
    ([[[1.5, -0.5], [0, 1]]], [0, 0], "a probability is -0.5"),
    (spoiled(0, 0, 0, np.nan), R, "a probability is nan"),
    (P, np.where(R == 3, np.inf, R), "a reward is inf"),
    (P, np.where(R == 0, -np.inf, R), "a state without action"),
    (P, [["a", "b"]] * 3, "not a finite rational"),
    (P, R * 1j, "complex"),
    (P, [[1, 2], [3], [4, 5]], "different lengths"),
    (P, np.zeros((2, 3)), "rewards have shape (2, 3)"),
    (P, 1.0, "rewards have shape ()"),
    (P, None, "not a number"),
    (P[0], R, "transitions have shape (3, 3)"),
    (P[:, :, :2], R, "transitions have shape (2, 3, 2)"),
    (np.zeros((0, 0, 0)), np.zeros(0), "transitions have shape"),
    ([], [], "transitions have shape"),
    ([[[1.0]], [[0.5, 0.5], [0, 1]]], [0], "different lengths"),
    ([[["a"]]], [0], "not a finite rational"),
    (P * 1j, R, "complex"),
    ([sp.csr_array(P[0]), P[1]], R, "mixes sparse and dense"),
    ([sp.eye_array(2), sp.eye_array(3)], [0, 0], "shapes"),
    ([sp.csr_array(np.ones((2, 3)))], [0, 0], "transitions have shape (1, 2, 3)"),
    ([sp.csr_array(np.array([[np.nan]]))], [0], "a probability is nan"),
    ([sp.csr_array(np.array([[1j]]))], [0], "complex"),
    ([[[HALF, HALF - Fraction(1, 10**30)], [0, 1]]], [0, 0], "not 1"),
    ([[["0.5", "0.4999999999999999"], [0, 1]]], [0, 0], "not 1"),
    ([[[Fraction(1, 3), 0.6666667], [0, 1]]], [0, 0], "not 1"),
    ([[[1 / 3, 1 / 3, 1 / 3 + 1e-8]] * 3], [0, 0, 0], "not 1"),
    (SINGLE, [0] * 9, "not 1", "", "float64 and norm"),
    (SINGLE.astype(np.float16), [0] * 9, "not 1"),
    (sp.coo_array(np.stack([EYE] * 2)), [0, 0], "(2, 2, 2)"),
    ([damaged(5)], [0, 0], "column 5", "P"),
    ([damaged(-1)], [0, 0], "column -1"),
    ([STAYS] * 2, [SPARSE, damaged(7)], "column 7", "R"),
    ([STAYS] * 2, [SPARSE, sp.eye_array(3)], "matrices of rewards"),
    ([STAYS] * 2, [sp.eye_array(3)] * 2, "rewards have shape (2, 3, 3)"),
    ([STAYS] * 2, [SPARSE, EYE], "R mixes sparse and dense"),
    ([SPARSE], ["a", "b"], "not a finite rational", "R"),
    ([SPARSE], sp.csr_array(EYE * 1j), "complex"),
    ([SPARSE], sp.csr_array(np.ones((3, 1))), "rewards have shape (3, 1)"),
    ({0: {0: {1: 1}}}, {0: 1}, "a state without action"),
    ({0: {0: {0: 1}}}, {}, "there is no reward"),
    ({0: 1}, {0: 1}, "P has an entry by 0"),
    ({0: {0: {0: 1}}}, {"a": 1}, "R has an entry by 'a'"),
    ({0: {0: {0: "x"}}}, {0: 1}, "not a finite rational"),
    ({0: {0: {0: 0.5}}}, {0: 1}, "sum to 0.5, not 1"),
    (np.eye(4), [0] * 4, "4 entries in a list for 2 states"),
    ([(0.5, 0, 0, 1)], {0.5: 0}, "without action"),
    ({Nameless(): {}, Nameless(): {}}, {}, "are both called one"),
    ([(({},), 0, 0, 1)], [0], "cannot be a key"),
    ({"\x1b": {}}, {}, "U+001B"),
    (np.full((2, 2, 2), 0.4), [0, 0], "sum to 0.8"),
    ([[[1, 0], [0.4, 0.4]], [[1, 0]] * 2], [0, 0], "as many actions as states", "", 'layout="sas"'),
    (QUADRUPLES, [[1, 2, 99, 98], [3], [55], [66]], "4 entries in a list for 2 states"),
    (QUADRUPLES, [[1, 2, 99], [3]], "3 entries in a list for 2 actions"),
    (QUADRUPLES, [(0, 0, 7), (0, 0, 8), (1, 0, 9)], "for 2 states"),
    (QUADRUPLES, [(0, 0, 7), (0, 1, 8)], "there is no reward"),
    (QUADRUPLES, [(0, 0, 1, 7)], "there is no reward", "R"),
    (RAGGED, np.ones((5, 7)), "5 entries in a list for 2 states"),
    (RAGGED, [[1, 2], [3, 4, 5]], "3 entries in a list for 1 or 2 actions"),
    (CYCLE, [(0, 0, 7), (1, 1, 8), (2, 2, 9)], "may be triples (s, a, r), or"),
    ({"a": {"go": {"a": 1}}}, {"a": [1]}, "actions that are not numbers"),
    ({"a": {"go": {"a": 1}}}, [1], "states that are not numbers"),
    ({0: {0: {0: 1}}}, {(0, 0): 1, (5, 0): 7}, "a reward of state 5"),
    (TWO, {"a": 1, "b": 1, ("a", "X"): 50}, "a reward of the action 'X'", "R, a, X",
     "choose one of x, y"),
    (TWO, {"a": 1, "b": 1, ("a", "x", "A"): 50}, "a reward of the next state 'A'"),
    (TWO, {"a": 1, "b": 1, ("b", "y"): 50}, "a reward of the action 'y'", "R, b, y",
     "leave it out, or give -inf or NaN"),
    (TWO, {"a": {"x": 1, "y": 2}, "b": {"x": 3, "y": 4}}, "does not offer in state 'b'"),
    ([(0, 0, 0, 1.5), (0, 0, 0, -0.5)], [0], "a probability is -0.5"),  # though they cancel
    ([sp.coo_array(([1.5, -0.5, 1], ([0, 0, 1], [1, 1, 1])), shape=(2, 2))], [0, 0],
     "a probability is -0.5"),
    (ALIKE, {(0, 0): 1}, "the rewards are a dictionary"),
    *((ALIKE, table, "a table has the labels", "", "to_numpy") for table in (
        pd.DataFrame(R[:2], index=[1, 0]), pd.DataFrame(R[:2], columns=[1, 0]),
        pd.Series([1, 2], index=[1, 0]))),
    ([pd.DataFrame(np.full((2, 2), 0.5), index=[1, 0])] * 2, [0, 0], "a table has the labels"),
    (ALIKE, np.ma.array([[5, 1]] * 2, mask=[[1, 0]] * 2), "masked", "", "-inf"),
    (np.ma.array([[[1]], [[1]]], mask=[[[1]], [[0]]]), [[5, 1]], "masked"),
    ([[[1]], [[1]]], [np.ma.array([5, 1], mask=[1, 0])], "masked"),
    ({0: {0: np.ma.array([5, 1], mask=[1, 0]), 1: [0, 1]}, 1: {}}, {0: 1}, "masked"),
]  # fmt: skip
OPTIONS: list[Any] = [  # of MDP.from_arrays(P, R), or of with_
    *(({"discount": x}, "outside [0, 1]") for x in (1.1, -0.1, 10**400)),
    *(({"discount": x}, "not a finite rational") for x in (float("nan"), "high")),
    ({"discount": True}, "not a number"),
    ({"start": [0.5, 0.4, 0]}, "sum to 0.9", "start"),
    *(({"start": x}, "") for x in ("x", [1, 0], 3, -1, 0.5, True, {}, {0: 2, 1: -1}, {0: 10**400},
      pd.Series([0.5, 0.5], [1, 1]), pd.Series([1], ["x"]),
      np.ma.array([1.0, 0, 0], mask=[1, 0, 0]))),
    *(({"components": x}, "") for x in (np.zeros((6, 1)), np.zeros((5, 1)))),
    ({"component_names": ("a", "b")}, ""),
    ({"components": {"a": [1, 2]}}, "(2,)"),
    ({"components": {"a": ["x", *[0] * 5]}}, "not a finite rational"),
    ({"components": {"a": [np.nan, *[0.0] * 5]}}, "an amount is nan"),
    ({"components": {}}, "no component is given"),
    ({"components": {"a": [2, *[0] * 5], "rest": [1, *[0] * 5]}}, "called 'rest'"),
    ({"components": {"c": np.ma.array([1] * 6, mask=[1] + [0] * 5)}}, "masked"),
    ({"labels": {"end": [0, 1, 1]}}, "for 3 states"),
    ({"labels": ["end"]}, "labels are a list"),
    ({"sense": "least"}, "the sense is 'least'"),
    ({"discount": None}, "not a number"),  # with_ leaves the discount as it is
]  # fmt: skip
CHANGES: list[dict[str, Any]] = [
    {"actions": ("a", "a")}, {"actions": ("a",)}, {"space": StateSpace.plain(2)},
    {"space": StateSpace.plain(4)}, {"pair_state": np.arange(6)[::-1] // 2},
    {"pair_state": np.arange(5) // 2},
]  # fmt: skip
CALLS: list[Any] = [
    (lambda: MDP.from_arrays(P, R, states=["a", "b", "c", "d"]), "without action"),
    (lambda: MDP.from_arrays(P, R, states=["a", "b"]), "2 state labels"),
    (lambda: MDP.from_arrays(P, R, actions=["a"]), "action"),
    (lambda: MDP.from_arrays(THIRDS, [0] * 3, layout="xyz"), "'xyz' is not a layout"),
    (lambda: MDP.from_arrays(THIRDS, [0] * 3, layout="sas"), "have shape (2, 3, 3)"),
    *((lambda P=P: MDP.from_arrays(P, [1], layout="ass"), "are not 'ass'")
      for P in ([(0, 0, 0, 1)], {0: {0: {0: 1}}}, {(0, 0): {0: 1}})),
    (lambda: MDP.from_outcomes(ENDS, components=np.ones((2, 2))), "for 0 names"),
    (lambda: MDP.from_arrays(P, R).action("sty"), "unknown action 'sty'"),
    (lambda: solve(MDP.from_arrays(P, R, "1/2"), "value-iteration",
                   start=np.ma.array([1.0, 0, 0], mask=[1, 0, 0])), "masked"),
    (lambda: MDP.from_function(MDP.from_arrays(P, R).start, lambda s: [], lambda s, a: []),
     "goes by numbers"),
    (lambda: MDP.from_function(0, [0], lambda s, a: []), "actions is [0], not a function"),
    (lambda: MDP.from_function(0, lambda s: [0], [(1, 0, 0)]), "outcomes is ["),
    (lambda: MDP.from_function(0, lambda s: [0], lambda s, a: [(1, 0, 0)], max_states="x"),
     "max_states is 'x'"),
    (lambda: MDP.from_function(0, lambda s: [], lambda s, a: [], labels={"x": lambda s: ""}),
     "returns '', not True or"),
    (lambda: MDP.from_arrays(P, R).save("model.txt"), "cannot write a model as"),
    (lambda: MDP.from_arrays(P, R).save("model"), "a file without ending", "",
     "name it .npz, .umb or .json"),
]  # fmt: skip
PAIRS: list[Any] = [  # states, actions, rows, rewards, words
    ([0, 0, 1], [1, 1, 0], [[1, 0], [1, 0], [0, 1]], [0, 0, 0], "appears twice"),
    ([0, -1], [0, 0], EYE, [0, 0], "there is no state -1"),
    ([0, 1], [0, -1], EYE, [0, 0], "there is no action -1"),
    ([0, 0], [0, 1], EYE, [0, 0], "a state without action"),
    ([], [], np.zeros((0, 2)), [], "without state-action pairs"),
    ([0, 1], [0], EYE, [0, 0], "2 states and 1 actions"),
    ([0, 1], [0, 0], EYE[:1], [0, 0], "transitions of shape (1, 2)"),
    ([0, 1], [0, 0], [1.0, 1.0], [0, 0], "transitions of shape (2,)"),
    ([0, 1], [0, 0], EYE, [0], "rewards have shape (1,)"),
    ([0, 1], [False, True], EYE, [0, 0], "pair_action is not a list"),
    ([[0, 1]], [0, 0], EYE, [0, 0], "pair_state is not a list"),
    ([0, 1], [0, 0], [[np.nan, 1], [0, 1]], [0, 0], "a probability is nan"),
    ([0, 1], [0, 0], sp.csr_array(np.diag([1.0, 0])), [0, 0], "sum to 0, not 1"),
    (np.ma.array([0], mask=[1]), [0], [[1]], [0], "masked"),
    *(([0, 1], [0, 0], (sp.csr_array(top), below), [0, 0], "") for top, below in (
        ([[0.5, 0.5], [0.0, 1.0]], [1, 1]), ([[1, 1], [0, 1]], [2]), ([[1, 1], [0, 1]], [2, 0]),
        ([[1, 1], [0, 1]], [0.5, 1.0]), ([[1, 1], [0, 1]], [3, 1]))),
]  # fmt: skip
OUTCOMES: list[Any] = [
    ([], "without state-action pairs"),
    ([(0, 0, [])], "sum to 0, not 1"),
    ([(0, 0, [("1/2", 0, 0)])], "sum to 0.5, not 1"),
    ([(0, 0, [("3/2", 0, 0), ("-1/2", 0, 1)])], "a probability is -0.5"),
    ([(0, 0, [(1, 1, 0)])], "a state without action"),
    ([(0, 0, [(1, 0, 0)]), (2**62, 0, [(1, 0, 0)])], "a state without action"),
    ([(0, 0, [(1, 2**70, 0)])], "right form"),
    ([(0, 0, [(1, -1, 0)])], "there is no next state -1"),
    ([(0, 0, [(1, 0, 0)]), (0, 0, [(1, 0, 1)])], "appears twice"),
    *((rows, "right form") for rows in (
        [(0.0, 0, [(1, 0, 0)])], [(0, 0, [(1, 0.5, 0)])], [(0, 0, [(1, 0)])], [(0, 0)], [7],
        [(0, 0, [(1, 0, 0)]), ("one", 0, [(1, 0, 0)])])),
    ([(0, 0, [("half", 0, 0)])], "not a finite rational"),
    ([(0, 0, [(1, 0, None)])], "not a number"),
    *(([(0, 0, [(1.0, 0, x)])], f"a reward is {x}") for x in (INF, float("nan"))),
    ([(0, 0, [("1/3", 0, np.float32("inf")), ("2/3", 0, "1/3")])], "a reward is inf"),
    ([(0, 0, [(1, 0, 10**400)])], "too large"),
    ([(0, 0, [(0.5, 0, 10**400), (0.5, 0, 0.5)])], "too large for a float"),
    ([(0, 0, [(-(10**400), 0, 0)])], "a probability is -1e400"),
    ([(0, 0, [(10**400, 0, 0)])], "sum to 1e400, not 1"),
]  # fmt: skip
FUNCTIONS: list[Any] = [  # start, actions, outcomes, words
    (0, ["x"], lambda s, a: [(1, s + 1, 0)], "more than 9 states"),
    ([0], [], [], "a state is [0], which cannot be a key"),
    ({}, [], [], "no state to start in"),
    (0, [[1]], [(1, 0, 0)], "an action is [1], which cannot be a key"),
    (0, ["x"], [(1, [0], 0)], "a next state is [0], which cannot be a key"),
    (0, ["x"], [(1, 0)], "an outcome is (1, 0)"),
    (0, ["x"], [(0.9, 0, 0)], "sum to 0.9, not 1"),
    (0, ["x", "x"], [(1, 0, 0)], "a state-action pair appears twice"),
    (0, ["x"], [(float("nan"), 0, 0)], "nan is not a finite rational"),
    (0, lambda s: [0] if s == 0 else [], [(1, 1, 1), (0.5, 2, 9), (-0.5, 2, 9)],
     "a probability is -0.5"),
    (0, 7, [], "the function returns 7, not a list", "state 0"),
    (0, ["x"], None, "returns None"),
    (0, ["go"], 7, "returns 7", "state 0, action go"),
    (0, ["x"], [(5, 1, "x")], ""),
    (0, ["x"], [(1, 1, {"care": "x"})], ""),
]  # fmt: skip
KINDS = {
    "sum to": DistributionError, "not 1": DistributionError,
    "probability is nan": DistributionError, "probability is -": NegativeError,
    "have shape": ShapeError, "entries in a list": ShapeError, "that are not numbers": ShapeError,
}  # fmt: skip


def explored(start: Any, actions: Any, outcomes: Any) -> MDP:
    def asked(answer: Any) -> Any:
        return answer if callable(answer) else lambda *_: answer

    return MDP.from_function(start, asked(actions), asked(outcomes), max_states=9)


BASE = MDP.from_arrays(P, R, 0.9)
REFUSED: list[tuple[Callable[[], Any], list[str]]] = [
    *((call, said) for call, *said in CALLS),
    *((lambda P=P, R=R: MDP.from_arrays(P, R, 0.9), said) for P, R, *said in ARRAYS),
    *((lambda how=how: MDP.from_arrays(P, R, **how), said) for how, *said in OPTIONS),
    *((lambda how=how: BASE.with_(**how), said) for how, *said in OPTIONS[:-1]),
    *((lambda how=how: BASE.with_(**how), []) for how in CHANGES),
    *((lambda pairs=pairs: MDP.from_pairs(*pairs), [what]) for *pairs, what in PAIRS),
    *((lambda rows=rows: MDP.from_outcomes(rows), said) for rows, *said in OUTCOMES),
    *((lambda s=s, a=a, o=o: explored(s, a, o), said) for s, a, o, *said in FUNCTIONS),
]


@pytest.mark.parametrize(("call", "said"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_model_is_refused(call: Callable[[], Any], said: list[str]) -> None:
    kinds = [kind for part, kind in KINDS.items() if part in "".join(said[:1])]
    assert isinstance(refused(call, *said), kinds[0] if kinds else ModelError)


def test_an_error_of_the_users_function_stays_what_it_is() -> None:
    broken = KeyError("mine")

    def fails(*_: Any) -> Any:
        raise broken

    def later(*_: Any) -> Any:
        yield from fails()

    for ask in (fails, later):
        for actions, outcomes, where in ((lambda s: ["go"], ask, ", action go"), (ask, fails, "")):
            with pytest.raises(KeyError) as caught:
                MDP.from_function(0, actions, outcomes)
            assert caught.value is broken
            assert broken.__notes__[-1].endswith(f"for state 0{where}")


TAKES_MODEL = (
    "solve certify evaluate check assert_policy_optimal return_distribution simulate train tradeoff"
    " rationalize curve thresholds tornado one_way two_way gradient robust"
)


@pytest.mark.parametrize("name", TAKES_MODEL.split())
def test_an_option_that_there_is_not_is_refused(name: str) -> None:
    function = getattr(exact_mdp, name)
    care = Scenario.load("yuan2025")
    given = (care, "random") if "policy" in signature(function).parameters else (care,)
    said = "no option gamma=", "", "mdp.with_(discount="
    assert refused(lambda: function(*given, gamma=0.9), *said).where
