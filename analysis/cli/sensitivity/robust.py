"""What `exact-mdp sensitivity MODEL robust --set-kind box` tells.

What `exact-mdp sensitivity MODEL robust` tells.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import (
    ROUNDED,
    SHOWN,
    Report,
    only_first,
    policy_from,
)
from exact_mdp.analysis.cli.sensitivity.options import ranges_from as stated
from exact_mdp.analysis.sensitivity.ranges import RELATIVE, Range
from exact_mdp.analysis.sensitivity.robust.box import (
    box_extreme,
    box_optimum,
    box_ranges,
    exact_value,
)
from exact_mdp.analysis.sensitivity.robust.robust import (
    SETS,
    Robust,
    ambiguity_of,
    difference,
    robust,
)
from exact_mdp.analysis.sensitivity.robust.search import BoxExtreme, BoxOptimum
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.table import LARGEST, beside, exact, shown
from exact_mdp.solvers import solve
from exact_mdp.solvers.solution import Bounded

if TYPE_CHECKING:
    from exact_mdp.mdp.care.scenario import Scenario
    from exact_mdp.mdp.io.load import Loaded


STATED = ("parameters", "ranges", "range_file", "relative", "whole")
NEAR = 1e-6  # bounds of which one number is shown


def box_report(loaded: Loaded, options: Mapping[str, Any], policy: object, form: str) -> Report:
    """Return worst and best over one shared box of the scenario's parameters.

    Parameters
    ----------
    policy : "optimal", or what `form` says, as `solvers.evaluate` takes it
    """
    if loaded.scenario is None:
        raise ModelError(
            "a shared box needs the parameters of a scenario",
            where="--set-kind box",
            fix="give a scenario, or another kind of set",
        )
    scenario, mdp = loaded.scenario, loaded.mdp
    box, radius = _ranges(scenario, options)
    optimal = isinstance(policy, str) and policy == "optimal"
    held = solve(mdp) if optimal else policy
    surest = box_optimum(scenario, box, candidates={} if optimal else {form: policy}, progress=True)
    worst = surest.candidates["optimal today" if optimal else form]
    best = box_extreme(scenario, held, box, side="best", progress=True)
    there = solve(ScenarioFamily(scenario=scenario).at(best.point)).start
    today, sure = exact_value(mdp, held), exact_value(mdp, surest.policy)
    result = {
        "start_value": float(today),
        "error_bound": _rounded(today),
        "claim": "certified",
        "policy": form,
        "set_kind": "box",
        "radius": None if radius is None else float(radius),
        "nature": "one choice of the parameters for all states",
        "worst_case": _surest(surest) | {"nominal_policy": _extreme(worst)},
        # Some policy is worth this somewhere in the box; how much more there is, is not known.
        "best_case": {
            "value": None,
            "error_bound": None,
            "low": max(best.low, there.interval[0]),
            "high": None,
            "nominal_policy": _extreme(best),
        },
        "price_of_robustness": _exact(today - sure),
        "worst_case_gain": _gain(surest.worst, worst),
        "robust_policy_value": _exact(sure),
        "box": {name: [float(span.low), float(span.high)] for name, span in box.items()},
    }
    if options.get("perception") is not None:
        result["claim_of"] = ROUNDED
    open_signs = [name for name, sign in worst.signs.items() if sign == "open"]
    facts = {
        "uncertainty": f"{len(box)} parameters within a box, shared by all states",
        "start value": f"{number(float(today))} (certified)",
        "worst case": _said(worst.low, worst.high, worst.proven),
        "best case": _said(best.low, best.high, best.proven),
        "best policy against the box": _said(surest.low, surest.high, surest.saddle),
    }
    if open_signs:
        facts["directions not proven"] = str(len(open_signs))
    rows = [
        (
            name,
            f"{float(span.low):.6g} to {float(span.high):.6g}",
            f"{float(worst.point[name]):.6g}",
            worst.signs[name],
        )
        for name, span in box.items()
    ]
    headings = ("parameter", "range", "at the worst", "value moves")
    title = f"where the worst case of {form} is"
    return result, facts, [Grid(title=title, headings=headings, rows=rows, numeric=frozenset({2}))]


def _ranges(
    scenario: Scenario, options: Mapping[str, Any]
) -> tuple[dict[str, Range], Fraction | None]:
    """Return the box that the options mean: all probabilities ± the radius unless stated."""
    if not any(options.get(name) for name in STATED):
        radius = radius_from(options, RELATIVE)
        return box_ranges(scenario, relative=radius), radius
    if options.get("radius") is not None:
        raise ModelError("both a radius and ranges", where="--radius", fix="give one of them")
    asked: dict[str, Any] = {name: options.get(name) for name in STATED}
    asked["ranges"] = asked["ranges"] or ()
    spans = stated(ScenarioFamily(scenario=scenario), asked)
    moving = {name: (span.low, span.high) for name, span in spans.items() if span.low < span.high}
    if not asked["parameters"] and not asked["ranges"] and not asked["range_file"]:
        moving.pop("discount", None)
    return box_ranges(scenario, moving), None


def _said(low: float, high: float, exact_end: bool) -> str:
    if exact_end or high - low < NEAR:
        return f"{number(high)} ({'proven' if exact_end else 'bounded'})"
    return f"from {number(low)} to {number(high)} (bounded)"


def _rounded(value: Fraction) -> float:
    """Return what a float takes away from an exact number, rounded up; 0 where nothing."""
    lost = abs(value - Fraction(float(value)))
    return float(np.nextafter(float(lost), np.inf)) if lost else 0.0


def _exact(value: Fraction) -> dict[str, float]:
    return {"value": float(value), "error_bound": _rounded(value)}


def _between(low: float, high: float) -> dict[str, float]:
    """Return the middle of bounds, how far off it may be, and the bounds."""
    middle = (low + high) / 2
    half = max(high - middle, middle - low)
    error = float(np.nextafter(half, np.inf)) if half else 0.0
    return {"value": middle, "error_bound": error, "low": low, "high": high}


def _number(found: BoxExtreme) -> dict[str, float]:
    if found.proven:
        return _exact(found.reached) | {"low": found.low, "high": found.high}
    return _between(found.low, found.high)


def _surest(found: BoxOptimum) -> dict[str, Any]:
    known = _number(found.worst) if found.saddle else _between(found.low, found.high)
    return known | {"proven_best_policy": found.saddle}


def _gain(surest: BoxExtreme, held: BoxExtreme) -> dict[str, float]:
    """Return the worst case of the best candidate less that of the policy held."""
    if surest is held:
        return {"value": 0.0, "error_bound": 0.0}
    if surest.proven and held.proven:
        return _exact(surest.reached - held.reached)
    ends = [Bounded(**_ends(each)) for each in (surest, held)]
    found = difference(*ends)
    return {"value": found.value, "error_bound": found.error}


def _ends(found: BoxExtreme) -> dict[str, float]:
    known = _between(found.low, found.high)
    return {"value": known["value"], "error": known["error_bound"]}


def _extreme(found: BoxExtreme) -> dict[str, Any]:
    return _number(found) | {
        "claim": found.value.claim,
        "exact": found.reached if found.proven else None,
        "point": {name: float(at) for name, at in found.point.items()},
        "moves": dict(found.signs),
    }


BOX = "box"
MOST_APART = 2  # the L1 distance of laws that have nothing in common
RADII = {"interval": RELATIVE, "absolute": "0.02", "l1": "0.1", "kl": "0.01", "entropy": "0.01"}
"""The radius of each kind of set unless one is given."""

MEANING = {
    "interval": "each transition probability ± {} of itself, rows on their own",
    "absolute": "each transition probability ± {}, rows on their own",
    "l1": "rows within an L1 distance of {}, on their own",
    "kl": "rows that keep the tables likely, KL(p‖q) ≤ {}, on their own",
    "entropy": "rows of relative entropy KL(q‖p) ≤ {}, on their own",
}


def robust_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return the value against nature's worst choice within sets around the tables.

    Parameters
    ----------
    options : mapping
        `set_kind` (a name in `SETS`, or "box": one shared box for the parameters of a scenario),
        `radius`, `policy`, `perception`; `parameters`, `ranges`, `range_file`, `relative` and
        `whole` for a box.
    """
    kind = options.get("set_kind") or "interval"
    if kind not in (*SETS, BOX):
        fix = suggest(kind, [*SETS, BOX])
        raise ModelError(f"unknown set {kind!r}", where="--set-kind", fix=fix)
    form = options.get("policy") or "optimal"
    policy = policy_from(loaded, {**options, "policy": form})
    if kind == BOX:
        # import

        return box_report(loaded, options, policy, form)
    for name in ("parameters", "ranges", "range_file", "relative", "whole"):
        if options.get(name):
            raise ModelError(
                "parameters and ranges are for a box",
                where="sensitivity robust",
                fix="add --set-kind box, or give --radius instead",
            )
    radius = radius_from(options, RADII[kind])
    if kind == "l1" and radius > MOST_APART:
        raise ModelError(
            f"an L1 radius of {beside(radius, Fraction(MOST_APART))}, "
            f"and no two laws are more than {MOST_APART} apart",
            where="--radius",
            fix=f"choose one from 0 to {MOST_APART}",
        )
    found = robust(loaded.mdp, ambiguity_of(loaded.mdp, kind, radius), policy=policy)
    result = {
        "start_value": found.value.value,
        "error_bound": found.value.error,
        "claim": found.value.claim,
        "policy": form,
        "set_kind": kind,
        "radius": float(radius),
        "nature": "dynamic, independent in each state and action",
        "worst_case": interval(found.robust.start) | {"nominal_policy": interval(found.worst)},
        "best_case": interval(found.optimistic.start) | {"nominal_policy": interval(found.best)},
        "price_of_robustness": interval(found.price),
        "worst_case_gain": interval(found.gain),
        "robust_policy_value": interval(found.robust_value),
        "policy_changes": _changes(found),
        "seconds": found.robust.seconds,
    }
    facts = {
        "uncertainty": MEANING[kind].format(f"{float(radius):.4g}"),
        "policy held": form,
        "price of robustness": f"{found.price.value:.6g} (where the tables are right)",
        "worst-case gain": f"{found.gain.value:.6g} (at nature's worst)",
    }
    rows = [
        ("held", found.value, found.worst, found.best),
        ("robust", found.robust_value, found.robust.start, found.robust_best),
    ]
    grids = [
        Grid(
            title="value at the start",
            headings=("policy", "tables right", "worst case", "best case"),
            rows=[(name, *(number(n.value, n.error) for n in each)) for name, *each in rows],
            numeric=frozenset({1, 2, 3}),
        )
    ]
    changed = result["policy_changes"]
    if changed:
        grids.append(
            Grid(
                title="states in which the robust policy does something else"
                + only_first(len(changed)),
                headings=("state", "held", "robust"),
                rows=[(each["state"], each["before"], each["after"]) for each in changed[:SHOWN]],
            )
        )
    return result, facts, grids


def radius_from(options: Mapping[str, Any], usual: object) -> Fraction:
    """Return the radius that the options state, at least 0, or the usual one."""
    given = options.get("radius")
    try:
        radius = exact(usual if given is None else given)
    except ModelError as error:
        raise ModelError(error.what, where="--radius", fix=error.fix) from error
    if radius < 0:
        raise ModelError(
            f"a radius of {shown(radius)}", where="--radius", fix="choose one from 0 up"
        )
    if radius > LARGEST:
        raise ModelError(
            f"a radius of {shown(radius)}, beyond the floats", where="--radius", fix="choose less"
        )
    return radius


def interval(found: Bounded) -> dict[str, float]:
    """Return a number and its error bound."""
    return {"value": found.value, "error_bound": found.error}


def _changes(found: Robust) -> list[dict[str, str]]:
    mdp, pairs = found.mdp, found.robust.pairs
    assert pairs is not None
    return [
        {
            "state": mdp.space.label(state),
            "before": " or ".join(
                mdp.actions[mdp.pair_action[pair]]
                for pair in mdp.pairs_of(state)
                if found.policy[pair] > 0
            ),
            "after": mdp.actions[mdp.pair_action[pairs[state]]],
        }
        for state in found.changed.tolist()
    ]
