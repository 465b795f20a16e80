"""The gallery: every script of docs/gallery, with the figure that it draws.

    ```{gallery} values
    ```

shows the scripts of the folder `values` in the order of their names. The first line of a script's
docstring is its title, the rest says what is to be seen. A script draws one figure and needs no
more than a few seconds; `draw` runs it and saves the figure.
"""

from __future__ import annotations

import ast
import os
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from docutils import nodes
from plain_text import blocks
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def parts(script: Path) -> tuple[str, str, str]:
    """Return a script's title, what it says of its figure, and its lines."""
    source = script.read_text("utf-8")
    title, _, about = (ast.get_docstring(ast.parse(source)) or "").partition("\n")
    return title.rstrip("."), about.strip(), source[source.index('"""', 3) + 3 :].strip()


def draw(script: Path, target: Path) -> None:
    """Run a script and save its figure."""
    plt.close("all")
    with mpl.rc_context({"svg.hashsalt": "exact-mdp"}):
        exec(compile(script.read_text("utf-8"), str(script), "exec"), {})
        (number,) = plt.get_fignums()
        figure = plt.figure(number)
        figure.savefig(target, bbox_inches="tight", metadata={"Date": None})
    plt.close("all")


class Gallery(SphinxDirective):
    """Draw the scripts of one group."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return a section for each script: its text, its figure, its lines."""
        page = Path(self.env.doc2path(self.env.docname)).parent
        group = page / self.arguments[0]
        drawn = Path(self.env.app.doctreedir).parent / "gallery" / group.name
        drawn.mkdir(parents=True, exist_ok=True)
        found: list[nodes.Node] = []
        for script in sorted(group.glob("*.py")):
            self.env.note_dependency(str(script))
            title, about, code = parts(script)
            figure = drawn / f"{script.stem}.svg"
            draw(script, figure)
            section = nodes.section(names=[title], ids=[script.stem.replace("_", "-")])
            section += nodes.title("", title)
            section += blocks(about)
            section += nodes.image(uri=os.path.relpath(figure, page), alt=f"{title}. {about}")
            section += nodes.literal_block(code, code, language="python")
            found.append(section)
        if not found:
            raise self.error(f"no script in the group {group.name}")
        return found


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("gallery", Gallery)
    return {"parallel_read_safe": False}
