"""The ranges over which parameters are varied: by default ± 20 % of today's value.

A range file is TOML: `"base.anger" = [0.02, 0.10]`, or tables that spell the dotted name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError, locate_errors, require_list, require_type, warn_user
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of, room_of
from exact_mdp.mdp.parametric.family import place_of
from exact_mdp.mdp.table import FLOAT_RANGE, exact, format_beside_limits, format_rational

RELATIVE = Fraction(1, 5)  # a share of today's value; every result states its ranges


def unit_of(parameter: Parameter) -> str:
    """Return the unit of a parameter, for tables and axes."""
    if parameter.unit is not None:
        return parameter.unit
    if parameter.name == DISCOUNT:
        return "per step"
    if is_probability(parameter):
        return "probability"
    return "number"


def is_probability(parameter: Parameter) -> bool:
    """Return whether a parameter is a number from 0 to 1 that is not the discount."""
    return parameter.name != DISCOUNT and parameter.low == 0 and parameter.high == 1


@dataclass(frozen=True, kw_only=True)
class Range:
    """The range of a parameter: two numbers or "p/q", kept exact.

    Examples
    --------
    >>> Range(low=Fraction(1), high=Fraction(0))
    Traceback (most recent call last):
    ...
    exact_mdp.mdp.errors.ModelError: the range from 1 to 0 is empty
      where: range
      fix:   put the smaller number first
    """

    low: Fraction
    high: Fraction

    if TYPE_CHECKING:  # the constructor takes any two numbers

        def __init__(self, *, low: object, high: object) -> None: ...

    def __post_init__(self) -> None:
        for end in ("low", "high"):
            object.__setattr__(self, end, exact(getattr(self, end), "range"))
        if self.low > self.high:
            raise ModelError(
                f"the range from {format_beside_limits(self.low, self.high)} "
                f"to {format_rational(self.high)} is empty",
                where="range",
                fix="put the smaller number first",
            )


class Ranges(dict[str, Range]):
    """Validated ranges by parameter name."""


Stated = Mapping[str, object] | str | Path
"""{name: (low, high)}, or the .toml file that states them."""


def make_range_around(parameter: Parameter, relative: object = RELATIVE) -> Range:
    """Return a parameter's value ± a share of it, within the parameter's limits.

    "whole" stands for the limits themselves, and for ± 100 % if there are none.
    """
    whole = isinstance(relative, str) and relative == "whole"
    if whole:
        relative = 1
    share = exact(relative, "relative")
    if not 0 < share < FLOAT_RANGE[1]:
        fix = "choose one above 0, nearer to 1"
        raise ModelError(f"a share of {format_rational(share)}", where="relative", fix=fix)
    reach = abs(parameter.value) * share
    least, most = parameter.limits
    low, high = max(parameter.value - reach, least), min(parameter.value + reach, most)
    if whole and parameter.low is not None:
        low = parameter.low
    if whole and parameter.high is not None:
        high = parameter.high
    return Range(low=low, high=high)


def restrict_range(model: Parametric, parameter: Parameter, span: Range) -> Range:
    """Return the part of a default range in which models exist, the other parameters held fixed.

    The range ends where the named probabilities of a row sum to 1. If the model at an end cannot be
    built or has no finite values, as at discount 1 if an episode may go on forever, the end is
    moved half way to today's value until it has: a discount of 9/10 ends at 19/20. A model without
    finite values today keeps its range, and its analysis refuses it.
    """
    if isinstance(model, ScenarioFamily):  # all its models can be built, and end
        return span
    least, most = room_of(model, parameter.name)
    low, high = span.low, span.high
    if least is not None:
        low = max(low, least)
    if most is not None:
        high = min(high, most)
    name, today = parameter.name, parameter.value

    def has_values(value: Fraction) -> bool:
        try:
            mdp = model.at({name: value})
        except ModelError:
            return False
        return mdp.ends.has_finite_optimum

    def find_end(end: Fraction) -> Fraction:
        """Return the end, moved towards today's value until the model has values."""
        # 2^-40 of the way is less than 10^-12 of the range, and leaves no range.
        for halvings in range(40):
            moved: Fraction = today + (end - today) / 2**halvings
            if moved == today or has_values(moved):
                return moved
        return today

    if low < high and has_values(today):
        low, high = find_end(low), find_end(high)
    return Range(low=low, high=high)


def read_ranges(model: Parametric, ranges: Stated | None) -> Ranges:
    """Return stated ranges, or the ranges in a file, checked; raise ModelError for a bad one."""
    if isinstance(ranges, Ranges):
        return ranges
    if isinstance(ranges, str | Path):
        read = flatten_entries(toml_of(read_text(ranges, most=SMALL), str(ranges)))
        flat = {".".join(filter(None, (prefix, key))): value for prefix, key, value in read}
        if not flat:
            fix = 'write "NAME" = [low, high]'
            raise ModelError("no range in the file", where=str(ranges), fix=fix)
        with locate_errors(str(ranges)):
            return read_ranges(model, flat)
    valid = Ranges()
    stated = require_type(
        ranges or {}, Mapping, "ranges", "give {name: (low, high)}, or a .toml file"
    )
    for name, given in stated.items():
        parameter = parameter_of(model, name)
        where = f"range of {name}"
        if isinstance(given, Range):
            given = (given.low, given.high)
        if not isinstance(given, list | tuple) or len(given) != 2:
            raise ModelError("not a pair of numbers", where=where, fix="give low and high")
        with locate_errors(where, instead=True):
            low, high = exact(given[0]), exact(given[1])
            parameter.check(low)
            parameter.check(high)
            if low == high:
                raise ModelError(
                    f"the range from {format_beside_limits(low, high)} "
                    f"to {format_rational(high)} is empty",
                    fix="give two different numbers",
                )
            valid[name] = Range(low=low, high=high)
    return valid


def ranges_of(
    model: Parametric,
    names: Iterable[str] | None = None,
    ranges: Stated | None = None,
    relative: object | None = None,
) -> Ranges:
    """Return the range of each parameter: the stated one, or one around today's value.

    By default `names` are all parameters with a stated range or, if there are none, all parameters;
    `relative` is 1/5.
    """
    stated = read_ranges(model, ranges)
    if names is None:
        names = list(stated) or [parameter.name for parameter in model.parameters]
    share = relative
    if relative is None:
        share = RELATIVE
    spans = Ranges()
    for name in require_list(names, "names"):
        parameter = parameter_of(model, name)
        if name in stated:
            spans[name] = stated[name]
            continue
        span = make_range_around(parameter, share)
        spans[name] = restrict_range(model, parameter, span)
        # A number below 1 that is varied beyond 1 may be a utility: ask for its limits.
        plain = parameter.unit is None and parameter.low is None and parameter.high is None
        if relative is None and plain and 0 < parameter.value < 1 < spans[name].high:
            warn_user(
                f"{name}, {format_rational(parameter.value)} today, is varied up to "
                f"{format_rational(spans[name].high)}; if it is a utility or a probability, state "
                f'Parameter(name="{name}", value=…, low=0, high=1), else its range'
            )
    return spans


def range_of(model: Parametric, name: str, ranges: object = None, relative: object = None) -> Range:
    """Return the range of one parameter; `ranges` may be its (low, high) alone."""
    if not isinstance(ranges, Mapping | str | Path | None):
        ranges = {name: ranges}
    span = ranges_of(model, [name], ranges, relative)[name]
    if span.low == span.high:
        why = "no other value has a model with finite values"
        if span.low == 0:
            why = "a share of 0 is 0"
        raise ModelError(
            f"the range of {name} has one point, {format_rational(span.low)}: {why}",
            where=place_of(model),
            fix=f'give it one: ranges={{"{name}": (low, high)}}, --range {name}=LOW:HIGH',
        )
    return span


def flatten_entries(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str, Any]]:
    """Yield the entries of nested tables: the dotted name of the table, the key, the value."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from flatten_entries(value, ".".join(filter(None, (prefix, key))))
        else:
            yield prefix, key, value


def list_usual_parameters(model: Parametric) -> list[str]:
    """Return the names of the parameters to vary together: all but the discount, unless alone.

    A relative change of the discount, as from 1 to 4/5, would outweigh all others.
    """
    names = [parameter.name for parameter in model.parameters]
    return [name for name in names if name != DISCOUNT] or names


def spans_of(
    model: Parametric,
    names: Iterable[str] | None = None,
    ranges: Stated | None = None,
    relative: object | None = None,
) -> dict[Parameter, Range]:
    """Return the parameters to vary together, with their ranges.

    Unless ranges are stated, the discount is left out, and so are parameters that are 0 today.
    """
    stated = read_ranges(model, ranges)
    names = names or list(stated) or list_usual_parameters(model)
    every = ranges_of(model, names, stated, relative)
    spans = {parameter_of(model, n): span for n, span in every.items() if span.low < span.high}
    if not spans:
        raise ModelError("no parameter has a range", where=place_of(model), fix="state a range")
    return spans
