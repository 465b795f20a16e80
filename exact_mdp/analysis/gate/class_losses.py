"""Losses of recurrent classes: at discount 1 an action may keep the optimum and never attain it.

Such an action belongs to an optimal policy exactly if other optimal actions lead from its next
states to states in which the optimum may stay, without coming back. Else a policy may stay forever
in a recurrent class and lose there, having entered it at state s with probability e(s):

    regret = Σ_s d(s) gap(s) + Σ_s e(s) (V*(s) - V^π(s))

The blame goes to the states of the class from which an optimal action can leave it; if there are
none, to the states in which the policy departs from the optimal policy of the certificate, first to
those with V + w > P w for the w of the proof (`solvers.exact.checker`), as no optimal policy can
use such an action forever. Several states share the blame equally.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.graph import find_reachable_nodes
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.endless.improper import ImproperPolicies
from exact_mdp.solvers.endless.quotient import of_pairs
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.levels import compute_surpluses
from exact_mdp.solvers.values.policy_chain import PolicyChain


def final_class(chain: PolicyChain) -> Integers:
    """Return (S,) the number of each state's recurrent class; -1 for transient and terminal."""
    return np.where(chain.mdp.terminal, -1, chain.classes.label)


def compute_exact_row(mdp: MDP, pair: int) -> tuple[Fraction, frozenset[tuple[int, Fraction]]]:
    """Return the exact expected reward and the exact row of a pair; twins have the same."""
    reward, row = Fraction(0), dict[int, Fraction]()
    for chance, following, gain in mdp.table.row(pair):
        reward += chance * gain
        row[following] = row.get(following, Fraction(0)) + chance
    return reward, frozenset(row.items())


def to_blame(chain: PolicyChain, best: Certificate, lost: Floats) -> Flags:
    """Return the pairs (L,) of a policy to blame for the losses (S,) in its recurrent classes."""
    mdp, table, label = chain.mdp, chain.mdp.table, final_class(chain)
    of, taken, optimal = mdp.pair_state, chain.chosen > 0, best.optimal_pairs
    departs = taken & (mdp.pair_action != best.policy[of])
    # The policy's pairs in states from which an optimal action can leave the class.
    moves = label[table.next] != label[of[table.pair]]
    out = np.logical_or.reduceat(moves, table.offsets[:-1]) & optimal
    leaves = taken & np.logical_or.reduceat(out, mdp.pair_offsets[:-1])[of]
    at_fault, named = taken & ~optimal, np.zeros(mdp.n_states, dtype=bool)
    # Four reasons, the strongest first; each applies to classes for which none was found yet.
    for pairs in (at_fault, leaves, None, departs):
        open_ = ((label >= 0) & (lost > 0) & ~named[label])[of]
        if pairs is None:
            some = _find_third_order_losses(mdp, best, departs & open_)
        else:
            some = pairs & open_
        at_fault = at_fault | some
        named[label[of[some]]] = True
    at_fault = at_fault | _giving_up(chain, best, lost, at_fault)
    # Twins, pairs of the same state with the same row and reward, are to blame, too.
    near = np.flatnonzero(np.isin(of, of[at_fault])).tolist()
    kinds = {(of[pair], compute_exact_row(mdp, pair)) for pair in near if at_fault[pair]}
    at_fault[near] = [(of[pair], compute_exact_row(mdp, pair)) in kinds for pair in near]
    return at_fault


def _giving_up(chain: PolicyChain, best: Certificate, lost: Floats, known: Flags) -> Flags:
    """Return the pairs (L,) with which a policy gives up an infinite value, if none is known yet.

    Each of them alone may keep that value if an optimal policy follows; this policy goes on until
    it has left the states of infinite value.
    """
    mdp, of = chain.mdp, chain.mdp.pair_state
    given_up = (best.infinite_sign > 0) & np.isposinf(lost)
    taken: Flags = (chain.chosen > 0) & given_up[of]
    if not given_up.any() or (known & taken & chain.reached[of]).any():
        return np.zeros(len(of), dtype=bool)
    leaves = taken & (mdp.transition @ (best.infinite_sign <= 0) > 0)
    departs = taken & (mdp.pair_action != best.policy[of])
    # The most specific reason that applies to any pair.
    for reason in (leaves & departs, departs, leaves):
        if reason.any():
            return np.asarray(reason)
    return taken


def _find_third_order_losses(mdp: MDP, best: Certificate, pairs: Flags) -> Flags:
    """Return which of some pairs (L,), in states of finite value, have V + w > P w."""
    falling = np.zeros(len(pairs), dtype=bool)
    if best.g is not None and best.w is not None:
        some = np.flatnonzero(pairs & (best.infinite_sign == 0)[mdp.pair_state])
        third = compute_surpluses(bellman_rows(mdp), best.g, best.h, best.w, pairs=some)[2]
        falling[some] = [top < 0 for top, _ in third]
    return falling


def charge_class_losses(
    label: Integers, came: Floats, by_state: Floats, gap: Floats, wrong: Flags
) -> Floats:
    """Return (S,) the losses of classes, charged to the states that are `wrong` (S,).

    `came` (S,) are arrivals in the classes of `label`, 0 in states that the policy never reaches. A
    class in which some state has a gap (S,) loses by that gap, not by staying.
    """
    # The loss of a class: arrivals times regret, over the states where it is entered.
    inside = label >= 0
    lost = came * np.where(came > 0, by_state, 0.0)
    whole = np.bincount(label[inside], weights=lost[inside], minlength=len(label))
    whole[label[inside & (gap > 0)]] = 0.0
    # Equal parts for the wrong states of each class.
    blamed = inside & wrong
    number = np.bincount(label[blamed], minlength=len(label))
    return np.where(blamed, whole[label] / np.maximum(number[label], 1), 0.0)


def find_attaining_pairs(mdp: MDP, best: Certificate, optimal: Flags, state: int) -> list[int]:
    """Return the optimal pairs (L,) of a state that belong to some optimal policy."""
    pairs = [pair for pair in mdp.pairs_of(state) if optimal[pair]]
    # Every optimal pair attains the value if all policies end.
    if not mdp.ends.has_improper_policy or len(pairs) < 2:
        return pairs
    sign, stays = best.infinite_sign, PolicyChain.of_pairs(mdp, best.pairs).classes.recurrent
    if sign[state] > 0:
        return [pair for pair in pairs if pair == best.pairs[state] or _earns_forever(mdp, pair)]
    if stays[state] or sign[state] < 0:
        return pairs
    # States from which optimal pairs of other states lead to where the optimum may stay.
    used = np.flatnonzero(optimal & (mdp.pair_state != state))
    shape = (mdp.n_states, mdp.n_pairs)
    choice = sp.csr_array((np.ones(len(used)), (mdp.pair_state[used], used)), shape)
    free = find_zero_reward_pairs(mdp, best, optimal)
    stays = stays | np.logical_or.reduceat(free, mdp.pair_offsets[:-1])
    arrives = find_reachable_nodes((choice @ mdp.transition).T.tocsr(), stays & (sign == 0))
    arrives[state] = False
    attaining = []
    for pair in pairs:
        if free[pair] or arrives[mdp.transition[[pair]].indices].any():
            attaining.append(pair)
    return attaining or pairs


def _earns_forever(mdp: MDP, pair: int) -> bool:
    """Return whether a state is worth +∞ to some policy that takes a pair of it each time."""
    state = mdp.pair_state[pair]
    kept = (mdp.pair_state != state) | (np.arange(mdp.n_pairs) == pair)
    return bool(ImproperPolicies(of_pairs(mdp.maximised, np.flatnonzero(kept))).sign[state] > 0)


def find_zero_reward_pairs(mdp: MDP, best: Certificate, optimal: Flags) -> Flags:
    """Return the optimal pairs (L,) of states of value 0 that earn a policy 0 forever."""
    # Start from all states of value 0, and drop those that cannot stay among the others.
    left = np.array([value == 0 for value in best.value], dtype=bool)
    earned = np.array([gain == 0 for gain in mdp.table.expected_gain_exact[0]], dtype=bool)
    while True:
        inside = optimal & earned & left[mdp.pair_state] & (mdp.transition @ ~left == 0)
        kept = np.logical_or.reduceat(inside, mdp.pair_offsets[:-1])
        if (kept == left).all():
            return np.asarray(inside)
        left = kept
