"""Exact analysis of finite Markov decision processes: models, solvers, proofs, audits.

The rooms are `exact_mdp.mdp` (what a problem is), `.solvers` (how it is solved), `.analysis` (what
it means) and `.paper_repro`. All public names are here, and each room has its own of them too. They
are listed once, in `__init__.pyi`; a name is loaded when it is first asked for.

>>> from exact_mdp import MDP, check, solve
>>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]], layout="ass")
>>> solve(mdp).value.tolist(), check(mdp, [1, 0]).passed
([3.0, 0.0], True)
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any


def _read_public_names() -> dict[str, tuple[str, str]]:
    """Return the module of each public name, and its name there."""
    source = Path(__file__).with_suffix(".pyi").read_text("utf-8")
    places = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(__name__):
            for alias in node.names:
                places[alias.asname or alias.name] = (node.module or "", alias.name)
    return places


_HOMES = _read_public_names()


class _Link(Loader, MetaPathFinder):
    """Takes `mdp.model`, by the link of a checkout, for `exact_mdp.mdp.model`.

    Read again under a second name, a module has classes of its own, and `isinstance` fails.
    """

    def __init__(self, room: str) -> None:
        self.room = room

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        if not name.startswith(f"{self.room}.") or name.endswith(".__main__"):
            return None
        return ModuleSpec(name, self, is_package=True)

    def exec_module(self, module: ModuleType) -> None:
        sys.modules[module.__name__] = import_module(f"{__name__}.{module.__name__}")


def names_of(room: str) -> tuple[list[str], Callable[[str], Any]]:
    """Return the public names of a room, and the function that loads one: its `__getattr__`."""
    if not f"{room}.".startswith(f"{__name__}."):
        sys.meta_path.insert(0, _Link(room))
        room = f"{__name__}.{room}"
    names = sorted(name for name, (home, _) in _HOMES.items() if f"{home}.".startswith(f"{room}."))

    def load_public_name(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        home, own = _HOMES[name]
        module = import_module(home)
        return vars(module)[own] if own in vars(module) else import_module(f"{home}.{own}")

    return names, load_public_name


__all__, _load = names_of(__name__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("exact-mdp")
    value = globals()[name] = _load(name)
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
