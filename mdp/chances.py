"""The chance of each status next, as sums of named parameters: the care model without a matrix.

Every chance of the care model is a sum of numbers of its tables, cut off at 1:

    p_i(s, a) = min(1, Σ of the parameters named by step[s, a, i])        under action a,
    z_i(s)    = min(1, Σ of the parameters named by skip[s, i])           when a subtask is skipped.

So one array of positions says how the model follows from its parameters: exact laws, batches of
drawn parameters and matrix-free operators all read it. Source: Yuan et al. (2025), Section 2.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mdp.table import Floats, Integers

if TYPE_CHECKING:
    from mdp.scenario import Scenario


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


def chances(scenario: Scenario) -> Chances:
    """Return which parameters make up each chance of a scenario.

    Examples
    --------
    >>> from mdp import Scenario
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


def _influence(scenario: Scenario, origin: str, target: str) -> str:
    by_row = scenario.readings["influence_orientation"] == "row-to-column"
    first, second = (origin, target) if by_row else (target, origin)
    return f"influence.{first}.{second}"


def _staying(scenario: Scenario, position: dict[str, int], present: np.ndarray, i: int) -> Integers:
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
