"""Models made of parts of another: some of its pairs, with states merged, and an end.

    derived(mdp, pairs, label)     pair l leads from label(s) to label(s'), label -1 is the end

Merged states are those of an end component that is not worth telling apart: what a policy can do in
one of them it can do in all (the quotient of de Alfaro, Formal Verification of Probabilistic
Systems, 1997, section 3.3). Rests are further pairs, which earn something and lead to the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers, OutcomeTable, integers, ones, over_groups


@dataclass(frozen=True, kw_only=True, eq=False)
class Derived:
    """A model of S' states and L' pairs, the last state its end, and where its pairs are from.

    Attributes
    ----------
    mdp : MDP
    label : (S,) int64
        The state that each one of the other model became.
    source : (L',) int64
        The pair that each one is made of; -1 - i for rest number i; the pair of the end has L.
    """

    mdp: MDP
    label: Integers
    source: Integers

    def only(self, states: Integers) -> Derived:
        """Return the model with some of the pairs (K,), a pair of each state among them."""
        states = np.unique(states)
        mdp = self.mdp
        mdp_of_states = mdp.with_(
            table=mdp.table.of_pairs(states),
            pair_state=mdp.pair_state[states],
            pair_action=mdp.pair_action[states],
        )
        return Derived(mdp=mdp_of_states, label=self.label, source=self.source[states])


def derived(
    mdp: MDP,
    pairs: Integers,
    label: Integers,
    *,
    earned: Sequence[Fraction] | None = None,
    rests: Sequence[tuple[int, Fraction]] = (),
) -> Derived:
    """Return the model of some pairs (K,) between the states that `label` (S,) gives.

    `earned` are other rewards of these pairs; `rests` lists new states and what resting there is
    worth.
    """
    size = int(label.max(initial=-1)) + 1
    label = np.where(label < 0, size, label)
    table = mdp.table.of_pairs(pairs)
    if earned is not None:
        gain, below = over_groups(earned, np.arange(len(pairs) + 1))
    elif len(mdp.table.gain) == mdp.n_pairs and not (
        mdp.table.gain.dtype == np.float64 and any(value for _, value in rests)
    ):
        gain, below = mdp.table.gain[pairs], mdp.table.gain_denominator[pairs]
    else:
        gain, below = (part[pairs] for part in mdp.table.expected_gain_exact())
    extra = [*(state for state, _ in rests), size]
    worths = [*(value for _, value in rests), Fraction(0)]
    more = integers(value.numerator for value in worths)
    under = integers(value.denominator for value in worths)
    offsets, following = table.offsets, label[table.next]
    order = np.lexsort((following, table.pair))
    one = np.ones(len(extra), dtype=table.weight.dtype)
    outcomes = OutcomeTable(
        offsets=np.concatenate([offsets, offsets[-1] + 1 + np.arange(len(extra))]),
        next=np.concatenate([following[order], np.full(len(extra), size)]),
        weight=np.concatenate([table.weight[order], one]),
        denominator=np.concatenate([table.denominator, ones(len(extra))]),
        gain=np.concatenate([gain, more.astype(gain.dtype) if gain.dtype == np.float64 else more]),
        gain_denominator=np.concatenate([below, under]),
    )
    owner = np.concatenate([label[mdp.pair_state[pairs]], extra])
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
