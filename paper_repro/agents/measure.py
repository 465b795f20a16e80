"""Measured perception: a backend's confusion matrix, its uncertainty, and what it would cost.

For every status vector s a backend is given n behaviours and reads p out of each; the matrix is
C(s, p) = count(s, p) / n(s). A row's uncertainty is Dirichlet(count + 1/2^n), the prior of Perks
(1947), which weighs as much as one behaviour; that of one status's sensitivity or specificity is
the interval of Clopper and Pearson (1934). What it costs is exact
for a given matrix: the robot in state (place, s) follows

    π_C(a | place, s) = Σ_p C(s, p) π(a | place, p),

whose value is a linear solve. The spread of that value over matrices drawn from the posterior is
an estimate.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.perception import value_under_counts
from mdp import MDP, Policy
from mdp.errors import ModelError
from mdp.perception import perceived
from mdp.perception_counts import LEVEL, Counted, counted, interval
from paper_repro.agents.modules import Modules, Place
from paper_repro.agents.protocol import Backend
from paper_repro.agents.world import seed_of
from solvers import evaluate

__all__ = ["bits", "cost", "count", "interval", "labelled", "matrix", "rates", "to_csv", "vector"]

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
    return counted(pairs, size=2**statuses).counts


def matrix(counts: Counts, prior: float = 0.0) -> Floats:
    """Return the (2^n, 2^n) confusion matrix: frequencies, or posterior means with a prior.

    Raises
    ------
    ModelError
        Where a status was never seen and there is no prior to go by.
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
    drawn = value_under_counts(mdp, policy, perks, seed=seed, draws=draws) if draws else None
    return {
        "perfect": {"value": perfect.mean, "claim": str(perfect.claim)},
        "measured": {"value": measured.mean, "claim": str(measured.claim)},
        "loss": perfect.mean - measured.mean,
        "posterior": {
            "mean": None if drawn is None else drawn.mean,
            "interval": None if drawn is None else list(drawn.interval),
            "level": LEVEL, "draws": draws, "claim": "estimated",
        },
    }  # fmt: skip
