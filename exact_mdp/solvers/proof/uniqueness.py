"""Proofs that the equations of every policy have one solution.

The discount is one where γ Σ P < 1 in all rows; else a rank that falls along transitions, or
weights with w > γ P w, such as the greatest expected number of steps (Bertsekas and Tsitsiklis,
Mathematics of Operations Research 16, 1991). `solvers.proof.checker.one_solution` checks them.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from math import lcm

import numpy as np

from exact_mdp.mdp.chain import require_termination, termination, topological_levels
from exact_mdp.mdp.exact import bellman_rows, slack_signs
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.proof.exact import solve_exactly
from exact_mdp.solvers.proof.margins import falling
from exact_mdp.solvers.solution import SolverError


def uniqueness(mdp: MDP) -> tuple[Integers | None, list[int] | None]:
    """Return what proves that values are unique: nothing, a rank, or weights."""
    slack = slack_signs(mdp)[~mdp.terminal[mdp.pair_state]]
    if (slack > 0).all():
        return None, None
    require_termination(mdp)
    ends = termination(mdp)
    if ends.proven and (slack >= 0).all():
        return ends.rank, None
    level = topological_levels(mdp)
    if level is not None:
        return level, None
    with suppress(SolverError):
        weight = [int(number) for number in np.rint(2.0**20 * margin_weights(mdp).value)]
        proven = falling(mdp, np.array(weight, dtype=object))
        if (proven | mdp.terminal[mdp.pair_state]).all():
            return None, weight
    # The greatest expected number of steps: w = 1 + γ P w for the pairs that take longest.
    rows = bellman_rows(mdp)
    ones = np.where(mdp.terminal[mdp.pair_state], 0, rows.scale[rows.pair_state])
    steps = solve_exactly(replace(rows, constant=ones), positive=True)
    common = lcm(*steps.denominator)
    below = [steps.denominator[group] for group in steps.group.tolist()]
    return None, [a * (common // b) for a, b in zip(steps.numerator, below, strict=True)]
