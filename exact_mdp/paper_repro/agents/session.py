"""One conversation in one folder: recording, text, HTML and run record; resumable and replayable.

conversation.jsonl   everything, written as it goes
conversation.txt     the same for reading, and
conversation.html    as a page, both written when the run stops
run.json             versions, commit and date
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import read_bytes, write_atomically
from exact_mdp.paper_repro.agents import recording, views
from exact_mdp.paper_repro.agents.conversation import Conversation, totals
from exact_mdp.paper_repro.agents.protocol import BackendError, Reply, Request, violations
from exact_mdp.paper_repro.agents.recording import Recorder, Recording

NAME = "conversation.jsonl"

Progress = Callable[[Mapping[str, Any]], None]


def hold(
    talk: Conversation,
    out: Path,
    *,
    resume: bool = False,
    limit: int | None = None,
    progress: Progress = lambda step: None,
) -> Recording:
    """Run a conversation into a folder, or continue the one that it holds.

    Parameters
    ----------
    talk : Conversation
    out : folder, made where it does not exist
    resume : go on where the recording stops
    limit : stop after this many timesteps in all; resume goes on from there
    progress : called with each step once it is on the disk, those that the folder held first

    Raises
    ------
    ModelError
        Where the folder holds a conversation and `resume` is not asked for, or holds one with
        other settings, or one that does not follow from them; BackendError where no answer came.
        What was recorded before stays.
    """
    path, header = out / NAME, talk.header()
    kept = _kept(path, header, resume)
    if kept:
        _follows(talk, kept, path)
    steps = list(kept.steps) if kept else []
    for held in steps:
        progress(held)
    if kept and kept.end:
        return kept
    recording.make(out)
    end = None
    try:
        with Recorder(path, keep=kept.whole if kept else 0) as recorder:
            if kept is None:
                recorder.add(header)
            coming = talk.steps(steps)
            while limit is None or len(steps) < limit:
                step = next(coming, None)
                if step is None:
                    end = totals(steps)
                    recorder.add(end)
                    break
                recorder.add(step)
                steps.append(step)
                progress(step)
    finally:  # write what was recorded, whatever stopped the run
        whole = Recording(header=header, steps=tuple(steps), end=end, whole=0)
        _written(whole, path)
    return whole


def render(path: Path, out: Path) -> list[Path]:
    """Write the text and the page of a recording into a folder, and return their paths."""
    return _written(recording.read(path), out / path.name)


def _written(told: Recording, path: Path) -> list[Path]:
    """Write text and page of a recording beside a path."""
    texts = {".txt": views.text(told), ".html": views.page(told)}
    for ending, text in texts.items():
        write_atomically(path.with_suffix(ending), text)
    return [path.with_suffix(ending) for ending in texts]


class Recorded:
    """A backend that answers from a recording, request by request, and from nothing else."""

    def __init__(self, told: Recording) -> None:
        self._told = told
        self._calls = iter([(s["timestep"], call) for s in told.steps for call in s["calls"]])

    def describe(self) -> dict[str, Any]:
        """Return the description of the backend that was recorded."""
        return dict(self._told.header["backend"])

    def answer(self, request: Request) -> Reply:
        """Return the recorded answer; raises BackendError where another question was recorded."""
        where = "the end of the recording"
        timestep, call = next(self._calls, (None, None))
        if call is not None:
            where = f"timestep {timestep}, {request.purpose}"
        if call is None or call["request"] != request.digest:
            raise BackendError(
                "the recording holds no answer to this request",
                where=where,
                fix="replay with the prompts, scenario and version that it was made with",
            )
        wrong = violations(call["data"], request.schema)
        if wrong:
            raise BackendError(f"a recorded answer does not fit: {wrong[0]}", where=where)
        kept = {key: value for key, value in call.items() if key not in ("purpose", "request")}
        return Reply(**kept)


def replayed(talk: Conversation, told: Recording) -> list[str]:
    """Replay a recorded conversation without a model; return what differs.

    Parameters
    ----------
    talk : the same conversation with `Recorded` as its backend
    told : the recording
    """
    differences = []
    header = talk.header()
    for key in sorted(set(header) | set(told.header)):
        if header.get(key) != told.header.get(key):
            differences.append(f"header: {key}")
    again: list[dict[str, Any]] = []
    coming = talk.steps()
    for step in told.steps:
        fresh = next(coming, None)
        if fresh is None:
            differences.append(f"timestep {step['timestep']}: the scenario was over before it")
            break
        again.append(fresh)
        differences += [
            f"timestep {step['timestep']}: {key}"
            for key in sorted(set(step) | set(fresh))
            if key not in step or key not in fresh or fresh[key] != step[key]
        ]
    if told.end and not differences and totals(again) != told.end:
        differences.append("the totals at the end")
    if told.end and not differences and not talk.world.ended(again[-1]["next_state"]):
        differences.append("the end: the scenario was not over there")
    return differences


def _follows(talk: Conversation, kept: Recording, path: Path) -> None:
    """Check that a recording to be continued follows from these settings and answers."""
    try:
        differences = replayed(replace(talk, backend=Recorded(kept)), kept)
    except BackendError as error:
        differences = [error.what]
    if differences:
        raise ModelError(
            f"the recorded conversation does not follow from its settings: {differences[0]}",
            where=str(path),
            fix="begin a new one in another --out",
        )


def _kept(path: Path, header: Mapping[str, Any], resume: bool) -> Recording | None:
    """Return what the folder already holds of this conversation."""
    if not path.exists() or path.stat().st_size == 0:
        return None
    if not resume:
        raise ModelError(
            "the folder holds a conversation", where=str(path), fix="add --resume, or another --out"
        )
    if b"\n" not in read_bytes(path):  # stopped within the header: nothing to keep
        return None
    kept = recording.read(path)
    other = [key for key in header if json.loads(json.dumps(header[key])) != kept.header.get(key)]
    if other:
        raise ModelError(
            f"the recorded conversation has another {', '.join(other)}",
            where=str(path),
            fix="resume with the settings of its first line, or name another --out",
        )
    return kept
