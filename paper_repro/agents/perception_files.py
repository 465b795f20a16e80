"""Reading labelled timesteps out of recordings, and writing what was measured.

labelled.jsonl    a header, then every behaviour with its label, written as it goes
confusion.csv     the matrix: rows are true statuses, columns perceived ones
perception.json   counts, rates with intervals, and values
run.json          versions, commit and date
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from analysis.record import run_record
from mdp import MDP
from mdp.errors import ModelError
from mdp.files import read_bytes, write_atomically
from paper_repro.agents import DISCLAIMER, recording
from paper_repro.agents.measure import Floats, Labelled, to_csv
from paper_repro.agents.schema import behaviour_schema, violations


def counted(paths: Sequence[Path], statuses: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Yield (true, perceived) status numbers of every timestep of some recordings."""
    seen: dict[str, Path] = {}
    for path in paths:
        told = recording.read(path)
        content = json.dumps([told.header, *told.steps[:1]], sort_keys=True)
        if content in seen:
            raise ModelError(
                "one conversation is named twice, which would count it twice",
                where=f"{seen[content]} and {path}",
                fix="name each conversation once",
            )
        seen[content] = path
        if told.header["statuses"] != list(statuses):
            raise ModelError(
                f"a recording with the statuses {', '.join(told.header['statuses'])}",
                where=str(path),
                fix="choose the --scenario that it was made with",
            )
        for step in told.steps:
            yield int(step["status"], 2), int(step["perceived"], 2)


class Notebook:
    """The file labelled.jsonl: what it holds already, and adding to it."""

    def __init__(self, out: Path, header: Mapping[str, Any], *, resume: bool) -> None:
        """Open the file of a folder.

        Raises
        ------
        ModelError
            Where it holds something and `resume` is not asked for, or other settings.
        """
        make(out)
        path, self.header = out / "labelled.jsonl", {"kind": "header", **header}
        data = read_bytes(path) if path.exists() else b""
        if data and not resume:
            raise ModelError(
                "the folder holds a measurement",
                where=str(path),
                fix="add --resume, or another --out",
            )
        whole = data[: data.rfind(b"\n") + 1]
        try:
            entries = [json.loads(text) for text in whole.splitlines()]
            self.past = [Labelled(**entry) for entry in entries[1:]]
            self._check()
        except (ValueError, TypeError, RecursionError) as error:
            raise ModelError(
                f"a damaged measurement: {error}", where=str(path), fix="name another --out"
            ) from error
        if entries and entries[0] != self.header:
            raise ModelError(
                "the measurement begun here has other settings",
                where=str(path),
                fix="resume with the settings of its first line, or name another --out",
            )
        self._recorder = recording.Recorder(path, keep=len(whole))
        if not entries:
            self._recorder.add(self.header)

    def _check(self) -> None:
        """Hold that the entries are those of this measurement, in their order."""
        size = 2 ** len(self.header["statuses"])
        for number, entry in enumerate(self.past):
            seen, texts = entry.perceived, entry.behaviour
            if entry.status != number % size or type(entry.status) is not int:
                raise ValueError(f"line {number + 2} is of another status vector")
            if type(seen) is not int or not 0 <= seen < size:
                raise ValueError(f"line {number + 2} has no perceived status vector")
            if violations(texts, behaviour_schema()):
                raise ValueError(f"line {number + 2} has no behaviour")

    def add(self, entry: Labelled) -> None:
        """Write one entry and wait until it is on the disk."""
        self._recorder.add(asdict(entry))

    def __enter__(self) -> Notebook:
        return self

    def __exit__(self, *error: object) -> None:
        self._recorder.__exit__(*error)


def make(out: Path) -> None:
    """Make a folder; raises ModelError where that fails."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(
            f"cannot make the folder: {error.strerror}", where=str(out), fix="name another --out"
        ) from error


def write(out: Path, confusion: Floats, result: Mapping[str, Any], mdp: MDP, scenario: str) -> None:
    """Write confusion.csv, perception.json and run.json."""
    make(out)
    write_atomically(out / "confusion.csv", to_csv(confusion))
    text = json.dumps({"disclaimer": DISCLAIMER, **result}, indent=1, ensure_ascii=False)
    write_atomically(out / "perception.json", text + "\n")
    record = run_record(mdp, model=scenario, solver="auto", seed=result["seed"])
    write_atomically(out / "run.json", json.dumps(record, indent=1) + "\n")
