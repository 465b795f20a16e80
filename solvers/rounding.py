"""Rounding errors of double precision, bounded in advance.

A sum of n products, in any order, each number rounded a few times before, is off by at most

    γ(n + few) Σ |p| |x|,   γ(n) = n u / (1 - n u),   u = 2⁻⁵³

as long as nothing underflows; what does costs at most TINY for each term (Higham, Accuracy and
Stability of Numerical Algorithms, SIAM 2002, sections 3.1 and 3.4). Bounds are themselves computed
in double precision, so `SLACK` enlarges each of them by more than that can cost: a bound is a sum
of nonnegative terms, and these keep a relative error of at most γ(n + few).
"""

from __future__ import annotations

import numpy as np

from mdp.table import Floats, Integers

UNIT = 2.0**-53
TINY = 2.0**-1000
SLACK = 1 + 2.0**-20


def gamma(terms: Integers | int) -> Floats:
    """Return γ(n), a little more than n units of roundoff.

    Examples
    --------
    >>> float(gamma(1)) > 2**-53
    True
    """
    count = np.asarray(terms, dtype=np.float64) * UNIT
    return np.asarray(count / (1 - count) * (1 + 4 * UNIT))
