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

from mdp import MDP, Policy
from mdp.errors import ModelError
from mdp.perception import perceived
from paper_repro.agents.modules import Modules, Place
from paper_repro.agents.protocol import Backend
from paper_repro.agents.world import seed_of
from solvers import evaluate

LEVEL = 0.95

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
    table = np.zeros((2**statuses, 2**statuses), dtype=np.int64)
    for true, seen in pairs:
        table[true, seen] += 1
    return table


def matrix(counts: Counts, prior: float = 0.0) -> Floats:
    """Return the (2^n, 2^n) confusion matrix: frequencies, or posterior means with a prior.

    Raises
    ------
    ModelError
        Where a status was never seen and there is no prior to go by.
    """
    weight = counts + prior
    total = weight.sum(axis=1, keepdims=True)
    if (total == 0).any():
        width = len(counts).bit_length() - 1
        missing = [format(int(row), f"0{width}b") for row in np.flatnonzero(total[:, 0] == 0)]
        raise ModelError(
            f"no behaviour was labelled {', '.join(missing[:4])}"
            + (" and others" if len(missing) > 4 else ""),
            where="confusion matrix",
            fix="label more behaviours, or give a --prior, which counts as that many of each",
        )
    return np.asarray(weight / total)


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
    numbers = np.arange(len(counts))
    found: dict[str, Any] = {}
    for place, name in enumerate(statuses):
        bit = numbers >> (len(statuses) - 1 - place) & 1
        found[name] = {}
        for what, present in (("sensitivity", 1), ("specificity", 0)):
            rows = counts[bit == present]
            right, total = int(rows[:, bit == present].sum()), int(rows.sum())
            low, high = interval(right, total)
            rate = right / total if total else None
            found[name][what] = {
                "right": right, "of": total, "rate": rate, "low": low, "high": high
            }  # fmt: skip
    return found


def interval(right: int, total: int, level: float = LEVEL) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a proportion.

    Examples
    --------
    >>> low, high = interval(10, 10)
    >>> round(low, 4), high
    (0.6915, 1.0)
    """
    from scipy.stats import beta

    tail = (1 - level) / 2
    low = 0.0 if right == 0 else float(beta.ppf(tail, right, total - right + 1))
    high = 1.0 if right == total else float(beta.ppf(1 - tail, right + 1, total - right))
    return low, high


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
    rng = np.random.default_rng(seed)
    values = [evaluate(mdp, perceived(mdp, policy, _draw(counts, rng))).mean for _ in range(draws)]
    spread = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]).tolist() if values else None
    mean = float(np.mean(values)) if values else None
    return {
        "perfect": {"value": perfect.mean, "claim": str(perfect.claim)},
        "measured": {"value": measured.mean, "claim": str(measured.claim)},
        "loss": perfect.mean - measured.mean,
        "posterior": {
            "mean": mean, "interval": spread, "level": LEVEL, "draws": draws, "claim": "estimated"
        },
    }  # fmt: skip


def _draw(counts: Counts, rng: np.random.Generator) -> Floats:
    return np.stack([rng.dirichlet(row + 1 / len(row)) for row in counts])
