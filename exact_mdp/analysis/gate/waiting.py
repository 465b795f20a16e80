"""Waiting for ever: at discount 1 an action may keep the optimal value and never attain it.

Such an action belongs to an optimal policy exactly if other optimal actions lead from its next
states to where the optimum may stay, without coming back. What a policy loses by waiting is lost in
a class of states that it never leaves, by the state s at which it comes in with probability e(s):

    regret = Σ_s d(s) gap(s) + Σ_s e(s) (V*(s) - V^π(s))

To blame are the states of the class in which an optimal action may lead out of it; else those in
which the policy departs from the optimal one of the certificate, first where V + w > P w with the w
of the proof (`solvers.exact.checker`): no optimal policy can use such an action for ever. Where
there are several states, each has an equal share.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.graph import closure, endless, strong_components
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.levels import surplus
from exact_mdp.solvers.values.policy_chain import PolicyChain


def final_class(chain: PolicyChain) -> Integers:
    """Return (S,) the number of the class that a state is in and a policy never leaves, or -1."""
    graph, mdp = chain.graph, chain.mdp
    label = strong_components(graph)
    source = np.repeat(np.arange(mdp.n_states), np.diff(graph.indptr))
    left = np.zeros(int(label.max()) + 1, dtype=bool)
    left[label[source[label[source] != label[graph.indices]]]] = True
    return np.where(left[label] | mdp.terminal, -1, label)


def ways_out(mdp: MDP, label: Integers, optimal: Flags) -> Flags:
    """Return (S,) states of a final class (S,) in which an optimal pair may lead out of it."""
    matrix = mdp.transition
    pair = np.repeat(np.arange(mdp.n_pairs), np.diff(matrix.indptr))
    out = np.zeros(mdp.n_pairs, dtype=bool)
    out[pair[label[matrix.indices] != label[mdp.pair_state[pair]]]] = True
    return np.logical_or.reduceat(out & optimal, mdp.pair_offsets[:-1]) & (label >= 0)


def to_blame(chain: PolicyChain, best: Certificate, lost: Floats) -> Flags:
    """Return (L,) pairs of a policy that are to blame for what is lost (S,) in its classes."""
    mdp, label = chain.mdp, final_class(chain)
    of, taken, optimal = mdp.pair_state, chain.chosen > 0, np.asarray(best.optimal_pairs)
    departs = taken & (mdp.pair_action != best.policy[of])
    at_fault, named = taken & ~optimal, np.zeros(mdp.n_states, dtype=bool)
    for pairs in (at_fault, taken & ways_out(mdp, label, optimal)[of], None, departs, taken):
        open_ = ((label >= 0) & (lost > 0) & ~named[label])[of]
        some = _falling(mdp, best, departs & open_) if pairs is None else pairs & open_
        at_fault = at_fault | some
        named[label[of[some]]] = True
    rows = bellman_rows(mdp)  # twins of an action are to blame with it
    following, weight = rows.next.tolist(), rows.weight.tolist()
    entries = map(slice, rows.offsets[:-1].tolist(), rows.offsets[1:].tolist())
    parts = zip(of.tolist(), rows.constant.tolist(), entries, strict=True)
    content = [(s, c, *following[each], *weight[each]) for s, c, each in parts]
    blamed = {content[pair] for pair in np.flatnonzero(at_fault)}
    return np.array([each in blamed for each in content])


def _falling(mdp: MDP, best: Certificate, pairs: Flags) -> Flags:
    """Return those pairs (L,) of finite states for which V + w > P w."""
    falling = np.zeros(len(pairs), dtype=bool)
    if best.g is not None and best.w is not None:
        some = np.flatnonzero(pairs & (best.infinite_sign == 0)[mdp.pair_state])
        third, _ = surplus(bellman_rows(mdp), best.g, best.h, best.w, pairs=some)[2]
        falling[some] = [top < 0 for top in third]
    return falling


def shares(label: Integers, came: Floats, by_state: Floats, gap: Floats, wrong: Flags) -> Floats:
    """Return (S,) what is lost by waiting, charged to the states (S,) that are `wrong`.

    `came` (S,) are arrivals in the classes of `label`, 0 where the policy never comes. Where the
    gap (S,) of a state is not 0, that is what is lost there.
    """
    inside = label >= 0
    lost = np.where(inside & (came > 0), came * np.where(came > 0, by_state, 0.0), 0.0)
    whole = np.bincount(label[inside], weights=lost[inside], minlength=len(label))
    whole[label[inside & (gap > 0)]] = 0.0
    blamed = inside & wrong & (whole[label] > 0)
    number = np.bincount(label[blamed], minlength=len(label))
    return np.where(blamed, whole[label] / np.maximum(number[label], 1), 0.0)


def taking(mdp: MDP, pairs: Integers) -> PolicyChain:
    """Return the chain of a policy that takes these pairs (S,)."""
    chosen = np.zeros(mdp.n_pairs)
    chosen[pairs] = 1.0
    return PolicyChain(mdp=mdp, chosen=chosen)


def attaining(mdp: MDP, best: Certificate, optimal: Flags, state: int) -> list[int]:
    """Return the optimal pairs (L,) of a state that belong to some optimal policy."""
    pairs = [pair for pair in mdp.pairs_of(state) if optimal[pair]]
    sign, stays = best.infinite_sign, final_class(taking(mdp, best.pairs)) >= 0
    stays |= mdp.terminal
    if not endless(mdp) or len(pairs) < 2 or stays[state] or sign[state] < 0:
        return pairs
    used = np.flatnonzero(optimal & (mdp.pair_state != state))
    choice = sp.csr_array(
        (np.ones(len(used)), (mdp.pair_state[used], used)), (mdp.n_states, mdp.n_pairs)
    )
    home = stays & (sign == sign[state])
    arrives = closure((choice @ mdp.transition).T.tocsr(), home)
    arrives[state] = False
    attaining_pairs = [pair for pair in pairs if arrives[mdp.transition[[pair]].indices].any()]
    return attaining_pairs or pairs
