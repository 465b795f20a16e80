"""Sweeps over a model's transitions, compiled where the model is large enough to be worth it.

An iterate is V = h + c w, kept as h (S,) and the shift c, with the weights w of `solvers.bounds`.
With d and the margins m as there,

    d_c(l) = d(l) - c m(l),   d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - leak(l) h(s)

is what pair l of state s would add to V(s). One pass over all pairs gives T V - V, a greedy policy,
and bounds V^π ≥ h + low w and V* ≤ h + high w in which every rounding error is counted; one over
the pairs of a policy gives T_π V - V. Where γ < 1 and no state is terminal, w is 1 and h can stay
as small as values differ: what is lost by rounding values of size 1/(1 - γ) is then not divided by
1 - γ a second time (relative value iteration, White, J. Math. Anal. Appl. 6, 1963; bounds by
MacQueen, J. Math. Anal. Appl. 14, 1966).

Models of fewer than `COMPILED` transitions are swept in NumPy, as loading compiled code takes
longer than solving them. Blocks of states run on two threads; every number is computed by one of
them and minima do not depend on an order, so the results are the same whatever their number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.gains import COMPILED, Gain, RoundingFacts, gains, greedy, rounding_facts
from solvers.rounding import TINY
from solvers.solution import SolverError, Status

if TYPE_CHECKING:
    from solvers.bounds import Weights


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """What one pass over all pairs found around V = h + c w.

    Attributes
    ----------
    step : (S,)
        T V - V.
    pairs : (S,) int64
        The first pair of each state that no other beats by more than rounding: a policy π.
    low, high : float
        h + low · w ≤ V^π ≤ V* ≤ h + high · w.
    floor : float
        About how far rounding alone may keep low and high apart.
    """

    step: Floats
    pairs: Integers
    low: float
    high: float
    floor: float


@dataclass(frozen=True, eq=False)
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

    @property
    def compiled(self) -> bool:
        """Whether compiled loops are used; it depends on the model's size alone."""
        return self.mdp.n_transitions >= COMPILED

    @cached_property
    def uniform(self) -> bool:
        """Whether a shift of all values is a shift by c w: γ < 1, and no state is terminal."""
        weight = self.weights.value
        alike = bool((weight == 1.0).all())
        return alike and self.mdp.discount < 1 and not self.mdp.terminal.any()

    @cached_property
    def _facts(self) -> RoundingFacts:
        return rounding_facts(self.mdp)

    @cached_property
    def _ends(self) -> list[int]:
        from solvers.kernels.blocks import block_ends

        return block_ends(self.mdp.transition.indptr[self.mdp.pair_offsets])

    @cached_property
    def margin(self) -> Floats:
        """(L,) the margins, rounded."""
        return np.asarray(0.5 * (self.weights.least + self.weights.most))

    @np.errstate(over="ignore", invalid="ignore")
    def improve(self, value: Floats, shift: float = 0.0) -> Pass:
        """Return T V - V, a greedy policy and bounds, for V = `value` (S,) + `shift` w.

        Raises
        ------
        SolverError
            Where a value is beyond the range of floats.
        """
        found = (self._improve_compiled if self.compiled else self._improve)(value, shift)
        if not np.isfinite(found.high - found.low):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        return found

    @np.errstate(over="ignore", invalid="ignore")
    def follow(self, value: Floats, shift: float, pairs: Integers) -> tuple[Floats, float, float]:
        """Return T_π V - V (S,) for a policy's `pairs` (S,), and its least and greatest ratio to m.

        The ratios are rounded, without a claim about their error.
        """
        return (self._follow_compiled if self.compiled else self._follow)(value, shift, pairs)

    def relax(self, value: Floats, shift: float, *, backward: bool) -> float:
        """Improve `value` (S,) in place, each state by what those before it have become.

        Returns the greatest change. Compiled for models of any size.
        """
        from solvers.kernels import bellman

        return float(bellman.relax(backward, self.mdp.pair_offsets, *self._model, value, shift))

    # ---- in NumPy ----------------------------------------------------------------------------

    def _improve(self, value: Floats, shift: float) -> Pass:
        mdp, weights = self.mdp, self.weights
        first, live = mdp.pair_offsets[:-1], ~mdp.terminal
        gain = gains(mdp, value)
        shifted = gain.value - shift * self.margin
        tied = gain.error if self.strict else gain.noise
        pairs = greedy(mdp, Gain(value=shifted, error=gain.error, noise=tied))
        step = np.where(live, np.maximum.reduceat(shifted, first), 0.0)
        if not live.any():
            return Pass(step=step, pairs=pairs, low=0.0, high=0.0, floor=0.0)
        open_pairs = live[mdp.pair_state]
        most = weights.ratio(gain.value + gain.error)[open_pairs]
        least = -weights.ratio(gain.error - gain.value)[pairs[live]]
        floor = gain.noise[open_pairs].max() / self._least
        low, high = float(least.min()), float(most.max())
        return Pass(step=step, pairs=pairs, low=low, high=high, floor=float(floor))

    def _follow(self, value: Floats, shift: float, pairs: Integers) -> tuple[Floats, float, float]:
        mdp, matrix = self.mdp, self._rows(pairs)
        margin, leak = self.margin[pairs], self._facts.leak[pairs]
        counts = np.diff(matrix.indptr)
        ahead = matrix.data * (value[matrix.indices] - np.repeat(value, counts))
        flow = mdp.discount * np.add.reduceat(ahead, matrix.indptr[:-1])
        step = mdp.reward[pairs] + (flow - leak * value) - shift * margin
        step[mdp.terminal] = 0.0
        ratio = (step / margin)[~mdp.terminal]
        return step, float(ratio.min(initial=np.inf)), float(ratio.max(initial=-np.inf))

    def _rows(self, pairs: Integers) -> Any:
        """Return the rows of `pairs` (S,), those of the policy before where it is the same."""
        known = self.__dict__.get("_last")
        if known is None or known[0] is not pairs:
            known = (pairs, self.mdp.transition[pairs])
            self.__dict__["_last"] = known
        return known[1]

    # ---- compiled ----------------------------------------------------------------------------

    @cached_property
    def _model(self) -> tuple[Any, ...]:
        mdp, matrix, weights = self.mdp, self.mdp.transition, self.weights
        arrays = (matrix.indptr, matrix.indices, matrix.data, mdp.reward, self._facts.leak)
        return (*arrays, weights.least, weights.most, mdp.terminal, mdp.discount)

    @cached_property
    def _least(self) -> float:
        """The least margin of all."""
        return float(self.weights.least.min())

    @cached_property
    def _most_pairs(self) -> int:
        return int(np.diff(self.mdp.pair_offsets).max())

    def _blocks(self, work: Callable[[int, int, Floats], None], count: int) -> Floats:
        """Run `work` on all blocks of states; return what each left as its `count` extremes."""
        from solvers.kernels.blocks import run_blocks

        extremes = np.empty((len(self._ends) - 1, count))
        run_blocks(self._ends, lambda n, first, last: work(first, last, extremes[n]))
        return extremes

    def _improve_compiled(self, value: Floats, shift: float) -> Pass:
        from solvers.kernels import bellman

        mdp, facts = self.mdp, self._facts
        step, pairs = np.empty(mdp.n_states), np.empty(mdp.n_states, dtype=np.int64)
        still = bool(value.min() == value.max())
        tiny = TINY * (1 + float(np.abs(value).max()))
        indptr, indices, data, reward, leak, least, most, ended, rate = self._model

        def work(first: int, last: int, extremes: Floats) -> None:
            bellman.improve(
                *(first, last, mdp.pair_offsets, indptr, indices, data),
                *(reward, facts.reward_error, leak, facts.leak_error, least, most),
                *(ended, rate, facts.merged, value, shift, tiny),
                *(self.strict, still),
                *(step, pairs, np.empty((2, self._most_pairs)), extremes),
            )

        found = self._blocks(work, 3)
        low, high, loudest = found[:, 0].min(), found[:, 1].max(), found[:, 2].max()
        floor = loudest / self._least
        if mdp.terminal.all():
            low = high = floor = np.float64(0)
        return Pass(step=step, pairs=pairs, low=float(low), high=float(high), floor=float(floor))

    def _follow_compiled(
        self, value: Floats, shift: float, pairs: Integers
    ) -> tuple[Floats, float, float]:
        from solvers.kernels import bellman

        step = np.empty(self.mdp.n_states)

        def work(first: int, last: int, extremes: Floats) -> None:
            bellman.follow(first, last, pairs, *self._model, value, shift, step, extremes)

        found = self._blocks(work, 2)
        return step, float(found[:, 0].min()), float(found[:, 1].max())
