"""Gain and bias of a Markov chain with rewards, exactly or in floats.

    g = P g,      g + (I - P) h = r,      h + (I - P) w = 0

g is the average reward per step, from each state; the bias h is what a start is worth beyond it, so
that n steps earn n g + h in the mean, up to terms that vanish or, where the chain is periodic,
average out; w is -h's own bias. The last equation fixes h: its long-run average is 0 (Puterman,
Markov Decision Processes, 1994, theorem 8.2.6, corollary 8.2.9).

One state of each recurrent class is its base. With y = f + P y elsewhere and y = 0 there, what is
earned on the way to a base, and t the same for f = 1,

    mean of f in a class  =  (f + P y) / (1 + P t)   at its base

by renewal (Ross, Stochastic Processes, 1996, theorem 3.6.1), y less its own mean solves the second
equation within the class, and transient states take the means of where they come to. All this is
one kind of equation with a nonsingular matrix, and periodic chains are no different from others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import strong_components
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers, common, integers, spans
from exact_mdp.solvers.bounds.linear import LinearSystem, rows_of
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.exact.linear import Matrix, exact_solve
from exact_mdp.solvers.solution import SolverError, Status

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Classes:
    """The recurrent classes of a chain, C in number.

    Attributes
    ----------
    label : (S,) int64
        The class of each state; -1 where it is transient.
    base : (C,) int64
        One state of each.
    """

    label: Integers
    base: Integers

    @classmethod
    def of(cls, graph: sp.csr_array) -> Classes:
        """Return the classes of a graph (S, S): what is never left, once entered."""
        graph = sp.csr_array(graph, copy=True)  # a search takes no views of other arrays
        part = strong_components(graph)
        source = np.repeat(np.arange(len(part)), np.diff(graph.indptr))
        closed = np.ones(int(part.max()) + 1, dtype=bool)
        closed[part[source[part[source] != part[graph.indices]]]] = False
        number = np.where(closed, np.cumsum(closed) - 1, -1)
        label = number[part].astype(np.int64)
        recurrent = np.flatnonzero(label >= 0)
        _, first = np.unique(label[recurrent], return_index=True)
        return cls(label=label, base=recurrent[first])

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


def graph_of(mdp: MDP, pairs: Integers) -> sp.csr_array:
    """Return where the pairs (K,) of a policy lead from each state, (S, S), however rarely."""
    offsets = mdp.table.offsets
    following = mdp.table.next[spans(offsets[pairs], offsets[pairs + 1])]
    source = np.repeat(mdp.pair_state[pairs], offsets[pairs + 1] - offsets[pairs])
    shape = (mdp.n_states, mdp.n_states)
    return sp.csr_array((np.ones(len(source)), (source, following)), shape)


class Averages(ABC):
    """Means and biases of rewards (S,) in a chain, as arrays of floats or of Fractions."""

    classes: Classes

    @property
    @abstractmethod
    def ones(self) -> Numbers:
        """(S,) a reward of 1 in every state."""

    @abstractmethod
    def total(self, constant: Numbers, stop: Mask) -> Numbers:
        """Return y (S,): y = constant where `stop`, and constant + P y elsewhere."""

    @abstractmethod
    def onward(self, value: Numbers) -> Numbers:
        """Return (C,) what P makes of `value` (S,) at the bases."""

    def expansion(self, reward: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Return gain g, bias h and w, each (S,)."""
        gain = self.spread(self.mean(reward))
        bias = self.bias(reward - gain)
        return gain, bias, self.bias(-bias)

    def bias(self, earned: Numbers) -> Numbers:
        """Return (S,) the bias of rewards whose mean is 0 in each class."""
        bias = self.until_base(earned)
        return np.asarray(bias - self.spread(self.mean(bias)))

    def mean(self, earned: Numbers) -> Numbers:
        """Return (C,) the long-run average of rewards (S,) in each class."""
        return np.asarray(self._cycle(earned) / self.period)

    @cached_property
    def period(self) -> Numbers:
        """(C,) the mean number of steps between two visits of a base."""
        return self._cycle(self.ones)

    def spread(self, means: Numbers) -> Numbers:
        """Return (S,) the expectation of a number (C,) of the class that the chain ends in."""
        label, inside = self.classes.label, self.classes.recurrent
        if len(means) == 1 or inside.all():
            return np.asarray(means[np.maximum(label, 0)])
        return self.total(np.where(inside, means[label], means[0] * 0), inside)

    def until_base(self, earned: Numbers) -> Numbers:
        """Return (S,) what is earned before the chain comes to a base."""
        at_base = self.classes.at_base
        return self.total(np.where(at_base, earned * 0, earned), at_base)

    def _cycle(self, earned: Numbers) -> Numbers:
        """Return (C,) what is earned between two visits of a base."""
        return np.asarray(earned[self.classes.base] + self.onward(self.until_base(earned)))


class FloatAverages(Averages):
    """The same in floats, without a claim about their errors."""

    def __init__(self, transition: sp.csr_array, classes: Classes, roundings: int = 1) -> None:
        """Take P (S, S), whose rows may be empty where a state is absorbing."""
        self.transition, self.classes, self._roundings = transition, classes, roundings
        self._systems: dict[bytes, LinearSystem] = {}

    @property
    def ones(self) -> Floats:
        """(S,) floats."""
        return np.ones(len(self.classes.label))

    def system(self, stop: Mask) -> LinearSystem:
        """Return the equation y = c + P y, with empty rows where `stop`."""
        key = stop.tobytes()
        if key not in self._systems:
            rows = rows_of(self.transition, ~stop)
            self._systems[key] = LinearSystem(rows, 1.0, roundings=self._roundings)
        return self._systems[key]

    def total(self, constant: Floats, stop: Mask) -> Floats:
        """Return y (S,), refined."""
        total = self.system(stop).approximate(constant)
        if not np.all(np.isfinite(total)):
            raise SolverError(Status.NO_BOUND, "the chain leaves some states too rarely")
        return total

    def onward(self, value: Floats) -> Floats:
        """Return (C,) floats."""
        return np.asarray(self.transition[self.classes.base] @ value)


class ExactAverages(Averages):
    """The same in Fractions, from equations with one pair for each state and rows that sum to 1."""

    def __init__(self, rows: BellmanRows) -> None:
        """Take the Bellman equations of the chain, at discount 1."""
        states = len(rows.scale)
        graph = sp.csr_array((np.ones(len(rows.next)), rows.next, rows.offsets), (states, states))
        self.classes, self._rows = Classes.of(graph), rows
        self._systems: dict[bytes, Matrix] = {}

    @property
    def ones(self) -> Numbers:
        """(S,) Fractions."""
        return np.array([Fraction(1)] * len(self.classes.label), dtype=object)

    @property
    def reward(self) -> Numbers:
        """(S,) the rewards."""
        rows = self._rows
        numbers = zip(rows.constant.tolist(), rows.scale.tolist(), strict=True)
        return np.array([Fraction(top, below) for top, below in numbers], dtype=object)

    def total(self, constant: Numbers, stop: Mask) -> Numbers:
        """Return y (S,)."""
        numbers, unit = common(constant.tolist())
        earned = zip(numbers, self._rows.scale.tolist(), strict=True)
        top, below = exact_solve(self._system(stop), [number * scale for number, scale in earned])
        return Level.over(map(int, top), int(below) * unit).fractions()

    def _system(self, stop: Mask) -> Matrix:
        """Return the equations y = c + P y, with y = c where `stop`."""
        key, rows = stop.tobytes(), self._rows
        if key not in self._systems:
            states, inside = np.arange(len(stop)), ~stop[rows.pair]
            self._systems[key] = Matrix.of(
                len(stop),
                np.concatenate([states, rows.pair[inside]]),
                np.concatenate([states, rows.next[inside]]),
                integers([*rows.scale.tolist(), *(-rows.weight[inside]).tolist()]),
            )
        return self._systems[key]

    def onward(self, value: Numbers) -> Numbers:
        """Return (C,) Fractions."""
        rows, base = self._rows, self.classes.base
        first, last = rows.offsets[base], rows.offsets[base + 1]
        entries = spans(first, last)
        terms = rows.weight[entries].astype(object) * value[rows.next[entries]]
        offsets = np.cumsum(last - first) - (last - first)
        return np.asarray(np.add.reduceat(terms, offsets) / rows.scale[base].astype(object))
