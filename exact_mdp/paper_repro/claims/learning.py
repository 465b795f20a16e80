"""Claims about learning (Sections 3.2.4, 3.2.5 and 4.1), compared with many training runs.

The paper trains once with each exploration schedule; here each is trained with many seeds, so that
an outcome has a frequency. Final policies are judged by exact value. What the paper shows of its
runs is judged as an event ("a run like the paper's is nothing unusual"), what it says of training
in general by whether most runs here do so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.learning.curves import EXPERIMENTS as POINT
from exact_mdp.analysis.learning.outcomes import CANDIDATES, Outcomes, share_interval
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import (
    Claims,
    Finding,
    Verdict,
    event,
    plotted,
    share_error,
    statement,
    undecided,
    usual,
)
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.readings.training import CONVERGED, SETTINGS, SHOWN, settings_of
from exact_mdp.paper_repro.reported import ANGRY, CONVERGED_RETURN, NUMBER, ORDERS, UNIQUE_POLICIES
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.schedules import PAPER_DECAYING, Exponential
from exact_mdp.solvers.solution import Bounded, Estimated

CLAIMS = Claims()
SETTLED = 0.95  # share of runs with one action, from which on a status counts as settled

# ---- settings, as the code that uses them holds them -------------------------------------------

_POLICY = "Each epoch's policy is that of its 10th episode"
_CURVE = "Each point of a learning curve is the average of 40 experiments"
_CHOSEN = "The final policy is chosen among the five suggested most often"


def _epsilon(reading: Reading, epoch: int, paper: float) -> Finding:
    code = settings_of("decaying", reading.training)
    falling, error = code.exploration, 1e-12
    assert isinstance(falling, Exponential)
    value, last = float(falling.values(epoch + 1)[epoch]), float(falling.values(code.epochs)[-1])
    return statement(
        abs(value - paper) <= error,
        f"with λ = {falling.decay:.6g}; it ends at ε = {last:.4f}",
        Bounded(value=value, error=error),
        difference=value - paper,
    )


def _setting(
    name: str, source: str, says: str, paper: str, held: Callable[[QLearning], object]
) -> None:
    def work(reading: Reading) -> Fraction:
        return Fraction(str(held(settings_of("constant", reading.training))))

    CLAIMS.entry(name, source, says, paper, work)


for _name, _paper, _held, _says in (
    ("rate", "1/20", lambda code: code.rate.values(1)[0], "Learning rate."),
    ("discount", "19/20", lambda code: code.discount, "Discount factor in training."),
    ("epochs", "6000", lambda code: code.epochs, "Epochs."),
    ("episodes", "30", lambda code: code.episodes, "Episodes of an epoch."),
    ("epsilon", "1/10", lambda code: code.exploration.value, "Constant ε."),
):
    _setting(f"training.{_name}", "Section 3.2.4", f"{_says} Used as stated.", _paper, _held)
for _epoch, _value in ((0, 1.0), (300, 0.8)):
    _name, _says = f"equation2.epoch-{_epoch}", f"Decaying ε at epoch {_epoch}."
    _keep = CLAIMS.add(_name, "Equation 2", says=_says, kind="input", paper=_value)
    _keep(partial(_epsilon, epoch=_epoch, paper=_value))
_says = "The least ε that the decay comes down to. Used as stated."
_setting("equation2.minimum", "Equation 2", _says, "3/100", lambda code: PAPER_DECAYING.minimum)
for _name, _paper, _held, _says in (
    (
        "snapshot",
        "10",
        lambda code: code.snapshot_episode,
        _POLICY,
    ),
    (
        "experiments",
        "40",
        lambda code: POINT,
        _CURVE,
    ),
    ("candidates", "5", lambda code: CANDIDATES, _CHOSEN),
):
    _setting(f"training.{_name}", "Section 3.2.5", f"{_says}.", _paper, _held)


@CLAIMS.add("training.selection-runs", "Section 3.2.5", "open", kind="input", paper=10000)
def _selection_runs(reading: Reading) -> Finding:
    """The final policy is chosen by 10,000 experiments with each candidate."""
    return undecided(
        "not used: here the candidates are compared by their exact values, what ever more "
        "experiments would come to"
    )


# ---- curves ------------------------------------------------------------------------------------


def _estimate(values: Floats | Integers) -> Estimated:
    error = float(values.std(ddof=1)) / sqrt(len(values))
    return Estimated(value=float(values.mean()), standard_error=error)


def _converged(reading: Reading, schedule: str) -> Finding:
    tail = reading.learned(schedule).converged
    low, high = np.quantile(tail, [0.05, 0.95]).tolist()
    return plotted(
        CONVERGED_RETURN,
        _estimate(tail),
        f"exact values of the greedy policies of the last {CONVERGED:,} epochs, mean of "
        f"{len(tail)} runs; nine runs in ten lie between {low:.1f} and {high:.1f}",
        low=low,
        high=high,
    )


for _schedule, _shown in SHOWN.items():
    CLAIMS.add(
        f"learning.converged.{_schedule}",
        "Section 4.1, Figure 9",
        "plotted",
        says=f"With {_shown} the average return after convergence is about {CONVERGED_RETURN}.",
        paper=CONVERGED_RETURN,
        learns=True,
    )(partial(_converged, schedule=_schedule))


@CLAIMS.add("learning.similar", "Section 4.1, Figure 9", learns=True)
def _similar(reading: Reading) -> Finding:
    """Both exploration schedules perform alike."""
    constant, decaying = (reading.learned(schedule).converged for schedule in SETTINGS)
    apart = float(decaying.mean() - constant.mean())
    error = sqrt(constant.var(ddof=1) / len(constant) + decaying.var(ddof=1) / len(decaying))
    point = reading.evaluations["optimal"].sd / sqrt(POINT)
    alike = abs(apart) <= 2 * point
    return statement(
        alike,
        f"decaying less constant: {apart:+.2f}, {'at most' if alike else 'more than'} twice the "
        f"standard error {point:.1f} of one point of the plot ({POINT} experiments)",
        Estimated(value=apart, standard_error=error),
        f"{apart:+.2f} points apart".replace("-", "−"),
    )


@CLAIMS.add("learning.superior", "Section 4.1, Figure 9", learns=True)
def _above_random(reading: Reading) -> Finding:
    """After convergence both are above the random strategy."""
    random = reading.evaluations["random"].mean
    runs = np.concatenate([reading.learned(schedule).converged for schedule in SETTINGS])
    above = int((runs > random).sum())
    return statement(
        above == len(runs),
        f"{above} of {len(runs)} runs end above {random:.1f}; the lowest at {runs.min():.1f}",
    )


# ---- policies ----------------------------------------------------------------------------------


def _unique(reading: Reading, schedule: str) -> Finding:
    distinct, paper = reading.learned(schedule).outcomes.distinct, UNIQUE_POLICIES[schedule]
    seen = int((distinct == paper).sum())
    found, average = event(seen, len(distinct), ""), _estimate(distinct)
    return replace(
        found,
        why=f"{found.shown} end with exactly {paper}; the mean number is {average.value:.2f}, the "
        f"range {distinct.min()} to {distinct.max()}",
        number=average,
        shown="",
        difference=average.value - paper,
        details={**found.details, "share": seen / len(distinct)},
    )


def _angry(reading: Reading, schedule: str) -> Finding:
    final = reading.learned(schedule).final
    supportive = final[:, [int(status, 2) for status in ANGRY]] == NUMBER["supportive"]
    right, each = int(supportive.all(axis=1).sum()), supportive.mean(axis=0)
    return event(
        right,
        len(final),
        f"{1 - right / len(final):.0%} of the runs do not; status by status supportive is "
        f"learned by {each.min():.0%} ({ANGRY[int(each.argmin())]}) to {each.max():.0%} of the "
        "runs",
    )


def _stated(reading: Reading, schedule: str) -> Finding:
    final = reading.learned(schedule).final
    orders = {order: sum(reported.states(policy, [order]) for policy in final) for order in ORDERS}
    shares = ", ".join(f"{order} {count / len(final):.1%}" for order, count in orders.items())
    whole = sum(reported.compatible(policy) for policy in final)
    return event(
        sum(orders.values()),
        len(final),
        f"by the order of 1000 and 0100: {shares} of the runs; all that the text says of a policy, "
        f"anger and 0000 included, holds for {whole / len(final):.1%}",
        orders=orders,
        compatible=whole,
    )


for _schedule, _shown in SHOWN.items():
    CLAIMS.add(
        f"learning.unique.{_schedule}",
        "Section 4.1, Section 3.2.5",
        "event",
        says=f"With {_shown} {UNIQUE_POLICIES[_schedule]} unique policies are suggested in the "
        "last 100 episodes of the run.",
        paper=UNIQUE_POLICIES[_schedule],
        learns=True,
    )(partial(_unique, schedule=_schedule))
    CLAIMS.add(
        f"learning.anger.{_schedule}",
        "Section 4.1, Figure 10",
        "event",
        says=f"The run with {_shown} learns supportive assistance in all eight statuses with "
        "anger.",
        learns=True,
    )(partial(_angry, schedule=_schedule))
    CLAIMS.add(
        f"learning.stated.{_schedule}",
        "Section 4.1, Figure 10",
        "event",
        says=f"The run with {_shown} learns the stated actions of 1100, 1000 and 0100.",
        learns=True,
    )(partial(_stated, schedule=_schedule))


@CLAIMS.add("learning.same-but-first", "Section 4.1, Figure 10", "event", learns=True)
def _same_but_first(reading: Reading) -> Finding:
    """The policies of the two runs, one of each schedule, differ in status 0000 alone."""
    constant, decaying = (reading.learned(schedule).final for schedule in SETTINGS)
    apart = constant != decaying
    rest, first = apart[:, 1:].sum(axis=1), apart[:, 0]
    return event(
        int(((rest == 0) & first).sum()),
        len(apart),
        f"of pairs of runs; {int((rest == 0).sum())} agree outside 0000, and the mean pair differs "
        f"in {rest.mean():.1f} of the other 15 statuses",
    )


@CLAIMS.add("learning.together", "Section 4.1, Figure 10", "event", learns=True)
def _all_at_once(reading: Reading) -> Finding:
    """All that is told of the two runs at once: their numbers of policies, where these differ, the
    three actions in 0000, the agreement elsewhere, and the stated actions."""
    held, kept, parts = np.array(True), [], shown_together(reading)
    for name, each in parts.items():
        held = held & each
        kept.append(f"{name} {each.mean():.1%}, with all before {100 * held.mean():.2g} %")
    alike = float(np.prod([each.mean() for each in parts.values()]))
    found = event(int(np.diag(held).sum()), len(held), "")
    return replace(
        found,
        why=f"{found.shown} draws of one run each; {int(held.sum()):,} of all {held.size:,} pairs: "
        f"{'; '.join(kept)}. Were these parts independent, it would be {100 * alike:.1g} %",
        details={**found.details, "pairs": int(held.sum()), "all_pairs": held.size},
    )


def shown_together(reading: Reading) -> dict[str, NDArray[np.bool_]]:
    """Return by what is told of the two runs (R, R) the pairs, one of each schedule, that show it.

    In the order of the text; of a run the policies of its last 100 episodes count.
    """
    runs = {schedule: reading.learned(schedule).runs for schedule in SETTINGS}
    last = {s: [run.policies[np.unique(run.last)] for run in each] for s, each in runs.items()}
    first, second = (_of_each(each) for each in last.values())
    final, other = (reading.learned(schedule).final for schedule in SETTINGS)
    three = 0
    for start in reported.STARTS:
        three |= 1 << NUMBER[start]
    numbers = [
        np.array([len(each) == UNIQUE_POLICIES[schedule] for each in listed])
        for schedule, listed in last.items()
    ]

    def both(one: NDArray[np.bool_], two: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.asarray(one[:, None] & two[None, :])

    return {
        "three and two policies": both(*numbers),
        "each run's differ in 0000 alone": both(first.alone, second.alone),
        "a1, a2 and a3 there": (first.starts[:, None] | second.starts[None, :]) == three,
        "the final ones differ there": final[:, None, 0] != other[None, :, 0],
        "and agree elsewhere": (final[:, None, 1:] == other[None, :, 1:]).all(axis=2),
        "supportive with anger": both(first.angry, second.angry),
        "1100, 1000 and 0100 as stated": both(first.stated, second.stated),
    }


class _Ends(NamedTuple):
    """What the last policies of each run do."""

    starts: Integers  # (R,) the actions in 0000, as bits
    alone: NDArray[np.bool_]  # (R,) whether they differ in 0000 alone
    angry: NDArray[np.bool_]  # (R,) whether all are supportive wherever there is anger
    stated: NDArray[np.bool_]  # (R,) whether all have the stated actions, in either order


def _of_each(last: Sequence[Numbers]) -> _Ends:
    places = [int(status, 2) for status in ANGRY]
    return _Ends(
        starts=np.array([np.bitwise_or.reduce(1 << each[:, 0].astype(int)) for each in last]),
        alone=np.array([bool((each[:, 1:] == each[0, 1:]).all()) for each in last]),
        angry=np.array([bool((each[:, places] == NUMBER["supportive"]).all()) for each in last]),
        stated=np.array([all(reported.states(policy) for policy in each) for each in last]),
    )


def _outcomes(reading: Reading) -> list[Outcomes]:
    return [reading.learned(schedule).outcomes for schedule in SETTINGS]


@CLAIMS.add("learning.one-run-all-three", "Section 4.1", "event", learns=True)
def _differ_in_first(reading: Reading) -> Finding:
    """The policies of a run's last 100 episodes differ in status 0000 alone."""
    changed = np.concatenate([each.changed for each in _outcomes(reading)])
    only = changed[:, 0] & ~changed[:, 1:].any(axis=1)
    anywhere = int(changed.any(axis=1).sum())
    return event(
        int(only.sum()), len(changed), f"of the runs of both schedules; {anywhere} change anywhere"
    )


@CLAIMS.add("learning.selection", "Section 3.2.5, Section 4.1", "usual", learns=True)
def _selection(reading: Reading) -> Finding:
    """Choosing among the five most frequent policies gives the final, optimal policy."""
    kept = np.concatenate([each.selected_regret for each in _outcomes(reading)])
    last = np.concatenate([each.regret for each in _outcomes(reading)])
    return usual(
        int((kept == 0).sum()),
        len(kept),
        f"{(kept == 0).mean():.0%} of the runs end with an optimal policy where the selection is "
        f"made by exact value, the best that any choice among the five can do; the mean regret is "
        f"{kept.mean():.2f} after the selection and {last.mean():.2f} before",
    )


@CLAIMS.add("learning.first-status-unsettled", "Section 4.1, Section 4.3", learns=True)
def _unsettled(reading: Reading) -> Finding:
    """The best assistance in status 0000 is hard to tell because of the model's chance."""
    # The same model, the same chance and exploration: only the step falls.
    kept, fallen = taken_first(reading), taken_first(reading.falling)
    total, settled = int(fallen.sum()), int(fallen.max())
    low, high = share_interval(settled, total)
    action = int(fallen.argmax())
    kind = "an optimal" if action in optimal_first(reading) else "no optimal"
    gaps = "; ".join(
        f"{shown} {gap.mean():.2f} ± {gap.std(ddof=1) / sqrt(len(gap)):.2f} with a constant step, "
        f"{other.mean():.2f} ± {other.std(ddof=1) / sqrt(len(other)):.2f} with a falling one, "
        f"and from run to run it varies by {gap.std(ddof=1):.1f} and {other.std(ddof=1):.1f}"
        for shown, gap, other in (
            (shown, gap_first(reading, name), gap_first(reading.falling, name))
            for name, shown in SHOWN.items()
        )
    )
    found = statement(
        high < SETTLED,
        f"with the paper's constant learning rate {_shares(reading, kept)}, over "
        f"{int(kept.sum())} runs; with a step of 0.5 n^-{reading.power:g} "
        f"{_shares(reading, fallen)}, over {total}: {kind} action. Model, chance and "
        "exploration are the same; the falling step starts ten times as large, and what counts is "
        "how small it ends. "
        f"What the table says of non-directive less directive in 0000 at the end: {gaps}. With a "
        "constant step this is no difference in worth: the action that looks worse is tried by "
        "exploration alone, so its entry is seldom corrected and stays low; a falling step brings "
        "both entries to what they are worth",
        Estimated(value=settled / total, standard_error=share_error(settled, total)),
        f"{settled} of {total} runs settle when the step falls",
        constant_step=kept.tolist(),
        falling_step=fallen.tolist(),
    )
    few = low < SETTLED <= high
    return replace(found, verdict=Verdict.NOT_DETERMINED) if few else found


def taken_first(reading: Reading) -> Integers:
    """Return (A,) how many runs of both schedules end with each action in status 0000."""
    return np.asarray(sum(each.choices(0) for each in _outcomes(reading)))


def gap_first(reading: Reading, schedule: str) -> Floats:
    """Return (R,) by how much runs value non-directive above directive in status 0000."""
    q = np.stack([run.q[0] for run in reading.learned(schedule).runs])
    return np.asarray(q[:, NUMBER["non-directive"]] - q[:, NUMBER["directive"]])


def _shares(reading: Reading, counts: Integers) -> str:
    """Say which actions runs end with in 0000, the most frequent first."""
    order = [int(a) for a in np.argsort(-counts, kind="stable") if counts[a]]
    return ", ".join(f"{reading.mdp.actions[a]} {counts[a] / counts.sum():.0%}" for a in order)


def optimal_first(reading: Reading) -> set[int]:
    """Return the actions that are optimal at the start, where 0000 is."""
    pairs = reading.mdp.pairs_of(reading.mdp.start[0][0])
    best = reading.certificate.optimal_pairs
    return {int(reading.mdp.pair_action[pair]) for pair in pairs if best[pair]}
