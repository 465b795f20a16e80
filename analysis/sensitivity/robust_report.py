"""What `exact-mdp sensitivity MODEL robust` tells."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from analysis.cli_output import Grid, number
from analysis.sensitivity.ranges import RELATIVE
from analysis.sensitivity.report import SHOWN, Report, only_first
from analysis.sensitivity.report_options import policy_from
from analysis.sensitivity.robust import SETS, ambiguity_of, robust
from analysis.sensitivity.robust_result import Robust
from mdp.errors import ModelError, suggest
from mdp.table import LARGEST, beside, exact, shown
from solvers.solution import Bounded

if TYPE_CHECKING:
    from mdp.load import Loaded

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
        from analysis.sensitivity.box_report import box_report

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
