"""What every result offers: `frame()`, a table; `plot()`, where there is a picture; a short text.

A result says what it found in `value`, with its claim, and how far it may be off in `error`; it has
a `policy` where there is one. A notebook shows its report.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import fields
from reprlib import Repr
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.mdp.report import Report, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame as DataFrame
else:  # loaded where a table is asked for
    DataFrame = Any

ROWS_SHOWN = 20

_SHORT = Repr()
_SHORT.maxlevel, _SHORT.maxtuple, _SHORT.maxdict, _SHORT.maxlist = 2, 3, 3, 3
_SHORT.maxother = _SHORT.maxstring = 120


class Brief:
    """A dataclass whose arrays are read-only; its text says their shapes: give it `repr=False`."""

    def __post_init__(self) -> None:
        for part in vars(self).values():
            if isinstance(part, np.ndarray):
                part.setflags(write=False)

    def __repr__(self) -> str:
        names = getattr(self, "__dataclass_fields__", {})
        parts = (f"{name}={_shorten_value(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({', '.join(parts)})"


class ByFields:
    """A dataclass whose copies and pickles hold the fields alone, their arrays read-only."""

    def __getstate__(self) -> dict[str, Any]:
        parts: Any = self
        return {part.name: getattr(self, part.name) for part in fields(parts)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)


class Result(Brief, ABC):
    """A dataclass that can be shown."""

    @abstractmethod
    def frame(self) -> DataFrame:
        """Return the result as a table, one row for each thing found."""

    def report(self) -> Report:
        """Return what the result says: its text with its claim, and its table."""
        return plain_report(self, self.frame())

    def _repr_html_(self) -> str:
        return self.report().html(ROWS_SHOWN)


class Pictured(Result):
    """A result of which there is a picture."""

    def plot(self, ax: Axes | None = None, **settings: Any) -> Axes:
        """Draw the result on axes, or on those of a new figure.

        Parameters
        ----------
        ax : Axes, optional
        **settings
            As the function takes them that draws it, such as `most` and `output` ("optimal",
            "fixed", "regret") of a tornado, or a `wtp` to mark in acceptability curves; an unknown
            one is refused with a list of those that there are.

        Returns
        -------
        Axes

        Raises
        ------
        ModelError
            For an unknown setting, and where matplotlib is not installed.
        """
        import exact_mdp

        drawn: Axes = exact_mdp.draw(self, ax=ax, **settings)
        return drawn


def data_frame(*content: Any, **settings: Any) -> DataFrame:
    """Return a table of pandas, which is loaded here."""
    import pandas

    return pandas.DataFrame(*content, **settings)


def plain_report(thing: object, frame: DataFrame, count: int = 0) -> Report:
    """Return a report of something's text and table, as `frame_to_table` takes it."""
    said, claim = repr(thing), str(getattr(thing, "claim", ""))
    title = said if claim in said else f"{said} ({claim})"
    return Report(title=title, facts={}, tables={"rows": frame_to_table(frame, count=count)})


def frame_to_table(frame: DataFrame, title: str = "", count: int = 0) -> Table:
    """Return a table of a frame; of so many rows where these are only the first."""
    frame = frame.reset_index() if frame.index.name else frame
    columns: dict[str, str] = {}
    for key, (name, kind) in enumerate(frame.dtypes.items()):
        again = " " * (name in columns)  # a parameter may have the name of another column
        columns[f"{name}{again}"] = f"{key}:.6g" if kind.kind == "f" else f"{key}"
    rows = frame.set_axis([*map(str, range(len(columns)))], axis=1)
    return Table(title=title, columns=columns, rows=rows, count=count)


def _shorten_value(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    return _SHORT.repr(value)
