"""Q-tables as they are saved: text, JSON and NumPy files, dictionaries, tables over a whole grid.

Each form is read as the array itself, or refused where it may mean two things.
"""

import json
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from refusal_tables import of_file, refused

from exact_mdp import MDP, Policy

LAKE = MDP.from_gymnasium("FrozenLake-v1", "99/100")
Q = np.random.default_rng(0).normal(size=(16, 4))
BEST, WORST = (Policy.of(LAKE, table, kind="q").choices(LAKE).tolist() for table in (Q, -Q))
FRAME = pd.DataFrame(Q, columns=LAKE.actions)
ROWS = [",".join(map(str, row)) for row in Q.tolist()]


def read(model: MDP, path: object, kind: str = "auto") -> np.ndarray:
    policy = Policy.of(model, path, kind=kind)
    assert policy.read_as == "q"
    return policy.choices(model)


@pytest.mark.parametrize("sign", [",", ";", "\t", " "])
@pytest.mark.parametrize("header", ["none", "numbers", "names", "other order"])
@pytest.mark.parametrize("index", ["none", "numbers", "other order", "cells"])
def test_text_files_with_and_without_headers(
    tmp_path: Path, sign: str, header: str, index: str
) -> None:
    frame = FRAME.copy()
    if header == "numbers":
        frame.columns = range(4)
    if header == "other order":
        frame = frame[["UP", "LEFT", "RIGHT", "DOWN"]]
    if index == "other order":
        frame = frame.iloc[::-1]
    if index == "cells":
        frame.index = [f"({s // 4},{s % 4})" for s in range(16)]
    options: Any = {"header": header != "none", "index": index != "none", "sep": sign}
    if sign == " ":
        options["index_label"] = "state"
    path = tmp_path / ("q.txt" if sign == " " else "q.csv")
    frame.to_csv(path, **options)
    assert read(LAKE, path).tolist() == BEST


@pytest.mark.parametrize("heads", ["s,a,value", "state,action,q", "Action,Q_value,State"])
@pytest.mark.parametrize("named", [False, True])
def test_long_text_files(tmp_path: Path, heads: str, named: bool) -> None:
    """A line for each state and action, in any order."""
    lines = []
    for s, a in reversed(PAIRS):
        action = LAKE.actions[a] if named else str(a)
        line = [str(s), action, str(Q[s, a])]
        lines.append(",".join(line if heads[0] == "s" else [line[1], line[2], line[0]]))
    path = tmp_path / "q.csv"
    path.write_text("\n".join([heads, *lines]), "utf-8")
    assert read(LAKE, path).tolist() == BEST
    for changed, said in (
        ([heads, *lines[:-1]], "there is no value for LEFT"),
        ([heads, *lines, lines[-1]], "appears twice"),
        ([heads, *lines[:-4]], "1 of 16 rows are missing"),
        ([heads, lines[0].replace("15", "16"), *lines[1:]], "there is no state 16"),
        (["state,action,worth", "0,LEFT,1"], "unknown column 'worth'"),
        (["state,action,q,extra", "0,LEFT,1,1"], "unknown column 'q'"),
    ):
        path.write_text("\n".join(changed), "utf-8")
        error = refused(lambda: read(LAKE, path), said)
    assert "state,action,q is a Q-table" in error.fix


def test_columns_of_a_header_of_numbers_in_another_order(tmp_path: Path) -> None:
    path = tmp_path / "q.csv"
    for order in ([3, 1, 0, 2], [0, 1, 2, 3], [1, 2, 3, 0]):
        pd.DataFrame(Q[:, order], columns=order).to_csv(path)
        assert read(LAKE, path).tolist() == BEST
    # Names that are numbers, but no positions.
    doses = MDP.from_arrays(np.eye(16)[[0] * 16][np.newaxis].repeat(4, 0), Q, "1/2")
    doses = doses.with_(actions=("30", "10", "20", "40"))
    pd.DataFrame(Q[:, [1, 2, 0, 3]], columns=[10, 20, 30, 40]).to_csv(path)
    assert read(doses, path).tolist() == Q.argmax(axis=1).tolist()


def test_files_of_savetxt(tmp_path: Path) -> None:
    path = tmp_path / "q.txt"
    for comment in ("", "alpha 0.1", "trained for\n2000 episodes of 100"):
        np.savetxt(path, Q, header=comment)
        assert read(LAKE, path).tolist() == BEST
    np.savetxt(path, Q[:, ::-1], header=" ".join(LAKE.actions[::-1]))
    assert read(LAKE, path).tolist() == BEST
    np.savetxt(path, Q.argmax(axis=1), fmt="%d")
    (tmp_path / "p.json").write_text(json.dumps(Q.argmax(axis=1).tolist()), "utf-8")
    np.savetxt(tmp_path / "f.txt", Q.argmax(axis=1))  # as 3.000000000000000000e+00
    np.savetxt(tmp_path / "f.csv", Q.argmax(axis=1), fmt="%.1f")
    for file in (path, tmp_path / "p.json", tmp_path / "f.txt", tmp_path / "f.csv"):
        policy = Policy.of(LAKE, file)
        assert (policy.read_as, policy.choices(LAKE).tolist()) == ("policy", BEST)


PAIRS = [(s, a) for s in range(16) for a in range(4)]
JSON: list[Any] = [
    Q.tolist(),
    {"q_table": Q.tolist(), "epsilon": 0.1, "returns": [1, 2]},
    {"agent": {"q": Q.tolist()}},
    {s: Q[s].tolist() for s in range(16)},
    {str((s // 4, s % 4)): Q[s].tolist() for s in range(16)},
    {f"(np.int64({s // 4}), np.int64({s % 4}))": Q[s].tolist() for s in range(16)},
    {s: {a: Q[s, a] for a in range(4)} for s in range(16)},
    {s: {name: Q[s, a] for a, name in enumerate(LAKE.actions)} for s in range(16)},
    {str(pair): Q[pair] for pair in PAIRS},
]


@pytest.mark.parametrize("content", JSON, ids=range(len(JSON)))
def test_json_files(tmp_path: Path, content: Any) -> None:
    (path := tmp_path / "q.json").write_text(json.dumps(content), "utf-8")
    assert read(LAKE, path).tolist() == BEST


def test_dictionaries_are_read_without_kind() -> None:
    forms = [
        {s: {a: Q[s, a] for a in range(4)} for s in range(16)},
        {(s, a): Q[s, a] for s, a in PAIRS},
        {(s, LAKE.actions[a]): Q[s, a] for s, a in PAIRS},
    ]
    for form in forms:
        assert read(LAKE, form).tolist() == BEST
    # Numbers from 0 to 1 may be probabilities with a mistake.
    inside = {s: dict.fromkeys(range(4), 0.3) for s in range(16)}
    refused(lambda: Policy.of(LAKE, inside), "not a distribution", "", 'kind="q"')
    assert read(LAKE, inside, "q").tolist() == [0] * 16


def test_a_part_of_a_file_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "q.npz", first=Q, second=-Q)
    both = {"agent.v1": {"q": Q.tolist()}, "target": (-Q).tolist()}
    (tmp_path / "q.json").write_text(json.dumps(both), "utf-8")
    for file, one, other in (("q.npz", "first", "second"), ("q.json", "agent.v1.q", "target")):
        path = tmp_path / file
        error = refused(lambda path=path: Policy.of(LAKE, path), f"holds {one}, {other}")
        assert error.fix == f"say which: {path}#{one}"
        assert read(LAKE, f"{path}#{one}").tolist() == BEST
        assert read(LAKE, f"{path}#{other}").tolist() == WORST
        refused(lambda path=path: Policy.of(LAKE, f"{path}#third"), "")
    np.savez(tmp_path / "one.npz", q_table=Q)
    refused(lambda: Policy.of(LAKE, f"{tmp_path}/one.npz#q"), "holds q_table")
    done = run("check", "gymnasium:FrozenLake-v1", f"{tmp_path}/q.npz#second", "--kind", "q")
    assert done.status == 1


@pytest.mark.parametrize(
    "form", [Q, {s: Q[s] for s in range(16)}, {(s, a): Q[s, a] for s, a in PAIRS}]
)
def test_a_pickle_is_refused_with_the_code_that_converts_it(tmp_path: Path, form: Any) -> None:
    path = tmp_path / "q.pkl"
    path.write_bytes(pickle.dumps(form))
    error = refused(lambda: Policy.of(LAKE, path), "a pickle is not read")
    assert "in Python" in run("check", "gymnasium:FrozenLake-v1", path, "--kind", "q").err
    code = error.fix.partition("without a kind: ")[2]
    assert "'MODEL'" in code
    exec(code.replace("MODEL", "gymnasium:FrozenLake-v1"), {})
    policy = Policy.of(LAKE, f"{path}.csv")
    assert policy.choices(LAKE).tolist() == BEST


# ---- tables over more states than the model has --------------------------------------------------


def walk(size: tuple[int, ...]) -> MDP:
    """A model of the cells of a grid with even sums, from which a walk goes back to the origin."""

    def step(cell: Any, action: str) -> list[Any]:
        axis = "xyz".index(action)
        then = [*cell]
        then[axis] = max(then[axis] - 2, 0)
        return [(1, tuple(then), -1)]

    corner = tuple(length - 1 for length in size)
    actions = "xyz"[: len(size)]
    return MDP.from_function(corner, lambda cell: list(actions) if any(cell) else [], step, 0.9)


@settings(max_examples=25)
@given(st.lists(st.integers(3, 6), min_size=2, max_size=3), st.randoms())
def test_a_table_over_the_grid_fits_a_model_of_its_reachable_cells(
    size: list[int], draw: Any
) -> None:
    model, n = walk(tuple(size)), len(size)
    table = np.array([draw.gauss(0, 9) for _ in range(int(np.prod(size)) * n)]).reshape(*size, n)
    cells = [*np.ndindex(*size)]
    wanted = [int(table[cell].argmax()) for cell in cells if model.space.lookup.can_find(cell)]
    for form in (table, {cell: table[cell] for cell in cells}):
        with pytest.warns(UserWarning, match="rows are not read: their states are not in"):
            policy = Policy.of(model, form)
        own = {model.space.number(c): a for c, a in zip(
            [c for c in cells if model.space.lookup.can_find(c)], wanted, strict=True)}  # fmt: skip
        chosen = policy.choices(model)
        for state, action in own.items():
            assert model.forced[state] or chosen[state] == action


def test_rows_that_are_not_reached_are_named(tmp_path: Path) -> None:
    model = MDP.from_function(
        5, lambda s: ["a", "b"] if s else [], lambda s, a: [(1, {5: 2, 2: 0}[s], -1)], 0.9
    )
    table = np.array([[0, 1], [9, 9], [2, 1], [9, 9], [9, 9], [0, 7]], float)
    pd.DataFrame(table).to_csv(tmp_path / "q.csv")
    (tmp_path / "q.json").write_text(json.dumps(table.tolist()), "utf-8")
    forms: list[Any] = [table, dict(enumerate(table)), tmp_path / "q.csv", tmp_path / "q.json"]
    for form in forms:
        with pytest.warns(UserWarning, match="3 of 6 rows are not read: .*: 1, 3, 4$") as told:
            policy = Policy.of(model, form)
        assert told[0].filename == __file__
        labels = map(model.space.label, range(3))
        chosen = dict(zip(labels, policy.choices(model).tolist(), strict=True))
        assert chosen | {"state 0": 0} == {"state 5": 1, "state 2": 0, "state 0": 0}
    # A state that the table lacks is missing as before.
    refused(lambda: Policy.of(model, table[:5]), "not a policy")
    # Without all states of the model the numbers may also count its states.
    refused(lambda: Policy.of(model, {2: [1.5, 2], 9: [1, 2]}), "9 is not a state")
    words = MDP.from_function("1", lambda s: ["a", "b"] if s == "1" else [],
                              lambda s, a: [(1, "3", 1)], 0.9)  # fmt: skip
    refused(lambda: Policy.of(words, {0: "a", 1: "b"}), "0 is not a state")


@pytest.mark.parametrize("horizon", [None, 9])
@pytest.mark.parametrize("cells", [True, False])
def test_forms_over_all_states_are_read_with_and_without_a_horizon(
    cells: bool, horizon: int | None
) -> None:
    def name(row: int, column: int) -> Any:
        return (row, column) if cells else 3 * row + column

    def go(state: Any, action: int) -> list[Any]:
        row, column = state if cells else divmod(state, 3)
        to = (min(1, row + 1), column) if action else (row, min(2, column + 1))
        return [(1, "out" if to == (1, 2) else name(*(to if to != (0, 1) else (row, column))), -1)]

    corner = name(0, 0)
    model = MDP.from_function(corner, lambda s: [] if s == "out" else [0, 1], go, 0.9)
    asked = model if horizon is None else model.within(horizon)
    grid = [name(row, column) for row in range(2) for column in range(3)]
    table = np.random.default_rng(1).normal(size=(2, 3, 2))
    if not cells:
        table = table.reshape(6, 2)
    q = {state: table[state] for state in grid}
    best = {state: int(q[state].argmax()) for state in grid}
    wanted = Policy.of(model, {s: a for s, a in best.items() if model.space.lookup.can_find(s)})
    pairs = {(state, a): q[state][a] for state in grid for a in (0, 1)}
    for form in (table, q, pairs, table.argmax(-1), best):
        with pytest.warns(UserWarning, match="3 of 6 rows are not read"):
            policy = Policy.of(asked, form)
        assert policy.space == (asked.space.untimed or asked.space)
        assert policy.choices(model).tolist() == wanted.choices(model).tolist()


def test_pairs_of_numbers_are_read_with_a_horizon() -> None:
    model = MDP.from_arrays([np.eye(3)] * 2, [[0, 1], [1, 0], [2, 0]], 0.9)
    q = {(state, a): a - state * 0.75 * a for state in range(3) for a in (0, 1)}
    assert Policy.of(model.within(5), q).rule.tolist() == [1, 1, 0]
    by_time = {(time, state): int(time == 1) for time in range(5) for state in range(3)}
    assert Policy.of(model.within(5), by_time).rule.tolist()[:9] == [0] * 3 + [1] * 3 + [0] * 3


def test_a_table_by_names_or_by_order_is_refused() -> None:
    """States 0, 3, 1, end in this order: row 1 is of state 1, or of the second state."""
    follow: dict[int, Any] = {0: 3, 3: 1, 1: "end"}
    model = MDP.from_function(
        0, lambda s: ["a", "b"] if s in follow else [], lambda s, a: [(1, follow[s], s)], 0.9
    )
    table = np.array([[0.5, 1], [2, 0], [9, 0], [0, 3]])
    said = "row 1 may be of state 1, by its name, or of state 3", "", "{state: row}"
    for asked in (model, model.within(4)):
        refused(lambda asked=asked: Policy.of(asked, table), *said)  # type: ignore[misc]
        assert Policy.of(asked, [1, 0, 1, 0]).rule.tolist() == [1, 0, 1, 0]  # by order
    with pytest.warns(UserWarning, match="1 of 4 rows are not read"):
        chosen = Policy.of(model, dict(enumerate(table))).choices(model)
    assert chosen.tolist() == [1, 1, 0, 0]


def test_states_that_count_from_0_are_rows_also_beside_an_end() -> None:
    """Found in the order 0, 2, 1, end: each number is its own row."""
    follow: dict[int, Any] = {0: 2, 2: 1, 1: "end"}
    model = MDP.from_function(
        0, lambda s: ["a", "b"] if s in follow else [], lambda s, a: [(1, follow[s], s)], 0.9
    )
    assert model.space.labels(range(4)) == ["state 0", "state 1", "state 2", "state end"]
    table = np.array([[0.5, 1], [2, 0], [0, 3], [0, 0]])
    for form in (table, table.argmax(1)):
        assert Policy.of(model, form).choices(model).tolist() == [1, 0, 1, 0]


# ---- what could mean two things ------------------------------------------------------------------

END = MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])])
COUNTED = "\n".join(f"{s},1.5,2.5,3.5" for s in range(16))
REFUSED = [
    ("q.csv", COUNTED, "the first column counts 0, 1, 2"),
    ("q.csv", "\n".join([*ROWS[:3], "1,2,x,4"]), "'x' is not a finite rational"),
    ("q.csv", "\n".join(["LEFT,DOWN,LEFT,UP", *ROWS]), "appears twice"),
    ("q.csv", "\n".join(["LEFT,DOWN,TOP,UP", *ROWS]), "unknown action 'TOP'"),
    ("q.csv", "\n".join(ROWS[:15]), "shape (15, 4)"),
    ("q.csv", "state,LEFT,DOWN,RIGHT,UP\n" + "\n".join(f"1,{row}" for row in ROWS), "twice"),
    ("q.csv", "state,LEFT,DOWN,RIGHT,UP\n" + f"0,{ROWS[0]}", "10 of 16 rows are missing"),
    ("q.csv", "LEFT,DOWN,RIGHT,UP\n", "no rows"),
    ("q.csv", ";LEFT;DOWN\n0;0,5;1,5\n", "'0,5' is not a finite rational"),
    ("q.csv", "1,2\n3\n", "1 values under 2 headings"),
    ("q.txt", "", "the header is ''"),
    ("q.txt", "# nothing", "no rows"),
    ("q.json", "[[1, 2], [3]]", "real numbers only"),
    ("q.json", '[["a"]]', "'a' is not a finite rational"),
    ("q.json", "[[[1, 2]]]", "shape (1, 1, 2)"),
]


@pytest.mark.parametrize("case", REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_table(case: tuple[str, str, str]) -> None:
    name, text, said = case
    refused(lambda: of_file(name, text, lambda path: Policy.of(LAKE, path)), said)


def test_a_first_line_that_may_number_the_actions_or_hold_values() -> None:
    """The end of this model needs no row, so two lines may be two rows, or one below a header."""
    model = MDP.from_gymnasium({0: {0: [(1, 0, 1, True)], 1: [(1, 0, 2, True)]}}, start=0)
    assert model.space.extra
    refused(
        lambda: of_file("q.csv", "0,1\n5,3\n", lambda path: Policy.of(model, path)),
        "the first line is 0,1: it may number the actions, or hold values",
    )
    named = of_file("q.csv", ",0,1\n0,5,3\n", lambda path: Policy.of(model, path))
    assert named.choices(model)[0] == 0


def test_nothing_is_rounded(tmp_path: Path) -> None:
    """Two values that are the same float differ in their last decimals."""
    text = re.sub(r"[^,]+,[^,]+$", "0.30000000000000000001,0.3", ROWS[0])
    (tmp_path / "q.csv").write_text("\n".join(["-9,-9,0.3,0.30000000000000000001", *ROWS[1:]]))
    assert text
    assert read(LAKE, tmp_path / "q.csv")[0] == 3
