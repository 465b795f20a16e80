"""The figures of the model and of learning: what each shows, which of the paper's it answers to.

A figure is a `Picture`: its words, which stand in `figures.toml`, and a function that draws it;
`draw_all` saves them as SVG and PNG.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

from exact_mdp.analysis.plots import (
    plot_distinct,
    plot_influence,
    plot_regrets,
    plot_return_distribution,
    plot_status_transitions,
    plot_value_bands,
    save,
    style,
)
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.table import Floats
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.learning import gap_first
from exact_mdp.paper_repro.reading import SEED, Reading
from exact_mdp.paper_repro.readings.training import SHOWN, random_baseline
from exact_mdp.paper_repro.report.drawings import (
    Average,
    plot_averages,
    plot_choices,
    plot_dots,
    plot_experiments,
    plot_shares,
    plot_status_policy,
    plot_trials,
)
from exact_mdp.paper_repro.reported import ACTIONS, FINAL, NUMBER, STARTS, STATUS_WORDS, STATUSES
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.returns import return_distribution

ROUNDING = 1e-9
WORDS = tomllib.loads((Path(__file__).parent / "figures.toml").read_text("utf-8"))
Draw = TypeVar("Draw", bound=Callable[..., Figure])


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One figure: the name of its files, its words, and the function that draws it."""

    name: str
    title: str
    caption: str
    alt: str  # what is to be seen, in words
    place: str  # the figure of the paper that it answers to; empty for one that the paper has not
    draw: Callable[..., Figure]  # from what it is about: a Reading, a ReadingStudy, or nothing
    learns: bool  # whether it shows training runs

    @property
    def script(self) -> str:
        """Where it is drawn: a file of the checkout and the function in it."""
        module = self.draw.__module__.removeprefix("exact_mdp.").replace(".", "/")
        return f"{module}.py, {self.draw.__name__}"


class Pictures(list[Picture]):
    """The figures of one part of the report; `add` puts one in."""

    def add(self, name: str, *, learns: bool = False) -> Callable[[Draw], Draw]:
        """Return a decorator that adds a figure which the function draws."""
        words = WORDS[name]
        first = words["caption"].partition(". ")[0].removesuffix(".")

        def keep(draw: Draw) -> Draw:
            picture = Picture(
                name=name,
                title=words["title"],
                caption=words["caption"],
                alt=words.get("alt", f"{words['title']}. {first}."),
                place=words.get("place", ""),
                draw=draw,
                learns=learns,
            )
            self.append(picture)
            return draw

        return keep


def draw_all(
    pictures: Mapping[str, Callable[[], Figure]],
    folder: Path,
    progress: Callable[[str], None] = lambda name: None,
    dpi: int | None = None,
) -> None:
    """Draw every figure into a folder, as SVG and PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    with style():
        if dpi is not None:
            plt.rcParams["savefig.dpi"] = dpi
        for name, draw in pictures.items():
            progress(name)
            figure = draw()
            for text in figure.findobj(Text):  # a reward is counted in points throughout the report
                text.set_text(text.get_text().replace("(reward)", "(points)"))
            # The layout is worked out once, not anew for each kind of file.
            figure.draw_without_rendering()
            figure.set_layout_engine("none")
            save(figure, folder, name)
            plt.close(figure)


PICTURES = Pictures()
"""The figures of Sections 2 to 4.1, in the order of the paper."""


@PICTURES.add("trial_flow")
def _trials(reading: Reading) -> Figure:
    figure, ax = plt.subplots(figsize=(7.4, 3.1))
    flows = {
        label: trial_flow(reading.mdp, reading.policies[name], reading.scenario.trials)
        for name, label in (("optimal", "optimal policy"), ("random", "random actions"))
    }
    plot_trials(flows, ax=ax)
    ax.set_title("The first subtask, trial by trial")
    return figure


def trial_flow(mdp: MDP, policy: PolicyLike, trials: int) -> tuple[Floats, Floats]:
    """Return (M,) probabilities that each trial of subtask 0 is made, and completes it if made."""
    found, trial = evaluate(mdp, policy), mdp.space.values("trial")
    here = (mdp.space.values("subtask") == 0) & (trial < trials) & ~mdp.terminal
    clear = np.stack([status_law(mdp, action)[:, 0] for action in range(len(ACTIONS))], axis=1)
    weights, status = found.chain.weights, mdp.space.values("status")
    made, ends = np.zeros(trials), np.zeros(trials)
    for state in np.flatnonzero(here).tolist():
        pairs, visits = list(mdp.pairs_of(state)), float(found.visits[state])
        done = weights[pairs] @ clear[status[state], mdp.pair_action[pairs]]
        made[trial[state]] += visits
        ends[trial[state]] += visits * float(done)
    return made, ends / made


def status_law(mdp: MDP, action: int) -> Floats:
    """Return the (2^n, 2^n) law of the next status vector in the first trial, as compiled."""
    size = mdp.space.column("status").size
    following = np.maximum(mdp.space.values("status"), 0)
    law = np.zeros((size, size))
    for vector in range(size):
        row = mdp.transition[[mdp.pair(mdp.space.index(status=vector), action)]].tocoo()
        np.add.at(law[vector], following[row.coords[1]], row.data)
    return law


@PICTURES.add("status_transitions")
def _transitions(reading: Reading) -> Figure:
    figure, axes = plt.subplots(2, 2, figsize=(9, 9.6))
    for (action, number), ax in zip(NUMBER.items(), axes.flat, strict=True):
        plot_status_transitions(status_law(reading.mdp, number), reading.scenario.statuses, ax=ax)
        ax.set(title=f"a{number} {action}", ylabel="status now")
    figure.suptitle(
        "Chance of each status after an action, in per cent from 10 on; the darker, the likelier\n"
        "digits: forgetful, confused, angry, disengaged; 0000 completes the subtask",
        x=0.01,
        ha="left",
    )
    return figure


@PICTURES.add("influence_graph")
def _influence(reading: Reading) -> Figure:
    figure, ax = plt.subplots(figsize=(5, 5.3))
    plot_influence(reading.scenario, ax=ax)
    ax.set_title(
        "What each status adds to the chance of another,\n"
        "without assistance (Table 3), percentage points"
    )
    return figure


@PICTURES.add("learning_curves", learns=True)
def _learning(reading: Reading) -> Figure:
    figure = plt.figure(figsize=(6.6, 6.4))
    grid = figure.add_gridspec(2, 1)
    top = figure.add_subplot(grid[0])
    optimum = reading.evaluations["optimal"].mean
    curves = {shown: reading.learned(name).drawn.sampled for name, shown in SHOWN.items()}
    plot_experiments(curves | {"random": random_baseline(reading.mdp, SEED).sampled}, ax=top)
    top.axhline(optimum, color="black", linestyle=":", linewidth=1, label="optimum")
    top.legend(frameon=False, ncols=4, loc="lower center")
    top.set_ylim(bottom=0)
    top.set_title("One run of each, as the paper draws it: average of 40 experiments an epoch")
    below, first = grid[1].subgridspec(1, 2), None
    for column, (name, shown) in enumerate(SHOWN.items()):
        ax = figure.add_subplot(below[column], sharey=first)
        first = first or ax
        values = reading.learned(name).values
        plot_value_bands({shown: values}, optimum=optimum, ax=ax)
        ax.set(title=f"{shown}: {len(values)} runs", ylabel="exact value (points)")
        ax.set_ylim(bottom=120)
    return figure


@PICTURES.add("learned_policies", learns=True)
def _learned_maps(reading: Reading) -> Figure:
    figure, axes = plt.subplots(2, 1, figsize=(5.6, 6.8))
    for ax, (name, shown) in zip(axes, SHOWN.items(), strict=True):
        choices, shares = reading.learned(name).common()
        plot_status_policy(
            ACTIONS,
            choices,
            statuses=reading.scenario.statuses,
            shares=shares,
            marked=np.flatnonzero(choices != reading.optimum[: len(choices)]).tolist(),
            ax=ax,
        )
        ax.set_title(f"{shown}: the commonest action at the end")
    return figure


@PICTURES.add("optimal_policy_map")
def _policy_map(reading: Reading) -> Figure:
    """Draw one map for each different one among the subtasks and trials."""
    space, size = reading.mdp.space, len(STATUSES)
    maps: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for subtask in range(space.column("subtask").size):
        for trial in range(reading.scenario.trials):
            first = space.index(subtask=subtask, trial=trial)
            key = tuple(np.asarray(reading.optimum[first : first + size]).tolist())
            maps.setdefault(key, []).append((subtask, trial))
    figure, axes = plt.subplots(len(maps), 1, figsize=(5.6, 3.4 * len(maps)), squeeze=False)
    for (choices, places), ax in zip(maps.items(), axes[:, 0], strict=True):
        plot_status_policy(
            reading.mdp.actions, np.array(choices), statuses=reading.scenario.statuses, ax=ax
        )
        listed = ", ".join(f"{subtask}/{trial}" for subtask, trial in places)
        where = "every subtask and trial" if len(maps) == 1 else f"subtask/trial {listed}"
        ax.set_title(f"optimal action, {where}")
    return figure


@PICTURES.add("three_policies", learns=True)
def _averages(reading: Reading) -> Figure:
    figure, ax = plt.subplots(figsize=(6, 4.4))
    found = reading.weighed
    rows = [
        Average(
            label=f"{start} in 0000,\n{name}",
            exact=float(found.mean[number, place]),
            standard_error=float(found.variance[number, place] / reported.EXPERIMENTS) ** 0.5,
            reported=reported.AVERAGE_RETURN[start],
            span=found.range(start),
        )
        for place, start in enumerate(STARTS)
        for name, number in (("as written", found.best()), ("best fit", int(found.fitting)))
    ]
    plot_averages(rows, optimum=reading.evaluations["optimal"].mean, ax=ax)
    ax.set_title("Three policies: what the paper reports, and exactly", pad=18)
    return figure


@PICTURES.add("return_distributions")
def _returns(reading: Reading) -> Figure:
    labels = {
        "optimal": "optimal policy",
        f"reported.{FINAL}": "reported final policy",
        "random": "random actions",
    }
    figure, axes = plt.subplots(3, 1, figsize=(5.8, 5.8), sharex=True, sharey=True)
    lowest = []
    for ax, (name, label) in zip(axes, labels.items(), strict=True):
        distribution = return_distribution(reading.mdp, reading.policies[name])
        plot_return_distribution(distribution, label=label, bin=10, ax=ax)
        lowest.append(float(distribution.quantile(0.001)))
    axes[-1].set_xlim(left=min(lowest))
    axes[-1].set_xlabel("return of an episode (points); dashed: the mean")
    return figure


@PICTURES.add("cost_of_choices")
def _choices(reading: Reading) -> Figure:
    figure, ax = plt.subplots(figsize=(6.6, 5.8))
    policy = reported.policy(FINAL, reading.completion)
    plot_choices(
        choice_losses(reading),
        rows=[f"{words.replace(' and ', ', ')}  {s}" for s, words in STATUS_WORDS.items()],
        columns=[action.replace("-", "-\n") for action in ACTIONS],
        marked={row: NUMBER[policy[status]] for row, status in enumerate(STATUSES)},
        ax=ax,
    )
    ax.set_xlabel("● action of the reported final policy", loc="left")
    figure.suptitle("Points lost by an action taken whenever a status comes up", x=0.01, ha="left")
    return figure


def choice_losses(reading: Reading) -> Floats:
    """Return (16, 4) what is lost at the start by an action in a status, all else being optimal."""
    mdp, best = reading.mdp, reading.evaluations["optimal"].mean
    status, free = mdp.space.values("status"), ~mdp.forced & ~mdp.terminal
    losses = np.zeros((len(STATUSES), len(ACTIONS)))
    for vector, action in np.ndindex(losses.shape):
        other = np.where(free & (status == vector), action, reading.optimum)
        losses[vector, action] = best - evaluate(mdp, Policy.from_choices(mdp, other)).mean
    return np.where(np.abs(losses) < ROUNDING, 0.0, losses)


@PICTURES.add("unique_policies", learns=True)
def _unique(reading: Reading) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 3.6))
    plot_distinct({shown: reading.learned(name).outcomes for name, shown in SHOWN.items()}, ax=ax)
    ax.set_title("Policies that are greedy in the last 100 episodes of a run")
    return figure


@PICTURES.add("first_status", learns=True)
def _first_status(reading: Reading) -> Figure:
    figure, (above, below) = plt.subplots(2, 1, figsize=(7.6, 5.2))
    rows = {
        f"{shown}, {step}": (view.learned(name), gap_first(view, name))
        for step, view in (("constant rate", reading), ("falling step", reading.falling))
        for name, shown in SHOWN.items()
    }
    shares = {label: learned.outcomes.choices(0) for label, (learned, _) in rows.items()}
    plot_shares(shares, reading.mdp.actions[: len(ACTIONS)], ax=above)
    above.set_xlabel("share of runs by their final action in 0000")
    plot_dots({label: gaps for label, (_, gaps) in rows.items()}, ax=below)
    below.axvline(0, color="black", lw=0.8)
    below.set_xlabel("learned value of non-directive less directive in 0000 (points)")
    return figure


@PICTURES.add("final_regret", learns=True)
def _regrets(reading: Reading) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 3.6))
    plot_regrets({shown: reading.learned(name).outcomes for name, shown in SHOWN.items()}, ax=ax)
    ax.set_title("What final policies lose against the optimum")
    return figure
