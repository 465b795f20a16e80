"""Reports of a check for continuous integration: JUnit XML, and the pages of GitHub Actions.

There is one test case for each verdict, or for an error. Some systems show a failure's `message`
and some only its text, so the text holds the whole message. The elements are common to the
xunit2 formats of pytest and Jenkins. A GitHub runner interprets a line that begins with `::`, or
contains `##[`, as a command ("Workflow commands for GitHub Actions" in its documentation); as names
come from models and files, such lines are changed.
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

# Characters that XML 1.0 does not allow (section 2.2).
FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
TYPES = {"failure": "regret", "error": "error"}  # the `type` of each kind of element
ACTIONS, SUMMARY = "GITHUB_ACTIONS", "GITHUB_STEP_SUMMARY"


class Case(NamedTuple):
    """A test case: its name; "failure", "error" or, if it passed, ""; a line and a text."""

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
    """Write the report of one suite, the whole file or none; raise ModelError on failure."""

    def add_element(parent: ElementTree.Element, tag: str, **texts: str) -> ElementTree.Element:
        texts = {name: FORBIDDEN.sub("?", text) for name, text in texts.items()}
        return ElementTree.SubElement(parent, tag, texts)

    kinds = [case.kind for case in cases]
    counts = {"tests": len(cases), "failures": kinds.count("failure")}
    counts |= {"errors": kinds.count("error"), "skipped": 0}
    shared = {name: str(count) for name, count in counts.items()} | {"time": f"{seconds:.3f}"}
    # <testsuites> holds one <testsuite> with its properties, and a <testcase> for each case.
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
    """Write the report of a check without a verdict, if a file is named for it."""
    case = Case("check", "error", message.partition("\n")[0], message)
    if path is not None:
        # The command reports a failure to write, unless it fails for a graver reason.
        with suppress(ValueError, OSError):
            write_junit(path, suite, [case], seconds=0.0, properties={})


# ---- GitHub --------------------------------------------------------------------------------------


def is_github_actions() -> bool:
    """Return whether this is a step of GitHub Actions."""
    return os.environ.get(ACTIONS) == "true"


def defuse_line(line: str) -> str:
    """Return a line that no GitHub runner takes for a command; elsewhere, the line as it is."""
    if not is_github_actions():
        return line
    line = line.replace("##[", "## [")
    if line.lstrip().startswith("::"):
        line = line.replace("::", ": :", 1)
    return line


def print_annotation(title: str, message: str) -> None:
    """Print an error annotation on standard error, which GitHub shows at the top of a run."""
    if is_github_actions():
        head, text = _escape_annotation(title, ",:"), _escape_annotation(message)
        print(f"::error title={head}::{text}", file=sys.stderr)


def append_summary(markdown: str) -> None:
    """Append Markdown to the step's summary; raise ModelError if that cannot be written to."""
    path = os.environ.get(SUMMARY)
    if not path:
        return
    try:
        with open(path, "a", encoding="utf-8", errors="backslashreplace") as file:
            if markdown:
                file.write(f"{markdown}\n")
    except OSError as error:
        raise ModelError(
            f"cannot write the summary of the step: {error.strerror}",
            where=f"{SUMMARY}={path}",
            fix=f"name a file that can be written, or unset {SUMMARY}",
        ) from error


def _escape_annotation(text: str, more: str = "") -> str:
    """Return a text with the characters escaped that would end an annotation or its title."""
    for character in "%\r\n" + more:
        text = text.replace(character, f"%{ord(character):02X}")
    return text
