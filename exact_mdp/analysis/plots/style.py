"""One look for every figure: colours, axes, titles, legends, bars, lines, maps.

Every text is shown as it is written: names may hold "$", which matplotlib would read as a formula.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import AutoLocator
from matplotlib.transforms import ScaledTranslation, blended_transform_factory

from exact_mdp.mdp.errors import named_options

Arguments = ParamSpec("Arguments")
Look = dict[str, Any]  # settings of a function of matplotlib

# Okabe and Ito's colours, ordered from light to dark so that greyscale keeps them apart.
PALETTE = ("#FFFFFF", "#F0E442", "#56B4E9", "#D55E00", "#009E73", "#CC79A7", "#0072B2", "#4D4D4D")
HATCHES = ("", "...", "//", "", "xx", "\\\\", "++", "")
LINES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3)))
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
WHITE, BLUE, ORANGE, BLACK = PALETTE[0], PALETTE[2], PALETTE[3], "#000000"
INK = (PALETTE[6], PALETTE[3], PALETTE[4], PALETTE[7], PALETTE[5], "#8C6D1F")
COLUMN_SIZE = 7  # points, in a figure as wide as a column of a journal
LETTER = 0.58 * COLUMN_SIZE / 72  # inches that a letter of that size is wide on average
LOW: Look = {"color": WHITE, "hatch": ""}  # the looks of two kinds of bars
HIGH: Look = {"color": BLUE, "hatch": "//"}

SETTINGS: dict[Any, Any] = {
    "figure.dpi": 144,
    "savefig.dpi": 200,
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "figure.titlesize": 10,
    "hatch.linewidth": 0.4,
    "svg.fonttype": "none",
    "svg.hashsalt": "exact-mdp",
    "figure.constrained_layout.use": True,
    "legend.frameon": False,
    "text.parse_math": False,
    # Letters are as wide at every resolution, so texts fit into the room that they were given.
    "text.hinting": "none",
}


def fill_of(number: int) -> Look:
    """Return the fill, the hatching and the ink on it of one of several actions."""
    fill, hatch = PALETTE[number % len(PALETTE)], HATCHES[number % len(HATCHES)]
    dark = sum(int(fill[i : i + 2], 16) for i in (1, 3, 5)) < 330
    return {"fill": fill, "hatch": hatch, "ink": "white" if dark else BLACK}


def apply_style(function: Callable[Arguments, Axes]) -> Callable[Arguments, Axes]:
    """Let a function draw in this style, on its own axes or on given ones.

    Texts are as written, and the title is broken where the figure ends.
    """

    @wraps(function)
    def draw_picture(*arguments: Arguments.args, **settings: Arguments.kwargs) -> Axes:
        given = settings.get("ax")
        own = SETTINGS
        if given:
            own = {"text.parse_math": False, "legend.frameon": False}
        with _use_settings(own):
            ax = named_options(function)(*arguments, **settings)
        for text in ax.findobj(Text):  # also texts that given axes already have
            assert isinstance(text, Text)
            text.set_parse_math(False)
        if is_narrow(ax):
            _fit_column(ax)
        return ax

    return draw_picture


@contextmanager
def _use_settings(settings: Any) -> Iterator[None]:
    """Draw with settings; the interactive mode that a notebook turns on meanwhile stays on."""
    with mpl.rc_context(settings):
        yield
        shows = mpl.is_interactive()
    mpl.interactive(shows)


@contextmanager
def style() -> Iterator[None]:
    """Draw with the project's settings inside a `with` block.

    >>> with style():
    ...     mpl.rcParams["svg.fonttype"]
    'none'
    """
    with _use_settings(SETTINGS):
        yield


def axes_or_new(ax: Axes | None, names: Sequence[str] = (), high: float = 4.2) -> Axes:
    """Return the axes, or new ones in a figure with room for the names of its rows."""
    if ax is not None:
        return ax
    wide = 7.2 + 0.08 * max(0, max(map(len, names), default=0) - 12)
    if names:
        high = min(4.8, 1.8 + 0.32 * len(names))
    return plt.subplots(figsize=(wide, high), layout="constrained")[1]


def label_axes(
    ax: Axes,
    what: str,
    model: str = "",
    *,
    x: str = "",
    y: str = "",
    handles: Sequence[Any] = (),
    legend: str = "",
) -> Axes:
    """Return the axes with a title (the quantity and the model), names, and a legend apart.

    The legend has the `handles`, or everything with a label, below its own title.
    """
    title = what
    if model:
        title = f"{what} \N{EN DASH} {model}"
    ax.set_title("")
    # To break lines, matplotlib measures texts as formulas even if they are not.
    ax.set_title(title, loc="left", wrap="$" not in title)
    ax.set(**{key: text for key, text in (("xlabel", x), ("ylabel", y)) if text})
    if drawn := handles or ax.get_legend_handles_labels()[0]:
        columns = 1
        if max(len(str(each.get_label())) for each in drawn) < 20:
            columns = 2
        under: Look = {"bbox_to_anchor": (0.0, -0.25), "ncols": columns, "fontsize": "small"}
        place: Look
        if is_narrow(ax):
            place = under
        else:
            place = {"bbox_to_anchor": (1.02, 1.0)}
        ax.legend(handles=handles or None, title=legend, loc="upper left", **place)
    return ax


def is_narrow(ax: Axes) -> bool:
    """Whether the axes and the names of their rows leave no room beside them, of 4.8 inches."""
    figure = ax.get_figure(root=True)
    return figure is not None and float(figure.get_size_inches()[0]) - measure_names(ax) < 4.8


def measure_names(ax: Axes) -> float:
    """Return how many inches the names of the rows take, about."""
    return 0.08 * max((len(text.get_text()) for text in ax.get_yticklabels()), default=0)


def _fit_column(ax: Axes) -> None:
    """Break long texts and shrink letters, so that a figure as wide as a column shows them all."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    wide, high = figure.get_size_inches() / LETTER
    names = [text.get_text() for text in ax.get_yticklabels()]
    longest = max(map(len, names), default=0)
    two_lines = 2.4 * COLUMN_SIZE / 72 * len(names) < 0.7 * high * LETTER
    if two_lines and longest > 0.25 * wide:
        names = [_break_lines(name, 0.3 * wide) for name in names]
        ax.set_yticks(ax.get_yticks(), names)
        longest = max(len(line) for name in names for line in name.split("\n"))
    right = max(wide - longest - 8, 0.45 * wide)  # letters beside the names of the rows
    for other in figure.axes:
        other.tick_params(labelsize=COLUMN_SIZE)
        if isinstance(steps := other.xaxis.get_major_locator(), AutoLocator):
            steps.set_params(nbins=max(1, min(4, int(right // 9))))
        for label, room in ((other.xaxis.label, right), (other.yaxis.label, 0.6 * high)):
            label.set(text=_break_lines(label.get_text(), room), fontsize=COLUMN_SIZE)
    title = _break_lines(ax.get_title(loc="left"), 0.9 * right)
    ax.set_title(title, loc="left", fontsize=COLUMN_SIZE + 1, wrap=False)
    under = 2 + 1.4 * len(ax.get_xlabel().split("\n")) * bool(ax.get_xlabel())  # lines
    if legend := ax.get_legend():
        # Below the axis, its numbers and its name, from the left end of the figure.
        below = ScaledTranslation(0, -under * COLUMN_SIZE / 72, figure.dpi_scale_trans)
        corner = blended_transform_factory(figure.transFigure, ax.transAxes) + below
        legend.set_bbox_to_anchor((0.0, 0.0), transform=corner)
        for text in legend.get_texts():
            text.set(text=_break_lines(text.get_text(), 0.8 * wide), fontsize=COLUMN_SIZE)
        legend.get_title().set_fontsize(COLUMN_SIZE)
        under += 1.5 * len(legend.get_texts())
    if len(names) > 1:
        lines = under + 1.6 * len(title.split("\n"))
        fits = (high * LETTER * 72 - COLUMN_SIZE * lines) / len(names) / 1.3
        shorter = 0.45 * wide / max(longest, 1) * COLUMN_SIZE
        ax.tick_params("y", labelsize=max(3.5, min(COLUMN_SIZE, fits, shorter)))


def _break_lines(text: str, room: float) -> str:
    """Return a text in lines of at most `room` letters, broken at spaces and after dots."""
    lines = [""]
    for part in re.findall(r"\[[^]]*\] ?|[^ .[]+[ .]*|[ .[]+", " ".join(text.split())):
        if lines[-1] and len(lines[-1] + part.rstrip()) > room:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip() for line in lines)


def make_swatch(label: str, look: Look) -> Patch:
    """Return a legend's handle for a colour and a hatching."""
    fill = look.get("fill", look.get("color"))
    return Patch(edgecolor=BLACK, label=label, facecolor=fill, hatch=look["hatch"])


def add_bar(ax: Axes, row: float, length: float, look: Look, **more: Any) -> None:
    """Draw one bar across."""
    ticks: Look = {"ecolor": BLACK, "elinewidth": 1, "capsize": 2}
    ax.barh(row, length, edgecolor=BLACK, error_kw=ticks, **look, **more)


def add_bars(
    ax: Axes | None,
    names: Sequence[str],
    drawn: Iterable[tuple[float, float, Look]],
    middle: float = 0.0,
) -> Axes:
    """Draw rows with a name each, and bars across from a line: row, length, look."""
    ax = axes_or_new(ax, names)
    for row, length, look in drawn:
        add_bar(ax, row, length, look, left=middle)
    name_rows(ax, names)
    ax.axvline(middle, color=BLACK, linewidth=0.8)
    return ax


def name_rows(ax: Axes, names: Sequence[str]) -> None:
    """Name the rows 0, 1, …, the first on top."""
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()


def choose_line_style(number: int, inks: Sequence[str] = INK) -> Look:
    """Return a colour and dashes for one of several lines; no two lines have both in common."""
    turn, place = divmod(number, len(inks))
    return {"color": inks[place], "linestyle": LINES[(place + turn) % len(LINES)]}


def add_lines(
    ax: Axes,
    curves: Mapping[str, tuple[Any, Any]],
    bands: Mapping[str, tuple[Any, Any, Any]] | None = None,
    *,
    words: str = "",
    inks: Sequence[str] = INK,
    **form: Any,
) -> None:
    """Draw curves (x, y) by label, with bands (x, low, high); `words` name a single band."""
    for number, (label, curve) in enumerate(curves.items()):
        look = choose_line_style(number, inks)
        if bands:
            if len(bands) == 1:
                name = words
            else:
                name = None
            ax.fill_between(*bands[label], color=look["color"], alpha=0.22, linewidth=0, label=name)
        ax.plot(*curve, label=label, **look, **form)


def add_horizontal_line(ax: Axes, value: float, label: str = "optimum") -> None:
    """Draw a dotted line across at a value."""
    ax.axhline(value, color="black", linestyle=":", linewidth=1, label=label)
