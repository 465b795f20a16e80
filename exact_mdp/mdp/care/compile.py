"""Compile a scenario to its explicit transition matrix, exactly, without a loop over states.

A subtask is a block of trials × (skipped flag) × status vectors. Next states are counted from the
start of the block, so the same rows serve at every place of the block: numbers from the block's
size on are the first trial of the next subtask, or the end. Rows consist of the events of
`mdp.care.rules`; a skip after the last failed trial is a matrix product:

    P(z, gain g | s, a) = Σ_{s' ≠ 0, gain(s') = g} K_a(s, s') Z(s', z).

All subtasks are copies of a few blocks (inside a task, last of its task, last of all), one after
the other. Every transition leads to a state with a higher number, and the end comes last.
Source: Yuan et al. (2025), Equation 1, Table 4 and Section 3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from math import lcm
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.care.laws import Laws
from exact_mdp.mdp.care.rules import COMPLETE, FAIL, FINAL, SKIPPED, Rules
from exact_mdp.mdp.care.tables import SKIP
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    BLOCK,
    EXACT_IN_INT64,
    MOST_BYTES,
    Integers,
    Numbers,
    OutcomeTable,
    concatenate_ranges,
    estimate_outcome_bytes,
    find_magnitude,
    multiply,
    to_integer_array,
)

Rows = dict[str, NDArray[Any]]
"""Rows of a block: their lengths, and columns of an outcome table by name."""


class Branches(NamedTuple):
    """Outcomes of a step, one for each of some next vectors.

    Outcome c has the probability Σ_{s'} K(s, s') M(s', c) over the next vectors `chosen`; without a
    `scatter` M, one of them leads to one outcome.
    """

    event: int  # the bit of the model's event
    chosen: Integers  # (m,) next vectors
    gain: Numbers  # (1 or A, k, …)
    state: Integers  # (k,) counted from the block's start
    scatter: Numbers | None = None  # (m, k) weights M over `scale`


class SubtaskStep(NamedTuple):
    """A step of a subtask, with a trial (`tries`), a skip (`skips`) or both."""

    trial: int
    flag: int
    tries: bool
    skips: bool


def list_steps(rules: Rules) -> list[SubtaskStep]:
    """Return the steps of a subtask, in the order of their states."""
    steps, last = [], rules.trials - (not rules.own)
    for trial in range(last):
        for flag in range(rules.flags):
            steps.append(SubtaskStep(trial, flag, tries=True, skips=False))
    # The last trial, or a skip with a timestep of its own, after which the flag is 1.
    for flag in range(rules.flags):
        if rules.own:
            flag = 1
        steps.append(SubtaskStep(last, flag, tries=not rules.own, skips=True))
    return steps


class Subtask:
    """The outcomes of the steps of a subtask, exact or for draws."""

    def __init__(self, laws: Laws) -> None:
        self.laws, rules = laws, laws.rules
        step, bottom = laws.compute_distributions(rules.step.reshape(-1, rules.step.shape[2]))
        shape = rules.vectors, rules.assistive
        self.step, self.bottom = step.reshape(*shape, *step.shape[1:]), bottom.reshape(shape)
        self.skip, self.skip_bottom = laws.compute_distributions(rules.skip)
        self.present, self.following = rules.now * laws.cost, rules.next * laws.cost

    def compute_event_gain(self, event: int, place: int, flag: int = 0) -> Any:
        """Return the gain of an event, without the weights of the action and of the statuses."""
        return self.laws.gain[self.laws.rules.gains[event, place, flag]]

    def list_outcomes(self, place: int, step: SubtaskStep) -> list[Branches]:
        """Return the outcomes of a step by the vector that follows its trial, or else its skip.

        A gain is without the costs of statuses. If a skip follows the trial, its outcomes are the
        next vectors of the trial, and its states those to which each vector of the skip leads.
        """
        # Without a trial every vector is followed by a skip; with one, all but 0.
        rules, others = self.laws.rules, np.arange(int(step.tries), self.laws.rules.vectors)
        outcomes, gain = [], 0
        if step.tries:
            done = self.compute_event_gain(COMPLETE, place, step.flag) + self.laws.assist
            home = rules.list_next_states(step.flag, place)[:1]
            outcomes.append(Branches(0, np.array([0]), done[:, None], home))
            gain = self.compute_event_gain(FAIL, place)
        if not step.skips:  # the next trial
            layer = ((step.trial + 1) * rules.flags + step.flag) * rules.vectors
            return [*outcomes, Branches(0, others, np.array([[gain]]), layer + others)]
        # A skip leads to the next subtask.
        gain = gain + self.compute_event_gain(SKIPPED, place, 1)
        ends = rules.list_next_states(1, place)
        if place == FINAL:  # all vectors lead to the end
            ends = ends[others]
        return [*outcomes, Branches(1, others, np.array([[gain]]), ends)]


class SubtaskBlock(Subtask):
    """The exact rows of a subtask, by its place."""

    def __init__(self, laws: Laws) -> None:
        super().__init__(laws)
        bottoms = self.skip_bottom.tolist()
        self.scale = lcm(*bottoms)  # of the law of a skip (2^n, 2^n)
        # The type of the denominator holds all sums of a row's weights, which are not greater.
        shared = to_integer_array([self.scale // each for each in bottoms])
        kind = to_integer_array([self.scale]).dtype
        self.skip = multiply(self.skip, shared[:, None]).astype(kind)

    def build_rows(self, place: int) -> Rows:
        """Return all rows of a subtask, by trial, flag, status and action."""
        rules, parts = self.laws.rules, list[Rows]()
        layer, first = rules.flags * rules.vectors, dict[int, Rows]()
        for step in list_steps(rules):
            if step.skips:
                parts.append(self._build_step(place, step))
                continue
            # The rows are the same for each trial, shifted.
            if step.trial == 0:
                first[step.flag] = self._build_step(place, step)
            rows = first[step.flag]
            shift = np.where(rows["next"] < rules.size, step.trial * layer, 0)
            parts.append(rows | {"next": rows["next"] + shift})
        return _concatenate_rows(parts)

    def _join_outcomes(self, place: int, step: SubtaskStep) -> list[Branches]:
        """Return the outcomes of a step with their whole gains; those after a skip are joined."""
        outcomes = []
        for branch in self.list_outcomes(place, step):
            outcomes.append(branch._replace(gain=branch.gain + self.following[branch.chosen]))
        if not step.skips or (not step.tries and place != FINAL):
            return outcomes
        # Outcomes with the same gain are joined, by a product with the distribution of the skip.
        # After the last subtask only the end follows, so the vector does not matter.
        scale = 1
        if step.tries:
            scale = self.scale
        _, others, (gain,), ends, _ = outcomes.pop()
        for amount in sorted(set(gain.tolist())):
            chosen, there = others[gain == amount], np.array([0])
            scatter = np.full((len(chosen), 1), scale, self.skip.dtype)
            if place != FINAL:
                there = np.flatnonzero((self.skip[chosen] != 0).any(axis=0))
                scatter = self.skip[chosen][:, there]
            gains = np.full((1, len(there)), amount, dtype=gain.dtype)
            outcomes.append(Branches(1, chosen, gains, ends[there], scatter))
        return outcomes

    def _build_step(self, place: int, step: SubtaskStep) -> Rows:
        """Return the rows of a step, with sorted next states and without zeros.

        A row may have as many outcomes as status vectors times costs. So a few present vectors are
        computed at a time, and of each product only the columns that can be positive.
        """
        # The distribution of the vectors after the step, over a denominator for each row.
        outcomes = self._join_outcomes(place, step)
        laws, bottom = self.step, self.bottom
        if not step.tries:
            laws = self.skip[:, None]
            bottom = np.broadcast_to(to_integer_array([self.scale]), laws.shape[:2])
        actions, scale = bottom.shape[1], to_integer_array([1])
        if step.tries and step.skips:
            scale = to_integer_array([self.scale])
        # The columns of all outcomes, sorted by next state.
        below, states = multiply(bottom, scale), np.concatenate([each.state for each in outcomes])
        order = np.argsort(states, kind="stable")
        kind = np.repeat([each.event for each in outcomes], [len(o.state) for o in outcomes])
        gains = [np.broadcast_to(o.gain, (actions, len(o.state))) for o in outcomes]
        gain, event = np.concatenate(gains, axis=1)[:, order], kind[order].astype(np.uint8)
        amount = self._compute_components(laws, bottom, place, step)
        # The weights, for as many present vectors at a time as memory allows.
        each = max(1, BLOCK // (actions * len(states)))
        parts = []
        for begin in range(0, len(laws), each):
            some = slice(begin, begin + each)
            weight = []
            for outcome in outcomes:
                law = laws[some][:, :, outcome.chosen]
                if outcome.scatter is None:
                    weight.append(multiply(law, scale))
                else:
                    weight.append(_multiply_matrices(law, outcome.scatter))
            # The type of the row's denominator holds all sums.
            joined = np.concatenate([w.astype(below.dtype) for w in weight], axis=2)[:, :, order]
            positive, shape = np.array(joined != 0, dtype=bool), joined.shape
            parts.append(
                {
                    "lengths": positive.sum(axis=2).reshape(-1),
                    "next": np.broadcast_to(states[order], shape)[positive],
                    "weight": joined[positive],
                    "gain": (gain + self.present[some, None, None])[positive],
                    "event": np.broadcast_to(event, shape)[positive],
                }
            )
        return _concatenate_rows(parts) | {
            "denominator": below.reshape(-1),
            "components": amount.reshape(-1, amount.shape[2]),
            "component_denominator": multiply(
                bottom.reshape(-1), to_integer_array([self.laws.scale])
            ),
        }

    def _compute_components(
        self, law: Numbers, bottom: Numbers, place: int, step: SubtaskStep
    ) -> Numbers:
        """Return the expected reward components (V, A, C) as integers over the row denominators."""
        # Count how often each weight is charged, times its probability: first the statuses.
        rules, reward = self.laws.rules, self.laws.reward
        counts = np.zeros((*bottom.shape, len(rules.weights)), dtype=bottom.dtype)
        for i, on in enumerate(rules.bits.T):
            counts[:, :, i] = rules.now * on[:, None] * bottom
            counts[:, :, i] += rules.next * law[:, :, on == 1].sum(axis=2)
        # Then the events, with their probabilities and flags.
        failed, shares = bottom, []
        if step.tries:
            failed = bottom - law[:, :, 0]
            shares += [(COMPLETE, law[:, :, 0], step.flag), (FAIL, failed, 0)]
        if step.skips:
            shares.append((SKIPPED, failed, 1))
        for event, share, of in shares:
            counts += share[:, :, None] * rules.charged[rules.gains[event, place, of]]
        # Then the action, which is charged if the subtask is completed.
        if step.tries:
            own = np.eye(rules.assistive, dtype=np.int64)
            counts[:, :, -rules.assistive :] += law[:, :, 0, None] * own
        return multiply(counts, reward[rules.weights])


def _concatenate_rows(parts: Sequence[Rows]) -> Rows:
    """Return several groups of rows as one."""
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _multiply_matrices(left: Numbers, right: Numbers) -> Numbers:
    """Return the exact product (…, m) @ (m, n) of integer arrays."""
    narrow = left.dtype != object and right.dtype != object
    largest = find_magnitude(left) * find_magnitude(right) * max(len(right), 1)
    if narrow and largest < EXACT_IN_INT64:
        return np.asarray(left @ right)
    return np.asarray(left.astype(object) @ right.astype(object))


def check_explicit(laws: Laws) -> None:
    """Raise ModelError if the explicit model would be too large."""
    rules = laws.rules
    outcomes, denominator = estimate_size(laws)
    each = estimate_outcome_bytes(wide=denominator >= EXACT_IN_INT64)
    if outcomes * each > MOST_BYTES:
        states = len(rules.places) * rules.trials * rules.vectors
        raise ModelError(
            f"the explicit model would have {states:,} states and up to {outcomes:,} outcomes of "
            f"{each} bytes each, more than {MOST_BYTES / 1e9:g} GB",
            where=f"scenario {laws.scenario.name}",
            fix="use fewer subtasks, trials or statuses",
        )


def estimate_size(laws: Laws) -> tuple[int, int]:
    """Return bounds on the number of outcomes and on the denominators (before cancelling).

    A row of a trial has as many outcomes as there are next vectors s' of positive probability. If a
    failed trial ends in a skip, there are at most

        1 + Σ over gains g of  min(2^n, Σ over s' ≠ 0 of gain g of the number of z it leads to).
    """
    rules, following = laws.rules, (laws.rules.next * laws.cost).tolist()
    rows = rules.step.reshape(-1, rules.step.shape[2])
    # A status that is neither certain nor impossible doubles the number of next vectors.
    unsure = np.asarray((laws.top > 0) & (laws.top < laws.bottom), dtype=bool)
    steps, skips = (2 ** unsure[each].sum(axis=-1) for each in (rows, rules.skip))
    failed: dict[int, int] = {}
    for cost, ends in list(zip(following, skips.tolist(), strict=True))[1:]:
        failed[cost] = min(rules.vectors, failed.get(cost, 0) + ends)
    trying = (rules.trials - (not rules.own)) * int(steps.sum())
    if rules.own:
        skipping, ending = int(skips.sum()), rules.vectors * len(set(following))
    else:
        skipping, ending = len(rows) * (1 + sum(failed.values())), len(rows) * (1 + len(failed))
    subtasks = len(rules.places)
    outcomes = rules.flags * (subtasks * trying + (subtasks - 1) * skipping + ending) + 1
    return outcomes, max(laws.compute_denominators(rows)) * lcm(
        *laws.compute_denominators(rules.skip)
    )


def compile_scenario(laws: Laws) -> MDP:
    """Return the explicit model of a scenario, without a warning; see `Scenario.compile`."""
    check_explicit(laws)
    used, order = np.unique(laws.rules.places, return_inverse=True)
    # One block of each kind is itself a model; longer ones repeat its rows.
    small = _compile_blocks(laws, used)
    if np.array_equal(laws.rules.places, used):
        return small
    return _repeat_blocks(laws, small, order)


def _compile_blocks(laws: Laws, places: Integers) -> MDP:
    """Return the checked model with a block for each of `places` (K,), one after the other."""
    scenario, rules, block = laws.scenario, laws.rules, SubtaskBlock(laws)
    starts = np.arange(len(places)) * rules.size
    end = len(places) * rules.size
    blocks = list(map(block.build_rows, places.tolist()))
    for rows, start in zip(blocks, starts, strict=True):
        rows["next"] = rows["next"] + start
    # The end stays put with reward 0.
    ones = ("lengths", "weight", "denominator", "component_denominator")
    tail = {"next": end, **dict.fromkeys(ones, 1)}
    last = {key: np.array([tail.get(key, 0)]) for key in blocks[0]}
    last["components"] = np.zeros((1, len(rules.components)), dtype=np.int64)
    rows = _concatenate_rows([*blocks, last])
    lengths, (state, action) = rows.pop("lengths"), rules.list_pairs()
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        gain_denominator=_broadcast_integer(laws.scale, len(lengths)),
        averaged=True,  # the cost of a status depends on the next vector; its component is a mean
        **rows
        | {
            "next": rows["next"].astype(_choose_state_type(end)),
            "event": rows["event"].astype("u1"),
        },
    )
    space = rules.build_space(len(places))
    return MDP(
        table,
        np.append((starts[:, None] + state).reshape(-1), end),
        np.append(np.tile(action, len(places)), 0),
        space=space,
        actions=rules.actions,
        discount_exact=scenario.discount,
        component_names=rules.components,
        events=(SKIP,),
        name=scenario.name,
        parameters=scenario.parameters,
        labels=rules.build_labels(space),
    )


def _repeat_blocks(laws: Laws, small: MDP, order: Integers) -> MDP:
    """Return the model with the blocks of `small` in the given order (K,).

    Its rows are copies of the rows of `small`, which are checked already, with shifted states.
    """
    # The pairs of each block, and of the end, in `small`.
    rules, matrix, count = laws.rules, small.transition, len(order)
    starts = np.append(np.arange(order.max() + 1) * rules.size, small.n_states - 1)
    rows, numbers = small.pair_offsets[starts], np.append(order, len(starts) - 1)
    end = count * rules.size
    lasts = np.append(rows[1:], small.n_pairs)
    pairs = concatenate_ranges(rows[numbers], lasts[numbers])
    # The shift of the states of each block, and of each pair.
    moves = np.append(np.arange(count) * rules.size, end) - starts[numbers]
    moves = np.repeat(moves.astype(_choose_state_type(end)), (lasts - rows)[numbers])
    table = small.table.of_pairs(pairs)
    following = table.next + np.repeat(moves, np.diff(table.offsets))
    below = _broadcast_integer(laws.scale, len(pairs))
    table = replace(table, next=following, gain_denominator=below)
    # The matrix has fewer entries if outcomes with different rewards lead to one state.
    matrix = matrix[pairs]
    columns = following
    if len(matrix.indices) < len(following):
        columns = matrix.indices + np.repeat(moves, np.diff(matrix.indptr))
    shape = len(pairs), end + 1
    transition = sp.csr_array((matrix.data, columns, matrix.indptr), shape)
    transition.has_canonical_format = True
    states, space = small.pair_state[pairs] + moves, rules.build_space(count)
    parts: dict[str, Any] = {field.name: getattr(small, field.name) for field in fields(MDP)}
    parts |= {
        "table": table,
        "space": space,
        "labels": rules.build_labels(space),
        "pair_state": states,
        "pair_action": small.pair_action[pairs],
        "pair_offsets": np.concatenate([[0], np.cumsum(np.bincount(states))]),
        "reward": small.reward[pairs],
        "transition": transition,
    }
    # Set the fields without the checks and derivations of the constructor.
    mdp = object.__new__(MDP)
    mdp.__setstate__(parts)
    return mdp


def _choose_state_type(end: int) -> type[np.signedinteger[Any]]:
    """Return the type of state numbers up to `end`."""
    if end < 2**31 - 1:
        return np.int32
    return np.int64


def _broadcast_integer(value: int, count: int) -> Numbers:
    """Return an array (count,) of one integer that takes the memory of one entry."""
    return np.asarray(np.broadcast_to(to_integer_array([value]), (count,)))
