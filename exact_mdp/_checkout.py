"""In a checkout, a room answers to its folder's name too: `from mdp import MDP`.

The rooms lie at the top of the repository, so that Python finds them there under their own names.
A second copy of every class would come of that. Instead each room, where it is imported by its
folder's name, is replaced by the one module that it is (`exact_mdp.mdp`), and so is everything
inside it. An installed package has no folder of that name, and nothing of this happens.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module, util
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType
from typing import Any

_PACKAGE = __name__.partition(".")[0]
_ROOMS: set[str] = set()


class _Alias(Loader):
    """Finds and loads `mdp.anything` as what `exact_mdp.mdp.anything` is."""

    @classmethod
    def find_spec(
        cls, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        room, dot, _ = name.partition(".")
        if not dot or room not in _ROOMS:
            return None
        real = util.find_spec(f"{_PACKAGE}.{name}")
        if real is None:
            return None
        return ModuleSpec(
            name, cls(), origin=real.origin, is_package=real.submodule_search_locations is not None
        )

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(f"{_PACKAGE}.{spec.name}")
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        # The module has run already, under its own name: it gets its own specification back.
        spec = module.__spec__
        if spec is not None and spec.loader_state is not None:
            module.__spec__ = spec.loader_state

    def get_code(self, name: str) -> CodeType | None:
        """Return the code that `python -m` runs."""
        spec = util.find_spec(f"{_PACKAGE}.{name}")
        loader: Any = None if spec is None else spec.loader
        return None if spec is None else loader.get_code(spec.name)


def alias(room: str) -> None:
    """Let a room's folder name stand for the room itself, and for all that is in it."""
    if not _ROOMS:
        sys.meta_path.insert(0, _Alias)
    _ROOMS.add(room)
    sys.modules[room] = import_module(f"{_PACKAGE}.{room}")
