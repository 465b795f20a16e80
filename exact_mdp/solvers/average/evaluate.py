"""A policy's gain and bias in floats, with bounds that hold, and where it spends its time.

For any h' and w', with d = r + P h' - h' and e = h' + w' - P w' of the policy's chain,

    min d ≤ g ≤ max d,      min e ≤ mean of h' ≤ max e       in each recurrent class,

because a mean of P x - x is 0 there. What h' is off by solves the same equation as h, with the
residual d - g for a reward: it is at most the residuals that are met on the way to a base, and the
mean of h' (`chain` has the equations, `bounds.linear` verified bounds on their solutions). The
share of time is what is met between two visits of a base, over the time between them. Rounding
errors are counted everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, ReadAs
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.average.chain import Classes, FloatAverages, Mask, graph_of
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, Gain, gains, gamma
from exact_mdp.solvers.bounds.linear import FixedPoint, transposed
from exact_mdp.solvers.solution import Bounded, Claim, SolverError, Status, Valued

if TYPE_CHECKING:
    from pandas import DataFrame

LISTED = 1000  # states in a report


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
        Gain, the average reward per step from each state, and bias; see `solvers.average.chain`.
    error, bias_error : (S,)
        How far they may be from the exact ones.
    exact : (FixedPoint, FixedPoint), optional
        `share` and `arrivals`, where they were found in rational arithmetic.

    Examples
    --------
    >>> from exact_mdp.solvers import evaluate
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], ["4/5", "1/5"]]], [[5], [-1]])
    >>> found = evaluate(mdp, [0, 0], criterion="average")
    >>> found.start.interval, found.share.value.round(4).tolist()
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

    @property
    def read_as(self) -> ReadAs:
        """What an array was taken for: "q" or "policy"."""
        return "policy" if self.policy is None else self.policy.read_as

    @property
    def mean(self) -> float:
        """The gain from the start."""
        return self.start.value

    @cached_property
    def share(self) -> FixedPoint:
        """(S,) the share of time that is spent in each state in the long run, from the start."""
        if self.exact is not None:
            return self.exact[0]
        at_base, label = self.classes.at_base, self.classes.label
        averages = self._averages
        system = transposed(averages.system(at_base))
        arrivals = self.arrivals
        onward = averages.transition[self.classes.base].sum(axis=0)
        onward = np.where(at_base, 0.0, onward)
        rounding = float(gamma(len(self.classes.base) + self.roundings))
        met = system.solve(onward, rounding * onward)
        inside, size = label >= 0, len(self.classes.base)
        times = np.where(at_base, 1.0, np.maximum(met.value, 0.0)) * inside
        doubt = np.where(at_base, 0.0, met.error) * inside
        period, off = (
            np.bincount(label[inside], x[inside], size).astype(np.float64) for x in (times, doubt)
        )
        off = off + gamma(len(label)) * period
        if not (period > off).all():
            raise SolverError(Status.NO_BOUND)
        mass, loose = np.maximum(arrivals.value, 0.0), arrivals.error
        own = self.classes.base[np.maximum(label, 0)]
        least = (period - off)[label]
        share = mass[own] * times / period[label] * inside
        error = (loose[own] * (times + doubt) + mass[own] * doubt + share * off[label]) / least
        return FixedPoint(value=share, error=(error + 8 * UNIT * share) * SLACK * inside)

    @cached_property
    def arrivals(self) -> FixedPoint:
        """(S,) expected visits from the start until a base, that arrival included."""
        if self.exact is not None:
            return self.exact[1]
        begin = self.mdp.start_distribution
        return transposed(self._averages.system(self.classes.at_base)).solve(begin, UNIT * begin)

    @cached_property
    def _averages(self) -> FloatAverages:
        return averages_of(self.mdp, self.weights, self.roundings)

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

        return pandas.DataFrame(
            {
                "state": self.mdp.space.labels(range(len(self.value))),
                "gain": self.value,
                "gain error": self.error,
                "bias": self.bias,
                "bias error": self.bias_error,
                "share": self.share.value,
                "share error": self.share.error,
            }
        )

    def __repr__(self) -> str:
        return f"AverageEvaluation(gain at the start {self.start})"


def evaluated(
    mdp: MDP, weights: Floats, roundings: int = 1, policy: Policy | None = None
) -> AverageEvaluation:
    """Return gain and bias of a policy, in a model at discount 1 whose rows sum to 1.

    Raises SolverError where double precision cannot bound them.
    """
    averages = averages_of(mdp, weights, roundings)
    label, inside, size = _sizes(averages.classes)
    first = mdp.pair_offsets[:-1]
    _, bias, second = averages.expansion(np.add.reduceat(weights * mdp.reward, first))
    step = _of_policy(mdp, gains(mdp, bias), weights, roundings)
    gain = bounded_gain(averages, step)
    rest = np.abs(step.value - gain.value) * (1 + UNIT) + step.error + gain.error
    still, at_base = np.zeros(len(label)), averages.classes.at_base
    away = averages.system(at_base).solve(still, np.where(at_base, 0.0, rest * SLACK)).error
    away_from_mean = gains(mdp, second, reward=-bias[mdp.pair_state])
    low, high = _between(_of_policy(mdp, away_from_mean, weights, roundings), label, size)
    most = np.zeros(size)
    np.maximum.at(most, label[inside], away[inside])
    off = (np.maximum(np.abs(low), np.abs(high)) + most)[label] + away
    if not inside.all():
        off = averages.system(inside).solve(still, np.where(inside, off, rest) * SLACK).error
    off = off * SLACK
    for array in (gain.value, gain.error, bias, off):
        array.setflags(write=False)
    return AverageEvaluation(
        mdp=mdp,
        weights=weights,
        roundings=roundings,
        policy=policy,
        classes=averages.classes,
        value=gain.value,
        error=gain.error,
        bias=bias,
        bias_error=off,
    )


def averages_of(mdp: MDP, weights: Floats, roundings: int = 1) -> FloatAverages:
    """Return the chain of a policy, given as probabilities of pairs (L,)."""
    shape, every = (mdp.n_states, mdp.n_pairs), np.arange(mdp.n_pairs)
    mixing = sp.csr_array((weights, (mdp.pair_state, every)), shape)
    mixing.eliminate_zeros()
    classes = Classes.of(graph_of(mdp, np.flatnonzero(weights)))
    return FloatAverages(sp.csr_array(mixing @ mdp.transition), classes, roundings)


def bounded_gain(averages: FloatAverages, step: FixedPoint) -> FixedPoint:
    """Return the gain (S,), from what a step of the policy adds to any values (S,)."""
    label, inside, size = _sizes(averages.classes)
    low, high = _between(step, label, size)
    middle, half = low / 2 + high / 2, (high - low) / 2
    half = half * SLACK + UNIT * (np.abs(low) + np.abs(high)) + TINY * (high != low)
    gain = FixedPoint(value=middle[label] * inside, error=half[label] * inside)
    return gain if inside.all() else averages.system(inside).solve(gain.value, gain.error)


def _of_policy(mdp: MDP, added: Gain, weights: Floats, roundings: int) -> FixedPoint:
    """Return (S,) what a step of a policy adds, from what each pair does."""
    first = mdp.pair_offsets[:-1]
    most = int(np.diff(mdp.pair_offsets).max()) + roundings + 2
    error = added.error + gamma(most) * np.abs(added.value)
    return FixedPoint(
        value=np.add.reduceat(weights * added.value, first),
        error=np.add.reduceat(weights * error, first) * SLACK,
    )


def _sizes(classes: Classes) -> tuple[Integers, Mask, int]:
    return classes.label, classes.recurrent, len(classes.base)


def _between(point: FixedPoint, label: Integers, size: int) -> tuple[Floats, Floats]:
    """Return (C,) the least and the greatest of numbers (S,) in each class, errors included."""
    low, high, inside = np.full(size, np.inf), np.full(size, -np.inf), label >= 0
    wide = point.error * SLACK + UNIT * np.abs(point.value)
    np.minimum.at(low, label[inside], (point.value - wide)[inside])
    np.maximum.at(high, label[inside], (point.value + wide)[inside])
    return low, high
