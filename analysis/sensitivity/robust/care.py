"""A policy's value over a box of a care scenario's parameters: bounds on it and on its gradient.

Each parameter is its middle in the box and half the width times an unknown of its own. Chances are
sums of parameters (`mdp.care.laws`), cut off at 1; one that is cut off somewhere in the box moves
by between nothing and the whole of what its parameters move. The next statuses are independent, so
that the expectation of what follows is taken status by status, in affine forms of the parameters
(`analysis.sensitivity.robust.affine`), and then

    V(s) = Σ_a π(a|s) X(s, a),      G_j(s) = Σ_a π(a|s) ∂_j X(s, a),

X(s, a) being what a step earns and the discounted value of what follows, by `mdp.care.rules`, and
G_j the derivative by parameter j, bounded by an interval: one pass from the last subtask back to
the start. Source of the model: Yuan et al. (2025), Sections 2.1 and 3.2, in all its readings.
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
from exact_mdp.mdp.care.laws import chances
from exact_mdp.mdp.care.rules import Rules
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.values.policy_chain import PolicyChain


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
    """One policy in one scenario, and J parameters that may move, the discount not among them."""

    def __init__(self, scenario: Scenario, policy: PolicyLike, names: Sequence[str]) -> None:
        self.scenario, self.names = scenario, tuple(names)
        self.rules, self.chances = Rules(scenario), chances(scenario)
        mdp = compile_scenario(scenario)
        weights = PolicyChain.of(mdp, policy).weights[:-1].reshape(len(self.rules.places), -1)
        layers = self.rules.trials, self.rules.flags, self.rules.vectors, self.rules.assistive
        trying = int(np.prod(layers))
        self.policy = weights[:, :trying].reshape(len(weights), *layers)
        self.discount = mdp.discount

    def bounds(self, low: Mapping[str, Fraction], high: Mapping[str, Fraction]) -> BoxBounds:
        """Return bounds over {name: low} … {name: high}, both with all of `names`."""
        return _Pass(self, low, high).run()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Value:
    """Numbers over the box: their forms (…), and bounds (…, J) of their derivatives."""

    form: Forms
    slope: Span

    def __add__(self, other: _Value) -> _Value:
        (low, high), (below, above) = self.slope, other.slope
        return _Value(form=self.form + other.form, slope=(low + below, high + above))

    def __getitem__(self, key: int | slice) -> _Value:
        return _Value(form=self.form[key], slope=(self.slope[0][key], self.slope[1][key]))

    def scaled(self, rate: float) -> _Value:
        """Return the numbers times a constant of at least 0."""
        return _Value(
            form=self.form.scaled(rate), slope=(rate * self.slope[0], rate * self.slope[1])
        )


def _beside(parts: Sequence[_Value]) -> _Value:
    """Return numbers side by side along a new first axis."""
    low, high = (np.stack([part.slope[end] for part in parts]) for end in (0, 1))
    return _Value(form=stacked([part.form for part in parts]), slope=(low, high))


class _Pass:
    """Chances and weights over one box, and one backward pass over it."""

    def __init__(
        self, model: CareBox, low: Mapping[str, Fraction], high: Mapping[str, Fraction]
    ) -> None:
        self.model, self.rules = model, model.rules
        self.names = tuple(name for name in model.names if low[name] < high[name])
        unknowns = np.eye(len(self.names))
        forms, moves = [], []
        for parameter in model.scenario.parameters:
            centre, slope = (
                float(low.get(parameter.name, parameter.value)),
                0 * unknowns.sum(axis=0),
            )
            unit = slope
            if parameter.name in self.names:
                ends = low[parameter.name], high[parameter.name]
                unit = unknowns[self.names.index(parameter.name)]
                centre = float((ends[0] + ends[1]) / 2)
                slope = unit * float((ends[1] - ends[0]) / 2)
            rest = UNIT * (abs(centre) + float(np.abs(slope).sum()))
            forms.append(Forms.of(np.array(centre), slope, np.array(rest)))
            moves.append(unit)
        self.parameters = _Value(form=stacked(forms), slope=(np.stack(moves),) * 2)
        self.place = {name: number for number, name in enumerate(model.chances.names)}
        chance, use = self._chances()
        step, skip = model.chances.step, model.chances.skip
        self.step = chance[step], (use[0][step], use[1][step])
        self.skip = chance[skip], (use[0][skip], use[1][skip])

    def _chances(self) -> tuple[Forms, Span]:
        """Return the chances (U,), and the least and greatest share of each unknown (U, J)."""
        terms, none = self.model.chances.terms, len(self.place)
        nothing = Forms.constant(np.zeros(1), len(self.names))
        table = chained(self.parameters.form, nothing)
        moves = np.concatenate([self.parameters.slope[0], np.zeros((1, len(self.names)))])
        total, use = table[terms[:, 0]], moves[terms[:, 0]]
        for column in range(1, terms.shape[1]):
            total = total + table[terms[:, column]]
            use = np.maximum(use, moves[terms[:, column]])
        least, most = total.low, total.high
        # A parameter alone is at most 1; only a sum can be cut off.
        alone = (terms[:, 1:] == none).all(axis=1)
        over, cut = (least >= 1) & ~alone, (least < 1) & (most > 1) & ~alone
        bottom = np.clip(least, 0.0, 1.0)
        middle = np.where(over, 1.0, np.where(cut, (bottom + 1) / 2, total.centre))
        half = np.where(over, 0.0, np.where(cut, (1 - bottom) / 2 * (1 + OUT) + UNIT, total.rest))
        linear = np.where((over | cut)[:, None], 0.0, total.slope)
        moving = use * ~over[:, None]
        within = bottom, np.minimum(most, 1.0)
        return Forms.of(middle, linear, half, within), (moving * ~cut[:, None], moving)

    def _earned(self, names: Sequence[str]) -> _Value:
        """Return the sum of some reward weights, from none on."""
        zero = np.zeros(len(self.names))
        total = _Value(form=Forms.constant(np.array(0.0), len(zero)), slope=(zero, zero))
        for name in names:
            total = total + self.parameters[self.place[f"reward.{name}"]]
        return total

    def _event(self, event: str, place: int, flag: int) -> _Value:
        return self._earned(self.rules.charged(event, place, flag))

    @cached_property
    def _cost(self) -> _Value:
        """What the statuses of each vector are charged, (2^n,)."""
        scenario = self.model.scenario
        weights = [scenario.weights[status] for status in scenario.statuses]
        return _beside(
            [
                self._earned([name for name, on in zip(weights, row, strict=True) if on])
                for row in self.rules.bits.tolist()
            ]
        )

    def _charged(self, value: _Value, times: int) -> _Value:
        """Return (2^n,) numbers with the cost of each vector, as often as the rules charge it."""
        for _ in range(times):
            value = value + self._cost
        return value

    def run(self) -> BoxBounds:
        """Return the bounds at the start."""
        rules = self.rules
        flat = np.zeros((rules.vectors, len(self.names)))
        nothing = Forms.constant(np.zeros(rules.vectors), len(self.names))
        # Values at a subtask's first trial, by flag.
        after = [_Value(form=nothing, slope=(flat, flat))] * rules.flags
        for subtask in range(len(rules.places) - 1, -1, -1):
            place = int(rules.places[subtask])
            state = [self._skip(after[rules.kept[place, 1]], place)] * rules.flags
            for trial in range(rules.trials - 1, -1, -1):
                state = [
                    self._trial(
                        self.model.policy[subtask, trial, flag],
                        self._event("complete", place, flag)
                        + after[rules.kept[place, flag]][0].scaled(self.model.discount),
                        state[flag],
                        last=trial == rules.trials - 1,
                    )
                    for flag in range(rules.flags)
                ]
            after = state
        start = after[0][0]
        slopes = zip(self.names, *(end.tolist() for end in start.slope), strict=True)
        return BoxBounds(
            low=float(start.form.low),
            high=float(start.form.high),
            slopes={name: (below, above) for name, below, above in slopes},
        )

    def _skip(self, onward: _Value, place: int) -> _Value:
        """Return (2^n,) what a skip from each status vector is worth."""
        rules, payoff = self.rules, onward.scaled(self.model.discount)
        payoff = self._charged(payoff, rules.next * rules.own)
        low, high = payoff.slope
        form, slope = expected(payoff.form[None], (low[None], high[None]), *self.skip)
        found = _Value(form=form, slope=slope) + self._event("skip", place, 1)
        return self._charged(found, rules.now * rules.own)

    def _trial(self, policy: Floats, done: _Value, failed: _Value, *, last: bool) -> _Value:
        """Return (2^n,) the values of a trial, from those of completing and of failing it."""
        rules, actions = self.rules, self.model.scenario.actions
        worth = failed if last and not rules.own else failed.scaled(self.model.discount)
        worth = self._charged(worth + self._event("fail", 0, 0), rules.next)
        parts = []
        for action in actions:  # the payoffs of next vectors, action by action
            first = done + self._earned([f"assist.{action}"])
            ends = [
                np.concatenate([a[None], b[1:]])
                for a, b in zip(first.slope, worth.slope, strict=True)
            ]
            form = chained(first.form[None], worth.form[1:])
            parts.append(_Value(form=form, slope=(ends[0], ends[1])))
        payoff = _beside(parts)
        low, high = payoff.slope
        form, slope = expected(payoff.form[None], (low[None], high[None]), *self.step)
        below, above = ((end * policy[..., None]).sum(axis=1) for end in slope)
        found = _Value(form=form.scaled(policy).total(1), slope=(below, above))
        found = self._charged(found, rules.now)
        return _Value(form=found.form, slope=wider(*found.slope))
