"""Work in blocks, on as many threads as there are cores.

It pays for loops that let go of Python's lock: compiled ones, and those of NumPy over long arrays.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMALLEST = 500_000  # transitions for which another thread pays: each is begun anew for a pass
PER_THREAD = 3  # blocks of rows: with several, threads end at nearly the same time
IN_CACHE = 2**16  # entries of a few arrays that a core's cache holds, amply


def count_cores() -> int:
    """Return how many cores this process may use, two at most: memory is too slow for more."""
    if hasattr(os, "sched_getaffinity"):
        return min(2, len(os.sched_getaffinity(0)))
    return min(2, os.cpu_count() or 1)


def block_ends(
    work: NDArray[Any], threads: int | None = None, most: int | None = None
) -> list[int]:
    """Return 0, …, N: where to cut N items into blocks of about the same work.

    `work` (N+1,) is that of all items before each; there are as many threads as cores, fewer for
    little work, unless given; `most` is about the most work of a block, which a cache holds.
    """
    total = int(work[-1])
    if threads is None:
        threads = min(count_cores(), total // SMALLEST) if total >= 2 * SMALLEST else 1
    if threads == 1 and (most is None or total <= most):
        return [0, len(work) - 1]
    count = 1 if threads == 1 else PER_THREAD * threads
    if most is not None:
        count = max(count, total // most)
    inner = np.searchsorted(work, [total * i // count for i in range(1, count)])
    return [0, *sorted({int(i) for i in inner} - {0, len(work) - 1}), len(work) - 1]


def run_blocks(
    ends: Sequence[int], work: Callable[[int, int, int], None], size: int = 2 * SMALLEST
) -> None:
    """Call `work(number, first, last)` for each block; on all cores if the `size` pays."""
    blocks = enumerate(pairwise(ends))
    if len(ends) == 2 or size < 2 * SMALLEST:
        for number, (first, last) in blocks:
            work(number, first, last)
        return
    # Each with a copy of what holds here, such as which floating-point errors are ignored.
    with ThreadPoolExecutor(count_cores()) as pool:
        for done in [
            pool.submit(copy_context().run, work, number, first, last)
            for number, (first, last) in blocks
        ]:
            done.result()
