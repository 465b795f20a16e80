"""Where the total reward is infinite, where it is finite, and what can be stayed in for nothing.

    V(s) = sup over policies of lim inf over n of E[r_1 + … + r_n]          (discount 1)

End components decide, each by its best mean reward g (`solvers.endless.means`):

    g > 0   worth +∞ wherever it can be reached without a risk of -∞
    g < 0   never worth staying in: -∞ where nothing else can be reached for sure
    g = 0   the pairs with r + P h - h = 0, h a potential, can be used for ever. Where they all earn
            nothing, staying is worth 0. Where rewards cancel, n steps earn h(s) - E h(X_n), and the
            least mean of h that some policy keeps up says what staying is worth: its last term has
            a limit where the policy's classes have no period. Where they have one, the total swings

Where +∞ and -∞ can only be had together, each with some probability, the mean reward of the whole
decides: the greatest E[g] over the component that a policy stays in at last, an exact number again.
If that is 0, or if a total that swings might be better than all else that can be had, lim inf is no
longer a matter of each state by itself (a policy does better to mix the phases), and the model is
refused by name.

A model with a goal follows other rules: outside the goal nothing can be stayed in. A run that never
arrives is worth `unreached`, +∞ or -∞, in the numbers that are maximised. Where that is -∞, and a
component of positive mean can be left for the goal for sure, going round often enough beforehand
earns more than any number: the least upper bound is +∞, and no policy attains it. Other states may
have it; a model that begins in one is refused by name.

Sources: de Alfaro, Formal Verification of Probabilistic Systems, 1997, chapters 3 and 5; Bertsekas
and Tsitsiklis, Mathematics of Operations Research 16, 1991; Baier, Bertrand, Dubslaff, Gburek and
Sankur, Stochastic Shortest Paths and Weight-Bounded Properties in Markov Decision Processes, LICS
2018, for components in which rewards cancel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf

import numpy as np

from exact_mdp.mdp.chain import ways_out
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.average.certificate import AverageCertificate
from exact_mdp.solvers.average.certify import certify_average
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.endless.means import Components, exact_mean, surplus
from exact_mdp.solvers.proof.endless import aperiodic

SHOWN = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Tilted:
    """A rest in which rewards cancel: what is earned from s to t is height(s) - height(t).

    Attributes
    ----------
    height : dict of Fraction by state
        The potential h.
    worth : Fraction or None
        What staying is worth, less the height of where one comes from; None where that swings.
    stay : (J,) int64
        The pairs that stay for that worth.
    swing : Fraction or None
        What staying for ever is worth at most, if that is more; less height.
    second : dict of Fraction by state
        A potential of the heights, which proves that nothing is worth more.
    """

    height: Mapping[int, Fraction]
    worth: Fraction | None
    stay: Integers
    swing: Fraction | None
    second: Mapping[int, Fraction]


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """What is known of a model's states before any finite value is.

    Attributes
    ----------
    mdp : MDP
        Its rows sum to 1 exactly.
    graph : Graph
    components : Components
        The end components, ends left out.
    sign : (S,) int64
        1 where the value is +∞, -1 where it is -∞, else 0.
    kept : (L,) bool
        The pairs that lead from finite states to finite states only.
    rest : (S,) int64
        The number of each state's rest, a part of an end component between whose states one moves
        at will; -1 where there is none.
    inside : (L,) bool
        The pairs with which one moves inside a rest.
    tilted : dict of Tilted by rest
        In the other rests nothing is earned, and staying is worth 0; with a goal it is not allowed.
    core, losing : (C,) int64
        The components where +∞ is earned, and where all is lost; none where a drift decides that,
        or, of the latter, a goal.
    given_up : (S,) int64
        The round in which states of -∞ were given up, see `Graph.rounds`.
    missing : (S,) bool
        Where some policy never reaches a goal, if that is worth +∞.
    drift : AverageCertificate, optional
        The best mean reward from each state, where +∞ and -∞ come together.
    """

    mdp: MDP
    graph: Graph
    components: Components
    sign: Integers
    kept: Mask
    rest: Integers
    inside: Mask
    tilted: Mapping[int, Tilted]
    core: Integers
    losing: Integers
    given_up: Integers
    missing: Mask
    drift: AverageCertificate | None = None

    @property
    def over(self) -> Mask:
        """(S,) True where all is over: terminal states, or the goal."""
        return self.mdp.terminal if self.mdp.goal is None else self.mdp.goal

    @cached_property
    def height(self) -> dict[int, Fraction]:
        """The heights of states in tilted rests."""
        return {state: h for each in self.tilted.values() for state, h in each.height.items()}

    @cached_property
    def gaining(self) -> tuple[Integers, list[Fraction], Integers]:
        """States, potentials and pairs of the cores."""
        return self.components.proof(self.core, 1)


def structure(mdp: MDP) -> Structure:
    """Return the structure of a model at discount 1, whose rows sum to 1 exactly."""
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
            tilted={},
            core=none,
            losing=none,
            given_up=np.zeros(mdp.n_states, dtype=np.int64),
            missing=missing,
        )
    rewards = np.sign(mdp.table.expected_gain_exact()[0])
    quiet, still = label, inside
    if rewards[inside].any():
        quiet, still = graph.end_components(inside & (rewards == 0))
    best, both = _best_means(components, rewards, quiet)
    worth = np.append(best, -1)[label]  # the sign of each state's component
    settled = over | (worth >= 0) if goal is None else over
    given_up = graph.rounds(settled, every)
    safe, drift = given_up == 0, None
    win = graph.distance((worth > 0) & safe, every & graph.every(safe)) >= 0
    sign = np.where(win & safe, 1, np.where(safe, 0, -1))
    if goal is not None:
        if (bad := (sign > 0) & (mdp.start_distribution > 0)).any():
            raise refusal(
                mdp, bad, "no policy has the best value: costs fall without end before the goal"
            )
    elif ((graph.distance(worth > 0, every) >= 0) & (sign < 1)).any():
        drift = certify_average(mdp)
        sign = np.array([(each > 0) - (each < 0) for each in drift.value])
        _check_drift(mdp, graph, sign, drift.value)
    kept = (sign == 0)[mdp.pair_state] & graph.every(sign == 0)
    tilted: dict[int, Tilted] = {}
    rest, moved = quiet, still
    uneven = both & (best == 0)
    if uneven.any():
        chosen = np.flatnonzero(uneven & (sign[_first(label, len(best))] == 0))
        rest, moved, tilted = _tilted(components, graph, rewards, still, chosen)
    plain = goal is None and drift is None
    of_sign = sign[_first(label, len(best))]
    return Structure(
        mdp=mdp,
        graph=graph,
        components=components,
        sign=sign,
        kept=kept,
        rest=np.where(sign == 0, rest, -1),
        inside=moved & kept,
        tilted=tilted,
        core=np.flatnonzero((best > 0) & (of_sign > 0)) if drift is None else none,
        losing=np.flatnonzero(of_sign < 0) if plain else none,
        given_up=np.where(sign < 0, given_up, 0),
        missing=np.zeros(mdp.n_states, dtype=bool),
        drift=drift,
    )


def _first(label: Integers, count: int) -> Integers:
    """Return (C,) a state of each component."""
    found = np.zeros(count, dtype=np.int64)
    found[label[label >= 0]] = np.flatnonzero(label >= 0)
    return found


def _best_means(components: Components, rewards: Numbers, quiet: Integers) -> tuple[Integers, Mask]:
    """Return (C,) the signs of the best mean rewards, and where rewards of both signs are met."""
    label, inside = components.label, components.inside
    owner, count = label[components.mdp.pair_state], int(label.max(initial=-1)) + 1

    def any_of(where: Mask, of: Integers) -> Mask:
        return np.bincount(of[where], minlength=count) > 0

    gains, losses = any_of(inside & (rewards > 0), owner), any_of(inside & (rewards < 0), owner)
    free = any_of(quiet >= 0, label)
    best = np.where(gains, 1, np.where(free, 0, -1))
    both = gains & losses
    best[both] = components.signs(np.flatnonzero(both))
    return best, both


def _check_drift(mdp: MDP, graph: Graph, sign: Integers, mean: Numbers) -> None:
    """Raise ModelError where a mean of 0 is made of components that gain and others that lose."""
    suspect = (sign == 0)[mdp.pair_state] & ~graph.every(sign == 0)
    for pair in np.flatnonzero(suspect).tolist():
        if sum(p * mean[state] for p, state, _ in mdp.table.row(pair)) == 0:
            bad = np.isin(np.arange(mdp.n_states), mdp.pair_state[pair])
            raise refusal(
                mdp,
                bad,
                "the total reward may have no limit: gains and losses without end cancel",
            )


def _tilted(
    components: Components,
    graph: Graph,
    rewards: Numbers,
    still: Mask,
    chosen: Integers,
) -> tuple[Integers, Mask, dict[int, Tilted]]:
    """Return rests and their pairs where some `chosen` components have rewards of both signs."""
    mdp, label = components.mdp, components.label
    moved = still & ~np.isin(label, chosen)[mdp.pair_state]
    height: dict[int, Fraction] = {}
    for number in chosen.tolist():
        states, own = components.among([number])
        best = exact_mean(own)
        height |= zip(states.tolist(), best.potential, strict=True)
        gain = surplus(bellman_rows(own.mdp), [*best.potential, Fraction(0)])
        moved[own.source[[pair for pair, x in enumerate(gain[:-1]) if x == best.mean]]] = True
    rest, moved = graph.end_components(moved)
    found = {}
    for number in np.unique(rest[np.isin(label, chosen) & (rest >= 0)]).tolist():
        states = np.flatnonzero(rest == number)
        pairs = np.flatnonzero(moved & (rest == number)[mdp.pair_state])
        here = {state: height[state] for state in states.tolist()}
        if len({*here.values()}) > 1:
            found[number] = _sloping(mdp, graph, states, pairs, here, rewards)
    return rest, moved, found


def _sloping(
    mdp: MDP,
    graph: Graph,
    states: Integers,
    pairs: Integers,
    height: dict[int, Fraction],
    rewards: Numbers,
) -> Tilted:
    """Return what staying in a tilted rest is worth."""
    if mdp.goal is not None:
        return Tilted(height=height, worth=None, stay=pairs[:0], swing=None, second={})
    quiet = np.zeros(mdp.n_pairs, dtype=bool)
    quiet[pairs[rewards[pairs] == 0]] = True
    label, staying = graph.end_components(quiet)
    worth, stay = None, pairs[:0]
    for state in states[label[states] >= 0].tolist():
        if worth is None or -height[state] > worth:
            worth = -height[state]
            stay = np.flatnonzero(staying & (label == label[state])[mdp.pair_state])
    names = np.full(mdp.n_states, -1, dtype=np.int64)
    names[states] = np.arange(len(states))
    earned = [-height[state] for state in mdp.pair_state[pairs].tolist()]
    most, swing = exact_mean(derived(mdp, pairs, names, earned=earned)), None
    if worth is None or most.mean > worth:
        after = [mdp.table.next[slice(*mdp.table.offsets[p : p + 2])] for p in most.pairs]
        if aperiodic([each.tolist() for each in after], states.tolist()):
            worth, stay = most.mean, most.pairs
        else:
            swing = most.mean
    second = dict(zip(states.tolist(), most.potential, strict=True))
    return Tilted(height=height, worth=worth, stay=stay, swing=swing, second=second)


def sign_at_start(mdp: MDP, sign: Integers) -> int:
    """Return 1 where the start is worth +∞, -1 where -∞, else 0; raises ModelError for a mix."""
    signs = {int(sign[state]) for state, weight in mdp.start if weight} - {0}
    if len(signs) > 1:
        raise ModelError(
            "the value is +∞ from one state of the start and -∞ from another",
            where="start",
            fix="start in one state: --start, or mdp.with_(start=…)",
        )
    return signs.pop() if signs else 0


def refusal(mdp: MDP, states: Mask, what: str) -> ModelError:
    """Return the error to raise where no total is known to be the best."""
    listed = np.flatnonzero(states).tolist()
    named = ", ".join(f"({mdp.space.label(state)})" for state in listed[:SHOWN])
    more = f" and {len(listed) - SHOWN} more" if len(listed) > SHOWN else ""
    return ModelError(
        f"at discount 1 {what}",
        where=f"state {named}{more}",
        fix=ways_out(mdp),
    )


def finite(found: Structure) -> tuple[Derived, Mask]:
    """Return the model of the finite values, and which of its pairs (L',) swing for ever.

    Rests are merged, each a state with a pair to the end where staying is allowed. The value of a
    state is that of its label, plus its height.
    """
    mdp, rest = found.mdp, found.rest
    pairs = found.kept & ~found.inside & ~found.over[mdp.pair_state]
    count = int(rest.max(initial=-1)) + 1
    leaving = np.bincount(rest[found.graph.having(pairs) & (rest >= 0)], minlength=count) > 0
    uneven = np.zeros(count, dtype=bool)
    uneven[list(found.tilted)] = True
    free = mdp.goal is None
    merged = np.bincount(rest[rest >= 0], minlength=count) > 0
    merged &= leaving | uneven | (not free)  # the others are at an end
    number = np.append(np.where(merged, np.cumsum(merged) - 1, -1), -1)
    label = number[rest]
    open_ = (found.sign == 0) & ~found.over & (rest < 0)
    label[open_] = int(merged.sum()) + np.arange(int(open_.sum()))
    rests = [(int(k), Fraction(0)) for k in number[:-1][merged & ~uneven]] if free else []
    swings = []
    for k, each in found.tilted.items():
        if each.worth is not None:
            rests.append((int(number[k]), each.worth))
        if each.swing is not None:
            swings.append(-1 - len(rests))
            rests.append((int(number[k]), each.swing))
    chosen, earned = np.flatnonzero(pairs), None
    if height := found.height:
        top, below = mdp.table.expected_gain_exact()
        earned = []
        for pair in chosen.tolist():
            ahead = sum(p * height.get(state, 0) for p, state, _ in mdp.table.row(pair))
            own = Fraction(int(top[pair]), int(below[pair]))
            earned.append(own + ahead - height.get(int(mdp.pair_state[pair]), 0))
    whole = derived(mdp, chosen, label, earned=earned, rests=rests)
    return whole, np.isin(whole.source, swings)
