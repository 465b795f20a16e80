"""Policies state by state: what a mapping, a function, a list of names or a file says.

Each state has a choice: an action, {action: probability}, or a row of A numbers, which are
probabilities or action values. `mdp.forms.names` says which state or action is meant. In a file all
is text: there the digits of a state are a number.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from os.path import isdir, isfile
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, located, of_type, once_each, suggest
from exact_mdp.mdp.forms.names import is_number, whole_of
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.io.files import STANDARD_INPUT, read_text, write_atomically
from exact_mdp.mdp.io.structured import csv_of, json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import Parts, numbers_of, policy_of_array, rows_read, too_small
from exact_mdp.mdp.space import TIME, StateSpace
from exact_mdp.mdp.table import Numbers, as_float, exact

PRINTED_TIME = re.compile(rf"{TIME} \d+, ")  # as printed; "time out" may be a name
NUMBERS = re.compile(r"[-+\d.eE\s;]*\d[-+\d.eE\s;]*")  # as np.savetxt writes them
SAVE = 'np.save("q_table.npy", q_table)'
Chances = dict[int, dict[int, Fraction]]
"""Probabilities of actions by the number of a combination of column values."""


def of_mapping(model: MDP, entries: Mapping[Any, Any], kind: str = "auto") -> Parts:
    """Return what is said of statuses, {status: action}, of states, or of pairs."""
    default = getattr(entries, "default_factory", None)  # of a defaultdict, which is not changed
    if _are_pairs(model, entries):
        return _of_pairs(model, entries, kind, default)
    if "status" in model.space.names and not any("status " in str(key) for key in entries):
        space = StateSpace(columns=(model.space.column("status"),))
        keys = [space.columns[0].parse(str(label)) for label in entries]
    else:
        timed = any(PRINTED_TIME.match(str(key)) for key in entries)
        space = model.space if timed else model.space.untimed or model.space
        keys = space.numbers(entries)
    choices = once_each(zip(keys, entries.values(), strict=True), space.label)
    if default is not None:
        choices = {key: choices[key] if key in choices else default() for key in range(space.size)}
    return of_choices(model, space, choices, kind)


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
    return of_choices(model, space, choices, kind)


def of_list(model: MDP, names: Sequence[Any]) -> Parts:
    """Return what a list of actions says, one for each state by number."""
    space = model.space.untimed or model.space
    if len(names) > space.size:
        raise ShapeError(
            f"{len(names)} actions for {space.size} states", fix="give one for each state"
        )
    return of_choices(model, space, dict(enumerate(names)), "auto")


def of_choices(model: MDP, space: StateSpace, choices: Mapping[int, Any], kind: str) -> Parts:
    """Return the policy of the choice of each state, by number."""
    plain, names = dict[int, Any](), model.action_names
    for key, choice in choices.items():
        refuse_masked(choice, "policy")
        if isinstance(choice, np.ndarray) and (not choice.ndim or len(choice) != model.n_actions):
            choice = choice.tolist()
        wide = isinstance(choice, list) and len(choice) != model.n_actions  # it is no row
        plain[key] = tuple(choice) if wide else choice
    if plain and all(_is_row(model, choice, kind) for choice in plain.values()):
        return _of_rows(model, space, plain, kind)
    chances: Chances = {}
    for key, choice in plain.items():
        with located(space.label(key)):
            mixed = isinstance(choice, Mapping)
            numbers = names.numbers(choice if mixed else [choice])
            each = zip(numbers, map(_probability, choice.values() if mixed else [1]), strict=True)
            chances[key] = once_each(each, names.label)
    return _of_chances(model, space, chances)


def _probability(value: object) -> Fraction:
    number = exact(value)
    if number and not as_float(number):
        raise too_small("")
    return number


def _is_row(model: MDP, choice: Any, kind: str) -> bool:
    """Return whether a choice is a row of numbers: a list, or a tuple that is no action."""
    if not isinstance(choice, list | tuple | np.ndarray):
        return False
    plain = choice.tolist() if isinstance(choice, np.ndarray) else choice
    named = model.action_names.knows(tuple(plain))
    action = named and isinstance(choice, tuple)
    # (0.0, 1.0) equals (0, 1), the action that "(0, 1)" is the text of.
    equal = (
        tuple(of(x) if is_number(x) and whole_of(x) == x else x for x in plain)
        for of in (int, float)
    )
    if kind == "auto" and not action and (named or any(map(model.action_names.knows, equal))):
        raise ModelError(
            f"{choice} may be the action of that name, or a row of numbers for all actions, "
            "which differ",
            fix="give the action by its name, as text, or rows as one array with kind=",
        )
    return not action


def _of_rows(model: MDP, space: StateSpace, rows: Mapping[int, Any], kind: str) -> Parts:
    """Return the policy of a row of A numbers for each state; others than asked are left open."""
    table = np.full((space.size, model.n_actions), np.nan, dtype=object)
    for key, row in rows.items():
        if len(row) != model.n_actions:
            raise ShapeError(
                f"a row of {len(row)} numbers",
                where=f"policy, {space.label(key)}",
                fix=f"give one for each of the {model.n_actions} actions",
            )
        table[key] = [exact(x) if isinstance(x, str) else x for x in row]
    return policy_of_array(model, numbers_of(table), kind)


def _are_pairs(model: MDP, entries: Mapping[Any, Any]) -> bool:
    """Return whether a mapping is {(state, action): number}; ModelError where it may be of states.

    There, {state: action} has states that are pairs themselves, and actions that are numbers.
    """
    if not entries or not all(
        isinstance(key, tuple) and len(key) == 2 and is_number(value)
        for key, value in entries.items()
    ):
        return False
    space = model.space.untimed or model.space
    if not all(map(space.lookup.holds, entries)):
        return True
    pairs = all(space.lookup.holds(s) and model.action_names.holds(a) for s, a in entries)
    if pairs and len({s for s, _ in entries}) >= np.count_nonzero(model.asked):
        raise ModelError(
            "the keys may be states, or a state and an action each, which differ",
            fix="give an array (S, A), or {state: a row of A numbers}; or the states as text",
        )
    return False


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
    table[states, actions] = list(entries.values())
    return policy_of_array(model, numbers_of(table), kind)


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
        fix = (
            "give random, always:ACTION, or a .json, .csv, .npy or .npz file; the optimal policy "
            "is solve(mdp).policy, on the command line optimal"
        )
        what = f"unknown kind of policy {where!r}"
        if where in model.actions:
            fix = f"did you mean always:{where}?"
        elif isdir(path):
            what = f"{where!r} is a folder"
        elif suffix and isfile(path):
            what, fix = f"cannot read {suffix}", f"load it yourself, then {SAVE}"
        raise ModelError(what, fix=fix)
    content = json_of(read_text(path), where, parse_float=str, parse_int=_digits)
    by_status = "status" in model.space.names
    if not isinstance(content, dict):
        column = model.space.columns[0] if len(model.space.columns) == 1 else None
        first = "0000" if by_status else column.label(0) if column else "0"
        example = json.dumps({first: model.actions[0]}, ensure_ascii=False)
        raise ModelError("the file is not a JSON object", fix=f"write {example[:-1]}, …}}")
    if not by_status:
        content = {_digits(key): choice for key, choice in content.items()}
    return of_mapping(model, content, kind)


def _digits(text: str) -> Any:
    """Return the number that the digits of a file are, other text as it is."""
    number = whole_of(text.removeprefix("-"))
    return int(text) if number is not None and text.strip() in (str(number), f"-{number}") else text


def _of_csv(model: MDP, text: str) -> Parts:
    rows = csv_of(io.StringIO(text))
    _, given = next(rows, (0, []))
    header = [name.strip() for name in given]
    columns = [name for name in header if name not in ("action", "probability")]
    by_state = columns == ["state"] and "state" not in model.space.names
    known = [*(columns if by_state else model.space.names), "action", "probability"]
    if header and all(NUMBERS.fullmatch(name) for name in header):
        what = "the file holds numbers alone, with no header"
        raise ModelError(what, fix=f"give a Q-table as .npy: {SAVE}")
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
    by_name = by_state or (len(columns) == 1 and bool(space.columns[0].words))
    chances: Chances = {}
    for number, row in rows:
        with located(f"line {number}"):
            entry = dict(zip(header, row, strict=True))
            if by_name:
                key = space.number(_digits(entry[columns[0]]))
            else:
                key = space.index(**{c.name: c.parse(entry[c.name]) for c in space.columns})
            word = entry["action"] if entry["action"] in model.actions else entry["action"].strip()
            action = model.action_names.number(word)
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
    names = space.names
    if not names or (suffix == ".json" and len(names) > 1):
        raise ModelError(
            f"the policy reads {', '.join(names) or 'no column of the state'}",
            where=suffix[1:].upper(),
            fix="write it as .csv" if names else "name it as always:ACTION instead",
        )
    labels = {key: [*space.as_dict(key).values()] for key in rows}
    column = space.columns[0]
    if len(names) == 1 and column.words:
        read = [space.lookup.holds(_digits(words[0])) for words in labels.values()]
        if not all(read):  # a name that may be the number of another state
            labels = {key: [space.label(key)] for key in rows}
    if suffix == ".csv":
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([*names, "action", *(["probability"] if mixed else [])])
        for key, taken in rows.items():
            for action, chance in taken.items():
                writer.writerow([*labels[key], action, *([str(chance)] if mixed else [])])
        write_atomically(path, out.getvalue())
    else:
        entries = {
            labels[key][0]: next(iter(taken)) if len(taken) == 1 else taken
            for key, taken in rows.items()
        }
        write_atomically(path, json.dumps(entries, indent=2) + "\n")
