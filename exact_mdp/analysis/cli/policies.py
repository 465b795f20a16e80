"""The commands of an optimum, its proof, and of one policy: value, returns, simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ulp
from pathlib import Path
from typing import Any

import exact_mdp
from exact_mdp.analysis.cli.given import Given
from exact_mdp.analysis.cli.words import limits_from, refuse_options
from exact_mdp.analysis.optimum import compute_optimum
from exact_mdp.analysis.tradeoffs.front import Front
from exact_mdp.analysis.tradeoffs.rationalize import Rationalization
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io import model_json
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.table import float_of
from exact_mdp.solvers.claims import in_float
from exact_mdp.solvers.exact import codec, verified
from exact_mdp.solvers.exact.certificate import (
    BoundedCertificate,
    Certificate,
    Proof,
    require_sound_proof,
)
from exact_mdp.solvers.exact.regret import RegretCertificate
from exact_mdp.solvers.objectives.limits import ConstrainedSolution, name_bounds
from exact_mdp.solvers.objectives.totals import TotalsProof

PROOFS = (
    Certificate,
    BoundedCertificate,
    RegretCertificate,
    Front,
    ConstrainedSolution,
    Rationalization,
)
KINDS: dict[str, Any] = {}
for _proof in PROOFS:
    KINDS.update(dict.fromkeys(_proof.kinds, _proof))


# ---- the optimum ---------------------------------------------------------------------------------


def solve_command(
    given: Given,
    *,
    certify: bool = False,
    subject_to: Sequence[str] = (),
    method: str = "auto",
    tol: str | None = None,
    certificate: str | None = None,
    policy_out: str | None = None,
    out: str | None = None,
) -> Report:
    """Find an optimal policy and its value, bounded or proved.

    With --certify the optimum is also computed in rational arithmetic, and proved. The result says
    whether an optimal policy needs the status alone, unless bounds without a proof leave that open.
    With --horizon episodes stop, and the optimal policy depends on the time. With --subject-to the
    optimum under limits is exact, with its policy, which may draw its actions, and the price of
    each limit; the exit status is 1 if no policy keeps the limits.

    Example: exact-mdp solve yuan2025 --certify --certificate proof.json
    Example: exact-mdp solve tea --subject-to 'steps <= 20'

    Parameters
    ----------
    given : Given
    certify : bool
        Compute and prove the exact optimum.
    subject_to : 'NAME >= X', optional
        Keep an expected total at least (>=) or at most (<=) at X: of a component of the reward,
        steps, an event, or a sum such as 2*a-b. Exact.
    method : NAME
        {solvers.total:SOLVERS}, or the one that suits the model.
    tol : X, optional
        Greatest absolute error of a value.
    certificate : FILE, .json
        Write a proof for `verify`: .json; of the optimum with --certify or under limits, and of
        bounds otherwise.
    policy_out : FILE, {formats:WRITTEN_POLICIES}
        Write the policy: {formats:WRITTEN_POLICIES}.
    out : FILE, .npz
        Write values, policy and action values: .npz. A record of its making, FILE.run.json, is
        written beside each file.

    Keys
    ----
    Of Solution, ConstrainedSolution, UnderLimits.
    exact_start_value: the optimal value at the start, "p/q", null unless certified; unique: whether
    no other policy is optimal on the states reached, null unless certified; stationary: whether the
    optimum depends on the status alone; policy_by_state: action of each state, if there are no
    statuses, null where even the best value is infinitely bad; gain: average reward per step, state
    by state; bias: advantage of a start in the state beyond its gain; feasible: whether some policy
    keeps the limits; method: the algorithm; iterations: sweeps or improvements; status: how the
    solver ended; limits: the limits, as they were given; totals: what the policy attains of each
    limited total, "p/q"; regret_bound: greatest loss of the policy.
    """
    given = given.with_limits(subject_to)
    mdp, average = given.mdp, given.criterion == "average"
    proof: Any
    if subject_to:
        refused = {"--method": method != "auto", "--tol": tol, "--out": out}
        refuse_options(refused, "limits")
        limits = limits_from(subject_to)
        proof = exact_mdp.solve(mdp, subject_to=limits, criterion=given.criterion)
        require_sound_proof(proof)
        policy: Policy = proof.policy
        solver, report = "limits", proof.report()
    else:
        if certificate and not certify and (average or mdp.ends.has_improper_policy):
            what = "bounds are proved of totals of rewards where every policy ends"
            fix = "add --certify, which proves the exact values"
            raise ModelError(what, where="--certificate", fix=fix)
        if tol is None:
            error = None
        else:
            error = float_of(tol, "--tol")
        best = compute_optimum(mdp, method, error, certify=certify, criterion=given.criterion)
        proof = best.certificate
        if certificate and proof is None:
            proof = exact_mdp.certify(mdp, bounded=True, solution=best.solution)
        if out:
            best.save(out)
        policy = Policy.of(mdp, best.best)
        solver = "exact"
        if best.solution:
            solver = best.solution.solver
        report = best.report()
    if policy_out:
        policy.write(policy_out)
    if certificate and proof:
        proof.save(certificate)
    written = [path for path in (policy_out, out, certificate) if path]
    for path in written:
        write_atomically(Path(path).with_suffix(".run.json"), given.format_record(solver))
    return given.complete_report(replace(report, facts={**report.facts, "written": written}))


def verify_command(certificate: str, given: Given, *, proven: bool = False) -> Report:
    """Check a certificate of an optimum, of a verdict or of a front.

    CERTIFICATE is a file that solve wrote, with limits or without, the regret of a policy from
    check, or a front from tradeoff. The checker imports no solver. With --proven a second checker,
    whose soundness is proven in Coq, has to accept it, too; it covers all but fronts of three
    objectives and weights. The exit status is 1 if CERTIFICATE does not hold for MODEL.

    Example: exact-mdp verify proof.json yuan2025
    Example: exact-mdp verify proof.json yuan2025 --proven

    Parameters
    ----------
    certificate : CERTIFICATE
    proven : bool
        Ask the checker whose soundness is proven, too.

    Keys
    ----
    certificate: the certificate's file; holds: whether the certificate holds; violations: rules
    that are broken, empty if all hold; proven: whether the checker whose soundness is proven was
    asked, too; objectives: the totals that a front or limits are about; shows: what is proven of a
    policy, in a sentence; regret: loss of the policy at the start; exact_regret: the regret, "p/q";
    optimal_value: the optimal value at the start; learned_value: the value of the policy at the
    start.
    """
    mdp = given.mdp  # read first, as both files may be given in the wrong order
    # The checker, and with --proven a second one, judge the file against the model.
    proof = codec.load_proof(KINDS, certificate)
    mdp = given.with_limits(isinstance(proof, ConstrainedSolution)).mdp
    proof = replace(proof, mdp=mdp)
    violations = proof.violations(mdp)
    if proven and not is_accepted_by_proven_checker(proof, mdp) and not violations:
        violations = ["the checker whose soundness is proven does not accept it"]
    by = ""
    if proven:
        by = ", by the proven checker, too"
    if violations:
        said = "does not hold"
    else:
        said = f"holds ({proof.claim}{by})"
    facts: dict[str, Any] = {
        "certificate": certificate,
        "holds": Shown(not violations, said),
        "violations": Shown(violations, [{"what is wrong": each} for each in violations]),
        "proven": Shown(proven),
        "claim": Shown(None if violations else proof.claim),
    }
    # The statement of a sound proof: totals, or the optimum with its claim.
    if isinstance(proof, TotalsProof):
        facts |= {"kind": proof.kind, "objectives": list(proof.objectives)}
        facts |= {} if violations else _proven_totals(proof)
    elif isinstance(proof, RegretCertificate):
        facts |= {"kind": proof.kind, "criterion": proof.criterion}
        facts |= {} if violations else _list_losses(proof)
    elif not violations:
        value, exact = float(proof.start.value), isinstance(proof, Certificate)
        if exact:
            error = ulp(value)
        else:
            error = proof.start.error
        facts |= {"start_value": Shown(value, proof.start), "error_bound": Shown(error)}
        if exact:
            if proof.kind == "average":
                more = {"criterion": "average"}
            else:
                more = {"unique": proof.unique}
            facts |= {"exact_start_value": Shown(proof.start_value)} | more
    return given.complete_report(Report(title="proof", facts=facts, passed=not violations))


def _list_losses(proof: RegretCertificate) -> dict[str, Any]:
    """Return the statement of a sound proof of a regret: a sentence, and its numbers."""
    best, own = in_float(proof.optimum.start_value), in_float(proof.value.start_value)
    lost = in_float(proof.regret)
    shows = f"at the start the policy is worth {own:.10g}, the optimum is {best:.10g}, and it loses"
    return {
        "shows": f"{shows} {lost:.10g}",
        "regret": Shown(lost, proof.start),
        "exact_regret": Shown(proof.regret),
        "optimal_value": Shown(best, proof.optimum.start),
        "learned_value": Shown(own, proof.value.start),
    }


def is_accepted_by_proven_checker(proof: Proof, mdp: MDP) -> bool:
    """Return whether the proven checker accepts a proof; raises ModelError for other kinds."""
    several = isinstance(proof, Front) and len(proof.objectives) > 2
    if proof.kind not in (known := [*verified.KEYS, "limits", "front"]) or several:
        if several:
            what = "a front of three objectives"
        else:
            what = proof.kind
        raise ModelError(
            f"the checker whose soundness is proven covers {', '.join(known)}, not {what}",
            where="--proven",
            fix="leave it out: the other checker covers this kind",
        )
    if not isinstance(proof, TotalsProof):
        return verified.holds(model_json.encode_model(mdp), codec.build_file_content(proof, int))
    totals = proof.of.to_totals()
    content = model_json.encode_model(mdp), codec.build_file_content(proof)
    if isinstance(proof, Front):
        return verified.front_holds(*content, totals.amounts)
    return verified.limits_hold(*content, totals.names, totals.amounts)


def _proven_totals(proof: TotalsProof) -> dict[str, Any]:
    """Return the statement of a sound proof about totals, by the texts of its totals."""
    texts = proof.objectives
    if isinstance(proof, Front):
        totals = [dict(zip(texts, point, strict=True)) for point in sorted(proof.vertices)]
        return {"names": texts, "vertices": len(totals), "totals": totals}
    if isinstance(proof, Rationalization):
        alone = [ends and list(ends) for ends in proof.alone.values()]
        return {
            "possible": proof.possible,
            "change": proof.change,
            "weights": dict(zip(texts, proof.multipliers, strict=True)),
            "alone": dict(zip(texts, alone, strict=True)),
        }
    assert isinstance(proof, ConstrainedSolution)
    # An optimum under limits; limits are shown with the texts of their totals.
    text = dict(zip(proof.of.names, texts, strict=True))
    limits = [replace(limit, name=text[limit.name]) for limit in proof.limits]
    moved = [replace(limit, name=text[limit.name]) for limit in proof.moved]
    closest = name_bounds(limits, moved)
    none = "none: no policy keeps the limits (proven)"
    return {
        "limits": [str(limit) for limit in limits],
        "feasible": proof.feasible,
        "exact_start_value": Shown(proof.start_value, proof.start or none),
        "totals": {text[name]: total for name, total in proof.totals.items()},
        "prices": {text[name]: price for name, price in proof.prices.items()},
        "closest": Shown(closest, [limit.format_limit(10) for limit in moved]),
    }


# ---- one policy ----------------------------------------------------------------------------------


def evaluate_command(given: Given, policy: Policy) -> Report:
    """Compute a policy's mean return, its spread and its components.

    Example: exact-mdp evaluate yuan2025 always:directive

    Keys
    ----
    Of Evaluation.
    components: expected total of each component of the reward, which sum to the mean; mean:
    expected return; by_state: gain, bias and share of time of each state, or null if there are
    many; recurrent_classes: number of classes of states in which the policy stays.
    """
    return given.complete_report(
        exact_mdp.evaluate(given.mdp, policy, criterion=given.criterion).report()
    )


def returns_command(given: Given, policy: Policy, *, exact: bool = False) -> Report:
    """Compute the exact distribution of a policy's return, at discount 1.

    Example: exact-mdp returns yuan2025 random --set tasks=[1]

    Parameters
    ----------
    exact : bool
        Give the probabilities as rationals, too.

    Keys
    ----
    Of ReturnDistribution.
    distribution: {return: probability}; exact_distribution: the distribution with probabilities
    "p/q", or null; mean: expected return; sd: standard deviation of the return.
    """
    distribution = exact_mdp.return_distribution(given.mdp, policy, exact=exact)
    report, moments = distribution.report(), exact_mdp.evaluate(given.mdp, policy).report().facts
    bounds = {name: moments["error_bounds"].value[name] for name in ("mean", "sd")}
    more = {name: moments[name] for name in bounds} | {"error_bounds": Shown(bounds)}
    return given.complete_report(replace(report, facts={**report.facts, **more}))


def simulate_command(given: Given, policy: Policy, *, episodes: int, seed: int = 0) -> Report:
    """Estimate a policy's mean return by simulation.

    Example: exact-mdp simulate tea random --episodes 10000

    Parameters
    ----------
    episodes : N, 1 to 1000000000
        Number of episodes.
    seed : S
        Seed of the random numbers.

    Keys
    ----
    Of Simulation.
    mean: mean of the returns; episodes: number of episodes; interval: 95 % interval of the mean;
    steps: mean number of steps; event_probability: probability that each event happens in an
    episode; truncated: truncated episodes; truncation_error: greatest effect of the truncated
    episodes on the mean.
    """
    runs = exact_mdp.simulate(given.asked, policy, episodes, seed, horizon=given.horizon)
    return given.complete_report(runs.report(), seed=seed)
