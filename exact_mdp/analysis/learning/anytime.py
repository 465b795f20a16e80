"""An interval for a share that holds at every moment, so that one may look, and stop, at any time.

Of n independent trials k succeeded and m did not. If p is the chance of success, whoever bets
against it, with stakes that follow the trials so far, has after n trials

    E_n(p) = ∫ q^k (1 - q)^m dBeta(1/2, 1/2)(q) / (p^k (1 - p)^m)
           = C(2k, k) C(2m, m) / (4^n C(n, k)) / (p^k (1 - p)^m)

times what was there at first: E_n(p) is a martingale of mean 1. So P(E_n(p) ≥ 1/α at some n) ≤ α
(Ville, Étude critique de la notion de collectif, 1939), and all p with E_n(p) < 1/α so far are an
interval that holds at all n together with probability 1 - α (Robbins, Annals of Mathematical
Statistics 41, 1970). An interval for a fixed n, looked at after each trial, misses the truth sooner
or later. All is worked out in integers: no rounding decides what is excluded.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from fractions import Fraction
from math import comb, log, log1p, pi

from scipy import special

GRID = 2**20  # ends of intervals are multiples of 1 / GRID, outwards
FEW, MOST = 1000, 2**62  # trials


def excluded(share: Fraction, hits: int, misses: int, alpha: Fraction) -> bool:
    """Return whether E_n(share) ≥ 1/α after so many trials."""
    top, below, n = share.numerator, share.denominator, hits + misses
    won = comb(2 * hits, hits) * comb(2 * misses, misses) * below**n * alpha.numerator
    fair = comb(n, hits) * 4**n * top**hits * (below - top) ** misses * alpha.denominator
    return bool(won >= fair)


def fewest(share: Fraction, alpha: Fraction) -> int:
    """Return the least number of misses, without a hit, that exclude a share below 1.

    E_n(p) falls and then rises in the number of misses, so that it is found by bisection; in
    logarithms where a small share needs thousands.
    """
    if share == 1:
        return 1

    def excludes(misses: int) -> bool:
        if misses < FEW:
            return excluded(share, 0, misses, alpha)
        mixed = special.betaln(misses + 0.5, 0.5) - log(pi)  # C(2m, m) / 4^m
        return bool(mixed - misses * log1p(-float(share)) >= -log(alpha))

    return bisect_left(range(MOST), True, key=excludes)


def share_intervals(trials: Iterable[bool], alpha: Fraction) -> Iterator[tuple[Fraction, Fraction]]:
    """Yield after each trial an interval of the chance of success.

    All of them together hold with probability 1 - α; they only narrow.
    """
    low = high = hits = misses = 0
    for trial in trials:
        hits, misses = hits + bool(trial), misses + (not trial)
        low = _raised(low, hits, misses, alpha)
        high = min(GRID - low, _raised(high, misses, hits, alpha))  # from 1 downwards
        yield Fraction(low, GRID), Fraction(GRID - high, GRID)


def _raised(known: int, hits: int, misses: int, alpha: Fraction) -> int:
    """Return the greatest number on the grid that is excluded from below, `known` at least."""
    above = hits * GRID // (hits + misses) + 1  # beyond the share seen, which never is excluded
    if known + 1 >= above or not excluded(Fraction(known + 1, GRID), hits, misses, alpha):
        return known
    while above - known > 1:
        middle = (known + above) // 2
        if excluded(Fraction(middle, GRID), hits, misses, alpha):
            known = middle
        else:
            above = middle
    return known
