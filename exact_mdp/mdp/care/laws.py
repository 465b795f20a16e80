"""How a status vector moves: the chance of each status next, and the laws that they make.

Every chance of the care model is a sum of numbers of its tables, cut off at 1:

    p_i(s, a) = min(1, Σ of the parameters in terms[step[s, a, i]])       under action a,
    z_i(s)    = min(1, Σ of the parameters in terms[skip[s, i]])          when a subtask is skipped.

A sum above 1 is not a probability: `warn_of_excess` names it wherever a model is made of it. The
next statuses are independent, so that

    K_a(s, s') = Π_i p_i(s, a)^{s'_i} (1 - p_i(s, a))^{1 - s'_i},

as integers over one denominator for each row in an exact model. One array of positions says how a
model follows from its parameters: exact laws and batches of drawn parameters read it.
Source: Yuan et al. (2025), Section 2.1.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import lcm, prod

import numpy as np

from exact_mdp.mdp.care.tables import Tables, bits_of
from exact_mdp.mdp.errors import ScenarioWarning
from exact_mdp.mdp.table import Integers, Numbers, common, integers, multiply, shown


@dataclass(frozen=True, kw_only=True, eq=False)
class Chances:
    """Which parameters add up to the chance of each status."""

    names: tuple[str, ...]  # the P parameters of the scenario, in its order
    bits: Integers  # (2^n, n) the status vectors; the first status is the most significant digit
    terms: Integers  # (U, n) positions in `names` of the terms of each of U chances; P for none
    step: Integers  # (2^n, A, n) which chance p_i(s, a) is
    skip: Integers  # (2^n, n) which chance z_i(s) is

    def sums(self, scenario: Tables) -> tuple[Numbers, int]:
        """Return (U,) the sums of terms, not cut off, as integers over one denominator."""
        used = np.flatnonzero(np.bincount(self.terms.reshape(-1))[: len(self.names)])
        tops, bottom = common([scenario.parameters[k].value for k in used.tolist()])
        small = bottom * (len(self.bits[0]) + 1) < 2**62
        numbers = np.zeros(len(self.names) + 1, dtype=np.int64 if small else object)
        numbers[used] = tops
        return np.asarray(numbers[self.terms].sum(axis=1)), bottom


def chances(scenario: Tables) -> Chances:
    """Return which parameters make up each chance of a scenario."""
    readings = ("influence_orientation", "influence_on_present", "skip_onset")
    return _chances(
        scenario.names,
        scenario.statuses,
        scenario.actions,
        tuple(sorted(scenario.others.items())),
        *(scenario.readings[name] for name in readings),
    )


@lru_cache(maxsize=16)
def _chances(
    names: tuple[str, ...],
    statuses: tuple[str, ...],
    actions: tuple[str, ...],
    others: tuple[tuple[str, str], ...],
    orientation: str,
    on_present: str,
    onset: str,
) -> Chances:
    """Return the chances of all scenarios that differ in nothing but their numbers and rules."""
    position, none, count = {name: k for k, name in enumerate(names)}, len(names), len(statuses)
    bits = bits_of(count)
    present = bits.astype(bool)
    step = np.empty((2**count, len(actions), count), dtype=np.int64)
    skip = np.empty((2**count, count), dtype=np.int64)
    terms: list[Integers] = []

    def add(rows: Integers) -> int:
        """Add rows of terms (k, n), and return the number of the first."""
        terms.append(rows)
        return sum(map(len, terms)) - len(rows)

    def alone(name: str | None) -> int:
        """Return the number of the chance that is one parameter, or 0."""
        row = np.full((1, count), none)
        row[0, 0] = none if name is None else position[name]
        return add(row)

    nothing = alone(None)
    for i, status in enumerate(statuses):
        here = present[:, i]
        free = np.full((2**count, count), none)
        free[:, 0] = np.where(here, position[f"persistence.{status}"], position[f"base.{status}"])
        for column, j in enumerate((j for j in range(count) if j != i), start=1):
            pushed = present[:, j] & (~here if on_present == "none" else True)
            free[pushed, column] = position[influence(orientation, statuses[j], status)]
        # Where nothing is added to it, the persistence is one chance for all vectors.
        kinds = np.arange(2**count)
        kinds[here & (free[:, 1:] == none).all(axis=1)] = 1 << (count - 1 - i)
        used, which = np.unique(kinds, return_inverse=True)
        which = which + add(free[used])
        for number, action in enumerate(actions):
            step[:, number, i] = which
            for name, where in (("persistence", here), ("onset", ~here)):
                assisted = f"assistance.{action}.{status}.{name}"
                if assisted in position:
                    step[where, number, i] = alone(assisted)
        skip[:, i] = nothing
        if onset == "base":
            skip[~here, i] = which[~here]
        if onset != "reset":
            other = dict(others).get(status)
            if other is None:
                skip[here, i] = alone(f"skip.{status}.persistence")
            else:
                both = present[:, statuses.index(other)]
                skip[here & ~both, i] = alone(f"skip.{status}.alone")
                skip[here & both, i] = alone(f"skip.{status}.with-other")
    joined = np.concatenate(terms)
    for array in (bits, joined, step, skip):
        array.setflags(write=False)
    return Chances(names=names, bits=bits, terms=joined, step=step, skip=skip)


def influence(orientation: str, origin: str, target: str) -> str:
    """Return the parameter by which one status pushes another."""
    first, second = (origin, target) if orientation == "row-to-column" else (target, origin)
    return f"influence.{first}.{second}"


def excess(scenario: Tables) -> str | None:
    """Return in one line which chances pass 1 and are cut off there, or None where none does.

    Sums are compared exactly. No chance can be negative: every term lies in [0, 1].
    """
    law = chances(scenario)
    sums, bottom = law.sums(scenario)
    over = np.array(sums > bottom, dtype=bool)
    if not over.any():
        return None
    count = int(over[law.step].sum() + over[law.skip].sum())
    greatest = max(sums[over].tolist())
    first = np.array(sums == greatest, dtype=bool)
    if first[law.step].any():
        vector, action, status = np.argwhere(first[law.step])[0].tolist()
        which, word = law.step[vector, action, status], f"under {scenario.actions[action]}"
    else:
        vector, status = np.argwhere(first[law.skip])[0].tolist()
        which, word = law.skip[vector, status], "on a skip"
    label = "".join(map(str, law.bits[vector].tolist()))
    added = " + ".join(
        f"{law.names[k]} {shown(scenario.parameters[k].value)}"
        for k in law.terms[which].tolist()
        if k < len(law.names)
    )
    others = "; and so is 1 other" if count == 2 else f"; and so are {count - 1} others"
    return (
        f"a chance of {shown(Fraction(greatest, bottom))} is cut off at 1: "
        f"{scenario.statuses[status]} in status {label} {word} is {added}"
        f"{others if count > 1 else ''}"
    )


def warn_of_excess(scenario: Tables, *, where: str = "", stacklevel: int = 2) -> bool:
    """Warn where a chance is cut off at 1, and say whether one is.

    `where` is the part of an analysis; `stacklevel` as in `warnings.warn`, 2 for the caller's line.
    """
    message = excess(scenario)
    if message is not None:
        text = f"scenario {scenario.name}{where}: {message}"
        warnings.warn(text, ScenarioWarning, stacklevel=stacklevel + 1)
    return message is not None


@dataclass(frozen=True, kw_only=True)
class Laws:
    """Laws of the next status vector, exact: integers over one denominator for each row."""

    step: Numbers  # (2^n, A, 2^n) weights under each action
    step_denominator: Numbers  # (2^n, A)
    skip: Numbers  # (2^n, 2^n) weights when a subtask is skipped
    skip_denominator: int


class ExactChances:
    """The chances of a scenario as fractions in lowest terms, and the laws that they make."""

    def __init__(self, scenario: Tables) -> None:
        self.found = chances(scenario)
        sums, shared = self.found.sums(scenario)
        parts = [Fraction(min(total, shared), shared) for total in sums.tolist()]
        self.top = [part.numerator for part in parts]
        self.bottom = [part.denominator for part in parts]

    def denominators(self, which: Integers) -> list[int]:
        """Return the denominators of rows, whose chances `which` (R, n) names."""
        return [prod(self.bottom[k] for k in row) for row in which.tolist()]

    def reach(self, which: Integers) -> Integers:
        """Return (…,) how many vectors each row leads to."""
        open_ = np.array([0 < a < b for a, b in zip(self.top, self.bottom, strict=True)])
        return np.asarray(2 ** open_[which].sum(axis=-1))

    def laws(self) -> Laws:
        """Return the laws of the status vector under every action and on a skip."""
        vectors, actions, count = self.found.step.shape
        weight, denominator = self._products(self.found.step.reshape(-1, count))
        skip, bottoms = self._products(self.found.skip)
        bottom = lcm(*bottoms.tolist())
        shared = integers([bottom // each for each in bottoms.tolist()])
        return Laws(
            step=weight.reshape(vectors, actions, vectors),
            step_denominator=denominator.reshape(vectors, actions),
            # As wide as its denominator, below which every sum of a row's weights stays.
            skip=multiply(skip, shared[:, None]).astype(integers([bottom]).dtype),
            skip_denominator=bottom,
        )

    def _products(self, which: Integers) -> tuple[Numbers, Numbers]:
        """Return the law of independent bits: (R, 2^n) integer weights over (R,) denominators."""
        denominator = integers(self.denominators(which))
        top = integers(self.top)[which].astype(denominator.dtype)
        bottom = integers(self.bottom)[which].astype(denominator.dtype)
        weight = np.ones((len(which), 1), dtype=denominator.dtype)
        for i in range(which.shape[1]):
            one, zero = top[:, i : i + 1], bottom[:, i : i + 1] - top[:, i : i + 1]
            weight = np.stack([weight * zero, weight * one], axis=2).reshape(len(which), -1)
        return weight, denominator
