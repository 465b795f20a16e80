"""One array, one meaning: every form of a policy or Q-table, in memory and in files."""

import warnings
from fractions import Fraction as F
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli_runner import run

from exact_mdp import (
    MDP,
    ModelError,
    Policy,
    Scenario,
    assert_policy_optimal,
    certify,
    check,
    evaluate,
    return_distribution,
    save,
    simulate,
    solve,
)

SMALL = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2)
BOTH = np.array([[0.5, 0.5], [0.1, 0.9]])


@pytest.fixture
def mdp() -> MDP:
    """Two states with a choice each, then the end, which has two actions as well."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 2, 0)]), (1, 1, [(1, 2, 2)])]
    ends = [(2, 0, [(1, 2, 0)]), (2, 1, [(1, 2, 0)])]
    return MDP.from_outcomes([*rows, *ends], states=["first", "second", "end"])


def whole(top: object, last: object = (0.0, 0.0)) -> np.ndarray:
    return np.vstack([np.asarray(top), np.asarray(last)])


def test_an_array_that_fits_both_readings_is_refused_everywhere(mdp: MDP, tmp_path: Path) -> None:
    """The same numbers mean the same in memory and in a file, or are refused in both."""
    table = whole(BOTH)
    np.save(tmp_path / "q.npy", table)
    np.savez(tmp_path / "q.npz", q=table)
    save(mdp, tmp_path / "m.npz")
    forms: list[Any] = [table, table.tolist(), tmp_path / "q.npy", str(tmp_path / "q.npz")]
    for form in forms:
        for reader in (
            lambda form: check(mdp, form),
            lambda form: evaluate(mdp, form),
            lambda form: Policy.of(mdp, form),
            lambda form: assert_policy_optimal(mdp, form),
            lambda form: return_distribution(mdp, form),
            lambda form: simulate(mdp, form, 5, 0),
        ):
            with pytest.raises(ModelError, match="are these probabilities or a Q-table") as error:
                reader(form)
            assert "first" in error.value.where
            assert "--kind" in error.value.fix
        assert check(mdp, form, kind="q").read_as == "q"
        assert check(mdp, form, kind="q").regret.learned.value == 3
        assert check(mdp, form, kind="policy").read_as == "policy"
        assert float(check(mdp, form, kind="policy").regret.learned.value) == pytest.approx(2.3)
        assert evaluate(mdp, form, kind="q").mean == 3
        assert evaluate(mdp, form, kind="policy").mean == pytest.approx(2.3)
        assert simulate(mdp, form, 5, 0, kind="q").mean == 3
        assert return_distribution(mdp, form, kind="q").mean == 3
    model, file = tmp_path / "m.npz", tmp_path / "q.npy"
    for words in (("check",), ("evaluate",), ("returns",), ("simulate", "--episodes", "5")):
        done = run(*words, model, file)
        assert (done.status, done.out) == (2, "")
        assert "are these probabilities or a Q-table" in done.err
        for kind, line in (("q", "a Q-table"), ("policy", "action probabilities")):
            answer = run(*words, model, file, "--kind", kind, "--json")
            assert answer.result["read_as"] == kind
            text = run(*words, model, file, "--kind", kind).out
            assert line in text.splitlines()[0]


def test_the_rule_of_auto(mdp: MDP) -> None:
    """No distributions: a Q-table. Ones and noughts: the same policy either way."""
    q = check(mdp, whole([[3, 1], [1, 2]]))
    assert (q.read_as, q.passed) == ("q", True)
    asked = "read as a Q-table: its greedy policy, discount 1, start state first"
    assert q.message().splitlines()[0] == asked
    certain = check(mdp, whole([[1, 0], [0, 1]], [7, np.nan]))
    assert (certain.read_as, certain.passed) == ("policy", True)
    assert certain.q_error is None
    assert check(mdp, [0, 1, 0]).read_as == "policy"
    assert check(mdp, "random").read_as == "policy"
    with pytest.raises(ModelError, match="not a distribution"):
        check(mdp, whole([[3, 1], [1, 2]]), kind="policy")
    with pytest.raises(ModelError, match="not a kind of array"):
        check(mdp, whole([[3, 1], [1, 2]]), kind="table")
    for words in ("random", {"first": "0", "second": "1", "end": "0"}, Policy.uniform(mdp)):
        with pytest.raises(ModelError, match="not a Q-table"):
            check(mdp, words, kind="q")
    with pytest.raises(ModelError):
        check(mdp, np.array([0, 1, 0]), kind="q")


@pytest.mark.parametrize("last", [(0, 0), (np.nan, np.nan), (np.inf, -np.inf), (-np.inf, -np.inf)])
def test_rows_of_terminal_states_may_hold_anything(mdp: MDP, last: tuple[float, float]) -> None:
    """Nothing is chosen where everything has ended."""
    for kind in ("q", "policy"):
        assert check(mdp, whole([[1.0, 0], [0, 1]], last), kind=kind).passed
    assert check(mdp, whole([[2.0, 0], [0, 3]], last)).passed
    assert check(mdp, whole([[1.0, 0], [0, 1]], last)).read_as == "policy"


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_rows_that_say_nothing_are_refused_by_state(
    mdp: MDP, number: float, tmp_path: Path
) -> None:
    """NaN or +inf on an action offered, or -inf on all of them, chooses nothing."""
    save(mdp, tmp_path / "m.npz")
    for row in ([number, 1], [-np.inf, -np.inf], [number, number]):
        table = whole([[3.0, 1], row])
        np.save(tmp_path / "q.npy", table)
        for form in (table, tmp_path / "q.npy", table.astype(np.float32), table.tolist()):
            with pytest.raises(ModelError) as error:
                check(mdp, form)
            assert "second" in error.value.where
        done = run("check", tmp_path / "m.npz", tmp_path / "q.npy")
        assert (done.status, done.out) == (2, "")
    assert check(mdp, whole([[3.0, -np.inf], [-np.inf, 2]])).passed


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.longdouble, object])
def test_q_tables_are_compared_as_they_are(mdp: MDP, dtype: Any, tmp_path: Path) -> None:
    """2^53 and 2^53 + 1 are two numbers; as doubles they would tie and the first would win."""
    if dtype is np.longdouble and np.finfo(np.longdouble).nmant < 60:
        pytest.skip("long double is double here")
    table = np.zeros((3, 2), dtype=dtype)
    table[0] = [2**53 + 1, 2**53]
    table[1] = [2**53, 2**53 + 1]
    forms: list[Any] = [table]
    if dtype is not object:
        np.save(tmp_path / "q.npy", table)
        forms.append(tmp_path / "q.npy")
    if dtype is np.int64:
        forms.append(table.tolist())
        forms.append([[2**53 + 1, float(2**53)], [2**53, F(2**53) + F(1, 3)], [0, 0]])
    for form in forms:
        audit = check(mdp, form)
        assert (audit.read_as, audit.passed) == ("q", True)
        assert Policy.of(mdp, table, kind="q").choices(mdp).tolist()[:2] == [0, 1]


def test_numbers_beyond_floats_are_compared_too(mdp: MDP) -> None:
    """Integers and fractions of any size decide; statistics of errors leave them out."""
    audit = check(mdp, [[10**400 + 1, 10**400], [F(1, 10**400), F(2, 10**400)], [0, 0]])
    assert audit.passed
    assert audit.q_error is not None
    if np.finfo(np.longdouble).max > np.finfo(np.float64).max:
        table = np.array([[2, 1], [1, 2], [0, 0]], dtype=np.longdouble) * np.longdouble("1e400")
        assert check(mdp, table).passed


# ---- policies that are none of the model's -----------------------------------------------------


def rare() -> MDP:
    """Return a choice between 5 and 0; a third action is offered in state 1 alone."""
    rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 0)]), (1, 1, [(1, 2, 0)]), (1, 2, [(1, 2, 0)])]
    return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])


LEAST, ENDS = F(1, 10**400), [[0, 1, 0], [0, 0, 0]]
MASKED = np.ma.masked_array([[9.0, 1, 0], *ENDS], mask=np.eye(3) * [1, 0, 0])


@pytest.mark.parametrize(
    ("given", "kind", "what"),
    [
        # What a policy does once in a billion visits is part of it.
        *(
            ([[1, 0, chance], *ENDS], "policy", "not available")
            for chance in (5e-10, 1e-17, 5e-324)
        ),
        # 5/10^400 is given up by who takes the second action once in 10^400 times.
        ([[1 - LEAST, LEAST, 0], *ENDS], "policy", "smaller than any float"),
        ({"0": {"0": 1 - LEAST, "1": "1e-400"}, "1": "1", "2": "0"}, "auto", "smaller than any"),
        (MASKED, "q", "masked"),
        (np.array([[float("nan"), F(1, 3), 0], *ENDS], dtype=object), "auto", "NaN"),
    ],
)
def test_what_is_hidden_is_refused_and_numpy_says_nothing(given: Any, kind: str, what: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ModelError, match=what):
            check(rare(), given, kind=kind)


def test_what_hides_nothing_is_taken() -> None:
    """An array without a masked entry, a matrix, and what is done once in 10^17 visits."""
    table = [[9.0, 1.0, 0.0], *ENDS]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        matrix = np.asmatrix(table)
    for given in (np.ma.masked_array(table), matrix):
        assert check(rare(), given, kind="q").passed
    assert check(rare(), [[1, 0, 0], *ENDS], kind="policy").passed
    for chance in (5e-10, 1e-17, 5e-324):
        audit = check(rare(), [[1, chance, 0], *ENDS], kind="policy")
        assert not audit.passed
        assert audit.regret.at_start.value > 0


def test_action_numbers_by_time_are_told_from_tables() -> None:
    """(2, 2) whole numbers may be actions by time and state, a Q-table, or a policy."""
    stay, go = (0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)])
    rows = [stay, go, (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, 3)])]
    mdp = MDP.from_outcomes(rows).within(2)
    for given in ([[0, 1], [1, 0]], [[1, 1], [0, 1]]):
        with pytest.raises(ModelError, match="may be action numbers"):
            check(mdp, np.array(given))
        assert check(mdp, np.array(given), kind="q").read_as == "q"
    assert check(mdp, np.array([[5, 6], [3, 9]])).read_as == "q"


def test_every_form_of_a_policy_and_of_a_q_table(tmp_path: Path) -> None:
    mdp = SMALL.compile()
    q = np.random.default_rng(5).normal(size=(16, 4))
    greedy = q.argmax(axis=1)
    by_name = {format(s, "04b"): mdp.actions[a] for s, a in enumerate(greedy)}
    keys = mdp.space.values("status")
    whole = q[keys]  # the end reads the last row, which does not matter
    np.save(tmp_path / "q.npy", q)
    np.savez(tmp_path / "q.npz", q=whole, other=np.zeros(3))
    np.save(tmp_path / "regular.npy", whole[:-1])
    Policy.of(mdp, by_name).write(tmp_path / "policy.json")
    Policy.of(mdp, by_name).write(tmp_path / "policy.csv")
    tables = [q, q.tolist(), whole, whole[:-1], (1000 * q).astype(int)]
    tables += [tmp_path / "q.npy", str(tmp_path / "q.npz"), tmp_path / "regular.npy"]
    others = [by_name, Policy.of(mdp, by_name), greedy[keys], np.eye(4)[greedy[keys]]]
    others += [tmp_path / "policy.json", str(tmp_path / "policy.csv")]
    others += [np.eye(4, dtype=int)[greedy[keys]]]
    run = SimpleNamespace(q=q, policy=lambda mdp: Policy.of(mdp, q, kind="q"))
    expected = check(mdp, by_name).regret.at_start
    for learned in (*tables, run, Policy.of(mdp, q, kind="q")):  # which knows its Q-table
        audit = check(mdp, learned)
        assert audit.regret.at_start == expected
        assert audit.q_error is not None
    for learned in others:
        audit = check(mdp, learned)
        assert (audit.regret.at_start, audit.q_error) == (expected, None)
    for solved in (solve(mdp), certify(mdp)):
        assert check(mdp, solved).passed
    assert check(mdp, "always:none").regret.learned.value == pytest.approx(
        evaluate(mdp, "always:none").mean
    )


@pytest.mark.parametrize(
    "learned",
    [
        np.full((16, 4), np.nan),
        np.zeros((15, 4)),
        np.zeros((16, 5)),
        np.zeros(16),
        np.array([["a"]]),
        {"0000": "none"},
        {"0000": "nothing"},
        "always:nothing",
        "missing.npy",
        3,
        None,
    ],
)
def test_what_does_not_fit_the_model_is_refused(learned: object) -> None:
    with pytest.raises(ModelError):
        check(SMALL.compile(), learned)


def test_action_numbers_that_are_not_whole_are_refused() -> None:
    """0.9 is not action 0."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])])
    with pytest.raises(ModelError, match="not all numbers of actions"):
        Policy.by(mdp, ("state",), [0.9, 0.0])
    assert Policy.by(mdp, ("state",), [1, 0]).weights(mdp).tolist() == [0.0, 1.0, 1.0]


SHORT = ["float16", "float32", "bfloat16"]


def short(rows: np.ndarray, kind: str) -> np.ndarray:
    """Return rows rounded to a type of networks; a bfloat16 is the first half of a float32."""
    if kind != "bfloat16":
        return rows.astype(kind)
    bits = rows.astype(np.float32).view(np.uint32) + np.uint32(0x8000)
    return (bits & np.uint32(0xFFFF0000)).view(np.float32)


class Tensor:
    """An array by its protocol alone."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.array, dtype=dtype)


@pytest.mark.parametrize("kind", SHORT)
@pytest.mark.parametrize("actions", [2, 3, 18])
def test_probabilities_of_a_network_are_no_q_table(kind: str, actions: int, tmp_path: Path) -> None:
    """Rows of short floats miss 1 by their rounding; they are refused, or divided by their sums."""
    rng, states = np.random.default_rng(actions), 6
    law = np.tile(np.eye(states), (actions, 1, 1))
    mdp = MDP.from_arrays(law, rng.random((states, actions)), discount=0.5)
    logits = rng.normal(size=(states, actions))
    table = short(np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True), kind)
    assert (np.abs(table.astype(float).sum(axis=1) - 1) > 1e-9).any()
    np.save(tmp_path / "p.npy", table)
    np.savez(tmp_path / "p.npz", q=table)
    forms: list[Any] = [table, table.astype(float), table.tolist(), [*table], Tensor(table)]
    forms += [dict(enumerate(table)), lambda state: table[int(state)]]
    forms += [tmp_path / "p.npy", tmp_path / "p.npz"]
    exact = [[F(float(x)) for x in row] for row in table]
    value = sum(
        F(float(mdp.reward[pair])) * exact[0][mdp.pair_action[pair]] for pair in mdp.pairs_of(0)
    )
    for form in forms:
        with pytest.raises(ModelError, match="are these probabilities or a Q-table"):
            check(mdp, form)
        audit = check(mdp, form, kind="policy")
        assert audit.regret.learned.value == 2 * value / sum(exact[0])  # discount 1/2
        assert audit.read_as == "policy"
        assert check(mdp, form, kind="q").read_as == "q"
    by_name = {str(s): dict(zip(mdp.actions, table[s], strict=True)) for s in range(states)}
    lines = [f"{s},{a},{x!s}" for s, row in by_name.items() for a, x in row.items()]
    (tmp_path / "p.csv").write_text("\n".join(["state,action,probability", *lines]))
    assert check(mdp, by_name).regret.learned.value == 2 * value / sum(exact[0])
    if kind == "float32":  # as text: in as many digits as tell it from other floats
        printed = check(mdp, tmp_path / "p.csv").regret.learned.value
        assert float(printed) == pytest.approx(float(2 * value / sum(exact[0])), rel=1e-6)
    else:
        with pytest.raises(ModelError, match="not a distribution"):
            check(mdp, short(table * 1.2, kind), kind="policy")


def test_a_row_beyond_the_rounding_of_its_type_is_a_row_of_action_values(mdp: MDP) -> None:
    """One part in 2^24 for each entry and one more is all that float32 explains; doubles less."""
    off = whole([[0.5, 0.5 + 2.0**-20], [0.1, 0.9]])
    assert check(mdp, off.astype(np.float32)).read_as == "q"
    with pytest.raises(ModelError, match="not a distribution"):
        check(mdp, off.astype(np.float32), kind="policy")
    with pytest.raises(ModelError, match="not a distribution"):
        check(mdp, {"first": {"0": 0.333, "1": 0.666}, "second": "0"})


def test_the_first_line_says_what_was_read(mdp: MDP) -> None:
    """With the discount and the horizon: all that a number rests on."""
    first = str(check(mdp, whole(BOTH), kind="policy", horizon=3)).splitlines()[0]
    assert first == "read as action probabilities, discount 1, horizon 3, start time 0, state first"
    assert "read as a Q-table" in str(check(mdp, whole(BOTH), kind="q")).splitlines()[0]


def test_what_is_printed_says_that_the_limit_of_an_environment_is_left_out(mdp: MDP) -> None:
    limited = mdp.with_(time_limit=7)
    audit = check(limited, whole(BOTH), kind="q")
    for text in (str(audit), audit.message()):
        assert text.endswith("answer is for episodes without a limit: horizon=7")
    for model, horizon in ((mdp, None), (limited, 7)):
        other = check(model, whole(BOTH), kind="q", horizon=horizon)
        assert "limit" not in str(other) + other.message()


def test_a_loss_names_the_columns_that_a_policy_does_not_see(mdp: MDP) -> None:
    said = check(mdp, whole(BOTH), kind="q", horizon=3).report().facts["representation"]
    assert "cannot see time, " in str(said)
