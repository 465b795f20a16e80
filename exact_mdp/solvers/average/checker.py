"""Checks a certificate of average optimality against the model alone; imports no solver.

With d(x) = Σ P(l, s') x(s') - x(s) for each pair l of state s, every pair has to satisfy

    d(g) ≤ 0;    where d(g) = 0:  r - g + d(h) ≤ 0;    where this is 0, too:  d(w) - h ≤ 0

and those of the policy have to satisfy all three as equations (for the first two: Puterman, Markov
Decision Processes, 1994, equations 9.1.1 and 9.1.2; for the third: Veinott, Annals of Mathematical
Statistics 40, 1969; Puterman, section 10.2).

As equations, they have one solution g, h for each policy: its gain and its bias (chain.py there).
As inequalities, they say of v = g / ρ + h + ρ w, for every small interest rate ρ > 0, that
r + P v - (1 + ρ) v = d(g) / ρ + (r - g + d(h)) + ρ (d(w) - h) - ρ² w is of order ρ² at most. So no
policy has a value v' > v + O(ρ): g is the greatest gain, and h the greatest bias among the
policies of that gain. The rows are those without a discount.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.exact import BellmanRows, bellman_rows, row_sums
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.proof.checker import not_of, policy_pairs


class Rationals(NamedTuple):
    """Rationals (S,) as integers over one positive denominator."""

    top: Sequence[int]
    below: int

    def negated(self) -> Rationals:
        """Return the numbers times -1."""
        return Rationals([-number for number in self.top], self.below)


@dataclass(frozen=True, kw_only=True, eq=False)
class AverageClaims:
    """What a certificate claims; see `solvers.average.certificate.AverageCertificate`."""

    model: str
    policy: Integers
    g: Rationals
    h: Rationals
    w: Rationals
    start_value: Fraction

    def __post_init__(self) -> None:
        self.policy.setflags(write=False)


def average_violations(found: AverageClaims, mdp: MDP) -> list[str]:
    """Return what does not hold of a certificate, in words; nothing where it is sound."""
    vectors = {"gains": found.g, "biases": found.h, "second biases": found.w}
    wrong = not_of(mdp, found.model, *(each.top for each in vectors.values()))
    wrong += [
        f"its {name} are not integers over a positive one"
        for name, (top, below) in vectors.items()
        if {*map(type, top), type(below)} != {int} or below <= 0
    ]
    if found.policy.dtype.kind != "i":
        wrong.append(f"its actions are of type {found.policy.dtype}")
    pairs = None if wrong else policy_pairs(mdp, found.policy)
    if pairs is None:
        return wrong or ["the policy takes an action that is not available"]
    tied, claimed = np.ones(mdp.n_pairs, dtype=bool), (found.g, found.h, found.w)
    step = bellman_rows(mdp.maximised.undiscounted)
    if mdp.sense == "min":  # the least costs are minus the greatest rewards
        claimed = (found.g.negated(), found.h.negated(), found.w.negated())
    losses = surplus(step, *claimed)
    for more, what in zip(losses, ("gains", "relative values", "biases"), strict=True):
        above = np.flatnonzero(np.asarray(more > 0, dtype=bool) & tied)
        if len(above):
            wrong.append(f"{mdp.where(int(above[0]))}, improves on the {what} claimed")
        if np.asarray(more[pairs] != 0, dtype=bool).any():
            wrong.append(f"the policy does not attain the {what} claimed")
        tied &= np.asarray(more == 0, dtype=bool)
    top, below = found.g
    if found.start_value != sum((p * Fraction(top[s], below) for s, p in mdp.start), Fraction(0)):
        wrong.append("the start value is not that of the start states")
    return wrong


def surplus(
    rows: BellmanRows, g: Rationals, h: Rationals, w: Rationals
) -> tuple[Numbers, Numbers, Numbers]:
    """Return d(g), r - g + d(h) and d(w) - h of each pair, (L,) integers.

    Each times the scale of the state, and the denominators of g, of g and h, and of h and w.
    """
    state = rows.pair_state
    own, weight = rows.scale[state].astype(object), rows.weight.astype(object)
    gain, bias, second = (np.array(each.top, dtype=object) for each in (g, h, w))

    def flow(value: Numbers) -> Numbers:
        return np.asarray(row_sums(weight * value[rows.next], rows.offsets) - own * value[state])

    short = rows.constant.astype(object) * g.below - own * gain[state]
    return (
        flow(gain),
        short * h.below + flow(bias) * g.below,
        flow(second) * h.below - own * bias[state] * w.below,
    )
