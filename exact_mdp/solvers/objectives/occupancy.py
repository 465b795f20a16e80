"""How often each pair is taken from the start, exactly: the flow of a policy.

    x(t) = μ(t) + Σ_s x(s) · γ P_π(s, t)

over the states that the policy reaches; x counts discounted visits. Mixtures of policies mix their
flows, and x(l) / x(s) is the probability of a pair in the stationary policy of a mixture (Altman,
Constrained Markov Decision Processes, 1999, chapter 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.exact.find import visited
from exact_mdp.solvers.exact.levels import fraction
from exact_mdp.solvers.objectives.amounts import Objectives

Start = Sequence[tuple[int, Fraction]]


def visits(of: Objectives, pairs: Integers, start: Start | None = None) -> dict[int, Fraction]:
    """Return the expected visits of the pairs (S,) of a policy from the start, exactly."""
    first = None if start is None else [state for state, _ in start]
    states = of.reached(pairs, first) & ~of.ending.terminal
    level = visited(of.rows.of_pairs(pairs), states, of.mdp.start if start is None else start)
    below = level.each_below
    return {int(pairs[s]): fraction(level.top[s], below[s]) for s in np.flatnonzero(states)}
