"""Policies by status, by cell, by array, by file; exact shares; and what is no policy."""

import copy
import json
import os
import pickle
import stat
from collections import defaultdict
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace  # noqa: F401 - the table names it
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import policy_by
from refusal_tables import of_file, refused, table_of_refusals
from strategies import Rows, models

from exact_mdp import (
    MDP,
    Column,
    ModelError,
    Policy,
    Scenario,
    StateSpace,
    certify,
    check,
    return_distribution,
    save,
    solve,
)

SCENARIO = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2)
CARE = SCENARIO.compile()
OWN_SKIP = SCENARIO.with_(readings={"skip_timestep": "own"}).compile()
FLAGGED = SCENARIO.with_(readings={"task_bonus": "no-subtask-skipped"}).compile()
PLAIN = MDP.from_outcomes(
    [(0, 0, [(1, 1, 0)]), (0, 2, [(1, 0, 1)]), (1, 1, [(1, 1, 0)]), (2, 0, [(1, 1, 5)]),
     (2, 1, [(1, 0, 0)])],
    "1/2", actions=["a", "b", "c"], states=["x", "y", "z"],
)  # fmt: skip
LAKE = MDP.from_gymnasium("FrozenLake-v1", "99/100")
ACTIONS = list(CARE.actions)
STATUSES = [format(number, "04b") for number in range(16)]
by_status = st.lists(st.integers(0, 3), min_size=16, max_size=16)


def once(*rewards: object) -> MDP:
    choices = [(0, action, [(1, 1, reward)]) for action, reward in enumerate(rewards)]
    return MDP.from_outcomes([*choices, (1, 0, [(1, 1, 0)])])


def follows(mdp: MDP, policy: Policy, chosen: list[int]) -> None:
    status = mdp.space.values("status")
    first = mdp.pair_action[mdp.pair_offsets[:-1]].tolist()
    wanted = [a if one else chosen[s] for a, one, s in zip(first, mdp.forced, status, strict=True)]
    assert policy.choices(mdp).tolist() == wanted
    taken = mdp.pair_action == np.array(wanted)[mdp.pair_state]
    assert policy.weights(mdp).tolist() == taken.tolist()


# ---- one policy, many forms ----------------------------------------------------------------------


@settings(max_examples=20)
@given(by_status)
def test_every_form_of_a_status_policy_is_the_same(tmp_path_factory: Any, chosen: Any) -> None:
    folder, one_hot = tmp_path_factory.mktemp("policy"), np.eye(4)[chosen]
    words = {STATUSES[s]: ACTIONS[a] for s, a in enumerate(chosen)}
    Policy.of(CARE, words).write(folder / "p.csv")
    (folder / "p.json").write_text(json.dumps(words))
    np.save(folder / "q.npy", one_hot)
    np.savez(folder / "q.npz", one_hot)
    np.savez(folder / "more.npz", visits=np.zeros(3), q=one_hot)
    files = [folder / name for name in ("p.csv", "p.json", "q.npy", "q.npz", "more.npz")]
    mixed = {status: {word: 1} for status, word in words.items()}
    for mdp in (CARE, OWN_SKIP, FLAGGED):  # a table over statuses leaves the action skip out
        policies = [policy_by(CARE, ["status"], chosen), policy_by(CARE, ["status"], one_hot)]
        policies += [Policy.of(mdp, form) for form in (words, mixed, *files, str(files[0]))]
        policies += [Policy.of(mdp, one_hot * 3 - 1, kind="q"), Policy.of(CARE, words)]
        for policy in policies:
            assert Policy.of(mdp, policy) is policy
            follows(mdp, policy, chosen)
    numbers = np.where(CARE.forced, 0, np.array([*chosen, 0])[CARE.space.values("status")])
    for form in (numbers, numbers[:, None], numbers[:-1], np.eye(4)[numbers]):
        assert Policy.of(CARE, form).deterministic
        follows(CARE, Policy.of(CARE, form), chosen)
    for table in (np.eye(4)[numbers], np.eye(4)[numbers][:-1]):
        follows(CARE, Policy.of(CARE, table, kind="q"), chosen)


@settings(max_examples=10)
@given(st.lists(st.integers(0, 3), min_size=16, max_size=16))
def test_every_form_of_a_policy_over_cells_is_the_same(numbers: list[int]) -> None:
    """By columns, by what a function gives, in a model within some steps; nothing is added."""
    names, one_hot = [LAKE.actions[a] for a in numbers], np.eye(4)[numbers]
    rows: defaultdict[int, Any] = defaultdict(lambda: np.zeros(4))
    rows |= {s: 2.5 * one_hot[s] for s in range(16) if numbers[s]}
    count = len(rows)
    forms = [
        lambda s: names[s],
        lambda s: {names[s]: 1},
        lambda s: np.array(numbers[s]),
        lambda s: one_hot[s],
        {LAKE.space.label(s): a for s, a in enumerate(names)},
        {(s // 4, s % 4): a for s, a in enumerate(names)},
        rows,
    ]
    for mdp in (LAKE, LAKE.within(3)):
        wanted = Policy.of(mdp, numbers).weights(mdp).tolist()
        for form in forms[:1] if mdp is not LAKE else forms:
            assert Policy.of(mdp, form).weights(mdp).tolist() == wanted
    assert len(rows) == count


@settings(max_examples=30)
@given(st.sampled_from([CARE, FLAGGED, PLAIN]), st.integers(0, 2**32))
def test_a_mixed_policy_over_all_columns_survives_its_file(
    tmp_path_factory: Any, mdp: MDP, seed: int
) -> None:
    offered = np.zeros((mdp.n_states, mdp.n_actions), dtype=bool)
    offered[mdp.pair_state, mdp.pair_action] = True
    offered = offered[: mdp.space.regular]
    table = np.random.default_rng(seed).dirichlet(np.full(mdp.n_actions, 0.4), size=len(offered))
    table = np.where(offered, table, 0)
    table[table.sum(axis=1) == 0, 0] = 1
    table /= table.sum(axis=1, keepdims=True)
    policy = policy_by(mdp, mdp.space.names, table)
    path = tmp_path_factory.mktemp("policy") / "mixed.csv"
    policy.write(path)
    again = Policy.of(mdp, path)
    assert again.columns == mdp.space.names
    free = ~mdp.forced[mdp.pair_state]
    wanted = table[np.where(free, mdp.pair_state, 0), mdp.pair_action]
    for each in (policy, again):
        assert each.weights(mdp)[free].tolist() == wanted[free].tolist()


def test_a_policy_is_read_as_the_array_of_its_rule() -> None:
    numbers = np.zeros(CARE.n_states, dtype=np.int64)
    policy, other = Policy.of(CARE, numbers), Policy.of(CARE, numbers)
    assert "table" not in vars(policy)
    assert Policy.of(CARE, numbers + 1).table.tolist() == np.eye(4)[numbers + 1].tolist()
    assert np.asarray(policy).tolist() == policy.rule.tolist() == numbers.tolist()
    assert np.asarray(policy).dtype == np.int64
    assert (policy[3], policy[[1, 2]].tolist()) == (0, [0, 0])
    for again in (numbers, other, copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        assert np.array_equal(policy, again)
    assert policy in {policy}
    table = np.array([[0.5, 0.5, 0, 0]] * 16)
    mixed = policy_by(CARE, ["status"], table)
    table[0] = [0, 1, 0, 0]
    assert np.asarray(mixed).tolist() == mixed.table.tolist() == [[0.5, 0.5, 0, 0]] * 16
    with pytest.raises(ValueError, match="read-only"):
        mixed.table[0, 0] = 0


@given(models(discounts=(Fraction(1, 2),)), st.booleans())
def test_states_whose_actions_are_the_same(drawn: Rows, floats: bool) -> None:
    mdp = drawn.model(floats=floats)
    rows = [[mdp.table.row(pair) for pair in mdp.pairs_of(s)] for s in range(mdp.n_states)]
    assert mdp.ends.alike.tolist() == [all(row == each[0] for row in each) for each in rows]


# ---- names that are numbers of others ------------------------------------------------------------

PERMUTED = MDP.from_arrays([np.eye(4)] * 2, [[1, 0]] * 4, "1/2", states=["3", "1", "2", "0"])


def walk(actions: list[Any], best: list[Any], states: list[Any]) -> MDP:
    """The states in a row; the best action of each earns 1."""
    after, right = (dict(pairwise(states)), dict(zip(states, best, strict=False)))

    def outcomes(state: Any, action: Any) -> list[tuple[int, Any, int]]:
        return [(1, after[state], int(action == right[state]))]

    return MDP.from_function(states[0], lambda s: actions if s in after else [], outcomes)


TUPLES = walk([(0, 1), (1, 0)], [(1, 0), (0, 1)], [0, 1, 2])
COSTS = MDP.from_arrays([[[1, 0], [0, 1]]] * 2, [[1, 2], [1, 2]], "1/2", sense="min", layout="ass")
ONES = [[1, 0], [1, 0]]


def test_what_fits_two_readings_that_differ_is_refused_and_both_are_named() -> None:
    both = "may be state 3, by its name, or state 0, number 3 in the model's order"
    for start in (3, {3: 1}, np.int64(3), 3.0, {"1": "1/2", 3: "1/2"}):
        refused(lambda x=start: PERMUTED.with_(start=x), both, "", 'write "state 3" or "state 0"')
    for start in ("3", "state 3", {"3": 1}, [1, 0, 0, 0], None):
        assert PERMUTED.with_(start=start).start == ((0, 1),)
    assert PERMUTED.with_(start=1).start == ((1, 1),)  # both readings are the same


def test_a_solution_of_another_model_goes_by_names() -> None:
    P, R = [[[1, 0], [0, 1]]] * 2, [[1, 0], [0, 1]]
    one = MDP.from_arrays(P, R, "1/2", actions=["l", "r"], states=["x", "y"], layout="ass")
    turned = MDP.from_arrays(P[::-1], np.array(R)[:, ::-1], "1/2", actions=["r", "l"],
                             states=["x", "y"], layout="ass")  # fmt: skip
    other = MDP.from_arrays(P, R, "1/2", actions=["l", "r"], states=["y", "x"], layout="ass")
    for solved in (solve(one), certify(one)):
        assert check(turned, solved).passed
        assert not check(one.with_(actions=("r", "l")), solved).passed
        with pytest.raises(ModelError, match="have other names here"):
            check(other, solved)


# ---- named policies and Q-tables -----------------------------------------------------------------


@given(st.lists(st.floats(-1e6, 1e6), min_size=9, max_size=9))
def test_a_q_table_is_greedy_over_what_is_offered(values: list[float]) -> None:
    """The lowest action wins a tie; NaN matters only where it could be chosen."""
    for table in (np.array(values).reshape(3, 3), np.round(values).reshape(3, 3) % 2):
        table[0, 1] = table[1, 0] = np.nan  # not offered, and without a choice
        chosen = Policy.of(PLAIN, table, kind="q").choices(PLAIN).tolist()
        for state in (0, 2):
            offered = [int(PLAIN.pair_action[pair]) for pair in PLAIN.pairs_of(state)]
            assert chosen[state] == max(offered, key=lambda a, row=table[state]: (row[a], -a))
        assert chosen[1] == 1
        table[2, 1] = np.nan
        with pytest.raises(ModelError, match=r"NaN(.|\n)*state z"):
            Policy.of(PLAIN, table, kind="q")


@pytest.mark.parametrize("unoffered", [5.0, -np.inf, np.inf, np.nan])
def test_only_actions_offered_count_where_a_value_is_minus_infinity(unoffered: float) -> None:
    rows = [(0, action, [(1, 1, action)]) for action in (0, 2)]
    mdp = MDP.from_outcomes([*rows, *((1, action, [(1, 1, 0)]) for action in (0, 1, 2))])
    for own, best in (([-np.inf, 2.0], 2), ([2.0, -np.inf], 0), ([-1e300, -np.inf], 0)):
        table = np.array([[own[0], unoffered, own[1]], [0, 0, 0]])
        assert Policy.of(mdp, table, kind="q").choices(mdp)[0] == best
    with pytest.raises(ModelError, match="every available action has the value -inf"):
        Policy.of(mdp, np.array([[-np.inf, unoffered, -np.inf], [0, 0, 0]]), kind="q")


# ---- exact shares --------------------------------------------------------------------------------


def exactly(model: MDP, policy: object, **how: Any) -> Fraction:
    value = check(model, policy, exact_values=True, **how).regret.at_start.value
    assert isinstance(value, Fraction)
    return value


@given(st.fractions(0, 1, max_denominator=40).filter(lambda share: 0 < share < 1))
def test_a_share_keeps_the_exact_limit_and_no_lower_one(share: Fraction) -> None:
    """With a share of the action that loses 5, the regret is 5 times that."""
    model, rest = once(5, 0), 1 - share
    words = {"0": {"0": str(rest), "1": str(share)}}
    for policy in (words, {"0": {"0": rest, "1": share}}, [[rest, share], [1, 0]],
                   np.array([[rest, share], [1, 0]], dtype=object)):  # fmt: skip
        kind = "auto" if isinstance(policy, dict) else "policy"
        assert check(model, policy, max_regret=5 * share, kind=kind).passed
        assert exactly(model, policy, kind=kind) == 5 * share
    assert not check(model, words, max_regret=5 * share - Fraction(1, 10**30)).passed


def test_decimal_words_are_the_decimals_that_they_say() -> None:
    """ "0.9" is 9/10; the float 0.9 is the number that it is; random is 1/3 of three."""
    model, high, low = once(5, 0), Fraction(0.9), Fraction(0.1)
    assert exactly(model, {"0": {"0": "0.9", "1": "0.1"}}) == Fraction(1, 2)
    assert exactly(model, {"0": {"0": 0.9, "1": 0.1}}) == 5 * low / (high + low)
    assert exactly(model, [[0.9, 0.1], [1, 0]], kind="policy") == 5 * low / (high + low)
    half = {"0": {"0": 0.9, "1": "1/10"}}  # each number is what it is
    assert exactly(model, half) == 5 * Fraction(1, 10) / (high + Fraction(1, 10))
    assert exactly(once(1, 0, 0), "random") == Fraction(2, 3)
    assert return_distribution(once(0, 1, 2), "random", exact=True).exact == (Fraction(1, 3),) * 3


@pytest.mark.parametrize("share", ["9/10", "1/3", "1/2", "123456789/1000000007"])
def test_files_keep_exact_shares(tmp_path: Path, share: str) -> None:
    model, path, again = once(5, 0), tmp_path / "policy.csv", tmp_path / "again.csv"
    words = {"0": {"0": share, "1": str(1 - Fraction(share))}, "1": "0"}
    (tmp_path / "policy.json").write_text(json.dumps(words))
    policy = Policy.of(model, tmp_path / "policy.json")
    policy.write(path)
    assert Policy.of(model, path).frame().equals(policy.frame())
    assert exactly(model, policy) == 5 * (1 - Fraction(share))
    policy.write(again)
    assert again.read_bytes() == path.read_bytes()
    Policy.of(once(1, 0, 0), "random").write(tmp_path / "random.csv")
    assert "1/3" in (tmp_path / "random.csv").read_text()
    save(model, tmp_path / "m.npz")
    exact = str(5 * (1 - Fraction(share)))
    done = run("check", tmp_path / "m.npz", path, "--max-regret", exact, "--json")
    assert (done.status, done.result["exact_regret"]) == (0, exact)


# ---- dictionaries of numbers, and what networks return -------------------------------------------

TABLE = MDP.from_arrays([[[0.5, 0.5], [0, 1]], [[0, 1], [0.5, 0.5]]], [[1, 0], [0, 2]], "9/10",
                        layout="ass", states=["x", "y"], actions=["l", "r"])  # fmt: skip


@pytest.mark.parametrize("values", [[[3.0, 4], [5, -1]], [["1/2", "1/3"], ["-2", 0]],
                                    [[-np.inf, 1], [0, 0]], [[0.5, 0.5], [1, 0]]])  # fmt: skip
@pytest.mark.parametrize("named", [False, True])
def test_a_dictionary_of_action_values_is_a_q_table(values: list[list[Any]], named: bool) -> None:
    states, actions = (TABLE.space.columns[0].words, TABLE.actions) if named else ((0, 1), (0, 1))
    numbers = [[float(Fraction(x)) if isinstance(x, str) else x for x in row] for row in values]
    expected = Policy.of(TABLE, np.array(numbers), kind="q").rule.tolist()
    table = {s: dict(zip(actions, row, strict=True)) for s, row in zip(states, values, strict=True)}
    pairs = {(s, a): x for s, row in table.items() for a, x in row.items()}
    each = [table, pairs] if not isinstance(values[0][0], str) else [table]
    for form in each:
        policy = Policy.of(TABLE, form, kind="q")
        assert (policy.rule.tolist(), policy.read_as) == (expected, "q")


GRID = MDP.from_function((0, 0), lambda s: [0, 1] if s[0] < 2 else [],
                         lambda s, a: [(1, (s[0] + 1, a), a)])  # fmt: skip


def test_pairs_may_have_probabilities_and_states_may_be_tuples() -> None:
    mixed = {("x", "l"): "1/4", ("x", "r"): "3/4", ("y", 0): 1}
    assert Policy.of(TABLE, {k: Fraction(v) for k, v in mixed.items()}).shares is None
    cells = {(0, 0): 1, (1, 0): 0, (1, 1): 1}
    assert Policy.of(GRID, cells).rule[: len(cells)].tolist() == [1, 0, 1]
    q = {(cell, action): float(action == best) for cell, best in cells.items() for action in (0, 1)}
    assert Policy.of(GRID, q, kind="q").rule[: len(cells)].tolist() == [1, 0, 1]
    everywhere = {(row, column): [0, 1] for row in range(2) for column in range(3)}
    with pytest.warns(UserWarning, match=r"3 of 6 rows are not read.*: \(0, 1\), \(0, 2\)"):
        assert Policy.of(GRID, everywhere, kind="q").rule[: len(cells)].tolist() == [1, 1, 1]


def test_a_policy_with_negative_numbers_of_rounding_is_not_a_q_table() -> None:
    rows = np.array([[1, -4e-16], [0.25, 0.75]])
    mixed = Policy.of(TABLE, rows, kind="policy")
    assert mixed.weights(TABLE).tolist() == [1, 0, 0.25, 0.75]
    pure = Policy.of(TABLE, np.array([[1, -4e-16], [-1e-12, 1]]))
    assert (pure.rule.tolist(), pure.read_as) == ([0, 1], "policy")
    refused(lambda: Policy.of(TABLE, rows), "a Q-table?")
    assert Policy.of(TABLE, np.array([[1, -1e-8], [0, 1]])).read_as == "q"


class Tensor:
    """What torch's tensors do: none is an array while it has a gradient, or is a bfloat16."""

    def __init__(self, values: Any, *, grad: bool = True, short: bool = False) -> None:
        self.values, self.grad, self.short = np.asarray(values), grad, short

    def detach(self) -> "Tensor":
        return Tensor(self.values, grad=False, short=self.short)

    def cpu(self) -> "Tensor":
        return self

    def float(self) -> "Tensor":
        return Tensor(self.values.astype(np.float32), grad=self.grad)

    def numpy(self) -> np.ndarray:
        if self.grad:
            raise RuntimeError("call detach first")
        if self.short:
            raise TypeError("unsupported type BFloat16")
        return self.values

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        return self.numpy()


@pytest.mark.parametrize("short", [False, True])
def test_tensors_are_the_arrays_that_they_hold(short: bool) -> None:
    rows = np.array([[1.0, 2.5], [3.0, -1.0]])
    forms = [Tensor(rows, short=short), [Tensor(row, short=short) for row in rows],
             lambda s: Tensor(rows["xy".index(s)], short=short),
             lambda s: Tensor(rows["xy".index(s)].argmax()),
             {"x": Tensor(rows[0]), "y": Tensor(rows[1])}]  # fmt: skip
    for form in forms:
        assert Policy.of(TABLE, form).rule.tolist() == [1, 0]
    mdp = MDP.from_arrays(Tensor(np.eye(2)[None]), [Tensor(1.0), Tensor(2.0)], start=Tensor([0, 1]))
    assert (mdp.reward.tolist(), mdp.start) == ([1, 2], ((1, 1),))


class Network:
    def forward(self) -> None: ...

    def parameters(self) -> None: ...


GAP = MDP.from_outcomes([(s, a, [(1, s, a)]) for s in range(4) for a in range(2)], "1/2",
                        space=StateSpace(columns=(Column(name="state", size=3,
                        words=("0", "2", "3")),), extra=("cut off",)))  # fmt: skip


def test_rows_of_states_whose_numbers_have_a_gap(tmp_path: Path) -> None:
    np.save(tmp_path / "q.npy", np.eye(4)[:, :2] * 2)
    said = "row 3 of 4 may be for state 3, or for cut off"
    for form in (np.eye(4)[:, :2] * 2, [0, 1, 0, 1], tmp_path / "q.npy"):
        refused(lambda form=form: Policy.of(GAP, form), said, "", "{state: row}")
    rows = {"0": [0, 2], "2": [2, 0], "3": [0, 2], "cut off": [0, 3]}
    assert Policy.of(GAP, rows, kind="q").rule.tolist() == [1, 0, 1, 1]
    solution = solve(GAP)
    assert Policy.of(GAP, solution).rule.tolist() == [1, 1, 1, 1]


# ---- what is no policy ---------------------------------------------------------------------------


def partial(mdp: MDP, *states: int) -> Policy:
    table = np.eye(mdp.n_actions)[[0] * mdp.n_states]
    table[list(states)] = np.nan
    return policy_by(mdp, ["state"], table)


WIDE = Policy(space=StateSpace(columns=(Column(name="status", size=64, bits=6),)),
              actions=CARE.actions, rule=np.eye(4)[[0] * 64])  # fmt: skip
ONE = MDP.from_arrays([np.eye(1)] * 2, [[0, 1]], "1/2")
NUMBERED = MDP.from_arrays([np.eye(4)] * 2, [[1, 0], [0, 1]] * 2, "1/2",
                           states=["3", "5", "7", "1"], actions=["2", "1"])  # fmt: skip
LISTED = MDP.from_outcomes([(s, a, [(1, 1, int(a == s))]) for s in (0, 1) for a in (0, 1)],
                           "1/2", actions=["True", "False"])  # fmt: skip
TIMES = np.arange(5)[:, None, None]
MASKED = np.ma.array([1], mask=[True])


def weights(mdp: MDP, form: Any, kind: str = "auto") -> np.ndarray:
    return Policy.of(mdp, form, kind=kind).weights(mdp)


def file(name: str, text: str) -> Policy:
    return of_file(name, text, lambda path: Policy.of(CARE, path))


def test_a_policy_may_say_nothing_of_a_state_without_a_choice() -> None:
    assert partial(PLAIN, 1).choices(PLAIN).tolist() == [0, 1, 0]
    assert Policy.of(PLAIN, np.array([2, 0, 1])).choices(PLAIN).tolist() == [2, 1, 1]


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"rule": np.array([4])}, "there is no action"),
        ({"rule": np.array([0, 1])}, "shape (2,), not (1, 4)"),
    ],
)
def test_rules_that_do_not_fit(parts: Any, words: str) -> None:
    named = {"space": StateSpace(columns=()), "actions": CARE.actions}
    refused(lambda: Policy(**named | parts), words)


# ---- files ---------------------------------------------------------------------------------------

CSV = "status,action\n" + "".join(f"{status},none\n" for status in STATUSES)
JSON = json.dumps(dict.fromkeys(STATUSES, "none"))


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def shares(share: str) -> str:
    return "status,action,probability\n" + "".join(f"{s},none,{share}\n" for s in STATUSES)


test_what_is_no_policy = table_of_refusals(__file__, globals())


def test_states_that_no_record_has(tmp_path: Path) -> None:
    rows = [(e, s, (e + s) % 2, 1, s + 1) for e in (0, 1) for s in range(5)]
    frame = pd.DataFrame(rows, columns=["episode", "state", "action", "reward", "next_state"])
    named = frame.assign(state=[f"s{s}" for s in frame.state])
    named["next_state"] = [f"s{s}" for s in frame.next_state]
    path = tmp_path / "p.csv"
    path.write_text("state,action\n0,0\n7,0\n", "utf-8")
    for records, policy in (
        (frame, {0: 0, 7: 0}),
        (frame, {(s, a): 0.5 for s in (0, 7) for a in (0, 1)}),
        (frame, path),
        (named, {"s0": 0, "s7": 0}),
    ):
        mdp = MDP.from_transitions(records, "9/10")
        for model in (mdp, mdp.within(3)):
            refused(lambda model=model, policy=policy: Policy.of(model, policy), "no record has")
    refused(lambda: Policy.of(mdp, np.zeros((7, 2)), kind="q"), "shape (7, 2)", "", "its records")
    error = refused(lambda: Policy.of(LAKE, {99: "DOWN"}), "there is no state 99")
    assert "record" not in error.what


def test_arrays_and_names_that_are_no_policy(tmp_path: Path) -> None:
    odd = [np.zeros((16, 4), kind) for kind in ("c16", "S2", "M8[s]", "V8")]
    for array in (*odd, np.array([["a"]]), np.array([{}], dtype=object), np.zeros((16, 0))):
        np.save(tmp_path / "q.npy", array, allow_pickle=True)
        with pytest.raises(ModelError):
            Policy.of(CARE, tmp_path / "q.npy")
    np.savez(tmp_path / "q.npz", first=np.zeros((16, 4)), second=np.zeros((16, 4)))
    refused(lambda: Policy.of(CARE, tmp_path / "q.npz"), "holds first, second")
    for name in ("p\0.json", "p\0.csv", "p\0.npy", f"{'p' * 5000}.json"):
        with pytest.raises(ModelError):
            Policy.of(CARE, name)


def test_files_as_editors_leave_them(tmp_path: Path) -> None:
    """A byte order mark, CRLF, blank lines, spaces, and the order of columns change nothing."""
    text = CSV.replace("\n", "\r\n").replace("0001,none", " 0001 , directive ") + "\r\n\r\n"
    for name, content in (("p.csv", text), ("p.json", JSON)):
        (tmp_path / name).write_bytes(content.encode("utf-8-sig"))
    follows(CARE, Policy.of(CARE, tmp_path / "p.csv"), [0, 3, *[0] * 14])
    follows(CARE, Policy.of(CARE, tmp_path / "p.json"), [0] * 16)
    lines = [f"{('none', 'directive')[t]},{s},{t}" for t in range(2) for s in STATUSES]
    (tmp_path / "p.csv").write_text("action,status,trial\n" + "\n".join(reversed(lines)))
    trial = CARE.space.values("trial")[:-1]
    assert (
        Policy.of(CARE, tmp_path / "p.csv").choices(CARE)[:-1].tolist()
        == (3 * (trial == 1)).tolist()
    )


def test_writing_is_whole_or_not_at_all(tmp_path: Path) -> None:
    policy, path = Policy.of(CARE, json.loads(JSON)), tmp_path / "p.csv"
    policy.write(path)
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    plain = Scenario.load("yuan2025").compile()
    for mdp, form, name, words in (
        (CARE, policy, "nowhere/p.csv", "cannot write"),
        (CARE, policy, "p.json", "name it .csv"),
        (plain, "always:none", "always.csv", "the same in all states"),
    ):
        with pytest.raises(ModelError, match=words):
            Policy.of(mdp, form).write(tmp_path / name)
    assert [file.name for file in tmp_path.iterdir()] == ["p.csv"]
    for form, first in (
        (np.zeros(65, dtype=int), ["subtask,trial,status,action", "0,0,0000,none"]),
        (json.loads(JSON), ["status,action", "0000,none"]),
    ):
        Policy.of(CARE, form).write(path)
        lines = path.read_text(encoding="utf-8").splitlines()
        assert lines[:2] == first
        assert len(lines) == len(np.atleast_1d(form)) or len(lines) == 17
