"""What the commands print: one renderer for all of them.

A command gives back a `Report`: its result, the facts and tables that people see of it, notes, and
its exit status. JSON holds the result; text holds facts and tables. A value is shown by its type:

    type                in JSON                                  in text
    Certified, Bounded  {"value": x, "error_bound": e}           117.07 (bounded, within 2e-12)
    Estimated           {"value": x, "standard_error": e, ...}   117.1 (estimated, standard error 2)
    Fraction            "p/q"                                    p/q
    float               as Python's repr, which is exact         ten digits at most
    NaN, None           null                                     - in a table, no fact
    infinity            "inf", "-inf"                            inf, -inf
    bool                true, false                              yes, no
    dataclass           an object of its fields

A table takes its rows from a result's `.frame()`, or from a list of mappings. Text never has
colours or cut-off cells: what is too wide wraps.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from decimal import ROUND_UP, Context
from fractions import Fraction
from operator import itemgetter
from typing import Any, Literal

from exact_mdp.analysis import github
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp.errors import ModelError, shown_text
from exact_mdp.solvers.solution import Bounded, Certified, Estimated

Row = Mapping[str, Any]
FORMAT = 2  # of the JSON: another number where a key changes its meaning or goes
DIGITS = 10  # significant digits of a number in a table
SHOWN = 40  # rows of a table
Claimed = Certified | Bounded | Estimated
Column = str | Callable[[Any], Any] | tuple[Callable[[Any], Any], str]


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows and what is shown of them.

    Attributes
    ----------
    title : str
    rows : pandas.DataFrame, or sequence of mappings or of anything else
    columns : mapping
        {heading: what stands below it}: "key" or "key:format" of a row, with a format as Python's
        `format` takes it (".4g", ".1%") and possibly a sign before it ("± .2g"); or a function of
        the row that returns the value, alone or with such a format. Numbers stand to the right.
    first : int
        Number of rows shown; the title says where there are more.
    note : str
        What the columns mean, in a line below the title.

    Examples
    --------
    >>> rows = [{"name": "a", "share": 0.25}, {"name": "b", "share": None}]
    >>> found = Table(title="shares", rows=rows, columns={"": "name", "share": "share:.1%"})
    >>> found.cells()
    [['a', '25.0%'], ['b', '-']]
    """

    title: str
    rows: Any
    columns: Mapping[str, Column]
    first: int = SHOWN
    note: str = ""

    def cells(self) -> list[list[str]]:
        """Return the texts of the rows that are shown."""
        return [
            [cell(value, form) for value, (_, form) in zip(row, self._columns, strict=True)]
            for row in self._values()
        ]

    def heading(self) -> str:
        """Return the title, with the number of rows where not all are shown."""
        more = f" (the first {self.first:,} of {len(self.rows):,}; --json prints all)"
        return self.title + (more if len(self.rows) > self.first else "")

    def numeric(self) -> list[bool]:
        """Return which columns hold numbers alone."""
        kinds = (int, float, Fraction, Certified, Bounded, Estimated)
        return [
            all(value is None or isinstance(value, kinds) for value in column)
            and any(value is not None and not isinstance(value, bool) for value in column)
            for column in zip(*self._values(), strict=True)
        ] or [False] * len(self.columns)

    @property
    def _columns(self) -> list[tuple[Callable[[Any], Any], str]]:
        found = list[tuple[Callable[[Any], Any], str]]()
        for said in self.columns.values():
            if isinstance(said, str):
                key, _, form = said.partition(":")
                found.append((itemgetter(key), form))
            else:
                found.append(said if isinstance(said, tuple) else (said, ""))
        return found

    def _values(self) -> list[list[Any]]:
        rows = self.rows
        if hasattr(rows, "to_dict"):  # a table of pandas
            rows = rows.head(self.first).to_dict("records")
        take = [column for column, _ in self._columns]
        return [[_scalar(column(row)) for column in take] for row in rows[: self.first]]


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a command found.

    Attributes
    ----------
    result : mapping
        The JSON object.
    facts : mapping
        {name: value}, for people; a fact of None is left out.
    tables : sequence of Table
        A table without rows is left out.
    notes : sequence of str
        Printed on standard error; part of Markdown. That this is no medical advice is part of
        every form, in JSON the key "notice".
    status : int
        The exit status.
    """

    result: Row
    facts: Row
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    status: int = 0


def show(report: Report, *, as_json: bool, as_markdown: bool = False) -> int:
    """Print a report, as JSON or for people, and return its exit status."""
    from rich import box, console, table

    advice = [ADVICE] * (ADVICE in report.notes)
    for note in (each for each in report.notes if each != ADVICE):
        print(f"note: {note}", file=sys.stderr)
    if as_json and as_markdown:
        raise ModelError("two forms of one output", where="--markdown", fix="leave out --json")
    if as_json or as_markdown:
        # "##[" in a name would begin a command to a runner.
        result = dict(report.result) | dict.fromkeys(["notice"] * len(advice), ADVICE)
        found = to_json(result) if as_json else markdown(report)
        print(found.replace("##[", "##\\u005b") if github.running() else found)
        return report.status
    out = console.Console(no_color=True, highlight=False, markup=False, emoji=False)
    with out.capture() as captured:
        facts = table.Table.grid(padding=(0, 2, 0, 0))
        for name, value in report.facts.items():
            if value is not None:
                facts.add_row(_text(name), _text(fact(value)))
        out.print(facts)
        for each in report.tables:
            if not len(each.rows):
                continue
            grid = table.Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
            for heading, right in zip(each.columns, each.numeric(), strict=True):
                side: Literal["left", "right"] = "right" if right else "left"
                grid.add_column(_text(heading), overflow="fold", justify=side)
            for row in each.cells():
                grid.add_row(*(_text(shown) for shown in row))
            out.print(_text(f"\n{each.heading()}"))
            if each.note:
                out.print(_text(each.note))
            out.print(grid)
        for line in advice:
            out.print(_text(f"\n{line}"))
    for line in captured.get().splitlines():
        print(github.inert(line.rstrip()))
    return report.status


def markdown(report: Report, title: str = "") -> str:
    """Return facts and tables as Markdown; no name in them is read as markup."""
    facts = [[name, fact(value)] for name, value in report.facts.items() if value is not None]
    parts = [f"## {_escaped(title)}\n"] if title else []
    parts.append(_pipes(["", ""], [False, False], facts))
    for each in report.tables:
        if len(each.rows):
            note = f"{_escaped(each.note)}\n\n" if each.note else ""
            grid = _pipes(list(each.columns), each.numeric(), each.cells())
            parts.append(f"### {_escaped(each.heading())}\n\n{note}{grid}")
    parts += [f"Note: {_escaped(note)}\n" for note in report.notes]
    return "\n".join(parts)


def _pipes(headings: Sequence[str], right: Sequence[bool], rows: Sequence[Sequence[str]]) -> str:
    sides = ["---:" if side else "---" for side in right]
    lines = [[_escaped(each) for each in row] for row in (headings, *rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (lines[0], sides, *lines[1:]))


def _escaped(said: str) -> str:
    """Return a text that Markdown shows as it is, on one line."""
    return re.sub(r"([\\`*_\[\]<>|~$&#])", r"\\\1", shown_text(said))


def _text(said: str) -> Any:
    """Return a text as it is: the name of a file may hold what steers a terminal."""
    from rich import text

    return text.Text(shown_text(said, lines=True), overflow="fold")


# ---- one value ---------------------------------------------------------------------------------


def cell(value: Any, form: str = "") -> str:
    """Return a value as a table shows it.

    Examples
    --------
    >>> cell(0.5, "± .2f"), cell(True), cell(["a", "b"]), cell(Bounded(value=117.24, error=0.1))
    ('± 0.50', 'yes', 'a, b', '117.2')
    """
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if form and not isinstance(value, str):
        sign, _, form = form.rpartition(" ")
        shown = format(float(getattr(value, "value", value)), form)
        return f"{sign} {shown}" if sign else shown
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return number(value)
    if isinstance(value, Fraction):
        return ratio(value)
    if isinstance(value, Estimated):
        return f"{number(value.value, value.standard_error)} ± {value.standard_error:.1g}"
    if isinstance(value, Certified | Bounded):
        return number(float(value.value), error_of(value))
    if isinstance(value, list | tuple):
        return ", ".join(cell(each) for each in value)
    return str(value)


def fact(value: Any) -> str:
    """Return a value as a fact shows it: a number says what it claims.

    Examples
    --------
    >>> fact(Bounded(value=117.24, error=0.101)), fact(12345), fact(Certified(value=Fraction(1, 4)))
    ('117.2 (bounded, within 0.11)', '12,345', '0.25 (certified)')
    >>> fact(Estimated(value=147.63, standard_error=1.14))
    '147.6 (estimated, standard error 1.1)'
    """
    if isinstance(value, Bounded) and math.isnan(value.value):
        return "unknown: double precision cannot bound it"
    if isinstance(value, Bounded):
        return f"{cell(value)} ({value.claim}, within {at_most(value.error)})"
    if isinstance(value, Estimated):
        error = value.standard_error
        shown = number(value.value, error / 10)
        cut = f", cut off within {at_most(value.cut_off)}" if value.cut_off else ""
        return f"{shown} ({value.claim}, standard error {error:.2g}{cut})"
    if isinstance(value, Certified):
        return f"{cell(value)} ({value.claim})"
    return cell(value)


def between(low: float, high: float, error: float = 0.0) -> str:
    """Return both ends of an interval, with the digits that an error leaves."""
    return f"{number(low, error)} to {number(high, error)}"


def error_of(number: Certified | Bounded) -> float:
    """Return how far the float of a number may be off, rounded up; 0 where it is exact."""
    if isinstance(number, Bounded):
        return number.error
    if isinstance(number.value, float):
        return 0.0  # infinite, and that is exact
    lost = abs(number.value - Fraction(float(number.value)))
    return math.nextafter(float(lost), math.inf) if lost else 0.0


def claimed(key: str, number: Claimed) -> dict[str, Any]:
    """Return a number that a result rests on: value, error bound and claim, one key each."""
    error = {} if isinstance(number, Estimated) else {"error_bound": error_of(number)}
    return {key: float(number.value), **error, "claim": number.claim}


def to_json(result: Row) -> str:
    """Return strict JSON, which names its format first."""
    return json.dumps(plain({"format": FORMAT, **result}), indent=2, allow_nan=False)


def plain(value: Any) -> Any:
    """Return the same made of what JSON has; NumPy arrays and numbers have `tolist`."""
    if isinstance(value, Mapping):
        return {str(key): plain(below) for key, below in value.items()}
    if isinstance(value, list | tuple):
        return [plain(below) for below in value]
    if isinstance(value, Certified | Bounded):
        return plain({"value": float(value.value), "error_bound": error_of(value)})
    if isinstance(value, Estimated):
        error = value.standard_error
        return plain({"value": value.value, "standard_error": error, "interval": value.interval})
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Fraction):
        return ratio(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else f"{value:g}"
    if not isinstance(value, str) and hasattr(value, "tolist"):
        return plain(value.tolist())
    return value


def _scalar(value: Any) -> Any:
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", 1) == 0 else value


def number(value: float | None, error: float = 0.0) -> str:
    """Return a number with the digits that its error leaves, ten at most; "-" for none."""
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
    """Return an error bound with two digits, rounded up so that it still holds."""
    if error == 0 or not math.isfinite(error):
        return f"{error:g}"
    return f"{Context(prec=2, rounding=ROUND_UP).create_decimal(error):g}"


def ratio(value: Fraction | float) -> str:
    """Return "p/q", or "p" for an integer, however many digits there are; "inf" or "-inf"."""
    if isinstance(value, float):
        return f"{value:g}"
    top = digits_of(value.numerator)
    return top if value.denominator == 1 else f"{top}/{digits_of(value.denominator)}"


def decimal(value: Fraction | float) -> str:
    """Return the exact decimal where there is one, otherwise "p/q"; "inf" and "-inf" too."""
    if not isinstance(value, Fraction):
        return str(value)
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
