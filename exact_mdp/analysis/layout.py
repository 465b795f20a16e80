"""Where each state stands in a picture: the row and the column of a map.

A map is spanned by columns of the state space, or by the parts of states that are tuples. By
default the column that actions such as "right" change goes across and the one that "down" changes
goes down, in the direction of the arrow; without such actions the last column goes across. All
others go down. Numbered states of a grid world fill its `shape` row by row; without a shape they
stand in rows of ten.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite, prod
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from exact_mdp.analysis.gate.criteria import format_alternatives
from exact_mdp.analysis.optimum import actions_of
from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.forms.names import text_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import Floats, Integers

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.audit import Audit

MOST_CELLS = 4000  # that a picture has room for
MOST_NAMED = 40  # states that a picture names one by one
SHORT = 5  # letters of an action's name that fit into a cell
END = "∎"
ARROWS = "←↓→↑"
COMPASS = (("left", "down", "right", "up"), ("west", "south", "east", "north"))
INITIALS = ("ldru", "wsen")
Sides = dict[str, tuple[Column, Integers]]  # by name, with the value of each state, -1 outside


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """The place of each state, and what the rows and columns are called."""

    row: Integers  # (S,), -1 for states outside the map
    column: Integers
    rows: tuple[str, ...]  # their labels
    columns: tuple[str, ...]
    down: str  # what goes down
    across: str
    signs: dict[str, str]  # by action; its name where an arrow would not point at the next cell
    listed: bool = False  # whether places mean nothing: states stand in rows
    held: str = ""  # the columns held fixed, with their values

    @property
    def cells(self) -> int:
        """The number of cells; a map of more than MOST_CELLS is not drawn."""
        return len(self.rows) * len(self.columns)

    @property
    def named_in_cells(self) -> bool:
        """Whether a state's name stands in its cell, as no row or column says it."""
        return self.listed and len(self.columns) > 1

    @property
    def shown(self) -> Integers:
        """The states that are in the map."""
        return np.flatnonzero(self.row >= 0)

    def format_actions(self, actions: Sequence[str]) -> str:
        """Return the text of a cell: up to two short signs of actions, else their number."""
        text = "/".join(self.signs[action] for action in actions)
        short = len(actions) < 2 or len(text) <= SHORT
        return text if short else f"any of {len(actions)}"


def arrange(
    model: MDP,
    *,
    shape: tuple[int, int] | None = None,
    down: str | Sequence[str] | None = None,
    across: str | Sequence[str] | None = None,
    **at: object,
) -> Layout:
    """Return the places of a model's states; raise ModelError if they do not fit.

    `shape` is (rows, columns) of a grid world whose states are numbered row by row. `down` and
    `across` name columns of the state space, or parts of states that are tuples; those that neither
    names go down, except the time of a model with a horizon. `at` holds columns fixed, such as
    `trial=0`: other states are left out.
    """
    sides = find_columns(model)
    down, across = ([each] if isinstance(each, str) else each for each in (down, across))
    named = [*(down or ()), *(across or ()), *at]
    for name in named:
        require_known_name(name, sides, "state column", "state space")
    inside = np.ones(model.n_states, dtype=bool)
    for name, value in at.items():
        inside &= sides[name][1] == sides[name][0].number(value)
    rest = [name for name in sides if name not in named]
    if shape is not None:
        sides = _columns_of(_build_grid_space(model.space, shape, named))
    elif len(sides) < 2 or not model.space.regular:
        return _lay_out_list(model)
    elif across is None and TIME in rest and model.space.untimed is not None:
        across = [TIME]  # a row for each state, a column for each time
    elif len(rest) == 1 and sides[rest[0]][0].bits > 1 and not (down or across):
        sides = _split_digits(*sides[rest[0]])
    labels = {name: [*map(own.label, range(own.size))] for name, (own, _) in sides.items()}
    values = {name: own for name, (_, own) in sides.items()}
    heading = {} if shape is not None else _find_map_directions(model, values)
    for name, sign in heading.items():
        if sign < 0:  # its values fall in the direction of the arrow
            values[name] = np.where(values[name] < 0, -1, len(labels[name]) - 1 - values[name])
            labels[name].reverse()
    rest = [name for name in sides if name not in named]
    if heading.keys() <= {*rest}:
        rest = [*(name for name in rest if name not in heading), *heading]
    across = rest[-1:] if across is None else across
    below = [name for name in (*(down or ()), *rest) if name not in across]
    place = np.zeros((2, model.n_states), dtype=np.int64)
    for side, names in enumerate((below, across)):
        for name in names:
            inside &= values[name] >= 0
            place[side] = place[side] * len(labels[name]) + values[name]
    row, column = np.where(inside, place, -1)
    # In blocks of maps an arrow points inside one.
    last = [values[names[-1]] if names else 0 * row for names in (below, across)]
    return Layout(
        row=row,
        column=column,
        rows=tuple(map(", ".join, product(*(labels[name] for name in below)))),
        columns=tuple(map(", ".join, product(*(labels[name] for name in across)))),
        down=", ".join(below) or "-",
        across=", ".join(across) or "-",
        signs=_choose_arrows(model, *last, timed=TIME in (*below, *across)),
        held=", ".join(f"{name} {value}" for name, value in at.items()),
    )


def find_columns(model: MDP) -> Sides:
    """Return the columns of states; of tuples, their parts.

    Tuples have parts if all have one length, all other states are terminal, and few cells are
    empty.
    """
    space, sides = model.space, Sides()
    objects = space.columns[0].objects if len(space.columns) == 1 else ()
    inside = np.array([isinstance(each, tuple) for each in objects], dtype=bool)
    tuples: list[Any] = [each for each in objects if isinstance(each, tuple)]
    width = len(tuples[0]) if len(objects) == space.size and tuples else 0
    if width > 1 and {*map(len, tuples)} == {width} and model.terminal[~inside].all():
        fields = getattr(tuples[0], "_fields", None) or [f"state[{k}]" for k in range(width)]
        for name, own in zip(fields, zip(*tuples, strict=True), strict=True):
            distinct = [*dict.fromkeys(own)]
            with suppress(TypeError):  # of several kinds
                distinct = sorted(distinct)
            texts = [(text_of(value), repr(value)) for value in distinct]
            words = tuple(a if a.strip() and a.isprintable() else b for a, b in texts)
            part = Column(name=name, size=len(words), words=words, objects=tuple(distinct))
            sides[name] = part, np.full(space.size, -1)
            place = {value: number for number, value in enumerate(distinct)}
            sides[name][1][inside] = [place[value] for value in own]
    # A map of tuples that leaves more than three of four cells empty says less than a list.
    few = 0 < prod(each.size for each, _ in sides.values()) <= 4 * len(tuples)
    return sides if few else _columns_of(space)


def _columns_of(space: StateSpace) -> Sides:
    return {each.name: (each, space.values(each.name)) for each in space.columns}


def _split_digits(column: Column, value: Integers) -> Sides:
    """Return the first and the last digits of a column as two."""
    low = column.bits // 2
    high = column.bits - low
    first = Column(name=f"{column.name}: first digits", size=2**high, bits=high)
    last = Column(name=f"{column.name}: last digits", size=2**low, bits=low)
    return {first.name: (first, value >> low), last.name: (last, value & (2**low - 1))}


def _build_grid_space(
    space: StateSpace, shape: tuple[int, int], named: Sequence[str]
) -> StateSpace:
    """Return the space of the rows and columns that numbered states fill row by row."""
    what, fix = "", ""
    if named:
        what = "a shape and columns of a map"
        fix = "leave out shape, or down, across and the columns held fixed"
    elif any(column.objects for column in space.columns):
        what = "states are numbered as they were found, not row by row"
        fix = "leave it out; states that are tuples, such as (row, column), are placed by these"
    elif prod(shape) != space.regular or min(shape) < 1:
        what = f"{shape[0]} rows of {shape[1]} states are not {space.regular} states"
        fix = "give (rows, columns) with rows × columns the number of states"
    if what:
        raise ModelError(what, where="shape", fix=fix)
    sides = zip(("row", "column"), shape, strict=True)
    return replace(space, columns=tuple(Column(name=name, size=size) for name, size in sides))


def _find_map_directions(model: MDP, values: Mapping[str, Integers]) -> dict[str, float]:
    """Return the columns that "down" and "right" change most, with the sign of the change.

    None if actions are not directions, or change the same coordinate.
    """
    drift = _compute_drift(model, [*values.values()])
    signs = np.array([*choose_symbols(model.actions).values()])
    left, down, right, up = (drift[:, signs == sign].sum(axis=1) for sign in ARROWS)
    most = {[*values][np.abs(each).argmax()]: each for each in (down - up, right - left)}
    signed = {name: float(each[np.abs(each).argmax()]) for name, each in most.items()}
    return signed if len(signed) == 2 and all(signed.values()) else {}


def _lay_out_list(model: MDP) -> Layout:
    """Return a list of states: a row for each of a few that have names, else rows of ten."""
    states = np.arange(model.n_states)
    names = [name.removeprefix("state ") for name in model.space.labels(states)]
    named = len(states) <= MOST_NAMED and not all(map(str.isdecimal, names))
    wide = 1 if named else min(len(states), 10)
    return Layout(
        row=states // wide,
        column=states % wide,
        signs=choose_symbols(model.actions),
        rows=tuple(names) if named else tuple(map(str, states[::wide].tolist())),
        columns=("",) if named else tuple(f"+{column}" for column in range(wide)),
        down="state",
        across="" if named else "state",
        listed=True,
    )


def shorten_names(names: Sequence[str], most: int) -> list[str]:
    """Return names of at most `most` letters, kept distinct: their ends, or else numbers."""
    half = most // 2
    for first, last in ((most - 1, 0), (0, most - 1), (most - 1 - half, half)):
        short = [n if len(n) <= most else f"{n[:first]}…{n[len(n) - last :]}" for n in names]
        if len({*short}) == len({*names}):
            return short
    return [*map(str, range(len(names)))]


def _compute_drift(model: MDP, values: Sequence[Integers]) -> Floats:
    """Return (C, A) where each action leads along some coordinates (C, S), -1 outside of them.

    A move counts by its probability, not its length: a long way back to a start has no weight.
    """
    table = model.table
    places = np.array(values)
    before, after = places[:, model.pair_state[table.pair]], places[:, table.next]
    moved = np.where((before < 0) | (after < 0), 0, np.sign(after - before))
    action = model.pair_action[table.pair]
    weighted = moved * table.compute_probabilities()
    return np.array([np.bincount(action, each, model.n_actions) for each in weighted])


def _choose_arrows(model: MDP, row: Integers, column: Integers, *, timed: bool) -> dict[str, str]:
    """Return a sign for each action: an arrow only if its moves go that way more than sideways.

    In a map of times, in which all moves go on by one, words stand for arrows.
    """
    right, down = _compute_drift(model, [column, row])
    ways = {"←": (-right, down), "↓": (down, right), "→": (right, down), "↑": (-down, right)}
    signs = choose_symbols(model.actions)
    for number, (action, sign) in enumerate(signs.items()):
        if sign in ways:
            ahead, aside = (float(each[number]) for each in ways[sign])
            if timed or ((ahead or aside) and ahead <= abs(aside)):
                signs[action] = action
    return signs


def choose_symbols(actions: Sequence[str]) -> dict[str, str]:
    """Return a sign for each action: an arrow if its name is a direction, else a short name.

    If all names are short, they stand for themselves.
    """
    names = [name.strip().lower() for name in actions]
    words = [*COMPASS, *(letters for letters in INITIALS if set(letters) <= set(names))]
    known: dict[str, str] = {}
    for each in words:
        known.update(zip(each, ARROWS, strict=True))
    short = all(len(name) <= SHORT for name in actions)
    drawn = {}
    for number, (name, given) in enumerate(zip(names, actions, strict=True)):
        drawn[given] = f"a{number}"
        if known.get(name):
            drawn[given] = known[name]
        elif short:
            drawn[given] = given
    return drawn


# ---- what an audit says of each state, in a figure and on a page ---------------------------------


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One state of a map; it is idle if it has no choice or no visit, and is not wrong."""

    state: int
    kind: Literal["wrong", "idle", ""]
    text: str  # the action of the policy, with "✗" if it is wrong
    small: str  # the optimal action then
    name: str  # the state's number or name, where states are only listed
    title: str  # the state in full, with its numbers
    start: bool  # whether episodes begin there
    shade: float  # its loss as a share of the greatest finite loss; infinite as the loss is


def ends_of(model: MDP) -> dict[int, tuple[str, str]]:
    """Return the sign and the words of each state in which an episode ends."""
    signs = dict.fromkeys(np.flatnonzero(model.over).tolist(), (END, "an episode ends"))
    for name, states in model.labels.items():
        own = np.flatnonzero(states)
        if 0 < len(own) < len(signs) and model.over[own].all():
            signs |= dict.fromkeys(own.tolist(), (name[:1].upper(), name))
    return signs


def build_cells(audit: Audit, layout: Layout) -> list[list[Cell | None]]:
    """Return the cell at each row and column of the map; None where no state is."""
    mdp, choices = audit.mdp, actions_of(audit.mdp, audit.chain.chosen > 0)
    grid: list[list[Cell | None]] = [[None] * len(layout.columns) for _ in layout.rows]
    # Losses are shaded relative to the greatest finite one.
    wrong = {each.state: each for each in audit.disagreements}
    finite = [each.cost for each in audit.disagreements if isfinite(each.cost)]
    most = max(finite, default=0.0) or 1.0
    idle, ends = ~mdp.ends.must_choose | (audit.visits == 0), ends_of(mdp)
    begins = {state for state, _ in mdp.start}
    for state in layout.shown.tolist():
        each, label = wrong.get(state), mdp.space.label(state)
        # The text of the cell, and the sentence that a page shows for it.
        names = choices[state]
        text, best = layout.format_actions(names), ""
        said = f"{format_alternatives(names)}; {audit.visits[state]:.6g} expected visits"
        if mdp.over[state]:
            text, said = ends[state]
        elif each is not None:
            text, best = f"✗ {text}", layout.format_actions(each.optimal)
            said = (
                f"yours {each.learned}, optimal {format_alternatives(each.optimal)}; "
                f"{each.expected_visits:.6g} expected visits, loses {each.cost:.6g}"
            )
        if state in begins:
            said += ", start"
        grid[layout.row[state]][layout.column[state]] = Cell(
            state=state,
            kind="wrong" if each is not None else "idle" if idle[state] else "",
            text=text,
            small=best,
            name=label.removeprefix("state ") if layout.named_in_cells else "",
            title=f"{label}: {said}",
            start=state in begins,
            shade=0.0 if each is None else each.cost / most,
        )
    return grid
