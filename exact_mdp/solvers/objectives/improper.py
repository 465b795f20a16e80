"""The reduction of policies without finite totals: a model of the policies that are compared.

At discount 1 a policy may never end, or end outside a goal. With c the amounts of a pair, oriented
so that more is better, its runs stay in end components, whose mean amounts g(μ) decide:

    c = 0 in all pairs      the run earns nothing more; these states become one, which may end
    g(μ) ≤ 0, not all 0     some total is -∞: no other policy is better, and this one drops out
    g_k(μ) > 0 for some k   a total grows without limit: there is no front, and it is refused

and with g = 0 for amounts that are not, totals may cancel forever, which is refused. With a goal a
run that misses it drops out, too, so that a component without amounts has to be left. The policies
that remain end in the new model, and have the same totals there. Since every other class of states
loses by some weights w ≥ 0 and gains by none, optima exist for all weights, and are attained by
policies that end (Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991).

The way back: a policy takes the pairs that its pairs were made of, and moves inside of a component
to the state from which it leaves. A component has one policy at a time: to stop in it with some
probability, and else to leave it, would take memory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_states, find_start_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.advice import ways_out, where_endless
from exact_mdp.mdp.table import Integers, Numbers, to_integer_array
from exact_mdp.solvers.endless.quotient import (
    Quotient,
    build_quotient,
    extract_components,
    merge_components,
)
from exact_mdp.solvers.exact.find import best_average

Column = tuple[Numbers, Numbers]


@dataclass(frozen=True, eq=False)
class FiniteTotals:
    """Which policies of a model at discount 1 have finite totals, and the model of these.

    Every pair of `ending` earns something if some objective has an amount there. A run has ended in
    its terminal states; if `given` has a goal, only in the goal.
    """

    given: MDP
    ending: MDP

    @cached_property
    def graph(self) -> PairGraph:
        """The graph of the pairs."""
        return PairGraph.of(self.ending)

    @cached_property
    def ended(self) -> Mask:
        """(S,) True where a run has ended as it should."""
        if self.given.goal is None:
            return self.ending.terminal
        return self.ending.terminal & self.given.goal

    @cached_property
    def applies(self) -> bool:
        """Whether some policy never ends, or ends outside the goal."""
        ends = self.ending.ends
        missed = self.given.ends.find_missed(self.ending.terminal)
        return not ends.every_policy_ends or bool(missed.any())

    # ---- the policies that are compared ------------------------------------------------------

    @cached_property
    def _idle(self) -> tuple[Integers, Mask]:
        """(S,) the end component without amounts of each state, or -1, and (L,) their pairs."""
        earned, _ = self.ending.table.expected_gain_exact
        idle = np.asarray(earned == 0, dtype=bool) & ~self.ended[self.ending.pair_state]
        return self.graph.end_components(idle)

    @cached_property
    def _sure(self) -> Mask:
        """(S,) True where some policy surely ends, or stays where nothing is earned."""
        every, havens = np.ones(self.ending.n_pairs, dtype=bool), self.ended
        if self.given.goal is None:
            havens = havens | (self._idle[0] >= 0)
        return np.asarray(self.graph.compute_rounds(havens, every) == 0)

    @cached_property
    def _kept(self) -> Mask:
        """(L,) True for pairs that some policy with finite totals may take."""
        safe = (self._sure & ~self.ended)[self.ending.pair_state]
        safe &= self.graph.find_pairs_within(self._sure)
        reached = find_reachable_states(self.ending, pairs=safe)
        return np.asarray(safe & reached[self.ending.pair_state])

    @cached_property
    def _merged(self) -> tuple[Integers, Mask]:
        """(S,) the merged component of each state, or -1, and (L,) the pairs inside."""
        component, inside = self._idle
        inside = inside & self._kept
        return np.where(self.graph.find_states_with(inside), component, -1), inside

    def apply(self) -> Quotient:
        """Return the model of the policies that are compared; they end in it.

        Raises ModelError if no policy from the start has finite totals, or if the best of all
        miss the goal.
        """
        if self.given.ends.missing_pays:
            self._require_goal()
        lost = np.flatnonzero(find_start_states(self.given) & ~self._sure)
        if len(lost):
            raise ModelError(
                "no policy from the start has finite totals",
                where=self.given.space.place(int(lost[0])),
                fix=ways_out(self.given),
            )
        # Components that are not left are ends, which only a model without a goal has.
        may_stop = self.given.goal is None
        pairs, new_state, stops = merge_components(
            self.graph, self._kept, self._merged, may_stop=may_stop
        )
        quotient = build_quotient(self.ending, np.flatnonzero(pairs), new_state, stops=stops)
        start = dict[int, Fraction]()
        for state, share in self.given.start:
            own = int(quotient.new_state[state])
            start[own] = start.get(own, Fraction(0)) + share
        return Quotient(
            mdp=quotient.mdp.with_(start=start, sense=self.given.sense),
            new_state=quotient.new_state,
            source=quotient.source,
        )

    def _require_goal(self) -> None:
        """Raise ModelError if a run may miss the goal."""
        component, _ = self.graph.end_components(~self.ended[self.ending.pair_state])
        missed = np.flatnonzero(find_reachable_states(self.given) & (component >= 0))
        if len(missed):
            raise ModelError(
                "a run that misses the goal is worth infinity, which is the best of all here",
                where=self.given.space.place(int(missed[0])),
                fix="count in the model itself, without --until, or leave out what leads there",
            )

    # ---- totals that grow without limit ------------------------------------------------------

    def require_no_growth(self, columns: Sequence[Column]) -> None:
        """Raise ModelError if a total may grow without limit, by columns of amounts (L,).

        Here and below each column is oriented so that more is better.
        """
        # Without a goal a policy may also earn where no policy ends.
        pairs = self._kept
        if self.given.goal is None:
            reached = find_reachable_states(self.given) & ~self.ended
            pairs = reached[self.ending.pair_state]
        if any(_find_gain_sign(self.ending, pairs, column) > 0 for column in columns):
            raise ModelError(
                "some policy never ends, and its totals at discount 1 would grow forever",
                where=where_endless(self.ending),
                fix=ways_out(self.given),
            )

    def require_loss(self, quotient: Quotient, columns: Sequence[Column]) -> None:
        """Raise ModelError unless policies that do not end in a quotient lose in some total."""
        # No mean is above 0: all are 0 where the mean of their sum is.
        after = [carry_over(quotient, column) for column in columns]
        below = np.lcm.reduce([under.astype(object) for _, under in after])
        total = sum(top.astype(object) * (below // under) for top, under in after)
        live = ~quotient.mdp.terminal[quotient.mdp.pair_state]
        if _find_gain_sign(quotient.mdp, live, (np.asarray(total), below)) >= 0:
            raise ModelError(
                "the totals of a policy that never ends may cancel forever, and have no limit",
                where=where_endless(self.ending),
                fix=ways_out(self.given),
            )

    # ---- the way back ------------------------------------------------------------------------

    def lift_pairs(self, quotient: Quotient, chosen: Integers) -> Integers:
        """Return pairs (S,) of the model, given a pair (S',) of each new state."""
        return quotient.lift_pairs(self.graph, self._merged, chosen)

    def restrict_visits(
        self, quotient: Quotient, visits: Mapping[int, Fraction]
    ) -> dict[int, Fraction]:
        """Return how often new pairs are visited, given the visits by a policy."""
        mdp, found = quotient.mdp, dict[int, Fraction]()
        left = [Fraction(0)] * mdp.n_states
        for state, share in mdp.start:
            left[state] += share
        for pair, source in enumerate(quotient.source.tolist()):
            number = visits.get(source, Fraction(0))
            if source < 0 or not number:
                continue
            found[pair] = number
            left[int(mdp.pair_state[pair])] -= number
            for share, after, _ in mdp.table.row(pair):
                left[after] += share * number
        # What enters a component and does not leave it stops there.
        for pair in np.flatnonzero(quotient.source < 0).tolist():
            if left[int(mdp.pair_state[pair])]:
                found[pair] = left[int(mdp.pair_state[pair])]
        return found


def carry_over(quotient: Quotient, column: Column) -> Column:
    """Return amounts (L',) of the pairs of a quotient; stops and the end have none."""
    (top, below), source = column, quotient.source
    from_pair = (source >= 0) & (source < len(top))
    amounts = np.where(from_pair, top[np.where(from_pair, source, 0)].astype(object), 0)
    under = np.where(from_pair, below[np.where(from_pair, source, 0)].astype(object), 1)
    return to_integer_array(amounts.tolist()), to_integer_array(under.tolist())


def _find_gain_sign(mdp: MDP, pairs: Mask, column: Column) -> int:
    """Return the sign of the greatest mean amount in end components of some pairs; -1 if none."""
    graph = PairGraph.of(mdp)
    component, inside = graph.end_components(pairs)
    amounts = np.asarray(column[0])
    # Without positive amounts the mean is 0 where a policy can stay by pairs that have none.
    if not (amounts[inside] > 0).any():
        _, idle = graph.end_components(inside & np.asarray(amounts == 0, dtype=bool))
        return int(idle.any()) - 1
    own = extract_components(mdp, component, inside)
    table = own.mdp.table.with_reward(*carry_over(own, column))
    _, (gain, *_) = best_average(own.mdp.with_(table=table))
    greatest = max(gain.top[:-1])  # the last state is an end, which none reaches
    return (greatest > 0) - (greatest < 0)
