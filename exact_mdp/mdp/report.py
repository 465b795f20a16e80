"""Reports: the content of a result, from which text, JSON, Markdown and HTML are made.

    type                in JSON                                  for people
    Certified, Bounded  {"value": x, "error_bound": e}           117.07 (bounded, within 2e-12)
    Estimated           {"value": x, "standard_error": e, ...}   117.1 (estimated, standard error 2)
    Fraction            "p/q"                                    p/q, if that is short
    float               as Python's repr, which is exact         ten digits at most
    NaN, None           null                                     - in a table, no fact
    infinity            "inf", "-inf"                            inf, -inf
    bool                true, false                              yes, no
    dataclass           an object of its fields                  the same

The types of numbers are recognised by their attributes `claim` and `error` or `standard_error`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from decimal import ROUND_UP, Context, Decimal, Inexact, localcontext
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import flint

from exact_mdp.mdp.errors import JSON_FORMAT, shown_text
from exact_mdp.mdp.table import format_rational, to_python_number

# Significant digits of a number in a table: more would show rounding errors, which differ between
# machines; fewer would hide differences between policies that are nearly as good.
DIGITS = 10
MOST_LISTED = 1000  # states, rows or returns that a report lists one by one; files have them all
TEMPLATE = Path(__file__).with_suffix(".html.j2")


@dataclass(frozen=True)
class Shown:
    """A value of the JSON, and the text shown to people instead; by default it is not shown."""

    value: Any
    text: Any = None


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table as people see it: its title, its columns and the number of rows to show.

    `rows` are a data frame or a list of mappings; None takes the rows of the fact with the same
    key. `columns` are {heading: "key" or "key:format"}, with a format for Python's `format`
    (".4g", ".1%") and possibly a sign before it ("± .2g"). Only the `first` rows are shown; the
    title says if there are more. `note` is a line below the title.
    """

    title: str
    columns: Mapping[str, str]
    rows: Any = None
    first: int = 40
    note: str = ""
    count: int = 0  # the number of all rows, if `rows` has only the first of them

    def format_heading(self) -> str:
        """Return the title, with the number of rows if not all are shown."""
        if len(self.rows) <= self.first:
            return self.title
        return f"{self.title} (the first {self.first:,} of {len(self.rows):,}; --json prints all)"

    def values(self) -> list[list[Any]]:
        """Return the values of the rows that are shown."""
        rows = self.rows[: self.first]
        if hasattr(rows, "to_dict"):  # a data frame
            rows = rows.to_dict("records")
        keys = [column.partition(":")[0] for column in self.columns.values()]
        shown = []
        for row in rows:
            shown.append([to_python_number(row.get(key)) for key in keys])
        return shown

    def cells(self) -> list[list[str]]:
        """Return the texts of the rows that are shown."""
        forms = [column.partition(":")[2] for column in self.columns.values()]
        return [[*map(format_cell, row, forms)] for row in self.values()]

    def numeric(self) -> list[bool]:
        """Return for each column whether it holds numbers only."""
        values = self.values()
        if not values:
            return [False] * len(self.columns)
        return [_is_numeric(column) for column in zip(*values, strict=True)]


def _is_numeric(column: Sequence[Any]) -> bool:
    """Return whether all values of a column are numbers or missing, and one is a real number."""
    for value in column:
        number = isinstance(value, int | float | Fraction) or _has_claim(value)
        if value is not None and not number:
            return False
    return any(value is not None and not isinstance(value, bool) for value in column)


@dataclass(frozen=True, kw_only=True)
class Report:
    """The content of a result: a title of one line, facts, tables and notes.

    `facts` are the JSON object. In text output each fact is a line, with spaces for the key's
    underscores; a mapping, or a list of mappings, is a table; None and empty facts are omitted.
    `tables` give the layout of a fact's table; those with a key that is not a fact are not in the
    JSON. If `passed` is False, the exit status is 1.
    """

    title: str
    facts: Mapping[str, Any]
    tables: Mapping[str, Table] = field(default_factory=dict)
    notes: Sequence[str] = ()
    passed: bool | None = None

    def json(self, **more: Any) -> str:
        """Return strict JSON, with its format first."""
        content = {"format": JSON_FORMAT, **self.facts, **more}
        return json.dumps(to_json_values(content), indent=2, allow_nan=False)

    def lines(self) -> dict[str, str]:
        """Return the facts that are shown as lines, {name: text}."""
        lines = {}
        for key, value in self._list_visible():
            if key not in self.tables and not _is_table(value):
                lines[key.replace("_", " ")] = format_fact(value)
        return lines

    def shown_tables(self) -> list[Table]:
        """Return the tables that have rows."""
        tables = []
        # Facts without a layout of their own.
        for key, value in self._list_visible():
            if key not in self.tables and _is_table(value):
                tables.append(_build_table(key.replace("_", " "), value))
        # Tables with a layout; a table without rows of its own takes the rows of a fact.
        for key, table in self.tables.items():
            rows = table.rows
            if rows is None:
                rows = self.facts.get(key)
            if isinstance(rows, Shown):
                rows = rows.value
            if rows is None or not len(rows):
                continue
            if isinstance(rows, Mapping):
                rows = _list_rows(rows)
            tables.append(replace(table, rows=rows))
        return tables

    def html(self, first: int) -> str:
        """Return the HTML for a notebook: title, notes, lines, and the first rows of tables."""
        return str(load_template(TEMPLATE).module.notebook(self, first))

    def _list_visible(self) -> Iterator[tuple[str, Any]]:
        """Yield the keys and values of the facts that people see."""
        for key, value in self.facts.items():
            if isinstance(value, Shown):
                value = value.text
            empty = hasattr(value, "__len__") and not len(value)
            if value is not None and not empty:
                yield key, value


def _is_table(value: Any) -> bool:
    """Return whether a fact is shown as a table: a long or nested mapping, or a list of them."""
    if isinstance(value, Mapping):
        return len(value) > 6 or any(isinstance(v, Mapping) for v in value.values())
    return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)


def _list_rows(named: Mapping[Any, Any]) -> list[dict[str, Any]]:
    """Return the rows of a mapping: its keys in a first column without a heading."""
    rows = []
    for name, value in named.items():
        if not isinstance(value, Mapping):
            value = {"value": value}
        rows.append({"": str(name), **value})
    return rows


def _build_table(title: str, value: Any) -> Table:
    """Return the table of a mapping or of a list of mappings: the columns without nested values."""
    if isinstance(value, Mapping):
        rows = _list_rows(value)
    else:
        rows = list(value)
    # All keys, in the order in which they first occur.
    keys: dict[str, None] = {}
    for row in rows:
        keys |= dict.fromkeys(row)

    def is_flat(value: Any) -> bool:
        return not isinstance(value, Mapping) and (_has_claim(value) or not is_dataclass(value))

    shown = []
    for key in keys:
        if all(is_flat(row.get(key)) for row in rows):
            shown.append(key)
    return Table(title=title, rows=rows, columns={key.replace("_", " "): key for key in shown})


@cache
def load_template(path: Path) -> Any:
    r"""Return an HTML template, which may import the template of reports.

    An undefined name is an error. Names stay text: jinja2 escapes the content of elements and
    attributes, `tojson` escapes data for scripts, and characters that steer a terminal or change
    the direction of text are written as `\x1b`.
    """
    import jinja2

    def escape_unsafe(value: Any) -> Any:
        if type(value) is str:
            return shown_text(value, lines=True)
        return value

    return jinja2.Environment(
        loader=jinja2.FileSystemLoader([path.parent, TEMPLATE.parent]),
        undefined=jinja2.StrictUndefined,
        autoescape=True,
        finalize=escape_unsafe,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    ).get_template(path.name)


def list_claim_facts(key: str, number: Any) -> dict[str, Any]:
    """Return the facts of a result's main number: value, error bound and claim."""
    facts = {key: Shown(float(number.value), number)}
    if not hasattr(number, "standard_error"):
        facts["error_bound"] = Shown(error_of(number))
    return facts | {"claim": Shown(number.claim)}


# ---- one value -----------------------------------------------------------------------------------


def _has_claim(value: Any) -> bool:
    """Return whether a value is a number with a claim: certified, bounded, estimated."""
    return hasattr(value, "claim") and hasattr(value, "value")


def to_json_values(value: Any) -> Any:
    """Return a value made of JSON types only."""
    if isinstance(value, Shown):
        return to_json_values(value.value)
    if isinstance(value, Mapping):
        return {str(key): to_json_values(below) for key, below in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(below) for below in value]
    # Numbers with a claim.
    if _has_claim(value) and hasattr(value, "standard_error"):
        error = value.standard_error
        return to_json_values(
            {"value": value.value, "standard_error": error, "interval": value.interval}
        )
    if _has_claim(value):
        return to_json_values({"value": float(value.value), "error_bound": error_of(value)})
    if is_dataclass(value):
        return {each.name: to_json_values(getattr(value, each.name)) for each in fields(value)}
    # Numbers that JSON lacks: rationals, NaN and infinity.
    if isinstance(value, Fraction):
        return format_ratio(value)
    if isinstance(value, float) and math.isnan(value):
        return None
    if isinstance(value, float) and math.isinf(value):
        return f"{value:g}"
    # NumPy arrays and numbers.
    if not isinstance(value, str) and hasattr(value, "tolist"):
        return to_json_values(value.tolist())
    return value


def format_cell(value: Any, form: str = "") -> str:
    """Return a value as a table shows it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    # A column with a format of its own, perhaps after a sign: "± .2g".
    if form and not isinstance(value, str):
        sign, _, form = form.rpartition(" ")
        text = format(float(getattr(value, "value", value)), form)
        if sign:
            text = f"{sign} {text}"
        return text
    # Otherwise the type decides.
    if isinstance(value, bool):
        return {True: "yes", False: "no"}[value]
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return format_number(value)
    if isinstance(value, Fraction):
        text = format_ratio(value)
        if len(text) > 12:  # too wide for a column
            return format_rational(value, DIGITS)
        return text
    if _has_claim(value) and hasattr(value, "standard_error"):
        error = value.standard_error
        if not math.isfinite(error):
            return format_number(value.value)
        error = float(f"{error:.2g}")
        return f"{format_number(value.value, error / 10)} ± {format_number(error)}"
    if _has_claim(value):
        return format_number(float(value.value), error_of(value))
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {format_cell(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(format_cell(each) for each in value)
    return str(value)


def format_fact(value: Any) -> str:
    """Return a value as the line of a fact shows it: a number with its claim and error."""
    if not _has_claim(value):
        return format_cell(value)
    if math.isnan(value.value):
        return "unknown: double precision cannot bound it"
    # Estimates have a standard error, and perhaps a bound for the steps that were cut off.
    if hasattr(value, "standard_error"):
        error = value.standard_error
        if not math.isfinite(error):
            return f"{format_number(value.value)} ({value.claim}, of one draw)"
        claim = f"{value.claim}, standard error {float(f'{error:.2g}'):g}"
        if value.cut_off:
            claim += f", cut off within {format_error_bound(value.cut_off)}"
        return f"{format_number(value.value, error / 10)} ({claim})"
    # Bounded numbers have an error bound; certified ones are exact.
    claim = str(value.claim)
    if hasattr(value, "error"):
        claim += f", within {format_error_bound(value.error)}"
    return f"{format_cell(value)} ({claim})"


def format_interval(low: float, high: float, error: float = 0.0) -> str:
    """Return both ends of an interval, with as many digits as the error justifies."""
    return f"{format_number(low, error)} to {format_number(high, error)}"


def error_of(claimed: Any) -> float:
    """Return a bound on the error of a number as a float, rounded up; 0 if it is exact."""
    if hasattr(claimed, "error"):
        return float(claimed.error)
    if isinstance(claimed.value, float):  # infinity, which is exact
        return 0.0
    # The error of an exact rational is the rounding to a float.
    lost = abs(claimed.value - Fraction(float(claimed.value)))
    if not lost:
        return 0.0
    return math.nextafter(float(lost), math.inf)


def format_number(value: float | None, error: float = 0.0) -> str:
    """Return a number with at most ten digits, fewer if its error is large; "-" for none."""
    if value is None or math.isnan(value):
        return "-"
    # The last digit shown has the place of the leading digit of the error.
    digits = DIGITS
    if 0 < error < math.inf and 0 < abs(value) < math.inf:
        places = math.floor(math.log10(abs(value))) - math.floor(math.log10(error)) + 1
        digits = min(DIGITS, max(places, 1))
    # Python writes 1e+02 for 117 at one digit; people read 100 more easily.
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.{DIGITS}g}"


def format_error_bound(error: float) -> str:
    """Return an error bound with two digits, rounded up so that it still holds."""
    if error == 0 or not math.isfinite(error):
        return f"{error:g}"
    return f"{Context(prec=2, rounding=ROUND_UP).create_decimal(error):g}"


def format_ratio(value: Fraction | float) -> str:
    """Return "p/q", or "p" for an integer, with all digits; "inf" or "-inf" for infinity."""
    if isinstance(value, float):
        return f"{value:g}"
    top = digits_of(value.numerator)
    if value.denominator == 1:
        return top
    return f"{top}/{digits_of(value.denominator)}"


def format_decimal(value: Fraction | float) -> str:
    """Return the exact decimal of a number if it is finite, else "p/q"; "inf" for infinity."""
    if not isinstance(value, Fraction):
        return str(value)
    top, bottom = value.numerator, value.denominator
    # A finite decimal has at most as many digits as numerator and denominator have bits.
    with localcontext(prec=top.bit_length() + bottom.bit_length() + 1) as context:
        context.traps[Inexact] = True
        try:
            return f"{Decimal(top) / Decimal(bottom):f}"
        except Inexact:
            return format_ratio(value)


def digits_of(whole: int) -> str:
    """Return the decimal digits of an integer; Python itself refuses more than 4,300."""
    return str(flint.fmpz(whole))
