"""Compiled passes over a model's transitions: sums of differences, improvement, relaxation.

For values h the loops compute the advantage of pair l of state s,

    d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - (1 - γ) h(s),

see `solvers.bounds.gains` for this form, and `solvers.bounds.bounds` for the margins m. All but
`relax_states` write only to the place of the state or pair at hand, so that blocks may run on
several threads, with the same bits for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.forms.compiling import compile_loop, inline_loop, unsigned_index, unsigned_range
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.kernels.linear import SparseRows


class CompiledModel(NamedTuple):
    """A model's pairs: their rows, rewards r and margins m, (L,) or (1,); `ended` (S,); 1 - γ."""

    offsets: Numbers
    indptr: Numbers
    indices: Numbers
    data: Floats
    reward: Floats
    margin: Floats
    ended: Numbers
    discount: float
    leak: float


def build_compiled_model(mdp: MDP, reward: Floats, margin: Floats) -> CompiledModel:
    """Return a model in the form that compiled loops take."""
    matrix = mdp.transition
    rows, leak = (matrix.indptr, matrix.indices, matrix.data), float(1 - mdp.discount_exact)
    return CompiledModel(mdp.pair_offsets, *rows, reward, margin, mdp.terminal, mdp.discount, leak)


@inline_loop
def gain_of(pair: int, model: CompiledModel, value: Floats, own: float) -> float:
    """Return the advantage d of a pair, from `value` (S,) and the value of its own state."""
    ahead = 0.0
    for i in unsigned_range(
        model.indptr[unsigned_index(pair)], model.indptr[unsigned_index(pair + 1)]
    ):
        ahead += model.data[i] * (value[unsigned_index(model.indices[i])] - own)
    gain: float = model.reward[unsigned_index(pair)] + (model.discount * ahead - model.leak * own)
    return gain


@compile_loop
def sum_differences(
    first: int,
    last: int,
    pair_state: Numbers,
    rows: SparseRows,
    value: Floats,
    steps: Floats,
    flow: Floats,
) -> None:
    """Write Σ p (V' - V) and Σ p |V' - V| of pairs first … last-1 into `steps` and `flow` (L,)."""
    indptr, indices, data = rows
    for pair in range(first, last):
        own, ahead, size = value[pair_state[pair]], 0.0, 0.0
        for i in unsigned_range(indptr[pair], indptr[pair + 1]):
            term = data[i] * (value[unsigned_index(indices[i])] - own)
            ahead += term
            size += abs(term)
        steps[pair], flow[pair] = ahead, size


@compile_loop
def improve_states(
    first: int,
    last: int,
    model: CompiledModel,
    value: Floats,
    pairs: Integers,
    ceilings: Floats,
    rise: float,
    slack: float,
    step: Floats,
    extremes: Floats,
) -> None:
    """Write the greatest d of states first … last-1 into `step` (S,), its pair into `pairs` (S,).

    r(l) + γ P_l h is at most the ceiling (L,) plus `rise`, the total rise of γ P_l h, plus `slack`
    for rounding. Each state's previous pair is computed first, or if that is -1, the pair with the
    greatest ceiling; it stays unless another is better. Pairs whose ceilings show that they are not
    better are skipped. `extremes` (2,) are the least d / m of the greedy pairs, and the greatest of
    all computed pairs.
    """
    # Margins are one number for all pairs, or one for each.
    many = np.uint64(len(model.margin) > 1)
    low, high = np.inf, -np.inf
    for number in range(first, last):
        state = unsigned_index(number)
        begin, end = model.offsets[state], model.offsets[unsigned_index(number + 1)]
        if model.ended[state]:
            step[state], pairs[state] = 0.0, begin
            continue
        # The pair to begin with, and its advantage, which becomes its new ceiling.
        own, before = value[state], pairs[state]
        if before < 0:
            before = begin
            for pair in range(begin + 1, end):
                if ceilings[unsigned_index(pair)] > ceilings[unsigned_index(before)]:
                    before = pair
        chosen, place = before, unsigned_index(before)
        best = gain_of(before, model, value, own)
        ceilings[place] = best + (own - rise) + slack
        high, most = max(high, best / model.margin[place * many]), place
        # A pair is skipped if it can raise neither the best d nor the greatest d / m.
        for pair in range(begin, end):
            place = unsigned_index(pair)
            ceiling = ceilings[place] + (rise - own) + slack
            beaten = ceiling < best and (many == 0 or ceiling <= high * model.margin[place])
            if beaten or pair == before:
                continue
            gain = gain_of(pair, model, value, own)
            ceilings[place] = gain + (own - rise) + slack
            high = max(high, gain / model.margin[place * many])
            if gain > best:
                best, chosen, most = gain, pair, place
        step[state], pairs[state] = best, chosen
        low = min(low, best / model.margin[most * many])
    extremes[0], extremes[1] = low, high


@compile_loop
def relax_states(order: Integers, model: CompiledModel, value: Floats, level: float) -> None:
    """Make `value` (S,) satisfy max d = level in each state in turn, in the `order` (S,).

    Gauss-Seidel: a pair's advantage is divided by 1 - γ P(l, s), which sums up all repeated stays.
    """
    for number in order:
        state = unsigned_index(number)
        if model.ended[state]:
            continue
        own, best = value[state], -np.inf
        # The best advantage of the state, with the values that earlier states have just got.
        for pair in unsigned_range(model.offsets[state], model.offsets[state + np.uint64(1)]):
            ahead, stay = 0.0, 0.0
            for i in unsigned_range(model.indptr[pair], model.indptr[pair + np.uint64(1)]):
                following = unsigned_index(model.indices[i])
                ahead += model.data[i] * (value[following] - own)
                if following == state:
                    stay = model.data[i]
            gain = model.reward[pair] + (model.discount * ahead - model.leak * own) - level
            if stay > 0.0:
                gain /= 1 - model.discount * stay
            best = max(best, gain)
        value[state] = own + best
