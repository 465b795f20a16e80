"""Today's optimum under another reading of the text, and whether it is an optimum there as well.

A state of the reading is the state of today's model with the same columns. Where there is none,
because the tasks are others or because today's model leaves no choice there, it is the state with
the same status at subtask 0, trial 0. Let A(s) be the actions that are optimal today in the state
that s is, and B(s) those that are optimal in s. Today's optimum is one under the reading, too,
where some policy with π(s) ∈ A(s) ∩ B(s) never leaves the states that have such an action: the
greatest set of states from which that can be kept up contains the start. The policy that is
carried over takes such actions there, and today's optimal ones elsewhere, so that it loses
something exactly where the optimum changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.solution import Solution

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Today:
    """The optimal actions of the model as it is.

    Attributes
    ----------
    tasks : tuple of int
    space : StateSpace
    free : (S,) bool
        Where there is a choice.
    optimal : (S, A) bool
        By the scenario's actions; all False where none of them is available.
    actions : (S,)
        One of them.
    """

    tasks: tuple[int, ...]
    space: StateSpace
    free: Mask
    optimal: Mask
    actions: Integers

    @classmethod
    def of(cls, scenario: Scenario, mdp: MDP, solution: Solution) -> Today:
        """Return the optimal actions, those that differ by rounding alone included."""
        optimal = np.zeros((mdp.n_states, len(scenario.actions)), dtype=bool)
        number = _numbers(scenario, mdp)
        mine = number >= 0
        optimal[mdp.pair_state[mine], number[mine]] = best_pairs(mdp, solution)[mine]
        return cls(
            tasks=scenario.tasks,
            space=mdp.space,
            free=~mdp.forced,
            optimal=optimal,
            actions=np.maximum(number[solution.pairs], 0),
        )

    def carried(self, scenario: Scenario, mdp: MDP, solution: Solution) -> tuple[Integers, bool]:
        """Return today's optimum under a reading, (S,) actions, and whether the optimum changes."""
        state, number = self._states(scenario, mdp), _numbers(scenario, mdp)
        alike = self.optimal[state[mdp.pair_state], number] & (number >= 0)
        both = (alike | mdp.forced[mdp.pair_state]) & best_pairs(mdp, solution)
        while True:
            kept = np.logical_or.reduceat(both, mdp.pair_offsets[:-1])
            leaves = mdp.transition @ (~kept).astype(np.float64) > 0
            if not (both & leaves).any():
                break
            both &= ~leaves
        changes = not kept[[state for state, weight in mdp.start if weight]].all()
        names = np.array([mdp.action(name) for name in scenario.actions])
        only = mdp.pair_action[mdp.pair_offsets[:-1]]
        choices = np.where(mdp.forced, only, names[self.actions[state]])
        pairs = np.flatnonzero(both)[::-1]  # the first of several is written last
        choices[mdp.pair_state[pairs]] = mdp.pair_action[pairs]
        return choices, bool(changes)

    def _states(self, scenario: Scenario, mdp: MDP) -> Integers:
        """Return (S,) the state of today's model that each state of a reading is."""
        nothing = np.zeros(mdp.n_states, dtype=np.int64)
        fits = np.full(mdp.n_states, self.tasks == scenario.tasks)
        same, first = nothing, nothing
        for column in self.space.columns:
            known = column.name in mdp.space.names
            value = np.maximum(mdp.space.values(column.name), 0) if known else nothing
            fits &= value < column.size
            same = same * column.size + np.minimum(value, column.size - 1)
            first = first * column.size + (value if column.name == "status" else 0)
        return np.where(fits & self.free[same], same, first)


def best_pairs(mdp: MDP, solution: Solution) -> Mask:
    """Return (L,) whether a pair is optimal, up to rounding."""
    lost = solution.value[mdp.pair_state] - mdp.backup(solution.value)
    return np.asarray(lost <= 2 * solution.error_bound)


def _numbers(scenario: Scenario, mdp: MDP) -> Integers:
    """Return (L,) which of the scenario's actions a pair takes; -1 for none of them."""
    place = np.full(mdp.n_actions, -1, dtype=np.int64)
    for number, name in enumerate(scenario.actions):
        place[mdp.action(name)] = number
    return place[mdp.pair_action]
