"""`exact-mdp check`: the audit of one policy, or the gate for the trainer of several."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import exact_mdp
from exact_mdp.analysis import ci
from exact_mdp.analysis.cli.given import Given, list_advice
from exact_mdp.analysis.cli.render import format_report_markdown
from exact_mdp.analysis.cli.words import (
    limits_from,
    list_command_words,
    refuse_options,
    settings_of,
)
from exact_mdp.analysis.gate import check as gate
from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.layout import MOST_CELLS, arrange, build_cells
from exact_mdp.analysis.pages import ADVICE, render_page
from exact_mdp.mdp.errors import require_known_name
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.report import Report, Shown

if TYPE_CHECKING:
    from exact_mdp.analysis.learning.trainers import TrainerAudit

AT_THE_TOP = ("passed", "checks")  # of the page


def check_command(
    given: Given,
    learned: Sequence[str],
    *,
    max_regret: str | None = None,
    max_relative_regret: str | None = None,
    html: str | None = None,
    junit: str | None = None,
    certificate: str | None = None,
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
    share that is still open passes, so a trainer that is good enough fails with probability
    --alpha at most, wherever it stops.

    With --confidence, MODEL is one that `exact-mdp data` made, and the check passes if the upper
    end of an interval for the regret in the process behind the records keeps the limit.

    Example: exact-mdp check yuan2025 q_table.npy --max-regret 1/10
    Example: exact-mdp check tea runs/*.npy --share 9/10 --max-regret 1

    Parameters
    ----------
    max_regret : X, optional
        Greatest regret at the start: 0.1 or 1/10.
    max_relative_regret : X, optional
        Greatest regret over the absolute optimal value.
    html : FILE, .html
        Write a page with the picture of the policy: .html.
    junit : FILE, .xml
        Write a JUnit report: .xml.
    certificate : FILE, .json
        Write the proof of the regret for `verify`, whether the policy passes or not: .json. The
        regret has to be exact.
    certify : bool
        Use rational arithmetic, however long it takes.
    no_explain : bool
        Do not say which part of the loss is due to the columns that the policy reads, nor which
        rows to change first: much faster with --horizon.
    subject_to : 'NAME >= X', optional
        Keep an expected total at least (>=) or at most (<=) at X: of a component of the reward,
        steps, an event, or a sum such as 2*a-b. Exact.
    share : X, optional
        For several policies: the least share of all runs within the limits, 9/10 unless given.
    alpha : X, optional
        For several policies: how likely a failure by chance may be, 1/100 unless given.
    prove : bool
        For several policies: fail if the share is still open.
    confidence : C, optional
        For a model from records: decide by an interval at this confidence, such as 0.95.
    by : KIND, optional
        The method of the interval: robust, unless given, posterior or off-policy.
    evidence : NAME=VALUE, optional
        A setting of the method, as `Robust`, `Posterior` and `OffPolicy` take it in Python:
        rewards=known or rewards=LOW,HIGH, returns=LOW,HIGH, prior=1, n=2000 (models drawn), rng=0,
        n_jobs=1, records=FILE (trajectories), columns.state=NAME, behaviour=FILE (its
        probabilities).

    Keys
    ----
    Of Audit, TrainerAudit, RegretInterval, UnderLimits.
    checks: every check with its name, whether it passed, and why; regret: loss of the policy at the
    start; exact_regret: the regret, "p/q", or null; regret_claim: claim of the regret;
    regret_by_state: loss from each state; optimal_value: the optimal value at the start;
    learned_value: the value of the policy at the start; learned: the policy that was checked;
    limits: the limits, as they were given; kept: whether each limit is kept, or null; prices: gain
    of the optimum for each unit that a limit moves, "p/q"; closest: nearest values of the
    limits that some policy keeps; by: `robust`, `posterior` or `off-policy`; cells: with a
    horizon, for a policy without a time, the states where it is not optimal at some times, with the
    number of times; disagreements: states
    where it is not optimal, the costliest first, with state, learned, optimal, gap and
    expected_visits; rows: rows of the policy that were learned badly, with the gain of changing
    each; interval: intervals of both values and of the regret; max_regret: the limit given, or
    null; max_relative_regret: the relative limit given, or null; alpha: greatest probability of a
    failure by chance; share: the share that is required; share_interval: interval of the share,
    which holds after every run at once; observed: share of the runs within the limits; runs: runs
    judged; given: policies given; policies: each policy with its regret and whether it keeps the
    limits; proven: whether the share of all seeds is at least `share`, or null if that is open.
    """
    started = perf_counter()
    ci.append_summary("")  # fails here, before any work, if nothing can be written there
    given = given.with_limits(subject_to)
    asked: dict[str, Any] = {
        "max_regret": max_regret,
        "max_relative_regret": max_relative_regret,
        "exact_values": True if certify else None,
        "criterion": given.criterion,
        "subject_to": limits_from(subject_to) or None,
    }
    audit: Audit | TrainerAudit
    if certificate is not None:  # refused before any work
        unproven = {"--subject-to": subject_to, "--confidence": confidence}
        refuse_options(unproven, "a certificate", "leave it out, or --certificate")
    # One policy: an audit, of the model or of the process behind its records.
    if len(learned) == 1:
        of_many = {"--share": share, "--alpha": alpha, "--prove": prove}
        refuse_options(of_many, "a single policy", "name the policy of each run, as in runs/*.npy")
        (name,), asked = learned, asked | _read_interval_options(given, confidence, by, evidence)
        audit, report = _of_one(given, name, asked, explain=not no_explain)
    else:
        # Several policies: the runs of a trainer.
        of_one: dict[str, Any] = {"--html": html, "--no-explain": no_explain}
        of_one |= {"--confidence": confidence, "--by": by, "--evidence": evidence}
        of_one |= {"--certificate": certificate}
        refuse_options(of_one, "several policies")
        asked |= {"share": share or "9/10", "alpha": alpha or "1/100", "prove": prove}
        policies = (given.policy_from(each) for each in learned)
        audit = exact_mdp.check_trainer(given.mdp, policies, runs=len(learned), **asked)
        report = given.complete_report(audit.report(learned))
        name = f"{len(report.facts['policies'])} policies"
    if certificate is not None and isinstance(audit, Audit):
        audit.certificate.save(certificate)
    passed = "failed"
    if audit.passed:
        passed = "passed"
    report = replace(report, title=f"{name} in {given.loaded.name}: {passed}")
    # The page, the JUnit file, the summary of a job.
    if html is not None and isinstance(audit, Audit):
        write_atomically(html, _render_audit_page(audit, report, given.loaded.name, name))
    text = audit.message(explain=report.facts.get("representation") is not None)
    if junit is not None:
        _write_junit(junit, given, audit, name, text, perf_counter() - started)
    ci.append_summary(format_report_markdown(report))
    if not report.passed:
        ci.print_annotation(report.title, text)
    return report


def _of_one(
    given: Given, name: str, asked: Mapping[str, Any], *, explain: bool
) -> tuple[Audit, Report]:
    """Return the audit of one policy, and its report, which begins with the policy as read."""
    policy = given.policy_from(name)
    audit = gate.check(given.asked if "by" in asked else given.mdp, policy, **asked)
    report = given.complete_report(audit.report(explain=explain), policy=Shown(name), learned=name)
    if given.horizon is None:
        horizon = "none"
    else:
        horizon = f"{given.horizon:,} steps"
    facts = {"read_as": Shown(policy.read_as, policy.source or "a policy"), **report.facts}
    facts |= {"horizon": Shown(given.horizon, horizon), "start": Shown(given.start, audit.begins)}
    return audit, replace(report, facts=facts)


def _write_junit(
    path: str, given: Given, audit: Audit | TrainerAudit, name: str, text: str, seconds: float
) -> None:
    cases = []
    for each in audit.verdicts:
        if each.passed:
            cases.append(ci.Case(each.name))
        else:
            cases.append(ci.Case(each.name, "failure", each.told, text))
    model = given.loaded.name
    asked = {"question": given.in_words(), "sense": given.mdp.sense}
    values = {"model": model, "learned": name} | audit.measures
    values |= {key: said for key, said in asked.items() if said is not None}
    values |= {"notice": ADVICE} if list_advice(given.loaded) else {}
    properties = {key: str(value) for key, value in values.items()}
    ci.write_junit(path, f"exact-mdp check {model}", cases, seconds=seconds, properties=properties)


def _render_audit_page(audit: Audit, report: Report, model: str, policy: str) -> str:
    """Return the page: verdict, losses, the policy with its wrong states, every table."""
    layout = arrange(audit.mdp)
    legend = [f"{sign} {action}" for action, sign in layout.signs.items() if sign != action]
    return render_page(
        "audit.html.j2",
        model=model,
        policy=policy,
        passed=audit.passed,
        verdict="; ".join(map(str, audit.verdicts)),
        facts=[each for each in report.lines().items() if each[0] not in AT_THE_TOP],
        layout=layout,
        cells=build_cells(audit, layout) if layout.cells <= MOST_CELLS else [],
        legend=", ".join(legend),
        tables=[replace(each, first=2000) for each in report.shown_tables()],
        notes=[note for note in report.notes if note != ADVICE],  # at the foot of every page
        rerun=shlex.join(["exact-mdp", *list_command_words()]),
    )


def _read_interval_options(
    given: Given, confidence: str | None, by: str | None, evidence: Sequence[str]
) -> dict[str, Any]:
    """Return the interval options for a model whose episodes do not stop."""
    if confidence is None:
        fix = "give --confidence 0.95"
        refuse_options({"--by": by, "--evidence": evidence}, "a check without an interval", fix)
        return {}
    kind = gate.EVIDENCE[
        require_known_name(by or "robust", gate.EVIDENCE, "kind of interval", "--by")
    ]
    stated = settings_of(kind, evidence, "--evidence")
    if by == "posterior":
        stated["progress"] = True
    return {"horizon": given.horizon, "confidence": confidence, "by": kind(**stated)}
