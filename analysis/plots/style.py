"""One look for every figure, and saving it as vector and raster without half-written files."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import ParamSpec

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from exact_mdp.mdp.io.files import write_atomically

Arguments = ParamSpec("Arguments")

# Okabe and Ito's colours, ordered from light to dark so that greyscale keeps them apart.
PALETTE = ("#FFFFFF", "#F0E442", "#56B4E9", "#D55E00", "#009E73", "#CC79A7", "#0072B2", "#4D4D4D")
HATCHES = ("", "...", "//", "", "xx", "\\\\", "++", "")
LINES = ("-", "--", ":", "-.")

SETTINGS = {
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "hatch.linewidth": 0.4,
    "svg.fonttype": "none",
    "svg.hashsalt": "exact-mdp",
    "figure.constrained_layout.use": True,
    "text.parse_math": False,
}


@dataclass(frozen=True, kw_only=True)
class ActionStyle:
    """How one action is drawn: fill, hatching, the letters on it and their colour."""

    name: str
    short: str
    fill: str
    hatch: str
    ink: str


def action_styles(actions: Sequence[str]) -> list[ActionStyle]:
    """Return one style for each action.

    Examples
    --------
    >>> [style.short for style in action_styles(["none", "supportive"])]
    ['a0', 'a1']
    """
    styles = []
    for number, name in enumerate(actions):
        fill = PALETTE[number % len(PALETTE)]
        dark = sum(int(fill[i : i + 2], 16) for i in (1, 3, 5)) < 330
        styles.append(
            ActionStyle(
                name=name,
                short=f"a{number}",
                fill=fill,
                hatch=HATCHES[number % len(HATCHES)],
                ink="white" if dark else "black",
            )
        )
    return styles


def plain_text(function: Callable[Arguments, Axes]) -> Callable[Arguments, Axes]:
    """Let a function that draws on axes show every text as it is: names hold "$", not formulas.

    Parameters
    ----------
    function : function that returns the axes it drew on

    Returns
    -------
    function

    Examples
    --------
    >>> @plain_text
    ... def plot(ax=None):
    ...     ax = axes_or_new(ax)
    ...     ax.set_title("from $a to $b")
    ...     return ax
    >>> plot().title.get_parse_math()
    False
    """

    @wraps(function)
    def plain(*arguments: Arguments.args, **settings: Arguments.kwargs) -> Axes:
        given = settings.get("ax")
        if isinstance(given, Axes):
            _as_written(given)
        with mpl.rc_context({"text.parse_math": False}):
            ax = function(*arguments, **settings)
        _as_written(ax)
        return ax

    return plain


def _as_written(drawn: Axes | Figure) -> None:
    """Show every text of a drawing as it is written; matplotlib takes $…$ for a formula."""
    for text in drawn.findobj(Text):
        text.set_parse_math(False)


@contextmanager
def style() -> Iterator[None]:
    """Draw with the project's settings inside a `with` block."""
    with mpl.rc_context(SETTINGS):
        yield


def axes_or_new(ax: Axes | None) -> Axes:
    """Return the axes, or those of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    _, fresh = plt.subplots()
    return fresh


def titled(ax: Axes, text: str) -> Text:
    """Set and return a title that is broken where it would be wider than its axes.

    Breaks in the text are kept. Set the figure's size, and what its layout depends on, before.
    """
    title = ax.set_title("")
    ax.figure.draw_without_rendering()
    room = ax.get_window_extent().width

    def fits(words: Sequence[str]) -> bool:
        title.set_text(" ".join(words))
        return bool(title.get_window_extent().width <= room)

    lines: list[list[str]] = []
    for paragraph in text.split("\n"):
        lines.append([])
        for word in paragraph.split():
            if lines[-1] and not fits([*lines[-1], word]):
                lines.append([])
            lines[-1].append(word)
    title.set_text("\n".join(" ".join(line) for line in lines))
    return title


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as SVG and PNG, each whole or not at all; return the paths."""
    _as_written(figure)
    paths = []
    for kind, metadata in (("svg", {"Date": None}), ("png", {})):
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, metadata=metadata)
        path = folder / f"{name}.{kind}"
        write_atomically(path, buffer.getvalue())
        paths.append(path)
    return paths
