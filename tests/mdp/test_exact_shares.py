"""Exact probabilities of a policy's actions stay exact in a certified verdict."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, Policy, check, return_distribution, save

TINY = Fraction(1, 10**30)


def once(*rewards: object) -> MDP:
    """Return a model in which one choice is made, and then all ends."""
    choices = [(0, action, [(1, 1, reward)]) for action, reward in enumerate(rewards)]
    return MDP.from_outcomes([*choices, (1, 0, [(1, 1, 0)])])


def exactly(model: MDP, policy: object, **how: object) -> Fraction:
    value = check(model, policy, exact_values=True, **how).regret.at_start.value
    assert isinstance(value, Fraction)
    return value


def forms(share: Fraction) -> list[object]:
    rest = 1 - share
    return [
        {"0": {"0": str(share), "1": str(rest)}},
        {"0": {"0": share, "1": rest}},
        [[share, rest], [1, 0]],
        np.array([[share, rest], [1, 0]], dtype=object),
    ]


@pytest.mark.parametrize("k", range(1, 40))
def test_a_share_in_fortieths_keeps_the_exact_limit_and_no_lower_one(k: int) -> None:
    """With k/40 of the action that loses 5, the regret is k/8: this limit holds, no lower one."""
    model, limit = once(5, 0), Fraction(k, 8)
    for policy in forms(1 - Fraction(k, 40)):
        kind = "auto" if isinstance(policy, dict) else "policy"
        assert check(model, policy, max_regret=limit, kind=kind).passed
    words = forms(1 - Fraction(k, 40))[0]
    audit = check(model, words, max_regret=limit - TINY)
    assert not audit.passed
    assert audit.regret.at_start.value == limit


def test_decimal_words_are_the_decimals_that_they_say() -> None:
    """ "0.9" is 9/10; the float 0.9 is the number that it is."""
    model = once(5, 0)
    assert exactly(model, {"0": {"0": "0.9", "1": "0.1"}}) == Fraction(1, 2)
    high, low = Fraction(0.9), Fraction(0.1)
    assert exactly(model, {"0": {"0": 0.9, "1": 0.1}}) == 5 * low / (high + low)
    assert exactly(model, [[0.9, 0.1], [1, 0]], kind="policy") == 5 * low / (high + low)
    half = {"0": {"0": 0.9, "1": "1/10"}}  # each number is what it is
    assert exactly(model, half) == 5 * Fraction(1, 10) / (high + Fraction(1, 10))


def test_random_is_uniform_exactly() -> None:
    """With three actions, each is drawn with probability 1/3."""
    model = once(1, 0, 0)
    assert exactly(model, "random") == Fraction(2, 3)
    assert check(model, "random", max_regret="2/3").passed
    assert not check(model, "random", max_regret=Fraction(2, 3) - TINY).passed


@pytest.mark.parametrize("suffix", [".csv", ".json"])
@pytest.mark.parametrize("share", ["9/10", "1/3", "1/2", "123456789/1000000007"])
def test_files_keep_exact_shares(tmp_path: Path, suffix: str, share: str) -> None:
    """What is written as "p/q" or as a decimal is read back as the same number."""
    model, path = once(5, 0), tmp_path / f"policy{suffix}"
    policy = Policy.of(model, {"0": {"0": share, "1": str(1 - Fraction(share))}, "1": "0"})
    policy.write(path)
    again = Policy.of(model, path)
    assert exactly(model, again) == 5 * (1 - Fraction(share))
    assert again.table.tolist() == policy.table.tolist()
    second = tmp_path / f"again{suffix}"
    again.write(second)
    assert second.read_bytes() == path.read_bytes()


def test_random_is_written_exactly(tmp_path: Path) -> None:
    """The file of the uniform policy says 1/3, not a float near it."""
    model, path = once(1, 0, 0), tmp_path / "random.csv"
    Policy.of(model, "random").write(path)
    assert "1/3" in path.read_text()
    assert exactly(model, path) == Fraction(2, 3)


def test_the_command_line_keeps_exact_shares(tmp_path: Path) -> None:
    """`check` prints the exact regret and passes at the exact limit."""
    model, policy = tmp_path / "model.npz", tmp_path / "policy.json"
    save(once(5, 0), model)
    policy.write_text('{"0": {"0": "9/10", "1": "1/10"}, "1": "0"}')
    found = run("check", model, policy, "--max-regret", "1/2", "--json")
    assert (found.status, found.result["exact_regret"]) == (0, "1/2")
    assert run("check", model, policy, "--max-regret", "0.4999999999999999999999999").status == 1


def test_shares_of_another_table_are_refused() -> None:
    """A policy cannot say one thing in floats and another exactly."""
    model = once(5, 0)
    table = np.array([[0.5, 0.5], [1.0, 0.0]])
    for shares in ([[9, 1], [1, 0]], [[1, 1]], [[1, 1], [1, 1]], [[0, 0], [1, 0]]):
        with pytest.raises(ModelError, match="differ from the table"):
            Policy(space=model.space, actions=model.actions, rule=table, shares=np.array(shares))


chances = st.lists(st.integers(0, 50), min_size=2, max_size=2).filter(any)


@settings(max_examples=40, deadline=None)
@given(st.lists(chances, min_size=3, max_size=3), st.lists(st.integers(-9, 9), min_size=6,
       max_size=6))  # fmt: skip
def test_a_mixed_policy_is_worth_the_sum_over_its_paths(
    counts: list[list[int]], rewards: list[int]
) -> None:
    """Enumeration in Fractions: state 0 leads to 1 or 2 by the action, then all ends."""
    outcomes = [
        (0, 0, [(1, 1, rewards[0])]),
        (0, 1, [("1/3", 1, rewards[1]), ("2/3", 2, rewards[1])]),
        *((s, a, [(1, 3, rewards[2 * s + a])]) for s in (1, 2) for a in (0, 1)),
        (3, 0, [(1, 3, 0)]),
    ]
    model = MDP.from_outcomes(outcomes)
    share = [[Fraction(n, sum(row)) for n in row] for row in counts]
    later = {s: sum(share[s][a] * rewards[2 * s + a] for a in (0, 1)) for s in (1, 2)}
    expected = share[0][0] * (rewards[0] + later[1])
    expected += share[0][1] * (rewards[1] + later[1] / 3 + later[2] * Fraction(2, 3))
    policy = {
        str(s): {str(a): str(share[s][a]) for a in (0, 1)} for s in range(3)
    } | {"3": "0"}  # fmt: skip
    assert check(model, policy, exact_values=True).regret.learned.value == expected


def test_the_exact_law_of_a_return_has_the_exact_shares() -> None:
    """Probabilities of returns are rounded from thirds, not from floats near them."""
    law = return_distribution(once(0, 1, 2), "random", exact=True)
    assert law.exact == (Fraction(1, 3),) * 3


def test_a_mapping_may_leave_out_where_all_has_ended() -> None:
    """A terminal state needs no row, whatever actions it offers."""
    mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[5, 0], [0, 0]])
    assert check(mdp, {"0": {"0": "9/10", "1": "1/10"}}, max_regret="1/2").passed
