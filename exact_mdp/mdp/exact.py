"""What a model is exactly, in integers: its Bellman equations, and a hash of its content.

For every pair l of state s, with the discount already in the weights,

    scale(s) · Q(l) = constant(l) + Σ_i weight(i) · V(next(i))

where all numbers are integers, scale(s) > 0 and weight(i) > 0. Outcomes that lead to the same state
are added up. All pairs of a state share the state's scale, so that their right sides are compared
as they are. Numbers are 64-bit integers where they fit and Python integers where they do not.

The hash is SHA-256 of the number of states, discount, start, state and action of every pair, the
transition matrix (outcomes with the same next state added up), the expected rewards, and of the
sense and the goal where rewards are costs or a goal has to be reached. Names of states and actions,
labels, reward components and events are left out: they do not change what is optimal. Models hash
equally if and only if these exact contents are equal, so that 0.5, 1/2 and 2/4 are one and the
same, and so are a row of 0.1 ten times and one of 1/10. Rows are encoded by their values alone:
those that a row of doubles means (`mdp.rows`) as these doubles, so that a large float model is
hashed without touching its numbers one by one; any other as integers over their denominator in
lowest terms. A reward of 0.1 (a dyadic rational) differs from 1/10.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.rows import in_floats
from exact_mdp.mdp.table import (
    EXACT_IN_FLOAT,
    EXACT_IN_INT64,
    Floats,
    Integers,
    Numbers,
    distinct,
    magnitude,
    merged,
    multiply,
    reduced,
    spans,
)

if TYPE_CHECKING:
    from hashlib import _Hash


@dataclass(frozen=True, kw_only=True, eq=False)
class BellmanRows:
    """Integer Bellman equations of a model with S states, L pairs and M transitions.

    Attributes
    ----------
    pair_offsets : (S+1,) int64
        Pairs of state s are pair_offsets[s] … pair_offsets[s+1]-1.
    terminal : (S,) bool
        States with the value 0, because nothing happens there any more.
    scale : (S,)
        What the equations of a state are multiplied by to be in integers.
    constant : (L,)
        Expected reward times scale.
    offsets : (L+1,) int64
        Transitions of pair l are offsets[l] … offsets[l+1]-1, sorted by next state.
    next, weight : (M,)
        Next states; discounted probabilities times scale.
    """

    pair_offsets: Integers
    terminal: NDArray[np.bool_]
    scale: Numbers
    constant: Numbers
    offsets: Integers
    next: Numbers
    weight: Numbers

    @cached_property
    def pair_state(self) -> Integers:
        """(L,) the state of each pair."""
        return np.repeat(np.arange(len(self.scale)), np.diff(self.pair_offsets))

    @cached_property
    def pair(self) -> Integers:
        """(M,) the pair of each transition."""
        return np.repeat(np.arange(len(self.constant)), np.diff(self.offsets))

    def of_pairs(self, pairs: Integers) -> BellmanRows:
        """Return the equations of the policy that takes `pairs` (S,), one of each state."""
        first, last = self.offsets[pairs], self.offsets[pairs + 1]
        entries = spans(first, last)
        return replace(
            self,
            pair_offsets=np.arange(len(self.scale) + 1),
            constant=self.constant[pairs],
            offsets=np.concatenate([[0], np.cumsum(last - first)]),
            next=self.next[entries],
            weight=self.weight[entries],
        )


def bellman_rows(model: MDP, pairs: Integers | None = None) -> BellmanRows:
    """Return the Bellman equations of a model in integers.

    With `pairs`, (K,) rising numbers with one of each state at least, they are those of these
    pairs, over the scale that these need. Those of all pairs are made once for each model.
    """
    if pairs is None or len(pairs) == model.n_pairs:
        if model not in _ROWS:
            _ROWS[model] = _bellman_rows(model, None)
            for array in vars(_ROWS[model]).values():
                array.setflags(write=False)  # all callers have the same
        return _ROWS[model]
    return _bellman_rows(model, pairs)


_ROWS: WeakKeyDictionary[MDP, BellmanRows] = WeakKeyDictionary()


def _bellman_rows(model: MDP, pairs: Integers | None) -> BellmanRows:
    table, pair_offsets, pair_state = model.table, model.pair_offsets, model.pair_state
    if pairs is not None:
        table, pair_state = table.of_pairs(pairs), pair_state[pairs]
        pair_offsets = np.searchsorted(pairs, pair_offsets)
    offsets, following, weight, denominator = merged(table)
    gain, gain_denominator = reduced(*table.expected_gain_exact())
    over, under = model.discount_exact.numerator, model.discount_exact.denominator
    bottom = multiply(denominator, _integer(under))
    scale = multiply(bottom // np.gcd(bottom, gain_denominator), gain_denominator)
    state_scale = lcm_by_group(scale, pair_offsets)
    scale = state_scale[pair_state]
    factor = multiply(scale // bottom, _integer(over))
    lengths = np.diff(offsets)
    if over == 0:
        offsets, following, weight = np.zeros_like(offsets), following[:0], weight[:0]
    else:
        weight = multiply(weight, np.repeat(factor, lengths))
    return BellmanRows(
        pair_offsets=pair_offsets,
        terminal=model.terminal,
        scale=state_scale,
        constant=multiply(gain, scale // gain_denominator),
        offsets=offsets,
        next=following,
        weight=weight,
    )


def row_sums(values: Numbers, offsets: Integers) -> Numbers:
    """Return (L,) exact sums of integers over the rows that `offsets` delimits, empty ones too."""
    lengths = np.diff(offsets)
    if magnitude(values) * int(lengths.max(initial=0)) >= 2**62:
        values = values.astype(object)
    sums = np.zeros(len(lengths), dtype=values.dtype)
    filled = lengths > 0
    if filled.any():
        sums[filled] = np.add.reduceat(values, offsets[:-1][filled])
    return sums


def _integer(value: int) -> Numbers:
    return np.array(value, dtype=np.int64 if abs(value) < 2**62 else object)


def lcm_by_group(values: Numbers, offsets: Integers) -> Numbers:
    """Return the least common multiples of groups of positive integers, none of them empty."""
    found = np.asarray(np.lcm.reduceat(values, offsets[:-1]))
    if values.dtype != object:
        # a 64-bit product that overflowed is not a multiple of all its factors, or is one by chance
        safe = bool((found > 0).all())
        if not safe or (np.repeat(found, np.diff(offsets)) % values).any():
            return lcm_by_group(values.astype(object), offsets)
    return found


# ---- the hash -----------------------------------------------------------------------------------


@once
def fingerprint(model: MDP) -> str:
    """Return the SHA-256 of the model's exact content in hexadecimal.

    Parameters
    ----------
    model : MDP

    Returns
    -------
    str

    Examples
    --------
    >>> from exact_mdp import MDP, fingerprint
    >>> one, other = (MDP.from_arrays([[[1]]], [r], discount="1/2") for r in ("1/2", 0.5))
    >>> fingerprint(one) == fingerprint(other)
    True
    """
    digest = sha256(b"exact-mdp model 1\n")
    start = sorted((state, weight) for state, weight in model.start if weight)
    digest.update(f"{model.n_states} {model.n_pairs} {_text(model.discount_exact)}\n".encode())
    digest.update(" ".join(f"{state} {_text(weight)}" for state, weight in start).encode())
    index = "<i4" if model.n_states < 2**31 else "<i8"
    _add(digest, model.pair_state, index)
    _add(digest, model.pair_action, "<i8")
    first, offsets = distinct(model.table)
    _add(digest, offsets, "<i8")
    if model.table.weight.dtype == np.float64 and len(first) == len(model.table.next):
        _add(digest, model.table.next, index)
        _add_floats(digest, model.table.weight, model.n_pairs)
    else:
        _, following, weight, denominator = merged(model.table)
        _add(digest, following, index)
        floats, meant = in_floats(weight, denominator, offsets)
        _add_rationals(digest, weight, denominator, offsets, floats, ~meant)
    if model.table.gain.dtype == np.float64 and len(model.table.gain) == model.n_pairs:
        _add_floats(digest, model.table.gain, model.n_pairs)
    else:
        top, bottom = reduced(*model.table.expected_gain_exact())
        floats = _doubles(top, bottom)
        each = np.arange(model.n_pairs + 1)
        _add_rationals(digest, top, bottom, each, floats, ~np.isfinite(floats))
    if model.sense != "max":
        digest.update(f"\nsense {model.sense}".encode())
    if model.goal is not None:
        _add(digest, np.packbits(model.goal), "u1")
        digest.update(str(model.unreached).encode())
    return digest.hexdigest()


def _add(digest: _Hash, values: Numbers, kind: str) -> None:
    digest.update(f"\n{len(values)}:".encode())
    digest.update(np.ascontiguousarray(values, dtype=kind).data)


def _add_floats(digest: _Hash, values: Numbers, rows: int) -> None:
    """Add rows of doubles as `_add_rationals` would."""
    _add(digest, np.zeros(rows, dtype=bool), "?")
    _add(digest, values + 0.0, "<f8")  # -0.0 becomes 0.0


def _add_rationals(
    digest: _Hash,
    top: Numbers,
    bottom: Numbers,
    offsets: Integers,
    floats: Floats,
    others: NDArray[np.bool_],
) -> None:
    """Add rows in lowest terms: `floats` (M,), or top (M,) over bottom (L,) where marked (L,)."""
    inside = np.repeat(others, np.diff(offsets))
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
