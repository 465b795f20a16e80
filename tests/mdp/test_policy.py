"""Policies by status, by all columns, by array, of every form and file; and what is none."""

from __future__ import annotations

import copy
import json
import os
import pickle
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, Column, ModelError, Policy, Scenario, StateSpace

CARE = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2)
MDP_1 = CARE.compile()
OWN_SKIP = CARE.with_(readings={"skip_timestep": "own"}).compile()
FLAGGED = CARE.with_(readings={"task_bonus": "no-subtask-skipped"}).compile()
PLAIN = MDP.from_outcomes(
    [(0, 0, [(1, 1, 0)]), (0, 2, [(1, 0, 1)]), (1, 1, [(1, 1, 0)]), (2, 0, [(1, 1, 5)]),
     (2, 1, [(1, 0, 0)])],
    "1/2", actions=["a", "b", "c"], states=["x", "y", "z"],
)  # fmt: skip
ACTIONS = list(MDP_1.actions)
STATUSES = [format(number, "04b") for number in range(16)]
by_status = st.lists(st.integers(0, 3), min_size=16, max_size=16)
numbers = st.floats(-1e6, 1e6)


def status_of(mdp: MDP) -> Any:
    return mdp.space.values("status")


def check_follows(mdp: MDP, policy: Policy, chosen: list[int]) -> None:
    """The policy takes chosen[status] wherever there is a choice, in a model that may have more."""
    weights, status = policy.weights(mdp), status_of(mdp)
    assert np.add.reduceat(weights, mdp.pair_offsets[:-1]) == pytest.approx(1)
    for pair in range(mdp.n_pairs):
        state = mdp.pair_state[pair]
        wanted = mdp.forced[state] or mdp.pair_action[pair] == chosen[status[state]]
        assert weights[pair] == float(wanted)
    actions = policy.choices(mdp)
    free = ~mdp.forced
    assert actions[free].tolist() == [chosen[s] for s in status[free]]
    first = mdp.pair_action[mdp.pair_offsets[:-1]]
    assert actions[~free].tolist() == first[~free].tolist()


# ---- one policy, many forms ------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(by_status)
def test_every_form_of_a_status_policy_is_the_same(chosen: list[int]) -> None:
    words = {STATUSES[s]: ACTIONS[a] for s, a in enumerate(chosen)}
    all_states = np.where(MDP_1.forced, 0, np.array([*chosen, 0])[status_of(MDP_1)])
    forms = [
        Policy.of(MDP_1, words),
        Policy.of(MDP_1, {status: {word: 1} for status, word in words.items()}),
        Policy.by(MDP_1, ["status"], chosen),
        Policy.by(MDP_1, ["status"], np.eye(4)[chosen]),
        Policy.of(MDP_1, all_states),
        Policy.of(MDP_1, all_states[:-1]),
        Policy.of(MDP_1, np.eye(4)[all_states]),
        Policy.of(MDP_1, np.eye(4)[chosen] * 3 - 1, kind="q"),
        Policy.of(MDP_1, np.eye(4)[all_states], kind="q"),
        Policy.of(MDP_1, np.eye(4)[all_states][:-1], kind="q"),
    ]
    for policy in forms:
        assert policy.deterministic
        check_follows(MDP_1, policy, chosen)
        assert Policy.of(MDP_1, policy) is policy
    for mdp in (OWN_SKIP, FLAGGED):
        for policy in forms[:4]:
            check_follows(mdp, policy, chosen)
        check_follows(mdp, Policy.of(mdp, np.eye(4)[chosen], kind="q"), chosen)
        check_follows(mdp, Policy.of(mdp, words), chosen)


@settings(max_examples=25, deadline=None)
@given(by_status, st.sampled_from([MDP_1, OWN_SKIP, FLAGGED]))
def test_files_are_the_inverse_of_writing(
    tmp_path_factory: pytest.TempPathFactory, chosen: list[int], mdp: MDP
) -> None:
    folder = tmp_path_factory.mktemp("policy")
    policy = Policy.of(mdp, {STATUSES[s]: ACTIONS[a] for s, a in enumerate(chosen)})
    for name in ("p.csv", "p.json"):
        policy.write(folder / name)
        check_follows(mdp, Policy.of(mdp, folder / name), chosen)
        check_follows(mdp, Policy.of(mdp, str(folder / name)), chosen)
    np.save(folder / "q.npy", np.eye(4)[chosen])
    check_follows(mdp, Policy.of(mdp, folder / "q.npy"), chosen)
    np.savez(folder / "q.npz", np.eye(4)[chosen])
    check_follows(mdp, Policy.of(mdp, folder / "q.npz"), chosen)
    np.savez(folder / "more.npz", visits=np.zeros(3), q=np.eye(4)[chosen])
    check_follows(mdp, Policy.of(mdp, folder / "more.npz"), chosen)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_a_mixed_policy_over_all_columns_survives_its_file(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    mdp = data.draw(st.sampled_from([MDP_1, FLAGGED, PLAIN]))
    size = (mdp.space.regular, mdp.n_actions)
    seed = data.draw(st.integers(0, 2**32))
    table = np.random.default_rng(seed).dirichlet(np.full(size[1], 0.4), size=size[0])
    offered = np.zeros((mdp.n_states, mdp.n_actions), dtype=bool)
    offered[mdp.pair_state, mdp.pair_action] = True
    table = np.where(offered[: size[0]], table, 0)
    table[table.sum(axis=1) == 0, 0] = 1
    table /= table.sum(axis=1, keepdims=True)
    policy = Policy.by(mdp, mdp.space.names, table)
    path = tmp_path_factory.mktemp("policy") / "mixed.csv"
    policy.write(path)
    again = Policy.of(mdp, path)
    assert again.weights(mdp).tolist() == policy.weights(mdp).tolist()
    assert again.columns == mdp.space.names
    weights = policy.weights(mdp)
    for pair in range(mdp.n_pairs):
        state = int(mdp.pair_state[pair])
        if not mdp.forced[state]:
            assert weights[pair] == table[state, mdp.pair_action[pair]]


def test_a_mixed_status_policy_as_json(tmp_path: Path) -> None:
    content: dict[str, Any] = dict.fromkeys(STATUSES, "none")
    content["0110"] = {"directive": 0.25, "supportive": "3/4"}
    path = tmp_path / "mixed.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    policy = Policy.of(MDP_1, path)
    assert not policy.deterministic
    assert policy.table[6].tolist() == [0, 0.75, 0, 0.25]
    policy.write(tmp_path / "again.json")
    assert Policy.of(MDP_1, tmp_path / "again.json").table.tolist() == policy.table.tolist()
    status = status_of(MDP_1)[MDP_1.pair_state]
    weights = policy.weights(MDP_1)[status == 6].reshape(-1, 4)
    assert weights.tolist() == [[0, 0.75, 0, 0.25]] * len(weights)


def test_a_policy_is_the_array_of_its_rule() -> None:
    numbers = np.zeros(MDP_1.n_states, dtype=np.int64)
    policy = Policy.of(MDP_1, numbers)
    assert "table" not in vars(policy)
    assert np.asarray(policy).tolist() == policy.tolist() == list(policy) == numbers.tolist()
    assert policy.shape == (len(policy),) == numbers.shape
    assert policy.ndim == 1
    assert policy.dtype == np.int64
    assert policy[3] == 0
    assert policy[[1, 2]].tolist() == [0, 0]
    assert (policy == numbers).all()
    assert (numbers == policy).all()
    assert not (policy != numbers).any()
    assert policy in {policy}
    other = Policy.of(MDP_1, numbers)
    assert (policy == other).all()
    assert not (policy != other).any()
    assert (policy + 1 == 1 + policy).all()
    assert (policy < 1).all()
    assert np.maximum(policy, other).tolist() == numbers.tolist()
    assert policy.size == policy.copy().size == policy.reshape(1, -1).shape[1] == len(policy)
    assert policy.astype(float).tobytes() == numbers.astype(float).tobytes()
    for again in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        assert (again == policy).all()
    with pytest.raises(AttributeError, match="'Policy' object has no attribute 'gap'"):
        _ = policy.__getattribute__("gap")
    mixed = Policy.by(MDP_1, ["status"], [[0.5, 0.5, 0, 0]] * 16)
    assert np.asarray(mixed).tolist() == mixed.table.tolist()
    assert mixed.shape == (16, 4)
    with pytest.raises(ModelError, match="there is no action"):
        Policy(space=StateSpace(columns=()), actions=MDP_1.actions, rule=np.array([4]))
    with pytest.raises(ModelError, match=r"shape \(2,\), not \(1, 4\)"):
        Policy(space=StateSpace(columns=()), actions=MDP_1.actions, rule=np.array([0, 1]))


# ---- named policies ------------------------------------------------


@pytest.mark.parametrize("mdp", [MDP_1, OWN_SKIP, FLAGGED, PLAIN], ids=["care", "own", "flag", "3"])
def test_the_random_policy_is_uniform_over_what_is_offered(mdp: MDP) -> None:
    weights = Policy.of(mdp, "random").weights(mdp)
    for state in range(mdp.n_states):
        pairs = mdp.pairs_of(state)
        assert weights[pairs.start : pairs.stop].tolist() == [1 / len(pairs)] * len(pairs)


@pytest.mark.parametrize("action", range(4))
def test_always(action: int) -> None:
    for mdp in (MDP_1, OWN_SKIP, FLAGGED):
        policy = Policy.of(mdp, f"always:{ACTIONS[action]}")
        check_follows(mdp, policy, [action] * 16)
    assert policy.columns == ()


def test_an_action_that_is_not_offered() -> None:
    assert PLAIN.forced.tolist() == [False, True, False]
    with pytest.raises(ModelError, match=r"not available(.|\n)*state z(.|\n)*a, b"):
        Policy.of(PLAIN, "always:c").weights(PLAIN)
    with pytest.raises(ModelError, match=r"not available(.|\n)*state x(.|\n)*a, c"):
        Policy.of(PLAIN, np.array([1, 1, 1])).weights(PLAIN)
    assert Policy.of(PLAIN, np.array([2, 0, 1])).choices(PLAIN).tolist() == [2, 1, 1]


# ---- Q-tables ------------------------------------------------


@given(st.lists(numbers, min_size=9, max_size=9))
def test_a_q_table_is_greedy_over_what_is_offered(values: list[float]) -> None:
    table = np.array(values).reshape(3, 3)
    chosen = Policy.of(PLAIN, table, kind="q").choices(PLAIN).tolist()
    for state in range(3):
        offered = [int(PLAIN.pair_action[pair]) for pair in PLAIN.pairs_of(state)]
        assert chosen[state] == max(offered, key=lambda a: (table[state, a], -a))


def test_ties_go_to_the_lowest_action() -> None:
    check_follows(MDP_1, Policy.of(MDP_1, np.zeros((16, 4)), kind="q"), [0] * 16)
    table = np.tile([0.0, 1.0, 1.0, 1.0], (16, 1))
    check_follows(MDP_1, Policy.of(MDP_1, table, kind="q"), [1] * 16)
    table[4] = [-np.inf, -np.inf, 3, 3]
    check_follows(MDP_1, Policy.of(MDP_1, table, kind="q"), [1, 1, 1, 1, 2, *[1] * 11])


def test_nan_matters_only_where_it_could_be_chosen() -> None:
    table = np.zeros((3, 3))
    table[0, 1] = table[1, 0] = np.nan
    assert Policy.of(PLAIN, table, kind="q").choices(PLAIN).tolist() == [0, 1, 0]
    table[2, 1] = np.nan
    with pytest.raises(ModelError, match=r"NaN(.|\n)*state z"):
        Policy.of(PLAIN, table, kind="q")
    with pytest.raises(ModelError, match=r"NaN(.|\n)*status 0010"):
        Policy.of(MDP_1, np.where(np.arange(16)[:, None] == 2, np.nan, 0) * np.ones(4), kind="q")


@pytest.mark.parametrize("shape", [(4, 16), (16, 5), (17, 4), (16,), (16, 4, 1), (0, 4), ()])
def test_q_tables_of_other_shapes(shape: tuple[int, ...]) -> None:
    with pytest.raises(ModelError, match=r"\(65, 4\) (over|prob)|not floats"):
        Policy.of(MDP_1, np.zeros(shape), kind="q")


def test_a_status_table_leaves_skip_out() -> None:
    """Where *skip* is an action of its own, a table over statuses still has four columns."""
    assert OWN_SKIP.n_actions == 5
    check_follows(OWN_SKIP, Policy.of(OWN_SKIP, np.eye(4)[[2] * 16], kind="q"), [2] * 16)


# ---- objects that are refused ------------------------------------------------


@pytest.mark.parametrize(
    "given",
    [
        np.zeros(64, dtype=int) + 4,
        np.full(65, -1),
        np.zeros(63, dtype=int),
        np.zeros(65),
        np.zeros((65, 4)),
        np.full((65, 4), 0.3),
        np.zeros((65, 3)),
        None,
        3,
        "always:non",
        "always:",
        "optimall",
        {},
        {"0000": "none"},
        object(),
    ],
    ids=lambda given: str(getattr(given, "shape", given))[:12],
)
def test_objects_that_are_no_policy(given: Any) -> None:
    with pytest.raises(ModelError):
        Policy.of(MDP_1, given, kind="policy").weights(MDP_1)


def test_a_policy_of_another_model() -> None:
    six = Column(name="status", size=64, bits=6)
    policy = Policy(
        space=StateSpace(columns=(six,)), actions=MDP_1.actions, rule=np.eye(4)[[0] * 64]
    )
    with pytest.raises(ModelError, match="64 values here and 16"):
        policy.weights(MDP_1)
    with pytest.raises(ModelError, match="unknown action 'none'"):
        Policy.by(MDP_1, ["status"], [0] * 16).weights(
            MDP_1.with_(actions=("nothing", "supportive", "non-directive", "directive"))
        )
    with pytest.raises(ModelError, match="unknown state column 'subtask'"):
        Policy.by(MDP_1, ["subtask"], [0, 1]).weights(PLAIN)


def test_a_row_that_says_nothing_is_an_error_only_where_it_is_asked() -> None:
    table = np.eye(3)[[0, 0, 0]]
    table[1] = np.nan  # state y is forced
    assert Policy.by(PLAIN, ["state"], table).choices(PLAIN).tolist() == [0, 1, 0]
    table[2] = np.nan
    with pytest.raises(ModelError, match=r"gives no action(.|\n)*state z"):
        Policy.by(PLAIN, ["state"], table).weights(PLAIN)


def test_a_policy_is_frozen() -> None:
    table = np.eye(4)[[0] * 16]
    policy = Policy.by(MDP_1, ["status"], table)
    table[0] = [0, 1, 0, 0]
    assert policy.table[0].tolist() == [1, 0, 0, 0]
    with pytest.raises(ValueError, match="read-only"):
        policy.table[0, 0] = 0


@pytest.mark.parametrize("unoffered", [5.0, -np.inf, np.inf, np.nan])
def test_only_actions_offered_count_where_a_value_is_minus_infinity(unoffered: float) -> None:
    rows = [(0, action, [(1, 1, action)]) for action in (0, 2)]
    rows += [(1, action, [(1, 1, 0)]) for action in (0, 1, 2)]
    mdp = MDP.from_outcomes(rows)
    for own, best in (([-np.inf, 2.0], 2), ([2.0, -np.inf], 0), ([-1e300, -np.inf], 0)):
        table = np.array([[own[0], unoffered, own[1]], [0, 0, 0]])
        assert Policy.of(mdp, table, kind="q").choices(mdp)[0] == best
    with pytest.raises(ModelError, match="every action offered has the value -inf"):
        Policy.of(mdp, np.array([[-np.inf, unoffered, -np.inf], [0, 0, 0]]), kind="q")


# ---- files that are refused, and those that are read all the same -----------

GOOD_CSV = "status,action\n" + "".join(f"{status},none\n" for status in STATUSES)
GOOD_JSON = json.dumps(dict.fromkeys(STATUSES, "none"))

BAD_FILES: dict[str, tuple[str, str, str]] = {
    "empty csv": ("p.csv", "", "the header is missing"),
    "empty json": ("p.json", "", "broken JSON"),
    "json list": ("p.json", "[1]", "not a JSON object"),
    "json number": ("p.json", "3", "not a JSON object"),
    "json cut": ("p.json", GOOD_JSON[:-5], "broken JSON"),
    "json deep": ("p.json", '{"a":' * 100_000, "nested more than 100 deep"),
    "json twice": ("p.json", GOOD_JSON[:-1] + ', "0000": "none"}', "0000 appears twice"),
    "json status": ("p.json", GOOD_JSON.replace("0110", "0120"), "unknown status '0120'"),
    "json short status": ("p.json", GOOD_JSON.replace("0110", "110"), "unknown status '110'"),
    "json action": ("p.json", GOOD_JSON.replace("none", "nome", 1), "unknown action 'nome'"),
    "json missing": ("p.json", '{"0000": "none"}', "15 of 16 rows are missing: status 0001"),
    "json number action": ("p.json", GOOD_JSON.replace('"none"', "2", 1), "unknown action '2'"),
    "json null action": ("p.json", GOOD_JSON.replace('"none"', "null", 1), "unknown action"),
    "json list action": ("p.json", GOOD_JSON.replace('"none"', "[1]", 1), "unknown action"),
    "json chance": (
        "p.json", GOOD_JSON.replace('"none"', '{"none": 0.5}', 1), "not a distribution",
    ),
    "json negative": (
        "p.json",
        GOOD_JSON.replace('"none"', '{"none": 1.5, "directive": -0.5}', 1),
        "not a distribution",
    ),
    "json huge": ("p.json", GOOD_JSON.replace('"none"', '{"none": 1e9999}', 1), ""),
    "json nan": ("p.json", GOOD_JSON.replace('"none"', '{"none": NaN}', 1), ""),
    "json null chance": (
        "p.json", GOOD_JSON.replace('"none"', '{"none": null}', 1), "not a number",
    ),
    "json no chance": ("p.json", GOOD_JSON.replace('"none"', "{}", 1), "not a distribution"),
    "csv header": ("p.csv", GOOD_CSV.replace("status", "stats", 1), "unknown column 'stats'"),
    "csv no action": ("p.csv", GOOD_CSV.replace(",action", "", 1), "the header is status"),
    "csv action only": ("p.csv", "action\nnone\n", "the header is action"),
    "csv header twice": ("p.csv", GOOD_CSV.replace("action", "status,action", 1), "the header is"),
    "csv no header": ("p.csv", GOOD_CSV.partition("\n")[2], "unknown column '0000'"),
    "csv long line": ("p.csv", GOOD_CSV.replace("none", "none,1", 1), "3 values under 2 headings"),
    "csv twice": ("p.csv", GOOD_CSV + "0000,none\n", "status 0000 appears twice"),
    "csv other twice": ("p.csv", GOOD_CSV + "0000,directive\n", "status 0000 appears twice"),
    "csv missing": ("p.csv", GOOD_CSV.replace("1001,none\n", ""), "1 of 16 rows are missing"),
    "csv action": ("p.csv", GOOD_CSV.replace("none", "nothing", 1), "unknown action 'nothing'"),
    "csv status": ("p.csv", GOOD_CSV.replace("0101", "0201"), "unknown status '0201'"),
    "csv number status": ("p.csv", GOOD_CSV.replace("0101", "5"), "unknown status '5'"),
    "csv quote": ("p.csv", GOOD_CSV.replace("none", '"none', 1), "broken CSV"),
    "csv null": ("p.csv", GOOD_CSV.replace("none", "no\0ne", 1), ""),
    "csv trial": (
        "p.csv", "trial,status,action\n" + "".join(f"2,{s},none\n" for s in STATUSES),
        "unknown trial '2'",
    ),
    "csv probability": (
        "p.csv",
        "status,action,probability\n" + "".join(f"{s},none,0.9\n" for s in STATUSES),
        "not a distribution",
    ),
    "csv probability word": (
        "p.csv",
        "status,action,probability\n" + "".join(f"{s},none,often\n" for s in STATUSES),
        "not a finite rational",
    ),
    "other kind": ("p.txt", GOOD_CSV, "unknown kind of policy"),
    "no ending": ("optimall", GOOD_CSV, "unknown kind of policy"),
    "text as npy": ("p.npy", GOOD_CSV, "NumPy"),
    "text as npz": ("p.npz", GOOD_CSV, "NumPy"),
    "empty npy": ("p.npy", "", "NumPy"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_FILES)
def test_files_that_are_no_policy(tmp_path: Path, name: str) -> None:
    file, content, message = BAD_FILES[name]
    path = tmp_path / file
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        Policy.of(MDP_1, path)
    assert message in str(caught.value)
    assert caught.value.fix


@pytest.mark.parametrize("name", ["p\0.json", "p\0.csv", "p\0.npy", f"{'p' * 5000}.json"])
def test_names_that_no_file_can_have(name: str) -> None:
    with pytest.raises(ModelError):
        Policy.of(MDP_1, name)


@pytest.mark.parametrize(
    "array", [np.array([["a"]]), np.array([1j]), np.array([{}], dtype=object), np.array("x")]
)
def test_arrays_that_are_no_numbers(tmp_path: Path, array: Any) -> None:
    path = tmp_path / "q.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(ModelError):
        Policy.of(MDP_1, path)


def test_archives_of_several_arrays(tmp_path: Path) -> None:
    path = tmp_path / "q.npz"
    np.savez(path, first=np.zeros((16, 4)), second=np.zeros((16, 4)))
    with pytest.raises(ModelError, match="holds first, second"):
        Policy.of(MDP_1, path)


def test_files_as_editors_leave_them(tmp_path: Path) -> None:
    """A byte order mark, CRLF, blank lines and spaces change nothing."""
    text = GOOD_CSV.replace("\n", "\r\n").replace("0001,none", " 0001 , directive ") + "\r\n\r\n"
    path = tmp_path / "p.csv"
    path.write_bytes(text.encode("utf-8-sig"))
    check_follows(MDP_1, Policy.of(MDP_1, path), [0, 3, *[0] * 14])
    path = tmp_path / "p.json"
    path.write_bytes(GOOD_JSON.encode("utf-8-sig"))
    check_follows(MDP_1, Policy.of(MDP_1, path), [0] * 16)


def test_columns_in_any_order(tmp_path: Path) -> None:
    lines = [
        f"directive,{s},{t}" if t == 1 else f"none,{s},{t}" for t in range(2) for s in STATUSES
    ]
    path = tmp_path / "p.csv"
    path.write_text("action,status,trial\n" + "\n".join(reversed(lines)), encoding="utf-8")
    policy = Policy.of(MDP_1, path)
    trial = MDP_1.space.values("trial")
    chosen = policy.choices(MDP_1)
    assert chosen[:-1].tolist() == [3 * (t == 1) for t in trial[:-1].tolist()]


# ---- writing ------------------------------------------------


def test_writing_is_whole_or_not_at_all(tmp_path: Path) -> None:
    policy = Policy.of(MDP_1, GOOD := dict.fromkeys(STATUSES, "none"))
    path = tmp_path / "p.json"
    policy.write(path)
    assert json.loads(path.read_text(encoding="utf-8")) == GOOD
    assert [file.name for file in tmp_path.iterdir()] == ["p.json"]
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    with pytest.raises(ModelError, match="cannot write"):
        policy.write(tmp_path / "nowhere" / "p.json")
    with pytest.raises(ModelError, match=r"name it \.csv or \.json"):
        policy.write(tmp_path / "p.yaml")
    with pytest.raises(ModelError, match="the policy reads subtask, trial, status"):
        Policy.of(MDP_1, "random").write(tmp_path / "all.json")


def test_the_header_names_what_is_read(tmp_path: Path) -> None:
    Policy.of(MDP_1, np.zeros(65, dtype=int)).write(tmp_path / "all.csv")
    lines = (tmp_path / "all.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["subtask,trial,status,action", "0,0,0000,none"]
    assert len(lines) == 65
    Policy.by(MDP_1, ["status"], [3] * 16).write(tmp_path / "status.csv")
    lines = (tmp_path / "status.csv").read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["status,action", "0000,directive"]


def test_a_policy_that_reads_nothing_is_not_written(tmp_path: Path) -> None:
    mdp = Scenario.load("yuan2025").compile()
    with pytest.raises(ModelError, match="reads no column"):
        Policy.of(mdp, "always:none").write(tmp_path / "always.csv")
    assert not list(tmp_path.iterdir())
