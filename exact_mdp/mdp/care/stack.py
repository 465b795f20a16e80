"""The models of many draws of a scenario's numbers, as one structure with many sets of numbers.

Every chance of the explicit model is a product of chances of statuses, K(s' | s, a), or, for a
skip that follows the last trial, a sum of such products, Σ_{s' ≠ 0} K(s' | s, a) Z(z | s'). Which
number belongs to which outcome follows once from the outcomes that `mdp.care.compile` lists. Equal
numbers are stored once: a step has the same chances in all trials and subtasks, and the same
rewards in all trials and in all subtasks at the same place.

Here outcomes of probability 0 are kept, as another draw may make them possible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.care.compile import Step, Subtask, list_steps
from exact_mdp.mdp.care.laws import Laws
from exact_mdp.mdp.care.rules import FINAL, Rules
from exact_mdp.mdp.care.tables import ScenarioTables
from exact_mdp.mdp.table import Floats, Integers


@dataclass(frozen=True, kw_only=True, eq=False)
class ScenarioOutcomes:
    """The outcomes of a scenario's model, and where its numbers are in tables of draws."""

    offsets: Integers  # (L + 1,) the first outcome of each pair
    column: Integers  # (N,) the next state of each outcome
    number: Integers  # (N,) the row of its chance
    earned: Integers  # (L,) the row of the reward of each pair

    @classmethod
    def of(cls, scenario: ScenarioTables) -> ScenarioOutcomes:
        """Return the outcomes of a scenario, by its rules."""
        subtask = Subtask(Laws.of(scenario))
        rules, rows = subtask.laws.rules, 0
        counts, columns, numbers, earned = ([list[Integers]() for _ in range(4)])
        # The rows of rewards of each kind of step.
        first = {}
        for place, step in _list_kinds(rules):
            first[place, step] = rows
            rows += len(_list_rows(rules, step))
        for k, place in enumerate(rules.places.tolist()):
            for step in list_steps(rules):
                pairs = _list_rows(rules, step)
                branches = subtask.list_outcomes(place, step)
                chosen, states = [], []
                for branch in branches:
                    chosen.append(branch.chosen)
                    states.append(branch.state)
                if _is_scattered(place, step):
                    vectors = np.arange(rules.vectors)
                    chosen[-1] = _count_trial_rows(rules) * rules.vectors + vectors
                column = np.concatenate(states) + k * rules.size
                number = np.concatenate(chosen) + pairs[:, None] * rules.vectors
                counts.append(np.full(len(pairs), len(column)))
                columns.append(np.tile(column, len(pairs)))
                numbers.append(number.reshape(-1))
                kind = step._replace(trial=0)
                earned.append(first[place, kind] + np.arange(len(pairs)))
        # The end stays put, with the last chance, which is 1, and the last reward, which is 0.
        last = _count_chances(rules)
        for parts, number in ((counts, 1), (columns, len(rules.places) * rules.size)):
            parts.append(np.array([number]))
        numbers.append(np.array([last]))
        earned.append(np.array([rows]))
        return cls(
            offsets=np.append(0, np.cumsum(np.concatenate(counts))),
            column=np.concatenate(columns),
            number=np.concatenate(numbers),
            earned=np.concatenate(earned),
        )


def compute_numbers(laws: Laws) -> tuple[Floats, Floats]:
    """Return the chances (K, D) and rewards (R, D) of D draws."""
    subtask, rules = Subtask(laws), laws.rules
    draws = laws.top.shape[1]
    # The chances of every vector after a trial, and after a skip.
    chances = [subtask.step.reshape(-1, draws)]
    if rules.own:
        chances.append(subtask.skip.reshape(-1, draws))
    else:
        # A skip follows a trial that ends with any vector but 0: one matrix product in each draw.
        failed = np.ascontiguousarray(np.moveaxis(subtask.step[:, :, 1:], -1, 0))
        after = np.ascontiguousarray(np.moveaxis(subtask.skip[1:], -1, 0))
        both = failed.reshape(draws, -1, rules.vectors - 1) @ after
        chances.append(np.moveaxis(both, 0, -1).reshape(-1, draws))
    chances.append(np.ones((1, draws)))
    # The rewards: costs of statuses, and the gains of the outcomes.
    costs = {}
    for tries, law in ((True, subtask.step), (False, subtask.skip[:, None])):
        costs[tries] = np.einsum("sazd,zd->sad", law, subtask.following)
        costs[tries] += subtask.present[:, None]
    amounts = []
    for place, step in _list_kinds(rules):
        law = subtask.step if step.tries else subtask.skip[:, None]
        amount = costs[step.tries].copy()
        for branch in subtask.list_outcomes(place, step):
            amount += law[:, :, branch.chosen].sum(axis=2) * branch.gain[:, 0]
        amounts.append(amount.reshape(-1, draws))
    amounts.append(np.zeros((1, draws)))
    return np.concatenate(chances), np.concatenate(amounts)


def _list_kinds(rules: Rules) -> list[tuple[int, Step]]:
    """Return the steps that differ in their rewards, with their places; they are of trial 0."""
    kinds = {}
    for place in np.unique(rules.places).tolist():
        for step in list_steps(rules):
            kinds[place, step._replace(trial=0)] = None
    return [*kinds]


def _is_scattered(place: int, step: Step) -> bool:
    """Return whether a skip draws the next vectors of a trial again; the last of all does not."""
    return step.tries and step.skips and place != FINAL


def _count_trial_rows(rules: Rules) -> int:
    """Return the number of distributions of vectors after a trial."""
    return rules.vectors * rules.assistive


def _list_rows(rules: Rules, step: Step) -> Integers:
    """Return the distribution of each pair of a step, as numbers in the table of chances."""
    trying = _count_trial_rows(rules)
    if step.tries:
        return np.arange(trying)
    return trying + np.arange(rules.vectors)


def _count_chances(rules: Rules) -> int:
    """Return the number of chances that are not certain."""
    rows = 2 * _count_trial_rows(rules)
    if rules.own:
        rows = _count_trial_rows(rules) + rules.vectors
    return rows * rules.vectors
