"""Draws in blocks, each a piece of work: in threads or processes, resumed from a folder.

Blocks have a fixed size, and a stream of random numbers each, so that the same draws give the same
bytes however many workers there are, and a larger sample begins with the blocks of a smaller one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.vary.solver import DrawSolver
from exact_mdp.solvers.parallel import Arrays, many


class How(TypedDict, total=False):
    """Where the work is done, as `solvers.parallel.many` takes it; results do not change.

    The workers of a care scenario are threads, those of other models processes.
    """

    n_jobs: int | None
    folder: str | Path | None
    progress: bool


def run(
    solver: DrawSolver,
    what: str,
    work: Callable[[Any], Arrays],
    pieces: Sequence[Any],
    key: Mapping[str, object],
    **how: Unpack[How],
) -> list[Arrays]:
    """Do pieces of work: compiled loops in threads, other models in processes."""
    folder = how.get("folder")
    if folder is not None:
        how["folder"] = Path(folder) / what
    return many(work, pieces, key=key, what=what, threads=solver.compiled, **how)


def seeded(seed: int, n: int, block: int) -> tuple[list[tuple[SeedSequence, int]], int]:
    """Return blocks, each a stream and how many draws to take from it, and the size of a last one.

    Examples
    --------
    >>> pieces, rest = seeded(0, 5, 2)
    >>> [count for _, count in pieces], rest
    ([2, 2, 1], 1)
    """
    rest = n % block
    sizes = [block] * (n // block) + [rest] * (rest > 0)
    return list(zip(SeedSequence(seed).spawn(len(sizes)), sizes, strict=True)), rest


def in_blocks(
    solver: DrawSolver,
    what: str,
    work: Callable[[Any], Arrays],
    pieces: Sequence[Any],
    key: Mapping[str, object],
    rest: int,
    **how: Unpack[How],
) -> list[Arrays]:
    """Do blocks of draws: whole ones in a folder for samples of any size, one of `rest` apart."""
    full = len(pieces) - (rest > 0)
    if how.get("folder") is None or not rest:
        return run(solver, what, work, pieces, key, **how)
    done = run(solver, what, work, pieces[:full], key, **how) if full else []
    last = {"last block": full, "draws": rest}
    name = f"{what}-last-{full}-{rest}"
    return done + run(solver, name, work, pieces[full:], {**key, **last}, **how)


def joined(blocks: Sequence[Arrays], names: Iterable[str] | None = None) -> Arrays:
    """Return arrays of all draws, by name: all of them unless names are given."""
    chosen = blocks[0] if names is None else names
    return {name: np.concatenate([block[name] for block in blocks]) for name in chosen}
