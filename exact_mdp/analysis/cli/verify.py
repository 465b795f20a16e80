"""What `exact-mdp verify` does: check a proof of an optimum, made here or elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import ulp
from typing import Any

from exact_mdp.analysis.cli.options import given
from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.exact import codec
from exact_mdp.solvers.exact.certificate import BoundedCertificate, Certificate
from exact_mdp.solvers.objectives.file import PROOFS, ObjectivesProof
from exact_mdp.solvers.solution import Bounded, Certified

HOLDS, FAILS = 0, 1


def verify(*, certificate: str, **shared: Any) -> Report:
    """Check a certificate."""
    try:
        kind, proof = codec.load(KINDS, certificate)
    except ModelError as error:
        if not str(shared["model"]).endswith(".json"):
            raise
        fix = "name the certificate first: exact-mdp verify CERTIFICATE MODEL"
        raise ModelError(error.what, where=error.where, fix=fix) from error
    asked = given(**shared)
    proof = (
        proof if isinstance(proof, ObjectivesProof) else replace(proof, mdp=asked.mdp, **_of(kind))
    )
    violations = proof.violations(asked.mdp)
    result = {
        "certificate": certificate,
        "holds": not violations,
        "violations": violations,
        "claim": None if violations else proof.claim,
    }
    facts: dict[str, Any] = {
        "certificate": certificate,
        "proof": "does not hold" if violations else f"holds ({proof.claim})",
    }
    tables = list[Table]()
    if isinstance(proof, ObjectivesProof):
        proven = {} if violations else proof.found(asked.mdp)
        result |= {"kind": kind, "objectives": list(proof.objectives)} | proven
        if "vertices" in proven:
            facts |= {"names": proven["names"], "vertices": proven["vertices"]}
            tables.append(_totals(proven))
        elif "limits" in proven:
            result["limits"] = [str(limit) for limit in proven["limits"]]
            result["closest"] = {moved.name: moved.bound for moved in proven["closest"]}
            if proven["exact_start_value"] is not None:
                facts["start value"] = Certified(value=proven["exact_start_value"])
            else:
                facts["limits"] = "no policy keeps them all (proven)"
            tables.append(_limits(proven))
    elif not violations:
        start = _start(proof, asked.mdp)
        result |= {"start_value": start.value, "error_bound": start.error}
        facts["start value"] = start if isinstance(proof, BoundedCertificate) else proof.start
        if isinstance(proof, Certificate):
            result["exact_start_value"] = proof.start_value
            result |= {"criterion": "average"} if kind == "average" else {"unique": proof.unique}
    table = Table(
        title="violations",
        rows=[{"what": violation} for violation in violations],
        columns={"what is wrong": "what"},
    )
    return asked.report(result, facts, [*tables, table], status=FAILS if violations else HOLDS)


def _totals(proven: Mapping[str, Any]) -> Table:
    """Return the totals of the vertices."""
    return Table(
        title="vertices of the front",
        rows=[{name: float(total) for name, total in each.items()} for each in proven["totals"]],
        columns={name: f"{name}:.10g" for name in proven["names"]},
    )


def _limits(proven: Mapping[str, Any]) -> Table:
    """Return what was proven of each limit."""
    limits, totals, prices = proven["limits"], proven["totals"], proven.get("prices", {})
    moved = [limit.text(10) for limit in proven.get("closest", limits)]
    rows = [
        {"limit": str(limit), "closest": near, "total": totals.get(limit.name)}
        | {"price": prices.get(limit.name)}
        for limit, near in zip(limits, moved, strict=True)
    ]
    shown = {"limit": "limit"} | ({"total": "total:.10g"} if totals else {})
    shown |= {"price": "price:.10g"} if prices else {}
    if proven["feasible"] or not prices:
        return Table(title="limits", rows=rows, columns=shown)
    title = "limits, and the closest ones that can be kept"
    return Table(title=title, rows=rows, columns={"limit": "limit", "closest": "closest"})


KINDS: dict[str, Any] = {
    "total": Certificate,
    "average": Certificate,
    "bounds": BoundedCertificate,
    **PROOFS,
}


def _of(kind: str) -> dict[str, str]:
    """Return what a certificate says of its kind."""
    return {} if kind == "bounds" else {"kind": kind}


def _start(proof: Certificate | BoundedCertificate, mdp: MDP) -> Bounded:
    """Return what a sound certificate proves of the start value."""
    if not isinstance(proof, BoundedCertificate):
        value = float(proof.start_value)
        return Bounded(value=value, error=ulp(value))
    middle = proof.value
    value = float(sum(weight * Fraction(float(middle[state])) for state, weight in mdp.start))
    return Bounded(value=value, error=proof.error_bound + ulp(value))
