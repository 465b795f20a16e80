"""Sweeps over a model's transitions: improve the values, follow a policy, judge what was reached.

An iterate is V = h + c w, kept as h (S,) and the shift c, with the weights w of `solvers.bounds`.
With d and the margins m as there,

    d_c(l) = d(l) - c m(l),   d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - leak(l) h(s)

is what pair l of state s would add to V(s). One pass over all pairs gives T V - V and a greedy
policy; one over the pairs of a policy gives T_π V - V. Where γ < 1 and no state is terminal, w is 1
and h can stay as small as values differ: what is lost by rounding values of size 1/(1 - γ) is then
not divided by 1 - γ a second time (relative value iteration, White, J. Math. Anal. Appl. 6, 1963;
bounds by MacQueen, J. Math. Anal. Appl. 14, 1966). A judging pass gives bounds V^π ≥ h + low w and
V* ≤ h + high w in which every rounding error is counted.

Models of fewer than `COMPILED` transitions are swept in NumPy, as loading compiled code takes
longer than solving them; `solvers.compiled_sweeps` sweeps larger ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.gains import COMPILED, Gain, RoundingFacts, gains, greedy, rounding_facts
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
        from solvers.kernels import bellman

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
    from solvers.compiled_sweeps import CompiledSweeps

    return CompiledSweeps(mdp, weights, strict)
