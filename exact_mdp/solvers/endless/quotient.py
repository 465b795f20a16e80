"""Quotients: models of some pairs of another model, with states merged, and an end added.

    build_quotient(mdp, pairs, new_state)      pair l leads from new_state(s) to new_state(s')

The new state -1 is the end. Merged states are the states of one end component that need not be
distinguished: a policy that can do something in one of them can do it in all (de Alfaro, Formal
Verification of Probabilistic Systems, 1997, section 3.3). Stops are further pairs, which lead to
the end with a given reward.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.graph import Mask, PairGraph
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers, OutcomeTable, Rows, make_ones, to_integer_array
from exact_mdp.solvers.bounds.bounds import improve_policy
from exact_mdp.solvers.bounds.gains import Advantages
from exact_mdp.solvers.claims import SolverError, Status

Improve = Callable[[MDP, Integers], tuple[Integers, Floats, Advantages]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Quotient:
    """A model of S' states and L' pairs, whose last state is the end, and the way back from it."""

    mdp: MDP
    new_state: Integers  # (S,) the state here of each state of the other model
    source: Integers  # (L',) the original pair of each pair; -1 - i for stop i; L for the end

    def lift_pairs(
        self, graph: PairGraph, merged: tuple[Integers, Mask], chosen: Integers
    ) -> Integers:
        """Return pairs (S,) of the other model, given pairs (S',) of this one, which make them.

        `graph` belongs to the other model, and `merged` says which of its states became one: the
        component (S,) of each state, or -1, and the pairs (L,) inside. States that became the end
        take their first pair.
        """
        component, inside = merged
        pairs = np.empty(len(component), dtype=np.int64)
        choose_first_pairs(graph, np.ones(len(inside), dtype=bool), pairs)
        # States that were not merged take the pair itself.
        taken = self.source[chosen][self.new_state]
        leaves = (taken >= 0) & (taken < len(inside))
        single = leaves & (component < 0)
        pairs[single] = taken[single]
        # Stay in a component that is not left; in one that is, go to the state whose pair leaves.
        staying = inside & ((component >= 0) & ~leaves)[graph.pair_state]
        choose_first_pairs(graph, staying, pairs)
        ways = taken[(component >= 0) & leaves]
        pairs[graph.pair_state[ways]] = ways
        target = graph.find_states_with(staying)
        target[graph.pair_state[ways]] = True
        choose_nearer_pairs(graph, target, inside, pairs)
        return pairs

    def omit_losing_pairs(self, improve: Improve = improve_policy) -> Quotient:
        """Return a model in which every policy ends, without the pairs that clearly lose in cycles.

        Policy iteration in floats, from a policy that ends, finds these pairs.
        """
        mdp = self.mdp
        if mdp.ends.every_policy_ends:
            return self
        # A policy that always moves nearer to the end is proper; improve it.
        graph, pairs = PairGraph.of(mdp), mdp.pair_offsets[:-1].copy()
        every = np.ones(mdp.n_pairs, dtype=bool)
        choose_nearer_pairs(graph, mdp.terminal, every, pairs)
        pairs, _, gain = improve(mdp, pairs)
        _, inside = graph.end_components(~mdp.terminal[mdp.pair_state])
        losing = inside & (gain.value < -gain.noise)
        losing[pairs] = False
        # In every component some pair loses as much as staying does on average. The fewer pairs
        # are omitted, and the more these lose, the easier the omission is to verify: lower the
        # limit of the loss step by step until every policy ends. Measured: factors from 2 to 256
        # leave as many models unsolved.
        limit = float(gain.value.min())
        while losing.any():
            limit /= 16
            pairs = np.flatnonzero(~(losing & (gain.value <= limit)))
            part = of_pairs(mdp, pairs)
            if part.ends.every_policy_ends:
                return replace(self, mdp=part, source=self.source[pairs])
            if not (losing & (gain.value > limit)).any():
                break
        raise SolverError(Status.NO_BOUND, "staying forever loses too little a step")


def of_pairs(mdp: MDP, pairs: Integers) -> MDP:
    """Return the model with only some of its pairs, at least one for each state."""
    own = {name: getattr(mdp, name)[pairs] for name in ("pair_state", "pair_action")}
    return mdp.with_(table=mdp.table.of_pairs(pairs), **own)


def build_quotient(
    mdp: MDP,
    pairs: Integers,
    new_state: Integers,
    *,
    zero_rewards: bool = False,
    stops: Sequence[tuple[int, Fraction]] = (),
) -> Quotient:
    """Return the model of some pairs (K,) between the new states of all states (S,).

    With `zero_rewards` the pairs earn 0. `stops` lists new states with the reward for stopping
    there, which is 0 if the pairs keep their rewards.
    """
    size, table = int(new_state.max(initial=-1)) + 1, mdp.table.of_pairs(pairs)
    new_state = np.where(new_state < 0, size, new_state)
    if zero_rewards:
        gain, below = np.zeros(len(pairs), np.int64), make_ones(len(pairs))
    elif table.joint:
        gain, below = table.expected_gain_exact
    else:
        gain, below = table.gain, table.gain_denominator
    # Behind the pairs come the stops, and one pair of the end itself; all lead to the end.
    extra = np.array([*(state for state, _ in stops), size])
    worths = [*(value for _, value in stops), Fraction(0)]
    more = to_integer_array(value.numerator for value in worths)
    under = to_integer_array(value.denominator for value in worths)
    if gain.dtype == np.float64:
        more = more.astype(gain.dtype)
    # Outcomes of a pair are sorted by their new states.
    following = new_state[table.next]
    order = np.lexsort((following, table.pair))
    one = np.ones(len(extra), dtype=table.weight.dtype)
    rows = Rows(
        offsets=np.append(table.offsets, table.offsets[-1] + 1 + np.arange(len(extra))),
        next=np.append(following[order], np.full(len(extra), size)),
        weight=np.append(table.weight[order], one),
        denominator=np.append(table.denominator, make_ones(len(extra))),
        sound=table.rows.sound,
    )
    outcomes = OutcomeTable(
        rows=rows,
        gain=np.append(gain, more),
        gain_denominator=np.append(below, under),
    )
    # Sort pairs by their state, and number the actions of each state from 0.
    owner = np.append(new_state[mdp.pair_state[pairs]], extra)
    by_state = np.argsort(owner, kind="stable")
    owner = owner[by_state]
    action = np.arange(len(owner)) - np.searchsorted(owner, owner)
    source = np.concatenate([pairs, -1 - np.arange(len(stops)), [mdp.n_pairs]])[by_state]
    model = MDP(
        outcomes.of_pairs(by_state),
        owner,
        action,
        space=StateSpace.plain(size + 1),
        actions=tuple(map(str, range(int(action.max()) + 1))),
        discount_exact=Fraction(1),
        start=((size, Fraction(1)),),
        name=mdp.name,
    )
    return Quotient(mdp=model, new_state=new_state, source=source)


def extract_components(mdp: MDP, component: Integers, inside: Mask) -> Quotient:
    """Return the components (S,), and pairs (L,), as a model with an end that none reaches."""
    chosen = component >= 0
    new_state = np.where(chosen, np.cumsum(chosen) - 1, -1)
    return build_quotient(mdp, np.flatnonzero(inside), new_state)


def stop_in_components(mdp: MDP, component: Integers, pairs: Mask, worth: Floats) -> Quotient:
    """Return the model of some pairs (L,), without rewards, in which components are left or stop.

    Each component becomes a state with a stop of its worth (C,). `component` (S,) has the number of
    each state, or -1: then it stays a state of its own.
    """
    new_state, passed = component.copy(), component < 0
    new_state[passed] = len(worth) + np.arange(int(passed.sum()))
    stops = [(number, Fraction(value)) for number, value in enumerate(worth.tolist())]
    return build_quotient(mdp, np.flatnonzero(pairs), new_state, zero_rewards=True, stops=stops)


def choose_nearer_pairs(graph: PairGraph, target: Mask, pairs: Mask, chosen: Integers) -> None:
    """Write into `chosen` (S,) one of some pairs (L,) that leads nearer to the target (S,)."""
    distance = graph.compute_distance(target, pairs)
    nearer = graph.find_falling_pairs(distance) & pairs & (distance > 0)[graph.pair_state]
    choose_first_pairs(graph, nearer, chosen)


def choose_first_pairs(graph: PairGraph, pairs: Mask, chosen: Integers) -> None:
    """Write into `chosen` (S,) the first of some pairs (L,) of each state that has one."""
    some = np.flatnonzero(pairs)
    states, first = np.unique(graph.pair_state[some], return_index=True)
    chosen[states] = some[first]
