"""One array, one meaning: a policy or a Q-table, in memory and in files."""

import warnings
from collections.abc import Callable
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
    assert_policy_optimal,
    check,
    evaluate,
    return_distribution,
    save,
    simulate,
)

# Two states with a choice each, then the end, which has two actions as well.
WALK = MDP.from_outcomes(
    [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 2, 0)]), (1, 1, [(1, 2, 2)]),
     (2, 0, [(1, 2, 0)]), (2, 1, [(1, 2, 0)])],
    states=["first", "second", "end"],
)  # fmt: skip
BOTH = [[0.5, 0.5], [0.1, 0.9]]
READERS: dict[str, Callable[..., Any]] = {  # each way to ask what a policy is worth
    "check": lambda form, **how: check(WALK, form, **how).regret.learned.value,
    "assert": lambda form, **how: assert_policy_optimal(WALK, form, 9, **how).regret.learned.value,
    "evaluate": lambda form, **how: evaluate(WALK, form, **how).mean,
    "policy": lambda form, **how: evaluate(WALK, Policy.of(WALK, form, **how)).mean,
    "returns": lambda form, **how: return_distribution(WALK, form, **how).mean,
    "simulate": lambda form, **how: simulate(WALK, form, 20_000, 0, **how).mean,
}


def whole(top: object, last: object = (0.0, 0.0)) -> np.ndarray:
    return np.vstack([np.asarray(top), np.asarray(last)])


def test_an_array_that_fits_both_readings_is_refused_everywhere(tmp_path: Path) -> None:
    """The same numbers mean the same in memory and in a file, or are refused in both."""
    model, file = tmp_path / "m.npz", tmp_path / "q.npy"
    np.save(file, whole(BOTH))
    np.savez(tmp_path / "q.npz", q=whole(BOTH))
    save(WALK, model)
    for form in (whole(BOTH), whole(BOTH).tolist(), file, str(tmp_path / "q.npz")):
        for value_of in READERS.values():
            with pytest.raises(ModelError, match="are these probabilities or a Q-table") as error:
                value_of(form)
            assert "first" in error.value.where
            assert "--kind" in error.value.fix
            assert value_of(form, kind="q") == 3
            assert float(value_of(form, kind="policy")) == pytest.approx(2.3, abs=0.02)
        assert [check(WALK, form, kind=kind).read_as for kind in ("q", "policy")] == ["q", "policy"]
    for words in ("check", "evaluate", "returns", "simulate --episodes 5"):
        assert "are these probabilities or a Q-table" in run(words, model, file).refusal()
        for kind, line in (("q", "a Q-table"), ("policy", "action probabilities")):
            assert run(words, model, file, "--kind", kind, "--json").result["read_as"] == kind
            assert line in run(words, model, file, "--kind", kind).out.splitlines()[0]


@pytest.mark.parametrize(
    "words",
    [
        *("tornado", "gradient", "robust", "curve --parameter discount", "sobol --samples 2"),
        *("one-way --parameter discount --points 2", "psa --samples 2 --n-jobs 1"),
        "two-way --parameter discount --parameter reward.1 --points 2",
    ],
)
def test_where_parameters_vary_one_says_what_an_array_is(words: str, tmp_path: Path) -> None:
    rows = [(0, 0, [("1/2", 1, 1), ("1/2", 0, 1)]), (0, 1, [(1, 1, 0)])]
    rows += [(1, 0, [(1, 1, 0)]), (1, 1, [(1, 0, 2)])]
    save(MDP.from_outcomes(rows, "9/10"), tmp_path / "m.npz")
    np.save(tmp_path / "q.npy", BOTH)
    line = (words, tmp_path / "m.npz", "--policy", tmp_path / "q.npy", "--json")
    assert "--kind policy" in run(*line).refusal()
    for kind in ("q", "policy"):
        assert run(*line, "--kind", kind).result["read_as"] == kind


def test_the_rule_of_auto() -> None:
    """No distributions: a Q-table. Ones and noughts: the same policy either way."""
    q = check(WALK, whole([[3, 1], [1, 2]]))
    assert (q.read_as, q.passed) == ("q", True)
    asked = "read as a Q-table: its greedy policy, discount 1, start state first"
    assert q.message().splitlines()[0] == asked
    ones = np.array([[1, 0], [0, 1], [0, 0]])
    for form in (ones, whole(ones[:2], [7, np.nan]), [0, 1, 0]):
        certain = check(WALK, form)
        assert (certain.read_as, certain.passed, certain.q_error) == ("policy", True, None)
    assert check(WALK, "random").read_as == "policy"
    run = SimpleNamespace(q=whole(BOTH), policy=lambda mdp: "random")  # what a learner has
    assert (check(WALK, run).read_as, check(WALK, run).regret.learned.value) == ("q", 3)
    assert check(WALK, whole([[3.0, -np.inf], [-np.inf, 2]])).passed
    within = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)]),
                                (1, 1, [(1, 1, 3)])]).within(2)  # fmt: skip
    assert check(within, np.array([[1, 1], [0, 1]]), kind="q").read_as == "q"
    assert check(within, np.array([[5, 6], [3, 9]])).read_as == "q"


@pytest.mark.parametrize("last", [(0, 0), (np.nan, np.nan), (np.inf, -np.inf), (-np.inf, -np.inf)])
def test_rows_of_terminal_states_may_hold_anything(last: tuple[float, float]) -> None:
    """Nothing is chosen where everything has ended."""
    for kind in ("q", "policy"):
        assert check(WALK, whole([[1.0, 0], [0, 1]], last), kind=kind).passed
    assert check(WALK, whole([[2.0, 0], [0, 3]], last)).passed
    assert check(WALK, whole([[1.0, 0], [0, 1]], last)).read_as == "policy"


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.longdouble, object])
def test_q_tables_are_compared_as_they_are(dtype: Any, tmp_path: Path) -> None:
    """2^53 and 2^53 + 1 are two numbers; as doubles they would tie and the first would win."""
    if dtype is np.longdouble and np.finfo(np.longdouble).nmant < 60:
        pytest.skip("long double is double here")
    table = np.array([[2**53 + 1, 2**53], [2**53, 2**53 + 1], [0, 0]], dtype=dtype)
    forms: list[Any] = [table, Policy.of(WALK, table, kind="q")]
    if dtype is not object:
        np.save(tmp_path / "q.npy", table)
        forms.append(tmp_path / "q.npy")
    if dtype is np.int64:
        forms.append(table.tolist())
        forms.append([[2**53 + 1, float(2**53)], [2**53, F(2**53) + F(1, 3)], [0, 0]])
    for form in forms:
        audit = check(WALK, form)
        assert (audit.read_as, audit.passed) == ("q", True)
        assert audit.q_error is not None


def test_what_hides_nothing_is_taken() -> None:
    """An array without a masked entry, a matrix, and what is done once in 10^17 visits."""
    table = [[9.0, 1.0], [0, 1], [0, 0]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        matrix = np.asmatrix(table)
    for form in (np.ma.masked_array(table), matrix):
        assert check(WALK, form, kind="q").passed
    for chance in (5e-10, 1e-17, 5e-324):
        audit = check(WALK, [[1, chance], [0, 1], [0, 0]], kind="policy")
        assert not audit.passed
        assert audit.regret.at_start.value > 0


# ---- numbers of networks -------------------------------------------------------------------------


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


@pytest.mark.parametrize("kind", ["float16", "float32", "bfloat16"])
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
    row = [F(float(x)) for x in table[0]]
    gains = mdp.reward[mdp.pairs_of(0)].tolist()
    value = 2 * sum(F(r) * p for r, p in zip(gains, row, strict=True)) / sum(row)  # discount 1/2
    for form in forms:
        with pytest.raises(ModelError, match="are these probabilities or a Q-table"):
            check(mdp, form)
        audit = check(mdp, form, kind="policy")
        assert (audit.regret.learned.value, audit.read_as) == (value, "policy")
        assert check(mdp, form, kind="q").read_as == "q"
    by_name = {str(s): dict(zip(mdp.actions, table[s], strict=True)) for s in range(states)}
    assert check(mdp, by_name).regret.learned.value == value
    if kind == "float32":  # as text: in as many digits as tell it from other floats
        lines = [f"{s},{a},{x!s}" for s, each in by_name.items() for a, x in each.items()]
        (tmp_path / "p.csv").write_text("\n".join(["state,action,probability", *lines]))
        printed = check(mdp, tmp_path / "p.csv").regret.learned.value
        assert float(printed) == pytest.approx(float(value), rel=1e-6)
    else:
        with pytest.raises(ModelError, match="not a distribution"):
            check(mdp, short(table * 1.2, kind), kind="policy")


def test_a_row_beyond_the_rounding_of_its_type_is_a_row_of_action_values() -> None:
    """One part in 2^24 for each entry and one more is all that float32 explains; doubles less."""
    off = whole([[0.5, 0.5 + 2.0**-20], [0.1, 0.9]]).astype(np.float32)
    assert check(WALK, off).read_as == "q"
    thirds = {"first": {"0": 0.333, "1": 0.666}, "second": "0"}
    for form, kind in ((off, "policy"), (thirds, "auto")):
        with pytest.raises(ModelError, match="not a distribution"):
            check(WALK, form, kind=kind)


# ---- what is said of it --------------------------------------------------------------------------


def test_what_is_printed_says_all_that_a_number_rests_on() -> None:
    """What was read, the discount, the horizon, and that an environment's limit is left out."""
    table, limited = whole(BOTH), WALK.with_(time_limit=7)
    first = str(check(WALK, table, kind="policy", horizon=3)).splitlines()[0]
    assert first == "read as action probabilities, discount 1, horizon 3, start time 0, state first"
    audit = check(limited, table, kind="q")
    for text in (str(audit), audit.message()):
        assert "read as a Q-table" in text.splitlines()[0]
        assert text.endswith("answer is for episodes without a limit: horizon=7")
    for model, horizon in ((WALK, None), (limited, 7)):
        other = check(model, table, kind="q", horizon=horizon)
        assert "limit" not in str(other) + other.message()
    why = check(WALK, table, kind="q", horizon=3).report().facts["representation"]
    assert "cannot see time, " in str(why)
