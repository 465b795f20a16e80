"""Finished parts of a reproduction, kept so that an interrupted run goes on where it stopped.

A part is stored under OUT/work, in a folder named after the source code that made it: a change of
any module of the four packages starts afresh, nothing stale is ever read, and the main job deletes
what other versions left. Within it, names
carry the model's fingerprint and whatever else the part depends on. Each file is written whole or
not at all.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import read_text, write_atomically
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.solvers.parallel.sources import source_digest

NAMED = re.compile(r"code-[0-9a-f]{12}")


@dataclass(frozen=True, kw_only=True)
class Store:
    """A folder for finished parts; none where `root` is None.

    Examples
    --------
    >>> Store().json("sum", lambda: 1 + 1)
    2
    """

    root: Path | None = None

    @classmethod
    def under(cls, out: Path) -> Store:
        """Return the store of an output folder, made where it is missing."""
        root = out / "work" / f"code-{source_digest()[:12]}"
        try:
            root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ModelError(
                f"cannot make the folder: {error.strerror}", where=str(out), fix="name another"
            ) from error
        return cls(root=root)

    def clear_others(self) -> None:
        """Delete what other versions of the source code left beside this store."""
        if self.root is None:
            return
        for folder in self.root.parent.iterdir():
            other = folder != self.root and NAMED.fullmatch(folder.name) is not None
            if other and folder.is_dir() and not folder.is_symlink():
                rmtree(folder, ignore_errors=True)

    @property
    def used(self) -> bool:
        """Whether something is stored already."""
        return self.root is not None and any(self.root.iterdir())

    def folder(self, name: str) -> Path | None:
        """Return where a part that keeps its own files may keep them; None without a store."""
        return None if self.root is None else self.root / name

    def json(self, name: str, compute: Callable[[], Any]) -> Any:
        """Return a part, read where it is stored, else computed and stored."""
        if self.root is None:
            return compute()
        path = self.root / f"{name}.json"
        if path.exists():
            try:
                return json_of(read_text(path), str(path))
            except ModelError as error:
                raise ModelError(
                    "the file is damaged", where=str(path), fix="delete it, and run again"
                ) from error
        found = compute()
        write_atomically(path, json.dumps(found) + "\n")
        return found
