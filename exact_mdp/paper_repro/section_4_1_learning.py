"""Section 4.1, the policies that learning ends with: Figures 9 and 10.

The paper trains once with each exploration schedule; here many seeds are trained, so every
observation about its runs gets a frequency. Policies are judged by exact values instead of
experiments.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot, sqrt
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp import Estimated
from exact_mdp.analysis.learning.curves import (
    EXPERIMENTS,
    average_epochs,
    sample_epoch_returns,
)
from exact_mdp.analysis.vary.intervals import mean_of
from exact_mdp.paper_repro import drawing
from exact_mdp.paper_repro.claim import (
    NEARLY_ALL,
    Finding,
    compare_approximately,
    format_per_cent,
    judge_by_runs,
    judge_distance,
    judge_statement,
    register_claim,
)
from exact_mdp.paper_repro.compiled import list_optimal_actions
from exact_mdp.paper_repro.drawing import BLUE, FILLS, GREEN, RED, register_figure
from exact_mdp.paper_repro.paper import (
    ACTIONS,
    ANGRY,
    AVERAGES,
    ORDERS,
    REPORTED,
    STATUSES,
    has_stated_actions,
)
from exact_mdp.paper_repro.silent_points import CONVERGED, CURVES, SHOWN, Reading, spawn_seed
from exact_mdp.solvers.learning.q_learning import QLearning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NUMBER = {action: number for number, action in enumerate(ACTIONS)}

# ---- learning curves -----------------------------------------------------------------------------


@register_claim(
    "learning.converged.{word}", "Section 4.1", "Figure 9", rule="about", each=SHOWN, learns=True
)
def converged_return(reading: Reading, schedule: str) -> Finding:
    """With {means} the average return after convergence is about 140."""
    tails = reading.train_runs(schedule).converged
    low, high = np.quantile(tails, [0.05, 0.95]).tolist()
    why = (
        f"exact values of the greedy policies of the last {CONVERGED:,} epochs, averaged over "
        f"these and over all runs ({len(tails)}); nine runs in ten have an average from {low:.1f} "
        f"to {high:.1f}, and the optimum is {reading.evaluate_policy('optimal').mean:.1f}"
    )
    return compare_approximately(REPORTED["converged"], mean_of(tails), why)


@register_claim("learning.similar", "Section 4.1", "Figure 9", learns=True)
def schedules_perform_alike(reading: Reading) -> Finding:
    """Both exploration schedules perform alike."""
    constant, decaying = (reading.train_runs(schedule).converged for schedule in SHOWN)
    apart = float(decaying.mean() - constant.mean())
    error = hypot(mean_of(constant).standard_error, mean_of(decaying).standard_error)
    point = reading.evaluate_policy("optimal").sd / sqrt(EXPERIMENTS)
    return judge_distance(
        abs(apart),
        2 * point,
        f"decaying minus constant: {apart:+.2f}; the standard error of one point of the plot "
        f"({EXPERIMENTS} experiments) is {point:.1f}, and alike means within twice that",
        number=Estimated(value=apart, standard_error=error),
        number_is="decaying minus constant, in points",
    )


@register_claim("learning.superior", "Section 4.1", "Figure 9", rule="share", learns=True)
def learned_superior(reading: Reading) -> Finding:
    """After convergence both are above the random strategy."""
    random = reading.evaluate_policy("random").mean
    runs = np.concatenate([reading.train_runs(schedule).converged for schedule in SHOWN])
    why = f"random actions earn {random:.1f}, and the lowest of the runs ends at {runs.min():.1f}"
    return judge_by_runs(int((runs > random).sum()), len(runs), "runs", why)


@register_figure("learning_curves", "Figure 9", title="Learning curves of three strategies")
def learning_curves(reading: Reading) -> Figure:
    """Above, as the paper draws it: one run of each strategy, the average return of 40 experiments
    with the greedy policy of each epoch; pale the range within 20 epochs, heavy the mean of 100.
    Below, exact values of the same policies over all runs: the mean, and the band of nine runs in
    ten, for each epoch by itself.
    """
    fig, panels = drawing.create_axes(6.8, 6.2, nrows=2, ncols=2)
    grid = panels[0, 0].get_gridspec()
    for old in panels[0]:
        old.remove()
    # Above: one run of each strategy, as the paper draws it.
    top = fig.add_subplot(grid[0, :])
    optimum = reading.evaluate_policy("optimal").mean
    curves = {shown: reading.train_runs(name).drawn.sampled for name, shown in SHOWN.items()}
    # The random strategy has a seed of its own, apart from the seeds of the schedules.
    source = spawn_seed(CURVES, len(SHOWN))
    returns, _ = sample_epoch_returns(reading.mdp, QLearning().epochs, rng=source)
    curves["random"] = returns.mean(axis=1)
    looks = ((BLUE, "-"), (RED, "--"), (GREEN, "-."))
    for (label, values), (colour, line) in zip(curves.items(), looks, strict=True):
        drawing.draw_band(top, values, colour)
        top.plot(*average_epochs(values, 100), color=colour, ls=line, lw=1.6, label=label)
    top.axhline(optimum, color="black", ls=":", lw=1, label=f"optimum {optimum:.1f}")
    top.legend(ncols=4, loc="lower center")
    top.set(ylim=(0, None), xlabel="epoch", ylabel="average return (points)")
    top.set_title(
        "One run of each: average of 40 experiments at each epoch\n"
        "(pale: the range within 20 epochs; heavy: the mean of 100)"
    )
    # Below: exact values of the policies of all runs, with the band of nine runs in ten.
    for ax, (name, shown), (colour, line) in zip(panels[1], SHOWN.items(), looks, strict=False):
        values = reading.train_runs(name).values
        low, high = np.quantile(values, [0.05, 0.95], axis=0)
        at, middle = average_epochs(values.mean(axis=0), 25)
        band = (average_epochs(each, 25)[1] for each in (low, high))
        ax.fill_between(
            at,
            *band,
            color=colour,
            alpha=0.25,
            lw=0,
            label="nine runs in ten,\neach epoch by itself",
        )
        ax.plot(at, middle, color=colour, ls=line, label="mean")
        ax.axhline(optimum, color="black", ls=":", lw=1, label="optimum")
        ax.legend(loc="lower right")
        ax.set(ylim=(120, None), xlabel="epoch", ylabel="exact value (points)")
        ax.set_title(f"{shown}: {len(values)} runs")
    return fig


# ---- learned policies ----------------------------------------------------------------------------


def name_actions(policy: np.ndarray) -> dict[str, str]:
    """Return a policy (16,) by status."""
    named = {}
    for status, action in zip(STATUSES, policy, strict=True):
        named[status] = ACTIONS[int(action)]
    return named


UNIQUE = {s: f"{SHOWN[s]} the run suggests {n}" for s, n in REPORTED["unique_policies"].items()}


@register_claim(
    "learning.unique.{word}", "Section 4.1", "Section 3.2.5", rule="share", each=UNIQUE, learns=True
)
def unique_policies(reading: Reading, schedule: str) -> Finding:
    """With {means} unique policies in its last 100 episodes."""
    distinct = reading.train_runs(schedule).outcomes.distinct
    paper = REPORTED["unique_policies"][schedule]
    number = mean_of(distinct.astype(float))
    return judge_by_runs(
        int((distinct == paper).sum()),
        len(distinct),
        "runs",
        f"the runs end with {number.value:.2f} on average, {distinct.min()} to {distinct.max()}",
        paper=float(paper),
        details={"share": float((distinct == paper).mean())},
        number=number,
        number_is="mean number of policies",
    )


@register_claim(
    "learning.anger.{word}", "Section 4.1", "Figure 10", rule="share", each=SHOWN, learns=True
)
def learned_anger(reading: Reading, schedule: str) -> Finding:
    """The run with {means} learns supportive assistance in all eight statuses with anger."""
    final = reading.train_runs(schedule).final
    # A run counts if all eight statuses with anger have supportive assistance.
    supportive = final[:, [int(status, 2) for status in ANGRY]] == NUMBER["supportive"]
    each = supportive.mean(axis=0)
    why = (
        f"taken one by one, these statuses have supportive assistance in "
        f"{format_per_cent(each.min())} ({ANGRY[int(each.argmin())]}) to "
        f"{format_per_cent(each.max())} of the runs"
    )
    return judge_by_runs(int(supportive.all(axis=1).sum()), len(final), "runs", why)


@register_claim(
    "learning.stated.{word}", "Section 4.1", "Figure 10", rule="share", each=SHOWN, learns=True
)
def learned_stated(reading: Reading, schedule: str) -> Finding:
    """The run with {means} learns the stated actions of 1100, 1000 and 0100."""
    final = [name_actions(policy) for policy in reading.train_runs(schedule).final]
    # The text leaves open which action belongs to 1000 and which to 0100: count both orders.
    orders = {}
    for order in ORDERS:
        orders[order] = sum(has_stated_actions(policy, order) for policy in final)
    whole = sum(are_as_described([policy]) for policy in final)
    shares = []
    for order, count in orders.items():
        shares.append(
            f"{format_per_cent(count / len(final))} of the runs with 1000 and 0100 {order}"
        )
    why = (
        f"{', '.join(shares)}; everything that the text says of a policy, anger and 0000 included, "
        f"holds in {format_per_cent(whole / len(final))}"
    )
    return judge_by_runs(sum(orders.values()), len(final), "runs", why, details={"orders": orders})


def are_as_described(policies: Iterable[dict[str, str]]) -> bool:
    """Return whether the text's statements about statuses hold for all of some policies."""
    for policy in policies:
        supportive = all(policy[status] == "supportive" for status in ANGRY)
        if not supportive or policy["0000"] not in AVERAGES or not has_either_order(policy):
            return False
    return True


def has_either_order(policy: dict[str, str]) -> bool:
    """Return whether a policy takes the stated actions, with "respectively" read in some order."""
    return any(has_stated_actions(policy, order) for order in ORDERS)


@register_claim("learning.same-but-first", "Section 4.1", "Figure 10", rule="share", learns=True)
def same_but_first(reading: Reading) -> Finding:
    """The policies of the two runs, one of each schedule, differ in status 0000 alone."""
    constant, decaying = (reading.train_runs(schedule).final for schedule in SHOWN)
    # Run i of one schedule is compared with run i of the other: the pairs are independent.
    apart = constant != decaying
    rest = apart[:, 1:].sum(axis=1)
    why = (
        f"{int((rest == 0).sum())} pairs agree in the other 15 statuses; on average a pair differs "
        f"in {rest.mean():.1f} of them"
    )
    return judge_by_runs(int(((rest == 0) & apart[:, 0]).sum()), len(apart), "pairs of runs", why)


@register_claim("learning.together", "Section 4.1", "Figure 10", rule="share", learns=True)
def runs_show_everything(reading: Reading) -> Finding:
    """The two runs show all of this at once: three and two policies, which differ in 0000 alone and
    take a1, a2 and a3 there; final policies that differ there alone; and the stated actions.
    """
    parts = told_together(reading)
    # Statement after statement: how often it holds, and how often it holds with all before it.
    within, shares = np.array(True), []
    for name, each in parts.items():
        within = within & each
        both = f"{format_per_cent(each.mean())} ({format_per_cent(within.mean())})"
        shares.append(f"{name} {both}")
    why = (
        "in how many of all pairs of one run with each schedule a statement holds, and in brackets "
        f"in how many it holds together with all statements before it: {'; '.join(shares)}"
    )
    number = Estimated(value=float(within.mean()), standard_error=error_of_pairs(within))
    # Pairs without a run in common are independent.
    return judge_by_runs(
        int(within.sum()),
        int(within.size),
        "pairs of runs",
        why,
        independent=min(within.shape),
        number=number,
    )


def error_of_pairs(shown: np.ndarray) -> float:
    """Return the standard error of the share of (M, N) pairs that show something; 0 for one run.

    Pairs with a run in common are not independent. By what two such pairs have in common, the
    variance of the share is (ζ + (N - 1) a + (M - 1) b) / (M N), where ζ is the variance of one
    pair, a and b the covariances of two in a row and of two in a column (Hoeffding, Annals of
    Mathematical Statistics 19, 1948). The sample variance of the means of rows, over M, and that
    of columns, over N, have the expectations (ζ + (N - 1) a - b) / (M N) and
    (ζ + (M - 1) b - a) / (M N). So their sum is on average too large by (ζ - a - b) / (M N): not
    too small, and by no more than the variance ζ / (M N) of as many independent pairs.
    """
    sides = [shown.mean(axis=axis) for axis in (0, 1)]
    return sqrt(sum(each.var(ddof=1) / len(each) for each in sides if len(each) > 1))


def told_together(reading: Reading) -> dict[str, np.ndarray]:
    """Return, for each statement about the two runs, the pairs of runs (R, R) that show it.

    For a run, the policies of its last 100 episodes count.
    """
    runs = [reading.train_runs(schedule) for schedule in SHOWN]
    places = [int(status, 2) for status in ANGRY]

    def pair_runs(first: Iterable[bool], second: Iterable[bool]) -> np.ndarray:
        return np.logical_and.outer(list(first), list(second))

    def differ_in_first_alone(policies: np.ndarray) -> bool:
        return bool((policies[:, 1:] == policies[0, 1:]).all())

    def are_supportive_in_anger(policies: np.ndarray) -> bool:
        return bool((policies[:, places] == NUMBER["supportive"]).all())

    def take_stated_actions(policies: np.ndarray) -> bool:
        return all(has_either_order(name_actions(policy)) for policy in policies)

    # Sets of actions in 0000 as bit masks, so that a union is an "or".
    def mask_first_actions(policies: np.ndarray) -> int:
        return sum(1 << action for action in set(policies[:, 0].tolist()))

    starts = [[*map(mask_first_actions, run.last)] for run in runs]
    three = sum(1 << NUMBER[start] for start in AVERAGES)
    one, two = runs[0].final, runs[1].final
    numbers = REPORTED["unique_policies"]
    as_many = []
    for run in runs:
        as_many.append([len(policies) == numbers[run.schedule] for policies in run.last])
    return {
        "three and two policies": pair_runs(*as_many),
        "the policies of each run differ in 0000 alone": pair_runs(
            *(map(differ_in_first_alone, run.last) for run in runs)
        ),
        "a1, a2 and a3 there": np.bitwise_or.outer(*map(np.array, starts)) == three,
        "the final policies differ there": one[:, None, 0] != two[None, :, 0],
        "the final policies agree elsewhere": (one[:, None, 1:] == two[None, :, 1:]).all(axis=2),
        "supportive with anger": pair_runs(
            *(map(are_supportive_in_anger, run.last) for run in runs)
        ),
        "1100, 1000 and 0100 as stated": pair_runs(
            *(map(take_stated_actions, run.last) for run in runs)
        ),
    }


@register_claim("learning.one-run-all-three", "Section 4.1", rule="share", learns=True)
def one_run_all_three(reading: Reading) -> Finding:
    """The policies of a run's last 100 episodes differ in status 0000 alone."""
    changed = np.concatenate([reading.train_runs(s).outcomes.changed for s in SHOWN])
    only = changed[:, 0] & ~changed[:, 1:].any(axis=1)
    why = f"in {int(changed.any(axis=1).sum())} runs they differ in some status"
    return judge_by_runs(int(only.sum()), len(changed), "runs", why)


@register_claim("learning.selection", "Section 4.1", "Section 3.2.5", rule="share", learns=True)
def selection_finds_optimum(reading: Reading) -> Finding:
    """Choosing among the five most frequent policies gives the final, optimal policy."""
    outcomes = [reading.train_runs(schedule).outcomes for schedule in SHOWN]
    regrets = np.concatenate([each.selected_regret for each in outcomes])
    last = np.concatenate([each.regret for each in outcomes])
    why = (
        "the five are compared by their exact values here, so that no experiments can choose "
        f"better; on average the chosen policy is {regrets.mean():.2f} points below the optimum, "
        f"and the last one of the run {last.mean():.2f}"
    )
    return judge_by_runs(int((regrets == 0).sum()), len(regrets), "runs", why)


@register_claim("learning.first-status-unsettled", "Section 4.1", "Section 4.3", learns=True)
def first_status_unsettled(reading: Reading) -> Finding:
    """The best assistance in status 0000 is hard to tell because the model is random."""
    # The same model, the same randomness and exploration: only the step falls.
    constant, fallen = first_actions(reading), first_actions(reading.falling)
    total, settled = int(fallen.sum()), int(fallen.max())
    error = sqrt((settled + 0.5) * (total - settled + 0.5) / total**3)
    best = set.intersection(*list_optimal_actions(reading, "0000"))
    kind = "no optimal"
    if ACTIONS[int(fallen.argmax())] in best:
        kind = "an optimal"
    return judge_statement(
        settled < NEARLY_ALL * total,
        f"with the paper's constant learning rate {constant.sum()} runs end with "
        f"{format_frequencies(constant)}; with a rate of 0.5 n^-0.7 at the n-th update {total} "
        f"runs end with {format_frequencies(fallen)}, {kind} action. Model and exploration are the "
        "same, so the learning rate is the cause",
        number=Estimated(value=settled / total, standard_error=error),
        number_is="share of the runs with a falling rate that end with the same action",
        details={"constant_step": constant.tolist(), "falling_step": fallen.tolist()},
    )


def first_actions(reading: Reading) -> np.ndarray:
    """Return (A,) how many runs of both schedules end with each action in status 0000."""
    return np.asarray(sum(reading.train_runs(s).outcomes.choices(0)[: len(ACTIONS)] for s in SHOWN))


def format_frequencies(counts: np.ndarray) -> str:
    """Return which actions runs end with, the most frequent first."""
    order = [int(a) for a in np.argsort(-counts, kind="stable") if counts[a]]
    return ", ".join(f"{ACTIONS[a]} {format_per_cent(counts[a] / counts.sum())}" for a in order)


@register_figure(
    "learned_policies",
    "Figure 10",
    title="Learned policies of the two exploration schedules, and the optimal one",
)
def learned_policies(reading: Reading) -> Figure:
    """The commonest final action in each status, and the share of runs that end with it. On the
    right the optimal policy, which is the same in every subtask and trial.
    """
    best = [ACTIONS[action] for action in reading.optimum[: len(STATUSES)]]
    fig, panels = drawing.create_axes(9.6, 3.6, ncols=3, sharey=True)
    for ax, (name, shown) in zip(panels, SHOWN.items(), strict=False):
        choices, often = reading.train_runs(name).find_common_actions()
        chosen = [ACTIONS[action] for action in choices]
        notes = []
        for share, action, optimal in zip(often, chosen, best, strict=True):
            note = format_per_cent(share)
            if action != optimal:
                note += "\nnot optimal"
            notes.append(note)
        drawing.draw_status_map(ax, chosen, notes)
        runs = len(reading.train_runs(name).runs)
        ax.set_title(f"{shown}: the commonest final action\nof {runs} runs, and its share of them")
    drawing.draw_status_map(panels[2], best, [""] * len(best))
    panels[2].set_title("optimal action\n")
    return fig


@register_figure(
    "first_status", title="Action in status 0000 with a constant and with a falling learning rate"
)
def first_status(reading: Reading) -> Figure:
    """Above, the action in 0000 that runs end with, under the paper's constant learning rate and
    with a rate of 0.5 n^-0.7 at the n-th update; model and exploration are the same. Below, the
    learned value of non-directive minus that of directive assistance, one dot for each run: right
    of the line a run prefers non-directive assistance, which is the best one.
    """
    from matplotlib.patches import Patch

    fig, (above, below) = drawing.create_axes(7.6, 5.0, nrows=2)
    rows = []
    for step, view in (("constant rate", reading), ("falling rate", reading.falling)):
        for name, shown in SHOWN.items():
            rows.append((f"{shown}, {step}", view.train_runs(name)))
    for row, (_, learned) in enumerate(rows):
        counts = learned.outcomes.choices(0)[: len(ACTIONS)]
        left = 0.0
        for action, count in zip(ACTIONS, counts / counts.sum(), strict=True):
            fill, hatch = FILLS[action]
            look = {"color": fill, "hatch": hatch, "ec": "black", "lw": 0.6}
            above.barh(row, count, left=left, height=0.6, **look)
            left += count
        q = np.stack([run.q[0] for run in learned.runs])
        gap = q[:, NUMBER["non-directive"]] - q[:, NUMBER["directive"]]
        apart = (np.arange(len(gap)) * 0.618034) % 1 - 0.5  # spread, and the same each time
        below.plot(gap, row + 0.6 * apart, "o", ms=2.5, mfc="none", color="0.45", mew=0.6)
        below.plot([gap.mean()] * 2, [row - 0.4, row + 0.4], color="black", lw=2)
    for ax in (above, below):
        ax.set_yticks(range(len(rows)), [label for label, _ in rows])
        ax.invert_yaxis()
    handles = []
    for action, (fill, hatch) in FILLS.items():
        handles.append(Patch(facecolor=fill, hatch=hatch, edgecolor="black", label=action))
    above.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1), ncols=4)
    above.set(xlim=(0, 1), xlabel="share of runs by their final action in 0000")
    below.axvline(0, color="black", lw=0.8)
    below.set_xlabel(
        "learned value in 0000: non-directive minus directive (points); bar: mean\n"
        "left of the line a run prefers directive, right of it non-directive"
    )
    return fig
