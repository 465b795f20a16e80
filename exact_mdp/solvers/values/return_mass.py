"""The probability mass of (state, reward so far), carried through an episode block by block.

    m(s', x + r) += p · m(s, x)        for each outcome (p, s', r) of s

The states that an episode may visit fall into blocks: those of the same greatest distance from the
start once states that lead back to each other count as one. Every transition leads to a later
block, or back into its own. So a block is complete when its turn comes, and can be forgotten.

On a coarse lattice of rewards, a block of n states has an array (n, W) over all W multiples between
its least and its greatest reward so far. Outcomes with the same reward r are one sparse matrix, and
x + r is a shift. On a fine lattice, of which few sums occur, the masses are in dictionaries; so are
exact masses, which are integers, those of a block being over one denominator.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import lcm
from typing import Any

import numpy as np
import scipy.sparse as sp
import tqdm

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Backward, strong_components
from exact_mdp.mdp.table import Floats, Integers, Numbers, integers
from exact_mdp.solvers.bounds.gains import TINY
from exact_mdp.solvers.values.policy_chain import Mask, PolicyChain

REMAINING = 1e-12
# Of what may be left in a cycle anyway: without it, a slow one would drag long tails along.
SLOW_EDGE = 1e-12
EDGE = 1e-290  # masses below are dropped before they lose their digits, and the processor its speed
CELLS = 2**26  # of a window
STEPS = 20_000_000  # with dictionaries


@dataclass(frozen=True, kw_only=True, eq=False)
class Carried:
    """Mass by multiple of the unit, its roundings, and the mass that is not in it."""

    multiples: Numbers
    masses: Floats
    roundings: int
    remaining: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Flow:
    """The outcomes that an episode can meet, among states numbered by block.

    All terminal states together are the end, a block of its own, the last.
    """

    chain: PolicyChain
    used: Integers  # (M,) which of the chain's outcomes
    source: Integers  # (M,) outcome by outcome
    target: Integers  # (M,) the number of states stands for the end
    gain: Numbers  # (M,)
    block: Integers  # (n+1,) block of each state, in increasing order
    start: dict[int, Fraction]  # {state: probability}

    @classmethod
    def of(cls, chain: PolicyChain, gain: Numbers, ends: Mask) -> Flow:
        """Return the flow of a chain that ends, with (N,) rewards as multiples of a unit.

        What comes to other ends than `ends` (S,) is left out.
        """
        mdp = chain.mdp
        inside = chain.reached & ~mdp.terminal
        members = np.flatnonzero(inside)
        level = _levels(chain.graph[members][:, members].T.tocsr())
        order = np.argsort(level, kind="stable")
        place = np.full(mdp.n_states, len(members))
        place[members[order]] = np.arange(len(members))
        used = np.flatnonzero(inside[chain.source] & (inside | ends)[chain.table.next])
        start: dict[int, Fraction] = defaultdict(Fraction)
        for state, weight in mdp.start:
            if inside[state] or ends[state]:
                start[int(place[state])] += weight
        return cls(
            chain=chain,
            used=used,
            source=place[chain.source[used]],
            target=place[chain.table.next[used]],
            gain=gain[used],
            block=np.append(level[order], level.max(initial=-1) + 1),
            start={state: weight for state, weight in start.items() if weight},
        )

    @property
    def end(self) -> int:
        """The number that stands for the end."""
        return len(self.block) - 1

    @cached_property
    def first(self) -> Integers:
        """(B+1,) the first state of each block, and one past the end."""
        return np.searchsorted(self.block, np.arange(self.block[-1] + 2))

    @cached_property
    def cyclic(self) -> Mask:
        """(B,) True for blocks with transitions into themselves."""
        inner = self.block[self.source] == self.block[self.target]
        return np.bincount(self.block[self.source[inner]], minlength=self.block[-1] + 1) > 0

    @property
    def tolerance(self) -> float:
        """Mass that may be left in each cyclic block."""
        return REMAINING / max(int(self.cyclic.sum()), 1)

    @property
    def entering(self) -> Integers:
        """(n+1,) the number of outcomes that lead to each state."""
        return np.bincount(self.target, minlength=self.end + 1)


def _levels(graph: sp.csr_array) -> Integers:
    """Return the most edges on a way from each node; nodes on a common cycle count as one."""
    label = strong_components(graph)
    here, there = (label[each] for each in graph.tocoo().coords)
    count, apart = int(label.max(initial=-1)) + 1, here != there
    edges = sp.csr_array((np.ones(apart.sum()), (here[apart], there[apart])), (count, count))
    edges.sum_duplicates()
    waiting = np.diff(edges.indptr)
    owner, every = np.repeat(np.arange(count), waiting), np.ones(edges.nnz, dtype=bool)
    backward = Backward.of(np.arange(edges.nnz + 1), edges.indices, owner, count)
    return backward.rounds(waiting == 0, every, waiting)[0][label]


def _too_many() -> ModelError:
    return ModelError(
        "too many different returns for their distribution to be worked out",
        where="rewards",
        fix="round the rewards to a coarser grid; evaluate() gives mean and sd, simulate() samples",
    )


def _too_slow(sweeps: int, left: float) -> ModelError:
    return ModelError(
        f"after {sweeps:,} sweeps {left:.1g} of the probability has not reached the end",
        where="policy",
        fix="raise max_sweeps; evaluate() gives mean and sd, simulate() samples returns",
    )


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
                raise _too_many()
            self.mass = np.pad(self.mass, ((0, 0), (before, after)))
            self.low -= before
        self.mass[rows, low - self.low : high - self.low] += mass

    def trim(self, edge: float = EDGE) -> float:
        """Drop mass below `edge`, and empty columns at both ends; return what was lost by that."""
        small = self.mass < edge
        lost = float(self.mass.sum(where=small))
        self.mass[small] = 0.0
        kept = np.flatnonzero(~small.all(axis=0))
        first, last = (int(kept[0]), int(kept[-1]) + 1) if len(kept) else (0, 0)
        self.low, self.mass = self.low + first, np.ascontiguousarray(self.mass[:, first:last])
        return lost


def carry_dense(flow: Flow, max_sweeps: int) -> Carried:
    """Return the mass at the end, from arrays over the whole range of rewards so far."""
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
    for block in tqdm.tqdm(range(last), desc="returns", unit="block", delay=2, disable=None):
        window, sweeps = windows.pop(block, None), 1
        if window is None:  # what led here was too small to speak of
            continue
        if flow.cyclic[block]:
            inner = [group for group in groups[block] if group.block == block]
            window, left, sweeps = _swept(window, inner, flow.tolerance, max_sweeps)
            lost += left
        lost += window.trim()
        roundings += (int(entering[block]) + flow.chain.roundings + 6) * sweeps + sweeps
        for group in groups.pop(block, []):
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
    raise _too_slow(max_sweeps, left)


def carry_sparse(flow: Flow, max_sweeps: int) -> Carried:
    """Return the mass at the end, from a dictionary of the rewards so far of each state."""
    shares = flow.chain.probability[flow.used].tolist()
    start = {state: float(weight) for state, weight in flow.start.items()}
    masses, lost, sweeps = _carry(flow, shares, start, max_sweeps)
    multiples = sorted(multiple for multiple, mass in masses.items() if mass > 0)
    # Underflow to 0 takes some returns away altogether.
    lost += TINY * (len(masses) - len(multiples))
    roundings = (int(flow.entering.max()) + flow.chain.roundings + 7) * (sweeps + 2)
    return Carried(
        multiples=integers(multiples),
        masses=np.array([masses[multiple] for multiple in multiples]),
        roundings=roundings,
        remaining=lost,
    )


def carry_exact(flow: Flow) -> tuple[dict[int, int], int]:
    """Return the mass at the end as integers over one denominator."""
    if flow.cyclic.any():
        raise ModelError(
            "states lead back to each other, so that returns have no end",
            where="policy",
            fix="leave out exact=True: all but 10^-12 of the probability is then found",
        )
    odds, block = flow.chain.odds, flow.block[flow.source].tolist()
    chances = [odds[number] for number in flow.used.tolist()]
    common = [1] * int(flow.block[-1])
    for here, chance in zip(block, chances, strict=True):
        common[here] = lcm(common[here], chance.denominator)
    # Mass of block b is over start · common[0] ⋯ common[b-1]; who jumps ahead takes all of these.
    product = [1]
    for factor in common:
        product.append(product[-1] * factor)
    shares = [
        int(chance * common[here]) * (product[there] // product[here + 1])
        for chance, here, there in zip(
            chances, block, flow.block[flow.target].tolist(), strict=True
        )
    ]
    bottom = lcm(*(weight.denominator for weight in flow.start.values()))
    start = {
        state: int(weight * bottom) * product[int(flow.block[state])]
        for state, weight in flow.start.items()
    }
    masses, _, _ = _carry(flow, shares, start, 1)
    return masses, bottom * product[-1]


def _carry(
    flow: Flow, shares: list[Any], start: dict[int, Any], max_sweeps: int
) -> tuple[dict[int, Any], Any, int]:
    """Return the mass at the end by reward, what is not in it, and the number of sweeps."""
    rows: list[dict[tuple[int, int], Any]] = [defaultdict(int) for _ in range(flow.end)]
    steps = zip(flow.source.tolist(), flow.target.tolist(), flow.gain.tolist(), shares, strict=True)
    for source, target, gain, share in steps:
        rows[source][target, gain] += share
    masses: list[dict[int, Any]] = [defaultdict(int) for _ in range(flow.end + 1)]
    for state, weight in start.items():
        masses[state][0] += weight
    lost, sweeps, work, edge = 0, 0, 0, flow.tolerance * SLOW_EDGE
    for block in range(int(flow.block[-1])):
        members = range(int(flow.first[block]), int(flow.first[block + 1]))
        moving = {state: masses[state] for state in members}
        for _ in range(max_sweeps):
            sweeps += 1
            following: dict[int, dict[int, Any]] = {}
            for state, spread in moving.items():
                work += len(spread) * len(rows[state])
                if work > STEPS:
                    raise _too_many()
                for (target, gain), share in rows[state].items():
                    inner = members.start <= target < members.stop
                    into = (
                        following.setdefault(target, defaultdict(int)) if inner else masses[target]
                    )
                    for so_far, mass in spread.items():
                        into[so_far + gain] += mass * share
            for spread in following.values():
                for multiple in [x for x, mass in spread.items() if mass < edge]:
                    lost += spread.pop(multiple)
            left = sum(sum(spread.values()) for spread in following.values())
            if left <= flow.tolerance:
                lost += left
                break
            moving = following
        else:
            raise _too_slow(max_sweeps, float(left))
        for state in members:
            masses[state].clear()
    return masses[flow.end], lost, sweeps
