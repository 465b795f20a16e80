"""Where the total reward is infinite, where it is finite, and what can be stayed in for nothing.

End components decide, each by the sign of its best mean reward g (`solvers.endless.means`):

    g > 0   worth +∞ wherever it can be reached without a risk of -∞
    g < 0   never worth staying in: -∞ where nothing else can be reached for sure
    g = 0   where no reward of the component is positive, the pairs that earn nothing can be used
            for ever, and staying is worth 0

In any other model the value depends on more than these signs: where rewards of both signs have a
mean of 0, or where +∞ and -∞ can only be had together. Exact levels say what it is there
(`solvers.exact.find`).

A model with a goal follows other rules: outside the goal nothing can be stayed in. A run that never
arrives is worth `unreached`, +∞ or -∞, in the numbers that are maximised. Where that is -∞, and a
component of positive mean can be left for the goal for sure, going round often enough beforehand
earns more than any number: the least upper bound is +∞, and no policy attains it. Other states may
have it; a model that begins in one is refused by name.

Sources: de Alfaro, Formal Verification of Probabilistic Systems, 1997, chapters 3 and 5; Bertsekas
and Tsitsiklis, Mathematics of Operations Research 16, 1991.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.endless.means import Components
from exact_mdp.solvers.exact.find import falling_costs


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """What is known of a model's states before any finite value is.

    Attributes
    ----------
    mdp : MDP
    graph : Graph
    components : Components
        The end components, ends left out.
    sign : (S,) int64
        1 where the value is +∞, -1 where it is -∞, else 0.
    kept : (L,) bool
        The pairs that lead from finite states to finite states only.
    rest : (S,) int64
        The number of each state's rest, a part of an end component between whose states one moves
        at will and for nothing; -1 where there is none. With a goal it is not allowed to stay.
    inside : (L,) bool
        The pairs with which one moves inside a rest.
    core : (C,) int64
        The components where +∞ is earned.
    missing : (S,) bool
        Where some policy never reaches a goal, if that is worth +∞.
    """

    mdp: MDP
    graph: Graph
    components: Components
    sign: Integers
    kept: Mask
    rest: Integers
    inside: Mask
    core: Integers
    missing: Mask

    @property
    def over(self) -> Mask:
        """(S,) True where all is over: terminal states, or the goal."""
        return self.mdp.terminal if self.mdp.goal is None else self.mdp.goal


def structure(mdp: MDP) -> Structure | None:
    """Return the structure of a model at discount 1; None where signs do not say all."""
    graph, goal = Graph.of(mdp), mdp.goal
    over = mdp.terminal if goal is None else goal
    every, none = np.ones(mdp.n_pairs, dtype=bool), np.arange(0)
    label, inside = graph.end_components(~over[mdp.pair_state])
    components = Components(mdp=mdp, label=label, inside=inside)
    if goal is not None and mdp.unreached == inf:
        missing = label >= 0
        sign = np.where(graph.distance(missing, every) >= 0, 1, 0)
        return Structure(
            mdp=mdp,
            graph=graph,
            components=components,
            sign=sign,
            kept=(sign == 0)[mdp.pair_state],
            rest=np.full(mdp.n_states, -1),
            inside=~every,
            core=none,
            missing=missing,
        )
    rewards = np.sign(mdp.table.expected_gain_exact()[0])
    quiet, still = label, inside
    if rewards[inside].any():
        quiet, still = graph.end_components(inside & (rewards == 0))
    owner, count = label[mdp.pair_state], int(label.max(initial=-1)) + 1

    def any_of(where: Mask, of: Integers) -> Mask:
        return np.bincount(of[where], minlength=count) > 0

    gains, losses = any_of(inside & (rewards > 0), owner), any_of(inside & (rewards < 0), owner)
    best = np.where(gains, 1, np.where(any_of(quiet >= 0, label), 0, -1))
    both = np.flatnonzero(gains & losses)
    best[both] = components.signs(both)
    value_sign = np.append(best, -1)[label]  # the sign of each state's component
    settled = over | (value_sign >= 0) if goal is None else over
    safe = graph.rounds(settled, every) == 0
    win = safe & (graph.distance((value_sign > 0) & safe, graph.every(safe)) >= 0)
    sign = np.where(win, 1, np.where(safe, 0, -1))
    if goal is not None:
        if (bad := win & (mdp.start_distribution > 0)).any():
            raise falling_costs(mdp, bad)
    elif ((graph.distance(value_sign > 0, every) >= 0) & ~win).any():
        return None  # +∞ and -∞ together
    cancel = np.isin(label, both[best[both] == 0])
    if (cancel & (sign == 0)).any():
        return None
    finite_pairs = (sign == 0)[mdp.pair_state] & graph.every(sign == 0)
    return Structure(
        mdp=mdp,
        graph=graph,
        components=components,
        sign=sign,
        kept=finite_pairs,
        rest=np.where(sign == 0, quiet, -1),
        inside=still & finite_pairs,
        core=np.unique(label[win & (value_sign > 0)]),
        missing=np.zeros(mdp.n_states, dtype=bool),
    )


def finite(parts: Structure) -> Derived:
    """Return the model of the finite values.

    Rests are merged, each a state with a pair to the end where staying is allowed. The value of a
    state is that of its label.
    """
    mdp, rest = parts.mdp, parts.rest
    pairs = parts.kept & ~parts.inside & ~parts.over[mdp.pair_state]
    count = int(rest.max(initial=-1)) + 1
    leaving = np.bincount(rest[parts.graph.having(pairs) & (rest >= 0)], minlength=count) > 0
    free = mdp.goal is None
    merged = np.bincount(rest[rest >= 0], minlength=count) > 0
    merged &= leaving | (not free)  # the others are at an end
    number = np.append(np.where(merged, np.cumsum(merged) - 1, -1), -1)
    label = number[rest]
    open_ = (parts.sign == 0) & ~parts.over & (rest < 0)
    label[open_] = int(merged.sum()) + np.arange(int(open_.sum()))
    rests = [(int(k), Fraction(0)) for k in number[:-1][merged]] if free else []
    return derived(mdp, np.flatnonzero(pairs), label, rests=rests)
