"""Measured perception: a backend's confusion matrix, its uncertainty, and what it would cost.

For every status vector s a backend is given n behaviours and reads p out of each; the matrix is
C(s, p) = count(s, p) / n(s). A row's uncertainty is Dirichlet(count + 1/2^n), the prior of Perks
(1947), which weighs as much as one behaviour; that of one status's sensitivity or specificity is
the interval of Clopper and Pearson (1934). What it costs is exact for a given matrix: the robot in
state (place, s) follows

    π_C(a | place, s) = Σ_p C(s, p) π(a | place, p),

whose value is a linear solve. The spread of that value over matrices drawn from the posterior is
an estimate. A folder holds

labelled.jsonl    a header, then every behaviour with its label, written as it goes
confusion.csv     the matrix: rows are true statuses, columns perceived ones
perception.json   counts, rates with intervals, and values
run.json          versions, commit and date
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.perception.cost import value_under_counts
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.care.perception import LEVEL, Counted, perceived
from exact_mdp.mdp.care.perception import counted as counted_perception
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import read_bytes, write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.paper_repro.agents import DISCLAIMER, recording
from exact_mdp.paper_repro.agents.conversation import seed_of
from exact_mdp.paper_repro.agents.prompts import VARIANTS, Modules, Place
from exact_mdp.paper_repro.agents.protocol import (
    Backend,
    behaviour_schema,
    record,
    violations,
    whole,
)
from exact_mdp.solvers.values.evaluate import evaluate


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
        recording.make(out)
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
        """Check that the entries are those of this measurement, in their order."""
        size = 2 ** len(self.header["statuses"])
        for number, entry in enumerate(self.past):
            due = number % size
            form = {"status": whole(due, due), "perceived": whole(0, size - 1)}
            wrong = violations(
                asdict(entry), record(form | {"behaviour": behaviour_schema()}), "it"
            )
            if wrong:
                raise ValueError(f"line {number + 2} does not fit: {wrong[0]}")

    def add(self, entry: Labelled) -> None:
        """Write one entry and wait until it is on the disk."""
        self._recorder.add(asdict(entry))

    def __enter__(self) -> Notebook:
        return self

    def __exit__(self, *error: object) -> None:
        self._recorder.__exit__(*error)


def write(out: Path, confusion: Floats, result: Mapping[str, Any], mdp: MDP, scenario: str) -> None:
    """Write confusion.csv, perception.json and run.json."""
    recording.make(out)
    write_atomically(out / "confusion.csv", to_csv(confusion))
    text = json.dumps({"disclaimer": DISCLAIMER, **result}, indent=1, ensure_ascii=False)
    write_atomically(out / "perception.json", text + "\n")
    record = run_record(mdp, model=scenario, solver="auto", seed=result["seed"])
    write_atomically(out / "run.json", json.dumps(record, indent=1) + "\n")


Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Labelled:
    """A behaviour with the status that it was made for, and the status read out of it."""

    status: int
    perceived: int
    behaviour: dict[str, str]


def bits(number: int, statuses: Sequence[str]) -> dict[str, int]:
    """Return the statuses of a vector's number.

    Examples
    --------
    >>> bits(2, ["anger", "disengagement"])
    {'anger': 1, 'disengagement': 0}
    """
    text = format(number, f"0{len(statuses)}b")
    return {name: int(bit) for name, bit in zip(statuses, text, strict=True)}


def vector(seen: dict[str, int]) -> int:
    """Return the number of a status vector; the first status is the most significant digit."""
    return int("".join(str(int(bit)) for bit in seen.values()), 2)


def labelled(
    modules: Modules,
    behave: Backend,
    perceive: Backend,
    *,
    each: int,
    seed: int,
    past: Sequence[Labelled] = (),
    progress: Callable[[Labelled], None] = lambda found: None,
) -> list[Labelled]:
    """Return `each` behaviours for every status vector, and what is perceived in them.

    Parameters
    ----------
    behave, perceive : the backends that make and that read a behaviour
    past : what was labelled before, to go on from
    progress : called with each entry as soon as there is one
    """
    found = list(past)
    steps, statuses = modules.activity.steps, modules.statuses
    for number in range(len(found), each * 2 ** len(statuses)):
        truth = number % 2 ** len(statuses)
        place = Place(step=steps[number // 2 ** len(statuses) % len(steps)], attempt=1, attempts=5)
        status = bits(truth, statuses)
        asked = modules.behaviour(place, (), "", status, seed_of(seed, number, "behaviour"))
        behaviour = dict(behave.answer(asked).data)
        seen = perceive.answer(modules.perception(behaviour, seed_of(seed, number, "perception")))
        ordered = {name: int(seen.data[name]) for name in statuses}
        entry = Labelled(status=truth, perceived=vector(ordered), behaviour=behaviour)
        found.append(entry)
        progress(entry)
    return found


def count(pairs: Iterable[tuple[int, int]], statuses: int) -> Counts:
    """Return (2^n, 2^n) how often each true vector was perceived as each other."""
    return counted_perception(pairs, size=2**statuses).counts


def matrix(counts: Counts, prior: float = 0.0) -> Floats:
    """Return the (2^n, 2^n) confusion matrix: frequencies, or posterior means with a prior.

    Raises
    ------
    ModelError
        Where a status was never seen and there is no prior.
    """
    return Counted(counts=counts, prior=prior).mean


def to_csv(confusion: Floats) -> str:
    """Return the matrix as CSV: rows are true statuses, columns perceived ones."""
    width = len(confusion).bit_length() - 1
    names = [format(number, f"0{width}b") for number in range(len(confusion))]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["status", *names])
    for name, row in zip(names, confusion.tolist(), strict=True):
        writer.writerow([name, *row])
    return stream.getvalue()


def rates(counts: Counts, statuses: Sequence[str]) -> dict[str, Any]:
    """Return sensitivity and specificity of each status: right, of, rate and interval."""
    found = Counted(counts=counts).rates(statuses, LEVEL)
    return {
        name: {
            what: {"right": r.right, "of": r.total, "rate": r.value, "low": r.low, "high": r.high}
            for what, r in both.items()
        }
        for name, both in found.items()
    }


def cost(
    mdp: MDP, policy: Policy, counts: Counts, *, prior: float, draws: int, seed: int
) -> dict[str, Any]:
    """Return the value of a policy with perfect and with the measured perception.

    Parameters
    ----------
    prior : as in `matrix`
    draws : matrices drawn from the posterior, for the mean and interval of the value that the
        counts leave open; with few counts it is drawn towards chance, away from the counted one
    """
    if len(counts) != mdp.space.column("status").size:
        raise ModelError(
            f"a confusion matrix of {len(counts)} statuses",
            where="perception",
            fix=f"give one of {mdp.space.column('status').size}",
        )
    perfect = evaluate(mdp, policy)
    measured = evaluate(mdp, perceived(mdp, policy, matrix(counts, prior)))
    perks = Counted(counts=counts, prior=1 / len(counts))
    drawn = value_under_counts(mdp, policy, perks, rng=seed, n=draws) if draws else None
    return {
        "perfect": {"value": perfect.mean, "claim": str(perfect.claim)},
        "measured": {"value": measured.mean, "claim": str(measured.claim)},
        "loss": perfect.mean - measured.mean,
        "posterior": {
            "mean": None if drawn is None else drawn.value.value,
            "interval": None if drawn is None else list(drawn.interval),
            "level": LEVEL, "draws": draws, "claim": "estimated",
        },
    }  # fmt: skip


def sentence(worth: Mapping[str, Any]) -> str:
    """Return in one sentence what the errors cost.

    Examples
    --------
    >>> print(sentence({"perfect": {"value": 146.24}, "loss": 20.5}))
    These errors of perception cost 20.50 of the 146.24 that the policy earns in a conversation with
    perfect perception (14 %).
    >>> print(sentence({"perfect": {"value": 146.24}, "loss": 0.0}))
    These errors of perception cost nothing of the 146.24 that the policy earns in a conversation
    with perfect perception.
    """
    perfect, loss = worth["perfect"]["value"], worth["loss"]
    cost = f"cost {loss:.2f} of" if loss > 0 else f"add {-loss:.2f} to"
    share = f" ({100 * loss / abs(perfect):.2g} %)" if loss > 0 and perfect else ""
    return (
        f"These errors of perception {cost if loss else 'cost nothing of'} the {perfect:.2f} that "
        f"the policy earns in a conversation with perfect perception{share}."
    )


@dataclass(frozen=True, kw_only=True)
class Answers:
    """What the robot says to one behaviour with one kind of assistance, by variant."""

    status: str
    action: str
    behaviour: dict[str, str]
    speech: dict[str, str]
    prompt_characters: dict[str, int]


def side_by_side(
    modules: Modules,
    backend: Backend,
    *,
    vectors: list[int],
    actions: list[str],
    seed: int,
) -> list[Answers]:
    """Return the answers of all variants for each status vector and action.

    The behaviour is made once for each vector, and the variants share their seed, so that what
    differs between them is the prompt.
    """
    found = []
    place = Place(step=modules.activity.steps[0], attempt=2, attempts=5)
    for number, (vector, action) in enumerate(product(vectors, actions)):
        status = bits(vector, modules.statuses)
        asked = modules.behaviour(place, (), "", status, seed_of(seed, vector, "behaviour"))
        behaviour = dict(backend.answer(asked).data)
        speech, length = {}, {}
        for variant in VARIANTS:
            request = replace(modules, variant=variant).execution(
                place, (), behaviour, action, status, seed_of(seed, number, "execution")
            )
            speech[variant] = str(backend.answer(request).data["speech"])
            length[variant] = sum(len(content) for _, content in request.messages)
        entry = Answers(
            status="".join(map(str, status.values())),
            action=action,
            behaviour=behaviour,
            speech=speech,
            prompt_characters=length,
        )
        found.append(entry)
    return found
