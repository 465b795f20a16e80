"""The way of an episode's probability mass, laid out block by block.

The states that an episode may visit fall into blocks: those of the same greatest distance from the
start once states that lead back to each other count as one. Every transition leads to a later
block, or back into its own. So a block is complete when its turn comes, and can be forgotten.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from mdp.chain import spans
from mdp.errors import ModelError
from mdp.table import Floats, Integers, Numbers
from solvers.policy_chain import Mask, PolicyChain

REMAINING = 1e-12
# Of what may be left in a cycle anyway: without it, a slow one would drag long tails along.
SLOW_EDGE = 1e-12


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

    Attributes
    ----------
    chain : PolicyChain
    used : (M,) ints
        Which of the chain's outcomes.
    source, target, gain : (M,)
        Outcome by outcome; the number of states stands for the end as a target.
    block : (n+1,)
        Block of each state, in increasing order; the end is a block of its own, the last.
    start : {state: probability}
        All terminal states together are the end.
    """

    chain: PolicyChain
    used: Integers
    source: Integers
    target: Integers
    gain: Numbers
    block: Integers
    start: dict[int, Fraction]

    @classmethod
    def of(cls, chain: PolicyChain, gain: Numbers) -> Flow:
        """Return the flow of a chain that ends, with (N,) rewards as multiples of a unit."""
        mdp = chain.mdp
        inside = chain.reached & ~mdp.terminal
        members = np.flatnonzero(inside)
        matrix = chain.graph[members][:, members].tocsr()
        level = _levels(matrix)
        order = np.argsort(level, kind="stable")
        place = np.full(mdp.n_states, len(members))
        place[members[order]] = np.arange(len(members))
        used = np.flatnonzero(inside[chain.source])
        start: dict[int, Fraction] = defaultdict(Fraction)
        for state, weight in mdp.start:
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


def _levels(matrix: sp.csr_array) -> Integers:
    """Return (n,) the greatest distance from a first state, cycles counting as one state."""
    level = _peeled(matrix)
    if (level >= 0).all():
        return level
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(matrix, directed=True, connection="strong")
    entries = matrix.tocoo()
    here, there = label[entries.coords[0]], label[entries.coords[1]]
    apart = here != there
    ones = np.ones(int(apart.sum()))
    level = _peeled(sp.csr_array((ones, (here[apart], there[apart])), (count, count)))
    return np.asarray(level[label])


def _peeled(matrix: sp.csr_array) -> Integers:
    """Return (n,) the greatest number of steps to each state; -1 where a cycle leads to it."""
    states = matrix.shape[0]
    waiting = np.bincount(matrix.indices, minlength=states)
    level = np.full(states, -1)
    frontier, reached = np.flatnonzero(waiting == 0), 0
    while len(frontier):
        level[frontier] = reached
        found = matrix.indices[spans(matrix.indptr[frontier], matrix.indptr[frontier + 1])]
        found, count = np.unique(found, return_counts=True)
        waiting[found] -= count
        frontier, reached = found[waiting[found] == 0], reached + 1
    return level


def too_many() -> ModelError:
    return ModelError(
        "too many different returns for their distribution to be worked out",
        where="rewards",
        fix="round the rewards to a coarser grid; evaluate() gives mean and sd, simulate() samples",
    )


def too_slow(sweeps: int, left: float) -> ModelError:
    return ModelError(
        f"after {sweeps:,} sweeps {left:.1g} of the probability has not reached the end",
        where="policy",
        fix="raise max_sweeps; evaluate() gives mean and sd, simulate() samples returns",
    )
