"""How often each pair is taken from the start, exactly: the flow of a policy.

    x(t) = μ(t) + Σ_s x(s) · γ P_π(s, t)

over the states that the policy reaches; x counts discounted visits. Mixtures of policies mix their
flows, and x(l) / x(s) is the probability of a pair in the stationary policy of a mixture (Altman,
Constrained Markov Decision Processes, 1999, chapter 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import lcm

import numpy as np

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, integers
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.proof.exact import ExactValues, solve_exactly
from exact_mdp.solvers.proof.rationals import fraction

Start = Sequence[tuple[int, Fraction]]


def flow(
    mdp: MDP, rows: BellmanRows, states: Integers, start: Start | None = None
) -> tuple[BellmanRows, ExactValues]:
    """Return the equations of the visits of a policy, and their solution.

    Parameters
    ----------
    rows : BellmanRows
        Those of a policy: one pair of each state.
    states : (K,) int64
        The states that are reached and not terminal.
    start : sequence of (state, Fraction), optional
        What comes in from outside, μ; the model's start unless given.
    """
    offsets, following = rows.offsets.tolist(), rows.next.tolist()
    weight, scale = rows.weight.tolist(), rows.scale.tolist()
    into: list[dict[int, Fraction]] = [{} for _ in range(mdp.n_states)]
    for state in states.tolist():
        for i in range(offsets[state], offsets[state + 1]):
            into[following[i]][state] = fraction(weight[i], scale[state])
    first = [Fraction(0)] * mdp.n_states
    for state, chance in mdp.start if start is None else start:
        first[state] += chance
    parts = zip(first, into, strict=True)
    scales = [lcm(mu.denominator, *(p.denominator for p in row.values())) for mu, row in parts]
    every = list(zip(scales, into, strict=True))
    equations = BellmanRows(
        pair_offsets=np.arange(mdp.n_states + 1),
        terminal=np.zeros(mdp.n_states, dtype=bool),
        scale=integers(scales),
        constant=integers(int(mu * unit) for mu, unit in zip(first, scales, strict=True)),
        offsets=np.concatenate([[0], np.cumsum([len(row) for row in into], dtype=np.int64)]),
        next=np.array([s for row in into for s in sorted(row)], dtype=rows.next.dtype),
        weight=integers(int(row[s] * unit) for unit, row in every for s in sorted(row)),
    )
    return equations, solve_exactly(equations)


def visits(of: Objectives, pairs: Integers, start: Start | None = None) -> dict[int, Fraction]:
    """Return the expected visits of the pairs (S,) of a policy from the start, exactly."""
    first = None if start is None else [state for state, _ in start]
    states = np.flatnonzero(of.reached(pairs, first) & ~of.ending.terminal)
    rows = of.restricted(pairs, of.rows.constant)
    _, found = flow(of.ending, rows, states, start)
    below = found.denominator
    return {
        int(pairs[s]): Fraction(found.numerator[s], below[found.group[s]]) for s in states.tolist()
    }
