"""Where each state stands in a picture: in a row and a column of a map.

A map is spanned by columns of the state space, `down` and `across`; the last column goes across
unless said otherwise, and all others down; the digits of a column that is left alone go both ways.
A grid world whose states are only numbered is given its
`shape`, read row by row. States of a single column without a shape stand in rows of ten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import prod

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers

WIDE = 10  # states in a row where nothing says how many
ARROWS = "←↓→↑"
COMPASS = (("left", "down", "right", "up"), ("west", "south", "east", "north"))
INITIALS = ("ldru", "wsen")


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """The place of each state, and what the rows and columns are called.

    Attributes
    ----------
    row, column : (S,) int64
        Counted from 0; -1 for states outside the map.
    rows, columns : tuple of str
        A label for each.
    down, across : str
        What goes down and across.
    listed : bool
        Whether the map is a mere list of states in rows, whose places mean nothing.
    """

    row: Integers
    column: Integers
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    down: str
    across: str
    listed: bool = False

    @property
    def shown(self) -> Integers:
        """The states that are in the map."""
        return np.flatnonzero(self.row >= 0)


def arrange(
    model: MDP,
    *,
    shape: tuple[int, int] | None = None,
    down: Sequence[str] | None = None,
    across: Sequence[str] | None = None,
    **at: int,
) -> Layout:
    """Return the places of a model's states.

    Parameters
    ----------
    model : MDP
    shape : (int, int), optional
        Rows and columns of a grid world whose states are numbered row by row.
    down, across : sequence of str, optional
        Columns of the state space; those that neither names go down.
    **at
        Values of columns that are held fixed, such as `trial=0`: other states are left out.

    Returns
    -------
    Layout

    Raises
    ------
    ModelError
        For a shape that the states do not fill, and unknown columns or values.

    Examples
    --------
    >>> model = MDP.from_arrays([[[1 / 6] * 6] * 6], [0] * 6, 0.9)
    >>> arrange(model, shape=(2, 3)).column.tolist()
    [0, 1, 2, 0, 1, 2]
    """
    space = model.space
    if shape is not None:
        if prod(shape) != space.regular or min(shape) < 1:
            raise ModelError(
                f"{shape[0]} rows of {shape[1]} states are not {space.regular} states",
                where="shape",
                fix="give (rows, columns) with rows × columns the number of states",
            )
        return _numbered(space, *shape, listed=False)
    if len(space.columns) < 2 or space.regular == 0:
        return _numbered(space, -(-space.size // WIDE), min(space.size, WIDE), listed=True)
    named = [*(down or ()), *(across or ()), *at]
    for name in named:
        space.column(name)
    rest = [name for name in space.names if name not in named]
    split = across is None and len(rest) == 1 and not down and space.column(rest[0]).bits > 1
    if across is None:
        across = rest[-1:]
    below = [name for name in space.names if name in {*(down or ()), *rest} - {*across, *at}]
    states = np.arange(space.size)
    inside = states < space.regular
    for name, value in at.items():
        space.index(**{name: value})
        inside &= space.values(name) == value
    (row, rows), (column, columns) = (_along(space, names) for names in (below, list(across)))
    under, over = ", ".join(below) or "-", ", ".join(across) or "-"
    if split:
        low = space.column(rest[0]).bits // 2
        row, column = column >> low, column & (2**low - 1)
        rows, columns = (
            tuple(dict.fromkeys(label[:-low] for label in columns)),
            tuple(dict.fromkeys(label[-low:] for label in columns)),
        )
        under, over = f"{over}: first digits", f"{over}: last digits"
    return Layout(
        row=np.where(inside, row, -1),
        column=np.where(inside, column, -1),
        rows=rows,
        columns=columns,
        down=under,
        across=over,
    )


def _along(space: StateSpace, names: Sequence[str]) -> tuple[Integers, tuple[str, ...]]:
    """Return the place (S,) of each state along some columns, and the label of each place."""
    place, columns = np.zeros(space.size, dtype=np.int64), [space.column(name) for name in names]
    for column in columns:
        place = place * column.size + space.values(column.name)
    sizes = [column.size for column in columns]
    labels = tuple(
        ", ".join(column.label(value) for column, value in zip(columns, values, strict=True))
        for values in np.ndindex(*sizes)
    )
    return place, labels


def _numbered(space: StateSpace, high: int, wide: int, *, listed: bool) -> Layout:
    states = np.arange(space.size)
    inside = np.full(space.size, True) if listed else states < space.regular
    return Layout(
        row=np.where(inside, states // wide, -1),
        column=np.where(inside, states % wide, -1),
        rows=tuple(str(wide * row if listed else row) for row in range(high)),
        columns=tuple(("+" if listed else "") + str(column) for column in range(wide)),
        down="state" if listed else "row",
        across="state" if listed else "column",
        listed=listed,
    )


def taken(model: MDP, chosen: Floats) -> list[list[int]]:
    """Return the numbers of the actions that probabilities (L,) of pairs give to each state."""
    used = np.asarray(chosen) > 0
    return [
        model.pair_action[first:last][used[first:last]].tolist()
        for first, last in pairwise(model.pair_offsets.tolist())
    ]


def joined(signs: Sequence[str], many: str) -> str:
    """Return up to two signs of actions side by side, else in words how many there are.

    Examples
    --------
    >>> joined(["↓", "→"], "tied"), joined(["a0", "a1", "a2"], "tied")
    ('↓/→', '3 tied')
    """
    return "/".join(signs) if len(signs) <= 2 else f"{len(signs)} {many}"


def symbols(actions: Sequence[str]) -> list[str]:
    """Return a sign for each action: an arrow where its name is a direction, else a short name.

    Names of up to two characters stand for themselves where all are that short.

    Examples
    --------
    >>> symbols(["LEFT", "DOWN", "wait"]), symbols(["0", "1"]), symbols(["N", "E", "S", "W"])
    (['←', '↓', 'a2'], ['0', '1'], ['↑', '→', '↓', '←'])
    """
    names = [name.strip().lower() for name in actions]
    words = [*COMPASS, *(letters for letters in INITIALS if set(letters) <= set(names))]
    known = {word: arrow for each in words for word, arrow in zip(each, ARROWS, strict=True)}
    short = all(len(name) <= 2 for name in actions)
    return [
        known.get(name) or (given if short else f"a{number}")
        for number, (name, given) in enumerate(zip(names, actions, strict=True))
    ]
