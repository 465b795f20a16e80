"""Sparse rows of rationals, a row for each (state, action) pair."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from exact_mdp.analysis.sensitivity.exact_chain import rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.row_change import Entries
from exact_mdp.mdp.table import Integers, Numbers

if TYPE_CHECKING:
    from flint import fmpq


def by_pair(entries: Entries, states: int, pairs: int) -> list[list[tuple[int, fmpq]]]:
    """Return each pair's entries, (state, number); keys are pair · states + state."""
    rows: list[list[tuple[int, fmpq]]] = [[] for _ in range(pairs)]
    key, top, bottom = entries
    for number, a, b in zip(key.tolist(), top, bottom, strict=True):
        rows[number // states].append((number % states, rational(Fraction(int(a), int(b)))))
    return rows


def by_pair_slopes(key: Integers, slope: Numbers, mdp: MDP) -> dict[int, list[tuple[int, fmpq]]]:
    """Return the entries of the pairs that have any; keys as above."""
    rows: dict[int, list[tuple[int, fmpq]]] = {}
    for number, each in zip(key.tolist(), slope, strict=True):
        pair, state = divmod(number, mdp.n_states)
        rows.setdefault(pair, []).append((state, rational(each)))
    return rows


def dot(row: Sequence[tuple[int, fmpq]], value: Sequence[fmpq]) -> fmpq:
    """Return Σ_s' a(s') x(s') of a row's entries.

    Examples
    --------
    >>> dot([(1, rational(2))], [rational(5), rational(7)])
    14
    """
    return sum((amount * value[state] for state, amount in row), rational(0))


def worth(uses: Sequence[fmpq], earned: dict[int, fmpq]) -> fmpq:
    """Return Σ_l d(l) c(l) of what some pairs earn."""
    return sum((uses[pair] * gain for pair, gain in earned.items()), rational(0))
