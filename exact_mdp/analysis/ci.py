"""What continuous integration shows of a check: JUnit XML, and the pages of GitHub Actions.

One test case stands for each verdict, or for an error. Some systems show a failure's `message` and
some only its text, so the text holds all of it. The elements are those that the xunit2 form of
pytest and Jenkins has in common. A runner of GitHub takes a line that begins with `::`, or has
`##[` anywhere, for a command ("Workflow commands for GitHub Actions" in its documentation); names
come from models and files, so such lines are changed.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically

# What XML 1.0 does not allow, in section 2.2.
FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
TYPES = {"failure": "regret", "error": "error"}  # elements, and the types that they state
ACTIONS, SUMMARY = "GITHUB_ACTIONS", "GITHUB_STEP_SUMMARY"


class Case(NamedTuple):
    """A test case: its name; "failure" or "error", or "" where it passed; a line and a text."""

    name: str
    kind: str = ""
    message: str = ""
    text: str = ""


def write_junit(
    path: str | Path,
    suite: str,
    cases: Sequence[Case],
    *,
    seconds: float,
    properties: Mapping[str, str],
) -> None:
    """Write the report of one suite, the whole file or none; ModelError where that fails."""

    def add_element(parent: ElementTree.Element, tag: str, **texts: str) -> ElementTree.Element:
        texts = {name: FORBIDDEN.sub("?", text) for name, text in texts.items()}
        return ElementTree.SubElement(parent, tag, texts)

    kinds = [case.kind for case in cases]
    counts = {"tests": len(cases), "failures": kinds.count("failure")}
    counts |= {"errors": kinds.count("error"), "skipped": 0}
    shared = {name: str(count) for name, count in counts.items()} | {"time": f"{seconds:.3f}"}
    root = ElementTree.Element("testsuites", {"name": "exact-mdp"} | shared)
    at = datetime.now(UTC).isoformat(timespec="seconds")
    group = add_element(root, "testsuite", name=suite, **shared, timestamp=at)
    listed = add_element(group, "properties")
    for name, value in properties.items():
        add_element(listed, "property", name=name, value=value)
    for case in cases:
        time = f"{seconds / len(cases):.3f}"
        element = add_element(group, "testcase", classname=suite, name=case.name, time=time)
        if case.kind:
            below = add_element(element, case.kind, message=case.message, type=TYPES[case.kind])
            below.text = FORBIDDEN.sub("?", case.text)
    ElementTree.indent(root)
    report: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(path, report + b"\n")


def write_error(path: str | None, suite: str, message: str) -> None:
    """Write the report of a check that came to no verdict, where there is a file for it."""
    case = Case("check", "error", message.partition("\n")[0], message)
    if path is not None:
        with suppress(ValueError, OSError):  # reported by the command, or about something worse
            write_junit(path, suite, [case], seconds=0.0, properties={})


# ---- GitHub --------------------------------------------------------------------------------------


def is_github_actions() -> bool:
    """Return whether this is a step of GitHub Actions."""
    return os.environ.get(ACTIONS) == "true"


def defuse_line(line: str) -> str:
    """Return a line that no runner takes for a command; the line itself elsewhere."""
    if not is_github_actions():
        return line
    line = line.replace("##[", "## [")
    return line.replace("::", ": :", 1) if line.lstrip().startswith("::") else line


def print_annotation(title: str, message: str) -> None:
    """Print an error annotation on standard error, which the page of a run shows at its top."""
    if is_github_actions():
        print(
            f"::error title={_escape_annotation(title, ',:')}::{_escape_annotation(message)}",
            file=sys.stderr,
        )


def append_summary(markdown: str) -> None:
    """Append Markdown to the step's summary; ModelError where that cannot be written to."""
    if not (path := os.environ.get(SUMMARY)):
        return
    try:
        with open(path, "a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{markdown}\n" * bool(markdown))
    except OSError as error:
        raise ModelError(
            f"cannot write the summary of the step: {error.strerror}",
            where=f"{SUMMARY}={path}",
            fix=f"name a file that can be written, or unset {SUMMARY}",
        ) from error


def _escape_annotation(text: str, more: str = "") -> str:
    for character in "%\r\n" + more:
        text = text.replace(character, f"%{ord(character):02X}")
    return text
