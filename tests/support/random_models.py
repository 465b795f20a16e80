"""Exact models drawn from a seed, with whole numbers over small denominators."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp import MDP

PARTS = 1000  # of which drawn probabilities and rewards are whole numbers
Row = tuple[int, int, list[tuple[Fraction, int, Fraction]]]


def garnet_rows(states: int, *, rng: int, actions: int = 4, branches: int = 5) -> list[Row]:
    """Each action has some random successors and a reward in [0, 1) (Archibald et al., 1995)."""
    draw = np.random.default_rng(rng)
    ahead = [draw.choice(states, branches, replace=False) for _ in range(states * actions)]
    return _rows(draw, np.array(ahead), actions)


def dense(states: int, *, rng: int, actions: int = 4) -> MDP:
    """Every state can follow every other."""
    ahead = np.tile(np.arange(states), (states * actions, 1))
    return MDP.from_outcomes(_rows(np.random.default_rng(rng), ahead, actions), "19/20")


def _rows(draw: np.random.Generator, ahead: np.ndarray[Any, Any], actions: int) -> list[Row]:
    """The rows of pairs with these successors (L, b), in proportion to whole numbers."""
    weight, gain = draw.integers(1, PARTS, ahead.shape), draw.integers(0, PARTS, len(ahead))
    rows = []
    for pair, (nexts, weights) in enumerate(zip(ahead.tolist(), weight.tolist(), strict=True)):
        reward, total = Fraction(int(gain[pair]), PARTS), sum(weights)
        chances = [(Fraction(w, total), n, reward) for w, n in zip(weights, nexts, strict=True)]
        rows.append((pair // actions, pair % actions, chances))
    return rows
