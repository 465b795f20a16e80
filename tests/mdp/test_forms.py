"""Models as others write them are the same models: layouts, lists, dictionaries, functions."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from model_contents import laws
from strategies import Rows, models

from exact_mdp import (
    MDP,
    DistributionError,
    ModelError,
    NegativeError,
    Policy,
    ShapeError,
    certify,
    solve,
)

HALF = Fraction(1, 2)


@st.composite
def arrays(draw: st.DrawFn) -> tuple[Any, Any, Any]:
    """Transitions (A, S, S) in 64ths, rewards (S, A) in quarters, and which pairs are offered."""
    actions, states = draw(st.sampled_from([(1, 3), (2, 3), (3, 2), (2, 2), (4, 1)]))
    seed = draw(st.integers(0, 2**32))
    rng = np.random.default_rng(seed)
    P = rng.multinomial(64, np.full(states, 1 / states), size=(actions, states)) / 64
    offered = rng.random((states, actions)) < 0.7
    offered[np.arange(states), rng.integers(actions, size=states)] = True
    offered[rng.integers(states), -1] = True  # what shows how many actions there are
    # No reward is whole: none is taken for a state or an action.
    return P, rng.integers(-8, 8, (states, actions)) / 4 + 1 / 8, offered


@given(arrays())
def test_every_form_is_the_same_model(given: tuple[Any, Any, Any]) -> None:
    """P and R as in QuantEcon, pymdptoolbox, mdpsolver and AI-Toolbox, against one row a pair."""
    P, R, offered = given
    actions, states = P.shape[:2]
    sas = P.transpose(1, 0, 2)
    state, action = np.nonzero(offered)
    rows, gains = sas[offered], R[offered]
    wanted = laws(MDP.from_pairs(state, action, rows, gains, HALF))
    missing = np.where(offered, R, -np.inf)
    nonsense = np.where(offered[:, :, None], sas, 7.0)
    by_move = np.repeat(missing[:, :, None], states, axis=2)
    pairs = list(zip(state.tolist(), action.tolist(), strict=True))
    nested = [
        [sas[s, a].tolist() if offered[s, a] else None for a in range(actions)]
        for s in range(states)
    ]
    named = {s: {a: dict(enumerate(sas[s, a])) for t, a in pairs if t == s} for s in range(states)}
    quadruples = [(s, a, t, sas[s, a, t]) for s, a in pairs for t in range(states)]
    order = np.random.default_rng(0).permutation(states * actions)
    every_state, every_action = np.divmod(order, actions)
    forms: list[MDP] = [
        MDP.from_arrays(nonsense, missing, HALF, layout="sas"),
        MDP.from_arrays(nonsense.transpose(1, 0, 2), missing, HALF, layout="ass"),
        MDP.from_arrays(nonsense, by_move, HALF, layout="sas"),
        MDP.from_arrays(nonsense.astype(object), missing.astype(object), HALF, layout="sas"),
        MDP.from_arrays([sp.csr_array(x) for x in nonsense], missing, HALF, layout="sas"),
        MDP.from_arrays(nested, missing.tolist(), HALF, layout="sas"),
        MDP.from_arrays(named, {s: {a: R[s, a] for a in named[s]} for s in named}, HALF),
        MDP.from_arrays({(s, a): named[s][a] for s, a in pairs}, R, HALF),
        MDP.from_arrays({(s, a, t): p for s, a, t, p in quadruples}, R, HALF),
        MDP.from_arrays(quadruples, {(s, a): R[s, a] for s, a in pairs}, HALF),
        MDP.from_arrays(np.array(quadruples), missing, HALF),
        MDP.from_arrays(quadruples, by_move, HALF),
        MDP.from_pairs(
            every_state, every_action, nonsense.reshape(-1, states)[order],
            missing.reshape(-1)[order], HALF,
        ),
    ]  # fmt: skip
    triples = [(s, a, R[s, a]) for s, a in pairs]
    by_outcome = [(s, a, t, R[s, a]) for s, a, t, _ in quadruples]
    for width, listed in ((3, triples), (4, by_outcome), (3, np.array(triples))):
        if (len(listed), width) == (states, actions):
            with pytest.raises(ModelError, match="the rewards may be"):
                MDP.from_arrays(quadruples, listed, HALF)
        else:
            forms.append(MDP.from_arrays(quadruples, listed, HALF))
    if actions != states:
        forms.append(MDP.from_arrays(nonsense, missing, HALF))
        forms.append(MDP.from_arrays([sp.coo_array(x) for x in nonsense], missing, HALF))
    for number, mdp in enumerate(forms):
        assert laws(mdp) == wanted, number
    wrong: list[Any] = [
        np.ones((states + 1, actions)), np.ones((states, actions + 1)), np.ones(states + 1),
        np.ones((states, actions, states + 1)), R[:-1], [*R.tolist(), [1.0]],
        {s: [*R[s], 1.0] for s in range(states)},
        {(s, a): [R[s, a]] * (states + 1) for s, a in pairs},
    ]  # fmt: skip
    for P, R_ in product((named, quadruples, np.array(quadruples)), wrong):
        with pytest.raises(ShapeError) as caught:
            MDP.from_arrays(P, R_, HALF)
        assert caught.value.where.startswith("R")
        assert caught.value.fix
    costs = MDP.from_arrays(named, dict(enumerate(R.max(axis=1))), HALF)
    assert costs.reward.tolist() == R.max(axis=1)[state].tolist()


RAGGED = [[[0.5, 0.5], [0, 1]], [[1, 0]]]
QUADRUPLES = [(0, 0, 1, 1), (0, 1, 0, 1), (1, 0, 1, 1)]
CYCLE = [(0, 0, 1, 1), (1, 1, 2, 1), (2, 2, 0, 1)]


@pytest.mark.parametrize(
    ("P", "R", "kind", "message"),
    [
        (QUADRUPLES, [[1, 2, 99, 98], [3], [55], [66]], ShapeError, "4 entries in a list for 2 st"),
        (QUADRUPLES, [[1, 2, 99], [3]], ShapeError, "3 entries in a list for 2 actions"),
        (QUADRUPLES, [(0, 0, 7), (0, 0, 8), (1, 0, 9)], ShapeError, "for 2 states"),
        (QUADRUPLES, [(0, 0, 7), (0, 1, 8), (1, 1, 9)], ShapeError, "for 2 states"),
        (QUADRUPLES, [(0, 0, 7), (0, 1, 8)], ModelError, "there is no reward"),
        (QUADRUPLES, [(0, 0, 1, 7)], ModelError, "there is no reward"),
        (RAGGED, np.ones((5, 7)), ShapeError, "5 entries in a list for 2 states"),
        (RAGGED, [[1, 2], [3, 4, 5]], ShapeError, "3 entries in a list for 1 or 2 actions"),
        (CYCLE, [(0, 0, 7), (1, 1, 8), (2, 2, 9)], ModelError, "may be triples (s, a, r), or"),
        ({"a": {"go": {"a": 1}}}, {"a": [1]}, ShapeError, "actions that are not numbers"),
        ({"a": {"go": {"a": 1}}}, [1], ShapeError, "states that are not numbers"),
        ({0: {0: {0: 1}}}, {(0, 0): 1, (5, 0): 7}, ModelError, "a reward of state 5"),
    ],
)
def test_no_reward_is_left_out(P: Any, R: Any, kind: type[ModelError], message: str) -> None:
    with pytest.raises(kind) as caught:
        MDP.from_arrays(P, R)
    assert message in caught.value.what
    assert caught.value.where.startswith("R")
    assert caught.value.fix


def test_rows_of_rewards_beside_quadruples() -> None:
    """By names as well; a pair that is not available may be said to be so."""
    inf = float("inf")
    for R in (
        [(0, 0, 7), (0, 1, 8), (1, 0, 9)],
        [(0, 0, 7), (0, 1, 8), (1, 0, 9), (1, 1, -inf)],
        [(0, 0, 1, 7), (0, 1, 0, 8), (1, 0, 1, 9)],
        [[7, 8], [9]],
    ):
        assert MDP.from_arrays(QUADRUPLES, R, HALF).R.tolist() == [[7, 8], [9, -inf]]
    named = MDP.from_arrays(
        [("a", "go", "b", 1), ("b", "go", "a", 1)], [("a", "go", 3), ("b", "go", 4)]
    )
    assert named.reward.tolist() == [3, 4]


def test_sparse_matrices_in_an_array_are_a_list() -> None:
    matrices = np.empty(2, dtype=object)
    matrices[:] = [sp.csr_array(np.eye(2)), sp.csr_array(np.eye(2)[::-1])]
    assert laws(MDP.from_arrays(matrices, matrices)) == laws(
        MDP.from_arrays(list(matrices), list(matrices))
    )


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_single_precision_is_named_where_it_misses_1(kind: type[Any]) -> None:
    P = np.random.default_rng(0).random((1, 9, 9)).astype(kind)
    P /= P.sum(axis=-1, keepdims=True)
    if kind is np.float64:
        assert MDP.from_arrays(P, [0] * 9).n_states == 9
    else:
        with pytest.raises(DistributionError, match=r"single precision(.|\n)*float64 and norm"):
            MDP.from_arrays(P, [0] * 9)
    P[0, 0, 0] += kind(0.2)
    with pytest.raises(DistributionError, match="add the missing outcome"):
        MDP.from_arrays(P, [0] * 9)


def test_the_reward_of_a_pair_is_earned_in_full() -> None:
    """In a dictionary as in an array, where tenths of floats do not sum to 1."""
    tenths = dict.fromkeys(range(10), 0.1)
    mdp = MDP.from_arrays({s: {0: tenths} for s in range(10)}, dict.fromkeys(range(10), 3.0), 0.9)
    assert mdp.reward.tolist() == [3.0] * 10
    assert laws(mdp) == laws(MDP.from_arrays(np.full((1, 10, 10), 0.1), [3.0] * 10, 0.9))


def test_names_stay() -> None:
    mdp = MDP.from_arrays(
        {"<script>": {"$x$": {"b": "1/3", '"': "2/3"}, "go": {"b": 1}}, "b": {}, '"': {}},
        {"<script>": {"$x$": {"b": 1, '"': 0}, "go": {"b": "1/2"}}},
        start="<script>",
    )
    assert mdp.actions == ("$x$", "go")
    assert [mdp.space.label(state) for state in range(3)] == [
        "state <script>",
        "state b",
        'state "',
    ]
    assert certify(mdp).start_value == HALF
    renamed = MDP.from_arrays({"a": {"go": {"a": 1}}}, {"a": 0}, states=["x"], actions=["y"])
    assert (renamed.space.label(0), renamed.actions) == ("state x", ("y",))


class Nameless:
    def __repr__(self) -> str:
        return "one"


BAD: dict[str, tuple[Any, Any, type[ModelError], str]] = {
    "a state without a row": ({0: {0: {1: 1}}}, {0: 1}, ModelError, "a state without action"),
    "no reward": ({0: {0: {0: 1}}}, {}, ModelError, "there is no reward"),
    "a short row": ([[[1.0]], [[0.5, 0.5], [0, 1]]], [0, 0], ShapeError, "different lengths"),
    "a flat dictionary": ({0: 1}, {0: 1}, ModelError, "P has an entry by 0"),
    "a deep one": ({0: {0: {0: {0: 1}}}}, {0: 1}, ModelError, "P has an entry by 0, 0, 0, 0"),
    "a reward by words": ({0: {0: {0: 1}}}, {"a": 1}, ModelError, "R has an entry by 'a'"),
    "a word": ({0: {0: {0: "x"}}}, {0: 1}, ModelError, "not a finite rational"),
    "a sum": ({0: {0: {0: 0.5}}}, {0: 1}, DistributionError, "sum to 0.5, not 1"),
    "a matrix": (np.eye(4), [0] * 4, ModelError, "4 entries in a list for 2 states"),
    "part of a state": ([(0.5, 0, 0, 1)], {0.5: 0}, ModelError, "without action"),
    "two of a name": ({Nameless(): {}, Nameless(): {}}, {}, ModelError, "are both called one"),
    "no hashable": ([(({},), 0, 0, 1)], [0], ModelError, "cannot be a key"),
    "a control character": ({"\x1b": {}}, {}, ModelError, "U+001B"),
    "cube": (np.full((2, 2, 2), 0.4), [0, 0], DistributionError, "sum to 0.8"),
    "one row": ([[[1, 0], [0.4, 0.4]], [[1, 0]] * 2], [0, 0], DistributionError, "sum to 0.8"),
    "layout": (np.full((2, 3, 3), 1 / 3), [0] * 3, ModelError, "'xyz' is not a layout"),
    "other layout": (np.full((2, 3, 3), 1 / 3), [0] * 3, ShapeError, "have shape (2, 3, 3)"),
}
LAYOUT = {"layout": "xyz", "other layout": "sas"}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_model_is_refused(name: str) -> None:
    P, R, kind, message = BAD[name]
    with pytest.raises(kind) as caught:
        MDP.from_arrays(P, R, layout=LAYOUT.get(name))
    assert message in caught.value.what
    assert caught.value.fix
    assert ('layout="sas"' in caught.value.fix) == (name == "one row")


# ---- the start ---------------------------------------------------------------------------------

STARTS = [
    2,
    "2",
    {2: 1},
    {"2": "1/1", 0: 0},
    [0, 0, 1],
    np.array([0.0, 0, 1]),
    (0, 0, 1),
    pd.Series([0, 1.0], [1, 2]),
]


@pytest.mark.parametrize("start", STARTS, ids=str)
def test_a_start_in_any_form(start: Any) -> None:
    eye, rows = np.eye(3), [(s, 0, [(1, s, 0)]) for s in range(3)]
    for mdp in (
        MDP.from_arrays([eye], [0, 0, 0], start=start),
        MDP.from_pairs([0, 1, 2], [0, 0, 0], eye, [0, 0, 0], start=start),
        MDP.from_outcomes(rows, start=start),
        MDP.from_arrays([eye], [0, 0, 0]).with_(start=start),
        MDP.from_gymnasium({s: {0: [(1, s, 0, False)]} for s in range(3)}, start=start),
    ):
        assert mdp.start == ((2, Fraction(1)),)
    listed = [(s, s, "go", 0, s) for s in range(3)]
    names = ["episode", "state", "action", "reward", "next_state"]
    learned = MDP.from_transitions(pd.DataFrame(listed, columns=names), start=start)
    assert learned.start == ((2, Fraction(1)),)
    named = MDP.from_arrays([eye], [0, 0, 0], states=["x", "y", "2 or so"], start="2 or so")
    assert named.start == ((2, 1),)


NO_STARTS = [
    *("x", [1, 0], 3, -1, 0.5, True, {"x": 1}, [0.5, 0.4, 0]),
    *(pd.Series([0.5, 0.5], [1, 1]), pd.Series([1], ["x"])),
]


@pytest.mark.parametrize("start", NO_STARTS, ids=str)
def test_what_is_no_start(start: Any) -> None:
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays([np.eye(3)], [0, 0, 0], start=start)
    assert "start" in caught.value.where
    assert caught.value.fix


# ---- functions -----------------------------------------------------------------------------------


@given(models(discounts=(HALF,)), st.sampled_from([int, str, lambda s: (s, "x")]))
def test_exploring_finds_the_reachable_model(drawn: Rows, name: Callable[[int], Any]) -> None:
    """State by state it is the model that was listed; the optimum from the start is the same."""
    whole = drawn.model()
    back = {name(s): s for s in range(drawn.n_states)}
    of_state: dict[int, dict[str, Any]] = {}
    for s, a, r, following in drawn.pairs:
        of_state.setdefault(s, {})[f"a{a}"] = [(p, name(t), r) for t, p in following.items()]
    asked: list[Any] = []

    def outcomes(state: Any, action: str) -> Any:
        asked.append((state, action))
        return of_state[back[state]][action]

    mdp = MDP.from_function(name(0), lambda s: of_state[back[s]], outcomes, HALF)
    assert len(set(asked)) == len(asked) == mdp.n_pairs

    def number(state: int) -> int:
        return mdp.space.number(name(state))

    assert laws(mdp) == {
        (number(s), f"a{a}"): {(number(t), r): p for (t, r), p in law.items()}
        for (s, a), law in laws(whole).items()
        if (name(s), f"a{a}") in asked
    }
    assert certify(mdp).start_value == certify(whole).start_value


def test_what_exploring_keeps_and_refuses() -> None:
    """Two steps of a die with a start distribution; the ends are states without actions."""

    def actions(state: tuple[int, str]) -> list[str]:
        return [] if state[0] >= 2 else ["roll", "pass"]

    def outcomes(state: tuple[int, str], action: str) -> list[Any]:
        if action == "pass":
            return [(1, (2, state[1]), 0), (0, (99, "never"), 0)]
        return [("1/6", (state[0] + 1, str(face)), face) for face in range(1, 7)]

    start = {(0, "a"): "1/2", (1, "b"): "1/2"}
    mdp = MDP.from_function(start, actions, outcomes, labels={"over": lambda state: state[0] == 2})
    assert mdp.labels["over"].tolist() == mdp.terminal.tolist()
    assert mdp.space.label(mdp.space.number((1, "3"))) == "state (1, '3')"
    assert mdp.n_states == 2 + 6 + 6 + 2
    assert certify(mdp).start_value == HALF * 7 + HALF * Fraction(7, 2)
    assert mdp.with_(start=(1, "3")).start == ((mdp.space.number((1, "3")), 1),)


def test_rewards_by_component() -> None:
    """Amounts by name add up to the reward; what has none of a name has 0 of it."""
    outcomes = [("1/3", "b", {"care": "3/2", "time": -1}), ("2/3", "c", {"time": "-1/2"})]
    mdp = MDP.from_function("a", lambda s: ["go"] if s == "a" else [], lambda s, a: outcomes)
    assert mdp.component_names == ("care", "time")
    amounts = [
        [Fraction(int(x), int(y)) for x, y in zip(*mdp.component(name), strict=True)]
        for name in mdp.component_names
    ]
    assert amounts == [[HALF, 0, 0], [Fraction(-2, 3), 0, 0]]
    assert [r for _, _, r in mdp.table.row(0)] == [HALF, -HALF]
    plain = MDP.from_function(
        "a",
        lambda s: ["go"] if s == "a" else [],
        lambda s, a: [(p, t, sum(Fraction(x) for x in r.values())) for p, t, r in outcomes],
    )
    assert laws(plain) == laws(mdp)
    mixed = MDP.from_function(
        0, lambda s: "x" * (s < 1), lambda s, a: [(0.5, 1, {"x": 0.1}), (0.5, 2, 3)]
    )
    assert mixed.component_names == ("x", "rest")
    assert mixed.components[0].tolist() == [0.05, 1.5]


ENDLESS: dict[str, tuple[Any, Any, Any]] = {
    "more than 9 states": (0, [0], [(1, None, 0)]),
    "a state is [0], which cannot be a key": ([0], [], []),
    "no state to start in": ({}, [], []),
    "an action is [1], which cannot be a key": (0, [[1]], [(1, 0, 0)]),
    "a next state is [0], which cannot be a key": (0, ["x"], [(1, [0], 0)]),
    "an outcome is (1, 0)": (0, ["x"], [(1, 0)]),
    "sum to 0.9, not 1": (0, ["x"], [(0.9, 0, 0)]),
    "a state-action pair appears twice": (0, ["x", "x"], [(1, 0, 0)]),
    "nan is not a finite rational": (0, ["x"], [(float("nan"), 0, 0)]),
}


@pytest.mark.parametrize("message", ENDLESS)
def test_what_cannot_be_explored(message: str) -> None:
    start, actions, outcomes = ENDLESS[message]

    def following(state: Any, action: Any) -> Any:
        return (
            [(p, state + 1 if then is None else then, r) for p, then, r in outcomes]
            if (message.startswith("more"))
            else outcomes
        )

    with pytest.raises(ModelError) as caught:
        MDP.from_function(start, lambda state: actions, following, max_states=9)
    assert message in caught.value.what
    assert caught.value.fix


@pytest.mark.parametrize(
    ("actions", "outcomes", "where"),
    [
        (["go"], None, "state 0, action go"),
        (["go"], 7, "state 0, action go"),
        (["go"], [(5, 1, "x")], "state 0, action go"),
        (["go"], [(1, 1, {"care": "x"})], "state 0, action go"),
        (7, [], "state 0"),
    ],
)
def test_a_wrong_answer_is_of_a_state_and_an_action(
    actions: Any, outcomes: Any, where: str
) -> None:
    with pytest.raises(ModelError) as caught:
        MDP.from_function(0, lambda s: actions, lambda s, a: outcomes)
    assert caught.value.where == where
    assert caught.value.fix


def test_an_error_of_the_users_function_stays_what_it_is() -> None:
    broken = KeyError("mine")

    def fails(*_: Any) -> Any:
        raise broken

    def later(*_: Any) -> Any:
        yield from fails()

    for ask in (fails, later):
        with pytest.raises(KeyError) as caught:
            MDP.from_function(0, lambda s: ["go"], ask)
        assert caught.value is broken
        assert broken.__notes__[-1].endswith("for state 0, action go")
        with pytest.raises(KeyError):
            MDP.from_function(0, ask, fails)
        assert broken.__notes__[-1].endswith("for state 0")


@pytest.mark.parametrize("ending", [".npz", ".umb"])
def test_a_loaded_model_knows_states_by_their_text(tmp_path: Path, ending: str) -> None:
    """Names of a file may be texts of objects; a number may be a name, or is refused."""
    path = tmp_path / f"model{ending}"
    MDP.from_function(
        (0, 0),
        lambda s: ["stay", "go"] if s == (0, 0) else [],
        lambda s, a: [(1, (0, 0) if a == "stay" else (0, 1), 0)],
        HALF,
    ).save(path)
    loaded = MDP.load(path)
    assert loaded.space.number((0, 1)) == loaded.space.number("(0, 1)") == 1
    assert Policy.of(loaded, {(0, 0): "go"}).rule[0] == 1
    assert MDP.load(path, start=(0, 1)).start == loaded.with_(start={(0, 1): 1}).start == ((1, 1),)
    with pytest.raises(ModelError, match="is not a state"):
        loaded.space.number((7, 7))
    tens = MDP.from_arrays([np.eye(2)], [0, 0], states=["10", "20"])
    ones = MDP.from_arrays([np.eye(2)], [0, 0], states=["1", "2"])
    assert (tens.space.number(20), ones.space.number(2), ones.space.number("1")) == (1, 1, 0)
    with pytest.raises(ModelError, match="state 1, by its name, or state 2, number 1 in"):
        ones.space.number(1)


@pytest.mark.parametrize("ending", [".npz", ".umb"])
def test_a_model_is_saved_and_loaded(tmp_path: Path, ending: str) -> None:
    follow = {"$go$": [("1/3", "a<b>", "1/7"), ("2/3", "c", 0)]}
    mdp = MDP.from_function(
        "a<b>", lambda s: follow if s == "a<b>" else None, lambda s, a: follow[a], "9/10"
    )
    mdp.save(tmp_path / f"model{ending}")
    again = MDP.load(tmp_path / f"model{ending}")
    assert laws(again) == laws(mdp)
    assert (again.space, again.actions) == (mdp.space, mdp.actions)
    assert MDP.load(tmp_path / f"model{ending}", discount="1/2").discount_exact == HALF
    with pytest.raises(ModelError, match="cannot write a model as"):
        mdp.save(tmp_path / "model.txt")


# ---- what would be misread ---------------------------------------------------------------------

MASKED = np.ma.array([[5, 1]], mask=[[1, 0]])
ONE = [[[1]], [[1]]]
HIDDEN: dict[str, Callable[[], Any]] = {
    "R": lambda: MDP.from_arrays(ONE, MASKED, HALF),
    "P": lambda: MDP.from_arrays(np.ma.array(ONE, mask=[[[1]], [[0]]]), [[5, 1]], HALF),
    "a list": lambda: MDP.from_arrays(ONE, [MASKED[0]], HALF),
    "a dictionary": lambda: MDP.from_arrays({0: {0: MASKED[0], 1: [0, 1]}, 1: {}}, {0: 1}, HALF),
    "start": lambda: MDP.from_arrays(ONE, [[5, 1]], start=np.ma.array([1.0], mask=[1])),
    "components": lambda: MDP.from_arrays(ONE, [[5, 1]], components={"c": MASKED}),
    "pairs": lambda: MDP.from_pairs(np.ma.array([0], mask=[1]), [0], [[1]], [0]),
    "values": lambda: solve(
        MDP.from_arrays(ONE, [[5, 1]], HALF), "value-iteration", start=np.ma.array([1.0], mask=[1])
    ),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_what_lies_under_a_mask_is_not_read(name: str) -> None:
    with pytest.raises(ModelError, match="entries of the array are masked") as caught:
        HIDDEN[name]()
    assert "-inf" in caught.value.fix
    whole = np.ma.array([[5, 1]], mask=False)
    assert MDP.from_arrays(ONE, whole, HALF).reward.tolist() == [5, 1]


TWO = {"a": {"x": {"a": 1}, "y": {"a": 1}}, "b": {"x": {"b": 1}}}


@pytest.mark.parametrize(
    ("key", "fix"),
    [
        (("a", "X"), "choose one of x, y"),
        (("a", "x", "A"), "choose one of a, b"),
        (
            ("b", "y"),
            "leave it out, or give -inf or NaN, as of what is not offered; or list the "
            "action in P: choose one of x",
        ),
    ],
)
def test_a_reward_of_what_is_not_there_is_refused(key: tuple[str, ...], fix: str) -> None:
    """It was dropped without a word, so that a typing error changed the model."""
    with pytest.raises(ModelError, match="a reward of the") as caught:
        MDP.from_arrays(TWO, {"a": 1, "b": 1, key: 50}, HALF)
    assert caught.value.fix == fix
    assert caught.value.where == f"R, {', '.join(key)}"


@pytest.mark.parametrize("none", [-np.inf, np.nan, None])
def test_tables_of_rewards_may_say_that_there_is_none(none: float | None) -> None:
    R = {"a": {"x": 1, "y": 2}, "b": {"x": 3, "y": none}}
    assert MDP.from_arrays(TWO, R, HALF).reward.tolist() == [1, 2, 3]
    R["b"]["y"] = 4
    with pytest.raises(ModelError, match="does not offer in state 'b'"):
        MDP.from_arrays(TWO, R, HALF)


def test_rewards_of_what_is_listed_as_unavailable_are_passed_over() -> None:
    P = {"a": {"x": {"a": 1}, "y": None}, "b": {}}
    for R in ({"a": {"x": 1, "y": 5}}, {"a": 1, ("b", "x"): 0}, {"a": 1, ("a", "x", "b"): 7}):
        assert MDP.from_arrays(P, R, HALF).reward.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("names", "what"),
    [
        ({"start": [0.5, 0.4]}, "start probabilities"),
        ({"discount": 2}, "discount"),
        ({"R": [np.inf, 0]}, "reward is inf"),
    ],
)
def test_the_layout_is_named_only_where_it_may_help(names: dict[str, Any], what: str) -> None:
    with pytest.raises(ModelError, match=what) as caught:
        MDP.from_arrays([np.eye(2)] * 2, **({"R": [0, 0]} | names))
    assert "layout" not in caught.value.fix


EXPLORED: dict[str, tuple[Any, Any, Any, str]] = {
    "a list": ([0], lambda s, a: [], 9, r"actions is \[0\], not a function"),
    "a number": (lambda s: 3, lambda s, a: [], 9, "the function returns 3, not a list"),
    "no outcomes": (lambda s: [0], [(1, 0, 0)], 9, "outcomes is .*, not a function"),
    "a word": (lambda s: [0], lambda s, a: [(1, 0, 0)], "x", "max_states is 'x'"),
}


@pytest.mark.parametrize("name", EXPLORED)
def test_arguments_of_another_kind_are_told_what_to_be(name: str) -> None:
    actions, outcomes, most, message = EXPLORED[name]
    with pytest.raises(ModelError, match=message) as caught:
        MDP.from_function(0, actions, outcomes, max_states=most)
    assert caught.value.where
    assert caught.value.fix


EYES = [np.array([[1.0, 0], [1, 0]])] * 2  # the same in both layouts
CANCEL: dict[str, Callable[[], Any]] = {
    "function": lambda: MDP.from_function(
        0, lambda s: [0] if s == 0 else [], lambda s, a: [(1, 1, 1), (0.5, 2, 9), (-0.5, 2, 9)]
    ),
    "quadruples": lambda: MDP.from_arrays([(0, 0, 0, 1.5), (0, 0, 0, -0.5)], [0]),
    "coordinates": lambda: MDP.from_arrays(
        [sp.coo_array(([1.5, -0.5, 1], ([0, 0, 1], [1, 1, 1])), shape=(2, 2))], [0, 0]
    ),
}


@pytest.mark.parametrize("name", CANCEL)
def test_negative_probabilities_are_refused_though_they_cancel(name: str) -> None:
    with pytest.raises(NegativeError, match=r"a probability is -0\.5"):
        CANCEL[name]()


def test_labels_of_tables_are_no_order_of_a_model() -> None:
    """Tables whose labels were in another order were read by position, without a word."""
    R = pd.DataFrame([[1, 2], [3, 4]])
    assert MDP.from_arrays(EYES, R, HALF).reward.tolist() == [1, 2, 3, 4]
    for table in (R.iloc[::-1], R[[1, 0]], R.set_axis(["x", "y"]), pd.Series([1, 2], index=[1, 0])):
        with pytest.raises(ModelError, match="a table has the labels") as caught:
            MDP.from_arrays(EYES, table, HALF)
        assert "to_numpy" in caught.value.fix
    with pytest.raises(ModelError, match="a table has the labels"):
        MDP.from_arrays([R.iloc[::-1] * 0 + 0.5] * 2, [0, 0], HALF)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: MDP.from_arrays(EYES, {(0, 0): 1}), "the rewards are a dictionary"),
        (
            lambda: MDP.from_function(0, lambda s: [], lambda s, a: [], labels={"x": lambda s: ""}),
            "returns '', not True or False",
        ),
    ],
)
def test_what_was_taken_without_a_word(make: Callable[[], Any], what: str) -> None:
    with pytest.raises(ModelError, match=what) as caught:
        make()
    assert caught.value.fix
