"""Policies as files: JSON and CSV by column labels, NumPy arrays, see `policy_array`."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.arrays import read_array
from exact_mdp.mdp.io.files import read_text, write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import check_action, rows_read, too_small
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Numbers, exact

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, eq=False)
class FileTable:
    """A policy as a file or a mapping gives it: (K, A) probabilities over some columns.

    Rows that it leaves out are NaN; `where` names it in errors.
    """

    space: StateSpace
    table: Numbers
    where: str


class Written(Protocol):
    """What is written of a policy; see `Policy`."""

    @property
    def space(self) -> StateSpace: ...
    @property
    def actions(self) -> tuple[str, ...]: ...
    @property
    def table(self) -> Floats: ...
    @property
    def shares(self) -> Numbers | None: ...
    @property
    def columns(self) -> tuple[str, ...]: ...
    @property
    def deterministic(self) -> bool: ...


def read(path: str | Path, mdp: MDP) -> FileTable:
    """Return what a `.json` or `.csv` file says; see `Policy.read`."""
    where, suffix = str(path), Path(path).suffix.lower()
    if suffix == ".json":
        return _from_json(read_text(path), mdp, where)
    if suffix == ".csv":
        return _from_csv(read_text(path), mdp, where)
    raise ModelError(
        f"unknown kind of policy {where!r}",
        where="policy",
        fix="give optimal, random, always:ACTION, or a .json, .csv, .npy or .npz file",
    )


def write(policy: Written, path: str | Path) -> None:
    """See `Policy.write`."""
    suffix = Path(path).suffix.lower()
    if suffix == ".csv":
        write_atomically(path, _as_csv(policy))
    elif suffix == ".json":
        write_atomically(path, _as_json(policy))
    else:
        raise ModelError(
            f"cannot write a policy as {suffix or 'a file without ending'}",
            where=str(path),
            fix="name it .csv or .json",
        )


def from_mapping(mdp: MDP, entries: Mapping[Any, Any], *, where: str) -> FileTable:
    """Return what a mapping says: {status: action} or {status: {action: probability}}."""
    names = (mdp.space.untimed or mdp.space).names
    name = "status" if "status" in names else names[0]
    rows: dict[int, dict[int, Fraction]] = {}
    space = StateSpace(columns=(mdp.space.column(name),))
    for label, choice in entries.items():
        key = at_place(where, partial(space.columns[0].parse, str(label)))
        place = f"{where}, {name} {label}"
        if key in rows:
            raise ModelError(f"{name} {label} appears twice", where=where, fix="keep one of them")
        mixed = choice if isinstance(choice, Mapping) else {str(choice): 1}
        rows[key] = {
            check_action(str(action), mdp.actions, place): _probability(value, place)
            for action, value in mixed.items()
        }
    return _filled(mdp, space, rows, where)


def _from_json(text: str, mdp: MDP, where: str) -> FileTable:
    def once(items: list[tuple[str, Any]]) -> dict[str, Any]:
        entries: dict[str, Any] = {}
        for key, value in items:
            if key in entries:
                raise ModelError(f"{key} appears twice", where=where, fix="keep one of them")
            entries[key] = value
        return entries

    try:
        content = json.loads(text, object_pairs_hook=once, parse_float=str, parse_int=str)
    except ModelError:
        raise
    except (ValueError, RecursionError) as error:
        raise ModelError(
            f"broken JSON: {str(error)[:200]}", where=where, fix="mend the syntax"
        ) from error
    if not isinstance(content, dict):
        raise ModelError(
            "the file is not a JSON object", where=where, fix='write {"0000": "none", …}'
        )
    return from_mapping(mdp, content, where=where)


def _from_csv(text: str, mdp: MDP, where: str) -> FileTable:
    try:
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except csv.Error as error:
        raise ModelError(f"broken CSV: {error}", where=where, fix="mend that line") from error
    header = [name.strip() for name in lines[0]] if lines else []
    columns = [name for name in header if name not in ("action", "probability")]
    known = [*mdp.space.names, "action", "probability"]
    for name in header:
        if name not in known:
            raise ModelError(f"unknown column {name!r}", where=where, fix=suggest(name, known))
    if "action" not in header or not columns or len(set(header)) != len(header):
        raise ModelError(
            f"the header is {','.join(header) or 'missing'}",
            where=where,
            fix=f"write {','.join([*mdp.space.names, 'action'])}, or status,action",
        )
    space = StateSpace(columns=tuple(mdp.space.column(name) for name in columns))
    rows: dict[int, dict[int, Fraction]] = {}
    for number, line in enumerate(lines[1:], start=2):
        place = f"{where}, line {number}"
        if not line:
            continue
        if len(line) != len(header):
            raise ModelError(
                f"{len(line)} values under {len(header)} headings", where=place, fix="mend the line"
            )
        entry = dict(zip(header, line, strict=True))
        values = at_place(place, partial(_values, space, entry))
        word = entry["action"] if entry["action"] in mdp.actions else entry["action"].strip()
        action = check_action(word, mdp.actions, place)
        chances = rows.setdefault(space.index(**values), {})
        if action in chances or (chances and "probability" not in header):
            raise ModelError(
                f"{space.label(space.index(**values))} appears twice",
                where=place,
                fix="keep one of them, or add a column probability",
            )
        chances[action] = _probability(entry.get("probability", "1").strip(), place)
    return _filled(mdp, space, rows, where)


def array_file(path: str | Path, make: Callable[[Numbers], T]) -> T:
    """Return what is made of the array of a file, with the file's name in what goes wrong."""
    array = read_array(path, called="q")
    return at_place(str(path), lambda: make(array))


def _filled(
    mdp: MDP, space: StateSpace, rows: Mapping[int, Mapping[int, Fraction]], where: str
) -> FileTable:
    floats = all(float(chance) == chance for row in rows.values() for chance in row.values())
    kind = np.float64 if floats else object
    table: Numbers = np.full((space.size, mdp.n_actions), np.nan, dtype=kind)
    for key, chances in rows.items():
        table[key] = 0
        for action, chance in chances.items():
            table[key, action] = chance
    return FileTable(space=space, table=table, where=where)


def check_complete(mdp: MDP, found: FileTable) -> None:
    """Raise ModelError where a combination is missing that a state with a choice reads."""
    keys = rows_read(mdp, found.space)
    silent = np.isnan(found.table.astype(np.float64)[keys]).any(axis=1)
    missing = silent & ~mdp.forced & ~mdp.terminal
    if missing.any():
        lost = sorted(set(keys[missing].tolist()))
        shown = "; ".join(found.space.labels(lost[:4])) + (" …" if len(lost) > 4 else "")
        raise ModelError(
            f"{len(lost)} of {found.space.size} rows are missing: {shown}",
            where=found.where,
            fix="add an action for each",
        )


def _values(space: StateSpace, entry: Mapping[str, str]) -> dict[str, int]:
    return {column.name: column.parse(entry[column.name]) for column in space.columns}


def _probability(value: object, where: str) -> Fraction:
    number = at_place(where, lambda: exact(value))
    if number and not at_place(where, lambda: float(number)):
        raise too_small(where)
    return number


def at_place(where: str, make: Callable[[], T]) -> T:
    """Return make(), with the place put in front of a ModelError's own."""
    try:
        return make()
    except ModelError as error:
        place = where if not error.where else f"{where}, {error.where}"
        raise ModelError(error.what, where=place, fix=error.fix) from error
    except OverflowError as error:
        raise ModelError("a number too large for a float", where=where, fix="check it") from error


def _written(policy: Written, key: int, action: int) -> float | str:
    """Return a probability as it is written: as a decimal or "p/q", which is read as exact."""
    rounded = float(policy.table[key, action])
    if policy.shares is None:
        return rounded
    row = policy.shares[key].tolist()
    share = Fraction(row[action], sum(row))
    rounded = float(share)
    return rounded if Fraction(repr(rounded)) == share else str(share)


def _as_csv(policy: Written) -> str:
    if not policy.columns:
        raise ModelError(
            "the policy reads no column of the state",
            where="CSV",
            fix="name it as always:ACTION instead",
        )
    mixed = not policy.deterministic
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*policy.columns, "action", *(["probability"] if mixed else [])])
    for key in range(policy.space.regular):
        labels = list(policy.space.as_dict(key).values())
        for action in np.flatnonzero(policy.table[key] > 0):
            chance = [str(_written(policy, key, int(action)))] if mixed else []
            writer.writerow([*labels, policy.actions[action], *chance])
    return out.getvalue()


def _as_json(policy: Written) -> str:
    if len(policy.columns) != 1:
        raise ModelError(
            f"the policy reads {', '.join(policy.columns) or 'no column'}",
            where="JSON",
            fix="write it as .csv",
        )
    entries: dict[str, object] = {}
    for key in range(policy.space.regular):
        row = policy.table[key]
        taken = np.flatnonzero(row > 0).tolist()
        chosen = [(policy.actions[action], _written(policy, key, action)) for action in taken]
        if chosen:
            label = policy.space.columns[0].label(key)
            entries[label] = chosen[0][0] if len(chosen) == 1 else dict(chosen)
    return json.dumps(entries, indent=2) + "\n"
