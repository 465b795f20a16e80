"""The page for those who come from other tools: every block runs, alone, without these tools."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[2] / "docs/coming_from.md").read_text("utf-8")
BLOCKS = re.findall(
    r"^## (\S+?),?(?: [^\n]*)?\n(?:(?!^## ).)*?```python\n(.*?)^```$", PAGE, re.M | re.S
)
SHOWN = {
    "QuantEcon": ["-8.571428", "-20. ", "Policy([0 0]"],
    "pymdptoolbox": ["[74.6496 78.1056 82.1056] Policy([0 0 0]"],
    "msdm": ["-4 "],
    "Gymnasium": ["('LEFT', 'DOWN', 'RIGHT', 'UP') row 1, column 2"],
}


@pytest.mark.parametrize(("tool", "block"), BLOCKS, ids=[tool for tool, _ in BLOCKS])
def test_blocks_run(tool: str, block: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(block, f"docs/coming_from.md, {tool}", "exec"), {})
    printed = capsys.readouterr().out
    assert [text for text in SHOWN.get(tool, []) if text not in printed] == []


def test_every_tool_has_a_block() -> None:
    assert len(BLOCKS) == PAGE.count("\n## ") == PAGE.count("```python")
    assert {tool for tool, _ in BLOCKS} >= {*SHOWN, "msdm", "Storm"}
