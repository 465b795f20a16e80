"""Where factors may have entries, by elimination of a dense pattern."""

from __future__ import annotations

import numpy as np


def factor_pattern(pattern: np.ndarray) -> np.ndarray:
    """Return (S, S) where factors of a dense pattern and its mirror image may have entries."""
    found: np.ndarray = pattern | pattern.T
    for pivot in range(len(found)):
        later = np.flatnonzero(found[pivot, pivot + 1 :]) + pivot + 1
        found[np.ix_(later, later)] = True
    return found
