"""Which statements of the paper can hold together under one reading, and which cannot.

Each statement is a distance from what a reading and a completion imply, in standard deviations of
the number that is reported. Statements can hold together where some reading and completion leaves
none of them further off than three:

    score(set) = min over readings and completions of the max over the set of the distance.

A set that cannot is a contradiction; the smallest ones are those without a smaller one inside.
Source of the statements: Yuan et al. (2025), Section 4.1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Floats
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import (
    TOLERANCE,
    Evidence,
    reported_averages,
    spread_of_average,
)
from exact_mdp.paper_repro.readings.search import STARTS

TOGETHER = 3.0  # standard deviations
PART = 128  # readings at a time
Singles = NDArray[np.float32]

STATEMENTS = {
    "a2": f"a2 in 0000 returned {reported.AVERAGE_RETURN['non-directive']} on average",
    "a3": f"a3 in 0000 returned {reported.AVERAGE_RETURN['directive']} on average",
    "a1": f"a1 in 0000 returned {reported.AVERAGE_RETURN['supportive']} on average",
    "converged": f"the learned policies return about {reported.CONVERGED_RETURN}",
    "random": f"the random strategy returns around {reported.RANDOM_RETURN}",
    "ranking": "a2 in 0000 is better than a3, and a3 than a1",
    "respectively": "1000 gets directive and 0100 non-directive, in the order of the sentence",
    "optimal": "the final policy is optimal, as far as its experiments can tell",
}
"""What the paper says, by a short name."""


@dataclass(frozen=True, kw_only=True)
class Joint:
    """How well some statements can hold together under one reading and completion.

    Attributes
    ----------
    statements : tuple of str
        Keys of `STATEMENTS`.
    score : float
        The least over readings and completions of the largest distance among the statements, in
        standard deviations.
    reading, completion : int
        Where it is least.
    readings : int
        Number of readings under which they hold together with some completion.
    """

    statements: tuple[str, ...]
    score: float
    reading: int
    completion: int
    readings: int

    @property
    def possible(self) -> bool:
        """Whether each statement can be within three standard deviations at once."""
        return self.score <= TOGETHER


def distances(found: Evidence) -> dict[str, Floats]:
    """Return (R, C) the distance of every statement, in standard deviations; 0 where it holds.

    The ranking is off by what it lacks, in standard errors of the difference of two averages; the
    final policy by its regret, in standard errors of its average: an optimum that the experiments
    could not tell from it counts as reached. The order of a sentence holds (0) or does not (∞).
    """
    search = found.search
    error = search.variance / found.experiments
    spread = spread_of_average(search.variance, found.experiments)
    scores = np.abs(search.mean - reported_averages()) / spread
    place = {start: number for number, start in enumerate(STARTS)}
    best, middle, worst = (place[each] for each in ("non-directive", "directive", "supportive"))

    def lacking(upper: int, lower: int) -> Floats:
        gap = search.mean[:, :, lower] - search.mean[:, :, upper]
        return np.asarray(gap / np.sqrt(error[:, :, lower] + error[:, :, upper]))

    def read_off(number: float, mean: Floats, tolerance: float | None) -> Floats:
        return np.asarray(np.abs(mean - number) / (TOLERANCE if tolerance is None else tolerance))

    written = [
        0.0 if all(each[status] == action for status, action in STATED.items()) else np.inf
        for each in search.completions
    ]
    shape = scores.shape[:2]
    random = read_off(reported.RANDOM_RETURN, search.random_mean, found.random_tolerance)
    regret = search.optimum[:, None] - search.mean[:, :, best]
    return {
        "a2": scores[:, :, best],
        "a3": scores[:, :, middle],
        "a1": scores[:, :, worst],
        "converged": read_off(
            reported.CONVERGED_RETURN, search.mean.mean(axis=2), found.converged_tolerance
        ),
        "random": np.broadcast_to(random[:, None], shape),
        "ranking": np.maximum(np.maximum(lacking(best, middle), lacking(middle, worst)), 0.0),
        "respectively": np.broadcast_to(np.array(written), shape),
        "optimal": np.maximum(regret, 0.0) / np.sqrt(error[:, :, best]),
    }


STATED = {status: reported.STATED[status] for status in ("1000", "0100")}


def joint(found: Evidence, statements: Sequence[str] = tuple(STATEMENTS)) -> list[Joint]:
    """Return how well every set of statements can hold together, small sets first."""
    parts = distances(found)
    chosen = {name: parts[name].astype(np.float32) for name in statements}  # half the memory
    merged: dict[tuple[str, ...], Joint] = {}
    # A part of the readings at a time, so that the arrays stay near the processor.
    for first in range(0, len(found.search.space), PART):
        part = {name: array[first : first + PART] for name, array in chosen.items()}
        for each in _sets(part, (), np.zeros(1, dtype=np.float32)):
            moved = replace(each, reading=each.reading + first)
            merged[each.statements] = _better(merged.get(each.statements), moved)
    listed = list(merged.values())
    order = {name: number for number, name in enumerate(statements)}
    return sorted(
        listed, key=lambda each: (len(each.statements), [order[name] for name in each.statements])
    )


def _better(known: Joint | None, other: Joint) -> Joint:
    """Return the nearer of two, the first where they are alike, with the readings of both."""
    if known is None:
        return other
    nearer = other if other.score < known.score else known
    return replace(nearer, readings=known.readings + other.readings)


def _sets(parts: Mapping[str, Singles], names: tuple[str, ...], worst: Singles) -> Iterator[Joint]:
    """Yield every set that adds statements behind the last one of `names`, depth first."""
    left = list(parts)
    behind = left.index(names[-1]) + 1 if names else 0
    for name in left[behind:]:
        both = np.maximum(worst, parts[name])
        nearest = both.min(axis=1)
        reading = int(nearest.argmin())
        yield Joint(
            statements=(*names, name),
            score=float(nearest[reading]),
            reading=reading,
            completion=int(both[reading].argmin()),
            readings=int((nearest <= TOGETHER).sum()),
        )
        yield from _sets(parts, (*names, name), both)


def contradictions(found: Sequence[Joint]) -> list[Joint]:
    """Return the smallest sets of statements that cannot hold together under any reading."""
    smallest: list[Joint] = []
    for each in sorted(found, key=lambda one: len(one.statements)):
        inside = any(set(known.statements) <= set(each.statements) for known in smallest)
        if not each.possible and not inside:
            smallest.append(each)
    return smallest


def largest_possible(found: Sequence[Joint]) -> list[Joint]:
    """Return the largest sets of statements that can hold together under some reading."""
    largest: list[Joint] = []
    for each in sorted(found, key=lambda one: -len(one.statements)):
        inside = any(set(each.statements) <= set(known.statements) for known in largest)
        if each.possible and not inside:
            largest.append(each)
    return largest
