"""Base classes of results: `frame()`, a table; `plot()`, a picture if there is one; a short text.

A result has its number in `value`, the kind of this number in `claim`, a bound on its error in
`error`, and the policy, if there is one, in `policy`. A notebook shows its report.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from reprlib import Repr
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.report import Report, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame as DataFrame
else:  # pandas is loaded by the first function that makes a table
    DataFrame = Any

ROWS_SHOWN = 20  # in a notebook


class Brief:
    """A dataclass with read-only arrays, and a text with only their shapes (use `repr=False`)."""

    def __post_init__(self) -> None:
        for part in vars(self).values():
            if isinstance(part, np.ndarray):
                part.setflags(write=False)

    def __repr__(self) -> str:
        names = getattr(self, "__dataclass_fields__", {})
        parts = (f"{name}={_shorten_value(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({', '.join(parts)})"


class Result(Brief, ABC):
    """A result: a dataclass with a table and a report."""

    @abstractmethod
    def frame(self) -> DataFrame:
        """Return the result as a table, one row for each thing found."""

    def report(self) -> Report:
        """Return the report of the result: its text with its claim, and its table."""
        return plain_report(self, self.frame())

    def _repr_html_(self) -> str:
        return self.report().html(ROWS_SHOWN)


class Pictured(Result):
    """A result with a picture."""

    def plot(self, ax: Axes | None = None, **settings: Any) -> Axes:
        """Draw the result on the given axes, or in a new figure.

        Parameters
        ----------
        ax : Axes, optional
        **settings
            Settings of the plotting function, such as `most` and `output` ("optimal", "fixed",
            "regret") of a tornado, or a `wtp` to mark in acceptability curves; for an unknown
            setting, the error lists the known ones.

        Returns
        -------
        Axes

        Raises
        ------
        ModelError
            For an unknown setting, and if matplotlib is not installed.
        """
        import exact_mdp

        drawn: Axes = exact_mdp.draw(self, ax=ax, **settings)
        return drawn


class Judged(Pictured):
    """An audit: a result with a verdict, `passed`; not a condition, as a failed one would hold."""

    def __bool__(self) -> bool:
        raise ModelError(
            f"{type(self).__name__} is neither true nor false",
            where="condition",
            fix="ask for its verdict, Audit.passed",
        )


def data_frame(*content: Any, **settings: Any) -> DataFrame:
    """Return a pandas data frame."""
    import pandas

    return pandas.DataFrame(*content, **settings)


def plain_report(thing: object, frame: DataFrame, count: int = 0) -> Report:
    """Return a report with the text of `thing` as its title, and one table.

    `count` is the number of all rows, if the frame has only the first of them.
    """
    title, claim = repr(thing), str(getattr(thing, "claim", ""))
    if claim not in title:
        title = f"{title} ({claim})"
    return Report(title=title, facts={}, tables={"rows": frame_to_table(frame, count=count)})


def frame_to_table(frame: DataFrame, title: str = "", count: int = 0) -> Table:
    """Return the table of a data frame; `count` is the number of all rows, if it has fewer."""
    if frame.index.name:
        frame = frame.reset_index()
    columns: dict[str, str] = {}
    for key, (name, kind) in enumerate(frame.dtypes.items()):
        heading, column = str(name), str(key)
        if name in columns:  # a parameter may have the name of another column
            heading += " "
        if kind.kind == "f":
            column += ":.6g"
        columns[heading] = column
    # The columns are found by number, since names need not be unique.
    rows = frame.set_axis([*map(str, range(len(columns)))], axis=1)
    return Table(title=title, columns=columns, rows=rows, count=count)


def _shorten_value(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    # The first entries of a part only.
    short = Repr()
    short.maxlevel = 2
    short.maxtuple = short.maxdict = short.maxlist = 3
    short.maxother = short.maxstring = 120
    return short.repr(value)
