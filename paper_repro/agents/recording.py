"""What the entries of a recording have to look like, so that a damaged one is told as such.

A conversation on file: one JSON object a line, written as it goes, so a crash loses one step.

The first line is the header: everything that the conversation follows from. Then one line for
each timestep, and a last one with the totals. A line counts once its newline is written.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import read_bytes

MOST_COUNTED = 10**18  # of anything that a recording counts: steps, tokens
EVENTS = ("completed", "failed", "skipped")
CALL = ("purpose", "request", "data", "attempts", "prompt_tokens", "completion_tokens", "seconds")

Test = Callable[[Any], bool]


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MOST_COUNTED


def _seed(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(part, str) for part in value)


def _table(value: Any) -> bool:
    return isinstance(value, dict)


def _fraction(value: Any) -> bool:
    if not isinstance(value, str) or len(value) > 4000 or not value.isascii():
        return False
    if not value.lstrip("-").replace("/", "", 1).isdecimal():
        return False
    try:
        Fraction(value)
    except (ValueError, ZeroDivisionError):
        return False
    return True


def _steps(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(part, dict) and _text(part.get("goal")) and _text(part.get("step"))
        for part in value
    )


def _behaviour(value: Any) -> bool:
    return _table(value) and _text(value.get("nonverbal")) and _text(value.get("verbal"))


def _calls(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(call, dict)
        and set(call) == set(CALL)
        and _table(call["data"])
        and all(_whole(call[name]) for name in CALL[3:6])
        for call in value
    )


HEADER: dict[str, Test] = {
    **dict.fromkeys(("disclaimer", "scenario", "policy", "setting", "activity", "variant"), _text),
    **dict.fromkeys(("activity_named", "prompts_named"), _text),
    "seed": _seed,
    **dict.fromkeys(("trials", "history"), _whole),
    **dict.fromkeys(("set", "statuses", "actions"), _texts),
    "backend": _table,
    "steps": _steps,
}

STEP: dict[str, Test] = {
    **dict.fromkeys(("timestep", "state", "subtask", "trial", "next_state"), _whole),
    **dict.fromkeys(("status", "perceived", "action", "assistance"), _text),
    **dict.fromkeys(("reward", "return"), _fraction),
    "behaviour": _behaviour,
    "event": EVENTS.__contains__,
    "calls": _calls,
}

END: dict[str, Test] = {
    **dict.fromkeys(("timesteps", "completed", "skipped", "misperceived"), _whole),
    **dict.fromkeys(("requests", "attempts", "prompt_tokens", "completion_tokens"), _whole),
    "return": _fraction,
}


def fault(entry: Mapping[str, Any], shape: Mapping[str, Test]) -> str | None:
    """Return the name of a part that is missing or of another kind; None where there is none.

    Examples
    --------
    >>> fault({"seed": -1}, {"seed": _whole})
    'seed'
    """
    for name, test in shape.items():
        value = entry.get(name)
        try:
            good = name in entry and test(value)
        except TypeError:  # an unhashable value where a word is wanted
            good = False
        if not good:
            return name
    return None


def step_fault(step: Mapping[str, Any], header: Mapping[str, Any]) -> str | None:
    """Return the name of a part of a timestep that does not fit itself or the header."""
    found = fault(step, STEP)
    if found:
        return found
    for name in ("status", "perceived"):
        if len(step[name]) != len(header["statuses"]) or not set(step[name]) <= {"0", "1"}:
            return name
    if step["subtask"] >= len(header["steps"]):
        return "subtask"
    return None if step["action"] in header["actions"] else "action"


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
