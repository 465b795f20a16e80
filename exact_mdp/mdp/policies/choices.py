"""Policies state by state: what a mapping, a function or a file says.

Each state has a choice: an action, {action: probability}, or a row of A numbers, which are
probabilities or action values. `mdp.forms.names` says which state or action is meant; a list or an
array is a row, and so is a tuple that is no action. In a file all is text: there the digits of a
state are a number.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, located, of_type, once_each
from exact_mdp.mdp.forms.names import is_number, whole_of
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.io.files import STANDARD_INPUT, read_text, write_atomically
from exact_mdp.mdp.io.structured import csv_of, json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import Parts, numbers_of, policy_of_array, rows_read, too_small
from exact_mdp.mdp.space import TIME, StateSpace
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
        keys = [space.columns[0].number(str(label)) for label in entries]
    else:
        timed = any(PRINTED_TIME.match(str(key)) for key in entries)
        space = model.space if timed else model.space.untimed or model.space
        keys = space.numbers(entries)
    choices = once_each(zip(keys, entries.values(), strict=True), space.label)
    if default is not None:
        choices = {key: choices[key] if key in choices else default() for key in range(space.size)}
    return _of_choices(model, space, choices, kind)


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
    return _of_choices(model, space, choices, kind)


def _of_choices(model: MDP, space: StateSpace, choices: Mapping[int, Any], kind: str) -> Parts:
    """Return the policy of the choice of each state, by number."""
    for choice in choices.values():
        refuse_masked(choice, "policy")
    if choices and all(_is_row(model, choice, kind) for choice in choices.values()):
        table = np.full((space.size, model.n_actions), np.nan, dtype=object)
        for key, row in choices.items():
            if len(row) != model.n_actions:
                raise ShapeError(
                    f"a row of {len(row)} numbers",
                    where=f"policy, {space.label(key)}",
                    fix=f"give one for each of the {model.n_actions} actions",
                )
            table[key] = [exact(x) if isinstance(x, str) else x for x in row]
        return policy_of_array(model, numbers_of(table), kind)
    chances, names = Chances(), model.action_names
    for key, choice in choices.items():
        with located(space.label(key)):
            if isinstance(choice, Mapping):
                each = zip(names.numbers(choice), map(_probability, choice.values()), strict=True)
                chances[key] = once_each(each, names.label)
            else:
                chances[key] = {names.number(_alone(choice)): Fraction(1)}
    return _of_chances(model, space, chances)


def _alone(choice: Any) -> Any:
    """Return an action, of an array without dimensions the number in it."""
    choice = choice.item() if isinstance(choice, np.ndarray) and not choice.ndim else choice
    return tuple(choice) if isinstance(choice, list | np.ndarray) else choice


def _probability(value: object) -> Fraction:
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
    whole = tuple(int(x) if is_number(x) and whole_of(x) is not None else x for x in row)
    action, equal = map(model.action_names.knows, (row, whole))
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
    keys = rows_read(model, space)
    silent = np.ones(space.size, dtype=bool)
    silent[list(chances)] = False
    missing = silent[keys] & model.asked
    if missing.any():
        lost = sorted(set(keys[missing].tolist()))
        shown = "; ".join(space.labels(lost[:4])) + (" …" if len(lost) > 4 else "")
        raise ModelError(
            f"{len(lost)} of {space.size} rows are missing: {shown}", fix="add an action for each"
        )
    floats = all(float(chance) == chance for row in chances.values() for chance in row.values())
    table: Numbers = np.full(
        (space.size, model.n_actions), np.nan, dtype=np.float64 if floats else object
    )
    for key, row in chances.items():
        table[key] = 0
        for action, chance in row.items():
            table[key, action] = chance
    return {"space": space, "actions": model.actions, "rule": table}


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
    content = json_of(read_text(path), where, parse_float=str, parse_int=_digits)
    by_status = "status" in model.space.names
    if not isinstance(content, dict):
        first = "0000" if by_status else "0"
        example = json.dumps({first: model.actions[0]}, ensure_ascii=False)
        raise ModelError("the file is not a JSON object", fix=f"write {example[:-1]}, …}}")
    if not by_status:
        content = {_digits(key): choice for key, choice in content.items()}
    return of_mapping(model, content, kind)


def _digits(text: str) -> Any:
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
        with located(f"line {number}"):
            entry = dict(zip(header, row, strict=True))
            if by_name:
                key = space.number(_digits(entry[columns[0]]))
            else:
                key = space.index(**{c.name: c.number(entry[c.name]) for c in space.columns})
            action = model.action_names.number(entry["action"])
            taken = chances.setdefault(key, {})
            if action in taken or (taken and "probability" not in header):
                raise ModelError(
                    f"{space.label(key)} appears twice",
                    fix="keep one of them, or add a column probability",
                )
            taken[action] = _probability(entry.get("probability", "1").strip())
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


def write(path: str | Path, space: StateSpace, rows: Mapping[int, Mapping[str, Any]]) -> None:
    """Write the probabilities of the actions of each row as `.csv`."""
    if Path(of_type(path, str | Path, "path", "give a text")).suffix.lower() != ".csv":
        raise ModelError("a policy is written as .csv", where=str(path), fix="name it .csv")
    if not space.names:
        raise ModelError(
            "the policy reads no column of the state",
            where=str(path),
            fix="name it as always:ACTION instead",
        )
    labels = {key: [*space.as_dict(key).values()] for key in rows}
    if len(space.names) == 1 and space.columns[0].words:
        read = [space.lookup.holds(_digits(words[0])) for words in labels.values()]
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
