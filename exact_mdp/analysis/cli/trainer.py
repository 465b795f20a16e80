"""What `exact-mdp check` does: of one policy, an audit; of several, the gate for their trainer."""

from __future__ import annotations

from time import perf_counter
from typing import Any

from exact_mdp.analysis import github
from exact_mdp.analysis.cli import check as one
from exact_mdp.analysis.cli.options import (
    Question,
    check_outputs,
    given,
    limits_from,
    policy_from,
)
from exact_mdp.analysis.cli.render import Report, Table, markdown
from exact_mdp.analysis.gate.junit import Case, write_junit
from exact_mdp.analysis.learning.trainers import TrainerAudit, check_trainer
from exact_mdp.mdp.errors import ModelError

PASSED, FAILED = 0, 1
SHARE, ALPHA = "9/10", "1/100"
SHOWN = 20
ASKING = ("model", "sets", "discount", "horizon", "criterion", *Question.__dataclass_fields__)


def check(
    *, learned: tuple[str, ...], share: str | None, alpha: str | None, prove: bool, **options: Any
) -> Report:
    """Audit one policy; or those of independent runs, until it is decided what share passes."""
    several = {"--share": share, "--alpha": alpha, "--prove": prove or None}
    if len(learned) > 1:
        return _runs(learned, share or SHARE, alpha or ALPHA, prove, **options)
    for option, value in several.items():
        if value is not None:
            raise ModelError(
                f"{option} is a question of several policies",
                where=option,
                fix="name the policy of each run, as in runs/*.npy",
            )
    return one.check(learned=learned[0], **options)


def _runs(
    learned: tuple[str, ...],
    share: str,
    alpha: str,
    prove: bool,
    *,
    max_regret: str | None,
    max_relative_regret: str | None,
    junit: str | None,
    certify: bool,
    subject_to: tuple[str, ...],
    kind: str,
    perception: str | None,
    **options: Any,
) -> Report:
    started = perf_counter()
    asking = {name: options.pop(name) for name in ASKING}
    if others := [name for name, value in options.items() if value]:
        option = f"--{others[0].replace('_', '-')}"
        raise ModelError(
            f"{option} does not apply to several policies", where=option, fix="leave it out"
        )
    check_outputs((junit, (".xml",)))
    asked = given(**asking)
    mdp, average = asked.mdp, asked.average
    found = check_trainer(
        mdp,
        (policy_from(mdp, name, perception, kind=kind, average=average) for name in learned),
        runs=len(learned),
        share=share,
        alpha=alpha,
        prove=prove,
        max_regret=max_regret,
        max_relative_regret=max_relative_regret,
        exact_values=True if certify else None,
        criterion="average" if average else "total",
        subject_to=limits_from(subject_to) or None,
    )
    rows = [row | {"policy": learned[row.pop("run")]} for row in found.frame().to_dict("records")]
    low, high = found.interval
    result = {
        "perception": perception,
        "passed": found.passed,
        "proven": found.proven,
        "claim": found.claim,
        "within": found.within,
        "runs": len(rows),
        "given": len(learned),
        "observed": found.value,
        "share_interval": [float(low), float(high)],
        "share": found.share,
        "alpha": found.alpha,
        "max_regret": found.audits[0].max_regret,
        "max_relative_regret": found.audits[0].max_relative_regret,
        "policies": rows,
    }
    report = asked.report(
        result,
        {"verdict": "passed" if found.passed else "FAILED", "found": found.message()},
        [
            Table(
                title="the runs, in the order given",
                note="share: of all runs, from and to; all these intervals hold together",
                rows=rows,
                columns={
                    "policy": "policy",
                    "regret": "regret",
                    "within the limits": lambda row: "yes" if row["passed"] else "NO",
                    "share from": "low:.3f",
                    "to": "high:.3f",
                },
                first=SHOWN,
            )
        ],
        status=PASSED if found.passed else FAILED,
    )
    title = f"{len(rows)} policies in {asked.loaded.name}: {'passed' if found.passed else 'failed'}"
    if junit is not None:
        _junit(junit, asked.loaded.name, found, perf_counter() - started)
    github.summarise(markdown(report, title))
    if not found.passed:
        github.annotate(title, found.message())
    return report


def _junit(path: str, model: str, found: TrainerAudit, seconds: float) -> None:
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
