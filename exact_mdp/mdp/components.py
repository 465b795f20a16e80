"""What a reward is made of: the exact expected amount of each component, for every pair.

    r(l) = Σ_c components[l, c] / component_denominator[l]

The amounts are columns of the table of outcomes: integers over one denominator for each pair, or
floats, each the dyadic rational that it is. What components given by name leave of the reward is
one more, "rest"; so a cost that is no part of the reward (Altman, Constrained Markov Decision
Processes, 1999) is a component like any other. Floats that add up to the reward but for rounding,
and exactly as the decimals that they print as, are these decimals: 6.1 and -1.1 are parts of 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError
from exact_mdp.mdp.forms.numbers import array_of, grouped
from exact_mdp.mdp.forms.rows import NEXT
from exact_mdp.mdp.table import (
    Floats,
    Numbers,
    OutcomeTable,
    dyadic,
    integers,
    multiply,
    ones,
    over_groups,
    reduced,
)

REST = "rest"


def made_of(table: OutcomeTable, columns: Sequence[tuple[Numbers, Numbers]]) -> OutcomeTable:
    """Return a table with components, given as numerators and denominators (L,) each."""
    if all(top.dtype == np.float64 for top, _ in columns):
        amounts, bottom = np.stack([top for top, _ in columns], axis=1), ones(table.pairs)
    else:
        each = [reduced(*_whole(column)) for column in columns]
        common = np.lcm.reduce([below.astype(object) for _, below in each])
        whole = [multiply(top, common // below).astype(object) for top, below in each]
        amounts = integers(np.stack(whole, axis=1).reshape(-1).tolist())
        amounts, bottom = amounts.reshape(table.pairs, len(columns)), integers(common.tolist())
    made = copy(table)  # what is known of its rows still holds
    vars(made).update(components=amounts, component_denominator=bottom)
    return made


def _whole(column: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
    top, bottom = column
    return dyadic(top, np.arange(len(top) + 1)) if top.dtype == np.float64 else (top, bottom)


def _completed(
    columns: dict[str, tuple[Numbers, Numbers]], earned: OutcomeTable
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return names and table of components that were given by name, with the rest of the reward."""
    table = made_of(earned, [*columns.values()])
    left, below = _rest(table)
    if not np.asarray(left != 0).any():
        return tuple(columns), table
    floats = np.float64 in (table.components.dtype, table.gain.dtype, table.weight.dtype)
    if floats and not wrong_rows(table, table.expected_gain()).any():
        printed = made_of(table, [*map(_as_printed, columns.values())])
        whole = not np.asarray(_rest(printed)[0] != 0).any()
        return tuple(columns), printed if whole else table
    if REST in columns:
        raise ModelError(
            f"components are given with one called {REST!r}, and do not add up to the reward",
            where="components",
            fix=f"leave {REST!r} out: it is what the others leave of the reward",
        )
    more = columns | {REST: reduced(left, below)}
    return tuple(more), made_of(table, [*more.values()])


def _rest(table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return what components leave of the reward of each pair, over denominators (L,)."""
    amount, below = table.expected_components_exact()
    total = np.asarray(multiply(amount, integers([1]), terms=amount.shape[1]).sum(axis=1))
    gain, bottom = table.expected_gain_exact()
    return multiply(gain, below) - multiply(total, bottom), multiply(bottom, below)


def _as_printed(column: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
    """Return amounts with each float as the decimal that it prints as: 0.1 as 1/10."""
    if column[0].dtype != np.float64:
        return column
    values = [Fraction(repr(value)) for value in column[0].tolist()]
    return over_groups(values, np.arange(len(values) + 1))


def wrong_rows(table: OutcomeTable, reward: Floats) -> Numbers:
    """Return (L,) where components do not add up to the rewards, up to rounding in floats."""
    floats = table.expected_components()
    with np.errstate(over="ignore"):  # a scale beyond the floats forgives nothing that it should
        total = floats.sum(axis=1)
        # Rewards of both signs cancel: it is the size of each that rounding is relative to.
        size = replace(table, gain=np.abs(table.gain)).expected_gain()
        scale = np.abs(floats).sum(axis=1) + size
    lost = (floats.shape[1] + 1) * 2.0**-1074  # below the range, rounding is no longer relative
    # A product and a sum for each outcome, a sum for each component; twice: here, and by the user.
    roundings = 2 * np.diff(table.offsets) + floats.shape[1] + 4
    return np.asarray(~(np.abs(total - reward) <= roundings * NEXT * scale + lost))


def each_component(names: dict[str, Any], change: Callable[[Any, str], Any]) -> None:
    """Replace what is given for each component of the reward by what a function makes of it."""
    given = names.get("components")
    if given is None:
        return
    if not isinstance(given, Mapping):
        columns = array_of(given, "components")
        words = tuple(names.get("component_names", ()))
        if columns.ndim != 2 or columns.shape[1] != len(words):
            raise ModelError(
                f"components have shape {columns.shape} for {len(words)} names",
                where="components",
                fix="give {name: amounts}",
            )
        given = dict(zip(words, columns.T, strict=True))
    changed = {str(name): change(values, f"component {name}") for name, values in given.items()}
    if not changed:
        raise ModelError("no component is given", where="components", fix="name one, or none")
    names["components"] = changed


def of_length(values: Any, where: str, pairs: int) -> Any:
    """Return amounts (L,) for L pairs."""
    amounts = array_of(values, where)
    if amounts.shape != (pairs,):
        raise ShapeError(
            f"amounts have shape {amounts.shape}, not ({pairs},)",
            where=where,
            fix="give one amount for each pair",
        )
    return amounts


def named_components(parts: dict[str, Any], table: OutcomeTable) -> dict[str, Any]:
    """Take `components` out of parts; return the names of all, and the table with them."""
    sound = table.gain.dtype != np.float64 or np.isfinite(table.gain).all()
    if parts.get("components") is None or not sound:  # a reward that is no number is refused next
        parts.pop("components", None)
        return {"table": table}
    each_component(parts, lambda values, where: _of_table(values, where, table))
    columns = {}
    for name, values in parts.pop("components").items():
        if values.ndim == 1:
            top, bottom = grouped(np.array(values), np.arange(table.pairs + 1))
        else:
            gain = grouped(np.asarray(values[table.pair, table.next]), table.offsets)
            top, bottom = table.earning(*gain).expected_gain_exact()
        if top.dtype == np.float64 and not np.isfinite(top).all():
            what = f"an amount is {top[~np.isfinite(top)][0]}"
            raise ModelError(what, where=f"component {name}", fix="give a finite number")
        columns[name] = top, bottom
    names, table = _completed(columns, table)
    return {"component_names": names, "table": table}


def _of_table(values: Any, where: str, table: OutcomeTable) -> Any:
    """Return amounts of pairs (L,) or of transitions (L, S) as arrays."""
    amounts = array_of(values, where)
    if amounts.ndim == 2 and len(amounts) == table.pairs and amounts.shape[1] > table.next.max():
        return amounts
    return of_length(amounts, where, table.pairs)
