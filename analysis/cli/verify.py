"""The command that checks a proof of an optimum, made here or elsewhere."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from exact_mdp.analysis.cli.options import horizon_option, model_options, stopped, tell_limit
from exact_mdp.analysis.cli.render import Grid, at_most, number, show

if TYPE_CHECKING:
    from exact_mdp.solvers.proof.certificate import BoundedCertificate, Certificate

HOLDS, FAILS = 0, 1


@click.command(short_help="Check a certificate of a model's optimum.")
@click.argument("certificate")
@click.argument("model")
@horizon_option
@model_options
def verify(
    certificate: str,
    model: str,
    horizon: str | None,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
) -> int:
    """Check that CERTIFICATE proves the optimum of MODEL; exit status 1 where it does not.

    The checker imports no solver.
    """
    from exact_mdp.mdp.io.load import load

    loaded, steps = stopped(load(model, sets=sets, discount=discount), horizon)
    proof = _read(certificate)
    violations = proof.violations(loaded.mdp)
    result: dict[str, Any] = {
        "certificate": certificate,
        "model": loaded.name,
        "horizon": steps,
        "passed": not violations,
        "violations": violations,
        "claim": None if violations else proof.claim,
    }
    facts = {
        "certificate": certificate,
        "model": loaded.name,
        "proof": "does not hold" if violations else f"holds ({proof.claim})",
    }
    if not violations:
        start = _start(proof, loaded.mdp.start)
        result |= start
        error = at_most(start["error_bound"])
        facts["start value"] = (
            f"{number(start['start_value'], start['error_bound'])} within {error}"
        )
    rows = [[violation] for violation in violations]
    grids = [Grid(title="violations", headings=["what is wrong"], rows=rows)] if rows else []
    tell_limit(loaded.mdp)
    show(result, as_json=as_json, facts=facts, grids=grids)
    return FAILS if violations else HOLDS


def _read(path: str) -> Certificate | BoundedCertificate:
    """Read a certificate of either kind."""
    from exact_mdp.mdp.io.files import LARGEST, read_text
    from exact_mdp.solvers.proof.certificate import BoundedCertificate, Certificate

    try:
        content = json.loads(read_text(path, most=LARGEST))
        bounded = isinstance(content, dict) and content.get("kind") == "bounded"
    except (ValueError, RecursionError):  # integers of over 4,300 decimal digits among them
        bounded = False  # reading it as a certificate says what is wrong
    return BoundedCertificate.load(path) if bounded else Certificate.load(path)


def _start(proof: Certificate | BoundedCertificate, start: Any) -> dict[str, Any]:
    """Return what a sound certificate proves of the start value."""
    from fractions import Fraction
    from math import ulp

    from exact_mdp.solvers.proof.certificate import Certificate

    if isinstance(proof, Certificate):
        value = float(proof.start_value)
        exact = {"exact_start_value": proof.start_value, "unique": proof.unique}
        return {"start_value": value, "error_bound": ulp(value)} | exact
    middle = proof.value
    value = float(sum(weight * Fraction(float(middle[state])) for state, weight in start))
    return {"start_value": value, "error_bound": proof.error_bound + ulp(value)}
