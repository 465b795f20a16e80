"""The gate: does a learned policy lose more than it may?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from fractions import Fraction
from math import inf, nextafter
from typing import TYPE_CHECKING, Any

import click

from exact_mdp.analysis.cli.options import (
    POLICY_HELP,
    check_outputs,
    horizon_option,
    kind_option,
    model_options,
    perception_option,
    read_as,
    stopped,
    tell_limit,
)
from exact_mdp.analysis.cli.render import Grid, number, show

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.audit import Audit
    from exact_mdp.analysis.gate.disagreements import Disagreement
    from exact_mdp.analysis.gate.representation import Representation
    from exact_mdp.mdp.model import MDP

PASSED, FAILED = 0, 1
SHOWN = 10  # disagreements in the table for people
LISTED_STATES = 1000  # models with more states are left to Python for the regret of each


@click.command(
    short_help="Audit a learned policy or Q-table; exit status 1 where it loses too much.",
    epilog=POLICY_HELP,
)
@click.argument("model")
@click.argument("learned")
@click.option("--max-regret", metavar="X", help="Greatest regret at the start: 0.1 or 1/10.")
@click.option(
    "--max-relative-regret", metavar="X", help="Greatest regret over the absolute optimal value."
)
@click.option("--junit", metavar="FILE", help="Write a JUnit report: .xml.")
@click.option("--certify", is_flag=True, help="Rational arithmetic, however long it takes.")
@click.option(
    "--no-explain", is_flag=True, help="Leave out what the policy's columns cannot express."
)
@kind_option
@perception_option
@horizon_option
@model_options
def check(
    model: str,
    learned: str,
    max_regret: str | None,
    max_relative_regret: str | None,
    junit: str | None,
    certify: bool,
    no_explain: bool,
    kind: str,
    perception: str | None,
    horizon: str | None,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
) -> int:
    """Hold LEARNED, a policy or Q-table, against the exact optimum of MODEL.

    Passes where the regret at the start is within the limits; what bounds leave open does not pass.
    Without a limit it passes where the regret is zero: exactly, but for what half a unit in the
    last place of the model's floats can move. --max-regret 0 forgives nothing. LEARNED is a POLICY;
    of a Q-table the greedy policy counts.
    """
    from time import perf_counter

    from exact_mdp.analysis.cli.options import policy_of
    from exact_mdp.analysis.gate import check as compare
    from exact_mdp.analysis.gate.audit import UNEXPLAINED
    from exact_mdp.mdp.io.load import load

    started = perf_counter()
    check_outputs((junit, (".xml",)))
    loaded, steps = stopped(load(model, sets=sets, discount=discount), horizon)
    given = policy_of(loaded.mdp, learned, perception, kind=kind)
    audit = compare.check(
        loaded.mdp,
        given,
        max_regret=max_regret,
        max_relative_regret=max_relative_regret,
        exact_values=True if certify else None,
    )
    why = None if no_explain else audit.representation
    if junit is not None:
        _report(
            junit, loaded.name, learned, audit, perf_counter() - started, explain=why is not None
        )
    result = {"model": loaded.name, "learned": learned, "perception": perception, "horizon": steps}
    result |= _result(audit)
    result |= _reasons(audit, why)
    if not no_explain and audit.unexplained:
        click.echo(f"note: {UNEXPLAINED}", err=True)
    facts = read_as(given) | _facts(result)
    tell_limit(loaded.mdp)
    show(result, as_json=as_json, facts=facts, grids=_grids(result))
    return PASSED if audit.passed else FAILED


def _report(
    path: str, model: str, learned: str, audit: Audit, seconds: float, *, explain: bool
) -> None:
    from exact_mdp.analysis.gate.junit import Case, write_junit

    text = audit.message(explain=explain)
    cases = [
        Case(name=each.name)
        if each.passed
        else Case(name=each.name, failure=f"{each.name}; {each.text}", text=text)
        for each in audit.verdicts
    ]
    properties = {
        "model": model,
        "learned": learned,
        "claim": str(audit.claim),
        "regret": repr(float(audit.regret.at_start.value)),
        "agreement": repr(audit.agreement),
    }
    suite = f"exact-mdp check {model}"
    write_junit(path, suite, cases, seconds=seconds, properties=properties)


def _result(audit: Audit) -> dict[str, Any]:
    from exact_mdp.solvers.solution import Certified

    mdp, lost = audit.mdp, audit.regret
    exact = isinstance(lost.at_start, Certified)
    by_state = zip(mdp.space.labels(range(mdp.n_states)), lost.by_state.tolist(), strict=True)
    return {
        "discount": mdp.discount,
        "read_as": audit.read_as,
        "passed": audit.passed,
        "claim": audit.claim,
        "regret": float(lost.at_start.value),
        "exact_regret": lost.at_start.value if exact else None,
        "error_bound": 0.0 if isinstance(lost.at_start, Certified) else lost.at_start.error,
        "forgiven": _float_below(audit.forgiven),
        "relative_regret": audit.relative_regret,
        "optimal_value": float(lost.optimal.value),
        "learned_value": float(lost.learned.value),
        "max_regret": audit.max_regret,
        "max_relative_regret": audit.max_relative_regret,
        "checks": [asdict(verdict) for verdict in audit.verdicts],
        "agreement": audit.agreement,
        "agreement_by_visits": audit.agreement_by_visits,
        "unclear": audit.unclear,
        "disagreements": [_disagreement(mdp, each) for each in audit.disagreements],
        "regret_by_state": dict(by_state) if mdp.n_states <= LISTED_STATES else None,
        "q_error": asdict(audit.q_error) if audit.q_error else None,
    }


def _float_below(number: Fraction) -> float:
    """Return the greatest float that is not above a number."""
    rounded = float(number)
    return rounded if rounded <= number else nextafter(rounded, -inf)


def _disagreement(mdp: MDP, each: Disagreement) -> dict[str, Any]:
    return {
        "state": each.label,
        "number": each.state,
        "columns": dict(mdp.space.as_dict(each.state)),
        "learned": each.learned,
        "optimal": each.optimal[0],
        "optimal_actions": each.optimal,
        "gap": each.gap,
        "expected_visits": each.expected_visits,
        "cost": each.cost,
        "gain_if_corrected": each.gain_if_corrected,
        "loss_if_alone": each.loss_if_alone,
    }


def _reasons(audit: Audit, why: Representation | None) -> dict[str, Any]:
    if why is None:
        return {"representation": None, "memory": None, "rows": None}
    best = why.best
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
            "policy": {
                best.policy.space.label(row) or "all states": best.policy.actions[
                    int(taken.argmax())
                ]
                for row, taken in enumerate(best.policy.table)
                if taken.max() > 0
            },
        },
        "memory": [
            {
                "columns": each.columns,
                "value": each.value.value,
                "upper_bound": each.upper_bound,
                "proven": each.proven,
                "worth": each.value.value - best.value.value,
            }
            for each in why.memory
        ],
        "rows": [asdict(change) for change in why.rows],
    }


def _facts(result: dict[str, Any]) -> dict[str, str]:
    error = result["error_bound"]
    facts = {
        "model": result["model"],
        "learned": result["learned"],
        **({"horizon": f"{result['horizon']:,} steps"} if result["horizon"] else {}),
        "verdict": "passed" if result["passed"] else "FAILED",
    }
    for each in result["checks"]:
        facts[each["name"]] = f"{'yes' if each['passed'] else 'no'}: {each['text']}"
    facts |= {
        "regret": f"{number(result['regret'], error)} ({result['claim']})",
        "relative regret": "undefined: the optimal value is, or may be, 0"
        if result["relative_regret"] is None
        else number(result["relative_regret"]),
        "optimal value": number(result["optimal_value"], error),
        "learned value": number(result["learned_value"], error),
        "agreement": f"{result['agreement']:.1%} of the states with a choice, "
        f"{result['agreement_by_visits']:.1%} of the visits to them",
    }
    if result["unclear"]:
        facts["not decided"] = f"by the bounds, in {result['unclear']} more states"
    if q := result["q_error"]:
        facts["Q-table"] = (
            f"promises {number(q['promised'])} at the start; root mean square error "
            f"{number(q['root_mean_square'])}, at most {number(q['largest'])} in {q['where']}"
        )
    if why := result["representation"]:
        read = ", ".join(why["columns"]) or "nothing"
        proof = "proven" if why["proven"] else f"upper bound {number(why['upper_bound'])}"
        facts[f"best that reads {read}"] = f"{number(why['best_value'])} ({proof})"
        facts["lost by what it reads"] = number(why["loss"])
        facts["lost by learning"] = number(why["learning_error"])
    return facts


def _grids(result: dict[str, Any]) -> list[Grid]:
    grids = []
    if listed := result["disagreements"]:
        rows = [
            (
                f"{each['state']}\n{each['learned']}, not {' or '.join(each['optimal_actions'])}",
                *(_short(each[key]) for key in ("gap", "expected_visits", "cost")),
                _short(each["gain_if_corrected"]),
            )
            for each in listed[:SHOWN]
        ]
        more = f", the {SHOWN} costliest of {len(listed)}" if len(listed) > SHOWN else ""
        title = f"not optimal{more} (gain: put right alone)"
        grids.append(_grid(title, ("state", "gap", "visits", "cost", "gain"), rows, {1, 2, 3, 4}))
    if result["rows"]:
        changes = [
            (each["row"], each["learned"], each["best"], number(each["gain"]))
            for each in result["rows"]
        ]
        title = "rows of the policy, each changed alone"
        grids.append(_grid(title, ("row", "learned", "better", "gain"), changes, {3}))
    if result["memory"] and len(result["memory"]) > 1:
        found = [
            (
                ", ".join(each["columns"]) or "nothing",
                number(each["value"]),
                number(each["worth"]),
                "yes" if each["proven"] else f"at most {number(each['upper_bound'])}",
            )
            for each in result["memory"]
        ]
        title = "what remembering more is worth"
        grids.append(_grid(title, ("reads", "best value", "worth", "proven"), found, {1, 2}))
    return grids


def _grid(
    title: str, headings: tuple[str, ...], rows: Sequence[tuple[str, ...]], numeric: set[int]
) -> Grid:
    return Grid(title=title, headings=headings, rows=rows, numeric=frozenset(numeric))


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}"
