"""Pictures of any model's states: what a policy does, what states are worth, how often they come.

A map has a cell for each state, placed as `analysis.layout` says: by two or more columns of the
state space, or by the `shape` of a grid world. Actions whose names are directions are arrows.
Values of states that are only numbered are bars. `place` stands for shape, down, across and the
columns held fixed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from exact_mdp.analysis.gate.cells import cells
from exact_mdp.analysis.layout import ARROWS, WIDE, Layout, arrange, joined, taken
from exact_mdp.analysis.plots.style import (
    BLACK,
    BLUE,
    Look,
    action_legend,
    action_styles,
    axes_or_new,
    cell,
    name_rows,
    plain_text,
    titled,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.audit import Audit
    from exact_mdp.analysis.gate.comparison import PolicyComparison
    from exact_mdp.solvers.solution import Solution
    from exact_mdp.solvers.values.evaluate import Evaluation

MOST_CELLS = 4000  # of a map
MOST_TEXTS = 700  # cells that have room for a text
NUMBERED = 60  # cells that have room for a number, too
MOST_NAMES = 40  # bars that are named
MOST_LETTERS = 70  # of the texts at the ends of bars, side by side
ORANGE = "#D55E00"
GROUND = "Blues"
ENDS = "∎ an episode ends"


@plain_text
def plot_policy(
    model: MDP, policy: PolicyLike, *, legend: bool = True, ax: Axes | None = None, **place: Any
) -> Axes:
    """Draw what a policy does in each state, in the style of its action.

    Parameters
    ----------
    model : MDP
    policy : PolicyLike
    legend : bool
        Name the actions beside the map.
    ax : Axes, optional
    **place
        Where states stand: `shape`, `down`, `across`, and columns held fixed; see `arrange`.

    Returns
    -------
    Axes

    Raises
    ------
    ModelError
        As `arrange` does, and where the map would have over 4,000 cells.

    Examples
    --------
    >>> names = ["left", "down", "right", "up"]
    >>> grid = MDP.from_arrays([np.eye(6)] * 4, [0, 0, 0, 0, 0, 1], 0.9, actions=names)
    >>> ax = plot_policy(grid, [2, 2, 1, 3, 0, 0], shape=(2, 3))
    >>> [text.get_text() for text in ax.texts]
    ['∎', '∎', '∎', '∎', '∎', '←']
    """
    layout = _placed(model, place)
    ax, styles = _map(layout, ax), action_styles(model.actions, layout.signs)
    choices = taken(model, policy_of(model, policy).weights(model))
    used = set[int]()
    for state in layout.shown.tolist():
        where, numbers = (int(layout.column[state]), int(layout.row[state])), choices[state]
        drawn = styles[numbers[0]]
        if model.over[state]:
            cell(ax, *where, drawn, text="∎", fill="0.92", ink="0.4", hatch="", font=_font(layout))
        elif len(numbers) > 1:
            mixed = joined([styles[number].short for number in numbers], "mixed")
            cell(ax, *where, drawn, text=mixed, fill="white", ink="black", hatch="", font=6)
        else:
            cell(ax, *where, drawn, font=_font(layout))
            used.add(numbers[0])
    if legend:
        ends = bool(model.over[layout.shown].any())
        action_legend(ax, styles, sorted(used), ends=ends)
    return ax


@plain_text
def plot_states(
    model: MDP,
    values: ArrayLike,
    *,
    policy: PolicyLike | None = None,
    label: str = "value (reward)",
    ax: Axes | None = None,
    **place: Any,
) -> Axes:
    """Draw a number for each state: a heat map, or bars where states are only numbered.

    Parameters
    ----------
    model : MDP
    values : (S,)
    policy : PolicyLike, optional
        Its actions are written into the cells, or at the ends of the bars.
    label : str
        What the numbers are, with their unit.
    ax : Axes, optional
    **place
        Where states stand; see `plot_policy`.

    Returns
    -------
    Axes

    Raises
    ------
    ModelError
        As `plot_policy` does, and for values that are not one for each state.

    Examples
    --------
    >>> model = MDP.from_arrays([np.eye(6)], np.zeros(6), 0.9)
    >>> (
    ...     len(plot_states(model, np.arange(6), shape=(2, 3)).patches),
    ...     len(plot_states(model, range(6)).patches),
    ... )
    (6, 6)
    """
    given = np.asarray(values, dtype=np.float64)
    if given.shape != (model.n_states,):
        raise ModelError(
            f"values of shape {given.shape} for {model.n_states} states",
            where="plot_states",
            fix="give one number for each state",
        )
    layout, texts = _placed(model, place), [""] * model.n_states
    if policy is not None:
        choices = taken(model, policy_of(model, policy).weights(model))
        texts = [
            joined([layout.signs[number] for number in numbers], "mixed") for numbers in choices
        ]
    if layout.listed:
        ax = _bars(axes_or_new(ax), model, given, texts, label)
        if policy is not None:
            _key(ax, model, layout)
        return ax
    ax, scale = _map(layout, ax), _scale(given[layout.shown])
    shades, font = colormaps[GROUND], _font(layout)
    style = action_styles(["-"])[0]
    numbered = len(layout.shown) <= NUMBERED
    for state in layout.shown.tolist():
        value, where = given[state], (int(layout.column[state]), int(layout.row[state]))
        share = 0.75 * float(scale(value)) if np.isfinite(value) else 0.0
        lines = ["∎" if model.over[state] else texts[state], f"{value:.3g}" * numbered]
        if not np.isfinite(value):
            lines[1] = f"{value:g}"
        text = "\n".join(line for line in lines if line) or " "
        ink = "white" if share > 0.6 else "black"
        cell(ax, *where, style, text=text, fill=shades(share), ink=ink, font=font, edgecolor="0.8")
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    low, high = scale.vmin or 0.0, scale.vmax or 0.0
    shown = ScalarMappable(Normalize(low, low + (high - low) / 0.75 or 1.0), shades)
    bar = figure.colorbar(shown, ax=ax, label=label, shrink=0.8)
    bar.ax.set_ylim(low, high if high > low else low + 1.0)
    ends = [ENDS] if model.over[layout.shown].any() else []
    if policy is not None or ends:
        _key(ax, model, layout, *ends)
    return ax


@plain_text
def plot_solution(found: Solution, *, ax: Axes | None = None, **place: Any) -> Axes:
    """Draw the values of a solution, a certificate or an evaluation, with the policy's actions.

    A certificate that was read from a file has no model, and no picture.
    """
    if found.mdp is None:
        raise ModelError(
            "a certificate read from a file does not contain the model",
            where="plot",
            fix="draw plot_states(model, certificate.value_float)",
        )
    value = getattr(found, "value_float", None)
    value = found.value if value is None else value
    label = "value (reward)" if getattr(found, "gain", None) is None else "gain (reward per step)"
    return plot_states(found.mdp, value, policy=found.policy, label=label, ax=ax, **place)


@plain_text
def plot_evaluation(
    found: Evaluation, *, visits: bool = False, ax: Axes | None = None, **place: Any
) -> Axes:
    """Draw the values of a policy, or its expected visits to each state from the start."""
    values, label = (found.visits, "expected visits") if visits else (found.value, "value (reward)")
    policy = found.policy
    return plot_states(found.mdp, values, policy=policy, label=label, ax=ax, **place)


@plain_text
def plot_audit(audit: Audit, *, ax: Axes | None = None, **place: Any) -> Axes:
    """Draw what the policy does; wrong states have a cross, a frame and the optimal action below.

    Darker cells cost more. States that are only listed have their number or
    name in a corner.
    """
    layout = _placed(audit.mdp, place)
    ax, style, font = _map(layout, ax), action_styles(["-"])[0], _font(layout)
    drawn = [each for row in cells(audit, layout) for each in row if each is not None]
    for each in drawn:
        where = (int(layout.column[each.state]), int(layout.row[each.state]))
        wrong = each.kind == "wrong"
        fill = (0.84, 0.37, 0.0, 0.1 + 0.6 * each.shade) if wrong else "white"
        edge, width = (ORANGE, 1.6) if wrong else ("0.8", 1.0)
        text = "\n".join(line for line in (each.text, each.small) if line)
        ink = "0.55" if each.kind == "idle" else "black"
        frame: Look = {"edgecolor": edge, "linewidth": width, "zorder": 1 + wrong}
        cell(ax, *where, style, text=text, fill=fill, ink=ink, font=font, **frame)
        if each.name and font:
            corner: Look = {"ha": "left", "va": "top", "fontsize": 0.6 * font, "clip_on": True}
            name = each.name if len(each.name) <= 9 else f"{each.name[:8]}…"
            ax.text(where[0] + 0.06, where[1] + 0.08, name, color=ink, **corner)
    words = ["✗ not optimal; below it the optimal action; darker cells cost more"]
    if any(each.kind == "idle" for each in drawn):
        words.append("grey: no choice, or not wrong and never visited")
    if audit.mdp.over[layout.shown].any():
        words.append(ENDS)
    if layout.listed:
        words.append("in the corner the state")
    _key(ax, audit.mdp, layout, *words)
    return ax


@plain_text
def plot_comparison(found: PolicyComparison, *, ax: Axes | None = None) -> Axes:
    """Draw the value of each policy at the start, certified or bounded; the optimum is a line."""
    ax, best = axes_or_new(ax, list(found.regrets)), float(found.value.value)
    for row, each in enumerate(found.regrets.values()):
        value = float(each.learned.value)
        end = value if np.isfinite(value) else 0.0  # an infinite value has no bar
        ax.barh(row, end, color=BLUE, edgecolor=BLACK, height=0.6)
        side = "left" if end >= 0 else "right"
        text = f" {value:.6g} ({each.learned.claim}) "
        ax.annotate(text, (end, row), va="center", ha=side, fontsize=8)
    if np.isfinite(best):
        ax.axvline(best, color=BLACK, linestyle=":")
    ax.axvline(0, color=BLACK, linewidth=0.8)
    name_rows(ax, list(found.regrets))
    ax.margins(x=0.3)
    ax.set_xlabel("value at the start (reward)")
    titled(ax, f"optimum {best:.6g} ({found.claim}), dotted")
    return ax


def _placed(model: MDP, place: Mapping[str, Any]) -> Layout:
    layout = arrange(model, **place)
    count = len(layout.rows) * len(layout.columns)
    if count > MOST_CELLS:
        raise ModelError(
            f"a map of {count:,} cells",
            where="plot",
            fix="hold columns fixed, such as trial=0, or read the table: .frame()",
        )
    return layout


def _map(layout: Layout, ax: Axes | None) -> Axes:
    """Return axes with a cell for each row and column of the map, and their names."""
    high, wide = len(layout.rows), len(layout.columns)
    if ax is None:
        size = (max(3.6, min(14.0, 2.6 + 0.55 * wide)), max(2.2, min(12.0, 1.2 + 0.45 * high)))
        ax = plt.subplots(figsize=size, layout="constrained")[1]
    ax.set(xlim=(0, wide), ylim=(high, 0), xlabel=layout.across, ylabel=layout.down)
    for ticks, labels in ((ax.set_xticks, layout.columns), (ax.set_yticks, layout.rows)):
        step = -(-len(labels) // MOST_NAMES)
        ticks(np.arange(0, len(labels), step) + 0.5, labels[::step])
    if max(map(len, layout.columns)) > 4:
        ax.tick_params(axis="x", rotation=90)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    return ax


def _font(layout: Layout) -> float | None:
    """Return the size of the text in a cell; 0 where there is no room for one."""
    wide = len(layout.columns) > 2 * WIDE
    sizes = ((30, 11), (2 * NUMBERED, 8), (MOST_TEXTS, 6 if wide else 8))
    return next((size for most, size in sizes if len(layout.shown) <= most), 0)


def _key(ax: Axes, model: MDP, layout: Layout, *words: str) -> None:
    """Say in the title what the signs of actions stand for."""
    signs = zip(layout.signs, model.actions, strict=True)
    named = [f"{sign} {name}" for sign, name in signs if sign != name and sign not in ARROWS]
    if words or 0 < len(named) <= len(ARROWS) * 2:
        titled(ax, "; ".join([*words, ", ".join(named)]).removesuffix("; "))


def _scale(values: Floats) -> Normalize:
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    return Normalize(low, high if high > low else low + 1.0)


def _bars(ax: Axes, model: MDP, values: Floats, texts: list[str], label: str) -> Axes:
    """Draw a bar for each state, with what the policy does at its end."""
    finite = np.where(np.isfinite(values), values, 0.0)
    ax.bar(range(len(values)), finite, color=BLUE, edgecolor=BLACK, linewidth=0.5)
    names = [model.space.label(state).removeprefix("state ") for state in range(len(values))]
    step = -(-len(values) // MOST_NAMES)
    long = max(map(len, names[::step])) > 3
    ax.set_xticks(range(0, len(values), step), names[::step], rotation=90 if long else 0)
    turned = 90 if len(values) * max(map(len, texts)) > MOST_LETTERS else 0
    for state, text in enumerate(texts if len(values) <= MOST_NAMES else ()):
        shown = text if np.isfinite(values[state]) else f"{text}\n{values[state]:g}"
        below = finite[state] < 0
        ax.annotate(
            "" if model.over[state] else shown,
            (state, finite[state]),
            xytext=(0, -2 if below else 2),
            textcoords="offset points",
            ha="center",
            va="top" if below else "bottom",
            fontsize=8,
            rotation=turned,
        )
    ax.axhline(0, color=BLACK, linewidth=0.8)
    ax.margins(y=0.3 if turned else 0.12)
    ax.set(xlabel="state", ylabel=label)
    return ax
