"""Where each state stands in a picture: in a row and a column of a map.

A map is spanned by columns of the state space, or by the parts of states that are tuples. Unless
said otherwise, the one that actions such as "right" change goes across and that of "down" goes
down, in the direction of the arrow; other columns make blocks of such maps. Without such actions
the last column goes across and all others down; the digits of one that is alone go both ways.
Numbered states of a grid world fill its `shape` row by row; without one they stand in rows of ten.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import prod
from typing import Any, Literal

import numpy as np

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.disagreements import either
from exact_mdp.analysis.vary.base_case import actions_of
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.forms.names import text_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Floats, Integers

MOST_CELLS = 4000
WIDE = 10  # states in a row where nothing says how many
MOST_NAMED = 40  # states that are listed by their names, one in a row
SHORT = 5  # letters of an action's name that fit into a cell
SPARSE = 4  # cells for each state of a map of tuples, at most
ARROWS = "←↓→↑"
COMPASS = (("left", "down", "right", "up"), ("west", "south", "east", "north"))
INITIALS = ("ldru", "wsen")


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """The place of each state, and what the rows and columns are called."""

    row: Integers  # (S,), -1 for states outside the map
    column: Integers
    rows: tuple[str, ...]  # their labels
    columns: tuple[str, ...]
    down: str  # what goes down
    across: str
    # One for each action; its name where an arrow would not point at the next cell.
    signs: tuple[str, ...]
    listed: bool = False  # whether places mean nothing: states stand in rows

    @property
    def cells(self) -> int:
        """The number of cells; there is no picture of more than MOST_CELLS."""
        return len(self.rows) * len(self.columns)

    @property
    def shown(self) -> Integers:
        """The states that are in the map."""
        return np.flatnonzero(self.row >= 0)


def arrange(
    model: MDP,
    *,
    shape: tuple[int, int] | None = None,
    down: str | Sequence[str] | None = None,
    across: str | Sequence[str] | None = None,
    **at: object,
) -> Layout:
    """Return the places of a model's states; raises ModelError where they do not fit.

    `shape` is that of a grid world whose states are numbered row by row. `down` and `across` name
    columns of the state space, or parts of states that are tuples; those that neither names go
    down. `at` holds columns fixed, such as `trial=0`: other states are left out.
    """
    space, states = _parts(model) or (model.space, np.arange(model.n_states))
    down, across = ([each] if isinstance(each, str) else each for each in (down, across))
    named = [*(down or ()), *(across or ()), *at]
    for name in named:
        space.column(name)
    heading: tuple[str, ...] = ()
    if shape is not None:
        _check_shape(model.space, shape, named)
        named = ["row", "column"]
        sides = (Column(name=name, size=size) for name, size in zip(named, shape, strict=True))
        space, down, across = StateSpace(columns=tuple(sides)), named[:1], named[1:]
        states = np.minimum(np.arange(model.n_states), space.regular)
    elif len(space.columns) < 2 or space.regular == 0:
        return _listed(model, space)
    else:
        space, states, heading = _headed(model, space, states)
    rest = [name for name in space.names if name not in named]
    if across is None and len(rest) == 1 and not down and space.column(rest[0]).bits > 1:
        space, rest = _halved(space, rest[0])
    if heading and not (down or across) and set(heading) <= set(rest):
        below, across = _blocks(space, heading, [name for name in rest if name not in heading])
    else:
        across = rest[-1:] if across is None else across
        below = [name for name in space.names if name in {*(down or ()), *rest} - {*across, *at}]
    inside = states < space.regular
    for name, value in at.items():
        inside &= space.values(name, states) == space.column(name).number(value)
    (row, rows), (column, columns) = (
        _along(space, names, states) for names in (below, list(across))
    )
    # In blocks of maps an arrow points inside one.
    last = [space.values(names[-1], states) if names else 0 * states for names in (below, across)]
    return Layout(
        row=np.where(inside, row, -1),
        column=np.where(inside, column, -1),
        rows=rows,
        columns=columns,
        down=", ".join(below) or "-",
        across=", ".join(across) or "-",
        signs=_signs(model, *last),
    )


def _halved(space: StateSpace, name: str) -> tuple[StateSpace, list[str]]:
    """Return the space in which the first and the last digits of a column are two columns."""
    own = space.column(name)
    place, low = space.columns.index(own), own.bits // 2
    halves = [
        Column(name=f"{name}: {which} digits", size=2**bits, bits=bits)
        for which, bits in (("first", own.bits - low), ("last", low))
    ]
    columns = (*space.columns[:place], *halves, *space.columns[place + 1 :])
    return replace(space, columns=columns), [each.name for each in halves]


def _check_shape(space: StateSpace, shape: tuple[int, int], named: Sequence[str]) -> None:
    """Raise ModelError for a shape that numbered states do not fill row by row."""
    if named:
        fix = "leave out shape, or down, across and the columns held fixed"
        raise ModelError("a shape and columns of a map", where="shape", fix=fix)
    if any(column.objects for column in space.columns):
        raise ModelError(
            "states are numbered as they were found, not row by row",
            where="shape",
            fix="leave it out; states that are tuples, such as (row, column), are placed by these",
        )
    if prod(shape) != space.regular or min(shape) < 1:
        raise ModelError(
            f"{shape[0]} rows of {shape[1]} states are not {space.regular} states",
            where="shape",
            fix="give (rows, columns) with rows × columns the number of states",
        )


def _parts(model: MDP) -> tuple[StateSpace, Integers] | None:
    """Return columns for the parts of states that are tuples, and each state's number in these.

    None where some state is no tuple of that length and no end, or where most cells were empty.
    """
    objects = model.space.columns[0].objects if len(model.space.columns) == 1 else ()
    inside = np.array([isinstance(thing, tuple) for thing in objects], dtype=bool)
    tuples: list[tuple[Hashable, ...]] = [each for each in objects if isinstance(each, tuple)]
    width = len(tuples[0]) if tuples else 0
    if width < 2 or any(len(each) != width for each in tuples) or len(objects) != model.n_states:
        return None
    if not model.terminal[~inside].all():
        return None
    fields = getattr(tuples[0], "_fields", None) or [f"state[{k}]" for k in range(width)]
    columns, values = [], np.full((width, model.n_states), -1)
    for k, field in enumerate(fields):
        distinct: list[Any] = [*dict.fromkeys(each[k] for each in tuples)]
        with suppress(TypeError):  # of several kinds
            distinct = sorted(distinct)
        place = {value: number for number, value in enumerate(distinct)}
        values[k, inside] = [place[each[k]] for each in tuples]
        texts = [(text_of(value), repr(value)) for value in distinct]
        words = tuple(a if a.strip() and a.isprintable() else b for a, b in texts)
        columns.append(Column(name=field, size=len(distinct), words=words, objects=tuple(distinct)))
    if prod(column.size for column in columns) > SPARSE * len(tuples):
        return None
    space = StateSpace(columns=tuple(columns))
    number = np.full(model.n_states, space.regular)
    number[inside] = np.ravel_multi_index([*values[:, inside]], [c.size for c in columns])
    return space, number


def _headed(
    model: MDP, space: StateSpace, states: Integers
) -> tuple[StateSpace, Integers, tuple[str, ...]]:
    """Return the columns that "down" and "right" change, turned where these lower them.

    With the space and the states' numbers in it; no columns where actions are no directions, or
    change one and the same.
    """
    values = np.array([space.values(name, states) for name in space.names])
    drift, signs = _drift(model, values), np.array(symbols(model.actions))
    net = {sign: drift[:, signs == sign].sum(axis=1) for sign in ARROWS}
    change = (net["↓"] - net["↑"], net["→"] - net["←"])
    heading = [int(np.argmax(np.abs(each))) for each in change]
    if heading[0] == heading[1] or not all(c[k] for c, k in zip(change, heading, strict=True)):
        return space, states, ()
    columns = list(space.columns)
    for each, k in zip(change, heading, strict=True):
        if each[k] < 0:
            own, back = columns[k], range(columns[k].size)[::-1]
            words, objects = tuple(map(own.label, back)), tuple(map(own.thing, back))
            columns[k] = Column(name=own.name, size=own.size, words=words, objects=objects)
            values[k] = own.size - 1 - values[k]
    number, inside = states.copy(), states < space.regular
    number[inside] = np.ravel_multi_index([*values[:, inside]], [c.size for c in columns])
    names = tuple(columns[k].name for k in heading)
    return replace(space, columns=tuple(columns)), number, names


def _blocks(
    space: StateSpace, heading: Sequence[str], others: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Return what goes down and across, where other columns make blocks on the shorter side."""
    sides, lengths = [[name] for name in heading], [space.column(name).size for name in heading]
    for name in reversed(others):
        side = int(lengths[1] < lengths[0])
        sides[side].insert(0, name)
        lengths[side] *= space.column(name).size
    return sides[0], sides[1]


def _along(
    space: StateSpace, names: Sequence[str], states: Integers
) -> tuple[Integers, tuple[str, ...]]:
    """Return the place (S,) of each state along some columns, and the label of each place."""
    place, columns = np.zeros(len(states), dtype=np.int64), [space.column(name) for name in names]
    for column in columns:
        place = place * column.size + space.values(column.name, states)
    sizes = [column.size for column in columns]
    labels = tuple(
        ", ".join(column.label(value) for column, value in zip(columns, values, strict=True))
        for values in np.ndindex(*sizes)
    )
    return place, labels


def _listed(model: MDP, space: StateSpace) -> Layout:
    """Return a list of states: a row for each of a few that have names, else rows of ten."""
    states = np.arange(space.size)
    names = [name.removeprefix("state ") for name in space.labels(range(space.size))]
    named = len(states) <= MOST_NAMED and not all(map(str.isdecimal, names))
    wide = 1 if named else min(space.size, WIDE)
    numbers = [str(first) for first in range(0, space.size, wide)]
    return Layout(
        row=states // wide,
        column=states % wide,
        signs=tuple(symbols(model.actions)),
        rows=tuple(names if named else numbers),
        columns=("",) if named else tuple(f"+{column}" for column in range(wide)),
        down="state",
        across="" if named else "state",
        listed=True,
    )


def _drift(model: MDP, values: Integers) -> Floats:
    """Return (C, A) where each action leads along some coordinates (C, S), -1 outside of them.

    A move counts by its probability, whatever its length: one far back to a start is no direction.
    """
    table = model.table
    before, after = values[:, model.pair_state[table.pair]], values[:, table.next]
    moved = np.where((before < 0) | (after < 0), 0, np.sign(after - before))
    action = model.pair_action[table.pair]
    weighted = moved * table.probabilities()
    return np.array([np.bincount(action, each, model.n_actions) for each in weighted])


def _signs(model: MDP, row: Integers, column: Integers) -> tuple[str, ...]:
    """Return a sign for each action: an arrow only where its moves go that way more than aside."""
    signs = symbols(model.actions)
    net = dict(zip(("←→", "↑↓"), _drift(model, np.array([column, row])), strict=True))
    for number, sign in enumerate(signs):
        if sign in ARROWS and any(net[axis][number] for axis in net):
            along, aside = sorted(net, key=lambda axis: sign not in axis)
            ahead = net[along][number] * (1 if sign == along[1] else -1)
            if ahead <= abs(net[aside][number]):
                signs[number] = model.actions[number]
    return tuple(signs)


COUNTED = {"mixed": "one of n actions is drawn", "tied": "n actions are optimal"}
"""What a cell says of n actions, and what that means."""


def joined(signs: Sequence[str], many: str) -> str:
    """Return up to two short signs of actions side by side, else how many, by a word of COUNTED."""
    text = "/".join(signs)
    return text if len(signs) < 2 or len(text) <= SHORT else f"{len(signs)} {many}"


def counts(texts: Iterable[str]) -> list[str]:
    """Return what the words of COUNTED in some cells mean.

    >>> counts([joined(["↓", "→"], "mixed"), joined(["a0", "a1", "a2"], "tied")])
    ['n tied: n actions are optimal']
    """
    words = {match[1] for text in texts if (match := re.search(r"\d+ (\w+)$", text))}
    return [f"n {word}: {meaning}" for word, meaning in COUNTED.items() if word in words]


def symbols(actions: Sequence[str]) -> list[str]:
    """Return a sign for each action: an arrow where its name is a direction, else a short name.

    Names stand for themselves where all are short.
    """
    names = [name.strip().lower() for name in actions]
    words = [*COMPASS, *(letters for letters in INITIALS if set(letters) <= set(names))]
    known = {word: arrow for each in words for word, arrow in zip(each, ARROWS, strict=True)}
    short = all(len(name) <= SHORT for name in actions)
    return [
        known.get(name) or (given if short else f"a{number}")
        for number, (name, given) in enumerate(zip(names, actions, strict=True))
    ]


# ---- what an audit says of each state, in a figure and on a page ---------------------------------


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One state of a map; idle is one without a choice or a visit that is not wrong."""

    state: int
    kind: Literal["wrong", "idle", ""]
    text: str  # what the policy does, with "✗" where that is wrong
    small: str  # the optimal action then
    name: str  # the state's number or name, where states are only listed
    title: str  # the state in full, with its numbers
    shade: float  # its loss as a share of the costliest state's, which may be infinite


def cells(audit: Audit, layout: Layout) -> list[list[Cell | None]]:
    """Return the cell at each row and column of the map; None where no state is."""
    mdp, choices = audit.mdp, actions_of(audit.mdp, audit.chain.chosen > 0)
    sign = dict(zip(mdp.actions, layout.signs, strict=True))
    grid: list[list[Cell | None]] = [[None] * len(layout.columns) for _ in layout.rows]
    wrong = {each.state: each for each in audit.disagreements}
    most = max((each.cost for each in audit.disagreements), default=0.0) or 1.0
    idle = ~mdp.asked | (audit.visits == 0)
    for state in layout.shown.tolist():
        each, label = wrong.get(state), mdp.space.label(state)
        names = choices[state]
        text, best = joined([sign[name] for name in names], "mixed"), ""
        said = f"{either(names)}; {audit.visits[state]:.6g} expected visits"
        if mdp.over[state]:
            text, said = "∎", "an episode ends here"
        elif each is not None:
            text, best = f"✗ {text}", joined([sign[name] for name in each.optimal], "tied")
            said = (
                f"yours {each.learned}, optimal {either(each.optimal)}; "
                f"{each.expected_visits:.6g} expected visits, loses {each.cost:.6g}"
            )
        grid[layout.row[state]][layout.column[state]] = Cell(
            state=state,
            kind="wrong" if each is not None else "idle" if idle[state] else "",
            text=text,
            small=best,
            name=label.removeprefix("state ") if layout.listed and len(layout.columns) > 1 else "",
            title=f"{label}: {said}",
            shade=0.0 if each is None else 1.0 if each.cost == most else each.cost / most,
        )
    return grid
