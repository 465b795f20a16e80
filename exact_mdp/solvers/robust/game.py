"""The game of an agent that chooses pairs against, or with, a nature that chooses their rows.

A game is played in a model, or in a part of one whose states may be merged (`endless.quotient`). A
margin m > 0 of weights w > 0, as in `robust.robust`, proves that whatever both sides choose, every
run ends, or counts for less and less.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_nodes
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.gains import POLICIES, UNIT, Advantages, choose_greedy_pairs
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.endless.quotient import Quotient
from exact_mdp.solvers.robust.sets import (
    Ambiguity,
    Inner,
    list_entries,
    side_by_side,
    solve_inner_problem,
)
from exact_mdp.solvers.values.policy_chain import PolicyChain


class Game:
    """A model and nature's sets; T states that are not terminal, with U pairs that may be taken.

    `mdp` is the model that is played, of S states and L pairs, and `source` (U,) the pair of the
    given model whose set belongs to each row.
    """

    def __init__(
        self,
        given: MDP,
        ambiguity: Ambiguity,
        *,
        against: bool,
        weights: Floats | None,
        part: Quotient | None = None,
    ) -> None:
        """Nature minimises if `against`, else maximises.

        `weights`, by pairs of the given model, fix a policy. If a `part` is given, it is played.
        """
        table, mdp = given.table, given
        following, source, live = table.next, np.arange(given.n_pairs), ~given.terminal
        if part is not None:
            following, mdp, source = part.new_state[table.next], part.mdp, part.source
            # Its end comes last. Other states may earn 0 in the mean, and yet not under all rows.
            live = np.arange(mdp.n_states) < mdp.n_states - 1
        self.mdp, self.ambiguity, self.against, self.weights = mdp, ambiguity, against, weights
        self.rewards = True  # whether rewards count
        self.live = np.flatnonzero(live)
        # A given policy leaves only the pairs that it takes; where a part can stop, it does.
        taken = live[mdp.pair_state]
        if weights is not None:
            self.weights = np.where(source < 0, 1.0, np.append(weights, 0.0)[source])
            taken &= self.weights > 0
        self.pairs = np.flatnonzero(taken)
        self.source = source[self.pairs]
        state = mdp.pair_state[self.pairs]
        self.first = np.searchsorted(state, self.live)  # (T,) the first of each state's pairs
        self.row_state = np.searchsorted(self.live, state)  # (U,) the place of each state in `live`
        start, length = table.offsets[self.source], np.diff(table.offsets)[self.source]
        probability, gain = table.compute_probabilities(), table.compute_gains()
        # A pair that stops has one outcome, the end, behind the outcomes of the table.
        stops = np.flatnonzero(self.source < 0)
        if len(stops):
            start[stops], length[stops] = len(table.next) + np.arange(len(stops)), 1
            following = np.append(following, np.full(len(stops), mdp.n_states - 1))
            probability = np.append(probability, np.ones(len(stops)))
            gain = np.append(gain, mdp.reward[self.pairs[stops]])
        self.blocks = side_by_side(self.source, (start, length), (following, probability, gain))

    def solve_inner_problem(self, value: Floats) -> Inner:
        """Return nature's best distribution for each of `pairs`, at values (S,)."""
        return solve_inner_problem(
            self.ambiguity,
            self.blocks,
            value,
            discount=self.mdp.discount,
            against=self.against,
            rewards=self.rewards,
        )

    def choose_pairs(self, q: Floats) -> Floats:
        """Return (U,) the probability with which the agent takes each pair, given values (U,)."""
        if self.weights is not None:
            share = self.weights[self.pairs]
            return np.asarray(share / np.add.reduceat(share, self.first)[self.row_state])
        # The first of the best pairs in each state.
        best = np.maximum.reduceat(q, self.first)
        number = np.where(q == best[self.row_state], np.arange(len(q)), len(q))
        share = np.zeros(len(q))
        share[np.minimum.reduceat(number, self.first)] = 1.0
        return share

    def keep_pairs(self, share: Floats, asked: Inner, doubt: Floats) -> Floats:
        """Return shares (U,), as they are where no pair is better beyond rounding, `doubt` (T,)."""
        least = np.maximum.reduceat(asked.low, self.first) - doubt
        kept = self.average_pairs(share, asked.high) + doubt >= least
        return np.where(kept[self.row_state], share, self.choose_pairs(asked.value))

    def list_pairs(self, share: Floats) -> Integers:
        """Return (T,) the last pair of each state that the agent takes, given its shares (U,)."""
        return np.asarray(np.maximum.reduceat(np.where(share > 0, self.pairs, -1), self.first))

    def take_pairs(self, pairs: Integers) -> Floats:
        """Return the shares (U,) of a policy that takes one pair (S,) in each state."""
        return np.asarray(pairs[self.mdp.pair_state[self.pairs]] == self.pairs, dtype=np.float64)

    def average_pairs(self, share: Floats, q: Floats) -> Floats:
        """Return (T,) the mean of pair values (U,)."""
        return np.asarray(np.add.reduceat(share * q, self.first))

    def back_up_pairs(self, q: Floats) -> Floats:
        """Return (T,) the values of states, given pair values (U,)."""
        return self.average_pairs(self.choose_pairs(q), q)

    @property
    def terms(self) -> int:
        """The most pairs over which the value of a state is a mean."""
        if self.weights is None:
            return 1
        return int(np.diff(np.append(self.first, len(self.pairs))).max()) + 1

    def bound_rounding(self, value: Floats, asked: Inner) -> Floats:
        """Return (T,) the rounding of the mean over pairs and of the difference from the value."""
        size = np.abs(value[self.live]) + np.maximum.reduceat(np.abs(asked.value), self.first)
        return np.asarray(4 * UNIT * self.terms * size)

    def solve_chain(self, asked: Inner, share: Floats, order: Integers | None) -> Floats:
        """Solve for the values (S,) under nature's choice and the agent's shares (U,)."""
        chain, earned = self.build_chain(asked.distributions, share)
        return LinearSystem(chain, self.mdp.discount, order=order).approximate(earned)

    def build_chain(
        self, distributions: list[Floats], share: Floats
    ) -> tuple[sp.csr_array, Floats]:
        """Return transitions (S, S) and rewards (S,) under distributions and shares (U,)."""
        place, following, probability, earned = list_entries(self.blocks, distributions)
        source, states = self.live[self.row_state], self.mdp.n_states
        taken = share[place] > 0
        place, following, probability = place[taken], following[taken], probability[taken]
        parts = (probability * share[place], (source[place], following))
        total = np.bincount(source, weights=earned * share, minlength=states)
        return sp.csr_array(parts, (states, states)), np.asarray(total, dtype=np.float64)

    def solve_nature(self, value: Floats, share: Floats, order: Integers | None) -> Floats:
        """Return the values (S,) of the agent's shares (U,), nature's best choice against them.

        Nature improves its choice from the one that is best for `value`.
        """
        for _ in range(100):
            before = value
            value = self.solve_chain(self.solve_inner_problem(value), share, order)
            if not (np.abs(value - before) > 8 * UNIT * np.abs(before).max()).any():
                break
        return value

    def improve_policy(self, mdp: MDP, pairs: Integers) -> tuple[Integers, Floats, Advantages]:
        """Return pairs (S,), values (S,) and advantages (L,), as `bounds.improve_policy` does.

        `mdp` is the model that is played. Nature's choice is optimal for each policy in turn
        (Hoffman and Karp, Management Science 12, 1966).
        """
        before, owner = set[int](), mdp.pair_state[self.pairs]
        value, order = np.zeros(mdp.n_states), mdp.ends.most_steps
        for _ in range(POLICIES):
            before.add(hash(pairs.tobytes()))
            value = self.solve_nature(value, self.take_pairs(pairs), order)
            asked = self.solve_inner_problem(value)
            # Pairs of terminal states have no advantage.
            gain, noise, error = np.zeros((3, mdp.n_pairs))
            gain[self.pairs] = asked.value - value[owner]
            error[self.pairs] = asked.high - asked.low
            noise[self.pairs] = error[self.pairs] + 8 * UNIT * np.abs(value[owner])
            found = Advantages(value=gain, error=error, noise=noise)
            better = choose_greedy_pairs(mdp, found, keep=pairs)
            if hash(better.tobytes()) in before:
                break
            pairs = better
        return pairs, value, found


@dataclass(frozen=True, eq=False)
class RobustModel:
    """A model `given` of maximised rewards, whose rows nature chooses against or with the agent.

    `mdp` is this model, or if `weights` (L,) fix a policy, the model without other choices.
    """

    mdp: MDP
    given: MDP
    ambiguity: Ambiguity
    against: bool
    weights: Floats | None

    @classmethod
    def of(cls, given: MDP, ambiguity: Ambiguity, *, against: bool, weights: Floats | None) -> Self:
        """Return the robust model, of a policy alone if `weights` (L,) give one."""
        mdp = given
        if weights is not None:
            mdp = PolicyChain.of(given, weights).model
        return cls(mdp, given, ambiguity, against, weights)

    @cached_property
    def graph(self) -> PairGraph:
        """The graph of the pairs of `mdp`."""
        return PairGraph.of(self.mdp)

    @cached_property
    def closed(self) -> Mask:
        """(L,) True for pairs of which nature can make an outcome impossible.

        Only pairs that a policy takes count, and none of terminal states.
        """
        given = self.given
        closed = ~self.ambiguity.keeps_outcomes(given) & ~given.terminal[given.pair_state]
        return np.asarray(closed & self.find_given_pairs(np.ones(self.mdp.n_pairs, dtype=bool)))

    @property
    def closed_of_mdp(self) -> Mask:
        """True for the pairs of `mdp` of which nature can make an outcome impossible."""
        if self.weights is None:
            return self.closed
        return np.asarray(np.logical_or.reduceat(self.closed, self.given.pair_offsets[:-1]))

    def find_given_pairs(self, pairs: Mask) -> Mask:
        """Return (L,) True for the pairs of `given` that some pairs of `mdp` are made of."""
        if self.weights is None:
            return pairs
        return np.asarray((self.weights > 0) & pairs[self.given.pair_state])

    def build_game(self, part: Quotient | None = None) -> Game:
        """Return the game that is played in the given model, or in a part of it."""
        return Game(
            self.given, self.ambiguity, against=self.against, weights=self.weights, part=part
        )


def verify_margins(game: Game) -> tuple[Floats, Floats]:
    """Return weights (S,), and verified margins (T,) of the states that are not terminal."""
    # A game in which both sides maximise the number of steps.
    late = copy(game)
    late.against, late.rewards = False, False
    # Weights as in `bounds.bounds`: levels of an acyclic model, else 1, else expected steps.
    order = game.mdp.ends.most_steps
    if order is not None:
        weight = order.astype(np.float64)
    elif game.mdp.discount < 1:
        weight = (~game.mdp.terminal).astype(np.float64)
    else:
        weight = _maximise_expected_steps(late)
    # Verified by an upper bound on γ max Σ q w.
    later = late.back_up_pairs(late.solve_inner_problem(weight).high)
    later *= 1 + 4 * UNIT * (game.terms - 1)
    margin = np.asarray((weight[game.live] - later) * (1 - 4 * UNIT))
    if not np.all(margin > 0):
        what = "no margin against the worst distributions can be verified"
        raise SolverError(Status.NO_BOUND, what)
    return weight, margin


def _maximise_expected_steps(game: Game) -> Floats:
    """Estimate the greatest expected number of steps, by policy iteration on both choices."""
    mdp, live = game.mdp, ~game.mdp.terminal
    weight = live.astype(np.float64)
    for iteration in range(POLICIES):
        asked = game.solve_inner_problem(weight)
        gain = 1 + game.back_up_pairs(asked.value) - weight[game.live]
        # If no pair adds half a step or more, all margins exceed a half.
        if iteration and gain.max() < 0.5:
            return weight
        chain, _ = game.build_chain(asked.distributions, game.choose_pairs(asked.value))
        # The expected number of steps is infinite if some state has no way to the end.
        stuck = np.flatnonzero(~find_reachable_nodes(chain.T.tocsr(), mdp.terminal.copy()))
        if len(stuck):
            named = ", ".join(f"({label})" for label in mdp.space.labels(stuck[:4]))
            more = ""
            if len(stuck) > 4:
                more = f" and {len(stuck) - 4} more"
            raise ModelError(
                "discount 1 needs every episode to end, and under some distributions within the "
                "sets one does not",
                where=f"it stays forever among {named}{more}",
                fix="choose a discount below 1, or smaller sets that keep a way out possible",
            )
        weight = LinearSystem(chain).approximate(live.astype(np.float64))
        if not np.all(np.isfinite(weight)):
            break
    what = "the end is too many steps away under the worst distributions"
    raise SolverError(Status.NO_BOUND, what)
