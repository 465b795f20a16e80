"""The search of `solvers.endless.graph`: backward from some states, one pair after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.kernels.compiling import at, compiled, span


@compiled
def spread(
    before: Integers,
    into: Integers,
    owner: Integers,
    left: NDArray[np.bool_],
    waiting: Integers,
    rank: Integers,
    queue: Integers,
    filled: int,
) -> None:
    """Write into `rank` (S,) when each state joins the first ones, which are in the queue (S,).

    It joins once `waiting` of its pairs that are `left` (L,) may lead to those before.
    """
    head = 0
    while head < filled:
        state = queue[head]
        head += 1
        for i in span(before[state], before[state + 1]):
            pair = at(into[i])
            if left[pair]:
                left[pair] = False
                found = at(owner[pair])
                waiting[found] -= 1
                if waiting[found] <= 0 and rank[found] < 0:
                    rank[found] = rank[at(state)] + 1
                    queue[filled] = found
                    filled += 1
