"""Sweeps over a model's transitions: improve the values, follow a policy, judge what was reached.

An iterate is V = h + c w, kept as h (S,) and the shift c, with the weights w of
`solvers.bounds.bounds`. With d and the margins m as there,

    d_c(l) = d(l) - c m(l),   d(l) = r(l) + γ Σ_s' P(l, s') (h(s') - h(s)) - (1 - γ) h(s)

is what pair l of state s would add to V(s). One pass over all pairs gives T V - V and a greedy
policy; one over the pairs of a policy gives T_π V - V. Where γ < 1 and no state is terminal, w is 1
and h can stay as small as values differ: what is lost by rounding values of size 1/(1 - γ) is then
not divided by 1 - γ a second time (relative value iteration, White, J. Math. Anal. Appl. 6, 1963;
bounds by MacQueen, J. Math. Anal. Appl. 14, 1966). A judging pass gives bounds V^π ≥ h + low w and
V* ≤ h + high w in which every rounding error is counted.

Models of fewer than `COMPILED` transitions are swept in NumPy, as loading compiled code takes
longer than solving them; once it is loaded, compiled loops find the same, bit for bit. Larger ones
are swept in compiled loops, on two threads, which leave out pairs that are proven to be beaten.
With

    q(l) = r(l) + γ Σ_s' P(l, s') h(s'),   q(l) now ≤ q(l) then + γ ρ,

ρ the greatest rise of h in any state between the two, one number for each pair, q(l) less the rise
until then, is all that has to be kept; a pair is looked at again only once that no longer proves it
beaten. What rounding may cost is added to each bound. Bounds of this kind eliminate actions in
MacQueen, Operations Research 15 (1967), and for one iteration at a time in Hastings and van Nunen,
in Markov Decision Theory (1977); here they also spare the last, judging pass most pairs.

Improving passes allow for rounding by the greatest error there can be in any pair, which costs next
to nothing; the judging pass counts the error of each. Every number is computed by one thread and
minima do not depend on an order, so the results are the same whatever the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from exact_mdp.mdp.forms.threads import block_ends, run_blocks
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import COMPILED, FLOAT_ROW_TOLERANCE, Floats, Integers
from exact_mdp.solvers.bounds.gains import (
    TINY,
    UNIT,
    Gain,
    RoundingFacts,
    Weights,
    added,
    gains,
    greedy,
    rounding_facts,
    roundings,
)
from exact_mdp.solvers.bounds.sizes import Greatest, Sizes, dropped, risen, sizes
from exact_mdp.solvers.solution import SolverError, Status

ASIDE = 8_000_000  # transitions of a model at most whose policies have their rows copied
FIRST_SWEEPS, APART, LEAST = 12, 6, 1e-12  # after which to ask how fast errors fall, and to where
ALIKE = 1e-6  # the part by which margins may differ that count as alike


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """What one pass over all pairs found around V = h + c w."""

    step: Floats  # (S,) T V - V
    low: float  # About h + low · w ≤ V^π ≤ V* ≤ h + high · w, for a greedy policy π
    high: float
    floor: float  # About how far rounding alone may keep low and high apart


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged(Pass):
    """A pass whose bounds are proven: every rounding error is counted."""

    pairs: Integers  # (S,) the first pair of each state that no other beats by more than rounding


Found = TypeVar("Found", bound=Pass)


@dataclass(eq=False)
class Sweeps:
    """The passes over one model with its verified weights.

    Where `strict`, pairs count as tied only where the rounding errors of d let them be; otherwise
    those of V do too, so that actions that are as good show as such, once V is as good as it gets.
    """

    mdp: MDP
    weights: Weights
    strict: bool = False
    _pairs: Integers | None = field(default=None, init=False)
    _rows: tuple[Any, ...] = field(default=(None,), init=False)

    @cached_property
    def uniform(self) -> bool:
        """Whether a shift of all values is one by c w: γ < 1, and no way leads to an end.

        Then nothing is left in a row but what it leaks.
        """
        live, rate = ~self.mdp.terminal, self.mdp.discount
        whole = rate < 1 and bool(live.any()) and bool((self.weights.value[live] == 1.0).all())
        return whole and self._most_margin <= 1 - rate + 2 * FLOAT_ROW_TOLERANCE

    @cached_property
    def alike(self) -> bool:
        """Whether a shift by c takes about as much from all pairs, and so favours none."""
        return self.uniform and self._most_margin <= (1 + ALIKE) * self.least_margin

    @cached_property
    def _most_margin(self) -> float:
        """An upper bound of the margins of all states that have not ended."""
        margin, ended = self.weights.margin, self.mdp.terminal
        open_pairs = margin[~ended[self.mdp.pair_state]] if ended.any() else margin
        return float(open_pairs.max()) + self.weights.error

    @cached_property
    def facts(self) -> RoundingFacts:
        """What is known of the model's rounding errors."""
        return rounding_facts(self.mdp)

    @cached_property
    def model(self) -> Any:
        """The model as compiled loops take it."""
        mdp, matrix = self.mdp, self.mdp.transition
        from exact_mdp.solvers.kernels import bellman

        return bellman.Model(
            offsets=mdp.pair_offsets,
            indptr=matrix.indptr,
            indices=matrix.indices,
            data=matrix.data,
            reward=mdp.reward,
            leak=self.facts.leak,
            margin=self.weights.margin,
            ended=mdp.terminal,
            discount=mdp.discount,
        )

    @cached_property
    def least_margin(self) -> float:
        """A lower bound of all margins."""
        return self.weights.extremes[0] - self.weights.error

    @cached_property
    def blur(self) -> float:
        """How far a margin may be off, as a part of it."""
        return self.weights.error / self.least_margin

    @property
    def policy(self) -> Integers | None:
        """(S,) the pairs found by the last improving pass that looked at any transition."""
        return self._pairs

    def improve(self, value: Floats, shift: float = 0.0, *, keep: bool = False) -> Pass:
        """Return T V - V and a greedy policy, for V = `value` (S,) + `shift` w.

        Both arrays are used again by the next call, and the first by `follow`. To `keep` a pair of
        the policy is to leave it only for one that is better by more than rounding.
        """
        found = self.judge(value, shift, self._pairs if keep else None)
        self._pairs = found.pairs
        return found

    @np.errstate(over="ignore", invalid="ignore")
    def judge(self, value: Floats, shift: float = 0.0, kept: Integers | None = None) -> Judged:
        """Return T V - V, a greedy policy and proven bounds; raises as `improve` does.

        Pairs that are `kept` (S,) stay where no other is better by more than rounding.
        """
        return finite(self._judge(value, shift, kept))

    @np.errstate(over="ignore", invalid="ignore")
    def follow(self, value: Floats, shift: float) -> tuple[Floats, float, float]:
        """Return T_π V - V (S,) for the `policy`, and its least and greatest ratio to m.

        The ratios are rounded, without a claim about their error. The array is used again by the
        next call.
        """
        if self._pairs is None:
            raise ValueError("there is no policy yet")
        return self._follow(value, shift, self._pairs)

    def settle(self, value: Floats, shift: float, goal: float, most: int) -> tuple[bool, float]:
        """Follow the policy until the error within it is at most `goal`; 0 asks for all there is.

        `value` (S,) changes in place. Returns whether `most` sweeps were enough, and the shift;
        sweeps end where errors that go on falling as they do would miss the goal. The error is
        that of V + δ w, δ the middle of the ratios d / m: where δ is more than the error, and no
        shift c takes it up, the values themselves have to move by it.
        """
        errors: list[float] = []
        while len(errors) < most:
            step, low, high = self.follow(value, shift)
            error = (high - low) / 2
            middle, idle = (low + high) / 2, goal == 0 and errors and not error < min(errors)
            if not self.uniform and (idle or not error > goal) and abs(middle) > error:
                value += middle * self.weights.value
                return True, shift
            if idle:
                return True, shift
            value += step
            if self.uniform:
                shift += self.mdp.discount * middle
            if not error > goal:
                return True, shift
            errors.append(error)
            if len(errors) >= FIRST_SWEEPS:
                rate = (error / errors[-APART]) ** (1 / (APART - 1))
                # Not of Python's floats, whose powers raise OverflowError where errors grow.
                if error * np.float64(rate) ** (most - len(errors)) > max(goal, LEAST * errors[0]):
                    break
        return False, shift

    def relax(self, value: Floats, shift: float, *, backward: bool) -> float:
        """Improve `value` (S,) in place, each state by what those before it have become.

        Returns the greatest change. Compiled for models of any size.
        """
        from exact_mdp.solvers.kernels import bellman

        return float(bellman.relax(backward, self.model, value, shift))

    def _judge(self, value: Floats, shift: float, kept: Integers | None) -> Judged:
        mdp, weights = self.mdp, self.weights
        first, live = mdp.pair_offsets[:-1], ~mdp.terminal
        gain = gains(mdp, value)
        shifted = gain.value - shift * weights.margin
        tied = gain.error if self.strict else gain.noise
        pairs = greedy(mdp, Gain(value=shifted, error=gain.error, noise=tied), keep=kept)
        step = np.where(live, np.maximum.reduceat(shifted, first), 0.0)
        if not live.any():
            return Judged(step=step, pairs=pairs, low=0.0, high=0.0, floor=0.0)
        open_pairs = live[mdp.pair_state]
        most = weights.ratio(gain.value + gain.error)[open_pairs]
        least = -weights.ratio(gain.error - gain.value)[pairs[live]]
        low, high = float(least.min()), float(most.max())
        floor = self._floor(float(gain.noise[open_pairs].max()), low, high)
        return Judged(step=step, pairs=pairs, low=low, high=high, floor=floor)

    def _floor(self, noise: float, low: float, high: float) -> float:
        """Return how far rounding of d, and of the margins, may keep these bounds apart."""
        return noise / self.least_margin + max(abs(low), abs(high)) * self.blur

    def _follow(self, value: Floats, shift: float, pairs: Integers) -> tuple[Floats, float, float]:
        mdp = self.mdp
        if self._rows[0] is not pairs:
            margin = self.weights.margin[pairs]
            self._rows = (pairs, mdp.transition[pairs], mdp.reward[pairs], margin)
        _, matrix, reward, margin = self._rows
        counts = np.diff(matrix.indptr)
        ahead = matrix.data * (value[matrix.indices] - np.repeat(value, counts))
        flow = mdp.discount * added(ahead, counts)
        step = reward + (flow - self.facts.leak * value) - shift * margin
        step[mdp.terminal] = 0.0
        ratio = (step / margin)[~mdp.terminal]
        return step, float(ratio.min(initial=np.inf)), float(ratio.max(initial=-np.inf))


def finite(found: Found) -> Found:
    """Return what a pass found; raises SolverError where its bounds are beyond floats."""
    if not np.isfinite(found.high - found.low):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return found


def sweeps_of(mdp: MDP, weights: Weights, *, strict: bool = False) -> Sweeps:
    """Return the sweeps for a model; what they find depends on its size alone."""
    if mdp.n_transitions < COMPILED:
        return Sweeps(mdp, weights, strict)
    return CompiledSweeps(mdp, weights, strict)


@dataclass(eq=False)
class Remembered:
    """What passes around changing values h have found; see `solvers.kernels.bellman.Known`.

    The rows of the policy are copied side by side, each where the longest of its state's has room,
    as reading them where they are would fetch from memory what lies between them, too: a tenth of
    the time of a solve. Of over `ASIDE` transitions that costs more memory than it is worth. At
    first q(l) = r(l) is what the ceilings say, of h = 0.
    """

    margin: tuple[float, float]  # bounds of the margins of all pairs
    policy: Any  # a Known: the policy, its rows and the ceilings
    before: Floats  # (S,) h of the last pass

    @classmethod
    def nothing(cls, mdp: MDP, weights: Weights, facts: RoundingFacts) -> Remembered:
        """Return what is known of a model before any pass."""
        matrix = mdp.transition
        slots = np.zeros(mdp.n_states + 1, dtype=matrix.indptr.dtype)
        indices, data = matrix.indices, matrix.data
        if len(data) <= ASIDE:
            lengths = matrix.indptr[1:] - matrix.indptr[:-1]
            longest = np.maximum.reduceat(lengths, mdp.pair_offsets[:-1])
            np.cumsum(longest, out=slots[1:])
        columns, room = np.empty(slots[-1], dtype=indices.dtype), np.empty(slots[-1])
        if len(room):
            indices, data = columns.view(), room.view()
            indices.flags.writeable = data.flags.writeable = False  # as the model's are
        from exact_mdp.solvers.kernels import bellman

        return cls(
            margin=(weights.extremes[0] - weights.error, weights.extremes[1] + weights.error),
            policy=bellman.Known(
                slots=slots[:-1],
                ends=slots[:-1].copy(),
                indices=indices,
                data=data,
                numbers=np.empty((2, mdp.n_states)),
                pairs=np.empty(mdp.n_states, dtype=np.int64),
                ceilings=mdp.reward + 4 * facts.reward_error_bound,  # rounded, too
                rise=0.0,
                known=False,
                columns=columns,
                weights=room,
            ),
            before=np.zeros(mdp.n_states),
        )

    @property
    def alike(self) -> float:
        """A lower bound of m(l) / m(l') for any two pairs."""
        return self.margin[0] / self.margin[1] * (1 - 4 * UNIT)

    def drop(self, shift: float) -> float:
        """Return an upper bound of -c m(l) for any pair, c being the `shift`."""
        return dropped(shift, *self.margin)

    def move(self, value: Floats, greatest: Greatest) -> None:
        """Go on to h = `value` (S,)."""
        from exact_mdp.solvers.kernels import bellman

        climb = float(bellman.climb(value, self.before))
        rise = risen(self.policy.rise, climb, greatest)
        self.policy = self.policy._replace(rise=rise)


class CompiledSweeps(Sweeps):
    """As `Sweeps`, for large models."""

    @property
    def alone(self) -> bool:
        """Whether passes are work for one thread, so that many of them may be one call."""
        return len(self._ends) == 2

    @np.errstate(over="ignore", invalid="ignore")
    def improve(self, value: Floats, shift: float = 0.0, *, keep: bool = False) -> Pass:
        """See `Sweeps.improve`; where all values are the same, there is no policy to follow.

        A pair is left only for one that is better as computed, asked to `keep` it or not.
        """
        (of, still), memory, step = self._sizes(value), self._memory, self._step
        if still:
            return finite(self._alone(float(value[0]), shift, of))
        memory.move(value, self._greatest)
        policy = memory.policy
        error = of.error + 8 * UNIT * (abs(policy.rise) + of.value + of.gain + of.error)
        what = policy, value, shift, error, memory.drop(shift), step
        from exact_mdp.solvers.kernels import bellman

        found = self._blocks(2, bellman.improve, self.model, *what)
        self._pairs, memory.policy = policy.pairs, policy._replace(known=True)
        low, high = float(found[:, 0].min()), float(found[:, 1].max())
        floor = self._floor(of.noise, low, high)
        return finite(Pass(step=step, low=low, high=high, floor=floor))

    def _alone(self, value: float, shift: float, of: Sizes) -> Pass:
        """Improve values that are all `value`: transitions add nothing, and are not read."""
        first, live = self.mdp.pair_offsets[:-1], ~self.mdp.terminal
        gain = self.mdp.reward if value == 0 else self.mdp.reward - self.facts.leak * value
        margin = self.weights.margin
        ratio = np.maximum.reduceat(gain / margin, first)
        low = float(ratio.min(initial=np.inf, where=live))
        high = float(ratio.max(initial=-np.inf, where=live))
        if not live.any():
            low = high = 0.0
        step = np.maximum.reduceat(gain - shift * margin if shift else gain, first)
        floor = self._floor(of.noise, low, high)
        return Pass(step=np.where(live, step, 0.0), low=low, high=high, floor=floor)

    def _judge(self, value: Floats, shift: float, kept: Integers | None) -> Judged:
        self._memory.move(value, self._greatest)
        of, still = self._sizes(value)
        tied = of.error if self.strict else of.noise
        spare = self._memory.drop(shift) + tied
        return self._judged(value, shift, of.value, spare, kept, still=still)

    def _judged(
        self,
        value: Floats,
        shift: float,
        size: float,
        spare: float,
        kept: Integers | None,
        *,
        still: bool,
    ) -> Judged:
        """Return the judging pass, for h = `value` (S,) of at most this `size`."""
        mdp, memory = self.mdp, self._memory
        step, pairs = np.empty(mdp.n_states), np.empty(mdp.n_states, dtype=np.int64)
        facts = self._known._replace(tiny=TINY * (1 + size) * bool(size))
        what = (self.model, facts, memory.policy, value, shift, self.strict, still)
        most, held = self._widest, pairs[:0] if kept is None else kept

        from exact_mdp.solvers.kernels import bellman

        def judge(first: int, last: int, extremes: Floats) -> None:
            room = np.empty((2, most))
            bellman.judge(
                first, last, *what, spare, memory.alike, held, step, pairs, room, extremes
            )

        found = self._blocks(3, judge)
        if mdp.terminal.all():
            return Judged(step=step, pairs=pairs, low=0.0, high=0.0, floor=0.0)
        low, high = float(found[:, 0].min()), float(found[:, 1].max())
        floor = self._floor(float(found[:, 2].max()), low, high)
        return Judged(step=step, pairs=pairs, low=low, high=high, floor=floor)

    def rounds(
        self, count: int, settings: dict[str, Any], state: dict[str, Any], value: Floats
    ) -> tuple[Any, Pass | None, bool, bool, int, int]:
        """Go through rounds of modified policy iteration; see `solvers.kernels.rounds`.

        `value` (S,) changes in place. The pass that has yet to be counted is given back.
        """
        most, states, memory = settings["most"], len(value), self._memory
        settings |= {
            "strict": self.strict,
            "uniform": self.uniform,
            "alike": self.alike,
            "least_margin": self.least_margin,
            "most_margin": memory.margin[1],
            "blur": self.blur,
        }
        step, extremes, pairs = np.empty(states), np.empty(3), memory.policy.pairs
        from exact_mdp.solvers.kernels import bellman
        from exact_mdp.solvers.kernels import rounds as loops

        reached, stopped, found, due, swept, left = loops.rounds(
            count,
            self.model,
            self._known,
            memory.policy,
            self._greatest,
            self.weights.value,
            loops.Settings(**settings),
            bellman.Slow(FIRST_SWEEPS, APART, LEAST),
            loops.State(**state, rise=memory.policy.rise, known=memory.policy.known),
            value,
            memory.before,
            step,
            pairs,
            np.empty((2, self._widest)),
            np.empty(most + 2),
            extremes,
        )
        memory.policy = memory.policy._replace(rise=reached.rise, known=reached.known)
        if reached.known:
            self._pairs, self._rows = pairs, (None,)
        if not found:
            return reached, None, stopped, due, swept, left
        low, high, floor = extremes.tolist()
        ahead = Pass(step=step, low=low, high=high, floor=floor)
        return reached, finite(ahead), stopped, due, swept, left

    def _follow(self, value: Floats, shift: float, pairs: Integers) -> tuple[Floats, float, float]:
        step, policy = self._step, self._memory.policy
        from exact_mdp.solvers.kernels import bellman

        found = self._blocks(2, bellman.follow, self.model, policy, value, shift, step)
        return step, float(found[:, 0].min()), float(found[:, 1].max())

    @np.errstate(over="ignore", invalid="ignore")
    def settle(self, value: Floats, shift: float, goal: float, most: int) -> tuple[bool, float]:
        """See `Sweeps.settle`."""
        if self._pairs is None or not self.alone:
            return super().settle(value, shift, goal, most)
        self._hold(self._pairs)
        from exact_mdp.solvers.kernels import bellman

        limits = bellman.Slow(FIRST_SWEEPS, APART, LEAST)
        what = (shift, float(goal), most, limits, self.uniform, self._step, np.empty(most + 2))
        known = self.model, self._memory.policy, self.weights.value
        done, shift = bellman.settle(*known, value, *what)
        return bool(done), float(shift)

    def _hold(self, pairs: Integers) -> None:
        """Have the rows of a policy side by side, as `improve` leaves them."""

    @property
    def held(self) -> Any:
        """The rows of the policy last followed, side by side: a `solvers.kernels.bellman.Known`."""
        return self._memory.policy

    def _blocks(self, count: int, work: Callable[..., None], *what: Any) -> Floats:
        """Run `work` on all blocks of states; return what each left as its `count` extremes."""
        extremes = np.empty((len(self._ends) - 1, count))
        run_blocks(self._ends, lambda n, first, last: work(first, last, *what, extremes[n]))
        return extremes

    def _sizes(self, value: Floats) -> tuple[Sizes, bool]:
        """Return bounds for h = `value` (S,), and whether all of it is the same."""
        low, high = float(value.min()), float(value.max())
        return sizes(low, high, self.mdp.discount, self._greatest), low == high

    @cached_property
    def _greatest(self) -> Greatest:
        facts, mdp = self.facts, self.mdp
        flow, off = 1 - facts.leak, facts.leak_error + 8 * UNIT
        return Greatest(
            reward=facts.size,
            leak=facts.leak,
            terms=int(facts.terms(mdp, 0, mdp.n_pairs).max()),
            reward_error=facts.reward_error_bound,
            leak_error=facts.leak_error,
            least_flow=flow - off,
            most_flow=flow + off,
        )

    @cached_property
    def _memory(self) -> Remembered:
        return Remembered.nothing(self.mdp, self.weights, self.facts)

    @cached_property
    def _ends(self) -> list[int]:
        return block_ends(self.mdp.transition.indptr[self.mdp.pair_offsets])

    @cached_property
    def _known(self) -> Any:
        """Rounding errors as the judging loop takes them."""
        from exact_mdp.solvers.kernels import bellman

        return bellman.Facts(
            reward_error=self._reward_error,
            leak_error=self.facts.leak_error,
            margin_error=self.weights.error,
            merged=self.facts.merged,
            tiny=0.0,
            rounding=self._rounding,
        )

    @cached_property
    def _widest(self) -> int:
        """The most pairs of a state."""
        return int((self.mdp.pair_offsets[1:] - self.mdp.pair_offsets[:-1]).max())

    @cached_property
    def _reward_error(self) -> Floats:
        return self.facts.reward_error

    @cached_property
    def _rounding(self) -> Floats:
        """γ(n + 8) of rows of n roundings."""
        return roundings(self._greatest.terms)

    @cached_property
    def _step(self) -> Floats:
        return np.empty(self.mdp.n_states)
