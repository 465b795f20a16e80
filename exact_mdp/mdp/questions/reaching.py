"""The probability of reaching a set of states T through a set C, as a total reward.

    r(l, s') = 1 if s' in T, else 0        γ = 1

The step into T earns 1 and leads to a new state `reached`, where the run ends; the first step from
a state of T does so, too. A run that leaves C ∪ T stays where it is and earns 0 (Baier and Katoen,
Principles of Model Checking, MIT Press 2008, section 10.1).

The way back: the states 0 … S-1 and the pairs 0 … L-1 are the given model's, and `reached`
and its pair come last.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.questions.ending import (
    NO_DATA,
    NO_GOAL,
    ONE_COMPONENT,
    REACHED,
    find_labelled_states,
    redirect_pairs,
)
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import make_ones


def ask_reaching(model: Any, label: str, allowed: str | None) -> Any:
    """Return the model whose value is the probability that a run reaches a labelled state.

    It passes through allowed states only; without `allowed`, all are. Raises ModelError if a label
    is unknown.
    """
    target, outside = find_labelled_states(model, label), np.zeros(model.n_states, dtype=bool)
    if allowed is not None:
        outside = ~find_labelled_states(model, allowed)
    size, pairs, space = model.n_states, model.n_pairs, model.space
    # Labelled states lead to `reached`, the new state S, at once; forbidden ones stay put.
    states = np.append(model.pair_state, size)
    table = redirect_pairs(
        model.table.with_reward(np.zeros(pairs, np.int64), make_ones(pairs)),
        np.append((target | outside)[model.pair_state], True),
        np.where(np.append(target, False)[states], size, states),
    )
    # Outcomes that arrive lead to `reached`. It has the greatest number, so they come last in
    # their row, which stays sorted.
    arrives = np.append(target, True)[table.next]
    order = np.argsort(2 * table.pair + arrives, kind="stable")
    arrives = arrives[order]
    table = table.map_numbers(
        lambda _, values: values,
        lambda _, values: values[order],
        offsets=table.offsets,
        next_states=np.where(arrives, table.next.dtype.type(size), table.next[order]),
    )
    # An arrival earns 1, but the step from `reached` to itself earns 0.
    parts = {
        "table": replace(table, gain=(arrives & (table.pair < pairs)).astype(np.int64)),
        "pair_state": states,
        "pair_action": np.append(model.pair_action, model.pair_action[-1]),
        "space": StateSpace(columns=space.columns, extra=(*space.extra, REACHED)),
        "discount_exact": Fraction(1),
        "labels": {name: np.append(flags, False) for name, flags in model.labels.items()},
        **ONE_COMPONENT,
        **NO_DATA,
        **NO_GOAL,
    }
    return replace(model, **parts)
