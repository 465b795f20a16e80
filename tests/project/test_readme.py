"""What README and guides show is run: Python blocks, exact-mdp lines, the files that are linked."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from exact_mdp.analysis.cli import main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text("utf-8")
PAGES = [
    README,
    *(path.read_text("utf-8") for path in sorted((ROOT / "docs" / "how-to").glob("*.md"))),
    (ROOT / "docs" / "reference" / "commands.md").read_text("utf-8"),
]
WORDS = 900


def blocks(page: str) -> list[tuple[str, str]]:
    """Return kind and text of each block of code."""
    return re.findall(r"^```([\w]*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


PYTHON = [body for kind, body in blocks(README) if kind == "python"]
SHOWN = [body for kind, body in blocks(README) if kind == "text"]
LINES = [
    line
    for page in PAGES
    for kind, body in blocks(page)
    if not kind
    for line in body.splitlines()
    if line.startswith("exact-mdp ")
]


def test_python_blocks_run_and_print_what_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    (shown,) = SHOWN
    for block in PYTHON:
        exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert shown in printed
    assert "Fraction(6561, 250)" in printed


def test_the_readme_is_short() -> None:
    assert len(README.split()) <= WORDS


@pytest.mark.parametrize("line", LINES)
def test_command_lines_run(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    table = np.zeros((16, 4))
    table[:, 1] = 1
    np.save("q_table.npy", table)
    status = main(shlex.split(line)[1:])
    shown = capsys.readouterr()
    assert status == (1 if " check " in line else 0), shown.err
    assert shown.out


def test_there_is_something_to_run() -> None:
    assert len(PYTHON) == 2
    assert len(LINES) >= 12


def test_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert links
    paper = "https://arxiv.org/abs/2501.17206"
    for link in links:
        assert link == paper or (ROOT / link).exists(), link
