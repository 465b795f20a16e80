"""How numbers are printed, and what becomes of errors that are planted in the command line."""

import errno
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from math import inf, nan
from pathlib import Path
from pkgutil import iter_modules
from typing import Any
from unittest.mock import Mock
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from cli_runner import run, strict
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import corridor

from exact_mdp import ModelError, Policy, Scenario, SolverError, Status, check, plots, solve
from exact_mdp.analysis import ci, exit_status
from exact_mdp.analysis.ci import Case, write_junit
from exact_mdp.analysis.cli.render import markdown
from exact_mdp.analysis.optimum import of_every_state
from exact_mdp.analysis.pages.audit import audit_page
from exact_mdp.analysis.plots.style import picture
from exact_mdp.mdp.report import Report, Table, at_most, decimal, digits_of, number, ratio
from exact_mdp.mdp.table import beside
from exact_mdp.paper_repro.__main__ import main as reproduce
from exact_mdp.paper_repro.agents.__main__ import main as agents
from exact_mdp.solvers.parallel import write_piece

READ = "exact_mdp.analysis.cli.given.read_model"
SOLVE = "exact_mdp.analysis.optimum.solve"
RUN, LOG = "exact_mdp.paper_repro.run.run", "exact_mdp.paper_repro.agents.log.read"
GIVES_UP = SolverError(Status.NO_BOUND)


def wrong(*words: Any, **how: Any) -> Any:
    solution = solve(*words, **how)
    return replace(solution, value=solution.value + 1e-6)


def program(main: Any, words: str) -> Callable[[], tuple[int, str, str]]:
    def call() -> tuple[int, str, str]:
        done = CliRunner().invoke(main, words.split())
        return done.exit_code, done.stdout, done.stderr

    return call


def command(words: str) -> Callable[[], tuple[int, str, str]]:
    def call() -> tuple[int, str, str]:
        done = run(*words.split())
        return done.status, done.out, done.err

    return call


CHECK, CERTIFY = command("check yuan2025 optimal"), command("solve yuan2025 --certify --json")
FAULTS: list[tuple[str, Any, Callable[[], tuple[int, str, str]], int, str]] = [
    (READ, OverflowError("too large for a float"), CHECK, 3, "OverflowError: "),
    (READ, RecursionError("maximum recursion depth"), CHECK, 3, ""),
    (READ, MemoryError(), CHECK, 3, ""),
    (READ, ValueError("Exceeds the limit (4300 digits)"), CHECK, 3, ""),
    (READ, OSError(errno.EMFILE, "Too many open files"), CHECK, 3, ""),
    (READ, ImportError("no such library"), CHECK, 3, ""),
    (READ, ValueError("a slip"), CHECK, 3, "ValueError: an error in the program, not in your inp"),
    (READ, KeyboardInterrupt(), CHECK, 130, "stopped by SIGINT\n"),
    (SOLVE, GIVES_UP, command("solve tea --json"), 3, "SolverError: double precision cannot bound"),
    (SOLVE, wrong, CERTIFY, 3, "Contradiction: exact values differ"),
    (RUN, OverflowError("too large"), program(reproduce, "--quick --out x"), 3, "OverflowError: "),
    (LOG, OverflowError("too large"), program(agents, "run --out x"), 3, "OverflowError: "),
    (LOG, None, program(agents, "rnu"), 2, ""),
]


@pytest.mark.parametrize(("place", "fault", "call", "status", "said"), FAULTS)
def test_what_is_neither_bad_input_nor_a_failed_check_ends_with_3(
    place: str,
    fault: Any,
    call: Callable[[], tuple[int, str, str]],
    status: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """A crash is not 1, which says that the policy is bad; it is one sentence, in every program."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(place, Mock(side_effect=fault))
    ended, out, err = call()
    assert (ended, out) == (status, "")
    err = re.sub(r'\n\{"status": \d, "error": \{.*\}\}\n$', "\n", err)  # with --json
    shape = r"[A-Z]\w+: [^\n]+\n  where: [^\n]+\n  fix:   [^\n]+\n"
    assert re.fullmatch(r"[^\n]+\n" if place == SOLVE or status == 130 else shape, err), err
    assert err.startswith(said)
    if "in the program" in said:
        assert "where: exact-mdp check, in analysis/cli/given.py, line " in err
        assert "EXACT_MDP_TRACEBACK=1" in err
        monkeypatch.setenv("EXACT_MDP_TRACEBACK", "1")
        assert "Traceback (most recent call last)" in call()[2]


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

    assert run("check", "tea", "optimal", "--junit", path).status == 0
    assert message() == ""
    monkeypatch.setattr(READ, fail)
    assert run("check", "tea", "optimal", "--junit", path).status in (3, 130)
    assert "did not end" not in message() != ""


def test_a_piece_whose_numbers_were_changed_is_damaged(tmp_path: Path) -> None:
    """A changed policy was read from beyond an array; others were taken as they were."""
    words = ["train", "tea", "--seeds=1", "--learner=epochs=3", "--n-jobs=1", "--out", tmp_path]
    assert run(*words).status == 0
    path = tmp_path / "runs-000000.npz"
    good = path.read_bytes()
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name, value in {"policies": 32767, "last": 32767, "snapshots": -1, "q": 3}.items():
        np.savez(path, **arrays | {name: np.full_like(arrays[name], value)})
        done = run(*words)
        assert (done.status, done.out) == (2, "")
        assert done.err.startswith("ModelError: the file is damaged\n")
    arrays.pop("sha256")
    for name in ("policies", "last"):  # with a digest that agrees
        write_piece(path, arrays | {name: np.full_like(arrays[name], 32767)})
        assert run(*words).status == 2
    path.write_bytes(good)
    assert run(*words).status == 0


# ---- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("off", [Fraction(1, 10**22), -Fraction(1, 10**22), Fraction(1, 3)])
def test_every_number_stands_on_its_own_side(off: Fraction) -> None:
    text = beside(1 + off, Fraction(0), Fraction(1))
    assert text not in ("1", "0")
    top, _, rest = text.replace(" - ", " + -").partition(" + ")
    assert (Fraction(top) + Fraction(rest or "0") > 1) == (off > 0)


def test_long_distributions_and_values_are_left_to_json(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.analysis.optimum.SHOWN_DIGITS", 100)
    monkeypatch.setattr("exact_mdp.solvers.values.returns.LISTED", 7)
    done = run("solve", "yuan2025", "--certify")
    assert re.search(r"exact start value  a rational of \d+ digits; --json prints it\n", done.out)
    done = run("returns", "yuan2025", "random", "--set", "tasks=[1]")
    assert "(the first 7 of 77; --json prints all)" in done.out
    assert len(done.out.splitlines()) == 19  # with what it is not: medical advice


@given(st.integers(-(10**30), 10**30), st.integers(1, 200))
def test_rationals_are_printed_exactly(top: int, bottom: int) -> None:
    value = Fraction(top, bottom)
    assert Fraction(decimal(value)) == Fraction(ratio(value)) == value
    ends = (value * 10 ** value.denominator.bit_length()).denominator == 1  # the decimal expansion
    assert ("/" in decimal(value)) == (not ends)


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


@settings(max_examples=50)
@given(st.floats() | st.integers() | st.text() | st.booleans() | st.none())
def test_json_is_strict_and_exact(value: object) -> None:
    written = strict(Report(title="", facts={"x": [value]}).json())["x"][0]
    assert written is None if value != value or value in (inf, -inf) else written == value


def test_json_takes_arrays_and_rationals() -> None:
    facts = {"a": np.array([1.5, nan]), 2: (np.int64(3), np.bool_(True)), "q": Fraction(1, 3)}
    expected = {"format": 2, "a": [1.5, None], "2": [3, True], "q": "1/3"}
    assert json.loads(Report(title="", facts=facts).json()) == expected


@given(st.floats(-1e9, 1e9), st.floats(1e-15, 1e9), st.floats(0, 1e300))
def test_printed_numbers_are_as_good_as_their_error(
    value: float, error: float, bound: float
) -> None:
    assert abs(float(number(value, error)) - value) <= max(error / 2, 1e-9 * abs(value))
    assert re.fullmatch(r"-?[0-9.]+(e[-+][0-9]+)?", number(value, error))
    assert Fraction(at_most(bound)) >= Fraction(bound)
    assert float(at_most(bound)) <= 1.1 * bound + 1e-320


# ---- reports -------------------------------------------------------------------------------------


def test_markdown_shows_facts_and_notes() -> None:
    table = Table(title="t", rows=[{"a": 1}], columns={"a": "a"}, note="what a is")
    report = Report(title="*", facts={"x": None, "y_z": 2}, tables={"t": table})
    assert markdown(report).splitlines() == [
        r"## \*", "", "|  |  |", "| --- | --- |", "| y z | 2 |", "", "### t", "", "what a is", "",
        "| a |", "| ---: |", "| 1 |",
    ]  # fmt: skip


def test_unsafe_characters_are_written_as_codes() -> None:
    """Names cannot hold them, but names of files and messages can."""
    audit, report = check(corridor(["a", "b"]), [1, 0]), Report(title="", facts={}, notes=["so"])
    shown = audit_page(audit, report, "m\x1b[31m\u202e", "p", rerun="x\ny", first=9)
    assert r"m\x1b[31m\u202e" in shown
    assert "\x1b" not in shown
    assert "x\ny" in shown
    assert "Note: so" in shown


def test_what_xml_cannot_hold(tmp_path: Path) -> None:
    nasty = 'a\x00b\x1b[0m<&>"\ud800\uffff ]]> é \U0001f600\n'
    case, path = Case(nasty, "failure", nasty, nasty), tmp_path / "r.xml"
    write_junit(path, nasty, [case], seconds=1, properties={nasty: nasty})
    root = ElementTree.fromstring(path.read_bytes())
    assert root.findtext(".//failure") == 'a?b?[0m<&>"?? ]]> é \U0001f600\n'
    with pytest.raises(ModelError):
        write_junit(tmp_path / "no" / "r.xml", "s", [case], seconds=0, properties={})


def test_github_is_told_nothing_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    ci.annotate("a", "b")
    ci.summarise("c")
    assert capsys.readouterr() == ("", "")
    assert ci.inert("::error::x ##[y]") == "::error::x ##[y]"


def test_names_stay_text_in_figures(tmp_path: Path) -> None:
    """Dollar signs, angle brackets and quotes are letters of a name: no formula, no element."""
    import matplotlib.pyplot as plt

    @picture
    def plot(ax: Any = None) -> Any:
        ax = plt.subplots()[1]
        ax.set_title("from $x^$ to $y$")
        ax.set_xlabel("<script>&\"'")
        ax.set_xticks([0, 1], ["$\\frac$", "</text>"])
        return ax

    with plots.style():
        plot().figure.savefig(tmp_path / "names.svg")
    root = ElementTree.parse(tmp_path / "names.svg").getroot()
    texts = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"from $x^$ to $y$", "<script>&\"'", "$\\frac$", "</text>"} <= texts
    assert not list(root.iter("{http://www.w3.org/2000/svg}script"))
    for module in iter_modules(plots.__path__):  # and every figure is drawn so
        for name, function in vars(import_module(f"{plots.__name__}.{module.name}")).items():
            assert not name.startswith("plot_") or hasattr(function, "__wrapped__"), name


def test_a_policy_by_status_is_one_that_reads_nothing_else(tmp_path: Path) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    path = tmp_path / "p.json"
    always = Policy.always(mdp, "directive").choices(mdp)
    late = always.copy()
    late[mdp.space.index(trial=1, status=3)] = 0
    for numbers, by_status in ((always, True), (late, False)):
        names = of_every_state(mdp, [mdp.actions[a] for a in numbers])
        assert (names.keys() == {f"{n:04b}" for n in range(16)}) is by_status
        path.write_text(json.dumps(names), encoding="utf-8")
        wanted = Policy.from_choices(mdp, numbers).weights(mdp)
        assert (Policy.of(mdp, path).weights(mdp) == wanted).all()


def test_what_a_program_prints_is_seen_while_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    screen, seen = io.StringIO(), []
    monkeypatch.setattr("sys.stdout", screen)

    @click.command()
    def talk() -> None:
        click.echo("first")
        seen.append(screen.getvalue())

    assert (exit_status.run(talk, "talk", []), seen) == (0, ["first\n"])
