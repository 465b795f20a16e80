"""Carries probability mass over (state, reward so far) on a coarse lattice, in arrays.

    m(s', x + r) += p · m(s, x)        for each outcome (p, s', r) of s

A block of n states has an array (n, W) over all W multiples between its least and its greatest
reward so far. Outcomes with the same reward r are one sparse matrix, and x + r is a shift.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from mdp.table import Floats, Integers
from solvers.returns_flow import SLOW_EDGE, Carried, Flow, too_many, too_slow

EDGE = 1e-290
CELLS = 2**26


class _Window:
    """Mass of n states over the multiples low … low + width - 1, growing as needed."""

    def __init__(self, states: int) -> None:
        self.states, self.low = states, 0
        self.mass: Floats = np.zeros((states, 0))

    def add(self, rows: Integers, low: int, mass: Floats) -> None:
        """Add (r, w) mass to different rows, its first column standing for `low`."""
        if not self.mass.size:
            self.low, self.mass = low, np.zeros((self.states, mass.shape[1]))
        width, high = self.mass.shape[1], low + mass.shape[1]
        if low < self.low or high > self.low + width:
            before = max(self.low - low, 0)
            after = max(high - self.low - width, 0)
            # A little more than asked for, as the next demand comes soon.
            before, after = before + (before > 0) * width // 2, after + (after > 0) * width // 2
            if self.states * (width + before + after) > CELLS:
                raise too_many()
            self.mass = np.pad(self.mass, ((0, 0), (before, after)))
            self.low -= before
        self.mass[rows, low - self.low : high - self.low] += mass

    def trim(self, edge: float = EDGE) -> float:
        """Drop mass below `edge`, and empty edges; return what was lost by that.

        So no number becomes so small that it loses its digits, and the processor its speed.
        """
        small = self.mass < edge
        lost = float(self.mass.sum(where=small))
        self.mass[small] = 0.0
        kept = np.flatnonzero(~small.all(axis=0))
        first, last = (int(kept[0]), int(kept[-1]) + 1) if len(kept) else (0, 0)
        self.low, self.mass = self.low + first, np.ascontiguousarray(self.mass[:, first:last])
        return lost


def carry_dense(flow: Flow, max_sweeps: int) -> Carried:
    """Return the mass at the end, from arrays over the whole range of rewards so far."""
    from tqdm import tqdm

    first, last = flow.first, int(flow.block[-1])
    groups = _groups(flow)
    windows: dict[int, _Window] = {}

    def add(block: int, rows: Integers, low: int, mass: Floats) -> None:
        if block not in windows:
            windows[block] = _Window(int(first[block + 1] - first[block]))
        windows[block].add(rows, low, mass)

    for state, weight in flow.start.items():
        block = int(flow.block[state])
        add(block, np.array([state - first[block]]), 0, np.array([[float(weight)]]))
    lost, roundings = 0.0, 4
    entering = np.maximum.reduceat(flow.entering, first[:-1])
    for block in tqdm(range(last), desc="returns", unit="block", delay=2, disable=None):
        window, sweeps = windows.pop(block, None), 1
        if window is None:  # what led here was too small to speak of
            continue
        if flow.cyclic[block]:
            inner = [group for group in groups[block] if group.block == block]
            window, left, sweeps = _swept(window, inner, flow.tolerance, max_sweeps)
            lost += left
        lost += window.trim()
        roundings += (int(entering[block]) + flow.chain.roundings + 6) * sweeps + sweeps
        for group in groups.pop(block):
            if group.block != block and window.mass.size:
                add(group.block, group.rows, window.low + group.gain, group.matrix @ window.mass)
    window = windows.get(last) or _Window(1)
    lost += window.trim()
    roundings += int(entering[last]) + 6
    mass = window.mass[0] if window.mass.size else np.zeros(0)
    found = np.flatnonzero(mass)
    return Carried(
        multiples=window.low + found, masses=mass[found], roundings=roundings, remaining=lost
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Group:
    """Outcomes of one block with the same reward and the same block to go to."""

    block: int
    gain: int
    rows: Integers
    matrix: sp.csr_array


def _groups(flow: Flow) -> dict[int, list[_Group]]:
    """Return the outcomes that leave each block, grouped by where they lead and their reward."""
    groups: dict[int, list[_Group]] = defaultdict(list)
    if not len(flow.used):
        return groups
    here, there = flow.block[flow.source], flow.block[flow.target]
    order = np.lexsort((flow.source, flow.target, flow.gain, there, here))
    keys = np.stack([here, there, flow.gain, flow.target, flow.source])[:, order]
    fresh = np.ones(keys.shape, dtype=bool)
    np.not_equal(keys[:, 1:], keys[:, :-1], out=fresh[:, 1:])
    # Several actions may do the same: their outcomes become one.
    one = np.flatnonzero(fresh.any(axis=0))
    probability = np.add.reduceat(flow.chain.probability[flow.used[order]], one)
    keys, fresh = keys[:, one], fresh[:, one]
    rows, first = np.flatnonzero(fresh[:4].any(axis=0)), np.flatnonzero(fresh[:3].any(axis=0))
    offsets = np.append(rows, len(one))
    cuts = np.append(np.searchsorted(rows, first), len(rows))
    column = keys[4] - flow.first[keys[0]]
    for begin, end in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        low, high = offsets[begin], offsets[end]
        block, leads, gain = keys[:3, low].tolist()
        size = int(flow.first[block + 1] - flow.first[block])
        parts = (probability[low:high], column[low:high], offsets[begin : end + 1] - low)
        matrix = sp.csr_array(parts, shape=(end - begin, size))
        reached = keys[3, rows[begin:end]] - flow.first[leads]
        groups[block].append(_Group(block=leads, gain=gain, rows=reached, matrix=matrix))
    return groups


def _swept(
    moving: _Window, inner: list[_Group], tolerance: float, max_sweeps: int
) -> tuple[_Window, float, int]:
    """Return the mass of all visits to a block, what was left moving in it, and the sweeps."""
    everyone = np.arange(moving.states)
    total, lost = _Window(moving.states), 0.0
    for sweep in range(1, max_sweeps + 1):
        total.add(everyone, moving.low, moving.mass)
        following = _Window(moving.states)
        for group in inner:
            following.add(group.rows, moving.low + group.gain, group.matrix @ moving.mass)
        lost += following.trim(tolerance * SLOW_EDGE)
        left = float(following.mass.sum())
        if left <= tolerance:
            return total, lost + left, sweep
        moving = following
    raise too_slow(max_sweeps, left)
