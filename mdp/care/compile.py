"""The rows of one subtask, worked out once for each kind of place it can have.

A subtask is a block of trials × (skipped flag) × status vectors. Next states are counted from the
block's start, so that the same rows serve at every place: numbers from the block's size on are the
next subtask's first trial, or the end. A skip after the last failed trial is one matrix product:

    P(z, cost v | s, a) = Σ_{s' ≠ 0, cost(s') = v} K_a(s, s') Z(s', z).

Source: Yuan et al. (2025), Equation 1, Table 4 and Section 3.2.

From a scenario to its explicit transition matrix, exactly, without a loop over states.

All subtasks share a few block templates (inside a task, last of its task, last of all), which are
laid down one after the other. States are numbered so that every transition leads to a higher
number; the end comes last. A model with one block of each kind is built and checked row by row;
where blocks repeat, the whole model is laid out from the rows of that one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.care.laws import Kernels, status_kernels
from exact_mdp.mdp.care.rules import Rules, kinds
from exact_mdp.mdp.care.size import check_explicit
from exact_mdp.mdp.care.tables import SKIP, Tables
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    EXACT_IN_INT64,
    Floats,
    Integers,
    Numbers,
    OutcomeTable,
    divide,
    integers,
    magnitude,
    multiply,
)

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

    def __init__(self, scenario: Tables, kernels: Kernels) -> None:
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


def compile_scenario(scenario: Tables) -> MDP:
    """Return the explicit model of a scenario, without a warning; see `Scenario.compile`."""
    check_explicit(scenario)
    template = Template(scenario, status_kernels(scenario))
    places = kinds(scenario)
    # One block of each kind is itself a model.
    used = np.unique(places)
    small = _model(scenario, template, used)
    if np.array_equal(places, used):
        return small
    return _repeated(scenario, template, small, np.searchsorted(used, places))


def _model(scenario: Tables, template: Template, places: Integers) -> MDP:
    """Return the checked model of blocks of the kinds `places` (K,), one after the other."""
    blocks = [template.block(last=kind > 0, final=kind == 2) for kind in places.tolist()]
    end = len(blocks) * template.size
    dtype = np.int32 if end < 2**31 - 1 else np.int64
    relative = [rows.next + i * template.size for i, rows in enumerate(blocks)]
    lengths = np.concatenate([*(rows.lengths for rows in blocks), [1]])
    state, action = template.pairs()
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=np.concatenate([*relative, [end]]).astype(dtype),
        weight=joined([rows.weight for rows in blocks], 1),
        denominator=joined([rows.denominator for rows in blocks], 1),
        gain=joined([rows.gain for rows in blocks], 0),
        gain_denominator=_same(template.scale, len(lengths)),
        event=np.concatenate([*(rows.event for rows in blocks), np.zeros(1, dtype=np.uint8)]),
    )
    starts = np.arange(len(blocks))[:, None] * template.size
    return MDP(
        table,
        np.append((starts + state).reshape(-1), end),
        np.append(np.tile(action, len(blocks)), 0),
        space=template.space(scenario.with_(tasks=[len(blocks)])),
        actions=template.actions,
        discount_exact=scenario.discount,
        component_names=scenario.components,
        components=np.concatenate(
            [*(rows.components for rows in blocks), np.zeros((1, len(scenario.components)))]
        ),
        events=(SKIP,),
        name=scenario.name,
        parameters=scenario.parameters,
    )


def _repeated(scenario: Tables, template: Template, small: MDP, order: Integers) -> MDP:
    """Return the model of the blocks of `small` in the given order (K,), each a number there.

    Its rows are those of `small`, which were checked there, at other places.
    """
    count, size, table, matrix = len(order), template.size, small.table, small.transition
    end = count * size
    starts = np.append(np.arange(order.max() + 1) * size, small.n_states - 1)
    rows = small.pair_offsets[starts]
    shifts = (np.arange(count) - order) * size
    # Runs of blocks of one kind, laid down at once.
    first = np.flatnonzero(np.diff(order, prepend=-1))
    runs = list(zip(first.tolist(), [*first[1:].tolist(), count], strict=True))

    def lay(values: Numbers, cuts: Numbers, *, moved: bool = False) -> Numbers:
        """Repeat blocks of `values`, which `cuts` (kinds + 1,) delimit; add the shifts to states"""
        counts = np.diff(cuts)
        total = int(counts[order].sum()) + len(values) - int(cuts[-1])
        wide = np.int64 if moved and end >= 2**31 - 1 else values.dtype
        laid, at = np.empty((total, *values.shape[1:]), dtype=wide), 0
        for begin, stop in runs:
            kind, times = order[begin], stop - begin
            block = values[cuts[kind] : cuts[kind + 1]]
            place = laid[at : at + times * len(block)].reshape(times, *block.shape)
            if moved:
                np.add(block, shifts[begin:stop, None].astype(wide), out=place)
            else:
                place[:] = block
            at += times * len(block)
        laid[at:] = end if moved else values[cuts[-1] :]
        return laid

    def ends(lengths: Numbers, cuts: Numbers) -> Integers:
        return np.concatenate([[0], np.cumsum(lay(lengths, cuts), dtype=np.int64)])

    outcomes, entries = table.offsets[rows], matrix.indptr[rows]
    following = lay(table.next, outcomes, moved=True)
    indptr = ends(np.diff(matrix.indptr), rows)
    merged = len(matrix.indices) < len(table.next)
    indices = lay(matrix.indices, entries, moved=True) if merged else following
    parts: dict[str, Any] = {field.name: getattr(small, field.name) for field in fields(MDP)}
    parts |= {
        "table": OutcomeTable(
            offsets=ends(np.diff(table.offsets), rows) if merged else indptr,
            next=following,
            weight=lay(table.weight, outcomes),
            denominator=lay(table.denominator, rows),
            gain=lay(table.gain, outcomes),
            gain_denominator=_same(template.scale, len(indptr) - 1),
            event=None if table.event is None else lay(table.event, outcomes),
        ),
        "space": template.space(scenario),
        "pair_state": lay(small.pair_state, rows, moved=True),
        "pair_action": lay(small.pair_action, rows),
        "pair_offsets": ends(np.diff(small.pair_offsets), starts),
        "components": lay(small.components, rows),
        "reward": lay(small.reward, rows),
    }
    if indptr[-1] < 2**31 - 1:
        indptr = indptr.astype(indices.dtype)
    shape = (len(indptr) - 1, end + 1)
    parts["transition"] = sp.csr_array((lay(matrix.data, entries), indices, indptr), shape)
    parts["transition"].has_canonical_format = True
    vars(parts["table"])["sums_to_one"] = table.sums_to_one
    mdp = object.__new__(MDP)
    mdp.__setstate__(parts)
    return mdp


def _same(value: int, count: int) -> Numbers:
    """Return (count,) times one integer, in the memory of one."""
    return np.asarray(np.broadcast_to(integers([value]), (count,)))
