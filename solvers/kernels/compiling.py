"""How the loops are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

_njit: Any = numba.njit

# Arrays are made by the callers: without reference counts the loops run twice as fast.
OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False}


def compiled(function: Callable[..., Any]) -> Any:
    """Compile when first called; keep the machine code where there is a place to keep it."""
    try:
        return _njit(cache=True, **OPTIONS)(function)
    except RuntimeError:  # numba found no folder that it may write to
        return _njit(**OPTIONS)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile as a part of whatever calls it."""
    return _njit(forceinline=True, **OPTIONS)(function)
