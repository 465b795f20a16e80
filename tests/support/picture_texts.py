"""What is written in a picture: in the cells of a map, at ticks, in a legend."""

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.text import Text


def texts(ax: Axes) -> dict[tuple[int, int], str]:
    each = ((text.get_position(), text.get_text()) for text in ax.texts)
    return {(int(y), int(x)): text for (x, y), text in each}


def texts_of(parts: Iterable[Text]) -> list[str]:
    """Return the texts of tick labels, of what stands in the axes, or of a legend's entries."""
    return [part.get_text() for part in parts]


def legend_of(ax: Axes) -> list[str]:
    """Return what the legend says."""
    legend = ax.get_legend()
    assert legend is not None
    return texts_of(legend.get_texts())
