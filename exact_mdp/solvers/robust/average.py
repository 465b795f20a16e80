"""Robust average rewards per step: the gain of a game in which nature chooses the rows.

Let (T h)(s) = max over pairs l of s of min over q in U_l of Σ q_i (r_i + h(s_i)), or with max and
min exchanged on either side. For any h, and wherever a run stays,

    least T h - h  ≤  gain  ≤  greatest T h - h,

the first for the policy that attains T h, the second for nature's choice at h. Where all
states have one gain, policy iteration brings both together: h solves g + h = r + P h for a policy
and nature's best choice against it (Hoffman and Karp, Management Science 12, 1966). So does value
iteration, h ← h + (T h - h) / 2, if policies go in circles (Ishikawa, Proceedings of the American
Mathematical Society 59, 1976, as T does not expand distances).

If the sets keep all outcomes possible, nature cannot change which states a pair may lead to. In an
end component a policy can then go from any state to any other, so that it has one gain. What it is
worth to reach the component is a total: each becomes one state, where the agent may stop for the
gain, and every run ends. If nature can make an outcome impossible, one state has to be visited
again and again whatever both sides choose; then all states have one gain.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask, PairGraph
from exact_mdp.mdp.table import Floats, Integers, make_ones
from exact_mdp.solvers.bounds.gains import RELATIVE_TOLERANCE, SLACK, UNIT
from exact_mdp.solvers.bounds.linear import LinearSystem, select_rows
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.endless.chain import Classes
from exact_mdp.solvers.endless.quotient import (
    Quotient,
    choose_nearer_pairs,
    extract_components,
    stop_in_components,
)
from exact_mdp.solvers.robust.game import Game, RobustModel
from exact_mdp.solvers.robust.sets import Inner


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Bounds on the gains of C components of a game, and the choices that attain them."""

    low: Floats  # (C,)
    high: Floats  # (C,)
    bias: Floats  # (S,) the h that proves them
    pairs: Integers  # (T,) the pair that the agent takes in each state
    status: Status = Status.ITERATION_LIMIT
    iterations: int = 0

    @property
    def sign(self) -> Integers:
        """(C,) the sign of each gain, 0 if it is unclear."""
        return (self.low > 0).astype(np.int64) - (self.high < 0)

    @property
    def middle(self) -> Floats:
        """(C,) numbers between the bounds."""
        return self.low / 2 + self.high / 2

    @property
    def error(self) -> float:
        """The greatest distance of a gain from `middle`."""
        half = (self.high - self.low) / 2 + UNIT * (np.abs(self.low) + np.abs(self.high))
        return float(half.max()) * SLACK


def bound_gains(game: Game, number: Integers, tol: float | None, max_iterations: int) -> Gains:
    """Return bounds on the gain of each component; they hold whatever the status is.

    `number` (S,) is the component of each state, of which no pair leads to another one; the end
    comes last, in states and in numbers.
    """
    live, component = game.live, number[game.live]
    value, share = np.zeros(len(number)), game.choose_pairs(np.zeros(len(game.pairs)))
    best, before = np.inf, set[int]()
    for iteration in range(1, max_iterations + 1):
        # Both sides choose; the agent keeps a pair if no other is better.
        asked, here = game.solve_inner_problem(value), value[live]
        doubt = game.bound_rounding(value, asked)
        share = game.keep_pairs(share, asked, doubt)
        low, high = np.full((2, int(number[-1])), np.inf)
        np.minimum.at(low, component, game.average_pairs(share, asked.low) - here - doubt)
        np.minimum.at(high, component, here - game.back_up_pairs(asked.high) - doubt)
        found = Gains(low=low, high=-high, bias=value, pairs=game.list_pairs(share))
        # Stop if the bounds are close enough, or no closer because all that is left is rounding.
        width = found.high - found.low
        wide, noise = float(width.max()), float((asked.high - asked.low).max() + doubt.max())
        if (width <= choose_tolerance(tol, found.middle)).all():
            return replace(found, status=Status.CONVERGED, iterations=iteration)
        if best <= wide <= 4 * noise:
            return replace(found, status=Status.PRECISION, iterations=iteration)
        best = min(best, wide)
        policy = hash(share.tobytes())
        if policy in before:
            # Policies that come back do not improve: take half a step of value iteration.
            ahead = game.average_pairs(share, asked.value) - here
            value = value.copy()
            value[live] += (ahead - found.middle[component]) / 2
        else:
            before.add(policy)
            value, share = _solve_nature(game, number, asked, share)
    return replace(found, iterations=max_iterations)


def choose_tolerance(tol: float | None, value: Floats) -> Floats | float:
    """Return the tolerance that was given, or else one for each of some values."""
    if tol is not None:
        return tol
    return RELATIVE_TOLERANCE * np.maximum(1.0, np.abs(value))


def _solve_nature(
    game: Game, number: Integers, asked: Inner, share: Floats
) -> tuple[Floats, Floats]:
    """Return h (S,) and shares (U,) as `_solve_bias`, for nature's best choice against them."""
    value, share = _solve_bias(game, number, asked, share)
    for _ in range(100):
        before = value
        value, share = _solve_bias(game, number, game.solve_inner_problem(value), share)
        if not (np.abs(value - before) > 8 * UNIT * np.abs(before).max()).any():
            break
    return value, share


def _solve_bias(
    game: Game, number: Integers, asked: Inner, share: Floats, *, joined: bool = False
) -> tuple[Floats, Floats]:
    """Return the h (S,) of both sides' choices, with g + h = r + P h, and the agent's shares (U,).

    `number` (S,) is the component of each state. Where one has several recurrent classes, the agent
    goes to the one of greatest gain, unless it was told so (`joined`) and underflow closes the way.
    """
    chain, earned = game.build_chain(asked.distributions, share)
    classes, states = Classes(chain), np.arange(len(number))
    # Rewards and steps on the way to the base of a class; and a round from there back to it.
    away = (~classes.at_base).astype(np.float64)
    until = LinearSystem(select_rows(chain, states, ~classes.at_base))
    reward, steps = until.approximate(away * earned), until.approximate(away)
    gain = ((earned + chain @ reward) / (1 + chain @ steps))[classes.base]
    # The best class of each component is the last one in this order.
    own = number[classes.base]
    order = np.lexsort((gain, own))
    best = order[np.flatnonzero(np.diff(own[order], append=-1))]
    if len(best) < len(gain) and not joined:
        pairs, every = game.mdp.pair_offsets[:-1].copy(), np.ones(game.mdp.n_pairs, dtype=bool)
        pairs[game.live] = game.list_pairs(share)
        choose_nearer_pairs(PairGraph.of(game.mdp), np.isin(classes.label, best), every, pairs)
        return _solve_bias(game, number, asked, game.take_pairs(pairs), joined=True)
    value = reward - gain[best][number] * steps
    # Only differences matter: h = 0 in the first state of each component.
    first = np.unique(number, return_index=True)[1]
    return np.asarray(value - value[first][number]), share


# ---- the reduction to totals ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RobustAverages(RobustModel):
    """Average rewards of a model at discount 1 whose rows nature chooses."""

    @cached_property
    def _components(self) -> tuple[Integers, Mask]:
        """(S,) the component of each state, or -1, and (L,) the pairs inside."""
        every = np.ones(self.mdp.n_pairs, dtype=bool)
        if self.closed.any():
            self._require_base()
            return np.zeros(self.mdp.n_states, dtype=np.int64), self.find_given_pairs(every)
        component, inside = self.graph.end_components(every)
        return component, self.find_given_pairs(inside)

    def _require_base(self) -> None:
        """Raise ModelError unless some state is visited again and again whatever happens.

        Of a pair whose set can close one outcome, any single outcome may be left: more than the set
        allows, so that some models are refused that have one gain, and none is wrongly accepted.
        """
        split = self.graph.split_pairs(self.closed_of_mdp)
        if split.find_base(np.ones(len(split.pair_state), dtype=bool)) is None:
            raise ModelError(
                "under some distributions within the sets an outcome is impossible; if they may "
                "leave any single one, no state is visited again and again whatever they are, so "
                "that states may differ in gain",
                where=self.given.where(int(self.closed.argmax())),
                fix="choose smaller sets that keep every outcome possible",
            )

    @cached_property
    def _inside(self) -> Quotient:
        """The model of the components, with an end that none reaches."""
        return extract_components(self.given, *self._components)

    def bound_gains(self, tol: float | None, max_iterations: int) -> Gains:
        """Return bounds on the gains of the components."""
        component, _ = self._components
        number = np.append(component[component >= 0], component.max() + 1)
        game = self.build_game(self._inside)
        found = bound_gains(game, number, tol, max_iterations)
        if found.status is Status.ITERATION_LIMIT:
            detail = f"{2 * found.error:.2g} is the error bound after {max_iterations} iterations"
            raise SolverError(found.status, detail)
        return found

    def apply(self, gains: Gains) -> tuple[Quotient, Game]:
        """Return the model in which each component is a state to stop in, and its game."""
        component, inside = self._components
        outside = self.find_given_pairs(np.ones(self.mdp.n_pairs, dtype=bool)) & ~inside
        none = np.zeros(self.given.n_pairs, dtype=np.int64)
        table = self.given.table.with_reward(none, make_ones(len(none)))
        part = stop_in_components(self.given, component, outside, gains.middle)
        return part, replace(self, given=self.given.with_(table=table)).build_game(part)

    # ---- the way back ------------------------------------------------------------------------

    def lift_policy(self, part: Quotient, gains: Gains, chosen: Integers) -> Integers:
        """Return the policy (S,) of the model, given pairs (S',) of its part.

        A policy that is given takes the first pairs here.
        """
        if self.weights is not None:
            return self.given.pair_offsets[:-1]
        pairs = part.lift_pairs(self.graph, self._components, chosen)
        own = np.zeros(self.given.n_states, dtype=np.int64)
        own[self._components[0] >= 0] = self._inside.source[gains.pairs]
        return np.where((part.source[chosen] < 0)[part.new_state], own, pairs)

    def choose_distributions(self, gains: Gains, value: Floats) -> list[Floats]:
        """Return nature's choice in the game of the whole model, given the gain of each state."""
        game, (_, inside) = self.build_game(), self._components
        later = copy(game)
        later.rewards = False
        staying = game.solve_inner_problem(gains.bias[self._inside.new_state]).distributions
        moving = later.solve_inner_problem(value).distributions
        each = []
        for block, stays, moves in zip(game.blocks, staying, moving, strict=True):
            each.append(np.where(inside[block.pair][:, None], stays, moves))
        return each
