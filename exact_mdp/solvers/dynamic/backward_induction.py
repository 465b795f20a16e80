"""Backward induction: one pass over an acyclic model, from the end to the start.

    V(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')

once V is known in all successors s' (Puterman, Markov Decision Processes, 1994, section 4.5). The
result is exact but for rounding, which the same pass bounds. Let level(s) be the greatest number of
steps from s to a terminal state, and let every q computed at level k, the right side above, be off
by at most ρ_k, given the V(s') that were computed. With

    W_0 = 0,    W_k = max(W_{k-1}, γ W_{k-1} + ρ_k),

V + W_level leaves no pair anything to add, since successors have smaller levels and W does not
fall with the level; therefore V* ≤ V + W_level. In the same way V - W' ≤ V^π ≤ V*, where W' is
made of the errors of the pairs that π takes and of what these lack to the best one. This is the
lemma of `solvers.bounds.bounds` with weights made to measure.

As rows sum to 1, q is computed from differences r + γ (b + Σ p (V(s') - b)), b the
value of the first successor: its error is set by how values differ, not by how large they are.

Two forms give the same bits: a loop in NumPy over runs of states that do not lead to each other,
and a compiled one (`solvers.kernels.layered`), once the model is large.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import numbered_in_order, runs_in_order
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers, spans
from exact_mdp.solvers.bounds.bounds import ladder, levels, verify
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT
from exact_mdp.solvers.dynamic.iterate import conclude, of_costs
from exact_mdp.solvers.solution import Solution, SolverError, Status

# NumPy takes as long as loading the compiled loop for four million transitions of the care model;
# the loop needs 6 ms a million.
COMPILED_FROM = 500_000
UNITS = UNIT * (1 + 2.0**-10)
SMALLEST = float(np.finfo(np.float64).tiny)  # of those floats that have all their digits


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

    name: ClassVar[str] = "backward-induction"

    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum; raises ModelError where states come back to themselves."""
        started = perf_counter()
        in_order = numbered_in_order(model)
        level = None if in_order else levels(model)
        if level is None and not in_order:
            raise ModelError(
                "backward induction needs a model without cycles",
                where=f"model {model.name}".strip(),
                fix="use ModifiedPolicyIteration or PolicyIteration",
            )
        done = one_pass(model, level)
        # Where expected rewards were themselves added up in floats, their error is counted there.
        table = model.table
        summed = table.joint and np.float64 in (table.weight.dtype, table.gain.dtype)
        found = verify(model, done.value) if summed else done.bounded(model)
        depth = len(done.above) - 1
        return conclude(model, self, found, status=Status.DIRECT, iterations=depth, started=started)


class _Reached(NamedTuple):
    """What `conclude` reads of bounds."""

    value: Floats
    pairs: Integers
    state_error: Floats
    regret: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """What one pass found.

    Attributes
    ----------
    value, pairs, level : (S,)
        Values, the pair taken in each state, and its level.
    above, below : (D+1,)
        By level: how far any q of it may be from the exact one, and how far that of the pairs
        taken may lie below the value.
    """

    value: Floats
    pairs: Integers
    level: Numbers
    above: Floats
    below: Floats

    def bounded(self, mdp: MDP) -> _Reached:
        """Return the values with their error bounds: V* above and V^π below them, by level."""
        rate = mdp.discount * (1 + 8 * UNIT)
        size = float(np.abs(self.value).max())
        longest = int(np.diff(mdp.table.offsets).max())
        lost = size > 0 or _underflows(mdp)
        tiny = TINY * (longest + 2) * (1 + size) * lost
        above, below = np.zeros((2, len(self.above)))
        ladder(self.above + tiny, rate, above)
        ladder(self.below + tiny, rate, below)
        above, below = above * SLACK, below * SLACK
        if not np.isfinite(above[-1] + below[-1] + size):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        error = np.maximum(above, below)[self.level]
        return _Reached(self.value, self.pairs, error, float((above + below).max()))


def _underflows(mdp: MDP) -> bool:
    """Return whether a reward that is not 0 may have lost digits below the range of floats."""
    table = mdp.table
    if table.gain.dtype == np.float64 and len(table.gain) == mdp.n_pairs:
        return False  # taken as they are
    small = np.abs(mdp.reward) < SMALLEST
    earning = np.asarray(table.gain != 0, dtype=bool)
    if len(earning) != mdp.n_pairs:
        earning = np.logical_or.reduceat(earning, table.offsets[:-1])
    return bool((small & earning).any())


def one_pass(mdp: MDP, level: Integers | None = None) -> Pass:
    """Return values of an acyclic model, with their rounding errors by level."""
    pays = mdp.n_transitions >= COMPILED_FROM
    return _compiled_pass(mdp, level) if pays else _array_pass(mdp, level)


def _extra(mdp: MDP) -> int:
    """How often a probability was rounded: once, and where floats were added up, more often."""
    if mdp.table.weight.dtype != np.float64 or mdp.n_transitions == len(mdp.table.next):
        return 1
    return 1 + int((np.diff(mdp.table.offsets) - np.diff(mdp.transition.indptr)).max())


def _compiled_pass(mdp: MDP, level: Integers | None) -> Pass:
    states, matrix = mdp.n_states, mdp.transition
    order = np.empty(0, np.int64) if level is None else np.argsort(level, kind="stable")
    value, pairs = np.empty(states), np.empty(states, dtype=np.int64)
    height = np.empty(states, dtype=np.int32)
    above, below = np.zeros(states + 1), np.zeros(states + 1)
    widest = int(np.diff(mdp.pair_offsets).max())
    from exact_mdp.solvers.kernels import layered

    depth = layered.backward(
        order,
        mdp.pair_offsets,
        matrix.indptr,
        matrix.indices,
        matrix.data,
        mdp.reward,
        mdp.discount,
        mdp.terminal,
        _extra(mdp),
        value,
        pairs,
        height,
        above,
        below,
        np.empty(widest),
        np.empty(widest),
    )
    above, below = above[: depth + 1].copy(), below[: depth + 1].copy()
    return Pass(value=value, pairs=pairs, level=height, above=above, below=below)


def _array_pass(mdp: MDP, level: Integers | None) -> Pass:
    matrix: Any = mdp.transition
    states, reward, first = mdp.n_states, mdp.reward, mdp.pair_offsets
    if level is None:
        order, cuts = np.arange(states), runs_in_order(mdp)
    else:
        order = np.argsort(-level, kind="stable")
        cuts = np.flatnonzero(np.diff(level[order], prepend=-1, append=-1))
        rows = spans(first[order], first[order + 1])
        matrix, reward = matrix[rows], reward[rows]
        first = np.concatenate([[0], np.cumsum(np.diff(first)[order])])
    own, rate, extra = mdp.pair_offsets[:-1], mdp.discount, _extra(mdp)
    value, pairs = np.zeros(states), own.copy()
    height = np.zeros(states, dtype=np.int32)
    above, below = np.zeros(states + 1), np.zeros(states + 1)
    pair_cuts = first[cuts]
    ends = zip(cuts.tolist(), pair_cuts.tolist(), matrix.indptr[pair_cuts].tolist(), strict=True)
    for (s, l, i), (t, m, j) in reversed(list(pairwise(ends))):
        here = order[s:t]
        if mdp.terminal[here[0]]:
            continue  # worth 0
        following, counts = matrix.indices[i:j], np.diff(matrix.indptr[l : m + 1])
        begin, row = matrix.indptr[l:m] - i, np.repeat(np.arange(m - l), counts)
        base = value[following[begin]]
        # Sums in the order of the entries, as the compiled loop has them.
        term = matrix.data[i:j] * (value[following] - base[row])
        total, flow = np.bincount(row, term), np.bincount(row, np.abs(term))
        ahead = rate * (base + total)
        doubt = (counts + extra + 8) * UNITS * (rate * flow)
        doubt += 6 * UNITS * (np.abs(ahead) + np.abs(reward[l:m]))
        q, group = reward[l:m] + ahead, first[s:t] - l
        state = np.repeat(np.arange(t - s), np.diff(first[s : t + 1]))
        best = np.maximum.reduceat(q, group)
        slack = 2 * doubt + (16 * UNITS * np.abs(best))[state]
        good = q + slack >= np.maximum.reduceat(q - slack, group)[state]
        taken = np.minimum.reduceat(np.where(good, np.arange(m - l), m - l - 1), group)
        tall = np.maximum.reduceat(np.maximum.reduceat(height[following], begin), group) + 1
        value[here], pairs[here], height[here] = best, own[here] + (taken - group), tall
        np.maximum.at(above, tall, np.maximum.reduceat(doubt, group))
        np.maximum.at(below, tall, doubt[taken] + (best - q[taken]))
    depth = int(height.max())
    above, below = above[: depth + 1].copy(), below[: depth + 1].copy()
    return Pass(value=value, pairs=pairs, level=height, above=above, below=below)
