"""Claims about learning (Sections 3.2.4, 3.2.5 and 4.1), held against many training runs.

The paper trains once with each exploration schedule; here each is trained with many seeds, so that
an outcome has a frequency. Final policies are judged by exact value. What the paper shows of its
runs is judged as an event ("a run like the paper's is nothing unusual"), what it says of training
in general by whether most runs here do so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial
from math import sqrt

import numpy as np

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import (
    Finding,
    PaperClaim,
    Verdict,
    entry,
    event,
    plotted,
    statement,
    undecided,
    usual,
)
from exact_mdp.paper_repro.claims.policies import ANGRY
from exact_mdp.paper_repro.learned import CONVERGED, SCHEDULES, settings
from exact_mdp.paper_repro.readings.learning import compatible, stated
from exact_mdp.paper_repro.view import View
from exact_mdp.solvers.solution import Bounded, Estimated

SHOWN = {"constant": "constant ε", "decaying": "decaying ε"}
EXPERIMENTS_OF_A_POINT = 40


def claims() -> Iterator[PaperClaim]:
    """Yield the claims about learning."""
    yield from _settings()
    yield from _curves()
    yield from _policies()


# ---- settings ----------------------------------------------------------------------------------


def _settings() -> Iterator[PaperClaim]:
    place = ("Section 3.2.4",)
    entries = [
        ("rate", "Learning rate.", "1/20", lambda s: Fraction(str(s.rate.values(1)[0]))),
        ("discount", "Discount factor in training.", "19/20", lambda s: Fraction(s.discount)),
        ("epochs", "Epochs.", "6000", lambda s: Fraction(s.epochs)),
        ("episodes", "Episodes of an epoch.", "30", lambda s: Fraction(s.episodes)),
        ("epsilon", "Constant ε.", "1/10", lambda s: Fraction(str(s.exploration.values(1)[0]))),
    ]
    for name, says, paper, read in entries:
        yield PaperClaim(
            id=f"training.{name}",
            places=place,
            says=f"{says} Used as stated.",
            rule="entry",
            kind="input",
            paper=Fraction(paper),
            find=partial(_setting, paper=Fraction(paper), read=read),
        )
    for epoch, paper in ((0, 1.0), (300, 0.8)):
        yield PaperClaim(
            id=f"equation2.epoch-{epoch}",
            places=("Equation 2",),
            says=f"Decaying ε at epoch {epoch}.",
            rule="statement",
            kind="input",
            paper=paper,
            find=partial(_epsilon, epoch=epoch, paper=paper),
        )
    yield PaperClaim(
        id="equation2.minimum",
        places=("Equation 2",),
        says="The least ε that the decay comes down to. Used as stated.",
        rule="entry",
        kind="input",
        paper=Fraction(3, 100),
        find=lambda view: entry(Fraction(3, 100), Fraction(str(SCHEDULES["decaying"].minimum))),
    )
    yield from _evaluation()


def _evaluation() -> Iterator[PaperClaim]:
    """Yield the settings of Section 3.2.5, as the code that uses them holds them."""
    from exact_mdp.analysis.learning import curves as learning_curves
    from exact_mdp.analysis.learning.outcomes import CANDIDATES

    place = ("Section 3.2.5",)
    entries = [
        ("snapshot", "Each epoch's policy is that of its 10th episode.", 10,
         lambda: settings("constant").snapshot_episode),
        ("experiments", "Each point of a learning curve is the average of 40 experiments.",
         EXPERIMENTS_OF_A_POINT, lambda: learning_curves.EXPERIMENTS),
        ("candidates", "The final policy is chosen among the five suggested most often.", 5,
         lambda: CANDIDATES),
    ]  # fmt: skip
    for name, says, paper, held in entries:
        yield PaperClaim(
            id=f"training.{name}",
            places=place,
            says=says,
            rule="entry",
            kind="input",
            paper=Fraction(paper),
            find=partial(_held, paper=Fraction(paper), held=held),
        )
    yield PaperClaim(
        id="training.selection-runs",
        places=place,
        says="The final policy is chosen by 10,000 experiments with each candidate.",
        rule="open",
        kind="input",
        paper=10_000,
        find=lambda view: undecided(
            "not used: here the candidates are compared by their exact values, what ever more "
            "experiments would come to"
        ),
    )


def _held(view: View, *, paper: Fraction, held: Callable[[], int]) -> Finding:
    return entry(paper, Fraction(held()))


def _setting(view: View, *, paper: Fraction, read: object) -> Finding:
    assert callable(read)
    return entry(paper, read(settings("constant")))


def _epsilon(view: View, *, epoch: int, paper: float) -> Finding:
    schedule = SCHEDULES["decaying"]
    value = float(schedule.values(epoch + 1)[epoch])
    last = float(schedule.values(6000)[-1])
    error = 1e-12
    found = statement(
        abs(value - paper) <= error,
        f"with λ = {schedule.decay:.6g}; it ends at ε = {last:.4f}",
        Bounded(value=value, error=error),
    )
    return replace(found, difference=value - paper)


# ---- curves ------------------------------------------------------------------------------------


def _curves() -> Iterator[PaperClaim]:
    where = ("Section 4.1", "Figure 9")
    for schedule, name in SHOWN.items():
        yield PaperClaim(
            id=f"learning.converged.{schedule}",
            places=where,
            says=f"With {name} the average return after convergence is about "
            f"{reported.CONVERGED_RETURN}.",
            rule="plotted",
            paper=reported.CONVERGED_RETURN,
            find=partial(_converged, schedule=schedule),
            learns=True,
        )
    yield PaperClaim(
        id="learning.similar",
        places=where,
        says="Both exploration schedules perform alike.",
        rule="statement",
        find=_similar,
        learns=True,
    )
    yield PaperClaim(
        id="learning.superior",
        places=where,
        says="After convergence both are above the random strategy.",
        rule="statement",
        find=_above_random,
        learns=True,
    )


def _estimate(values: np.ndarray) -> Estimated:
    error = float(values.std(ddof=1)) / sqrt(len(values))
    return Estimated(value=float(values.mean()), standard_error=error)


def _converged(view: View, *, schedule: str) -> Finding:
    learned = view.learned(schedule)
    tail = learned.converged
    low, high = np.quantile(tail, [0.05, 0.95])
    return plotted(
        reported.CONVERGED_RETURN,
        _estimate(tail),
        f"exact values of the greedy policies of the last {CONVERGED:,} epochs, mean of "
        f"{len(tail)} runs; nine runs in ten lie between {low:.1f} and {high:.1f}",
        low=float(low),
        high=float(high),
    )


def _similar(view: View) -> Finding:
    constant, decaying = (view.learned(schedule).converged for schedule in SCHEDULES)
    apart = float(decaying.mean() - constant.mean())
    error = sqrt(constant.var(ddof=1) / len(constant) + decaying.var(ddof=1) / len(decaying))
    point = view.study.evaluations["optimal"].sd / sqrt(EXPERIMENTS_OF_A_POINT)
    return statement(
        abs(apart) <= 2 * point,
        f"decaying less constant: {apart:+.2f}, less than twice the standard error {point:.1f} "
        f"of one point of the plot ({EXPERIMENTS_OF_A_POINT} experiments)",
        Estimated(value=apart, standard_error=error),
    )


def _above_random(view: View) -> Finding:
    random = view.study.evaluations["random"].mean
    runs = np.concatenate([view.learned(schedule).converged for schedule in SCHEDULES])
    above = int((runs > random).sum())
    return statement(
        above == len(runs),
        f"{above} of {len(runs)} runs end above {random:.1f}; the lowest at {runs.min():.1f}",
    )


# ---- policies ----------------------------------------------------------------------------------


def _policies() -> Iterator[PaperClaim]:
    where = ("Section 4.1", "Figure 10")
    for schedule, name in SHOWN.items():
        yield PaperClaim(
            id=f"learning.unique.{schedule}",
            places=("Section 4.1", "Section 3.2.5"),
            says=f"With {name} {reported.UNIQUE_POLICIES[schedule]} unique policies are suggested "
            "in the last 100 episodes of the run.",
            rule="event",
            paper=reported.UNIQUE_POLICIES[schedule],
            find=partial(_unique, schedule=schedule),
            learns=True,
        )
        yield PaperClaim(
            id=f"learning.anger.{schedule}",
            places=where,
            says=f"The run with {name} learns supportive assistance in all eight statuses with "
            "anger.",
            rule="event",
            find=partial(_angry, schedule=schedule),
            learns=True,
        )
        yield PaperClaim(
            id=f"learning.stated.{schedule}",
            places=where,
            says=f"The run with {name} learns the stated actions of 1100, 1000 and 0100.",
            rule="event",
            find=partial(_stated, schedule=schedule),
            learns=True,
        )
    yield PaperClaim(
        id="learning.same-but-first",
        places=where,
        says="The policies of the two runs, one of each schedule, differ in status 0000 alone.",
        rule="event",
        find=_same_but_first,
        learns=True,
    )
    yield PaperClaim(
        id="learning.one-run-all-three",
        places=("Section 4.1",),
        says="The policies of a run's last 100 episodes differ in status 0000 alone.",
        rule="event",
        find=_differ_in_first,
        learns=True,
    )
    yield PaperClaim(
        id="learning.selection",
        places=("Section 3.2.5", "Section 4.1"),
        says="Choosing among the five most frequent policies gives the final, optimal policy.",
        rule="usual",
        find=_selection,
        learns=True,
    )
    yield PaperClaim(
        id="learning.first-status-unsettled",
        places=("Section 4.1", "Section 4.3"),
        says="The best assistance in status 0000 is hard to tell because of the model's chance.",
        rule="statement",
        find=_unsettled,
        learns=True,
    )


def _unique(view: View, *, schedule: str) -> Finding:
    distinct, paper = view.learned(schedule).outcomes.distinct, reported.UNIQUE_POLICIES[schedule]
    seen = int((distinct == paper).sum())
    found = event(seen, len(distinct), "")
    average = _estimate(distinct.astype(float))
    return replace(
        found,
        why=f"{found.shown} end with exactly {paper}; the mean number is {average.value:.2f}, the "
        f"range {distinct.min()} to {distinct.max()}",
        number=average,
        shown="",
        difference=average.value - paper,
        details={**found.details, "share": seen / len(distinct)},
    )


def _angry(view: View, *, schedule: str) -> Finding:
    final = view.learned(schedule).final
    angry = [int(status, 2) for status in ANGRY]
    all_right = int((final[:, angry] == 1).all(axis=1).sum())
    each = (final[:, angry] == 1).mean(axis=0)
    worst = ANGRY[int(each.argmin())]
    return event(
        all_right,
        len(final),
        f"{1 - all_right / len(final):.0%} of the runs do not; status by status supportive is "
        f"learned by {each.min():.0%} ({worst}) to {each.max():.0%} of the runs",
    )


def _stated(view: View, *, schedule: str) -> Finding:
    final = view.learned(schedule).final
    orders = {order: sum(stated(policy, [order]) for policy in final) for order in reported.ORDERS}
    shares = ", ".join(f"{order} {count / len(final):.1%}" for order, count in orders.items())
    whole = sum(compatible(policy) for policy in final)
    return event(
        sum(orders.values()),
        len(final),
        f"by the order of 1000 and 0100: {shares} of the runs; all that the text says of a policy, "
        f"anger and 0000 included, holds for {whole / len(final):.1%}",
        orders=orders,
        compatible=whole,
    )


def _same_but_first(view: View) -> Finding:
    constant, decaying = (view.learned(schedule).final for schedule in SCHEDULES)
    apart = constant != decaying
    rest, first = apart[:, 1:].sum(axis=1), apart[:, 0]
    both = int(((rest == 0) & first).sum())
    return event(
        both,
        len(apart),
        f"of pairs of runs; {int((rest == 0).sum())} agree outside 0000, and the mean pair differs "
        f"in {rest.mean():.1f} of the other 15 statuses",
    )


def _differ_in_first(view: View) -> Finding:
    changed = np.concatenate([view.learned(schedule).outcomes.changed for schedule in SCHEDULES])
    only = changed[:, 0] & ~changed[:, 1:].any(axis=1)
    anywhere = int(changed.any(axis=1).sum())
    return event(
        int(only.sum()), len(changed), f"of the runs of both schedules; {anywhere} change anywhere"
    )


def _selection(view: View) -> Finding:
    parts = [view.learned(schedule).outcomes for schedule in SCHEDULES]
    kept = np.concatenate([part.selected_regret for part in parts])
    last = np.concatenate([part.regret for part in parts])
    return usual(
        int((kept == 0).sum()),
        len(kept),
        f"{(kept == 0).mean():.0%} of the runs end with an optimal policy where the selection is "
        f"made by exact value, the best that any choice among the five can do; the mean regret is "
        f"{kept.mean():.2f} after the selection and {last.mean():.2f} before",
    )


def _unsettled(view: View) -> Finding:
    """Compare what is lost by the runner-up in 0000 with what learning's noise moves."""
    final = np.concatenate([view.learned(schedule).final[:, 0] for schedule in SCHEDULES])
    shares = np.bincount(final, minlength=view.mdp.n_actions) / len(final)
    names = [f"{name} {share:.0%}" for name, share in zip(view.mdp.actions, shares, strict=True)]
    optimum = view.study.evaluations["optimal"]
    start = view.mdp.start[0][0]
    q = optimum.mdp.backup(np.nan_to_num(optimum.value))[list(view.mdp.pairs_of(start))]
    order = np.sort(q)[::-1]
    return Finding(
        verdict=Verdict.REPRODUCED if shares.max() < 0.95 else Verdict.NOT_REPRODUCED,
        why=f"final actions in 0000 over {len(final)} runs: {', '.join(names)}; taking the second "
        f"best action once costs {order[0] - order[1]:.2f}",
        shown=f"the commonest action has {shares.max():.0%}",
    )
