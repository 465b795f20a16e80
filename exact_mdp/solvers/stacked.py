"""Stacked models: many models with one structure and many sets of numbers, solved all at once.

A stacked model is one table of pairs and next states with D columns of chances and rewards, one for
each draw of some parameters. It answers for all draws at once what a model answers for one:

    StackedModel.of(models).optimum()              values, gaps, and bounds on their errors
    StackedModel.of(models).evaluate(policies)     values at the start, and bounds on their errors

If no state can come back to itself, values follow by backward induction, with one rounding error ε
in each step, so that a state from which at most h steps remain has an error of at most

    h ε,     ε = ρ + γ(n + A + 16) (max |r| + max |V|) + κ max |V|,

where n is the greatest number of outcomes of a pair, A of pairs of a state, ρ the error of rewards,
and κ bounds the sum of the errors of a row, beyond one rounding of each chance. Otherwise

    V = r_π + γ P_π V,     π(s) ← a pair l of s with the greatest d(l) = r(l) + γ P_l V - V(s)

with dense rows (D, L, S), and one LU of all of them in each step. The bounds hold whatever V is:
with a w > 0 such that w - γ P_l w ≥ c > 0 for every pair l,

    V - w max_π (-d)⁺ / c  ≤  V_π  ≤  V*  ≤  V + w max_l d⁺ / c,

because w shrinks by at least c in each step of any policy. Below discount 1, w = 1 and c = 1 - γ.
At discount 1, w is the greatest expected number of steps to the end, found by the same iteration
and checked. `StackedModel.of` returns None, and models are solved one by one, if some policy may
never end, if a run may miss its goal, if models do not have the same pairs, or are too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.graph import find_ends_outside_goal, rank_acyclic_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import (
    POLICIES,
    SLACK,
    TINY,
    UNIT,
    gamma,
    reward_errors,
    rounding_facts,
    row_error,
)

DENSE = 2**16  # entries of dense rows: with more, sparse solvers are as fast
MOST_CHANCES = 2**24  # numbers in memory


class StackedStructure(NamedTuple):
    """The pairs and outcomes that models share; equal chances and rewards may share a row."""

    state: Integers  # (L,) the state of each pair
    first: Integers  # (S + 1,) the first pair of each state
    offsets: Integers  # (L + 1,) the first outcome of each pair
    column: Integers  # (N,) the next state of each outcome
    number: Integers  # (N,) the row of its chance
    earned: Integers  # (L,) the row of the reward of each pair
    ended: Flags  # (S,) states that are terminal in all models

    def count_steps(self) -> Integers | None:
        """Return (S,) the most steps from each state to the end; None if a state may come back."""
        return rank_acyclic_states(self.offsets[self.first], self.column, self.ended)


class StackedOptimum(NamedTuple):
    """The optima of D models: values, suboptimality gaps of all pairs, bounds on their errors."""

    value: Floats  # (D, S)
    error: Floats  # (D, S)
    gap: Floats  # (D, L)
    doubt: Floats  # (D, L)


@dataclass(frozen=True, kw_only=True, eq=False)
class StackedModel:
    """D models with one structure of L pairs and S states; rewards are maximised."""

    structure: StackedStructure
    steps: Integers | None  # (S,) as in `StackedStructure.count_steps`
    chances: Floats  # (K, D)
    amounts: Floats  # (R, D) rewards
    reward_error: Floats  # (D, L), or (D, 1)
    rate: Floats  # (D,) the discount γ
    leak: Floats  # (D, 1) 1 - γ, rounded once
    terms: int  # the most roundings in a row
    row_error: float = 0.0  # κ, for the sum of the errors of a row beyond one rounding each
    live: Flags  # (D, S) states that are not terminal, at discount 1; all of them below
    start: Floats  # (D, S)

    @classmethod
    def of(cls, models: Sequence[MDP]) -> StackedModel | None:
        """Return models as one; None if they are too large or too different.

        None also if some policy may never end, or may miss a goal.
        """
        # The models must have the same pairs, and no run may miss a goal.
        one = models[0]
        if one.n_transitions * len(models) > MOST_CHANCES:
            return None
        for other in models[1:]:
            if not np.array_equal(one.pair_offsets, other.pair_offsets):
                return None
        if any(mdp.discount_exact == 1 and find_ends_outside_goal(mdp).any() for mdp in models):
            return None
        # The outcomes of all models, as pair · S + next state; most have the same ones.
        keys = [_list_outcome_keys(mdp) for mdp in models]
        alike = {key.tobytes(): key for key in keys}
        union = reduce(np.union1d, alike.values())
        pair, column = np.divmod(union, one.n_states)
        structure = StackedStructure(
            state=np.array(one.pair_state),
            first=np.array(one.pair_offsets),
            offsets=np.searchsorted(pair, np.arange(one.n_pairs + 1)),
            column=column,
            number=np.arange(len(column)),
            earned=np.arange(one.n_pairs),
            ended=np.logical_and.reduce([mdp.terminal for mdp in models]),
        )
        # Dense rows of large models would take more time than sparse solvers.
        steps = structure.count_steps()
        if steps is None and one.n_pairs * one.n_states > DENSE:
            return None
        # Stack the numbers of all models; costs are negated.
        places = {content: np.searchsorted(union, key) for content, key in alike.items()}
        chances = np.zeros((len(models), len(union)))
        for row, mdp, key in zip(chances, models, keys, strict=True):
            row[places[key.tobytes()]] = mdp.transition.data
        facts = [rounding_facts(mdp) for mdp in models]
        stacked = cls(
            structure=structure,
            steps=steps,
            chances=np.ascontiguousarray(chances.T),
            amounts=np.stack([mdp.sense.orient(mdp.reward) for mdp in models], axis=1),
            reward_error=np.stack([reward_errors(mdp) for mdp in models]),
            rate=np.array([mdp.discount for mdp in models]),
            leak=np.array([[f.leak] for f in facts]),
            terms=max(f.most for f in facts),
            live=np.stack([~mdp.terminal | (mdp.discount_exact < 1) for mdp in models]),
            start=np.stack([mdp.start_distribution for mdp in models]),
        )
        # Without verified weights, some policy may never end.
        if steps is None and stacked.weights is None:
            return None
        return stacked

    @property
    def size(self) -> int:
        """Numbers in memory."""
        if self.steps is None:
            return self.rows.size
        return self.chances.size

    def pays_at_end(self, amounts: Floats) -> bool:
        """Return whether some amounts (D, L) other than 0 belong to states that count as ended."""
        ended = ~self.live
        if self.steps is not None:
            ended = ended | self.structure.ended
        return bool((amounts * ended[:, self.structure.state]).any())

    def with_reward(self, reward: Floats, error: Floats) -> StackedModel:
        """Return the models with another reward (D, L), known up to an error (D, L)."""
        structure = self.structure._replace(earned=np.arange(reward.shape[1]))
        amounts = np.ascontiguousarray(reward.T)
        other = replace(self, structure=structure, amounts=amounts, reward_error=error)
        # Dense rows and weights depend on transitions only, and need not be computed again.
        if self.steps is None:
            vars(other).update(rows=self.rows, weights=self.weights)
        return other

    def optimum(self) -> StackedOptimum | None:
        """Return the optima; None if the iteration does not settle, or values overflow."""
        if self.steps is None:
            return self._iterate_policies()
        from exact_mdp.solvers.kernels import stacked as loops

        # The end is worth nothing, and its pairs lose nothing.
        state, count = self.structure.state, len(self.rate)
        value, q = (np.zeros((size, count)) for size in (len(self.steps), len(state)))
        loops.write_optimum(*self._loop_inputs, value, q)
        error = self._bound_backward_errors(value)
        if not np.isfinite(error).all():
            return None
        # The value of a pair has the error of its state.
        return StackedOptimum(value.T, error, (value[state] - q).T, 2 * error[:, state])

    def evaluate(self, policies: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return the values at the start (D, N) of policies (N, L), and bounds on their errors."""
        evaluate = self._evaluate_by_solving
        if self.steps is not None:
            evaluate = self._evaluate_backward
        found = [self.at_start(*evaluate(np.array(chosen))) for chosen in policies]
        value, error = (np.stack(each, axis=1) for each in zip(*found, strict=True))
        return value, error

    # ---- backward induction ------------------------------------------------------------------

    @property
    def _loop_inputs(self) -> tuple[Integers, StackedStructure, NamedTuple]:
        """The order of the states, the structure and the numbers, as compiled loops take them."""
        from exact_mdp.solvers.kernels.stacked import Numbers

        assert self.steps is not None
        order = np.argsort(self.steps, kind="stable")[np.count_nonzero(self.structure.ended) :]
        return order, self.structure, Numbers(self.chances, self.amounts, self.rate)

    def _evaluate_backward(self, chosen: Floats) -> tuple[Floats, Floats]:
        """Return the values (D, S) of a policy (L,), and bounds on their errors."""
        from exact_mdp.solvers.kernels import stacked as loops

        value = np.zeros((self.start.shape[1], len(self.rate)))
        room = np.empty(len(self.rate))
        loops.write_policy_values(*self._loop_inputs, chosen, value, room)
        return value.T, self._bound_backward_errors(value)

    def _bound_backward_errors(self, value: Floats) -> Floats:
        """Return bounds (D, S) on the errors of values (S, D), as in the header of this module."""
        terms = self.terms + int(np.diff(self.structure.first).max()) + 16
        with np.errstate(over="ignore", invalid="ignore"):
            largest, earned = np.abs(value).max(axis=0), np.abs(self.amounts).max(axis=0)
            once = gamma(terms) * (earned + largest) + self.row_error * largest
            once += self.reward_error.max(axis=1) + TINY * (1 + largest) * terms
            return np.asarray(once[:, None] * (np.asarray(self.steps) * SLACK))

    # ---- policy iteration -------------------------------------------------------------------

    @cached_property
    def rows(self) -> Floats:
        """(D, L, S) the dense rows."""
        mine = self.structure
        rows = np.zeros((len(self.rate), len(mine.state), self.start.shape[1]))
        pair = np.repeat(np.arange(len(mine.state)), np.diff(mine.offsets))
        rows[:, pair, mine.column] = self.chances[mine.number].T
        return rows

    @cached_property
    def reward(self) -> Floats:
        """(D, L) the rewards."""
        return np.ascontiguousarray(self.amounts[self.structure.earned].T)

    def compute_advantages(
        self, value: Floats, reward: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Return d(l) of values (D, S), and a bound on its rounding error, both (D, L)."""
        if reward is None:
            reward = self.reward
        # d = r + γ Σ P (V' - V) - (1 - γ) V: its rounding depends on differences of values only.
        here = value[:, self.structure.state]
        apart = value[:, None, :] - here[:, :, None]
        ahead, flow = (
            self.rate[:, None] * np.einsum("dls,dls->dl", self.rows, each)
            for each in (apart, np.abs(apart))
        )
        gain = reward + (ahead - self.leak * here)
        tiny = TINY * (1 + np.abs(value).max()) * (self.terms + 1)
        error = row_error(self.leak, self.terms, flow, reward, here) + self.reward_error + tiny
        alive = self.live[:, self.structure.state]
        return np.where(alive, gain, 0.0), np.where(alive, error * SLACK, 0.0)

    def solve_chains(self, rows: Floats, rewards: Floats) -> Floats:
        """Return the values (D, S) of chains (D, S, S) with rewards (D, S)."""
        rows = np.where(self.live[:, :, None], rows * self.rate[:, None, None], 0.0)
        earned = np.where(self.live, rewards, 0.0)[:, :, None]
        return np.asarray(np.linalg.solve(np.eye(rows.shape[1]) - rows, earned)[:, :, 0])

    def improve_policies(self, reward: Floats) -> tuple[Floats, Integers] | None:
        """Return values (D, S) and pairs (D, S) that no pair improves by more than rounding.

        Policy iteration; None if an improper policy or an overflow makes equations unsolvable.
        """
        first, count = self.structure.first[:-1], len(self.rate)
        draw, pairs = np.arange(count)[:, None], np.tile(first, (count, 1))
        number = np.arange(len(self.structure.state))
        for _ in range(POLICIES):
            # Evaluate the policies of all models: one batch of linear systems.
            try:
                value = self.solve_chains(self.rows[draw, pairs], reward[draw, pairs])
            except np.linalg.LinAlgError:
                return None
            if not np.isfinite(value).all():
                return None
            # Improve: change a pair only if another beats it by more than both may round.
            gain, noise = self.compute_advantages(value, reward)
            best = np.maximum.reduceat(gain, first, axis=1)
            noise = 2 * np.maximum.reduceat(noise, first, axis=1)
            better = best - gain[draw, pairs] > noise
            if not better.any():
                return value, pairs
            # The first pair of each state that has the greatest advantage.
            there = np.where(gain == best[:, self.structure.state], number, len(number))
            pairs = np.where(better, np.minimum.reduceat(there, first, axis=1), pairs)
        return None

    @cached_property
    def weights(self) -> tuple[Floats, Floats] | None:
        """Weights w (D, S) and margins c (D,); None if some policy may never end at discount 1."""
        # Below discount 1 the margin of w = 1 is 1 - γ.
        least = self.leak[:, 0] * (1 - UNIT) / SLACK
        if (least > 0).all() and self.rate.max() < 1:
            return np.ones_like(self.start), least
        # At discount 1 maximise the number of steps, and verify by how much it falls in each pair.
        alive = self.live[:, self.structure.state]
        most = self.improve_policies(alive.astype(float))
        if most is None or not (most[0] >= 0).all():
            return None
        falls, noise = self.compute_advantages(most[0], np.zeros_like(self.reward))
        least = np.where(alive, -falls - noise, 1.0).min(axis=1) / SLACK
        if (least > 0).all():
            return (most[0], least)
        return None

    def _iterate_policies(self) -> StackedOptimum | None:
        """Return the optima by policy iteration."""
        best = self.improve_policies(self.reward)
        if best is None or self.weights is None:
            return None
        weight, least = self.weights
        value, pairs = best
        gain, noise = self.compute_advantages(value)
        draw = np.arange(len(value))[:, None]
        # Above V* by all pairs, below by the policy's own pairs.
        above = (gain + noise).max(axis=1)
        below = (noise - gain)[draw, pairs].max(axis=1)
        error = weight * (np.maximum(above, below) / least * SLACK)[:, None]
        # A gap moves with the error of its own state and of the states that follow.
        ahead = np.einsum("dls,ds->dl", self.rows, error)
        doubt = (noise + error[:, self.structure.state] + ahead) * SLACK
        return StackedOptimum(value, error, -gain, doubt)

    def _evaluate_by_solving(self, chosen: Floats) -> tuple[Floats, Floats]:
        """Return the values (D, S) of a policy (L,), and bounds on their errors."""
        assert self.weights is not None
        weight, least = self.weights
        first = self.structure.first[:-1]
        rows = np.add.reduceat(self.rows * chosen[:, None], first, axis=1)
        value = self.solve_chains(rows, np.add.reduceat(self.reward * chosen, first, axis=1))
        # The residual of a policy is the mean of its pairs' advantages; it would be 0 exactly.
        gain, noise = self.compute_advantages(value)
        noise = noise + gamma(len(self.structure.state) + 16) * np.abs(gain)
        off = np.abs(np.add.reduceat(gain * chosen, first, axis=1))
        off += np.add.reduceat(noise * chosen, first, axis=1)
        return value, weight * (off.max(axis=1) / least * SLACK)[:, None]

    def at_start(self, value: Floats, error: Floats) -> tuple[Floats, Floats]:
        """Return values (D, S) and their errors at the start, (D,) each."""
        count = gamma(self.start.shape[1] + 2)
        mean = np.einsum("ds,ds->d", self.start, value)
        size = np.einsum("ds,ds->d", self.start, np.abs(value))
        off = np.einsum("ds,ds->d", self.start, error)
        # A single start state adds no rounding.
        rounding = np.where((self.start == 1).any(axis=1), 0.0, count * size)
        return mean, (off + rounding) * SLACK


def _list_outcome_keys(mdp: MDP) -> Integers:
    """Return pair · S + next state of the outcomes of a model, rising."""
    pair = np.repeat(np.arange(mdp.n_pairs), np.diff(mdp.transition.indptr))
    return np.asarray(pair * mdp.n_states + mdp.transition.indices)
