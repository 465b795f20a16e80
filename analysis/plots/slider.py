"""A slider over pictures drawn beforehand: interactive wherever a page is viewed, without a server.

Each value's figure is drawn once and put into the page; moving the slider shows another.
Nothing is loaded from elsewhere.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Sequence
from itertools import count

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

_NUMBERS = count()


class Slider:
    """HTML for a page or a notebook; see `slider`."""

    def __init__(self, text: str, values: Sequence[str]) -> None:
        self.text, self.values = text, tuple(values)

    def _repr_html_(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Slider({len(self.values)} pictures, {self.values[0]} to {self.values[-1]})"


def slider(
    draw: Callable[[int, Axes], None],
    values: Sequence[str],
    *,
    name: str,
    first: int = 0,
    size: tuple[float, float] = (6.0, 4.2),
    dpi: int = 90,
) -> Slider:
    """Return a slider that shows one picture for each value.

    Parameters
    ----------
    draw : function of a value's number and an Axes
    values : what is written beside the slider for each picture, at least one
    name : what is varied
    first : number of the picture shown first
    size : width and height of a picture in inches, of `dpi` points each

    Raises
    ------
    ValueError
        Without values, or where `first` is none of them.

    Examples
    --------
    >>> slider(lambda k, ax: ax.plot([0, k]), ["0", "1"], name="slope")
    Slider(2 pictures, 0 to 1)
    """
    if not 0 <= first < len(values):
        raise ValueError(f"picture {first} of {len(values)}: give at least one value")
    pictures = []
    for number in range(len(values)):
        figure, ax = plt.subplots(figsize=size)
        draw(number, ax)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=dpi)
        plt.close(figure)
        pictures.append(base64.b64encode(buffer.getvalue()).decode())
    mark = f"exact-mdp-slider-{next(_NUMBERS)}"
    images = "".join(
        f'<img alt="{html.escape(f"{name} = {value}")}" style="max-width:100%;'
        f'{"" if number == first else "display:none"}" src="data:image/png;base64,{picture}">'
        for number, (value, picture) in enumerate(zip(values, pictures, strict=True))
    )
    labels = "".join(f"<span hidden>{html.escape(value)}</span>" for value in values)
    move = (
        "const box=this.closest('div');"
        "box.querySelectorAll('img').forEach((it,k)=>it.style.display=k==this.value?'':'none');"
        "box.querySelector('output').textContent="
        "box.querySelectorAll('span')[this.value].textContent"
    )
    text = (
        f'<div><label for="{mark}">{html.escape(name)} = </label>'
        f"<output>{html.escape(values[first])}</output><br>"
        f'<input id="{mark}" type="range" min="0" max="{len(values) - 1}" value="{first}" '
        f'style="width:min(28em,100%)" oninput="{move}"><br>{labels}{images}</div>'
    )
    return Slider(text, values)
