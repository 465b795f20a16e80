"""Policy iteration for the average reward in floats: gain first, then bias, then its bias.

    evaluate   g, h, w of the policy (`chain`)
    improve    in every state a pair that is greatest in d(g); among those, in r - g + d(h); among
               those, in d(w) - h, with d(x) = Σ P(l, s') x(s') - x(s)

Puterman, Markov Decision Processes, 1994, section 9.2.1; the third level makes the bias the
greatest (section 10.3). A pair is kept unless another beats it by more than rounding. A policy that
comes back differs from the last by rounding errors alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.average.chain import Classes, FloatAverages, graph_of
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.solution import SolverError, Status

MOST = 1000  # policies


class Improved(NamedTuple):
    """The pairs (S,) of a policy, relative values (S,), iterations, and how it ended."""

    pairs: Integers
    bias: Floats
    iterations: int
    status: Status = Status.DIRECT


def improved(step: MDP, pairs: Integers | None = None, most: int = MOST) -> Improved:
    """Return a policy that is optimal up to rounding, from `pairs` (S,) or from the first ones.

    `step` is a model at discount 1 with rows that sum to 1.
    """
    still, first = np.zeros(step.n_states), step.pair_offsets[:-1]
    if pairs is None:
        pairs = _greatest(step, (still, still, still), first)
    seen: set[bytes] = set()
    for iteration in range(1, most + 1):
        seen.add(pairs.tobytes())
        averages = FloatAverages(step.transition[pairs], Classes.of(graph_of(step, pairs)))
        found = averages.expansion(step.reward[pairs])
        pairs = _greatest(step, found, pairs)
        if pairs.tobytes() in seen:
            return Improved(pairs, found[1], iteration)
    raise SolverError(Status.ITERATION_LIMIT, f"{most} policies were evaluated")


def _greatest(step: MDP, found: tuple[Floats, Floats, Floats], keep: Integers) -> Integers:
    """Return (S,) pairs that no other beats by more than rounding, those of `keep` first."""
    first, state = step.pair_offsets[:-1], step.pair_state
    gain, bias, second = found
    left = np.ones(step.n_pairs, dtype=bool)
    for earned, value in (
        (np.zeros(step.n_pairs), gain),
        (step.reward - gain[state], bias),
        (-bias[state], second),
    ):
        level = gains(step, value, reward=earned)
        least = np.where(left, level.value - level.noise, -np.inf)
        left &= level.value + level.noise >= np.maximum.reduceat(least, first)[state]
    chosen = np.minimum.reduceat(np.where(left, np.arange(step.n_pairs), step.n_pairs), first)
    return np.where(left[keep], keep, chosen)
