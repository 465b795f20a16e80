"""The rules of a care scenario, stated once: probabilities, charges and successors.

A state is (k, t, f, s): subtask k, t trials of it failed so far, f = 1 if a subtask of this task
was skipped (kept only if the bonus depends on it), status vector s. The next statuses are
independent, each with a chance that is a sum of parameters, cut off at 1:

    p_i(s, a) = min(1, Σ of the parameters in terms[step[s, a, i]])       under action a,
    z_i(s)    = min(1, Σ of the parameters in terms[skip[s, i]])          when a subtask is skipped.

Under an action a they have the distribution K_a(s, ·), on a skip Z(s, ·):

    complete   s' = 0 under K_a                 leads to k + 1, flag f
    fail       s' ≠ 0 under K_a                 leads to k, t + 1, s'
    skip       after the M-th fail, s'' by Z    leads to k + 1, flag 1, s''

If `skip_timestep` is own, a skip is a step of its own, t = M, in which *skip* is the only action;
else it belongs to the step of the M-th fail. A new task starts with f = 0; after the last subtask
comes the end. `CHARGES`, `BONUS` and `STATUS_COST` state the charges, besides assist.a for a
completed subtask; the vector 0 costs nothing. `Rules` applies them to a scenario, as positions of
its parameters; `mdp.care.laws` inserts the numbers.
Source: Yuan et al. (2025), Equation 1, Table 4 and Sections 2.1 and 3.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.care.tables import MAPPINGS, SKIP, ScenarioTables, bits_of
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Integers

INSIDE, LAST, FINAL = range(3)
"""Places of a subtask: inside a task, last of one, last of all."""

COMPLETE, FAIL, SKIPPED = range(3)

# Event, the weight that it charges, and the reading under which it is charged (None for all).
CHARGES: tuple[tuple[int, str, tuple[str, str] | None], ...] = (
    (COMPLETE, "timestep", None),
    (COMPLETE, "subtask-complete", None),
    (COMPLETE, "trial", ("trial_cost", "every-trial")),
    (FAIL, "timestep", None),
    (FAIL, "trial", None),
    (SKIPPED, "subtask-skip", None),
    (SKIPPED, "timestep", ("skip_timestep", "own")),
)

# The events, with their flags, after which the end of a task is rewarded.
BONUS: dict[str, tuple[tuple[int, int], ...]] = {
    "always": ((COMPLETE, 0), (COMPLETE, 1), (SKIPPED, 1)),
    "last-subtask-completed": ((COMPLETE, 0), (COMPLETE, 1)),
    "no-subtask-skipped": ((COMPLETE, 0),),
}

# Whether a step charges the statuses of its present vector, and of its next vector.
STATUS_COST = {"next": (0, 1), "current": (1, 0)}


class Rules:
    """The rules of all scenarios that differ in their numbers only.

    Positions are indices of parameters, with P for none. The states of a subtask are ordered by
    trial, flag and status vector; there are M `trials` with a choice, and 2 `flags` if the bonus
    depends on them.

    - `terms` (U, n): the positions of the terms of each of U probabilities; `step` (2^n, A, n) and
      `skip` (2^n, n) are the numbers of the probabilities of each status, under an action and on a
      skip.
    - `weights` (C,): the positions of the `components`, statuses first, actions last.
    - `charges` (G, …): the positions of the weights that add up to each of G gains; `gains`
      (3, 3, 2) is the number of the gain of an event, by place of the subtask and flag (the flag of
      the state, or 1 for a skip); `charged` (G, C) is 1 if a gain has a component.
    - `now`, `next`: whether a step charges the statuses of its present and of its next vector.
    - `places` (K,) of the subtasks; `flag_after` (3, 2): the flag at the start of the next one.
    """

    def __init__(self, scenario: ScenarioTables) -> None:
        names, statuses, actions = scenario.names, scenario.statuses, scenario.actions
        tasks, trials, components = scenario.tasks, scenario.trials, scenario.components
        self.names, self.statuses, self.trials = names, statuses, trials
        self.components, self.readings = components, dict(scenario.readings)
        self.now, self.next = STATUS_COST[self.readings["status_cost"]]
        self.own = self.readings["skip_timestep"] == "own"
        self.assistive = len(actions)
        self.actions = (*actions, SKIP) if self.own else actions
        # The flag, whether a subtask of the task was skipped, is kept only if the bonus depends on
        # it.
        paid = BONUS[self.readings["task_bonus"]]
        self.flags = 2 if (COMPLETE, 0) in paid and (COMPLETE, 1) not in paid else 1
        self.flag_after = np.zeros((3, 2), dtype=np.int64)
        self.flag_after[INSIDE, 1] = self.flags - 1
        # The size of a subtask: trials, flags and status vectors.
        self.bits = bits_of(len(statuses))
        self.vectors = len(self.bits)
        self.size = (trials + self.own) * self.flags * self.vectors
        # The place of each subtask: inside its task, last of it, or last of all.
        self.places = np.full(sum(tasks), INSIDE)
        self.places[np.cumsum(tasks) - 1] = LAST
        self.places[-1] = FINAL
        # Positions of the parameters, and of the weights among them.
        self.position = {name: place for place, name in enumerate(names)}
        self.weights = np.array([self.position[f"reward.{name}"] for name in components])
        # The weights that each event charges; equal sets of weights are one gain.
        rows: dict[tuple[int, ...], int] = {}
        self.gains = np.zeros((3, 3, 2), dtype=np.int64)
        for event, place, flag in np.ndindex(self.gains.shape):
            charged = []
            for of, weight, reading in CHARGES:
                if of == event and (reading is None or self.readings[reading[0]] == reading[1]):
                    charged.append(weight)
            if place != INSIDE and (event, flag) in paid:
                charged.append("task-complete")
            row = tuple(self.position[f"reward.{weight}"] for weight in charged)
            self.gains[event, place, flag] = rows.setdefault(row, len(rows))
        # Shorter sets are padded with P, the position of the number 0.
        widest = max(map(len, rows))
        self.charges = np.array([[*row, *[len(names)] * (widest - len(row))] for row in rows])
        self.charged = (self.charges[:, :, None] == self.weights).any(axis=1).astype(np.int64)
        self._add_chances(actions, scenario.others)

    def _add_chances(self, actions: tuple[str, ...], others: Mapping[str, str]) -> None:
        """Set `terms`, `step` and `skip`."""
        position, none, count = self.position, len(self.names), len(self.statuses)
        present, onset = self.bits.astype(bool), self.readings["skip_onset"]
        pushing = self.readings["influence_on_present"] == "additive"
        by_row = self.readings["influence_orientation"] == "row-to-column"
        self.step = np.empty((self.vectors, len(actions), count), dtype=np.int64)
        self.skip = np.empty((self.vectors, count), dtype=np.int64)
        terms: list[Integers] = []

        def add_terms(rows: Integers) -> int:
            """Add rows of terms (k, n), and return the number of the first."""
            terms.append(rows)
            return sum(map(len, terms)) - len(rows)

        def add_single_term(place: int) -> int:
            """Return the number of the probability that is a single parameter, or 0."""
            return add_terms(np.array([[place, *[none] * (count - 1)]]))

        nothing = add_single_term(none)
        for i, status in enumerate(self.statuses):
            here, (stays, comes) = present[:, i], (f"persistence.{status}", f"base.{status}")
            free = np.full((self.vectors, count), none)
            free[:, 0] = np.where(here, position[stays], position[comes])
            for term, j in enumerate((j for j in range(count) if j != i), start=1):
                pair = self.statuses[j], status
                row, column = pair if by_row else pair[::-1]
                free[present[:, j] & (~here | pushing), term] = position[
                    f"influence.{row}.{column}"
                ]
            # A persistence without influences is the same probability for all vectors.
            kinds = np.arange(self.vectors)
            kinds[here & (free[:, 1:] == none).all(axis=1)] = 1 << (count - 1 - i)
            used, which = np.unique(kinds, return_inverse=True)
            which = which + add_terms(free[used])
            for number, action in enumerate(actions):
                self.step[:, number, i] = which
                for rule, where in (("persistence", here), ("onset", ~here)):
                    if (name := f"assistance.{action}.{status}.{rule}") in position:
                        self.step[where, number, i] = add_single_term(position[name])
            self.skip[:, i] = which if onset == "base" else nothing
            if onset == "reset":
                continue
            both = present[:, self.statuses.index(others.get(status, status))]
            rules = ("with-other", "alone") if status in others else ("persistence",)
            for rule, where in zip(rules, (both, ~both), strict=False):
                self.skip[here & where, i] = add_single_term(position[f"skip.{status}.{rule}"])
        self.terms = np.concatenate(terms)

    def list_next_states(self, flag: int, place: int) -> Integers:
        """Return (2^n,) the states that follow a subtask, counted from its own first state."""
        if place == FINAL:
            return np.full(self.vectors, self.size)
        return (
            self.size + int(self.flag_after[place, flag]) * self.vectors + np.arange(self.vectors)
        )

    def list_pairs(self) -> tuple[Integers, Integers]:
        """Return state and action of each row of a subtask, states counted from its first."""
        trying = self.trials * self.flags * self.vectors
        state, action = np.divmod(np.arange(trying * self.assistive), self.assistive)
        skipping = np.arange(trying, self.size)
        return (
            np.concatenate([state, skipping]),
            np.append(action, np.full(len(skipping), self.assistive)),
        )

    def build_space(self, subtasks: int) -> StateSpace:
        """Return the state space; the end comes last."""
        columns = [
            Column(name="subtask", size=subtasks),
            Column(name="trial", size=self.trials + self.own),
            Column(name="status", size=self.vectors, bits=self.bits.shape[1]),
        ]
        if self.flags == 2:
            columns.insert(2, Column(name="skipped", size=2))
        return StateSpace(columns=tuple(columns), extra=("end",))

    def build_labels(self, space: StateSpace) -> dict[str, NDArray[np.bool_]]:
        """Return the named sets of states: each status, the end, and after or in a skip.

        *skipped* are the states of a task in which a subtask was skipped, if the bonus depends on
        it, and the states of a skip that takes its own timestep; else no state remembers a skip.
        """
        end = np.arange(space.size) == space.regular
        on = (self.bits[space.values("status")] == 1) & ~end[:, None]
        skipped = (space.values("trial") == self.trials) & self.own
        if self.flags == 2:
            skipped |= space.values("skipped") == 1
        return {"end": end, "skipped": skipped, **dict(zip(self.statuses, on.T, strict=True))}


_made: dict[tuple[Any, ...], Rules] = {}


def rules_of(scenario: ScenarioTables) -> Rules:
    """Return the rules of a scenario, computed once for all scenarios with the same names."""
    mappings = (tuple(getattr(scenario, each).items()) for each in MAPPINGS)
    sizes = scenario.tasks, scenario.max_trial
    key = scenario.names, scenario.statuses, scenario.actions, sizes, *mappings
    if key not in _made:
        if len(_made) == 16:
            _made.clear()
        _made[key] = Rules(scenario)
    return _made[key]
