"""How the loops are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

_njit: Any = numba.njit

# Arrays are made by the callers: without reference counts the loops run twice as fast.
OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False}


def compile_loop(function: Callable[..., Any], **options: Any) -> Any:
    """Compile when first called; keep the machine code where there is a place to keep it."""
    try:
        return _njit(cache=True, **OPTIONS, **options)(function)
    except RuntimeError:  # numba found no folder that it may write to
        return _njit(**OPTIONS, **options)(function)


def inline_loop(function: Callable[..., Any], **options: Any) -> Any:
    """Compile as a part of whatever calls it."""
    return _njit(forceinline=True, **OPTIONS, **options)(function)


# Python's indices may be negative, and each look-up asks; of unsigned numbers it need not, which
# halves the time of a loop over transitions. They do not mix with signed ones: nothing is to be
# added to them.


@inline_loop
def unsigned_range(first: int, last: int) -> range:
    """Return range(first, last), for numbers that are not negative."""
    return range(np.uint64(first), np.uint64(last))


@inline_loop
def unsigned_index(place: int) -> Any:
    """Return a place in an array, which is not negative."""
    return np.uint64(place)
