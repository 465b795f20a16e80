"""Gain and bias of a Markov chain with rewards, and its stationary distributions.

    g = P g,      g + (I - P) h = r,      h + (I - P) w = 0

n steps earn n g + h on average, up to terms that vanish or average out; the long-run average of h
is 0 (Puterman, Markov Decision Processes, 1994, theorem 8.2.6, corollary 8.2.9). One frequently
visited state of each recurrent class is its base. The stationary distribution is the mean number of
visits between two visits of the base, divided by the time between them (Ross, Stochastic Processes,
1996, theorem 3.6.1). The bias is the reward on the way to a base, y = f + P y, less its mean.

In floats, for any h' and w', min d ≤ g ≤ max d and min e ≤ mean of h' ≤ max e in each class, with
d = r + P h' - h' and e = h' + w' - P w'. The error of h' solves the equation of h with the reward
d - g: it is at most the sum of residuals on the way to a base, plus the mean of h'.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import Mask, strong_components
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers, concatenate_ranges
from exact_mdp.solvers.bounds.gains import (
    SLACK,
    TINY,
    UNIT,
    Advantages,
    BoundedVector,
    compute_advantages,
    gamma,
)
from exact_mdp.solvers.bounds.linear import LinearSystem, select_rows, transpose_system
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.exact.linear import (
    Matrix,
    build_equations,
    compute_expected_visits,
    solve_policy_equations,
)


class Classes:
    """The C recurrent classes of a chain: sets of states that are never left once entered."""

    def __init__(self, graph: sp.csr_array) -> None:
        """Take the graph (S, S) of a chain, with an entry for each possible transition."""
        # A strong component is a class if no transition leaves it.
        part = strong_components(graph)
        source = np.repeat(np.arange(len(part)), np.diff(graph.indptr))
        closed = np.ones(int(part.max()) + 1, dtype=bool)
        closed[part[source[part[source] != part[graph.indices]]]] = False
        # (S,) the class of each state; -1 where it is transient
        self.label = np.where(closed, np.cumsum(closed) - 1, -1)[part]
        # Power iteration with half a step, for periodic chains: the likeliest state is the base.
        moves, often = graph.T.tocsr() / 2, np.ones(len(part))
        # Measured: after 8 steps instead of 64, bounds are 20 times as wide.
        for _ in range(64):
            often = often / 2 + moves @ often
        order = np.lexsort((-often.astype(np.float32), self.label))
        # (C,) the base of each class.
        self.base = order[np.flatnonzero(np.diff(self.label[order], prepend=-1))]

    @property
    def recurrent(self) -> Mask:
        """(S,) True in the states of a class."""
        return np.asarray(self.label >= 0)

    @cached_property
    def at_base(self) -> Mask:
        """(S,) True at the base of each class."""
        marked = np.zeros(len(self.label), dtype=bool)
        marked[self.base] = True
        return marked

    @property
    def own(self) -> Integers:
        """(S,) the class of each state, 0 where it is transient."""
        return np.maximum(self.label, 0)

    def normalise_in_classes(self, visits: Numbers) -> Numbers:
        """Return (S,) visits (S,) divided by their sum over the state's class; 0 if transient."""
        inside = np.where(self.recurrent, visits, visits[0] * 0)
        return np.asarray(inside / self.sum_by_class(inside)[self.own])

    def sum_by_class(self, amounts: Numbers) -> Numbers:
        """Return (C,) the sums of amounts (S,) in each class."""
        total = np.zeros(len(self.base), dtype=amounts.dtype)
        np.add.at(total, self.label[self.recurrent], amounts[self.recurrent])
        return total


class Chain(Protocol):
    """A Markov chain, in floats or in Fractions: all that gain and bias need to know of it."""

    classes: Classes

    @property
    def stationary(self) -> Numbers:
        """(S,) the share of time in each state of a class."""

    def accumulate_until_base(self, constant: Numbers) -> Numbers:
        """Return y (S,): y = constant at bases, and constant + P y elsewhere."""


def compute_laurent_expansion(chain: Chain, reward: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Return gain g, bias h and w, each (S,), of rewards (S,)."""
    gain = long_run(chain, reward)
    bias = _compute_bias(chain, reward - gain)
    return gain, bias, _compute_bias(chain, -bias)


def _compute_bias(chain: Chain, earned: Numbers) -> Numbers:
    """Return (S,) the bias of rewards whose mean is 0 in each class."""
    bias = chain.accumulate_until_base(np.where(chain.classes.at_base, earned * 0, earned))
    return np.asarray(bias - long_run(chain, bias))


def long_run(chain: Chain, earned: Numbers) -> Numbers:
    """Return (S,) the long-run average of rewards (S,), from each state."""
    classes = chain.classes
    inside, own = classes.recurrent, classes.sum_by_class(chain.stationary * earned)[classes.own]
    if inside.all() or len(classes.base) == 1:
        return np.asarray(own)
    return np.where(
        inside, own, chain.accumulate_until_base(np.where(classes.at_base, own, own * 0))
    )


class FloatChain:
    """The chain, in floats, of a policy that takes pairs (U,), with these probabilities or 1."""

    def __init__(
        self, mdp: MDP, pairs: Integers, weights: Floats | None = None, roundings: int = 1
    ) -> None:
        self.mdp, self._roundings, table = mdp, roundings, mdp.table
        shape, source = (mdp.n_states, mdp.n_states), mdp.pair_state[pairs]
        offsets = np.append(0, np.cumsum(np.bincount(source, minlength=mdp.n_states)))
        # The chain of the policy: its rows are means of the rows of the pairs that it takes.
        chances = weights
        if weights is None:
            chances = np.ones(len(pairs))
        self.taken = sp.csr_array((chances, pairs, offsets), (mdp.n_states, mdp.n_pairs))
        self.transition = sp.csr_array(self.taken @ mdp.transition)
        # The graph has every transition: entries that underflow are missing in the matrix.
        lengths = np.diff(table.offsets)[pairs]
        following = table.next[concatenate_ranges(table.offsets[pairs], table.offsets[pairs + 1])]
        rare = np.full(len(following), np.finfo(np.float64).tiny)
        entries = (rare, (np.repeat(source, lengths), following))
        self.classes = Classes(self.transition + sp.csr_array(entries, shape))

    def _build_system_until(self, stop: Mask) -> LinearSystem:
        """Return the equation y = c + P y, with empty rows where `stop`."""
        rows = select_rows(self.transition, np.arange(len(stop)), ~stop)
        return LinearSystem(rows, 1.0, roundings=self._roundings)

    @cached_property
    def until_base(self) -> LinearSystem:
        """The equation y = c + P y, with empty rows at the bases."""
        return self._build_system_until(self.classes.at_base)

    @cached_property
    def until_class(self) -> LinearSystem:
        """The equation y = c + P y, with empty rows in recurrent classes."""
        return self._build_system_until(self.classes.recurrent)

    @cached_property
    def visits(self) -> LinearSystem:
        """The equation x = c + x P of visits, up to and including arrivals at bases."""
        return transpose_system(self.until_base)

    @cached_property
    def onward(self) -> Floats:
        """(S,) the probability of a step from a base into each other state."""
        return np.where(self.classes.at_base, 0.0, self.transition[self.classes.base].sum(axis=0))

    @cached_property
    def stationary(self) -> Floats:
        """(S,) the share of time in each state of a class."""
        often = np.maximum(self.visits.approximate(self.onward), 0.0)
        return self.classes.normalise_in_classes(np.where(self.classes.at_base, 1.0, often))

    def accumulate_until_base(self, constant: Floats) -> Floats:
        """Return y (S,): y = constant at bases, and constant + P y elsewhere."""
        total = self.until_base.approximate(constant)
        if not np.all(np.isfinite(total)):
            raise SolverError(Status.NO_BOUND, "the chain leaves some states too rarely")
        return total

    def bounded_gain(self, step: BoundedVector) -> BoundedVector:
        """Return the gain (S,), given the policy's advantages (S,) over any values."""
        # In a class the gain lies between the least and the greatest step of the policy.
        low, high = self.bound_by_class(step)
        middle, half = low / 2 + high / 2, (high - low) / 2
        half = half * SLACK + UNIT * (np.abs(low) + np.abs(high)) + TINY * (high != low)
        inside, own = self.classes.recurrent, self.classes.own
        # Elsewhere it is the expected gain of the class that the chain ends in.
        gain = BoundedVector(value=middle[own] * inside, error=half[own] * inside)
        if inside.all():
            return gain
        return self.until_class.solve(gain.value, gain.error)

    def bound_by_class(self, point: BoundedVector) -> tuple[Floats, Floats]:
        """Return (C,) the least and the greatest of numbers (S,) in each class, errors included."""
        size, inside = len(self.classes.base), self.classes.recurrent
        low, high, own = np.full(size, np.inf), np.full(size, -np.inf), self.classes.label[inside]
        wide = point.error * SLACK + UNIT * np.abs(point.value)
        np.minimum.at(low, own, (point.value - wide)[inside])
        np.maximum.at(high, own, (point.value + wide)[inside])
        return low, high

    def evaluate_chain(self) -> tuple[BoundedVector, BoundedVector]:
        """Return gain and bias (S,); raise SolverError if floats cannot bound them."""
        mdp, classes = self.mdp, self.classes

        def of_policy(added: Advantages) -> BoundedVector:
            """Return the advantages (S,) of the policy's pairs, given all advantages."""
            terms = int(np.diff(mdp.pair_offsets).max()) + self._roundings + 2
            error = added.error + gamma(terms) * np.abs(added.value)
            return BoundedVector(value=self.taken @ added.value, error=self.taken @ error * SLACK)

        # Any bias gives bounds on the gain; w gives bounds on the error of the bias.
        _, bias, second = compute_laurent_expansion(self, self.taken @ mdp.reward)
        step = of_policy(compute_advantages(mdp, bias))
        gain = self.bounded_gain(step)
        # The residual r - g + P h - h of the bias, rounding included.
        residual = np.abs(step.value - gain.value) * (1 + UNIT) + step.error + gain.error
        still, inside, own = np.zeros(len(bias)), classes.recurrent, classes.own
        # Collected on the way to a base, the residual bounds the error up to a constant of the
        # class.
        met = np.where(classes.at_base, 0.0, residual * SLACK)
        away = self.until_base.solve(still, met).error
        low, high = self.bound_by_class(
            of_policy(compute_advantages(mdp, second, reward=-bias[mdp.pair_state]))
        )
        # That constant is bounded by the mean of the bias, which has to be 0.
        most = np.zeros(len(classes.base))
        np.maximum.at(most, own[inside], away[inside])
        off = (np.maximum(np.abs(low), np.abs(high)) + most)[own] + away
        if not inside.all():
            # Transient states add their own residual to the error of the class that they enter.
            off = self.until_class.solve(still, np.where(inside, off, residual) * SLACK).error
        return gain, BoundedVector(value=bias, error=off * SLACK)

    def compute_limit_distribution(self) -> tuple[BoundedVector, BoundedVector]:
        """Return (S,) the share of time in each state, from the start, and arrivals at bases.

        The latter are expected visits in states other than a base.
        """
        at_base, inside, own = self.classes.at_base, self.classes.recurrent, self.classes.own
        begin, error = self.mdp.start_distribution, gamma(len(self.classes.base) + self._roundings)
        # Arrivals at bases, and visits between two visits of a base.
        arrivals = self.visits.solve(begin, UNIT * begin)
        met = self.visits.solve(self.onward, error * self.onward)
        times = np.where(at_base, 1.0, np.maximum(met.value, 0.0)) * inside
        doubt = np.where(at_base, 0.0, met.error) * inside
        # The period of a class is the number of steps between two visits of its base.
        period, off = (np.bincount(own, each).astype(np.float64) for each in (times, doubt))
        off = off + gamma(len(own)) * period
        if not (period > off).all():
            raise SolverError(Status.NO_BOUND)
        base = self.classes.base[own]
        # A state's long-run share is the mass that enters its class times its share of the period.
        mass, loose = np.maximum(arrivals.value, 0.0)[base], arrivals.error[base]
        share = mass * times / period[own]
        error = (loose * (times + doubt) + mass * doubt + share * off[own]) / (period - off)[own]
        error = (error + 8 * UNIT * share) * SLACK
        return BoundedVector(value=share, error=error), arrivals


class ExactChain:
    """A chain in Fractions, from equations with one pair for each state and rows that sum to 1."""

    def __init__(self, rows: BellmanRows) -> None:
        """Take the Bellman equations of the chain, at discount 1."""
        states, scale = len(rows.scale), rows.scale[rows.pair_state[rows.pair]]
        chance = (rows.weight / scale.astype(object)).astype(np.float64)
        graph = sp.csr_array((chance, rows.next, rows.offsets), (states, states))
        self.classes, self.rows = Classes(graph), rows

    @cached_property
    def reward(self) -> Numbers:
        """(S,) the rewards."""
        parts = zip(self.rows.constant.tolist(), self.rows.scale.tolist(), strict=True)
        return np.array([Fraction(top, below) for top, below in parts], dtype=object)

    @cached_property
    def stationary(self) -> Numbers:
        """(S,) the share of time in each state of a class."""
        rows, onward = self.rows, list[tuple[int, Fraction]]()
        for base in self.classes.base.tolist():
            entries = range(rows.offsets[base], rows.offsets[base + 1])
            unit = int(rows.scale[base])
            onward += [(int(rows.next[i]), Fraction(int(rows.weight[i]), unit)) for i in entries]
        return self.classes.normalise_in_classes(self.compute_visits(onward))

    def compute_visits(self, start: Sequence[tuple[int, Fraction]]) -> Numbers:
        """Return (S,) expected visits from a start until a base, that arrival included."""
        return compute_expected_visits(self.rows, ~self.classes.at_base, start).to_fractions()

    def compute_limit_distribution(
        self, start: Sequence[tuple[int, Fraction]]
    ) -> tuple[Numbers, Numbers]:
        """Return (S,) the share of time in each state, from a start, and `compute_visits`."""
        visits = self.compute_visits(start)
        return visits[self.classes.base[self.classes.own]] * self.stationary, visits

    @cached_property
    def _until_base(self) -> Matrix:
        return build_equations(self.rows, ~self.classes.at_base)

    def accumulate_until_base(self, constant: Numbers) -> Numbers:
        """Return y (S,): y = constant at bases, and constant + P y elsewhere."""
        return solve_policy_equations(self._until_base, self.rows, constant.tolist()).to_fractions()
