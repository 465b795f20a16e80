"""Policies state by state: what a mapping, a function or a file says.

Each state has a choice: an action, {action: probability}, or a row of A numbers, which are
probabilities or action values; of a Q-table {action: value} is a row, too. {(state, action):
number} is a table of rows where it has every action offered, else {state: {action: number}}.
`mdp.forms.names` says which state or action is meant; a list or an array is a row, and so is a
tuple that is no action. In a file all is text: there the digits of a state are a number.
"""

from __future__ import annotations

import csv
import io
import json
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, locate_errors, once_each, require_type
from exact_mdp.mdp.forms.names import integer_of, is_number
from exact_mdp.mdp.forms.numbers import convert_tensors, refuse_masked
from exact_mdp.mdp.io.files import STANDARD_INPUT, read_text, write_atomically
from exact_mdp.mdp.io.structured import csv_of, json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import Parts, numbers_of, policy_of_array, rows_read, too_small
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import Numbers, as_float, exact

PRINTED_TIME = re.compile(rf"{TIME} \d+, ")  # as printed; "time out" may be a name
WHOLE = re.compile(r"\s*-?(0|[1-9]\d{0,17})\s*", re.ASCII)
Chances = dict[int, dict[int, Fraction]]
"""Probabilities of actions by the number of a combination of column values."""


def of_mapping(model: MDP, entries: Mapping[Any, Any], kind: str = "auto") -> Parts:
    """Return what is said of statuses, {status: action}, or of states."""
    default = getattr(entries, "default_factory", None)  # of a defaultdict, which is not changed
    if "status" in model.space.names and not any("status " in str(key) for key in entries):
        space = StateSpace(columns=(model.space.column("status"),))
        number = _by_text(space.columns[0])
    else:
        timed = any(PRINTED_TIME.match(str(key)) for key in entries)
        space = model.space if timed else model.space.untimed or model.space
        number = space.number
    entries = _by_pair(model, space, number, entries) or _keep_reachable(space, entries)
    choices = once_each([(number(key), choice) for key, choice in entries.items()], space.label)
    if default is not None:
        choices = {key: choices[key] if key in choices else default() for key in range(space.size)}
    return _of_choices(model, space, choices, kind)


def _by_text(column: Column) -> Callable[[object], int]:
    """Return the function that numbers the values of a column by their texts."""
    return lambda label: column.number(str(label))


def _by_pair(
    model: MDP, space: StateSpace, number: Callable[[object], int], entries: Mapping[Any, Any]
) -> dict[Any, Any]:
    """Return {(state, action): number} as {state: {action: number}}; nothing for other entries.

    Where it has every action that is offered it is a table: {state: row}, read as arrays are.
    """
    pairs = all(isinstance(key, tuple) and len(key) == 2 for key in entries)
    kinds = (int, float, Fraction, np.number)
    if not pairs or not all(isinstance(value, kinds) for value in entries.values()):
        return {}
    try:
        each = [
            (number(state), model.action_names.find_number(action)) for state, action in entries
        ]
    except ModelError:
        return {}
    rows = rows_read(model, space)[model.pair_state]
    asked = model.asked[model.pair_state]
    offered = zip(rows[asked].tolist(), model.pair_action[asked].tolist(), strict=True)
    complete = {*offered} <= {*each}
    if all(map(space.lookup.can_find, entries)):
        if not complete:
            return {}  # {state: action}
        if {*rows[asked].tolist()} <= {*map(number, entries)}:
            raise ModelError(
                "the keys may be states, or pairs of a state and an action: "
                f"{', '.join(map(str, [*entries][:4]))}",
                fix="give {state: {action: number}}, or the names of actions: {state: action}",
            )
    table: dict[Any, dict[str, Any]] = {}
    for (state, action), value in once_each(
        zip(each, entries.values(), strict=True), lambda pair: space.label(pair[0])
    ).items():
        table.setdefault(space.label(state), {})[model.actions[action]] = value
    if complete:
        return {s: [row.get(name, 0) for name in model.actions] for s, row in table.items()}
    return table


def _keep_reachable(space: StateSpace, entries: Mapping[Any, Any]) -> Mapping[Any, Any]:
    """Return the entries of states; warn of those that a function's model did not reach."""
    made = len(space.columns) == 1 and space.columns[0].objects
    others = [key for key in entries if isinstance(key, tuple) and not space.lookup.can_find(key)]
    if not made or not others or len(others) == len(entries):
        return entries
    shown = ", ".join(map(str, others[:4])) + " …" * (len(others) > 4)
    warnings.warn(
        f"{len(others)} of {len(entries)} rows are not read, as their states are not in the model, "
        f"which has those that can be reached from its start: {shown}",
        stacklevel=2,
    )
    return {key: choice for key, choice in entries.items() if key not in {*others}}


def of_function(model: MDP, ask: Callable[[Any], Any], kind: str = "auto") -> Parts:
    """Return what a function answers for each state with a choice.

    It is given the object that the state is, where the model was made of such; else its name; else
    its number.
    """
    space = model.space.untimed or model.space
    column = space.columns[0] if len(space.columns) == 1 else None
    choices = {}
    for state in np.unique(rows_read(model, space)[model.asked]).tolist():
        choices[state] = ask(column.thing(state) if column and state < column.size else state)
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
    """Return whether an answer is a pair of an action and what an agent remembers, or None."""
    pair = (
        isinstance(choice, tuple) and len(choice) == 2 and not model.action_names.has_name(choice)
    )
    return pair and (choice[1] is None or (np.ndim(choice[0]) == 0) != (np.ndim(choice[1]) == 0))


def _of_choices(model: MDP, space: StateSpace, choices: Mapping[int, Any], kind: str) -> Parts:
    """Return the policy of the choice of each state, by number."""
    choices = {key: convert_tensors(choice) for key, choice in choices.items()}
    for choice in choices.values():
        refuse_masked(choice, "policy")
    if kind == "q":
        choices = {
            key: _read_action_values(model, space, key, choice)
            if isinstance(choice, Mapping)
            else choice
            for key, choice in choices.items()
        }
    if choices and all(_is_row(model, choice, kind) for choice in choices.values()):
        table = np.full((space.size, model.n_actions), np.nan, dtype=object)
        for key, row in choices.items():
            if len(row) != model.n_actions:
                raise ShapeError(
                    f"a row of {len(row)} numbers",
                    where=f"policy, {space.label(key)}",
                    fix=f"give one for each of the {model.n_actions} actions"
                    + "; the action itself is the first entry of the row: [0]" * (len(row) == 1),
                )
            table[key] = [exact(x) if isinstance(x, str) else x for x in row]
        _check_complete(model, space, choices)
        return policy_of_array(model, numbers_of(table), kind)
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


def _read_action_values(
    model: MDP, space: StateSpace, key: int, choice: Mapping[Any, Any]
) -> list[Any]:
    """Return the row of action values that {action: value} is; NaN for actions not offered."""
    names = model.action_names
    with locate_errors(space.label(key)):
        values = once_each(
            zip(names.find_numbers(choice), choice.values(), strict=True), names.label
        )
        states = np.flatnonzero((rows_read(model, space) == key) & model.asked)
        offered = np.unique(model.pair_action[np.isin(model.pair_state, states)])
        if lost := [model.actions[action] for action in offered.tolist() if action not in values]:
            raise ModelError(
                f"there is no value of {', '.join(lost)}",
                fix="give one for every action that is offered; -inf for one never to be taken",
            )
    return [values.get(action, np.nan) for action in range(model.n_actions)]


def _unwrap_action(choice: Any) -> Any:
    """Return an action, of an array without dimensions the number in it."""
    choice = choice.item() if isinstance(choice, np.ndarray) and not choice.ndim else choice
    return tuple(choice) if isinstance(choice, list | np.ndarray) else choice


def _parse_probability(value: object) -> Fraction:
    number = exact(value)
    if number and not as_float(number):
        raise too_small("")
    return number


def _is_row(model: MDP, choice: Any, kind: str) -> bool:
    """Return whether a choice is a row of numbers: a list, or a tuple that is no action."""
    if not isinstance(choice, list | tuple | np.ndarray) or not np.ndim(choice):
        return False
    row = tuple(choice.tolist() if isinstance(choice, np.ndarray) else choice)
    # (0.0, 1.0) equals (0, 1), the action that "(0, 1)" is the text of.
    whole = tuple(int(x) if is_number(x) and integer_of(x) is not None else x for x in row)
    action, equal = map(model.action_names.has_name, (row, whole))
    if isinstance(choice, tuple) and action:
        return False
    if kind == "auto" and (action or equal):
        raise ModelError(
            f"{choice} may be the action of that name, or a row of numbers for all actions, "
            "which differ",
            fix="give the action by its name, as text, or rows as one array with kind=",
        )
    return True


def _of_chances(model: MDP, space: StateSpace, chances: Chances) -> Parts:
    """Return the policy; raises ModelError where a combination that a choice reads is missing."""
    _check_complete(model, space, chances)
    floats = all(float(chance) == chance for row in chances.values() for chance in row.values())
    table: Numbers = np.full(
        (space.size, model.n_actions), np.nan, dtype=np.float64 if floats else object
    )
    for key, row in chances.items():
        table[key] = 0
        for action, chance in row.items():
            table[key, action] = chance
    return {"space": space, "actions": model.actions, "rule": table}


def _check_complete(model: MDP, space: StateSpace, said: Iterable[int]) -> None:
    """Raise ModelError where nothing is said of a row that a state with a choice reads."""
    keys = rows_read(model, space)
    silent = np.ones(space.size, dtype=bool)
    silent[list(said)] = False
    missing = silent[keys] & model.asked
    if missing.any():
        lost = sorted(set(keys[missing].tolist()))
        shown = "; ".join(space.labels(lost[:4])) + (" …" if len(lost) > 4 else "")
        raise ModelError(
            f"{len(lost)} of {space.size} rows are missing: {shown}", fix="add one for each"
        )


# ---- files ---------------------------------------------------------------------------------------


def of_file(model: MDP, path: str | Path, kind: str = "auto") -> Parts:
    """Return what a `.json` or `.csv` file says, or JSON in standard input; see `Policy.of`."""
    where, suffix = str(path), Path(path).suffix.lower()
    if suffix == ".csv":
        return _of_csv(model, read_text(path))
    if suffix != ".json" and where != STANDARD_INPUT:
        raise ModelError(
            f"cannot read {suffix}" if suffix and isfile(path) else f"unknown policy {where!r}",
            fix=f"did you mean always:{where}?"
            if where in model.actions
            else "give random, always:ACTION, or a .json, .csv, .npy or .npz file; the optimal "
            "policy is solve(mdp).policy, on the command line optimal",
        )
    content = json_of(read_text(path), where, parse_float=str, parse_int=_parse_digits)
    by_status = "status" in model.space.names
    if not isinstance(content, dict):
        first = "0000" if by_status else "0"
        example = json.dumps({first: model.actions[0]}, ensure_ascii=False)
        raise ModelError("the file is not a JSON object", fix=f"write {example[:-1]}, …}}")
    if not by_status:
        content = {_parse_digits(key): choice for key, choice in content.items()}
    return of_mapping(model, content, kind)


def _parse_digits(text: str) -> Any:
    """Return the number that the digits of a file are, other text as it is."""
    return int(text) if WHOLE.fullmatch(text) else text


def _of_csv(model: MDP, text: str) -> Parts:
    rows = csv_of(io.StringIO(text))
    _, given = next(rows, (0, []))
    header = [name.strip() for name in given]
    columns = [name for name in header if name not in ("action", "probability")]
    by_state = columns == ["state"] and "state" not in model.space.names
    known = [*(columns if by_state else model.space.names), "action", "probability"]
    wrong = [name for name in header if name not in known]
    if wrong or "action" not in header or not columns or len(set(header)) != len(header):
        raise ModelError(
            f"unknown column {wrong[0]!r}" if wrong else f"the header is {','.join(header)!r}",
            fix=f"write {','.join([*model.space.names, 'action'])}, or some of these columns; "
            'numbers alone are a Q-table: np.save("q_table.npy", q_table)',
        )
    space = model.space.untimed or model.space
    if not by_state:
        space = StateSpace(columns=tuple(model.space.column(name) for name in columns))
    by_name = by_state or (len(columns) == 1 and bool(space.columns[0].words))
    chances: Chances = {}
    for number, row in rows:
        with locate_errors(f"line {number}"):
            entry = dict(zip(header, row, strict=True))
            if by_name:
                key = space.number(_parse_digits(entry[columns[0]]))
            else:
                key = space.index(**{c.name: c.number(entry[c.name]) for c in space.columns})
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
    """Return a name for each state."""
    if len(space.columns) == 1:
        column = space.columns[0]
        return [*(column.label(value) for value in range(column.size)), *space.extra]
    return space.labels(range(space.size))


def of_every_state(mdp: MDP, said: Sequence[Any]) -> dict[str, Any]:
    """Return what is said of every state: by status where that alone decides, else by state.

    Both are policies that a file may hold.
    """
    if "status" in mdp.space.names:
        column = mdp.space.column("status")
        status = mdp.space.values("status")
        asked = np.flatnonzero(mdp.asked & (status >= 0)).tolist()
        each = [(column.label(int(status[state])), said[state]) for state in asked]
        by_label = {
            column.label(value): said[mdp.space.index(status=value)] for value in range(column.size)
        }
        by_label |= dict(each)
        if all(by_label[label] == one for label, one in each):
            return by_label
    return dict(zip(state_names(mdp.space), said, strict=True))


def write_policy(
    path: str | Path, space: StateSpace, rows: Mapping[int, Mapping[str, Any]]
) -> None:
    """Write the probabilities of the actions of each row as `.csv`."""
    if Path(require_type(path, str | Path, "path", "give a text")).suffix.lower() != ".csv":
        raise ModelError("a policy is written as .csv", where=str(path), fix="name it .csv")
    if not space.names:
        raise ModelError(
            "the policy reads no column of the state",
            where=str(path),
            fix="name it as always:ACTION instead",
        )
    labels = {key: [*space.as_dict(key).values()] for key in rows}
    if len(space.names) == 1 and space.columns[0].words:
        read = [space.lookup.can_find(_parse_digits(words[0])) for words in labels.values()]
        if not all(read):  # a name that may be the number of another state
            labels = {key: [space.label(key)] for key in rows}
    mixed = any(len(taken) > 1 for taken in rows.values())
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*space.names, "action", *["probability"] * mixed])
    for key, taken in rows.items():
        for action, chance in taken.items():
            writer.writerow([*labels[key], action, *[str(chance)] * mixed])
    write_atomically(path, out.getvalue())
