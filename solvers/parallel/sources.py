"""The code at work in this process: a digest of its sources, and the versions it stands on.

Two processes that are given the same piece give the same bytes where these are equal. So they
travel with work that is done elsewhere, and whoever has others refuses it (`solvers.parallel.many`,
`solvers.parallel.cluster`). A process has the code that it imported, not what its files hold by
now: files that changed since are refused too, until the process is started again.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from exact_mdp.mdp.errors import ModelError

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("mdp", "solvers", "analysis", "paper_repro")
NUMBERS = ("numpy", "scipy", "numba")  # a result depends on them,
TRAVEL = ("dask", "distributed")  # and whether it arrives on these
LOOK_AGAIN = 1.0  # seconds after which a process looks at its files again
SHORT = 16  # characters of a digest that are shown and sent

Stamp = tuple[int, int, int]


def source_digest() -> str:
    """Return a SHA-256 digest of the names and contents of all `*.py` and `*.toml` files here."""
    digest = sha256()
    for path in map(Path, sorted(_stamps())):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()


def here() -> dict[str, str]:
    """Return what a result of this process depends on besides the work itself.

    These are Python's version as far as the minor one, those of the packages, and `sources`, the
    beginning of the digest. ModelError names a file that changed since it began to be imported.
    """
    found = {"Python": ".".join(platform.python_version_tuple()[:2])}
    for name in (*NUMBERS, *TRAVEL, "exact-mdp"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # Dask is optional; a folder on the path has no version
            continue
    digest = source_digest()
    _unchanged()
    return found | {"sources": digest[:SHORT]}


def difference(mine: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    """Return in words where two results of `here` differ; "" where they do not.

    The version of exact-mdp is compared where both have one: the sources tell in any case.
    """
    names = [name for name in {**mine, **theirs} if mine.get(name) != theirs.get(name)]
    told = [
        f"{name} {theirs.get(name, 'missing')} there, {mine.get(name, 'missing')} here"
        for name in names
        if name != "exact-mdp" or (name in mine and name in theirs)
    ]
    return "; ".join(told)


def require(wanted: Mapping[str, str], where: str) -> None:
    """Refuse work of a process for which `here` was `wanted`; `where` is this one in words."""
    told = difference(wanted, _remembered())
    if told:
        raise unlike(told, where)


def unlike(told: str, where: str) -> ModelError:
    """Return the error for a worker with other code or other versions."""
    return ModelError(
        f"a worker runs other code than this process: {told}",
        where=where,
        fix="install the same versions there, and start it again; finished pieces are kept",
    )


def _stamps() -> dict[str, Stamp]:
    """Return for each file what changes when it is written; within milliseconds."""
    found: dict[str, Stamp] = {}
    waiting = [str(ROOT / package) for package in PACKAGES if (ROOT / package).is_dir()]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.name.endswith((".py", ".toml")):
                    status = entry.stat()
                    found[entry.path] = (status.st_mtime_ns, status.st_size, status.st_ino)
                elif entry.name != "__pycache__" and entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
    return found


def _unchanged() -> None:
    now = _stamps()
    changed = [path for path in {**_BEGUN, **now} if _BEGUN.get(path) != now.get(path)]
    if changed:
        more = f" and {len(changed) - 1} more files" if len(changed) > 1 else ""
        raise ModelError(
            f"the source changed since this process began{more}",
            where=os.path.relpath(changed[0], ROOT),
            fix="start it again: it has the old code in memory, and new workers have the new one",
        )


def _remembered() -> dict[str, str]:
    """Return `here`, found once in this process; its files are looked at once a second."""
    if not _memory:
        _memory.append((here(), time.monotonic()))
    found, looked = _memory[0]
    if time.monotonic() - looked > LOOK_AGAIN:
        _unchanged()
        _memory[0] = (found, time.monotonic())
    return found


_BEGUN = _stamps()
_memory: list[tuple[dict[str, str], float]] = []
