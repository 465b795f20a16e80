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
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_states, find_start_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.advice import ways_out, where_endless
from exact_mdp.mdp.table import Numbers, to_integer_array
from exact_mdp.solvers.endless.improper import ImproperPolicies
from exact_mdp.solvers.endless.quotient import Quotient, extract_components
from exact_mdp.solvers.exact.find import best_average

Column = tuple[Numbers, Numbers]


@dataclass(frozen=True, eq=False)
class FiniteTotals(ImproperPolicies):
    """Which policies of a model at discount 1 have finite totals, and the model of these.

    In `mdp` every pair loses something if some objective has an amount there, and missing a goal of
    the `given` model is worth -∞: the policies with finite totals are those of finite values.
    """

    given: MDP

    # ---- the policies that are compared ------------------------------------------------------

    @cached_property
    def kept(self) -> Mask:
        """(L,) True for pairs that some policy with finite totals may take from the start."""
        safe = super().kept
        return safe & find_reachable_states(self.mdp, pairs=safe)[self.mdp.pair_state]

    def apply(self) -> Quotient:
        """Return the model of the policies that are compared; they end in it.

        Raises ModelError if no policy from the start has finite totals, or if the best of all
        miss the goal.
        """
        if self.given.ends.missing_pays:
            self._require_goal()
        lost = np.flatnonzero(find_start_states(self.given) & (self.sign < 0))
        if len(lost):
            raise ModelError(
                "no policy from the start has finite totals",
                where=self.given.space.place(int(lost[0])),
                fix=ways_out(self.given),
            )
        quotient, start = super().apply(), dict[int, Fraction]()
        for state, share in self.given.start:
            own = int(quotient.new_state[state])
            start[own] = start.get(own, Fraction(0)) + share
        return replace(quotient, mdp=quotient.mdp.with_(start=start, sense=self.given.sense))

    def _require_goal(self) -> None:
        """Raise ModelError if a run may miss the goal."""
        missed = np.flatnonzero(find_reachable_states(self.given) & (self.maximal[0] >= 0))
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
        pairs = self.kept
        if self.given.goal is None:
            reached = find_reachable_states(self.given) & ~self.mdp.terminal
            pairs = reached[self.mdp.pair_state]
        if any(_find_gain_sign(self.mdp, pairs, column) > 0 for column in columns):
            raise ModelError(
                "some policy never ends, and its totals at discount 1 would grow forever",
                where=where_endless(self.mdp),
                fix=ways_out(self.given),
            )

    def require_loss(self, quotient: Quotient, columns: Sequence[Column]) -> None:
        """Raise ModelError unless policies that do not end in a quotient lose in some total."""
        # No mean is above 0: all are 0 where the mean of their sum is.
        total = combine_columns([(Fraction(1), column) for column in columns])
        live = ~quotient.mdp.terminal[quotient.mdp.pair_state]
        if _find_gain_sign(quotient.mdp, live, carry_over(quotient, total)) >= 0:
            raise ModelError(
                "the totals of a policy that never ends may cancel forever, and have no limit",
                where=where_endless(self.mdp),
                fix=ways_out(self.given),
            )

    # ---- the way back ------------------------------------------------------------------------

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


def combine_columns(terms: Sequence[tuple[Fraction, Column]]) -> Column:
    """Return a linear combination of amounts (L,), over denominators (L,)."""
    below = np.lcm.reduce([f.denominator * under.astype(object) for f, (_, under) in terms])
    added = []
    for f, (top, under) in terms:
        added.append(top.astype(object) * (f.numerator * (below // (under * f.denominator))))
    return np.asarray(sum(added)), below


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
