"""Sweeps in compiled loops, on two threads, which leave out what is proven to be beaten.

Improving passes allow for rounding by the greatest error there can be in any pair, which costs next
to nothing; the judging pass counts the error of each. Both leave out pairs that are proven to be
beaten by what `solvers.remembered` keeps. Every number is computed by one thread and minima do not
depend on an order, so the results are the same whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mdp.table import Floats, Integers
from mdp.threads import block_ends, run_blocks
from solvers.kernels import bellman
from solvers.remembered import Remembered
from solvers.rounding import SLACK, TINY, UNIT, gamma
from solvers.sweeps import Judged, Pass, Sweeps, finite


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
        ended, rate, step, rows = (
            self.mdp.terminal,
            self.mdp.discount,
            self._step,
            self._memory.rows,
        )

        def work(first: int, last: int, extremes: Floats) -> None:
            bellman.follow(first, last, *rows, ended, rate, value, shift, step, extremes)

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
