"""Policies as files and mappings: JSON and CSV by column labels; NumPy arrays, see `.arrays`."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, located, suggest
from exact_mdp.mdp.io.files import read_text, write_atomically
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import Parts, check_action, rows_read, too_small
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Numbers, as_float, exact

Rows = dict[int, dict[int, Fraction]]
"""Probabilities of actions by the number of a combination of column values."""


def read(path: str | Path, model: MDP) -> Parts:
    """Return what a `.json` or `.csv` file says; see `Policy.read`."""
    where, suffix = str(path), Path(path).suffix.lower()
    if suffix == ".json":
        content = json_of(
            read_text(path), where, object_pairs_hook=_once, parse_float=str, parse_int=str
        )
        if not isinstance(content, dict):
            raise ModelError("the file is not a JSON object", fix='write {"0000": "none", …}')
        return from_mapping(model, content)
    if suffix == ".csv":
        return _from_csv(read_text(path), model)
    raise ModelError(
        f"unknown kind of policy {where!r}",
        fix="give optimal, random, always:ACTION, or a .json, .csv, .npy or .npz file",
    )


def _once(items: list[tuple[str, Any]]) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for key, value in items:
        if key in entries:
            raise ModelError(f"{key} appears twice", fix="keep one of them")
        entries[key] = value
    return entries


def from_mapping(model: MDP, entries: Mapping[Any, Any]) -> Parts:
    """Return what a mapping says: {status: action} or {status: {action: probability}}."""
    names = (model.space.untimed or model.space).names
    name = "status" if "status" in names else names[0]
    space = StateSpace(columns=(model.space.column(name),))
    rows: Rows = {}
    for label, choice in entries.items():
        key = space.columns[0].parse(str(label))
        if key in rows:
            raise ModelError(f"{name} {label} appears twice", fix="keep one of them")
        mixed = choice if isinstance(choice, Mapping) else {str(choice): 1}
        with located(f"{name} {label}"):
            rows[key] = {
                check_action(str(action), model.actions, ""): _probability(value)
                for action, value in mixed.items()
            }
    return _complete(model, space, rows)


def _from_csv(text: str, model: MDP) -> Parts:
    try:
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise ModelError(f"broken CSV: {error}", fix="correct that line") from error
    header = [name.strip() for name in lines[0]] if lines else []
    columns = [name for name in header if name not in ("action", "probability")]
    known = [*model.space.names, "action", "probability"]
    for name in header:
        if name not in known:
            raise ModelError(f"unknown column {name!r}", fix=suggest(name, known))
    if "action" not in header or not columns or len(set(header)) != len(header):
        raise ModelError(
            f"the header is {','.join(header) or 'missing'}",
            fix=f"write {','.join([*model.space.names, 'action'])}, or status,action",
        )
    space = StateSpace(columns=tuple(model.space.column(name) for name in columns))
    rows: Rows = {}
    for number, line in enumerate(lines[1:], start=2):
        with located(f"line {number}"):
            if line and len(line) != len(header):
                raise ModelError(
                    f"{len(line)} values under {len(header)} headings", fix="correct the line"
                )
            if line:
                _add_line(rows, space, model, dict(zip(header, line, strict=True)))
    return _complete(model, space, rows)


def _add_line(rows: Rows, space: StateSpace, model: MDP, entry: Mapping[str, str]) -> None:
    """Add one line of a CSV file, its values by heading, to the rows."""
    values = {column.name: column.parse(entry[column.name]) for column in space.columns}
    word = entry["action"] if entry["action"] in model.actions else entry["action"].strip()
    action, key = check_action(word, model.actions, ""), space.index(**values)
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
    missing = silent[keys] & ~model.forced & ~model.terminal
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
    suffix = Path(path).suffix.lower()
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
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*space.names, "action", *(["probability"] if mixed else [])])
    for key, taken in rows.items():
        labels = list(space.as_dict(key).values())
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
    entries = {
        space.columns[0].label(key): next(iter(taken)) if len(taken) == 1 else taken
        for key, taken in rows.items()
    }
    return json.dumps(entries, indent=2) + "\n"
