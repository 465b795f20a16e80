"""What a trial of a care scenario earns, and where its rows lie: the rules without the chances.

Every gain is a sum of reward weights, each at most once, as an integer over one common `scale`.
Rows of a table and operators without one both read these. Source: Yuan et al. (2025), Equation 1,
Table 4 and Section 3.2; the readings are those of `mdp.care.tables`.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.care.tables import SKIP, Tables
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import EXACT_IN_INT64, Integers, Numbers, common


class Rules:
    """Gains and the layout of a subtask, which is a block of trials × flags × status vectors.

    Attributes
    ----------
    actions : tuple of str
        The assistive ones, and *skip* where that takes a timestep of its own (`own`).
    trials, flags, vectors, size : int
        Trials with a choice; 2 flags where it matters whether a subtask was skipped; 2^n status
        vectors; states of a block.
    worth : {weight: int}, scale : int
        Every reward weight is worth[name] / scale.
    cost, assist : (2^n,), (A,)
        What a status vector costs, and what an action adds where the subtask is completed.
    following : bool
        Whether the cost is that of the next status vector; else of the present one.
    """

    def __init__(self, scenario: Tables, bits: Integers) -> None:
        self.readings = dict(scenario.readings)  # a dictionary, as views cannot be pickled
        self.bits = bits
        self.assistive = len(scenario.actions)
        self.own = self.readings["skip_timestep"] == "own"
        self.actions = (*scenario.actions, SKIP) if self.own else scenario.actions
        self.flags = 2 if self.readings["task_bonus"] == "no-subtask-skipped" else 1
        self.trials = scenario.trials
        self.vectors = len(bits)
        self.size = (self.trials + self.own) * self.flags * self.vectors
        names = scenario.components
        numbers, self.scale = common([scenario[f"reward.{name}"] for name in names])
        self.names = names
        self.worth = dict(zip(names, numbers, strict=True))
        # A gain adds up weights, each at most once: this is the type that holds every such sum.
        self.largest = sum(abs(number) for number in numbers)
        self.kind = np.dtype(np.int64 if self.largest < EXACT_IN_INT64 else object)
        self.assist = self.gains([self.worth[f"assist.{a}"] for a in scenario.actions])
        statuses = [self.worth[scenario.weights[status]] for status in scenario.statuses]
        self.cost = self.gains([0])
        for worth in statuses:  # the first status is the most significant digit
            self.cost = (self.cost[:, None] + self.gains([0, worth])).reshape(-1)
        self.following = self.readings["status_cost"] == "next"

    def gains(self, values: list[int]) -> Numbers:
        """Return integers of the type that holds every gain."""
        return np.array(values, dtype=self.kind)

    def bonus(self, *, last: bool, skipped: bool, flag: int = 0) -> int:
        """Return what is paid at the end of a task, where this is the `last` subtask of one."""
        rule = self.readings["task_bonus"]
        paid = last and (
            rule == "always"
            or (rule == "last-subtask-completed" and not skipped)
            or (rule == "no-subtask-skipped" and not skipped and flag == 0)
        )
        return self.worth["task-complete"] if paid else 0

    def completing(self, *, last: bool, flag: int) -> int:
        """Return the gain of a trial that completes the subtask, but for the action's own."""
        every = self.worth["trial"] * (self.readings["trial_cost"] == "every-trial")
        fixed = self.worth["timestep"] + self.worth["subtask-complete"] + every
        return fixed + self.bonus(last=last, skipped=False, flag=flag)

    def failing(self) -> int:
        """Return the gain of a failed trial, but for the cost of the status."""
        return self.worth["timestep"] + self.worth["trial"]

    def skipping(self, *, last: bool) -> int:
        """Return what a skip adds; it comes with `timestep` where that is its own."""
        return self.worth["subtask-skip"] + self.bonus(last=last, skipped=True)

    def kept(self, flag: int, *, last: bool) -> int:
        """Return the flag that the next subtask starts with: each task begins anew."""
        return 0 if last or self.flags == 1 else flag

    def pairs(self) -> tuple[Integers, Integers]:
        """Return state and action of each row of a block, states counted from its start."""
        trying = self.trials * self.flags * self.vectors
        state, action = np.divmod(np.arange(trying * self.assistive), self.assistive)
        skipping = np.arange(trying, self.size)
        return np.concatenate([state, skipping]), np.append(
            action, np.full(len(skipping), self.assistive)
        )

    def space(self, scenario: Tables) -> StateSpace:
        """Return what the state numbers mean; the end comes last."""
        columns = [
            Column(name="subtask", size=sum(scenario.tasks)),
            Column(name="trial", size=self.trials + self.own),
            Column(name="status", size=self.vectors, bits=len(scenario.statuses)),
        ]
        if self.flags == 2:
            columns.insert(2, Column(name="skipped", size=2))
        return StateSpace(columns=tuple(columns), extra=("end",))


def kinds(scenario: Tables) -> Integers:
    """Return (K,) the place of each subtask: 0 inside a task, 1 last of one, 2 last of all.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> kinds(Scenario.load("yuan2025").with_(tasks=[3, 1])).tolist()
    [0, 0, 1, 2]
    """
    last = np.cumsum(scenario.tasks)
    found = np.zeros(last[-1], dtype=np.int64)
    found[last - 1] = 1
    found[-1] = 2
    return found
