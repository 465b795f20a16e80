"""Models from a long table: one row for each outcome, as `MDP.frame` prints them.

    state, action, next state, probability, reward

The rows of a pair need not stand together. A state that no row leaves is an end. A single
column `cost` in place of `reward` makes the sense "min". Every other column is a component of the
reward; without a column `reward`, the reward is the sum of the components, and a column `cost`
among them is refused unless the sense is given.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import ModelError, locate_errors, require_type
from exact_mdp.mdp.forms.listed import OutcomeColumns, name_columns
from exact_mdp.mdp.forms.names import Numbering
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.io.files import read_text
from exact_mdp.mdp.io.structured import csv_of, require_column_names
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.validate import check_options

if TYPE_CHECKING:
    from pandas import DataFrame

STATE, ACTION, NEXT, PROBABILITY = PLACES = ("state", "action", "next state", "probability")
COST = Sense.MIN.amount
AMOUNTS = {Sense.MAX.amount, COST}
USUAL = {  # other names of columns, in small letters and with spaces
    "s": STATE,
    "from": STATE,
    "a": ACTION,
    "p": PROBABILITY,
    "prob": PROBABILITY,
    "s'": NEXT,
    "next": NEXT,
    "to": NEXT,
    "r": Sense.MAX.amount,
}
NUMBERED = re.compile(r"(?:state )?(0|[1-9][0-9]{0,18})")  # a name that is a number


class FromFrame(FromArrays):
    """Models from long tables."""

    @classmethod
    def from_frame(
        cls,
        frame: DataFrame | str | Path,
        discount: object = 1,
        *,
        start: object = None,
        **names: Any,
    ) -> Self:
        """Build from a table with one row for each outcome, as `frame` prints it.

        Parameters
        ----------
        frame : DataFrame, {column: values}, or path of a `.csv` file
            The columns state, action, next state, probability, and reward, or cost alone (whose
            sense is "min"). Capital letters do not matter, and s, a, next_state or to, p and r are
            read, too. Every other column is a component of the reward, which is their sum if there
            is no reward; a cost beside others then needs a `sense`. A state that no row leaves is
            an end. (`frame` prints no components.)
        discount : number or "p/q"
        start, **names
            As in `from_arrays`; states, actions and components come from the table.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For a column that is missing, for a value that is missing or no number, with its row;
            and as the constructor does.

        Examples
        --------
        >>> import pandas as pd
        >>> from exact_mdp import MDP
        >>> names = ["state", "action", "next state", "probability", "cost"]
        >>> rows = [
        ...     ("worn", "wait", "worn", "2/3", 1),
        ...     ("worn", "wait", "broken", "1/3", 9),
        ...     ("worn", "repair", "new", 1, 4),
        ... ]
        >>> mdp = MDP.from_frame(pd.DataFrame(rows, columns=names))
        >>> mdp.sense.value, mdp.frame(["worn"]).to_csv(index=False, header=False).split()
        ('min', ['worn,wait,worn,2/3,1', 'worn,wait,broken,1/3,9', 'worn,repair,new,1,4'])
        """
        follows = "leave it out: it follows from the table"
        check_options(names, dict.fromkeys(("states", "actions", "components"), follows))
        given, places, where = _read_columns(frame)
        columns = _name_columns(given, where)
        if where != "frame":
            names = {"name": Path(where).stem} | names
        # A cost is the amount that counts only if it is the only one.
        amounts = [name for name in columns if name not in PLACES]
        paid = [name for name in amounts if name == Sense.MAX.amount or amounts == [COST]]
        parts = [name for name in amounts if name not in paid]
        if paid == [COST]:
            names = {"sense": Sense.MIN} | names
            if not Sense.of_options(names).costs:
                fix = 'name the column "reward", or leave the sense out'
                raise ModelError('costs have the sense "min"', where="sense", fix=fix)
        if COST in parts and not paid and "sense" not in names:
            raise ModelError(
                "a column 'cost' beside other amounts may be what counts, or one amount of several",
                where=where,
                fix="add a column reward, or name the column otherwise and have all amounts added",
            )
        # Gather the outcomes of each pair, with all their amounts.
        states, actions, pairs = Numbering(), Numbering(), dict[tuple[int, int], list[Any]]()
        kinds = (states, actions, states)
        rows = zip(places, *(columns[name] for name in (*PLACES, *paid, *parts)), strict=True)
        for place, *row in rows:
            state, action, then = (
                numbering.add_thing(_name_of(cell, what, place), what, place)
                for numbering, what, cell in zip(kinds, PLACES, row, strict=False)
            )
            heads = (PROBABILITY, *paid, *parts)
            chance, *amounts = map(_number_of, row[3:], heads, [place] * len(heads))
            pairs.setdefault((state, action), []).append((chance, then, amounts))
        # The reward is the first amount, or all amounts together.
        filled, listed = OutcomeColumns(), []
        for (state, action), outcomes in pairs.items():
            if paid:
                rewarded = [(chance, then, each[0]) for chance, then, each in outcomes]
            else:
                named = [dict(zip(parts, each, strict=True)) for *_, each in outcomes]
                rewarded = [(p, to, gain) for (p, to, _), gain in zip(outcomes, named, strict=True)]
            filled.add_pair(state, action, rewarded)
            listed.append([each[1:] for *_, each in outcomes])
        own = name_columns(filled, states, actions)
        ends = [0] * (len(filled.state) - len(listed))
        if paid and parts:
            own["components"] = {
                name: [*([amounts[k] for amounts in each] for each in listed), *ends]
                for k, name in enumerate(parts)
            }
        return cls._from_columns(filled, discount, start, own | names)


def _read_columns(frame: Any) -> tuple[dict[str, list[Any]], list[str], str]:
    """Return the columns of a table, the place of each row, and the place of all; for messages."""
    import pandas

    where, word = "frame", "row"
    if isinstance(frame, str | Path):
        # Texts, so that the decimals of a file are exact.
        where, word = str(frame), "line"
        rows = csv_of(read_text(frame).splitlines(), where)
        _, heads = next(rows, (0, []))
        lines = {line: [cell.strip() for cell in row] for line, row in rows}
        frame = pandas.DataFrame([*lines.values()], [*lines], heads, dtype=object)
    elif isinstance(frame, Mapping):
        try:
            frame = pandas.DataFrame(frame, dtype=object)
        except ValueError as error:
            fix = "give lists of the same length"
            raise ModelError(f"no table: {error}", where=where, fix=fix) from error
    fix = "give a DataFrame, {column: values}, or the path of a .csv file"
    require_type(frame, pandas.DataFrame, where, fix)
    heads = [*map(str, frame.columns)]
    values = [frame.iloc[:, k].tolist() for k in range(len(heads))]
    places = [f"{where}, {word} {number}" for number in frame.index]
    require_column_names(heads, where)
    return dict(zip(heads, values, strict=True)), places, where


def _name_columns(given: dict[str, list[Any]], where: str) -> dict[str, list[Any]]:
    """Return the columns under their own names; ModelError if one is missing, or there twice."""
    columns: dict[str, list[Any]] = {}
    for name, values in given.items():
        known = usual_name(name)
        if known not in (*PLACES, *AMOUNTS):
            known = name
        if known in columns:
            raise ModelError(f"two columns are the {known}", where=where, fix="leave one out")
        columns[known] = values
    missing = [name for name in PLACES if name not in columns]
    if missing:
        fix = f"give the columns {', '.join(PLACES)}, reward"
        if PROBABILITY in missing:
            fix += "; from observed transitions a model is estimated: MDP.from_transitions"
        what = (
            f"the table has no column {missing[0]!r}, but {', '.join(map(repr, given)) or 'none'}"
        )
        raise ModelError(what, where=where, fix=fix)
    if len(columns) == len(PLACES):
        fix = "add a column reward or cost, with 0 where nothing is earned"
        raise ModelError("the table has no reward", where=where, fix=fix)
    return columns


def usual_name(name: str) -> str:
    """Return the own name of a column: state for S, next state for next_state."""
    plain = name.strip().lower().replace("_", " ")
    return USUAL.get(plain, plain)


def _require_there(cell: Any, what: str, place: str) -> None:
    """Raise ModelError for an empty cell."""
    import pandas

    if (isinstance(cell, str) and not cell) or (
        pandas.api.types.is_scalar(cell) and pandas.isna(cell)
    ):
        raise ModelError(f"the {what} is missing", where=place, fix="fill the cell")


def _name_of(cell: Any, what: str, place: str) -> Any:
    """Return the name of a state or action; a text that shows a number is the number."""
    _require_there(cell, what, place)
    if isinstance(cell, str):
        numbered = NUMBERED.fullmatch(cell)
        if numbered:
            return int(numbered[1])
    return cell


def _number_of(cell: Any, what: str, place: str) -> Any:
    """Return a number as given; raise ModelError for a missing one, and for other values."""
    _require_there(cell, what, place)
    with locate_errors(f"{place}, {what}"):
        return as_given(cell)
