"""The report of a gate as JUnit XML, which continuous integration systems show.

One test case for each verdict; a check that came to none has a single case with an error. Some
systems show a failure's `message` and some only its text, so the text holds all of it. Values are
properties of the suite. The elements are those that the xunit2 form of pytest and Jenkins has in
common; characters that XML cannot hold become "?".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from exact_mdp.mdp.io.files import write_atomically

# What XML 1.0 does not allow, in section 2.2.
FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
TYPES = {"failure": "regret", "error": "error"}  # elements, and the types that they state


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

    def add(parent: ElementTree.Element, tag: str, **texts: str) -> ElementTree.Element:
        texts = {name: FORBIDDEN.sub("?", text) for name, text in texts.items()}
        return ElementTree.SubElement(parent, tag, texts)

    kinds = [case.kind for case in cases]
    counts = {"tests": len(cases), "failures": kinds.count("failure")}
    counts |= {"errors": kinds.count("error"), "skipped": 0}
    shared = {name: str(count) for name, count in counts.items()} | {"time": f"{seconds:.3f}"}
    root = ElementTree.Element("testsuites", {"name": "exact-mdp"} | shared)
    at = datetime.now(UTC).isoformat(timespec="seconds")
    group = add(root, "testsuite", name=suite, **shared, timestamp=at)
    listed = add(group, "properties")
    for name, value in properties.items():
        add(listed, "property", name=name, value=value)
    for case in cases:
        time = f"{seconds / len(cases):.3f}"
        element = add(group, "testcase", classname=suite, name=case.name, time=time)
        if case.kind:
            below = add(element, case.kind, message=case.message, type=TYPES[case.kind])
            below.text = FORBIDDEN.sub("?", case.text)
    ElementTree.indent(root)
    report: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(path, report + b"\n")
