"""The worst case within sets around the tables: the kind robust."""

from __future__ import annotations

from fractions import Fraction
from math import inf, nextafter
from typing import Any

from exact_mdp.analysis.cli.render import Report, Table, cell, claimed, plain
from exact_mdp.analysis.cli.sensitivity.options import ROUNDED, STATED, Asked, stated_ranges
from exact_mdp.analysis.sensitivity.ranges import RELATIVE, Range
from exact_mdp.analysis.sensitivity.robust.box import (
    BoxExtreme,
    BoxOptimum,
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
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.table import LARGEST, beside, exact, shown
from exact_mdp.solvers import solve
from exact_mdp.solvers.solution import Bounded, Certified

BOX = "box"
MOST_APART = 2  # the L1 distance of laws that have nothing in common
NEAR = 1e-6  # bounds of which one number is shown
RADII = {"interval": RELATIVE, "absolute": "0.02", "l1": "0.1", "kl": "0.01", "entropy": "0.01"}
"""The radius of each kind of set unless one is given."""

MEANING = {
    "interval": "each transition probability ± {} of itself, rows on their own",
    "absolute": "each transition probability ± {}, rows on their own",
    "l1": "rows within an L1 distance of {}, on their own",
    "kl": "rows that keep the tables likely, KL(p‖q) ≤ {}, on their own",
    "entropy": "rows of relative entropy KL(q‖p) ≤ {}, on their own",
}


def robust_report(asked: Asked) -> Report:
    """Return the value against nature's worst choice within sets around the tables."""
    kind = asked["set_kind"] or "interval"
    if kind == BOX:
        return _box_report(asked)
    if kind not in SETS:
        raise ModelError(
            f"unknown set {kind!r}", where="--set-kind", fix=suggest(kind, [*SETS, BOX])
        )
    if any(asked[name] for name in ("parameters", *STATED)):
        raise ModelError(
            "parameters and ranges are for a box",
            where="sensitivity robust",
            fix="add --set-kind box, or give --radius instead",
        )
    radius = _radius(asked, RADII[kind])
    if kind == "l1" and radius > MOST_APART:
        raise ModelError(
            f"an L1 radius of {beside(radius, Fraction(MOST_APART))}, "
            f"but no two distributions are more than {MOST_APART} apart",
            where="--radius",
            fix=f"choose one from 0 to {MOST_APART}",
        )
    mdp = asked.loaded.mdp
    found = robust(mdp, ambiguity_of(mdp, kind, radius), policy=asked.policy)
    changes = _changes(found)
    result = claimed("start_value", found.value) | {
        "policy": asked.form,
        "set_kind": kind,
        "radius": float(radius),
        "nature": "dynamic, independent in each state and action",
        "worst_case": plain(found.robust.start) | {"nominal_policy": found.worst},
        "best_case": plain(found.optimistic.start) | {"nominal_policy": found.best},
        "price_of_robustness": found.price,
        "worst_case_gain": found.gain,
        "robust_policy_value": found.robust_value,
        "policy_changes": changes,
        "seconds": found.robust.seconds,
    }
    facts = {
        "start value": found.value,
        "uncertainty": MEANING[kind].format(f"{float(radius):.4g}"),
        "policy held": asked.form,
        "price of robustness": f"{cell(found.price)} (where the tables are right)",
        "worst-case gain": f"{cell(found.gain)} (at nature's worst)",
    }
    values = [
        {"policy": "held", "right": found.value, "worst": found.worst, "best": found.best},
        {
            "policy": "robust",
            "right": found.robust_value,
            "worst": found.robust.start,
            "best": found.robust_best,
        },
    ]
    tables = [
        Table(
            title="value at the start",
            rows=values,
            columns={
                "policy": "policy",
                "tables right": "right",
                "worst case": "worst",
                "best case": "best",
            },
        ),
        Table(
            title="states in which the robust policy takes another action",
            rows=changes,
            columns={"state": "state", "held": "before", "robust": "after"},
        ),
    ]
    return Report(result=result, facts=facts, tables=tables)


def _radius(asked: Asked, usual: object) -> Fraction:
    """Return the radius that the options state, at least 0, or the usual one."""
    given = asked["radius"]
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


# ---- one box of parameters, shared by all states -----------------------------------------------


def _box_report(asked: Asked) -> Report:
    """Return worst and best over one shared box of the scenario's parameters."""
    scenario, mdp, form = asked.loaded.scenario, asked.loaded.mdp, asked.form
    if scenario is None:
        raise ModelError(
            "a shared box needs the parameters of a scenario",
            where="--set-kind box",
            fix="give a scenario, or another kind of set",
        )
    box, radius = _box(scenario, asked)
    optimal = isinstance(asked.policy, str) and asked.policy == "optimal"
    held = solve(mdp) if optimal else asked.policy
    others = {} if optimal else {form: asked.policy}
    surest = box_optimum(scenario, box, candidates=others, progress=True)
    worst = surest.candidates["optimal today" if optimal else form]
    best = box_extreme(scenario, held, box, side="best", progress=True)
    there = solve(ScenarioFamily(scenario=scenario).at(best.point)).start
    today, sure = exact_value(mdp, held), exact_value(mdp, surest.policy)
    result = claimed("start_value", Certified(value=today)) | {
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
        "price_of_robustness": Certified(value=today - sure),
        "worst_case_gain": _gain(surest.worst, worst),
        "robust_policy_value": Certified(value=sure),
        "box": {name: [float(span.low), float(span.high)] for name, span in box.items()},
    }
    if asked["perception"] is not None:
        result["claim_of"] = ROUNDED
    unknown = sum(sign == "open" for sign in worst.signs.values())
    facts = {
        "uncertainty": f"{len(box)} parameters within a box, shared by all states",
        "start value": Certified(value=today),
        "worst case": _said(worst.low, worst.high, proven=worst.proven),
        "best case": _said(best.low, best.high, proven=best.proven),
        "best policy against the box": _said(surest.low, surest.high, proven=surest.saddle),
        "directions not proven": unknown or None,
    }
    rows = [
        {
            "name": name,
            "low": float(span.low),
            "high": float(span.high),
            "at": float(worst.point[name]),
            "moves": worst.signs[name],
        }
        for name, span in box.items()
    ]
    columns = {
        "parameter": "name",
        "from": "low:.6g",
        "to": "high:.6g",
        "at the worst": "at:.6g",
        "value moves": "moves",
    }
    table = Table(title=f"where the worst case of {form} is", rows=rows, columns=columns)
    return Report(result=result, facts=facts, tables=[table])


def _box(scenario: Scenario, asked: Asked) -> tuple[dict[str, Range], Fraction | None]:
    """Return the box that the options mean: all probabilities ± the radius unless stated."""
    if not any(asked[name] for name in ("parameters", *STATED)):
        radius = _radius(asked, RELATIVE)
        return box_ranges(scenario, relative=radius), radius
    if asked["radius"] is not None:
        raise ModelError("both a radius and ranges", where="--radius", fix="give one of them")
    spans = stated_ranges(ScenarioFamily(scenario=scenario), asked.options)
    moving = {name: (span.low, span.high) for name, span in spans.items() if span.low < span.high}
    if not (asked["parameters"] or asked["ranges"] or asked["range_file"]):
        moving.pop("discount", None)
    return box_ranges(scenario, moving), None


def _said(low: float, high: float, *, proven: bool) -> str:
    if proven or high - low < NEAR:
        return f"{cell(high)} ({'proven' if proven else 'bounded'})"
    return f"from {cell(low)} to {cell(high)} (bounded)"


def _number(found: BoxExtreme) -> dict[str, Any]:
    return {**plain(found.value), "low": found.low, "high": found.high}


def _extreme(found: BoxExtreme) -> dict[str, Any]:
    return _number(found) | {
        "claim": found.value.claim,
        "exact": found.reached if found.proven else None,
        "point": {name: float(at) for name, at in found.point.items()},
        "moves": found.signs,
    }


def _surest(found: BoxOptimum) -> dict[str, Any]:
    if found.saddle:
        known = _number(found.worst)
    else:
        known = {**plain(_middle(found)), "low": found.low, "high": found.high}
    return known | {"proven_best_policy": found.saddle}


def _middle(found: BoxExtreme | BoxOptimum) -> Bounded:
    """Return the middle of bounds, and how far off it may be."""
    middle = (found.low + found.high) / 2
    half = max(found.high - middle, middle - found.low)
    return Bounded(value=middle, error=nextafter(half, inf) if half else 0.0)


def _gain(surest: BoxExtreme, held: BoxExtreme) -> Certified | Bounded:
    """Return the worst case of the best candidate less that of the policy held."""
    if surest is held:
        return Bounded(value=0.0, error=0.0)
    if surest.proven and held.proven:
        return Certified(value=surest.reached - held.reached)
    return difference(_middle(surest), _middle(held))
