"""The reduction of improper policies in robust models at discount 1.

If the sets keep all outcomes possible, nature cannot change which states a pair may lead to. Then
the model itself has the same end components, and a policy reaches the same states with probability
1 in it, and `endless.improper` applies with three changes:

- What a pair earns is judged by all of its outcomes, as nature chooses their probabilities.
- Where a component has both gains and losses, g is the best gain against nature. With T the
  right side of the robust equation, T h > h for some h proves g > 0, and T h < h that g < 0; h is
  found as for an average reward (`average`).
- Pairs are left out so that every policy ends. The robust values V of the rest are right for the
  whole if each omitted pair is worth less than V. For let nature make its best choices at V. Under
  these rows V is not exceeded by a policy that ends; any other has a recurrent class with
  an omitted pair in it, hence with a negative gain, and is worth -∞.

If nature can make an outcome impossible, it may keep a run where the model itself would let it
leave. Then components of the other pairs become single states, and the rest has to end under all
distributions, which margins prove; infinite values are refused.

(Stochastic shortest paths: Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991;
robust ones with end components: Wolff, Topcu and Murray, CDC 2012.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.questions.advice import where_endless
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.endless.improper import ImproperPolicies
from exact_mdp.solvers.endless.quotient import (
    Quotient,
    build_quotient,
    choose_first_pairs,
    choose_nearer_pairs,
)
from exact_mdp.solvers.robust.average import bound_gains
from exact_mdp.solvers.robust.game import RobustModel

STEPS = 1000  # of the search for a gain; a few dozen are usual


@dataclass(frozen=True, eq=False)
class RobustImproperPolicies(RobustModel, ImproperPolicies):
    """The end components of a model of maximised rewards whose rows nature chooses."""

    def require_applicable(self) -> None:
        """Raise ModelError if nature can close a way, or if gains and losses may cancel."""
        if self.closed.any() and self.sign.any():
            raise self._refuse_closed_ways()
        if not self.applies:
            raise ModelError(
                "some policy never ends, and nature decides whether its gains or its losses are "
                "greater, or both +∞ and -∞ can be reached",
                where=where_endless(self.mdp),
                fix="choose a discount below 1",
            )

    def _refuse_closed_ways(self) -> ModelError:
        return ModelError(
            "some policy never ends, or misses the goal, and under some distributions within the "
            "sets an outcome is impossible",
            where=self.given.where(int(self.closed.argmax())),
            fix="choose smaller sets that keep every outcome possible, or a discount below 1",
        )

    # ---- what `ImproperPolicies` asks --------------------------------------------------------

    @cached_property
    def maximal(self) -> tuple[Integers, Mask]:
        """See `ImproperPolicies.maximal`: of pairs whose outcomes all remain possible."""
        outside = ~self.mdp.ends.destination[self.mdp.pair_state]
        return self.graph.end_components(outside & ~self.closed_of_mdp)

    @cached_property
    def reward_signs(self) -> tuple[Mask, Mask]:
        """(L,) True for pairs that earn in some outcome, and (L,) True for those that lose."""
        table = self.mdp.table
        earns, loses = (np.asarray(each, dtype=bool) for each in (table.gain > 0, table.gain < 0))
        if len(table.gain) == table.pairs:
            return earns, loses
        first = table.offsets[:-1]
        return np.logical_or.reduceat(earns, first), np.logical_or.reduceat(loses, first)

    def find_gain_signs(self, own: Quotient) -> Integers:
        """See `ImproperPolicies.find_gain_signs`."""
        return self._solve_gain(own)[0]

    @cached_property
    def applies(self) -> bool:
        """Whether signs decide.

        A gain that is unclear is not above 0, or else the values of the finite model are refused;
        but it may be 0, so that without a goal staying has no value.
        """
        if self.mdp.ends.has_goal:
            return True
        gain_sign, cancels = self.gains
        every = np.ones(self.mdp.n_pairs, dtype=bool)
        reachable = self.graph.compute_distance(gain_sign > 0, every) >= 0
        idle = self.zero_reward[0]
        with_idle = np.isin(self.maximal[0], np.unique(self.maximal[0][idle >= 0]))
        open_signs = cancels & ~with_idle & (self.sign <= 0)
        return not (open_signs | reachable & (self.sign <= 0)).any()

    def choose_pairs_that_earn(self, numbers: Integers, pairs: Integers) -> None:
        """See `ImproperPolicies.choose_pairs_that_earn`."""
        (component, inside), (earns, loses) = self.maximal, self.reward_signs
        # Without losses it is enough to come back to a pair that earns.
        mixed = np.unique(component[self.mdp.pair_state[inside & loses]])
        here = inside & np.isin(component, np.setdiff1d(numbers, mixed))[self.mdp.pair_state]
        earning = here & earns
        choose_nearer_pairs(self.graph, self.graph.find_states_with(earning), here, pairs)
        choose_first_pairs(self.graph, earning, pairs)
        # Otherwise the policy that proves the gain.
        chosen = np.isin(component, np.intersect1d(numbers, mixed))
        if chosen.any():
            own = self.extract_components(np.intersect1d(numbers, mixed))
            pairs[chosen] = own.source[self._solve_gain(own)[1]]

    def build_part(
        self, pairs: Mask, new_state: Integers, stops: Sequence[tuple[int, Fraction]] = ()
    ) -> Quotient:
        """Return a model of pairs of the given model, as its rows are what nature chooses."""
        own = np.flatnonzero(self.find_given_pairs(pairs))
        return build_quotient(self.given, own, new_state, stops=stops)

    # ---- gains -------------------------------------------------------------------------------

    def _solve_gain(self, own: Quotient) -> tuple[Integers, Integers]:
        """Return the sign of each state's gain, 0 if unclear, and pairs with a gain of this sign.

        `own` is a model of components, whose last state is an end that none reaches.
        """
        # Number the components from 0.
        states = own.new_state < own.mdp.n_states - 1
        component = np.unique(self.maximal[0][states], return_inverse=True)[1]
        number = np.append(component, component.max() + 1)
        found = bound_gains(self.build_game(own), number, 0.0, STEPS)
        return found.sign[component], found.pairs

    # ---- the finite model --------------------------------------------------------------------

    def omit_losing_pairs(self, whole: Quotient) -> Quotient:
        """Return the part of a finite model in which every policy ends; one policy does."""
        if self.weights is not None:
            return whole
        try:
            return whole.omit_losing_pairs(self.build_game(whole).improve_policy)
        except SolverError as error:
            if self.closed.any():
                raise self._refuse_closed_ways() from error
            raise

    def require_losses(self, whole: Quotient, part: Quotient, found: BoundedVector) -> None:
        """Raise SolverError unless the omitted pairs are worth less than the values of the part."""
        game = self.build_game(whole)
        left_out = ~np.isin(game.source, part.source)
        if not left_out.any():
            return
        high = np.nextafter(found.value + found.error, np.inf)
        low = np.nextafter(found.value - found.error, -np.inf)
        worth = game.solve_inner_problem(high).high
        if not (worth < low[game.live][game.row_state])[left_out].all():
            raise SolverError(Status.NO_BOUND, "staying forever loses too little a step")
