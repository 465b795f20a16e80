"""What `exact-mdp check` does: it finds out whether a learned policy loses too much."""

from __future__ import annotations

import shlex
from dataclasses import replace
from fractions import Fraction
from math import inf, isinf, isnan, nextafter
from time import perf_counter
from typing import Any

import click

from exact_mdp.analysis import github
from exact_mdp.analysis.cli.options import (
    advice,
    check_outputs,
    given,
    limits_from,
    renamed,
    whole_of,
)
from exact_mdp.analysis.cli.render import Report, Table, cell, fact, markdown
from exact_mdp.analysis.gate import check as gate
from exact_mdp.analysis.gate.audit import UNEXPLAINED, Audit, share_of
from exact_mdp.analysis.gate.data import off_policy, posterior, robust
from exact_mdp.analysis.gate.disagreements import Disagreement, either
from exact_mdp.analysis.gate.junit import Case, write_junit
from exact_mdp.analysis.gate.reasons import Representation
from exact_mdp.analysis.pages.audit import audit_page
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.solution import Certified

PASSED, FAILED = 0, 1
DRAWN = ("draws", "seed", "n_jobs")
RANGES = ("rewards", "returns")
OF_KIND = {
    "robust": RANGES,
    "posterior": ("prior", *DRAWN),
    "off-policy": (*RANGES, "records", "columns", "behaviour", "draws", "seed"),
}
OF_INTERVAL = (
    "confidence",
    "by",
    *dict.fromkeys(name for kind in OF_KIND.values() for name in kind),
)
SHOWN = 10  # disagreements in the table for people
ON_PAGE = 2000  # and on a page
LISTED_STATES = 1000  # models with more states are left to Python for the regret of each
COLUMNS = (
    "yours: what the policy does; optimal: what it should do; value lost: expected visits times "
    "what each loses; share: of all that is lost"
)


def check(
    *,
    learned: str,
    max_regret: str | None,
    max_relative_regret: str | None,
    junit: str | None,
    html: str | None,
    certify: bool,
    no_explain: bool,
    subject_to: tuple[str, ...],
    **rest: Any,
) -> Report:
    """Audit a policy."""
    started = perf_counter()
    check_outputs((junit, (".xml",)), (html, (".html",)))
    github.check_summary()
    settings = {name: rest.pop(name) for name in OF_INTERVAL}
    interval = _interval_of(**settings)
    asked = given(policy=learned, **rest)
    # An interval needs the counts, which a model of episodes that stop has not.
    counted = settings["confidence"] is not None and asked.steps is not None
    audit = gate.check(
        asked.asked if counted else asked.mdp,
        asked.policy,
        horizon=asked.steps if counted else None,
        max_regret=max_regret,
        max_relative_regret=max_relative_regret,
        exact_values=True if certify else None,
        criterion="average" if asked.average else "total",
        subject_to=limits_from(subject_to) or None,
        **interval,
    )
    why = None if no_explain else audit.representation
    if junit is not None:
        seconds = perf_counter() - started
        told = {"notice": ADVICE} if advice(asked.endless) else {}
        text = audit.message(explain=why is not None)
        _junit(junit, asked.loaded.name, learned, audit, seconds, told, text)
    result = {"learned": learned} | _result(audit) | _limits(audit) | _reasons(why)
    report = asked.report(
        result,
        _facts(audit, why),
        _tables(result, audit),
        notes=_notes(audit, explain=not no_explain),
        status=PASSED if audit.passed else FAILED,
    )
    if html is not None:
        write_atomically(html, _page(report, audit, asked.loaded.name, learned))
    title = f"{learned} in {asked.loaded.name}: {'passed' if audit.passed else 'failed'}"
    github.summarise(markdown(report, title))
    if not audit.passed:
        github.annotate(title, audit.message(explain=why is not None))
    return report


def _interval_of(confidence: str | None, by: str | None, **settings: Any) -> dict[str, Any]:
    """Return what `check` is told of the interval; raises ModelError for options without one."""
    stated = {name: value for name, value in settings.items() if value not in (None, ())}
    if confidence is None:
        if by is not None or stated:
            option = _option("by" if by is not None else next(iter(stated)))
            raise ModelError(
                f"{option} applies to an interval", where=option, fix="give --confidence 0.95"
            )
        return {}
    kind = by or "robust"
    if kind not in OF_KIND:
        raise ModelError(
            f"unknown kind of interval {kind!r}", where="--by", fix=suggest(kind, OF_KIND)
        )
    for name in stated:
        if name not in OF_KIND[kind]:
            right = " or ".join(each for each, names in OF_KIND.items() if name in names)
            raise ModelError(
                f"{_option(name)} does not apply to {kind}",
                where=_option(name),
                fix=f"leave it out, or give --by {right}",
            )
    for name in RANGES:
        if name in stated and not (name == "rewards" and stated[name] == "known"):
            stated[name] = _range(stated[name], _option(name))
    if kind == "robust":
        return {"confidence": confidence, "by": robust.Robust(**stated)}
    stated["rng"] = whole_of(stated.pop("seed", "0"), "--seed")
    stated["n"] = whole_of(stated.pop("draws", str(posterior.DRAWS)), "--draws", 2, 10**8)
    if "n_jobs" in stated:
        stated["n_jobs"] = whole_of(stated["n_jobs"], "--n-jobs", 1, 10**6)
    if kind == "off-policy":
        stated["columns"] = dict(map(renamed, stated.get("columns", ())))
        evidence: object = off_policy.OffPolicy(**stated)
    else:
        evidence = posterior.Posterior(progress=True, **stated)
    return {"confidence": confidence, "by": evidence}


def _option(name: str) -> str:
    return f"--{'column' if name == 'columns' else name.replace('_', '-')}"


def _range(text: str, option: str) -> tuple[str, str]:
    """Return the ends of a range that an option states."""
    low, comma, high = text.partition(",")
    if not (comma and low.strip() and high.strip()):
        raise ModelError(f"{text!r} is no range", where=option, fix="write LOW,HIGH, such as 0,1")
    return low.strip(), high.strip()


def _notes(audit: Audit, *, explain: bool) -> list[str]:
    """Return what a reader should know: above all on what an interval rests."""
    notes = [UNEXPLAINED] if explain and audit.unexplained else []
    if audit.interval is not None:
        notes += [f"assumed: {each}" for each in audit.interval.assumptions]
    return notes


def _of_interval(audit: Audit) -> dict[str, Any]:
    """Return the keys of an interval; none where there is none."""
    found = audit.interval
    if found is None:
        return {}
    more = dict(found.found)
    if isinstance(found, posterior.PosteriorInterval) and audit.max_regret is not None:
        more["probability_within"] = found.within(audit.max_regret)
    return {
        "regret_interval": audit.regret_interval,
        "confidence": found.confidence,
        "by": found.by,
        "interval": more,
        "assumptions": found.assumptions,
    }


def _page(report: Report, audit: Audit, model: str, learned: str) -> str:
    """Return the page of a report, its tables at full length."""
    words = click.get_current_context().find_root().obj
    told = {"verdict", *(each.name for each in audit.verdicts)}  # at the top of the page
    listed = [replace(each, first=ON_PAGE) for each in report.tables if len(each.rows)]
    return audit_page(
        audit,
        model=model,
        policy=learned,
        facts={
            name: fact(value)
            for name, value in report.facts.items()
            if value is not None and name not in told
        },
        tables=[
            {
                "heading": each.heading(),
                "note": each.note,
                "columns": list(each.columns),
                "numeric": each.numeric(),
                "rows": each.cells(),
            }
            for each in listed
        ],
        notes=[note for note in report.notes if note != ADVICE],  # at the foot of every page
        rerun=shlex.join(["exact-mdp", *words]),
    )


def _junit(
    path: str,
    model: str,
    learned: str,
    audit: Audit,
    seconds: float,
    told: dict[str, str],
    text: str,
) -> None:
    cases = [
        Case(name=each.name) if each.passed else Case(name=each.name, failure=each.told, text=text)
        for each in audit.verdicts
    ]
    properties = {
        "model": model,
        "learned": learned,
        "claim": str(audit.claim),
        "regret": repr(float(audit.regret.at_start.value)),
        "agreement": repr(audit.agreement),
        **told,
    }
    if audit.interval is not None:
        properties["regret_interval"] = str(audit.interval)
    suite = f"exact-mdp check {model}"
    write_junit(path, suite, cases, seconds=seconds, properties=properties)


def _result(audit: Audit) -> dict[str, Any]:
    mdp, lost = audit.mdp, audit.regret
    exact = isinstance(lost.at_start, Certified)
    costs = sum(each.cost for each in audit.disagreements)
    by_state = zip(mdp.space.labels(range(mdp.n_states)), lost.by_state.tolist(), strict=True)
    return {
        "passed": audit.passed,
        "claim": audit.claim,
        "regret_claim": audit.value.claim,
        "regret": float(lost.at_start.value),
        "exact_regret": lost.at_start.value if exact else None,
        "error_bound": 0.0 if isinstance(lost.at_start, Certified) else lost.at_start.error,
        "forgiven": _float_below(audit.forgiven),
        "relative_regret": audit.relative_regret,
        "optimal_value": float(lost.optimal.value),
        "learned_value": float(lost.learned.value),
        **_of_interval(audit),
        "max_regret": audit.max_regret,
        "max_relative_regret": audit.max_relative_regret,
        "checks": [
            {"name": each.name, "passed": each.passed, "text": each.text} for each in audit.verdicts
        ],
        "agreement": audit.agreement,
        "agreement_by_visits": audit.agreement_by_visits,
        "unclear": audit.unclear,
        "disagreements": [_disagreement(mdp, each, costs) for each in audit.disagreements],
        "regret_by_state": dict(by_state) if mdp.n_states <= LISTED_STATES else None,
        "q_error": audit.q_error,
    }


def _limits(audit: Audit) -> dict[str, Any]:
    """Return what is said of limits, as `solve` does; null without them."""
    under = audit.limits
    if under is None:
        return dict.fromkeys(["feasible", "limits", "kept", "totals", "prices", "closest", "room"])
    best = under.best
    return {
        "feasible": best.feasible,
        "limits": [str(limit) for limit in best.limits],
        "kept": [under.keeps(limit) for limit in best.limits],
        "totals": dict(under.totals),
        "prices": best.prices if best.feasible else None,
        "closest": best.closest,
        "room": under.room if best.feasible else None,
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
    if why is None:
        return {"representation": None, "rows": None}
    best = why.best
    policy = {
        best.policy.space.label(row) or "all states": best.policy.actions[int(taken.argmax())]
        for row, taken in enumerate(best.policy.table)
        if taken.max() > 0
    }
    return {
        "representation": {
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
        "rows": why.rows,
    }


def _facts(audit: Audit, why: Representation | None) -> dict[str, Any]:
    lost, relative = audit.regret, audit.relative_regret
    facts: dict[str, Any] = {"verdict": "passed" if audit.passed else "FAILED"}
    for each in audit.verdicts:
        word = "yes" if each.passed else "not decided" if each.undecided else "no"
        facts[each.name] = f"{word}: {each.text}"
    if audit.interval is not None:
        facts["regret of the process"] = f"{audit.interval} ({audit.claim})"
        for name, value in _of_interval(audit)["interval"].items():
            facts[f"{audit.interval.by}: {name.replace('_', ' ')}"] = (
                f"[{value[0]:.6g}, {value[1]:.6g}]" if isinstance(value, tuple) else value
            )
    facts["measured from"] = audit.begins
    if count := audit.never_reached:
        facts["wrong, but never reached from there"] = (
            f"{count} state{'s' * (count > 1)}, which cost nothing; --start STATE begins elsewhere"
        )
    if not audit.feasible:
        return facts | {"learned value": lost.learned}
    facts |= {
        "regret" if audit.interval is None else "regret in the estimated model": lost.at_start,
        "relative regret": relative
        if relative is not None
        else "undefined: the optimal value is infinite"
        if isinf(lost.optimal.value)
        else "undefined: the optimal value is, or may be, 0",
        "optimal value": lost.optimal,
        "learned value": lost.learned,
        "agreement": f"{audit.agreement:.1%} of the states with a choice, "
        + (
            "of the visits to them not known"
            if isnan(audit.agreement_by_visits)
            else f"{audit.agreement_by_visits:.1%} of the visits to them"
        ),
        "value of the room left under the limits": Certified(value=audit.limits.room)
        if audit.limits is not None
        else None,
        "not decided": f"in {audit.unclear} more states, by these bounds"
        if audit.unclear
        else None,
    }
    if q := audit.q_error:
        facts["Q-table"] = (
            f"promises {cell(q.promised)} at the start; its error: mean {cell(q.mean)}, root mean "
            f"square {cell(q.root_mean_square)} ({cell(q.visited)} by visits), at most "
            f"{cell(q.largest)} in {q.where}"
        )
    if why is not None:
        best = why.best
        proof = "proven" if best.proven else f"bound {cell(best.upper_bound)}"
        facts[f"best policy that reads {_read(best.columns)}"] = f"{cell(best.value)} ({proof})"
        facts["lost because of what it reads"] = why.loss
        facts["lost by learning"] = why.learning_error
    return facts


def _limit_table(audit: Audit) -> Table:
    under = audit.limits
    best = under and under.best
    priced = zip(best.limits, best.price, best.moved, strict=True) if best else ()
    rows = [
        {
            "limit": str(limit),
            "total": float(under.totals[limit.name]) if under else None,
            "kept": "yes" if under and under.keeps(limit) else "NO",
            "price": float(price),
            "closest": moved.text(10),
        }
        for limit, price, moved in priced
    ]
    last = {"price": "price:.6g"} if best and best.feasible else {"closest": "closest"}
    return Table(
        title="limits",
        rows=rows,
        columns={"limit": "limit", "yours": "total:.10g", "kept": "kept", **last},
        note="price: what the optimum gains for one point by which the limit is moved"
        if best and best.feasible
        else "closest: all are moved by the same step, the least with which a policy keeps them",
    )


def _tables(result: dict[str, Any], audit: Audit) -> list[Table]:
    return [
        _limit_table(audit),
        Table(
            title="where it is not optimal, the costliest first",
            note=COLUMNS,
            rows=[row for row in result["disagreements"] if row["expected_visits"] != 0],
            columns={
                "state": "state",
                "yours": "learned",
                "optimal": lambda row: either(row["optimal_actions"]),
                "value lost": "cost:.6g",
                "visits": "expected_visits:.6g",
                "share": "share:.1%",
            },
            first=SHOWN,
        ),
        Table(
            title="rows of the policy, each changed alone",
            rows=[vars(change) for change in result["rows"] or ()],
            columns={"row": "row", "yours": "learned", "better": "best", "gain": "gain"},
        ),
    ]


def _read(columns: tuple[str, ...]) -> str:
    return ", ".join(columns) or "nothing"
