"""Values on their way to the optimum, the pass that bounds them, and the steps that improve them.

For values h, pair l of state s has the advantage

    d(l) = r(l) + γ P_l h - h(s),

in the form of `solvers.bounds.gains`, which keeps digits. The Bellman residual T h - h is the
greatest advantage of each state, and its pairs make a greedy policy π. With weights w and margins
m(l) = w(s) - γ P_l w > 0 (`solvers.bounds.bounds`),

    h + low w ≤ V^π ≤ V* ≤ h + high w,   low = min over π of d / m,   high = max of all d / m,

but for rounding. Passes over large models leave out pairs that are beaten, as values have not risen
enough since the last look at them to make up for it (MacQueen, Operations Research 15, 1967).

If no transition leads to an end (w = 1), values h need be right only up to a common constant, which
is held as the `level`: at the optimum the Bellman residual is T h - h = level instead of 0
(relative value iteration: White, J. Math. Anal. Appl. 6, 1963; bounds by MacQueen, J. Math. Anal.
Appl. 14, 1966). So h is as small as values differ, and loses no digits next to discount 1.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from exact_mdp.mdp.forms.threads import block_ends, run_blocks
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import COMPILED, Floats, Integers
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.bounds import Bounds, margin_weights
from exact_mdp.solvers.bounds.gains import RELATIVE_TOLERANCE, UNIT, largest_error, rounding_facts
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.claims import SolverError, Status

NEARLY_ONE = 1 - 1e-7  # from this discount on, values are too large to be solved for as they are
PATIENCE = 5  # passes without progress, after which only the equations of a policy help


class BellmanPass:
    """A pass over all pairs, and its last result.

    Attributes
    ----------
    pairs : (S,) integers
        The greedy policy; a pair stays unless another one is better as computed.
    residual : (S,) floats
        The Bellman residual T h - h.
    low, high : float
        The bounds h + low w and h + high w, without their rounding errors.
    policy_stays : bool
        Whether the greedy policy is the same as in the pass before.
    """

    def __init__(self, mdp: MDP) -> None:
        self.mdp = mdp
        self.weights = margin_weights(mdp)
        self.facts = rounding_facts(mdp)
        self.live = ~mdp.terminal
        self.is_large = mdp.n_transitions >= COMPILED or mdp.n_states > linear.FEW
        self.pairs: Integers = np.full(mdp.n_states, -1)
        self.residual: Floats = np.zeros(mdp.n_states)
        self.low = self.high = 0.0
        self.policy_stays = False
        self._error = 0.0  # the greatest rounding error of an advantage
        self._climbed = 0.0  # how much γ P h can have risen in all passes
        self._last_value: Floats = np.zeros(mdp.n_states)

    def run(self, value: Floats, bottom: float, top: float) -> None:
        """Pass over all pairs with values (S,), which lie between `bottom` and `top`."""
        last_pairs = self.pairs
        self._error = largest_error(self.mdp, bottom, top)
        if not self.live.any():
            self.pairs = self.mdp.pair_offsets[:-1]
            self.low = self.high = 0.0
        elif self.is_large:
            self._run_compiled(value, bottom, top)
        else:
            self._run_in_numpy(value)
        if not np.isfinite(self.half_gap):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        self.policy_stays = bool((self.pairs == last_pairs).all())

    @property
    def half_gap(self) -> float:
        """Half of the gap between the bounds, in units of w."""
        return (self.high - self.low) / 2

    def bound_rounding(self) -> float:
        """Return a limit on how far rounding can have moved the bounds."""
        return self.weights.bound_rounding(self._error, max(abs(self.low), abs(self.high)))

    def _run_in_numpy(self, value: Floats) -> None:
        """Pass over a small model in NumPy, as loading compiled loops takes longer."""
        mdp, state, margin = self.mdp, self.mdp.pair_state, self.weights.margin
        matrix, first = mdp.transition, mdp.pair_offsets[:-1]
        # Advantages are sums of differences, so large values cancel before they are added.
        following, here = self._ends_of_transitions
        steps = matrix.data * (value.take(following) - value.take(here))
        ahead = np.add.reduceat(steps, matrix.indptr[:-1])
        advantage = mdp.reward + (mdp.discount * ahead - self.facts.leak * value[state])
        self.residual = np.maximum.reduceat(advantage, first)
        # A pair gives way only to one that is better; then the first of the best ones is taken.
        pairs = np.where(self.pairs < 0, first, self.pairs)
        better = np.flatnonzero(self.residual > advantage[pairs])
        if len(better):
            places = np.flatnonzero(advantage == self.residual[state])
            pairs[better] = places[np.searchsorted(places, first[better])]
        self.pairs = pairs
        if self.weights.uniform:
            self.low = float(self.residual.min(where=self.live, initial=np.inf))
            self.high = float(self.residual.max(where=self.live, initial=-np.inf))
            self.low, self.high = self.low / float(margin[0]), self.high / float(margin[0])
        else:
            ratio = advantage / margin
            highest = np.maximum.reduceat(ratio, first)
            self.low = float(ratio[pairs].min(where=self.live, initial=np.inf))
            self.high = float(highest.max(where=self.live, initial=-np.inf))

    def _run_compiled(self, value: Floats, bottom: float, top: float) -> None:
        """Pass over a large model, blocks of states on as many threads as there are cores."""
        from exact_mdp.solvers.kernels import bellman

        mdp, ends, model = self.mdp, self._block_ends, self.compiled_model
        self.pairs, self.residual = self.pairs.copy(), np.empty(mdp.n_states)
        # r + γ P h of a pair is at most its ceiling and what γ P h has climbed since.
        climb = mdp.discount * float((value - self._last_value).max())
        self._climbed += climb + 4 * UNIT * (abs(climb) + abs(self._climbed))
        self._last_value = value.copy()
        size = 2 * (top - bottom) + max(-bottom, top) + self.facts.size
        slack = self._error + 16 * UNIT * (abs(self._climbed) + size)
        known = value, self.pairs, self._ceilings, self._climbed, slack, self.residual
        extremes = np.empty((len(ends) - 1, 2))

        def improve_block(number: int, first: int, last: int) -> None:
            bellman.improve_states(first, last, model, *known, extremes[number])

        run_blocks(ends, improve_block, mdp.n_transitions)
        self.low, self.high = float(extremes[:, 0].min()), float(extremes[:, 1].max())

    @cached_property
    def compiled_model(self) -> Any:
        """The model as compiled loops take it."""
        from exact_mdp.solvers.kernels import bellman

        return bellman.build_compiled_model(self.mdp, self.mdp.reward, self.weights.margin)

    @cached_property
    def _ends_of_transitions(self) -> tuple[Integers, Integers]:
        """The next state and the own state of each transition, (M,) each."""
        matrix = self.mdp.transition
        here = np.repeat(self.mdp.pair_state, np.diff(matrix.indptr))
        return matrix.indices.astype(np.int64), here

    @cached_property
    def _block_ends(self) -> list[int]:
        return block_ends(self.mdp.transition.indptr[self.mdp.pair_offsets])

    @cached_property
    def _ceilings(self) -> Floats:
        return np.asarray(self.mdp.reward + 2 * self.facts.most_reward_error)


class Values:
    """Values h (S,) on their way to V*, with the bounds of the last pass around them.

    Attributes
    ----------
    value : (S,) floats
        The values h; `level` says which constant they share with V*.
    search : BellmanPass
        The last pass over all pairs: residual, greedy policy, bounds.
    passes, idle : int
        The number of passes, and of the last ones that narrowed the bounds by less than a tenth.
    narrowest : float
        The least half of the gap between bounds so far.
    """

    def __init__(self, mdp: MDP, value: Floats) -> None:
        self.mdp, self.value = mdp, value
        self.search = BellmanPass(mdp)
        self.weights, self.live = self.search.weights, self.search.live
        self.level = 0.0
        self.passes, self.idle, self.narrowest = 0, 0, np.inf
        self._last_step = value.copy()  # the values that the last step of this class left
        self._state_by_state = False
        self._solved: tuple[Integers, LinearSystem] | None = None

    # ---- passes over all pairs -----------------------------------------------------------------

    def pass_over_pairs(self) -> None:
        """Find the Bellman residual, a greedy policy and bounds on V* for the present values."""
        if not np.array_equal(self.value, self._last_step):
            self._state_by_state = True
        bottom, top = self._centre_values()
        self.search.run(self.value, bottom, top)
        self.passes += 1
        # A gap between bounds has to fall by a tenth to count as progress.
        if self.search.half_gap < 0.9 * self.narrowest:
            self.narrowest, self.idle = self.search.half_gap, 0
        else:
            self.idle += 1

    def _centre_values(self) -> tuple[float, float]:
        """Move a large common constant of the values into the level; return their range."""
        is_free = self.weights.uniform and self.live.any()
        values = self.value
        if is_free and self.mdp.terminal.any():
            values = values[self.live]
        bottom, top = float(values.min()), float(values.max())
        middle = (top + bottom) / 2
        if is_free and abs(middle) > top - bottom:
            self.value = self.live * (self.value - middle)
            self.level += self.search.facts.leak * middle
            return bottom - middle, top - middle
        return bottom, top

    def default_tolerance(self) -> float:
        """Return the tolerance if none was given: a part of the greatest value."""
        centre = self.search.low / 2 + self.search.high / 2
        largest = float(np.abs(self.value + centre * self.weights.value).max())
        return RELATIVE_TOLERANCE * max(1.0, largest)

    def prove_bounds(self) -> Bounds:
        """Return the bounds of the pass, widened by the greatest effect that rounding can have."""
        wide = self.search.bound_rounding()
        return Bounds(
            value=self.value,
            weight=self.weights.value,
            pairs=self.search.pairs,
            low=self.search.low - wide,
            high=self.search.high + wide,
        ).centre_bounds()

    # ---- steps ---------------------------------------------------------------------------------

    def apply_backup(self) -> None:
        """Move on to T h, at the level between the bounds.

        Once states have been improved one by one, their errors differ, and a change of level could
        bring back more error than a sweep removes.
        """
        if not self._state_by_state:
            self._set_level()
        self._add_to_values(self.search.residual - self.level)

    def sweep_states(self) -> None:
        """Improve one state after the other, upward and then downward in number (Gauss-Seidel).

        Each state sees what the states before it have become, so one sweep carries values
        along a whole chain of states.
        """
        from exact_mdp.solvers.kernels import bellman

        upward = np.arange(self.mdp.n_states)
        for order in (upward, upward[::-1]):
            bellman.relax_states(order, self.search.compiled_model, self.value, self.level)

    def solve_policy_equations(self, *, closely: bool = False) -> None:
        """Move on to the values of the greedy policy: h + x, where x - γ P_π x = T_π h - h.

        A remaining residual counts 1 / (1 - γ) times as much in values: if policies are improved by
        these equations alone, they are solved `closely`, or policies may cycle forever.
        """
        residual = self.policy_residual()
        is_near_one = NEARLY_ONE < self.mdp.discount < 1
        if self.weights.uniform and self.live.any() and is_near_one:
            margin = self.live * self.weights.margin
            self.correct_values(*self.policy_system.solve_relatively(residual, margin))
        else:
            self.correct_values(self.policy_system.solve_roughly(residual, closely=closely))

    def policy_residual(self) -> Floats:
        """Return T_π h - h (S,) of the greedy policy, beyond the level between the bounds."""
        self._set_level()
        return self.live * (self.search.residual - self.level)

    def correct_values(self, correction: Floats, constant: float = 0.0) -> None:
        """Add a correction (S,); if only differences matter, its middle goes into the level."""
        if self.weights.uniform:
            middle = float(correction.max() + correction.min()) / 2
            correction = correction - middle
            self.level += self.search.facts.leak * (middle + constant)
        self._add_to_values(correction)

    def _add_to_values(self, change: Floats) -> None:
        """Add to the values of all states that are not terminal."""
        self.value = self.value + self.live * change
        self._last_step = self.value.copy()

    def _set_level(self) -> None:
        """Set the level to the middle between the bounds, if only differences matter."""
        if self.weights.uniform:
            middle = self.search.low / 2 + self.search.high / 2
            self.level = middle * float(self.weights.margin[0])

    @property
    def policy_system(self) -> LinearSystem:
        """The linear equations of the greedy policy, made once for each policy."""
        if self._solved is None or not np.array_equal(self._solved[0], self.search.pairs):
            self._solved = None  # two systems at once would take twice the memory
            chain, _ = policy_chain(self.mdp, self.search.pairs)
            self._solved = self.search.pairs, LinearSystem(chain, self.mdp.discount)
        return self._solved[1]
