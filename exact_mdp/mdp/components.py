"""Components of the reward: the exact expected amount of each, for every pair.

    r(i) = Σ_c components[i, c] / component_denominator[l]

The amounts are columns of the table of outcomes: integers over one denominator for each pair l, or
floats, each the dyadic rational that it is. They are stored by outcome i, or by pair if all of its
outcomes have the same amount. The remainder, the reward less all components given by name, is one
more component, "rest"; so a cost that is not part of the reward (Altman, Constrained Markov
Decision Processes, 1999) is a component like any other. Floats that add up to the reward except for
rounding, and add up exactly as the decimals that they print as, are taken as these decimals: 6.1
and -1.1 add up to 5.
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
    Integers,
    Numbers,
    OutcomeTable,
    divide,
    hold_same_numbers,
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
    # If one column is by outcome, all are.
    if any(len(top) != table.pairs for top, _ in columns):
        columns = [(_repeat_by_outcome(top, table), below) for top, below in columns]
    if all(top.dtype == np.float64 for top, _ in columns):
        amounts, bottom = np.stack([top for top, _ in columns], axis=1), make_ones(table.pairs)
    else:
        # Exact columns come over one denominator for each pair, the least common multiple.
        each = []
        for column in columns:
            each.append(cancel_common_divisor(*_column_to_integers(column, table), table))
        amounts, bottom = table.over_one_denominator(each)
    made = copy(table)  # the rows are the same, and cached facts about them remain true
    vars(made).update(components=amounts, component_denominator=bottom, averaged=False)
    return made


def _repeat_by_outcome(top: Numbers, table: OutcomeTable) -> Numbers:
    """Return numbers by outcome (N,); numbers by pair (L,) are repeated."""
    if len(top) == table.pairs:
        return np.asarray(top[table.pair])
    return top


def cancel_common_divisor(
    top: Numbers, below: Numbers, table: OutcomeTable
) -> tuple[Numbers, Numbers]:
    """Return numerators (L,) or (N,) and denominators (L,) without a common divisor."""
    if len(top) == table.pairs:
        return reduce_fractions(top, below)
    shared = np.gcd(np.gcd.reduceat(top, table.offsets[:-1]), below)
    return np.asarray(top // shared[table.pair]), np.asarray(below // shared)


def _column_to_integers(
    column: tuple[Numbers, Numbers], table: OutcomeTable
) -> tuple[Numbers, Numbers]:
    """Return a column as integer numerators and denominators."""
    top, bottom = column
    if top.dtype != np.float64:
        return top, bottom
    return to_dyadic_integers(top, _list_groups(top, table))


def _list_groups(top: Numbers, table: OutcomeTable) -> Integers:
    """Return the offsets (L+1,) of the numbers of each pair: one (L,), or its outcomes' (N,)."""
    if len(top) == table.pairs:
        return np.arange(len(top) + 1)
    return table.offsets


def _complete_components(
    columns: dict[str, tuple[Numbers, Numbers]], earned: OutcomeTable
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return names and table of the given components and the rest of the reward."""
    names, table = _add_remainder(columns, earned)
    # If the reward differs between outcomes, components that were given by pair are means.
    if not table.parted_by_outcome and not adds_up(table):
        table = replace(table, averaged=True)
    return names, table


def adds_up(table: OutcomeTable) -> bool:
    """Return whether components add up to the reward in each outcome, not only on average."""
    if not (table.joint or table.parted_by_outcome):
        return True
    # Integers add up exactly or not at all.
    if np.float64 not in (table.gain.dtype, table.components.dtype):
        return not np.asarray(_remainder_by_outcome(table)[0] != 0).any()
    # Floats: compare in each outcome, with an allowance for rounding.
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
    """Return names and table of the components, with the remainder of the reward if any."""
    table = with_components(earned, [*columns.values()])
    left, below = _compute_remainder(table)
    if not np.asarray(left != 0).any():
        return tuple(columns), table
    # Floats may miss the reward by rounding alone. If their printed decimals add up exactly, these
    # are the amounts that the user meant.
    floats = np.float64 in (table.components.dtype, table.gain.dtype, table.weight.dtype)
    if floats and not wrong_rows(table, table.expected_gain()).any():
        printed = with_components(
            table, [_as_printed(column, table) for column in columns.values()]
        )
        if not np.asarray(_compute_remainder(printed)[0] != 0).any():
            table = printed
        return tuple(columns), table
    # A real remainder is a component of its own.
    if REST in columns:
        raise ModelError(
            f"the components, one of them called {REST!r}, do not add up to the reward",
            where="components",
            fix=f"leave {REST!r} out: it is the reward less the others, and is added by itself",
        )
    more = columns | {REST: cancel_common_divisor(left, below, table)}
    return tuple(more), with_components(table, [*more.values()])


def _compute_remainder(table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return the reward less all components: integers (L,) over denominators (L,).

    The integers are by outcome (N,) if the components are.
    """
    if table.parted_by_outcome:
        return _remainder_by_outcome(table)
    amount, below = table.expected_components_exact()
    total = np.asarray(multiply(amount, to_integer_array([1]), terms=amount.shape[1]).sum(axis=1))
    gain, bottom = table.expected_gain_exact
    return multiply(gain, below) - multiply(total, bottom), multiply(bottom, below)


def _remainder_by_outcome(table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return the reward less all components in each outcome (N,), over denominators (L,)."""
    gain, below = table.integer_gains
    left = _repeat_by_outcome(gain, table).astype(object)
    for number in range(table.components.shape[1]):
        part, under = table.with_component_reward(number).integer_gains
        part = _repeat_by_outcome(part, table).astype(object)
        left = left * under[table.pair] - part * below[table.pair].astype(object)
        below = multiply(below, under)
    return to_integer_array(left.tolist()), below


def _as_printed(column: tuple[Numbers, Numbers], table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return amounts in which each float is the decimal that it prints as: 0.1 is 1/10."""
    top, _ = column
    if top.dtype != np.float64:
        return column
    values = [Fraction(repr(value)) for value in top.tolist()]
    return over_groups(values, _list_groups(top, table))


def wrong_rows(table: OutcomeTable, reward: Floats) -> Numbers:
    """Return (L,) True where components do not add up to the reward, even up to rounding."""
    floats = table.expected_components()
    with np.errstate(over="ignore"):  # sums of huge amounts may overflow
        total = floats.sum(axis=1)
        # Amounts of both signs may cancel, but rounding is relative to the size of each of them.
        sizes = replace(table, gain=np.abs(table.gain), components=np.abs(table.components))
        scale = sizes.expected_components().sum(axis=1) + sizes.expected_gain()
    # Rounding is relative, except below the range of normal floats, where it is absolute.
    lost = (floats.shape[1] + 1) * 2.0**-1074
    # Roundings: a product and a sum for each outcome, of the reward and of each component, and a
    # sum for each component. All of them happened twice: here, and in the user's own sums.
    roundings = 4 * np.diff(table.offsets) + floats.shape[1] + 4
    return np.asarray(~(np.abs(total - reward) <= roundings * NEXT * scale + lost))


def each_component(names: dict[str, Any], change: Callable[[Any, str], Any]) -> None:
    """Apply `change`, a function of values and their place, to the values of each component."""
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
        fix = "name at least one, or leave components out"
        raise ModelError("no component is given", where="components", fix=fix)
    names["components"] = changed


def require_length(values: Any, where: str, pairs: int) -> Any:
    """Return amounts as an array (L,); raise ShapeError for another length."""
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
    """Take `components` out of parts; return component names and the table with components.

    Without components in `parts`, `by_outcome` gives their amounts (N,) by name.
    """
    # A reward that is not finite is refused by validation, which comes next.
    sound = table.gain.dtype != np.float64 or np.isfinite(table.gain).all()
    given = parts.get("components") is not None
    if not (given or by_outcome) or not sound:
        parts.pop("components", None)
        return {"table": table}
    each_component(parts, lambda values, where: _read_table_amounts(values, where, table))
    every: Mapping[str, Any] = by_outcome or {}
    if given:
        every = parts.pop("components")
    # Bring each component into one form: by outcome, and then by pair if its outcomes agree.
    columns = {}
    for name, values in every.items():
        if given and values.ndim == 1:
            top, bottom = group_numbers(np.array(values), np.arange(table.pairs + 1))
        else:
            if values.ndim == 2:
                values = np.asarray(values[table.pair, table.next])
            top, bottom = _by_pair_if_alike(np.array(values), table)
        if top.dtype == np.float64 and not np.isfinite(top).all():
            what = f"an amount is {top[~np.isfinite(top)][0]}"
            raise ModelError(what, where=f"component {name}", fix="give a finite number")
        columns[name] = top, bottom
    names, table = _complete_components(columns, table)
    return {"component_names": names, "table": table}


def with_outcome_amounts(table: OutcomeTable, amounts: Mapping[str, Any]) -> OutcomeTable:
    """Return a table with components, given as amounts by outcome {name: (N,)}."""
    columns = [_by_pair_if_alike(np.asarray(values), table) for values in amounts.values()]
    return with_components(table, columns)


def _by_pair_if_alike(values: Numbers, table: OutcomeTable) -> tuple[Numbers, Numbers]:
    """Return numerators and denominators of amounts (N,); by pair, if its outcomes agree."""
    of_pair = values[table.offsets[:-1]]
    if hold_same_numbers(values, of_pair[table.pair]):
        return group_numbers(of_pair, np.arange(table.pairs + 1))
    return group_numbers(values, table.offsets)


def align_tables(tables: Sequence[OutcomeTable]) -> Sequence[OutcomeTable]:
    """Return tables whose numbers are of one kind: floats or integers, by pair or by outcome."""
    if len(tables) == 1:
        return tables
    floats = all(table.weight.dtype == np.float64 for table in tables)
    sound = all(table.rows.sound for table in tables)
    events = any(table.event is not None for table in tables)
    parts = [table.components.shape[1] for table in tables if table.components is not None]
    columns = [_align_rewards(tables)]
    for number in range(max(parts, default=0)):
        columns.append(_align_rewards([table.with_component_reward(number) for table in tables]))
    aligned = []
    for table, (gain, below), *amounts in zip(tables, *columns, strict=True):
        event, rows = table.event, replace(table.rows, sound=sound)
        if not floats:
            weight, bottom = table.rows.integers
            rows = replace(table.rows, weight=weight, denominator=bottom)
        if events and event is None:
            event = np.zeros(len(table.next), dtype=np.uint8)
        own = OutcomeTable(rows=rows, gain=gain, gain_denominator=below, event=event)
        if amounts:
            own = with_components(own, amounts)
        averaged = any(each.averaged for each in tables)
        aligned.append(replace(own, averaged=averaged))
    return aligned


def _align_rewards(tables: Sequence[OutcomeTable]) -> list[tuple[Numbers, Numbers]]:
    """Return the rewards of tables: by outcome, or in integers, if one table has them so."""
    by_outcome = any(len(table.gain) != table.pairs for table in tables)
    floats = all(table.gain.dtype == np.float64 for table in tables)
    rewards = []
    for table in tables:
        gain, below = table.gain, table.gain_denominator
        if not floats:
            gain, below = table.integer_gains
        if by_outcome:
            gain = _repeat_by_outcome(gain, table)
        rewards.append((gain, below))
    return rewards


def require_amounts(table: OutcomeTable, what: str) -> None:
    """Raise ModelError if only the mean reward of each pair is known, not of each outcome.

    This is so for a single component of a scenario; `what` names the analysis that needs more.
    """
    if table.averaged and table.components is None:
        raise ModelError(
            f"{what} needs the reward of each outcome, but for this component of the reward only "
            "the mean of each pair is known",
            where="reward components",
            fix="evaluate() gives the mean; or, in a scenario, set every other weight to 0 (--set "
            "reward.NAME=0 for each of them), and leave out --reward, or reward=",
        )


def _read_table_amounts(values: Any, where: str, table: OutcomeTable) -> Any:
    """Return an array of amounts by pair (L,) or by transition (L, S)."""
    amounts = array_of(values, where)
    if amounts.ndim == 2 and len(amounts) == table.pairs and amounts.shape[1] > table.next.max():
        return amounts
    return require_length(amounts, where, table.pairs)
