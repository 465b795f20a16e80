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

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.build import MOST_UNNAMED_ACTIONS
from exact_mdp.mdp.components import with_outcome_amounts
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.io.files import LARGEST, read_text
from exact_mdp.mdp.io.parts import (
    FLOATS,
    MODEL,
    PARTS,
    SETS,
    build_model,
    encode_integer,
    encode_parts,
    encode_rationals,
    list_sets,
    parse_natural,
    parse_positive,
    parse_rational,
    states_format,
    write_object,
)
from exact_mdp.mdp.io.structured import json_of, or_null, refuse_value, require_shape
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

VERSION = 2
ONE = ("reward",)  # the default name of a single component


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
HEAD = PARTS | {
    "states": parse_natural,
    "start": {str: parse_rational},
    "goal": or_null([parse_natural]),
    "labels": {str: [parse_natural]},
    "components": {str: [parse_amounts]},
    "target": or_null([parse_natural]),
    "component_names": or_null([str]),
    "action_names": or_null([str]),
    "state_names": or_null([str]),
    "pairs": [PAIR],
}
ORDER = (
    *("format", "version", "name", "states", "discount", "sense", *FLOATS, "start", "goal"),
    *("unreached", "time_limit", "labels", "components", "averaged", "target", "component_names"),
    *("action_names", "state_names"),
)
"""The order of the keys in a file; the pairs follow."""
OTHERWISE: dict[str, Any] = {"name": "", "unreached": "inf", "labels": {}, "components": {}}
OTHERWISE |= dict.fromkeys(FLOATS, False)
"""Values of keys that the files of other programs may leave out."""


def encode_model(mdp: MDP) -> dict[str, Any]:
    """Return the content of the file of a model."""
    table = mdp.table
    # Names of states: words of a single column, else printed forms; null for plain numbers.
    words = None
    if mdp.space != StateSpace.plain(mdp.n_states):
        words = mdp.space.labels(range(mdp.n_states))
        if mdp.space.names == ("state",):
            words[: mdp.space.regular] = map(mdp.space.columns[0].label, range(mdp.space.regular))
    # Components, or else the name of the only one unless it is the default.
    components = dict[str, list[Any]]()
    if table.components is not None:
        for place, name in enumerate(mdp.component_names):
            components[name] = _list_amounts(table.with_component_reward(place), _encode_ratio)
    parts = encode_parts(mdp)
    if not components and mdp.component_names != ONE:
        parts["component_names"] = mdp.component_names
    parts |= {
        "format": MODEL,
        "version": VERSION,
        "states": mdp.n_states,
        "start": {str(state): share for state, share in mdp.start if share},
        "goal": None,
        **{name: np.flatnonzero(each).tolist() for name, each in list_sets(mdp).items()},
        "labels": {name: np.flatnonzero(each).tolist() for name, each in mdp.labels.items()},
        "components": components,
        "action_names": mdp.actions,
        "state_names": words,
    }
    head = {key: encode_rationals(parts[key]) for key in ORDER if key in parts}
    return {**head, "pairs": _list_pairs(mdp, _encode_integers, _encode_ratio)}


def list_problem(mdp: MDP) -> dict[str, Any]:
    """Return the part of a file that proofs are about, with Python's own numbers.

    It is for a checker in the same process, which needs neither names nor texts.
    """
    goal = None
    if mdp.goal is not None:
        goal = np.flatnonzero(mdp.goal).tolist()
    return {
        "format": MODEL,
        "version": VERSION,
        "states": mdp.n_states,
        "discount": encode_rationals(mdp.discount_exact),
        "sense": mdp.sense.value,
        "start": {str(state): encode_rationals(share) for state, share in mdp.start if share},
        "goal": goal,
        "unreached": str(mdp.unreached),
        "pairs": _list_pairs(mdp, np.ndarray.tolist, _reduce_ratio),
    }


def _list_pairs(
    mdp: MDP, integers: Callable[[Numbers], list[Any]], ratio: Callable[[int, int], Any]
) -> list[dict[str, Any]]:
    """Return the pairs of a model, with numbers as the given functions write them."""
    # The columns of the pairs; lists by outcome are cut into one list for each pair.
    table, (weight, below) = mdp.table, mdp.table.rows.integers
    rows, all_next, all_weights = _slice_rows(table), table.next.tolist(), integers(weight)
    following, weights = [all_next[row] for row in rows], [all_weights[row] for row in rows]
    states, actions = mdp.pair_state.tolist(), mdp.pair_action.tolist()
    columns = states, actions, _list_amounts(table, ratio), integers(below), following, weights
    return [dict(zip(PAIR, pair, strict=True)) for pair in zip(*columns, strict=True)]


def _slice_rows(table: OutcomeTable) -> list[slice]:
    """Return the outcomes of each pair."""
    offsets = table.offsets.tolist()
    return list(map(slice, offsets[:-1], offsets[1:]))


def _list_amounts(table: OutcomeTable, ratio: Callable[[int, int], Any]) -> list[Any]:
    """Return the reward of each pair of a table; a list if its outcomes have different rewards."""
    gain, below = table.integer_gains
    if len(gain) == table.pairs:
        return list(map(ratio, gain.tolist(), below.tolist()))
    each = list(map(ratio, gain.tolist(), below[table.pair].tolist()))
    amounts = []
    for row in _slice_rows(table):
        own: Any = each[row]
        if len({*own}) == 1:
            own = own[0]
        amounts.append(own)
    return amounts


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
    write_object(path, encode_model(mdp), listed=["pairs"])


def read_model_json(path: str | Path) -> MDP:
    """Return the model in a file; raise ModelError if it is damaged, or not a valid model."""
    with locate_errors(str(path)):
        given = json_of(read_text(path, most=LARGEST), str(path))
        if not states_format(given, MODEL, VERSION):
            raise ModelError(
                f"the file is not an {MODEL} of version {VERSION}",
                fix="give a file that exact-mdp convert IN model.json wrote; in "
                "verify CERTIFICATE MODEL the certificate comes first",
            )
        head = require_shape(OTHERWISE | given, HEAD)
        pairs, states = head["pairs"], head["states"]
        if not 1 <= states <= len(pairs):
            raise ModelError(
                f"{states} states and {len(pairs)} pairs", fix="give each state a pair"
            )
        lengths = [_count_outcomes(number, pair) for number, pair in enumerate(pairs)]
        ends = np.concatenate([[0], np.cumsum(lengths)])
        state, action, reward, below, following, weight = (
            [pair[key] for pair in pairs] for key in PAIR
        )
        # The outcomes of all pairs, sorted by next state within a pair.
        columns = [np.repeat(np.arange(len(pairs)), lengths).tolist(), [*chain(*following)]]
        columns += [[*chain(*weight)], _list_by_outcome(reward, lengths)]
        order = sorted(range(ends[-1]), key=lambda k: [column[k] for column in columns])
        _, next_states, weights, rewards = ([column[k] for k in order] for column in columns)
        # Rewards by pair, or all by outcome if some are.
        groups = ends
        if not any(isinstance(each, tuple) for each in reward):
            rewards, groups = reward, np.arange(len(pairs) + 1)
        gain, under = over_groups(rewards, groups)
        distributions = Rows(
            offsets=ends,
            next=np.array(next_states, dtype=np.int64),
            weight=to_integer_array(weights),
            denominator=to_integer_array(below),
        )
        table = OutcomeTable(rows=distributions, gain=gain, gain_denominator=under)
        parts = head["components"]
        if parts:
            amounts = {}
            for name, own in parts.items():
                with locate_errors(f"components, {name}"):
                    amounts[name] = np.array(_list_by_outcome(own, lengths), dtype=object)[order]
            table = with_outcome_amounts(table, amounts)
        # Names of actions, labels and sets of states.
        names = head["action_names"]
        if names is None:
            names = tuple(map(str, range(min(max(action), MOST_UNNAMED_ACTIONS) + 1)))
        flags = {name: _parse_flags(name, each, states) for name, each in head["labels"].items()}
        given = {name: head[name] for name in SETS if head[name] is not None}
        sets: dict[str, Any] = {name: _parse_flags(name, given[name], states) for name in given}
        return build_model(
            head,
            table,
            pair_state=np.array(state, dtype=np.int64),
            pair_action=np.array(action, dtype=np.int64),
            space=StateSpace.plain(states, head["state_names"] or ()),
            actions=names,
            start=tuple((_parse_state(key), share) for key, share in head["start"].items()),
            component_names=tuple(parts) or head["component_names"] or ONE,
            labels=flags,
            **sets,
        )


def _count_outcomes(number: int, pair: Mapping[str, Any]) -> int:
    """Return the number of outcomes of a pair; raise ModelError if its lists differ in length."""
    lists = [pair[key] for key in ("next", "weight", "reward") if isinstance(pair[key], tuple)]
    if not pair["next"] or len({*map(len, lists)}) > 1:
        with locate_errors(f"pairs, {number}"):
            refuse_value(pair["weight"], "a list with a weight, or a reward, for each next state")
    return len(pair["next"])


def _parse_state(key: str) -> int:
    """Return the state number that a key of the start is."""
    with locate_errors("start"):
        number = parse_rational(key)
        if number.denominator != 1:
            refuse_value(key, "a whole number from 0 up, below 2^62")
        return parse_natural(number.numerator)


def _list_by_outcome(amounts: Sequence[Any], lengths: Sequence[int]) -> list[Fraction]:
    """Return the amounts of all outcomes; a number counts for each outcome of its pair."""
    if len(amounts) != len(lengths):
        refuse_value(amounts, f"a list of {len(lengths)} numbers")
    values = list[Fraction]()
    for given, length in zip(amounts, lengths, strict=True):
        own = given
        if not isinstance(given, tuple):
            own = [given] * length
        if len(own) != length:
            refuse_value(given, f"a list of {length} numbers")
        values += own
    return values


def _parse_flags(name: str, numbers: Sequence[int], states: int) -> Numbers:
    """Return (S,) True for the listed states."""
    if max(numbers, default=0) >= states:
        with locate_errors(name):
            refuse_value(numbers, f"a list of states below {states}")
    return np.isin(np.arange(states), numbers)
