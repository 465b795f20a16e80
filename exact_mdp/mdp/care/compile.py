"""From a scenario to its explicit transition matrix, exactly, without a loop over states.

A subtask is a block of trials × (skipped flag) × status vectors. Next states are counted from the
block's start, so that the same rows serve wherever it lies: numbers from the block's size on are
the next subtask's first trial, or the end. Every row is made of the events of `mdp.care.rules`; a
skip after the last failed trial is one matrix product:

    P(z, gain g | s, a) = Σ_{s' ≠ 0, gain(s') = g} K_a(s, s') Z(s', z).

All subtasks share a few blocks (inside a task, last of its task, last of all), laid down one after
the other. States are numbered so that every transition leads to a higher number; the end comes
last. How large the model would be is known before any of it is built.
Source: Yuan et al. (2025), Equation 1, Table 4 and Section 3.2.
"""

from __future__ import annotations

from math import lcm
from typing import Any

import numpy as np

from exact_mdp.mdp.care.laws import ExactChances, Laws
from exact_mdp.mdp.care.rules import Rules
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

Rows = dict[str, Numbers]
"""Rows of a block: lengths, next, weight, denominator, gain, event; components amount / below."""


def _block(rules: Rules, laws: Laws, place: int) -> Rows:
    """Return all rows of a subtask at a place, by trial, flag, status and action."""
    (skip, ends, earned), below = _skip(rules, laws, place), integers([laws.skip_denominator])
    step, bottom = laws.step, laws.step_denominator
    failed, numbers = rules.gain("fail") + rules.following, np.arange(rules.vectors)
    success = step[:, :, 0]
    shares = {"complete": success, "fail": bottom - success}
    # Failing leads to the next trial with s', or to a skip: sums over s' with one gain.
    groups = []
    for gain in [] if rules.own else sorted(set(failed[1:].tolist())):
        chosen = 1 + np.flatnonzero(failed[1:] == gain)
        reached = np.flatnonzero((skip[chosen] != 0).any(axis=0))
        groups.append((chosen, skip[chosen][:, reached], ends[reached], gain + earned[reached]))
    first, last = list[Rows](), list[Rows]()
    for flag in range(rules.flags):
        home = rules.after(flag, place)[:1]
        done = rules.gain("complete", place, flag) + rules.assist[:, None]
        own = _components(rules, step, bottom, shares, flag, place)
        following = np.append(home, (rules.flags + flag) * rules.vectors + numbers[1:])
        gain = _beside(done, failed[1:]) + rules.present[:, None, None]
        first.append(_rows(following, step, bottom, gain, 0 * numbers, own))
        if rules.own:
            continue
        following = np.concatenate([home, *(to for _, _, to, _ in groups)])
        gains = _beside(done, np.concatenate([gain for *_, gain in groups]))
        own = _components(rules, step, bottom, shares | {"skip": shares["fail"]}, flag, place)
        wide, event = multiply(bottom, below), np.minimum(np.arange(len(following)), 1)
        # A row may have as many outcomes as status vectors times costs: a few rows at a time.
        each = max(1, ENTRIES // (rules.assistive * len(following)))
        for begin in range(0, rules.vectors, each):
            some = slice(begin, begin + each)
            weight = [multiply(step[some, :, :1], below)]
            weight += [_matmul(step[some][:, :, chosen], law) for chosen, law, _, _ in groups]
            # As wide as the row's denominator, below which sums stay.
            law = np.concatenate([part.astype(wide.dtype) for part in weight], axis=2)
            gain = gains + rules.present[some, None, None]
            last.append(_rows(following, law, wide[some], gain, event, tuple(o[some] for o in own)))
    if rules.own:  # *skip* is the only action, in a timestep of its own
        under = np.broadcast_to(below, (rules.vectors, 1))
        own = _components(rules, laws.skip[:, None], under, {"skip": under}, 1, place)
        gain = earned + rules.present[:, None, None]
        rows = _rows(ends, skip[:, None], under, gain, np.ones(len(ends), dtype=int), own)
        last = [rows] * rules.flags
    layer = rules.flags * rules.vectors
    parts = [
        rows | {"next": np.where(rows["next"] < rules.size, trial * layer, 0) + rows["next"]}
        for trial in range(rules.trials - (not rules.own))
        for rows in first
    ]
    parts += last
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _skip(rules: Rules, laws: Laws, place: int) -> tuple[Numbers, Integers, Numbers]:
    """Return the law of a skip (2^n, E) over E ends, the states and gains that it may come to."""
    gain = rules.gain("skip", place, 1) + rules.own * rules.following
    kinds, which = np.unique(gain, return_inverse=True)
    pairs = rules.after(1, place) * len(kinds) + which
    ends, which = np.unique(pairs, return_inverse=True)
    law = [laws.skip[:, which == end].sum(axis=1) for end in range(len(ends))]
    return np.stack(law, axis=1), ends // len(kinds), kinds[ends % len(kinds)]


def _beside(done: Numbers, failed: Numbers) -> Numbers:
    """Return the gains (A, 1 + n) of completing (A, 1), and of what failing leads to (n,)."""
    return np.concatenate([done, np.broadcast_to(failed, (len(done), len(failed)))], axis=1)


def _components(
    rules: Rules, law: Numbers, bottom: Numbers, shares: dict[str, Numbers], flag: int, place: int
) -> tuple[Numbers, Numbers]:
    """Return expected reward components (2^n, A, C) over (2^n, A), all of them integers.

    They come from the law of the next vector and the `shares` (2^n, A) of events.
    """
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
    return amounts, multiply(np.asarray(bottom), integers([rules.scale]))


def _rows(
    following: Integers,
    weight: Numbers,
    denominator: Numbers,
    gain: Numbers,
    event: Integers,
    components: tuple[Numbers, ...],
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
        "event": np.broadcast_to(event[order].astype(np.uint8), shape)[positive],
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
    """Return the most outcomes, and the greatest denominator of one before anything cancels."""
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
    laws, places = exact.laws(), rules.places.tolist()
    blocks = {place: _block(rules, laws, place) for place in {*places}}
    end = len(places) * rules.size
    kind = np.int32 if end < 2**31 - 1 else np.int64

    def joined(key: str, *tail: Any, **options: Any) -> Numbers:
        """Return the rows of all blocks, and those of the end."""
        parts = (blocks[place][key] for place in places)
        return np.concatenate([*parts, np.array(tail, dtype=np.int64)], **options)

    following = joined("next", end, dtype=kind)
    at = 0
    for number, place in enumerate(places):
        size = len(blocks[place]["next"])
        following[at : at + size] += number * rules.size
        at += size
    state, action = rules.pairs()
    lengths = joined("lengths", 1)
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=following,
        weight=joined("weight", 1),
        denominator=joined("denominator", 1),
        gain=joined("gain", 0),
        gain_denominator=np.broadcast_to(integers([rules.scale]), (len(lengths),)),
        event=joined("event", 0, dtype=np.uint8, casting="unsafe"),
    )
    space = rules.space(len(places))
    starts = np.arange(len(places))[:, None] * rules.size
    return MDP(
        table,
        np.append((starts + state).reshape(-1), end),
        np.append(np.tile(action, len(places)), 0),
        space=space,
        actions=rules.actions,
        discount_exact=scenario.discount,
        component_names=rules.names,
        component_table=ComponentTable(
            amount=joined("amount", [0] * len(rules.names)), denominator=joined("below", 1)
        ),
        events=(SKIP,),
        name=scenario.name,
        parameters=scenario.parameters,
        labels=rules.labels(space),
    )
