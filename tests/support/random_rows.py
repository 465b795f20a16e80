"""Random rows for `MDP.from_outcomes`, with exact probabilities and small rewards."""

from collections.abc import Iterator
from fractions import Fraction as F
from typing import Any

import numpy as np
from oracle import Row, rows_of

from exact_mdp import MDP


def random_rows(rng: np.random.Generator, *, size: int, end: bool, ends: bool = False) -> list[Any]:
    """Rows of random pairs: with an end in the last state, which each pair may lead to (`ends`)."""
    rows = list[Any]()
    for s in range(size - end):
        for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
            targets = {*rng.integers(0, size, rng.integers(1, 3)).tolist()}
            targets |= {size - 1} if ends else {*()}
            weights = rng.integers(1, 4, len(targets)).tolist()
            reward = int(rng.integers(-2, 3))
            each = zip(weights, sorted(targets), strict=True)
            rows.append((s, a, [(F(w, sum(weights)), t, reward) for w, t in each]))
    return [*rows, (size - 1, 0, [(1, size - 1, 0)])] if end else rows


def maximised(mdp: MDP) -> list[Row]:
    sign = 1 if mdp.sense == "max" else -1
    return [(s, a, sign * r, law) for s, a, r, law in rows_of(mdp)]


def ending_models(seed: int) -> Iterator[MDP]:
    """Models of both senses and several discounts in which every policy ends."""
    rng = np.random.default_rng(seed)
    for rate in ("0", "1/2", "9/10", "1") * 10:
        for sense in ("max", "min"):
            rows = random_rows(rng, size=int(rng.integers(2, 6)), end=True, ends=True)
            yield MDP.from_outcomes(rows, rate, sense=sense)
