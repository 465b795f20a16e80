"""Models as `model.json`: exact rows in integers, for any program to read.

    format, version   "exact-mdp model", 2
    name              a text
    states            S
    discount          a number
    sense             "max", or "min" for costs
    start             {state: probability}, for the states with a positive probability
    pairs             a list of {"state", "action", "reward", "denominator", "next", "weight"}: the
                      pair leads to next[i] with probability weight[i] / denominator, and the
                      positive integers in weight add up to the denominator; the reward is one
                      number, or a list with one for each of the next states
    float_probabilities, float_rewards
                      whether they were given as floats; audits then allow for their rounding
    goal, unreached   null, or a list of states, the goal; and the value of a run that never reaches
                      it, "inf" or "-inf"
    time_limit        null, or the number of steps after which the environment stops; it is not part
                      of the model, and results mention it
    target            a list of states in which `until` ends runs below discount 1; left out
                      without such a question
    labels            {name: list of states}
    component_names   [name] of the only component, if that is not "reward"; left out if it is
    components        {name: list with a number for each pair}: parts of the reward; instead of a
                      number there may be a list with one for each of the next states
    averaged          whether components, or without them rewards, are only means over the outcomes
                      of a pair; left out if not
    action_names      a list of texts, by number
    state_names       a list of texts, by number, or null

A number is an integer or a text: "7", "1/3", or in hexadecimal "-0x1f4/0x3". Integers of 2^53 and
above are texts, because some programs would round them. States and actions are numbers from 0, and
pairs are in the order of states and actions. Columns of states, parameters, events, and numbers of
observations are not saved.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
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
from exact_mdp.mdp.table import (
    EXACT_IN_FLOAT,
    Numbers,
    OutcomeTable,
    Rows,
    find_magnitude,
    over_groups,
    to_integer_array,
)

FORMAT, VERSION = "exact-mdp model", 2
FLOATS = ("float_probabilities", "float_rewards")
ONE = ("reward",)  # the default name of a single component


def parse_positive(given: Any) -> int:
    """Return a positive integer."""
    value = parse_rational(given)
    if value <= 0 or value.denominator != 1:
        refuse_value(given, "a positive integer")
    return value.numerator


def parse_amounts(given: Any) -> Fraction | tuple[Fraction, ...]:
    """Return the reward, or component amount, of a pair; or a tuple with one per next state."""
    if isinstance(given, list):
        amounts: tuple[Fraction, ...] = require_shape(given, [parse_rational])
        return amounts
    return parse_rational(given)


PAIR = {
    "state": parse_natural,
    "action": parse_natural,
    "reward": parse_amounts,
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
    "components": {str: [parse_amounts]},
    "averaged": or_null(bool),
    "target": or_null([parse_natural]),
    "component_names": or_null([str]),
    "action_names": or_null([str]),
    "state_names": or_null([str]),
    "pairs": [PAIR],
}
OTHERWISE: dict[str, Any] = {"name": "", "unreached": "inf", "labels": {}, "components": {}}
OTHERWISE |= dict.fromkeys(FLOATS, False)
"""Values of keys that the files of other programs may leave out."""


def encode_problem(mdp: MDP, *, as_text: bool = True) -> dict[str, Any]:
    """Return the part of a model's file that proofs are about: all but names and components.

    Without `as_text`, the pairs have Python's own numbers, for a checker in the same process.
    """
    integers: Callable[[Numbers], list[Any]] = np.ndarray.tolist
    ratio: Callable[[int, int], Any] = _reduce_ratio
    if as_text:
        integers, ratio = _encode_integers, _encode_ratio
    # The columns of the pairs; lists by outcome are cut into one list for each pair.
    table, rows = mdp.table, _slice_rows(mdp)
    (weight, below), (gain, under) = table.rows.integers, table.integer_gains
    all_next, all_weights = table.next.tolist(), integers(weight)
    following, weights = [all_next[row] for row in rows], [all_weights[row] for row in rows]
    if len(gain) == table.pairs:
        rewards = list(map(ratio, gain.tolist(), under.tolist()))
    else:
        each = list(map(ratio, gain.tolist(), np.repeat(under, np.diff(table.offsets)).tolist()))
        rewards = [_merge_equal(each[row]) for row in rows]
    states, actions = mdp.pair_state.tolist(), mdp.pair_action.tolist()
    columns = states, actions, rewards, integers(below), following, weights
    goal = None
    if mdp.goal is not None:
        goal = np.flatnonzero(mdp.goal).tolist()
    return {
        "format": FORMAT,
        "version": VERSION,
        "states": mdp.n_states,
        "discount": encode_rationals(mdp.discount_exact),
        "sense": mdp.sense,
        "start": {str(state): encode_rationals(share) for state, share in mdp.start if share},
        "goal": goal,
        "unreached": str(mdp.unreached),
        "pairs": [dict(zip(PAIR, pair, strict=True)) for pair in zip(*columns, strict=True)],
    }


def encode_model(mdp: MDP) -> dict[str, Any]:
    """Return the content of the file of a model."""
    table, problem = mdp.table, encode_problem(mdp)
    # Names of states: words of a single column, else printed forms; null for plain numbers.
    words = None
    if mdp.space != StateSpace.plain(mdp.n_states):
        words = mdp.space.labels(range(mdp.n_states))
        if mdp.space.names == ("state",):
            words[: mdp.space.regular] = map(mdp.space.columns[0].label, range(mdp.space.regular))
    # Keys that are written only if they differ from their default.
    parts, optional = dict[str, list[Any]](), dict[str, Any]()
    if table.components is not None:
        parts = dict(_list_component_amounts(mdp))
    if table.averaged:
        optional["averaged"] = True
    if mdp.target is not None and mdp.goal is None:
        optional["target"] = np.flatnonzero(mdp.target).tolist()
    if not parts and mdp.component_names != ONE:
        optional["component_names"] = list(mdp.component_names)
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": mdp.name,
        **{key: problem[key] for key in ("states", "discount", "sense")},
        **{name: getattr(mdp, name) for name in FLOATS},
        **{key: problem[key] for key in ("start", "goal", "unreached")},
        "time_limit": mdp.time_limit,
        "labels": {name: np.flatnonzero(each).tolist() for name, each in mdp.labels.items()},
        "components": parts,
        **optional,
        "action_names": list(mdp.actions),
        "state_names": words,
        "pairs": problem["pairs"],
    }


def _slice_rows(mdp: MDP) -> list[slice]:
    """Return the outcomes of each pair."""
    offsets = mdp.table.offsets.tolist()
    return list(map(slice, offsets[:-1], offsets[1:]))


def _merge_equal(amounts: list[Any]) -> Any:
    """Return the amount of a pair if all of its outcomes have the same, else the list."""
    if len({*amounts}) > 1:
        return amounts
    return amounts[0]


def _list_component_amounts(mdp: MDP) -> Iterator[tuple[str, list[Any]]]:
    """Yield the name of each component, and its amount for each pair, or amounts by outcome."""
    table, rows = mdp.table, _slice_rows(mdp)
    for place, name in enumerate(mdp.component_names):
        if not table.parted_by_outcome:
            yield name, [*map(_encode_ratio, *(each.tolist() for each in mdp.component(name)))]
            continue
        gain, below = table.with_component_reward(place).integer_gains
        each = list(map(_encode_ratio, gain.tolist(), below[table.pair].tolist()))
        yield name, [_merge_equal(each[row]) for row in rows]


def _encode_integers(array: Numbers) -> list[int | str]:
    """Return integers for JSON, large ones as texts."""
    numbers: list[int | str] = array.tolist()
    if find_magnitude(array) < EXACT_IN_FLOAT:
        return numbers
    return list(map(encode_integer, array.tolist()))


@lru_cache
def _encode_ratio(top: int, below: int) -> Any:
    """Return a ratio for JSON."""
    if below == 1:
        return encode_integer(top)
    return encode_rationals(Fraction(top, below))


@lru_cache
def _reduce_ratio(top: int, below: int) -> int | Fraction:
    """Return a ratio as an integer, with which a checker computes faster, or as a Fraction."""
    number = Fraction(top, below)
    if number.denominator == 1:
        return number.numerator
    return number


def write_model_json(mdp: MDP, path: str | Path) -> None:
    """Write a model, completely or not at all."""
    head = encode_model(mdp)
    pairs = ",\n  ".join(json.dumps(pair) for pair in head.pop("pairs"))
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    write_atomically(path, "{" + ",\n ".join([*lines, f'"pairs": [\n  {pairs}]']) + "}\n")


def read_model_json(path: str | Path) -> MDP:
    """Return the model in a file; raise ModelError if it is damaged, or not a valid model."""
    with locate_errors(str(path)):
        given = json_of(read_text(path, most=LARGEST), str(path))
        if not has_format(given, FORMAT, VERSION):
            raise ModelError(
                f"the file is not an {FORMAT} of version {VERSION}",
                fix="give a file that exact-mdp convert IN model.json wrote; in "
                "verify CERTIFICATE MODEL the certificate comes first",
            )
        head = require_shape(OTHERWISE | given, HEAD)
        rows = [_parse_pair(number, **pair) for number, pair in enumerate(head["pairs"])]
        states, count = head["states"], len(rows)
        if not 1 <= states <= count:
            raise ModelError(f"{states} states and {count} pairs", fix="give each state a pair")
        state, action, reward, below, following, weight, orders = map(list, zip(*rows, strict=True))
        # Rewards by pair, or all by outcome if some are.
        ends = np.concatenate([[0], np.cumsum([len(each) for each in weight])])
        groups = np.arange(count + 1)
        if any(isinstance(each, tuple) for each in reward):
            by_outcome: list[Fraction] = []
            for own, weights in zip(reward, weight, strict=True):
                if not isinstance(own, tuple):
                    own = [own] * len(weights)
                by_outcome += own
            reward, groups = by_outcome, ends
        gain, under = over_groups(reward, groups)
        distributions = Rows(
            offsets=ends,
            next=np.array([*chain(*following)], dtype=np.int64),
            weight=to_integer_array(chain(*weight)),
            denominator=to_integer_array(below),
        )
        table = OutcomeTable(rows=distributions, gain=gain, gain_denominator=under)
        parts = head["components"]
        if parts:
            columns = {name: _parse_component(name, parts[name], orders) for name in parts}
            table = with_outcome_amounts(table, columns)
        table = replace(table, averaged=bool(head["averaged"]))
        # Names of actions, labels and sets of states.
        names = head["action_names"]
        if names is None:
            names = tuple(map(str, range(min(max(action), MOST_UNNAMED_ACTIONS) + 1)))
        flags = {name: _parse_flags(name, each, states) for name, each in head["labels"].items()}
        sets: dict[str, Any] = {}
        for name in ("goal", "target"):
            if head[name] is not None:
                sets[name] = _parse_flags(name, head[name], states)
        return MDP(
            table,
            np.array(state, dtype=np.int64),
            np.array(action, dtype=np.int64),
            space=StateSpace.plain(states, head["state_names"] or ()),
            actions=names,
            discount_exact=head["discount"],
            start=tuple((_parse_state(key), share) for key, share in head["start"].items()),
            component_names=tuple(parts) or head["component_names"] or ONE,
            labels=flags,
            **sets,
            **{key: head[key] for key in (*FLOATS, "name", "sense", "unreached", "time_limit")},
        )


def _parse_pair(
    number: int, state: int, action: int, reward: Any, denominator: int, next: Any, weight: Any
) -> tuple[Any, ...]:
    """Return the parts of a pair, sorted by next state, and the order in which they stood."""
    each = [next, weight]
    if isinstance(reward, tuple):
        each.append(reward)
    if not next or len({*map(len, each)}) > 1:
        with locate_errors(f"pairs, {number}"):
            refuse_value(weight, "a list with a weight, or a reward, for each next state")
    order = sorted(range(len(next)), key=lambda k: [column[k] for column in each])
    next, weight = [next[k] for k in order], [weight[k] for k in order]
    if isinstance(reward, tuple):
        reward = tuple(reward[k] for k in order)
    return state, action, reward, denominator, next, weight, order


def _parse_state(key: str) -> int:
    """Return the state number that a key of the start is."""
    with locate_errors("start"):
        number = parse_rational(key)
        if number.denominator != 1:
            refuse_value(key, "a whole number from 0 up, below 2^62")
        return parse_natural(number.numerator)


def _parse_component(name: str, amounts: Sequence[Any], orders: Sequence[Sequence[int]]) -> Numbers:
    """Return the amounts (N,) of a component, with the outcomes of each pair in sorted order."""
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
    """Return (S,) True for the listed states."""
    if max(numbers, default=0) >= states:
        with locate_errors(name):
            refuse_value(numbers, f"a list of states below {states}")
    return np.isin(np.arange(states), numbers)
