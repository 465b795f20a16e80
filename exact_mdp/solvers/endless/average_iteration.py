"""Howard's policy iteration for the average reward per step, in floats.

Pairs are taken that are greatest in (d(g), r - g + d(h), d(w) - h), in this order, with g, h, w of
the policy (`chain`) and d(x) = P x - x (Puterman, Markov Decision Processes, 1994, sections 9.2.1
and 10.3).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.gains import (
    POLICIES,
    RELATIVE_TOLERANCE,
    BoundedVector,
    choose_greedy_pairs,
    compute_advantages,
)
from exact_mdp.solvers.claims import PrecisionWarning, SolverError, Status
from exact_mdp.solvers.dynamic.methods import ModifiedPolicyIteration
from exact_mdp.solvers.endless.chain import FloatChain, compute_laurent_expansion

# 1 - γ of the discounted model whose optimal policy is the first one. The smaller, the nearer that
# policy is to the optimum, and the longer it takes to find.
NEARNESS = Fraction(1, 2**12)

Improved = tuple[Integers, Floats, int]
"""The pairs (S,) of a policy, relative values (S,), and iterations."""


@dataclass(frozen=True)
class AveragePolicyIteration:
    """Howard's policy iteration for average rewards, with g, h and w of each policy.

    A policy is improved in the order of (d(g), r - g + d(h), d(w) - h): a better gain first, then
    a better bias (Puterman, 1994, section 9.2.1; Howard, 1960).
    """

    max_iterations: int = POLICIES

    def run(self, step: MDP, pairs: Integers | None = None) -> Improved:
        """Return a policy that is optimal up to rounding, from `pairs` (S,) or a patient policy."""
        if pairs is None:
            pairs = _choose_patient_pairs(step)
        seen: set[bytes] = set()
        before: tuple[Floats, Floats] | None = None
        for iteration in range(1, self.max_iterations + 1):
            seen.add(pairs.tobytes())
            # Evaluate the policy: its gain g with bounds, its bias h, and w.
            chain = FloatChain(step, pairs)
            _, bias, second = compute_laurent_expansion(chain, step.reward[pairs])
            added = compute_advantages(step, bias)
            own = BoundedVector(value=added.value[pairs], error=added.error[pairs])
            gain = chain.bounded_gain(own)
            # Stop once neither the gain nor the bias rises by more than rounding.
            if before is not None and not self._has_risen(before, gain, bias):
                return pairs, bias, iteration
            before = gain.value, bias
            pairs = self._improve_pairs(step, pairs, gain, bias, second)
            if pairs.tobytes() in seen:
                return pairs, bias, iteration
        raise SolverError(Status.ITERATION_LIMIT, f"{self.max_iterations} policies were evaluated")

    @staticmethod
    def _has_risen(before: tuple[Floats, Floats], gain: BoundedVector, bias: Floats) -> bool:
        """Return whether a policy is better than the one before, beyond rounding."""
        least = RELATIVE_TOLERANCE * float(np.abs(bias).max())
        gain_rises = (gain.value - before[0] > gain.error).any()
        return bool(gain_rises or (bias - before[1] > least).any())

    @staticmethod
    def _improve_pairs(
        step: MDP, pairs: Integers, gain: BoundedVector, bias: Floats, second: Floats
    ) -> Integers:
        """Return pairs (S,) that are greatest in all three levels, in their order."""
        # Gains that are equal come out of different equations: their whole error counts, not only
        # the error of their differences.
        means = compute_advantages(step, gain.value, reward=np.zeros(step.n_pairs))
        unsure = step.transition @ gain.error + gain.error[step.pair_state]
        return choose_greedy_pairs(
            step,
            replace(means, noise=means.noise + unsure),
            compute_advantages(step, bias, reward=step.reward - gain.value[step.pair_state]),
            compute_advantages(step, second, reward=-bias[step.pair_state]),
            keep=pairs,
        )


def _choose_patient_pairs(step: MDP) -> Integers:
    """Return the pairs (S,) that are best with a discount near 1, few of which need improving."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            return ModifiedPolicyIteration().solve(step.with_(discount=1 - NEARNESS)).pairs
        except SolverError:  # any policy may be the first
            return step.pair_offsets[:-1]
