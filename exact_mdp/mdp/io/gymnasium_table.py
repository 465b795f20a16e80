"""The table `P` of an environment as rows of outcomes: dictionaries or lists, by state and action.

`P[state][action]` lists (probability, next state, reward, terminated). States and actions are whole
numbers from 0, as floats too, and terminated may be 0 or 1. Probabilities in single or half
precision are divided by their sum, where it misses 1 by their rounding alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors, shorten_text
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.table import exact

NOWHERE = -1  # a next state that some tables write where the episode is over
LISTED = "let P[state][action] list (probability, next state, reward, terminated)"
Outcome = tuple[Any, int, Any, bool]
Rows = dict[tuple[int, int], list[Outcome]]


def is_outcome_table(given: Any) -> bool:
    """Return whether a table is given by itself, not by an environment that has it."""
    return isinstance(given, Mapping | list | tuple | np.ndarray)


def read_outcome_rows(env: Any, where: str) -> tuple[Rows, int]:
    """Return the outcomes of every pair, and the number of states.

    A state without a row, or with an empty one, is an end if outcomes enter it, all terminated.
    """
    table = env if is_outcome_table(env) else getattr(env, "P", None)
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
    rows: Rows = {}
    empty: dict[int, Any] = {}
    for state, row in _list_items(table, where, "P"):
        if row is None or (is_outcome_table(row) and len(row) == 0):
            empty[state] = row
            continue
        for action, listed in _list_items(row, where, f"P[{state}]"):
            place = f"{where}, P[{state}][{action}]"
            outcomes = [
                _parse_table_outcome(each, place) for each in _require_sequence(listed, place)
            ]
            rows[state, action] = _without_rounding(outcomes)
    return rows, _count_states(rows, empty, where)


def _count_states(rows: Rows, empty: Mapping[int, Any], where: str) -> int:
    """Return the number of states; raises ModelError where one has no action, and is no end."""
    named = {state for state, _ in rows}
    outcomes = [each for own in rows.values() for each in own]
    alive = {following for _, following, _, over in outcomes if not over} - named
    over = {following for _, following, _, over in outcomes if over} - named - {NOWHERE}
    stays = "an end stays: {0: [(1.0, state, 0, True)]}"
    for state, row in empty.items():
        if state in alive or state not in over:
            raise _no_action(f"P[{state}]", row, where)
    for state in sorted(alive)[:1]:
        what = f"there is no next state {state}: P does not list it, and an outcome that is not "
        fix = f"list it, or let that outcome be terminated; {stays}"
        raise ModelError(f"{what}terminated leads there", where=where, fix=fix)
    known = named | over
    if len(known) <= max(known):
        state = next(number for number in range(len(known) + 1) if number not in known)
        what = f"state {state} is without action: P does not list it, and no outcome ends there"
        raise ModelError(what, where=where, fix=f"number states from 0 without gaps; {stays}")
    return len(known)


def _without_rounding(outcomes: list[Outcome]) -> list[Outcome]:
    """Return outcomes whose probabilities, in single or half precision, sum to 1 but for rounding.

    They are divided by their exact sum. Others stay as they are.
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
    return [(each / total, *rest) for each, (_, *rest) in zip(numbers, outcomes, strict=True)]


def _list_items(table: Any, where: str, what: str) -> Iterator[tuple[int, Any]]:
    """Yield the numbers and entries of a dictionary, or of a list, which counts from 0."""
    if not is_outcome_table(table) or len(table) == 0:
        raise _no_action(what, table, where)
    for key, value in table.items() if isinstance(table, Mapping) else enumerate(table):
        if not is_whole_number(key) or key < 0:
            fix = "number states and actions from 0; with other names, describe the model: "
            fix += "MDP.from_function(start, actions, outcomes)"
            raise ModelError(f"{what} has the key {key!r}", where=where, fix=fix)
        yield int(key), value


def _no_action(what: str, table: Any, where: str) -> ModelError:
    fix = f"{LISTED}; an end stays: {{0: [(1.0, state, 0, True)]}}"
    return ModelError(
        f"{what} lists no action: {shorten_text(repr(table), 80)}", where=where, fix=fix
    )


def is_whole_number(number: Any) -> bool:
    """Return whether this is a whole number, of whatever type but a truth value."""
    if isinstance(number, float | np.floating):
        return float(number).is_integer()
    return isinstance(number, int | np.integer) and not isinstance(number, bool)


def _require_sequence(values: Any, where: str) -> Sequence[Any]:
    if isinstance(values, Sequence) and not isinstance(values, str):
        return values
    if isinstance(values, np.ndarray) and values.ndim:
        return list(values)
    what = f"{type(values).__name__} found where a list is expected"
    raise ModelError(what, where=where, fix=LISTED)


def _parse_table_outcome(given: Any, place: str) -> Outcome:
    values, why = _require_sequence(given, place), ""
    if len(values) != 4:
        why = f"it has {len(values)} entries"
    elif not is_whole_number(values[1]):
        why = f"its next state is {values[1]!r}"
    elif not isinstance(values[3], bool | np.bool_) and not (
        is_whole_number(values[3]) and values[3] in (0, 1)
    ):
        why = f"whether the episode is over is {values[3]!r}"
    if why:
        raise ModelError(f"an outcome is {given!r}: {why}", where=place, fix=LISTED)
    with locate_errors(place):
        for number in (values[0], values[2]):
            as_given(number)
    return values[0], int(values[1]), values[2], bool(values[3])
