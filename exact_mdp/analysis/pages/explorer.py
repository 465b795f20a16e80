"""The explorer: a page on which one parameter moves, and value, regret and policy move with it.

The page holds the pieces of `analysis.vary.curves.curve`: for each piece the optimal actions, the
optimal value, and the value of a policy held fixed, both as ratios of polynomials with whole
coefficients. Its script computes with whole numbers of any size, so its numbers at a rational value
are exact. At both ends of the range, at today's value and on both sides of each switching point the
optimum has been proved, the proof checked, and its value compared with the ratio's. A second
parameter moves in steps: for each of its values the pieces of the first one are computed anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from html import escape
from itertools import chain, pairwise
from math import lcm
from typing import Any

import numpy as np

from exact_mdp.analysis.layout import MOST_CELLS, arrange
from exact_mdp.analysis.optimum import actions_of
from exact_mdp.analysis.pages import render_page
from exact_mdp.analysis.vary.curves import curve as exact_curves
from exact_mdp.analysis.vary.curves.checker import RationalFunction
from exact_mdp.analysis.vary.curves.curve import ValueFunction
from exact_mdp.analysis.vary.ranges import Stated, ranges_of, unit_of
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Family, Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.result import DataFrame, Result, frame_to_table
from exact_mdp.mdp.table import format_rational
from exact_mdp.mdp.validate import Flags, require_count
from exact_mdp.solvers.exact.certify import certify_and_check

GROW = "this.style.height=this.contentDocument.documentElement.scrollHeight+20+'px'"


@dataclass(frozen=True, kw_only=True, eq=False)
class Explorer(Result):
    """The pieces of one parameter, for each value of a second one, and the page that shows them."""

    model: str  # its name
    curves: tuple[ValueFunction, ...]  # one for each value of the second parameter, or one
    second: Parameter | None = None
    grid: tuple[Fraction, ...] = ()  # the second parameter's values
    policy: str | None = None  # what the policy held fixed is called

    def __repr__(self) -> str:
        curve = self.curves[0]
        also = f", {len(self.grid)} values of {self.second.name}" if self.second else ""
        count = sum(len(each.pieces) for each in self.curves)
        low, high = format_rational(curve.range.low), format_rational(curve.range.high)
        return f"Explorer({curve.parameter.name} from {low} to {high}, {count} pieces{also})"

    def frame(self) -> DataFrame:
        """Return one row for each piece."""
        import pandas

        also = [{self.second.name: float(x)} for x in self.grid] if self.second else [{}]
        frames = [c.frame().assign(**x) for c, x in zip(self.curves, also, strict=True)]
        return pandas.concat(frames, ignore_index=True)

    def report(self) -> Report:
        """Return the pieces of the optimal value."""
        also = [self.second.name] if self.second else []
        first = self.curves[0]
        facts: dict[str, Any] = {"parameters": [first.parameter.name, *also]}
        facts |= {"pieces": len(self.frame()), "claim": Shown(first.claim), **first.criterion_facts}
        table = frame_to_table(self.frame(), f"pieces of the optimal {first.measure}")
        return Report(title="explorer", facts=facts, tables={"listed": table})

    def page(self, *, rerun: str = "") -> str:
        """Return the page; `rerun` is the command that makes it again."""
        name = self.curves[0].parameter.name
        title = f"{name}, {self.second.name}" if self.second else name
        return render_page(
            "explorer.html.j2",
            title=f"{self.model}: {title}",
            model=self.model,
            policy=self.policy,
            measure=self.curves[0].measure,
            data=_build_page_data(self),
            rerun=rerun,
        )

    def _repr_html_(self) -> str:
        # The frame grows to the page's own height where it may.
        return (
            f'<iframe title="{escape(repr(self))}" srcdoc="{escape(self.page())}" '
            f'style="width:100%;height:860px;border:0" onload="{GROW}"></iframe>'
        )


def explore(
    model: Scenario | MDP | Parametric,
    *names: str,
    ranges: Stated | None = None,
    relative: object | None = None,
    policy: PolicyLike | None = None,
    n: int = 11,
    criterion: str = "total",
) -> Explorer:
    """Return the explorer of one parameter, or of two; in a notebook it shows itself.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    *names : str
        The parameter that moves, and perhaps a second one that moves in steps.
    ranges : {name: (low, high)}, optional
        Today's value ± 20 % unless given, within what the model admits.
    relative : number, optional
        A share other than 20 %, or "whole".
    policy : PolicyLike, optional
        A policy held fixed, whose value and regret are shown.
    n : int
        Values of the second parameter, from 2 to 101, evenly spaced; today's is added.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    Explorer

    Raises
    ------
    ModelError
        For no parameter or more than two, and as `thresholds` does.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> explore(MDP.from_outcomes(rows, "9/10"), "discount", policy="random")
    Explorer(discount from 0.72 to 0.95, 2 pieces)
    """
    if not all(isinstance(name, str) for name in names):
        raise ModelError(
            "names of parameters are texts", where="explorer", fix='write explore(model, "name")'
        )
    if not 1 <= len(set(names)) == len(names) <= 2:
        raise ModelError(
            f"{len(names)} parameters, or one twice", where="explorer", fix="name one or two"
        )
    if not 2 <= require_count(n, "n", 2) <= 101:
        raise ModelError(f"{n} values", where="explorer", fix="choose from 2 to 101")
    # The ranges; each has to leave room to move.
    family = parametric(model)
    spans = ranges_of(family, names, ranges, relative)
    for name, span in spans.items():
        if span.low == span.high:
            raise ModelError(f"{name} has no range", where="explorer", fix="state a range")
    # The family for each value of the second parameter, today's value among them.
    second, grid, models = None, list[Fraction](), [(f"explorer of {names[0]}", family)]
    if len(names) == 2:
        second, span = parameter_of(family, names[1]), spans[names[1]]
        steps = {span.low + (span.high - span.low) * k / (n - 1) for k in range(n)}
        grid = sorted(steps | {x for x in (second.value,) if span.low <= x <= span.high})
        models = []
        for x in grid:
            models.append((f"{names[1]} = {format_rational(x)}", held_at(family, names[1], x)))
    # One curve for each of them; at some points its value is compared with a proven optimum.
    curves = []
    for where, here in models:
        with locate_errors(where):
            held: dict[str, Any] = {"policy": policy, "criterion": criterion}
            curve = exact_curves.curve(here, names[0], spans[names[0]], **held)
            for point in list_certified_points(curve):
                proof = certify_and_check(here.at({names[0]: point}), criterion)
                if proof.start_value != curve.at(point):
                    raise ModelError(
                        "the rows of the model do not follow the polynomials of the curve",
                        where=f"parameter {names[0]} = {format_rational(point)}",
                        fix=f'state breaks={{"{names[0]}": [value, …]}} where the formula changes',
                    )
        curves.append(curve)
    return Explorer(
        model=family.name or "model",
        curves=tuple(curves),
        second=second,
        grid=tuple(grid),
        policy=policy if policy is None or isinstance(policy, str) else "the policy",
    )


def held_at(family: Parametric, name: str, value: Fraction) -> Parametric:
    """Return the family with another value of a parameter that does not move."""
    if isinstance(family, ScenarioFamily):
        return replace(family, scenario=family.scenario.with_(parameters={name: value}), base=None)
    if isinstance(family, Family):
        moved = (replace(p, value=value) if p.name == name else p for p in family.parameters)
        return replace(family, parameters=tuple(moved))
    raise ModelError(
        f"the parameters of {family.name} cannot be held",
        where=f"parameter {name}",
        fix="give a scenario, a model or a Family, or one parameter alone",
    )


def list_certified_points(curve: ValueFunction) -> list[Fraction]:
    """Return the values of the parameter at which the optimum is proved, in rising order."""
    low, high, today = curve.range.low, curve.range.high, curve.parameter.value
    ends = set()
    for piece in curve.pieces:
        for end in (*piece.low, *piece.high):
            ends.add(end)
    return sorted({low, high, min(max(today, low), high)} | ends)


# ---- what the script of the page reads ---------------------------------------------------------


def _build_page_data(explorer: Explorer) -> dict[str, Any]:
    first = explorer.curves[0]
    mdp, layout = first.mdp, arrange(first.mdp)
    known: dict[tuple[str, ...], int] = {}

    def number_action_sets(pairs: Flags) -> list[int]:
        """Return the number of the set of actions, by pairs (L,), of each state."""
        return [known.setdefault(each, len(known)) for each in actions_of(mdp, pairs)]

    # Curves hold numbers of action sets; a set that occurs often is listed once.
    drawn = layout.cells <= MOST_CELLS
    curves = [_encode_curve(curve, number_action_sets) for curve in explorer.curves]
    taken = None if first.chain is None else number_action_sets(first.chain.chosen > 0)
    # States whose optimal actions change somewhere.
    sets = []
    for curve in curves:
        sets += [piece["sets"] for piece in curve["pieces"]]
    every = np.array(sets)
    moving = np.flatnonzero((every != every[0]).any(axis=0)).tolist()
    for curve in curves:  # of each piece but the first, only what has changed
        pieces = curve["pieces"]
        for before, piece in reversed([*pairwise(pieces)]):
            both = zip(before["sets"], piece["sets"], strict=True)
            piece["turns"] = [(s, now) for s, (old, now) in enumerate(both) if old != now]
            del piece["sets"]
    states = layout.shown.tolist() if drawn else moving
    return {
        "parameter": _encode_parameter(first.parameter),
        "low": _encode_rational(first.range.low),
        "high": _encode_rational(first.range.high),
        "steps": 1000,  # of the slider
        "second": explorer.second and _encode_parameter(explorer.second),
        "grid": [_encode_rational(value) for value in explorer.grid],
        "curves": curves,
        "sets": [list(each) for each in known],
        "signs": [*layout.signs.items()],
        "taken": taken,
        "sense": mdp.sense,
        "measure": first.measure,
        "idle": np.flatnonzero(~mdp.ends.must_choose).tolist(),
        "ends": np.flatnonzero(mdp.over).tolist(),
        "labels": {state: mdp.space.label(state) for state in states},
        "moving": moving,
        "map": drawn
        and {
            "caption": f"down: {layout.down}; across: {layout.across}",
            "rows": layout.rows,
            "columns": layout.columns,
            "listed": layout.listed,
            "cells": [[s, int(layout.row[s]), int(layout.column[s])] for s in states],
        },
        "checked": first.checked,
        "bounds": sum(len(list_certified_points(curve)) for curve in explorer.curves),
    }


def _encode_curve(curve: ValueFunction, numbers: Callable[[Flags], list[int]]) -> dict[str, Any]:
    """Return the pieces of a curve, and the different values of the policy held fixed."""
    fixed = list(dict.fromkeys(piece.fixed for piece in curve.pieces if piece.fixed is not None))
    pieces = []
    for piece in curve.pieces:
        pieces.append(
            {
                "low": [_encode_rational(end) for end in piece.low],
                "high": [_encode_rational(end) for end in piece.high],
                "value": _encode_polynomials(piece.value),
                "fixed": fixed.index(piece.fixed) if piece.fixed is not None else None,
                "sets": numbers(piece.optimal),
            }
        )
    return {
        "pieces": pieces,
        "fixed": [_encode_polynomials(each) for each in fixed],
        "certified": [_encode_rational(point) for point in list_certified_points(curve)],
    }


def _encode_parameter(own: Parameter) -> dict[str, str]:
    return {"name": own.name, "unit": unit_of(own), "today": _encode_rational(own.value)}


def _encode_rational(number: Fraction) -> str:
    """Return a rational in hexadecimal, "p/q": no number of digits is too large."""
    return f"{number.numerator:x}/{number.denominator:x}"


def _encode_polynomials(ratio: RationalFunction) -> list[list[str]]:
    """Return the coefficients of N and of D, times a number that makes them whole."""
    both: tuple[Sequence[Fraction], ...] = (ratio.numerator, ratio.denominator)
    scale = lcm(*(c.denominator for c in chain(*both)))
    coded = []
    for part in both:
        coded.append([f"{int(c * scale):x}" for c in part])
    return coded
