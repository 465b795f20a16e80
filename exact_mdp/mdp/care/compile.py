"""From a scenario to its explicit transition matrix, exactly, without a loop over states.

A subtask is a block of trials × (skipped flag) × status vectors. Next states are counted from the
block's start, so that the same rows serve wherever it lies: numbers from the block's size on are
the next subtask's first trial, or the end. Every row is made of the events of `mdp.care.rules`; a
skip after the last failed trial is one matrix product:

    P(z, gain g | s, a) = Σ_{s' ≠ 0, gain(s') = g} K_a(s, s') Z(s', z).

All subtasks share a few blocks (inside a task, last of its task, last of all), laid down one after
the other. States are numbered so that every transition leads to a higher number; the end comes
last. A model with one block of each kind is built and checked row by row; where blocks repeat, the
whole model is laid out from the rows of that one.

How large the model would be is known before any of it is built. A row of a trial has as many
outcomes as there are next status vectors s' of positive chance. Where a failed trial ends in a skip
there are at most

    1 + Σ over gains g of  min(2^n, Σ over s' ≠ 0 of gain g of the number of z that s' leads to).

An outcome takes 41 bytes at the peak of compilation (the published scenario with 10,000 subtasks),
and 231 where probabilities have no 64-bit denominators (8 statuses with distinct weights, 2
subtasks): Python's integers, and rows to merge.
Source: Yuan et al. (2025), Equation 1, Table 4 and Section 3.2.
"""

from __future__ import annotations

from dataclasses import fields
from math import lcm
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.care.laws import ExactChances, Laws
from exact_mdp.mdp.care.rules import FINAL, Rules
from exact_mdp.mdp.care.tables import SKIP, Tables
from exact_mdp.mdp.components import ComponentTable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    EXACT_IN_INT64,
    MOST_BYTES,
    NARROW,
    WIDE,
    Integers,
    Numbers,
    OutcomeTable,
    integers,
    magnitude,
    multiply,
)

ENTRIES = 2**20  # of a product held at once

Rows = dict[str, NDArray[Any]]
"""Rows of a block: lengths, next, weight, denominator, gain, event; components amount / below."""


class Block:
    """Works out the rows of a subtask at its place."""

    def __init__(self, rules: Rules, laws: Laws) -> None:
        self.rules, self.laws = rules, laws
        shape = rules.vectors, 1
        self.skip_bottom = np.broadcast_to(integers([laws.skip_denominator]), shape)

    def rows(self, place: int) -> Rows:
        """Return all rows of a subtask, by trial, flag, status and action."""
        rules, parts = self.rules, []
        layer = rules.flags * rules.vectors
        trying = [self._trial(flag, place) for flag in range(rules.flags)]
        for trial in range(rules.trials - (not rules.own)):
            for rows in trying:  # the same rows, further on
                shift = np.where(rows["next"] < rules.size, trial * layer, 0)
                parts.append(rows | {"next": rows["next"] + shift})
        if rules.own:
            parts += [self._skip(place)] * rules.flags
        else:
            parts += [rows for flag in range(rules.flags) for rows in self._last(flag, place)]
        return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}

    def _done(self, flag: int, place: int) -> tuple[Integers, Numbers]:
        """Return where completing leads, (1,), and what it earns under each action, (A, 1)."""
        rules = self.rules
        gain = rules.gain("complete", place, flag) + rules.assist[:, None]
        return rules.after(flag, place)[:1], gain

    def _trial(self, flag: int, place: int) -> Rows:
        """Return the rows of the first trial, which another one follows, or a skip of its own."""
        rules, laws = self.rules, self.laws
        home, done = self._done(flag, place)
        failed = rules.gain("fail") + rules.following[None, 1:]
        gain = np.concatenate([done, np.repeat(failed, len(done), axis=0)], axis=1)
        success = laws.step[:, :, 0]
        shares = {"complete": success, "fail": laws.step_denominator - success}
        return _rows(
            np.append(home, (rules.flags + flag) * rules.vectors + np.arange(1, rules.vectors)),
            laws.step,
            laws.step_denominator,
            gain + rules.present[:, None, None],
            np.zeros(rules.vectors, dtype=np.uint8),
            self._components(laws.step, laws.step_denominator, shares, flag, place),
        )

    def _last(self, flag: int, place: int) -> list[Rows]:
        """Return the rows of a trial that ends in a skip where it fails.

        A row may have as many outcomes as status vectors times costs: a few present vectors at a
        time, and of each product only the columns in which it can be positive.
        """
        rules, laws = self.rules, self.laws
        home, done = self._done(flag, place)
        nexts, skip = rules.after(1, place), laws.skip
        if place == FINAL:  # it does not matter what a skip makes of the vector
            nexts, skip = nexts[:1], np.asarray(self.skip_bottom)
        failed = rules.gain("fail") + rules.gain("skip", place, 1) + rules.following
        groups = []
        for gain in sorted(set(failed[1:].tolist())):
            chosen = 1 + np.flatnonzero(failed[1:] == gain)
            ends = np.flatnonzero((skip[chosen] != 0).any(axis=0))
            groups.append((gain, chosen, ends, skip[chosen][:, ends]))
        columns = np.concatenate([home, *(nexts[ends] for _, _, ends, _ in groups)])
        gains = rules.gains([gain for gain, _, ends, _ in groups for _ in ends])
        gains = np.concatenate([done, np.repeat(gains[None], len(done), axis=0)], axis=1)
        event = np.ones(len(columns), dtype=np.uint8)
        event[0] = 0
        bottom = multiply(laws.step_denominator, integers([laws.skip_denominator]))
        success = laws.step[:, :, 0]
        failure = laws.step_denominator - success
        shares = {"complete": success, "fail": failure, "skip": failure}
        components = self._components(laws.step, laws.step_denominator, shares, flag, place)
        each = max(1, ENTRIES // (rules.assistive * len(columns)))
        parts = []
        for begin in range(0, rules.vectors, each):
            some = slice(begin, begin + each)
            step = laws.step[some]
            weight = [multiply(step[:, :, :1], integers([laws.skip_denominator]))]
            weight += [_matmul(step[:, :, chosen], law) for _, chosen, _, law in groups]
            # As wide as the row's denominator, below which sums stay.
            law = np.concatenate([part.astype(bottom.dtype) for part in weight], axis=2)
            gain = gains + rules.present[some, None, None]
            own = components[0][some], components[1][some]
            parts.append(_rows(columns, law, bottom[some], gain, event, own))
        return parts

    def _skip(self, place: int) -> Rows:
        """Return the rows in which *skip* is the only action and takes its own timestep."""
        rules, law = self.rules, self.laws.skip[:, None, :]
        nexts, gain = rules.after(1, place), rules.gain("skip", place, 1) + rules.following
        shares = {"skip": self.skip_bottom}
        components = self._components(law, self.skip_bottom, shares, 1, place)
        if place == FINAL:
            gain, which = np.unique(gain, return_inverse=True)
            same = [law[:, :, which == number].sum(axis=2) for number in range(len(gain))]
            law, nexts = np.stack(same, axis=2), nexts[: len(gain)]
        gain = gain + rules.present[:, None, None]
        event = np.ones(len(nexts), dtype=np.uint8)
        return _rows(nexts, law, np.asarray(self.skip_bottom), gain, event, components)

    def _components(
        self,
        law: Numbers,
        bottom: Numbers,
        shares: dict[str, Numbers],
        flag: int,
        place: int,
    ) -> tuple[Numbers, Numbers]:
        """Return expected reward components (2^n, A, C) over (2^n, A).

        They come from the `shares` (2^n, A) of events, and are integers.
        """
        rules = self.rules
        counts = np.zeros((*bottom.shape, len(rules.names)), dtype=bottom.dtype)
        for event, share in shares.items():
            for name in rules.charged(event, place, 1 if event == "skip" else flag):
                counts[:, :, rules.names.index(name)] += share
        for i, on in enumerate(rules.bits.T):
            counts[:, :, i] = rules.now * on[:, None] * bottom
            counts[:, :, i] += rules.next * law[:, :, on == 1].sum(axis=2)
        if "complete" in shares:
            own = np.eye(rules.assistive, dtype=np.int64)
            counts[:, :, -rules.assistive :] = shares["complete"][:, :, None] * own
        amounts = multiply(counts, integers([rules.worth[name] for name in rules.names]))
        full = multiply(np.asarray(bottom), integers([rules.scale]))
        return amounts, np.broadcast_to(full, amounts.shape[:2])


def _rows(
    following: Integers,
    weight: Numbers,
    denominator: Numbers,
    gain: Numbers,
    event: NDArray[np.uint8],
    components: tuple[Numbers, Numbers],
) -> Rows:
    """Flatten (2^n, A, outcomes) arrays to rows, outcomes sorted by next state, zeros left out."""
    order = np.argsort(following, kind="stable")
    weight, gain = weight[:, :, order], gain[:, :, order]
    positive, shape = np.array(weight != 0, dtype=bool), weight.shape
    return {
        "lengths": positive.sum(axis=2).reshape(-1),
        "next": np.broadcast_to(following[order], shape)[positive],
        "weight": weight[positive],
        "denominator": denominator.reshape(-1),
        "gain": np.broadcast_to(gain, shape)[positive],
        "event": np.broadcast_to(event[order], shape)[positive],
        "amount": components[0].reshape(-1, components[0].shape[2]),
        "below": components[1].reshape(-1),
    }


def _matmul(left: Numbers, right: Numbers) -> Numbers:
    """Return the exact product (…, m) @ (m, n) of integer arrays."""
    narrow = left.dtype != object and right.dtype != object
    if narrow and magnitude(left) * magnitude(right) * max(len(right), 1) < EXACT_IN_INT64:
        return np.asarray(left @ right)
    return np.asarray(left.astype(object) @ right.astype(object))


def check_explicit(scenario: Tables) -> tuple[Rules, ExactChances]:
    """Return rules and chances, or raise ModelError where an explicit model would be too large."""
    rules, exact = Rules(scenario), ExactChances(scenario)
    outcomes, denominator = size(rules, exact)
    each = NARROW if denominator < EXACT_IN_INT64 else WIDE
    if outcomes * each > MOST_BYTES:
        states = len(rules.places) * rules.trials * rules.vectors
        raise ModelError(
            f"the explicit model would have {states:,} states and up to {outcomes:,} outcomes of "
            f"{each} bytes each, more than {MOST_BYTES / 1e9:g} GB",
            where=f"scenario {scenario.name}",
            fix="use fewer subtasks, trials or statuses",
        )
    return rules, exact


def size(rules: Rules, exact: ExactChances) -> tuple[int, int]:
    """Return the most outcomes, and the greatest denominator of one before anything cancels.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> size(Rules(scenario), ExactChances(scenario))[0], len(scenario.compile().table.next)
    (16481, 11005)
    """
    found, vectors = exact.found, rules.vectors
    rows = found.step.reshape(-1, found.step.shape[2])
    steps, skips = int(exact.reach(rows).sum()), exact.reach(found.skip).tolist()
    failed: dict[int, int] = {}
    for cost, ends in list(zip(rules.following.tolist(), skips, strict=True))[1:]:
        failed[cost] = min(vectors, failed.get(cost, 0) + ends)
    trying = (rules.trials - (not rules.own)) * steps
    if rules.own:
        skipping, ending = sum(skips), vectors * len(set(rules.following.tolist()))
    else:
        skipping, ending = len(rows) * (1 + sum(failed.values())), len(rows) * (1 + len(failed))
    subtasks = len(rules.places)
    outcomes = rules.flags * (subtasks * trying + (subtasks - 1) * skipping + ending) + 1
    bottoms = exact.denominators(rows), exact.denominators(found.skip)
    return outcomes, max(bottoms[0]) * lcm(*bottoms[1])


def compile_scenario(scenario: Tables) -> MDP:
    """Return the explicit model of a scenario, without a warning; see `Scenario.compile`."""
    rules, exact = check_explicit(scenario)
    used, order = np.unique(rules.places, return_inverse=True)
    small = _model(scenario, rules, exact.laws(), used)  # one block of each kind is itself a model
    return small if np.array_equal(rules.places, used) else _repeated(rules, small, order)


def _model(scenario: Tables, rules: Rules, laws: Laws, places: Integers) -> MDP:
    """Return the checked model of a block at each of `places` (K,), one after the other."""
    block = Block(rules, laws)
    blocks = [block.rows(place) for place in places.tolist()]
    end = len(blocks) * rules.size

    def joined(key: str, *tail: int) -> Numbers:
        return np.concatenate([*(rows[key] for rows in blocks), np.array(tail, dtype=np.int64)])

    lengths = joined("lengths", 1)
    starts = np.arange(len(blocks)) * rules.size
    following = [rows["next"] + start for rows, start in zip(blocks, starts, strict=True)]
    state, action = rules.pairs()
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=np.concatenate([*following, [end]]).astype(_states(end)),
        weight=joined("weight", 1),
        denominator=joined("denominator", 1),
        gain=joined("gain", 0),
        gain_denominator=_same(rules.scale, len(lengths)),
        event=joined("event", 0).astype(np.uint8),
    )
    nothing = np.zeros((1, len(rules.names)), dtype=np.int64)
    components = ComponentTable(
        amount=np.concatenate([*(rows["amount"] for rows in blocks), nothing]),
        denominator=joined("below", 1),
    )
    return MDP(
        table,
        np.append((starts[:, None] + state).reshape(-1), end),
        np.append(np.tile(action, len(blocks)), 0),
        space=rules.space(len(blocks)),
        actions=rules.actions,
        discount_exact=scenario.discount,
        component_names=rules.names,
        component_table=components,
        events=(SKIP,),
        name=scenario.name,
        parameters=scenario.parameters,
        labels=rules.labels(rules.space(len(blocks))),
    )


def _repeated(rules: Rules, small: MDP, order: Integers) -> MDP:
    """Return the model of the blocks of `small` in the given order (K,), each a number there.

    Its rows are those of `small`, which were checked there, at other places.
    """
    count, size, table, matrix = len(order), rules.size, small.table, small.transition
    known = small.component_table
    end = count * size
    starts = np.append(np.arange(order.max() + 1) * size, small.n_states - 1)
    rows = small.pair_offsets[starts]
    shifts = (np.arange(count) - order) * size
    # Runs of blocks of one kind, laid down at once.
    first = np.flatnonzero(np.diff(order, prepend=-1))
    runs = list(zip(first.tolist(), [*first[1:].tolist(), count], strict=True))

    def lay(values: Numbers, cuts: Numbers, *, moved: bool = False) -> Numbers:
        """Repeat blocks of `values`, which `cuts` (kinds + 1,) delimit; shift states."""
        total = int(np.diff(cuts)[order].sum()) + len(values) - int(cuts[-1])
        kind = np.promote_types(values.dtype, _states(end)) if moved else values.dtype
        laid, at = np.empty((total, *values.shape[1:]), dtype=kind), 0
        for begin, stop in runs:
            number, times = order[begin], stop - begin
            block = values[cuts[number] : cuts[number + 1]]
            place = laid[at : at + times * len(block)].reshape(times, *block.shape)
            if moved:
                np.add(block, shifts[begin:stop, None].astype(kind), out=place)
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
            gain_denominator=_same(rules.scale, len(indptr) - 1),
            event=None if table.event is None else lay(table.event, outcomes),
        ),
        "space": rules.space(count),
        "labels": rules.labels(rules.space(count)),
        "pair_state": lay(small.pair_state, rows, moved=True),
        "pair_action": lay(small.pair_action, rows),
        "pair_offsets": ends(np.diff(small.pair_offsets), starts),
        "component_table": known
        and ComponentTable(
            amount=lay(known.amount, rows), denominator=lay(known.denominator, rows)
        ),
        "reward": lay(small.reward, rows),
    }
    if indptr[-1] < 2**31 - 1:
        indptr = indptr.astype(indices.dtype)
    shape = (len(indptr) - 1, end + 1)
    parts["transition"] = sp.csr_array((lay(matrix.data, entries), indices, indptr), shape)
    parts["transition"].has_canonical_format = True
    mdp = object.__new__(MDP)
    mdp.__setstate__(parts)
    return mdp


def _states(end: int) -> type[np.signedinteger[Any]]:
    """Return the type of state numbers up to `end`."""
    return np.int32 if end < 2**31 - 1 else np.int64


def _same(value: int, count: int) -> Numbers:
    """Return (count,) times one integer, in the memory of one."""
    return np.asarray(np.broadcast_to(integers([value]), (count,)))
