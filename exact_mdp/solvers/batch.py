"""Solve many small models at once: optima and policies of models that differ only in numbers.

    V = r_π + γ P_π V,     π(s) ← a pair l of s with the greatest d(l) = r(l) + γ P_l V - V(s)

Rows are dense, (D, L, S) for D models; each step of policy iteration is one LU of all of them. The
bounds hold whatever V is: with a w > 0 such that w - γ P_l w ≥ c > 0 for every pair l,

    V - w max_π (-d)⁺ / c  ≤  V_π  ≤  V*  ≤  V + w max_l d⁺ / c,

because w shrinks by at least c in each step of any policy. Below discount 1, w = 1 and c = 1 - γ.
At discount 1, w is the greatest expected number of steps to the end, found by the same iteration
and checked. `Batch.of` returns None, and models are solved one by one, if some policy may never
end, if a run may miss its goal, or if the models do not have the same pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from exact_mdp.mdp.graph import beside_goal
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Batch:
    """D models with the same L pairs and S states; rewards are maximised."""

    rows: Floats  # (D, L, S)
    reward: Floats  # (D, L)
    reward_error: Floats  # (D, L)
    rate: Floats  # (D,) the discount γ
    leak: Floats  # (D, 1) 1 - γ, rounded once
    terms: int  # the most roundings in a row
    live: np.ndarray  # (D, S) states that are not terminal, at discount 1; all of them below
    start: Floats  # (D, S)
    state: Integers  # (L,) the state of each pair
    first: Integers  # (S,) the first pair of each state

    @classmethod
    def of(cls, models: Sequence[MDP]) -> Batch | None:
        """Return the models as one batch; None if they are too large or too different.

        None also if some policy may never end, or may miss a goal.
        """
        # Dense rows of large models would take more time than sparse solvers.
        one = models[0]
        # With more entries of dense rows, sparse solvers are as fast.
        if one.n_pairs * one.n_states > 2**16:
            return None
        # The models must have the same pairs, and no run may miss a goal.
        for other in models[1:]:
            if not np.array_equal(one.pair_offsets, other.pair_offsets):
                return None
        if any(mdp.discount_exact == 1 and beside_goal(mdp).any() for mdp in models):
            return None
        # Stack the numbers of all models; costs are negated.
        facts = [rounding_facts(mdp) for mdp in models]
        batch = cls(
            rows=np.stack([mdp.transition.toarray() for mdp in models]),
            reward=np.stack([mdp.sign * mdp.reward for mdp in models]),
            reward_error=np.stack([reward_errors(mdp) for mdp in models]),
            rate=np.array([mdp.discount for mdp in models]),
            leak=np.array([[f.leak] for f in facts]),
            terms=max(f.most for f in facts),
            live=np.stack([~mdp.terminal | (mdp.discount_exact < 1) for mdp in models]),
            start=np.stack([mdp.start_distribution for mdp in models]),
            state=np.array(one.pair_state),
            first=np.array(one.pair_offsets[:-1]),
        )
        # Without verified weights, some policy may never end.
        if batch.weights is None:
            return None
        return batch

    def compute_advantages(
        self, value: Floats, reward: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Return d(l) of values (D, S), and a bound on its rounding error, both (D, L)."""
        if reward is None:
            reward = self.reward
        # d = r + γ Σ P (V' - V) - (1 - γ) V: its rounding depends on differences of values only.
        here = value[:, self.state]
        apart = value[:, None, :] - here[:, :, None]
        ahead, flow = (
            self.rate[:, None] * np.einsum("dls,dls->dl", self.rows, each)
            for each in (apart, np.abs(apart))
        )
        gain = reward + (ahead - self.leak * here)
        tiny = TINY * (1 + np.abs(value).max()) * (self.terms + 1)
        error = row_error(self.leak, self.terms, flow, reward, here) + self.reward_error + tiny
        alive = self.live[:, self.state]
        return np.where(alive, gain, 0.0), np.where(alive, error * SLACK, 0.0)

    def solve_chains(self, rows: Floats, rewards: Floats) -> Floats:
        """Return (D, S, C) the values of chains (D, S, S) with several rewards (D, S, C)."""
        live = self.live[:, :, None]
        rows = np.where(live, rows * self.rate[:, None, None], 0.0)
        earned = np.where(live, rewards, 0.0)
        return np.asarray(np.linalg.solve(np.eye(rows.shape[1]) - rows, earned))

    def improve_policies(self, reward: Floats) -> tuple[Floats, Integers] | None:
        """Return values (D, S) and pairs (D, S) that no pair improves by more than rounding.

        Policy iteration; None if an improper policy or an overflow makes equations unsolvable.
        """
        draw, pairs = np.arange(len(self.rows))[:, None], np.tile(self.first, (len(self.rows), 1))
        number = np.arange(len(self.state))
        for _ in range(POLICIES):
            # Evaluate the policies of all models: one batch of linear systems.
            try:
                rewards = reward[draw, pairs][:, :, None]
                value = self.solve_chains(self.rows[draw, pairs], rewards)[:, :, 0]
            except np.linalg.LinAlgError:
                return None
            if not np.isfinite(value).all():
                return None
            # Improve: change a pair only if another beats it by more than both may round.
            gain, noise = self.compute_advantages(value, reward)
            best = np.maximum.reduceat(gain, self.first, axis=1)
            noise = 2 * np.maximum.reduceat(noise, self.first, axis=1)
            better = best - gain[draw, pairs] > noise
            if not better.any():
                return value, pairs
            # The first pair of each state that has the greatest advantage.
            there = np.where(gain == best[:, self.state], number, len(number))
            pairs = np.where(better, np.minimum.reduceat(there, self.first, axis=1), pairs)
        return None

    @cached_property
    def weights(self) -> tuple[Floats, Floats] | None:
        """Weights w (D, S) and margins c (D,); None if some policy may never end at discount 1."""
        # Below discount 1 the margin of w = 1 is 1 - γ.
        least = self.leak[:, 0] * (1 - UNIT) / SLACK
        if (least > 0).all() and self.rate.max() < 1:
            return np.ones_like(self.start), least
        # At discount 1 maximise the number of steps, and verify by how much it falls in each pair.
        alive = self.live[:, self.state]
        most = self.improve_policies(alive.astype(float))
        if most is None or not (most[0] >= 0).all():
            return None
        falls, noise = self.compute_advantages(most[0], np.zeros_like(self.reward))
        least = np.where(alive, -falls - noise, 1.0).min(axis=1) / SLACK
        if (least > 0).all():
            return (most[0], least)
        return None

    def solve_models(self) -> tuple[Floats, Floats, Floats, Floats] | None:
        """Return values and their errors (D, S), suboptimality gaps and their errors (D, L)."""
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
        return value, error, -gain, (noise + error[:, self.state] + ahead) * SLACK

    def of_policy(self, chosen: Floats) -> tuple[Floats, Floats]:
        """Return the values at the start (D,) of a policy (L,), and bounds on their errors."""
        assert self.weights is not None
        weight, least = self.weights
        value = self._evaluate_amounts(chosen, self.reward[:, :, None])[:, :, 0]
        # The residual of a policy is the mean of its pairs' advantages; it would be 0 exactly.
        gain, noise = self.compute_advantages(value)
        noise = noise + gamma(len(self.state) + 16) * np.abs(gain)
        off = np.abs(np.add.reduceat(gain * chosen, self.first, axis=1))
        off += np.add.reduceat(noise * chosen, self.first, axis=1)
        return self.at_start(value, weight * (off.max(axis=1) / least * SLACK)[:, None])

    def compute_totals(self, chosen: Floats, amounts: Floats) -> Floats:
        """Return (D, C) the expected totals of amounts (D, L, C) under a policy (L,)."""
        return np.asarray(
            np.einsum("ds,dsc->dc", self.start, self._evaluate_amounts(chosen, amounts))
        )

    def _evaluate_amounts(self, chosen: Floats, amounts: Floats) -> Floats:
        """Return the expected totals (D, S, C) of amounts (D, L, C) under a policy (L,)."""
        each = (np.add.reduceat(x * chosen[:, None], self.first, 1) for x in (self.rows, amounts))
        return self.solve_chains(*each)

    def at_start(self, value: Floats, error: Floats) -> tuple[Floats, Floats]:
        """Return values (D, S) and their errors at the start, (D,) each."""
        count = gamma(len(self.first) + 2)
        mean = np.einsum("ds,ds->d", self.start, value)
        size = np.einsum("ds,ds->d", self.start, np.abs(value))
        off = np.einsum("ds,ds->d", self.start, error)
        # A single start state adds no rounding.
        rounding = np.where((self.start == 1).any(axis=1), 0.0, count * size)
        return mean, (off + rounding) * SLACK
