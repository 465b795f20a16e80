"""What README and guides show is run: Python blocks, exact-mdp lines, the files that are linked."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cli_runner import main

from exact_mdp.paper_repro.agents.__main__ import main as agents

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text("utf-8")
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted(DOCS.glob("*.md")),
    *sorted((DOCS / "how-to").glob("*.md")),
    DOCS / "reference" / "commands.md",
]
PROGRAMS = ("exact-mdp ", "python -m exact_mdp.paper_repro.agents ")
# Records have a test of their own, test_interval_command; the others need Storm or a model.
ELSEWHERE = ("records.csv", "model.prism", "--backend ")
WORDS = 900


def blocks(page: str) -> list[tuple[str, str]]:
    """Return kind and text of each block of code."""
    return re.findall(r"^```([\w]*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


PYTHON = [body for kind, body in blocks(README) if kind == "python"]
SHOWN = [body for kind, body in blocks(README) if kind == "text"]


def command_blocks() -> Iterator[object]:
    """The command lines of each block; those of a page that is long to work out are slow."""
    for page in PAGES:
        for kind, body in blocks(page.read_text("utf-8")):
            lines = [line for line in body.splitlines() if line.startswith(PROGRAMS)]
            if not kind and lines and not any(words in body for words in ELSEWHERE):
                marks = [pytest.mark.slow] if page.parent == DOCS else []
                yield pytest.param(lines, id=f"{page.stem}: {lines[0]}", marks=marks)


BLOCKS = list(command_blocks())


def test_python_blocks_run_and_print_what_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    (shown,) = SHOWN
    for block in PYTHON:
        exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert shown in printed
    assert "Fraction(6561, 250)" in printed


def test_the_readme_is_short() -> None:
    assert len(README.split()) <= WORDS


@pytest.mark.parametrize("lines", BLOCKS)
def test_command_lines_run(
    lines: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    table = np.zeros((16, 4))
    table[:, 1] = 1
    np.save("q_table.npy", table)
    for line in lines:
        words = shlex.split(line)
        if words[0] == "python":
            assert agents(words[3:], standalone_mode=False) in (None, 0), line
        else:
            assert main(words[1:]) == (1 if words[1] == "check" else 0), line
        assert capsys.readouterr().out, line


def test_there_is_something_to_run() -> None:
    assert len(PYTHON) == 2
    assert len(BLOCKS) >= 18


def test_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert links
    paper = "https://arxiv.org/abs/2501.17206"
    for link in links:
        assert link == paper or (ROOT / link).exists(), link


def test_no_page_shows_what_a_command_writes() -> None:
    """`make reproduce` rewrites its results, and `make clean` removes them."""
    assert "/results/\n" in (ROOT / ".gitignore").read_text("utf-8")
    for page in PAGES:
        for picture in re.findall(r"!\[[^]]*]\(([^)]+)\)", page.read_text("utf-8")):
            if "://" not in picture:
                shown = (page.parent / picture).resolve().relative_to(ROOT)
                assert shown.parts[0] != "results", (page, picture)
