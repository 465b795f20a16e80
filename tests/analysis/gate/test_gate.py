"""The gate: `exact-mdp check`, its exit statuses and reports, and the pytest fixture."""

import json
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_runner import launch, run
from oracle import Oracle, State

from exact_mdp.analysis import best_policy, check
from exact_mdp.analysis.gate.junit import Case, junit, write_junit
from exact_mdp.mdp import MDP, ModelError, Policy, Scenario
from exact_mdp.mdp.io.load import save_model
from exact_mdp.solvers import certify, solve

SMALL = ("--set", "tasks=[2]", "--set", "max_trial=2")
KEYS = {
    "passed",
    "regret",
    "relative_regret",
    "optimal_value",
    "learned_value",
    "agreement",
    "disagreements",
    "claim",
}
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

    def act(state: State) -> dict[str, int]:
        assert not isinstance(state, str)
        return {files["costly"]["".join(map(str, state[3]))]: 1}

    lost = oracle.value(oracle.start) - oracle.evaluate(act, distribution=False)["mean"]
    assert lost > 1
    for ending in (".json", ".csv", "-status.npy", "-states.npz"):
        done = run("check", "yuan2025", tmp_path / f"right{ending}", *SMALL, "--json")
        assert (done.status, done.err) == (0, "")
        found = done.result
        assert found.keys() >= KEYS
        assert (found["passed"], found["regret"], found["agreement"]) == (True, 0, 1)
        assert (found["disagreements"], found["claim"]) == ([], "certified")
        done = run("check", "yuan2025", tmp_path / f"costly{ending}", *SMALL, "--json")
        assert (done.status, done.err) == (1, "")
        found = done.result
        assert found["passed"] is False
        assert found["regret"] == pytest.approx(float(lost), abs=1e-9)
        assert found["optimal_value"] - found["learned_value"] == pytest.approx(float(lost))
        assert found["exact_regret"] == str(lost)
        assert found["disagreements"][0].keys() >= PER_STATE
        # Only trial 0 and the first trial of the next subtask can be in status 0000.
        assert {each["columns"]["status"] for each in found["disagreements"]} == {"0000"}
        visited = [each for each in found["disagreements"] if each["expected_visits"] > 0]
        assert visited[0]["state"] == "subtask 0, trial 0, status 0000"
        assert sum(each["cost"] for each in visited) == pytest.approx(float(lost), abs=1e-9)
        assert found["regret_by_state"]["subtask 0, trial 0, status 0000"] == found["regret"]


def test_a_wrong_action_where_nobody_comes_passes(mdp: MDP, tmp_path: Path) -> None:
    choices = np.array(certify(mdp).policy)
    never = mdp.space.index(subtask=0, trial=0, status=5)
    choices[never] = 0 if choices[never] != 0 else 1
    table = np.eye(4)[choices]
    np.save(tmp_path / "q.npy", table)
    found = run("check", "yuan2025", tmp_path / "q.npy", *SMALL, "--json")
    assert (found.status, found.result["passed"], found.result["regret"]) == (0, True, 0)
    (wrong,) = found.result["disagreements"]
    assert wrong["state"] == "subtask 0, trial 0, status 0101"
    assert (wrong["expected_visits"], wrong["cost"]) == (0, 0)
    assert wrong["gap"] > 0
    assert 0 < found.result["agreement"] < 1 == found.result["agreement_by_visits"]


def test_limits_decide(mdp: MDP, tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    Policy.of(mdp, spoiled(by_status(mdp), "1000")).write(path)
    plain = run("check", "yuan2025", path, *SMALL, "--json").result
    lost, relative = plain["regret"], plain["relative_regret"]
    assert relative == pytest.approx(lost / abs(plain["optimal_value"]))
    for words, status in (
        ((), 1),
        (("--max-regret", lost * 1.001), 0),
        (("--max-regret", lost * 0.999), 1),
        (("--max-regret", plain["exact_regret"]), 0),
        (("--max-relative-regret", relative * 1.001), 0),
        (("--max-relative-regret", relative * 0.999), 1),
        (("--max-regret", lost * 2, "--max-relative-regret", relative / 2), 1),
        (("--max-regret", lost * 2, "--max-relative-regret", relative * 2), 0),
    ):
        done = run("check", "yuan2025", path, *SMALL, *words, "--json")
        assert (done.status, done.result["passed"]) == (status, status == 0)
        assert len(done.result["checks"]) == max(1, len(words) // 2)


@pytest.mark.parametrize("learned", ["optimal", "random", "always:directive"])
def test_policies_by_name(mdp: MDP, learned: str) -> None:
    done = run("check", "yuan2025", learned, *SMALL, "--json")
    audit = check(mdp, solve(mdp) if learned == "optimal" else learned)
    assert done.status == (0 if learned == "optimal" else 1)
    assert done.result["regret"] == pytest.approx(float(audit.regret.at_start.value), abs=1e-12)
    assert done.result["claim"] == "certified"


def test_reasons(mdp: MDP, tmp_path: Path) -> None:
    q = np.random.default_rng(0).normal(size=(16, 4))
    np.save(tmp_path / "q.npy", q)
    found = run("check", "yuan2025", tmp_path / "q.npy", *SMALL, "--json").result
    why = found["representation"]
    assert (why["columns"], why["proven"]) == (["status"], True)
    assert why["loss"] + why["learning_error"] == pytest.approx(found["regret"], abs=1e-12)
    assert list(why["policy"]) == [f"status {s:04b}" for s in range(16)]
    assert [each["columns"] for each in found["memory"]] == [
        ["status"],
        ["subtask", "status"],
        ["trial", "status"],
        ["subtask", "trial", "status"],
    ]
    assert found["memory"][0]["worth"] == 0
    assert found["rows"][0]["gain"] > 0
    assert found["q_error"]["promised"] == q[0].max()
    bare = run("check", "yuan2025", tmp_path / "q.npy", *SMALL, "--json", "--no-explain").result
    assert (bare["representation"], bare["memory"], bare["rows"]) == (None, None, None)
    assert bare["regret"] == found["regret"]


def test_text_for_people(mdp: MDP, tmp_path: Path) -> None:
    np.save(tmp_path / "q.npy", np.random.default_rng(0).normal(size=(16, 4)))
    done = run("check", "yuan2025", tmp_path / "q.npy", *SMALL)
    assert (done.status, done.err) == (1, "")
    for text in ("FAILED", "regret", "costliest", "remembering more", "changed alone", "status"):
        assert text in done.out
    done = run("check", "yuan2025", "optimal", *SMALL)
    assert (done.status, done.err) == (0, "")
    assert "passed" in done.out


def test_models_that_are_no_scenarios(tmp_path: Path) -> None:
    wait, cut = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]], [[1, 0, 0]] * 3
    forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
    save_model(forest, tmp_path / "forest.npz")
    np.save(tmp_path / "q.npy", np.array([[1.0, 0], [0, 1], [0, 1]]) * 11.2)
    done = run("check", tmp_path / "forest.npz", tmp_path / "q.npy", "--json")
    assert done.status == 1
    assert done.result["learned_value"] == pytest.approx(10800 / 932, abs=1e-12)
    assert done.result["optimal_value"] == pytest.approx(74.6496, abs=1e-12)
    assert done.result["representation"] is None  # it reads all there is
    (tmp_path / "p.csv").write_text("state,action\n0,0\n1,0\n2,0\n")
    assert run("check", tmp_path / "forest.npz", tmp_path / "p.csv").status == 0


# ---- bad input ---------------------------------------------------------------------------------


def test_bad_input_is_refused(mdp: MDP, tmp_path: Path) -> None:
    best = by_status(mdp)
    short = {key: best[key] for key in list(best)[:-1]}
    (tmp_path / "short.json").write_text(json.dumps(short))
    twice = json.dumps(best)[:-1] + ', "0000": "none"}'
    (tmp_path / "twice.json").write_text(twice)
    (tmp_path / "broken.json").write_text('{"0000": ')
    (tmp_path / "action.json").write_text(json.dumps(best | {"0000": "nothing"}))
    (tmp_path / "twice.csv").write_text("status,action\n0000,none\n0000,directive\n")
    np.save(tmp_path / "nan.npy", np.full((16, 4), np.nan))
    np.save(tmp_path / "shape.npy", np.zeros((4, 16)))
    np.save(tmp_path / "whole.npy", np.zeros((16, 4)))
    whole = (tmp_path / "whole.npy").read_bytes()
    (tmp_path / "cut.npy").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04 not an archive")
    good = ("yuan2025", tmp_path / "whole.npy", *SMALL)
    refused = [("yuan2025", tmp_path / name, *SMALL) for name in (
        "short.json", "twice.json", "broken.json", "action.json", "twice.csv", "nan.npy",
        "shape.npy", "cut.npy", "cut.npz", "missing.npy", "missing.json",
    )]  # fmt: skip
    refused += [
        ("yuan2026", "random"),
        ("yuan2025", "always:nothing"),
        ("yuan2025", "directive"),
        (*good, "--max-regret", "-1"),
        (*good, "--max-regret", "nan"),
        (*good, "--max-relative-regret", "much"),
        (*good, "--junit", tmp_path / "report.txt"),
        (*good, "--junit", tmp_path / "nowhere" / "report.xml"),
        (*good, "--discount", "2"),
        (*good, "--set", "base.angre=1"),
        (*good, "--max-regret", "inf"),
        (*good, "--kind", "table"),
        ("yuan2025", "random", *SMALL, "--kind", "q"),
    ]
    for words in refused:
        for more in ((), ("--json",)):
            done = run("check", *words, *more)
            assert (done.status, done.out) == (2, ""), words
            assert all(part in done.err for part in ("ModelError: ", "where: ", "fix: ")), words
    assert run("check", "yuan2025").status == 2
    assert run("check", *good, "--limit", "1").status == 2


def test_a_report_of_bad_input_is_an_error(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    done = run("check", "yuan2025", tmp_path / "no.npy", "--junit", report)
    assert (done.status, list(tmp_path.iterdir())) == (2, [report])
    assert b'errors="1"' in report.read_bytes()


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


def test_junit_of_a_passing_check_is_replaced_whole(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    report.write_text("something else")
    assert run("check", "yuan2025", "optimal", *SMALL, "--junit", report).status == 0
    root = ElementTree.parse(report).getroot()
    assert (root.get("tests"), root.get("failures")) == ("1", "0")
    assert root.find(".//failure") is None


def test_what_xml_cannot_hold(tmp_path: Path) -> None:
    nasty = 'a\x00b\x1b[0m<&>"\ud800\uffff ]]> é \U0001f600\n'
    case = Case(name=nasty, failure=nasty, text=nasty)
    root = ElementTree.fromstring(junit(nasty, [case], seconds=1, properties={nasty: nasty}))
    failure = root.find(".//failure")
    assert failure is not None
    assert failure.text == 'a?b?[0m<&>"?? ]]> é \U0001f600\n'
    with pytest.raises(ModelError):
        write_junit(tmp_path / "no" / "r.xml", "s", [case], seconds=0, properties={})


# ---- the pytest fixture ------------------------------------------------------------------------

TESTS = """
import numpy as np
import pytest
from mdp import ModelError, Scenario

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


def test_refuses(policy_gate):
    with pytest.raises(ModelError):
        policy_gate("yuan2025", "missing.json", set=SMALL)
    with pytest.raises(ModelError):
        policy_gate("missing.toml", "best.json")
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
    assert "3 passed" in done.stdout
    assert "1 failed" in done.stdout
    assert "failed: the regret is zero; it is" in done.stdout
    assert "(subtask 0, trial 0, status 0000): none, not non-directive" in done.stdout
    assert "Traceback" not in done.stdout
    cases = {
        case.get("name"): case for case in ElementTree.parse(report).getroot().iter("testcase")
    }
    found = {each.get("name"): each.get("value") for each in cases["test_fails"].iter("property")}
    assert found["claim"] == "certified"
    assert float(found["regret"] or "nan") > 1
    assert float(found["agreement"] or "nan") < 1


def test_the_plugin_loads_nothing_heavy() -> None:
    code = (
        "import sys, exact_mdp.analysis.pytest_plugin; "
        "heavy = {'numpy', 'scipy', 'exact_mdp.mdp.model', 'exact_mdp.solvers', 'click'}; "
        "print(heavy & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_infinite_action_values_are_no_errors_and_promise_nothing() -> None:
    """A table may rule actions out by -inf, which says nothing of their values."""
    step = [[0, 1, 0], [0, 0, 1], [0, 0, 1]]
    mdp = MDP.from_arrays([step] * 3, [[1, 3, 2], [0, 1, 4], [0, 0, 0]])
    table = np.array([[2.0, -np.inf, 6.5], [-np.inf, 0.5, 3.5], [0, 0, 0]])
    found = check(mdp, table, kind="q").q_error
    assert found is not None
    # Q* is 5, 7, 6 in the first state and 0, 1, 4 in the second.
    errors = np.array([2 - 5, 6.5 - 6, 0.5 - 1, 3.5 - 4])
    assert (found.largest, found.where) == (3.0, mdp.where(0))
    assert found.mean == pytest.approx(errors.mean())
    assert found.root_mean_square == pytest.approx((errors**2).mean() ** 0.5)
    assert found.promised == 6.5
    assert found.visited == pytest.approx(0.5)
