"""A conversation on file: one JSON object a line, written as it goes, so a crash loses one step.

The first line is the header: everything that the conversation follows from. Then one line for
each timestep, and a last one with the totals. A line counts once its newline is written.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mdp.errors import ModelError
from mdp.files import read_bytes
from paper_repro.agents.record_shape import END, HEADER, fault, step_fault

FORMAT = 1


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a file holds: the header, the whole steps, the totals where it is finished."""

    header: dict[str, Any]
    steps: tuple[dict[str, Any], ...]
    end: dict[str, Any] | None
    whole: int  # bytes up to the last newline


def line(entry: Mapping[str, Any]) -> str:
    """Return one entry as a line.

    Examples
    --------
    >>> line({"kind": "end"})
    '{"kind": "end"}\\n'
    """
    return json.dumps(entry, ensure_ascii=False) + "\n"


class Recorder:
    """Appends entries to a file, each on the disk before the next begins."""

    def __init__(self, path: Path, *, keep: int) -> None:
        """Open a file and cut it to its first `keep` bytes."""
        self._path = path
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            os.ftruncate(self._file, keep)
        except OSError as error:
            raise ModelError(
                f"cannot write the recording: {error.strerror}",
                where=str(path),
                fix="check the folder",
            ) from error

    def add(self, entry: Mapping[str, Any]) -> None:
        """Write one entry and wait until it is on the disk."""
        data = line(entry).encode("utf-8")
        try:
            while data:
                data = data[os.write(self._file, data) :]
            os.fsync(self._file)
        except OSError as error:
            raise ModelError(
                f"cannot write the recording: {error.strerror}",
                where=str(self._path),
                fix="make room, then resume",
            ) from error

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)


def read(path: str | Path) -> Recording:
    """Read a recording; a last line without its newline is left out.

    Raises
    ------
    ModelError
        For a file that is no recording, or is damaged before its last line.
    """
    data = read_bytes(path)
    entries: list[dict[str, Any]] = []
    whole = data[: data.rfind(b"\n") + 1]
    for number, written in enumerate(whole.split(b"\n")[:-1], start=1):
        try:
            entry = json.loads(written.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise _damaged(path, number, "is not JSON") from error
        if not isinstance(entry, dict):
            raise _damaged(path, number, "is not an object")
        entries.append(entry)
    if not entries or entries[0].get("kind") != "header" or entries[0].get("format") != FORMAT:
        raise _damaged(path, 1, f"is no header of format {FORMAT}")
    header = entries[0]
    wrong = fault(header, HEADER)
    if wrong:
        raise _damaged(path, 1, f"has no good {wrong!r}")
    end = entries.pop() if entries[-1].get("kind") == "end" else None
    for number, entry in enumerate(entries[1:], start=2):
        if entry.get("kind") != "step":
            raise _damaged(path, number, "is no timestep")
        wrong = step_fault(entry, header)
        if wrong:
            raise _damaged(path, number, f"has no good {wrong!r}")
        if entry["timestep"] != number - 2:
            raise _damaged(path, number, f"is timestep {entry['timestep']}, not {number - 2}")
    if end:
        wrong = fault(end, END)
        if wrong:
            raise _damaged(path, len(entries) + 1, f"has no good {wrong!r}")
    return Recording(header=header, steps=tuple(entries[1:]), end=end, whole=len(whole))


def _damaged(path: str | Path, number: int, what: str) -> ModelError:
    return ModelError(
        f"line {number} {what}",
        where=str(path),
        fix="name the conversation.jsonl of a run; begin a new run where it is damaged",
    )
