"""The exact model in integers: its Bellman equations, and a hash of its content.

For every pair l of state s, with the discount already in the weights,

    scale(s) · Q(l) = constant(l) + Σ_i weight(i) · V(next(i))

where all numbers are integers, scale(s) > 0 and weight(i) > 0. Outcomes that lead to the same state
are added up. All pairs of a state share the state's scale, so their right sides can be compared
directly. Numbers are 64-bit integers if they fit, else Python integers.

The hash is SHA-256 of a text of lines. The first line is `exact-mdp model 2` and the sense; with a
goal, also the value of a run that misses it, and the list of its states. The other lines are
integers in hexadecimal, such as 0x1f, with a space between them:

    number of states, numerator and denominator of the discount
    state, numerator and denominator of the probability, for each state of the start
    of all pairs, by state and action: the states; the actions; the numerators of the expected
    rewards; their denominators; the denominators of the rows; how many next states they have
    these next states, of all pairs in rising order, outcomes with the same one added up
    the weights: numerators of their probabilities

with fractions and rows in lowest terms. Names of states and actions, labels, reward components and
events are left out: they do not change the optimum. Models hash equally if and only if these
contents are equal, so 0.5, 1/2 and 2/4 are one and the same, and 0.1 (a dyadic rational)
differs from 1/10.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from numbers import Rational
from typing import TYPE_CHECKING, cast

import flint
import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.table import (
    Integers,
    Numbers,
    concatenate_ranges,
    multiply,
    reduce_fractions,
    row_sums,
    to_integer_array,
)

if TYPE_CHECKING:
    from flint import fmpq


@dataclass(frozen=True, kw_only=True, eq=False)
class BellmanRows:
    """Integer Bellman equations of a model with S states, L pairs and M transitions.

    The equations of a state are multiplied by its `scale` (S,). `constant` (L,) is the expected
    reward times the scale. The transitions of pair l are offsets[l] … offsets[l+1]-1, with `next`
    states and `weight` (M,), the discounted probability times the scale. `terminal` states have the
    value 0.
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
        """Return the equations of some pairs only, such as the pairs that a policy takes."""
        first, last = self.offsets[pairs], self.offsets[pairs + 1]
        entries = concatenate_ranges(first, last)
        return replace(
            self,
            pair_offsets=np.searchsorted(self.pair_state[pairs], np.arange(len(self.scale) + 1)),
            constant=self.constant[pairs],
            offsets=np.concatenate([[0], np.cumsum(last - first)]),
            next=self.next[entries],
            weight=self.weight[entries],
        )

    def within(self, states: NDArray[np.bool_], pairs: Integers) -> BellmanRows:
        """Return the equations of some pairs of some `states` (S,), which they never leave.

        The states are numbered anew, in their order.
        """
        rows, number = self.of_pairs(pairs), np.cumsum(states) - 1
        owner = number[self.pair_state[pairs]]
        return replace(
            rows,
            pair_offsets=np.searchsorted(owner, np.arange(int(states.sum()) + 1)),
            terminal=rows.terminal[states],
            scale=rows.scale[states],
            next=number[rows.next],
        )


@cache_on_model
def bellman_rows(model: MDP) -> BellmanRows:
    """Return the Bellman equations of a model in integers, computed once and read-only."""
    table, pair_offsets, pair_state = model.table, model.pair_offsets, model.pair_state
    offsets, following, weight, denominator = table.rows.merged
    gain, gain_denominator = reduce_fractions(*table.expected_gain_exact)
    over, under = model.discount_exact.numerator, model.discount_exact.denominator
    # The scale of a pair is lcm(row denominator · discount denominator, reward denominator).
    bottom = multiply(denominator, to_integer_array([under]))
    scale = multiply(bottom // np.gcd(bottom, gain_denominator), gain_denominator)
    # The scale of a state is a common multiple over its pairs.
    state_scale = lcm_by_group(scale, pair_offsets)
    scale = state_scale[pair_state]
    factor = multiply(scale // bottom, to_integer_array([over]))
    # With discount 0 no next state counts.
    lengths = np.diff(offsets)
    if over == 0:
        offsets, following, weight = np.zeros_like(offsets), following[:0], weight[:0]
    else:
        weight = multiply(weight, np.repeat(factor, lengths))
    rows = BellmanRows(
        pair_offsets=pair_offsets,
        terminal=model.terminal,
        scale=state_scale,
        constant=multiply(gain, scale // gain_denominator),
        offsets=offsets,
        next=following,
        weight=weight,
    )
    for array in vars(rows).values():
        array.setflags(write=False)
    return rows


def lcm_by_group(values: Numbers, offsets: Integers) -> Numbers:
    """Return the least common multiple of each group of positive integers; no group is empty."""
    multiples = np.asarray(np.lcm.reduceat(values, offsets[:-1]))
    if values.dtype != object:
        # If a 64-bit product overflows, it is hardly ever a multiple of all factors: check.
        safe = bool((multiples > 0).all())
        if not safe or (np.repeat(multiples, np.diff(offsets)) % values).any():
            return lcm_by_group(values.astype(object), offsets)
    return multiples


# ---- the hash -----------------------------------------------------------------------------------


@cache_on_model
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
    # Rows in lowest terms, so that equal distributions have equal numbers.
    offsets, following, weight, _ = model.table.rows.merged
    weight = weight // np.repeat(np.gcd.reduceat(weight, offsets[:-1]), np.diff(offsets))
    rate, start = model.discount_exact, sorted((s, p) for s, p in model.start if p)
    start_numbers: list[int] = []
    for state, probability in start:
        start_numbers += [state, probability.numerator, probability.denominator]
    columns = (
        np.array([model.n_states, rate.numerator, rate.denominator], dtype=object),
        np.array(start_numbers, dtype=object),
        *(
            model.pair_state,
            model.pair_action,
            *reduce_fractions(*model.table.expected_gain_exact),
        ),
        *(row_sums(weight, offsets), np.diff(offsets), following, weight),
    )
    head = f"exact-mdp model 2 {model.sense}"
    if model.goal is not None:
        head += f" {model.unreached} {np.flatnonzero(model.goal).tolist()}"
    # Hash the first line, then one line for each column.
    digest = sha256(head.encode())
    for column in columns:
        digest.update(("\n" + " ".join(map(hex, column.tolist()))).encode())
    return digest.hexdigest()


# ---- exact numbers in Python and in FLINT --------------------------------------------------------


def to_flint(number: Fraction | int) -> fmpq:
    """Return a number as FLINT's rational."""
    number_q: fmpq = flint.fmpq(number.numerator, number.denominator)
    return number_q


@dataclass(frozen=True, slots=True)
class _LowestTerms:
    """A rational in lowest terms, which `Fraction` copies without reducing it again."""

    numerator: int
    denominator: int


Rational.register(_LowestTerms)


def from_flint(number: fmpq) -> Fraction:
    """Return FLINT's rational as Python's."""
    return Fraction(cast(Rational, _LowestTerms(int(number.p), int(number.q))))
