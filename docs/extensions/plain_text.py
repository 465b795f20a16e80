"""Plain text as the modules write it: paragraphs, `code` in single backticks, indented examples.

    ```{text-of} exact_mdp.solvers.exact.codec
    ```

shows what a module says of itself: a file format is described once, beside the code that reads it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ITEM = re.compile(r"^(-|\d+\.) +", re.M)
CODE = re.compile(r"(`[^`]+`|https?://[^\s,;)]+)")


def inline(text: str) -> Iterator[nodes.Node]:
    """Yield the nodes of running text."""
    for part in CODE.split(text):
        if part.startswith("`") and part.endswith("`") and len(part) > 1:
            yield nodes.literal("", part[1:-1])
        elif part.startswith("http"):
            address = part.rstrip(".")
            yield nodes.reference("", address, refuri=address)
            yield nodes.Text(part[len(address) :])
        elif part:
            yield nodes.Text(part)


def blocks(text: str) -> Iterator[nodes.Node]:
    """Yield the nodes of paragraphs; those that are indented are shown as they are written."""
    shown: list[str] = []
    for block in [*re.split(r"\n\s*\n", text.rstrip()), ""]:
        if block.startswith(("  ", ">>>")):
            shown.append(block)
            continue
        if shown:
            code = inspect.cleandoc("\n" + "\n\n".join(shown))
            yield nodes.literal_block(code, code, language="text")
            shown = []
        if ITEM.match(block):
            yield listed(ITEM.split(block)[1:])
        elif block:
            yield paragraph(block)


def paragraph(text: str) -> nodes.paragraph:
    """Return one paragraph."""
    return nodes.paragraph("", "", *inline(" ".join(text.split())))


def listed(items: list[str]) -> nodes.Element:
    """Return a list of a text's items; `items` alternates between marks and texts."""
    found = nodes.bullet_list() if items[0] == "-" else nodes.enumerated_list(enumtype="arabic")
    found += [nodes.list_item("", paragraph(text)) for text in items[1::2]]
    return found


class TextOf(SphinxDirective):
    """Show the text at the top of a module."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return its paragraphs."""
        module = import_module(self.arguments[0])
        self.env.note_dependency(str(module.__file__))
        return list(blocks(inspect.getdoc(module) or ""))


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("text-of", TextOf)
    return {"parallel_read_safe": True}
