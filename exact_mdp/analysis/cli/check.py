"""`exact-mdp check`: of one policy, an audit; of several, the gate for their trainer."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

from exact_mdp.analysis import ci
from exact_mdp.analysis.cli.given import Given, advice
from exact_mdp.analysis.cli.render import markdown
from exact_mdp.analysis.cli.words import check_outputs, limits_from, refuse, settings_of, typed
from exact_mdp.analysis.gate import check as gate
from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.layout import MOST_CELLS, arrange, cells, counts
from exact_mdp.analysis.learning.trainers import TrainerAudit, check_trainer
from exact_mdp.analysis.pages.page import ADVICE, render
from exact_mdp.mdp.errors import ModelError, known
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.report import Report, Shown

ON_PAGE = 2000  # disagreements
AT_THE_TOP = ("passed", "checks")  # of the page


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

    Example: exact-mdp check yuan2025 q_table.npy --max-regret 1/10
    Example: exact-mdp check tea runs/*.npy --share 9/10 --max-regret 1

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
        Leave out which part of the loss is due to what the policy reads, and which of its rows to
        change first: much faster with --horizon.
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

    Keys
    ----
    Of Audit, TrainerAudit, RegretInterval, UnderLimits.
    checks: every check with its name, whether it passed, and why; regret: loss of the policy at the
    start; exact_regret: the regret, "p/q", or null; regret_claim: claim of the regret;
    regret_by_state: loss from each state; optimal_value: the optimal value at the start;
    learned_value: the value of the policy at the start; learned: the policy that was checked;
    limits: the limits, as they were given; kept: whether each limit is kept, or null; prices: gain
    of the optimum for each unit by which a limit moves, "p/q"; closest: nearest values of the
    limits that some policy keeps; by: `robust`, `posterior` or `off-policy`; disagreements: states
    where it is not optimal, the costliest first, with state, learned, optimal, gap and
    expected_visits; rows: rows of the policy that were learned badly, with the gain of changing
    each; interval: intervals of both values and of the regret; max_regret: the limit given, or
    null; max_relative_regret: the relative limit given, or null; alpha: greatest probability of a
    failure by chance; share: the share that is required; share_interval: interval of the share,
    which holds after every run at once; observed: share of the runs within the limits; runs: runs
    judged; given: policies given; policies: each policy with its regret and whether it keeps the
    limits.
    """
    started, single = perf_counter(), len(learned) == 1
    if single:
        of_many = {"--share": share, "--alpha": alpha, "--prove": prove}
        refuse(of_many, "a single policy", "name the policy of each run, as in runs/*.npy")
    else:
        of_one: dict[str, Any] = {"--html": html, "--confidence": confidence, "--by": by}
        refuse(of_one | {"--evidence": evidence, "--no-explain": no_explain}, "several policies")
    check_outputs((junit, (".xml",)), (html, (".html",)))
    ci.summarise("")  # where it cannot be written to, that is said before any work
    asked: dict[str, Any] = {
        "max_regret": max_regret,
        "max_relative_regret": max_relative_regret,
        "exact_values": True if certify else None,
        "criterion": given.criterion,
        "subject_to": limits_from(subject_to) or None,
    }
    audit: Audit | TrainerAudit
    if single:
        audit, report = _audited(given, learned[0], not no_explain, asked, confidence, by, evidence)
    else:
        policies = (given.policy(name) for name in learned)
        asked |= {"share": share or "9/10", "alpha": alpha or "1/100", "prove": prove}
        audit = check_trainer(given.mdp, policies, runs=len(learned), **asked)
        report = given.report(audit.report(learned))
    name = learned[0] if single else f"{len(report.facts['policies'])} policies"
    passed = "passed" if audit.passed else "failed"
    report = replace(report, title=f"{name} in {given.loaded.name}: {passed}")
    _publish(given, audit, report, name, (junit, html), perf_counter() - started)
    return report


def _publish(
    given: Given,
    audit: Audit | TrainerAudit,
    report: Report,
    name: str,
    files: tuple[str | None, str | None],
    seconds: float,
) -> None:
    """Write the JUnit report, the page and what GitHub shows of a step, where these are wanted."""
    (junit, html), model = files, given.loaded.name
    text = audit.message(explain=report.facts.get("representation") is not None)
    if junit is not None:
        cases = [
            ci.Case(each.name) if each.passed else ci.Case(each.name, "failure", each.told, text)
            for each in audit.verdicts
        ]
        values = {"model": model, "learned": name} | audit.measures
        values |= {"notice": ADVICE} if advice(given.endless) else {}
        properties = {key: str(value) for key, value in values.items()}
        suite = f"exact-mdp check {model}"
        ci.write_junit(junit, suite, cases, seconds=seconds, properties=properties)
    if html is not None and isinstance(audit, Audit):
        write_atomically(html, _page(audit, report, model, name))
    ci.summarise(markdown(report))
    if not report.passed:
        ci.annotate(report.title, text)


def _page(audit: Audit, report: Report, model: str, policy: str) -> str:
    """Return the page: verdict, what is lost, the policy with its wrong states, every table."""
    layout, actions = arrange(audit.mdp), audit.mdp.actions
    grid = cells(audit, layout) if layout.cells <= MOST_CELLS else []
    texts = [text for row in grid for each in row if each for text in (each.text, each.small)]
    legend = [f"{a} {b}" for a, b in zip(layout.signs, actions, strict=True) if a != b]
    return render(
        "audit.html.j2",
        model=model,
        policy=policy,
        passed=audit.passed,
        verdict="; ".join(map(str, audit.verdicts)),
        facts=[each for each in report.lines().items() if each[0] not in AT_THE_TOP],
        layout=layout,
        cells=grid,
        legend=", ".join(legend + counts(texts)),
        tables=[replace(each, first=ON_PAGE) for each in report.shown_tables()],
        notes=[note for note in report.notes if note != ADVICE],  # at the foot of every page
        rerun=shlex.join(["exact-mdp", *typed()]),
    )


def _audited(
    given: Given,
    learned: str,
    explain: bool,
    asked: dict[str, Any],
    confidence: str | None,
    by: str | None,
    evidence: Sequence[str],
) -> tuple[Audit, Report]:
    """Return the audit of one policy, and what it says."""
    if confidence is None and (by is not None or evidence):
        option = "--evidence" if by is None else "--by"
        what = f"{option} applies to an interval"
        raise ModelError(what, where=option, fix="give --confidence 0.95")
    mdp = given.mdp
    if confidence is not None:
        kind = gate.EVIDENCE[known(by or "robust", gate.EVIDENCE, "kind of interval", "--by")]
        stated = settings_of(kind, evidence, "--evidence")
        if by == "posterior":
            stated["progress"] = True
        # An interval needs the counts, which a model of episodes that stop has not.
        mdp, asked = given.asked, asked | {"horizon": given.horizon, "confidence": confidence}
        asked["by"] = kind(**stated)
    policy = given.policy(learned)
    audit = gate.check(mdp, policy, **asked)
    names = {"policy": Shown(learned), "learned": learned}
    report = given.report(audit.report(explain=explain), **names)
    read_as = {"read_as": Shown(policy.read_as, policy.source or None)}
    return audit, replace(report, facts=read_as | {**report.facts})
