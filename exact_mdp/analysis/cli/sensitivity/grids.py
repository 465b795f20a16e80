"""Values at evenly spaced points of one parameter's range, or of two."""

from __future__ import annotations

from typing import Any

from exact_mdp.analysis.cli.options import whole_of
from exact_mdp.analysis.cli.render import Report, Table, claimed
from exact_mdp.analysis.cli.sensitivity.options import Asked, analysis
from exact_mdp.analysis.vary.one_way import one_way, two_way
from exact_mdp.mdp.errors import ModelError
from exact_mdp.solvers.solver import solve

MOST = 10_000  # points along one range


@analysis("one-way")
def one_way_report(asked: Asked) -> Report:
    """Return the start value along one parameter, re-optimised and of the policy held fixed."""
    (name,) = _named(asked, 1, "one-way")
    along = one_way(asked.model, name, policy=asked.policy, **_how(asked, "21"))
    rows = [
        {
            "at": float(point.at),
            "value": point.optimal.value,
            "fixed_value": point.fixed.value,
            "regret": point.regret.value,
            "error_bound": point.regret.error,
        }
        for point in along.points
    ]
    return _report(asked, {"parameter": name}, rows, {name: "at:.6g"})


@analysis("two-way")
def two_way_report(asked: Asked) -> Report:
    """Return the start value over a grid of two parameters, and the number of the best policy."""
    x, y = _named(asked, 2, "two-way")
    grid = two_way(asked.model, x, y, policy=asked.policy, **_how(asked, "11"))
    keys = ("x", "y", "policy", "value", "fixed_value", "regret", "error_bound", "claim")
    table = grid.frame().set_axis(keys, axis="columns").drop(columns="claim")
    names = {"parameters": [x, y], "policies": int(grid.policy.max()) + 1}
    columns = {x: "x:.6g", y: "y:.6g", "policy": "policy"}
    return _report(asked, names, table.to_dict("records"), columns)


def _report(
    asked: Asked, about: dict[str, Any], rows: list[dict[str, Any]], columns: dict[str, str]
) -> Report:
    start = solve(asked.loaded.mdp).start
    result = claimed("start_value", start) | {"policy": asked.form, **about, "points": rows}
    values = {
        "re-optimised": "value:.6g",
        "policy held fixed": "fixed_value:.6g",
        "its regret": "regret:.3g",
    }
    table = Table(title="value at the start", rows=rows, columns=columns | values)
    facts = {"start value": start, "policy held fixed": asked.form}
    return Report(result=result, facts=facts, tables=[table])


def _named(asked: Asked, count: int, kind: str) -> tuple[str, ...]:
    names: tuple[str, ...] = asked["parameters"] or ()
    if len(names) != count:
        raise ModelError(
            f"{len(names)} parameters, and {kind} varies {count}",
            where="--parameter",
            fix=f"give --parameter NAME {'once' if count == 1 else 'twice'}; `exact-mdp gradient "
            "MODEL` lists the names",
        )
    return names


def _how(asked: Asked, points: str) -> dict[str, Any]:
    """Return the ranges and the number of points that the options ask for."""
    return {
        "ranges": asked.ranges()[0],
        "points": whole_of(asked["points"] or points, "--points", 2, MOST),
    }
