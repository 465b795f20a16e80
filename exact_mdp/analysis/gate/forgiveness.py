"""How far the rounding of given floats can move a regret: all that a verdict on zero forgives.

A float stands for whatever it was rounded from, half a unit in its last place to either side. To
first order that moves the difference of two policies' values at the start by at most

    Σ_l |v(l) - u(l)| ρ(l) + ω(l) γ (max x_i - min x_i),   x_i = v(l) V^*(s_i) - u(l) V^π(s_i)

with u and v the expected uses of pair l, ρ half a unit in the last place of its expected reward,
and ω a quarter of one in the last place of its probabilities, added up: these sum to 1, so that as
much is given as taken. What both policies do alike moves both alike. A regret of at most that is
none. A pair ties with the best action where its gap is at most e(l) + γ Σ P(l, s') F(s') + F(s),
with e(l) = ρ(l) + ω(l) γ (max V_i - min V_i), and F what the optimum collects of that.

All of this is bounded from above. Nothing is forgiven of rewards where one of them is no float, and
of probabilities likewise: they count as given exactly. So do 0, and a probability of 1.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.solution import SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits


def _roundings(mdp: MDP) -> tuple[Floats, Floats]:
    """Return ρ and ω (L,)."""
    table, first = mdp.table, mdp.table.offsets[:-1]
    chance, gain, moved = table.probabilities(), table.gains(), np.zeros(mdp.n_pairs)
    if table.weight.dtype == np.float64:
        moved = np.where(chance < 1, np.spacing(chance) / 4, 0.0)
        moved = np.add.reduceat(moved, first)
    rounded = moved * (np.maximum.reduceat(gain, first) - np.minimum.reduceat(gain, first))
    if table.gain.dtype == np.float64:
        earned = np.where(gain, chance * np.spacing(np.abs(gain)) / 2, 0.0)
        rounded = rounded + np.add.reduceat(earned, first)
    return rounded, moved


def _span(mdp: MDP, value: Floats, error: Floats) -> Floats:
    """Return (L,) how far apart numbers (N,) of the outcomes of a pair are at most."""
    first = mdp.table.offsets[:-1]
    return np.maximum.reduceat(value + error, first) - np.minimum.reduceat(value - error, first)


def per_use(mdp: MDP, known: FixedPoint, *, rewards: bool = True) -> Floats:
    """Return e (L,) for values (S,) known up to an error."""
    if not mdp.floats:
        return np.zeros(mdp.n_pairs)
    (rounded, moved), there = _roundings(mdp), mdp.table.next
    span = mdp.discount * _span(mdp, known.value[there], known.error[there])
    return np.asarray((rounded * rewards + moved * span) * SLACK + TINY)


def forgiven(
    mdp: MDP, own: tuple[PolicyChain, FixedPoint], best: tuple[PolicyChain, FixedPoint]
) -> Fraction:
    """Return what can be moved at the start; 0 where floats do not suffice to say so.

    Chains may have further ends, whose values no rounding moves.
    """
    if not mdp.floats:
        return Fraction(0)
    rounded, moved = _roundings(mdp)
    apart, unsure = np.zeros((2, mdp.n_pairs))
    x, off = np.zeros((2, len(mdp.table.next)))
    with np.errstate(over="ignore", invalid="ignore"):
        for sign, (chain, known) in ((-1, own), (1, best)):
            try:
                met = visits(chain.mdp, chain.discounted)
            except SolverError:
                return Fraction(0)
            live = (chain.reached & ~chain.mdp.terminal)[mdp.pair_state] * chain.weights
            uses, loose = live * met.value[mdp.pair_state], live * met.error[mdp.pair_state]
            loose += 4 * UNIT * np.abs(uses)
            value, error = known.value[mdp.table.next], known.error[mdp.table.next]
            each, more = uses[mdp.table.pair], loose[mdp.table.pair]
            x += sign * each * value
            off += (more * np.abs(value) + (np.abs(each) + more) * error) + 3 * UNIT * np.abs(x)
            apart, unsure = apart + sign * uses, unsure + loose
        most = rounded * (np.abs(apart) + unsure) + mdp.discount * moved * _span(mdp, x, off)
    found = float(most.sum()) * SLACK
    return Fraction(found) if np.isfinite(found) else Fraction(0)


def ties(best: PolicyChain, known: FixedPoint) -> Floats:
    """Return (L,) the gap up to which a pair ties with the best action; SolverError."""
    mdp, each = best.mdp, per_use(best.mdp, known)
    counted = ~mdp.terminal & (best.ends if mdp.discount_exact == 1 else True)
    taken = np.add.reduceat(best.weights * each, mdp.pair_offsets[:-1])
    found = best.discounted.solve(np.where(counted, taken, 0.0))
    later = np.maximum(found.value, 0.0) + found.error
    return np.asarray(
        (each + mdp.discount * (mdp.transition @ later) + later[mdp.pair_state]) * SLACK
    )
