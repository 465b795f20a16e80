"""The reduction of improper policies at discount 1: infinite values, and a model of finite ones.

A run ends, or stays in an end component: states and pairs which a policy can use forever. The
states of a maximal end component reach each other, so its best mean reward g is one number:

    g > 0    stay in it: the value is +∞ wherever it can be reached without a risk of -∞
    g < 0    no optimal policy stays in it
    g = 0    without positive rewards, a policy stays by pairs without reward, or leaves

Pairs without reward form zero-reward end components: a policy can move between their states, or
stay, for nothing. Their states have one value, and become one state of the finite model, which may
end there. With a goal a run that never arrives has the value +∞ or -∞, so that staying does not end
it; if +∞ is better, a way to any end component is enough. Rewards of both signs may cancel in a
component: then exact levels decide (`exact.find`), not this reduction.

The way back: a state has the value of the state that it became, or an infinite one; in a merged
component a policy moves to the state from which the finite model leaves it (de Alfaro, Formal
Verification of Probabilistic Systems, 1997, chapters 3 and 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf

import numpy as np

from exact_mdp.mdp.graph import Mask, PairGraph
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import SolverError
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.endless.average import solve_average
from exact_mdp.solvers.endless.quotient import (
    Quotient,
    build_quotient,
    choose_first_pairs,
    choose_nearer_pairs,
)
from exact_mdp.solvers.exact.find import best_average, no_falling
from exact_mdp.solvers.solution import Solution


@dataclass(frozen=True, eq=False)
class ImproperPolicies:
    """The end components of a model of maximised rewards, and the signs of its infinite values."""

    mdp: MDP

    @cached_property
    def graph(self) -> PairGraph:
        """The graph of the pairs."""
        return PairGraph.of(self.mdp)

    # ---- end components ----------------------------------------------------------------------

    @cached_property
    def maximal(self) -> tuple[Integers, Mask]:
        """(S,) the maximal end component of each state, or -1, and (L,) the pairs in them.

        Ends are left out.
        """
        return self.graph.end_components(~self.mdp.ends.destination[self.mdp.pair_state])

    @cached_property
    def reward_signs(self) -> tuple[Mask, Mask]:
        """(L,) True for the pairs that earn something, and (L,) True for those that lose."""
        earned = self.mdp.table.expected_gain_exact[0]
        return np.asarray(earned > 0, dtype=bool), np.asarray(earned < 0, dtype=bool)

    @cached_property
    def zero_reward(self) -> tuple[Integers, Mask]:
        """(S,) the zero-reward end component of each state, or -1, and (L,) the pairs in them."""
        (component, inside), (earns, loses) = self.maximal, self.reward_signs
        rewarded = earns | loses
        if not rewarded[inside].any():
            return component, inside
        return self.graph.end_components(inside & ~rewarded)

    @cached_property
    def gains(self) -> tuple[Integers, Mask]:
        """(S,) the sign of the best gain of each state's component, and whether rewards may cancel.

        The sign is -1 outside of components. Rewards of one sign decide it, and a zero-reward
        component makes it at least 0. With both signs the best gain is computed; if floats cannot
        tell its sign, it counts as 0.
        """
        (component, inside), (earns, loses) = self.maximal, self.reward_signs
        count = int(component.max(initial=-1)) + 1

        def have_some(where: Mask, number: Integers) -> Mask:
            return np.bincount(number[where], minlength=count) > 0

        owner = component[self.mdp.pair_state]
        gains, losses = have_some(inside & earns, owner), have_some(inside & loses, owner)
        zero = have_some(self.zero_reward[0] >= 0, component)
        sign = np.where(gains, 1, np.where(zero, 0, -1))
        both = np.flatnonzero(gains & losses)
        if len(both):
            # All states of a component have the same gain.
            own = component[np.isin(component, both)]
            sign[own] = self.find_gain_signs(self.extract_components(both))
        cancels = gains & losses & (sign == 0)
        return np.append(sign, -1)[component], np.append(cancels, False)[component]

    def find_gain_signs(self, own: Quotient) -> Integers:
        """Return the sign of the best gain of each state of a model of components, 0 if unclear."""
        best, signs = _solve_gain_in_floats(own), np.zeros(own.mdp.n_states - 1, dtype=np.int64)
        if best is not None:
            signs += (best.value > best.error)[:-1]
            signs -= (best.value < -best.error)[:-1]
        return signs

    # ---- signs of values ---------------------------------------------------------------------

    @cached_property
    def sign(self) -> Integers:
        """(S,) 1 where the value is +∞, -1 where it is -∞, 0 where it is finite."""
        mdp, graph, every = self.mdp, self.graph, np.ones(self.mdp.n_pairs, dtype=bool)
        # If missing the goal pays +∞, a way to any end component is enough.
        if mdp.ends.missing_pays:
            return np.where(graph.compute_distance(self.maximal[0] >= 0, every) >= 0, 1, 0)
        gain_sign, _ = self.gains
        # Safe states: some policy avoids -∞ with probability 1.
        havens = mdp.ends.destination
        if not mdp.ends.has_goal:
            havens = havens | (gain_sign >= 0)
        safe = graph.compute_rounds(havens, every) == 0
        # The value is +∞ if a component of positive gain can be reached along safe states.
        positive = (gain_sign > 0) & safe
        above = safe & (graph.compute_distance(positive, graph.find_pairs_within(safe)) >= 0)
        if mdp.ends.has_goal:
            no_falling(mdp, above)
        return np.where(above, 1, np.where(safe, 0, -1))

    @cached_property
    def applies(self) -> bool:
        """Whether signs decide, and exact levels are not needed.

        They do not if rewards may cancel, or if +∞ can be reached only at a risk of -∞.
        """
        ends, every = self.mdp.ends, np.ones(self.mdp.n_pairs, dtype=bool)
        if ends.missing_pays:
            return True
        gain_sign, cancels = self.gains
        open_signs = cancels & (self.sign == 0)
        if not ends.has_goal:
            reachable = self.graph.compute_distance(gain_sign > 0, every) >= 0
            open_signs |= reachable & (self.sign <= 0)
        return not open_signs.any()

    # ---- the finite model --------------------------------------------------------------------

    @cached_property
    def kept(self) -> Mask:
        """(L,) True for pairs of states of finite values, ends apart, that lead only to such."""
        finite = self.sign == 0
        live = finite & ~self.mdp.ends.destination
        return np.asarray(live[self.mdp.pair_state] & self.graph.find_pairs_within(finite))

    @cached_property
    def _merged(self) -> tuple[Integers, Mask]:
        """The zero-reward components of finite values, as `zero_reward`."""
        component, inside = self.zero_reward
        inside = inside & self.kept
        return np.where(self.graph.find_states_with(inside), component, -1), inside

    def apply(self) -> Quotient:
        """Return the model of the finite values, in which each zero-reward component is one state.

        Some of its policies may still be improper: they lose in cycles.
        """
        # Components are left by pairs that are kept; states that no pair leaves become the end.
        graph, (component, inside) = self.graph, self._merged
        pairs = self.kept & ~inside
        left = graph.find_states_with(pairs)
        numbers = np.unique(component[left & (component >= 0)])
        new_state = np.full(graph.states, -1)
        joined, single = np.isin(component, numbers), left & (component < 0)
        new_state[joined] = np.searchsorted(numbers, component[joined])
        new_state[single] = len(numbers) + np.arange(int(single.sum()))
        # Without a goal, a run may also stop in a component.
        stops = list[tuple[int, Fraction]]()
        if not self.mdp.ends.has_goal:
            stops = [(number, Fraction(0)) for number in range(len(numbers))]
        return self.build_part(pairs, new_state, stops)

    def build_part(
        self, pairs: Mask, new_state: Integers, stops: Sequence[tuple[int, Fraction]] = ()
    ) -> Quotient:
        """Return the model of some pairs (L,) between new states, as `build_quotient` does."""
        return build_quotient(self.mdp, np.flatnonzero(pairs), new_state, stops=stops)

    # ---- the way back ------------------------------------------------------------------------

    def lift_values(self, part: Quotient, solution: Solution | BoundedVector) -> BoundedVector:
        """Return the values (S,) of the model, given a solution of its finite model."""
        value, error = solution.value[part.new_state], solution.error[part.new_state]
        value[self.sign > 0], value[self.sign < 0] = inf, -inf
        return BoundedVector(value=value, error=np.where(self.sign == 0, error, 0.0))

    def lift_policy(self, part: Quotient, chosen: Integers) -> Integers:
        """Return the policy (S,) of the model, given pairs (S',) of its finite model."""
        pairs = part.lift_pairs(self.graph, self._merged, chosen)
        if (self.sign > 0).any():
            self._choose_earning_pairs(pairs)
        return pairs

    def _choose_earning_pairs(self, pairs: Integers) -> None:
        """Write into `pairs` (S,) a policy that attains +∞ where the value is that."""
        # Stay in the components that earn it, or that miss a goal if missing pays.
        mdp, graph, (component, _) = self.mdp, self.graph, self.maximal
        if mdp.ends.missing_pays:
            earning = component >= 0
            inside = graph.find_pairs_within(earning) & earning[mdp.pair_state]
            choose_first_pairs(graph, inside, pairs)
        else:
            earning = (self.sign > 0) & (self.gains[0] > 0)
            self.choose_pairs_that_earn(np.unique(component[earning]), pairs)
        # Elsewhere go there along safe states.
        safe = graph.find_pairs_within(self.sign >= 0) & (self.sign > 0)[mdp.pair_state]
        choose_nearer_pairs(graph, earning, safe, pairs)

    def choose_pairs_that_earn(self, numbers: Integers, pairs: Integers) -> None:
        """Write into `pairs` (S,) a policy that stays in components, with a positive gain."""
        own = self.extract_components(numbers)
        best = _solve_gain_in_floats(own)
        if best is not None and (best.value > best.error)[:-1].all():
            used = best.pairs
        else:
            used = best_average(own.mdp)[0]
        pairs[np.isin(self.maximal[0], numbers)] = own.source[used[:-1]]

    def extract_components(self, numbers: Integers) -> Quotient:
        """Return maximal end components as a model of their own, with an end that none reaches."""
        component, inside = self.maximal
        chosen = np.isin(component, numbers)
        new_state = np.where(chosen, np.cumsum(chosen) - 1, -1)
        return self.build_part(inside & chosen[self.mdp.pair_state], new_state)


def _solve_gain_in_floats(own: Quotient) -> Solution | None:
    """Return the best average reward in floats; None if floats cannot bound it."""
    try:
        return solve_average(own.mdp, PolicyIteration())
    except SolverError:
        return None
