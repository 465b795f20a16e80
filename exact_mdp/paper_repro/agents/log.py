"""A conversation on file: JSON lines, and the same as text (Yuan et al. 2025, Section 4.2).

The first line is the header: everything that determines the conversation. Then one line for each
timestep, on the disk before the next begins, and a last one with the totals. A line counts once its
newline is written. In the text, words that come from a backend stand on one line, without control
characters, so that none of them can look like a line of the record.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from exact_mdp import ModelError

FORMAT = 2  # of recordings
OUTCOMES = {
    "completed": "step completed",
    "failed": "step not completed, another trial",
    "skipped": "step skipped after the last trial",
}


@dataclass(kw_only=True)
class Recording:
    """The contents of a file: the header, the steps and, if it is finished, the totals."""

    path: Path
    header: dict[str, Any] = field(default_factory=dict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    end: dict[str, Any] | None = None

    def add_entry(self, entry: dict[str, Any]) -> None:
        """Write an entry; raise ModelError if that fails."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8", newline="\n") as file:
                file.write(json.dumps(entry, ensure_ascii=False) + "\n")
        except OSError as error:
            raise ModelError(
                f"cannot write the recording: {error.strerror}",
                where=str(self.path),
                fix="make room, or name another --out",
            ) from error
        if entry["kind"] == "step":
            self.steps.append(entry)
        elif entry["kind"] == "end":
            self.end = entry
        else:
            self.header = entry


def open_recording(path: Path, header: dict[str, Any], *, resume: bool) -> Recording:
    """Return the recording of a file, or a new one if there is none.

    Raises ModelError if there is one and `resume` is not asked for, or if it has another header.
    """
    record = read_recording(path)
    if record is None:
        record = Recording(path=path)
        record.add_entry(header)
    elif not resume:
        raise ModelError(
            "the folder holds a recording",
            where=str(path),
            fix="name another --out, or add --resume",
        )
    elif record.header != header:
        raise ModelError(
            "the folder holds a recording with other settings",
            where=str(path),
            fix="name another --out",
        )
    return record


def read_recording(path: Path) -> Recording | None:
    """Return a recording, without an incomplete last line; None if there is none.

    Raises
    ------
    ModelError
        For a file that is not a recording, or is damaged before its last line.
    """
    if not path.exists():
        return None
    if not path.is_file():
        raise ModelError("not a regular file", where=str(path), fix="name another --out")
    try:
        *lines, torn = path.read_text("utf-8").split("\n")
        entries = [json.loads(line) for line in lines]
        kinds = [entry["kind"] for entry in entries]
        steps = kinds.count("step")
        whole = ["header", *["step"] * steps, *["end"] * kinds.count("end")]
        numbers = [entry.get("timestep") for entry in entries[1 : steps + 1]]
        if kinds and (kinds != whole or numbers != list(range(steps)) or kinds.count("end") > 1):
            raise ValueError("its lines are not a header and the timesteps in their order")
        if entries and repr(entries[0]["format"]) != repr(FORMAT):  # neither 2.0 nor true
            raise ValueError(f"it is of format {entries[0]['format']}, not {FORMAT}")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelError(
            f"the recording is damaged: {error}", where=str(path), fix="name another --out"
        ) from error
    if torn:
        path.write_text("".join(line + "\n" for line in lines), "utf-8", newline="\n")
    if not entries:
        return None
    if kinds[-1] == "end":
        end = entries.pop()
    else:
        end = None
    return Recording(path=path, header=entries[0], steps=entries[1:], end=end)


def compute_totals(steps: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the last entry of a finished recording."""
    events = [step["event"] for step in steps]
    return {
        "kind": "end",
        "timesteps": len(steps),
        "return": steps[-1]["return"],
        "completed": events.count("completed"),
        "skipped": events.count("skipped"),
        "misperceived": sum(step["status"] != step["perceived"] for step in steps),
    }


# ---- as text -------------------------------------------------------------------------------------


def clean_text(text: object) -> str:
    """Return text on one line, without control characters.

    >>> clean_text("one\\nTimestep 7\\x1b[31m")
    'one Timestep 7 [31m'
    """
    return " ".join("".join(c if c.isprintable() else " " for c in str(text)).split())


def format_amount(text: str) -> str:
    """Return an exact number for reading: as a whole number if it is one, else with two decimals.

    >>> format_amount("-8"), format_amount("1/3")
    ('-8', '0.33')
    """
    value = Fraction(text)
    if value.denominator == 1:
        return str(value)
    return f"{float(value):.2f}"


def format_recording(record: Recording) -> str:
    """Return the text of a recording, finished or not."""
    header = record.header
    backend = ", ".join(f"{key} {value}" for key, value in header["backend"].items())
    top = f"""{header["disclaimer"]}
Scenario: {clean_text(header["scenario"])}{"".join(f", {clean_text(s)}" for s in header["set"])}; \
policy: {clean_text(header["policy"])}; seed {header["seed"]}
Language: {clean_text(backend)}; action execution: {header["variant"]}
Setting: {clean_text(header["setting"])}

"""
    blocks, last = [format_step(header, step) for step in record.steps], ""
    if end := record.end:
        last = (
            f"End after {end['timesteps']} timesteps: {end['completed']} steps completed, "
            f"{end['skipped']} skipped, return {format_amount(end['return'])}; "
            f"the status was misperceived in {end['misperceived']} timesteps.\n"
        )
    return "".join([top, *blocks, last])


def format_step(header: Mapping[str, Any], step: Mapping[str, Any]) -> str:
    """Return the lines of one timestep."""
    place, behaviour = header["steps"][step["subtask"]], step["behaviour"]
    return f"""Timestep {step["timestep"]}
  Task: {clean_text(place["goal"])}
  Subtask {step["subtask"] + 1} of {len(header["steps"])}: {clean_text(place["step"])}
  Trial: {min(step["trial"] + 1, header["trials"])} of {header["trials"]}
  PLWD status: {step["status"]} ({format_status(header["statuses"], step["status"])})
  PLWD nonverbal: {clean_text(behaviour["nonverbal"])}
  PLWD verbal: {clean_text(behaviour["verbal"]) or "(says nothing)"}
  Perceived status: {step["perceived"]} ({format_status(header["statuses"], step["perceived"])})
  Action: a{header["actions"].index(step["action"])} {step["action"]}
  Robot Caregiver: {clean_text(step["assistance"]) or "(says nothing)"}
  Outcome: {OUTCOMES[step["event"]]}; reward {format_amount(step["reward"])}, \
return so far {format_amount(step["return"])}

"""


def format_status(names: Sequence[str], bits: str) -> str:
    """Return a status vector with its names.

    >>> format_status(["anger", "disengagement"], "10")
    'Anger=1, Disengagement=0'
    """
    return ", ".join(f"{clean_text(n.capitalize())}={b}" for n, b in zip(names, bits, strict=True))


def format_dialogue(header: Mapping[str, Any], step: Mapping[str, Any]) -> str:
    """Return one timestep as a dialogue: behaviour, speech and the next status."""
    behaviour, place = step["behaviour"], header["steps"][step["subtask"]]
    action = header["actions"].index(step["action"])
    return f"""{step["timestep"]}. {clean_text(place["step"])} \
(trial {min(step["trial"] + 1, header["trials"])} of {header["trials"]})
   [{clean_text(behaviour["nonverbal"])}]
   PLWD:  {clean_text(behaviour["verbal"]) or "(says nothing)"}
   Robot: {clean_text(step["assistance"]) or "(says nothing)"} (a{action} {step["action"]})
   {OUTCOMES[step["event"]]}"""
