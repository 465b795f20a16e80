"""Pictures of the states of a model: actions of a policy, values, expected visits, losses.

A map has a cell for each state, placed as `analysis.layout` says. Actions that are directions are
arrows. The start has a heavy frame; a terminal state shows the first letter of its label, such as
goal or hole, or ∎. Values of states that are only numbered are bars. `place` stands for shape,
down, across and the columns held fixed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import ArrayLike

from exact_mdp.analysis.layout import (
    ARROWS,
    MOST_CELLS,
    MOST_NAMED,
    Layout,
    arrange,
    build_cells,
    ends_of,
    find_columns,
    shorten_names,
)
from exact_mdp.analysis.optimum import actions_of
from exact_mdp.analysis.plots.style import (
    BLACK,
    BLUE,
    ORANGE,
    WHITE,
    Look,
    apply_style,
    axes_or_new,
    fill_of,
    is_narrow,
    label_axes,
    make_swatch,
    measure_names,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.audit import Audit
    from exact_mdp.solvers.solution import Solution
    from exact_mdp.solvers.values.evaluate import Evaluation

NUMBERED = 60  # cells that have room for a number, too
NAMES_PER_INCH = 7.2  # one above the other, or upright side by side
MOST_LETTERS = 70  # of names side by side
LONGEST = 26  # letters of a name beside the axes
SHADES = LinearSegmentedColormap.from_list("value", ["#F7FBFF", "#2171B5"])
LOSSES = LinearSegmentedColormap.from_list("loss", ["#FFF1E8", ORANGE])
ENDLESS: Look = {"fill": BLUE, "hatch": "//"}  # of an infinite loss


@apply_style
def plot_policy(model: MDP, policy: PolicyLike, *, ax: Axes | None = None, **place: Any) -> Axes:
    """Draw the action of a policy in each state, in the style of the action.

    Parameters
    ----------
    model : MDP
    policy : PolicyLike
    ax : Axes, optional
    **place
        Where states stand: `shape`, `down`, `across`, and columns held fixed; see `arrange`.

    Returns
    -------
    Axes

    Examples
    --------
    >>> names = ["left", "down", "right", "up"]
    >>> grid = MDP.from_arrays([np.eye(6)] * 4, [0, 0, 0, 0, 0, 1], 0.9, actions=names)
    >>> ax = plot_policy(grid, [2, 2, 1, 3, 0, 0], shape=(2, 3))
    >>> [text.get_text() for text in ax.texts]
    ['∎', '∎', '∎', '∎', '∎', '←']
    """
    layout, ends, used = _place_states(model, place), ends_of(model), set[int]()
    choices = actions_of(model, policy_of(model, policy).weights(model) > 0)
    shown: dict[int, tuple[str, Look]] = {}
    for state in layout.shown.tolist():
        text, number = layout.format_actions(choices[state]), model.actions.index(choices[state][0])
        if state in ends:
            shown[state] = ends[state][0], {"fill": "0.92", "ink": "0.2"}
        elif len(choices[state]) > 1:
            shown[state] = text, {"font": 6}
        else:
            used.add(number)
            shown[state] = text, fill_of(number)
    names = [s if s == action else f"{s} {action}" for action, s in layout.signs.items()]
    handles = [make_swatch(names[number], fill_of(number)) for number in sorted(used)]
    return _draw_map(model, layout, ax, "What the policy does", shown, handles)


@apply_style
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

    Examples
    --------
    >>> model = MDP.from_arrays([np.eye(6)], np.zeros(6), 0.9)
    >>> len(plot_states(model, np.arange(6), shape=(2, 3)).patches)  # cells, and the start's frame
    7
    """
    given = np.asarray(values, dtype=np.float64)
    if given.shape != (model.n_states,):
        raise ModelError(
            f"values of shape {given.shape} for {model.n_states} states",
            where="plot_states",
            fix="give one number for each state",
        )
    # The actions of a policy are written into the cells.
    layout, texts = _place_states(model, place), [""] * model.n_states
    if policy is not None:
        choices = actions_of(model, policy_of(model, policy).weights(model) > 0)
        texts = [*map(layout.format_actions, choices)]
    acts = policy is not None and not (layout.listed and model.n_states > MOST_NAMED)
    signs: list[Artist] = []
    if acts:
        signs = [*_make_sign_handles(layout, (texts[s] for s in layout.shown.tolist()))]
    acting = ""
    if acts:
        acting = ", and what the policy does"
    what = f"{label.partition(' (')[0].capitalize()} of each state{acting}"
    # States that are only numbered have no map: draw bars.
    if layout.listed:
        ax = _draw_state_bars(axes_or_new(ax), model, given, texts, label)
        return label_axes(ax, what, model.name, handles=signs)
    # The scale of the colours reaches from the least to the greatest finite value.
    known = given[layout.shown][np.isfinite(given[layout.shown])]
    if len(known):
        low, high = (float(known.min()), float(known.max()))
    else:
        low, high = (0.0, 0.0)
    scale = Normalize(low, high if high > low else low + 1.0)
    # Each cell: the sign of an end or an action, and the number if there is room.
    ends, shown = ends_of(model), dict[int, Any]()
    for state in layout.shown.tolist():
        value, finite = given[state], np.isfinite(given[state])
        share = 0.0
        if finite:
            share = float(scale(value))
        number = ""
        if len(layout.shown) <= NUMBERED or not finite:
            number = f"{value:.3g}"
        lines = [ends[state][0] if state in ends else texts[state], number]
        look = {"fill": SHADES(share), "ink": "white" if share > 0.7 else BLACK}
        shown[state] = "\n".join(filter(None, lines)), look | {"edgecolor": "0.8"}
    # One value needs no scale.
    bar = None
    if high > low:
        bar = ScalarMappable(scale, SHADES), label
    elif len(known):
        signs.append(make_swatch(f"{low:.4g}", {"fill": SHADES(0.0), "hatch": ""}))
    return _draw_map(model, layout, ax, what, shown, signs, bar)


@apply_style
def plot_solution(solution: Solution, *, ax: Axes | None = None, **place: Any) -> Axes:
    """Draw the values of a solution, a certificate or an evaluation, with the policy's actions.

    A certificate that was read from a file has no model, and therefore no picture.
    """
    if solution.mdp is None:
        raise ModelError(
            "a certificate read from a file does not contain the model",
            where="plot",
            fix="draw plots.plot_states(model, certificate.value_float)",
        )
    value = getattr(solution, "value_float", None)
    if value is None:
        value = solution.value
    average = getattr(solution, "gain", None) is not None
    label = "optimal value (reward)"
    if average:
        label = "optimal gain (reward per step)"
    return plot_states(solution.mdp, value, policy=solution.policy, label=label, ax=ax, **place)


@apply_style
def plot_evaluation(
    own: Evaluation, *, visits: bool = False, ax: Axes | None = None, **place: Any
) -> Axes:
    """Draw the values of a policy, or its expected visits to each state from the start."""
    if visits:
        values, label = (own.visits, "expected visits")
    else:
        values, label = (own.value, "value (reward)")
    return plot_states(own.mdp, values, policy=own.policy, label=label, ax=ax, **place)


@apply_style
def plot_audit(audit: Audit, *, ax: Axes | None = None, **place: Any) -> Axes:
    """Draw what the policy does; wrong states have a cross, a frame and the optimal action below.

    Darker cells cost more; those that lose infinitely much are blue and hatched.
    """
    layout, mdp = _place_states(audit.mdp, place), audit.mdp
    drawn = [each for each in chain(*build_cells(audit, layout)) if each is not None]
    ends, shown = ends_of(mdp), dict[int, tuple[str, Look]]()
    lossy = any(each.cost > 0 for each in audit.disagreements)
    # The look of each cell: wrong ones have a fill by their loss and a heavy frame.
    for each in drawn:
        if each.state in ends:
            text = ends[each.state][0]
        else:
            text = f"{each.text}\n{each.small}".strip()
        look: Look = {"edgecolor": "0.8", "ink": "0.5" if each.kind == "idle" else BLACK}
        if each.kind == "wrong":
            look |= {"edgecolor": ORANGE, "linewidth": 1.6, "zorder": 2}
            if lossy:
                look["fill"] = LOSSES(min(each.shade, 1.0))
            if np.isinf(each.shade):
                look |= ENDLESS
        shown[each.state] = text, look
    # The colour bar reaches to the largest finite loss.
    losses = [each.cost for each in audit.disagreements if np.isfinite(each.cost)]
    colours = ScalarMappable(Normalize(0.0, max(losses, default=0.0)), LOSSES)
    words = []
    if any(each.kind == "wrong" for each in drawn):
        words = ["✗ not optimal; below it\n   the optimal action"]
    if any(each.kind == "idle" for each in drawn):
        words.append("grey sign: not wrong;\n   no choice or no visit")
    lost = float(audit.regret.at_start.value)
    texts = [text for text, _ in shown.values()]
    what = f"Where the policy is not optimal; regret at the start {lost:.4g}"
    bar = None
    if max(losses, default=0.0) > 0:
        bar = (colours, "what the state loses (reward)")
    signs: list[Artist] = [*map(_make_text_handle, words), *_make_sign_handles(layout, texts)]
    if any(np.isinf(each.shade) for each in drawn):
        signs.append(make_swatch("loses infinitely much", ENDLESS))
    return _draw_map(mdp, layout, ax, what, shown, signs, bar)


# ---- maps --------------------------------------------------------------------------------------


def _place_states(model: MDP, place: Mapping[str, Any]) -> Layout:
    layout = arrange(model, **place)
    if layout.cells > MOST_CELLS:
        columns = [column for column, _ in find_columns(model).values() if not layout.listed]
        fix = "read the table: .frame()"
        for most in sorted(columns, key=lambda column: column.size)[-1:]:
            first = most.label(0)
            value = first if first == "0" else repr(first)
            fix = f"hold columns fixed, such as {most.name}={value}, or {fix}"
        raise ModelError(f"a map of {layout.cells:,} cells", where="plot", fix=fix)
    return layout


def _draw_map(
    model: MDP,
    layout: Layout,
    ax: Axes | None,
    what: str,
    shown: Mapping[int, tuple[str, Look]],
    handles: Sequence[Artist],
    colours: tuple[ScalarMappable, str] | None = None,
) -> Axes:
    """Draw the cells of states, a text and the look of each, with a legend and a colour bar.

    States that are only listed have their number or name in a corner.
    """
    high, wide = len(layout.rows), len(layout.columns)
    if ax is None:
        size = (max(4.8, min(14.0, 3.4 + 0.55 * wide)), max(2.8, min(12.0, 1.9 + 0.42 * high)))
        ax = plt.subplots(figsize=size, layout="constrained")[1]
    ax.set(xlim=(0, wide), ylim=(high, 0), xlabel=layout.across, ylabel=layout.down)
    inches = np.array([ax.bbox.width, ax.bbox.height]) / ax.figure.dpi
    for ticks, labels, most in (
        (ax.set_xticks, layout.columns, MOST_NAMED),
        (ax.set_yticks, layout.rows, min(MOST_NAMED, int(NAMES_PER_INCH * inches[1]))),
    ):
        step = -(-len(labels) // max(1, most))
        ticks(np.arange(0, len(labels), step) + 0.5, shorten_names(labels, LONGEST)[::step])
    if max(map(len, layout.columns)) > 4:
        ax.tick_params(axis="x", rotation=90)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    # The size of the text in a cell, by the number of cells; 0 if a cell has no room for one.
    sizes = ((30, 10), (2 * NUMBERED, 8), (700, 6 if wide > 20 else 7))
    font = next((size for most, size in sizes if len(shown) <= most), 0)
    texts = [text.split("\n") for text, _ in shown.values()]
    letters = max(1, *map(len, chain(*texts)))
    deep = max(map(len, texts))
    inches[0] = min(inches[0], ax.figure.bbox.width / ax.figure.dpi - measure_names(ax) - 1)
    room = 72 * inches / [wide * letters, high]
    # A letter is 0.85 sizes of the font wide, a line 1.3 high; nobody reads less than 3.5 points.
    font = min(font, *(room / [0.85, 1.3 * deep]).tolist())
    if font < 3.5:
        font = 0
    usual: Look = {"fill": WHITE, "ink": BLACK, "hatch": "", "font": font}
    # a frame would cover a cell without a text
    thin: Look
    if font:
        thin = {}
    else:
        thin = {"linewidth": 0.2}
    listed = layout.named_in_cells
    full = [name.removeprefix("state ") for name in model.space.labels(shown if listed else ())]
    names = dict(zip(shown, shorten_names(full, 12), strict=False))  # 12 letters fit into a corner
    for state, (text, own) in shown.items():
        look = usual | {"edgecolor": BLACK} | own | thin
        x, y = int(layout.column[state]), int(layout.row[state])
        fill, ink, hatch, most = map(look.pop, usual)
        ax.add_patch(Rectangle((x, y), 1, 1, facecolor=fill, hatch=hatch, **look))
        if font:
            box = {"facecolor": fill if hatch else "none", "edgecolor": "none", "pad": 1.2}
            centre: Look = {"ha": "center", "va": "center", "fontsize": min(font, most)}
            ax.text(x + 0.5, y + 0.5, text, color=ink, bbox=box, **centre)
        if font and listed:
            beside: Look = {"ha": "left", "va": "top", "fontsize": 0.6 * font, "clip_on": True}
            ax.text(x + 0.06, y + 0.08, names[state], color=ink, **beside)
    if colours is not None:
        # the legend is on the other one
        side = "bottom"
        if is_narrow(ax):
            side = "right"
        place: Look = {"location": side, "shrink": 0.7, "aspect": 35, "pad": 0.03}
        bar = ax.figure.colorbar(colours[0], ax=ax, label=colours[1], **place)
        bar.outline.set_visible(False)
    handles = [*handles, *_signs_of_states(ax, model, layout)]
    if not font:  # no sign is drawn
        handles = [each for each in handles if isinstance(each, Patch)]
    if layout.held:
        what += f"; {layout.held}"
    return label_axes(ax, what, model.name, handles=handles)


def _signs_of_states(ax: Axes, model: MDP, layout: Layout) -> list[Any]:
    """Frame the start; return a legend's entries for it and for terminal states."""
    listed, ends = list[Any](), ends_of(model)
    starts = [s for s, _ in model.start if layout.row[s] >= 0]
    if len(starts) < len(layout.shown) / 2:
        for s in starts:
            corner = (int(layout.column[s]), int(layout.row[s]))
            ax.add_patch(Rectangle(corner, 1, 1, fill=False, edgecolor=BLACK, lw=2.5, zorder=4))
        if starts:
            listed.append(Patch(facecolor="none", edgecolor=BLACK, lw=2, label="start"))
    shown = dict.fromkeys(ends[s] for s in layout.shown.tolist() if s in ends)
    return [*listed, *(_make_text_handle(f"{sign} {words}") for sign, words in shown)]


def _make_sign_handles(layout: Layout, texts: Iterable[str]) -> list[Line2D]:
    """Return a legend's entries for the signs of actions in some texts that need an explanation."""
    signs, drawn = layout.signs.items(), {*re.split(r"[\s/]", " ".join(texts))}
    shown = [(sign, action) for action, sign in signs if sign in drawn]
    open_ = [f"{sign} {action}" for sign, action in shown if sign not in (action, *ARROWS)]
    return [*map(_make_text_handle, open_[: 2 * len(ARROWS)])]


def _make_text_handle(text: str) -> Line2D:
    return Line2D([], [], linestyle="", label=text)


def _draw_state_bars(ax: Axes, model: MDP, values: Floats, texts: list[str], label: str) -> Axes:
    """Draw a bar for each state, with what the policy does at its end."""
    count, finite = len(values), np.where(np.isfinite(values), values, 0.0)
    edge: Look
    if count <= NUMBERED:
        edge = {"edgecolor": BLACK, "linewidth": 0.5}
    else:
        edge = {"width": 1.0}
    bars = ax.bar(range(count), finite, color=BLUE, **edge)
    # Name as many bars as fit, upright if their names would run into each other.
    names = [name.removeprefix("state ") for name in model.space.labels(range(count))]
    names = shorten_names(names, LONGEST)
    wide = ax.bbox.width / ax.figure.dpi
    most = min(MOST_NAMED, max(1, int(NAMES_PER_INCH * wide)))
    step = -(-count // most)
    upright = len("  ".join(names[::step])) > MOST_LETTERS
    ax.set_xticks(range(0, count, step), names[::step], rotation=90 if upright else 0)
    turned = 0
    if count * max(map(len, texts)) > MOST_LETTERS:
        turned = 90
    # An infinite value has no bar: write it.
    for state in np.flatnonzero(~np.isfinite(values)):
        texts[state] += f"\n{values[state]:g}"
    if count <= most:
        shown = []
        for over, text in zip(model.over, texts, strict=True):
            shown.append("" if over else text)
        ax.bar_label(bars, shown, padding=2, fontsize=8, rotation=turned)
    ax.axhline(0, color=BLACK, linewidth=0.8)
    ax.margins(x=0.01, y=0.3 if turned and count <= most else 0.12)
    ax.set(xlabel="state", ylabel=label)
    return ax
