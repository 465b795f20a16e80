"""Policies state by state: from a mapping, a function or a file.

Each state has a choice: an action, {action: probability}, or a row of A numbers, which are
probabilities or action values; in a Q-table {action: value} is a row as well. {(state, action):
number} is a table of rows if it has all available actions, else {state: {action: number}}.
`mdp.forms.names` states how to refer to a state or an action. A list or an array is a row, and so
is a tuple that is not an action. Everything in a file is text: there the digits of a state are a
number. In a text file a Q-table may have a line for each value: state,action,q.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, join_few, locate_errors, once_each
from exact_mdp.mdp.forms.long_table import ACTION, STATE, usual_name
from exact_mdp.mdp.forms.names import integer_of, is_number
from exact_mdp.mdp.forms.numbers import convert_tensors, refuse_masked
from exact_mdp.mdp.io.files import LARGE, STANDARD_INPUT, read_text, write_atomically
from exact_mdp.mdp.io.formats import POLICIES, Format, find_format, join_endings, split_part
from exact_mdp.mdp.io.structured import csv_of, json_of, read_array
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import (
    Parts,
    numbers_of,
    of_given_array,
    policy_of_array,
    rows_read,
    too_small,
    warn_unread,
)
from exact_mdp.mdp.policies.tables import (
    Line,
    find_part,
    is_number_text,
    parse_digits,
    parse_key,
    parse_lists,
    parse_number,
    read_lines,
    read_table,
)
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import Numbers, as_float, exact

PRINTED_TIME = re.compile(rf"{TIME} \d+, ")  # in the printed form of a state
PARTED = (".npz", ".json")  # files of which "FILE#NAME" names a part
VALUES = ("q", "value", "q value", "action value")  # columns of a long Q-table
PICKLES = (".pkl", ".pickle")
Chances = dict[int, dict[int, Fraction]]
"""Probabilities of actions by the number of a combination of column values."""


def of_mapping(model: MDP, entries: Mapping[Any, Any], kind: str = "auto") -> Parts:
    """Return the policy of {status: choice} or {state: choice}."""
    default = getattr(entries, "default_factory", None)  # a defaultdict has a choice for all others
    if "status" in model.space.names and not any("status " in str(key) for key in entries):
        space = StateSpace(columns=(model.space.column("status"),))
        number = _by_text(space.columns[0])
    else:
        # A policy of states without a time is the same at every time.
        space = model.space
        if space.untimed is not None and not _names_times(model, space.untimed, entries):
            space = space.untimed
        number = _state_finder(model, space.number)
    entries = _by_pair(model, space, number, entries) or _keep_reachable(space, entries)
    choices = once_each([(number(key), choice) for key, choice in entries.items()], space.label)
    for key, same in _find_same_seen(space).items():
        if key not in choices and same in choices:
            choices[key] = choices[same]
    if default is not None:
        for key in range(space.size):
            if key not in choices:
                choices[key] = default()
    return _of_choices(model, space, choices, kind)


def _names_times(model: MDP, untimed: StateSpace, keys: Iterable[Any]) -> bool:
    """Return whether keys name times, too: "time 2, state ill", or (2, "ill").

    Unless they name all times, tuples may be states of a grid, or pairs of a state and an action.
    """
    keys, space = list(keys), model.space
    if any(PRINTED_TIME.match(str(key)) for key in keys):
        return True
    if all(map(untimed.lookup.can_find, keys)) or not all(isinstance(key, tuple) for key in keys):
        return False
    if not all(map(space.lookup.can_find, keys)):
        return False
    if {*np.flatnonzero(model.ends.must_choose).tolist()} <= {*map(space.number, keys)}:
        return True
    states = dict.fromkeys(state for state, *_ in keys)
    others = _find_unreached(untimed, states)
    pairs = all(state in others or untimed.lookup.can_find(state) for state in states)
    pairs = pairs and all(model.action_names.can_find(key[-1]) for key in keys)
    return not pairs and not _find_unreached(untimed, keys)


def _state_finder(model: MDP, find: Callable[[Any], int]) -> Callable[[Any], int]:
    """Return a function that finds states; of an estimated model it says what records lack."""

    def find_state(name: Any) -> int:
        try:
            return find(name)
        except ModelError as error:
            origin = origin_of(model)
            observed = (origin.model if origin else model).observations
            if observed is None or model.space.lookup.has_name(name):
                raise
            fix = f"leave it out: the model cannot come there; or {error.fix}"
            raise ModelError(f"{error.what}; no record has this state", fix=fix) from None

    return find_state


def _by_text(column: Column) -> Callable[[object], int]:
    """Return the function that numbers the values of a column by their texts."""
    return lambda label: column.number(str(label))


def _by_pair(
    model: MDP, space: StateSpace, number: Callable[[object], int], entries: Mapping[Any, Any]
) -> dict[Any, Any]:
    """Return {(state, action): number} as {state: {action: number}}; {} for other entries.

    If it has all available actions it is a table, {state: row}, which is read like an array.
    """
    pairs = all(isinstance(key, tuple) and len(key) == 2 for key in entries)
    kinds = (int, float, Fraction, np.number)
    if not pairs or not all(isinstance(value, kinds) for value in entries.values()):
        return {}
    states = dict.fromkeys(state for state, _ in entries)
    others = _find_unreached(space, states)
    if not all(map(space.lookup.can_find, entries)):
        entries = {key: value for key, value in entries.items() if key[0] not in others}
    each = []
    try:
        for state, action in entries:
            each.append((number(state), model.action_names.find_number(action)))
    except ModelError:
        if not any(map(space.lookup.can_find, entries)):
            raise
        return {}
    # Does every available action of a state with a choice have a number?
    rows = rows_read(model, space)[model.pair_state]
    choosing = model.ends.must_choose[model.pair_state]
    choosing &= ~np.isin(rows, [*_find_same_seen(space)])
    offered = zip(rows[choosing].tolist(), model.pair_action[choosing].tolist(), strict=True)
    complete = {*offered} <= {*each}
    # The keys may themselves be states that are tuples.
    if all(map(space.lookup.can_find, entries)):
        if not complete:
            return {}  # {state: action}
        if {*rows[choosing].tolist()} <= {*map(number, entries)}:
            raise ModelError(
                "the keys may be states, or pairs of a state and an action: "
                f"{', '.join(map(str, [*entries][:4]))}",
                fix="give {state: {action: number}}, or the names of actions: {state: action}",
            )
    if others:
        warn_unread([*map(str, others)], len(others), len(states))
    table: dict[Any, dict[str, Any]] = {}
    numbers = once_each(zip(each, entries.values(), strict=True), lambda pair: space.label(pair[0]))
    for (state, action), value in numbers.items():
        table.setdefault(space.label(state), {})[model.actions[action]] = value
    if not complete:
        return table
    full: dict[Any, list[Any]] = {}
    for state_label, row in table.items():
        full[state_label] = [row.get(name, 0) for name in model.actions]
    return full


def _find_unreached(space: StateSpace, states: Collection[Any]) -> dict[Any, None]:
    """Return the states of a whole grid that a model made from tuples or numbers does not have.

    If all are unknown, none is returned: they are mistakes, which are refused. Numbers may also
    count the states of the model, so they are a grid only if all of its states are among them.
    """
    objects: tuple[Any, ...] = ()
    if len(space.columns) == 1:
        objects = space.columns[0].objects
    kind: Any = tuple
    if not any(isinstance(thing, tuple) for thing in objects):
        kind = int | np.integer
        if not {thing for thing in objects if isinstance(thing, kind)} <= {*states}:
            return {}
    if not any(isinstance(thing, kind) for thing in objects):
        return {}
    others = dict[Any, None]()
    for state in states:
        if isinstance(state, kind) and not space.lookup.can_find(state):
            others[state] = None
    if len(others) == len(states):
        return {}
    return others


def _keep_reachable(space: StateSpace, entries: Mapping[Any, Any]) -> Mapping[Any, Any]:
    """Return the entries of known states; warn about states that the model does not reach."""
    others = _find_unreached(space, entries)
    if not others:
        return entries
    warn_unread([*map(str, others)], len(others), len(entries))
    return {key: choice for key, choice in entries.items() if key not in others}


def _find_same_seen(space: StateSpace) -> dict[int, int]:
    """Return {row: row of the state that looks the same to an agent} for `Natural` states."""
    same = {}
    if len(space.columns) == 1:
        for row, thing in enumerate(space.columns[0].objects):
            seen = getattr(thing, "seen", None)
            if seen is not None:
                same[row] = space.number(seen)
    return same


def of_function(model: MDP, ask: Callable[[Any], Any], kind: str = "auto") -> Parts:
    """Return the policy that a function gives, called for each state with a choice.

    The argument of the function is the object of the state, if the model was made from objects;
    else the name of the state; without names its number.
    """
    space = model.space.untimed or model.space
    choices = {}
    for state in np.unique(rows_read(model, space)[model.ends.must_choose]).tolist():
        thing = state
        if len(space.columns) == 1 and state < space.columns[0].size:
            thing = space.columns[0].find_object(state)
        choices[state] = ask(thing)
        # Answers of functions that forget to return, and of agents that also return their state.
        if choices[state] is None:
            raise ModelError(
                "the function returns None",
                where=f"policy, {space.label(state)}",
                fix="return an action, {action: probability}, or a row of A numbers",
            )
        if _is_answer_of_agent(model, choices[state]):
            raise ModelError(
                f"the function returns {choices[state]!r}, an action and a state of the agent",
                where=f"policy, {space.label(state)}",
                fix="return the action alone: lambda state: agent.predict(state)[0]",
            )
    return _of_choices(model, space, choices, kind)


def _is_answer_of_agent(model: MDP, choice: Any) -> bool:
    """Return whether an answer is a pair: an action and the internal state of an agent, or None."""
    if not isinstance(choice, tuple) or len(choice) != 2 or model.action_names.has_name(choice):
        return False
    action, memory = choice
    return memory is None or (np.ndim(action) == 0) != (np.ndim(memory) == 0)


def _of_choices(model: MDP, space: StateSpace, choices: Mapping[int, Any], kind: str) -> Parts:
    """Return the policy of {row number: choice}."""
    if kind == "auto" and _has_action_values(space, choices):
        kind = "q"
    read: dict[int, Any] = {}
    for key, choice in choices.items():
        choice = convert_tensors(choice)
        refuse_masked(choice, "policy")
        if kind == "q" and isinstance(choice, Mapping):
            choice = _read_action_values(model, space, key, choice)
        read[key] = choice
    choices = read
    # Rows of numbers make a table, which is read like an array.
    if choices and all(_is_row(model, choice, kind) for choice in choices.values()):
        table = np.full((space.size, model.n_actions), np.nan, dtype=object)
        for key, row in choices.items():
            if len(row) != model.n_actions:
                fix = f"give one for each of the {model.n_actions} actions"
                if len(row) == 1:
                    fix += "; the action itself is the first entry of the row: [0]"
                where = f"policy, {space.label(key)}"
                raise ShapeError(f"a row of {len(row)} numbers", where=where, fix=fix)
            for action, number in enumerate(row):
                if isinstance(number, str):
                    number = exact(number)
                table[key, action] = number
        _check_complete(model, space, choices)
        return policy_of_array(model, numbers_of(table), kind)
    # Otherwise each choice is an action, or {action: probability}.
    chances, names = Chances(), model.action_names
    for key, choice in choices.items():
        with locate_errors(space.label(key)):
            if isinstance(choice, Mapping):
                each = zip(
                    names.find_numbers(choice),
                    map(_parse_probability, choice.values()),
                    strict=True,
                )
                chances[key] = once_each(each, names.label)
            else:
                chances[key] = {names.find_number(_unwrap_action(choice)): Fraction(1)}
    return _of_chances(model, space, chances)


def _has_action_values(space: StateSpace, choices: Mapping[int, Any]) -> bool:
    """Return whether all choices are {action: number}, and some number is below 0 or above 1."""
    if not all(isinstance(choice, Mapping) for choice in choices.values()):
        return False
    for key, choice in choices.items():
        with locate_errors(space.label(key)):
            for value in choice.values():
                number = value
                if isinstance(value, str):
                    number = exact(value)
                if is_number(number) and not 0 <= number <= 1:
                    return True
    return False


def _read_action_values(
    model: MDP, space: StateSpace, key: int, choice: Mapping[Any, Any]
) -> list[Any]:
    """Return {action: value} as a row of action values; NaN for unavailable actions."""
    names = model.action_names
    with locate_errors(space.label(key)):
        values = once_each(
            zip(names.find_numbers(choice), choice.values(), strict=True), names.label
        )
        states = np.flatnonzero((rows_read(model, space) == key) & model.ends.must_choose)
        offered = np.unique(model.pair_action[np.isin(model.pair_state, states)])
        lost = [model.actions[action] for action in offered.tolist() if action not in values]
        if lost:
            raise ModelError(
                f"there is no value for {', '.join(lost)}",
                fix="give one for every available action; -inf for one never to be taken",
            )
    return [values.get(action, np.nan) for action in range(model.n_actions)]


def _unwrap_action(choice: Any) -> Any:
    """Return an action as a number, name or tuple; it may be given as an array or a list."""
    if isinstance(choice, np.ndarray) and not choice.ndim:
        return choice.item()
    if isinstance(choice, list | np.ndarray):
        return tuple(choice)
    return choice


def _parse_probability(value: object) -> Fraction:
    """Return a probability exactly; raise ModelError if it is positive, but 0 as a float."""
    number = exact(value)
    if number and not as_float(number):
        raise too_small("")
    return number


def _is_row(model: MDP, choice: Any, kind: str) -> bool:
    """Return whether a choice is a row of numbers: a list, or a tuple that is not an action."""
    if not isinstance(choice, list | tuple | np.ndarray) or not np.ndim(choice):
        return False
    if isinstance(choice, np.ndarray):
        row = tuple(choice.tolist())
    else:
        row = tuple(choice)
    # (0.0, 1.0) equals (0, 1), and may be the action with the name "(0, 1)".
    whole = []
    for number in row:
        if is_number(number) and integer_of(number) is not None:
            number = int(number)
        whole.append(number)
    action, equal = map(model.action_names.has_name, (row, tuple(whole)))
    if isinstance(choice, tuple) and action:
        return False
    if kind == "auto" and (action or equal):
        raise ModelError(
            f"{choice} may be the action of that name, or a row of numbers for all actions, "
            "and the two differ",
            fix="give the action by its name, as text, or rows as one array with kind=",
        )
    return True


def _of_chances(model: MDP, space: StateSpace, chances: Chances) -> Parts:
    """Return the policy; raise ModelError if a row that a state with a choice reads is missing."""
    _check_complete(model, space, chances)
    # Floats suffice if they hold all probabilities exactly.
    kind: type = np.float64
    for row in chances.values():
        if not all(float(chance) == chance for chance in row.values()):
            kind = object
    table: Numbers = np.full((space.size, model.n_actions), np.nan, dtype=kind)
    for key, row in chances.items():
        table[key] = 0
        for action, chance in row.items():
            table[key, action] = chance
    return {"space": space, "actions": model.actions, "rule": table}


def _check_complete(model: MDP, space: StateSpace, said: Iterable[int]) -> None:
    """Raise ModelError unless `said` has all rows that states with a choice read."""
    keys = rows_read(model, space)
    silent = np.ones(space.size, dtype=bool)
    silent[list(said)] = False
    missing = silent[keys] & model.ends.must_choose
    if missing.any():
        lost = sorted(set(keys[missing].tolist()))
        shown = join_few(map(space.label, lost), len(lost), "; ")
        raise ModelError(
            f"{len(lost)} of {space.size} rows are missing: {shown}", fix="add one for each"
        )


# ---- files ---------------------------------------------------------------------------------------


def of_file(model: MDP, path: str | Path, kind: str = "auto") -> Parts:
    """Return the policy in a file, or in JSON from standard input."""
    where, form = str(path), find_policy_format(path)
    if form is None:
        suffix, what = Path(path).suffix.lower(), f"unknown policy {where!r}"
        if suffix in PICKLES:
            raise _pickle_error(where)
        if suffix and isfile(path):
            what = f"cannot read {suffix}"
        fix = (
            f"give random, always:ACTION, or a {join_endings(POLICIES)} file; the optimal policy "
            "is solve(mdp).policy, on the command line optimal"
        )
        if where in model.actions:
            fix = f"did you mean always:{where}?"
        raise ModelError(what, fix=fix)
    return dict(form.read_file(model, path, kind=kind))


def _number_or_text(choice: Any) -> Any:
    """Return a text that writes a number as that number, and anything else as it is."""
    if isinstance(choice, str) and is_number_text(choice):
        return exact(choice)
    return choice


def find_policy_format(path: str | Path) -> Format | None:
    """Return the format of a policy's file, or of "FILE#NAME"; None if it is not among them."""
    if str(path) == STANDARD_INPUT:
        return POLICIES[".json"]
    return find_format(split_part(str(path), PARTED)[0], POLICIES)


def _pickle_error(path: str) -> ModelError:
    """Return the error for a pickled policy, with the lines that convert it."""
    out = f"{path}.csv"
    code = (
        "import pathlib, pickle; from exact_mdp import Policy, load; "
        f"q = pickle.loads(pathlib.Path({path!r}).read_bytes()); "
        f"Policy.of(load('MODEL'), q, kind='q').write({out!r})"
    )
    return ModelError(
        "a pickle is not read, since it may run any code",
        fix="if you trust it, write its policy for your MODEL in Python, and give that .csv "
        f"without a kind: {code}",
    )


def read_policy_array(model: MDP, path: str | Path, *, kind: str) -> Parts:
    """Return the policy in a file of an array, or in the array NAME of "FILE#NAME"."""
    # A number of an array takes at most 16 bytes.
    most = max(LARGE, 16 * model.n_states * model.n_actions)
    file, name = split_part(str(path), PARTED)
    return of_given_array(model, read_array(file, name, called="q", most=most), kind)


def read_policy_json(model: MDP, path: str | Path, *, kind: str) -> Parts:
    """Return the policy in JSON: an object by status or by state, or a table as lists of rows."""
    # Digits of a state are its number.
    file, name = split_part(str(path), PARTED)
    content = json_of(read_text(file), file, parse_float=str, parse_int=parse_digits)
    content = find_part(content, name, file)
    if isinstance(content, list):
        return of_given_array(model, numbers_of(parse_lists(content)), kind)
    by_status = "status" in model.space.names
    if not isinstance(content, dict):
        first = "0"
        if by_status:
            first = "0000"
        example = json.dumps({first: model.actions[0]}, ensure_ascii=False)
        raise ModelError(
            "the file is not a JSON object or list", fix=f"write {example[:-1]}, …}}, or rows"
        )
    if not by_status:
        content = once_each(((parse_key(key), choice) for key, choice in content.items()), str)
        # A number of a pair (state, action) may be written with a point, and is a text here.
        if all(isinstance(key, tuple) and len(key) == 2 for key in content):
            content = {key: _number_or_text(choice) for key, choice in content.items()}
    return of_mapping(model, content, kind)


def read_policy_text(model: MDP, path: str | Path, *, kind: str) -> Parts:
    """Return the policy in a text file: a table of numbers, or a list of actions with a header."""
    text = read_text(path)
    rows = csv_of(io.StringIO(text))
    _, first = next(rows, (0, []))
    heads = [*map(usual_name, first)]
    for value in {*heads} & {*VALUES}:
        if sorted(heads) == sorted((STATE, ACTION, value)):
            places = [*map(heads.index, (STATE, ACTION, value))]
            return _read_long_q_table(model, rows, places, kind)
    header = [*map(str.strip, first)]
    if "action" in header or {*header} <= {"state", *model.space.names}:
        return _read_listed_actions(model, header, rows)
    lines, comment = read_lines(text, spaces=Path(path).suffix.lower() == ".txt")
    table = read_table(model, lines, comment)
    if isinstance(table, dict):
        return of_mapping(model, table, kind)
    return of_given_array(model, numbers_of(table), kind)


def _read_long_q_table(model: MDP, rows: Iterable[Line], places: Sequence[int], kind: str) -> Parts:
    """Return the policy of a Q-table with a line for each state and action, and its value."""
    values: dict[Any, list[tuple[str, Any]]] = {}
    for number, row in rows:
        state, action, value = (row[place].strip() for place in places)
        with locate_errors(f"line {number}"):
            values.setdefault(parse_key(state), []).append((action, parse_number(value)))
    if kind == "auto":
        kind = "q"
    return of_mapping(model, {state: once_each(row) for state, row in values.items()}, kind)


def _read_listed_actions(model: MDP, header: list[str], rows: Iterable[Line]) -> Parts:
    """Return the policy in rows of a CSV text: state columns, action, perhaps probability."""
    columns = [name for name in header if name not in ("action", "probability")]
    by_state = columns == ["state"] and "state" not in model.space.names
    # The header has columns of the state, or one column `state`; and the action.
    known = ["action", "probability", *model.space.names]
    if by_state or not {*columns} & {*known}:
        known = ["action", "probability", "state"]
    wrong = [name for name in header if name not in known]
    if wrong or "action" not in header or not columns or len(set(header)) != len(header):
        what = f"the header is {','.join(header)!r}"
        if wrong:
            what = f"unknown column {wrong[0]!r}"
        raise ModelError(
            what,
            fix=f"write {','.join([*model.space.names, 'action'])}, or some of these columns; "
            "numbers alone are a table: a row for each state, a column for each action; "
            "state,action,q is a Q-table with a line for each value",
        )
    # The states by number or name, or a space over the columns that the header names.
    space = model.space.untimed or model.space
    if not by_state:
        space = StateSpace(columns=tuple(model.space.column(name) for name in columns))
    by_name = by_state or (len(columns) == 1 and bool(space.columns[0].words))
    chances: Chances = {}

    def find_by_columns(entry: Any) -> int:
        return space.index(**{c.name: c.number(entry[c.name]) for c in space.columns})

    # Each line adds an action of a row; several need probabilities.
    for number, row in rows:
        with locate_errors(f"line {number}"):
            entry = dict(zip(header, row, strict=True))
            if by_name:
                key = _state_finder(model, space.number)(parse_digits(entry[columns[0]]))
            else:
                key = _state_finder(model, find_by_columns)(entry)
            action = model.action_names.find_number(entry["action"])
            taken = chances.setdefault(key, {})
            if action in taken or (taken and "probability" not in header):
                raise ModelError(
                    f"{space.label(key)} appears twice",
                    fix="keep one of them, or add a column probability",
                )
            taken[action] = _parse_probability(entry.get("probability", "1").strip())
    return _of_chances(model, space, chances)


def state_names(space: StateSpace) -> list[str]:
    """Return a name for each state: its word, or its printed form."""
    if len(space.columns) == 1:
        column = space.columns[0]
        return [*(column.label(value) for value in range(column.size)), *space.extra]
    return space.labels(range(space.size))


def of_every_state(mdp: MDP, said: Sequence[Any]) -> dict[str, Any]:
    """Return the choices of a policy, one for each state, as a mapping for a file.

    The keys are statuses if the choice depends on the status only, else names of states.
    """
    if "status" in mdp.space.names:
        column = mdp.space.column("status")
        status = mdp.space.values("status")
        choosing = np.flatnonzero(mdp.ends.must_choose & (status >= 0)).tolist()
        each = [(column.label(int(status[state])), said[state]) for state in choosing]
        # A status without a state with a choice gets the choice of its first state.
        by_label = {}
        for value in range(column.size):
            by_label[column.label(value)] = said[mdp.space.index(status=value)]
        by_label |= dict(each)
        if all(by_label[label] == one for label, one in each):
            return by_label
    return dict(zip(state_names(mdp.space), said, strict=True))


def write_policy_csv(
    space: StateSpace, rows: Mapping[int, Mapping[str, Any]], path: str | Path
) -> None:
    """Write the probabilities of the actions of each row."""
    if not space.names:
        raise ModelError(
            "the policy is the same in all states",
            where=str(path),
            fix="name it as always:ACTION instead",
        )
    # The words of a state are its column values, or its printed form if these are ambiguous.
    labels = {key: [*space.as_dict(key).values()] for key in rows}
    if len(space.names) == 1 and space.columns[0].words:
        read = [space.lookup.can_find(parse_digits(words[0])) for words in labels.values()]
        if not all(read):  # a name may also be the number of another state
            labels = {key: [space.label(key)] for key in rows}
    # Only a mixed policy needs the column of probabilities.
    mixed = any(len(taken) > 1 for taken in rows.values())
    header = [*space.names, "action"]
    if mixed:
        header.append("probability")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    for key, taken in rows.items():
        for action, chance in taken.items():
            line = [*labels[key], action]
            if mixed:
                line.append(str(chance))
            writer.writerow(line)
    write_atomically(path, out.getvalue())
