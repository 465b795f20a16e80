"""Make an exact certificate: prove that values are unique, solve, and say what is optimal."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import lcm

import numpy as np

from mdp.bellman import BellmanRows, bellman_rows
from mdp.chain import reachable, require_termination, termination, topological_levels
from mdp.fingerprint import fingerprint
from mdp.model import MDP
from mdp.table import Integers
from solvers.certificate import Certificate
from solvers.exact import solve_exactly


def certify_exact(mdp: MDP) -> Certificate:
    """Return the exact certificate of a model; see `solvers.certificate.certify`."""
    rows = bellman_rows(mdp)
    rank, weight = _proof(mdp, rows)
    found = solve_exactly(rows)
    optimal, first = found.optimal, mdp.pair_offsets[:-1]
    reached = reachable(mdp, pairs=optimal) & ~mdp.terminal
    count = np.add.reduceat(optimal.astype(np.int64), first)
    numbers = np.where(optimal, np.arange(mdp.n_pairs), mdp.n_pairs)
    start_value = sum(
        (
            weight * Fraction(found.numerator[state], found.denominator[found.group[state]])
            for state, weight in mdp.start
        ),
        Fraction(0),
    )
    return Certificate(
        model=fingerprint(mdp),
        numerator=found.numerator,
        group=found.group,
        denominator=found.denominator,
        policy=mdp.pair_action[np.minimum.reduceat(numbers, first)],
        optimal_pairs=optimal,
        gap=found.gap,
        gap_scale=found.gap_scale,
        unique=bool((count[reached] == 1).all()),
        start_value=start_value,
        rank=rank,
        weight=weight,
        mdp=mdp,
    )


def _proof(mdp: MDP, rows: BellmanRows) -> tuple[Integers | None, list[int] | None]:
    """Return what proves that values are unique: nothing, a rank, or weights."""
    slack = rows.slack()[~mdp.terminal[mdp.pair_state]]
    if (slack > 0).all():
        return None, None
    require_termination(mdp)
    ends = termination(mdp)
    if ends.proven and (slack >= 0).all():
        return ends.rank, None
    level = topological_levels(mdp)
    if level is not None:
        return level, None
    # The greatest expected number of steps: w = 1 + γ P w for the pairs that take longest.
    ones = np.where(mdp.terminal[mdp.pair_state], 0, rows.scale[rows.pair_state])
    steps = solve_exactly(replace(rows, constant=ones), positive=True)
    common = lcm(*steps.denominator)
    below = [steps.denominator[group] for group in steps.group.tolist()]
    return None, [a * (common // b) for a, b in zip(steps.numerator, below, strict=True)]
