"""The figures of the reproduction, drawn from a study and saved as SVG and PNG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.plots import (
    plot_influence,
    plot_policy_map,
    plot_return_distribution,
    plot_status_transitions,
    save,
    style,
)
from mdp import MDP
from paper_repro.numbers import Study
from solvers.returns import return_distribution


def draw_all(study: Study, folder: Path, progress: Callable[[str], None]) -> list[Path]:
    """Draw every figure into a folder; return the paths written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with style():
        for name, draw in FIGURES.items():
            progress(name)
            figure = draw(study)
            written += save(figure, folder, name)
            plt.close(figure)
    return written


def _policy_map(study: Study) -> Figure:
    """One map for each different one among the subtasks and trials."""
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

    from analysis.plots import action_styles

    handles = [
        Patch(facecolor=s.fill, edgecolor="black", hatch=s.hatch, label=f"{s.short} {s.name}")
        for s in action_styles(mdp.actions)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)


def _influence(study: Study) -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 5.6))
    plot_influence(study.scenario, ax=ax)
    ax.set_title("Influence between statuses without assistance (Table 3), percentage points")
    return figure


def _transitions(study: Study) -> Figure:
    figure, axes = plt.subplots(2, 2, figsize=(11, 9.5))
    for number, ax in enumerate(axes.flat):
        plot_status_transitions(status_law(study.mdp, number), study.scenario.statuses, ax=ax)
        ax.set_title(f"a{number} {study.mdp.actions[number]}")
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


def _returns(study: Study) -> Figure:
    labels = {
        "optimal": "optimal policy",
        "reported.non-directive": "reported final policy (a2 in 0000)",
        "random": "random policy",
    }
    figure, axes = plt.subplots(3, 1, figsize=(7, 6.5), sharex=True)
    lowest = []
    for ax, (name, label) in zip(axes, labels.items(), strict=True):
        distribution = return_distribution(study.mdp, study.policies[name])
        plot_return_distribution(distribution, label=label, ax=ax)
        lowest.append(float(distribution.quantile(0.001)))
    axes[-1].set_xlim(left=min(lowest))
    axes[-1].set_xlabel("return of an episode (sum of rewards)")
    return figure


FIGURES: dict[str, Callable[[Study], Figure]] = {
    "optimal_policy_map": _policy_map,
    "influence_graph": _influence,
    "status_transitions": _transitions,
    "return_distributions": _returns,
}
