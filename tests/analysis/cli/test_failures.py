"""Every refusal and failure has its exit status and its sentence; nothing is half-written."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import PROGRAM, launch, run, strict

from exact_mdp import MDP, ModelError, load, save

LONG_HEX = "0x" + "f" * 9000
YUAN = Path(__file__).parents[3] / "exact_mdp" / "mdp" / "scenarios" / "yuan2025.toml"


def told(err: str, status: int = 2) -> None:
    assert "Traceback" not in err, err
    err = re.sub(r'\n\{"status": \d, "error": \{.*\}\}\n$', "\n", err)  # with --json
    assert re.fullmatch(r"[A-Z]\w+: [^\n]+\n  where: [^\n]+\n  fix:   [^\n]+\n", err), (status, err)
    assert len(err) < 3500


def changed(pattern: str, line: str) -> str:
    text, count = re.subn(pattern, lambda _: line, YUAN.read_text("utf-8"), count=1, flags=re.M)
    assert count == 1
    return text


NESTED = ".".join(["a"] * 3000)
SCENARIOS = {
    "max_trial": lambda: changed(r"^max_trial *=.*$", f"max_trial = {LONG_HEX}"),
    "tasks": lambda: changed(r"^tasks *=.*$", f"tasks = [{LONG_HEX}]"),
    "a parameter": lambda: YUAN.read_text("utf-8") + f"\n[base.x]\ny = {LONG_HEX}\n",
    "a title": lambda: changed(r"^title *=.*$", f"title = {LONG_HEX}"),
    "an unknown key": lambda: f"x = {LONG_HEX}\n" + YUAN.read_text("utf-8"),
    "a dotted table": lambda: YUAN.read_text("utf-8") + f"\n[base.{NESTED}]\nx = 1\n",
    "a dotted key": lambda: f"{NESTED} = 1\n" + YUAN.read_text("utf-8"),
    "lists in lists": lambda: "x = " + "[" * 5000 + "]" * 5000,
}


@pytest.mark.parametrize("text", SCENARIOS.values(), ids=SCENARIOS.keys())
def test_long_numbers_and_deep_tables_of_a_scenario_are_bad_input(
    tmp_path: Path, text: Any
) -> None:
    """Integers of 9,000 digits and keys of 3,000 parts are refused at the door, by name."""
    path = tmp_path / "model.toml"
    path.write_text(text(), "utf-8")
    done = run("info", path)
    assert (done.status, done.out) == (2, "")
    told(done.err)
    assert str(path) in done.err


@pytest.mark.parametrize("line", [f"{NESTED} = 1", f'"base.anger" = [{LONG_HEX}, 1]'])
@pytest.mark.parametrize(
    "words",
    [
        ("tornado", "tea", "--range"),
        ("psa", "tea", "--samples", "4", "--uncertain"),
        ("evaluate", "yuan2025", "random", "--perception"),
    ],
    ids=lambda words: words[-1],
)
def test_so_are_those_of_every_other_toml_file(
    tmp_path: Path, words: tuple[str, ...], line: str
) -> None:
    path = tmp_path / "file.toml"
    path.write_text(line, "utf-8")
    done = run(*words, path)
    assert (done.status, done.out) == (2, "")
    told(done.err)


LINES = {
    "check yuan2025 random --max-regret {}": "--max-regret",
    "check yuan2025 random --max-relative-regret {}": "--max-relative-regret",
    "check yuan2025 random --discount {}": "--discount",
    "solve yuan2025 --discount {}": "--discount",
    "solve yuan2025 --tol {}": "--tol",
    "train tea --seeds 1 --learner epochs=2 --learner discount={}": "--learner, discount",
    "train tea --seeds 1 --learner epochs=2 --learner rate={}": "--learner rate",
    "train tea --seeds {}": "--seeds",
    "simulate tea random --episodes {}": "--episodes",
    "robust tea --radius {}": "--radius",
    "robust tea --set-kind kl --radius {}": "--radius",
    "threshold tea --relative {}": "--relative",
    "tornado tea --relative {}": "--relative",
}


@pytest.mark.parametrize("value", ["nan", "1e400", "1e999", "9" * 5000])
@pytest.mark.parametrize("line", LINES)
def test_a_value_beyond_all_limits_is_refused_with_the_name_of_its_option(
    line: str, value: str
) -> None:
    """No option takes a number beyond the floats, and every refusal names the option."""
    done = run(*line.format(value).split())
    assert (done.status, done.out) == (2, "")
    told(done.err)
    assert f"  where: {LINES[line]}\n" in done.err


ENDS = {
    "0": "import sys; sys.exit(0)",
    "1": "import sys; sys.exit(1)",
    "text": "import sys; sys.exit('a text')",
    "None": "raise SystemExit",
    "a subclass": "class End(SystemExit): pass\nraise End(0)",
    "at once": "import os; os._exit(0)",
    "click": "import gymnasium as g; import click\n"
    "class Env(g.Env):\n"
    "    observation_space = action_space = g.spaces.Discrete(2)\n"
    "    @property\n"
    "    def P(self): raise click.exceptions.Exit(0)\n"
    "g.register('X-v0', entry_point=Env, disable_env_checker=True)",
    "any other": "class End(BaseException): pass\nraise End",
}


@pytest.mark.parametrize("code", ENDS.values(), ids=ENDS.keys())
def test_a_module_that_ends_the_program_gives_no_verdict(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An environment that asks for status 0 while it is loaded has not passed."""
    pytest.importorskip("gymnasium")
    (tmp_path / "ends.py").write_text(code, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "ends", raising=False)
    done = run("check", "gymnasium:ends:X-v0", "random", "--discount", "0.9")
    assert (done.status, done.out) == (3, "")
    told(done.err)


LOUD = """
import atexit, os, sys
print("python")
sys.__stdout__.write("below")
os.write(1, b"system")
os.system("echo child")
atexit.register(print, "at exit")
import gymnasium
entry = "gymnasium.envs.toy_text.frozen_lake:FrozenLakeEnv"
gymnasium.register("X-v0", entry_point=entry)
"""


@pytest.mark.parametrize("model, status", [("X-v0", 0), ("Y-v0", 2)])
def test_what_a_module_prints_stays_out_of_the_result(
    model: str, status: int, tmp_path: Path
) -> None:
    pytest.importorskip("gymnasium")
    (tmp_path / "loud.py").write_text(LOUD, "utf-8")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = launch("info", f"gymnasium:loud:{model}", "--json", PYTHONPATH=path)
    assert done.status == status, done.err
    assert done.out == "" if status else strict(done.out)["states"] == 16
    assert all(word in done.err for word in ("python", "below", "system", "child", "at exit"))


def test_what_is_registered_for_the_end_does_not_change_the_status(tmp_path: Path) -> None:
    (tmp_path / "late.py").write_text(
        "import atexit, os; atexit.register(os._exit, 0); atexit.register(lambda: os._exit(0))\n"
        "import gymnasium; gymnasium.register('X-v0', "
        "entry_point='gymnasium.envs.toy_text.frozen_lake:FrozenLakeEnv')",
        "utf-8",
    )
    pytest.importorskip("gymnasium")
    words = ["check", "gymnasium:late:X-v0", "always:LEFT"]
    path = os.pathsep.join([str(tmp_path), *sys.path])
    end = subprocess.run(
        [sys.executable, "-m", "exact_mdp", *words],
        capture_output=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert end.returncode == 1, end.stderr


# ---- streams and disks ---------------------------------------------------------------------------

CHECK = ("check", "tea", "optimal")


def shell(redirection: str, *words: str) -> subprocess.CompletedProcess[str]:
    line = " ".join([str(PROGRAM), *words, redirection])
    return subprocess.run(line, shell=True, capture_output=True, encoding="utf-8")


@pytest.mark.parametrize("json", [(), ("--json",)])
def test_a_full_disk_behind_standard_output_ends_with_3(json: tuple[str, ...]) -> None:
    done = shell(">/dev/full", *CHECK, *json)
    assert done.returncode == 3
    told(done.stderr)
    assert "cannot write to standard output: No space left on device" in done.stderr


def test_a_closed_standard_output_ends_with_3() -> None:
    """A check whose verdict nobody can read has neither passed nor failed."""
    done = shell(">&-", *CHECK)
    assert done.returncode == 3
    told(done.stderr)
    assert "standard output is closed" in done.stderr
    assert shell(">/dev/null", *CHECK).returncode == 0


def test_a_closed_standard_error_changes_no_status() -> None:
    done = shell("2>&-", *CHECK)
    assert done.returncode == 0
    assert "passed" in done.stdout
    for redirection in ("2>&-", "2>/dev/full"):
        done = shell(redirection, "check", "tea", "nowhere.csv")
        assert (done.returncode, done.stdout) == (2, "")


def test_a_full_disk_behind_a_file_ends_with_3_and_leaves_nothing(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")  # Unix alone has it

    def little() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    done = subprocess.run(
        [PROGRAM, "convert", "yuan2025", str(tmp_path / "model.npz")],
        capture_output=True,
        encoding="utf-8",
        preexec_fn=little,
        # Python would keep the first 2,000 bytes of a module that it compiles here.
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path.parent), "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert (done.returncode, done.stdout) == (3, "")
    told(done.stderr)
    assert "model.npz" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_path_that_cannot_be_written_to_is_bad_input(tmp_path: Path) -> None:
    folder = tmp_path / "model.npz"
    folder.mkdir()
    done = launch("convert", "tea", folder)
    assert (done.status, done.out) == (2, "")


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
    save(load("yuan2025"), tmp_path / "whole.npz")
    content = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "truncated.npz").write_bytes(content[: len(content) // 2])
    (tmp_path / "truncated.json").write_text('{"format": "exact-mdp certificate",', "utf-8")
    np.save(tmp_path / "shape.npy", np.zeros((3, 3)))
    np.save(tmp_path / "zeros.npy", np.zeros((16, 4)))
    np.save(tmp_path / "nan.npy", np.full((16, 4), np.nan))
    content = (tmp_path / "zeros.npy").read_bytes()
    (tmp_path / "truncated.npy").write_bytes(content[: len(content) // 2])
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not an archive")
    (tmp_path / "broken.json").write_text('{"0000": ', "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


REFUSED = {
    "unknown model file": "info unknown.xyz",
    "a folder": "info folder.toml",
    "not text": "info binary.toml",
    "broken TOML": "solve broken.toml",
    "truncated model": "solve truncated.npz",
    "probability above 1": "solve yuan2025 --set base.anger=1.1",
    "negative probability": "info yuan2025 --set base.anger=-0.1",
    "not a number": "info yuan2025 --set base.anger=often",
    "unknown status": "info yuan2025 --set base.joy=0.1",
    "unknown action in a parameter": "info yuan2025 --set reward.assist.hug=1",
    "unknown option of a reading": "info yuan2025 --set readings.trial_cost=never",
    "no setting": "info yuan2025 --set tasks",
    "negative max_trial": "info yuan2025 --set max_trial=-1",
    "empty task list": "info yuan2025 --set tasks=[]",
    "setting on a saved model": "info whole.npz --set tasks=[1]",
    "discount of a word": "solve yuan2025 --discount high",
    "negative discount": "solve yuan2025 --discount=-1/2",
    "division by zero": "solve yuan2025 --discount 1/0",
    "unknown method": "solve yuan2025 --method simplex",
    "tolerance 0": "solve yuan2025 --tol 0",
    "tolerance of a word": "solve yuan2025 --tol small",
    "tolerance too large": "solve yuan2025 --tol 1e999",
    "cycles": "solve gymnasium:FrozenLake-v1 --discount 0.9 --method backward-induction",
    "wrong ending": "solve yuan2025 --out values.csv",
    "policy of wrong ending": "solve yuan2025 --policy-out policy.npz",
    "no folder": "solve yuan2025 --out nowhere/values.npz",
    "one file twice": "solve yuan2025 --policy-out x.json --certificate x.json",
    "model of wrong ending": "convert yuan2025 model.txt",
    "model into no folder": "convert yuan2025 nowhere/model.npz",
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
    "broken JSON": "check yuan2025 broken.json",
    "NaN in a Q-table": "check yuan2025 nan.npy",
    "truncated array": "check yuan2025 truncated.npy",
    "no archive": "check yuan2025 broken.npz",
    "an action for a policy": "check yuan2025 directive",
    "negative limit": "check yuan2025 zeros.npy --max-regret -1",
    "limit of a word": "check yuan2025 zeros.npy --max-relative-regret much",
    "infinite limit": "check yuan2025 zeros.npy --max-regret inf",
    "report of wrong ending": "check yuan2025 zeros.npy --junit report.txt",
    "report into no folder": "check yuan2025 zeros.npy --junit nowhere/report.xml",
    "unknown kind of array": "check yuan2025 zeros.npy --kind table",
    "a name as a Q-table": "check yuan2025 random --kind q",
    "no policy": "check yuan2025",
    "an option of other commands": "check yuan2025 zeros.npy --limit 1",
    "returns below discount 1": "returns yuan2025 random --discount 0.95",
    "no episodes": "simulate yuan2025 random --episodes 0",
    "negative episodes": "simulate yuan2025 random --episodes -5",
    "too many episodes": "simulate yuan2025 random --episodes 99999999999",
    "seed of a word": "simulate yuan2025 random --episodes 10 --seed lucky",
    "negative seed": "simulate yuan2025 random --episodes 10 --seed=-1",
    "truncated certificate": "verify truncated.json yuan2025",
    "no certificate": "verify nowhere.json yuan2025",
    "no model": "solve",
    "too many words": "info yuan2025 tea",
    "no value": "solve yuan2025 --method",
    "episodes left out": "simulate yuan2025 random",
}


@pytest.mark.usefixtures("bad")
@pytest.mark.parametrize("line", REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_is_refused_with_what_where_and_fix(line: str) -> None:
    for form in ("", " --json"):
        done = run(*(line + form).split())
        assert (done.status, done.out) == (2, "")
        told(done.err)


@pytest.mark.usefixtures("bad")
def test_what_was_refused_leaves_no_file(bad: Path) -> None:
    before = sorted(bad.iterdir())
    words = ("--out", "x.npz", "--policy-out", "x.csv", "--method", "backward-induction")
    assert run("solve", "gymnasium:FrozenLake-v1", "--discount", "0.9", *words).status == 2
    assert run("convert", "yuan2025", "x.npz", "--set", "base.anger=2").status == 2
    assert sorted(bad.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--set", "max_trial=1000000000"), "max_trial is over 200,000,000"),
        (("--set", f"max_trial={'9' * 5000}"), "max_trial is over 200,000,000"),
        (("--discount", "1.0000000000000000000001"), "discount is 1 + 1e-22, outside [0, 1]"),
        (("--set", "base.anger=1.0000000000000000000001"), "base.anger is 1 + 1e-22, outside [0,"),
        (("--set", "base.anger=-1e-400"), "base.anger is -1e-400, outside [0, 1]"),
    ],
)
def test_a_refused_number_is_shown_outside_its_limits(words: tuple[str, ...], said: str) -> None:
    """1000000000 is a positive whole number, and 1 is not outside [0, 1]."""
    done = run("info", "yuan2025", *words)
    assert done.status == 2
    assert done.err.startswith(f"ModelError: {said}")


def test_sums_are_shown_apart_from_1() -> None:
    with pytest.raises(ModelError, match="start probabilities sum to 1 \\+ 1e-08, not 1"):
        MDP.from_arrays([[[1, 0], [0, 1]]], [1, 0], 0.5, start={0: "1/2", 1: "0.50000001"})


def test_a_program_without_a_command_shows_its_help() -> None:
    done = run()
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("Usage: exact-mdp")


@pytest.mark.parametrize("words", ["solve nowhere.npz", "solve", "solve tea --discount 2", "sove"])
def test_with_json_the_last_line_of_an_error_is_an_object(words: str) -> None:
    done = run(*words.split(), "--json")
    plain = run(*words.split())
    assert (done.status, done.out) == (2, "")
    *text, last = done.err.splitlines()
    assert text == plain.err.splitlines()
    said = strict(last)
    assert said["status"] == 2
    error = said["error"]
    assert text[-1] == f"  fix:   {error['fix']}"
    assert "\n".join(text).startswith(
        f"{error['kind']}: {error['what']}\n  where: {error['where']}"
    )
