"""The Bellman equations in integers, for exact solving and exact checking.

For every pair l of state s, with the discount already in the weights,

    scale(s) · Q(l) = constant(l) + Σ_i weight(i) · V(next(i))

where all numbers are integers, scale(s) > 0 and weight(i) > 0. Outcomes that lead to the same state
are added up. All pairs of a state share the state's scale, so that their right sides are compared
as they are. Numbers are 64-bit integers where they fit and Python integers where they do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers, OutcomeTable, magnitude, multiply


@dataclass(frozen=True, kw_only=True, eq=False)
class BellmanRows:
    """Integer Bellman equations of a model with S states, L pairs and M transitions.

    Attributes
    ----------
    pair_offsets : (S+1,) int64
        Pairs of state s are pair_offsets[s] … pair_offsets[s+1]-1.
    terminal : (S,) bool
        States worth 0 because nothing happens there any more.
    scale : (S,)
        What the equations of a state are multiplied by to be in integers.
    constant : (L,)
        Expected reward times scale.
    offsets : (L+1,) int64
        Transitions of pair l are offsets[l] … offsets[l+1]-1, sorted by next state.
    next, weight : (M,)
        Next states; discounted probabilities times scale.
    """

    pair_offsets: Integers
    terminal: NDArray[np.bool_]
    scale: Numbers
    constant: Numbers
    offsets: Integers
    next: Numbers
    weight: Numbers

    @property
    def pair_state(self) -> Integers:
        """(L,) the state of each pair."""
        return np.repeat(np.arange(len(self.scale)), np.diff(self.pair_offsets))

    @property
    def pair(self) -> Integers:
        """(M,) the pair of each transition."""
        return np.repeat(np.arange(len(self.constant)), np.diff(self.offsets))

    def slack(self) -> Numbers:
        """Return (L,) scale less the sum of weights: positive where γ times the row sum is < 1."""
        return np.asarray(self.scale[self.pair_state] - row_sums(self.weight, self.offsets))


def bellman_rows(mdp: MDP) -> BellmanRows:
    """Return the Bellman equations of a model in integers.

    Examples
    --------
    >>> mdp = MDP.from_outcomes(
    ...     [(0, 0, [("1/3", 0, "1/2"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])], "9/10"
    ... )
    >>> rows = bellman_rows(mdp)  # 30 V(0) = 5 + 9 V(0) + 18 V(1), 10 V(1) = 9 V(1)
    >>> rows.scale.tolist(), rows.constant.tolist(), rows.weight.tolist()
    ([30, 10], [5, 0], [9, 18, 9])
    """
    offsets, following, weight, denominator = merged(mdp.table)
    gain, gain_denominator = reduced(*mdp.table.expected_gain_exact())
    over, under = mdp.discount_exact.numerator, mdp.discount_exact.denominator
    bottom = multiply(denominator, _integer(under))
    scale = _lcm(bottom, gain_denominator)
    state_scale = _lcm_by_group(scale, mdp.pair_offsets)
    scale = state_scale[mdp.pair_state]
    factor = multiply(scale // bottom, _integer(over))
    lengths = np.diff(offsets)
    if over == 0:
        offsets, following, weight = np.zeros_like(offsets), following[:0], weight[:0]
    else:
        weight = multiply(weight, np.repeat(factor, lengths))
    return BellmanRows(
        pair_offsets=mdp.pair_offsets,
        terminal=mdp.terminal,
        scale=state_scale,
        constant=multiply(gain, scale // gain_denominator),
        offsets=offsets,
        next=following,
        weight=weight,
    )


def merged(table: OutcomeTable) -> tuple[Integers, Numbers, Numbers, Numbers]:
    """Return the exact (L, S) transition matrix in lowest terms, row by row.

    Returns
    -------
    offsets, next, weight, denominator : (L+1,), (M,), (M,), (L,)
        Pair l leads to next[i] with probability weight[i] / denominator[l].
    """
    weight, denominator = table.integer_weights()
    first, offsets = distinct(table)
    following = table.next
    if len(first) < len(following):
        weight, following = np.asarray(np.add.reduceat(weight, first)), following[first]
    shared = np.gcd(np.gcd.reduceat(weight, offsets[:-1]), denominator)
    return offsets, following, weight // np.repeat(shared, np.diff(offsets)), denominator // shared


def distinct(table: OutcomeTable) -> tuple[Integers, Integers]:
    """Return where runs of outcomes to the same next state begin, and each pair's first run."""
    fresh = np.empty(len(table.next), dtype=bool)
    fresh[1:] = table.next[1:] != table.next[:-1]
    fresh[table.offsets[:-1]] = True
    first = np.flatnonzero(fresh)
    return first, np.searchsorted(first, table.offsets).astype(np.int64)


def reduced(top: Numbers, bottom: Numbers) -> tuple[Numbers, Numbers]:
    """Return the fractions top / bottom in lowest terms, elementwise."""
    shared = np.gcd(top, bottom)
    return np.asarray(top // shared), np.asarray(bottom // shared)


def row_sums(values: Numbers, offsets: Integers) -> Numbers:
    """Return (L,) exact sums of integers over the rows that `offsets` delimits, empty ones too."""
    lengths = np.diff(offsets)
    if magnitude(values) * int(lengths.max(initial=0)) >= 2**62:
        values = values.astype(object)
    sums = np.zeros(len(lengths), dtype=values.dtype)
    filled = lengths > 0
    if filled.any():
        sums[filled] = np.add.reduceat(values, offsets[:-1][filled])
    return sums


def _integer(value: int) -> Numbers:
    return np.array(value, dtype=np.int64 if abs(value) < 2**62 else object)


def _lcm(left: Numbers, right: Numbers) -> Numbers:
    return multiply(left // np.gcd(left, right), right)


def _lcm_by_group(values: Numbers, offsets: Integers) -> Numbers:
    """Return the least common multiples of groups of positive integers, none of them empty."""
    found = np.asarray(np.lcm.reduceat(values, offsets[:-1]))
    if values.dtype != object:
        # a 64-bit product that overflowed is no multiple of all its factors, or is one all the same
        safe = bool((found > 0).all())
        if not safe or (np.repeat(found, np.diff(offsets)) % values).any():
            return _lcm_by_group(values.astype(object), offsets)
    return found
