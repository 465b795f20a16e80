"""How a command prints a report: as text, as Markdown, or as JSON.

Text never has colours or cut-off cells: what is too wide wraps.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Any, Literal

from exact_mdp.analysis import ci
from exact_mdp.analysis.pages import ADVICE
from exact_mdp.mdp.errors import ModelError, shown_text
from exact_mdp.mdp.report import Report


def show(report: Report, *, as_json: bool, as_markdown: bool) -> None:
    """Print a report, its notes on standard error; advice is part of every form."""
    if as_json and as_markdown:
        raise ModelError("two forms of one output", where="--markdown", fix="leave out --json")
    for note in report.notes:
        if note != ADVICE:
            print(f"note: {note}", file=sys.stderr)
    if as_json or as_markdown:
        notice = {"notice": ADVICE} if ADVICE in report.notes else {}
        printed = report.json(**notice) if as_json else markdown(report)
        # "##[" in a name would begin a command to a runner.
        print(printed.replace("##[", "##\\u005b") if ci.running() else printed)
    else:
        for line in text(report).splitlines():
            print(ci.inert(line.rstrip()))


def text(report: Report) -> str:
    """Return facts and tables as text."""
    from rich import box, console, table

    out = console.Console(no_color=True, highlight=False, markup=False, emoji=False)
    with out.capture() as captured:
        facts = table.Table.grid(padding=(0, 2, 0, 0))
        for name, value in report.lines().items():
            facts.add_row(_text(name), _text(value))
        out.print(facts)
        for each in report.shown_tables():
            grid = table.Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
            for heading, right in zip(each.columns, each.numeric(), strict=True):
                side: Literal["left", "right"] = "right" if right else "left"
                grid.add_column(_text(heading), overflow="fold", justify=side)
            for row in each.cells():
                grid.add_row(*map(_text, row))
            out.print(_text(f"\n{each.heading()}"))
            if each.note:
                out.print(_text(each.note))
            out.print(grid)
        if ADVICE in report.notes:
            out.print(_text(f"\n{ADVICE}"))
    return str(captured.get())


def markdown(report: Report) -> str:
    """Return facts and tables as Markdown; no name in them is read as markup."""
    facts = [[*each] for each in report.lines().items()]
    parts = [f"## {_escaped(report.title)}\n", _pipes(["", ""], [False, False], facts)]
    for each in report.shown_tables():
        note = f"{_escaped(each.note)}\n\n" if each.note else ""
        grid = _pipes(list(each.columns), each.numeric(), each.cells())
        parts.append(f"### {_escaped(each.heading())}\n\n{note}{grid}")
    parts += [f"Note: {_escaped(note)}\n" for note in report.notes]
    return "\n".join(parts)


def _pipes(headings: Sequence[str], right: Sequence[bool], rows: Sequence[Sequence[str]]) -> str:
    sides = ["---:" if side else "---" for side in right]
    lines = [[_escaped(each) for each in row] for row in (headings, *rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (lines[0], sides, *lines[1:]))


def _escaped(said: str) -> str:
    """Return a text that Markdown shows as it is, on one line."""
    return re.sub(r"([\\`*_\[\]<>|~$&#])", r"\\\1", shown_text(said))


def _text(said: str) -> Any:
    """Return a text as it is: the name of a file may hold what steers a terminal."""
    from rich import text

    return text.Text(shown_text(said, lines=True), overflow="fold")
