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
arrives is worth `unreached`, +∞ or -∞, in the numbers that are maximised.

Sources: de Alfaro, Formal Verification of Probabilistic Systems, 1997, chapters 3 and 5; Bertsekas
and Tsitsiklis, Mathematics of Operations Research 16, 1991; Baier, Bertrand, Dubslaff, Gburek and
Sankur, Stochastic Shortest Paths and Weight-Bounded Properties in Markov Decision Processes, LICS
2018, for components in which rewards cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import inf

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.average.certificate import AverageCertificate
from exact_mdp.solvers.average.certify import certify_average
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.endless.means import Component, component, exact_mean, surplus
from exact_mdp.solvers.proof.endless import aperiodic

SHOWN = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """States (K,) between which one moves at will: a component whose pairs are used for ever.

    Attributes
    ----------
    states : (K,) int64
    height : list of Fraction, of length K
        The potential h: all 0 where nothing is earned.
    worth : Fraction or None
        What staying is worth, less the height of where one comes from; None where it is not
        allowed to stay.
    stay : (J,) int64
        The pairs that stay for that worth.
    swing : Fraction or None
        What staying for ever is worth at most, where rewards cancel, if that is more; less height.
    second : list of Fraction, of length K
        A potential of the heights, which proves `swing`; all 0 where there are none.
    """

    states: Integers
    height: list[Fraction]
    worth: Fraction | None
    stay: Integers
    swing: Fraction | None = None
    second: list[Fraction] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """What is known of a model's states before any finite value is.

    Attributes
    ----------
    mdp : MDP
        Its rows sum to 1 exactly.
    graph : Graph
    sign : (S,) int64
        1 where the value is +∞, -1 where it is -∞, else 0.
    kept : (L,) bool
        The pairs that lead from finite states to finite states only.
    inside : (L,) bool
        Those of them with which one moves inside a rest.
    rests : list of Rest
        Terminal states left out.
    cores, losing : list of Component
        Where +∞ is earned, and where all is lost; none where a goal or a drift decides that.
    given_up : (S,) int64
        The round in which states of -∞ were given up, see `Graph.rounds`.
    missing : (S,) bool
        Where some policy never reaches a goal, if that is worth +∞.
    drift : AverageCertificate, optional
        The best mean reward from each state, where +∞ and -∞ come together.
    """

    mdp: MDP
    graph: Graph
    sign: Integers
    kept: Mask
    inside: Mask
    rests: list[Rest]
    cores: list[Component]
    losing: list[Component]
    given_up: Integers
    missing: Mask
    drift: AverageCertificate | None = None


def structure(mdp: MDP) -> Structure:
    """Return the structure of a model at discount 1, whose rows sum to 1 exactly."""
    graph = Graph.of(mdp)
    rewards = np.sign(mdp.table.expected_gain_exact()[0])
    terminal = mdp.terminal if mdp.goal is None else mdp.goal
    moving = ~terminal[mdp.pair_state]
    label, inside = graph.end_components(moving)
    if mdp.goal is not None and mdp.unreached == inf:
        return _missing(mdp, graph, label, terminal)
    found = [
        component(mdp, graph, np.flatnonzero(label == number), inside, rewards)
        for number in range(int(label.max(initial=-1)) + 1)
    ]
    every = np.ones(mdp.n_pairs, dtype=bool)
    above, best = (
        _of([each for each in found if each.sign == sign], mdp.n_states) for sign in (1, 0)
    )
    if mdp.goal is not None:
        best = terminal
        if (bad := above & (graph.rounds(best, every) == 0)).any():
            raise refusal(
                mdp,
                bad,
                "costs can be driven to -∞ before the goal is reached, so that no policy is best",
            )
        above[:] = False
    else:
        best |= terminal
    drift = None
    given_up = graph.rounds(above | best, every)
    might = graph.distance(above, every) >= 0
    safe = given_up == 0
    win = graph.distance(above, every & graph.every(safe)) >= 0
    sign = np.where(win & safe, 1, np.where(safe, 0, -1))
    if (might & (sign < 1)).any():
        drift = certify_average(mdp)
        sign = np.array([(each > 0) - (each < 0) for each in drift.gain])
        _check_drift(mdp, graph, sign, drift.gain)
    kept = (sign == 0)[mdp.pair_state] & graph.every(sign == 0)
    rests: list[Rest] = []
    moved = np.zeros(mdp.n_pairs, dtype=bool)
    for each in found:
        if sign[each.states[0]] == 0 and (each.sign == 0 or mdp.goal is not None):
            for rest, pairs in _rests(mdp, graph, each, rewards, kept & inside):
                rests.append(rest)
                moved[pairs] = True
    plain = mdp.goal is None and drift is None
    return Structure(
        mdp=mdp,
        graph=graph,
        sign=sign,
        kept=kept,
        inside=moved,
        rests=rests,
        cores=[each for each in found if each.sign == 1 and plain and sign[each.states[0]] == 1],
        losing=[each for each in found if plain and sign[each.states[0]] == -1],
        given_up=np.where(sign < 0, given_up, 0),
        missing=np.zeros(mdp.n_states, dtype=bool),
        drift=drift,
    )


def _missing(mdp: MDP, graph: Graph, label: Integers, goal: Mask) -> Structure:
    """Return the structure of a model in which never reaching the goal is worth +∞."""
    every = np.ones(mdp.n_pairs, dtype=bool)
    sign = np.where(graph.distance(label >= 0, every & ~goal[mdp.pair_state]) >= 0, 1, 0)
    none = np.zeros(mdp.n_pairs, dtype=bool)
    return Structure(
        mdp=mdp,
        graph=graph,
        sign=sign,
        kept=(sign == 0)[mdp.pair_state],
        inside=none,
        rests=[],
        cores=[],
        losing=[],
        given_up=np.zeros(mdp.n_states, dtype=np.int64),
        missing=label >= 0,
    )


def _of(components: Sequence[Component], states: int) -> Mask:
    found = np.zeros(states, dtype=bool)
    for each in components:
        found[each.states] = True
    return found


def _check_drift(mdp: MDP, graph: Graph, sign: Integers, mean: Numbers) -> None:
    """Raise ModelError where a mean of 0 is made of components that gain and others that lose."""
    suspect = (sign == 0)[mdp.pair_state] & ~graph.every(sign == 0)
    for pair in np.flatnonzero(suspect).tolist():
        if sum(p * mean[state] for p, state, _ in mdp.table.row(pair)) == 0:
            state = mdp.pair_state[[pair]]
            bad = np.isin(np.arange(mdp.n_states), state)
            raise refusal(mdp, bad, "gains and losses without end cancel on average")


def _rests(
    mdp: MDP, graph: Graph, each: Component, rewards: Numbers, inside: Mask
) -> list[tuple[Rest, Integers]]:
    """Return what can be stayed in of a component of mean 0, and the pairs that do."""
    own = np.flatnonzero(inside & np.isin(mdp.pair_state, each.states))
    height = [Fraction(0)] * len(each.states)
    tight = np.zeros(mdp.n_pairs, dtype=bool)
    if (rewards[own] > 0).any():
        height = each.mean.potential
        gain = surplus(bellman_rows(each.own.mdp), [*height, Fraction(0)])
        source = each.own.source
        tight[source[[pair for pair, number in enumerate(gain[:-1]) if number == 0]]] = True
    else:
        tight[own[rewards[own] == 0]] = True
    label, staying = graph.end_components(tight)
    place = {state: i for i, state in enumerate(each.states.tolist())}
    found = []
    for number in range(int(label.max(initial=-1)) + 1):
        states = np.flatnonzero(label == number)
        pairs = np.flatnonzero(staying & (label == number)[mdp.pair_state])
        here = [height[place[state]] for state in states.tolist()]
        found.append((_rest(mdp, graph, states, pairs, here, rewards), pairs))
    return found


def _rest(
    mdp: MDP,
    graph: Graph,
    states: Integers,
    pairs: Integers,
    height: list[Fraction],
    rewards: Numbers,
) -> Rest:
    nothing = [Fraction(0)] * len(states)
    if mdp.goal is not None:
        return Rest(states=states, height=height, worth=None, stay=pairs[:0], second=nothing)
    if len(set(height)) == 1:
        return Rest(states=states, height=nothing, worth=Fraction(0), stay=pairs, second=nothing)
    quiet = np.zeros(mdp.n_pairs, dtype=bool)
    quiet[pairs[rewards[pairs] == 0]] = True
    label, staying = graph.end_components(quiet)
    own, worth, stay = label[states], None, pairs[:0]
    for number in range(int(label.max(initial=-1)) + 1):
        level = -height[int(np.flatnonzero(own == number)[0])]
        if worth is None or level > worth:
            worth = level
            stay = np.flatnonzero(staying & (label == number)[mdp.pair_state])
    names = np.full(mdp.n_states, -1, dtype=np.int64)
    names[states] = np.arange(len(states))
    earned = [-height[names[state]] for state in mdp.pair_state[pairs].tolist()]
    most = exact_mean(derived(mdp, pairs, names, earned=earned))
    swing = None
    if worth is None or most.mean > worth:
        after = [
            np.unique(mdp.table.next[slice(*mdp.table.offsets[p : p + 2])]) for p in most.pairs
        ]
        if aperiodic([each.tolist() for each in after], states.tolist()):
            worth, stay = most.mean, most.pairs
        else:
            swing = most.mean
    return Rest(
        states=states, height=height, worth=worth, stay=stay, swing=swing, second=most.potential
    )


def refusal(mdp: MDP, states: Mask, what: str) -> ModelError:
    """Return the error to raise where the total reward has no limit."""
    listed = np.flatnonzero(states).tolist()
    named = ", ".join(f"({mdp.space.label(state)})" for state in listed[:SHOWN])
    more = f" and {len(listed) - SHOWN} more" if len(listed) > SHOWN else ""
    return ModelError(
        f"at discount 1 the total reward has no limit: {what}",
        where=f"state {named}{more}",
        fix="choose a discount below 1 (discount=0.95), stop after N steps (--horizon "
        f"{mdp.time_limit or 'N'}), or ask for the average reward",
    )


def finite(found: Structure) -> tuple[Derived, Mask]:
    """Return the model of the finite values, and which of its pairs (L',) swing for ever.

    Rests are merged, each a state with a pair to the end. The value of a state is that of its
    label, plus its height in its rest.
    """
    mdp, sign = found.mdp, found.sign
    over = mdp.terminal if mdp.goal is None else mdp.goal
    label = np.full(mdp.n_states, -1, dtype=np.int64)
    pairs = found.kept & ~found.inside & ~over[mdp.pair_state]
    leaving = found.graph.having(pairs)
    open_ = (sign == 0) & ~over
    rests: list[tuple[int, Fraction]] = []
    swings: list[int] = []
    height: dict[int, Fraction] = {}
    number = 0
    for rest in found.rests:
        open_[rest.states] = False
        height |= zip(rest.states.tolist(), rest.height, strict=True)
        flat = not any(rest.height)
        if flat and rest.worth is not None and not leaving[rest.states].any():
            continue
        label[rest.states] = number
        if rest.worth is not None:
            rests.append((number, rest.worth))
        if rest.swing is not None:
            swings.append(-1 - len(rests))
            rests.append((number, rest.swing))
        number += 1
    label[open_] = number + np.arange(int(open_.sum()))
    chosen = np.flatnonzero(pairs)
    earned = None
    if any(height.values()):
        top, below = mdp.table.expected_gain_exact()
        earned = []
        for pair in chosen.tolist():
            ahead = sum(p * height.get(state, 0) for p, state, _ in mdp.table.row(pair))
            own = Fraction(int(top[pair]), int(below[pair]))
            earned.append(own + ahead - height.get(int(mdp.pair_state[pair]), 0))
    whole = derived(mdp, chosen, label, earned=earned, rests=rests)
    return whole, np.isin(whole.source, swings)
