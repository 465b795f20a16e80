"""The stacked model of many draws of a care scenario, made from its rules without its models.

A draw sets some parameters of a scenario; the others keep their value. Every chance of the explicit
model is a chance of the vector after a trial, K(s' | s, a), or after a skip, Z(z | s'), or after
both, Σ_{s' ≠ 0} K(s' | s, a) Z(z | s'). Which of them belongs to which outcome follows once from
the outcomes that `mdp.care.compile` lists. Equal numbers are stored once: a step has the same
chances in all trials and subtasks, and the same rewards in all trials, at the same place.

Rounding. An exact chance is a sum of n numbers, cut off at 1, and the distribution of the next
status vector is a product of n chances: in floats, the absolute errors of a row sum to at most κ =
2 n γ(n) + γ(2n + 1). With a skip, a row is made of two distributions. So the errors of a row sum to
at most c = 2 κ + γ(2^(n+1) + 4 A + 24), and a reward, of at most R in absolute value, has an error
of c R (γ as in `solvers.bounds.gains`; Higham, Accuracy and Stability of Numerical Algorithms, SIAM
2002, 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from exact_mdp.mdp.care.compile import Subtask, SubtaskStep, list_steps
from exact_mdp.mdp.care.laws import Laws
from exact_mdp.mdp.care.rules import FINAL
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma
from exact_mdp.solvers.stacked import StackedModel, StackedStructure


class ScenarioStack:
    """The models of draws of some parameters; "discount" may be among the `names`."""

    def __init__(self, scenario: Scenario, mdp: MDP, names: Sequence[str]) -> None:
        self.scenario, self.start = scenario, np.array(mdp.start_distribution)
        self.structure = self._build_structure(mdp)
        self.steps = self.structure.count_steps()
        # One row of numbers for each parameter of the scenario, 0, and the discount.
        rules, zero = scenario.laws.rules, len(scenario.names)
        today = [float(parameter.value) for parameter in scenario.parameters]
        self.today = np.array([*today, 0.0, float(scenario.discount)])
        places = rules.position | {DISCOUNT: zero + 1}
        self.moved = [places[name] for name in names]
        # c, as in the header of this module.
        bits, vectors, actions = rules.bits.shape[1], rules.vectors, rules.assistive
        law = 2 * bits * float(gamma(bits)) + float(gamma(2 * bits + 1))
        self.unit = (2 * law + float(gamma(2 * vectors + 4 * actions + 24))) * SLACK

    def stack_draws(self, draws: Floats) -> tuple[StackedModel, Flags]:
        """Return the models of draws (D, Q), and whether some chance was cut off at 1 (D,).

        Raises ModelError for rewards that overflow.
        """
        count, numbers = len(draws), np.tile(self.today[:, None], len(draws))
        numbers[self.moved] = draws.T
        laws, rate = Laws.from_draws(self.scenario, numbers[:-1]), numbers[-1].copy()
        subtask = Subtask(laws)
        stacked = StackedModel(
            structure=self.structure,
            steps=self.steps,
            chances=self._compute_chances(subtask),
            amounts=self._compute_rewards(subtask),
            reward_error=(self._bound_rewards(laws) * self.unit)[:, None],
            rate=rate,
            leak=1 - rate[:, None],
            terms=laws.rules.vectors + 1,
            row_error=self.unit,
            live=np.tile(~self.structure.ended, (count, 1)),
            start=np.tile(self.start, (count, 1)),
        )
        # A sum that is exactly 1 stays below this after eight roundings.
        return stacked, np.any(laws.sums > 1 + 8 * UNIT, axis=0)

    def _build_structure(self, mdp: MDP) -> StackedStructure:
        """Return all outcomes of the explicit model, also those that are impossible today.

        Sets `kinds`, the places and steps that differ in their rewards, and `rows`, of the chances.
        """
        subtask, kinds = Subtask(self.scenario.laws), dict[tuple[int, SubtaskStep], int]()
        rules, rewards = subtask.laws.rules, 0
        vectors, trying = rules.vectors, rules.vectors * rules.assistive
        lengths, columns, numbers, earned = [list[Integers]() for _ in range(4)]
        for k, place in enumerate(rules.places.tolist()):
            for step in list_steps(rules):
                # The row of chances of each pair: after a trial, or after a skip alone.
                rows = np.arange(trying)
                if not step.tries:
                    rows = np.arange(trying, trying + vectors)
                branches = subtask.list_outcomes(place, step)
                chosen = [branch.chosen for branch in branches]
                if step.tries and step.skips and place != FINAL:
                    chosen[-1] = np.arange(vectors) + trying * vectors  # after a trial and a skip
                column = np.concatenate([branch.state for branch in branches]) + k * rules.size
                lengths.append(np.full(len(rows), len(column)))
                columns.append(np.tile(column, len(rows)))
                numbers.append((np.concatenate(chosen) + rows[:, None] * vectors).reshape(-1))
                kind = place, step._replace(trial=0)
                if kind not in kinds:
                    kinds[kind], rewards = rewards, rewards + len(rows)
                earned.append(kinds[kind] + np.arange(len(rows)))
        # The end stays put, with the last of the chances, which is 1, and earns the last reward, 0.
        self.rows = (trying + (vectors if rules.own else trying)) * vectors + 1  # of chances
        lasts = (1, len(rules.places) * rules.size, self.rows - 1, rewards)
        for parts, number in zip((lengths, columns, numbers, earned), lasts, strict=True):
            parts.append(np.array([number]))
        self.kinds = [*kinds]
        return StackedStructure(
            state=np.array(mdp.pair_state),
            first=np.array(mdp.pair_offsets),
            offsets=np.append(0, np.cumsum(np.concatenate(lengths))),
            column=np.concatenate(columns),
            number=np.concatenate(numbers),
            earned=np.concatenate(earned),
            ended=np.array(mdp.labels["end"]),
        )

    def _compute_chances(self, subtask: Subtask) -> Floats:
        """Return the chances (K, D) of vectors after a trial, and after a skip or both."""
        after, draws = subtask.skip, subtask.skip.shape[-1]
        if not subtask.laws.rules.own:
            # A skip follows a trial that ends with any vector but 0: a product in each draw.
            failed, again = (
                np.ascontiguousarray(np.moveaxis(each, -1, 0))
                for each in (subtask.step[:, :, 1:], subtask.skip[1:])
            )
            after = np.moveaxis(failed @ again[:, None], 0, -1)
        parts = subtask.step.reshape(-1, draws), after.reshape(-1, draws), np.ones((1, draws))
        return np.concatenate(parts)

    def _compute_rewards(self, subtask: Subtask) -> Floats:
        """Return the rewards (R, D): costs of statuses, and the gains of the outcomes."""
        laws, costs = {True: subtask.step, False: subtask.skip[:, None]}, {}
        for tries, law in laws.items():
            following = np.einsum("sazd,zd->sad", law, subtask.following)
            costs[tries] = following + subtask.present[:, None]
        amounts = []
        for place, step in self.kinds:
            amount = costs[step.tries]
            for branch in subtask.list_outcomes(place, step):
                share = laws[step.tries][:, :, branch.chosen].sum(axis=2)
                amount = amount + share * branch.gain[:, 0]
            amounts.append(amount.reshape(-1, amount.shape[-1]))
        return np.concatenate([*amounts, np.zeros((1, amounts[0].shape[1]))])

    def _bound_rewards(self, laws: Laws) -> Floats:
        """Return (D,) R, a bound on rewards; raises ModelError if sums may overflow."""
        rules = laws.rules
        # A timestep completes the subtask, with the action's reward, or fails, possibly with a
        # skip; either way status costs are added.
        with np.errstate(over="ignore"):
            sizes = replace(laws, reward=np.abs(laws.reward))
            complete, fail, skip = (sizes.gain[each].max(axis=(0, 1)) for each in rules.gains)
            reward = np.maximum(complete + sizes.assist.max(axis=0), fail + skip)
            reward += sizes.cost[-1]
            # No number exceeds R times the number of timesteps, squared for its error bound.
            steps = len(rules.places) * (rules.trials + 1)
            whole = reward * (2 * steps * (steps + 1))
        if not whole.max() < np.finfo(float).max / 2**12:
            raise ModelError(
                "reward weights so large that returns overflow",
                where=f"scenario {self.scenario.name}",
                fix="state rewards in a larger unit, or draw them with a smaller spread",
            )
        return np.asarray(reward)
