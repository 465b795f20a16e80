"""What the commands print: one JSON object, or plain aligned tables.

JSON has no NaN (it becomes null) and no infinity (it becomes "inf" or "-inf"); floats are as
Python's repr gives them, which is exact, and rationals are "p/q". Text never has colours or cut-off
cells: what is too wide wraps.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_UP, Context
from fractions import Fraction
from typing import Any, Literal

Side = Literal["left", "right"]
DIGITS = 10  # significant digits of a number in a table


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A table of texts; numbers should be formatted already, and stand to the right."""

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: frozenset[int] = frozenset()


def show(
    result: Mapping[str, Any], *, as_json: bool, facts: Mapping[str, str], grids: Iterable[Grid]
) -> None:
    """Print a command's result: as JSON, or as its facts and tables for people."""
    if as_json:
        print(to_json(result))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from exact_mdp.mdp.errors import shown_text

    def plain(text: str) -> Text:  # the name of a file may hold what steers a terminal
        return Text(shown_text(text, lines=True), overflow="fold")

    console = Console(no_color=True, highlight=False, markup=False, emoji=False)
    with console.capture() as captured:
        table = Table.grid(padding=(0, 2, 0, 0))
        for name, value in facts.items():
            table.add_row(plain(name), plain(value))
        console.print(table)
        for grid in grids:
            table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
            for column, heading in enumerate(grid.headings):
                side: Side = "right" if column in grid.numeric else "left"
                table.add_column(plain(heading), overflow="fold", justify=side)
            for row in grid.rows:
                table.add_row(*(plain(cell) for cell in row))
            console.print(plain(f"\n{grid.title}"))
            console.print(table)
    for line in captured.get().splitlines():
        print(line.rstrip())


def to_json(result: Mapping[str, Any]) -> str:
    """Return strict JSON.

    Examples
    --------
    >>> to_json({"value": Fraction(1, 3), "steps": math.inf, "x": 0.1}).replace(chr(10), "")
    '{  "value": "1/3",  "steps": "inf",  "x": 0.1}'
    """
    return json.dumps(_plain(result), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    """Return the same made of what JSON has; NumPy arrays and numbers have `tolist`."""
    if isinstance(value, Mapping):
        return {str(key): _plain(below) for key, below in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(below) for below in value]
    if isinstance(value, Fraction):
        return ratio(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else f"{value:g}"
    if not isinstance(value, str) and hasattr(value, "tolist"):
        return _plain(value.tolist())
    return value


def number(value: float | None, error: float = 0.0) -> str:
    """Return a number with the digits that its error leaves, ten at most; "-" for none.

    Examples
    --------
    >>> number(117.0712345678901), number(117.07, error=0.3), number(None)
    ('117.0712346', '117.1', '-')
    """
    if value is None or math.isnan(value):
        return "-"
    digits = DIGITS
    if 0 < error < abs(value) < math.inf:
        places = math.floor(math.log10(abs(value))) - math.floor(math.log10(error)) + 1
        digits = min(DIGITS, places)
    # Python writes 1e+02 for 117 at one digit; people read 100 more easily.
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.{DIGITS}g}"


def at_most(error: float) -> str:
    """Return an error bound with two digits, rounded up so that it still holds.

    Examples
    --------
    >>> at_most(2.01e-12), at_most(0.0), at_most(math.inf)
    ('2.1e-12', '0', 'inf')
    """
    if error == 0 or not math.isfinite(error):
        return f"{error:g}"
    return f"{Context(prec=2, rounding=ROUND_UP).create_decimal(error):g}"


def ratio(value: Fraction) -> str:
    """Return "p/q", or "p" for an integer, however many digits there are.

    Examples
    --------
    >>> ratio(Fraction(-6, 4)), len(ratio(Fraction(10**9999)))
    ('-3/2', 10000)
    """
    top = digits_of(value.numerator)
    return top if value.denominator == 1 else f"{top}/{digits_of(value.denominator)}"


def decimal(value: Fraction) -> str:
    """Return the exact decimal where it is finite, otherwise "p/q".

    Examples
    --------
    >>> decimal(Fraction(-1, 8)), decimal(Fraction(42)), decimal(Fraction(1, 3))
    ('-0.125', '42', '1/3')
    """
    twos = (value.denominator & -value.denominator).bit_length() - 1
    rest, fives = value.denominator >> twos, 0
    while rest % 5 == 0:
        rest, fives = rest // 5, fives + 1
    places = max(twos, fives)
    if rest != 1 or places == 0:
        return ratio(value)
    text = digits_of(abs(value.numerator) * 10**places // value.denominator).zfill(places + 1)
    return f"{'-' if value < 0 else ''}{text[:-places]}.{text[-places:]}"


def digits_of(whole: int) -> str:
    """Return an integer's decimal digits in pieces: Python refuses over 4,300 at a time."""
    if whole < 0:
        return f"-{digits_of(-whole)}"
    if whole.bit_length() <= 2000:
        return str(whole)
    half = whole.bit_length() * 3 // 20
    high, low = divmod(whole, 10**half)
    return digits_of(high) + digits_of(low).zfill(half)
