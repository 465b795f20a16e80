"""Questions about named sets of states, as models whose optimal value is the answer.

The probability of reaching a set T of states, through the states of a set C only, is a total reward
at discount 1: what leads out of T earns 1 and ends, and nothing is earned elsewhere,

    Pr_s(C U T) = E_s Σ_t r_t,    r = 1 on the step out of T, 0 else; T and the states outside C ∪ T
                                  are left for good.

The expected reward until T is that of the model in which T is absorbing and earns nothing. A run
that never reaches T is worth +∞ (so that it is infinite unless T is reached almost surely), as
PRISM and Storm define R[F T]. A discount below 1 keeps every sum finite, and this rule is not
needed.

States keep their numbers and pairs, so that policies for the model are policies here.
Sources: Baier and Katoen, Principles of Model Checking, MIT Press 2008, sections 10.1 and 10.6;
https://www.prismmodelchecker.org/manual/PropertySpecification/Reward-basedProperties.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, ones
from exact_mdp.mdp.validate import Flags, Parts

REACHED = "reached"


def reaching(model: Parts, label: str, allowed: str | None) -> dict[str, Any]:
    """Return what changes where the probability of reaching a label is asked for."""
    target, size, space = labelled(model, label), model.n_states, model.space
    outside = np.zeros(size, dtype=bool) if allowed is None else ~labelled(model, allowed)
    for state, chance in model.start:
        if chance > 0 and outside[state] and not target[state]:
            raise ModelError(
                f"the start, state ({space.label(state)}), is not among the allowed states",
                where=f"allowed {allowed!r}",
                fix="allow it, or start elsewhere",
            )
    name = REACHED
    while name in space.extra:
        name += "'"
    states = np.append(model.pair_state, size)
    earning = np.append(target[model.pair_state], False)
    unearned = replace(model.table, gain=np.zeros(len(earning) - 1, np.int64), gain_doubt=None)
    table = _ended(
        replace(unearned, gain_denominator=ones(len(earning) - 1)),
        np.append((target | outside)[model.pair_state], True),
        np.where(earning, size, states),
    )
    return {
        "table": replace(table, gain=earning.astype(np.int64)),
        "pair_state": states,
        "pair_action": np.append(model.pair_action, model.pair_action[-1]),
        "space": StateSpace(columns=space.columns, extra=(*space.extra, name)),
        "discount_exact": Fraction(1),
        **ONE_COMPONENT,
        **NO_DATA,
        "labels": {name: np.append(flags, False) for name, flags in model.labels.items()},
        "goal": None,
    }


def until(model: Parts, label: str, reward: str | None) -> dict[str, Any]:
    """Return what changes where the expected reward until a label is asked for."""
    target, table, changes = labelled(model, label), model.table, dict[str, Any]()
    if reward is not None and (reward,) != model.component_names:
        gain, below = _component(model, reward)
        table = replace(table, gain=gain, gain_denominator=below, gain_doubt=None)
        changes |= ONE_COMPONENT | {"component_names": (reward,)}
    ends = target[model.pair_state]
    known = model.component_table
    if "component_table" not in changes and known is not None:
        changes["component_table"] = replace(known, amount=np.where(ends[:, None], 0, known.amount))
    return {
        **changes,
        **NO_DATA,
        "table": _ended(table, ends, model.pair_state),
        "goal": target if model.discount_exact == 1 else None,
    }


NO_DATA: dict[str, Any] = {
    "observations": None,
    "episodes": None,
}  # other rows than those that were observed
ONE_COMPONENT = {"component_names": ("reward",), "component_table": None}


def labelled(model: Parts, label: str) -> Flags:
    """Return the states (S,) of a label; raises ModelError where there are none."""
    if label not in model.labels:
        raise ModelError(
            f"unknown label {label!r}",
            where="labels",
            fix=suggest(str(label), model.labels)
            if model.labels
            else "the model has none: build it with labels={name: (S,) truth values}",
        )
    if not model.labels[label].any():
        raise ModelError(
            f"no state has the label {label!r}",
            where="labels",
            fix="choose one that a state has",
        )
    return model.labels[label]


def _component(model: Parts, name: str) -> tuple[Numbers, Numbers]:
    """Return the expected reward (L,) of a component over its denominators (L,)."""
    if name not in model.component_names:
        fix = suggest(name, model.component_names)
        raise ModelError(f"no reward component {name!r}", where="reward components", fix=fix)
    if model.component_table is None:
        return model.table.expected_gain_exact()
    return model.component_table.column(model.component_names.index(name))


def _ended(table: OutcomeTable, ends: Flags, follows: Numbers) -> OutcomeTable:
    """Return the table whose marked pairs lead for sure to the states that follow, and earn 0.

    `ends` and `follows` (L,) say this of every pair, and may say it of one more, which is appended.
    """

    def longer(name: str, values: Numbers) -> Numbers:
        one = name in ("weight", "denominator", "gain_denominator")
        return np.append(values, np.array(int(one), dtype=values.dtype))

    ending = replace(
        table.mapped(longer, longer),
        offsets=np.append(table.offsets, table.offsets[-1] + 1),
        next=np.append(table.next, table.next.dtype.type(0)),
    )
    found = ending.of_pairs(np.where(ends, table.pairs, np.arange(len(ends))))
    lengths = np.diff(found.offsets)
    moved = np.repeat(np.asarray(follows), lengths).astype(found.next.dtype)
    return replace(found, next=np.where(np.repeat(ends, lengths), moved, found.next))
