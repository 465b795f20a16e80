"""Backward induction: one pass over an acyclic model, from the end to the start.

    V(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')

once V is known in all successors s'. States of the same level, the greatest number of steps to a
terminal state, are computed at once (Puterman, Markov Decision Processes, 1994, section 4.5). The
result is exact but for rounding, whose effect is bounded afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np

from mdp.chain import spans
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.bounds import bounds, levels
from solvers.conclusion import conclude
from solvers.solution import Solution, Status


@dataclass(frozen=True, kw_only=True)
class BackwardInduction:
    """Solve an acyclic model in one pass, at any discount.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [[3], [0]])
    >>> solution = BackwardInduction().solve(mdp)
    >>> solution.value.tolist(), solution.iterations
    ([3.0, 0.0], 1)
    """

    @property
    def name(self) -> str:
        return "backward-induction"

    @np.errstate(over="ignore", invalid="ignore")
    def solve(self, mdp: MDP) -> Solution:
        """Return the optimum; raises ModelError where states come back to themselves."""
        started = perf_counter()
        level = levels(mdp)
        if level is None:
            raise ModelError(
                "backward induction needs a model without cycles",
                where=f"model {mdp.name}".strip(),
                fix="use ModifiedPolicyIteration or PolicyIteration",
            )
        found = bounds(mdp, one_pass(mdp, level))
        return conclude(
            mdp,
            self,
            found,
            status=Status.DIRECT,
            iterations=int(level.max(initial=0)),
            started=started,
        )


def one_pass(mdp: MDP, level: Integers) -> Floats:
    """Return (S,) optimal values, level by level from the end."""
    order = np.argsort(-level, kind="stable")
    matrix: Any = mdp.transition
    reward, first = mdp.reward, mdp.pair_offsets
    if (order[1:] < order[:-1]).any():
        rows = spans(first[order], first[order + 1])
        matrix, reward = matrix[rows], reward[rows]
        first = np.concatenate([[0], np.cumsum(np.diff(first)[order])])
    cuts = np.concatenate([np.flatnonzero(np.diff(level[order], prepend=-1)), [len(order)]])
    value = np.zeros(mdp.n_states)
    pair_cuts = first[cuts]
    entry_cuts = matrix.indptr[pair_cuts]
    # The last block is that of the terminal states, of level 0, which are worth 0.
    ends = list(zip(cuts.tolist(), pair_cuts.tolist(), entry_cuts.tolist(), strict=True))[:-1]
    for (s, l, i), (t, m, j) in reversed(list(pairwise(ends))):
        terms = matrix.data[i:j] * value[matrix.indices[i:j]]
        q = reward[l:m] + mdp.discount * np.add.reduceat(terms, matrix.indptr[l:m] - i)
        value[order[s:t]] = np.maximum.reduceat(q, first[s:t] - l)
    return value
