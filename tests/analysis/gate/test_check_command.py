"""The gate: `exact-mdp check`, its reports, what a test asserts, and policies that were learned."""

import json
import subprocess
import sys
from fractions import Fraction as F
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from care_oracle import Oracle, acting
from cli_runner import launch, run

from exact_mdp import MDP, Policy, Scenario, best_policy

SMALL = ("--set", "tasks=[2]", "--set", "max_trial=2")
KEYS = {"passed", "regret", "relative_regret", "optimal_value", "learned_value", "agreement"}
KEYS |= {"disagreements", "claim"}


@pytest.fixture(scope="module")
def mdp() -> MDP:
    return Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()


def by_status(mdp: MDP) -> dict[str, str]:
    """Return an optimal policy of the default reading, which reads the status alone."""
    taken = best_policy(mdp).policy.table.argmax(axis=1)
    return {format(s, "04b"): mdp.actions[a] for s, a in enumerate(taken)}


# ---- verdicts ----------------------------------------------------------------------------------


def test_planted_policies_get_the_right_verdict(mdp: MDP, tmp_path: Path) -> None:
    right, first = by_status(mdp), "subtask 0, trial 0, status 0000"
    costly = right | {"0000": "none" if right["0000"] != "none" else "supportive"}
    oracle = Oracle(tasks=[2], max_trial=2)
    own = oracle.evaluate(acting(costly), distribution=False)["mean"]
    lost = oracle.value(oracle.start) - own
    assert lost > 1
    for policy, passed, exact in ((right, True, F(0)), (costly, False, lost)):
        q = np.eye(4)[[mdp.actions.index(action) for action in policy.values()]] * 3.5 - 1
        files = [tmp_path / name for name in ("p.json", "p.csv", "q.npy", "q.npz")]
        files[0].write_text(json.dumps(policy))
        Policy.of(mdp, policy).write(files[1])
        np.save(files[2], q)
        np.savez(files[3], q[mdp.space.values("status")])
        for path in files:
            done = run("check", "yuan2025", path, *SMALL, "--json")
            result = done.result
            assert (done.status, done.err) == (1 - passed, "")
            assert result.keys() >= KEYS
            assert (result["passed"], result["claim"]) == (passed, "certified")
            assert result["exact_regret"] == str(exact)
            assert result["regret"] == pytest.approx(float(exact), abs=1e-9)
            assert result["optimal_value"] - result["learned_value"] == pytest.approx(float(exact))
            assert result["regret_by_state"][first] == result["regret"]
            assert (result["agreement"] == 1) == passed
            # Only trial 0 and the first trial of the next subtask can be in status 0000.
            wrong = result["disagreements"]
            statuses = {each["columns"]["status"] for each in wrong}
            assert statuses == (set() if passed else {"0000"})
            visited = [each for each in wrong if each["expected_visits"] > 0]
            assert sum(each["cost"] for each in visited) == pytest.approx(float(exact), abs=1e-9)
            assert [each["state"] for each in visited[:1]] == ([] if passed else [first])


# ---- reports -----------------------------------------------------------------------------------


def test_junit_of_the_installed_program(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    words = ("check", "yuan2025", "always:none", *SMALL, "--max-regret", "1e9")
    done = launch(*words, "--max-relative-regret", "1/100", "--junit", report, "--json")
    assert (done.status, done.err) == (1, "")
    assert done.result["passed"] is False
    root = ElementTree.parse(report).getroot()
    (suite,) = root.findall("testsuite")
    for element in (root, suite):
        counts = [element.get(name) for name in ("tests", "failures", "errors", "skipped")]
        assert counts == ["2", "1", "0", "0"]
    first, second = suite.findall("testcase")
    assert (first.get("name"), len(first)) == ("the regret is at most 1000000000", 0)
    assert second.get("name") == "the relative regret is at most 0.01"
    (failure,) = second
    assert failure.tag == "failure"
    worst = done.result["disagreements"][0]["state"]
    assert failure.text is not None
    assert worst in failure.text
    assert "the best policy that reads nothing alone" in failure.text
    message = failure.get("message")
    assert message is not None
    assert "\n" not in message
    values = {each.get("name"): each.get("value") for each in suite.iter("property")}
    assert values["claim"] == "certified"
    assert float(values["regret"] or "nan") == done.result["regret"]
    assert list(tmp_path.iterdir()) == [report]


# ---- in a test -----------------------------------------------------------------------------------

TESTS = """
from exact_mdp import assert_policy_optimal, check_trainer


def test_passes():
    assert assert_policy_optimal("small.npz", "best.csv").agreement == 1
    assert_policy_optimal("small.npz", "q.npy", max_relative_regret="9/10", kind="q")


def test_fails():
    assert_policy_optimal("small.npz", "always:none")


def test_trainer():
    audit = check_trainer("tea", lambda seed: "random", runs=9, share=0.9, alpha="1/20", rng=0)
    assert audit.passed, audit.message()
"""


def test_the_assertions_in_a_users_tests(mdp: MDP, tmp_path: Path) -> None:
    best = by_status(mdp)
    mdp.save(tmp_path / "small.npz")
    Policy.of(mdp, best).write(tmp_path / "best.csv")
    np.save(tmp_path / "q.npy", np.eye(4)[[mdp.actions.index(action) for action in best.values()]])
    (tmp_path / "test_inner.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stdout + done.stderr
    for words in (
        "1 passed", "2 failed", "failed: the share of runs within the limits is not at least 0.9",
        "failed: the regret is not zero: it is",
        "subtask 0, trial 0, status 0000: yours none, optimal non-directive",
    ):  # fmt: skip
        assert words in done.stdout
    assert "gate/check.py" not in done.stdout  # the test's own line is shown, none of ours


# ---- reports of checks without a verdict -------------------------------------------------------

REFUSED = [
    "check tea nowhere.csv --junit {}",
    "check nowhere optimal --junit={}",
    "check tea optimal --max-regret often --junit {}",
    "check tea optimal --fast --junit {}",
    "check tea optimal --junit {} --fast",
    "check tea --junit {}",
]


@pytest.mark.parametrize("line", REFUSED)
def test_bad_input_becomes_an_error_case(tmp_path: Path, line: str) -> None:
    path = tmp_path / "gate.xml"
    path.write_text("something else")
    for words, errors in (("check tea optimal --junit {}", 0), (line, 1)):
        done = run(words.format(path))
        root = ElementTree.parse(path).getroot()
        counts = [root.get(name) for name in ("tests", "failures", "errors")]
        assert (done.status, counts) == (2 * errors, ["1", "0", str(errors)])
        cases = root.findall("./testsuite/testcase/error")
        assert (len(cases), root.find(".//failure")) == (errors, None)
    assert done.out == ""
    assert cases[0].get("message") == done.err.partition("\n")[0]
    assert str(cases[0].text).strip() == done.err.strip()
