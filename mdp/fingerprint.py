"""A hash of what a model is, whatever its numbers are stored as.

SHA-256 of the canonical exact content: number of states, discount, start, state and action of every
pair, the transition matrix (outcomes with the same next state added up) and the expected rewards.
Names of states and actions, reward components and events are left out: they do not change what is
optimal. Models hash equally if and only if these exact contents are equal, so that 0.5, 1/2 and 2/4
are one and the same, and 0.1 (a dyadic rational) differs from 1/10.

Rows are encoded by their values alone: those whose numbers all are doubles, exactly, as these, so
that a large float model is hashed without touching its numbers one by one; any other as integers
over their denominator in lowest terms.
"""

from __future__ import annotations

from fractions import Fraction
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.mdp.bellman import distinct, merged, reduced
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import EXACT_IN_FLOAT, EXACT_IN_INT64, Floats, Integers, Numbers

if TYPE_CHECKING:
    from hashlib import _Hash


def fingerprint(mdp: MDP) -> str:
    """Return the SHA-256 of the model's exact content in hexadecimal.

    Examples
    --------
    >>> half = MDP.from_arrays([[[0.5, 0.5], [0, 1]]], [1.0, 0.0], discount=0.5)
    >>> same = MDP.from_arrays([[["2/4", "1/2"], [0, 1]]], [1, 0], discount="1/2")
    >>> fingerprint(half) == fingerprint(same)
    True
    """
    digest = sha256(b"exact-mdp model 1\n")
    start = sorted((state, weight) for state, weight in mdp.start if weight)
    digest.update(f"{mdp.n_states} {mdp.n_pairs} {_text(mdp.discount_exact)}\n".encode())
    digest.update(" ".join(f"{state} {_text(weight)}" for state, weight in start).encode())
    index = "<i4" if mdp.n_states < 2**31 else "<i8"
    _add(digest, mdp.pair_state, index)
    _add(digest, mdp.pair_action, "<i8")
    first, offsets = distinct(mdp.table)
    _add(digest, offsets, "<i8")
    if mdp.table.weight.dtype == np.float64 and len(first) == len(mdp.table.next):
        _add(digest, mdp.table.next, index)
        _add_floats(digest, mdp.table.weight, mdp.n_pairs)
    else:
        _, following, weight, denominator = merged(mdp.table)
        _add(digest, following, index)
        _add_rationals(digest, weight, denominator, offsets)
    if mdp.table.gain.dtype == np.float64 and len(mdp.table.gain) == mdp.n_pairs:
        _add_floats(digest, mdp.table.gain, mdp.n_pairs)
    else:
        gain = reduced(*mdp.table.expected_gain_exact())
        _add_rationals(digest, *gain, np.arange(mdp.n_pairs + 1))
    return digest.hexdigest()


def _add(digest: _Hash, values: Numbers, kind: str) -> None:
    digest.update(f"\n{len(values)}:".encode())
    digest.update(np.ascontiguousarray(values, dtype=kind).data)


def _add_floats(digest: _Hash, values: Numbers, rows: int) -> None:
    """Add rows of doubles as `_add_rationals` would."""
    _add(digest, np.zeros(rows, dtype=bool), "?")
    _add(digest, values + 0.0, "<f8")  # -0.0 becomes 0.0


def _add_rationals(digest: _Hash, top: Numbers, bottom: Numbers, offsets: Integers) -> None:
    """Add rows in lowest terms: top (M,) over bottom (L,), rows beginning at `offsets`."""
    lengths = np.diff(offsets)
    floats = _doubles(top, np.repeat(bottom, lengths))
    others = ~np.logical_and.reduceat(np.isfinite(floats), offsets[:-1])
    inside = np.repeat(others, lengths)
    _add(digest, others, "?")
    _add(digest, floats[~inside], "<f8")
    if not others.any():
        return
    for values in (top[inside], bottom[others]):
        large = np.abs(values) >= EXACT_IN_INT64
        _add(digest, np.where(large, 0, values), "<i8")
        digest.update(" ".join(f"{value:x}" for value in values[large]).encode())


def _doubles(top: Numbers, bottom: Numbers) -> Floats:
    """Return the doubles that equal top / bottom, an infinity where none does."""
    if top.dtype == object or bottom.dtype == object:
        return np.array([_double(int(a), int(b)) for a, b in zip(top, bottom, strict=True)])
    dyadic = (bottom & (bottom - 1)) == 0
    odd = np.abs(top) // np.maximum(top & -top, 1)
    return np.where(dyadic & (odd < EXACT_IN_FLOAT), top / bottom, np.inf)


def _double(top: int, bottom: int) -> float:
    try:
        rounded = top / bottom
    except OverflowError:
        return np.inf
    over, under = rounded.as_integer_ratio()
    return rounded if over * bottom == top * under else np.inf


def _text(value: Fraction) -> str:
    return f"{value.numerator:x}/{value.denominator:x}"
