"""What GitHub Actions shows of a check: an annotation, a summary of the step, and no command.

A runner reads every line that a step prints: one that begins with `::` is a command to it, and so
is `##[` anywhere in a line. Names come from models and files, so such lines are changed. Outside of
GitHub Actions nothing here does anything. See "Workflow commands for GitHub Actions" in GitHub's
documentation for the form of a command and its escapes.
"""

from __future__ import annotations

import os
import re
import sys

from exact_mdp.mdp.errors import ModelError

ACTIONS, SUMMARY = "GITHUB_ACTIONS", "GITHUB_STEP_SUMMARY"


def running() -> bool:
    """Return whether this is a step of GitHub Actions."""
    return os.environ.get(ACTIONS) == "true"


def inert(line: str) -> str:
    """Return a line that no runner takes for a command; the line itself elsewhere."""
    if not running():
        return line
    line = line.replace("##[", "## [")
    return line.replace("::", ": :", 1) if line.lstrip().startswith("::") else line


def annotate(title: str, message: str) -> None:
    """Print an error annotation on standard error, which the page of a run shows at its top."""
    if running():
        print(f"::error title={_escaped(title, ',:')}::{_escaped(message)}", file=sys.stderr)


def report_error(title: str, message: str) -> None:
    """Report what kept a check from a verdict: an annotation, and a block in the summary."""
    annotate(title, message)
    fence = "`" * max(3, 1 + max(map(len, re.findall("`+", message)), default=0))
    summarise(f"## The check came to no verdict\n\n{fence}text\n{message}\n{fence}")


def summarise(markdown: str) -> None:
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


def _escaped(text: str, more: str = "") -> str:
    for character in "%\r\n" + more:
        text = text.replace(character, f"%{ord(character):02X}")
    return text
