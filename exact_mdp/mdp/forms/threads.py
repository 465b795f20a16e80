"""Work in blocks, on several threads.

Threads help with loops that release Python's lock: compiled loops, and NumPy's over long arrays.
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

# Transitions for which another thread saves more time than its start takes; every pass over a model
# starts its threads again.
SMALLEST = 500_000
IN_CACHE = 2**16  # entries of each array in a block, so that a few arrays fit in a core's cache


def count_cores() -> int:
    """Return the number of cores to use: at most two, since memory is too slow for more."""
    if hasattr(os, "sched_getaffinity"):
        return min(2, len(os.sched_getaffinity(0)))
    return min(2, os.cpu_count() or 1)


def block_ends(
    work: NDArray[Any], threads: int | None = None, most: int | None = None
) -> list[int]:
    """Return the ends 0, …, N of blocks of N items with about the same work each.

    `work` (N+1,) is the cumulative work, from 0. By default there are as many threads as cores, or
    fewer for little work. `most` is roughly the largest work of a block.
    """
    total = int(work[-1])
    if threads is None:
        threads = min(count_cores(), max(total // SMALLEST, 1))
    if threads == 1 and (most is None or total <= most):
        return [0, len(work) - 1]
    # With three blocks for each thread, all threads end at nearly the same time.
    count = 1
    if threads > 1:
        count = 3 * threads
    if most is not None:
        count = max(count, total // most)
    inner = np.searchsorted(work, [total * i // count for i in range(1, count)])
    return [0, *sorted({int(i) for i in inner} - {0, len(work) - 1}), len(work) - 1]


def run_blocks(
    ends: Sequence[int], work: Callable[[int, int, int], None], size: int = 2 * SMALLEST
) -> None:
    """Call `work(number, first, last)` for each block; on several threads if `size` is large."""
    blocks = enumerate(pairwise(ends))
    if len(ends) == 2 or size < 2 * SMALLEST:
        for number, (first, last) in blocks:
            work(number, first, last)
        return
    # Each thread gets a copy of the context, such as the floating-point errors to ignore.
    with ThreadPoolExecutor(count_cores()) as pool:
        running = []
        for number, (first, last) in blocks:
            running.append(pool.submit(copy_context().run, work, number, first, last))
        for future in running:
            future.result()  # raises the error of the block, if any
