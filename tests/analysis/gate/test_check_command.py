"""The gate: `exact-mdp check`, its reports, the pytest fixture, and policies that were learned."""

import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from care_oracle import Oracle, acting
from cli_runner import launch, main, run

from exact_mdp import (
    MDP,
    Constant,
    Policy,
    QLearning,
    Scenario,
    assert_policy_optimal,
    best_policy,
    check,
)

SMALL = ("--set", "tasks=[2]", "--set", "max_trial=2")
KEYS = {"passed", "regret", "relative_regret", "optimal_value", "learned_value", "agreement"}
KEYS |= {"disagreements", "claim"}
PER_STATE = {"state", "learned", "optimal", "gap", "expected_visits"}


@pytest.fixture(scope="module")
def mdp() -> MDP:
    return Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()


def by_status(mdp: MDP) -> dict[str, str]:
    """Return an optimal policy of the default reading, which reads the status alone."""
    taken = best_policy(mdp).policy.table.argmax(axis=1)
    return {format(s, "04b"): mdp.actions[a] for s, a in enumerate(taken)}


def spoiled(policy: dict[str, str], status: str) -> dict[str, str]:
    return policy | {status: "none" if policy[status] != "none" else "supportive"}


# ---- verdicts ----------------------------------------------------------------------------------


def test_planted_policies_get_the_right_verdict(mdp: MDP, tmp_path: Path) -> None:
    best = by_status(mdp)
    files = {"right": best, "costly": spoiled(best, "0000")}
    for name, policy in files.items():
        Policy.of(mdp, policy).write(tmp_path / f"{name}.json")
        Policy.of(mdp, policy).write(tmp_path / f"{name}.csv")
        rows = np.array([mdp.actions.index(action) for action in policy.values()])
        q = np.eye(4)[rows] * 3.5 - 1
        np.save(tmp_path / f"{name}-status.npy", q)
        np.savez(tmp_path / f"{name}-states.npz", q[mdp.space.values("status")])
    oracle = Oracle(tasks=[2], max_trial=2)
    own = oracle.evaluate(acting(files["costly"]), distribution=False)["mean"]
    lost = oracle.value(oracle.start) - own
    assert lost > 1
    for ending in (".json", ".csv", "-status.npy", "-states.npz"):
        done = run("check", "yuan2025", tmp_path / f"right{ending}", *SMALL, "--json")
        assert (done.status, done.err) == (0, "")
        result = done.result
        assert result.keys() >= KEYS
        assert (result["passed"], result["regret"], result["agreement"]) == (True, 0, 1)
        assert (result["disagreements"], result["claim"]) == ([], "certified")
        done = run("check", "yuan2025", tmp_path / f"costly{ending}", *SMALL, "--json")
        assert (done.status, done.err) == (1, "")
        result = done.result
        assert result["passed"] is False
        assert result["regret"] == pytest.approx(float(lost), abs=1e-9)
        assert result["optimal_value"] - result["learned_value"] == pytest.approx(float(lost))
        assert result["exact_regret"] == str(lost)
        assert result["disagreements"][0].keys() >= PER_STATE
        # Only trial 0 and the first trial of the next subtask can be in status 0000.
        assert {each["columns"]["status"] for each in result["disagreements"]} == {"0000"}
        visited = [each for each in result["disagreements"] if each["expected_visits"] > 0]
        assert visited[0]["state"] == "subtask 0, trial 0, status 0000"
        assert sum(each["cost"] for each in visited) == pytest.approx(float(lost), abs=1e-9)
        assert result["regret_by_state"]["subtask 0, trial 0, status 0000"] == result["regret"]


def test_reasons(mdp: MDP, tmp_path: Path) -> None:
    q = np.random.default_rng(0).normal(size=(16, 4))
    np.save(tmp_path / "q.npy", q)
    result = run("check", "yuan2025", tmp_path / "q.npy", *SMALL, "--json").result
    why = result["representation"]
    assert (why["columns"], why["proven"]) == (["status"], True)
    assert why["loss"] + why["learning_error"] == pytest.approx(result["regret"], abs=1e-12)
    assert list(why["policy"]) == [f"status {s:04b}" for s in range(16)]
    assert result["rows"][0]["gain"] > 0
    assert result["q_error"]["promised"] == q[0].max()
    bare = run("check", "yuan2025", tmp_path / "q.npy", *SMALL, "--json", "--no-explain").result
    assert (bare["representation"], bare["rows"]) == (None, None)
    assert bare["regret"] == result["regret"]


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


# ---- the pytest fixture ------------------------------------------------------------------------

TESTS = """
import os

import numpy as np
import pytest
from exact_mdp.analysis import assert_policy_optimal
from exact_mdp.mdp import ModelError, Scenario

SMALL = ("tasks=[2]", "max_trial=2")


def test_passes(policy_gate):
    audit = policy_gate("yuan2025", "best.json", set=SMALL)
    assert audit.agreement == 1


def test_model_object(policy_gate):
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    policy_gate(mdp, "best.json")
    policy_gate(mdp, "q.npy", max_relative_regret="9/10", discount="19/20")


def test_fails(policy_gate):
    policy_gate("yuan2025", "always:none", set=SMALL)


def test_trainer(policy_gate):
    files = policy_gate("yuan2025", ["best.json"] * 80, set=SMALL, runs=80)
    assert files.proven and len(files.audits) < 80
    policy_gate("tea", lambda seed: "random", runs=9, alpha="1/20")


def test_ends(policy_gate):
    with pytest.raises(RuntimeError, match="before there was an answer"):
        policy_gate("tea", lambda state: os._exit(0))


def test_asserts():
    assert_policy_optimal(Scenario.load("tea"), "random")


def test_refuses(policy_gate):
    with pytest.raises(ModelError):
        policy_gate("yuan2025", "missing.json", set=SMALL)
    with pytest.raises(ModelError):
        policy_gate("missing.toml", "best.json")
    with pytest.raises(ModelError, match="alpha is a question of several runs"):
        policy_gate("tea", "random", alpha="1/100")
    with pytest.raises(ModelError, match="one policy"):
        policy_gate("tea", np.array([0, 0]), runs=5)
"""


def test_fixture(mdp: MDP, tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    best = by_status(mdp)
    Policy.of(mdp, best).write(inner / "best.json")
    rows = np.array([mdp.actions.index(action) for action in best.values()])
    np.save(inner / "q.npy", np.eye(4)[rows])
    (inner / "test_inner.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    installed = any(
        e.value == "exact_mdp.analysis.pytest_plugin" for e in entry_points(group="pytest11")
    )
    plugin = () if installed else ("-p", "exact_mdp.analysis.pytest_plugin")
    report = tmp_path / "report.xml"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *plugin, "--junitxml", report, "inner"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "4 passed" in done.stdout
    assert "3 failed" in done.stdout
    assert "failed: the share of runs within the limits is not at least 0.9" in done.stdout
    assert "failed: the regret is not zero" in done.stdout
    assert "gate/check.py" not in done.stdout  # the test's own line is shown, none of ours
    assert "failed: the regret is not zero: it is" in done.stdout
    assert "subtask 0, trial 0, status 0000: yours none, optimal non-directive" in done.stdout
    assert "Traceback" not in done.stdout
    cases = {
        case.get("name"): case for case in ElementTree.parse(report).getroot().iter("testcase")
    }
    facts = {each.get("name"): each.get("value") for each in cases["test_fails"].iter("property")}
    assert facts["claim"] == "certified"
    assert float(facts["regret"] or "nan") > 1
    assert float(facts["agreement"] or "nan") < 1


def test_the_plugin_loads_nothing_heavy() -> None:
    code = (
        "import sys, exact_mdp.analysis.pytest_plugin; "
        "heavy = {'numpy', 'scipy', 'exact_mdp.mdp.model', 'exact_mdp.solvers', 'click'}; "
        "print(heavy & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


# ---- reports of checks without a verdict -------------------------------------------------------

REFUSED = {
    "a policy that is not there": "check tea nowhere.csv --junit {}",
    "a model that is not there": "check nowhere optimal --junit={}",
    "a bad limit": "check tea optimal --max-regret often --junit {}",
    "an unknown option": "check tea optimal --fast --junit {}",
    "an unknown option at the end": "check tea optimal --junit {} --fast",
    "no policy": "check tea --junit {}",
}


def stale(tmp_path: Path) -> Path:
    path = tmp_path / "gate.xml"
    path.write_text("something else")
    assert run("check", "tea", "optimal", "--junit", path).status == 0
    root = ElementTree.parse(path).getroot()
    assert [root.get(name) for name in ("tests", "failures", "errors")] == ["1", "0", "0"]
    assert [root.find(f".//{name}") for name in ("failure", "error")] == [None, None]
    return path


@pytest.mark.parametrize("line", REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_becomes_an_error_case(tmp_path: Path, line: str) -> None:
    path = stale(tmp_path)
    done = run(*line.format(path).split())
    assert (done.status, done.out) == (2, "")
    root = ElementTree.parse(path).getroot()
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("1", "0", "1")
    case = root.find("./testsuite/testcase/error")
    assert case is not None
    assert case.get("message") == done.err.partition("\n")[0]
    assert str(case.text).strip() == done.err.strip()


def test_help_and_refused_names_of_reports_write_nothing(tmp_path: Path) -> None:
    assert run("check", "--help", "--junit", tmp_path / "a.xml").status == 0
    assert run("check", "tea", "optimal", "--junit", tmp_path / "a.txt").status == 2
    assert list(tmp_path.iterdir()) == []


# ---- policies that were learned ---------------------------------------------------------------
# The limits were set after looking at these seeds, to notice a change; they say nothing of other
# seeds. Over 1,000 seeds of training as the paper does, 5 % lose more than 10.7.

AS_THE_PAPER = QLearning()
BY_VISITS = QLearning(rate=Constant(1.0), rate_power=0.6)


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").compile()


@pytest.mark.parametrize("seed", range(6))
def test_training_as_the_paper_does_ends_within_six_per_cent(care: MDP, seed: int) -> None:
    assert_policy_optimal(care, AS_THE_PAPER.train(care, seed).q, max_regret=8.0)


def test_rates_that_fall_with_visits_end_within_one_per_cent_but_for_one_seed(care: MDP) -> None:
    passed = {
        seed: check(care, BY_VISITS.train(care, seed).q, max_regret=1.4).passed
        for seed in range(12)
    }
    assert [seed for seed, within in passed.items() if not within] == [0]  # it loses 4.54


def test_a_broken_policy_is_refused(
    care: MDP, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    q = BY_VISITS.train(care, 3).q.copy()
    np.save(tmp_path / "learned.npy", q)
    words = ["check", "yuan2025", str(tmp_path / "learned.npy"), "--max-regret", "1.4"]
    assert main(words) == 0
    q[0b0001, 0] = q.max() + 1  # leaves a disengaged person alone
    np.save(tmp_path / "learned.npy", q)
    assert main(words) == 1
    assert "status 0001" in capsys.readouterr().out
    audit = check(care, q, max_regret=1.4)
    assert not audit.passed
    worst = [care.space.label(each.state) for each in audit.disagreements[:3]]
    assert all("status 0001" in label for label in worst)
