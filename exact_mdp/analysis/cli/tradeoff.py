"""What `tradeoff`, `rationalize` and `risk` do: fronts, weights that make a policy right, risk."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from exact_mdp.analysis.cli.options import check_outputs, given, policy_from
from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.analysis.cli.solve import whole_policy
from exact_mdp.analysis.tradeoffs.front import tradeoff as front_of
from exact_mdp.analysis.tradeoffs.rationalize import rationalize as weights_for
from exact_mdp.analysis.tradeoffs.risk import mean_cvar
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.solvers.risk.lattice import share_of
from exact_mdp.solvers.solution import Certified

RULES = 20  # rows of a policy with a memory that a table shows


def tradeoff(
    *, names: tuple[str, ...], policies: tuple[str, ...], certificate: str | None, **shared: Any
) -> Report:
    """Compute a front."""
    check_outputs((certificate, (".json",)))
    asked = given(**shared)
    mdp = asked.mdp
    front = front_of(mdp, names)
    if certificate:
        front.save(certificate)
    vertices = front.vertices
    beside, placed = [], []
    for form in policies:
        policy = policy_from(mdp, form)
        totals, far = front.totals(policy), front.distance(policy)
        beside.append({"policy": form, "values": _named(front.names, totals), "distance": far})
        placed.append({"policy": form, **_floats(front.names, totals), "distance": float(far)})
    edges = [
        {
            "from": edge.start,
            "to": edge.end,
            "rate": _named(front.names, edge.rate) if isinstance(edge.rate, tuple) else edge.rate,
        }
        for edge in front.edges
    ]
    result = {
        "names": list(front.names),
        "claim": front.claim,
        "vertices": [
            {
                "values": _named(front.names, vertex),
                "policy": whole_policy(mdp, [mdp.actions[action] for action in policy]),
            }
            for vertex, policy in zip(vertices, front.policies, strict=True)
        ],
        "edges": edges,
        "facets": [
            {"weights": _named(front.names, weights), "vertices": list(tight)}
            for weights, tight in front.facets
        ],
        "policies": beside,
        "written": [certificate] if certificate else [],
    }
    two = len(front.names) == 2
    costs = [
        None, *(float(e.rate) for e in front.edges if not isinstance(e.rate, tuple))
    ]  # fmt: skip
    rows = [
        _floats(front.names, vertex) | ({"rate": costs[number]} if two else {})
        for number, vertex in enumerate(vertices)
    ]
    facts = {
        "vertices": len(vertices),
        "claim": "certified: exact, and no policy is beyond",
        "more is": "worse: totals are costs" if mdp.sense == "min" else None,
        "written": result["written"] or None,
    }
    each = {name: f"{name}:.10g" for name in front.names}
    tables = [
        Table(
            title="vertices of the front",
            rows=rows,
            columns={**each, "rate": "rate:.6g"} if two else each,
            note=f"rate: how much {front.names[1]} one point of {front.names[0]} costs on the way "
            "from the row above"
            if two
            else "",
        ),
        Table(
            title="policies beside the front",
            rows=placed,
            columns={"policy": "policy", **each, "distance": "distance:.6g"},
            note="distance: by how much every total could be better at once",
        ),
    ]
    return asked.report(result, facts, tables)


def rationalize(**shared: Any) -> Report:
    """Find the weights for which a policy is optimal."""
    asked = given(**shared)
    found = weights_for(asked.mdp, asked.policy)
    result = {
        "claim": found.claim,
        "possible": found.possible,
        "change": found.change,
        "weights": found.weights,
        "alone": {name: ends and list(ends) for name, ends in found.alone.items()},
    }
    rows = [
        {
            "component": name,
            "multiplier": float(weight),
            "alone": "none" if ends is None else f"{float(ends[0]):.6g} to {float(ends[1]):.6g}",
        }
        for (name, weight), ends in zip(found.weights.items(), found.alone.values(), strict=True)
    ]
    facts = {
        "least change of the weights": Certified(value=found.change),
        "optimal": "already"
        if not found.change
        else "with these weights"
        if found.possible
        else "with no weights short of dropping them all (proven)",
    }
    table = Table(
        title="multipliers of the weights",
        rows=rows,
        columns={"component": "component", "multiplier": "multiplier:.6g", "alone": "alone"},
        note="alone: the multipliers of this weight for which the policy is optimal, the others "
        "unchanged",
    )
    return asked.report(result, facts, [table])


def risk(
    *,
    level: str,
    policies: tuple[str, ...],
    policy_out: str | None,
    **shared: Any,
) -> Report:
    """Find the best policy for a risk of the return."""
    check_outputs((policy_out, (".csv", ".json")))
    asked = given(**shared)
    mdp, share = asked.mdp, share_of(level)
    picture = mean_cvar(mdp, share, policies={p: policy_from(mdp, p) for p in policies})
    best = picture.optima[0]
    points = [
        {"weight": each.weight, "mean": each.mean, "cvar": each.value, "threshold": each.threshold}
        for each in picture.optima
    ]
    beside = [
        {"policy": name, "mean": mean, "cvar": value}
        for name, (mean, value) in picture.policies.items()
    ]
    rules: list[dict[str, Any]] = [
        {"state": mdp.space.label(state), "from": low, "to": high, "action": action}
        for state, low, high, action in best.rules()
    ]
    if policy_out:
        _write_rules(policy_out, rules)
    result = {
        "measure": "cvar",
        "level": share,
        "claim": picture.claim,
        "value": best.value,
        "mean": best.mean,
        "threshold": best.threshold,
        "distribution": best.distribution(),
        "points": points,
        "policies": beside,
        "policy": rules,
        "written": [policy_out] if policy_out else [],
    }
    facts = {
        "mean of the worst episodes": Certified(value=best.value),
        "their share": float(share),
        "mean of all episodes": Certified(value=best.mean),
        "threshold": float(best.threshold),
        "written": result["written"] or None,
    }
    table = Table(
        title="mean against the worst episodes",
        rows=picture.frame(),
        columns={"policy": "policy", "mean": "mean:.10g", "of the worst": "CVaR:.10g"},
        note="the best policies remember the reward so far; each is exact, and best for its weight",
    )
    listed = Table(
        title="best policy for the worst episodes, by state and reward so far",
        rows=[rule | {e: float(rule[e]) for e in ("from", "to")} for rule in rules],
        columns={"state": "state", "from": "from:.10g", "to": "to:.10g", "action": "action"},
        first=RULES,
        note="--policy-out FILE writes it",
    )
    return asked.report(result, facts, [table, listed])


def _write_rules(path: str, rules: Sequence[Mapping[str, Any]]) -> None:
    """Write what a policy does by state and reward so far, exactly."""
    texts = [{name: str(value) for name, value in rule.items()} for rule in rules]
    if path.lower().endswith(".json"):
        write_atomically(path, json.dumps(texts, indent=2, ensure_ascii=False) + "\n")
        return
    out = io.StringIO()
    writer = csv.DictWriter(out, ["state", "from", "to", "action"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(texts)
    write_atomically(path, out.getvalue())


def _named(names: tuple[str, ...], values: Any) -> dict[str, Fraction]:
    return dict(zip(names, values, strict=True))


def _floats(names: tuple[str, ...], values: Any) -> dict[str, Any]:
    return {name: float(value) for name, value in _named(names, values).items()}
