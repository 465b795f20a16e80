"""What a reward is made of: the exact expected amount of each component, for every pair.

    r(l) = Σ_c amount[l, c] / denominator[l]

Amounts are integers over one denominator for each pair, or floats, each the dyadic rational that it
is. What components given by name leave of the reward is one more, "rest"; so a cost that is no part
of the reward (Altman, Constrained Markov Decision Processes, 1999) is a component like any other.
Floats that add up to the reward but for rounding, and exactly as the decimals that they print as,
are these decimals: 6.1 and -1.1 are parts of 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError
from exact_mdp.mdp.forms.numbers import array_of, grouped, picked
from exact_mdp.mdp.table import (
    Floats,
    Numbers,
    OutcomeTable,
    divide,
    dyadic,
    integers,
    multiply,
    ones,
    over_groups,
    reduced,
)

REST = "rest"


@dataclass(frozen=True, kw_only=True, eq=False)
class ComponentTable:
    """Expected reward of L pairs by component: `amount` (L, C) over `denominator` (L,)."""

    amount: Numbers
    denominator: Numbers

    def floats(self) -> Floats:
        """Return (L, C) the amounts, each rounded once."""
        pairs, parts = self.amount.shape
        counts = np.full(pairs, parts)
        return divide(self.amount.reshape(-1), self.denominator, counts).reshape(pairs, parts)

    def exact(self) -> tuple[Numbers, Numbers]:
        """Return the amounts as integers (L, C) over denominators (L,)."""
        if self.amount.dtype != np.float64:
            return self.amount, self.denominator
        pairs, parts = self.amount.shape
        top, bottom = dyadic(self.amount.reshape(-1), np.arange(pairs + 1) * parts)
        return top.reshape(pairs, parts), bottom

    def column(self, number: int) -> tuple[Numbers, Numbers]:
        """Return the amounts (L,) of one component over their denominators (L,)."""
        return np.ascontiguousarray(self.amount[:, number]), self.denominator

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ComponentTable) or self.amount.shape != other.amount.shape:
            return NotImplemented
        (ours, below), (theirs, bottom) = self.exact(), other.exact()
        left = multiply(ours, bottom[:, None]), multiply(theirs, below[:, None])
        return np.array_equal(*left)

    __hash__ = None  # type: ignore[assignment]

    def __neg__(self) -> ComponentTable:
        amount = self.amount
        if amount.dtype == np.int64 and amount.min(initial=0) == np.iinfo(np.int64).min:
            amount = amount.astype(object)
        return ComponentTable(amount=-amount, denominator=self.denominator)


def of_columns(columns: Sequence[tuple[Numbers, Numbers]]) -> ComponentTable:
    """Return the table of components that are given as numerators and denominators (L,) each."""
    if all(top.dtype == np.float64 for top, _ in columns):
        amount = np.stack([top for top, _ in columns], axis=1)
        return ComponentTable(amount=amount, denominator=ones(len(amount)))
    each = [reduced(*_whole(column)) for column in columns]
    bottom = each[0][1].astype(object)
    for _, below in each[1:]:
        bottom = np.lcm(bottom, below.astype(object))
    amounts = [multiply(top, bottom // below).astype(object) for top, below in each]
    shape = len(bottom), len(columns)
    return ComponentTable(
        amount=integers(np.stack(amounts, axis=1).reshape(-1).tolist()).reshape(shape),
        denominator=integers(bottom.tolist()),
    )


def _whole(column: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
    top, bottom = column
    return dyadic(top, np.arange(len(top) + 1)) if top.dtype == np.float64 else (top, bottom)


def completed(
    columns: Mapping[str, tuple[Numbers, Numbers]], table: OutcomeTable
) -> tuple[tuple[str, ...], ComponentTable]:
    """Return names and table of components that were given by name, with the rest of the reward."""
    components = of_columns(list(columns.values()))
    left, below = _rest(components, table)
    if not np.asarray(left != 0).any():
        return tuple(columns), components
    if _adds_up(components, table):
        printed = of_columns([_as_printed(column) for column in columns.values()])
        whole = not np.asarray(_rest(printed, table)[0] != 0).any()
        return tuple(columns), printed if whole else components
    if REST in columns:
        raise ModelError(
            f"components are given with one called {REST!r}, and do not add up to the reward",
            where="components",
            fix=f"leave {REST!r} out: it is what the others leave of the reward",
        )
    return (*columns, REST), of_columns([*columns.values(), reduced(left, below)])


def _rest(components: ComponentTable, table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return what components leave of the reward of each pair, over denominators (L,)."""
    amount, below = components.exact()
    total = np.asarray(multiply(amount, integers([1]), terms=amount.shape[1]).sum(axis=1))
    gain, bottom = table.expected_gain_exact()
    return multiply(gain, below) - multiply(total, bottom), multiply(bottom, below)


def _as_printed(column: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
    """Return amounts with each float as the decimal that it prints as: 0.1 as 1/10."""
    if column[0].dtype != np.float64:
        return column
    values = [Fraction(repr(value)) for value in column[0].tolist()]
    return over_groups(values, np.arange(len(values) + 1))


def _adds_up(components: ComponentTable, table: OutcomeTable) -> bool:
    """Return whether floats add up to the reward but for rounding."""
    given = np.float64 in (components.amount.dtype, table.gain.dtype, table.weight.dtype)
    return given and not wrong_rows(components, table.expected_gain()).any()


def wrong_rows(components: ComponentTable, reward: Floats) -> Numbers:
    """Return (L,) where components do not add up to the rewards, up to rounding in floats."""
    floats = components.floats()
    with np.errstate(over="ignore"):  # a scale beyond the floats forgives nothing that it should
        total = floats.sum(axis=1)
        scale = np.abs(floats).sum(axis=1) + np.abs(reward)
    lost = (floats.shape[1] + 1) * 2.0**-1074  # below the range, rounding is no longer relative
    return np.asarray(~(np.abs(total - reward) <= 1e-12 * scale + lost))


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
    """Take `components`, of pairs or transitions, out of parts; return names and table of all."""
    if parts.get("components") is None:
        parts.pop("components", None)
        return {}
    each_component(parts, lambda values, where: _of_table(values, where, table))
    columns = {}
    for name, values in parts.pop("components").items():
        if values.ndim == 1:
            top, bottom = grouped(np.array(values), np.arange(table.pairs + 1))
        else:
            gain, under = grouped(picked(values, table.pair, table.next), table.offsets)
            earning = replace(table, gain=gain, gain_denominator=under)
            top, bottom = earning.expected_gain_exact()
        if top.dtype == np.float64 and not np.isfinite(top).all():
            what = f"an amount is {top[~np.isfinite(top)][0]}"
            raise ModelError(what, where=f"component {name}", fix="give a finite number")
        columns[name] = top, bottom
    names, known = completed(columns, table)
    return {"component_names": names, "component_table": known}


def _of_table(values: Any, where: str, table: OutcomeTable) -> Any:
    """Return amounts of pairs (L,) or of transitions (L, S) as arrays."""
    amounts = array_of(values, where)
    if amounts.ndim == 2 and len(amounts) == table.pairs and amounts.shape[1] > table.next.max():
        return amounts
    return of_length(amounts, where, table.pairs)
