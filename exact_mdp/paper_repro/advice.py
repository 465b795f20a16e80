"""Which assistance is best in which situation, and how sure that is: the first table of the page.

An assistance is best in a situation if it is optimal in all its statuses, in every subtask and
trial, by the exact certificate. How sure that is has two sides: in how many readings of the text
the same assistance is best, and how far the number on which it hinges most may be worse than in the
paper. That number is how often the assistance leaves the status in place that it is to end; if
there is no status, it is the price of the assistance. It gets worse step by step, so the last step
at which the assistance is still best is found by bisection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp import ModelError
from exact_mdp.paper_repro.compiled import compute_costs, list_optimal_actions
from exact_mdp.paper_repro.paper import ACTIONS, ANGRY, FINAL, OPEN
from exact_mdp.paper_repro.silent_points import Reading


@dataclass(frozen=True, kw_only=True)
class Situation:
    """Statuses that one assistance suits, and the status that it is to end."""

    person: str
    statuses: tuple[str, ...]
    ends: str = ""  # empty if no status is present


SITUATIONS = (
    Situation(person="well", statuses=("0000",)),
    Situation(person="confused only", statuses=("0100",), ends="confusion"),
    Situation(person="forgetful only", statuses=("1000",), ends="forgetfulness"),
    Situation(person="forgetful and confused", statuses=("1100",), ends="confusion"),
    Situation(person="angry, whatever else", statuses=ANGRY, ends="anger"),
    Situation(person="disengaged, not angry", statuses=OPEN, ends="disengagement"),
)


def advise(reading: Reading, others: Sequence[Reading]) -> list[dict[str, Any]]:
    """Return the best assistance of each situation, what others lose, and how sure that is."""
    lost, paper = compute_costs(reading), reading.find_reported_policy(FINAL)
    # The order of "respectively" belongs to the reported policy: one model counts once.
    models: dict[tuple[Any, ...], Reading] = {}
    for each in (reading, *others):
        scenario = each.scenario
        rules = (*scenario.readings.items(), scenario.tasks, scenario.discount)
        models.setdefault(rules, each)
    rows = []
    for situation in SITUATIONS:
        action = find_best_action(reading, situation)
        rest = []  # what the second best assistance loses in each status
        for status in situation.statuses:
            rest.append(float(np.sort(lost[int(status, 2)])[1]))
        said = sorted({paper[status] for status in situation.statuses} - {action})
        rows.append(
            {
                "person": situation.person,
                "statuses": list(situation.statuses),
                "best": action,
                "mentioned": situation.statuses != OPEN,
                "paper_differs": said,
                "second_best_loses": [min(rest), max(rest)],
                "versions": len(models),
                "agreeing": sum(is_best(action, each, situation) for each in models.values()),
                "ends": situation.ends,
                **find_limit(action, reading, situation),
            }
        )
    return rows


def is_best(action: str, reading: Reading, situation: Situation) -> bool:
    """Return whether an assistance is optimal throughout a situation."""
    for status in situation.statuses:
        if not all(action in best for best in list_optimal_actions(reading, status)):
            return False
    return True


def find_best_action(reading: Reading, situation: Situation) -> str:
    """Return the assistance that is optimal throughout a situation."""
    for action in ACTIONS:
        if is_best(action, reading, situation):
            return action
    raise ModelError(
        f"no assistance is best in all statuses of a person who is {situation.person}",
        where=reading.label,
        fix="divide this situation in advice.py",
    )


def find_limit(action: str, reading: Reading, situation: Situation) -> dict[str, Any]:
    """Return the decisive number of an assistance as it is, and the worst with which it is best."""
    if situation.ends:
        name, step = f"assistance.{action}.{situation.ends}.persistence", Fraction(1, 100)
    else:
        name, step = f"reward.assist.{action}", Fraction(-1)
    today = reading.scenario[name]

    def holds(steps: int) -> bool:
        scenario = reading.scenario.with_(parameters={name: today + steps * step})
        return is_best(action, replace(reading, scenario=scenario), situation)

    low, high = 0, 95  # at 100 %, or 95 points more, an assistance is useless
    while high - low > 1:
        middle = (low + high) // 2
        if holds(middle):
            low = middle
        else:
            high = middle
    return {"parameter": name, "today": float(today), "limit": float(today + low * step)}
