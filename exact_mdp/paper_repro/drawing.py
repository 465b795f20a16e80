"""The style of the figures, their saving, and the parts that several of them share.

A figure is a function of a `Reading`; its docstring is the caption. Saved twice, the bytes are the
same. Texts stand in the colours of Okabe and Ito, which greyscale keeps apart; what a colour means
is written in a legend or in the box itself.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.paper_repro.paper import write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from exact_mdp.paper_repro.silent_points import Reading

PERSON, ROBOT = "#F7D4E3", "#F2B872"  # the paper's pink and orange blocks
BLUE, RED, GREEN = "#0072B2", "#D55E00", "#009E73"
FILLS = {  # of the four assistances: fill, hatching
    "none": ("#FFFFFF", "..."),
    "supportive": ("#F0E442", ""),
    "non-directive": ("#56B4E9", "//"),
    "directive": ("#D55E00", ""),
}


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One figure: its name, the figure of the paper that it answers to, its words and code."""

    name: str
    title: str
    caption: str
    place: str  # empty if the paper has no such figure
    draw: Callable[[Reading], Figure]
    code: str


FIGURES: dict[str, Picture] = {}
"""Every figure by its name, in the order of the paper; filled by the sections."""

Draw = Callable[["Reading"], "Figure"]


def register_figure(name: str, place: str = "", *, title: str) -> Callable[[Draw], Draw]:
    """Return a decorator that makes a function a figure, with its docstring as the caption."""

    def keep_figure(draw: Draw) -> Draw:
        FIGURES[name] = Picture(
            name=name,
            title=title,
            caption=" ".join((draw.__doc__ or "").split()),
            place=place,
            draw=draw,
            code=f"{draw.__module__.rpartition('.')[2]}.py, {draw.__name__}",
        )
        return draw

    return keep_figure


def save_figure(picture: Picture, reading: Reading, folder: Path, *, dpi: int = 110) -> list[Path]:
    """Draw a figure into a folder as SVG and PNG, each written whole or not at all."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots.style import style

    paths: list[Path] = []
    with style(), mpl.rc_context({"axes.titlelocation": "left"}):
        drawn = picture.draw(reading)
        drawn.suptitle(picture.title, x=0.01, ha="left", fontsize=11)
        for kind, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            bytes_ = io.BytesIO()
            drawn.savefig(bytes_, format=kind, dpi=dpi, metadata=metadata)
            paths.append(folder / f"{picture.name}.{kind}")
            write_file(paths[-1], bytes_.getvalue())
        plt.close(drawn)
    return paths


def create_axes(width: float, height: float, **grid: Any) -> tuple[Figure, Any]:
    """Return a new figure and its axes."""
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(width, height), **grid)


# ---- boxes and arrows ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Box:
    """A box of a diagram: its middle, words and fill, and whether a language model is in it."""

    x: float
    y: float
    text: str
    fill: str = "white"
    model: bool = False
    width: float = 2.0
    height: float = 0.7


def draw_diagram(
    ax: Axes, boxes: Mapping[str, Box], arrows: Sequence[tuple[str, str, str]]
) -> None:
    """Draw boxes, and arrows (from, to, words) along a row or a column."""
    from matplotlib.patches import FancyBboxPatch

    for box in boxes.values():
        look: dict[str, Any] = {"edgecolor": "black", "linewidth": 0.9}
        if box.model:
            look |= {"linewidth": 1.6, "linestyle": (0, (4, 2))}
        corner = (box.x - box.width / 2, box.y - box.height / 2)
        shape = "round,pad=0,rounding_size=0.08"
        ax.add_patch(
            FancyBboxPatch(corner, box.width, box.height, shape, facecolor=box.fill, **look)
        )
        ax.text(box.x, box.y, box.text, ha="center", va="center", fontsize=8)
    for source, target, text in arrows:
        start, end = boxes[source], boxes[target]
        if start.x != end.x:
            side = np.sign(end.x - start.x) / 2
            a, b = start.x + side * start.width, end.x - side * end.width
            draw_arrow(ax, (a, start.y), (b, end.y))
            ax.text((a + b) / 2, start.y + 0.05, text, fontsize=7.5, ha="center", va="bottom")
        else:
            side = np.sign(end.y - start.y) / 2
            a, b = start.y + side * start.height, end.y - side * end.height
            draw_arrow(ax, (start.x, a), (end.x, b))
            ax.text(start.x + 0.08, (a + b) / 2, text, fontsize=7.5, ha="left", va="center")
    ax.set_axis_off()
    ax.set_aspect("equal")


def draw_arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw an arrow."""
    look = {"arrowstyle": "-|>", "color": "0.35", "lw": 1, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", xy=end, xytext=start, arrowprops=look)


def draw_legend(ax: Axes, **place: Any) -> None:
    """Say what pink, orange and a dashed edge stand for."""
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=PERSON, edgecolor="black", label="person (PLWD)"),
        Patch(facecolor=ROBOT, edgecolor="black", label="robot caregiver"),
        Patch(
            facecolor="white",
            edgecolor="black",
            linestyle=(0, (4, 2)),
            linewidth=1.6,
            label="dashed edge: a language model writes or reads",
        ),
    ]
    ax.legend(handles=handles, **place)


# ---- maps of statuses, curves --------------------------------------------------------------------


def draw_status_map(ax: Axes, actions: Sequence[str], notes: Sequence[str]) -> None:
    """Draw the action in each of 16 statuses, with a note under it.

    Rows: forgetfulness and confusion; columns: anger and disengagement.
    """
    from matplotlib.patches import Rectangle

    for status, (action, note) in enumerate(zip(actions, notes, strict=True)):
        x, y = status & 3, status >> 2
        fill, hatch = FILLS[action]
        ax.add_patch(Rectangle((x, y), 1, 1, facecolor=fill, hatch=hatch, edgecolor="black"))
        text = "\n".join(filter(None, (action, note)))
        back = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.5}
        ax.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=7, bbox=back)
    ax.set(xlim=(0, 4), ylim=(4, 0))
    ax.set_xticks(np.arange(4) + 0.5, ["neither", "disengaged", "angry", "angry,\ndisengaged"])
    ax.set_yticks(np.arange(4) + 0.5, ["neither", "confused", "forgetful", "forgetful,\nconfused"])
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)


def draw_band(ax: Axes, values: np.ndarray, colour: str, width: int = 20) -> None:
    """Draw the range of values in bins as a pale band."""
    cut = values[: len(values) // width * width].reshape(-1, width)
    at = np.arange(len(cut)) * width + width / 2
    ax.fill_between(at, cut.min(axis=1), cut.max(axis=1), color=colour, alpha=0.25, linewidth=0)
