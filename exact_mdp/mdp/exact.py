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
same, and 0.1 (a dyadic rational) differs from 1/10. Rows are encoded by their values alone: those
whose numbers all are doubles, exactly, as these, so that a large float model is hashed without
touching its numbers one by one; any other as integers over their denominator in lowest terms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from math import fsum
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.chain import endless
from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.table import (
    EXACT_IN_FLOAT,
    EXACT_IN_INT64,
    ROW_TOLERANCE,
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

    def slack(self) -> Numbers:
        """Return (L,) scale less the sum of weights: positive where γ times the row sum is < 1."""
        return np.asarray(self.scale[self.pair_state] - row_sums(self.weight, self.offsets))

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


def per_step(model: MDP) -> MDP:
    """Return the model in which all steps count alike: discount 1, each row divided by its sum.

    An average reward per step needs rows that sum to 1 exactly; those of floats need not.
    """
    table, parts = model.table, model.component_table
    if not table.sums_to_one:
        weight, below = table.integer_weights()
        whole = replace(
            table, weight=weight, denominator=below, weight_doubt=table.weight_rounding()
        )
        total = whole.row_sums()
        table = replace(whole, denominator=total)
        if parts is not None and len(table.gain) != table.pairs:
            amount, bottom = parts.exact()
            parts = replace(
                parts, amount=multiply(amount, below[:, None]), denominator=multiply(bottom, total)
            )
    if table is model.table and model.discount_exact == 1:
        return model
    names = model.component_names
    return model.with_(discount=1, table=table, component_table=parts, component_names=names)


def divided(model: MDP) -> MDP:
    """Return the model itself, or where some policy never ends, with each row divided by its sum.

    What goes on for ever has a total only where rows sum to 1 exactly. All that is said of such a
    model is of this one, so that an optimum and a policy's value can be compared.

    Examples
    --------
    >>> wait, leave = [[1, 0], [0.1, 0.9]], [[0.3, 0.7], [0, 1]]
    >>> mdp = MDP.from_arrays([wait, leave], [[1, 1], [0, 0]], layout="ass")
    >>> mdp.table.sums_to_one, divided(mdp).table.sums_to_one
    (False, True)
    """
    if model.discount_exact != 1 or model.table.sums_to_one or not endless(model):
        return model
    return _divided(model)


_divided = once(per_step)


def slack_signs(model: MDP) -> Numbers:
    """Return (L,) the signs of 1 - γ Σ P, exactly."""
    table, rate = model.table, model.discount_exact
    if rate * (1 + 2 * ROW_TOLERANCE) < 1 or table.sums_to_one:
        return np.full(model.n_pairs, int(rate < 1))
    if rate == 1 and table.weight.dtype == np.float64:
        rows = pairwise(table.offsets.tolist())
        sums = [fsum([1.0, *(-table.weight[first:last]).tolist()]) for first, last in rows]
        return np.sign(sums)  # a sum rounded once has the sign of the sum
    return np.sign(bellman_rows(model).slack())


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
        _add_rationals(digest, weight, denominator, offsets)
    if model.table.gain.dtype == np.float64 and len(model.table.gain) == model.n_pairs:
        _add_floats(digest, model.table.gain, model.n_pairs)
    else:
        gain = reduced(*model.table.expected_gain_exact())
        _add_rationals(digest, *gain, np.arange(model.n_pairs + 1))
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
