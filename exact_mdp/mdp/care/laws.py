"""The numbers of a care model: chances, gains and costs by the rules, exact or of many draws.

With the chance p_i of each status the next vector follows the law of independent bits,

    K(s') = Π_i p_i^{s'_i} (1 - p_i)^{1 - s'_i}.

Numbers are integers over denominators, or floats with an axis of draws in front: the explicit
matrix and batches of drawn parameters read the same statements. A sum above 1 is not a probability:
`warn_of_excess` names it wherever a model is made of it.
Source: Yuan et al. (2025), Section 2.1.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from math import prod
from typing import Self

import numpy as np

from exact_mdp.mdp.care.rules import Rules, rules_of
from exact_mdp.mdp.care.tables import ScenarioTables
from exact_mdp.mdp.errors import ScenarioWarning
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
    """The rules of a scenario at its numbers, or at those of D draws, an axis in front."""

    scenario: ScenarioTables
    rules: Rules
    sums: Numbers  # (…, U) the sums of terms, not cut off, over `one`
    one: int
    top: Numbers  # (…, U) the chances, cut off at 1, in lowest terms
    bottom: Numbers  # (U,)
    reward: Numbers  # (…, P+1) the weights by position, over `scale`
    scale: int

    @classmethod
    def of(cls, scenario: ScenarioTables) -> Self:
        """Return the exact laws of a scenario."""
        rules, values = rules_of(scenario), [each.value for each in scenario.parameters]
        used = np.flatnonzero(np.bincount(rules.terms.reshape(-1))[: len(values)])
        tops, one = to_common_denominator([values[place] for place in used.tolist()])
        small = one * (rules.terms.shape[1] + 1) < EXACT_IN_INT64
        numbers = np.zeros(len(values) + 1, dtype=np.int64 if small else object)
        numbers[used] = tops
        sums = _sum_at_positions(numbers, rules.terms)
        chances = [Fraction(min(total, one), one) for total in sums.tolist()]
        weights, scale = to_common_denominator([values[place] for place in rules.weights.tolist()])
        # A gain adds up weights, each at most once: this is the type that holds every such sum.
        narrow = sum(map(abs, weights)) < EXACT_IN_INT64
        reward = np.zeros(len(values) + 1, dtype=np.int64 if narrow else object)
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
        """Return the laws of draws (D, P+1) of all parameters, and 0."""
        rules = rules_of(scenario)
        sums, bottom = _sum_at_positions(numbers, rules.terms), np.ones(len(rules.terms))
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
        """(…, G) the gains."""
        return _sum_at_positions(self.reward, self.rules.charges)

    @cached_property
    def assist(self) -> Numbers:
        """(…, A) what an action adds where the subtask is completed."""
        return np.asarray(self.reward[..., self.rules.weights[-self.rules.assistive :]])

    @cached_property
    def cost(self) -> Numbers:
        """(…, 2^n) the weights of the statuses in a vector."""
        bits, charged = self.rules.bits, self.rules.weights
        return _sum_at_positions(
            self.reward, np.where(bits, charged[: bits.shape[1]], len(self.rules.names))
        )

    def compute_denominators(self, which: Integers) -> list[int]:
        """Return the denominators of rows, whose chances `which` (R, n) names."""
        bottom = self.bottom.tolist()
        return [prod(bottom[k] for k in row) for row in which.tolist()]

    def compute_distributions(self, which: Integers) -> tuple[Numbers, Numbers]:
        """Return (R, 2^n) integers over (R,): the law of the next vector in each of some rows."""
        bottom = to_integer_array(self.compute_denominators(which))
        chances = self.top, self.bottom - self.top
        one, none = (each[which.T].astype(bottom.dtype) for each in chances)
        law = np.empty((1 << len(one), len(which)), dtype=bottom.dtype)
        fill_joint_distribution(one, none, law)
        return law.T, bottom


def fill_joint_distribution(one: Numbers, none: Numbers, law: Numbers) -> None:
    """Write the law (2^n, R) of n bits that are 1 and 0 with the weights (n, R)."""
    law[0] = 1
    for i in range(len(one)):
        for prefix in range((1 << i) - 1, -1, -1):
            np.multiply(law[prefix], one[i], law[2 * prefix + 1])
            np.multiply(law[prefix], none[i], law[2 * prefix])


def _sum_at_positions(numbers: Numbers, places: Integers) -> Numbers:
    """Return (…, k) the sums of numbers (…, P+1) at the places (k, m), one after the other."""
    return reduce(np.add, (np.take(numbers, column, axis=-1) for column in places.T))


def describe_excess(laws: Laws) -> str | None:
    """Return in one line which chances pass 1 and are cut off there, or None where none does.

    Sums are compared exactly. No chance can be negative: every term lies in [0, 1].
    """
    rules, sums = laws.rules, laws.sums
    used = np.bincount(np.append(rules.step, rules.skip), minlength=len(sums))
    over = np.flatnonzero(used * np.array(sums > laws.one, dtype=bool))
    if not len(over):
        return None
    greatest, first = max(zip(sums[over].tolist(), over.tolist(), strict=True))
    added = " + ".join(
        f"{rules.names[k]} {format_rational(laws.scenario.parameters[k].value)}"
        for k in rules.terms[first].tolist()
        if k < len(rules.names)
    )
    more = int(used[over].sum()) - 1
    others = f"; so are {more} others" if more else ""
    chance = format_rational(Fraction(greatest, laws.one))
    return f"a chance of {chance} is cut off at 1: {added}{others}"


def warn_of_excess(laws: Laws, *, where: str = "", stacklevel: int = 2) -> None:
    """Warn where a chance is cut off at 1.

    `where` is the part of an analysis; `stacklevel` as in `warnings.warn`, 2 for the caller's line.
    """
    if message := describe_excess(laws):
        text = f"scenario {laws.scenario.name}{where}: {message}"
        warnings.warn(text, ScenarioWarning, stacklevel=stacklevel + 1)
