"""Policy iteration for the average reward in floats: gain first, then bias, then its bias.

    evaluate   g, h, w of the policy (`chain`)
    improve    in every state a pair that is greatest in d(g); among those, in r - g + d(h); among
               those, in d(w) - h, with d(x) = Σ P(l, s') x(s') - x(s)

Puterman, Markov Decision Processes, 1994, section 9.2.1; the third level makes the bias the
greatest (section 10.3). A pair is kept unless another beats it by more than rounding. It ends with
a policy that comes back, or whose gain and bias have risen nowhere: changes were rounding errors.
"""

from __future__ import annotations

import warnings
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.average.evaluate import averages_of, bounded_gain
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.dynamic.iterate import RELATIVE_TOLERANCE
from exact_mdp.solvers.dynamic.methods import ModifiedPolicyIteration
from exact_mdp.solvers.solution import PrecisionWarning, SolverError, Status

MOST = 1000  # policies
NEARNESS = Fraction(1, 2**12)  # 1 - γ of the policy to begin with


class Improved(NamedTuple):
    """The pairs (S,) of a policy, relative values (S,), iterations, and how it ended."""

    pairs: Integers
    bias: Floats
    iterations: int
    status: Status = Status.DIRECT


def improved(step: MDP, pairs: Integers | None = None, most: int = MOST) -> Improved:
    """Return a policy that is optimal up to rounding, from `pairs` (S,) or from a patient policy.

    `step` is a model at discount 1 with rows that sum to 1.
    """
    if pairs is None:
        pairs = _patient(step)
    seen: set[bytes] = set()
    before: tuple[Floats, Floats] | None = None
    for iteration in range(1, most + 1):
        seen.add(pairs.tobytes())
        taken = np.zeros(step.n_pairs)
        taken[pairs] = 1.0
        averages = averages_of(step, taken)
        _, bias, second = averages.expansion(step.reward[pairs])
        added = gains(step, bias)
        own = FixedPoint(value=added.value[pairs], error=added.error[pairs])
        gain = bounded_gain(averages, own)
        if before is not None:
            least = RELATIVE_TOLERANCE * float(np.abs(bias).max())
            risen = (gain.value - before[0] > gain.error).any() or (bias - before[1] > least).any()
            if not risen:
                return Improved(pairs, bias, iteration)
        before = gain.value, bias
        pairs = _greatest(step, gain, bias, second, pairs)
        if pairs.tobytes() in seen:
            return Improved(pairs, bias, iteration)
    raise SolverError(Status.ITERATION_LIMIT, f"{most} policies were evaluated")


def _patient(step: MDP) -> Integers:
    """Return the pairs (S,) that are best with a discount near 1: few are left to improve.

    From any other policy, news of a better class may travel one step in each iteration.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            return ModifiedPolicyIteration().solve(step.with_(discount=1 - NEARNESS)).pairs
        except SolverError:  # any policy does to begin with
            return step.pair_offsets[:-1]


def _greatest(
    step: MDP, gain: FixedPoint, bias: Floats, second: Floats, keep: Integers
) -> Integers:
    """Return (S,) pairs that no other beats by more than rounding, those of `keep` first.

    Gains that are equal come out of different equations: their whole error counts, not only that
    of their differences.
    """
    first, state = step.pair_offsets[:-1], step.pair_state
    unsure = step.transition @ gain.error + gain.error[state]
    left = np.ones(step.n_pairs, dtype=bool)
    for earned, value, doubt in (
        (np.zeros(step.n_pairs), gain.value, unsure),
        (step.reward - gain.value[state], bias, 0.0),
        (-bias[state], second, 0.0),
    ):
        level = gains(step, value, reward=earned)
        noise = level.noise + doubt
        least = np.where(left, level.value - noise, -np.inf)
        left &= level.value + noise >= np.maximum.reduceat(least, first)[state]
    chosen = np.minimum.reduceat(np.where(left, np.arange(step.n_pairs), step.n_pairs), first)
    return np.where(left[keep], keep, chosen)
