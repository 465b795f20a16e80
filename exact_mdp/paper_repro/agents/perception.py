"""How well a backend perceives: a confusion matrix counted from labelled behaviours or records.

For every status vector s a backend is given n behaviours and reads p out of each; the matrix is
C(s, p) = count(s, p) / n(s). What such perception costs a policy is exact for a given matrix.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

from exact_mdp import MDP, ModelError, Policy, evaluate
from exact_mdp.mdp.care.perception import Counted, perceived, read_counts
from exact_mdp.paper_repro.agents import log
from exact_mdp.paper_repro.agents.simulate import Backend, seed_of
from exact_mdp.paper_repro.agents.texts import TEXTS, Modules


def labelled(
    modules: Modules,
    behave: Backend,
    perceive: Backend,
    path: Path,
    *,
    each: int,
    seed: int,
    progress: Callable[[int], None] = lambda number: None,
) -> None:
    """Write `each` behaviours for every status vector, and what is perceived in them, to a file.

    Those that the file holds already are not asked for again.
    """
    size = 2 ** len(modules.statuses)
    header = {
        "kind": "header",
        "format": log.FORMAT,
        "statuses": list(modules.statuses),
        "behave": behave.describe(),
        "perceive": perceive.describe(),
        "texts": TEXTS["version"],
        "seed": seed,
    }
    record = log.read(path)
    if record is None:
        log.append(path, header)
        done = 0
    elif record.header != header:
        raise ModelError(
            "the folder holds a measurement with other settings",
            where=str(path),
            fix="name another --out",
        )
    else:
        done = len(record.steps)
    for number in range(done, each * size):
        bits = format(number % size, f"0{len(modules.statuses)}b")
        status = {name: int(bit) for name, bit in zip(modules.statuses, bits, strict=True)}
        place = modules.place(number // size, 1, 5)
        asked = modules.behaviour(place, (), status, seed_of(seed, number, "behaviour"))
        behaviour = behave.answer(asked)
        seen = perceive.answer(modules.perception(behaviour, seed_of(seed, number, "perception")))
        entry = {
            "kind": "step",
            "timestep": number,
            "status": bits,
            "perceived": "".join(str(seen[name]) for name in modules.statuses),
            "behaviour": behaviour,
        }
        log.append(path, entry)
        progress(number + 1)


def counts(mdp: MDP, paths: list[Path]) -> Counted:
    """Return how often each true vector was perceived as each other, in some recordings."""
    if len({path.resolve() for path in paths}) < len(paths):
        raise ModelError("one recording is named twice", where="--recording", fix="name it once")
    read = [read_counts(path, mdp) for path in paths]
    return Counted(counts=np.sum([one.counts for one in read], axis=0))


def as_csv(counted: Counted) -> str:
    """Return the matrix as CSV: rows are true statuses, columns perceived ones."""
    width = len(counted.counts).bit_length() - 1
    names = [format(number, f"0{width}b") for number in range(len(counted.counts))]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["status", *names])
    writer.writerows([name, *row] for name, row in zip(names, counted.mean.tolist(), strict=True))
    return stream.getvalue()


def cost(mdp: MDP, policy: Policy, counted: Counted) -> dict[str, float]:
    """Return the exact value of a policy with perfect and with the counted perception."""
    perfect = evaluate(mdp, policy).mean
    return {
        "perfect": perfect,
        "measured": evaluate(mdp, perceived(mdp, policy, counted.mean)).mean,
    }
