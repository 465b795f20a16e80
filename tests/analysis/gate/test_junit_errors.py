"""A check that came to no verdict leaves a JUnit report that says so, not one of an earlier run."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from cli_runner import run

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
    assert run("check", "tea", "optimal", "--junit", path).status == 0
    assert ElementTree.parse(path).find(".//error") is None
    return path


@pytest.mark.parametrize("line", REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_becomes_an_error_case(tmp_path: Path, line: str) -> None:
    path = stale(tmp_path)
    done = run(*line.format(path).split())
    assert (done.status, done.out) == (2, "")
    root = ElementTree.parse(path).getroot()
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("1", "0", "1")
    found = root.find("./testsuite/testcase/error")
    assert found is not None
    assert found.get("message") == done.err.partition("\n")[0]
    assert str(found.text).strip() == done.err.strip()


@pytest.mark.parametrize("fault", [OverflowError("too large"), KeyboardInterrupt()])
def test_so_does_whatever_else_ends_the_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    path = stale(tmp_path)

    def fail(*_: object, **__: object) -> None:
        before = ElementTree.parse(path).find(".//error")  # what a killed process leaves
        assert before is not None
        assert "did not end" in str(before.get("message"))
        raise fault

    monkeypatch.setattr("exact_mdp.analysis.cli.options.load", fail)
    assert run("check", "tea", "optimal", "--junit", path).status in (3, 130)
    found = ElementTree.parse(path).find(".//error")
    assert found is not None
    assert "did not end" not in str(found.get("message"))


def test_a_verdict_is_written_as_before(tmp_path: Path) -> None:
    path = stale(tmp_path)
    assert run("check", "tea", "random", "--junit", path).status == 1
    root = ElementTree.parse(path).getroot()
    assert (root.get("failures"), root.get("errors")) == ("1", "0")
    assert root.find(".//error") is None


def test_help_and_refused_names_of_reports_write_nothing(tmp_path: Path) -> None:
    assert run("check", "--help", "--junit", tmp_path / "a.xml").status == 0
    assert run("check", "tea", "optimal", "--junit", tmp_path / "a.txt").status == 2
    assert list(tmp_path.iterdir()) == []
