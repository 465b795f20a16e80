"""The run record: the origin of a saved result, in a `.run.json` beside it."""

from __future__ import annotations

import platform
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP

PACKAGES = ("exact-mdp", "numpy", "scipy", "python-flint", "cvxpy", "clarabel", "highspy", "numba")
COMMIT = ("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")


def run_record(
    mdp: object, *, model: str, solver: str, seed: int | None = None, command: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the origin of a result: model hash, solver, seed, versions and commit.

    `model` is the model as the user named it, `solver` the solver with its settings, `command` the
    words of the command line.
    """
    root, commit = Path(__file__).resolve().parents[2], None
    if (root / ".git").exists():  # the commit of a checkout, marked if files were changed
        with suppress(OSError, subprocess.TimeoutExpired):
            words = ["git", "-C", str(root), *COMMIT]
            done = subprocess.run(words, capture_output=True, text=True, timeout=10)
            commit = done.stdout.strip() or None
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return {
        "command": list(command),
        "model": model,
        "model_hash": fingerprint(mdp) if isinstance(mdp, MDP) else None,
        "solver": solver,
        "seed": seed,
        "versions": versions,
        "platform": f"{sys.platform} {platform.machine()}",
        "commit": commit,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }
