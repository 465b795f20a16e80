"""Compilation of loops with Numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

_njit: Any = numba.njit

# Callers allocate all arrays, so Numba's reference counts are off: loops run twice as fast.
OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False}


def compile_loop(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function at its first call, and cache the machine code if a folder is writable."""
    try:
        return _njit(cache=True, **OPTIONS, **options)(function)
    except RuntimeError:  # numba found no folder that it may write to
        return _njit(**OPTIONS, **options)(function)


def inline_loop(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function as a part of its callers."""
    return _njit(forceinline=True, **OPTIONS, **options)(function)


# Python allows negative indices, and Numba tests the sign at each access. With unsigned indices it
# does not, which halves the time of a loop over transitions. Do not add signed numbers to unsigned
# indices: the sum would be a float.


@inline_loop
def unsigned_range(first: int, last: int) -> range:
    """Return range(first, last) of unsigned numbers."""
    return range(np.uint64(first), np.uint64(last))


@inline_loop
def unsigned_index(place: int) -> Any:
    """Return an index as an unsigned number."""
    return np.uint64(place)
