"""The rounding allowance: how far the rounding of given floats can move a regret.

A float stands for any number that rounds to it, half a unit in its last place to either side. To
first order that moves the difference of two policies' values at the start by at most

    Σ_l |v(l) - u(l)| ρ(l) + M_l(x),    x_i = v(l) (r_i + γ V^*(s_i)) - u(l) (r_i + γ V^π(s_i))
    M_l(x) = min_c Σ_i ω_i |x_i - c|,   c the median, as errors of a row sum to 0

with u and v the expected uses of pair l by the policy and by the optimum, and ρ and ω_i half a unit
of its expected reward and of the probability of outcome i. A pair ties with the best action if its
gap is at most e(l) + γ Σ P(l, s') F(s') + F(s), with e(l) = ρ(l) + M_l(r + γ V) and F the total of
e under the optimum. All terms are bounded from above; exact numbers, 0 and a probability of 1 have
an allowance of zero.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, BoundedVector
from exact_mdp.solvers.claims import SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain


@cache_on_model
def _round_rewards(mdp: MDP) -> Floats:
    """Return ρ (L,), half a unit in the last place of each pair's expected reward."""
    if not mdp.float_rewards:
        return np.zeros(mdp.n_pairs)
    table, gain = mdp.table, mdp.table.compute_gains()
    earned = np.where(gain, table.compute_probabilities() * np.spacing(np.abs(gain)) / 2, 0.0)
    return np.add.reduceat(earned, table.offsets[:-1])


def _moved_by_rows(mdp: MDP, x: Floats, error: Floats) -> Floats:
    """Return M (L,) for numbers x (N,), each known up to an error (N,)."""
    table, first, pair = mdp.table, mdp.table.offsets[:-1], mdp.table.pair
    if not mdp.float_probabilities:
        return np.zeros(mdp.n_pairs)
    chance = table.compute_probabilities()
    half = np.where(chance < 1, np.spacing(chance) / 2, 0.0)
    # The median of x in each row, weighted by `half`: in the order of x, the first outcome up to
    # which half of the row's weight lies.
    order = np.lexsort((x, pair))
    ahead = np.cumsum(half[order])
    middle = (ahead[first] - half[order[first]] + ahead[table.offsets[1:] - 1]) / 2
    places = np.where(ahead >= middle[pair], np.arange(len(x)), len(x))
    median = x[order[np.minimum.reduceat(places, first)]]
    return np.add.reduceat(half * (np.abs(x - median[pair]) + error), first)


def round_finite_values(exact: Numbers) -> BoundedVector:
    """Return exact values as floats with error bounds; infinite values become 0."""
    value = np.nan_to_num(exact.astype(np.float64), posinf=0.0, neginf=0.0)
    return BoundedVector(value=value, error=UNIT * np.abs(value) + TINY)


def _compute_outcome_values(
    mdp: MDP, known: BoundedVector, rewards: bool = True
) -> tuple[Floats, Floats]:
    """Return r + γ V of outcomes (N,) and error bounds, for values (S,) with error bounds."""
    gain, there, rate = mdp.table.compute_gains() * rewards, mdp.table.next, mdp.discount
    x = gain + rate * known.value[there]
    return x, rate * known.error[there] + 3 * UNIT * (np.abs(gain) + np.abs(x))


def per_use(mdp: MDP, known: BoundedVector, *, rewards: bool = True) -> Floats:
    """Return e (L,) for values (S,) with error bounds; without `rewards`, with r = 0."""
    moved = _moved_by_rows(mdp, *_compute_outcome_values(mdp, known, rewards))
    return (_round_rewards(mdp) * rewards + moved) * SLACK + TINY


def bound_per_use(mdp: MDP, known: BoundedVector) -> float:
    """Return an upper bound on all e(l), from the greatest numbers alone.

    Half a unit in the last place of p is at most UNIT p, and c may be the middle of all x.
    """
    gain, value = mdp.table.shared_gains(), known.value
    spread = float(np.ptp(gain)) + mdp.discount * float(np.ptp(value) + 2 * known.error.max())
    size = float(np.abs(gain).max()) + float(np.abs(value).max())
    moved = mdp.float_rewards * size + mdp.float_probabilities * (spread / 2 + 8 * UNIT * size)
    return moved * UNIT * SLACK + TINY


def compute_rounding_allowance(
    mdp: MDP, own: tuple[PolicyChain, BoundedVector], best: tuple[PolicyChain, BoundedVector]
) -> Fraction:
    """Return how far rounding can move the regret at the start; 0 if floats cannot bound it.

    At discount 1, rounding does not move the value of a recurrent class.
    """
    if not mdp.floats:
        return Fraction(0)
    # v - u and its error (L,); x and its error (N,): the optimum is added, the policy subtracted.
    apart, unsure = np.zeros((2, mdp.n_pairs))
    pair = mdp.table.pair
    x, off = np.zeros((2, len(pair)))
    with np.errstate(over="ignore", invalid="ignore"):
        for sign, (chain, known) in ((-1, own), (1, best)):
            if mdp.discount_exact == 1 and not chain.ends_from_start:
                chain = chain.make_terminal(chain.classes.recurrent)
            try:
                met = chain.discounted.visits
            except SolverError:
                return Fraction(0)
            # Expected uses of pairs, with error bounds: visits times the policy's probabilities.
            live = (chain.reached & ~chain.mdp.terminal)[mdp.pair_state] * chain.weights
            uses, loose = live * met.value[mdp.pair_state], live * met.error[mdp.pair_state]
            loose += 4 * UNIT * np.abs(uses)
            # Their products with r + γ V, which enter x.
            value, error = _compute_outcome_values(mdp, known)
            each, more = uses[pair], loose[pair]
            x += sign * each * value
            off += (more * np.abs(value) + (np.abs(each) + more) * error) + 3 * UNIT * np.abs(x)
            apart, unsure = apart + sign * uses, unsure + loose
        most = _round_rewards(mdp) * (np.abs(apart) + unsure) + _moved_by_rows(mdp, x, off)
    bound = float(most.sum()) * SLACK
    if not np.isfinite(bound):
        return Fraction(0)
    return Fraction(bound)


def compute_tie_gaps(best: PolicyChain, known: BoundedVector) -> Floats:
    """Return (L,) the gap up to which a pair ties with the best action.

    Raises SolverError if floats cannot bound it.
    """
    mdp, each = best.mdp, per_use(best.mdp, known)
    # F collects e along the optimum; at discount 1 only in states from which it ends.
    counted = ~mdp.terminal
    if mdp.discount_exact == 1:
        counted &= best.proper
    taken = np.add.reduceat(best.weights * each, mdp.pair_offsets[:-1])
    moved = best.discounted.solve(np.where(counted, taken, 0.0))
    later = np.maximum(moved.value, 0.0) + moved.error
    return np.asarray(each + mdp.discount * (mdp.transition @ later) + later[mdp.pair_state])
