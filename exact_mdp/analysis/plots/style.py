"""One look for every figure: colours, axes, titles, legends, bars, cells.

Every text is shown as it is written: names may hold "$", which matplotlib takes for a formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text

from exact_mdp.mdp.errors import named_options
from exact_mdp.mdp.table import Numbers

Arguments = ParamSpec("Arguments")
Look = dict[str, Any]  # settings of a function of matplotlib

# Okabe and Ito's colours, ordered from light to dark so that greyscale keeps them apart.
PALETTE = ("#FFFFFF", "#F0E442", "#56B4E9", "#D55E00", "#009E73", "#CC79A7", "#0072B2", "#4D4D4D")
HATCHES = ("", "...", "//", "", "xx", "\\\\", "++", "")
LINES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 3)))
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
NARROW = 4.8  # inches
WHITE, BLUE, ORANGE, BLACK = PALETTE[0], PALETTE[2], PALETTE[3], "#000000"
INK = (PALETTE[6], PALETTE[3], PALETTE[4], PALETTE[7], PALETTE[5], "#8C6D1F")

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
    # Letters as wide at every resolution: what the layout gave room to is not cut off.
    "text.hinting": "none",
}


def fill_of(number: int) -> tuple[str, str, str]:
    """Return the fill, the hatching and the ink on it of one of several actions."""
    fill, hatch = PALETTE[number % len(PALETTE)], HATCHES[number % len(HATCHES)]
    dark = sum(int(fill[i : i + 2], 16) for i in (1, 3, 5)) < 330
    return fill, hatch, "white" if dark else "black"


def picture(function: Callable[Arguments, Axes]) -> Callable[Arguments, Axes]:
    """Let a function draw in this style, on its own axes or on given ones; texts are as written.

    The title is broken where the figure ends.

    Examples
    --------
    >>> @picture
    ... def plot(ax=None):
    ...     ax = axes_or_new(ax)
    ...     ax.set_title("from $a to $b")
    ...     return ax
    >>> plot().title.get_parse_math()
    False
    """

    @wraps(function)
    def drawn(*arguments: Arguments.args, **settings: Arguments.kwargs) -> Axes:
        given = settings.get("ax")
        if isinstance(given, Axes):
            _as_written(given)
        own = {"text.parse_math": False, "legend.frameon": False} if given else SETTINGS
        with _context(own):
            ax = named_options(function)(*arguments, **settings)
            title = ax.get_title() or ax.get_title(loc="left")
            ax.set_title("")
            # Where lines are broken, matplotlib measures formulas whatever it was told.
            ax.set_title(title, loc="left", wrap="$" not in title)
        _as_written(ax)
        return ax

    return drawn


def _as_written(drawn: Axes | Figure) -> None:
    for text in drawn.findobj(Text):
        assert isinstance(text, Text)
        text.set_parse_math(False)


@contextmanager
def _context(settings: Any) -> Iterator[None]:
    """Draw with settings; keep what a notebook turns on when it draws first, inside or not."""
    with mpl.rc_context(settings):
        yield
        shows = mpl.is_interactive()
    mpl.interactive(shows)


@contextmanager
def style() -> Iterator[None]:
    """Draw with the project's settings inside a `with` block.

    Examples
    --------
    >>> with style():
    ...     mpl.rcParams["svg.fonttype"]
    'none'
    """
    with _context(SETTINGS):
        yield


def axes_or_new(ax: Axes | None, names: Sequence[str] = (), high: float = 4.2) -> Axes:
    """Return the axes, or those of a new figure in which names, of rows also, have room."""
    if ax is not None:
        return ax
    wide = 7.2 + 0.08 * max(0, max(map(len, names), default=0) - 12)
    high = min(4.8, 1.8 + 0.32 * len(names)) if names else high
    return plt.subplots(figsize=(wide, high), layout="constrained")[1]


def described(
    ax: Axes,
    what: str,
    model: str = "",
    *,
    x: str = "",
    y: str = "",
    handles: Sequence[Any] = (),
    legend: str = "",
) -> Axes:
    """Return the axes with a title (what is shown, and of which model), their names, a legend.

    The legend has the `handles`, or what was drawn with a label, below the title `legend`, to the
    right of the axes, or below them where the figure is narrow.
    """
    ax.set_title(f"{what} \N{EN DASH} {model}" if model else what)
    ax.set(**{key: text for key, text in (("xlabel", x), ("ylabel", y)) if text})
    if drawn := handles or ax.get_legend_handles_labels()[0]:
        columns = 2 if max(len(str(each.get_label())) for each in drawn) < 20 else 1
        under: Look = {"bbox_to_anchor": (0.0, -0.25), "ncols": columns, "fontsize": "small"}
        place: Look = under if narrow(ax) else {"bbox_to_anchor": (1.02, 1.0)}
        ax.legend(handles=handles or None, title=legend, loc="upper left", **place)
    return ax


def narrow(ax: Axes) -> bool:
    """Whether there is no room beside the axes."""
    figure = ax.get_figure(root=True)
    return figure is not None and float(figure.get_size_inches()[0]) < NARROW


def swatch(label: str, look: tuple[str, str]) -> Patch:
    """Return a legend's handle for a fill and a hatching."""
    return Patch(facecolor=look[0], edgecolor="black", hatch=look[1], label=label)


def bars_across(
    ax: Axes,
    places: float | Numbers,
    lengths: float | Numbers,
    look: tuple[str, str],
    label: str,
    **more: Any,
) -> None:
    """Draw horizontal bars, of a fill and a hatching."""
    ticks: Look = {"ecolor": BLACK, "elinewidth": 1, "capsize": 2}
    fill, hatch = look
    form: Look = {"color": fill, "hatch": hatch, "edgecolor": BLACK} | more
    ax.barh(places, lengths, label=label, error_kw=ticks, **form)


def name_rows(ax: Axes, names: Sequence[str]) -> None:
    """Name the rows 0, 1, …, the first on top."""
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()


def line(number: int) -> Look:
    """Return colour and dashes of one of several lines."""
    return {"color": INK[number % len(INK)], "linestyle": LINES[number % len(LINES)]}


def level(ax: Axes, value: float, label: str = "optimum") -> None:
    """Draw a dotted line across at a value."""
    ax.axhline(value, color="black", linestyle=":", linewidth=1, label=label)


def cell(
    ax: Axes,
    column: float,
    row: float,
    text: str,
    *,
    fill: object = WHITE,
    ink: str = "black",
    hatch: str = "",
    font: float = 8,
    **frame: Any,
) -> None:
    """Draw a cell of a map, with a text; none at font 0."""
    frame = {"edgecolor": "black"} | frame
    ax.add_patch(Rectangle((column, row), 1, 1, facecolor=fill, hatch=hatch, **frame))
    if font:
        box = {"facecolor": fill if hatch else "none", "edgecolor": "none", "pad": 1.2}
        centre: Look = {"ha": "center", "va": "center", "fontsize": font, "bbox": box}
        ax.text(column + 0.5, row + 0.5, text, color=ink, **centre)
