"""What the README shows is run: every Python block, every exact-mdp line, every file it links."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from exact_mdp.analysis.cli import main

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text("utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
PYTHON = [body for kind, body in BLOCKS if kind == "python"]
LINES = [
    line
    for kind, body in BLOCKS
    if not kind
    for line in body.splitlines()
    if line.startswith("exact-mdp ")
]


@pytest.mark.parametrize("block", PYTHON)
def test_python_blocks_run(block: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(block, "README.md", "exec"), {})
    if "forest" in block:
        assert "26.244" in capsys.readouterr().out


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
    assert len(PYTHON) >= 3
    assert len(LINES) >= 4


def test_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert links
    paper = "https://arxiv.org/abs/2501.17206"
    for link in links:
        assert link == paper or (ROOT / link).exists(), link
