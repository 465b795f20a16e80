"""Printing of reports: as text, as Markdown, or as JSON.

Text has no colours and no cut-off cells: wide cells wrap.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Any, Literal

from exact_mdp.analysis import ci
from exact_mdp.analysis.pages import ADVICE
from exact_mdp.mdp.errors import shown_text
from exact_mdp.mdp.report import Report


def print_report(report: Report, *, as_json: bool, as_markdown: bool) -> None:
    """Print a report, its notes on standard error; advice is part of every form."""
    for note in report.notes:
        if note != ADVICE:
            print(f"note: {note}", file=sys.stderr)
    if as_json or as_markdown:
        if as_markdown:
            printed = format_report_markdown(report)
        elif ADVICE in report.notes:
            printed = report.json(notice=ADVICE)
        else:
            printed = report.json()
        # "##[" in a name would begin a command to GitHub's runner.
        if ci.is_github_actions():
            printed = printed.replace("##[", "##\\u005b")
        print(printed)
    else:
        for line in format_report_text(report).splitlines():
            print(ci.defuse_line(line.rstrip()))


def format_report_text(report: Report) -> str:
    """Return facts and tables as text."""
    from rich import box, console, table

    out = console.Console(no_color=True, highlight=False, markup=False, emoji=False)
    with out.capture() as captured:
        facts = table.Table.grid(padding=(0, 2, 0, 0))
        for name, value in report.lines().items():
            facts.add_row(_to_console_text(name), _to_console_text(value))
        out.print(facts)
        for each in report.shown_tables():
            grid = table.Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
            for heading, right in zip(each.columns, each.numeric(), strict=True):
                side: Literal["left", "right"] = "left"
                if right:
                    side = "right"
                grid.add_column(_to_console_text(heading), overflow="fold", justify=side)
            for row in each.cells():
                grid.add_row(*map(_to_console_text, row))
            out.print(_to_console_text(f"\n{each.format_heading()}"))
            if each.note:
                out.print(_to_console_text(each.note))
            out.print(grid)
        if ADVICE in report.notes:
            out.print(_to_console_text(f"\n{ADVICE}"))
    return str(captured.get())


def format_report_markdown(report: Report) -> str:
    """Return facts and tables as Markdown, with all names escaped."""
    facts = [[*each] for each in report.lines().items()]
    parts = [
        f"## {_escape_markdown(report.title)}\n",
        _format_pipe_table(["", ""], [False, False], facts),
    ]
    for each in report.shown_tables():
        note = ""
        if each.note:
            note = f"{_escape_markdown(each.note)}\n\n"
        grid = _format_pipe_table(list(each.columns), each.numeric(), each.cells())
        parts.append(f"### {_escape_markdown(each.format_heading())}\n\n{note}{grid}")
    parts += [f"Note: {_escape_markdown(note)}\n" for note in report.notes]
    return "\n".join(parts)


def _format_pipe_table(
    headings: Sequence[str], right: Sequence[bool], rows: Sequence[Sequence[str]]
) -> str:
    sides = ["---:" if side else "---" for side in right]
    lines = []
    for row in (headings, *rows):
        lines.append([_escape_markdown(each) for each in row])
    return "".join(f"| {' | '.join(line)} |\n" for line in (lines[0], sides, *lines[1:]))


def _escape_markdown(said: str) -> str:
    """Return a text on one line, with Markdown's special characters escaped."""
    return re.sub(r"([\\`*_\[\]<>|~$&#])", r"\\\1", shown_text(said))


def _to_console_text(said: str) -> Any:
    """Return a text without control sequences, which the name of a file may contain."""
    from rich import text

    return text.Text(shown_text(said, lines=True), overflow="fold")
