"""Frozen dataclasses that keep what they have computed, and are copied without it."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np


class ByFields:
    """A dataclass that is copied and pickled by its fields only; arrays stay read-only."""

    def __getstate__(self) -> dict[str, Any]:
        parts: Any = self
        return {part.name: getattr(self, part.name) for part in fields(parts)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)
