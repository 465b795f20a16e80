"""The report of a gate as JUnit XML, which continuous integration systems show.

One test case for each verdict; a check that came to none has a single case with an error. Some
systems show a failure's `message` and some only its text, so the text holds all of it. Values are
properties of the suite. The elements are those that the xunit2 form of pytest and Jenkins has in
common; characters that XML cannot hold become "?".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from exact_mdp.mdp.io.files import write_atomically

# What XML 1.0 does not allow, in section 2.2.
FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

KINDS = {"failure": "regret", "error": "error"}  # elements, and the types that they state


@dataclass(frozen=True, kw_only=True)
class Case:
    """One test case: what failed, or why there is no verdict, each on one line; None where neither.

    `text` is the full message.
    """

    name: str
    failure: str | None = None
    error: str | None = None
    text: str = ""


def junit(
    suite: str, cases: Sequence[Case], *, seconds: float, properties: Mapping[str, str]
) -> bytes:
    """Return a report of one suite of test cases."""
    failures = sum(case.failure is not None for case in cases)
    errors = sum(case.error is not None for case in cases)
    counts = {"tests": len(cases), "failures": failures, "errors": errors, "skipped": 0}
    shared = {name: str(count) for name, count in counts.items()} | {"time": f"{seconds:.3f}"}
    root = ElementTree.Element("testsuites", {"name": "exact-mdp"} | shared)
    at = datetime.now(UTC).isoformat(timespec="seconds")
    group = ElementTree.SubElement(root, "testsuite", {"name": _clean(suite)} | shared)
    group.set("timestamp", at)
    listed = ElementTree.SubElement(group, "properties")
    for name, value in properties.items():
        ElementTree.SubElement(listed, "property", name=_clean(name), value=_clean(value))
    for case in cases:
        time = f"{seconds / len(cases):.3f}"
        place = {"classname": _clean(suite), "name": _clean(case.name), "time": time}
        element = ElementTree.SubElement(group, "testcase", place)
        for kind, message in (("failure", case.failure), ("error", case.error)):
            if message is not None:
                named = {"message": _clean(message), "type": KINDS[kind]}
                ElementTree.SubElement(element, kind, named).text = _clean(case.text)
    ElementTree.indent(root)
    report: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return report + b"\n"


def write_junit(
    path: str | Path,
    suite: str,
    cases: Sequence[Case],
    *,
    seconds: float,
    properties: Mapping[str, str],
) -> None:
    """Write the report, the whole file or none; raises ModelError where that fails."""
    write_atomically(path, junit(suite, cases, seconds=seconds, properties=properties))


def _clean(text: str) -> str:
    return FORBIDDEN.sub("?", text)
