"""How far the rounding of given floats can move a value: all that a verdict on zero forgives.

A float stands for whatever it was rounded from, half a unit in its last place to either side. One
use of pair l can move the value of a policy, by what was rounded in its own row, by at most

    e(l) = Σ_i p_i ρ_i + γ (Σ_i ω_i) (max V(s_i) - min V(s_i))

with ρ_i and ω_i the rounding of its rewards and probabilities, and the last factor the span of the
values that this row can reach. Adding up the uses from a start,

    F(s) = e_π(s) + γ Σ_s' P_π(s, s') F(s')

Two policies whose values differ by at most F^π + F^* cannot be told apart by those who know no more
than the floats, F^* being that of an optimal policy. Nothing outside what is reached from the start
has any say in it, and it is 0 where all numbers are exact. It is computed from below and above, and
as a rational where these two do not decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, TINY
from exact_mdp.solvers.solution import SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """Numbers known from below and above.

    Attributes
    ----------
    low, high : (K,)
    """

    low: Floats
    high: Floats


def of_floats(mdp: MDP) -> bool:
    """Return whether any number of the model was given as a float that rounding may have moved.

    Examples
    --------
    >>> step = [[[0, 1], [0, 1]]]
    >>> of_floats(MDP.from_arrays(step, [1, 0])), of_floats(MDP.from_arrays(step, [0.1, 0]))
    (False, True)
    """
    return bool(mdp.table.weight_rounding().any() or mdp.table.gain_rounding().any())


def per_use(mdp: MDP, value: Floats, error: Floats) -> Range:
    """Return e(l) of every pair, (L,), for values (S,) known up to an error (S,).

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [0.1, 0])
    >>> found = per_use(mdp, np.array([0.1, 0.0]), np.zeros(2))
    >>> bool(found.low[0] <= 2.0**-57 <= found.high[0]), float(found.low[1])
    (True, 0.0)
    """
    table, first = mdp.table, mdp.table.offsets[:-1]
    rounded = table.gain_rounding()
    if len(rounded) != table.pairs:
        rounded = np.add.reduceat(table.probabilities() * rounded, first)
    moved = np.add.reduceat(table.weight_rounding(), first)
    # What is not known (NaN) lies where the policy never comes.
    there = np.nan_to_num(value, nan=0.0)[table.next]
    off = np.nan_to_num(error, nan=0.0, posinf=0.0)[table.next]
    with np.errstate(over="ignore", invalid="ignore"):
        span = np.maximum.reduceat(there, first) - np.minimum.reduceat(there, first)
        doubt = 2 * np.maximum.reduceat(off, first)
        least = rounded + mdp.discount * (moved * np.maximum(span - doubt, 0.0))
        most = rounded + mdp.discount * (moved * (span + doubt))
    return Range(low=least / SLACK, high=most * SLACK + TINY * (most > 0))


def exactly_per_use(mdp: MDP, value: Sequence[Fraction], pair: int) -> Fraction:
    """Return e(l) of one pair as a rational, for exact values of all states."""
    table = mdp.table
    begin, end = int(table.offsets[pair]), int(table.offsets[pair + 1])
    rounding, moved = table.gain_rounding(), table.weight_rounding()[begin:end]
    row = table.row(pair)
    if len(rounding) == table.pairs:
        rewards = Fraction(float(rounding[pair]))
    else:
        each = map(Fraction, rounding[begin:end].tolist())
        rewards = sum((p * r for (p, _, _), r in zip(row, each, strict=True)), Fraction(0))
    reached = [value[following] for _, following, _ in row]
    span = max(reached) - min(reached)
    return rewards + mdp.discount_exact * sum(map(Fraction, moved.tolist()), Fraction(0)) * span


def in_all(chain: PolicyChain, each: Range, *, reached: bool = False) -> Range:
    """Return F (S,) of a policy, from e(l) of every pair; up to infinity where floats fail.

    Parameters
    ----------
    reached : bool
        Leave out what the policy never reaches from the start.
    """
    mdp = chain.mdp
    counted = ~mdp.terminal & (chain.reached if reached else True)
    if mdp.discount_exact == 1:
        counted &= chain.ends
    low, high = (
        np.where(counted, np.add.reduceat(chain.weights * side, mdp.pair_offsets[:-1]), 0.0)
        for side in (each.low / SLACK, each.high * SLACK)
    )
    if not high.any():
        return Range(low=high, high=high)
    try:
        found = chain.discounted.solve((low + high) / 2, (high - low) / 2 * SLACK)
    except SolverError:
        return Range(low=np.zeros_like(low), high=np.full_like(high, inf))
    return Range(
        low=np.maximum(found.value - found.error, 0.0) / SLACK,
        high=(np.maximum(found.value, 0.0) + found.error) * SLACK,
    )


@dataclass(eq=False)
class Forgiveness:
    """What the rounding of the given floats can move at the start.

    Attributes
    ----------
    low, high : Fraction or infinity
        Proven bounds.
    make : callable, optional
        Works it out exactly.
    """

    low: Fraction
    high: Fraction | float
    make: Callable[[], Fraction] | None = None

    def covers(self, regret: Fraction) -> bool:
        """Return whether an exact regret is at most this, exactly."""
        if self.low < regret <= self.high and self.make is not None:
            self.low = self.high = self.make()
            self.make = None
        return regret <= self.low


def bounds_at_start(mdp: MDP, *parts: Range) -> tuple[Fraction, Fraction | float]:
    """Return bounds of the sum of several F over the start distribution."""
    low, high = Fraction(0), Fraction(0)
    for state, weight in mdp.start:
        for part in parts:
            if weight and not np.isfinite(part.high[state]):
                return Fraction(0), inf
            low += weight * Fraction(float(part.low[state]))
            high += weight * Fraction(float(part.high[state]))
    return low, high
