"""The rules of a care scenario, stated once: when a trial counts, what is charged, what follows.

A state is (k, t, f, s): subtask k, t trials of it failed so far, f = 1 if a subtask of this task
was skipped (kept only where the bonus asks for it), status vector s. Under an action a the next
statuses follow the law K_a(s, ·), on a skip Z(s, ·). A subtask ends in one of two events:

    event      when                             charges, in weights              leads to
    complete   s' = 0 under K_a                 timestep, subtask-complete,      k + 1, flag f
                                                assist.a, trial *, bonus
    fail       s' ≠ 0 under K_a                 timestep, trial                  k, t + 1, s'
    skip       after the M-th fail, s'' by Z    subtask-skip, timestep *, bonus  k + 1, flag 1, s''

    trial *      where `trial_cost` is every-trial
    timestep *   where `skip_timestep` is own: the skip is then a step of its own, t = M, in which
                 *skip* is the only action; else it belongs to the step of the M-th fail
    bonus        task-complete, where k is the last subtask of its task and `task_bonus` is
                   always                   after both events
                   last-subtask-completed   after `complete`
                   no-subtask-skipped       after `complete` with f = 0
    statuses     each step charges the weights of the statuses present in its next vector, or in
                 its present one (`status_cost`); the vector 0 costs nothing
    flag         a new task starts with f = 0; behind the last subtask of all is the end

`CHARGES`, `BONUS` and `STATUS_COST` are this table as data, `Rules` is what it says of a scenario.
The explicit matrix (`mdp.care.compile`) and batches of parameter draws (`solvers.care`) read it
there. Every gain is a sum of weights, each at most once, as an integer over one common `scale`.
Source: Yuan et al. (2025), Equation 1, Table 4 and Section 3.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.care.tables import SKIP, Tables, bits_of
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import EXACT_IN_INT64, Floats, Integers, Numbers, common, divide, integers

INSIDE, LAST, FINAL = 0, 1, 2
"""Places of a subtask: inside a task, last of one, last of all."""

PLACES = (INSIDE, LAST, FINAL)

# Event, the weight that it charges, and the reading under which it does.
CHARGES: tuple[tuple[str, str, tuple[str, str] | None], ...] = (
    ("complete", "timestep", None),
    ("complete", "subtask-complete", None),
    ("complete", "trial", ("trial_cost", "every-trial")),
    ("fail", "timestep", None),
    ("fail", "trial", None),
    ("skip", "subtask-skip", None),
    ("skip", "timestep", ("skip_timestep", "own")),
)

# After which events, with which flag, the end of a task is rewarded.
BONUS: Mapping[str, tuple[tuple[str, int], ...]] = MappingProxyType(
    {
        "always": (("complete", 0), ("complete", 1), ("skip", 1)),
        "last-subtask-completed": (("complete", 0), ("complete", 1)),
        "no-subtask-skipped": (("complete", 0),),
    }
)

# Whether a step charges the statuses of its present vector, and those of its next one.
STATUS_COST: Mapping[str, tuple[int, int]] = MappingProxyType({"next": (0, 1), "current": (1, 0)})


class Rules:
    """The rules of one scenario, and the layout of a subtask: trials × flags × status vectors.

    Attributes
    ----------
    actions : tuple of str
        The `assistive` ones, and *skip* where that takes a timestep of its own (`own`).
    trials, flags, vectors, size : int
        Trials with a choice, M; 2 flags where the bonus depends on them, else 1; 2^n status
        vectors; states of a subtask.
    kept : (3, 2) ints
        The flag that the next subtask starts with, by place and flag: each task begins anew.
    bits : (2^n, n)
        The status vectors; the first status is the most significant digit.
    names : tuple of str
        The reward weights; `worth` has their values over `scale`.
    now, next : int
        Whether a step charges the statuses of its present and of its next vector.
    present, following : (2^n,) ints
        What that comes to.
    assist : (A,) ints
        What an action adds where the subtask is completed.
    places : (K,) ints
        The place of each subtask.
    """

    def __init__(self, scenario: Tables) -> None:
        self.readings = dict(scenario.readings)  # a dictionary, as views cannot be pickled
        self.paid = BONUS[self.readings["task_bonus"]]
        self.now, self.next = STATUS_COST[self.readings["status_cost"]]
        self.own = self.readings["skip_timestep"] == "own"
        self.statuses = scenario.statuses
        self.assistive = len(scenario.actions)
        self.actions = (*scenario.actions, SKIP) if self.own else scenario.actions
        complete = {flag for event, flag in self.paid if event == "complete"}
        self.flags = 2 if len(complete) == 1 else 1  # the bonus depends on whether one was skipped
        self.kept = np.zeros((3, 2), dtype=np.int64)
        self.kept[INSIDE, 1] = self.flags - 1
        self.trials = scenario.trials
        self.bits = bits_of(len(scenario.statuses))
        self.vectors = len(self.bits)
        self.size = (self.trials + self.own) * self.flags * self.vectors
        self.places = np.full(sum(scenario.tasks), INSIDE)
        self.places[np.cumsum(scenario.tasks) - 1] = LAST
        self.places[-1] = FINAL
        self.names = scenario.components
        numbers, self.scale = common([scenario[f"reward.{name}"] for name in self.names])
        self.worth = dict(zip(self.names, numbers, strict=True))
        # A gain adds up weights, each at most once: this is the type that holds every such sum.
        largest = sum(abs(number) for number in numbers)
        self.kind = np.dtype(np.int64 if largest < EXACT_IN_INT64 else object)
        self.assist = self.gains([self.worth[f"assist.{a}"] for a in scenario.actions])
        weights = [self.worth[scenario.weights[status]] for status in scenario.statuses]
        cost = (self.bits.astype(self.kind) * self.gains(weights)).sum(axis=1)
        self.present, self.following = self.now * cost, self.next * cost

    def charged(self, event: str, place: int = INSIDE, flag: int = 0) -> tuple[str, ...]:
        """Return the weights that an event charges, beside the action's own and the statuses'.

        `flag` is that of the state, or 1 for a skip, which sets it.
        """
        charges = [
            weight
            for of, weight, reading in CHARGES
            if of == event and (reading is None or self.readings[reading[0]] == reading[1])
        ]
        bonus = place != INSIDE and (event, flag) in self.paid
        return (*charges, "task-complete") if bonus else tuple(charges)

    def gain(self, event: str, place: int = INSIDE, flag: int = 0) -> int:
        """Return the sum of the weights `charged`, an integer over `scale`."""
        return sum(self.worth[name] for name in self.charged(event, place, flag))

    def after(self, flag: int, place: int) -> Integers:
        """Return (2^n,) the states that follow a subtask, counted from its own first state."""
        if place == FINAL:
            return np.full(self.vectors, self.size)
        return self.size + int(self.kept[place, flag]) * self.vectors + np.arange(self.vectors)

    def gains(self, values: list[int]) -> Numbers:
        """Return integers of the type that holds every gain."""
        return np.array(values, dtype=self.kind)

    def rounded(self, values: Numbers) -> Floats:
        """Return sums of weights as floats, each rounded once."""
        return divide(values, np.broadcast_to(integers([self.scale]), values.shape))

    def pairs(self) -> tuple[Integers, Integers]:
        """Return state and action of each row of a subtask, states counted from its first."""
        trying = self.trials * self.flags * self.vectors
        state, action = np.divmod(np.arange(trying * self.assistive), self.assistive)
        skipping = np.arange(trying, self.size)
        return (
            np.concatenate([state, skipping]),
            np.append(action, np.full(len(skipping), self.assistive)),
        )

    def space(self, subtasks: int) -> StateSpace:
        """Return what the state numbers mean; the end comes last."""
        columns = [
            Column(name="subtask", size=subtasks),
            Column(name="trial", size=self.trials + self.own),
            Column(name="status", size=self.vectors, bits=self.bits.shape[1]),
        ]
        if self.flags == 2:
            columns.insert(2, Column(name="skipped", size=2))
        return StateSpace(columns=tuple(columns), extra=("end",))

    def labels(self, space: StateSpace) -> dict[str, NDArray[np.bool_]]:
        """Return the named sets of states: each status, the end, and after or in a skip.

        *skipped* are the states of a task in which a subtask was skipped, where the bonus depends
        on it, and those of a skip that takes its own timestep; else no state remembers a skip.
        """
        end = np.arange(space.size) == space.regular
        on = (self.bits[space.values("status")] == 1) & ~end[:, None]
        skipped = (space.values("trial") == self.trials) & self.own
        if self.flags == 2:
            skipped |= space.values("skipped") == 1
        return {"end": end, "skipped": skipped, **dict(zip(self.statuses, on.T, strict=True))}
