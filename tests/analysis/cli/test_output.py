"""What the command line prints: tables, strict JSON, help."""

import json
import re
import subprocess
import sys
from fractions import Fraction
from importlib import import_module
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from cli_runner import PROGRAM, launch, run, strict
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, save
from exact_mdp.analysis.cli import cli
from exact_mdp.analysis.cli.render import at_most, decimal, digits_of, number, ratio, to_json

ROOT = Path(__file__).resolve().parents[3]


# ---- what it prints --------------------------------------------------------------------------


def test_tables_are_plain_text_without_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    for width in ("40", "100"):
        monkeypatch.setenv("COLUMNS", width)
        for line in ("info tea", "solve yuan2025", "evaluate yuan2025 random", "solve tea"):
            done = run(*line.split())
            assert done.status == 0
            assert "\x1b" not in done.out
            assert "…" not in done.out
            assert max(len(text) for text in done.out.splitlines()) <= int(width)
            assert all(text == text.rstrip() for text in done.out.splitlines())
    assert re.search(r"^start value +84\.9137\d+ +\(bounded, within \S+\)$", done.out, re.MULTILINE)
    assert re.search(r"^101 +demonstrate$", done.out, re.MULTILINE)


def test_long_distributions_and_values_are_left_to_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_module("exact_mdp.analysis.cli.solve"), "SHOWN_DIGITS", 100)
    monkeypatch.setattr(import_module("exact_mdp.analysis.cli.evaluate"), "LISTED_RETURNS", 7)
    done = run("solve", "yuan2025", "--certify")
    assert re.search(r"exact start value  a rational of \d+ digits; --json prints it\n", done.out)
    done = run("returns", "yuan2025", "random", "--set", "tasks=[1]")
    assert "(the first 7 of 77; --json prints all)" in done.out
    assert len(done.out.splitlines()) == 20  # with what it is not: medical advice


def test_names_of_states_are_printed_as_they_are(tmp_path: Path) -> None:
    names = ["[bold]no markup[/bold]", "Zustand β :smile:"]
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0], states=names, actions=["[red]go"])
    path = tmp_path / "model.npz"
    save(mdp, path)
    found = run("solve", path, "--json").result
    assert found["policy_by_state"] == dict.fromkeys(names, "[red]go")
    assert all(name in run("solve", path).out for name in [*names, "[red]go"])
    done = launch("solve", path, PYTHONIOENCODING="ascii")
    assert done.status == 0
    assert "Zustand \\u03b2 :smile:" in done.out


def test_states_of_the_same_name_are_told_apart(tmp_path: Path) -> None:
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0], states=["x", "x"])
    save(mdp, tmp_path / "model.npz")
    found = run("solve", tmp_path / "model.npz", "--json").result
    assert list(found["policy_by_state"]) == ["x (state 0)", "x (state 1)"]


@given(st.integers(0, 10**30), st.integers(1, 200), st.booleans())
def test_rationals_are_printed_exactly(top: int, bottom: int, negative: bool) -> None:
    value = Fraction(-top if negative else top, bottom)
    assert Fraction(decimal(value)) == Fraction(ratio(value)) == value
    assert ("/" in decimal(value)) == (re.sub("^0+", "", str(bottom)) != "" and not finite(value))


def finite(value: Fraction) -> bool:
    """Return whether a decimal expansion ends: 10^k times the number is whole for some k."""
    return (value * 10 ** value.denominator.bit_length()).denominator == 1


@pytest.mark.parametrize("digits", [1, 602, 603, 4299, 4301, 30_000])
def test_integers_have_all_their_digits(digits: int) -> None:
    text = "".join(str((7 * place + place // 13) % 10) for place in range(1, digits + 1))
    whole = 0
    for start in range(0, digits, 1000):
        part = text[start : start + 1000]
        whole = whole * 10 ** len(part) + int(part)
    assert digits_of(whole) == text.lstrip("0")
    assert digits_of(-whole) == f"-{text.lstrip('0')}"
    assert digits_of(10**digits) == "1" + "0" * digits


@settings(max_examples=50)
@given(st.floats() | st.integers() | st.text() | st.booleans() | st.none())
def test_json_is_strict_and_exact(value: object) -> None:
    found = strict(to_json({"x": [value]}))["x"][0]
    assert found is None if value != value or value in (inf, -inf) else found == value


def test_json_takes_arrays_and_rationals() -> None:
    found = {"a": np.array([1.5, nan]), 2: (np.int64(3), np.bool_(True)), "q": Fraction(1, 3)}
    expected = {"format": 2, "a": [1.5, None], "2": [3, True], "q": "1/3"}
    assert json.loads(to_json(found)) == expected


@given(st.floats(0, 1e300))
def test_printed_bounds_hold(error: float) -> None:
    assert Fraction(at_most(error)) >= Fraction(error)
    assert float(at_most(error)) <= 1.1 * error + 1e-320


@given(st.floats(-1e9, 1e9), st.floats(1e-15, 1e9))
def test_printed_numbers_are_as_good_as_their_error(value: float, error: float) -> None:
    assert abs(float(number(value, error)) - value) <= max(error / 2, 1e-9 * abs(value))
    assert re.fullmatch(r"-?[0-9.]+(e[-+][0-9]+)?", number(value, error))


# ---- the program -----------------------------------------------------------------------------


def test_the_program_keeps_its_promises_to_scripts() -> None:
    done = launch("solve", "yuan2025", "--json")
    assert json.loads(done.out)["model"] == "yuan2025"
    assert (done.status, done.err) == (0, "")
    done = launch("solve", "yuan2026", "--json")
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("ModelError: unknown model 'yuan2026'\n  where: ")
    version = launch("--version")
    assert (version.status, version.out) == (0, "exact-mdp 0.1.0\n")


def test_a_closed_pipe_is_no_error() -> None:
    words = [PROGRAM, "returns", "yuan2025", "random", "--set", "tasks=[1]"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


def test_help_comes_without_loading_numpy() -> None:
    code = (
        "import runpy, sys; sys.argv[1:] = ['solve', '--help']\n"
        "try: runpy.run_module('exact_mdp', run_name='__main__')\n"
        "except SystemExit as end: status = end.code\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'rich', 'exact_mdp.mdp.model', 'tqdm'}; "
        "heavy &= set(sys.modules); "
        "sys.exit(f'{status} {heavy}' if status or heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, encoding="utf-8", cwd=ROOT
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "--certify" in done.stdout


def test_every_command_has_help() -> None:
    listed = run("--help").out
    for command in cli.commands.values():
        assert re.search(rf"^  {command.name} +\w", listed, re.MULTILINE)
        text = run(command.name, "--help").out
        assert text.startswith(f"Usage: exact-mdp {command.name} [OPTIONS]")
        for option in command.params:
            if option.param_type_name == "option":
                assert getattr(option, "help", None)


def test_every_command_is_documented() -> None:
    table = re.findall(
        r"^\| `exact-mdp ([\w-]+)",
        (ROOT / "docs" / "reference" / "commands.md").read_text("utf-8"),
        re.MULTILINE,
    )
    assert sorted(table) == sorted(cli.commands)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["evaluate", "yuan2025", "random"], True),
        (["gradient", "tea", "--parameter", "reward.anxiety"], True),
        (["info", "gymnasium:FrozenLake-v1"], False),
    ],
)
def test_what_concerns_care_says_that_it_is_no_medical_advice(words: list[str], told: bool) -> None:
    assert ("no medical advice" in run(*words).out) == told
    found = run(*words, "--json")
    assert ("no medical advice" in json.loads(found.out).get("notice", "")) == told
    assert "medical" not in found.err
