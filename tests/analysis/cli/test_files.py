"""Models and proofs as files, by the commands that write and check them."""

import json
from fractions import Fraction
from pathlib import Path

from cli_runner import run

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.io.load import load_model


def test_convert_keeps_the_model(tmp_path: Path) -> None:
    path = tmp_path / "tea.npz"
    found = run("convert", "tea", path, "--set", "max_trial=2", "--json").result
    assert found["written"] == str(path)
    saved = load_model("tea", sets=["max_trial=2"])
    assert fingerprint(load_model(path)) == fingerprint(saved)
    first = run("solve", "tea", "--set", "max_trial=2", "--json", "--certify").result
    again = run("solve", path, "--json", "--certify").result
    for key in ("exact_start_value", "policy", "stationary", "unique"):
        assert again[key] == first[key]


def test_verify_tells_proofs_from_what_is_none(tmp_path: Path) -> None:
    exact, bounds = tmp_path / "exact.json", tmp_path / "bounds.json"
    solved = run("solve", "yuan2025", "--certify", "--certificate", exact, "--json").result
    run("solve", "yuan2025", "--certificate", bounds, "--json")
    done = run("verify", exact, "yuan2025", "--json")
    assert (done.status, done.result["passed"], done.result["claim"]) == (0, True, "certified")
    for key in ("exact_start_value", "unique", "start_value"):
        assert done.result[key] == solved[key]
    done = run("verify", bounds, "yuan2025", "--json")
    assert (done.status, done.result["passed"], done.result["claim"]) == (0, True, "bounded")
    value = Fraction(solved["exact_start_value"])
    assert abs(Fraction(done.result["start_value"]) - value) <= done.result["error_bound"]

    for path in (exact, bounds):
        done = run("verify", path, "yuan2025", "--set", "base.anger=0.06", "--json")
        assert (done.status, done.result["passed"]) == (1, False)
        assert done.result["violations"]
    assert "does not hold" in run("verify", exact, "yuan2025", "--discount", "0.9").out

    content = json.loads(exact.read_text("utf-8"))
    top = content["start_value"][0]
    content["start_value"][0] = format(int(top, 16) + 1, "x")
    exact.write_text(json.dumps(content), "utf-8")
    done = run("verify", exact, "yuan2025", "--json")
    assert (done.status, done.result["passed"]) == (1, False)
