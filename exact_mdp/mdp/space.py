"""The state space: named integer columns, with labels computed on demand.

A state is a number. A `StateSpace` gives its meaning: the product of the columns in row-major order
(the last column moves fastest), followed by a few named states outside the product, such as an end.
Nothing is stored per state, so a million states take no memory.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import prod

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import (
    ModelError,
    check_names,
    locate_errors,
    no_such,
    require_known_name,
    words_of,
)
from exact_mdp.mdp.forms.names import Names

Integers = NDArray[np.int64]
TIME = "time"


@dataclass(frozen=True, kw_only=True)
class Column:
    """One named coordinate of a state: values 0 … size-1, printed as numbers, bits or words.

    `objects` are the Python objects that the words name, if the model was made from objects; they
    are not saved to files.

    Examples
    --------
    >>> Column(name="status", size=16, bits=4).label(4)
    '0100'
    """

    name: str
    size: int
    bits: int = 0
    words: tuple[str, ...] = ()
    objects: tuple[Hashable, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        check_names((self.name,), "column", where="state space")
        if not self.words:
            return
        what = "value"
        if self.name == "state":
            what = "state"
        check_names(self.words, what, where=f"column {self.name}")

    @cached_property
    def lookup(self) -> Names:
        """The values of the column by name, number, or the object that each was made from."""
        return Names(
            what=self.name,
            size=self.size,
            words={word: value for value, word in enumerate(self.words)},
            label=self.label,
            objects={thing: value for value, thing in enumerate(self.objects)},
        )

    def label(self, value: int) -> str:
        """Return the printed form of one value."""
        if self.words:
            return self.words[value]
        if self.bits:
            return format(value, f"0{self.bits}b")
        return str(value)

    def find_object(self, value: int) -> Hashable:
        """Return the object of a value; without objects its word; without words the value."""
        if self.objects:
            return self.objects[value]
        if self.words:
            return self.words[value]
        return value

    def number(self, value: object) -> int:
        """Return the value that a text, number or object names; see `mdp.forms.names`."""
        with locate_errors(f"column {self.name}"):
            # In a column of bits, a text is read as binary digits.
            if not self.bits or not isinstance(value, str):
                return self.lookup.find_number(value)
            text = value.strip()
            if len(text) != self.bits or not set(text) <= {"0", "1"}:
                raise ModelError(
                    f"unknown {self.name} {value!r}",
                    fix=f"write {self.bits} digits, each 0 or 1, such as {self.label(0)}",
                )
            return int(text, 2)


@dataclass(frozen=True, kw_only=True)
class StateSpace:
    """Named columns whose product, plus `extra` named states, is the set of states.

    Examples
    --------
    >>> space = StateSpace(
    ...     columns=(Column(name="trial", size=5), Column(name="status", size=16, bits=4)),
    ...     extra=("end",),
    ... )
    >>> space.size
    81
    >>> space.label(20)
    'trial 1, status 0100'
    >>> space.index(trial=1, status=4)
    20
    >>> space.label(80)
    'end'
    """

    columns: tuple[Column, ...]
    extra: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = list(self.extra)
        if len(self.columns) == 1:  # its words are the names of the states
            names += self.columns[0].words
        check_names(names, "state", where="states")

    @cached_property
    def regular(self) -> int:
        """Number of states in the product, without the extra ones."""
        return prod([column.size for column in self.columns])

    @cached_property
    def size(self) -> int:
        """Number of states."""
        return self.regular + len(self.extra)

    @property
    def names(self) -> tuple[str, ...]:
        """Column names."""
        return tuple(column.name for column in self.columns)

    @property
    def untimed(self) -> StateSpace | None:
        """The space without its first column if that is the time; else None.

        Examples
        --------
        >>> columns = (Column(name="time", size=4), Column(name="state", size=9))
        >>> StateSpace(columns=columns).untimed.names
        ('state',)
        """
        if len(self.columns) > 1 and self.columns[0].name == TIME:
            return StateSpace(columns=self.columns[1:], extra=self.extra)
        return None

    def column(self, name: str) -> Column:
        """Return the column called `name`; raise ModelError if there is none."""
        require_known_name(name, self.names, "state column", "state space")
        return self.columns[self.names.index(name)]

    def values(self, name: str, states: Integers | None = None) -> Integers:
        """Return the values of one column for all states (S,) or some; -1 for extra states."""
        column = self.column(name)
        index = np.arange(self.size)
        if states is not None:
            index = np.asarray(states, dtype=np.int64)
        # Row-major order: the column's value changes every `stride` states.
        stride = prod(c.size for c in self.columns[self.columns.index(column) + 1 :])
        return np.where(index < self.regular, index // stride % column.size, -1)

    def rows(self, columns: Sequence[Column]) -> Integers:
        """Return the row (S,) of each state in a table over some columns; 0 for extra states."""
        row = np.zeros(self.size, dtype=np.int64)
        for column in columns:
            row = row * column.size + np.maximum(self.values(column.name), 0)
        return row

    def index(self, **values: int) -> int:
        """Return the number of the state with these column values; 0 is the default of each."""
        for name in values:
            self.column(name)
        number = 0
        for column in self.columns:
            value = values.get(column.name, 0)
            if not 0 <= value < column.size:
                raise no_such(column.name, value, column.size, where="state space")
            number = number * column.size + value
        return number

    @cached_property
    def _number(self) -> dict[str, int]:
        """The number of each state by its printed form."""
        return {self.label(state): state for state in range(self.size)}

    @cached_property
    def lookup(self) -> Names:
        """The numbers of the states by name, number, object or column values."""
        words = {name: self.regular + place for place, name in enumerate(self.extra)}
        objects: Mapping[Hashable, int] = {}
        # The words and objects of a single column name the states themselves.
        if len(self.columns) == 1:
            words |= self.columns[0].lookup.words
            objects = self.columns[0].lookup.objects
        return Names(
            what="state",
            size=self.size,
            words=words,
            label=self.label,
            objects=objects,
            otherwise=self._in_columns,
        )

    def _in_columns(self, state: object) -> int | None:
        """Return the state with a printed form, or with a tuple of column values; else None."""
        # "state low" is the state with the word "low"; the words spare a list of all states.
        if len(self.columns) == 1 and self.columns[0].words:
            name = f"{self.columns[0].name} "
            if isinstance(state, str) and state.startswith(name):
                return self.lookup.words.get(state.removeprefix(name))
            return None
        if isinstance(state, str):
            return self._number.get(state)
        if not isinstance(state, tuple) or len(state) != len(self.columns):
            return None
        cells = zip(self.columns, state, strict=True)
        return self.index(**{column.name: column.number(value) for column, value in cells})

    def number(self, state: object) -> int:
        """Return the number of a state, given by number, object, name or column values.

        `mdp.forms.names` states the rules; raises ModelError for an unknown or ambiguous state.

        Examples
        --------
        >>> space = StateSpace(
        ...     columns=(Column(name="row", size=2), Column(name="side", size=2, words=("l", "r"))),
        ...     extra=("end",),
        ... )
        >>> [space.number(state) for state in (2, "3", (1, "r"), "row 0, side r", "end")]
        [2, 3, 3, 1, 4]
        """
        return self.lookup.find_number(state)

    def numbers(self, states: object) -> list[int]:
        """Return the numbers of some states, each given as in `number`."""
        return self.lookup.find_numbers(states)

    def _list_cells(self, state: int) -> Iterator[tuple[str, str]]:
        """Yield the name and the printed value of each column, the last column first."""
        for column in reversed(self.columns):
            state, value = divmod(state, column.size)
            yield column.name, column.label(value)

    def label(self, state: int) -> str:
        """Return the printed form of one state."""
        if not 0 <= state < self.size:
            raise no_such("state", state, self.size, where="state space")
        if state >= self.regular:
            return self.extra[state - self.regular]
        return ", ".join([f"{name} {value}" for name, value in self._list_cells(state)][::-1])

    def plain_label(self, state: int) -> str:
        """Return the printed form of one state in a table: the name alone of a plain state."""
        return self.label(state).removeprefix("state ")

    def place(self, state: int) -> str:
        """Return a state as messages name it: "state A", "state (row 0, column 3)"."""
        label = self.label(state)
        if label.startswith("state "):
            return label
        return f"state ({label})"

    def labels(self, states: Iterable[int]) -> list[str]:
        """Return the printed forms of some states."""
        return [self.label(int(state)) for state in states]

    def as_dict(self, state: int) -> Mapping[str, str]:
        """Return one state's column labels by name; an extra state is {"state": its name}."""
        if not 0 <= state < self.regular:
            return {"state": self.label(state)}
        return dict([*self._list_cells(state)][::-1])

    @classmethod
    def plain(cls, size: int, labels: Iterable[object] | None = ()) -> StateSpace:
        """Return a space of one column `state`, numbered or with a word for each state.

        Parameters
        ----------
        size : int
            The number of states.
        labels : iterable of str
            A word for each state; without labels, states are numbered.

        Returns
        -------
        StateSpace

        Raises
        ------
        ModelError
            If there are labels, but not one for each state.

        Examples
        --------
        >>> StateSpace.plain(2, ["low", "high"]).label(1)
        'state high'
        """
        words = words_of(labels, "states")
        if words and len(words) != size:
            raise ModelError(
                f"{len(words)} state labels for {size} states",
                where="state space",
                fix="give one label for each state, or none",
            )
        return cls(columns=(Column(name="state", size=size, words=words),))


def find_table_space(space: StateSpace, rows: int, forced: NDArray[np.bool_]) -> StateSpace | None:
    """Return the states that a table with `rows` rows is over; None if no states fit.

    These are all states; or all without some of the extra states, if these have no choice, which is
    True in `forced` (S,); or the states without the time, if that is the first column.
    """
    if rows == space.size:
        return space
    if space.untimed is not None:
        for untimed in (space.untimed, StateSpace(columns=space.untimed.columns)):
            if rows == untimed.size:
                return untimed
        return None
    if not space.regular <= rows < space.size or not forced[space.regular :].all():
        return None
    return StateSpace(columns=space.columns, extra=space.extra[: rows - space.regular])
