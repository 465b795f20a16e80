"""Models from data: counted as a dictionary counts, in chunks of any size; bad rows are named."""

import gzip
from collections import Counter, defaultdict
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import negated
from pyarrow import parquet
from refusal_tables import refused

from exact_mdp import MDP, ModelError, OffPolicy, certify, check, fingerprint, load, save

NAMES = ["episode", "state", "action", "reward", "next_state"]


def table(rows: list[tuple[Any, ...]]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=NAMES)


@st.composite
def records(draw: st.DrawFn) -> list[tuple[Any, ...]]:
    """Episodes over up to four states; the last step may lead nowhere."""
    steps = st.tuples(st.sampled_from("ab"), st.integers(-2, 2), st.integers(0, 3))
    rows: list[tuple[Any, ...]] = []
    for episode in range(draw(st.integers(1, 6))):
        state = draw(st.integers(0, 3))
        for action, tenths, then in draw(st.lists(steps, min_size=1, max_size=5)):
            rows.append((episode, str(state), action, f"{tenths}/10", str(then)))
            state = then
        if draw(st.booleans()):
            rows[-1] = (*rows[-1][:4], None)
    return rows


@given(records(), st.integers(1, 4))
def test_counts_are_those_of_a_dictionary(rows: list[tuple[Any, ...]], size: int) -> None:
    seen: dict[tuple[str, str], Counter[tuple[str, F]]] = defaultdict(Counter)
    starts = Counter({row[0]: row[1] for row in reversed(rows)}.values())
    for _, state, action, reward, then in rows:
        seen[state, action][then or "end", F(reward)] += 1
    frame = table(rows)
    mdp = MDP.from_transitions(
        [frame.iloc[n : n + size] for n in range(0, len(frame), size)], discount="1/2"
    )
    assert mdp.observations is not None
    assert mdp.counts is not None
    pairs = 0
    for pair in range(mdp.n_pairs):
        label = mdp.space.label(int(mdp.pair_state[pair])).removeprefix("state ")
        counts = seen.get((label, mdp.actions[mdp.pair_action[pair]]))
        if counts is None:  # an end
            assert mdp.observations[pair] == 0
            assert mdp.terminal[mdp.pair_state[pair]]
            assert mdp.counts[[pair]].sum() == 0
            continue
        pairs += 1
        total = counts.total()
        assert mdp.observations[pair] == mdp.counts[[pair]].sum() == total
        listed = [
            (mdp.space.label(then).removeprefix("state "), reward, chance)
            for chance, then, reward in mdp.table.row(pair)
        ]
        assert sorted(listed) == sorted((*key, F(n, total)) for key, n in counts.items())
    assert pairs == len(seen)
    estimated_starts = {mdp.space.label(s).removeprefix("state "): p for s, p in mdp.start}
    assert estimated_starts == {s: F(n, starts.total()) for s, n in starts.items()}


def test_a_file_gives_the_same_model_and_keeps_its_decimals(tmp_path: Path) -> None:
    """In a file "0.1" is a tenth; a table of floats holds the dyadic number."""
    rows = [
        (7, "home", "go", 0.1, "away"),
        (7, "away", "stay", 2.0, "away"),
        (8, "home", "go", 0.1, None),
    ]
    table(rows).to_csv(tmp_path / "log.csv", index=False)
    written, estimated = (
        MDP.from_transitions(tmp_path / "log.csv"),
        MDP.from_transitions(table(rows)),
    )
    home = [mdp.pair("home", "go") for mdp in (written, estimated)]
    assert {row[2] for row in written.table.row(home[0])} == {F(1, 10)}
    assert {row[2] for row in estimated.table.row(home[1])} == {F(0.1)}
    assert written.observations.tolist() == estimated.observations.tolist()  # type: ignore[union-attr]
    save(written, tmp_path / "model.npz")
    again = load(tmp_path / "model.npz")
    assert (again.counts != written.counts).nnz == 0
    assert fingerprint(again) == fingerprint(written)
    table(rows).to_parquet(tmp_path / "log.parquet")
    assert fingerprint(MDP.from_transitions(tmp_path / "log.parquet")) == fingerprint(estimated)
    renamed = table(rows).rename(columns={"episode": "stay", "state": "s t"})
    other = MDP.from_transitions(renamed, columns={"episode": "stay", "state": "s t"})
    assert fingerprint(other) == fingerprint(estimated)


def test_numbered_states_stand_in_order() -> None:
    rows = [(1, 10, 1, 0, 9), (1, 9, 0, 0, 2)]
    mdp = MDP.from_transitions(table(rows))
    assert mdp.space.labels(range(3)) == ["state 2", "state 9", "state 10"]
    assert mdp.actions == ("0", "1")
    assert mdp.start == ((2, F(1)),)


def test_other_texts_stay_as_they_are_written() -> None:
    rows = [(1, "007", "v1.0", 0, "1.50"), (2, "7", "1.5", 0, "1.5"), (3, "7.0", "1.5", 0, None)]
    mdp = MDP.from_transitions(table(rows))
    assert set(mdp.space.labels(range(4))) == {"state 007", "state 7", "state 1.5", "state 1.50"}
    assert mdp.actions == ("1.5", "v1.0")


def test_what_nobody_tried_is_left_out_or_worth_what_is_said() -> None:
    rows = [(1, "a", "x", -1, "b"), (2, "b", "y", 3, "a")]
    assert MDP.from_transitions(table(rows)).n_pairs == 2
    low = MDP.from_transitions(table(rows), discount="3/4", unseen="pessimistic")
    assert low.table.row(low.pair(0, "y")) == [(F(1), 2, F(-4))]
    assert low.space.label(2) == "unseen"
    dear = MDP.from_transitions(table(rows), discount="3/4", unseen="pessimistic", sense="min")
    assert dear.table.row(dear.pair(0, "y")) == [(F(1), 2, F(12))]  # costs of 3 for ever
    assert certify(dear).policy[0] == dear.action("x")
    stated = MDP.from_transitions(table(rows), unseen="1/3")
    assert stated.table.row(stated.pair(1, "x")) == [(F(1), 2, F(1, 3))]
    assert stated.observations.tolist() == [1, 0, 0, 1, 0]  # type: ignore[union-attr]
    for unseen in ("pessimistic", "worse"):
        with pytest.raises(ModelError, match=r"discount 1|worse"):
            MDP.from_transitions(table(rows), unseen=unseen)


GOOD = (1, "a", "x", 0, "b")
BAD: dict[str, list[tuple[Any, ...]]] = {
    "gap in an episode": [GOOD, (1, "a", "x", 0, "b")],
    "continues after another": [GOOD, (2, "a", "x", 0, "b"), (1, "b", "x", 0, "b")],
    "no reward": [GOOD, (2, "a", "x", np.nan, "b")],
    "or after the episode was over": [GOOD, (2, "a", "x", 0, None), (2, "b", "x", 0, "a")],
    "the state is ' '": [GOOD, (2, " ", "x", 0, "b")],
    "no action": [GOOD, (2, "a", None, 0, "b")],
    "reward is inf": [GOOD, (2, "a", "x", np.inf, "b")],
    "the state is 'NA'": [GOOD, (2, "NA", "x", 0, "b")],
    "the next state is 'None'": [GOOD, (2, "a", "x", 0, "None")],
    "the episode is 'NULL'": [GOOD, ("NULL", "a", "x", 0, "b")],
    "reward is 'dear'": [GOOD, (2, "a", "x", "dear", "b")],
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_row_is_named(what: str, tmp_path: Path) -> None:
    last = len(BAD[what]) - 1
    refused(lambda: MDP.from_transitions(table(BAD[what])), what, f"transitions, row {last}")
    table(BAD[what]).to_csv(tmp_path / "log.csv", index=False)
    done = run("data", tmp_path / "log.csv", "--out", tmp_path / "m.npz")
    assert f"log.csv, line {last + 2}" in done.refusal()
    assert not (tmp_path / "m.npz").exists()


@pytest.mark.parametrize("blank", ["\n", "\r\n", "\n\n"])
def test_blank_lines_count_among_the_lines(blank: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = f'{",".join(NAMES)}\n1,"a",x,0,b\n{blank}1,b,"x\ny",0,c\n{blank}1,d,x,0,e\n'
    path.write_bytes(rows.encode())
    line = rows[: rows.index("1,d")].count("\n") + 1
    refused(lambda: MDP.from_transitions(path), "a gap in an episode", f"{path}, line {line}")


def test_truth_values_are_no_numbers() -> None:
    """Python takes True for 1: they are two names, in one column as in two."""
    mdp = MDP.from_transitions(table([(1, True, "x", 0, None), (2, 1, "x", 0, None)]))
    assert mdp.space.labels(range(2)) == ["state 1", "state True"]
    mdp = MDP.from_transitions(table([(1, 1, "x", 0, True), (2, 1, "x", 0, True)]))
    assert mdp.space.labels(range(2)) == ["state 1", "state True"]
    estimated = MDP.from_transitions(table([(1, True, "x", 0, False), (2, False, "x", 0, pd.NA)]))
    assert estimated.space.labels(range(3)) == ["state False", "state True", "end"]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_column_that_is_not_used_is_named(ending: str, tmp_path: Path) -> None:
    """It may say how episodes stop."""
    name = "timeout"
    frame, path = table([GOOD]).assign(**{name: True}), tmp_path / f"log.{ending}"
    frame.to_csv(path, index=False) if ending == "csv" else frame.to_parquet(path)
    done = run("data", path, "--out", tmp_path / "m.npz")
    assert done.status == 0
    assert "not used: timeout;" in " ".join(done.err.split())
    words = ("--column", f"truncated={name}", "--json")
    used = run("data", path, "--out", tmp_path / "m.npz", *words)
    assert "not used" not in used.err
    assert used.result["cut_off"] == 1
    assert "truncated=NAME" in " ".join(run("data", "--help").out.split())


def cut(*rows: tuple[Any, ...]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=[*NAMES, "truncated"])


def marked(*rows: tuple[Any, ...], **marks: list[Any]) -> pd.DataFrame:
    return table([*rows]).assign(**marks)


# Two episodes 0 -> 1 -> over; the next state of a last row is the one in which the next begins.
RESET = [(e, s, "go", s, 1 - s) for e in (1, 2) for s in (0, 1)]


@pytest.mark.parametrize("true", [True, 1, "true", 1.0])
def test_a_terminated_row_ends_the_episode_whatever_follows(true: Any, tmp_path: Path) -> None:
    over = [false := "false" if isinstance(true, str) else type(true)(0), true, false, true]
    logs = [marked(*RESET, **marks) for marks in (
        {"terminated": over}, {"terminated": over, "done": over},
        {"terminated": over, "truncated": over}, {"done": over, "truncated": [false] * 4},
    )]  # fmt: skip
    (path := tmp_path / "log.csv").write_text(logs[0].to_csv(index=False), "utf-8")
    models = [*map(MDP.from_transitions, logs), MDP.from_transitions(path)]
    renamed = logs[0].rename(columns={"terminated": "over"})
    models.append(MDP.from_transitions(renamed, columns={"terminated": "over"}))
    said = "2 rows of transitions are done in states .* mark them in a column 'truncated'"
    with pytest.warns(UserWarning, match=said) as warned:  # perhaps a time limit
        models.append(MDP.from_transitions(marked(*RESET, done=over)))
    assert [each.filename for each in warned] == [__file__]
    for mdp in models:
        assert mdp.space.extra == ("end",)
        assert not mdp.labels
        assert certify(mdp).start_value == 1
    done = run("data", path, "--out", tmp_path / "m.npz", "--json")
    assert (done.result["cut_off"], load(tmp_path / "m.npz").space.extra) == (0, ("end",))


def test_marks_say_what_a_state_is_that_nobody_left() -> None:
    """It is an end where a row that led to it is terminated; else the episode was cut off."""
    rows = [(1, "a", "x", 1, "b"), (2, "a", "x", 2, "c")]
    mdp = MDP.from_transitions(marked(*rows, terminated=[True, False]), discount="1/2")
    assert mdp.space.labels(range(3)) == ["state a", "state b", "state c"]
    assert mdp.labels["cut off"].tolist() == [False, False, True]
    assert not MDP.from_transitions(marked(*rows, terminated=[True, True])).labels
    both = marked(*rows, done=[True, True], truncated=[False, True])
    assert MDP.from_transitions(both).labels["cut off"].tolist() == [False, False, True]


def test_records_with_resets_are_audited_as_the_model_of_them() -> None:
    rows = [(e, s, "go", s, 1 - s) for e in range(40) for s in (0, 1)]
    log = marked(*rows, terminated=[False, True] * 40)
    mdp = MDP.from_transitions(log, discount="1/2")
    audit = check(mdp, "optimal", confidence=0.9, by=OffPolicy(records=log, rewards=(0, 1)))
    assert audit.interval.found["cut_off"] == 0


def test_python_warns_of_columns_that_are_not_used() -> None:
    with pytest.warns(UserWarning, match="not used: 'timeout', 'step'") as told:
        MDP.from_transitions(table([GOOD]).assign(timeout=True, step=1))
    assert told[0].filename == __file__


HEAD, ONE = "episode,state,action,reward,next_state\n", table([GOOD])
NO_LOG: list[Any] = [  # log, columns, what is said, where, and how to put it right
    (ONE.rename(columns={"next_state": "next_stat"}), {}, "no column 'next_state'"),
    (ONE.rename(columns={"reward": "state"}), {"reward": "x"}, "'state' appears twice"),
    (HEAD.replace("reward", "state") + "1,a,x,0,b\n", {}, "'state' appears twice"),
    (ONE, {"sate": "s"}, "unknown column 'sate'"),
    *((other, {}, "is of type") for other in (5, [1, 2], [GOOD], {"state": [1]})),
    (table([(1, [0], "x", 0, [1])]), {}, "cannot be a name"),
    (table([]), {}, "no transitions"),
    ("", {}, "no transitions"),
    (table([(1, "end", "x", 0, None)]), {}, "named 'end'"),
    (f"{HEAD}1,a,x,0,b,9,9\n", {}, "7 values under 5 headings"),
    (f'{HEAD}1,"a, b",x,0,c\n1,c,x,1\n', {}, "4 values under 5 headings"),  # which is no end
    *((f"{HEAD}1,ä,x,0,b\n".encode(encoding), {}, "UTF-8") for encoding in ("utf-16", "latin-1")),
    (f'{HEAD}1,a,x,0,"b', {}, "broken CSV"),
    (b"PAR1", {}, "not a Parquet"),
    (cut((*GOOD, True), (1, "b", "x", 0, None, False)), {}, "the episode was over or cut off"),
    *((cut((*GOOD, x)), {}, "truncated is neither true nor false") for x in ("maybe", None)),
    (cut((*GOOD, True)), {"truncated": "timeout"}, "no column 'timeout'"),
    (marked(GOOD, terminated=[True], done=[False]), {}, "terminated and done differ"),
    (marked(GOOD, terminated=[False], done=[True]), {}, "terminated and done differ"),
    (marked(*RESET, terminated=[True] * 4), {}, "after a row that is marked as terminated",
     "transitions, row 1"),
    (marked((1, "a", "x", 0, None), done=[False]), {}, "neither terminated nor truncated"),
    (marked(GOOD, terminated=["maybe"]), {}, "terminated is neither true nor false"),
    (ONE.drop(columns=["state", "reward"]), {}, "no column 'state' nor 'reward' among 'episode'"),
    (ONE.drop(columns="episode"), {}, "no column 'episode'", "transitions", "a column done"),
    (ONE.drop(columns="next_state"), {}, "no column 'next_state'", "transitions", "a column done"),
    (ONE.rename(columns={"state": "State"}), {}, "'state'", "", "columns={'state': 'State'}"),
    (HEAD.replace(",", ", ") + "1, a, x, 0, b\n", {}, "no column 'state' nor", "", "skipinit"),
    (HEAD.replace(",", "|") + "1|a|x|0|b\n", {}, "no column", "log.csv"),
    (HEAD + "\0" * 2**21, {}, "a line has more than 1,048,576 characters"),
]  # fmt: skip


@pytest.mark.parametrize("case", NO_LOG, ids=range(len(NO_LOG)))
def test_what_is_no_log(case: tuple[Any, ...], tmp_path: Path) -> None:
    log, columns, *said = case
    if isinstance(log, str | bytes):
        path = tmp_path / ("log.parquet" if log == b"PAR1" else "log.csv")
        path.write_bytes(log.encode() if isinstance(log, str) else log)
        log = path
    refused(lambda: MDP.from_transitions(log, columns=columns), *said)


@pytest.mark.parametrize("ending", ["json", "csv.zip", "pkl"])
def test_other_kinds_of_files_are_named(ending: str, tmp_path: Path) -> None:
    (path := tmp_path / f"log.{ending}").write_text("{}", "utf-8")
    refused(lambda: MDP.from_transitions(path), f"cannot read .{ending.split('.')[-1]}")


# ---- logs as trainers write them -----------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 3, 20_000])
@pytest.mark.parametrize("mark", ["done", "terminated"])
@settings(max_examples=15)
@given(rows=records(), cuts=st.integers(0, 2**6 - 1))
def test_episodes_and_next_states_follow_from_marks(
    size: int, mark: str, rows: list[tuple[Any, ...]], cuts: int
) -> None:
    """A replay buffer has no numbers of episodes, a trajectory no next states."""
    frame, last = table(rows), []
    for number, (one, two) in enumerate(zip(rows, [*rows[1:], (None,)], strict=True)):
        last.append(one[0] != two[0])
        if last[-1]:
            frame.loc[number, "next_state"] = None
    cut = [here and bool(cuts >> row[0] & 1) for here, row in zip(last, rows, strict=True)]
    over = [here and not off for here, off in zip(last, cut, strict=True)]
    frame = frame.assign(truncated=cut, **{mark: last if mark == "done" else over})
    wanted = fingerprint(MDP.from_transitions(frame, discount="1/2"))
    for without in (["episode"], ["next_state"], ["episode", "next_state"]):
        log = frame.drop(columns=without)
        parts = [log.iloc[n : n + size] for n in range(0, len(log), size)]
        assert fingerprint(MDP.from_transitions(parts, discount="1/2")) == wanted


def test_a_last_row_that_no_mark_explains_is_refused() -> None:
    log = marked(*RESET, done=[False, True, False, False]).drop(columns="next_state")
    refused(lambda: MDP.from_transitions(log), "no next state, in a row", "row 3", "mark the row")
    alone = log.drop(columns="done")
    refused(lambda: MDP.from_transitions(alone), "no column 'next_state'", "", "truncated")


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "jsonl", "jsonl.gz"])
@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_files_of_other_kinds_give_the_same_model(ending: str, sign: str, tmp_path: Path) -> None:
    rows = [
        (7, "home, sweet", "go", "0.1", "(1, 2)"),
        (7, "(1, 2)", "stay", "2", "(1, 2)"),
        (8, "home, sweet", "go", "0.1", None),
    ]
    wanted = MDP.from_transitions(table(rows))
    path = tmp_path / f"log.{ending}"
    if "csv" in ending:
        table(rows).to_csv(path, index=False, sep=sign)
    else:
        log = table(rows).assign(reward=[0.1, 2, 0.1])
        text = log.to_json(orient="records", lines=True).replace('"(1, 2)"', "[1, 2]")
        written = gzip.compress(text.encode()) if ending.endswith("gz") else text.encode()
        path.write_bytes(written)
    assert fingerprint(MDP.from_transitions(path)) == fingerprint(wanted)


def test_usual_names_of_columns() -> None:
    frame = marked(*RESET, terminated=[False, True] * 2, truncated=[False] * 4)
    wanted = fingerprint(MDP.from_transitions(frame))
    usual = {"episode": "traj_id", "state": "obs", "action": "actions", "reward": "rewards"}
    for names in (
        usual | {"next_state": "next_obs", "terminated": "terminals", "truncated": "timeouts"},
        {"state": "observations", "next_state": "next_observations", "terminated": "dones"},
    ):
        assert fingerprint(MDP.from_transitions(frame.rename(columns=names))) == wanted
    # A name that is said, or the name itself, comes first.
    renamed = frame.rename(columns={"state": "cell"}).assign(obs=0)
    with pytest.warns(UserWarning, match="not used: 'obs'"):
        assert fingerprint(MDP.from_transitions(renamed, columns={"state": "cell"})) == wanted
    both = frame.rename(columns={"state": "obs"}).assign(observation=0)
    refused(
        lambda: MDP.from_transitions(both), "'obs' and 'observation' may both be", "", "state=obs"
    )


def test_all_problems_are_said_at_once(tmp_path: Path) -> None:
    rows = [GOOD, (2, "a", None, "dear", "b"), (3, "NA", "x", 0, "b"), (4, "a", "x", "free", "b")]
    error = refused(lambda: MDP.from_transitions(table(rows)), "row 1: no action")
    for what in ("row 1: the reward is 'dear'", "row 2: the state is 'NA'", "row 3: the reward"):
        assert what in error.what
    assert error.where == "transitions"


BROKEN: list[tuple[str, bytes, str, str]] = [
    ("log.jsonl", b'{"episode": 1}\n[1]\n', "not a JSON object", "line 2"),
    ("log.jsonl", b'{"episode": 1\n', "broken JSON", "line 1"),
    ("log.jsonl", b"", "no transitions", ""),
    ("log.csv.gz", b"episode", "not a whole .gz file", "log.csv.gz"),
    ("log.csv.gz", gzip.compress(HEAD.encode() * 99)[:-9], "not a whole .gz file", "log.csv.gz"),
]


@pytest.mark.parametrize("case", BROKEN, ids=range(len(BROKEN)))
def test_broken_files(case: tuple[str, bytes, str, str], tmp_path: Path) -> None:
    name, content, what, where = case
    (tmp_path / name).write_bytes(content)
    refused(lambda: MDP.from_transitions(tmp_path / name), what, where)


def test_a_parquet_file_is_read_by_its_columns_alone(tmp_path: Path) -> None:
    """An index of pandas is a column, whole numbers beside empty cells stay exact."""
    large, path = 2**60 + 1, tmp_path / "log.parquet"
    rows = [(7, large, "l", 1, large + 2), (7, large + 2, "r", 2, None)]
    frame = table(rows).assign(next_state=pd.array([large + 2, None], dtype="Int64"))
    frame.set_index("episode").to_parquet(path)
    mdp = MDP.from_transitions(path)
    assert mdp.space.labels(range(3)) == [f"state {large}", f"state {large + 2}", "end"]
    columns = pyarrow.Table.from_pandas(table([GOOD]))
    for noted in (b"{}", b'{"columns": [{}], "index_columns": [{}]}'):
        parquet.write_table(columns.replace_schema_metadata({"pandas": noted}), path)
        assert fingerprint(MDP.from_transitions(path)) == fingerprint(
            MDP.from_transitions(table([GOOD]))
        )
    twice = pyarrow.Table.from_arrays(columns.columns + columns.columns[:1], [*NAMES, NAMES[0]])
    parquet.write_table(twice, path)
    refused(lambda: MDP.from_transitions(path), "appears twice")


def test_changed_tables_have_no_observations() -> None:
    mdp = MDP.from_transitions(table([GOOD]), discount="1/2")
    assert mdp.with_(discount="1/3").observations is not None
    assert mdp.with_(table=mdp.table).observations is None
    assert mdp.within(2).observations is None
    assert mdp.within(2).episodes is mdp.with_(table=mdp.table).episodes is None
    assert mdp.episodes == mdp.with_(discount="1/3").episodes == 1
    assert mdp.with_(start=1).episodes is None
    assert MDP.from_transitions(table([GOOD]), start="a").episodes is None
    goal = mdp.with_(labels={"goal": [False, True]})
    for asked in (goal.with_(discount=1).until("goal"), goal.reaching("goal")):
        assert asked.observations is asked.episodes is None
    assert negated(mdp).observations is not None
    refused(lambda: mdp.with_(start={0: "1/2", 1: "1/2"}, episodes=3), "not counts over 3 episodes")
    refused(lambda: mdp.with_(episodes=0), "0 episodes")
    refused(lambda: mdp.with_(observations=np.array([2, 0])), "not counts over the observations")
    refused(lambda: mdp.with_(observations=np.array([1])), "for 2 pairs")


def test_a_name_of_very_many_digits_is_too_long_a_name() -> None:
    row = {"episode": 1, "state": "9" * 5000, "action": "a", "reward": 1, "next_state": None}
    with pytest.raises(ModelError, match="has 5,000 characters"):
        MDP.from_transitions(pd.DataFrame([row]))
