"""What breaks has its exit status and its sentence: long numbers, modules, disks, streams."""

import os
import re
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from cli_runner import PROGRAM, Done, launch, run, strict

import exact_mdp

LONG_HEX = "0x" + "f" * 9000
SCENARIOS = Path(exact_mdp.__file__).parent / "mdp" / "scenarios"
YUAN = (SCENARIOS / "yuan2025.toml").read_text("utf-8")


def changed(pattern: str, line: str) -> str:
    text, count = re.subn(pattern, lambda _: line, YUAN, count=1, flags=re.M)
    assert count == 1
    return text


NESTED = ".".join(["a"] * 3000)
FILES = [
    *(
        ("info", text)
        for text in (
            changed(r"^max_trial *=.*$", f"max_trial = {LONG_HEX}"),
            changed(r"^tasks *=.*$", f"tasks = [{LONG_HEX}]"),
            changed(r"^title *=.*$", f"title = {LONG_HEX}"),
            f"x = {LONG_HEX}\n" + YUAN,
            f"{NESTED} = 1\n" + YUAN,
            f"{YUAN}\n[base.x]\ny = {LONG_HEX}\n",
            f"{YUAN}\n[base.{NESTED}]\nx = 1\n",
            "x = " + "[" * 5000 + "]" * 5000,
        )
    ),
    *product(
        (
            "tornado tea --range",
            "psa tea --samples 4 --uncertain",
            "evaluate tea random --perception",
        ),
        (f"{NESTED} = 1", f'"base.anger" = [{LONG_HEX}, 1]'),
    ),
]


@pytest.mark.parametrize(("words", "text"), FILES, ids=map(str, range(len(FILES))))
def test_long_numbers_and_deep_tables_are_bad_input(words: str, text: str, tmp_path: Path) -> None:
    """Integers of 9,000 digits and keys of 3,000 parts are refused where they are read, by name."""
    path = tmp_path / "file.toml"
    path.write_text(text, "utf-8")
    assert str(path) in run(words, path).refusal()


ENDS = {
    "0": "import sys; sys.exit(0)",
    "1": "import sys; sys.exit(1)",
    "text": "import sys; sys.exit('a text')",
    "None": "raise SystemExit",
    "a subclass": "class End(SystemExit): pass\nraise End(0)",
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
    run("check gymnasium:ends:X-v0 random --discount 0.9").refusal(3)


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


# ---- streams and disks ---------------------------------------------------------------------------

CHECK, FULL = "check tea optimal", "the system refuses: No space left on device"


@pytest.mark.parametrize(
    ("line", "status", "said"),
    [
        (f"{CHECK} >/dev/full", 3, FULL),
        (f"{CHECK} --json >/dev/full", 3, FULL),
        (f"{CHECK} >&-", 3, "standard output is closed"),
        (f"{CHECK} >/dev/null", 0, ""),
        (f"{CHECK} 2>&-", 0, ""),
        ("check tea nowhere.csv 2>&-", 2, ""),
        ("check tea nowhere.csv 2>/dev/full", 2, ""),
    ],
)
def test_a_verdict_that_nobody_can_read_is_none(line: str, status: int, said: str) -> None:
    """A full disk or a closed stream ends with 3, but not where it is that of messages."""
    end = subprocess.run(f"{PROGRAM} {line}", shell=True, capture_output=True, encoding="utf-8")
    done = Done(status=end.returncode, out=end.stdout, err=end.stderr)
    assert done.status == status
    assert ("passed" in done.out) == (line == f"{CHECK} 2>&-")
    assert not said or said in done.refusal(3)


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
    assert "model.npz" in Done(status=done.returncode, out=done.stdout, err=done.stderr).refusal(3)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", ["solve nowhere.npz", "solve", "solve tea --discount 2", "sove"])
def test_with_json_the_last_line_of_an_error_is_an_object(words: str) -> None:
    plain, text = run(words).refusal(), run(words, "--json").err
    assert text.startswith(plain)
    error = strict(text.removeprefix(plain))
    assert (error.pop("format"), error.pop("status"), [*error]) == (2, 2, ["error"])
    assert plain == "{kind}: {what}\n  where: {where}\n  fix:   {fix}\n".format(**error["error"])
