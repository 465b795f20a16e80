"""`exact-mdp check`: of one policy, an audit; of several, the gate for their trainer."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import fields, replace
from fractions import Fraction
from math import inf, isinf, isnan, nextafter
from time import perf_counter
from typing import Any

import click

from exact_mdp.analysis import github
from exact_mdp.analysis.cli.given import Given, advice, check_outputs, limits_from, pairs_of
from exact_mdp.analysis.cli.render import markdown
from exact_mdp.analysis.gate import check as gate
from exact_mdp.analysis.gate.audit import UNEXPLAINED, Audit, share_of
from exact_mdp.analysis.gate.columns import Representation
from exact_mdp.analysis.gate.data.off_policy import OffPolicy
from exact_mdp.analysis.gate.data.posterior import Posterior, PosteriorInterval
from exact_mdp.analysis.gate.data.robust import Robust
from exact_mdp.analysis.gate.disagreements import Disagreement, either
from exact_mdp.analysis.gate.junit import Case, write_junit
from exact_mdp.analysis.learning.trainers import TrainerAudit, check_trainer
from exact_mdp.analysis.pages.audit import audit_page
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Report, Shown, Table, cell
from exact_mdp.solvers.solution import Certified

EVIDENCE: dict[str, Any] = {"robust": Robust, "posterior": Posterior, "off-policy": OffPolicy}
SHOWN = 10  # disagreements in the table for people
ON_PAGE = 2000  # and on a page
LISTED_STATES = 1000  # models with more states are left to Python for the regret of each
COLUMNS = (
    "yours: what the policy does; optimal: what it should do; value lost: expected visits times "
    "what each loses; share: of all that is lost"
)


def check(
    given: Given,
    learned: Sequence[str],
    *,
    max_regret: str | None = None,
    max_relative_regret: str | None = None,
    html: str | None = None,
    junit: str | None = None,
    certify: bool = False,
    no_explain: bool = False,
    subject_to: Sequence[str] = (),
    share: str | None = None,
    alpha: str | None = None,
    prove: bool = False,
    confidence: str | None = None,
    by: str | None = None,
    evidence: Sequence[str] = (),
) -> Report:
    """Compare a learned policy or Q-table with the exact optimum.

    The check passes if the regret at the start is within the limits; if bounds leave that open, it
    fails. Without a limit it passes if the regret is zero: exactly, or up to what half a unit in
    the last place of the model's floats can cause. --max-regret 0 forgives nothing.
    LEARNED is a POLICY; a Q-table stands for its greedy policy. With --subject-to it has to keep
    the limits too, the regret is against the best policy that keeps them, and nothing is forgiven.

    Several LEARNED are the policies of independent runs of one trainer. They are audited one after
    the other until it is decided whether at least --share of all runs are within the limits; a
    share that is still open passes, so that a trainer that is good enough fails with probability
    --alpha at most, wherever it stops.

    With --confidence, MODEL is one that `exact-mdp data` made, and the check passes where the upper
    end of an interval for the regret in the process behind the records keeps the limit.

    Example:

    exact-mdp check yuan2025 q_table.npy --max-regret 1/10
    exact-mdp check tea runs/*.npy --share 9/10 --max-regret 1

    Parameters
    ----------
    max_regret : X, optional
        Greatest regret at the start: 0.1 or 1/10.
    max_relative_regret : X, optional
        Greatest regret over the absolute optimal value.
    html : FILE, optional
        Write a page with the picture of the policy: .html.
    junit : FILE, optional
        Write a JUnit report: .xml.
    certify : bool
        Use rational arithmetic, however long it takes.
    no_explain : bool
        Leave out which part of the loss is due to what the policy reads.
    subject_to : 'NAME >= X', optional
        Keep an expected total at least (>=) or at most (<=) at X: of a component of the reward,
        steps, an event, or a sum such as 2*a-b. Exact.
    share : X, optional
        Of several: the least share of all runs within the limits, 9/10 unless given.
    alpha : X, optional
        Of several: how likely a failure may be by chance, 1/100 unless given.
    prove : bool
        Of several: fail a share that is still open.
    confidence : C, optional
        Of a model from records: decide by an interval at this confidence, such as 0.95.
    by : KIND, optional
        What makes the interval: robust, unless given, posterior or off-policy.
    evidence : NAME=VALUE, optional
        A setting of that, as `Robust`, `Posterior` and `OffPolicy` take it in Python: rewards=known
        or rewards=LOW,HIGH, returns=LOW,HIGH, prior=1, n=2000 (models drawn), rng=0, n_jobs=1,
        records=FILE (trajectories), columns.state=NAME, behaviour=FILE (its probabilities).
    """
    started = perf_counter()
    options: dict[str, Any] = {"max_regret": max_regret, "max_relative_regret": max_relative_regret}
    options |= {"exact_values": True if certify else None}
    options |= {"criterion": "average" if given.average else "total"}
    options |= {"subject_to": limits_from(subject_to) or None}
    if len(learned) > 1:
        refused: dict[str, Any] = {
            "--html": html,
            "--confidence": confidence,
            "--by": by,
            "--evidence": evidence,
        }
        _refuse(refused | {"--no-explain": no_explain}, "several policies", "leave it out")
        asked: dict[str, Any] = {
            "share": share or "9/10",
            "alpha": alpha or "1/100",
            "prove": prove,
        }
        return _runs(given, learned, junit, started, asked | options)
    refused = {"--share": share, "--alpha": alpha, "--prove": prove}
    _refuse(refused, "a single policy", "name the policy of each run, as in runs/*.npy")
    check_outputs((junit, (".xml",)), (html, (".html",)))
    github.check_summary()
    options |= _interval(confidence, by, evidence)
    # An interval needs the counts, which a model of episodes that stop has not.
    counted = confidence is not None and given.horizon is not None
    mdp = given.asked if counted else given.mdp
    policy = given.policy(learned[0])
    horizon = given.horizon if counted else None
    audit = gate.check(mdp, policy, horizon=horizon, **options)
    why = None if no_explain else audit.representation
    read_as = {"read_as": Shown(policy.read_as, policy.source or None)}
    names = {"policy": Shown(learned[0]), "learned": learned[0]}
    report = given.report(_report(audit, why, explain=not no_explain), **names)
    report = replace(report, facts={**read_as, **report.facts})
    passed = "passed" if audit.passed else "failed"
    report = replace(report, title=f"{learned[0]} in {given.loaded.name}: {passed}")
    _write(given, audit, report, html, junit, perf_counter() - started)
    _tell(report, audit.message(explain=why is not None))
    return report


def _write(
    given: Given,
    audit: Audit,
    report: Report,
    html: str | None,
    junit: str | None,
    seconds: float,
) -> None:
    """Write the page and the report of the audit that were asked for."""
    name = given.loaded.name
    if junit is not None:
        told = {"notice": ADVICE} if advice(given.endless) else {}
        _junit(junit, f"exact-mdp check {name}", report, audit, told, seconds=seconds)
    if html is not None:
        words = shlex.join(["exact-mdp", *click.get_current_context().find_root().obj])
        learned = report.facts["learned"]
        page = audit_page(audit, report, name, learned, rerun=words, first=ON_PAGE)
        write_atomically(html, page)


def _refuse(options: dict[str, Any], of: str, fix: str) -> None:
    for option, value in options.items():
        if value:
            raise ModelError(f"{option} does not apply to {of}", where=option, fix=fix)


def _tell(report: Report, message: str) -> None:
    """Tell GitHub of the verdict, where this is a step of its actions."""
    github.summarise(markdown(report))
    if not report.passed:
        github.annotate(report.title, message)


def _interval(confidence: str | None, by: str | None, settings: Sequence[str]) -> dict[str, Any]:
    """Return what `check` is told of the interval; raises ModelError for options without one."""
    if confidence is None:
        if by is not None or settings:
            option = "--evidence" if by is None else "--by"
            what = f"{option} applies to an interval"
            raise ModelError(what, where=option, fix="give --confidence 0.95")
        return {}
    kind = by or "robust"
    if kind not in EVIDENCE:
        fix = suggest(kind, EVIDENCE)
        raise ModelError(f"unknown kind of interval {kind!r}", where="--by", fix=fix)
    known = [
        each.name for each in fields(EVIDENCE[kind]) if each.name not in ("progress", "folder")
    ]
    stated: dict[str, Any] = {}
    for name, text in pairs_of(settings, "--evidence").items():
        where, (key, _, part) = f"--evidence {name}", name.partition(".")
        if key not in known:
            what = f"{key!r} does not apply to {kind}"
            raise ModelError(what, where="--evidence", fix=suggest(key, known))
        if key in ("rewards", "returns") and text != "known":
            stated[key] = _range(text, where)
        elif key in ("n", "rng", "n_jobs"):
            if not (text.isascii() and text.isdigit() and len(text) < 10):
                fix = "give one below a thousand million"
                raise ModelError(f"{text!r} is not a whole number", where=where, fix=fix)
            stated[key] = int(text)
        elif key == "columns":
            stated.setdefault(key, {})[part] = text
        else:
            stated[key] = text
    if kind == "posterior":
        stated["progress"] = True
    return {"confidence": confidence, "by": EVIDENCE[kind](**stated)}


def _range(text: str, option: str) -> tuple[str, str]:
    """Return the ends of a range that an option states."""
    low, comma, high = text.partition(",")
    if not (comma and low.strip() and high.strip()):
        raise ModelError(f"{text!r} is no range", where=option, fix="write LOW,HIGH, such as 0,1")
    return low.strip(), high.strip()


def _junit(
    path: str, suite: str, report: Report, audit: Audit, told: dict[str, str], *, seconds: float
) -> None:
    explain = report.facts["representation"] is not None
    text = audit.message(explain=explain)
    cases = [
        Case(name=each.name) if each.passed else Case(name=each.name, failure=each.told, text=text)
        for each in audit.verdicts
    ]
    properties = {
        "model": report.facts["model"],
        "learned": report.facts["learned"],
        "claim": str(audit.claim),
        "regret": repr(float(audit.regret.at_start.value)),
        "agreement": repr(audit.agreement),
        **told,
    }
    if audit.interval is not None:
        properties["regret_interval"] = str(audit.interval)
    write_junit(path, suite, cases, seconds=seconds, properties=properties)


# ---- what an audit says --------------------------------------------------------------------------


def _report(audit: Audit, why: Representation | None, *, explain: bool) -> Report:
    """Return the verdicts, what is lost, where, and why."""
    mdp, lost, relative = audit.mdp, audit.regret, audit.relative_regret
    exact, feasible = isinstance(lost.at_start, Certified), audit.feasible
    costs = sum(each.cost for each in audit.disagreements)
    by_state = zip(mdp.space.labels(range(mdp.n_states)), lost.by_state.tolist(), strict=True)
    infinite = "infinite" if isinf(lost.optimal.value) else "0, or may be"
    visits = audit.agreement_by_visits
    of_visits = "an unknown share" if isnan(visits) else f"{visits:.1%}"
    elsewhere = (
        f"; {audit.never_reached} wrong states are never reached from {audit.begins}, and cost "
        "nothing: --start STATE begins elsewhere"
    ) * bool(audit.never_reached)
    facts: dict[str, Any] = {
        "passed": Shown(audit.passed, "yes" if audit.passed else "FAILED"),
        "checks": Shown(
            [{"name": v.name, "passed": v.passed, "text": v.text} for v in audit.verdicts],
            "; ".join(each.told for each in audit.verdicts),
        ),
        **_of_interval(audit),
        "claim": Shown(audit.claim),
        "regret_claim": Shown(audit.value.claim),
        "regret": Shown(float(lost.at_start.value), lost.at_start if feasible else None),
        "exact_regret": Shown(lost.at_start.value if exact else None),
        "error_bound": Shown(getattr(lost.at_start, "error", 0.0)),
        "forgiven": Shown(_float_below(audit.forgiven)),
        "relative_regret": Shown(
            relative,
            (f"undefined: the optimal value is {infinite}" if relative is None else relative)
            if feasible
            else None,
        ),
        "optimal_value": Shown(float(lost.optimal.value), lost.optimal if feasible else None),
        "learned_value": Shown(float(lost.learned.value), lost.learned),
        "max_regret": Shown(audit.max_regret),
        "max_relative_regret": Shown(audit.max_relative_regret),
        "agreement": Shown(
            audit.agreement,
            f"{audit.agreement:.1%} of the states with a choice, {of_visits} of the visits to them"
            + elsewhere,
        ),
        "agreement_by_visits": Shown(visits),
        "unclear": Shown(audit.unclear, audit.unclear or None),
        "disagreements": [_disagreement(mdp, each, costs) for each in audit.disagreements],
        "regret_by_state": Shown(dict(by_state) if mdp.n_states <= LISTED_STATES else None),
        **_limits(audit),
        **_reasons(why),
    }
    q = audit.q_error
    facts["q_error"] = Shown(
        q,
        q
        and f"promises {cell(q.promised)} at the start; its error: mean {cell(q.mean)}, root mean "
        f"square {cell(q.root_mean_square)} ({cell(q.visited)} by visits), at most "
        f"{cell(q.largest)} in {q.where}",
    )
    notes = [UNEXPLAINED] if explain and audit.unexplained else []
    if audit.interval is not None:
        notes += [f"assumed: {each}" for each in audit.interval.assumptions]
    return Report(
        title="audit",
        facts=facts,
        tables=_tables(facts, audit, why),
        notes=notes,
        passed=audit.passed,
    )


def _of_interval(audit: Audit) -> dict[str, Any]:
    """Return the keys of an interval; none where there is none."""
    found = audit.interval
    if found is None:
        return {}
    more = dict(found.found)
    if isinstance(found, PosteriorInterval) and audit.max_regret is not None:
        more["probability_within"] = found.within(audit.max_regret)
    return {
        "regret_interval": Shown(audit.regret_interval, f"{found} ({audit.claim})"),
        "confidence": Shown(found.confidence),
        "by": Shown(found.by),
        "interval": more,
        "assumptions": Shown(found.assumptions),
    }


def _limits(audit: Audit) -> dict[str, Any]:
    """Return what is said of limits, as `solve` does; null without them."""
    under = audit.limits
    if under is None:
        return dict.fromkeys(["feasible", "limits", "kept", "totals", "prices", "closest", "room"])
    best = under.best
    room = under.room if best.feasible else None
    return {
        "feasible": best.feasible,
        "limits": [str(limit) for limit in best.limits],
        "kept": Shown([under.keeps(limit) for limit in best.limits]),
        "totals": Shown(dict(under.totals)),
        "prices": Shown(best.prices if best.feasible else None),
        "closest": Shown(best.closest),
        "room": Shown(
            room, room is not None and f"{cell(room)}: the value of the room left under the limits"
        ),
    }


def _float_below(number: Fraction) -> float:
    """Return the greatest float that is not above a number."""
    rounded = float(number)
    return rounded if rounded <= number else nextafter(rounded, -inf)


def _disagreement(mdp: MDP, each: Disagreement, lost: float) -> dict[str, Any]:
    return {
        "state": each.label,
        "number": each.state,
        "columns": mdp.space.as_dict(each.state),
        "learned": each.learned,
        "optimal": each.optimal[0],
        "optimal_actions": each.optimal,
        "gap": each.gap,
        "expected_visits": each.expected_visits,
        "cost": each.cost,
        "share": share_of(each.cost, lost),
    }


def _reasons(why: Representation | None) -> dict[str, Any]:
    """Return what is lost because of what the policy reads, and the rows of a better one."""
    if why is None:
        return {"representation": None, "rows": None}
    best = why.best
    policy = {
        best.policy.space.label(row) or "all states": best.policy.actions[int(taken.argmax())]
        for row, taken in enumerate(best.policy.table)
        if taken.max() > 0
    }
    proof = "proven" if best.proven else f"bound {cell(best.upper_bound)}"
    return {
        "representation": Shown(
            {
                "columns": best.columns,
                "best_value": best.value.value,
                "error_bound": best.value.error,
                "upper_bound": best.upper_bound,
                "mixed_upper_bound": best.mixed_upper_bound,
                "proven": best.proven,
                "loss": float(why.loss.value),
                "learning_error": float(why.learning_error.value),
                "uncertainty": why.uncertainty,
                "policy": policy,
            },
            f"the best policy that reads {', '.join(best.columns) or 'nothing'} has "
            f"{cell(best.value)} ({proof}): {cell(why.loss)} is lost because of what it reads, "
            f"{cell(why.learning_error)} by learning",
        ),
        "rows": Shown(why.rows),
    }


def _tables(facts: dict[str, Any], audit: Audit, why: Representation | None) -> dict[str, Table]:
    under = audit.limits
    best = under and under.best
    limits = [
        {
            "limit": str(limit),
            "total": float(under.totals[limit.name]) if under else None,
            "kept": "yes" if under and under.keeps(limit) else "NO",
            "price": float(price),
            "closest": moved.text(10),
        }
        for limit, price, moved in (
            zip(best.limits, best.price, best.moved, strict=True) if best else ()
        )
    ]
    last = {"price": "price:.6g"} if best and best.feasible else {"closest": "closest"}
    return {
        "limits of the policy": Table(
            title="limits",
            rows=limits,
            columns={"limit": "limit", "yours": "total:.10g", "kept": "kept", **last},
            note="price: what the optimum gains for one point by which the limit is moved"
            if best and best.feasible
            else "closest: all moved by the same step, the least with which a policy keeps them",
        ),
        "disagreements": Table(
            title="where it is not optimal, the costliest first",
            note=COLUMNS,
            rows=[
                row | {"optimal": either(row["optimal_actions"])}
                for row in facts["disagreements"]
                if row["expected_visits"] != 0
            ],
            columns={
                "state": "state",
                "yours": "learned",
                "optimal": "optimal",
                "value lost": "cost:.6g",
                "visits": "expected_visits:.6g",
                "share": "share:.1%",
            },
            first=SHOWN,
        ),
        "rows of the policy": Table(
            title="rows of the policy, each changed alone",
            rows=[vars(change) for change in why.rows] if why else (),
            columns={"row": "row", "yours": "learned", "better": "best", "gain": "gain"},
        ),
    }


# ---- the policies of several runs ----------------------------------------------------------------


def _runs(
    given: Given,
    learned: Sequence[str],
    junit: str | None,
    started: float,
    options: dict[str, Any],
) -> Report:
    """Audit the policies of independent runs until it is decided what share passes."""
    check_outputs((junit, (".xml",)))
    policies = (given.policy(name) for name in learned)
    found = check_trainer(given.mdp, policies, runs=len(learned), **options)
    rows = [row | {"policy": learned[row.pop("run")]} for row in found.frame().to_dict("records")]
    facts = {
        "passed": Shown(found.passed, found.message()),
        "proven": found.proven,
        "claim": found.claim,
        "within": found.within,
        "runs": len(rows),
        "given": len(learned),
        "observed": Shown(found.value),
        "share_interval": [float(end) for end in found.interval],
        "share": found.share,
        "alpha": found.alpha,
        "max_regret": found.audits[0].max_regret,
        "max_relative_regret": found.audits[0].max_relative_regret,
        "policies": rows,
    }
    table = Table(
        title="the runs, in the order given",
        note="share: of all runs, from and to; all these intervals hold together",
        columns={
            "policy": "policy",
            "regret": "regret",
            "within the limits": "passed",
            "share from": "low:.3f",
            "to": "high:.3f",
        },
        first=20,
    )
    passed = "passed" if found.passed else "failed"
    title = f"{len(rows)} policies in {given.loaded.name}: {passed}"
    report = Report(title=title, facts=facts, tables={"policies": table}, passed=found.passed)
    report = given.report(report)
    if junit is not None:
        _junit_of_runs(junit, given.loaded.name, found, perf_counter() - started)
    _tell(report, found.message())
    return report


def _junit_of_runs(path: str, model: str, found: TrainerAudit, seconds: float) -> None:
    name, text = f"the share of runs within the limits is at least {found.share}", found.message()
    case = Case(name=name)
    if not found.passed:
        case = Case(name=name, failure=text.partition("\n")[0], text=text)
    low, high = found.interval
    properties = {
        "model": model,
        "claim": str(found.claim),
        "within": f"{found.within} of {len(found.audits)}",
        "share": f"{float(low)!r} to {float(high)!r}",
        "alpha": str(found.alpha),
    }
    write_junit(path, f"exact-mdp check {model}", [case], seconds=seconds, properties=properties)
