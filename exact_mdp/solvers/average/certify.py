"""Exact average optimality: policy iteration in rationals, gain first, then bias, then its bias.

A policy is evaluated (`chain`), and every state takes the first pair that is greatest in

    (d(g),  r - g + d(h),  d(w) - h)      compared in this order,

keeping its own where that is among them. Each change makes the value at small interest rates
greater, so that no policy comes twice; what is left satisfies all that `checker` asks for
(Puterman, Markov Decision Processes, 1994, sections 9.2.1 and 10.3; Veinott, Annals of Mathematical
Statistics 37, 1966). The policy of floats to begin with leaves little to improve.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.exact import bellman_rows, fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers, common
from exact_mdp.solvers.average.certificate import AverageCertificate
from exact_mdp.solvers.average.chain import ExactAverages
from exact_mdp.solvers.average.checker import Rationals, surplus
from exact_mdp.solvers.average.iteration import improved
from exact_mdp.solvers.solution import SolverError


def certify_average(mdp: MDP) -> AverageCertificate:
    """Return the exact optimal gain and bias of a model, with their proof."""
    if mdp.sense == "min":
        found = certify_average(mdp.maximised)
        return replace(
            found,
            mdp=mdp,
            model=fingerprint(mdp),
            g=found.g.negated(),
            h=found.h.negated(),
            w=found.w.negated(),
            start_value=-found.start_value,
        )
    step = mdp.undiscounted
    rows = bellman_rows(step)
    try:
        pairs = improved(step).pairs
    except SolverError:  # floats only suggest a policy to begin with
        pairs = step.pair_offsets[:-1]
    while True:
        chain = ExactAverages(rows.of_pairs(pairs))
        g, h, w = (Rationals(*common(each.tolist())) for each in chain.expansion(chain.reward))
        better = _lexicographic(step, surplus(rows, g, h, w), pairs)
        if (better == pairs).all():
            break
        pairs = better
    start = sum((weight * Fraction(g.top[s], g.below) for s, weight in mdp.start), Fraction(0))
    return AverageCertificate(
        model=fingerprint(mdp),
        policy=mdp.pair_action[pairs],
        g=g,
        h=h,
        w=w,
        start_value=start,
        mdp=mdp,
    )


def _lexicographic(mdp: MDP, levels: tuple[Numbers, ...], keep: Integers) -> Integers:
    """Return (S,) the first pair of each state with the greatest levels, `keep` where it is one."""
    first, left = mdp.pair_offsets[:-1], np.ones(mdp.n_pairs, dtype=bool)
    for level in levels:
        inside = np.where(left, level, level.min() - 1)
        left &= np.asarray(inside == np.maximum.reduceat(inside, first)[mdp.pair_state], dtype=bool)
    chosen = np.minimum.reduceat(np.where(left, np.arange(mdp.n_pairs), mdp.n_pairs), first)
    return np.where(left[keep], keep, chosen)
