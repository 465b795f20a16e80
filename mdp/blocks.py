"""The rows of one subtask, worked out once for each kind of place it can have.

A subtask is a block of trials × (skipped flag) × status vectors. Next states are counted from the
block's start, so that the same rows serve at every place: numbers from the block's size on are the
next subtask's first trial, or the end. A skip after the last failed trial is one matrix product:

    P(z, cost v | s, a) = Σ_{s' ≠ 0, cost(s') = v} K_a(s, s') Z(s', z).

Source: Yuan et al. (2025), Equation 1, Table 4 and Section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mdp.laws import Kernels
from mdp.scenario import SKIP
from mdp.table import (
    EXACT_IN_INT64,
    Floats,
    Integers,
    Numbers,
    common,
    divide,
    integers,
    magnitude,
    multiply,
)

if TYPE_CHECKING:
    from mdp.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Rows of a block template: outcomes, and expected reward components."""

    lengths: Integers
    next: Integers
    weight: Numbers
    denominator: Numbers
    gain: Numbers
    event: NDArray[np.uint8]
    components: Floats


class Template:
    """Works out the rows of one subtask; `block` gives those of a subtask at its place."""

    def __init__(self, scenario: Scenario, kernels: Kernels) -> None:
        self.readings = scenario.readings
        self.kernels = kernels
        self.assistive = len(scenario.actions)
        self.own = self.readings["skip_timestep"] == "own"
        self.actions = (*scenario.actions, SKIP) if self.own else scenario.actions
        self.flags = 2 if self.readings["task_bonus"] == "no-subtask-skipped" else 1
        self.trials = scenario.trials
        self.vectors = len(kernels.bits)
        self.size = (self.trials + self.own) * self.flags * self.vectors
        names = scenario.components
        numbers, self.scale = common([scenario[f"reward.{name}"] for name in names])
        self.names = names
        self.worth = dict(zip(names, numbers, strict=True))
        # A gain adds up weights, each at most once: this is the type that holds every such sum.
        largest = sum(abs(number) for number in numbers)
        self.kind = np.dtype(np.int64 if largest < EXACT_IN_INT64 else object)
        self.assist = self._gains([self.worth[f"assist.{a}"] for a in scenario.actions])
        statuses = [self.worth[scenario.weights[status]] for status in scenario.statuses]
        self.cost = self._gains(
            [
                sum(worth for worth, present in zip(statuses, row, strict=True) if present)
                for row in kernels.bits.tolist()
            ]
        )
        self.following = self.readings["status_cost"] == "next"
        # A cost of the present status is the row's own; one of the next status is the outcome's.
        self.row_cost = (0 if self.following else 1) * self.cost[:, None, None]

    def _gains(self, values: list[int]) -> Numbers:
        return np.array(values, dtype=self.kind)

    def pairs(self) -> tuple[Integers, Integers]:
        """Return state and action of each row of a block, states counted from its start."""
        trying = self.trials * self.flags * self.vectors
        state, action = np.divmod(np.arange(trying * self.assistive), self.assistive)
        skipping = np.arange(trying, self.size)
        return np.concatenate([state, skipping]), np.append(
            action, np.full(len(skipping), self.assistive)
        )

    def block(self, *, last: bool, final: bool) -> Rows:
        """Return all rows of a subtask, by trial, flag, status and action."""
        parts = [
            self._trial(trial, flag, last=last, final=final)
            for trial in range(self.trials)
            for flag in range(self.flags)
        ]
        if self.own:
            parts += [self._skipping(last=last, final=final) for _ in range(self.flags)]
        return Rows(
            lengths=np.concatenate([rows.lengths for rows in parts]),
            next=np.concatenate([rows.next for rows in parts]),
            weight=joined([rows.weight for rows in parts]),
            denominator=joined([rows.denominator for rows in parts]),
            gain=joined([rows.gain for rows in parts]),
            event=np.concatenate([rows.event for rows in parts]),
            components=np.concatenate([rows.components for rows in parts]),
        )

    def _bonus(self, *, last: bool, skipped: bool, flag: int = 0) -> int:
        rule = self.readings["task_bonus"]
        paid = last and (
            rule == "always"
            or (rule == "last-subtask-completed" and not skipped)
            or (rule == "no-subtask-skipped" and not skipped and flag == 0)
        )
        return self.worth["task-complete"] if paid else 0

    def _after(self, flag: int, vector: Integers, *, last: bool, final: bool) -> Integers:
        """Return where the next subtask starts: its first trial, or the end."""
        kept = 0 if last or self.flags == 1 else flag
        return self.size + (0 * vector if final else kept * self.vectors + vector)

    def _trial(self, trial: int, flag: int, *, last: bool, final: bool) -> Rows:
        """Return the rows of one trial: complete, fail, or fail for the last time and skip."""
        step, bottom = self.kernels.step, self.kernels.step_denominator
        skips = trial == self.trials - 1 and not self.own
        every = self.worth["trial"] * (self.readings["trial_cost"] == "every-trial")
        completing = self._bonus(last=last, skipped=False, flag=flag)
        bonus = self._bonus(last=last, skipped=True)
        skipping = bonus + self.worth["subtask-skip"]
        failing = self.worth["timestep"] + self.worth["trial"]
        vectors = np.arange(self.vectors)

        nexts = [self._after(flag, vectors[:1], last=last, final=final)]
        gains = [[self.worth["timestep"] + self.worth["subtask-complete"] + every + completing]]
        weights = [step[:, :, :1]]
        if skips:
            z = self._after(1, vectors, last=last, final=final)
            weights = [multiply(weights[0], integers([self.kernels.skip_denominator]))]
            bottom = multiply(bottom, integers([self.kernels.skip_denominator]))
            costs = self.cost if self.following else 0 * self.cost
            for cost in sorted(set(costs[1:].tolist())):
                chosen = vectors[1:][costs[1:] == cost]
                law = _matmul(step[:, :, chosen], self.kernels.skip[chosen])
                law = law.astype(bottom.dtype)  # as wide as the row's denominator: sums stay below
                nexts.append(z[:1] if final else z)
                weights.append(law.sum(axis=2, keepdims=True) if final else law)
                gains.append([failing + skipping + cost] * len(nexts[-1]))
        else:
            nexts.append(((trial + 1) * self.flags + flag) * self.vectors + vectors[1:])
            weights.append(step[:, :, 1:])
            gains.append([failing + cost * self.following for cost in self.cost[1:].tolist()])

        gain = self._gains([value for part in gains for value in part])
        gain = gain + self.row_cost + np.zeros((1, self.assistive, 1), dtype=np.int64)
        gain[:, :, 0] += self.assist
        event = np.zeros(gain.shape[2], dtype=np.uint8)
        event[1:] = skips
        success = step[:, :, 0]
        return _rows(
            np.concatenate(nexts),
            _joined_last(weights),
            bottom,
            gain,
            event,
            self._components(success, completing, bonus, skips),
        )

    def _components(self, success: Numbers, completing: int, bonus: int, skips: bool) -> Floats:
        """Return (2^n, A, C) expected reward components of a trial."""
        step, bottom = self.kernels.step, self.kernels.step_denominator
        failure = bottom - success
        amounts: dict[str, Numbers] = {}
        for i, name in enumerate(self.names[: self.kernels.bits.shape[1]]):
            if self.following:
                law = step[:, :, self.kernels.bits[:, i] == 1].sum(axis=2)
            else:
                law = multiply(bottom, self.kernels.bits[:, i][:, None])
            amounts[name] = multiply(law, integers([self.worth[name]]))
        every = self.readings["trial_cost"] == "every-trial"
        for name, law in {
            "trial": bottom if every else failure,
            "subtask-complete": success,
            "subtask-skip": failure * skips,
            "timestep": bottom,
        }.items():
            amounts[name] = multiply(law, integers([self.worth[name]]))
        amounts["task-complete"] = multiply(success, integers([completing])) + multiply(
            failure, integers([bonus * skips])
        )
        for number in range(self.assistive):
            own = np.zeros(self.assistive, dtype=np.int64)
            own[number] = 1
            name = self.names[len(self.names) - self.assistive + number]
            amounts[name] = multiply(success * own, integers([self.worth[name]]))
        full = multiply(bottom, integers([self.scale]))
        return np.stack([divide(amounts[name], full) for name in self.names], axis=2)

    def _skipping(self, *, last: bool, final: bool) -> Rows:
        """Return the rows in which *skip* is the only action and takes its own timestep."""
        vectors = np.arange(self.vectors)
        bottom = np.broadcast_to(integers([self.kernels.skip_denominator]), (self.vectors, 1))
        bonus = self._bonus(last=last, skipped=True)
        fixed = self.worth["timestep"] + self.worth["subtask-skip"] + bonus
        law = self.kernels.skip
        cost = self.cost if self.following else 0 * self.cost
        nexts = self._after(1, vectors, last=last, final=final)
        if final:
            values = np.unique(cost)
            law = np.stack([law[:, cost == value].sum(axis=1) for value in values], axis=1)
            cost, nexts = values, nexts[: len(values)]
        amounts = dict.fromkeys(self.names, integers([0] * self.vectors))
        for i, name in enumerate(self.names[: self.kernels.bits.shape[1]]):
            present = self.kernels.bits[:, i]
            if self.following:
                charged = self.kernels.skip[:, present == 1].sum(axis=1)
            else:
                charged = multiply(present, integers([self.kernels.skip_denominator]))
            amounts[name] = multiply(charged, integers([self.worth[name]]))
        for name, worth in (
            ("timestep", self.worth["timestep"]),
            ("subtask-skip", self.worth["subtask-skip"]),
            ("task-complete", bonus),
        ):
            amounts[name] = multiply(np.asarray(bottom[:, 0]), integers([worth]))
        full = multiply(np.asarray(bottom[:, 0]), integers([self.scale]))
        components = np.stack([divide(amounts[name], full) for name in self.names], axis=1)
        return _rows(
            nexts,
            law[:, None, :],
            np.asarray(bottom),
            self._gains([fixed]) + cost + self.row_cost,
            np.ones(len(nexts), dtype=np.uint8),
            components[:, None, :],
        )


def _rows(
    following: Integers,
    weight: Numbers,
    denominator: Numbers,
    gain: Numbers,
    event: NDArray[np.uint8],
    components: Floats,
) -> Rows:
    """Flatten (2^n, A, outcomes) arrays to rows, outcomes sorted by next state, zeros left out."""
    order = np.argsort(following, kind="stable")
    weight, gain = weight[:, :, order], gain[:, :, order]
    kept = np.array(weight != 0, dtype=bool)
    shape = weight.shape
    return Rows(
        lengths=kept.sum(axis=2).reshape(-1),
        next=np.broadcast_to(following[order], shape)[kept],
        weight=weight[kept],
        denominator=denominator.reshape(-1),
        gain=np.broadcast_to(gain, shape)[kept],
        event=np.broadcast_to(event[order], shape)[kept],
        components=components.reshape(-1, components.shape[2]),
    )


def _matmul(left: Numbers, right: Numbers) -> Numbers:
    """Return the exact product (…, m) @ (m, n) of integer arrays."""
    narrow = left.dtype != object and right.dtype != object
    if narrow and magnitude(left) * magnitude(right) * max(len(right), 1) < EXACT_IN_INT64:
        return np.asarray(left @ right)
    return np.asarray(left.astype(object) @ right.astype(object))


def joined(parts: list[Numbers], *more: int) -> Numbers:
    """Concatenate integer arrays, keeping Python integers where one part needs them."""
    wide = any(part.dtype == object for part in parts)
    kind = np.dtype(object) if wide else np.dtype(np.int64)
    tail = [np.array(more, dtype=kind)] if more else []
    return np.concatenate([*parts, *tail], dtype=kind)


def _joined_last(parts: list[Numbers]) -> Numbers:
    """Concatenate along the last axis, keeping Python integers where one part needs them."""
    wide = any(part.dtype == object for part in parts)
    kind = np.dtype(object) if wide else np.dtype(np.int64)
    return np.concatenate(parts, axis=2, dtype=kind)
