"""Policies as their users have them: functions, dictionaries, lists, columns."""

from __future__ import annotations

from collections import defaultdict, namedtuple
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import Rows, models

from exact_mdp import MDP, ModelError, Policy, certify, check, solve

LAKE = MDP.from_gymnasium("FrozenLake-v1", "99/100")
HALL = MDP.from_function(
    (0, "in"), lambda s: ["go", "stay"] if s[0] < 3 else [],
    lambda s, a: [("1/2", (s[0] + (a == "go"), "in"), -1), ("1/2", s, -1)], "9/10",
)  # fmt: skip


@given(st.lists(st.integers(0, 3), min_size=16, max_size=16))
def test_every_form_of_a_policy_over_states(numbers: list[int]) -> None:
    wanted = Policy.of(LAKE, numbers).weights(LAKE)
    names, one_hot = [LAKE.actions[a] for a in numbers], np.eye(4)[numbers]
    seen: defaultdict[int, Any] = defaultdict(lambda: np.zeros(4))
    seen |= {s: 2.5 * one_hot[s] for s in range(16) if numbers[s]}
    rows = len(seen)
    forms = {
        "column": np.array(numbers)[:, None],
        "names": names,
        "function to numbers": lambda s: numbers[s],
        "function to names": lambda s: names[s],
        "function to NumPy numbers": lambda s: np.int64(numbers[s]),
        "function to probabilities": lambda s: {names[s]: 1},
        "function to rows": lambda s: one_hot[s],
        "dictionary": dict(enumerate(numbers)),
        "dictionary by text": {str(s): str(a) for s, a in enumerate(numbers)},
        "dictionary of names": {LAKE.space.label(s): a for s, a in enumerate(names)},
        "dictionary by columns": {(s // 4, s % 4): a for s, a in enumerate(names)},
        "dictionary of rows": {s: list(one_hot[s]) for s in range(16)},
        "defaultdict of rows": seen,
    }
    for name, form in forms.items():
        assert Policy.of(LAKE, form).weights(LAKE).tolist() == wanted.tolist(), name
    assert len(seen) == rows
    within = LAKE.within(3)
    unrolled = Policy.of(within, numbers).weights(within)
    for form in (forms["function to names"], forms["dictionary"]):
        assert Policy.of(within, form).weights(within).tolist() == unrolled.tolist()


def test_a_name_may_begin_as_the_printed_time_does() -> None:
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 0, 0)]), (1, 1, [(1, 0, 1)])]
    mdp = MDP.from_outcomes(rows, states=["time out", "time in"], actions=["x", "y"]).within(2)
    wanted = Policy.of(mdp, [0, 1]).weights(mdp).tolist()
    printed = {mdp.space.label(s): "xy"[s % 2] for s in range(4)}
    for policy in ({"time out": "x", "time in": "y"}, printed):
        assert Policy.of(mdp, policy).weights(mdp).tolist() == wanted


def test_a_function_is_given_the_objects_that_states_are() -> None:
    found = check(HALL, lambda state: "stay" if state == (1, "in") else "go")
    assert [HALL.space.label(each.state) for each in found.disagreements] == ["state (1, 'in')"]
    assert check(HALL, {(0, "in"): "go", (1, "in"): "go", (2, "in"): {"go": 1}}).passed
    assert check(HALL, solve(HALL)).passed


LINES = {
    "number.csv": ("state,action\n", "{s},DOWN\n", "", "policy"),
    "old.csv": ("state,action\n", "{s},1\n", "", "policy"),
    "columns.csv": ("row,column,action\n", "{row},{column},1\n", "", "policy"),
    "rows.json": ('{"0": [0,1,0,0]', ', "{s}": ["1/8", 0.5, "3/8", 0]', "}", "q"),
}


@pytest.mark.parametrize("name", LINES)
def test_a_file_by_state(tmp_path: Path, name: str) -> None:
    first, line, last, read_as = LINES[name]
    lines = (line.format(s=s, row=s // 4, column=s % 4) for s in range("json" in name, 16))
    (tmp_path / name).write_text(first + "".join(lines) + last)
    policy = Policy.of(LAKE, tmp_path / name, kind="q" if read_as == "q" else "auto")
    assert policy.read_as == read_as
    assert (policy.weights(LAKE) == Policy.always(LAKE, "DOWN").weights(LAKE)).all()


def test_rows_may_hold_anything_where_all_actions_are_the_same() -> None:
    """As in ICU-Sepsis: from death and survival the way leads on to the absorbing state."""
    P = np.zeros((4, 2, 4))
    P[0, :, 1:3] = [[0.5, 0.5], [0.25, 0.75]]
    P[1:, :, 3] = 1
    R = np.zeros((4, 2, 4))
    R[:, :, 2] = 1
    mdp = MDP.from_arrays(P, R, start=[1.0, 0, 0, 0])
    assert mdp.indifferent.tolist() == [False, True, True, True]
    table = np.array([[0.5, 0.5], [0, 0], [0, 0], [0, 0]])
    assert Policy.of(mdp, table, kind="policy").weights(mdp)[:2].tolist() == [0.5, 0.5]
    assert check(mdp, table[:, ::-1] * [0, 2]).passed
    with pytest.raises(ModelError, match="not a distribution"):
        Policy.of(mdp, table * 0, kind="policy")


def test_action_values_are_read_where_no_state_has_a_choice_that_matters() -> None:
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [[3, 3], [0, 0]])
    policy = Policy.of(mdp, np.array([[3.0, 2.9], [0, 0]]))
    assert policy.rule.tolist() == [0, 0]
    assert check(mdp, policy).passed


@given(models(discounts=(Fraction(1, 2),)), st.booleans())
def test_states_whose_actions_are_the_same(drawn: Rows, floats: bool) -> None:
    mdp = drawn.model(floats=floats)
    rows = [[mdp.table.row(pair) for pair in mdp.pairs_of(s)] for s in range(mdp.n_states)]
    assert mdp.indifferent.tolist() == [all(row == each[0] for row in each) for each in rows]


BAD: dict[str, tuple[Any, str]] = {
    "nothing": (lambda s: None, "returns None"),
    "no action": (lambda s: "FLY", "unknown action 'FLY'"),
    "no number": (lambda s: 7, "there is no action 7"),
    "short rows": (lambda s: [1, 0], "a row of 2 numbers"),
    "no state": ({99: "DOWN"}, "there is no state 99"),
    "names missing": (["DOWN"] * 3, "rows are missing"),
    "names of more": (["DOWN"] * 17, "17 actions for 16 states"),
    "states missing": ({0: "DOWN"}, "rows are missing"),
    "twice": ({0: "DOWN", "0": "UP"}, "appears twice"),
    "an agent": (SimpleNamespace(predict=lambda s: (0, None), policy=object()), "is an agent"),
    "a table": (pd.DataFrame(np.eye(4)[[0] * 16]), "a DataFrame of pandas"),
    "a series": (pd.Series([0] * 16), "a Series of pandas"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_policy(name: str) -> None:
    form, message = BAD[name]
    with pytest.raises(ModelError) as caught:
        Policy.of(LAKE, form)
    assert message in caught.value.what
    assert "policy" in caught.value.where
    assert caught.value.fix


@pytest.mark.parametrize("form", [lambda s: 0, ["UP"] * 16, {0: 1}])
def test_what_is_no_q_table(form: Any) -> None:
    with pytest.raises(ModelError):
        Policy.of(LAKE, form, kind="q")


def test_an_agent_of_the_environment_itself() -> None:
    """Directions by name are those that the environment moves in."""
    env = gymnasium.make("FrozenLake-v1", is_slippery=False).unwrapped
    mdp = MDP.from_gymnasium(env)
    after = {name: env.P[0][mdp.action(name)][0][1] for name in ("RIGHT", "DOWN", "LEFT", "UP")}
    places = {name: tuple(mdp.space.as_dict(state).values()) for name, state in after.items()}
    assert places == {"RIGHT": ("0", "1"), "DOWN": ("1", "0"), "LEFT": ("0", "0"), "UP": ("0", "0")}


@pytest.mark.parametrize("row", [{0: 0, 1: 1, "0": 1, "1": 0}, {1: "1/2", "1": "1/2"}])
def test_an_action_that_is_named_twice_is_refused(row: dict[Any, Any]) -> None:
    """The last one counted, without a word."""
    mdp = MDP.from_arrays([np.eye(1)] * 2, [[0, 1]], "1/2")
    with pytest.raises(ModelError, match="appears twice"):
        Policy.of(mdp, {0: row})


def test_integers_are_names_in_records() -> None:
    rows = [(0, 5, "a", 1, 7), (0, 7, "b", 1, 5), (0, 5, "b", 0, 5), (0, 5, "a", 1, 7),
            (0, 7, "a", 0, 5)]  # fmt: skip
    columns = ["episode", "state", "action", "reward", "next_state"]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=columns), "1/2")
    for form in (
        {5: "a", 7: "b"},
        {5: "a", 7: "b"}.__getitem__,
        defaultdict(lambda: "b", {5: "a"}),
    ):
        assert check(mdp, form).passed
    with pytest.raises(ModelError, match="not a state"):
        check(mdp, {0: "a", 1: "b"})


def test_ones_of_costs_are_ambiguous() -> None:
    costs = MDP.from_arrays(
        [[[1, 0], [0, 1]]] * 2, [[1, 2], [1, 2]], discount="1/2", sense="min", layout="ass"
    )
    rows = [[1, 0], [1, 0]]
    for form in (rows, dict(enumerate(rows)), rows.__getitem__):
        with pytest.raises(ModelError, match="differ"):
            check(costs, form)
        assert check(costs, form, kind="policy").passed
        assert not check(costs, form, kind="q").passed


def test_masked_answers_are_none() -> None:
    masked = np.ma.array([1], mask=[True])
    for form in (lambda s: np.ma.masked, lambda s: masked[0]):
        with pytest.raises(ModelError, match="masked"):
            Policy.of(LAKE, form)
    assert Policy.of(LAKE, lambda s: np.array(1)).tolist() == Policy.of(LAKE, lambda s: 1).tolist()


PERMUTED = MDP.from_arrays([np.eye(4)] * 2, [[1, 0]] * 4, "1/2", states=["3", "1", "2", "0"])


def test_one_rule_for_names_that_are_numbers_of_others() -> None:
    """States named 3, 1, 2, 0: what fits both readings and differs is refused, both named."""
    both = "may be state 3, by its name, or state 0, number 3 in the model's order"
    for bad in (3, {3: 1}, np.int64(3), 3.0, {"1": "1/2", 3: "1/2"}):
        with pytest.raises(ModelError, match=both) as caught:
            PERMUTED.with_(start=bad)
        assert 'write "state 3" or "state 0"' in caught.value.fix
    for good in ("3", "state 3", {"3": 1}, [1, 0, 0, 0], None):
        assert PERMUTED.with_(start=good).start == ((0, 1),)
    assert PERMUTED.with_(start=1).start == ((1, 1),)  # both readings are the same
    rising = {0: "0", 1: "1", 2: "1", 3: "1"}
    for form in (rising, rising.get):
        with pytest.raises(ModelError, match="by its name, or"):
            Policy.of(PERMUTED, form)
    for form in (dict.fromkeys(range(4), "1"), lambda s: "1"):
        assert Policy.of(PERMUTED, form).tolist() == [1] * 4
    named = {"3": "1", "1": "1", "2": "1", "0": "0"}
    assert Policy.of(PERMUTED, named).tolist() == [1, 1, 1, 0]


@pytest.mark.parametrize("ending", [".csv", ".json"])
def test_files_of_names_that_are_numbers_of_others(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"p{ending}"
    Policy.of(PERMUTED, [1, 1, 0, 0]).write(path)
    assert "state 3" in path.read_text()
    assert Policy.of(PERMUTED, path).tolist() == [1, 1, 0, 0]
    path.write_text(path.read_text().replace("state ", ""))
    with pytest.raises(ModelError, match="by its name, or"):
        Policy.of(PERMUTED, path)


def test_numbers_of_actions_are_names_or_numbers_alone() -> None:
    """Of actions 1, 2, 3 a policy by numbers from 0 was read half by name, half by number."""
    best, after = {"x": 2, "y": 1}, {"x": "y", "y": "z"}
    mdp = MDP.from_function(
        "x", lambda s: [1, 2, 3] if s in after else [],
        lambda s, a: [(1, after[s], int(a == best[s]))],
    )  # fmt: skip
    assert check(mdp, best).passed
    assert check(mdp, best.get).passed
    for wrong in ({"x": 2, "y": 0}, {"x": 1, "y": 0}):
        with pytest.raises(ModelError, match="0 is not an action"):
            check(mdp, wrong)
    for either in ([2, 1, 1], np.array([2, 1, 1])):
        with pytest.raises(ModelError, match="by its name, or"):
            check(mdp, either)
    assert check(mdp, Policy.from_choices(mdp, [1, 0, 0])).passed


def test_a_certificate_of_another_model_goes_by_names() -> None:
    P, R = [[[1, 0], [0, 1]]] * 2, [[1, 0], [0, 1]]
    one = MDP.from_arrays(P, R, "1/2", actions=["l", "r"], states=["x", "y"], layout="ass")
    turned = MDP.from_arrays(P[::-1], np.array(R)[:, ::-1], "1/2", actions=["r", "l"],
                             states=["x", "y"], layout="ass")  # fmt: skip
    renamed = one.with_(actions=("r", "l"))
    other = MDP.from_arrays(P, R, "1/2", actions=["l", "r"], states=["y", "x"], layout="ass")
    for found in (solve(one), certify(one)):
        assert check(turned, found).passed
        assert not check(renamed, found).passed
        with pytest.raises(ModelError, match="have other names here"):
            check(other, found)


def walk(acts: list[Any], best: list[Any], states: list[Any]) -> MDP:
    """The states in a row; the best action of each earns 1."""
    after, right = dict(pairwise(states)), dict(zip(states, best, strict=False))

    def outcomes(state: Any, action: Any) -> list[tuple[int, Any, int]]:
        return [(1, after[state], int(action == right[state]))]

    return MDP.from_function(states[0], lambda s: acts if s in after else [], outcomes)


@pytest.mark.parametrize("loaded", [False, True])
def test_text_of_digits_stays_text(tmp_path: Path, loaded: bool) -> None:
    mdp = walk(["0", "1"], ["1", "0", "1"], ["0", "1", "2", "3"])
    if loaded:
        mdp.save(tmp_path / "m.npz")
        mdp = MDP.load(tmp_path / "m.npz")
    asked: list[Any] = []
    assert check(mdp, lambda s: asked.append(s) or ("0" if s == "1" else "1")).passed
    assert asked == ["0", "1", "2"]
    assert not check(mdp, lambda s: "1" if s == "1" else "0").passed


def test_truth_is_what_it_equals() -> None:
    mdp = walk([True, False], [True, False], [0, 1, 2])
    assert mdp.actions == ("False", "True")
    for policy in ({0: 1, 1: 0}, lambda s: int(s == 0), [True, False, False], [1, 0, 0],
                   np.array([True, False, False]), {0: np.True_, 1: "False"}):  # fmt: skip
        assert check(mdp, policy).passed
    assert not check(mdp, {0: 0, 1: 1}).passed
    listed = MDP.from_outcomes(
        [(s, a, [(1, 1, int(a == s))]) for s in (0, 1) for a in (0, 1)],
        "1/2", actions=["True", "False"],
    )  # fmt: skip
    with pytest.raises(ModelError, match="may be action False, by its name, or action True"):
        Policy.of(listed, {0: 0, 1: 1})


def test_what_equals_an_object_is_that_and_what_may_be_a_row_is_refused() -> None:
    mdp = walk([(0, 1), (1, 0)], [(1, 0), (0, 1)], [0, 1, 2])
    right = {0: (1.0, 0.0), 1: (0.0, 1.0)}
    for policy in (right, right | {1: (0, 1)}, [(1, 0), (0, 1), (0, 1)]):
        assert check(mdp, policy).passed
    for make in (list, np.array):
        with pytest.raises(ModelError, match=r"or a row of numbers for all actions, which differ"):
            Policy.of(mdp, {0: make((1, 0)), 1: make((0.0, 1.0))})
        costs = mdp.with_(sense="min")
        with pytest.raises(ModelError, match=r"or a row of numbers for all actions, which differ"):
            Policy.of(costs, {0: make((1, 0)), 1: make((0, 1))})
        rows = {0: make((0, 1)), 1: make((1, 0))}
        assert check(mdp, Policy.of(mdp, rows, kind="policy")).passed
        half = Policy.of(mdp, {0: make((0.5, 0.5)), 1: make((1, 0))}, kind="policy")
        assert half.weights(mdp).tolist() == [0.5, 0.5, 1, 0, 1]
    three = walk([(0, 1), (1, 0), (1, 1)], [(1, 0), (0, 1)], [0, 1, 2])
    assert check(three, lambda s: np.array([1, 0]) if s == 0 else np.array([0, 1])).passed


@given(st.permutations(range(16)))
def test_named_levels_of_a_start_stand_in_any_order(order: list[int]) -> None:
    index = pd.MultiIndex.from_tuples([divmod(s, 4) for s in order], names=["row", "column"])
    start = pd.Series([s / 120 for s in order], index)
    wanted = LAKE.with_(start=np.arange(16) / 120).start
    turned = start.reorder_levels(["column", "row"])
    for each in (start, turned, start.set_axis(index.set_names([None, None]))):
        assert LAKE.with_(start=each).start == wanted
    for names in (["x", "y"], ["row", None], [None, "row"]):
        with pytest.raises(ModelError, match="levels of the index are"):
            LAKE.with_(start=start.set_axis(index.set_names(names)))


def test_levels_are_the_fields_of_named_tuples() -> None:
    cell = namedtuple("cell", "x y")
    mdp = walk(["l", "r"], ["l", "r", "l"], [cell(0, 1), cell(1, 0), cell(1, 1)])
    index = pd.MultiIndex.from_tuples([(0, 1), (1, 0)], names=["y", "x"])
    assert mdp.with_(start=pd.Series(["1/4", "3/4"], index)).start == ((0, 3 / 4), (1, 1 / 4))


def test_arrays_follow_the_rule_for_numbers_that_are_names() -> None:
    mdp = MDP.from_arrays(
        [np.eye(4)] * 2, [[1, 0], [0, 1]] * 2, "1/2", states=["3", "5", "7", "1"],
        actions=["2", "1"],
    )  # fmt: skip
    assert check(mdp, np.eye(2)[[0, 1, 0, 1]] * 2.5).passed
    for array in (np.array([2, 1, 2, 1]), [2, 1, 2, 1]):
        with pytest.raises(ModelError, match="2 is the name of an action, but the numbers of"):
            Policy.of(mdp, array)
