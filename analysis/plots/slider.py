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

from exact_mdp.mdp.errors import ModelError

_NUMBERS = count()
_MOVE = (
    "const box=this.closest('div');"
    "box.querySelectorAll('img').forEach((it,k)=>it.style.display=k==this.value?'':'none');"
    "box.querySelector('output').textContent="
    "box.querySelectorAll('span')[this.value].textContent"
)


class Slider:
    """A slider that shows one picture for each value, in a page or a notebook.

    Parameters
    ----------
    draw : callable
        Draws the picture of a value's number on an Axes.
    values : sequence of str
        What is written beside the slider for each picture, at least one.
    name : str
        What is varied.
    first : int
        Number of the picture shown first.
    size : (float, float)
        Width and height of a picture in inches.

    Raises
    ------
    ModelError
        Without values, and where there is no such first picture.

    Examples
    --------
    >>> Slider(lambda k, ax: ax.plot([0, k]), ["0", "1"], name="slope")
    Slider(2 pictures, 0 to 1)
    """

    def __init__(
        self,
        draw: Callable[[int, Axes], object],
        values: Sequence[str],
        *,
        name: str,
        first: int = 0,
        size: tuple[float, float] = (6.0, 4.2),
    ) -> None:
        if not 0 <= first < len(values):
            what = f"picture {first} of {len(values)}"
            raise ModelError(what, where="slider", fix="give at least one value")
        self.values, self.name, self.first = tuple(values), name, first
        self.pictures = []
        for number in range(len(values)):
            figure, ax = plt.subplots(figsize=size)
            draw(number, ax)
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=90)
            plt.close(figure)
            self.pictures.append(base64.b64encode(buffer.getvalue()).decode())

    def __repr__(self) -> str:
        return f"Slider({len(self.values)} pictures, {self.values[0]} to {self.values[-1]})"

    def _repr_html_(self) -> str:
        mark, name = f"exact-mdp-slider-{next(_NUMBERS)}", html.escape(self.name)
        values = [html.escape(value) for value in self.values]
        images = "".join(
            f'<img alt="{name} = {value}" src="data:image/png;base64,{picture}" '
            f'style="max-width:100%;{"" if number == self.first else "display:none"}">'
            for number, (value, picture) in enumerate(zip(values, self.pictures, strict=True))
        )
        labels = "".join(f"<span hidden>{value}</span>" for value in values)
        return (
            f'<div><label for="{mark}">{name} = </label><output>{values[self.first]}</output><br>'
            f'<input id="{mark}" type="range" min="0" max="{len(values) - 1}" '
            f'value="{self.first}" '
            f'style="width:min(28em,100%)" oninput="{_MOVE}"><br>{labels}{images}</div>'
        )
