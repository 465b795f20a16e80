"""Models made of parts of another: some of its pairs, with states merged, and an end.

    derived(mdp, pairs, label)     pair l leads from label(s) to label(s'), label -1 is the end

Merged states are those of an end component that is not worth telling apart: what a policy can do in
one of them it can do in all (the quotient of de Alfaro, Formal Verification of Probabilistic
Systems, 1997, section 3.3). Rests are further pairs, which earn something and lead to the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.graph import Mask, prove_termination
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers, OutcomeTable, make_ones, to_integer_array
from exact_mdp.solvers.bounds.bounds import improve_policy
from exact_mdp.solvers.endless.graph import Graph
from exact_mdp.solvers.solution import SolverError, Status

COARSER = 16  # from one limit of a loss to the next; 2 to 256 leave as many models unanswered


@dataclass(frozen=True, kw_only=True, eq=False)
class Derived:
    """A model of S' states and L' pairs, the last state its end, and where its pairs are from."""

    mdp: MDP
    label: Integers  # (S,) the state that each one of the other model became
    source: Integers  # (L',) the pair that each is made of; -1 - i for rest i; L for the end

    def without_losing(self) -> Derived:
        """Return a model in which every policy ends: without pairs that lose clearly in circles.

        Policy iteration in floats, from a policy that ends, tells which these are.
        """
        mdp = self.mdp
        if prove_termination(mdp).proven:
            return self
        graph, pairs = Graph(mdp), mdp.pair_offsets[:-1].copy()
        every = np.ones(mdp.n_pairs, dtype=bool)
        choose_nearer_pairs(graph, mdp.terminal, every, pairs)
        pairs, _, gain = improve_policy(mdp, pairs)
        _, inside = graph.end_components(~mdp.terminal[mdp.pair_state])
        losing = inside & (gain.value < -gain.noise)
        losing[pairs] = False
        # In every component some pair loses as much as staying does on average: the fewer are left
        # out, and the more they lose, the better the values may bear it out.
        least = float(gain.value.min())
        while losing.any():
            pairs = np.flatnonzero(~(losing & (gain.value <= least / COARSER)))
            part = of_pairs(mdp, pairs)
            if prove_termination(part).proven:
                return replace(self, mdp=part, source=self.source[pairs])
            least /= COARSER
            if not (losing & (gain.value > least)).any():
                break
        raise SolverError(Status.NO_BOUND, "staying forever loses too little a step")


def of_pairs(mdp: MDP, pairs: Integers) -> MDP:
    """Return the model with some pairs alone, one of each state among them."""
    own = {name: getattr(mdp, name)[pairs] for name in ("pair_state", "pair_action")}
    return mdp.with_(table=mdp.table.of_pairs(pairs), **own)


def build_derived_model(
    mdp: MDP,
    pairs: Integers,
    label: Integers,
    *,
    free: bool = False,
    rests: Sequence[tuple[int, Fraction]] = (),
) -> Derived:
    """Return the model of some pairs (K,) between the states that `label` (S,) gives.

    Where these are `free`, they earn nothing; `rests` lists new states and what resting there is
    worth, which is 0 unless the pairs are free.
    """
    size, table = int(label.max(initial=-1)) + 1, mdp.table.of_pairs(pairs)
    label = np.where(label < 0, size, label)
    if free:
        gain, below = np.zeros(len(pairs), np.int64), make_ones(len(pairs))
    elif table.joint:
        gain, below = table.expected_gain_exact()
    else:
        gain, below = table.gain, table.gain_denominator
    extra = np.array([*(state for state, _ in rests), size])
    worths = [*(value for _, value in rests), Fraction(0)]
    more = to_integer_array(value.numerator for value in worths)
    under = to_integer_array(value.denominator for value in worths)
    following = label[table.next]
    order = np.lexsort((following, table.pair))
    one = np.ones(len(extra), dtype=table.weight.dtype)
    outcomes = OutcomeTable(
        offsets=np.append(table.offsets, table.offsets[-1] + 1 + np.arange(len(extra))),
        next=np.append(following[order], np.full(len(extra), size)),
        weight=np.append(table.weight[order], one),
        denominator=np.append(table.denominator, make_ones(len(extra))),
        gain=np.append(gain, more.astype(gain.dtype) if gain.dtype == np.float64 else more),
        gain_denominator=np.append(below, under),
    )
    owner = np.append(label[mdp.pair_state[pairs]], extra)
    by_state = np.argsort(owner, kind="stable")
    owner = owner[by_state]
    action = np.arange(len(owner)) - np.searchsorted(owner, owner)
    source = np.concatenate([pairs, -1 - np.arange(len(rests)), [mdp.n_pairs]])[by_state]
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
    return Derived(mdp=model, label=label, source=source)


def choose_nearer_pairs(graph: Graph, target: Mask, pairs: Mask, chosen: Integers) -> None:
    """Write into `chosen` (S,) one of some pairs (L,) that leads nearer to the target (S,)."""
    distance = graph.compute_distance(target, pairs)
    choose_first_pairs(
        graph, graph.find_falling_pairs(distance) & pairs & (distance > 0)[graph.pair_state], chosen
    )


def choose_first_pairs(graph: Graph, pairs: Mask, chosen: Integers) -> None:
    """Write into `chosen` (S,) the first of some pairs (L,) of each state that has one."""
    some = np.flatnonzero(pairs)
    states, first = np.unique(graph.pair_state[some], return_index=True)
    chosen[states] = some[first]
