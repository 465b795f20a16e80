"""Policy iteration in rational arithmetic: from a policy that floats suggest to an unbeaten one.

Each policy is evaluated exactly, and every state takes the pair with the greatest advantage, until
no advantage is positive (Howard, Dynamic Programming and Markov Processes, 1960). With several
levels or amounts, each breaks the ties of those before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import find_reachable_nodes
from exact_mdp.mdp.table import Integers, Numbers, row_sums
from exact_mdp.solvers.bounds.gains import POLICIES
from exact_mdp.solvers.exact.levels import (
    Level,
    Step,
    compute_surplus_signs,
    make_fraction,
    yield_level_advantages,
)
from exact_mdp.solvers.exact.linear import evaluate_exactly


def iterate_policies(
    rows: BellmanRows, pairs: Integers, evaluate: Callable[[Integers], list[Step]]
) -> tuple[Integers, list[Level], Integers]:
    """Return unbeaten pairs (S,), their levels, and the signs (L,) of all advantages."""
    while True:
        levels, sign = evaluate(pairs), np.zeros(len(rows.constant), dtype=np.int64)
        # Each level breaks the ties of the levels before.
        for step in levels:
            known = np.union1d(pairs, np.flatnonzero(sign))
            sign += compute_surplus_signs(rows, step, known)
        # Only pairs of live states can improve the policy.
        gaining = np.flatnonzero((sign > 0) & ~rows.terminal[rows.pair_state])
        if not len(gaining):
            return pairs, [level for level, *_ in levels], sign
        # Compare advantages as fractions, one level after the other, and take the best of each
        # state.
        columns = []
        for step in levels:
            column = yield_level_advantages(rows, step, gaining)
            columns.append([make_fraction(x, a * b) for x, a, b in column])
        each = zip(*columns, strict=True)
        pairs, most = pairs.copy(), dict[int, tuple[Fraction, ...]]()
        for pair, gain in zip(gaining.tolist(), each, strict=True):
            state = int(rows.pair_state[pair])
            if state not in most or gain > most[state]:
                most[state], pairs[state] = gain, pair


def optimise_exactly(
    rows: BellmanRows, first: Integers | None = None, amounts: Sequence[Numbers] = ()
) -> tuple[Integers, list[Level], Integers]:
    """Return optimal pairs (S,), their values, and the signs (L,) of all advantages.

    With several amounts (L,), each breaks the ties of the amounts before. The search begins with
    the pairs `first` (S,), a proper policy. All later policies are proper too: a pair is replaced
    only by a better one, and a class of states that never ends would have a positive gain.
    """
    each = amounts or [rows.constant]
    listed, ones = [own.tolist() for own in each], [1] * len(rows.constant)
    if first is None:
        first = rows.pair_offsets[:-1]

    def evaluate(pairs: Integers) -> list[Step]:
        values = evaluate_exactly(rows, pairs, each)
        return [(value, own, ones) for value, own in zip(values, listed, strict=True)]

    return iterate_policies(
        rows, improve_in_floats(replace(rows, constant=each[0]), first), evaluate
    )


def improve_in_floats(rows: BellmanRows, first: Integers) -> Integers:
    """Return a policy (S,) that floats find better than the first one, and that is also proper."""
    state, live = rows.pair_state, ~rows.terminal
    if len(state) == len(live):
        return first
    # The model in floats: probabilities and rewards of the live pairs.
    scale = rows.scale[state].astype(object)
    try:
        share = (rows.weight / scale[rows.pair]).astype(np.float64) * live[state][rows.pair]
        earned = (rows.constant / scale).astype(np.float64) * live[state]
    except OverflowError:  # floats only suggest a policy; the first one will do
        return first
    moves = sp.csr_array((share, rows.next, rows.offsets), shape=(len(state), len(live)))
    one, pairs = sp.eye_array(len(live), format="csc"), first
    for _ in range(POLICIES):
        try:
            value = splu(sp.csc_array(one - moves[pairs])).solve(earned[pairs])
        except RuntimeError:  # singular, up to rounding
            return first
        # Advantages that rounding may explain count as 0, so that no policy comes twice. The part
        # affects only speed; measured: 2⁻⁵⁰ to 2⁻³⁰ take equally long.
        gain = earned + moves @ value - value[state]
        noise = 2.0**-40 * (np.abs(earned) + abs(moves) @ np.abs(value) + np.abs(value[state]))
        if not np.all(np.isfinite(gain)):
            return first
        gain[gain < noise.max(initial=0.0)] = 0.0
        # Take the first best pair of each state that has one.
        most = np.maximum.reduceat(gain, rows.pair_offsets[:-1])
        better = np.flatnonzero((gain > 0) & (gain == most[state]))
        if not len(better):
            break
        pairs = pairs.copy()
        own, place = np.unique(state[better], return_index=True)
        pairs[own] = better[place]
    chain = rows.of_pairs(pairs)
    # Floats may have found an improper policy: then the first pairs stay.
    graph = sp.csr_array((np.ones(len(chain.next)), chain.next, chain.offsets), (len(live),) * 2)
    ends = rows.terminal | (row_sums(chain.weight, chain.offsets) < chain.scale)
    if find_reachable_nodes(graph.T.tocsr(), ends).all():
        return pairs
    return first
