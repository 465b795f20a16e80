"""A gate for random trainers: the interval that holds at every moment, and what stops by it."""

import os
import sys
from collections.abc import Callable, Iterator
from fractions import Fraction as F
from importlib import import_module
from itertools import count
from math import log
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import betaln
from scipy.stats import binomtest

from exact_mdp import MDP, ModelError, Policy, QLearning, Scenario, check, check_trainer
from exact_mdp.analysis.learning.anytime import GRID, excluded, fewest, share_intervals
from exact_mdp.analysis.learning.trainers import _decided

SHARES = st.fractions(F(1, 50), F(49, 50), max_denominator=50)
ROUNDING = 1 - F(1, 10**9)


def won(share: F, hits: int, misses: int) -> F:
    """E_n as a bettor earns it: trial by trial, on the share that Krichevsky and Trofimov guess."""
    purse, k, n = F(1), 0, 0
    for trial in [True] * hits + [False] * misses:
        guess = (k + F(1, 2)) / (n + 1)
        purse *= guess / share if trial else (1 - guess) / (1 - share)
        k, n = k + trial, n + 1
    return purse


# ---- the interval --------------------------------------------------------------------------------


@given(SHARES, st.integers(0, 30), st.integers(0, 30))
def test_what_is_won_is_the_mixture_and_a_martingale(share: F, hits: int, misses: int) -> None:
    purse = won(share, hits, misses)
    expected = share * won(share, hits + 1, misses) + (1 - share) * won(share, hits, misses + 1)
    assert expected == purse
    if purse > 1:  # `excluded` finds the same number, to a billionth
        assert excluded(share, hits, misses, 1 / purse)
        assert not excluded(share, hits, misses, ROUNDING / purse)
    p = float(share)
    mixture = betaln(hits + 0.5, misses + 0.5) - betaln(0.5, 0.5)
    assert log(purse) == pytest.approx(mixture - hits * log(p) - misses * log(1 - p), abs=1e-9)


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.sampled_from([F(1, 20), F(1, 100)]))
def test_intervals_hold_all_shares_not_excluded_so_far(trials: list[bool], alpha: F) -> None:
    found, (low, high) = list(share_intervals(trials, alpha)), (F(0), F(1))
    for n, (left, right) in enumerate(found, 1):
        k = sum(trials[:n])
        assert low <= left <= right <= high  # they only narrow
        for end, sign in ((left, 1), (right, -1)):
            if end not in (low, high):
                assert excluded(end, k, n - k, alpha)
                assert not excluded(end + F(sign, GRID), k, n - k, alpha)
        inside = [j for j in range(1, 100) if left < F(j, 100) < right]
        assert not any(excluded(F(j, 100), k, n - k, alpha) for j in inside)
        low, high = left, right


@given(SHARES, st.fractions(F(1, 1000), F(1, 2), max_denominator=1000))
def test_the_fewest_runs_that_can_fail(share: F, alpha: F) -> None:
    assert fewest(share, alpha) == next(n for n in count(1) if excluded(share, 0, n, alpha))


LIMIT, ALPHA = F(9, 10), F(1, 20)
LONGEST = 250


@pytest.fixture(scope="module")
def decisions() -> np.ndarray:
    """1 where the gate has passed after n runs of which k did (n, k), -1 where failed, 0 open."""
    table = np.zeros((LONGEST + 1, LONGEST + 1), dtype=int)
    for n in range(1, LONGEST + 1):
        for k in range(n + 1):
            found = _decided(k, n, LIMIT, ALPHA)
            table[n, k] = 0 if found is None else 1 if found else -1
    return table


def law(decisions: np.ndarray, share: float) -> tuple[float, float, float]:
    """How likely the gate passes and fails, and after how many runs it stops on average."""
    alive, passes, fails, runs = np.array([1.0]), 0.0, 0.0, 0.0
    for n in range(1, LONGEST + 1):
        runs += alive.sum()
        alive = np.append(alive, 0) * (1 - share) + np.append(0, alive) * share
        told = decisions[n, : n + 1]
        passes, fails = passes + alive[told > 0].sum(), fails + alive[told < 0].sum()
        alive = np.where(told == 0, alive, 0)
    return passes, fails, runs


@pytest.mark.parametrize("share", [0.9, 0.905, 0.95])
def test_a_good_trainer_hardly_ever_fails(decisions: np.ndarray, share: float) -> None:
    """Exactly, by recursion; and in streams, each stopped where it suits a false alarm best."""
    _, fails, _ = law(decisions, share)
    assert fails <= float(ALPHA)
    rng = np.random.default_rng(20)
    hits = np.cumsum(rng.random((4000, LONGEST)) < share, axis=1)
    alarms = int((decisions[np.arange(1, LONGEST + 1), hits] < 0).any(axis=1).sum())
    interval = binomtest(alarms, 4000).proportion_ci(0.999, method="wilson")
    assert interval.low <= float(ALPHA)
    if share == 0.9:  # a bad share is passed as rarely: the same interval, from its other side
        assert law(decisions, share - 0.001)[0] <= float(ALPHA)
        looked = hits[:, 9:] / np.arange(10, LONGEST + 1)
        wilson = looked + 1.96 * np.sqrt(looked * (1 - looked) / np.arange(10, LONGEST + 1))
        assert (wilson < share).any(axis=1).mean() > 2 * 0.025  # what looking costs else


@pytest.mark.parametrize("share", [0.2, 0.5, 0.7])
def test_a_bad_trainer_is_found_soon(decisions: np.ndarray, share: float) -> None:
    """Not before Wald's bound ln(1/α) / KL, and before thrice that: the price of any share."""
    _, fails, runs = law(decisions, share)
    apart = share * log(share / 0.9) + (1 - share) * log((1 - share) / 0.1)
    assert fails > 0.999
    assert log(20) / apart <= runs <= 3 * log(20) / apart + 1


# ---- the gate ------------------------------------------------------------------------------------

TWO = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])


def often(share: int) -> Iterator[list[int]]:
    """Right in `share` of ten runs."""
    while True:
        yield from [[int(i < share), 0] for i in (3, 7, 0, 9, 2, 5, 8, 1, 6, 4)]


def test_a_trainer_is_judged_by_its_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds, solved = list[int](), list[MDP]()
    module = import_module("exact_mdp.analysis.gate.regret")
    proven = module.proven
    monkeypatch.setattr(module, "proven", lambda mdp: solved.append(mdp) or proven(mdp))

    def train(seed: int) -> list[int]:
        seeds.append(seed)
        return [seed % 2, 0]

    found = check_trainer(TWO, train, rng=0, share="9/10", alpha="1/20")
    assert len(solved) == 1  # the optimum is found once
    assert found.proven is False
    assert not found.passed
    assert list(found.names) == seeds
    assert found.frame()["passed"].tolist() == [seed % 2 == 1 for seed in seeds]
    assert set(found.frame()["regret"]) == {0, 2}
    assert found.within == sum(seed % 2 for seed in seeds)
    assert _decided(found.within - seeds[-1] % 2, len(seeds) - 1, F(9, 10), F(1, 20)) is None
    assert found.value == found.within / len(seeds)
    assert "is not at least 0.9" in found.message()
    assert f"the run that lost most, {next(s for s in seeds if s % 2 == 0)}:" in found.message()
    again = list(seeds)
    check_trainer(TWO, train, rng=0, share="9/10", alpha="1/20")
    assert seeds == again * 2
    assert found.plot().get_xlabel() == "run"
    repr(found)


def test_what_is_open_passes_unless_it_has_to_be_proven() -> None:
    for prove in (False, True):
        found = check_trainer(TWO, often(9), runs=40, share="9/10", prove=prove)
        assert (found.proven, found.passed, len(found.audits)) == (None, not prove, 40)
        what = "the share of runs within the limits is"
        assert f"{what} not proven to be {'at least' if prove else 'below'} 0.9" in found.message()
    assert check_trainer(TWO, often(10), runs=200, prove=True).proven
    assert check_trainer(TWO, often(9), runs=200, share="1/2", prove=True).proven
    few = check_trainer(TWO, [[1, 0]] * 3, runs=9)
    assert (len(few.audits), few.passed, few.worst.passed) == (3, True, True)
    assert not check_trainer(TWO, [[1, 0], [0, 0], [1, 0]], share=1).passed  # one is enough
    assert check_trainer(TWO, often(0), max_regret=2).passed
    assert not check_trainer(TWO, often(0), max_regret="199/100").passed


def test_too_few_runs_to_fail_are_refused() -> None:
    """Two bad runs leave a share of 9/10 open, three do not; a proof may be asked for with any."""
    for train in (lambda seed: [0, 0], [[0, 0]] * 9):
        with pytest.raises(ModelError, match="of 2 runs no outcome could fail") as refused:
            check_trainer(TWO, train, runs=2, rng=0)
        assert "give 3 runs or more" in str(refused.value)
        assert not check_trainer(TWO, train, runs=3, rng=0).passed
        assert not check_trainer(TWO, train, runs=2, rng=0, prove=True).passed
    with pytest.raises(ModelError, match="of 2 runs"):  # however many there might have been
        check_trainer(TWO, iter([[1, 0]] * 2))


@pytest.mark.parametrize("one", [[0, 0], np.array([0, 0]), "best.json", Path("a"), {"0": 1}])
def test_one_policy_is_no_list_of_them(one: object) -> None:
    with pytest.raises(ModelError, match="one policy, where runs ask for several"):
        check_trainer(TWO, one)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({"share": 0}, "share is 0"),
        ({"share": "11/10"}, "share is 1.1"),
        ({"share": "many"}, "many"),
        ({"alpha": 1}, "alpha is 1"),
        ({"alpha": -0.5}, "alpha is -0.5"),
        ({"runs": 0}, "runs is 0"),
        ({"rng": None}, "no seed"),
        ({"train": []}, "no policies"),
        ({"max_regret": -1}, "max_regret is -1"),
    ],
)
def test_questions_without_an_answer_are_refused(wrong: dict[str, object], what: str) -> None:
    given = {"train": lambda seed: [1, 0], "rng": 0} | wrong
    with pytest.raises(ModelError, match=what):
        check_trainer(TWO, **given)  # type: ignore[arg-type]


def test_an_audit_is_like_another_of_the_same_model_alone() -> None:
    first = check(TWO, [1, 0])
    assert check(TWO, [0, 0], like=first).value.value == 2
    with pytest.raises(ModelError, match="of another model"):
        check(TWO.with_(discount="1/2"), [0, 0], like=first)


@pytest.mark.parametrize("columns", [None, ("trial", "status"), ("trial",), "all"])
def test_a_training_run_is_a_policy_whatever_it_reads(columns: object) -> None:
    """A table over columns, and one with actions that only forced states have."""
    mdp = Scenario.load("tea").compile()
    read = mdp.space.names if columns == "all" else columns
    trained = QLearning(epochs=3, columns=read).train(mdp, rng=0)  # type: ignore[arg-type]
    mine, theirs = Policy.of(mdp, trained).weights(mdp), trained.policy(mdp).weights(mdp)
    free = ~(mdp.forced | mdp.terminal)[mdp.pair_state]
    assert mine[free].tolist() == theirs[free].tolist()


# ---- the command ---------------------------------------------------------------------------------


@pytest.fixture
def policies(tmp_path: Path) -> list[str]:
    TWO.save(tmp_path / "two.npz")
    found = []
    for number, (policy, _) in enumerate(zip(often(4), range(30), strict=False)):
        path = tmp_path / f"seed-{number:02}.npy"
        np.save(path, np.array(policy))
        found.append(str(path))
    return found


def test_check_takes_the_policies_of_many_seeds(policies: list[str], tmp_path: Path) -> None:
    model, report = str(tmp_path / "two.npz"), tmp_path / "r.xml"
    done = run("check", model, *policies, "--alpha", "1/20", "--junit", str(report), "--json")
    assert done.status == 1
    found = done.result
    wanted = check_trainer(TWO, often(4), runs=30, alpha="1/20")
    assert (found["passed"], found["proven"], found["claim"]) == (False, False, "estimated")
    assert (found["runs"], found["given"]) == (len(wanted.audits), 30)
    assert found["within"] == wanted.within
    assert found["share_interval"] == [float(end) for end in wanted.interval]
    assert [each["policy"] for each in found["policies"]] == policies[: found["runs"]]
    failure = ElementTree.parse(report).getroot().find(".//failure")
    assert failure is not None
    assert "is not at least 0.9" in str(failure.get("message"))
    shown = run("check", model, *policies, "--share", "1/4")
    assert shown.status == 0
    assert "passed: the share of runs within the limits" in shown.out
    table = run("check", model, *policies, "--share", "1/4", "--markdown")
    assert "| policy" in table.out


@pytest.mark.parametrize(
    ("several", "words", "what"),
    [
        (False, ["--share", "1/2"], "--share is a question of several policies"),
        (False, ["--prove"], "--prove is a question of several policies"),
        (True, ["--html", "page.html"], "--html does not apply to several policies"),
        (True, ["--no-explain"], "--no-explain does not apply"),
        (True, ["--share", "2"], "share is 2"),
        (True, ["--share", "1/2"], "give 10 runs or more"),
    ],
)
def test_options_that_do_not_fit(
    policies: list[str], tmp_path: Path, several: bool, words: list[str], what: str
) -> None:
    named = policies[: 3 if several else 1]
    done = run("check", str(tmp_path / "two.npz"), *named, *words)
    assert (done.status, done.out) == (2, "")
    assert what in done.err


@pytest.mark.parametrize("end", [lambda: sys.exit(0), lambda: os._exit(0)])
def test_a_trainer_that_ends_the_program_has_no_verdict(end: Callable[[], None]) -> None:
    """Neither while it trains, nor in the policy that it returns, nor in a list made on the way."""
    mdp = Scenario.load("tea").compile()
    before = os._exit
    for train in (lambda seed: end(), lambda seed: lambda state: end(), (end() for _ in range(9))):
        with pytest.raises(RuntimeError, match=r"sys.exit\(0\) was called before"):
            check_trainer(mdp, train, runs=9, alpha="1/20", rng=0)
    assert os._exit is before
