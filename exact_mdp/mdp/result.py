"""What every result offers: `frame()`, a table; `plot()`, where there is a picture; a short text.

A result says what it found in `value`, with its claim, and how far it may be off in `error`; it has
a `policy` where there is one. In a notebook it shows the first rows of its table.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import fields
from fractions import Fraction
from html import escape
from reprlib import Repr
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.mdp.report import cell

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
        parts = (f"{name}={_text(getattr(self, name))}" for name in names)
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

    def _repr_html_(self) -> str:
        said, claim = repr(self), getattr(self, "claim", "")
        frame = self.frame()
        return as_html(
            said + (f" ({claim})" if str(claim) not in said else ""), frame, rows=len(frame)
        )


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


def as_html(said: str, frame: DataFrame, *, rows: int) -> str:
    """Return a line and the first rows of a table of so many, as a notebook shows them."""
    head = frame.head(ROWS_SHOWN).copy()
    for name, kind in head.dtypes.items():
        if kind.kind == "O":
            head[name] = [cell(each) if isinstance(each, Fraction) else each for each in head[name]]
    more = rows - len(head)
    rest = f"<p>… and {more:,} rows more: <code>.frame()</code></p>" if more else ""
    return f"<p>{escape(said)}</p>{head.to_html(border=0)}{rest}"


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    return _SHORT.repr(value)
