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
from mdp.rules import Rules
from mdp.table import (
    EXACT_IN_INT64,
    Floats,
    Integers,
    Numbers,
    divide,
    integers,
    magnitude,
    multiply,
)

if TYPE_CHECKING:
    from mdp.scenario import Scenario

ENTRIES = 2**20  # of a product held at once


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


class Template(Rules):
    """Works out the rows of one subtask; `block` gives those of a subtask at its place."""

    def __init__(self, scenario: Scenario, kernels: Kernels) -> None:
        super().__init__(scenario, kernels.bits)
        self.kernels = kernels
        # A cost of the present status is the row's own; one of the next status is the outcome's.
        self.row_cost = (0 if self.following else 1) * self.cost[:, None, None]

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

    def _after(self, flag: int, vector: Integers, *, last: bool, final: bool) -> Integers:
        """Return where the next subtask starts: its first trial, or the end."""
        first = self.kept(flag, last=last) * self.vectors
        return self.size + (0 * vector if final else first + vector)

    def _trial(self, trial: int, flag: int, *, last: bool, final: bool) -> Rows:
        """Return the rows of one trial: complete, fail, or fail for the last time and skip."""
        step, bottom = self.kernels.step, self.kernels.step_denominator
        skips = trial == self.trials - 1 and not self.own
        completing = self.bonus(last=last, skipped=False, flag=flag)
        bonus = self.bonus(last=last, skipped=True)
        failing = self.failing()
        vectors = np.arange(self.vectors)

        components = self._components(step[:, :, 0], completing, bonus, skips)
        if skips:
            return self._last_trial(flag, components, last=last, final=final)
        nexts = [
            self._after(flag, vectors[:1], last=last, final=final),
            ((trial + 1) * self.flags + flag) * self.vectors + vectors[1:],
        ]
        gains = [failing + cost * self.following for cost in self.cost[1:].tolist()]
        gain = self.gains([self.completing(last=last, flag=flag), *gains])
        gain = gain + self.row_cost + np.zeros((1, self.assistive, 1), dtype=np.int64)
        gain[:, :, 0] += self.assist
        event = np.zeros(gain.shape[2], dtype=np.uint8)
        return _rows(np.concatenate(nexts), step, bottom, gain, event, components)

    def _last_trial(self, flag: int, components: Floats, *, last: bool, final: bool) -> Rows:
        """Return the rows of a trial that ends in a skip where it fails.

        A row may have as many outcomes as status vectors times costs, most of them impossible: a
        few present vectors at a time, and no more of each product than its nonzero part.
        """
        skip, worth = self.kernels.skip, self.failing() + self.skipping(last=last)
        scale = integers([self.kernels.skip_denominator])
        bottom = multiply(self.kernels.step_denominator, scale)
        z = self._after(1, np.arange(1 if final else self.vectors), last=last, final=final)
        costs = (self.cost if self.following else 0 * self.cost)[1:]
        groups = []
        for cost in sorted(set(costs.tolist())):
            chosen = 1 + np.flatnonzero(costs == cost)
            # At the end it does not matter what a skip makes of the vector: its law sums to 1.
            law = np.repeat(scale, len(chosen))[:, None] if final else skip[chosen]
            groups.append((chosen, law))
        amounts = self.gains([worth + cost for cost in sorted(set(costs.tolist()))])
        home = self._after(flag, np.zeros(1, dtype=np.int64), last=last, final=final)
        done = self.gains([self.completing(last=last, flag=flag)]) + self.assist
        parts: list[tuple[Integers, Integers, Numbers, Numbers, NDArray[np.uint8]]] = []
        each = max(1, ENTRIES // (self.assistive * len(groups) * len(z)))
        for begin in range(0, self.vectors, each):
            step = self.kernels.step[begin : begin + each].reshape(-1, self.vectors)
            rows = np.arange(len(step))
            present = np.broadcast_to(self.row_cost[:, 0, 0], (self.vectors,))
            own = np.repeat(present[begin : begin + each], self.assistive)
            # An outcome's place: by row, then next state, then cost; success comes before them.
            places = [rows * (len(z) * len(groups) + 1)]
            weights = [multiply(step[:, 0], scale).astype(bottom.dtype)]
            for number, (chosen, law) in enumerate(groups):
                left = step[:, chosen]
                some, ends = (left != 0).any(axis=1), (law != 0).any(axis=0)
                some, ends = np.flatnonzero(some), np.flatnonzero(ends)
                # As wide as the row's denominator, below which sums stay.
                product = _matmul(left[some], law[:, ends]).astype(bottom.dtype)
                place = places[0][some, None] + (1 + number + ends * len(groups))
                places.append(place.reshape(-1))
                weights.append(product.reshape(-1))
            place, weight = np.concatenate(places), np.concatenate(weights)
            kept = np.flatnonzero(weight != 0)
            kept = kept[np.argsort(place[kept])]
            row, rest = np.divmod(place[kept], len(z) * len(groups) + 1)
            failed = rest > 0
            following, number = np.divmod(np.maximum(rest - 1, 0), len(groups))
            gain = np.where(failed, amounts[number], done[row % self.assistive]) + own[row]
            parts.append(
                (
                    np.bincount(row, minlength=len(step)),
                    np.where(failed, z[following], home),
                    weight[kept],
                    gain,
                    failed.astype(np.uint8),
                )
            )
        lengths, nexts, weights, gains, events = map(list, zip(*parts, strict=True))
        return Rows(
            lengths=np.concatenate(lengths),
            next=np.concatenate(nexts),
            weight=np.concatenate(weights),
            denominator=bottom.reshape(-1),
            gain=np.concatenate(gains),
            event=np.concatenate(events),
            components=components.reshape(-1, components.shape[2]),
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
        bonus = self.bonus(last=last, skipped=True)
        fixed = self.worth["timestep"] + self.skipping(last=last)
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
            self.gains([fixed]) + cost + self.row_cost,
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
