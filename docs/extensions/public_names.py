"""The reference of a package: every name in its `__all__`, from its docstring.

    ```{names} exact_mdp.solvers
    ```

A name is described where it lives first, in the order of `ROOMS`; elsewhere a line leads there.
Docstrings are plain text with `code` in single backticks: *, | and a last _ mean themselves.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

# The packages whose names are public; the first is a choice of names from the others.
ROOMS = (
    "exact_mdp.mdp",
    "exact_mdp.solvers",
    "exact_mdp.analysis",
    "exact_mdp.analysis.vary",
    "exact_mdp.analysis.plots",
    "exact_mdp",
)


def homes() -> dict[str, dict[str, str]]:
    """Return, of every room, its public names and the room that describes each."""
    first: dict[int, str] = {}
    found: dict[str, dict[str, str]] = {}
    for room in ROOMS:
        module = import_module(room)
        found[room] = {
            name: first.setdefault(id(getattr(module, name)), room)
            for name in sorted(module.__all__, key=str.lower)
        }
    return found


def directive(room: str, name: str) -> list[str]:
    """Return the lines that describe a name of a room."""
    thing: Any = getattr(import_module(room), name)
    if inspect.isclass(thing):
        kind = "autoexception" if issubclass(thing, BaseException) else "autoclass"
        return [f".. {kind}:: {room}.{name}", "   :members:", ""]
    if inspect.isroutine(thing):
        return [f".. autofunction:: {room}.{name}", ""]
    told = ", ".join(f"``{key}``" for key in thing) if isinstance(thing, Mapping) else ""
    return [f".. py:data:: {room}.{name}", "", f"   {told}", ""]


class Names(SphinxDirective):
    """Describe the public names of a package."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return one section for each name."""
        room = self.arguments[0]
        lines: list[str] = []
        for name, home in homes()[room].items():
            if home == room:
                lines += directive(room, name)
            else:
                lines += [f"- :py:obj:`~{home}.{name}`, of `{home}`", ""]
        node = nodes.container()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, room), 0, node)
        return node.children


CODE = re.compile(r"(``.*?``|`[^`\n]*(?:\n[^`\n]*)?`)", re.S)


def plain(_app: Sphinx, what: str, name: str, *rest: Any) -> None:
    """Let marks of reStructuredText outside code and examples mean themselves."""
    lines, example = rest[-1], False
    for number, line in enumerate(lines):
        example = (example or ">>>" in line) and bool(line.strip())
        if example or line.lstrip().startswith(("..", ":")):
            continue
        parts = CODE.split(line)
        parts[::2] = [re.sub(r"([*|\\]|(?<=\w)_(?!\w))", r"\\\1", part) for part in parts[::2]]
        lines[number] = "".join(parts)
    if what in ("attribute", "data", "property"):
        WHOLE[name] = list(lines)


# Napoleon takes what stands before a colon in the text of a property for its type.
WHOLE: dict[str, list[str]] = {}


def whole(_app: Sphinx, _what: str, name: str, *rest: Any) -> None:
    """Keep the text of a property as it is."""
    rest[-1][:] = WHOLE.pop(name, rest[-1])


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("names", Names)
    app.connect("autodoc-process-docstring", plain, priority=100)  # before Napoleon's 500
    app.connect("autodoc-process-docstring", whole, priority=900)
    return {"parallel_read_safe": True}
