"""Compiled loops for stacked models: backward induction over states, for all draws at once.

    Q(l) = r(l) + γ Σ_s' P(l, s') V(s'),     V(s) = max_l Q(l)  or  Σ_l π(l) Q(l)

Arrays have one column for each draw, so every inner loop runs over adjacent numbers. Sums run over
outcomes in one order, so that neither blocks nor threads change a bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from exact_mdp.mdp.forms.compiling import compile_loop, inline_loop
from exact_mdp.mdp.table import Floats, Integers


class Numbers(NamedTuple):
    """The numbers of D models; `StackedStructure` says where each of them belongs."""

    chances: Floats  # (K, D)
    amounts: Floats  # (R, D)
    rate: Floats  # (D,)


@inline_loop
def write_pair_values(structure: Any, numbers: Numbers, l: int, value: Floats, q: Floats) -> None:
    """Write the values (D,) of a pair, given the values (S, D) of the states it leads to."""
    draws = len(q)
    for d in range(draws):
        q[d] = 0.0
    for n in range(structure.offsets[l], structure.offsets[l + 1]):
        k, s = structure.number[n], structure.column[n]
        for d in range(draws):
            q[d] += numbers.chances[k, d] * value[s, d]
    r = structure.earned[l]
    for d in range(draws):
        q[d] = numbers.amounts[r, d] + numbers.rate[d] * q[d]


@compile_loop
def write_optimum(
    order: Integers, structure: Any, numbers: Numbers, value: Floats, q: Floats
) -> None:
    """Write the optimal values of states (S, D) and of pairs (L, D).

    `order` has the states whose values are written, each after all states that it leads to.
    """
    for s in order:
        first, last = structure.first[s], structure.first[s + 1]
        for l in range(first, last):
            write_pair_values(structure, numbers, l, value, q[l])
        for d in range(value.shape[1]):
            value[s, d] = q[first, d]
        for l in range(first + 1, last):
            for d in range(value.shape[1]):
                value[s, d] = max(value[s, d], q[l, d])


@compile_loop
def write_policy_values(
    order: Integers, structure: Any, numbers: Numbers, chosen: Floats, value: Floats, q: Floats
) -> None:
    """Write the values (S, D) of a policy (L,); `q` (D,) is working memory."""
    for s in order:
        for d in range(value.shape[1]):
            value[s, d] = 0.0
        for l in range(structure.first[s], structure.first[s + 1]):
            if chosen[l] > 0.0:
                write_pair_values(structure, numbers, l, value, q)
                for d in range(value.shape[1]):
                    value[s, d] += chosen[l] * q[d]
