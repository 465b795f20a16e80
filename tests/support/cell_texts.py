"""What is written in the cells of a map."""

from matplotlib.axes import Axes


def texts(ax: Axes) -> dict[tuple[int, int], str]:
    each = ((text.get_position(), text.get_text()) for text in ax.texts)
    return {(int(y), int(x)): text for (x, y), text in each}
