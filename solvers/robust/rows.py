"""Rows of outcomes side by side, so that one call of NumPy asks nature about all of them.

A row of pair l has outcomes i with nominal probability p_i, next state s_i and reward g_i, and is
worth Σ q_i x_i under another law q, x_i = g_i + γ V(s_i). Rows of about the same length are put in
one block (K, n), n a power of two; a row that is shorter is filled up with copies of its first
outcome of probability 0, which are worth the same and so change nothing.

Outcomes, not next states, are what nature weighs: two outcomes may lead to one state with different
rewards. Rows of floats, whose sums are 1 only nearly, count divided by their sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma

ROOM = 2**22  # outcomes in one block


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """K rows of n outcomes.

    Attributes
    ----------
    place : (K,) int64
        Positions of the rows among the pairs that were asked for.
    pair : (K,) int64
    outcome : (K, n) int64
        Numbers of the outcomes in the model's table.
    filled : (K, n) bool
        True where a copy of the first outcome stands in.
    next, probability, gain : (K, n)
    largest : (K,)
        The greatest |gain| of each row.
    """

    place: Integers
    pair: Integers
    outcome: Integers
    filled: NDArray[np.bool_]
    next: Integers
    probability: Floats
    gain: Floats
    largest: Floats


class Ambiguity(Protocol):
    """A set of laws for each row, chosen from independently: (s, a)-rectangular uncertainty."""

    def least(self, block: Block, payoff: Floats) -> tuple[Floats, Floats]:
        """Return laws q (K, n) and b (K,): q in the set, and no member has Σ q x below Σ q x - b.

        Both hold up to rounding, which `inner` accounts for.
        """

    def check(self, mdp: MDP) -> None:
        """Raise ModelError where this is not a set of laws for the rows of `mdp`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Inner:
    """What nature makes of rows: its optimum lies in [low, high], and q gives about `value`.

    Attributes
    ----------
    low, high, value : (U,)
    laws : list of (K, n), one for each block
    """

    low: Floats
    high: Floats
    value: Floats
    laws: list[Floats]


def blocks_of(mdp: MDP, pairs: Integers) -> list[Block]:
    """Return the rows of some pairs (U,), in blocks.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]], [1, 0, 0])
    >>> [block.next.tolist() for block in blocks_of(mdp, np.arange(3))]
    [[[1], [2]], [[0, 1, 2, 0]]]
    """
    table = mdp.table
    probability, gain = table.probabilities(), table.gains()
    start, length = table.offsets[pairs], np.diff(table.offsets)[pairs]
    width = 2 ** np.ceil(np.log2(length)).astype(np.int64)
    found = []
    for n in np.unique(width).tolist():
        rows = np.flatnonzero(width == n)
        for first in range(0, len(rows), max(1, ROOM // n)):
            place = rows[first : first + max(1, ROOM // n)]
            column = np.arange(n)
            filled = column >= length[place][:, None]
            outcome = start[place][:, None] + np.where(filled, 0, column)
            p = np.where(filled, 0.0, probability[outcome])
            found.append(
                Block(
                    place=place,
                    pair=np.asarray(pairs[place]),
                    outcome=outcome,
                    filled=filled,
                    next=table.next[outcome],
                    probability=p / p.sum(axis=1, keepdims=True),
                    gain=gain[outcome],
                    largest=np.abs(gain[outcome]).max(axis=1),
                )
            )
    return found


def inner(
    ambiguity: Ambiguity,
    blocks: Sequence[Block],
    value: Floats,
    *,
    discount: float,
    against: bool,
    rewards: bool = True,
) -> Inner:
    """Return what each row is worth once nature has chosen its law.

    Parameters
    ----------
    value : (S,)
    against : bool
        True where nature makes rows worth as little as it can, False where as much.
    rewards : bool
        False leaves the gains out.

    Examples
    --------
    >>> from exact_mdp.solvers.robust.sets import L1Ball
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> found = inner(
    ...     L1Ball(radius=0.5),
    ...     blocks_of(mdp, np.arange(1)),
    ...     np.array([0.0, 8.0]),
    ...     discount=1.0,
    ...     against=True,
    ... )
    >>> found.value.tolist(), found.laws[0].tolist()
    ([3.0], [[0.75, 0.25]])
    """
    count = sum(len(block.place) for block in blocks)
    low, high, middle = np.empty(count), np.empty(count), np.empty(count)
    laws = []
    for block in blocks:
        later = value[block.next]
        payoff = discount * later
        size = np.abs(payoff).max(axis=1)
        if rewards:
            payoff += block.gain
            size += block.largest
        q, short = ambiguity.least(block, payoff if against else -payoff)
        base = payoff[:, :1]
        worth = base[:, 0] + np.einsum("kn,kn->k", q, payoff - base)
        n = payoff.shape[1]
        # A payoff is rounded four times; the mass of a law misses the set by (2 n + 6) units, over
        # payoffs that are up to twice `size` apart; the sum is rounded n times.
        error = (float(gamma(8 * n + 32)) * size + TINY * n * (size > 0)) * SLACK
        low[block.place] = worth - error - (short if against else 0.0)
        high[block.place] = worth + error + (0.0 if against else short)
        middle[block.place] = worth
        laws.append(q)
    return Inner(low=low, high=high, value=middle, laws=laws)


def entries(
    blocks: Sequence[Block], laws: Sequence[Floats], chosen: NDArray[np.bool_] | None = None
) -> tuple[Integers, Integers, Floats, Floats]:
    """Return the laws as a list: place, next state, probability and expected gain of the row.

    Parameters
    ----------
    chosen : (U,) bool, optional
        Only these places.

    Returns
    -------
    place, next, probability : (N,)
    earned : (U,)
        Expected gain under the law, by place; 0 in places left out.
    """
    count = sum(len(block.place) for block in blocks)
    earned = np.zeros(count)
    nothing: Integers = np.zeros(0, dtype=np.int64)
    place, following, weight = [nothing], [nothing], [np.zeros(0)]
    for block, q in zip(blocks, laws, strict=True):
        kept = slice(None) if chosen is None else chosen[block.place]
        used, law = block.place[kept], q[kept]
        earned[used] = np.einsum("kn,kn->k", law, block.gain[kept])
        positive = law > 0
        place.append(np.repeat(used, positive.sum(axis=1)))
        following.append(block.next[kept][positive])
        weight.append(law[positive])
    return np.concatenate(place), np.concatenate(following), np.concatenate(weight), earned
