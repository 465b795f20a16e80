"""What a result says of itself, once: text, JSON, Markdown and HTML are made from it.

    type                in JSON                                  for people
    Certified, Bounded  {"value": x, "error_bound": e}           117.07 (bounded, within 2e-12)
    Estimated           {"value": x, "standard_error": e, ...}   117.1 (estimated, standard error 2)
    Fraction            "p/q"                                    p/q, where that is short
    float               as Python's repr, which is exact         ten digits at most
    NaN, None           null                                     - in a table, no fact
    infinity            "inf", "-inf"                            inf, -inf
    bool                true, false                              yes, no
    dataclass           an object of its fields                  the same

The types of numbers are known by their `claim`, and by `error` or `standard_error`.
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
import numpy as np

from exact_mdp.mdp.errors import shown_text
from exact_mdp.mdp.table import format_rational

FORMAT = 2  # of the JSON: another number where a key changes its meaning or goes
DIGITS = 10  # significant digits of a number in a table
SHORT = 12  # letters of an exact number; of a longer one, its digits
SHOWN = 40  # rows of a table
ON_A_LINE = 6  # entries of a mapping that is a fact, not a table
TEMPLATE = Path(__file__).with_suffix(".html.j2")


@dataclass(frozen=True)
class Shown:
    """A value of the JSON, and what people see instead: nothing unless `text` is given."""

    value: Any
    text: Any = None


@dataclass(frozen=True, kw_only=True)
class Table:
    """How people see rows: of a table or of mappings; None for those of the fact of the same key.

    `columns` are {heading: "key" or "key:format"}, with a format as Python's `format` takes it
    (".4g", ".1%") and possibly a sign before it ("± .2g"). The `first` rows are shown, and the
    title says where there are more; `note` is a line below the title.
    """

    title: str
    columns: Mapping[str, str]
    rows: Any = None
    first: int = SHOWN
    note: str = ""
    count: int = 0  # rows that there are, where `rows` are only the first

    def heading(self) -> str:
        """Return the title, with the number of rows where not all are shown."""
        more = f" (the first {self.first:,} of {len(self.rows):,}; --json prints all)"
        return self.title + (more if len(self.rows) > self.first else "")

    def values(self) -> list[list[Any]]:
        """Return the values of the rows that are shown."""
        rows = self.rows[: self.first]
        rows = rows.to_dict("records") if hasattr(rows, "to_dict") else rows
        keys = [column.partition(":")[0] for column in self.columns.values()]
        each = [[row.get(key) for key in keys] for row in rows]
        return [[x.item() if isinstance(x, np.generic) else x for x in row] for row in each]

    def cells(self) -> list[list[str]]:
        """Return the texts of the rows that are shown."""
        forms = [column.partition(":")[2] for column in self.columns.values()]
        return [[*map(format_cell, row, forms)] for row in self.values()]

    def numeric(self) -> list[bool]:
        """Return which columns hold numbers alone."""
        return [
            all(value is None or isinstance(value, int | float | Fraction) or _has_claim(value)
                for value in column)
            and any(value is not None and not isinstance(value, bool) for value in column)
            for column in zip(*self.values(), strict=True)
        ] or [False] * len(self.columns)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a result says: a title of one line, facts, and notes beside them.

    `facts` are the JSON object. People read each as a line, with blanks for the key's underscores;
    a mapping, or a list of mappings, as a table; None and what is empty not at all. `tables` say
    how rows are shown that deserve better; those of a key that is no fact are for people alone.
    Where `passed` is False, the exit status is 1.
    """

    title: str
    facts: Mapping[str, Any]
    tables: Mapping[str, Table] = field(default_factory=dict)
    notes: Sequence[str] = ()
    passed: bool | None = None

    def json(self, **more: Any) -> str:
        """Return strict JSON, which names its format first."""
        content = {"format": FORMAT, **self.facts, **more}
        return json.dumps(to_json_values(content), indent=2, allow_nan=False)

    def lines(self) -> dict[str, str]:
        """Return the facts that are lines, for people."""
        return {
            key.replace("_", " "): format_fact(value)
            for key, value in self._seen()
            if key not in self.tables and not _is_table(value)
        }

    def shown_tables(self) -> list[Table]:
        """Return the tables that have rows."""
        tables = []
        for key, value in self._seen():
            if key not in self.tables and _is_table(value):
                tables.append(_build_table(key.replace("_", " "), value))
        for key, table in self.tables.items():
            rows = self.facts.get(key) if table.rows is None else table.rows
            rows = rows.value if isinstance(rows, Shown) else rows
            if rows is not None and len(rows):
                rows = _list_rows(rows) if isinstance(rows, Mapping) else rows
                tables.append(replace(table, rows=rows))
        return tables

    def html(self, first: int) -> str:
        """Return what a notebook shows: title, notes, lines, and the first rows of tables."""
        return str(load_template(TEMPLATE).module.notebook(self, first))

    def _seen(self) -> Iterator[tuple[str, Any]]:
        for key, value in self.facts.items():
            value = value.text if isinstance(value, Shown) else value
            if value is not None and not (hasattr(value, "__len__") and not len(value)):
                yield key, value


def _is_table(value: Any) -> bool:
    if isinstance(value, Mapping):
        return len(value) > ON_A_LINE or any(isinstance(v, Mapping) for v in value.values())
    return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)


def _list_rows(named: Mapping[Any, Any]) -> list[dict[str, Any]]:
    return [
        {"": str(name), **(value if isinstance(value, Mapping) else {"value": value})}
        for name, value in named.items()
    ]


def _build_table(title: str, value: Any) -> Table:
    """Return the table of a mapping or of a list of mappings: the columns without nested values."""
    rows = _list_rows(value) if isinstance(value, Mapping) else list(value)
    keys = [*dict.fromkeys(key for row in rows for key in row)]

    def is_flat(value: Any) -> bool:
        return not isinstance(value, Mapping) and (_has_claim(value) or not is_dataclass(value))

    shown = [key for key in keys if all(is_flat(row.get(key)) for row in rows)]
    return Table(title=title, rows=rows, columns={key.replace("_", " "): key for key in shown})


@cache
def load_template(path: Path) -> Any:
    r"""Return a template of HTML, which may import that of reports; an undefined name is an error.

    Names stay text: jinja2 escapes what stands in elements and attributes, `tojson` what a script
    reads, and characters that steer a terminal or turn text around are written as `\x1b`.
    """
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FileSystemLoader([path.parent, TEMPLATE.parent]),
        undefined=jinja2.StrictUndefined,
        autoescape=True,
        finalize=lambda value: shown_text(value, lines=True) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    ).get_template(path.name)


def list_claim_facts(key: str, number: Any) -> dict[str, Any]:
    """Return a number that a result rests on: value, error bound and claim, one key each."""
    error = {} if hasattr(number, "standard_error") else {"error_bound": Shown(error_of(number))}
    return {key: Shown(float(number.value), number), **error, "claim": Shown(number.claim)}


# ---- one value -----------------------------------------------------------------------------------


def _has_claim(value: Any) -> bool:
    return hasattr(value, "claim") and hasattr(value, "value")


def to_json_values(value: Any) -> Any:
    """Return the same made of what JSON has; NumPy arrays and numbers have `tolist`."""
    if isinstance(value, Shown):
        return to_json_values(value.value)
    if isinstance(value, Mapping):
        return {str(key): to_json_values(below) for key, below in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(below) for below in value]
    if _has_claim(value) and hasattr(value, "standard_error"):
        error = value.standard_error
        return to_json_values(
            {"value": value.value, "standard_error": error, "interval": value.interval}
        )
    if _has_claim(value):
        return to_json_values({"value": float(value.value), "error_bound": error_of(value)})
    if is_dataclass(value):
        return {each.name: to_json_values(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Fraction):
        return format_ratio(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else f"{value:g}"
    if not isinstance(value, str) and hasattr(value, "tolist"):
        return to_json_values(value.tolist())
    return value


def format_cell(value: Any, form: str = "") -> str:
    """Return a value as a table shows it."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if form and not isinstance(value, str):
        sign, _, form = form.rpartition(" ")
        text = format(float(getattr(value, "value", value)), form)
        return f"{sign} {text}" if sign else text
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return format_number(value)
    if isinstance(value, Fraction):
        text = format_ratio(value)
        return text if len(text) <= SHORT else format_rational(value, DIGITS)
    if _has_claim(value) and hasattr(value, "standard_error"):
        error = value.standard_error
        off = f" ± {format_number(float(f'{error:.1g}'))}" if math.isfinite(error) else ""
        return f"{format_number(value.value, error if off else 0.0)}{off}"
    if _has_claim(value):
        return format_number(float(value.value), error_of(value))
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {format_cell(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(format_cell(each) for each in value)
    return str(value)


def format_fact(value: Any) -> str:
    """Return a value as a fact shows it: a number says what it claims."""
    if not _has_claim(value):
        return format_cell(value)
    if math.isnan(value.value):
        return "unknown: double precision cannot bound it"
    if hasattr(value, "standard_error"):
        error = value.standard_error
        if not math.isfinite(error):
            return f"{format_number(value.value)} ({value.claim}, of one draw)"
        cut = f", cut off within {format_error_bound(value.cut_off)}" if value.cut_off else ""
        said = f"{value.claim}, standard error {error:.2g}{cut}"
        return f"{format_number(value.value, error / 10)} ({said})"
    within = f", within {format_error_bound(value.error)}" if hasattr(value, "error") else ""
    return f"{format_cell(value)} ({value.claim}{within})"


def format_interval(low: float, high: float, error: float = 0.0) -> str:
    """Return both ends of an interval, with the digits that an error leaves."""
    return f"{format_number(low, error)} to {format_number(high, error)}"


def error_of(claimed: Any) -> float:
    """Return how far the float of a number may be off, rounded up; 0 where it is exact."""
    if hasattr(claimed, "error"):
        return float(claimed.error)
    if isinstance(claimed.value, float):
        return 0.0  # infinite, and that is exact
    lost = abs(claimed.value - Fraction(float(claimed.value)))
    return math.nextafter(float(lost), math.inf) if lost else 0.0


def format_number(value: float | None, error: float = 0.0) -> str:
    """Return a number with the digits that its error leaves, ten at most; "-" for none."""
    if value is None or math.isnan(value):
        return "-"
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
    """Return "p/q", or "p" for an integer, however many digits there are; "inf" or "-inf"."""
    if isinstance(value, float):
        return f"{value:g}"
    top = digits_of(value.numerator)
    return top if value.denominator == 1 else f"{top}/{digits_of(value.denominator)}"


def format_decimal(value: Fraction | float) -> str:
    """Return the exact decimal where there is one, otherwise "p/q"; "inf" and "-inf" too."""
    if not isinstance(value, Fraction):
        return str(value)
    top, bottom = value.numerator, value.denominator
    with localcontext(prec=top.bit_length() + bottom.bit_length() + 1) as context:
        context.traps[Inexact] = True
        try:
            return f"{Decimal(top) / Decimal(bottom):f}"
        except Inexact:
            return format_ratio(value)


def digits_of(whole: int) -> str:
    """Return an integer's decimal digits: Python itself refuses over 4,300."""
    return str(flint.fmpz(whole))
