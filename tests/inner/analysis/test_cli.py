"""How numbers are printed, and what becomes of errors that are planted in the command line."""

import ast
import errno
import re
from dataclasses import replace
from fractions import Fraction
from math import inf, nan
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from cli_runner import Done, ask, run, strict
from hypothesis import given, settings
from hypothesis import strategies as st

import exact_mdp
from exact_mdp import ModelError, SolverError, Status, solve
from exact_mdp.analysis.ci import Case, write_junit
from exact_mdp.analysis.cli import cli
from exact_mdp.mdp.report import (
    Report,
    digits_of,
    format_cell,
    format_decimal,
    format_error_bound,
    format_number,
    format_ratio,
)
from exact_mdp.paper_repro.__main__ import main as reproduce
from exact_mdp.paper_repro.agents.__main__ import main as agents

UNTIDY = ValueError("an open handle")  # of a library that was interrupted, and could not tidy up
UNTIDY.__context__ = KeyboardInterrupt()
READ = "exact_mdp.analysis.cli.given.read_model"
SOLVE = "exact_mdp.analysis.optimum.solve"
RUN, LOG = (
    "exact_mdp.paper_repro.run.run_reproduction",
    "exact_mdp.paper_repro.agents.log.read_recording",
)
GIVES_UP = SolverError(Status.NO_BOUND)


def wrong(*words: Any, **how: Any) -> Any:
    solution = solve(*words, **how)
    return replace(solution, value=solution.value + 1e-6)


def ended(words: str) -> Done:
    program, _, rest = words.partition(" ")
    return ask(MAINS[program], rest) if program in MAINS else run(words)


MAINS = {"reproduce": reproduce, "agents": agents}
CHECK = "check yuan2025 optimal"
FAULTS: list[tuple[str, Any, str, int, str]] = [
    (READ, OverflowError("too large for a float"), CHECK, 3, "OverflowError: "),
    (READ, RecursionError("maximum recursion depth"), CHECK, 3, ""),
    (READ, MemoryError(), CHECK, 3, "MemoryError: not enough memory\n"),
    (READ, MemoryError(), f"{CHECK} --horizon=9", 3, "MemoryError: not enough memory\n"),
    (READ, OSError(errno.EMFILE, "Too many open files"), CHECK, 3, ""),
    (READ, ImportError("no such library"), CHECK, 3, ""),
    (READ, ValueError("a slip"), CHECK, 3, "ValueError: an error in the program, not in your inp"),
    (READ, KeyboardInterrupt(), CHECK, 130, "stopped by SIGINT\n"),
    (READ, UNTIDY, CHECK, 130, "stopped by SIGINT\n"),
    (SOLVE, GIVES_UP, "solve tea --json", 3, "SolverError: double precision cannot bound"),
    (SOLVE, wrong, "solve yuan2025 --certify --json", 3, "Contradiction: exact values differ"),
    (RUN, OverflowError("too large"), "reproduce --quick --out x", 3, "OverflowError: "),
    (LOG, OverflowError("too large"), "agents run --out x", 3, "OverflowError: "),
    (LOG, None, "agents rnu", 2, ""),
]


@pytest.mark.parametrize(("place", "fault", "words", "status", "said"), FAULTS)
def test_what_is_neither_bad_input_nor_a_failed_check_ends_with_3(
    place: str,
    fault: Any,
    words: str,
    status: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """A crash is not 1, which says that the policy is bad; it is one sentence, in every program."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(place, Mock(side_effect=fault))
    done = ended(words)
    err = done.err if status == 130 or place == SOLVE else done.refusal(status)
    assert (done.status, done.out, "Traceback" in err) == (status, "", False)
    assert err.startswith(said)
    assert ("fix:   choose fewer steps" in err) == ("--horizon" in words)
    if "in the program" in said:
        assert "where: exact-mdp check\n" in err
        assert "EXACT_MDP_TRACEBACK=1" in err
        monkeypatch.setenv("EXACT_MDP_TRACEBACK", "1")
        assert "Traceback (most recent call last)" in ended(words).err


@pytest.mark.parametrize("fault", [OverflowError("too large"), KeyboardInterrupt()])
def test_a_check_that_does_not_end_leaves_an_error_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException
) -> None:
    path = tmp_path / "gate.xml"

    def message() -> str:
        error = ElementTree.parse(path).find(".//error")
        return "" if error is None else str(error.get("message"))

    def fail(*_: object, **__: object) -> None:
        assert "did not end" in message()  # what a killed process leaves
        raise fault

    assert run("check tea optimal --junit", path).status == 0
    assert message() == ""
    monkeypatch.setattr(READ, fail)
    assert run("check tea optimal --junit", path).status in (3, 130)
    assert "did not end" not in message() != ""


# ---- numbers -------------------------------------------------------------------------------------


@given(st.integers(-(10**30), 10**30), st.integers(1, 200))
def test_rationals_are_printed_exactly(top: int, bottom: int) -> None:
    value = Fraction(top, bottom)
    assert Fraction(format_decimal(value)) == Fraction(format_ratio(value)) == value
    ends = (value * 10 ** value.denominator.bit_length()).denominator == 1  # the decimal expansion
    assert ("/" in format_decimal(value)) == (not ends)


@pytest.mark.parametrize("digits", [1, 602, 603, 4299, 4301, 30_000])
def test_integers_have_all_their_digits(digits: int) -> None:
    whole = 7 ** int(digits / 0.846)
    text, left = "", whole
    while left:
        left, part = divmod(left, 10**1000)
        text = (f"{part:01000d}" if left else str(part)) + text
    assert digits_of(whole) == text
    assert digits_of(-whole) == f"-{text}"
    assert digits_of(10**digits) == "1" + "0" * digits


def test_a_rational_beyond_the_floats_has_a_cell() -> None:
    assert format_cell(Fraction(10**400, 7)) == "1.428571429e399"
    assert (format_cell(Fraction(1, 7)), format_cell(Fraction(10**9, 7 * 10**6))) == (
        "1/7",
        "1000/7",
    )


@settings(max_examples=50)
@given(st.floats() | st.integers() | st.text() | st.booleans() | st.none())
def test_json_is_strict_and_exact_and_takes_arrays_and_rationals(value: object) -> None:
    facts = {"x": [value], "a": np.array([1.5, nan]), 2: (np.int64(3), np.bool_(True))}
    report = Report(title="numbers (estimated)", facts=facts | {"q": Fraction(1, 3)})
    written = strict(report.json())
    shown = None if value != value or value in (inf, -inf) else value
    assert written == {"format": 2, "x": [shown], "a": [1.5, None], "2": [3, True], "q": "1/3"}


@given(st.floats(-1e9, 1e9), st.floats(1e-15, 1e9), st.floats(0, 1e300))
def test_printed_numbers_are_as_good_as_their_error(
    value: float, error: float, bound: float
) -> None:
    assert abs(float(format_number(value, error)) - value) <= max(error / 2, 1e-9 * abs(value))
    assert re.fullmatch(r"-?[0-9.]+(e[-+][0-9]+)?", format_number(value, error))
    if error > abs(value):
        assert re.fullmatch(r"-?[0.]*[1-9]?0*(\.0)?(e[-+][0-9]+)?", format_number(value, error))
    assert Fraction(format_error_bound(bound)) >= Fraction(bound)
    assert float(format_error_bound(bound)) <= 1.1 * bound + 1e-320


# ---- reports -------------------------------------------------------------------------------------


def test_what_xml_cannot_hold(tmp_path: Path) -> None:
    nasty = 'a\x00b\x1b[0m<&>"\ud800\uffff ]]> é \U0001f600\n'
    case, path = Case(nasty, "failure", nasty, nasty), tmp_path / "r.xml"
    write_junit(path, nasty, [case], seconds=1, properties={nasty: nasty})
    root = ElementTree.fromstring(path.read_bytes())
    assert root.findtext(".//failure") == 'a?b?[0m<&>"?? ]]> é \U0001f600\n'
    with pytest.raises(ModelError):
        write_junit(tmp_path / "no" / "r.xml", "s", [case], seconds=0, properties={})


def test_an_error_names_options_that_there_are() -> None:
    described = [
        click.Context(each, **each.context_settings).to_info_dict()
        for each in (cli, reproduce, agents)
    ]
    known = {"--help", *re.findall(r"'(--[a-z-]+)'", str(described))}
    wrong = []
    for path in Path(exact_mdp.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Error"):
                words = re.findall(r"(?<![\w-])--[a-z][a-z-]*", ast.unparse(node))
                wrong += [(path.name, node.lineno, word) for word in words if word not in known]
    assert wrong == []
