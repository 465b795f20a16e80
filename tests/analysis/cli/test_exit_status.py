"""Every failure has its exit status and its sentence; no traceback, nothing half-written."""

import errno
import os
import re
import resource
import subprocess
from pathlib import Path
from typing import Any

import pytest
from cli_runner import PROGRAM, launch, run
from click.testing import CliRunner

from exact_mdp.paper_repro.__main__ import main as reproduce
from exact_mdp.paper_repro.agents.__main__ import main as agents

LONG_HEX = "0x" + "f" * 9000
YUAN = Path(__file__).parents[3] / "mdp" / "scenarios" / "yuan2025.toml"


def told(err: str, status: int = 2) -> None:
    assert "Traceback" not in err, err
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
        ("sensitivity", "tea", "tornado", "--ranges"),
        ("sensitivity", "tea", "psa", "--samples", "4", "--effective-sample-size"),
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
    "train tea --seeds 1 --epochs 2 --learning-discount {}": "--learning-discount",
    "train tea --seeds 1 --epochs 2 --rate {}": "--rate",
    "train tea --seeds {}": "--seeds",
    "simulate tea random --episodes {}": "--episodes",
    "sensitivity tea robust --radius {}": "--radius",
    "sensitivity tea robust --set-kind kl --radius {}": "--radius",
    "sensitivity tea threshold --relative {}": "--relative",
    "sensitivity tea tornado --relative {}": "--relative",
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


FAULTS = {
    "OverflowError": OverflowError("integer division result too large for a float"),
    "RecursionError": RecursionError("maximum recursion depth exceeded"),
    "MemoryError": MemoryError(),
    "ValueError": ValueError("Exceeds the limit (4300 digits) for integer string conversion"),
    "OSError": OSError(errno.EMFILE, "Too many open files"),
    "ImportError": ImportError("no such library"),
    "KeyError": KeyError("a slip"),
}


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_what_is_neither_bad_input_nor_a_failed_check_ends_with_3(
    monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    """A crash is not 1, which says that the policy is bad."""

    def fail(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr("exact_mdp.analysis.cli.options.load", fail)
    done = run("check", "yuan2025", "optimal")
    assert (done.status, done.out) == (3, "")
    told(done.err)


def test_the_other_programs_end_in_the_same_way(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OverflowError("too large")

    monkeypatch.setattr("exact_mdp.paper_repro.run.run", fail)
    done = CliRunner().invoke(reproduce, ["--quick", "--out", str(tmp_path)])
    assert (done.exit_code, done.stdout) == (3, "")
    told(done.stderr)
    monkeypatch.setattr("exact_mdp.paper_repro.agents.recording.read", fail)
    recording = tmp_path / "recording.jsonl"
    recording.write_text("{}", "utf-8")
    done = CliRunner().invoke(agents, ["replay", str(recording)])
    assert (done.exit_code, done.stdout) == (3, "")
    told(done.stderr)
    done = CliRunner().invoke(agents, ["repaly"])
    assert (done.exit_code, done.stdout) == (2, "")
    told(done.stderr)


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
    def little() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    done = subprocess.run(
        [PROGRAM, "convert", "yuan2025", str(tmp_path / "model.npz")],
        capture_output=True,
        encoding="utf-8",
        preexec_fn=little,
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path.parent)},
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
