"""Gain and bias of a Markov chain with rewards, and where it spends its time.

    g = P g,      g + (I - P) h = r,      h + (I - P) w = 0

g is the average reward per step, from each state; the bias h is what a start is worth beyond it, so
that n steps earn n g + h in the mean, up to terms that vanish or, where the chain is periodic,
average out; w is -h's own bias. The last equation fixes h: its long-run average is 0 (Puterman,
Markov Decision Processes, 1994, theorem 8.2.6, corollary 8.2.9).

One state of each recurrent class is its base. With y = f + P y elsewhere and y = 0 there, what is
earned on the way to a base, and t the same for f = 1,

    mean of f in a class  =  (f + P y) / (1 + P t)   at its base

by renewal (Ross, Stochastic Processes, 1996, theorem 3.6.1), y less its own mean solves the second
equation within the class, and transient states take the means of where they come to.

In floats, for any h' and w', with d = r + P h' - h' and e = h' + w' - P w',

    min d ≤ g ≤ max d,      min e ≤ mean of h' ≤ max e       in each recurrent class.

What h' is off by solves the equation of h with d - g for a reward: it is at most the residuals that
are met on the way to a base, and the mean of h'. The share of time is what is met between two
visits of a base, over the time between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import strong_components
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, ReadAs
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers, Numbers, spans
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, Gain, gains, gamma
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem, rows_of, transposed
from exact_mdp.solvers.exact.linear import Matrix, equations, solved
from exact_mdp.solvers.solution import Bounded, Claim, SolverError, Status, Valued

if TYPE_CHECKING:
    from pandas import DataFrame

Mask = NDArray[np.bool_]
LISTED = 1000  # states in a report


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
        part = strong_components(graph)
        source = np.repeat(np.arange(len(part)), np.diff(graph.indptr))
        closed = np.ones(int(part.max()) + 1, dtype=bool)
        closed[part[source[part[source] != part[graph.indices]]]] = False
        label = np.where(closed, np.cumsum(closed) - 1, -1)[part]
        recurrent = np.flatnonzero(label >= 0)
        return cls(label=label, base=recurrent[np.unique(label[recurrent], return_index=True)[1]])

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


class Averages:
    """Means and biases of rewards (S,) in a chain, as arrays of floats or of Fractions."""

    classes: Classes
    ones: Numbers  # (S,) a reward of 1 in every state

    def total(self, constant: Numbers, stop: Mask) -> Numbers:
        """Return y (S,): y = constant where `stop`, and constant + P y elsewhere."""
        raise NotImplementedError

    def onward(self, value: Numbers) -> Numbers:
        """Return (C,) what P makes of `value` (S,) at the bases."""
        raise NotImplementedError

    def expansion(self, reward: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Return gain g, bias h and w, each (S,)."""
        gain = self.spread(self.mean(reward))
        bias = self._bias(reward - gain)
        return gain, bias, self._bias(-bias)

    def _bias(self, earned: Numbers) -> Numbers:
        """Return (S,) the bias of rewards whose mean is 0 in each class."""
        bias = self._until_base(earned)
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
        inside, own = self.classes.recurrent, means[self.classes.own]
        if len(means) == 1 or inside.all():
            return np.asarray(own)
        return self.total(np.where(inside, own, means[0] * 0), inside)

    def _until_base(self, earned: Numbers) -> Numbers:
        """Return (S,) what is earned before the chain comes to a base."""
        at_base = self.classes.at_base
        return self.total(np.where(at_base, earned * 0, earned), at_base)

    def _cycle(self, earned: Numbers) -> Numbers:
        """Return (C,) what is earned between two visits of a base."""
        return np.asarray(earned[self.classes.base] + self.onward(self._until_base(earned)))


class FloatAverages(Averages):
    """The same in floats, of a policy given as probabilities of pairs (L,)."""

    def __init__(self, mdp: MDP, weights: Floats, roundings: int = 1) -> None:
        table, pairs = mdp.table, np.flatnonzero(weights)
        shape, source = (mdp.n_states, mdp.n_states), mdp.pair_state[pairs]
        offsets = np.append(0, np.cumsum(np.bincount(source, minlength=mdp.n_states)))
        taken = sp.csr_array((weights[pairs], pairs, offsets), (mdp.n_states, mdp.n_pairs))
        self.transition, self._roundings = sp.csr_array(taken @ mdp.transition), roundings
        # However rarely: the matrix has lost what is below the range of floats.
        lengths = np.diff(table.offsets)[pairs]
        following = table.next[spans(table.offsets[pairs], table.offsets[pairs + 1])]
        entries = (np.ones(len(following)), (np.repeat(source, lengths), following))
        self.classes, self.ones = Classes.of(sp.csr_array(entries, shape)), np.ones(mdp.n_states)
        self._systems: dict[bytes, LinearSystem] = {}

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

    def bounded_gain(self, step: FixedPoint) -> FixedPoint:
        """Return the gain (S,), from what a step of the policy adds to any values (S,)."""
        low, high = self.between(step)
        middle, half = low / 2 + high / 2, (high - low) / 2
        half = half * SLACK + UNIT * (np.abs(low) + np.abs(high)) + TINY * (high != low)
        inside, own = self.classes.recurrent, self.classes.own
        gain = FixedPoint(value=middle[own] * inside, error=half[own] * inside)
        return gain if inside.all() else self.system(inside).solve(gain.value, gain.error)

    def between(self, point: FixedPoint) -> tuple[Floats, Floats]:
        """Return (C,) the least and the greatest of numbers (S,) in each class, errors included."""
        size, inside = len(self.classes.base), self.classes.recurrent
        low, high, own = np.full(size, np.inf), np.full(size, -np.inf), self.classes.label[inside]
        wide = point.error * SLACK + UNIT * np.abs(point.value)
        np.minimum.at(low, own, (point.value - wide)[inside])
        np.maximum.at(high, own, (point.value + wide)[inside])
        return low, high


class ExactAverages(Averages):
    """The same in Fractions, from equations with one pair for each state and rows that sum to 1."""

    def __init__(self, rows: BellmanRows) -> None:
        """Take the Bellman equations of the chain, at discount 1."""
        states = len(rows.scale)
        graph = sp.csr_array((np.ones(len(rows.next)), rows.next, rows.offsets), (states, states))
        self.classes, self._rows = Classes.of(graph), rows
        self.ones = np.array([Fraction(1)] * states, dtype=object)
        self._systems: dict[bytes, Matrix] = {}

    @property
    def reward(self) -> Numbers:
        """(S,) the rewards."""
        parts = zip(self._rows.constant.tolist(), self._rows.scale.tolist(), strict=True)
        return np.array([Fraction(top, below) for top, below in parts], dtype=object)

    def total(self, constant: Numbers, stop: Mask) -> Numbers:
        """Return y (S,)."""
        key = stop.tobytes()
        if key not in self._systems:
            self._systems[key] = equations(self._rows, ~stop)
        return solved(self._systems[key], self._rows, constant.tolist()).fractions()

    def onward(self, value: Numbers) -> Numbers:
        """Return (C,) Fractions."""
        rows, base = self._rows, self.classes.base
        first, last = rows.offsets[base], rows.offsets[base + 1]
        entries = spans(first, last)
        terms = rows.weight[entries].astype(object) * value[rows.next[entries]]
        offsets = np.cumsum(last - first) - (last - first)
        return np.asarray(np.add.reduceat(terms, offsets) / rows.scale[base].astype(object))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AverageEvaluation(Valued, Result):
    """What a policy earns per step in the long run, and what a start is worth beyond it.

    Attributes
    ----------
    mdp : MDP
        The model, at discount 1.
    weights : (L,)
        Probability of each pair given its state, rounded `roundings` times at most.
    policy : Policy, optional
        The policy; None where it was given as probabilities of pairs.
    classes : Classes
        The recurrent classes: `label` (S,), -1 in transient states.
    value, bias : (S,)
        Gain, the average reward per step from each state, and bias; see `solvers.endless.chain`.
    error, bias_error : (S,)
        How far they may be from the exact ones.
    exact : (FixedPoint, FixedPoint), optional
        `share` and `arrivals`, where they were found in rational arithmetic.

    Examples
    --------
    >>> from exact_mdp.solvers import evaluate
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], ["4/5", "1/5"]]], [[5], [-1]])
    >>> evaluation = evaluate(mdp, [0, 0], criterion="average")
    >>> evaluation.start.interval, evaluation.share.value.round(4).tolist()
    ((2.69230..., 2.69230...), [0.6154, 0.3846])
    """

    mdp: MDP
    weights: Floats
    roundings: int
    policy: Policy | None
    classes: Classes
    value: Floats
    error: Floats
    bias: Floats
    bias_error: Floats
    exact: tuple[FixedPoint, FixedPoint] | None = None

    claim: ClassVar[Claim] = Claim.BOUNDED

    def __post_init__(self) -> None:
        for array in (self.value, self.error, self.bias, self.bias_error):
            array.setflags(write=False)

    @property
    def read_as(self) -> ReadAs:
        """What an array was taken for: "q" or "policy"."""
        return "policy" if self.policy is None else self.policy.read_as

    @property
    def mean(self) -> float:
        """The gain from the start."""
        return self.start.value

    @property
    def share(self) -> FixedPoint:
        """(S,) the share of time that is spent in each state in the long run, from the start."""
        return self._visited[0]

    @property
    def arrivals(self) -> FixedPoint:
        """(S,) expected visits from the start until a base, that arrival included."""
        return self._visited[1]

    @cached_property
    def _visited(self) -> tuple[FixedPoint, FixedPoint]:
        if self.exact is not None:
            return self.exact
        averages = FloatAverages(self.mdp, self.weights, self.roundings)
        at_base, inside, own = self.classes.at_base, self.classes.recurrent, self.classes.own
        system, begin = transposed(averages.system(at_base)), self.mdp.start_distribution
        arrivals = system.solve(begin, UNIT * begin)
        onward = averages.transition[self.classes.base].sum(axis=0)
        onward = np.where(at_base, 0.0, onward)
        met = system.solve(onward, gamma(len(self.classes.base) + self.roundings) * onward)
        times = np.where(at_base, 1.0, np.maximum(met.value, 0.0)) * inside
        doubt = np.where(at_base, 0.0, met.error) * inside
        period, off = (np.bincount(own, each).astype(np.float64) for each in (times, doubt))
        off = off + gamma(len(own)) * period
        if not (period > off).all():
            raise SolverError(Status.NO_BOUND)
        base = self.classes.base[own]
        mass, loose = np.maximum(arrivals.value, 0.0)[base], arrivals.error[base]
        share = mass * times / period[own]
        error = (loose * (times + doubt) + mass * doubt + share * off[own]) / (period - off)[own]
        error = (error + 8 * UNIT * share) * SLACK
        return FixedPoint(value=share, error=error), arrivals

    @property
    def visits(self) -> Floats:
        """(S,) the share of time; in transient states the expected visits from the start."""
        recurrent = self.classes.recurrent
        return np.where(recurrent, self.share.value, np.maximum(self.arrivals.value, 0.0))

    @cached_property
    def components(self) -> dict[str, Bounded]:
        """What each reward component adds to the gain from the start."""
        share, mdp = self.share, self.mdp
        used, doubt = (x[mdp.pair_state] * self.weights for x in (share.value, share.error))
        rounding = float(gamma(mdp.n_pairs + self.roundings + 6))
        size = np.abs(mdp.components)
        error = (doubt @ size + rounding * (used @ size)) * SLACK
        each = zip(mdp.component_names, used @ mdp.components, error, strict=True)
        return {name: Bounded(value=float(x), error=float(off)) for name, x, off in each}

    def report(self) -> Report:
        """Return gain and components, and gain, bias and share of time of each state."""
        frame, parts = self.frame(), self.components
        few = self.mdp.n_states <= LISTED
        facts = {
            "claim": Shown(self.claim),
            "mean": Shown(self.mean, self.start),
            "error_bound": Shown(self.start.error),
            "recurrent_classes": len(self.classes.base),
            "components": Shown({name: each.value for name, each in parts.items()}, parts),
            "by_state": Shown(frame.set_index("state").to_dict("index") if few else None),
        }
        columns = {name: name for name in ("state", "gain", "bias", "share")}
        table = Table(title="gain, bias and share of time", rows=frame, columns=columns)
        return Report(title="average reward", facts=facts, tables={"states": table})

    def frame(self) -> DataFrame:
        """Return gain, bias and share of time of each state, with their error bounds."""
        import pandas

        columns = {
            "state": self.mdp.space.labels(range(len(self.value))),
            "gain": self.value,
            "gain error": self.error,
            "bias": self.bias,
            "bias error": self.bias_error,
            "share": self.share.value,
            "share error": self.share.error,
        }
        return pandas.DataFrame(columns)

    def __repr__(self) -> str:
        return f"AverageEvaluation(gain at the start {self.start})"


def evaluated(
    mdp: MDP, weights: Floats, roundings: int = 1, policy: Policy | None = None
) -> AverageEvaluation:
    """Return gain and bias of a policy, in a model at discount 1 whose rows sum to 1.

    Raises SolverError where double precision cannot bound them.
    """
    averages = FloatAverages(mdp, weights, roundings)
    classes, first = averages.classes, mdp.pair_offsets[:-1]

    def of_policy(added: Gain) -> FixedPoint:
        """Return (S,) what a step of the policy adds, from what each pair does."""
        terms = int(np.diff(mdp.pair_offsets).max()) + roundings + 2
        error = added.error + gamma(terms) * np.abs(added.value)
        value, off = (np.add.reduceat(weights * each, first) for each in (added.value, error))
        return FixedPoint(value=value, error=off * SLACK)

    _, bias, second = averages.expansion(np.add.reduceat(weights * mdp.reward, first))
    step = of_policy(gains(mdp, bias))
    gain = averages.bounded_gain(step)
    rest = np.abs(step.value - gain.value) * (1 + UNIT) + step.error + gain.error
    still, inside, own = np.zeros(len(bias)), classes.recurrent, classes.own
    met = np.where(classes.at_base, 0.0, rest * SLACK)
    away = averages.system(classes.at_base).solve(still, met).error
    low, high = averages.between(of_policy(gains(mdp, second, reward=-bias[mdp.pair_state])))
    most = np.zeros(len(classes.base))
    np.maximum.at(most, own[inside], away[inside])
    off = (np.maximum(np.abs(low), np.abs(high)) + most)[own] + away
    if not inside.all():
        off = averages.system(inside).solve(still, np.where(inside, off, rest) * SLACK).error
    return AverageEvaluation(
        mdp=mdp,
        weights=weights,
        roundings=roundings,
        policy=policy,
        classes=classes,
        value=gain.value,
        error=gain.error,
        bias=bias,
        bias_error=off * SLACK,
    )
