"""How a status vector moves: independent next statuses, summed out one at a time.

    E[x(s') | s, a] = Σ_s' x(s') Π_i p_i(s, a)^{s'_i} (1 - p_i(s, a))^{1 - s'_i}

is n folds of the vector x, each of which halves it: x(…, 0, …) + p_i (x(…, 1, …) - x(…, 0, …)).
Folding anew for each of the 2^n present vectors s takes 4^n steps. But statuses of s are decided
one by one here, and a next status is folded as soon as its chance depends on nothing undecided, so
that all vectors with the same beginning share what was folded so far. Where a chance depends on all
other statuses if its own is absent, and on none if it is present or assisted, 2 · 3^n steps are
enough: sum over the 3^n ways in which each status is decided and folded, decided and kept, or
undecided. Up to 6 statuses the law is a small matrix, made from the exact one and stored once.

That a product law is applied factor by factor is due to Yates, The design and analysis of factorial
experiments, 1937.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np

from mdp.table import EXACT_IN_FLOAT, Floats, Integers, as_float


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """How the status vector moves under R rules (actions, or the skip): apply it with `expect`.

    Attributes
    ----------
    chance : (R, 2^n, n)
        Chance of each status next.
    ready : (R, n, 2) ints
        Statuses are decided from the last to the first; after how many of them, less one, the
        chance of status i is known, where it is absent or present itself.
    dense : (2^n, R · 2^n) or (0, 0)
        The law itself, next vectors in rows, where it is small.
    error : float
        In units of roundoff: E[x] as computed is off by at most error · max |x|.
    """

    chance: Floats
    ready: Integers
    dense: Floats
    error: float

    @property
    def vectors(self) -> int:
        """2^n."""
        return int(self.chance.shape[1])

    def expect(self, x: Floats) -> Floats:
        """Return (R, 2^n) the expectation of x (2^n,) from each present vector."""
        rules = len(self.chance)
        if len(self.dense):
            total = np.zeros(rules * self.vectors)
            for following, worth in enumerate(x.tolist()):
                total += self.dense[following] * worth
            return total.reshape(rules, self.vectors)
        return np.stack([_fold(self.chance[r], self.ready[r], x) for r in range(rules)])


Expect = Callable[[Law, Floats], Floats]


def chances_of(terms: Integers, values: list[Fraction]) -> tuple[Floats, float]:
    """Return the chances (R, 2^n, n), and how many units of roundoff they may be off by."""
    shared = lcm(*(value.denominator for value in values))
    count = terms.shape[-1]
    # Numbers over a common denominator add up exactly, and each chance is rounded once.
    exact = max(abs(value) for value in values) * shared * (count + 1) < EXACT_IN_FLOAT
    one = shared if exact else 1
    numbers = np.array([as_float(value * one) for value in values] + [0.0])
    total = numbers[terms[..., 0]]
    for column in range(1, count):
        total = total + numbers[terms[..., column]]
    chance = np.minimum(total, float(one)) / float(one)
    return np.ascontiguousarray(chance.transpose(1, 0, 2)), 1.0 if exact else count + 3.0


def law_of(chance: Floats, off: float, dense: Floats) -> Law:
    rules, vectors, count = chance.shape
    ready = np.zeros((rules, count, 2), dtype=np.int64)
    for r in range(rules):
        for i in range(count):
            cube = chance[r, :, i].reshape((2,) * count)
            for present in (0, 1):
                part = cube.take([present], axis=i)
                known = count - 1 - i
                for j in range(count):
                    if j != i and (part.take(0, axis=j) != part.take(1, axis=j)).any():
                        known = max(known, count - 1 - j)
                ready[r, i, present] = known
    # A fold is off by the error of p and four roundings of numbers of at most 2 max |x|; a row of
    # the dense law is a sum of 2^n products.
    error = vectors + 3.0 if len(dense) else count * (2 * off + 6.0)
    return Law(chance=chance, ready=ready, dense=dense, error=error)


def _fold(chance: Floats, ready: Integers, x: Floats) -> Floats:
    """Return (2^n,) expectations from every present vector, by the recursion above."""
    count = chance.shape[1]
    found = np.empty(len(x))

    def visit(depth: int, state: int, x: Floats, kept: tuple[int, ...]) -> None:
        if depth == count:
            found[state] = x[0]
            return
        for present in (0, 1):
            here = state | present << depth
            y, left = x, [*kept, depth]
            for place in range(len(left) - 1, -1, -1):  # those kept longest are the last digits
                i = count - 1 - left[place]
                if ready[i, here >> left[place] & 1] <= depth:
                    halves = y.reshape(-1, 2, 2**place)
                    y = halves[:, 0] + chance[here, i] * (halves[:, 1] - halves[:, 0])
                    del left[place]
            visit(depth + 1, here, y.reshape(-1), tuple(left))

    visit(0, 0, x, ())
    return found
