"""What bounds all pairs' numbers at once, without a look at any: numbers in, numbers out.

For h from a to b, and the greatest reward r and number of terms n of any pair,

    |d| ≤ r + γ 1.001 (b - a) + (1 - γ) max(|a|, |b|),   |error of d| ≤ γ(n + 8) γ (b - a) + …

as `solvers.bounds.gains` has it of each pair. Passes in Python (`solvers.bounds.sweeps`) and the
compiled run (`solvers.kernels.rounds`) ask the same functions, so that both pass over the same
pairs.
"""

from __future__ import annotations

from typing import NamedTuple

UNIT = 2.0**-53
TINY = 2.0**-1000
SLACK = 1 + 2.0**-20


class Greatest(NamedTuple):
    """Of a model's pairs, the greatest: reward in size, roundings in a row, errors; the leak 1 - γ.

    γ Σ_s' P(l, s') is from `least_flow` to `most_flow` for all of them.
    """

    reward: float
    leak: float
    terms: int
    reward_error: float
    leak_error: float
    least_flow: float
    most_flow: float


class Sizes(NamedTuple):
    """Of one h: how large its values are; and what bounds all pairs' d.

    `gain` bounds |d|, `error` its rounding error, `noise` that of V and q.
    """

    value: float
    gain: float
    error: float
    noise: float


def sizes(bottom: float, top: float, discount: float, most: Greatest) -> Sizes:
    """Return bounds for any h from `bottom` to `top`; see `solvers.bounds.gains` for the form."""
    span, size, count = top - bottom, max(abs(bottom), abs(top)), (most.terms + 8) * UNIT
    rounded, few = count / (1 - count) * (1 + 4 * UNIT), 4 * UNIT / (1 - 4 * UNIT) * (1 + 4 * UNIT)
    # No row of floats sums up to 1.001.
    flow, lost = 1.001 * discount * span, most.leak * size
    error = rounded * flow + few * (most.reward + lost)
    error += most.leak_error * size + TINY * (1 + size) * (most.terms + 1) + most.reward_error
    error *= SLACK
    noise = rounded * (flow + size + most.reward) + error
    return Sizes(size, most.reward + flow + lost + error, error, noise)


def risen(rise: float, climb: float, most: Greatest) -> float:
    """Return how much γ P_l h may have risen in all, once no h has risen by more than `climb`."""
    climb += 2 * UNIT * abs(climb) + TINY
    grown = max(most.least_flow * climb, most.most_flow * climb)
    return rise + (grown + 4 * UNIT * (abs(grown) + abs(rise)))


def dropped(shift: float, least: float, most: float) -> float:
    """Return an upper bound of -c m for the `shift` c and any margin m from `least` to `most`."""
    above = max(-shift * least, -shift * most)
    return above + 4 * UNIT * abs(above)
