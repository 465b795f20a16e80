"""The best pair of each state in floats, one state after the other, each after its successors."""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.kernels.compiling import Rows, at, compiled, span


@compiled
def best_pairs(
    states: Integers,
    pair_offsets: Integers,
    rows: Rows,
    constant: Floats,
    pivot: Floats,
    value: Floats,
    best: Integers,
) -> None:
    """Write into `best` (S,) the pair of the greatest Q, and into `value` (S,) that Q.

    pivot · Q = constant + Σ data · value, the sum over the row of the pair.
    """
    for k in range(len(states)):
        state = at(states[k])
        highest, chosen = 0.0, np.int64(-1)
        for pair in span(pair_offsets[state], pair_offsets[state + np.uint64(1)]):
            total = constant[pair]
            for i in span(rows.indptr[pair], rows.indptr[pair + np.uint64(1)]):
                total += rows.data[i] * value[at(rows.indices[i])]
            total /= pivot[pair]
            if chosen < 0 or total > highest:
                highest, chosen = total, np.int64(pair)
        value[state], best[state] = highest, chosen
