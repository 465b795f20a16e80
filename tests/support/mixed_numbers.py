"""Numbers given in every kind there is, and the values of a model in plain fractions alone."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np

from exact_mdp.mdp import MDP

Law = tuple[int, int, list[tuple[F, int, F]]]


def kinds(value: F) -> list[Any]:
    """Return the number in every kind that holds it exactly, floats last."""
    found: list[Any] = [value, f"{value.numerator}/{value.denominator}"]
    places = next((k for k in range(12) if (value * 10**k).denominator == 1), None)
    if places is not None:
        sign, digits = "-" if value < 0 else "", str(abs(int(value * 10**places))).zfill(places + 1)
        cut = len(digits) - places
        found.append(f"{sign}{digits[:cut]}.{digits[cut:]}" if places else f"{sign}{digits}")
    if value.denominator == 1:
        found += [int(value), np.int64(int(value))]
        if abs(value) < 100:
            found.append(np.int8(int(value)))
    return found + floats(value)


def floats(value: F) -> list[Any]:
    """Return the floats, of every width, that are the number exactly."""
    wide = float(value)
    if F(wide) != value:
        return []
    found: list[Any] = [wide, np.float64(wide), np.longdouble(wide)]
    with np.errstate(over="ignore"):
        short: list[Any] = [np.float32(wide), np.float16(wide)]
    return found + [number for number in short if float(number) == wide]


def rows_of(mdp: MDP) -> list[Law]:
    """Return every row of a model as `from_outcomes` takes it."""
    pairs = zip(mdp.pair_state.tolist(), mdp.pair_action.tolist(), strict=True)
    return [(s, a, mdp.table.row(pair)) for pair, (s, a) in enumerate(pairs)]


def again(mdp: MDP) -> MDP:
    """Return the model built anew from what it tells."""
    return MDP.from_outcomes(
        rows_of(mdp), mdp.discount_exact, start=dict(mdp.start), actions=mdp.actions
    )


def optimal(rows: Sequence[Law], states: int, discount: F) -> list[F]:
    """Return the optimal values, by trying every policy in fractions."""
    offered = [[row for row in rows if row[0] == s] for s in range(states)]
    best: list[F] | None = None
    for policy in product(*offered):
        matrix = [[F(int(i == j)) for j in range(states)] for i in range(states)]
        right = [F(0)] * states
        for s, _, outcomes in policy:
            for p, t, r in outcomes:
                matrix[s][t] -= discount * p
                right[s] += p * r
        value = _solved(matrix, right)
        best = value if best is None else [max(a, b) for a, b in zip(best, value, strict=True)]
    assert best is not None
    return best


def _solved(matrix: list[list[F]], right: list[F]) -> list[F]:
    rows = [[*row, number] for row, number in zip(matrix, right, strict=True)]
    for k in range(len(rows)):
        pivot = next(i for i in range(k, len(rows)) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(len(rows)):
            if i != k and rows[i][k]:
                rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[-1] for row in rows]
