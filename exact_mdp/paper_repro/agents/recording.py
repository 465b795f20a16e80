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

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import read_bytes
from exact_mdp.paper_repro.agents.protocol import (
    OBJECT,
    TEXT,
    Schema,
    listed,
    record,
    violations,
    whole,
)

FORMAT = 1
COUNT = whole(0, 10**18 - 1)  # of anything that a recording counts: steps, tokens
COUNTS = dict.fromkeys(("attempts", "prompt_tokens", "completion_tokens"), COUNT)
FRACTION = {"type": "string", "maxLength": 4000, "pattern": "-?[0-9]+(/[0-9]*[1-9][0-9]*)?"}
CALL = record({"purpose": TEXT, "request": TEXT, "data": OBJECT, **COUNTS, "seconds": {}})

HEADER = record(
    {
        "kind": {"type": "string", "enum": ["header"]},
        "format": {"type": "integer", "enum": [FORMAT]},
        **dict.fromkeys(("disclaimer", "scenario", "policy", "setting", "activity"), TEXT),
        **dict.fromkeys(("variant", "activity_named", "prompts_named"), TEXT),
        "seed": whole(),
        **dict.fromkeys(("trials", "history"), COUNT),
        **dict.fromkeys(("set", "statuses", "actions"), listed(TEXT)),
        "backend": OBJECT,
        "steps": listed(record({"goal": TEXT, "step": TEXT}, others=True)),
    },
    others=True,
)
END = record(
    {
        **dict.fromkeys(("timesteps", "completed", "skipped", "misperceived", "requests"), COUNT),
        **COUNTS,
        "return": FRACTION,
    },
    others=True,
)


def step_schema(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a timestep of the conversation that a header describes."""
    vector = {"type": "string", "pattern": f"[01]{{{len(header['statuses'])}}}"}
    return record(
        {
            "kind": {"type": "string", "enum": ["step"]},
            **dict.fromkeys(("timestep", "state", "trial", "next_state"), COUNT),
            "subtask": whole(0, len(header["steps"]) - 1),
            **dict.fromkeys(("status", "perceived"), vector),
            "action": {"type": "string", "enum": header["actions"]},
            "assistance": TEXT,
            **dict.fromkeys(("reward", "return"), FRACTION),
            "behaviour": record({"nonverbal": TEXT, "verbal": TEXT}, others=True),
            "event": {"type": "string", "enum": ["completed", "failed", "skipped"]},
            "calls": listed(CALL),
        },
        others=True,
    )


def make(out: Path) -> None:
    """Make a folder; raises ModelError where that fails."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(
            f"cannot make the folder: {error.strerror}", where=str(out), fix="name another --out"
        ) from error


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
            raise self._unwritten(error, "check the folder") from error

    def _unwritten(self, error: OSError, fix: str) -> ModelError:
        return ModelError(
            f"cannot write the recording: {error.strerror}", where=str(self._path), fix=fix
        )

    def add(self, entry: Mapping[str, Any]) -> None:
        """Write one entry and wait until it is on the disk."""
        data = line(entry).encode("utf-8")
        try:
            while data:
                data = data[os.write(self._file, data) :]
            os.fsync(self._file)
        except OSError as error:
            raise self._unwritten(error, "make room, then resume") from error

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)


def read(path: str | Path) -> Recording:
    """Read a recording; a last line without its newline is left out.

    Raises
    ------
    ModelError
        For a file that is not a recording, or is damaged before its last line.
    """
    data = read_bytes(path)
    whole = data[: data.rfind(b"\n") + 1]
    entries = []
    for number, written in enumerate(whole.split(b"\n")[:-1], start=1):
        try:
            entries.append(json.loads(written.decode("utf-8")))
        except (ValueError, RecursionError) as error:
            raise _damaged(path, number, "is not JSON") from error
    if not entries:
        raise _damaged(path, 1, f"is not a header of format {FORMAT}")
    header, last = entries[0], len(entries)
    _hold(path, 1, header, HEADER)
    ended = last > 1 and isinstance(entries[-1], dict) and entries[-1].get("kind") == "end"
    end = entries.pop() if ended else None
    schema = step_schema(header)
    for number, entry in enumerate(entries[1:], start=2):
        _hold(path, number, entry, schema)
        if entry["timestep"] != number - 2:
            raise _damaged(path, number, f"is timestep {entry['timestep']}, not {number - 2}")
    if end is not None:
        _hold(path, last, end, END)
    return Recording(header=header, steps=tuple(entries[1:]), end=end, whole=len(whole))


def _hold(path: str | Path, number: int, entry: object, schema: Schema) -> None:
    wrong = violations(entry, schema, "it")
    if wrong:
        raise _damaged(path, number, f"does not fit: {wrong[0]}")


def _damaged(path: str | Path, number: int, what: str) -> ModelError:
    return ModelError(
        f"line {number} {what}",
        where=str(path),
        fix="name the conversation.jsonl of a run; begin a new run where it is damaged",
    )
