"""Models that exact-mdp wrote for model checkers, read back with all that it says of them.

Such a file lists the model as any does, and describes it besides with the header of `mdp.io.npz`:
discount, sense, columns and names of the states, components, events, parameters. Its reward is
called `reward`, components and labels are numbered. What the header says has to fit what is listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any, TypeVar

import numpy as np

from exact_mdp.mdp.components import of_columns
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.explicit import REWARD, Explicit, expected, identifier, over, table_of
from exact_mdp.mdp.io.npz import parts_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, OutcomeTable, exact, multiply, shown
from exact_mdp.mdp.validate import as_discount, as_start

T = TypeVar("T")

GROUP = "exact-mdp"
CARRIER = "start"
"""The annotation whose description is the header: what the format has no place for, as JSON."""

OBSERVED = "observations"


def component_key(number: int) -> str:
    """Return the identifier of the reward model that holds a component."""
    return f"component-{number}"


def label_key(number: int) -> str:
    """Return the identifier of the annotation that holds a label."""
    return f"label-{number}"


def restored(
    found: Explicit,
    header: Mapping[str, Any],
    *,
    reward: str | None,
    discount: object,
    start: object,
) -> MDP:
    """Return a model that exact-mdp wrote, with everything that its header says of it."""
    chosen = identifier(found, REWARD if reward is None else reward)
    own, choices, pairs = found.own, np.diff(found.state_to_choices), len(found.actions)
    labels = _listed(found.labels, label_key, header.get("labels"))
    parts = parts_of(header, pairs=pairs, labels=labels)
    parts["goal"] = own.get("goal")
    columns = _listed(found.rewards, component_key, header.get("component_names"))
    initial = {state for state, p in parts["start"] if p > 0}
    for what, same in (
        ("a state without choices", bool(choices.all())),
        ("the names of the actions", found.listed_actions == parts["actions"]),
        ("the initial states", set(np.flatnonzero(found.initial).tolist()) == initial),
        ("the components of the reward", len(columns) in (0, len(parts["component_names"]))),
    ):
        if not same:
            raise ModelError(
                f"another program changed {what}",
                where=f"annotations/{GROUP}",
                fix=f"drop the annotations of group {GROUP}, which no longer describe the model",
            )
    ours = chosen == REWARD
    if not ours:
        parts["component_names"] = (found.titles["rewards"][chosen],)
    elif columns:
        parts["component_table"] = of_columns([expected(found, each) for each in columns])
    if discount is not None:
        parts["discount_exact"] = as_discount(discount)
    if start is not None:
        parts["start"], parts["episodes"] = as_start(start, parts["space"]), None
    table = table_of(found, found.rewards[chosen])
    coarse, finer = table, ours and "gain" in own
    if ours:
        changes = dict[str, Any]()
        if "event" in own:
            changes["event"] = own["event"].top.astype(np.uint8)
        if finer:
            gain, below = over(own["gain"], table.offsets)
            changes |= {"gain": gain, "gain_denominator": below}
        table = replace(table, **changes)
    if OBSERVED in own:
        parts[OBSERVED] = np.asarray(own[OBSERVED].top, dtype=np.int64)
        table = _of_counts(table, parts[OBSERVED])
    model = MDP(table, np.repeat(np.arange(len(choices)), choices), found.actions, **parts)
    if finer:
        _check_gains(table, coarse)
    return model


def _of_counts(table: OutcomeTable, seen: Integers) -> OutcomeTable:
    """Return the table with each probability of an observed pair as its count over theirs (L,)."""
    times = np.where((seen > 0) & (seen % table.denominator == 0), seen // table.denominator, 1)
    weight = table.weight * np.repeat(times, np.diff(table.offsets))
    return replace(table, weight=weight, denominator=table.denominator * times)


def _listed(found: Mapping[str, T], key: Callable[[int], str], names: object) -> list[T]:
    """Return the annotations that `save` wrote for names in the header, those that are there."""
    keys = map(key, range(len(names) if isinstance(names, list) else 0))
    return [found[each] for each in keys if each in found]


def _check_gains(finer: OutcomeTable, table: OutcomeTable) -> None:
    """Raise ModelError unless the rewards of branches average to those of the choices.

    Exact numbers agree exactly. Floats agree within the rounding of a sum of n products, which is
    at most (n + 3) 2^-52 Σ |p r|, and (n + 1) 2^-1074 below the range of normal floats.
    """
    floats = np.float64 in (finer.weight.dtype, finer.gain.dtype, table.gain.dtype)
    if not floats:
        (top, below), (a, b) = finer.expected_gain_exact(), table.expected_gain_exact()
        suspect = np.flatnonzero(np.asarray(multiply(top, b) != multiply(a, below), dtype=bool))
    else:
        suspect = np.arange(table.pairs)
    for choice in suspect.tolist():
        terms = [p * r for p, _, r in finer.row(choice)]
        wanted, slack = (
            exact(table.gain[choice]) / exact(table.gain_denominator[choice]),
            Fraction(0),
        )
        total = sum(terms, Fraction(0))
        if floats:
            tiny = (len(terms) + 1) * Fraction(2) ** -1074
            slack = (len(terms) + 3) * Fraction(2) ** -52 * sum(map(abs, terms)) + tiny
        if abs(total - wanted) > slack:
            raise ModelError(
                f"rewards of branches average {shown(total)}, the choice's is {shown(wanted)}",
                where=f"choice {choice}",
                fix=f"change both, or drop the annotation {GROUP}/gain",
            )
