"""Pieces of work to be done elsewhere, and what they must give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import SeedSequence, default_rng

from exact_mdp import ModelError

KEY = {"model": "normal draws", "seed": 0}


def draws(seed: int, index: int) -> dict[str, Any]:
    """One piece: random numbers of its own child of the seed."""
    rng = default_rng(SeedSequence(seed, spawn_key=(index,)))
    return {"x": rng.normal(size=50), "count": np.int64(index)}


def failing(index: int) -> dict[str, Any]:
    if index == 2:
        raise ModelError("piece 2 cannot be done", where="here", fix="leave it out")
    return {"x": np.zeros(1)}


def same(found: list[dict[str, Any]], wanted: list[dict[str, Any]]) -> bool:
    return len(found) == len(wanted) and all(
        list(a) == list(b) and all(a[name].tobytes() == b[name].tobytes() for name in a)
        for a, b in zip(found, wanted, strict=True)
    )


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of every file below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


WANTED = [
    {name: np.asarray(value) for name, value in draws(0, index).items()} for index in range(12)
]
