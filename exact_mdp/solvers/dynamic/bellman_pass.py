"""One pass over all pairs: the Bellman residual of values, a greedy policy, and bounds on V*.

For values h, pair l of state s has the advantage

    d(l) = r(l) + γ P_l h - h(s),

in the form of `solvers.bounds.gains`, which keeps digits. The Bellman residual T h - h is the
greatest advantage of each state, and its pairs make a greedy policy π. With weights w and margins
m(l) = w(s) - γ P_l w > 0 (`solvers.bounds.bounds`),

    h + low w ≤ V^π ≤ V* ≤ h + high w,   low = min over π of d / m,   high = max of all d / m,

but for rounding. Passes over large models leave out pairs that are beaten, as values have not risen
enough since the last look at them to make up for it (MacQueen, Operations Research 15, 1967).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from exact_mdp.mdp.forms.threads import block_ends, run_blocks
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import COMPILED, Floats, Integers
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.bounds.gains import UNIT, largest_error, rounding_facts
from exact_mdp.solvers.claims import SolverError, Status


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
