"""The worst case within sets around the tables: the kind robust."""

from __future__ import annotations

from fractions import Fraction

from exact_mdp.analysis.cli.render import Report, Table, cell, claimed, plain
from exact_mdp.analysis.cli.sensitivity.options import STATED, Asked, analysis
from exact_mdp.analysis.vary.base_case import finite_worth
from exact_mdp.analysis.vary.corners import worst_point
from exact_mdp.analysis.vary.ranges import RELATIVE, Ranges, ranges_of, unit_of, usual
from exact_mdp.analysis.vary.robust import (
    SETS,
    Robust,
    ambiguity_of,
    robust,
)
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.table import LARGEST, beside, exact, shown

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


@analysis("robust")
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
            where="robust",
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
    """Return the worst point that is found for the policy over one shared box of parameters."""
    ranges, radius = _box(asked)
    found = worst_point(asked.model, asked.policy, ranges)
    start = finite_worth(asked.loaded.mdp, asked.policy, "today's parameters")
    better = "most" if asked.loaded.mdp.sense == "max" else "least"
    result = claimed("start_value", start) | {
        "policy": asked.form,
        "set_kind": BOX,
        "radius": None if radius is None else float(radius),
        "nature": "one choice of the parameters for all states",
        "claim": found.claim,
        "worst_case": plain(found.value)
        | {
            "claim": found.claim,
            "point": {name: float(at) for name, at in found.point.items()},
            "optimum": found.optimum,
        },
        "box": {name: [float(span.low), float(span.high)] for name, span in ranges.items()},
    }
    facts = {
        "uncertainty": f"{len(ranges)} parameters within a box, shared by all states",
        "policy held": asked.form,
        "start value": start,
        "worst case": f"at {better} {cell(found.value)}: the worst of {found.corners:,} corners, "
        "not proven to be the worst point (estimated)",
        "optimum there": f"{cell(found.optimum)}: no policy has a better worst case",
    }
    rows = [
        {"name": name, "low": float(span.low), "high": float(span.high), "at": float(at)}
        for (name, span), at in zip(ranges.items(), found.point.values(), strict=True)
    ]
    columns = {
        "parameter": "name",
        "from": "low:.6g",
        "to": "high:.6g",
        "at the worst point": "at:.6g",
    }
    table = Table(title=f"the worst point found for {asked.form}", rows=rows, columns=columns)
    return Report(result=result, facts=facts, tables=[table])


def _box(asked: Asked) -> tuple[Ranges, Fraction | None]:
    """Return the box that the options mean: all probabilities ± the radius unless stated."""
    named = any(asked[name] for name in ("parameters", "ranges", "range_file"))
    if named or any(asked[name] for name in STATED):
        if asked["radius"] is not None:
            raise ModelError("both a radius and ranges", where="--radius", fix="give one of them")
        ranges, radius = asked.ranges()[0], None
        chosen = [*ranges] if named else usual(asked.model)
    else:
        radius = _radius(asked, RELATIVE)
        ranges = ranges_of(asked.model, relative=radius)
        chosen = [p.name for p in asked.model.parameters if unit_of(p) == "probability"]
    moving = (name for name in chosen if name in ranges)
    box = Ranges({n: ranges[n] for n in moving if ranges[n].low < ranges[n].high})
    if not box:
        raise ModelError(
            "no parameter moves",
            where="--set-kind box",
            fix="give a range (--range NAME=LOW:HIGH), or another kind of set",
        )
    return box, radius
