"""Sweeps over a model's transitions: improve the values, follow a policy, judge what was reached.

An iterate is V = h + c w, kept as h (S,) and the shift c, with the weights w of
`solvers.bounds.bounds`. With d and the margins m as there,

    d_c(l) = d(l) - c m(l),   d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - leak(l) h(s)

is what pair l of state s would add to V(s). One pass over all pairs gives T V - V and a greedy
policy; one over the pairs of a policy gives T_π V - V. Where γ < 1 and no state is terminal, w is 1
and h can stay as small as values differ: what is lost by rounding values of size 1/(1 - γ) is then
not divided by 1 - γ a second time (relative value iteration, White, J. Math. Anal. Appl. 6, 1963;
bounds by MacQueen, J. Math. Anal. Appl. 14, 1966). A judging pass gives bounds V^π ≥ h + low w and
V* ≤ h + high w in which every rounding error is counted.

Models of fewer than `COMPILED` transitions are swept in NumPy, as loading compiled code takes
longer than solving them; `solvers.bounds.sweeps` sweeps larger ones.

What the passes over a large model leave for the next: upper bounds, a policy and its rows.

    q(l) = r(l) + γ Σ_s' P(l, s') h(s'),   q(l) now ≤ q(l) then + γ ρ

where ρ is the greatest rise of h in any state between the two. The rises of all steps since the
first are added up in `rise`, so that one number for each pair, q(l) less the rise until then, is
all that has to be kept, and a pair is looked at again only once that no longer proves it beaten.
What rounding may cost is added to each bound. Bounds of this kind eliminate actions in MacQueen,
Operations Research 15 (1967), and for one iteration at a time in Hastings and van Nunen, in Markov
Decision Theory (1977); here they also spare the last, judging pass most pairs.

The rows of the policy are copied side by side, each where the longest of its state's has room, as
reading them where they are would fetch from memory what lies between them, too.

Sweeps in compiled loops, on two threads, which leave out what is proven to be beaten.

Improving passes allow for rounding by the greatest error there can be in any pair, which costs next
to nothing; the judging pass counts the error of each. Both leave out pairs that are proven to be
beaten by what `solvers.bounds.sweeps` keeps. Every number is computed by one thread and minima do
not depend on an order, so the results are the same whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.mdp.threads import block_ends, run_blocks
from exact_mdp.solvers.bounds.gains import (
    COMPILED,
    SLACK,
    TINY,
    UNIT,
    Gain,
    RoundingFacts,
    Weights,
    gains,
    gamma,
    greedy,
    rounding_facts,
)
from exact_mdp.solvers.solution import SolverError, Status


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """What one pass over all pairs found around V = h + c w.

    Attributes
    ----------
    step : (S,)
        T V - V.
    low, high : float
        About h + low · w ≤ V^π ≤ V* ≤ h + high · w, for a greedy policy π.
    floor : float
        About how far rounding alone may keep low and high apart.
    """

    step: Floats
    low: float
    high: float
    floor: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged(Pass):
    """A pass whose bounds are proven: every rounding error is counted.

    Attributes
    ----------
    pairs : (S,) int64
        The policy π: the first pair of each state that no other beats by more than rounding.
    """

    pairs: Integers


Found = TypeVar("Found", bound=Pass)


@dataclass(eq=False)
class Sweeps:
    """The passes over one model with its verified weights.

    Attributes
    ----------
    mdp : MDP
    weights : Weights
    strict : bool
        Whether pairs count as tied only where the rounding errors of d let them be; otherwise those
        of V do too, so that actions that are as good show as such, once V is as good as it gets.
    """

    mdp: MDP
    weights: Weights
    strict: bool = False
    _pairs: Integers | None = field(default=None, init=False)
    _rows: tuple[Any, ...] = field(default=(None,), init=False)

    @cached_property
    def uniform(self) -> bool:
        """Whether a shift of all values is a shift by c w: γ < 1, and no state is terminal."""
        weight = self.weights.value
        alike = bool((weight == 1.0).all())
        return alike and self.mdp.discount < 1 and not self.mdp.terminal.any()

    @cached_property
    def facts(self) -> RoundingFacts:
        """What is known of the model's rounding errors."""
        return rounding_facts(self.mdp)

    @cached_property
    def least_margin(self) -> float:
        """A lower bound of all margins."""
        return float(self.weights.margin.min()) - self.weights.error

    @property
    def policy(self) -> Integers | None:
        """(S,) the pairs found by the last improving pass that looked at any transition."""
        return self._pairs

    def improve(self, value: Floats, shift: float = 0.0) -> Pass:
        """Return T V - V and a greedy policy, for V = `value` (S,) + `shift` w.

        Both arrays are used again by the next call, and the first by `follow`.

        Raises
        ------
        SolverError
            Where a value is beyond the range of floats.
        """
        found = self.judge(value, shift)
        self._pairs = found.pairs
        return found

    @np.errstate(over="ignore", invalid="ignore")
    def judge(self, value: Floats, shift: float = 0.0) -> Judged:
        """Return T V - V, a greedy policy and proven bounds; raises as `improve` does."""
        return finite(self._judge(value, shift))

    @np.errstate(over="ignore", invalid="ignore")
    def follow(self, value: Floats, shift: float) -> tuple[Floats, float, float]:
        """Return T_π V - V (S,) for the `policy`, and its least and greatest ratio to m.

        The ratios are rounded, without a claim about their error. The array is used again by the
        next call.
        """
        if self._pairs is None:
            raise ValueError("there is no policy yet")
        return self._follow(value, shift, self._pairs)

    def relax(self, value: Floats, shift: float, *, backward: bool) -> float:
        """Improve `value` (S,) in place, each state by what those before it have become.

        Returns the greatest change. Compiled for models of any size.
        """
        from exact_mdp.solvers.kernels import bellman

        mdp, matrix = self.mdp, self.mdp.transition
        rows = (mdp.pair_offsets, matrix.indptr, matrix.indices, matrix.data, mdp.reward)
        margin = self.weights.margin
        model = (*rows, self.facts.leak, margin, mdp.terminal, mdp.discount)
        return float(bellman.relax(backward, *model, value, shift))

    def _judge(self, value: Floats, shift: float) -> Judged:
        mdp, weights = self.mdp, self.weights
        first, live = mdp.pair_offsets[:-1], ~mdp.terminal
        gain = gains(mdp, value)
        shifted = gain.value - shift * weights.margin
        tied = gain.error if self.strict else gain.noise
        pairs = greedy(mdp, Gain(value=shifted, error=gain.error, noise=tied))
        step = np.where(live, np.maximum.reduceat(shifted, first), 0.0)
        if not live.any():
            return Judged(step=step, pairs=pairs, low=0.0, high=0.0, floor=0.0)
        open_pairs = live[mdp.pair_state]
        most = weights.ratio(gain.value + gain.error)[open_pairs]
        least = -weights.ratio(gain.error - gain.value)[pairs[live]]
        floor = gain.noise[open_pairs].max() / self.least_margin
        low, high = float(least.min()), float(most.max())
        return Judged(step=step, pairs=pairs, low=low, high=high, floor=float(floor))

    def _follow(self, value: Floats, shift: float, pairs: Integers) -> tuple[Floats, float, float]:
        mdp = self.mdp
        if self._rows[0] is not pairs:
            leak, margin = self.facts.leak[pairs], self.weights.margin[pairs]
            self._rows = (pairs, mdp.transition[pairs], mdp.reward[pairs], leak, margin)
        _, matrix, reward, leak, margin = self._rows
        counts = np.diff(matrix.indptr)
        ahead = matrix.data * (value[matrix.indices] - np.repeat(value, counts))
        flow = mdp.discount * np.add.reduceat(ahead, matrix.indptr[:-1])
        step = reward + (flow - leak * value) - shift * margin
        step[mdp.terminal] = 0.0
        ratio = (step / margin)[~mdp.terminal]
        return step, float(ratio.min(initial=np.inf)), float(ratio.max(initial=-np.inf))


def finite(found: Found) -> Found:
    """Return what a pass found; raises SolverError where its bounds are beyond floats."""
    if not np.isfinite(found.high - found.low):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return found


def sweeps_of(mdp: MDP, weights: Weights, *, strict: bool = False) -> Sweeps:
    """Return the sweeps for a model of its size; the size alone decides."""
    if mdp.n_transitions < COMPILED:
        return Sweeps(mdp, weights, strict)
    return CompiledSweeps(mdp, weights, strict)


@dataclass(eq=False)
class Remembered:
    """What passes around changing values h have found; see `solvers.kernels.bellman.improve`.

    Attributes
    ----------
    flow : tuple of float
        Bounds of γ Σ_s' P(l, s') over all pairs.
    margin : tuple of float
        Bounds of the margins of all pairs.
    ceilings : (L,)
        q(l) is at most this and `rise`. At first that is said of h = 0.
    pairs : (S,) int64
        The policy found by the last pass.
    slots, ends : (S+1,), (S,)
        Where its rows are in `indices` and `data`.
    chain : (3, S)
        Rewards, leaks and margins of its pairs.
    rise : float
        How much the greatest γ P_l h can have risen since the first pass, in the sum of all steps.
    before : (S,)
        h of the last pass.
    known : bool
        Whether there is a policy.
    """

    flow: tuple[float, float]
    margin: tuple[float, float]
    ceilings: Floats
    pairs: Integers
    slots: Numbers
    ends: Numbers
    indices: Numbers
    data: Floats
    chain: Floats
    before: Floats
    rise: float = 0.0
    known: bool = False

    @classmethod
    def nothing(cls, mdp: MDP, weights: Weights, facts: RoundingFacts) -> Remembered:
        """Return what is known of a model before any pass: q(l) = r(l) for h = 0."""
        leak, leak_error = facts.leak, facts.leak_error
        least, most = float(leak.min()) - leak_error, float(leak.max()) + leak_error
        lost = 4 * UNIT * (1 + abs(least) + abs(most))
        margin, matrix = weights.margin, mdp.transition
        longest = np.diff(matrix.indptr)
        if longest.min() < longest.max():
            longest = np.maximum.reduceat(longest, mdp.pair_offsets[:-1])
        else:
            longest = longest[: mdp.n_states]
        slots = np.zeros(mdp.n_states + 1, dtype=matrix.indptr.dtype)
        np.cumsum(longest, out=slots[1:])
        return cls(
            flow=(1 - most - lost, 1 - least + lost),
            margin=(float(margin.min()) - weights.error, float(margin.max()) + weights.error),
            ceilings=mdp.reward + 4 * facts.reward_error_bound(mdp),  # rounded, too
            pairs=np.empty(mdp.n_states, dtype=np.int64),
            slots=slots,
            ends=slots[:-1].copy(),
            indices=np.empty(slots[-1], dtype=matrix.indices.dtype),
            data=np.empty(slots[-1]),
            chain=np.empty((3, mdp.n_states)),
            before=np.zeros(mdp.n_states),
        )

    @property
    def rows(self) -> tuple[Numbers, Numbers, Numbers, Floats, Floats]:
        """The policy's rows, as compiled loops take them."""
        return self.slots, self.ends, self.indices, self.data, self.chain

    @property
    def alike(self) -> float:
        """A lower bound of m(l) / m(l') for any two pairs."""
        return self.margin[0] / self.margin[1] * (1 - 4 * UNIT)

    def drop(self, shift: float) -> float:
        """Return an upper bound of -c m(l) for any pair, c being the `shift`."""
        most = max(-shift * self.margin[0], -shift * self.margin[1])
        return most + 4 * UNIT * abs(most)

    def move(self, value: Floats) -> None:
        """Go on to h = `value` (S,)."""
        from exact_mdp.solvers.kernels.bellman import climb

        most = float(np.nextafter(climb(value, self.before), np.inf))
        grown = max(self.flow[0] * most, self.flow[1] * most)
        self.rise += grown + 4 * UNIT * (abs(grown) + abs(self.rise))


@dataclass(frozen=True, kw_only=True)
class _Sizes:
    """Of one h: how far apart its values are, and how large; and what bounds all pairs' d.

    `gain` bounds |d|, `error` its rounding error, `noise` that of V and q.
    """

    span: float
    value: float
    gain: float
    error: float
    noise: float


class CompiledSweeps(Sweeps):
    """As `Sweeps`, for large models."""

    @np.errstate(over="ignore", invalid="ignore")
    def improve(self, value: Floats, shift: float = 0.0) -> Pass:
        """See `Sweeps.improve`; where all values are the same, there is no policy to follow."""
        from exact_mdp.solvers.kernels import bellman

        mdp, sizes = self.mdp, self._sizes(value)
        if sizes.span == 0:
            return finite(self._alone(float(value[0]), shift, sizes))
        memory, step = self._memory, self._step
        memory.move(value)
        rounded = abs(memory.rise) + sizes.value + sizes.gain + sizes.error
        error = sizes.error + 8 * UNIT * rounded

        def work(first: int, last: int, extremes: Floats) -> None:
            bellman.improve(
                *(first, last, mdp.pair_offsets, *self._model, mdp.terminal, mdp.discount),
                *(value, shift, memory.known, memory.rise, error, memory.ceilings, *memory.rows),
                *(step, memory.pairs, extremes),
            )

        found = self._blocks(work, 2)
        self._pairs, memory.known = memory.pairs, True
        low, high = float(found[:, 0].min()), float(found[:, 1].max())
        return finite(Pass(step=step, low=low, high=high, floor=sizes.noise / self.least_margin))

    def _alone(self, value: float, shift: float, sizes: _Sizes) -> Pass:
        """Improve values that are all `value`: transitions add nothing, and are not read."""
        first, live = self.mdp.pair_offsets[:-1], ~self.mdp.terminal
        gain = self.mdp.reward if value == 0 else self.mdp.reward - self.facts.leak * value
        margin, floor = self.weights.margin, sizes.noise / self.least_margin
        step = np.maximum.reduceat(gain - shift * margin if shift else gain, first)
        if self.uniform:
            ratio = step / margin[first] + shift
        else:
            ratio = np.maximum.reduceat(gain / margin, first)
        ratio = ratio[live]
        low, high = float(ratio.min(initial=np.inf)), float(ratio.max(initial=-np.inf))
        if not live.any():
            low = high = 0.0
        return Pass(step=np.where(live, step, 0.0), low=low, high=high, floor=floor)

    def _judge(self, value: Floats, shift: float) -> Judged:
        from exact_mdp.solvers.kernels import bellman

        mdp, facts, weights, memory = self.mdp, self.facts, self.weights, self._memory
        step, pairs = np.empty(mdp.n_states), np.empty(mdp.n_states, dtype=np.int64)
        memory.move(value)
        sizes = self._sizes(value)
        tied, still = sizes.error if self.strict else sizes.noise, sizes.span == 0
        tiny = TINY * (1 + sizes.value)

        def work(first: int, last: int, extremes: Floats) -> None:
            bellman.judge(
                *(first, last, mdp.pair_offsets, *self._model, mdp.terminal, mdp.discount),
                *(facts.reward_error, facts.leak_error, weights.error, facts.merged, tiny),
                *(self._rounding, value, shift, self.strict, still),
                *(memory.known, memory.rise, memory.drop(shift) + tied, memory.alike),
                *(memory.ceilings, memory.pairs, *memory.rows),
                *(step, pairs, np.empty((2, self._most_pairs)), extremes),
            )

        found = self._blocks(work, 3)
        low, high, loudest = found[:, 0].min(), found[:, 1].max(), found[:, 2].max()
        floor = loudest / self.least_margin
        if mdp.terminal.all():
            low = high = floor = np.float64(0)
        return Judged(step=step, pairs=pairs, low=float(low), high=float(high), floor=float(floor))

    def _follow(self, value: Floats, shift: float, pairs: Integers) -> tuple[Floats, float, float]:
        from exact_mdp.solvers.kernels import bellman

        mdp, step, rows = self.mdp, self._step, self._memory.rows

        def work(first: int, last: int, extremes: Floats) -> None:
            bellman.follow(
                first, last, *rows, mdp.terminal, mdp.discount, value, shift, step, extremes
            )

        found = self._blocks(work, 2)
        return step, float(found[:, 0].min()), float(found[:, 1].max())

    def _blocks(self, work: Callable[[int, int, Floats], None], count: int) -> Floats:
        """Run `work` on all blocks of states; return what each left as its `count` extremes."""
        extremes = np.empty((len(self._ends) - 1, count))
        run_blocks(self._ends, lambda n, first, last: work(first, last, extremes[n]))
        return extremes

    def _sizes(self, value: Floats) -> _Sizes:
        """Return bounds for h = `value` (S,), which never have to look at a transition."""
        facts, (most_reward, most_leak, terms) = self.facts, self._greatest
        low, high = float(value.min()), float(value.max())
        span, size = high - low, max(abs(low), abs(high))
        rounded = float(gamma(terms + 8))
        # No row sums up to 1.001.
        flow, lost = 1.001 * self.mdp.discount * span, most_leak * size
        earned_error = facts.reward_error_bound(self.mdp)
        error = rounded * flow + float(gamma(4)) * (most_reward + lost)
        error += facts.leak_error * size + TINY * (1 + size) * (terms + 1) + earned_error
        error *= SLACK
        noise = rounded * (flow + size + most_reward) + error
        gain = most_reward + flow + lost + error
        return _Sizes(span=span, value=size, gain=gain, error=error, noise=noise)

    @cached_property
    def _greatest(self) -> tuple[float, float, int]:
        """The greatest size of a reward and of a leak, and the most roundings in a row."""
        sizes = [
            max(abs(float(array.min())), abs(float(array.max())))
            for array in (self.mdp.reward, self.facts.leak)
        ]
        return sizes[0], sizes[1], int(self.facts.terms(self.mdp, 0, self.mdp.n_pairs).max())

    @cached_property
    def _memory(self) -> Remembered:
        return Remembered.nothing(self.mdp, self.weights, self.facts)

    @cached_property
    def _model(self) -> tuple[Any, ...]:
        mdp, matrix = self.mdp, self.mdp.transition
        rows = (matrix.indptr, matrix.indices, matrix.data)
        return (*rows, mdp.reward, self.facts.leak, self.weights.margin)

    @cached_property
    def _ends(self) -> list[int]:
        return block_ends(self.mdp.transition.indptr[self.mdp.pair_offsets])

    @cached_property
    def _most_pairs(self) -> int:
        return int(np.diff(self.mdp.pair_offsets).max())

    @cached_property
    def _rounding(self) -> Floats:
        """γ(n + 8) of rows of n roundings."""
        return gamma(np.arange(self._greatest[2] + 1) + 8)

    @cached_property
    def _step(self) -> Floats:
        return np.empty(self.mdp.n_states)
