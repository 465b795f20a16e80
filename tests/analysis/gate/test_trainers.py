"""A gate for random trainers: the interval that holds at every moment, and what stops by it."""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_runner import run

from exact_mdp import MDP, ModelError, Policy, QLearning, Scenario, check, check_trainer

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
        assert (
            f"{what} not proven to be {'at least' if prove else 'below'} 0.9" in verdict.message()
        )
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
        ({"alpha": 1}, "a risk of error of 1 proves nothing"),
        ({"alpha": -0.5}, "alpha is -0.5"),
        ({"runs": 0}, "runs is 0"),
        ({"rng": None}, "the seeds of the runs are drawn from it"),
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
    each_policy = []
    for number, (policy, _) in enumerate(zip(often(4), range(30), strict=False)):
        path = tmp_path / f"seed-{number:02}.npy"
        np.save(path, np.array(policy))
        each_policy.append(str(path))
    return each_policy


def test_check_takes_the_policies_of_many_seeds(policies: list[str], tmp_path: Path) -> None:
    model, report = str(tmp_path / "two.npz"), tmp_path / "r.xml"
    done = run("check", model, *policies, "--alpha", "1/20", "--junit", str(report), "--json")
    assert done.status == 1
    result = done.result
    wanted = check_trainer(TWO, often(4), runs=30, alpha="1/20")
    assert (result["passed"], result["proven"], result["claim"]) == (False, False, "estimated")
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
    table = run("check", model, *policies, "--share", "1/4", "--markdown")
    assert "| policy" in table.out


@pytest.mark.parametrize("end", [lambda: sys.exit(0), lambda: os._exit(0)])
def test_a_trainer_that_ends_the_program_has_no_verdict(end: Callable[[], None]) -> None:
    """Neither while it trains, nor in the policy that it returns, nor in a list made on the way."""
    mdp = Scenario.load("tea").compile()
    before = os._exit
    for train in (lambda seed: end(), lambda seed: lambda state: end(), (end() for _ in range(9))):
        with pytest.raises(RuntimeError, match=r"sys.exit\(0\) was called before"):
            check_trainer(mdp, train, runs=9, alpha="1/20", rng=0)
    assert os._exit is before
