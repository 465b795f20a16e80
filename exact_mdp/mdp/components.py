"""What a reward is made of: the exact expected amount of each component, for every pair.

    r(i) = Σ_c components[i, c] / component_denominator[l]

The amounts are columns of the table of outcomes: integers over one denominator for each pair, or
floats, each the dyadic rational that it is; of an outcome i of pair l, or of the pair where all of
its outcomes have the same. What components given by name leave of the reward is
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
from exact_mdp.mdp.forms.numbers import array_of, group_numbers
from exact_mdp.mdp.forms.rows import NEXT
from exact_mdp.mdp.table import (
    Floats,
    Numbers,
    OutcomeTable,
    divide,
    make_ones,
    multiply,
    over_groups,
    reduce_fractions,
    to_dyadic_integers,
    to_integer_array,
)

REST = "rest"


def with_components(
    table: OutcomeTable, columns: Sequence[tuple[Numbers, Numbers]]
) -> OutcomeTable:
    """Return a table with components, given as numerators (L,) or (N,) and denominators (L,)."""
    if any(len(top) != table.pairs for top, _ in columns):
        columns = [(_repeat_by_outcome(top, table), below) for top, below in columns]
    if all(top.dtype == np.float64 for top, _ in columns):
        amounts, bottom = np.stack([top for top, _ in columns], axis=1), make_ones(table.pairs)
    else:
        each = [
            _cancel_common_divisor(*_column_to_integers(column, table), table) for column in columns
        ]
        common = np.lcm.reduce([below.astype(object) for _, below in each])
        whole = [
            multiply(top, _of_length_of(top, common // below, table)).astype(object)
            for top, below in each
        ]
        amounts = to_integer_array(np.stack(whole, axis=1).reshape(-1).tolist())
        amounts, bottom = amounts.reshape(-1, len(columns)), to_integer_array(common.tolist())
    made = copy(table)  # what is known of its rows still holds
    vars(made).update(components=amounts, component_denominator=bottom, averaged=False)
    return made


def _repeat_by_outcome(top: Numbers, table: OutcomeTable) -> Numbers:
    """Return numbers (N,) of outcomes; those (L,) of pairs are repeated."""
    return np.asarray(top[table.pair]) if len(top) == table.pairs else top


def _of_length_of(top: Numbers, below: Numbers, table: OutcomeTable) -> Numbers:
    """Return denominators (L,), repeated for each outcome where the numerators are (N,)."""
    return below if len(top) == table.pairs else np.asarray(below[table.pair])


def _cancel_common_divisor(
    top: Numbers, below: Numbers, table: OutcomeTable
) -> tuple[Numbers, Numbers]:
    """Return numerators (L,) or (N,) and denominators (L,) without a divisor that all share."""
    if len(top) == table.pairs:
        return reduce_fractions(top, below)
    shared = np.gcd(np.gcd.reduceat(top, table.offsets[:-1]), below)
    return np.asarray(top // shared[table.pair]), np.asarray(below // shared)


def _column_to_integers(
    column: tuple[Numbers, Numbers], table: OutcomeTable
) -> tuple[Numbers, Numbers]:
    """Return a column in integers."""
    top, bottom = column
    if top.dtype != np.float64:
        return top, bottom
    return to_dyadic_integers(
        top, np.arange(len(top) + 1) if len(top) == table.pairs else table.offsets
    )


def _complete_components(
    columns: dict[str, tuple[Numbers, Numbers]], earned: OutcomeTable
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return names and table of components that were given by name, with the rest of the reward."""
    names, table = _add_remainder(columns, earned)
    # Where the reward differs between outcomes, components that were given by pair are means.
    means = not table.parted_by_outcome and not adds_up(table)
    return names, replace(table, averaged=True) if means else table


def adds_up(table: OutcomeTable) -> bool:
    """Return whether components add up to the reward in each outcome, not on average alone."""
    if not (table.joint or table.parted_by_outcome):
        return True
    if np.float64 not in (table.gain.dtype, table.components.dtype):
        return not np.asarray(_remainder_by_outcome(table)[0] != 0).any()
    gain, below = table.compute_gains(), table.component_denominator
    counts = np.diff(table.offsets)
    parts = table.components
    if not table.parted_by_outcome:
        parts, below = parts[table.pair], below[table.pair]
        counts = np.ones(len(gain), dtype=np.int64)
    each = np.stack([divide(part, below, counts) for part in parts.T], axis=1)
    # Each part is rounded once, and so are their sums and the reward.
    size = np.abs(each).sum(axis=1) + np.abs(gain)
    return bool((np.abs(each.sum(axis=1) - gain) <= (parts.shape[1] + 2) * NEXT * size).all())


def _add_remainder(
    columns: dict[str, tuple[Numbers, Numbers]], earned: OutcomeTable
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return names and table of the components, and of what they leave of the reward."""
    table = with_components(earned, [*columns.values()])
    left, below = _compute_remainder(table)
    if not np.asarray(left != 0).any():
        return tuple(columns), table
    floats = np.float64 in (table.components.dtype, table.gain.dtype, table.weight.dtype)
    if floats and not wrong_rows(table, table.expected_gain()).any():
        printed = with_components(
            table, [_as_printed(column, table) for column in columns.values()]
        )
        whole = not np.asarray(_compute_remainder(printed)[0] != 0).any()
        return tuple(columns), printed if whole else table
    if REST in columns:
        raise ModelError(
            f"components are given with one called {REST!r}, and do not add up to the reward",
            where="components",
            fix=f"leave {REST!r} out: it is what the others leave of the reward",
        )
    more = columns | {REST: _cancel_common_divisor(left, below, table)}
    return tuple(more), with_components(table, [*more.values()])


def _compute_remainder(table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return what components leave of the reward: of each pair (L,), over denominators (L,).

    Of each outcome (N,), where components are known by outcome.
    """
    if table.parted_by_outcome:
        return _remainder_by_outcome(table)
    amount, below = table.expected_components_exact()
    total = np.asarray(multiply(amount, to_integer_array([1]), terms=amount.shape[1]).sum(axis=1))
    gain, bottom = table.expected_gain_exact()
    return multiply(gain, below) - multiply(total, bottom), multiply(bottom, below)


def _remainder_by_outcome(table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return what components leave of the reward of each outcome (N,), over denominators (L,)."""
    gain, below = table.integer_gains()
    left = _repeat_by_outcome(gain, table).astype(object)
    for number in range(table.components.shape[1]):
        part, under = table.with_component_reward(number).integer_gains()
        part = _repeat_by_outcome(part, table).astype(object)
        left = left * under[table.pair] - part * below[table.pair].astype(object)
        below = multiply(below, under)
    return to_integer_array(left.tolist()), below


def _as_printed(column: tuple[Numbers, Numbers], table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return amounts with each float as the decimal that it prints as: 0.1 as 1/10."""
    top, _ = column
    if top.dtype != np.float64:
        return column
    values = [Fraction(repr(value)) for value in top.tolist()]
    of_pair = len(top) == table.pairs
    return over_groups(values, np.arange(len(top) + 1) if of_pair else table.offsets)


def wrong_rows(table: OutcomeTable, reward: Floats) -> Numbers:
    """Return (L,) where components do not add up to the rewards, up to rounding in floats."""
    floats = table.expected_components()
    with np.errstate(over="ignore"):  # a scale beyond the floats forgives nothing that it should
        total = floats.sum(axis=1)
        # Rewards of both signs cancel: it is the size of each that rounding is relative to.
        sizes = replace(table, gain=np.abs(table.gain), components=np.abs(table.components))
        scale = sizes.expected_components().sum(axis=1) + sizes.expected_gain()
    lost = (floats.shape[1] + 1) * 2.0**-1074  # below the range, rounding is no longer relative
    # A product and a sum for each outcome, of the reward and of each component, and a sum for each
    # component; twice: here, and by the user.
    roundings = 4 * np.diff(table.offsets) + floats.shape[1] + 4
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


def require_length(values: Any, where: str, pairs: int) -> Any:
    """Return amounts (L,) for L pairs."""
    amounts = array_of(values, where)
    if amounts.shape != (pairs,):
        raise ShapeError(
            f"amounts have shape {amounts.shape}, not ({pairs},)",
            where=where,
            fix="give one amount for each pair",
        )
    return amounts


def named_components(
    parts: dict[str, Any], table: OutcomeTable, by_outcome: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Take `components` out of parts; return the names of all, and the table with them.

    Unless parts have some, they are those `by_outcome`, with amounts (N,) by name.
    """
    sound = table.gain.dtype != np.float64 or np.isfinite(table.gain).all()
    given = parts.get("components") is not None
    if not (given or by_outcome) or not sound:  # a reward that is not a number is refused next
        parts.pop("components", None)
        return {"table": table}
    each_component(parts, lambda values, where: _read_table_amounts(values, where, table))
    every: Mapping[str, Any] = parts.pop("components") if given else by_outcome or {}
    columns = {}
    for name, values in every.items():
        if values.ndim == 2:
            values = np.asarray(values[table.pair, table.next])
        elif given:
            values = np.asarray(values)[table.pair]
        top, bottom = _by_pair_if_alike(np.array(values), table)
        if top.dtype == np.float64 and not np.isfinite(top).all():
            what = f"an amount is {top[~np.isfinite(top)][0]}"
            raise ModelError(what, where=f"component {name}", fix="give a finite number")
        columns[name] = top, bottom
    names, table = _complete_components(columns, table)
    return {"component_names": names, "table": table}


def with_outcome_amounts(table: OutcomeTable, amounts: Mapping[str, Any]) -> OutcomeTable:
    """Return a table with components, given as amounts (N,) of its outcomes by name."""
    columns = [_by_pair_if_alike(np.asarray(values), table) for values in amounts.values()]
    return with_components(table, columns)


def _by_pair_if_alike(values: Numbers, table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return amounts (N,) of outcomes as the arrays of a table: by pair, if those of each agree."""
    of_pair = values[table.offsets[:-1]]
    if np.asarray(values == of_pair[table.pair], dtype=bool).all():
        return group_numbers(of_pair, np.arange(table.pairs + 1))
    return group_numbers(values, table.offsets)


def require_amounts(table: OutcomeTable, what: str) -> None:
    """Raise ModelError where what is asked for needs the amount of each outcome.

    Only its mean over the outcomes of a pair is known of a component of a scenario.
    """
    if table.averaged and table.components is None:
        raise ModelError(
            f"{what} needs the reward of each outcome, and of this component of the reward only "
            "the mean of each pair is known",
            where="reward components",
            fix="evaluate() gives the mean; or, in a scenario, set every other weight to 0 (--set "
            "reward.NAME=0 for each of them), and leave out --reward, or reward=",
        )


def _read_table_amounts(values: Any, where: str, table: OutcomeTable) -> Any:
    """Return amounts of pairs (L,) or of transitions (L, S) as arrays."""
    amounts = array_of(values, where)
    if amounts.ndim == 2 and len(amounts) == table.pairs and amounts.shape[1] > table.next.max():
        return amounts
    return require_length(amounts, where, table.pairs)
