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
from exact_mdp.mdp.components import with_outcome_amounts
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.io.structured import (
    encode_integer,
    encode_rationals,
    has_format,
    json_of,
    or_null,
    parse_natural,
    parse_rational,
    parse_unreached,
    refuse_value,
    require_shape,
)
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, find_magnitude, over_groups, to_integer_array

FORMAT, VERSION = "exact-mdp model", 2
FLOATS = ("float_probabilities", "float_rewards")
ONE = ("reward",)  # the name of the only component, unless it is given


def parse_positive(given: Any) -> int:
    """Read an integer above 0."""
    value = given if type(given) is int else parse_rational(given)
    positive = value > 0 and value.denominator == 1
    return value.numerator if positive else refuse_value(given, "a positive integer")


def parse_rewards(given: Any) -> Fraction | tuple[Fraction, ...]:
    """Read one reward, or one for each next state."""
    return (
        require_shape(given, [parse_rational]) if isinstance(given, list) else parse_rational(given)
    )


PAIR = {
    "state": parse_natural,
    "action": parse_natural,
    "reward": parse_rewards,
    "denominator": parse_positive,
    "next": [parse_natural],
    "weight": [parse_positive],
}
HEAD = {
    "name": str,
    "states": parse_natural,
    "discount": parse_rational,
    "sense": str,
    "start": {str: parse_rational},
    **dict.fromkeys(FLOATS, bool),
    "goal": or_null([parse_natural]),
    "unreached": parse_unreached,
    "time_limit": or_null(parse_positive),
    "labels": {str: [parse_natural]},
    "components": {str: [lambda given: _parse_amount(given)]},
    "averaged": or_null(bool),
    "target": or_null([parse_natural]),
    "component_names": or_null([str]),
    "action_names": or_null([str]),
    "state_names": or_null([str]),
    "pairs": [PAIR],
}
OTHERWISE: dict[str, Any] = {"name": "", "unreached": "inf", "labels": {}, "components": {}}
OTHERWISE |= dict.fromkeys(FLOATS, False)
"""What stands for a key that a file of another program leaves out."""


def encode_model(mdp: MDP) -> dict[str, Any]:
    """Return what the file of a model contains."""
    table, offsets = mdp.table, mdp.table.offsets
    (weight, below), (gain, under) = table.integer_weights(), table.integer_gains()
    rows = list(map(slice, offsets[:-1].tolist(), offsets[1:].tolist()))
    following, weights = (
        map(each.__getitem__, rows) for each in (table.next.tolist(), _encode_integers(weight))
    )
    if len(gain) == table.pairs:
        rewards = list(map(_encode_ratio, gain.tolist(), under.tolist()))
    else:
        each = list(map(_encode_ratio, gain.tolist(), np.repeat(under, np.diff(offsets)).tolist()))
        of_pairs = map(each.__getitem__, rows)
        rewards = [own if len({*own}) > 1 else own[0] for own in of_pairs]
    states, actions = mdp.pair_state.tolist(), mdp.pair_action.tolist()
    columns = states, actions, rewards, _encode_integers(below), following, weights
    named, one = mdp.space != StateSpace.plain(mdp.n_states), mdp.space.names == ("state",)
    words = [
        mdp.space.columns[0].label(state) if one and state < mdp.space.regular else label
        for state, label in enumerate(mdp.space.labels(range(mdp.n_states)))
    ]
    parts = {} if table.components is None else dict(_list_component_amounts(mdp, rows))
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
        **({"target": targeted} if (targeted := _list_targets(mdp)) is not None else {}),
        **({} if parts or mdp.component_names == ONE else {"component_names": mdp.component_names}),
        "action_names": mdp.actions,
        "state_names": words if named else None,
    }
    pairs = [dict(zip(PAIR, pair, strict=True)) for pair in zip(*columns, strict=True)]
    return {**encode_rationals(head), "pairs": pairs}


def _list_targets(mdp: MDP) -> list[int] | None:
    """Return the states in which runs end for a question, if they are not the goal."""
    if mdp.target is None or mdp.goal is not None:
        return None
    return np.flatnonzero(mdp.target).tolist()


def _list_component_amounts(mdp: MDP, rows: Sequence[slice]) -> Iterator[tuple[str, list[Any]]]:
    """Yield the name of each component, and its amounts by pair, or lists of them by outcome."""
    table = mdp.table
    for place, name in enumerate(mdp.component_names):
        if not table.parted_by_outcome:
            yield name, [*map(_encode_ratio, *(each.tolist() for each in mdp.component(name)))]
            continue
        gain, below = table.with_component_reward(place).integer_gains()
        each = list(map(_encode_ratio, gain.tolist(), below[table.pair].tolist()))
        of_pairs = map(each.__getitem__, rows)
        yield name, [own if len({*own}) > 1 else own[0] for own in of_pairs]


def _encode_integers(array: Numbers) -> list[int | str]:
    numbers = array.tolist()
    return numbers if find_magnitude(array) < 2**53 else list(map(encode_integer, numbers))


@lru_cache
def _encode_ratio(top: int, below: int) -> Any:
    return encode_integer(top) if below == 1 else encode_rationals(Fraction(top, below))


def write_model_json(mdp: MDP, path: str | Path) -> None:
    """Write a model, whole or not at all."""
    head = encode_model(mdp)
    pairs = ",\n  ".join(json.dumps(pair) for pair in head.pop("pairs"))
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    write_atomically(path, "{" + ",\n ".join([*lines, f'"pairs": [\n  {pairs}]']) + "}\n")


def read_model_json(path: str | Path) -> MDP:
    """Read a model; raises ModelError for a file that is damaged, or no valid model."""
    with locate_errors(str(path)):
        given = json_of(read_text(path, most=LARGEST), str(path))
        if not has_format(given, FORMAT, VERSION):
            raise ModelError(
                f"the file is no {FORMAT} of version {VERSION}",
                fix="give a file that exact-mdp convert IN model.json wrote; in "
                "verify CERTIFICATE MODEL the certificate comes first",
            )
        head = require_shape(OTHERWISE | given, HEAD)
        rows = [_parse_pair(number, **pair) for number, pair in enumerate(head["pairs"])]
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
            weight=to_integer_array(chain(*weight)),
            denominator=to_integer_array(below),
            gain=gain,
            gain_denominator=under,
        )
        parts, names = head["components"], head["action_names"]
        if parts:
            columns = {name: _parse_component(name, parts[name], orders) for name in parts}
            table = with_outcome_amounts(table, columns)
        table = replace(table, averaged=bool(head["averaged"]))
        flags = {name: _parse_flags(name, each, states) for name, each in head["labels"].items()}
        return MDP(
            table,
            np.array(state, dtype=np.int64),
            np.array(action, dtype=np.int64),
            space=StateSpace.plain(states, head["state_names"] or ()),
            actions=tuple(map(str, range(min(max(action), MOST_UNNAMED_ACTIONS) + 1)))
            if names is None
            else names,
            discount_exact=head["discount"],
            start=tuple((_parse_state(key), share) for key, share in head["start"].items()),
            component_names=tuple(parts) or head["component_names"] or ONE,
            labels=flags,
            goal=None if head["goal"] is None else _parse_flags("goal", head["goal"], states),
            target=None
            if head["target"] is None
            else _parse_flags("target", head["target"], states),
            **{key: head[key] for key in (*FLOATS, "name", "sense", "unreached", "time_limit")},
        )


def _parse_pair(
    number: int, state: int, action: int, reward: Any, denominator: int, next: Any, weight: Any
) -> tuple[Any, ...]:
    """Return the parts of a pair, its next states in order."""
    each = [next, weight, reward] if isinstance(reward, tuple) else [next, weight]
    if not next or len({*map(len, each)}) > 1:
        with locate_errors(f"pairs, {number}"):
            refuse_value(weight, "a list with a weight, or a reward, for each next state")
    order = sorted(range(len(next)), key=lambda k: [column[k] for column in each])
    next, weight, *rewards = ([column[k] for k in order] for column in each)
    earned = tuple(rewards[0]) if rewards else reward
    return state, action, earned, denominator, next, weight, order


def _parse_state(key: str) -> int:
    with locate_errors("start"):
        return parse_natural(
            parse_rational(key).numerator if parse_rational(key).denominator == 1 else key
        )


def _parse_amount(given: Any) -> Any:
    """Read the amount of a pair, or the amounts of its outcomes."""
    return (
        require_shape(given, [parse_rational]) if isinstance(given, list) else parse_rational(given)
    )


def _parse_component(name: str, amounts: Sequence[Any], orders: Sequence[Sequence[int]]) -> Numbers:
    """Return the amounts (N,) of outcomes, those of each pair in the order of its outcomes."""
    with locate_errors(f"components, {name}"):
        if len(amounts) != len(orders):
            refuse_value(amounts, f"a list of {len(orders)} numbers")
        values = list[Fraction]()
        for given, order in zip(amounts, orders, strict=True):
            if not isinstance(given, tuple):
                values += [given] * len(order)
                continue
            if len(given) != len(order):
                refuse_value(given, f"a list of {len(order)} numbers")
            values += [given[k] for k in order]
    return np.array(values, dtype=object)


def _parse_flags(name: str, numbers: Sequence[int], states: int) -> Numbers:
    if max(numbers, default=0) >= states:
        with locate_errors(name):
            refuse_value(numbers, f"a list of states below {states}")
    return np.isin(np.arange(states), numbers)
