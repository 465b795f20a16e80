"""The numbers of a care model: probabilities, gains and costs by the rules, exact or for draws.

With the probability p_i of each status, the next vector has the distribution of independent bits,

    K(s') = Π_i p_i^{s'_i} (1 - p_i)^{1 - s'_i}.

Numbers are integers over denominators, or floats with an axis of draws at the end: the explicit
matrix and stacked models of drawn parameters use the same rules. A sum above 1 is not a
probability: `warn_of_excess` reports it when a model is built.
Source: Yuan et al. (2025), Section 2.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from math import prod
from typing import Self

import numpy as np

from exact_mdp.mdp.care.rules import Rules, rules_of
from exact_mdp.mdp.care.tables import ScenarioTables
from exact_mdp.mdp.errors import ScenarioWarning, warn_user
from exact_mdp.mdp.table import (
    EXACT_IN_INT64,
    Floats,
    Integers,
    Numbers,
    format_rational,
    to_common_denominator,
    to_integer_array,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Laws:
    """The rules of a scenario with its numbers, or with D draws of them, on an axis at the end."""

    scenario: ScenarioTables
    rules: Rules
    sums: Numbers  # (U, …) the sums of terms, not cut off, over `one`
    one: int
    top: Numbers  # (U, …) the chances, cut off at 1, in lowest terms
    bottom: Numbers  # (U,), or (U, 1) of ones for draws
    reward: Numbers  # (P+1, …) the weights by position, over `scale`
    scale: int

    @classmethod
    def of(cls, scenario: ScenarioTables) -> Self:
        """Return the exact laws of a scenario."""
        # Probabilities over a common denominator `one`, in 64-bit integers if their sums fit.
        rules, values = rules_of(scenario), [each.value for each in scenario.parameters]
        used = np.flatnonzero(np.bincount(rules.terms.reshape(-1))[: len(values)])
        tops, one = to_common_denominator([values[place] for place in used.tolist()])
        kind: type = object
        if one * (rules.terms.shape[1] + 1) < EXACT_IN_INT64:
            kind = np.int64
        numbers: Numbers = np.zeros(len(values) + 1, dtype=kind)
        numbers[used] = tops
        # Chances are sums of terms, cut off at 1.
        sums = _sum_at_positions(numbers, rules.terms)
        chances = [Fraction(min(total, one), one) for total in sums.tolist()]
        weights, scale = to_common_denominator([values[place] for place in rules.weights.tolist()])
        # A gain is a sum of weights, each at most once: choose a type that holds every such sum.
        kind = object
        if sum(map(abs, weights)) < EXACT_IN_INT64:
            kind = np.int64
        reward: Numbers = np.zeros(len(values) + 1, dtype=kind)
        reward[rules.weights] = weights
        return cls(
            scenario=scenario,
            rules=rules,
            sums=sums,
            one=one,
            top=to_integer_array(chance.numerator for chance in chances),
            bottom=to_integer_array(chance.denominator for chance in chances),
            reward=reward,
            scale=scale,
        )

    @classmethod
    def from_draws(cls, scenario: ScenarioTables, numbers: Floats) -> Self:
        """Return the laws of draws (P+1, D) of all parameters, and 0."""
        rules = rules_of(scenario)
        sums = _sum_at_positions(numbers, rules.terms)
        bottom = np.ones((len(rules.terms), 1), dtype=np.int64)
        return cls(
            scenario=scenario,
            rules=rules,
            sums=sums,
            one=1,
            top=np.minimum(sums, 1.0),
            bottom=bottom,
            reward=numbers,
            scale=1,
        )

    @cached_property
    def gain(self) -> Numbers:
        """(G, …) the gains."""
        return _sum_at_positions(self.reward, self.rules.charges)

    @cached_property
    def assist(self) -> Numbers:
        """(A, …) the weight of each action, charged if the subtask is completed."""
        return np.asarray(self.reward[self.rules.weights[-self.rules.assistive :]])

    @cached_property
    def cost(self) -> Numbers:
        """(2^n, …) the sum of the weights of the statuses in each vector."""
        bits, charged = self.rules.bits, self.rules.weights
        return _sum_at_positions(
            self.reward, np.where(bits, charged[: bits.shape[1]], len(self.rules.names))
        )

    def compute_denominators(self, which: Integers) -> list[int]:
        """Return the denominators of rows with the probabilities `which` (R, n)."""
        bottom = self.bottom.reshape(-1).tolist()
        products = []
        for row in which.tolist():
            products.append(prod(bottom[k] for k in row))
        return products

    def compute_distributions(self, which: Integers) -> tuple[Numbers, Numbers]:
        """Return the distributions of the next vector: numbers (R, 2^n, …) over integers (R,)."""
        bottom = to_integer_array(self.compute_denominators(which))
        kind = np.result_type(self.top, bottom)
        chances = self.top, self.bottom - self.top
        one, none = (each[which.T].astype(kind) for each in chances)
        law = np.empty((1 << len(one), *one.shape[1:]), dtype=kind)
        fill_joint_distribution(one, none, law)
        return law.swapaxes(0, 1), bottom


def fill_joint_distribution(one: Numbers, none: Numbers, law: Numbers) -> None:
    """Write the distribution (2^n, R, …) of n independent bits, whose weights are (n, R, …)."""
    # Each bit splits the entries of all vectors of the bits before it in two, in place.
    law[0] = 1
    for i in range(len(one)):
        for prefix in range((1 << i) - 1, -1, -1):
            np.multiply(law[prefix], one[i], law[2 * prefix + 1])
            np.multiply(law[prefix], none[i], law[2 * prefix])


def _sum_at_positions(numbers: Numbers, places: Integers) -> Numbers:
    """Return the sums (k, …) of numbers (P+1, …) at the places (k, m)."""
    return reduce(np.add, (numbers[column] for column in places.T))


def describe_excess(laws: Laws) -> str | None:
    """Return a line about the probabilities that are cut off at 1; None if there are none.

    Sums are compared exactly. No probability can be negative: every term is in [0, 1].
    """
    # The sums above 1 that some state uses; the line names the greatest.
    rules, sums = laws.rules, laws.sums
    used = np.bincount(np.append(rules.step, rules.skip), minlength=len(sums))
    over = np.flatnonzero(used * np.array(sums > laws.one, dtype=bool))
    if not len(over):
        return None
    greatest, first = max(zip(sums[over].tolist(), over.tolist(), strict=True))
    added = []
    for k in rules.terms[first].tolist():
        if k < len(rules.names):
            added.append(f"{rules.names[k]} {format_rational(laws.scenario.parameters[k].value)}")
    chance = format_rational(Fraction(greatest, laws.one))
    line = f"a chance of {chance} is cut off at 1: {' + '.join(added)}"
    more = int(used[over].sum()) - 1
    if more:
        line += f"; so are {more} others"
    return line


def warn_of_excess(laws: Laws, *, where: str = "") -> None:
    """Warn if a probability is cut off at 1; `where` names the part of an analysis."""
    message = describe_excess(laws)
    if message:
        warn_user(f"scenario {laws.scenario.name}{where}: {message}", ScenarioWarning)
