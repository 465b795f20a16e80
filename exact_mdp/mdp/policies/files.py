"""Policies as files and mappings: JSON and CSV by column labels; NumPy arrays, see `.arrays`."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, located, of_type, suggest
from exact_mdp.mdp.forms.names import Reading, amount_of
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.io.files import STANDARD_INPUT, read_text, write_atomically
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import (
    Parts,
    check_action,
    numbers_of,
    policy_of_array,
    rows_read,
    too_small,
)
from exact_mdp.mdp.space import TIME, WHOLE, StateSpace
from exact_mdp.mdp.table import Numbers, as_float, exact

PRINTED_TIME = re.compile(rf"{TIME} \d+, ")  # as printed; "time out" may be a name
Rows = dict[int, dict[int, Fraction]]
"""Probabilities of actions by the number of a combination of column values."""


PAIRS_OR_STATES = ModelError(
    "the keys may be states, or a state and an action each, which differ",
    fix="give an array (S, A), or {state: a row of A numbers}; or the states as text",
)


class Form(NamedTuple):
    """A reading of what is said, and the error to raise where it fits as well and differs."""

    parts: Callable[[], Parts]
    error: ModelError | None = None


def read(path: str | Path, model: MDP, kind: str = "auto") -> list[Form]:
    """Return what a `.json` or `.csv` file says, or JSON in standard input; see `Policy.of`."""
    where, suffix = str(path), Path(path).suffix.lower()
    if suffix == ".json" or where == STANDARD_INPUT:
        content = json_of(
            read_text(path), where, object_pairs_hook=_once, parse_float=str, parse_int=_digits
        )
        if not isinstance(content, dict):
            column = model.space.columns[0] if model.space.columns else None
            first = column.label(0) if column and len(model.space.columns) == 1 else "0"
            first = "0000" if "status" in model.space.names else first
            example = json.dumps({first: model.actions[0]}, ensure_ascii=False)
            raise ModelError("the file is not a JSON object", fix=f"write {example[:-1]}, …}}")
        if "status" not in model.space.names:
            content = {_digits(key): choice for key, choice in content.items()}
        return from_mapping(model, content, kind)
    if suffix == ".csv":
        return _from_csv(read_text(path), model)
    raise ModelError(
        f"unknown kind of policy {where!r}",
        fix="give random, always:ACTION, or a .json, .csv, .npy or .npz file; the optimal policy "
        "is solve(mdp).policy, on the command line optimal",
    )


def _are_pairs(entries: Mapping[Any, Any]) -> bool:
    """Return whether a mapping may be {(state, action): number}."""
    numbers = (int, float, Fraction, np.number)
    return bool(entries) and all(
        isinstance(key, tuple) and len(key) == 2 and isinstance(value, numbers)
        for key, value in entries.items()
    )


def _of_pairs(
    model: MDP, entries: Mapping[Any, Any], kind: str, default: Callable[[], Any] | None
) -> Parts:
    """Return what {(state, action): number} says: of all actions, unless there is a default."""
    space = model.space.untimed or model.space
    table: Numbers = np.zeros((space.size, model.n_actions), dtype=object)
    offered = rows_read(model, space)[model.pair_state], model.pair_action
    table[offered] = np.nan if default is None else default()
    states = space.numbers([state for state, _ in entries])
    actions = model.action_names.numbers([action for _, action in entries])
    for state, action, value in zip(states, actions, entries.values(), strict=True):
        table[state, action] = value
    return policy_of_array(model, numbers_of(table), kind)


def _once(items: list[tuple[str, Any]]) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for key, value in items:
        if key in entries:
            raise ModelError(f"{key} appears twice", fix="keep one of them")
        entries[key] = value
    return entries


def _digits(text: str) -> Any:
    """Return the number that the digits of a file are, other text as it is."""
    return int(text) if WHOLE.fullmatch(text.strip()) else text


def from_mapping(model: MDP, entries: Mapping[Any, Any], kind: str = "auto") -> list[Form]:
    """Return what a mapping says: of statuses, {status: action}, or of states by name or in print.

    Instead of an action there may be {action: probability}; of a state also a row of A
    probabilities or action values, for all of them; or {(state, action): number} in all.
    """
    if _are_pairs(entries):
        default = getattr(entries, "default_factory", None)  # of a defaultdict
        alone = Form(lambda: _of_pairs(model, entries, kind, default))
        if kind == "q":
            return [alone]
        try:
            forms = from_states(model, entries, kind)
            forms[0].parts()
        except ModelError:  # the keys are no states, or not all of them
            return [alone]
        return [*forms, Form(lambda: _of_pairs(model, entries, kind, None), PAIRS_OR_STATES)]
    if "status" not in model.space.names or any("status " in str(key) for key in entries):
        return from_states(model, entries, kind)
    space = StateSpace(columns=(model.space.column("status"),))
    rows: Rows = {}
    for label, choice in entries.items():
        key = space.columns[0].parse(str(label))
        if key in rows:
            raise ModelError(f"status {label} appears twice", fix="keep one of them")
        mixed = choice if isinstance(choice, Mapping) else {str(choice): 1}
        with located(f"status {label}"):
            rows[key] = _shares(
                mixed, (check_action(str(word), model.actions, "") for word in mixed)
            )
    return [Form(lambda: _complete(model, space, rows))]


def from_function(model: MDP, ask: Callable[[Any], Any], kind: str = "auto") -> list[Form]:
    """Return what a function answers: as `from_mapping`, asked of each state with a choice.

    It is given the object that the state is, where the model was made of such; else the name, a
    whole number as an int; the number of a state that has no name. Where names are the numbers of
    other states, it may have been meant of these.
    """
    space = model.space.untimed or model.space
    read = rows_read(model, space)[model.asked]
    column = space.columns[0] if len(space.columns) == 1 else None
    states = np.unique(read).tolist()
    things = dict(zip(states, states, strict=True))
    if column:
        things |= {state: column.thing(state) for state in states if state < column.size}
    forms = from_numbers(model, _answers(space, ask, things), kind)
    if column and {column.thing(value) for value in range(column.size)} == {*range(column.size)}:
        error = space.readings(things.values())[-1].error
        try:
            others = _answers(space, ask, dict(zip(states, states, strict=True))) if error else {}
        except Exception:  # the function knows no such states
            others = {}
        forms += from_numbers(model, others, kind, error) if others else []
    return forms


def _answers(space: StateSpace, ask: Callable[[Any], Any], things: Mapping[int, Any]) -> Any:
    """Return what a function says of states, by their numbers."""
    found = {state: ask(thing) for state, thing in things.items()}
    for state, answer in found.items():
        if answer is None:
            raise ModelError(
                "the function returns None",
                where=f"policy, {space.label(state)}",
                fix="return an action, {action: probability}, or a row of A numbers",
            )
    return found


def from_list(model: MDP, names: Sequence[str], kind: str) -> list[Form]:
    """Return what a list of action names says, one for each state by number."""
    space = model.space.untimed or model.space
    if len(names) > space.size:
        raise ShapeError(
            f"{len(names)} actions for {space.size} states", fix="give one for each state"
        )
    return from_numbers(model, dict(enumerate(names)), kind)


def from_states(model: MDP, entries: Mapping[Any, Any], kind: str) -> list[Form]:
    """Return what is said of states: by number, name, column values, or the object itself."""
    timed = any(PRINTED_TIME.match(str(key)) for key in entries)
    space = model.space if timed else model.space.untimed or model.space
    default = getattr(entries, "default_factory", None)  # of a defaultdict, which is not changed
    forms: list[Form] = []
    for reading in space.readings(entries):
        given: dict[int, Any] = {}
        for key, choice in zip(reading.numbers, entries.values(), strict=True):
            if key in given:
                raise ModelError(f"{space.label(key)} appears twice", fix="keep one of them")
            given[key] = choice
        if default is not None:
            given = {key: given[key] if key in given else default() for key in range(space.size)}
        forms += from_numbers(model, given, kind, reading.error, space)
    return forms


def from_numbers(
    model: MDP,
    given: Mapping[int, Any],
    kind: str,
    error: ModelError | None = None,
    space: StateSpace | None = None,
) -> list[Form]:
    """Return what is said of states by number, by default those without their time."""
    space = space or model.space.untimed or model.space
    given = {key: _unwrapped(choice) for key, choice in given.items()}
    rows = given
    as_rows = Form(lambda: _of_rows(model, space, rows, kind), error)
    forms: list[Form] = []
    if given and all(isinstance(row, list | tuple | np.ndarray) for row in given.values()):
        named = {key: _as_action(model, row) for key, row in given.items()}
        objects = bool(model.action_objects)
        doubtful = [
            row
            for key, row in rows.items()
            if not (objects and isinstance(row, tuple) and named[key])
        ]
        fits = all(len(row) == model.n_actions for row in rows.values())
        if len(doubtful) == len(rows) and (None in named.values() or (fits and kind != "auto")):
            return [as_rows]
        if doubtful and fits:
            for each in ("policy", "q"):
                as_one = partial(_of_rows, model, space, rows, each)
                forms.append(Form(as_one, _two_meanings(doubtful[0])))
        given = {key: named[key] or row for key, row in rows.items()}
    choices = list(given.values())
    if kind == "q" and any(isinstance(choice, Mapping) for choice in choices):
        raise ModelError(
            "a dictionary of actions holds probabilities, not action values",
            fix="give each state a row of A numbers",
        )
    mixed = {
        key: choice if isinstance(choice, Mapping) else {_key(space, key, choice): 1}
        for key, choice in given.items()
    }
    for key, row in mixed.items():  # an error of one names its state
        with located(space.label(key)):
            model.action_names.readings(row)
    words = [word for row in mixed.values() for word in row]
    readings = model.action_names.readings(words)

    def parts(numbers: list[int]) -> Parts:
        meant, rows = iter(numbers), {}
        for key, row in mixed.items():
            with located(space.label(key)):
                rows[key] = _shares(row, meant)
        return _complete(model, space, rows)

    by_name = [
        Form(partial(parts, reading.numbers), error or reading.error) for reading in readings
    ]
    return by_name + forms


def _as_action(model: MDP, row: Any) -> tuple[Any, ...] | None:
    """Return a row as the tuple that is an action, or equals one; None where it is none."""
    parts = tuple(row.tolist() if isinstance(row, np.ndarray) else row)
    amounts = [amount_of(part) for part in parts]
    forms = [parts]
    for kind in (int, float):
        if all(x is None or kind is float or x.denominator == 1 for x in amounts):
            pairs = zip(parts, amounts, strict=True)
            forms.append(tuple(part if x is None else kind(x) for part, x in pairs))
    return next((each for each in forms if model.action_names.knows(each)), None)


def _key(space: StateSpace, state: int, choice: Any) -> Any:
    """Return an action as a key; raises ModelError where it cannot be one."""
    try:
        hash(choice)
    except TypeError as error:
        raise ModelError(
            f"{choice!r} is not an action",
            where=space.label(state),
            fix="give an action, {action: probability}, or for all states a row of A numbers",
        ) from error
    return choice


def _two_meanings(row: Any) -> ModelError:
    return ModelError(
        f"{row} may be the action of that name, or a row of numbers for all actions, which differ",
        fix="give the action by its name, as text, or rows as one array with kind=",
    )


def _shares(mixed: Mapping[Any, Any], numbers: Iterator[int]) -> dict[int, Fraction]:
    """Return {action: probability} by the numbers of the actions, each of which is named once."""
    shares: dict[int, Fraction] = {}
    for action, chance in mixed.items():
        key = next(numbers)
        if key in shares:
            raise ModelError(f"action {action} appears twice", fix="keep one of them")
        shares[key] = _probability(chance)
    return shares


def _unwrapped(choice: Any) -> Any:
    """Return what an array without dimensions holds."""
    if not isinstance(choice, np.ndarray) or choice.ndim:
        return choice
    refuse_masked(choice, "policy")
    return choice.item()


def _of_rows(model: MDP, space: StateSpace, given: Mapping[int, Any], kind: str) -> Parts:
    """Return the policy of a row of A numbers for each state; others than asked are left open."""
    table = np.full((space.size, model.n_actions), np.nan, dtype=object)
    for key, row in given.items():
        if len(row) != model.n_actions:
            raise ShapeError(
                f"a row of {len(row)} numbers",
                where=f"policy, {space.label(key)}",
                fix=f"give one for each of the {model.n_actions} actions",
            )
        table[key] = [exact(x) if isinstance(x, str) else x for x in row]
    return policy_of_array(model, numbers_of(table), kind)


def _from_csv(text: str, model: MDP) -> list[Form]:
    try:
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise ModelError(f"broken CSV: {error}", fix="correct that line") from error
    header = [name.strip() for name in lines[0]] if lines else []
    columns = [name for name in header if name not in ("action", "probability")]
    by_state = columns == ["state"] and "state" not in model.space.names
    known = [*columns] if by_state else [*model.space.names]
    known += ["action", "probability"]
    for name in header:
        if name not in known:
            fix = "separate the columns by commas" if ";" in name or "\t" in name else ""
            raise ModelError(f"unknown column {name!r}", fix=fix or suggest(name, known))
    if "action" not in header or not columns or len(set(header)) != len(header):
        raise ModelError(
            f"the header is {','.join(header) or 'missing'}",
            fix=f"write {','.join([*model.space.names, 'action'])}, or status,action",
        )
    space = model.space.untimed or model.space
    if not by_state:
        space = StateSpace(columns=tuple(model.space.column(name) for name in columns))
    entries: dict[int, dict[str, str]] = {}
    for number, line in enumerate(lines[1:], start=2):
        with located(f"line {number}"):
            if line and len(line) != len(header):
                raise ModelError(
                    f"{len(line)} values under {len(header)} headings", fix="correct the line"
                )
        if line:
            entries[number] = dict(zip(header, line, strict=True))
    by_name = by_state or (len(space.columns) == 1 and bool(space.columns[0].words))
    if not by_name:
        readings = [Reading([_in_columns(space, *entry) for entry in entries.items()])]
    else:
        states = {number: _digits(entry[columns[0]]) for number, entry in entries.items()}
        for number, state in states.items():  # an error of one names its line
            with located(f"line {number}"):
                space.readings([state])
        readings = space.readings(states.values())

    def parts(keys: list[int]) -> Parts:
        rows: Rows = {}
        for key, (number, entry) in zip(keys, entries.items(), strict=True):
            with located(f"line {number}"):
                _add_line(rows, space, key, model, entry)
        return _complete(model, space, rows)

    return [Form(partial(parts, reading.numbers), reading.error) for reading in readings]


def _in_columns(space: StateSpace, number: int, entry: Mapping[str, str]) -> int:
    """Return the state of a line, by the printed values of columns."""
    with located(f"line {number}"):
        return space.index(**{each.name: each.parse(entry[each.name]) for each in space.columns})


def _add_line(
    rows: Rows, space: StateSpace, key: int, model: MDP, entry: Mapping[str, str]
) -> None:
    """Add one line of a CSV file, its values by heading, to the rows."""
    word = entry["action"] if entry["action"] in model.actions else entry["action"].strip()
    if "status" in space.names:
        action = check_action(word, model.actions, "")
    else:
        action = model.action(word)
    chances = rows.setdefault(key, {})
    if action in chances or (chances and "probability" not in entry):
        raise ModelError(
            f"{space.label(key)} appears twice", fix="keep one of them, or add a column probability"
        )
    chances[action] = _probability(entry.get("probability", "1").strip())


def _probability(value: object) -> Fraction:
    number = exact(value)
    if number and not as_float(number):
        raise too_small("")
    return number


def _complete(model: MDP, space: StateSpace, rows: Rows) -> Parts:
    """Return the policy; raises ModelError where a combination that a choice reads is missing."""
    keys = rows_read(model, space)
    silent = np.ones(space.size, dtype=bool)
    silent[list(rows)] = False
    missing = silent[keys] & model.asked
    if missing.any():
        lost = sorted(set(keys[missing].tolist()))
        shown = "; ".join(space.labels(lost[:4])) + (" …" if len(lost) > 4 else "")
        raise ModelError(
            f"{len(lost)} of {space.size} rows are missing: {shown}", fix="add an action for each"
        )
    floats = all(float(chance) == chance for row in rows.values() for chance in row.values())
    table: Numbers = np.full(
        (space.size, model.n_actions), np.nan, dtype=np.float64 if floats else object
    )
    for key, chances in rows.items():
        table[key] = 0
        for action, chance in chances.items():
            table[key, action] = chance
    return {"space": space, "actions": model.actions, "rule": table}


# ---- writing -------------------------------------------------------------------------------------


def write(
    path: str | Path,
    space: StateSpace,
    rows: Mapping[int, Mapping[str, float | str]],
    *,
    mixed: bool,
) -> None:
    """Write the probabilities of the actions of each row as `.csv` or `.json`, by the ending."""
    suffix = Path(of_type(path, str | Path, "path", "give a text")).suffix.lower()
    if suffix not in (".csv", ".json"):
        raise ModelError(
            f"cannot write a policy as {suffix or 'a file without ending'}",
            where=str(path),
            fix="name it .csv or .json",
        )
    text = _as_csv(space, rows, mixed) if suffix == ".csv" else _as_json(space, rows)
    write_atomically(path, text)


def _as_csv(space: StateSpace, rows: Mapping[int, Mapping[str, float | str]], mixed: bool) -> str:
    if not space.names:
        raise ModelError(
            "the policy reads no column of the state",
            where="CSV",
            fix="name it as always:ACTION instead",
        )
    out, names = io.StringIO(), _printed(space, rows)
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*space.names, "action", *(["probability"] if mixed else [])])
    for key, taken in rows.items():
        labels = [names[key]] if names else list(space.as_dict(key).values())
        for action, chance in taken.items():
            writer.writerow([*labels, action, *([str(chance)] if mixed else [])])
    return out.getvalue()


def _as_json(space: StateSpace, rows: Mapping[int, Mapping[str, float | str]]) -> str:
    if len(space.names) != 1:
        raise ModelError(
            f"the policy reads {', '.join(space.names) or 'no column'}",
            where="JSON",
            fix="write it as .csv",
        )
    names = _printed(space, rows)
    entries = {
        names.get(key, space.columns[0].label(key)): next(iter(taken)) if len(taken) == 1 else taken
        for key, taken in rows.items()
    }
    return json.dumps(entries, indent=2) + "\n"


def _printed(space: StateSpace, rows: Mapping[int, Any]) -> dict[int, str]:
    """Return the printed forms of states whose names are numbers of others, else nothing."""
    if len(space.columns) != 1 or not space.columns[0].words:
        return {}
    column = space.columns[0]
    names = [_digits(column.label(key)) for key in rows if key < column.size]
    return dict(zip(rows, space.labels(rows), strict=True)) if space.readings(names)[1:] else {}
