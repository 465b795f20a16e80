"""A policy's value over a box of a care scenario's parameters: bounds on it and on its gradient.

The next statuses are independent, so that the expectation of what follows is taken status by
status, in affine forms of the parameters (`analysis.sensitivity.affine_forms`):

    X ← X|0 + p_i (X|1 - X|0),     i = 1 … n,    and then  V(s) = Σ_a π(a|s) X(s, a).

Where a chance p_i(s, a) is a sum with parameter j in it, the derivative of V by θ_j follows

    G_j(s) = Σ_a π(a|s) (Σ_i [j in p_i(s, a)] Δ_i(s, a) + γ E G_j(s')),   Δ_i = E[X|1 - X|0],

Δ_i in affine forms as well, G in intervals. A chance that is cut off at 1 somewhere in the box
moves by between nothing and the whole of what its parameters move. The model is that of Yuan et
al. (2025), Sections 2.1 and 3.2, in all its readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from analysis.sensitivity.affine_forms import Forms, chained, mixed, stacked
from mdp.chances import chances
from mdp.scenario import Scenario
from mdp.table import Floats, Integers
from solvers.policy_chain import PolicyChain
from solvers.rounding import UNIT

Span = tuple[Floats, Floats]  # lower and upper bounds
OUT = 1e-13  # intervals are widened by this share of their size after each step


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
        self.bits = self.chances.bits
        self.vectors, self.count = self.bits.shape
        self.actions = len(scenario.actions)
        readings = scenario.readings
        self.own = readings["skip_timestep"] == "own"
        self.flags = 2 if readings["task_bonus"] == "no-subtask-skipped" else 1
        self.following = readings["status_cost"] == "next"
        mdp = scenario.compile()
        weights = PolicyChain.of(mdp, policy).weights[:-1].reshape(sum(scenario.tasks), -1)
        trying = scenario.trials * self.flags * self.vectors * self.actions
        shape = (len(weights), scenario.trials, self.flags, self.vectors, self.actions)
        self.policy = weights[:, :trying].reshape(shape)
        self.discount = mdp.discount

    @cached_property
    def _last(self) -> set[int]:
        """Positions of the last subtask of each task."""
        return {int(end) - 1 for end in np.cumsum(self.scenario.tasks)}

    def bounds(self, low: Mapping[str, Fraction], high: Mapping[str, Fraction]) -> BoxBounds:
        """Return bounds over {name: low} … {name: high}, both with all of `names`."""
        return _Pass(self, low, high).run()


class _Pass:
    """One backward pass over one box."""

    def __init__(
        self, model: CareBox, low: Mapping[str, Fraction], high: Mapping[str, Fraction]
    ) -> None:
        self.model = model
        scenario = model.scenario
        names = [name for name in model.names if low[name] < high[name]]
        self.unknowns, self.moving = len(names), names
        number = {name: j for j, name in enumerate(names)}
        centre = {p.name: float(low.get(p.name, p.value)) for p in scenario.parameters}
        self.slope = {name: np.zeros(self.unknowns) for name in centre}
        rest = dict.fromkeys(centre, 0.0)
        for name in names:
            middle = (low[name] + high[name]) / 2
            centre[name] = float(middle)
            self.slope[name][number[name]] = float((high[name] - low[name]) / 2)
        for name in centre:
            rest[name] = UNIT * (abs(centre[name]) + float(np.abs(self.slope[name]).sum()))
        self.form = {
            name: Forms.of(np.array(centre[name]), self.slope[name], np.array(rest[name]))
            for name in centre
        }
        order = model.chances.names
        none = Forms.constant(np.zeros(1), self.unknowns)
        table = chained(stacked([self.form[name] for name in order]), none)
        place = np.full(len(order) + 1, -1)
        for k, name in enumerate(order):
            place[k] = number.get(name, -1)
        self.step, self.step_use = self._chances(table, model.chances.step, place)
        self.skip, self.skip_use = self._chances(table, model.chances.skip, place)
        self.weight = {
            name.removeprefix("reward."): form
            for name, form in self.form.items()
            if name.startswith("reward.")
        }
        self.earning = {
            name.removeprefix("reward."): number[name]
            for name in names
            if name.startswith("reward.")
        }

    def _chances(self, table: Forms, terms: Integers, place: Integers) -> tuple[Forms, Span]:
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
        alone = (terms[..., 1:] == len(self.model.chances.names)).all(axis=-1)
        over, cut = (least >= 1) & ~alone, (least < 1) & (most > 1) & ~alone
        bottom = np.clip(least, 0.0, 1.0)
        middle = np.where(over, 1.0, np.where(cut, (bottom + 1) / 2, total.centre))
        half = np.where(over, 0.0, np.where(cut, (1 - bottom) / 2 * (1 + OUT) + UNIT, total.rest))
        linear = np.where((over | cut)[..., None], 0.0, total.slope)
        moving = use * ~over[..., None]
        sure = moving * ~cut[..., None]
        within = bottom, np.minimum(most, 1.0)
        return Forms.of(middle, linear, half, within), (sure, moving)

    # ---- what a step earns -------------------------------------------------------------------

    def _earn(self, *names: str) -> tuple[Forms, Floats]:
        """Return the sum of weights, and its derivative (J,)."""
        total = Forms.constant(np.array(0.0), self.unknowns)
        slope = np.zeros(self.unknowns)
        for name in names:
            total = total + self.weight[name]
            if name in self.earning:
                slope[self.earning[name]] += 1.0
        return total, slope

    def _costs(self) -> tuple[Forms, Floats]:
        """Return what each status vector costs: (2^n,), (2^n, J)."""
        found = [
            self._earn(
                *(
                    self.model.scenario.weights[status]
                    for status, on in zip(self.model.scenario.statuses, row, strict=True)
                    if on
                )
            )
            for row in self.model.bits.tolist()
        ]
        return stacked([form for form, _ in found]), np.stack([slope for _, slope in found])

    def _bonus(self, last: bool, *, skipped: bool, flag: int) -> list[str]:
        rule = self.model.scenario.readings["task_bonus"]
        paid = last and (
            rule == "always"
            or (rule == "last-subtask-completed" and not skipped)
            or (rule == "no-subtask-skipped" and not skipped and flag == 0)
        )
        return ["task-complete"] if paid else []

    # ---- the pass ----------------------------------------------------------------------------

    def run(self) -> BoxBounds:
        model = self.model
        vectors, flags, unknowns = model.vectors, model.flags, self.unknowns
        cost, cost_slope = self._costs()
        nothing = Forms.constant(np.zeros(vectors), unknowns)
        empty = np.zeros((vectors, unknowns))
        # Values at a subtask's first trial by flag, and bounds of their derivatives.
        after = [(nothing, (empty, empty))] * flags
        for subtask in range(len(model.policy) - 1, -1, -1):
            last = subtask in model._last
            onward = [after[0 if last else flag] for flag in range(flags)]
            skipped = onward[flags - 1]
            skipping = [self._skip(skipped, flag, last, cost, cost_slope) for flag in range(flags)]
            state = skipping
            for trial in range(model.scenario.trials - 1, -1, -1):
                state = [
                    self._trial(subtask, trial, flag, last, onward[flag], state[flag])
                    for flag in range(flags)
                ]
            after = state
        value, (least, most) = after[0]
        low, high = value[0].low, value[0].high
        slopes = zip(self.moving, least[0].tolist(), most[0].tolist(), strict=True)
        return BoxBounds(
            low=float(low),
            high=float(high),
            slopes={name: (below, above) for name, below, above in slopes},
        )

    def _skip(
        self,
        onward: tuple[Forms, Span],
        flag: int,
        last: bool,
        cost: Forms,
        cost_slope: Floats,
    ) -> tuple[Forms, Span]:
        """Return what a skip from each status vector is worth: discounted where it takes a step."""
        model = self.model
        bonus = self._bonus(last, skipped=True, flag=flag)
        fixed, fixed_slope = self._earn("subtask-skip", *bonus)
        value, (least, most) = onward
        rate = model.discount
        payoff, low, high = value.scaled(rate), rate * least, rate * most
        if model.own:
            step, step_slope = self._earn("timestep")
            fixed, fixed_slope = fixed + step, fixed_slope + step_slope
            if model.following:
                payoff, low, high = payoff + cost, low + cost_slope, high + cost_slope
        found, (low, high) = self._expected(
            payoff[None], (low[None], high[None]), self.skip, self.skip_use
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
        model, rate = self.model, self.model.discount
        final = trial == model.scenario.trials - 1 and not model.own
        cost, cost_slope = self._costs()
        worth, (low, high) = failed
        if not final:
            worth, low, high = worth.scaled(rate), rate * low, rate * high
        fixed, fixed_slope = self._earn("timestep", "trial")
        worth, low, high = worth + fixed, low + fixed_slope, high + fixed_slope
        if model.following:
            worth, low, high = worth + cost, low + cost_slope, high + cost_slope
        every = model.scenario.readings["trial_cost"] == "every-trial"
        names = ["timestep", "subtask-complete", *(["trial"] if every else [])]
        done, done_slope = self._earn(*names, *self._bonus(last, skipped=False, flag=flag))
        done = done + onward[0][0].scaled(rate)
        ends = rate * onward[1][0][0] + done_slope, rate * onward[1][1][0] + done_slope
        parts, lows, highs = [], [], []
        for action in model.scenario.actions:  # the payoffs of next vectors, action by action
            bonus, bonus_slope = self._earn(f"assist.{action}")
            first = done + bonus
            parts.append(chained(first[None], worth[1:]))
            lows.append(np.concatenate([[ends[0] + bonus_slope], low[1:]]))
            highs.append(np.concatenate([[ends[1] + bonus_slope], high[1:]]))
        payoff = stacked(parts)[None]
        q, (below, above) = self._expected(
            payoff, (np.stack(lows)[None], np.stack(highs)[None]), self.step, self.step_use
        )
        chosen = model.policy[subtask, trial, flag]
        value = q.scaled(chosen).total(1)
        below = (below * chosen[..., None]).sum(axis=1)
        above = (above * chosen[..., None]).sum(axis=1)
        if not model.following:
            value, below, above = value + cost, below + cost_slope, above + cost_slope
        return value, _wider(below, above)

    def _expected(
        self, payoff: Forms, slopes: Span, chance: Forms, use: Span
    ) -> tuple[Forms, Span]:
        """Return E[payoff] over independent bits, and bounds of its derivatives.

        Parameters
        ----------
        payoff : (…, 2^n) forms
        slopes : (…, 2^n, J) bounds of the derivatives of payoffs
        chance : (…, n) forms
        use : (…, n, J) the least and the greatest share of each unknown in a chance
        """
        count = self.model.count
        least, most = (np.clip(end, 0.0, 1.0) for end in (chance.low, chance.high))
        low, high = slopes
        for _bit in range(count):  # the most significant bit first
            half = low.shape[-2] // 2
            p, q = least[..., _bit, None, None], most[..., _bit, None, None]
            apart = low[..., half:, :] - low[..., :half, :]
            low = low[..., :half, :] + np.minimum(p * apart, q * apart)
            apart = high[..., half:, :] - high[..., :half, :]
            high = high[..., :half, :] + np.maximum(p * apart, q * apart)
        low, high = low[..., 0, :], high[..., 0, :]
        for bit in range(count):
            ahead = self._flip(payoff, chance, bit)
            down, up = ahead.low, ahead.high
            sure, moving = (part[..., bit, :] for part in use)
            down, up = down[..., None], up[..., None]
            low = low + np.where(down < 0, moving * down, sure * down)
            high = high + np.where(up > 0, moving * up, sure * up)
        total = payoff
        for bit in range(count):
            half = total.centre.shape[-1] // 2
            without, having = total[..., :half], total[..., half:]
            total = mixed(without, having, chance[..., bit : bit + 1])
        return total[..., 0], _wider(low, high)

    def _flip(self, payoff: Forms, chance: Forms, bit: int) -> Forms:
        """Return E[payoff with the bit - payoff without it] over the other bits."""
        count = self.model.count
        number = np.arange(2**count)
        on = (number >> (count - 1 - bit)) & 1 == 1
        total = payoff[..., np.flatnonzero(on)] - payoff[..., np.flatnonzero(~on)]
        for other in range(count):
            if other == bit:
                continue
            half = total.centre.shape[-1] // 2
            without, having = total[..., :half], total[..., half:]
            total = mixed(without, having, chance[..., other : other + 1])
        return total[..., 0]


def _wider(low: Floats, high: Floats) -> Span:
    """Return intervals that contain what rounding may have left out."""
    room = OUT * (np.abs(low) + np.abs(high))
    return low - room, high + room
