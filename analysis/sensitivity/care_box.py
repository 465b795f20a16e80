"""A policy's value over a box of a care scenario's parameters: bounds on it and on its gradient.

The next statuses are independent, so that the expectation of what follows is taken status by
status, in affine forms of the parameters (`analysis.sensitivity.affine_expectation`), and then

    V(s) = Σ_a π(a|s) X(s, a),      G_j(s) = Σ_a π(a|s) ∂_j X(s, a),

X(s, a) being what a step earns and the discounted value of what follows, G_j the derivative by
parameter j, bounded by an interval: one pass from the last subtask back to the start. The model is
that of Yuan et al. (2025), Sections 2.1 and 3.2, in all its readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from analysis.sensitivity.affine_expectation import Span, expected, wider
from analysis.sensitivity.affine_forms import Forms, chained, stacked
from analysis.sensitivity.care_forms import CareForms
from mdp.chances import chances
from mdp.compile import compile_scenario
from mdp.scenario import Scenario
from solvers.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxBounds:
    """Bounds over a box: of the start value, and of its derivatives by the parameters.

    Attributes
    ----------
    low, high : float
    slopes : {name: (low, high)}
        Per unit of each parameter that moves.
    """

    low: float
    high: float
    slopes: Mapping[str, tuple[float, float]]


class CareBox:
    """One policy in one scenario, and parameters that may move.

    Parameters
    ----------
    policy : anything that `solvers.evaluate` takes
    names : sequence of str
        J parameters other than the discount.
    """

    def __init__(self, scenario: Scenario, policy: object, names: Sequence[str]) -> None:
        self.scenario, self.names = scenario, tuple(names)
        self.chances = chances(scenario)
        vectors, actions = len(self.chances.bits), len(scenario.actions)
        self.vectors = vectors
        readings = scenario.readings
        self.own = readings["skip_timestep"] == "own"
        self.flags = 2 if readings["task_bonus"] == "no-subtask-skipped" else 1
        self.following = readings["status_cost"] == "next"
        mdp = compile_scenario(scenario)
        weights = PolicyChain.of(mdp, policy).weights[:-1].reshape(sum(scenario.tasks), -1)
        trying = scenario.trials * self.flags * vectors * actions
        shape = (len(weights), scenario.trials, self.flags, vectors, actions)
        self.policy = weights[:, :trying].reshape(shape)
        self.discount = mdp.discount

    @cached_property
    def _last(self) -> set[int]:
        """Positions of the last subtask of each task."""
        return {int(end) - 1 for end in np.cumsum(self.scenario.tasks)}

    def bounds(self, low: Mapping[str, Fraction], high: Mapping[str, Fraction]) -> BoxBounds:
        """Return bounds over {name: low} … {name: high}, both with all of `names`."""
        forms = CareForms(self.scenario, self.chances, self.names, low, high)
        return _Pass(self, forms).run()


class _Pass:
    """One backward pass over one box."""

    def __init__(self, model: CareBox, forms: CareForms) -> None:
        self.model, self.forms = model, forms

    def run(self) -> BoxBounds:
        """Return the bounds at the start."""
        model, unknowns = self.model, self.forms.unknowns
        vectors, flags = model.vectors, model.flags
        nothing = Forms.constant(np.zeros(vectors), unknowns)
        empty = np.zeros((vectors, unknowns))
        # Values at a subtask's first trial by flag, and bounds of their derivatives.
        after = [(nothing, (empty, empty))] * flags
        for subtask in range(len(model.policy) - 1, -1, -1):
            last = subtask in model._last
            onward = [after[0 if last else flag] for flag in range(flags)]
            skipped = onward[flags - 1]
            skipping = [self._skip(skipped, flag, last) for flag in range(flags)]
            state = skipping
            for trial in range(model.scenario.trials - 1, -1, -1):
                state = [
                    self._trial(subtask, trial, flag, last, onward[flag], state[flag])
                    for flag in range(flags)
                ]
            after = state
        value, (least, most) = after[0]
        low, high = value[0].low, value[0].high
        slopes = zip(self.forms.names, least[0].tolist(), most[0].tolist(), strict=True)
        return BoxBounds(
            low=float(low),
            high=float(high),
            slopes={name: (below, above) for name, below, above in slopes},
        )

    def _skip(self, onward: tuple[Forms, Span], flag: int, last: bool) -> tuple[Forms, Span]:
        """Return what a skip from each status vector is worth: discounted where it takes a step."""
        model, forms = self.model, self.forms
        cost, cost_slope = forms.costs
        bonus = forms.bonus(last, skipped=True, flag=flag)
        fixed, fixed_slope = forms.earn("subtask-skip", *bonus)
        value, (least, most) = onward
        rate = model.discount
        payoff, low, high = value.scaled(rate), rate * least, rate * most
        if model.own:
            step, step_slope = forms.earn("timestep")
            fixed, fixed_slope = fixed + step, fixed_slope + step_slope
            if model.following:
                payoff, low, high = payoff + cost, low + cost_slope, high + cost_slope
        found, (low, high) = expected(
            payoff[None], (low[None], high[None]), forms.skip, forms.skip_use
        )
        found = found + fixed
        low, high = low + fixed_slope, high + fixed_slope
        if model.own and not model.following:
            found, low, high = found + cost, low + cost_slope, high + cost_slope
        return found, (low, high)

    def _trial(
        self,
        subtask: int,
        trial: int,
        flag: int,
        last: bool,
        onward: tuple[Forms, Span],
        failed: tuple[Forms, Span],
    ) -> tuple[Forms, Span]:
        """Return values of a trial, and bounds of their derivatives."""
        model, forms, rate = self.model, self.forms, self.model.discount
        final = trial == model.scenario.trials - 1 and not model.own
        cost, cost_slope = forms.costs
        worth, (low, high) = failed
        if not final:
            worth, low, high = worth.scaled(rate), rate * low, rate * high
        fixed, fixed_slope = forms.earn("timestep", "trial")
        worth, low, high = worth + fixed, low + fixed_slope, high + fixed_slope
        if model.following:
            worth, low, high = worth + cost, low + cost_slope, high + cost_slope
        every = model.scenario.readings["trial_cost"] == "every-trial"
        names = ["timestep", "subtask-complete", *(["trial"] if every else [])]
        done, done_slope = forms.earn(*names, *forms.bonus(last, skipped=False, flag=flag))
        done = done + onward[0][0].scaled(rate)
        ends = rate * onward[1][0][0] + done_slope, rate * onward[1][1][0] + done_slope
        parts, lows, highs = [], [], []
        for action in model.scenario.actions:  # the payoffs of next vectors, action by action
            bonus, bonus_slope = forms.earn(f"assist.{action}")
            first = done + bonus
            parts.append(chained(first[None], worth[1:]))
            lows.append(np.concatenate([[ends[0] + bonus_slope], low[1:]]))
            highs.append(np.concatenate([[ends[1] + bonus_slope], high[1:]]))
        payoff = stacked(parts)[None]
        q, (below, above) = expected(
            payoff, (np.stack(lows)[None], np.stack(highs)[None]), forms.step, forms.step_use
        )
        chosen = model.policy[subtask, trial, flag]
        value = q.scaled(chosen).total(1)
        below = (below * chosen[..., None]).sum(axis=1)
        above = (above * chosen[..., None]).sum(axis=1)
        if not model.following:
            value, below, above = value + cost, below + cost_slope, above + cost_slope
        return value, wider(below, above)
