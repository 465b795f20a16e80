"""Rewards that count by the step in which they are earned: corrections of cohort models.

    V = E[ Σ_t γ^t w_t r_t ],    t = 0 … N-1

A cohort model counts people at the ends of its cycles, where life goes on within them. Of the
numbers at N points in time, "half-cycle" takes half of the first and the last (the trapezoidal
rule), and "simpson" the weights 1/3, 4/3, 2/3, 4/3, …, 4/3, 1/3, so N must be odd (Elbasha and
Chhatwal, PharmacoEconomics 34, 2016). n cycles have N = n + 1 points.

The way back: states and pairs keep their numbers.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.components import cancel_common_divisor, with_components
from exact_mdp.mdp.errors import ModelError, locate_errors, require_known_name
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.space import TIME
from exact_mdp.mdp.table import Numbers, OutcomeTable, exact, multiply, to_integer_array

RULES = ("half-cycle", "simpson")


def ask_step_weights(model: Any, weights: object) -> Any:
    """Return the model whose rewards have these weights: a rule, or one number for each step.

    Raises ModelError if the model has no time, or earns terminal values.
    """
    if model.space.names[:1] != (TIME,):
        fix = "stop its episodes first: mdp.within(N)"
        raise ModelError("the steps of this model have no number", where="weights", fix=fix)
    origin = origin_of(model)
    if origin is not None and origin.paid:
        raise ModelError(
            "a terminal value does not belong to a step",
            where="weights",
            fix="leave terminal_value out, and let an additional last step earn it",
        )
    # The last time has no steps, and extra states, whose time is -1, earn nothing.
    each = list_weights(weights, model.space.columns[0].size - 1)
    each += [Fraction(1), Fraction(1)]
    time = model.space.values(TIME, model.pair_state)
    top, below = (
        to_integer_array([getattr(weight, part) for weight in each])[time]
        for part in ("numerator", "denominator")
    )
    return replace(model, table=scale_rewards(model.table, top, below))


def list_weights(weights: object, steps: int) -> list[Fraction]:
    """Return the weight of each step."""
    if isinstance(weights, str):
        rule = require_known_name(weights, RULES, "rule", "weights")
        if rule == "half-cycle":
            ends, inner = Fraction(1, 2), [Fraction(1), Fraction(1)]
        else:
            ends, inner = Fraction(1, 3), [Fraction(4, 3), Fraction(2, 3)]
        if steps < 2 or (rule == "simpson" and steps % 2 == 0):
            need = "an odd number of steps, 3 or more" if rule == "simpson" else "2 steps"
            raise ModelError(
                f"{rule} weights of {steps} steps: the rule needs {need}",
                where="weights",
                fix='take one step more, "half-cycle", or a list of weights',
            )
        return [ends, *(inner[step % 2] for step in range(steps - 2)), ends]
    given = list(weights) if isinstance(weights, list | tuple | np.ndarray) else []
    if len(given) != steps:
        fix = f"give {steps} numbers, or one of {', '.join(RULES)}"
        raise ModelError(f"not one weight for each of {steps} steps", where="weights", fix=fix)
    with locate_errors("weights"):
        return [exact(weight) for weight in given]


def scale_rewards(table: OutcomeTable, top: Numbers, below: Numbers) -> OutcomeTable:
    """Return the table with the rewards of each pair times top / below (L,), exactly."""

    def scale(own: OutcomeTable) -> tuple[Numbers, Numbers]:
        gain, bottom = own.integer_gains
        factor = top
        if len(gain) != own.pairs:
            factor = top[own.pair]
        return cancel_common_divisor(multiply(gain, factor), multiply(bottom, below), own)

    scaled = replace(table.with_reward(*scale(table)), averaged=table.averaged)
    if table.components is None:
        return scaled
    count = table.components.shape[1]
    columns = [scale(table.with_component_reward(number)) for number in range(count)]
    return replace(with_components(scaled, columns), averaged=table.averaged)
