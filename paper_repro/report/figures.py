"""The figures of the reproduction: what each shows, which figure of the paper it answers to.

A figure is an object with a name, a caption, a description for those who cannot see it and a
function that draws it from a view of the model; `draw_all` saves them as SVG and PNG.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from exact_mdp.analysis.plots import (
    plot_distinct,
    plot_influence,
    plot_policy_map,
    plot_regrets,
    plot_return_distribution,
    plot_status_transitions,
    plot_value_bands,
    save,
    style,
)
from exact_mdp.analysis.plots.paper import (
    Average,
    plot_agreement,
    plot_averages,
    plot_choices,
    plot_experiments,
    plot_trials,
)
from exact_mdp.mdp import MDP, Policy
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.learning import SHOWN
from exact_mdp.paper_repro.learned import SCHEDULES, random_baseline
from exact_mdp.paper_repro.numbers import FINAL, Study
from exact_mdp.paper_repro.view import SEED, View
from exact_mdp.solvers import evaluate
from exact_mdp.solvers.values.returns import return_distribution

ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One figure.

    Attributes
    ----------
    name : str
        Of its files.
    title, caption : str
    alt : str
        What is to be seen, in words.
    place : str
        The figure of the paper that it answers to; empty for one that the paper has not.
    draw : function of a View
    learns : bool
        Whether it shows training runs.
    """

    name: str
    title: str
    caption: str
    alt: str
    place: str
    draw: Callable[[View], Figure]
    learns: bool = False


def draw_all(
    pictures: Mapping[str, Callable[[], Figure]],
    folder: Path,
    progress: Callable[[str], None] | None = None,
    dpi: int | None = None,
) -> list[Path]:
    """Draw every figure into a folder; return the paths written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with style():
        if dpi is not None:
            plt.rcParams["savefig.dpi"] = dpi
        for name, draw in pictures.items():
            if progress is not None:
                progress(name)
            figure = draw()
            # The layout is worked out once, not anew for each kind of file.
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
            written += save(figure, folder, name)
            plt.close(figure)
    return written


def _policy_map(view: View) -> Figure:
    """One map for each different one among the subtasks and trials."""
    study = view.study
    places = _distinct_maps(study)
    size = (max(0.8 + 2.6 * len(places), 4.4), 3.9)
    figure, axes = plt.subplots(1, len(places), figsize=size, squeeze=False)
    for (place, label), ax in zip(places, axes[0], strict=True):
        statuses = study.scenario.statuses
        plot_policy_map(study.mdp, study.optimum, statuses=statuses, ax=ax, legend=False, **place)
        ax.set_title(f"optimal action, {label}")
    _action_legend(figure, study.mdp, columns=2 if len(places) == 1 else 4)
    return figure


def _distinct_maps(study: Study) -> list[tuple[dict[str, int], str]]:
    """Return a place for each different map, and in which subtasks and trials it holds."""
    space, found = study.mdp.space, {}
    size = space.column("status").size
    for subtask in range(space.column("subtask").size):
        for trial in range(study.scenario.trials):
            first = space.index(subtask=subtask, trial=trial)
            key = tuple(study.optimum[first : first + size].tolist())
            found.setdefault(key, []).append((subtask, trial))
    total = sum(len(places) for places in found.values())
    maps = []
    for places in found.values():
        label = ", ".join(f"{subtask}/{trial}" for subtask, trial in places)
        title = "every subtask and trial" if len(places) == total else f"subtask/trial {label}"
        maps.append(({"subtask": places[0][0], "trial": places[0][1]}, title))
    return maps


def _action_legend(figure: Figure, mdp: MDP, *, columns: int) -> None:
    from matplotlib.patches import Patch

    from exact_mdp.analysis.plots import action_styles

    handles = [
        Patch(facecolor=s.fill, edgecolor="black", hatch=s.hatch, label=f"{s.short} {s.name}")
        for s in action_styles(mdp.actions)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)


def _influence(view: View) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 5.6))
    plot_influence(view.scenario, ax=ax)
    ax.set_title("Influence between statuses without assistance (Table 3), percentage points")
    return figure


def _transitions(view: View) -> Figure:
    figure, axes = plt.subplots(2, 2, figsize=(11, 9.5))
    for number, ax in enumerate(axes.flat):
        plot_status_transitions(status_law(view.mdp, number), view.scenario.statuses, ax=ax)
        ax.set_title(f"a{number} {view.mdp.actions[number]}")
    figure.suptitle(
        "Moves of the status vector (forgetful, confused, angry, disengaged) with probability of "
        "10 % or more;\nthe darker and thicker, the likelier; 0000 completes the subtask",
        x=0.01,
        ha="left",
    )
    return figure


def status_law(mdp: MDP, action: int) -> NDArray[np.float64]:
    """Return the (2^n, 2^n) law of the next status vector in the first trial, as compiled."""
    size = mdp.space.column("status").size
    pairs = [mdp.pair(mdp.space.index(status=vector), action) for vector in range(size)]
    following = np.maximum(mdp.space.values("status"), 0)
    law = np.zeros((size, size))
    for vector, pair in enumerate(pairs):
        row = mdp.transition[[pair]].tocoo()
        np.add.at(law[vector], following[row.coords[1]], row.data)
    return law


def _returns(view: View) -> Figure:
    labels = {
        "optimal": "optimal policy",
        "reported.non-directive": "reported final policy (a2 in 0000)",
        "random": "random policy",
    }
    figure, axes = plt.subplots(3, 1, figsize=(7, 6.5), sharex=True)
    lowest = []
    for ax, (name, label) in zip(axes, labels.items(), strict=True):
        distribution = return_distribution(view.mdp, view.study.policies[name])
        plot_return_distribution(distribution, label=label, ax=ax)
        lowest.append(float(distribution.quantile(0.001)))
    axes[-1].set_xlim(left=min(lowest))
    axes[-1].set_xlabel("return of an episode (sum of rewards)")
    return figure


def _trials(view: View) -> Figure:
    figure, ax = plt.subplots(figsize=(9.5, 3.3))
    names = {"optimal": "optimal policy", "random": "random actions"}
    flows = {
        label: trial_flow(view.mdp, view.study.policies[name], view.scenario.trials)
        for name, label in names.items()
    }
    plot_trials(flows, ax=ax)
    ax.set_title("The first subtask, trial by trial")
    return figure


def trial_flow(
    mdp: MDP, policy: object, trials: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (M,) probabilities that each trial of subtask 0 is made, and completes it if made."""
    found = evaluate(mdp, policy)
    here = (mdp.space.values("subtask") == 0) & ~mdp.terminal
    trial = mdp.space.values("trial")
    made = np.array([found.visits[here & (trial == t)].sum() for t in range(trials)])
    law = np.stack([status_law(mdp, action)[:, 0] for action in range(len(reported.ACTIONS))], 1)
    weights = found.chain.weights
    ends = np.zeros(trials)
    for state in np.flatnonzero(here & (trial < trials)).tolist():
        pairs = list(mdp.pairs_of(state))
        vector = int(mdp.space.values("status")[state])
        chosen = [(int(mdp.pair_action[pair]), float(weights[pair])) for pair in pairs]
        done = sum(weight * law[vector, action] for action, weight in chosen)
        ends[int(trial[state])] += float(found.visits[state]) * done
    return made, ends / made


def _learning(view: View) -> Figure:
    figure = plt.figure(figsize=(8, 7))
    above, below = figure.add_gridspec(2, 1)
    top = figure.add_subplot(above)
    optimum = view.study.evaluations["optimal"].mean
    curves = {SHOWN[name]: view.learned(name).drawn.sampled for name in SCHEDULES}
    plot_experiments(curves | {"random": random_baseline(view.mdp, SEED).sampled}, ax=top)
    top.axhline(optimum, color="black", linestyle=":", linewidth=1, label="optimum")
    top.legend(frameon=False, ncols=4, loc="lower center")
    top.set_ylim(bottom=0)
    top.set_title("One run of each, as the paper draws it: average of 40 experiments an epoch")
    parts = below.subgridspec(1, 2)
    first = None
    for name, place in zip(SCHEDULES, parts, strict=True):
        ax = figure.add_subplot(place, sharey=first)
        first = first or ax
        values = view.learned(name).values
        plot_value_bands({SHOWN[name]: values}, optimum=optimum, ax=ax)
        ax.set_title(f"{SHOWN[name]}: exact values, {len(values)} runs")
        ax.set_ylim(bottom=120)
    return figure


def _learned_maps(view: View) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 4.6))
    for ax, name in zip(axes, SCHEDULES, strict=True):
        learned = view.learned(name)
        choices, shares = learned.common()
        optimum = view.study.optimum[: len(choices)]
        plot_agreement(
            view.mdp.actions[: len(reported.ACTIONS)],
            choices,
            shares,
            statuses=view.scenario.statuses,
            marked=np.flatnonzero(choices != optimum).tolist(),
            ax=ax,
        )
        ax.set_title(f"{SHOWN[name]}: commonest final action")
    _action_legend(figure, view.mdp, columns=4)
    return figure


def _averages(view: View) -> Figure:
    figure, ax = plt.subplots(figsize=(7.6, 3.9))
    study, rows = view.study, []
    short = {action: f"a{number}" for number, action in enumerate(reported.ACTIONS)}
    found = study.completions
    for start, paper in reported.AVERAGE_RETURN.items():
        for name, place in (("as written", found.best()), ("best joint fit", found.fitting)):
            rows.append(
                Average(
                    label=f"{short[start]} in 0000, {name}",
                    exact=float(found.mean[start][place]),
                    standard_error=float(found.variance[start][place] / reported.EXPERIMENTS)
                    ** 0.5,
                    reported=paper,
                    span=found.range(start),
                )
            )
    plot_averages(rows, optimum=study.evaluations["optimal"].mean, ax=ax)
    return figure


def _unique(view: View) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 3.6))
    plot_distinct({SHOWN[name]: view.learned(name).outcomes for name in SCHEDULES}, ax=ax)
    for bars, hatch in zip(ax.containers[1::2], ("", "//"), strict=True):
        for bar in bars:
            bar.set_hatch(hatch)
    ax.set_xticks(range(1, round(ax.get_xlim()[1])))
    ax.legend(handles=ax.containers[1::2], labels=list(SHOWN.values()), frameon=False)
    ax.set_title("Policies that are greedy in the last 100 episodes of a run")
    return figure


def _regrets(view: View) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 3.6))
    plot_regrets({SHOWN[name]: view.learned(name).outcomes for name in SCHEDULES}, ax=ax)
    ax.set_title("What final policies lose against the optimum")
    return figure


def _choices(view: View) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 5.6))
    losses = choice_losses(view)
    rows = [format(vector, "04b") for vector in range(len(losses))]
    columns = [f"a{number} {action}" for number, action in enumerate(reported.ACTIONS)]
    policy = reported.policy(FINAL, view.study.completion)
    marked = {row: reported.ACTIONS.index(policy[label]) for row, label in enumerate(rows)}
    plot_choices(losses, rows=rows, columns=columns, marked=marked, ax=ax)
    ax.set_ylabel("status vector: forgetful, confused, angry, disengaged")
    return figure


def choice_losses(view: View) -> NDArray[np.float64]:
    """Return (16, 4) what is lost at the start by an action in a status, all else being optimal."""
    mdp, best = view.mdp, view.study.evaluations["optimal"].mean
    status, choices = mdp.space.values("status"), view.study.optimum
    free = ~mdp.forced & ~mdp.terminal
    losses = np.zeros((mdp.space.column("status").size, len(reported.ACTIONS)))
    for vector, action in np.ndindex(losses.shape):
        other = np.where(free & (status == vector), action, choices)
        losses[vector, action] = best - evaluate(mdp, Policy.from_choices(mdp, other)).mean
    return np.where(np.abs(losses) < ROUNDING, 0.0, losses)


PICTURES = (
    Picture(
        name="trial_flow",
        title="Trials of a subtask",
        caption="Up to five trials; a trial that ends in status 0000 completes the subtask, the "
        "last failed one skips it. Exact probabilities.",
        alt="Five boxes in a row, one for each trial, with arrows up to “subtask completed” and "
        "onwards to the next trial; after the fifth trial an arrow leads to “skipped”.",
        place="Figure 3",
        draw=_trials,
    ),
    Picture(
        name="status_transitions",
        title="Moves of the status vector under each action",
        caption="One panel for each action; 16 status vectors ordered by how many statuses are "
        "present.",
        alt="Four network diagrams, one for each action, of the same 16 status vectors, with an "
        "arrow for each move of 10 % or more, darker and thicker the likelier it is.",
        place="Figure 3",
        draw=_transitions,
    ),
    Picture(
        name="influence_graph",
        title="Influence between statuses",
        caption="Without assistance a status that is present raises the chance of the others; "
        "percentage points of Table 3, read from row to column.",
        alt="Network of the four statuses. Each arrow carries the percentage points that one "
        "status adds to another, the off-diagonal numbers of Table 3.",
        place="Figure 4",
        draw=_influence,
    ),
    Picture(
        name="learning_curves",
        title="Learning curves of three strategies",
        caption="Above: average return of 40 experiments with the greedy policy of each epoch, one "
        "run of each strategy; pale: range within 20 epochs, heavy: mean of 100. Below, without "
        "Monte Carlo noise: exact values of the same policies over many runs, mean and 5 to 95 % "
        "band. The dotted line is the optimum.",
        alt="Three panels of return against epoch. Above, sampled curves of constant exploration, "
        "decaying exploration and random actions; below, a mean and a band of exact values for "
        "each exploration. The optimum is a dotted line.",
        place="Figure 9",
        draw=_learning,
        learns=True,
    ),
    Picture(
        name="learned_policies",
        title="Learned policies of the two exploration schedules",
        caption="The commonest final action in each status and the share of runs that end with "
        "it. A heavy frame marks where it is not the optimal one.",
        alt="Two four by four maps of the status vectors, one for each exploration, with the "
        "commonest final action and the percentage of runs that end with it in each cell.",
        place="Figure 10",
        draw=_learned_maps,
        learns=True,
    ),
    Picture(
        name="optimal_policy_map",
        title="The optimal policy",
        caption="Exact; it is the same in every subtask and trial where one map is shown.",
        alt="Four by four map of the status vectors with the optimal action in each; the claims "
        "of Section 4.1 say of each status that the paper names which action is optimal there.",
        place="",
        draw=_policy_map,
    ),
    Picture(
        name="three_policies",
        title="The three reported averages",
        caption="Exact means of the three policies with exact standard errors of 1,000 "
        "experiments, beside what the paper reports: with 1000 and 0100 as the sentence is "
        "written, and with the completion, the best of 512, that fits all three averages best. "
        "Grey: the range over all completions.",
        alt="Six rows, two for each action in status 0000, as written and best joint fit, with the "
        "exact mean, its standard errors, the range over all completions and the reported "
        "average; the distance in standard errors stands at the right.",
        place="",
        draw=_averages,
    ),
    Picture(
        name="return_distributions",
        title="Distribution of the return",
        caption="Exact distribution of an episode's return under the optimal policy, under the "
        "policy that the paper reports (as written), and under random actions.",
        alt="Three bar charts of probability against return on one scale: the optimal policy, the "
        "reported final policy, random actions.",
        place="",
        draw=_returns,
    ),
    Picture(
        name="cost_of_choices",
        title="What each choice costs",
        caption="Expected return lost by taking an action whenever a status comes up, everything "
        "else being optimal. A heavy frame marks the action of the reported final policy, with "
        "1000 and 0100 as written.",
        alt="Table of 16 status vectors by four actions. Each cell carries the loss of its action; "
        "a heavy frame marks the action of the reported final policy.",
        place="",
        draw=_choices,
    ),
    Picture(
        name="unique_policies",
        title="Unique policies in the last 100 episodes",
        caption="Share of our runs by the number of policies that are greedy in the last 100 "
        "episodes, with 95 % intervals. The paper reports three (constant) and two (decaying).",
        alt="Bar chart of the share of runs against the number of unique policies for both "
        "schedules.",
        place="",
        draw=_unique,
        learns=True,
    ),
    Picture(
        name="final_regret",
        title="What learning leaves on the table",
        caption="Share of runs whose final policy loses at most so much of the optimum.",
        alt="Two rising step curves, one for each exploration schedule.",
        place="",
        draw=_regrets,
        learns=True,
    ),
)
"""The figures of Sections 2 to 4.1, in the order of the paper."""
