"""What the command line refuses, and how it fails."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import run

from exact_mdp.mdp.io.load import load_model, save_model

# ---- what it refuses -------------------------------------------------------------------------

STATUSES = [format(status, "04b") for status in range(16)]


@pytest.fixture
def bad(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in that holds files which are wrong in some way."""
    (tmp_path / "broken.toml").write_text('name = "broken', "utf-8")
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    lines = [f"{status},none" for status in STATUSES]
    (tmp_path / "missing.csv").write_text("\n".join(["status,action", *lines[1:]]), "utf-8")
    (tmp_path / "doubled.csv").write_text("\n".join(["status,action", lines[0], *lines]), "utf-8")
    (tmp_path / "missing.json").write_text('{"0000": "none"}', "utf-8")
    (tmp_path / "doubled.json").write_text('{"0000": "none", "0000": "none"}', "utf-8")
    (tmp_path / "action.json").write_text(json.dumps(dict.fromkeys(STATUSES, "hug")), "utf-8")
    (tmp_path / "status.json").write_text('{"00000": "none"}', "utf-8")
    (tmp_path / "unknown.xyz").write_text("", "utf-8")
    save_model(load_model("yuan2025"), tmp_path / "whole.npz")
    content = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "truncated.npz").write_bytes(content[: len(content) // 2])
    (tmp_path / "truncated.json").write_text('{"format": "exact-mdp certificate",', "utf-8")
    np.save(tmp_path / "shape.npy", np.zeros((3, 3)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


REFUSED = {
    "unknown scenario": "info yuan2052",
    "unknown model file": "info unknown.xyz",
    "no such file": "info nowhere.toml",
    "a folder": "info folder.toml",
    "not text": "info binary.toml",
    "broken TOML": "solve broken.toml",
    "truncated model": "solve truncated.npz",
    "unknown environment": "info gymnasium:Nowhere-v0",
    "probability above 1": "solve yuan2025 --set base.anger=1.1",
    "negative probability": "info yuan2025 --set base.anger=-0.1",
    "not a number": "info yuan2025 --set base.anger=often",
    "unknown parameter": "info yuan2025 --set base.angr=0.1",
    "unknown status": "info yuan2025 --set base.joy=0.1",
    "unknown action in a parameter": "info yuan2025 --set reward.assist.hug=1",
    "unknown reading": "info yuan2025 --set readings.influence=column-to-row",
    "unknown option of a reading": "info yuan2025 --set readings.trial_cost=never",
    "no setting": "info yuan2025 --set tasks",
    "negative max_trial": "info yuan2025 --set max_trial=-1",
    "empty task list": "info yuan2025 --set tasks=[]",
    "setting on a saved model": "info whole.npz --set tasks=[1]",
    "discount of a word": "solve yuan2025 --discount high",
    "discount above 1": "solve yuan2025 --discount 1.01",
    "negative discount": "solve yuan2025 --discount=-1/2",
    "division by zero": "solve yuan2025 --discount 1/0",
    "unknown method": "solve yuan2025 --method simplex",
    "tolerance 0": "solve yuan2025 --tol 0",
    "tolerance of a word": "solve yuan2025 --tol small",
    "tolerance too large": "solve yuan2025 --tol 1e999",
    "cycles": "solve gymnasium:FrozenLake-v1 --discount 0.9 --method backward-induction",
    "never ends": "solve gymnasium:FrozenLake-v1 --discount 1",
    "never ends, certified": "solve gymnasium:FrozenLake-v1 --certify",
    "policy never ends": "evaluate gymnasium:CliffWalking-v1 always:0",
    "wrong ending": "solve yuan2025 --out values.csv",
    "policy of wrong ending": "solve yuan2025 --policy-out policy.npz",
    "no folder": "solve yuan2025 --out nowhere/values.npz",
    "one file twice": "solve yuan2025 --policy-out x.json --certificate x.json",
    "model of wrong ending": "convert yuan2025 model.txt",
    "model into no folder": "convert yuan2025 nowhere/model.npz",
    "unknown action": "evaluate yuan2025 always:hug",
    "unknown policy": "evaluate yuan2025 greedy",
    "no policy file": "evaluate yuan2025 nowhere.csv",
    "missing status": "evaluate yuan2025 missing.csv",
    "doubled status": "evaluate yuan2025 doubled.csv",
    "missing status in JSON": "evaluate yuan2025 missing.json",
    "doubled status in JSON": "evaluate yuan2025 doubled.json",
    "unknown action in a file": "evaluate yuan2025 action.json",
    "unknown status in a file": "evaluate yuan2025 status.json",
    "Q-table of another shape": "evaluate yuan2025 shape.npy",
    "truncated archive as a policy": "evaluate yuan2025 truncated.npz",
    "returns below discount 1": "returns yuan2025 random --discount 0.95",
    "no episodes": "simulate yuan2025 random --episodes 0",
    "negative episodes": "simulate yuan2025 random --episodes -5",
    "too many episodes": "simulate yuan2025 random --episodes 99999999999",
    "seed of a word": "simulate yuan2025 random --episodes 10 --seed lucky",
    "negative seed": "simulate yuan2025 random --episodes 10 --seed=-1",
    "truncated certificate": "verify truncated.json yuan2025",
    "no certificate": "verify nowhere.json yuan2025",
    "unknown command": "slove yuan2025",
    "unknown option": "solve yuan2025 --fast",
    "no model": "solve",
    "no command": "",
    "too many words": "info yuan2025 tea",
    "no value": "solve yuan2025 --method",
    "episodes left out": "simulate yuan2025 random",
}


@pytest.mark.usefixtures("bad")
@pytest.mark.parametrize("line", REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_is_refused_with_what_where_and_fix(line: str) -> None:
    for form in ("", " --json"):
        done = run(*(line + form if line else line).split())
        assert (done.status, done.out) == (2, "")
        assert re.fullmatch(r"[A-Z]\w+: [^\n]+\n  where: [^\n]+\n  fix:   [^\n]+\n", done.err)


@pytest.mark.usefixtures("bad")
def test_what_was_refused_leaves_no_file(bad: Path) -> None:
    before = sorted(bad.iterdir())
    run("solve", "gymnasium:FrozenLake-v1", "--out", "x.npz", "--policy-out", "x.csv")
    run("convert", "yuan2025", "x.npz", "--set", "base.anger=2")
    assert sorted(bad.iterdir()) == before


def test_an_error_of_the_program_itself_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("a mistake")

    monkeypatch.setattr("exact_mdp.analysis.cli.options.load", broken)
    done = run("info", "yuan2025")
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith("ValueError: an error in the program, not in your input: a mis")
    assert "where: exact-mdp info, in analysis/cli/options.py, line " in done.err
    assert "EXACT_MDP_TRACEBACK=1" in done.err
    monkeypatch.setenv("EXACT_MDP_TRACEBACK", "1")
    assert "Traceback (most recent call last)" in run("info", "yuan2025").err


def test_a_solver_that_gives_up_ends_with_3(monkeypatch: pytest.MonkeyPatch) -> None:
    from exact_mdp.solvers import SolverError, Status

    def give_up(*_: object) -> None:
        raise SolverError(Status.NO_BOUND)

    monkeypatch.setattr("exact_mdp.solvers.solve", give_up)
    done = run("solve", "yuan2025", "--json")
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith("SolverError: double precision cannot bound")


def test_a_solver_that_contradicts_the_proof_ends_with_3(monkeypatch: pytest.MonkeyPatch) -> None:

    from exact_mdp import solvers

    solve = solvers.solve

    def wrong(*words: Any) -> solvers.Solution:
        found = solve(*words)
        return replace(found, value=found.value + 1e-6)

    monkeypatch.setattr("exact_mdp.solvers.solve", wrong)
    done = run("solve", "yuan2025", "--certify", "--json")
    assert (done.status, done.out) == (3, "")
    assert done.err.startswith("Contradiction: exact values differ")


def test_an_interruption_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("exact_mdp.analysis.cli.options.load", stop)
    done = run("info", "yuan2025")
    assert (done.status, done.out, done.err.strip()) == (130, "", "stopped by SIGINT")
