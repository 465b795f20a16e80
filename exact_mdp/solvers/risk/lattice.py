"""The returns that an episode can still have: whole multiples of one unit, from the end back.

At discount 1, where no state comes back to itself, returns from a state s are k u for integers k
between low(s) and high(s), u the greatest unit of which all rewards are multiples,

    low(s) = min over pairs l, outcomes (p, s', k) of l:  k + low(s'),

and high(s) likewise. What minimises a risk of the return depends on the reward so far, which is a
point of this lattice as well (Bäuerle and Ott, Markov decision processes with average-value-at-risk
criteria, Mathematical Methods of Operations Research 74, 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import exact, shown
from exact_mdp.solvers.bounds.bounds import levels

CELLS = 20_000_000  # outcomes times returns


@dataclass(frozen=True, kw_only=True, eq=False)
class Lattice:
    """A model that maximises, with rewards in whole units.

    Attributes
    ----------
    mdp : MDP
    unit : Fraction
    order : list of int
        States that are not terminal, from the end on.
    pairs : list of range
        Of each state.
    rows : list of (weights, denominator, outcomes), for each of L pairs
        Outcomes (next state, k) with whole weights over one denominator.
    low, high : list of int
        Least and greatest return from each state, whatever the policy, in units.
    """

    mdp: MDP
    unit: Fraction
    order: list[int]
    pairs: list[range]
    rows: list[tuple[list[int], int, list[tuple[int, int]]]]
    low: list[int]
    high: list[int]

    @classmethod
    def of(cls, model: MDP, horizon: int | None = None) -> Lattice:
        """Return the lattice of a model; raises ModelError where returns are on none."""
        mdp = model.maximised if horizon is None else model.maximised.within(horizon)
        if mdp.discount_exact != 1:
            raise ModelError(
                f"the discount is {shown(mdp.discount_exact)}, and risks are found at discount 1",
                where="risk of the return",
                fix="choose discount 1: then the reward so far says all that matters of the past",
            )
        ends = mdp.terminal.tolist()
        if mdp.goal is not None and any(e and not g for e, g in zip(ends, mdp.goal, strict=True)):
            raise ModelError(
                "episodes may end without the goal, at an infinite cost",
                where="risk of the return",
                fix="state a model of rewards or costs, without a question of a goal",
            )
        order = levels(mdp)
        if order is None:
            raise ModelError(
                "states lead back to each other, so that returns have no end",
                where="risk of the return",
                fix="give a horizon, or a model without cycles",
            )
        live = [int(s) for s in np.argsort(order, kind="stable") if not ends[s]]
        pairs = [mdp.pairs_of(state) for state in range(mdp.n_states)]
        given = {pair: mdp.table.row(pair) for state in live for pair in pairs[state]}
        gains = {gain for row in given.values() for p, _, gain in row if p}
        below = lcm(*(gain.denominator for gain in gains))
        unit = Fraction(gcd(*(int(gain * below) for gain in gains)) or 1, below)
        rows: list[tuple[list[int], int, list[tuple[int, int]]]] = [([], 1, [])] * mdp.n_pairs
        for pair, row in given.items():
            scale = lcm(*(p.denominator for p, _, _ in row))
            used = [(p, to, gain) for p, to, gain in row if p]
            weights = [int(p * scale) for p, _, _ in used]
            rows[pair] = (weights, scale, [(to, int(gain / unit)) for _, to, gain in used])
        low, high, cells = [0] * mdp.n_states, [0] * mdp.n_states, 0
        for state in live:
            every = [outcome for pair in pairs[state] for outcome in rows[pair][2]]
            low[state] = min(k + low[to] for to, k in every)
            high[state] = max(k + high[to] for to, k in every)
            cells += len(every) * (high[state] - low[state] + 1)
        if cells > CELLS:
            raise ModelError(
                f"{cells:,} pairs of an outcome and a return, in steps of {shown(unit)}",
                where="risk of the return",
                fix=f"use a model with at most {CELLS:,}: fewer states, or rounder rewards",
            )
        return cls(mdp=mdp, unit=unit, order=live, pairs=pairs, rows=rows, low=low, high=high)


def share_of(level: object) -> Fraction:
    """Return the share of the worst episodes that counts."""
    found = exact(level)
    if not 0 < found <= 1:
        raise ModelError(
            f"the level is {shown(found)}",
            where="conditional value at risk",
            fix="choose the share of the worst episodes: above 0, at most 1",
        )
    return found


def tail_mean(
    values: Sequence[Fraction], probabilities: Sequence[Fraction], level: Fraction
) -> tuple[Fraction, Fraction]:
    """Return the mean of the worst share of a distribution (rising values), and its threshold.

    Examples
    --------
    >>> worst, threshold = tail_mean(
    ...     [Fraction(0), Fraction(4)], [Fraction(1, 4)] * 2, Fraction(1, 2)
    ... )
    >>> str(worst), str(threshold)
    ('2', '4')
    """
    left, total = level, Fraction(0)
    for value, probability in zip(values, probabilities, strict=True):
        part = min(left, probability)
        total, left = total + part * value, left - part
        if left == 0:
            return total / level, value
    raise ValueError("the probabilities do not sum to 1")
