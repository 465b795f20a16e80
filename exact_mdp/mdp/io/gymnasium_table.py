"""The table `P` of an environment as rows of outcomes: dictionaries or lists, by state and action.

`P[state][action]` lists (probability, next state, reward, terminated). States and actions are whole
numbers from 0, possibly as floats, and terminated may be 0 or 1. Probabilities in single or half
precision are divided by their sum if it misses 1 only by their rounding.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors, shorten_text
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.table import exact

NOWHERE = -1  # the next state in some tables if the episode is over
LISTED = "let P[state][action] list (probability, next state, reward, terminated)"
Outcome = tuple[Any, int, Any, bool]
Rows = dict[tuple[int, int], list[Outcome]]


def is_outcome_table(given: Any) -> bool:
    """Return whether a value is a table itself, not an environment with a table."""
    return isinstance(given, Mapping | list | tuple | np.ndarray)


def read_outcome_rows(env: Any, where: str) -> tuple[Rows, int]:
    """Return the outcomes of every pair, and the number of states.

    A state without a row, or with an empty one, is an end if outcomes enter it, all terminated.
    """
    table = env
    if not is_outcome_table(env):
        table = getattr(env, "P", None)
    if table is None:
        raise ModelError(
            "the environment does not expose its model as P",
            where=where,
            fix="describe it: MDP.from_function(start, actions, outcomes); or use an environment "
            "with P, such as FrozenLake-v1",
        )
    if isinstance(table, np.ndarray) and table.dtype != object:
        what = f"P is an array of shape {table.shape}, and not a table of outcomes"
        raise ModelError(what, where=where, fix="give it with the rewards: MDP.from_arrays(P, R)")
    # Read the rows; states without actions are kept apart, since some of them are ends.
    rows: Rows = {}
    empty: dict[int, Any] = {}
    for state, row in _list_items(table, where, "P"):
        if row is None or (is_outcome_table(row) and len(row) == 0):
            empty[state] = row
            continue
        for action, listed in _list_items(row, where, f"P[{state}]"):
            place = f"{where}, P[{state}][{action}]"
            each = _require_sequence(listed, place)
            outcomes = [_parse_table_outcome(outcome, place) for outcome in each]
            rows[state, action] = _without_rounding(outcomes)
    return rows, _count_states(rows, empty, where)


def _count_states(rows: Rows, empty: Mapping[int, Any], where: str) -> int:
    """Return the number of states; raise ModelError if a state without actions is not an end."""
    # States without rows: those that an episode enters, and those in which it ends.
    named = {state for state, _ in rows}
    alive, over = set[int](), set[int]()
    for outcomes in rows.values():
        alive |= {following for _, following, _, terminated in outcomes if not terminated}
        over |= {following for _, following, _, terminated in outcomes if terminated}
    alive, over = alive - named, over - named - {NOWHERE}
    stays = "an end stays: {0: [(1.0, state, 0, True)]}"
    for state, row in empty.items():
        if state in alive or state not in over:
            raise _no_action(f"P[{state}]", row, where)
    for state in sorted(alive)[:1]:
        what = f"P does not list state {state}, and an outcome that is not terminated leads there"
        fix = f"list it, or let that outcome be terminated; {stays}"
        raise ModelError(what, where=where, fix=fix)
    known = named | over
    if len(known) <= max(known):
        state = next(number for number in range(len(known) + 1) if number not in known)
        what = f"state {state} has no action: P does not list it, and no outcome ends there"
        raise ModelError(what, where=where, fix=f"number states from 0 without gaps; {stays}")
    return len(known)


def _without_rounding(outcomes: list[Outcome]) -> list[Outcome]:
    """Return outcomes with probabilities in single or half precision divided by their exact sum.

    Outcomes in double precision, or with a sum that misses 1 by more than rounding, are unchanged.
    """
    chances = [chance for chance, *_ in outcomes]
    kinds = {type(chance) for chance in chances}
    if not kinds or not kinds <= {np.float32, np.float16} or not np.all(np.isfinite(chances)):
        return outcomes
    numbers = [*map(exact, chances)]
    total = sum(numbers, Fraction(0))
    rounding = sum(float(np.finfo(type(chance)).eps) for chance in chances) / 2
    if min(numbers) < 0 or abs(total - 1) > rounding:
        return outcomes
    scaled = []
    for each, (_, *rest) in zip(numbers, outcomes, strict=True):
        scaled.append((each / total, *rest))
    return scaled


def _list_items(table: Any, where: str, what: str) -> Iterator[tuple[int, Any]]:
    """Yield the numbers and entries of a dictionary, or of a list, which counts from 0."""
    if not is_outcome_table(table) or len(table) == 0:
        raise _no_action(what, table, where)
    items: Iterable[tuple[Any, Any]] = enumerate(table)
    if isinstance(table, Mapping):
        items = table.items()
    for key, value in items:
        if not is_whole_number(key) or key < 0:
            fix = "number states and actions from 0; with other names, describe the model: "
            fix += "MDP.from_function(start, actions, outcomes)"
            raise ModelError(f"{what} has the key {key!r}", where=where, fix=fix)
        yield int(key), value


def _no_action(what: str, table: Any, where: str) -> ModelError:
    """Return the error for a state without actions."""
    fix = f"{LISTED}; an end stays: {{0: [(1.0, state, 0, True)]}}"
    return ModelError(
        f"{what} lists no action: {shorten_text(repr(table), 80)}", where=where, fix=fix
    )


def is_whole_number(number: Any) -> bool:
    """Return whether a value is a whole number of any type; truth values are not."""
    if isinstance(number, float | np.floating):
        return float(number).is_integer()
    return isinstance(number, int | np.integer) and not isinstance(number, bool)


def _is_flag(value: Any) -> bool:
    """Return whether a value is True or False, 1 or 0."""
    if isinstance(value, bool | np.bool_):
        return True
    return is_whole_number(value) and value in (0, 1)


def _require_sequence(values: Any, where: str) -> Sequence[Any]:
    """Return a list, tuple or array as a sequence; raise ModelError for anything else."""
    if isinstance(values, Sequence) and not isinstance(values, str):
        return values
    if isinstance(values, np.ndarray) and values.ndim:
        return list(values)
    what = f"a list is expected, not {type(values).__name__}"
    raise ModelError(what, where=where, fix=LISTED)


def _parse_table_outcome(given: Any, place: str) -> Outcome:
    """Return an outcome (probability, next state, reward, terminated) with checked types."""
    values, why = _require_sequence(given, place), ""
    if len(values) != 4:
        why = f"it has {len(values)} entries"
    elif not is_whole_number(values[1]):
        why = f"its next state is {values[1]!r}"
    elif not _is_flag(values[3]):
        why = f"terminated is {values[3]!r}"
    if why:
        raise ModelError(f"an outcome is {given!r}: {why}", where=place, fix=LISTED)
    with locate_errors(place):
        for number in (values[0], values[2]):
            as_given(number)
    return values[0], int(values[1]), values[2], bool(values[3])
