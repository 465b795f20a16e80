"""Tables of numbers in text files: a Q-table, or probabilities, with a row for each state.

Values are separated by commas, semicolons, tabs or, in .txt, by spaces, as numpy.savetxt, pandas
and spreadsheets write them. Lines that begin with # are comments, except that a last one above the
numbers may be their header. A header names the actions, or numbers them from 0; without one, the
columns are in the model's order. A column before the actions names the states; without one, the
rows are in the model's order. A single column of whole numbers lists actions. If a first row may be
a header or numbers, or a first column may be states or values, the file is refused. An empty field,
or nan, is the value of an action that is not available.

In .json a table is lists of rows, or {state: row} and the other dictionaries, with states as texts,
such as "(0, 1)"; alone, or the only lists of rows under any key. If a .json or .npz file holds
several tables, FILE#NAME says which.
"""

from __future__ import annotations

import io
import math
import re
from ast import literal_eval
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors, once_each
from exact_mdp.mdp.forms.names import integer_of
from exact_mdp.mdp.io.structured import csv_of, find_separator
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import find_table_space
from exact_mdp.mdp.table import Numbers, exact

WHOLE = re.compile(r"\s*-?(0|[1-9]\d{0,17})\s*", re.ASCII)
NO_NUMBER = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
NUMPY_NUMBER = re.compile(r"np\.\w+\(([^()]*)\)")  # as repr((np.int64(0), np.int64(1)))
CORNERS = ("", "s", "state")  # above a column of states
Line = tuple[int, list[str]]


def parse_digits(text: str) -> Any:
    """Return a text of digits as an int, and other text as it is."""
    if WHOLE.fullmatch(text):
        return int(text)
    return text


def parse_key(text: str) -> Any:
    """Return the digits of a state as an int, "(0, 1)" as a tuple, and other text as it is."""
    if not text.startswith("("):
        return parse_digits(text)
    try:
        key = literal_eval(NUMPY_NUMBER.sub(r"\1", text))
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return text
    if isinstance(key, tuple):
        return key
    return text


def parse_number(text: str) -> Any:
    """Return the number that a text writes, exactly; NaN for an empty text."""
    text = text.strip()
    if not text:
        return math.nan
    if NO_NUMBER.fullmatch(text):
        return float(text)
    if WHOLE.fullmatch(text):
        return int(text)
    return exact(text)


def is_number_text(text: str) -> bool:
    """Return whether a text writes a number; an empty text does not."""
    try:
        return bool(text.strip()) and parse_number(text) is not None
    except ModelError:
        return False


def read_lines(text: str, *, spaces: bool) -> tuple[list[Line], list[str]]:
    """Return the lines of a table, and the last comment above it, as values.

    With `spaces`, these separate values if the first line has no other separator.
    """
    comment, kept = "", list[str]()
    for line in text.split("\n"):
        if line.lstrip().startswith("#"):
            if not any(map(str.strip, kept)):
                comment = line.lstrip().lstrip("#")
            line = ""  # an empty line, so that lines are counted
        kept.append(line)
    first = next(filter(str.strip, kept), "")
    if spaces and find_separator(first) == " ":
        comment, *kept = ["\t".join(line.split()) for line in (comment, *kept)]
    lines = csv_of(io.StringIO("\n".join(kept)), fix="give every row as many values as the first")
    names = comment.split(find_separator(comment))
    return [(n, [*map(str.strip, row)]) for n, row in lines], [*map(str.strip, names)]


def read_table(model: MDP, lines: Sequence[Line], comment: Sequence[str] = ()) -> Any:
    """Return the rows of a table, or {state: row} if it has a column of states."""
    if not lines:
        raise ModelError("the table has no rows", fix="give a row for each state")
    header, lines = _split_header(model, lines, comment)
    width, first = len(lines[0][1]), [row[0] for _, row in lines]
    # Is there a column of states before the columns of actions?
    if header:
        labelled = not model.action_names.can_find(header[0])
    else:
        labelled = not all(map(is_number_text, first)) or width == model.n_actions + 1
        counted = len(first) > 2 and first == [str(number) for number in range(len(first))]
        if counted and not labelled and width > 1:
            raise ModelError(
                "the first column counts 0, 1, 2 …: it may name the states, or hold values",
                fix="write a line above with the names of the actions, after the word state if "
                "the first column names the states",
            )
    table = []
    for number, row in lines:
        with locate_errors(f"line {number}"):
            table.append([*map(parse_number, row[labelled:])])
    if header:
        order = _order_actions(model, header[labelled:])
        table = [[row[place] for place in order] for row in table]
    if width == 1 and not labelled:  # numpy.savetxt writes action 3 as 3.000000000000000000e+00
        table = [
            [number if (whole := integer_of(number)) is None else whole] for (number,) in table
        ]
    if labelled:
        return once_each(zip(map(parse_key, first), table, strict=True), str)
    return table


def _split_header(
    model: MDP, lines: Sequence[Line], comment: Sequence[str]
) -> tuple[Sequence[str], Sequence[Line]]:
    """Return the header of a table, empty without one, and the other lines."""
    _, first = lines[0]
    width, numbered = len(first), [str(number) for number in range(len(first))]
    if width == 1:
        below = lines[not is_number_text(first[0]) :]
        return [], below or lines
    # Words above the columns of actions.
    if not all(is_number_text(text) for text in first[1:] if text):
        if len(lines) == 1:
            raise ModelError("the table has no rows", fix="give a row for each state")
        return first, lines[1:]
    # Numbers may be actions, or values.
    corner = width == model.n_actions + 1 and first[0].lower() in CORNERS
    listed = corner and all(map(model.action_names.can_find, first[1:]))
    if (listed or first[1:] == numbered[:-1]) and not is_number_text(first[0]):
        if not model.space.lookup.can_find(parse_key(first[0])):
            return first, lines[1:]
    elif first == numbered:
        fits = []
        for above in (0, 1):
            space = find_table_space(model.space, len(lines) - above, model.forced)
            fits.append(space is not None)
        if all(fits):
            raise ModelError(
                f"the first line is {','.join(first)}: it may number the actions, or hold values",
                fix="write the names of the actions there, or above it",
            )
        if fits[1]:
            return first, lines[1:]
    if len(comment) == width and all(map(model.action_names.can_find, comment[1:])):
        return comment, lines
    return [], lines


def _order_actions(model: MDP, names: Sequence[str]) -> list[int]:
    """Return the places of the columns of a header in the model's order of actions."""
    with locate_errors("header"):
        numbers = [model.action_names.find_number(name) for name in names]
        places = once_each(zip(numbers, range(len(names)), strict=True), model.action_names.label)
    return [places[number] for number in sorted(places)]


# ---- JSON ----------------------------------------------------------------------------------------


def find_part(content: Any, name: str | None, path: str) -> Any:
    """Return the part of a JSON file to read: the part NAME, or the only list of rows in it."""
    tables = dict(_list_tables(content, ""))
    if name is None:
        if len(tables) > 1:
            fix = f"say which: {path}#{next(iter(tables))}"
            raise ModelError(f"the file holds {', '.join(tables)[:200]}", fix=fix)
        return next(iter(tables.values()), content)
    named = tables
    if isinstance(content, dict):
        named = content | tables
    if name not in named:
        known = ", ".join([*named][:9]) or "nothing"
        raise ModelError(f"the file has no {name!r}", fix=f"choose one of its parts: {known}")
    return named[name]


def _list_tables(content: Any, name: str) -> Iterator[tuple[str, list[Any]]]:
    """Yield the lists of lists in JSON objects, each with its keys, joined by points."""
    if isinstance(content, dict):
        for key, part in content.items():
            yield from _list_tables(part, f"{name}.{key}".lstrip("."))
    elif isinstance(content, list) and name and content and isinstance(content[0], list):
        yield name, content


def parse_lists(content: list[Any]) -> list[Any]:
    """Return nested lists of numbers from JSON, in which numbers with a point are texts."""
    array: Numbers = np.array(content, dtype=object)
    for place, number in np.ndenumerate(array):
        if isinstance(number, str):
            array[place] = exact(number)
    nested: list[Any] = array.tolist()
    return nested
