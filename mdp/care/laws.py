"""The chance of each status next, as sums of named parameters: the care model without a matrix.

Every chance of the care model is a sum of numbers of its tables, cut off at 1:

    p_i(s, a) = min(1, Σ of the parameters named by step[s, a, i])        under action a,
    z_i(s)    = min(1, Σ of the parameters named by skip[s, i])           when a subtask is skipped.

A sum above 1 is no probability: `warn_of_excess` names it wherever a model is made of it.
So one array of positions says how the model follows from its parameters: exact laws, batches of
drawn parameters and matrix-free operators all read it. Source: Yuan et al. (2025), Section 2.1.

Laws of the next status vector, exact: under each action, and when a subtask is skipped.

Given the present vector s and an action a, the next statuses are independent, so that

    K_a(s, s') = Π_i p_i(s, a)^{s'_i} (1 - p_i(s, a))^{1 - s'_i},

worked out as integers over one denominator for each row. Source: Yuan et al. (2025), Section 2.1.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from fractions import Fraction
from math import prod

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.mdp.care.tables import Tables
from exact_mdp.mdp.errors import ScenarioWarning
from exact_mdp.mdp.table import Floats, Integers, Numbers, common, integers, multiply, shown

ZERO = Fraction(0)
NEAR = 1e-9  # sums of floats this much below 1 are looked at exactly, far more than rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Chances:
    """Which parameters add up to the chance of each status.

    Attributes
    ----------
    names : tuple of str
        The P parameters of the scenario, in its order.
    bits : (2^n, n)
        The status vectors; the first status is the most significant digit.
    step : (2^n, A, n, n) ints
        Positions in `names` of the terms of p_i(s, a); P where there is no term.
    skip : (2^n, n, n) ints
        The same of z_i(s).
    """

    names: tuple[str, ...]
    bits: Integers
    step: Integers
    skip: Integers

    def step_chances(self, values: ArrayLike) -> Floats:
        """Return p (…, 2^n, A, n) in floats, from values (…, P) of all parameters."""
        return _sums(values, self.step)

    def skip_chances(self, values: ArrayLike) -> Floats:
        """Return z (…, 2^n, n) in floats, from values (…, P) of all parameters."""
        return _sums(values, self.skip)


def chances(scenario: Tables) -> Chances:
    """Return which parameters make up each chance of a scenario.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> found = chances(scenario)
    >>> [found.names[k] for k in found.step[0b0010, 0, 0] if k < len(found.names)]
    ['base.forgetfulness', 'influence.anger.forgetfulness']
    >>> values = [float(parameter.value) for parameter in scenario.parameters]
    >>> found.step_chances(values)[0b0010, 0].round(2).tolist()
    [0.37, 0.38, 1.0, 0.3]
    """
    names = scenario.names
    position = {name: number for number, name in enumerate(names)}
    statuses, count, none = scenario.statuses, len(scenario.statuses), len(names)
    bits = (np.arange(2**count)[:, None] >> np.arange(count - 1, -1, -1)) & 1
    present = bits.astype(bool)
    kind = np.int16 if none < 2**15 else np.int32
    step = np.full((2**count, len(scenario.actions), count, count), none, dtype=kind)
    skip = np.full((2**count, count, count), none, dtype=kind)
    rule, additive = scenario.readings["skip_onset"], scenario.readings["influence_on_present"]
    for i, status in enumerate(statuses):
        pushes = np.full((2**count, count), none, dtype=kind)  # column 0 is for the term pushed
        others = [j for j in range(count) if j != i]
        for column, j in enumerate(others, start=1):
            pushes[present[:, j], column] = position[_influence(scenario, statuses[j], status)]
        here = present[:, i]
        free = pushes.copy()
        if additive == "none":
            free[here] = none
        free[:, 0] = np.where(here, position[f"persistence.{status}"], position[f"base.{status}"])
        for number, action in enumerate(scenario.actions):
            step[:, number, i] = free
            for name, where in (("persistence", here), ("onset", ~here)):
                assisted = position.get(f"assistance.{action}.{status}.{name}")
                if assisted is not None:
                    step[where, number, i] = none
                    step[where, number, i, 0] = assisted
        if rule != "reset":
            skip[here, i, 0] = _staying(scenario, position, present, i)[here]
        if rule == "base":
            skip[~here, i] = free[~here]
    return Chances(names=names, bits=bits, step=step, skip=skip)


def excess(scenario: Tables, found: Chances | None = None) -> str | None:
    """Return in one line which chances pass 1 and are cut off there, or None where none does.

    Sums are compared exactly. No chance can be negative: every term lies in [0, 1].

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> excess(scenario) is None
    True
    >>> print(excess(scenario.with_(parameters={"base.anger": "9/10"})))
    a chance of 1.24 is cut off at 1: anger in status 1101 under none is base.anger 0.9 + ...
    """
    found = chances(scenario) if found is None else found
    values = [parameter.value for parameter in scenario.parameters]
    rough = np.array([*map(float, values), 0.0])
    greatest: tuple[Fraction, str, list[int]] | None = None
    count = 0
    for table, when in ((found.step, "under"), (found.skip[:, None], "on a skip")):
        near = rough[table].sum(axis=-1) > 1 - NEAR
        rows, which = np.unique(table[near], axis=0, return_inverse=True)
        sums = [sum((values[k] for k in row if k < len(values)), ZERO) for row in rows.tolist()]
        over = np.array([total > 1 for total in sums], dtype=bool)[which.reshape(-1)]
        count += int(over.sum())
        for (vector, action, status), number in zip(
            np.argwhere(near)[over].tolist(), which.reshape(-1)[over].tolist(), strict=True
        ):
            if greatest is None or sums[number] > greatest[0]:
                word = f"under {scenario.actions[action]}" if when == "under" else when
                label = "".join(map(str, found.bits[vector].tolist()))
                place = f"{scenario.statuses[status]} in status {label} {word}"
                greatest = sums[number], place, rows[number].tolist()
    if greatest is None:
        return None
    total, place, terms = greatest
    added = " + ".join(f"{found.names[k]} {shown(values[k])}" for k in terms if k < len(values))
    others = "; and so is 1 other" if count == 2 else f"; and so are {count - 1} others"
    others = others if count > 1 else ""
    return f"a chance of {shown(total)} is cut off at 1: {place} is {added}{others}"


def warn_of_excess(scenario: Tables, *, where: str = "", stacklevel: int = 2) -> bool:
    """Warn where a chance is cut off at 1, and say whether one is.

    Parameters
    ----------
    where : str, optional
        In which part of an analysis.
    stacklevel : int
        Whose line the warning names: 2 for the caller's own.
    """
    message = excess(scenario)
    if message is not None:
        text = f"scenario {scenario.name}{where}: {message}"
        warnings.warn(text, ScenarioWarning, stacklevel=stacklevel + 1)
    return message is not None


def _influence(scenario: Tables, origin: str, target: str) -> str:
    by_row = scenario.readings["influence_orientation"] == "row-to-column"
    first, second = (origin, target) if by_row else (target, origin)
    return f"influence.{first}.{second}"


def _staying(scenario: Tables, position: dict[str, int], present: np.ndarray, i: int) -> Integers:
    """Return (2^n,) the parameter by which status i, where it is present, stays on a skip."""
    status = scenario.statuses[i]
    if status not in scenario.others:
        return np.full(len(present), position[f"skip.{status}.persistence"])
    other = present[:, scenario.statuses.index(scenario.others[status])]
    alone, both = (position[f"skip.{status}.{word}"] for word in ("alone", "with-other"))
    return np.where(other, both, alone)


def _sums(values: ArrayLike, terms: Integers) -> Floats:
    numbers = np.asarray(values, dtype=np.float64)
    padded = np.concatenate([numbers, np.zeros((*numbers.shape[:-1], 1))], axis=-1)
    total = padded[..., terms[..., 0]]
    for column in range(1, terms.shape[-1]):
        total = total + padded[..., terms[..., column]]
    return np.asarray(np.minimum(total, 1.0))


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Laws of the next status vector: integers over one denominator for each row."""

    bits: Integers  # (2^n, n) the vectors; the first status is the most significant digit
    step: Numbers  # (2^n, A, 2^n) weights under each action
    step_denominator: Numbers  # (2^n, A)
    skip: Numbers  # (2^n, 2^n) weights when a subtask is skipped
    skip_denominator: int


def status_kernels(scenario: Tables) -> Kernels:
    """Return the laws of the status vector under every action and on a skip."""
    found = chances(scenario)
    vectors, actions, count, _ = found.step.shape
    values = [parameter.value for parameter in scenario.parameters]

    def chance(terms: list[int]) -> Fraction:
        return min(
            Fraction(1), sum((values[k] for k in terms if k < len(found.names)), Fraction(0))
        )

    weight, denominator = _products(
        [[chance(terms) for terms in row] for row in found.step.reshape(-1, count, count).tolist()]
    )
    skip, skip_denominators = _products(
        [[chance(terms) for terms in row] for row in found.skip.tolist()]
    )
    shared, _ = common([Fraction(1, int(d)) for d in skip_denominators])
    bottom = shared[0] * int(skip_denominators[0])
    return Kernels(
        bits=found.bits,
        step=weight.reshape(vectors, actions, vectors),
        step_denominator=denominator.reshape(vectors, actions),
        # As wide as its denominator, below which every sum of a row's weights stays.
        skip=multiply(skip, integers(shared)[:, None]).astype(integers([bottom]).dtype),
        skip_denominator=bottom,
    )


def _products(rows: list[list[Fraction]]) -> tuple[Numbers, Numbers]:
    """Return the law of independent bits: (R, 2^n) integer weights over (R,) denominators."""
    top = integers([p.numerator for row in rows for p in row]).reshape(len(rows), -1)
    bottom = integers([p.denominator for row in rows for p in row]).reshape(len(rows), -1)
    whole = [prod(p.denominator for p in row) for row in rows]
    denominator = integers(whole)
    if denominator.dtype == object:
        top, bottom = top.astype(object), bottom.astype(object)
    weight = np.ones((len(rows), 1), dtype=denominator.dtype)
    for i in range(top.shape[1]):
        one, zero = top[:, i : i + 1], bottom[:, i : i + 1] - top[:, i : i + 1]
        weight = np.stack([weight * zero, weight * one], axis=2).reshape(len(rows), -1)
    return weight, denominator
