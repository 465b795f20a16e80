"""A care scenario's chances and weights over a box of its parameters, in affine forms.

Each parameter is its middle in the box and half the width times an unknown of its own. Chances are
sums of parameters (`mdp.care.laws`), cut off at 1; one that is cut off somewhere in the box moves
by between nothing and the whole of what its parameters move. The model is that of Yuan et al.
(2025), Sections 2.1 and 3.2, in all its readings.

A policy's value over a box of a care scenario's parameters: bounds on it and on its gradient.

The next statuses are independent, so that the expectation of what follows is taken status by
status, in affine forms of the parameters (`analysis.sensitivity.robust.affine`), and then

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

from exact_mdp.analysis.sensitivity.robust.affine import (
    OUT,
    Forms,
    Span,
    chained,
    expected,
    stacked,
    wider,
)
from exact_mdp.mdp.care.compile import compile_scenario
from exact_mdp.mdp.care.laws import Chances, chances
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.values.policy_chain import PolicyChain


class CareForms:
    """Chances and weights of a scenario over one box.

    Parameters
    ----------
    scenario : Scenario
    chances : Chances
        Its own.
    names : sequence of str
        Parameters that may move.
    low, high : {name: Fraction}
        Ends of the box; those that are the same do not move.

    Attributes
    ----------
    names : tuple of J str
        Parameters that move, an unknown each.
    step, skip : forms (…, n)
        Chances of the next statuses after a trial and after a skip.
    step_use, skip_use : ((…, n, J), (…, n, J))
        The least and the greatest share of each unknown in them.
    """

    def __init__(
        self,
        scenario: Scenario,
        chances: Chances,
        names: Sequence[str],
        low: Mapping[str, Fraction],
        high: Mapping[str, Fraction],
    ) -> None:
        self.scenario, self.chances = scenario, chances
        self.names = tuple(name for name in names if low[name] < high[name])
        self.unknowns = len(self.names)
        number = {name: j for j, name in enumerate(self.names)}
        centre = {p.name: float(low.get(p.name, p.value)) for p in scenario.parameters}
        slope = {name: np.zeros(self.unknowns) for name in centre}
        rest = dict.fromkeys(centre, 0.0)
        for name in self.names:
            middle = (low[name] + high[name]) / 2
            centre[name] = float(middle)
            slope[name][number[name]] = float((high[name] - low[name]) / 2)
        for name in centre:
            rest[name] = UNIT * (abs(centre[name]) + float(np.abs(slope[name]).sum()))
        form = {
            name: Forms.of(np.array(centre[name]), slope[name], np.array(rest[name]))
            for name in centre
        }
        order = chances.names
        none = Forms.constant(np.zeros(1), self.unknowns)
        table = chained(stacked([form[name] for name in order]), none)
        place = np.full(len(order) + 1, -1)
        for k, name in enumerate(order):
            place[k] = number.get(name, -1)
        self.step, self.step_use = self._sums(table, chances.step, place)
        self.skip, self.skip_use = self._sums(table, chances.skip, place)
        self.weight = {
            name.removeprefix("reward."): each
            for name, each in form.items()
            if name.startswith("reward.")
        }
        self.earning = {
            name.removeprefix("reward."): number[name]
            for name in self.names
            if name.startswith("reward.")
        }

    def _sums(self, table: Forms, terms: Integers, place: Integers) -> tuple[Forms, Span]:
        """Return chances (…, n), and the share of each unknown in them: (…, n, J), (…, n, J)."""
        total = table[terms[..., 0]]
        for column in range(1, terms.shape[-1]):
            total = total + table[terms[..., column]]
        use = np.zeros((*terms.shape[:-1], self.unknowns))
        for column in range(terms.shape[-1]):
            which = place[terms[..., column]]
            index = np.nonzero(which >= 0)
            use[(*index, which[index])] = 1.0
        least, most = total.low, total.high
        # A parameter alone is at most 1; only a sum can be cut off.
        alone = (terms[..., 1:] == len(self.chances.names)).all(axis=-1)
        over, cut = (least >= 1) & ~alone, (least < 1) & (most > 1) & ~alone
        bottom = np.clip(least, 0.0, 1.0)
        middle = np.where(over, 1.0, np.where(cut, (bottom + 1) / 2, total.centre))
        half = np.where(over, 0.0, np.where(cut, (1 - bottom) / 2 * (1 + OUT) + UNIT, total.rest))
        linear = np.where((over | cut)[..., None], 0.0, total.slope)
        moving = use * ~over[..., None]
        sure = moving * ~cut[..., None]
        within = bottom, np.minimum(most, 1.0)
        return Forms.of(middle, linear, half, within), (sure, moving)

    def earn(self, *names: str) -> tuple[Forms, Floats]:
        """Return the sum of weights, and its derivative (J,)."""
        total = Forms.constant(np.array(0.0), self.unknowns)
        slope = np.zeros(self.unknowns)
        for name in names:
            total = total + self.weight[name]
            if name in self.earning:
                slope[self.earning[name]] += 1.0
        return total, slope

    @cached_property
    def costs(self) -> tuple[Forms, Floats]:
        """What each status vector costs, and its derivative: (2^n,), (2^n, J)."""
        found = [
            self.earn(
                *(
                    self.scenario.weights[status]
                    for status, on in zip(self.scenario.statuses, row, strict=True)
                    if on
                )
            )
            for row in self.chances.bits.tolist()
        ]
        return stacked([form for form, _ in found]), np.stack([slope for _, slope in found])

    def bonus(self, last: bool, *, skipped: bool, flag: int) -> list[str]:
        """Return the weight earned at the end of a subtask, where its reading pays one."""
        rule = self.scenario.readings["task_bonus"]
        paid = last and (
            rule == "always"
            or (rule == "last-subtask-completed" and not skipped)
            or (rule == "no-subtask-skipped" and not skipped and flag == 0)
        )
        return ["task-complete"] if paid else []


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
