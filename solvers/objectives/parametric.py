"""All policies that are optimal for two objectives at some weights, by parametric simplex.

From a policy that is optimal for weights (t, 1 - t), with t within, the chain of `.switches` is
followed up to t = 1 and down to 0: the pair whose loss is 0 next is taken (Gass and Saaty, Naval
Research Logistics Quarterly 2, 1955). Its t is as precise as the values in fixed point are, so that
a step takes products of short integers, whatever the length of the exact fractions. Where no number
of bits tells signs, as where pairs tie that do not move alike, there is no answer.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.fixed_point import UNKNOWN, FixedPoint, bounds_errors
from exact_mdp.solvers.objectives.optima import proposed
from exact_mdp.solvers.objectives.switches import Bracket, Chain, optimal_between, shares
from exact_mdp.solvers.solution import SolverError

MIDDLE = Fraction(1_000_003, 2**21)  # where to begin: at no ratio of small numbers
NEAR = 1e-9  # floats that differ by less are compared as fractions
PLACES = 64  # bits of the bounds on totals

Step = tuple[int, int, Bracket, tuple[Bracket, ...]]  # left, taken, where, and totals from there on


def chain_of(of: Objectives) -> Chain | None:
    """Return the policies that are optimal for some weights; None where signs do not tell."""
    try:
        weight = _weights(of)
        if weight is None:
            return None
        pairs = proposed(of, [MIDDLE, 1 - MIDDLE], of.mdp.pair_offsets[:-1].copy())
        up, down = (_followed(FixedPoint(of, weight, pairs), upward=u) for u in (True, False))
    except (OverflowError, RuntimeError, SolverError):  # beyond the floats, or singular in them
        return None
    if up is None or down is None:
        return None
    first = pairs.copy()
    for _, taken, _, _ in down[1:]:
        first[of.mdp.pair_state[taken]] = taken
    back = down[:0:-1]
    return Chain(
        first=first,
        switches=(*(left for left, _, _, _ in back), *(taken for _, taken, _, _ in up[1:])),
        brackets=(*(where for _, _, where, _ in back), *(where for _, _, where, _ in up[1:])),
        totals=(*(totals for _, _, _, totals in back), *(totals for _, _, _, totals in up)),
        weight=tuple(weight.tolist()),
    )


def _weights(of: Objectives) -> Numbers | None:
    """Return weights that bound errors: 1, or about the greatest expected number of steps."""
    ones = np.ones(of.mdp.n_states, dtype=object)
    if bounds_errors(of, ones):
        return ones
    steps = np.rint(2.0**20 * margin_weights(of.ending).value)
    weight = np.array([int(number) for number in steps], dtype=object)
    return weight if bounds_errors(of, weight) else None


def _followed(fixed: FixedPoint, *, upward: bool) -> list[Step] | None:
    """Return the steps from MIDDLE to the end of the weights, the first of which is none."""
    found: list[Step] = [(-1, -1, (MIDDLE, MIDDLE), _rounded(fixed))]
    end = Fraction(int(upward))
    before: int | None = None
    while True:
        here = found[-1][2]
        while True:
            step = _next(fixed, end, upward)
            if step is not None:
                taken, where = step
                low, high = (here, where) if upward else (where, here)
                at = (before, taken) if upward else (taken, before)
                if optimal_between(fixed, low, high, *at):
                    break
            if not fixed.sharpen():
                return None
        if taken is None:
            return found
        before = int(fixed.pairs[fixed.of.mdp.pair_state[taken]])
        fixed.switch(taken)
        found.append((before, taken, where, _rounded(fixed)))


def _next(fixed: FixedPoint, end: Fraction, upward: bool) -> tuple[int | None, Bracket] | None:
    """Return the pair that loses nothing next, and where; no pair, and the end, where none does.

    None where signs do not tell.
    """
    signs = fixed.signs(shares(end))
    if (signs == UNKNOWN).any():
        return None
    falling = np.flatnonzero(signs == -1)
    if not len(falling):
        return None, (end, end)
    pair, t = _nearest(fixed.losses(), falling, upward)
    if fixed.known[pair]:
        return pair, (t, t)
    unit = 1 << fixed.bits // 2
    floor = t.numerator * unit // t.denominator
    return (
        (pair, (Fraction(floor - 1, unit), Fraction(floor + 2, unit)))
        if 1 < floor < unit - 2
        else None
    )


def _nearest(losses: list[Numbers], falling: Integers, upward: bool) -> tuple[int, Fraction]:
    """Return the pair whose loss is 0 first, and the t at which it is."""
    first, second = (loss[falling] for loss in losses)
    spare = max(0, max(int(x).bit_length() for x in (*first, *second)) - 900)
    a, b = ((loss >> spare).astype(np.float64) for loss in (first, second))
    with np.errstate(all="ignore"):
        about = b / (b - a)
    best = about.min() + NEAR if upward else about.max() - NEAR
    near = np.flatnonzero(about <= best if upward else about >= best)
    exact = [(Fraction(int(second[i]), int(second[i] - first[i])), int(falling[i])) for i in near]
    t, pair = min(exact) if upward else max(exact)
    return pair, t


def _rounded(fixed: FixedPoint) -> tuple[Bracket, ...]:
    """Return bounds on the totals, a little wider and of few digits."""
    unit = 1 << PLACES
    return tuple(
        (Fraction((low * unit).__floor__() - 1, unit), Fraction((high * unit).__ceil__() + 1, unit))
        for low, high in fixed.totals()
    )
