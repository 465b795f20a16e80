"""What `exact-mdp sensitivity MODEL gradient` tells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from exact_mdp.analysis.cli.render import Grid, number
from exact_mdp.analysis.cli.sensitivity.options import (
    ROUNDED,
    SHOWN,
    Report,
    any_range,
    model_of,
    only_first,
    policy_from,
)
from exact_mdp.analysis.sensitivity.gradient import Derivative, gradient
from exact_mdp.mdp.errors import ModelError
from exact_mdp.solvers.solution import Certified

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


def gradient_report(loaded: Loaded, options: Mapping[str, Any]) -> Report:
    """Return derivatives of the start value."""
    model = model_of(loaded)
    if any_range(options):
        raise ModelError(
            "a gradient has no ranges", where="sensitivity gradient", fix="leave them out"
        )
    names = options["parameters"] or None
    found = gradient(model, policy=policy_from(loaded, options), names=names)
    ends = {True: "re-optimised", False: "fixed"}
    result = {
        "start_value": float(found.start_value),
        "claim": found.start.claim,
        "policy": ends[found.reoptimised],
        "derivatives": {n: _value(d.value) for n, d in found.derivatives.items()},
        "left": {n: _value(d.left) for n, d in found.derivatives.items()},
        "right": {n: _value(d.right) for n, d in found.derivatives.items()},
        "elasticities": {n: d.elasticity for n, d in found.derivatives.items()},
        "exact_derivatives": {
            n: d.value.value if isinstance(d.value, Certified) else None
            for n, d in found.derivatives.items()
        },
        "error_bounds": {n: _error(d) for n, d in found.derivatives.items()},
        "steps": {
            n: {"one_less": _value(less), "one_more": _value(more)}
            for n, (less, more) in found.steps.items()
        },
    }
    ordered = sorted(found.derivatives.items(), key=lambda item: -abs(item[1].elasticity or 0.0))
    rows = [
        (
            name,
            number(float(each.parameter.value)),
            f"{_value(each.value):.6g}" if each.value else _sides(each),
            "-" if each.elasticity is None else f"{each.elasticity:.4g}",
        )
        for name, each in ordered[:SHOWN]
    ]
    grid = Grid(
        title=_title("derivatives of the start value, per unit of the parameter", found, ordered),
        headings=("parameter", "today", "derivative", "elasticity"),
        rows=rows,
        numeric=frozenset({1, 2, 3}),
    )
    claim = str(found.start.claim)
    if options.get("perception") is not None:
        result["claim_of"] = ROUNDED
        claim += f", {ROUNDED}"
    facts = {
        "start value": f"{number(result['start_value'])} ({claim})",
        "policy": result["policy"],
    }
    for name, (less, more) in found.steps.items():
        last = "" if less is None else f"the last one adds {float(less.value):+.6g}, "
        facts[name] = f"{last}one more adds {float(more.value):+.6g}"
    return result, facts, [grid]


def _value(each: Any) -> float | None:
    return None if each is None else float(each.value)


def _error(each: Derivative) -> float:
    """Return the larger error bound of both sides; 0 for exact ones."""
    return max(getattr(side, "error", 0.0) for side in (each.left, each.right) if side is not None)


def _sides(each: Derivative) -> str:
    return f"{_value(each.left):.6g} | {_value(each.right):.6g}"


def _title(text: str, found: Any, ordered: list[Any]) -> str:
    policy = "re-optimised" if found.reoptimised else "held fixed"
    return f"{text}{only_first(len(ordered))} (policy {policy})"
