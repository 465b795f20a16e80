"""How large the explicit model of a care scenario would be, before any of it is built.

A row of a trial has as many outcomes as there are next status vectors s' of positive chance. Where
a failed trial ends in a skip there are more: one for each cost of s' and each vector z that the
skip may make of it,

    1 + Σ over costs c of  min(2^n, Σ over s' ≠ 0 of cost c of the number of z that s' leads to),

and one for each cost where the model ends there. These are upper bounds, as if every s' could come
from everywhere. Each outcome takes 41 bytes at the peak of compilation (the published scenario with
10,000 subtasks), and 231 where probabilities have no 64-bit denominators (8 statuses with distinct
weights, 2 subtasks): Python's integers, and rows to merge.
"""

from __future__ import annotations

from fractions import Fraction
from math import lcm, prod

from exact_mdp.mdp.care.laws import chances
from exact_mdp.mdp.care.tables import Tables
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import EXACT_IN_INT64, MOST_BYTES, NARROW, WIDE, Integers, common

MOST_STATUSES = 10


def check_explicit(scenario: Tables) -> None:
    """Raise ModelError where a scenario is too large for an explicit transition matrix.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> check_explicit(Scenario.load("yuan2025").with_(tasks=[10_000]))
    >>> check_explicit(Scenario.load("yuan2025").with_(tasks=[90_000]))
    Traceback (most recent call last):
    ...
    exact_mdp.mdp.errors.ModelError: the explicit model would have 7,200,000 states and up to...
    """
    where = f"scenario {scenario.name}"
    fix = (
        "use fewer subtasks, trials or statuses, or the form without a matrix: "
        "`exact-mdp solve … --operator`, in Python Scenario.operator()"
    )
    count = len(scenario.statuses)
    if count > MOST_STATUSES:
        raise ModelError(
            f"{count} statuses, more than the {MOST_STATUSES} of an explicit model",
            where=where,
            fix=fix,
        )
    size = Size(scenario)
    most, each = size.outcomes, NARROW if size.denominator < EXACT_IN_INT64 else WIDE
    if most * each > MOST_BYTES:
        states = sum(scenario.tasks) * scenario.trials * 2**count
        raise ModelError(
            f"the explicit model would have {states:,} states and up to {most:,} outcomes of "
            f"{each} bytes each, more than {MOST_BYTES / 1e9:g} GB",
            where=where,
            fix=fix,
        )


class Size:
    """What is known of a scenario's table before it is built.

    Attributes
    ----------
    outcomes : int
        How many there are at most.
    denominator : int
        The greatest one of an outcome's probability, before anything cancels.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> Size(scenario).outcomes, len(scenario.compile().table.next)
    (16481, 11005)
    """

    def __init__(self, scenario: Tables) -> None:
        found = chances(scenario)
        values = [parameter.value for parameter in scenario.parameters]
        known: dict[tuple[int, ...], Fraction] = {}

        def chance(terms: list[int]) -> Fraction:
            key = tuple(terms)
            if key not in known:
                total = sum((values[k] for k in key if k < len(values)), Fraction(0))
                known[key] = min(Fraction(1), total)
            return known[key]

        def reach(terms: Integers) -> tuple[list[int], set[int]]:
            """Return how many vectors each row leads to, and the rows' denominators."""
            rows = [[chance(terms) for terms in row] for row in terms.tolist()]
            ends = [2 ** sum(0 < p < 1 for p in row) for row in rows]
            return ends, {prod(p.denominator for p in row) for row in rows}

        count, vectors = len(scenario.statuses), 2 ** len(scenario.statuses)
        step, bottoms = reach(found.step.reshape(-1, count, count))
        skip, skip_bottoms = reach(found.skip)
        self.denominator = max(bottoms) * lcm(*skip_bottoms)
        costs = _costs(scenario)
        failed: dict[int, int] = {}
        for cost, ends in list(zip(costs, skip, strict=True))[1:]:
            failed[cost] = min(vectors, failed.get(cost, 0) + ends)
        own = scenario.readings["skip_timestep"] == "own"
        flags = 2 if scenario.readings["task_bonus"] == "no-subtask-skipped" else 1
        trying = (scenario.trials - (not own)) * sum(step)
        skipping = sum(skip) if own else len(step) * (1 + sum(failed.values()))
        ending = vectors * len(set(costs)) if own else len(step) * (1 + len(failed))
        subtasks = sum(scenario.tasks)
        each = subtasks * trying + (subtasks - 1) * skipping + ending
        self.outcomes = flags * each + 1


def _costs(scenario: Tables) -> list[int]:
    """Return (2^n,) what each next status vector costs, as integers over one denominator."""
    worth, _ = common([scenario[f"reward.{scenario.weights[name]}"] for name in scenario.statuses])
    if scenario.readings["status_cost"] != "next":
        worth = [0] * len(worth)
    costs = [0]
    for more in worth:  # the first status is the most significant digit
        costs = [cost + extra for cost in costs for extra in (0, more)]
    return costs
