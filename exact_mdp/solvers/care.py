"""The stacked model of many draws of a care scenario, made from its rules without its models.

A draw sets some parameters of a scenario; the others keep their value. `mdp.care.stack` has the
chances and rewards of all draws at once, in floats.

Rounding. An exact chance is a sum of n numbers, cut off at 1, and the distribution of the next
status vector is a product of n chances: in floats, the absolute errors of a row sum to at most κ =
2 n γ(n) + γ(2n + 1). A row with a skip is made of two such distributions, and a reward is a sum of
at most R in absolute value over a row. So the sum of the errors of a row is at most 2 κ + γ(2^(n+1)
+ 4 A + 24), and the error of a reward R times as much (γ as in `solvers.bounds.gains`; Higham,
Accuracy and Stability of Numerical Algorithms, SIAM 2002, 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from exact_mdp.mdp.care.laws import Laws
from exact_mdp.mdp.care.rules import rules_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.stack import ScenarioOutcomes, compute_numbers
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma
from exact_mdp.solvers.stacked import StackedModel, Structure


class ScenarioStack:
    """The structure of a scenario's models, and the numbers of draws of some parameters.

    "discount" may be among the `names`.
    """

    def __init__(self, scenario: Scenario, mdp: MDP, names: Sequence[str]) -> None:
        self.scenario, outcomes = scenario, ScenarioOutcomes.of(scenario)
        self.structure = Structure(
            state=np.array(mdp.pair_state),
            first=np.array(mdp.pair_offsets[:-1]),
            offsets=outcomes.offsets,
            column=outcomes.column,
            number=outcomes.number,
            earned=outcomes.earned,
            ended=np.array(mdp.labels["end"]),
        )
        self.start = np.array(mdp.start_distribution)
        # One row of numbers for each parameter of the scenario, 0, and the discount.
        rules, zero = rules_of(scenario), len(scenario.names)
        today = [float(parameter.value) for parameter in scenario.parameters]
        self.today = np.array([*today, 0.0, float(scenario.discount)])
        places = rules.position | {DISCOUNT: zero + 1}
        self.moved = [places[name] for name in names]

    def stack_draws(self, draws: Floats) -> tuple[StackedModel, Flags]:
        """Return the models of draws (D, Q), and whether some chance was cut off at 1 (D,).

        Raises ModelError for rewards that overflow.
        """
        count = len(draws)
        numbers = np.tile(self.today[:, None], count)
        numbers[self.moved] = draws.T
        laws, rate = Laws.from_draws(self.scenario, numbers[:-1]), numbers[-1].copy()
        chances, amounts = compute_numbers(laws)
        bits, vectors, actions = (
            laws.rules.bits.shape[1], laws.rules.vectors, laws.rules.assistive
        )
        law = 2 * bits * float(gamma(bits)) + float(gamma(2 * bits + 1))
        unit = (2 * law + float(gamma(2 * vectors + 4 * actions + 24))) * SLACK
        stacked = StackedModel(
            structure=self.structure,
            chances=chances,
            amounts=amounts,
            reward_error=(self._bound_rewards(laws) * unit)[:, None],
            rate=rate,
            leak=1 - rate[:, None],
            terms=vectors + 1,
            row_error=unit,
            live=np.tile(~self.structure.ended, (count, 1)),
            start=np.tile(self.start, (count, 1)),
        )
        # A sum that is exactly 1 stays below this after eight roundings.
        return stacked, (laws.sums > 1 + 8 * UNIT).any(axis=0)

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
