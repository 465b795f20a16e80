"""Models as `model.json`: exact rows in integers, to be read by any program.

    format, version   "exact-mdp model", 2
    name              a text
    states            S
    discount          a number
    sense             "max", or "min" where rewards are costs
    start             {state: probability}, of the states where a run may begin
    pairs             a list of {"state", "action", "reward", "denominator", "next", "weight"}: the
                      pair leads to next[i] with probability weight[i] / denominator, and the
                      positive integers in weight add up to the denominator; the reward is one
                      number, or a list with one for each of the next states
    float_probabilities, float_rewards
                      whether they were given as floats, whose rounding a gate forgives
    goal, unreached   null, or a list of states, the goal; and what a run that never reaches it is
                      worth, "inf" or "-inf"
    time_limit        null, or after how many steps the environment stops, which is no part of the
                      model: results say so
    target            a list of states in which `until` ends runs below discount 1; left out
                      without such a question
    labels            {name: list of states}
    component_names   [name] of the only component, if that is not "reward"; left out if it is
    components        {name: list with a number for each pair}: parts of the reward; in place of a
                      number there may be a list with one for each of the next states
    averaged          whether components, or without them rewards, are only means over the outcomes
                      of a pair; left out if not
    action_names      a list of texts, by number
    state_names       the same of states, or null

A number is an integer or a text: "7", "1/3", or in hexadecimal "-0x1f4/0x3". Integers of 2^53 and
above are texts, because not all programs read them as they are. States and actions are numbers from
0 up, and pairs are in the order of states and actions. What is not kept: columns of states,
parameters, events, and how often pairs were observed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.build import MOST_UNNAMED_ACTIONS
from exact_mdp.mdp.components import of_outcomes
from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.io.structured import (
    integer,
    is_of,
    json_of,
    natural,
    number,
    optional,
    ready,
    refuse,
    shaped,
    unreached,
)
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, integers, magnitude, over_groups

FORMAT, VERSION = "exact-mdp model", 2
FLOATS = ("float_probabilities", "float_rewards")
ONE = ("reward",)  # the name of the only component, unless it is given


def positive(given: Any) -> int:
    """Read an integer above 0."""
    value = given if type(given) is int else number(given)
    positive = value > 0 and value.denominator == 1
    return value.numerator if positive else refuse(given, "a positive integer")


def rewards(given: Any) -> Fraction | tuple[Fraction, ...]:
    """Read one reward, or one for each next state."""
    return shaped(given, [number]) if isinstance(given, list) else number(given)


PAIR = {
    "state": natural,
    "action": natural,
    "reward": rewards,
    "denominator": positive,
    "next": [natural],
    "weight": [positive],
}
HEAD = {
    "name": str,
    "states": natural,
    "discount": number,
    "sense": str,
    "start": {str: number},
    **dict.fromkeys(FLOATS, bool),
    "goal": optional([natural]),
    "unreached": unreached,
    "time_limit": optional(positive),
    "labels": {str: [natural]},
    "components": {str: [lambda given: _amount(given)]},
    "averaged": optional(bool),
    "target": optional([natural]),
    "component_names": optional([str]),
    "action_names": optional([str]),
    "state_names": optional([str]),
    "pairs": [PAIR],
}
OTHERWISE: dict[str, Any] = {"name": "", "unreached": "inf", "labels": {}, "components": {}}
OTHERWISE |= dict.fromkeys(FLOATS, False)
"""What stands for a key that a file of another program leaves out."""


def content(mdp: MDP) -> dict[str, Any]:
    """Return what the file of a model contains."""
    table, offsets = mdp.table, mdp.table.offsets
    (weight, below), (gain, under) = table.integer_weights(), table.integer_gains()
    rows = list(map(slice, offsets[:-1].tolist(), offsets[1:].tolist()))
    following, weights = (
        map(each.__getitem__, rows) for each in (table.next.tolist(), _integers(weight))
    )
    if len(gain) == table.pairs:
        rewards = list(map(_ratio, gain.tolist(), under.tolist()))
    else:
        each = list(map(_ratio, gain.tolist(), np.repeat(under, np.diff(offsets)).tolist()))
        of_pairs = map(each.__getitem__, rows)
        rewards = [own if len({*own}) > 1 else own[0] for own in of_pairs]
    states, actions = mdp.pair_state.tolist(), mdp.pair_action.tolist()
    columns = states, actions, rewards, _integers(below), following, weights
    named, one = mdp.space != StateSpace.plain(mdp.n_states), mdp.space.names == ("state",)
    words = [
        mdp.space.columns[0].label(state) if one and state < mdp.space.regular else label
        for state, label in enumerate(mdp.space.labels(range(mdp.n_states)))
    ]
    parts = {} if table.components is None else dict(_amounts(mdp, rows))
    head = {
        "format": FORMAT,
        "version": VERSION,
        "name": mdp.name,
        "states": mdp.n_states,
        "discount": mdp.discount_exact,
        "sense": mdp.sense,
        **{name: getattr(mdp, name) for name in FLOATS},
        "start": {str(state): share for state, share in mdp.start if share},
        "goal": None if mdp.goal is None else np.flatnonzero(mdp.goal).tolist(),
        "unreached": str(mdp.unreached),
        "time_limit": mdp.time_limit,
        "labels": {name: np.flatnonzero(each).tolist() for name, each in mdp.labels.items()},
        "components": parts,
        **({"averaged": True} if table.averaged else {}),
        **({"target": targeted} if (targeted := _targeted(mdp)) is not None else {}),
        **({} if parts or mdp.component_names == ONE else {"component_names": mdp.component_names}),
        "action_names": mdp.actions,
        "state_names": words if named else None,
    }
    pairs = [dict(zip(PAIR, pair, strict=True)) for pair in zip(*columns, strict=True)]
    return {**ready(head), "pairs": pairs}


def _targeted(mdp: MDP) -> list[int] | None:
    """Return the states in which runs end for a question, if they are not the goal."""
    if mdp.target is None or mdp.goal is not None:
        return None
    return np.flatnonzero(mdp.target).tolist()


def _amounts(mdp: MDP, rows: Sequence[slice]) -> Iterator[tuple[str, list[Any]]]:
    """Yield the name of each component, and its amounts by pair, or lists of them by outcome."""
    table = mdp.table
    for place, name in enumerate(mdp.component_names):
        if not table.parted_by_outcome:
            yield name, [*map(_ratio, *(each.tolist() for each in mdp.component(name)))]
            continue
        gain, below = table.earning_component(place).integer_gains()
        each = list(map(_ratio, gain.tolist(), below[table.pair].tolist()))
        of_pairs = map(each.__getitem__, rows)
        yield name, [own if len({*own}) > 1 else own[0] for own in of_pairs]


def _integers(array: Numbers) -> list[int | str]:
    numbers = array.tolist()
    return numbers if magnitude(array) < 2**53 else list(map(integer, numbers))


@lru_cache
def _ratio(top: int, below: int) -> Any:
    return integer(top) if below == 1 else ready(Fraction(top, below))


def save(mdp: MDP, path: str | Path) -> None:
    """Write a model, whole or not at all."""
    head = content(mdp)
    pairs = ",\n  ".join(json.dumps(pair) for pair in head.pop("pairs"))
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    write_atomically(path, "{" + ",\n ".join([*lines, f'"pairs": [\n  {pairs}]']) + "}\n")


def load(path: str | Path) -> MDP:
    """Read a model; raises ModelError for a file that is damaged, or no valid model."""
    with located(str(path)):
        given = json_of(read_text(path, most=LARGEST), str(path))
        if not is_of(given, FORMAT, VERSION):
            raise ModelError(
                f"the file is no {FORMAT} of version {VERSION}",
                fix="give a file that exact-mdp convert IN model.json wrote; in "
                "verify CERTIFICATE MODEL the certificate comes first",
            )
        head = shaped(OTHERWISE | given, HEAD)
        rows = [_row(number, **pair) for number, pair in enumerate(head["pairs"])]
        states, count = head["states"], len(rows)
        if not 1 <= states <= count:
            raise ModelError(f"{states} states and {count} pairs", fix="give each state a pair")
        state, action, reward, below, following, weight, orders = map(list, zip(*rows, strict=True))
        ends = np.concatenate([[0], np.cumsum([len(each) for each in weight])])
        groups = np.arange(count + 1)
        if any(isinstance(each, tuple) for each in reward):
            each_own = zip(reward, weight, strict=True)
            reward = [*chain(*(x if isinstance(x, tuple) else [x] * len(w) for x, w in each_own))]
            groups = ends
        gain, under = over_groups(reward, groups)
        table = OutcomeTable(
            offsets=ends,
            next=np.array([*chain(*following)], dtype=np.int64),
            weight=integers(chain(*weight)),
            denominator=integers(below),
            gain=gain,
            gain_denominator=under,
        )
        parts, names = head["components"], head["action_names"]
        if parts:
            columns = {name: _component(name, parts[name], orders) for name in parts}
            table = of_outcomes(table, columns)
        table = replace(table, averaged=bool(head["averaged"]))
        flags = {name: _flags(name, each, states) for name, each in head["labels"].items()}
        return MDP(
            table,
            np.array(state, dtype=np.int64),
            np.array(action, dtype=np.int64),
            space=StateSpace.plain(states, head["state_names"] or ()),
            actions=tuple(map(str, range(min(max(action), MOST_UNNAMED_ACTIONS) + 1)))
            if names is None
            else names,
            discount_exact=head["discount"],
            start=tuple((_state(key), share) for key, share in head["start"].items()),
            component_names=tuple(parts) or head["component_names"] or ONE,
            labels=flags,
            goal=None if head["goal"] is None else _flags("goal", head["goal"], states),
            target=None if head["target"] is None else _flags("target", head["target"], states),
            **{key: head[key] for key in (*FLOATS, "name", "sense", "unreached", "time_limit")},
        )


def _row(
    number: int, state: int, action: int, reward: Any, denominator: int, next: Any, weight: Any
) -> tuple[Any, ...]:
    """Return the parts of a pair, its next states in order."""
    each = [next, weight, reward] if isinstance(reward, tuple) else [next, weight]
    if not next or len({*map(len, each)}) > 1:
        with located(f"pairs, {number}"):
            refuse(weight, "a list with a weight, or a reward, for each next state")
    order = sorted(range(len(next)), key=lambda k: [column[k] for column in each])
    next, weight, *rewards = ([column[k] for k in order] for column in each)
    earned = tuple(rewards[0]) if rewards else reward
    return state, action, earned, denominator, next, weight, order


def _state(key: str) -> int:
    with located("start"):
        return natural(number(key).numerator if number(key).denominator == 1 else key)


def _amount(given: Any) -> Any:
    """Read the amount of a pair, or the amounts of its outcomes."""
    return shaped(given, [number]) if isinstance(given, list) else number(given)


def _component(name: str, amounts: Sequence[Any], orders: Sequence[Sequence[int]]) -> Numbers:
    """Return the amounts (N,) of outcomes, those of each pair in the order of its outcomes."""
    with located(f"components, {name}"):
        if len(amounts) != len(orders):
            refuse(amounts, f"a list of {len(orders)} numbers")
        values = list[Fraction]()
        for given, order in zip(amounts, orders, strict=True):
            if not isinstance(given, tuple):
                values += [given] * len(order)
                continue
            if len(given) != len(order):
                refuse(given, f"a list of {len(order)} numbers")
            values += [given[k] for k in order]
    return np.array(values, dtype=object)


def _flags(name: str, numbers: Sequence[int], states: int) -> Numbers:
    if max(numbers, default=0) >= states:
        with located(name):
            refuse(numbers, f"a list of states below {states}")
    return np.isin(np.arange(states), numbers)
