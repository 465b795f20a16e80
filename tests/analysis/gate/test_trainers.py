"""A gate for random trainers: the interval that holds at every moment, and what stops by it."""

import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_runner import run

from exact_mdp import MDP, Policy, QLearning, Scenario, check_trainer

# ---- the gate ------------------------------------------------------------------------------------

TWO = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])


def often(share: int) -> Iterator[list[int]]:
    """Right in `share` of ten runs."""
    while True:
        yield from [[int(i < share), 0] for i in (3, 7, 0, 9, 2, 5, 8, 1, 6, 4)]


def test_what_is_open_passes_unless_it_has_to_be_proven() -> None:
    for prove in (False, True):
        verdict = check_trainer(TWO, often(9), runs=40, share="9/10", prove=prove)
        assert (verdict.proven, verdict.passed, len(verdict.audits)) == (None, not prove, 40)
        what = "the share of runs within the limits is"
        side = "at least" if prove else "below"
        assert f"{what} not proven to be {side} 0.9" in verdict.message()
    assert check_trainer(TWO, often(10), runs=200, prove=True).proven
    assert check_trainer(TWO, often(9), runs=200, share="1/2", prove=True).proven
    few = check_trainer(TWO, [[1, 0]] * 3, runs=9)
    assert (len(few.audits), few.passed, few.worst.passed) == (3, True, True)
    assert not check_trainer(TWO, [[1, 0], [0, 0], [1, 0]], share=1).passed  # one is enough
    assert check_trainer(TWO, often(0), max_regret=2).passed
    assert not check_trainer(TWO, often(0), max_regret="199/100").passed


def test_a_trainer_is_judged_by_its_seeds() -> None:
    seeds: list[int] = []

    def train(seed: int) -> list[int]:
        seeds.append(seed)
        return [seed % 2, 0]

    verdict = check_trainer(TWO, train, rng=0, share="9/10", alpha="1/20")
    assert (verdict.proven, verdict.passed, list(verdict.names)) == (False, False, seeds)
    assert verdict.frame()["passed"].tolist() == [seed % 2 == 1 for seed in seeds]
    assert verdict.frame()["regret"].tolist() == [2 * (1 - seed % 2) for seed in seeds]
    assert verdict.within == sum(seed % 2 for seed in seeds)
    assert verdict.value == verdict.within / len(seeds)
    assert "is not at least 0.9" in verdict.message()
    assert f"the run that lost most, {next(s for s in seeds if s % 2 == 0)}:" in verdict.message()
    one_less = check_trainer(TWO, [[s % 2, 0] for s in seeds[:-1]], share="9/10", alpha="1/20")
    assert one_less.proven is None  # it stops as soon as it knows
    again = list(seeds)
    check_trainer(TWO, train, rng=0, share="9/10", alpha="1/20")
    assert seeds == again * 2


def test_three_bad_runs_fail_and_a_proof_may_be_asked_for_with_any() -> None:
    """Two bad runs leave a share of 9/10 open, which is refused."""
    for train in (lambda seed: [0, 0], [[0, 0]] * 9):
        assert not check_trainer(TWO, train, runs=3, rng=0).passed
        assert not check_trainer(TWO, train, runs=2, rng=0, prove=True).passed


def test_an_optimum_is_found_once_for_each_model() -> None:
    audits = check_trainer(TWO, [[0, 0], [1, 0]], runs=2, prove=True).audits
    assert len({id(audit.regret.optimum) for audit in audits}) == 1 < len(audits)


@pytest.mark.parametrize("columns", [None, ("trial", "status"), ("trial",), "all"])
def test_a_training_run_is_a_policy_whatever_it_reads(columns: object) -> None:
    """A table over columns, and one with actions that only forced states have."""
    mdp = Scenario.load("tea").compile()
    read = mdp.space.names if columns == "all" else columns
    trained = QLearning(epochs=3, columns=read).train(mdp, rng=0)
    mine, theirs = Policy.of(mdp, trained).weights(mdp), trained.policy(mdp).weights(mdp)
    free = ~(mdp.forced | mdp.terminal)[mdp.pair_state]
    assert mine[free].tolist() == theirs[free].tolist()


# ---- the command ---------------------------------------------------------------------------------


def test_check_takes_the_policies_of_many_seeds(tmp_path: Path) -> None:
    model, report = tmp_path / "two.npz", tmp_path / "r.xml"
    TWO.save(model)
    policies = [str(tmp_path / f"seed-{number:02}.npy") for number in range(30)]
    for path, policy in zip(policies, often(4), strict=False):
        np.save(path, np.array(policy))
    done = run("check", model, *policies, "--alpha", "1/20", "--junit", report, "--json")
    result = done.result
    wanted = check_trainer(TWO, often(4), runs=30, alpha="1/20")
    assert (done.status, result["passed"], result["proven"]) == (1, False, False)
    assert result["claim"] == "estimated"
    assert (result["runs"], result["given"]) == (len(wanted.audits), 30)
    assert result["within"] == wanted.within
    assert result["share_interval"] == [float(end) for end in wanted.interval]
    assert [each["policy"] for each in result["policies"]] == policies[: result["runs"]]
    failure = ElementTree.parse(report).getroot().find(".//failure")
    assert failure is not None
    assert "is not at least 0.9" in str(failure.get("message"))
    shown = run("check", model, *policies, "--share", "1/4")
    assert shown.status == 0
    assert "passed: the share of runs within the limits" in shown.out
    assert "| policy" in run("check", model, *policies, "--share", "1/4", "--markdown").out


def test_a_trainer_that_ends_the_program_has_no_verdict() -> None:
    """Neither while it trains, nor in the policy that it returns, nor in a list made on the way."""
    mdp, end = Scenario.load("tea").compile(), sys.exit
    for train in (
        lambda seed: end(0),
        lambda seed: lambda state: end(0),
        (end(0) for _ in range(9)),
    ):
        with pytest.raises(RuntimeError, match=r"sys.exit\(0\) was called before"):
            check_trainer(mdp, train, runs=9, alpha="1/20", rng=0)
