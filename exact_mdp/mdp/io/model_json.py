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
    labels            {name: list of states}
    components        {name: list with a number for each pair}: parts of the expected reward
    action_names      a list of texts, by number
    state_names       the same of states, or null

A number is an integer or a text: "7", "1/3", or in hexadecimal "-0x1f4/0x3". Integers of 2^53 and
above are texts, because not all programs read them as they are. States and actions are numbers from
0 up, and pairs are in the order of states and actions. What is not kept: columns of states,
parameters, events, and how often pairs were observed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.components import ComponentTable, of_columns
from exact_mdp.mdp.errors import ModelError, located, short
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable, common, integers, magnitude, over_groups

FORMAT, VERSION = "exact-mdp model", 2
SAFE = 2**53
NUMBER = re.compile(r"-?(0x[0-9a-f]+|[0-9]+)(/(0x[0-9a-f]+|[0-9]+))?")
FLOATS = ("float_probabilities", "float_rewards")
PAIR = ("state", "action", "reward", "denominator", "next", "weight")


def content(mdp: MDP) -> dict[str, Any]:
    """Return what the file of a model contains."""
    table, offsets = mdp.table, mdp.table.offsets
    (weight, below), (gain, under) = table.integer_weights(), table.integer_gains()
    by_pair = len(gain) == table.pairs
    each_under = under if by_pair else np.repeat(under, np.diff(offsets))
    rewards: list[Any] = list(map(_text, gain.tolist(), each_under.tolist()))
    rows = list(map(slice, offsets[:-1].tolist(), offsets[1:].tolist()))
    if not by_pair:
        of_pairs = map(rewards.__getitem__, rows)
        rewards = [own if len({*own}) > 1 else own[0] for own in of_pairs]
    columns = (
        *(mdp.pair_state.tolist(), mdp.pair_action.tolist(), rewards, _integers(below)),
        *(map(each.__getitem__, rows) for each in (table.next.tolist(), _integers(weight))),
    )
    named = mdp.space != StateSpace.plain(mdp.n_states)
    amounts = {name: mdp.component(name) for name in mdp.component_names}
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": mdp.name,
        "states": mdp.n_states,
        "discount": _ratio(mdp.discount_exact),
        "sense": mdp.sense,
        "float_probabilities": mdp.float_probabilities,
        "float_rewards": mdp.float_rewards,
        "start": {str(state): _ratio(share) for state, share in mdp.start if share},
        "goal": None if mdp.goal is None else np.flatnonzero(mdp.goal).tolist(),
        "unreached": str(mdp.unreached),
        "labels": {name: np.flatnonzero(each).tolist() for name, each in mdp.labels.items()},
        "components": {
            name: list(map(_text, top.tolist(), bottom.tolist()))
            for name, (top, bottom) in amounts.items()
        }
        if mdp.component_table is not None
        else {},
        "action_names": list(mdp.actions),
        "state_names": list(mdp.space.labels(range(mdp.n_states))) if named else None,
        "pairs": [dict(zip(PAIR, pair, strict=True)) for pair in zip(*columns, strict=True)],
    }


def _integers(array: Numbers) -> list[int | str]:
    numbers = array.tolist()
    return numbers if magnitude(array) < SAFE else list(map(_integer, numbers))


def _integer(number: int) -> int | str:
    return number if -SAFE < number < SAFE else hex(number)


@lru_cache
def _text(top: int, below: int) -> int | str:
    return _integer(top) if below == 1 else _ratio(Fraction(top, below))


def _ratio(number: Fraction) -> int | str:
    top, below = number.numerator, number.denominator
    if below == 1:
        return _integer(top)
    return f"{top}/{below}" if max(abs(top), below) < SAFE else f"{hex(top)}/{hex(below)}"


def save(mdp: MDP, path: str | Path) -> None:
    """Write a model, whole or not at all.

    Examples
    --------
    >>> import tempfile
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, "1/7"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(mdp, f"{folder}/model.json")
    ...     load(f"{folder}/model.json").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    head = content(mdp)
    pairs = ",\n  ".join(json.dumps(pair) for pair in head.pop("pairs"))
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    write_atomically(path, "{" + ",\n ".join([*lines, f'"pairs": [\n  {pairs}]']) + "}\n")


def load(path: str | Path) -> MDP:
    """Read a model; raises ModelError for a file that is damaged, or no valid model."""
    with located(str(path)):
        data = json_of(read_text(path, most=LARGEST), str(path))
        if not isinstance(data, dict) or (data.get("format"), data.get("version")) != (FORMAT, 2):
            raise ModelError(
                f"the file is no {FORMAT} of version {VERSION}",
                fix="give a file that exact-mdp convert IN model.json wrote; in "
                "verify CERTIFICATE MODEL the certificate comes first",
            )
        return _model(data)


def _model(data: dict[str, Any]) -> MDP:
    states = _whole(data.get("states"), "states")
    pairs = _list(data.get("pairs"), "pairs")
    rows = [_row(pair, number) for number, pair in enumerate(pairs)]
    if not rows or states < 1 or states > len(rows):
        raise ModelError(f"{states} states and {len(rows)} pairs", fix="give each state a pair")
    state, action, reward, below, following, weight = zip(*rows, strict=True)
    offsets = np.concatenate([[0], np.cumsum([len(each) for each in weight])])
    joint = any(isinstance(each, list) for each in reward)
    if joint:
        each = [
            x if isinstance(x, list) else [x] * len(w) for x, w in zip(reward, weight, strict=True)
        ]
        gain, under = over_groups([number for row in each for number in row], offsets)
    else:
        gain, under = over_groups(list(reward), np.arange(len(rows) + 1))
    table = OutcomeTable(
        offsets=offsets,
        next=np.array([number for row in following for number in row], dtype=np.int64),
        weight=integers(number for row in weight for number in row),
        denominator=integers(below),
        gain=gain,
        gain_denominator=under,
    )
    named = data.get("action_names")
    actions = map(str, range(max(action) + 1)) if named is None else _list(named, "action_names")
    words = _list(data.get("state_names") or [], "state_names")
    parts = _dict(data.get("components", {}), "components")
    columns = {
        name: [_number(x, f"components, {name}") for x in _list(column, name)]
        for name, column in parts.items()
    }
    goal, start = data.get("goal"), _dict(data.get("start"), "start")
    return MDP(
        table,
        np.array(state, dtype=np.int64),
        np.array(action, dtype=np.int64),
        space=StateSpace.plain(states, words),
        actions=tuple(actions),
        discount_exact=_number(data.get("discount"), "discount"),
        start=tuple((_whole(s, "start"), _number(p, "start")) for s, p in start.items()),
        component_names=tuple(columns) or ("reward",),
        component_table=_components(columns, len(rows)) if columns else None,
        name=_texts([data.get("name", "")], "name")[0],
        sense=_texts([data.get("sense")], "sense")[0],
        **{name: _bool(data.get(name, False), name) for name in FLOATS},
        labels={
            name: _flags(each, states, f"labels, {name}")
            for name, each in _dict(data.get("labels", {}), "labels").items()
        },
        goal=None if goal is None else _flags(goal, states, "goal"),
        unreached=_unreached(data.get("unreached", "inf")),
    )


def _row(given: object, number: int) -> tuple[Any, ...]:
    where = f"pair {number}"
    pair = _dict(given, where)
    if pair.keys() != {*PAIR}:
        raise _wrong(pair, where, f"an object with the keys {', '.join(PAIR)}")
    following, weight = (
        [_whole(x, f"{where}, {key}") for x in _list(pair[key], f"{where}, {key}")]
        for key in ("next", "weight")
    )
    reward: Any = pair["reward"]
    if isinstance(reward, list):
        reward = [_number(x, f"{where}, reward") for x in reward]
    else:
        reward = _number(reward, f"{where}, reward")
    lengths = {len(following), len(weight)} | ({len(reward)} if isinstance(reward, list) else set())
    if len(lengths) > 1 or min(weight, default=0) <= 0:
        raise _wrong(weight, f"{where}, weight", "a positive integer for each next state")
    order = sorted(range(len(following)), key=following.__getitem__)
    if isinstance(reward, list):
        reward = [reward[i] for i in order]
    head = [_whole(pair[key], f"{where}, {key}") for key in ("state", "action", "denominator")]
    for key, number in zip(
        ("state", "action", "next"), [*head[:2], following[order[-1]]], strict=True
    ):
        if not 0 <= number < 2**62:
            raise _wrong(number, f"{where}, {key}", "a number from 0 up, of at most 62 bits")
    return *head[:2], reward, head[2], [following[i] for i in order], [weight[i] for i in order]


def _components(columns: dict[str, list[Fraction]], pairs: int) -> ComponentTable:
    for name, column in columns.items():
        if len(column) != pairs:
            raise _wrong(column, f"components, {name}", f"a list of {pairs} numbers")
    each = [common(column) for column in columns.values()]
    return of_columns([(integers(top), integers([below] * pairs)) for top, below in each])


def _flags(given: object, states: int, where: str) -> Numbers:
    found = np.zeros(states, dtype=bool)
    numbers = [_whole(x, where) for x in _list(given, where)]
    if numbers and not 0 <= min(numbers) <= max(numbers) < states:
        raise _wrong(given, where, f"a list of states below {states}")
    found[numbers] = True
    return found


def _number(given: object, where: str) -> Fraction:
    if type(given) is int:
        return Fraction(given)
    if isinstance(given, str) and NUMBER.fullmatch(given):
        top, _, below = given.partition("/")
        try:
            return Fraction(int(top, 0), int(below or "1", 0))
        except (ValueError, ZeroDivisionError):  # 007, 1/0, or digits beyond Python's limit
            pass
    raise _wrong(given, where, 'an integer, or a text such as "1/3" or "0x1f"')


def _whole(given: object, where: str) -> int:
    number = _number(given, where)
    if number.denominator != 1:
        raise _wrong(given, where, "an integer")
    return number.numerator


def _unreached(given: object) -> float:
    known = {"inf": inf, "-inf": -inf, "0.0": 0.0}
    if not isinstance(given, str) or given not in known:
        raise _wrong(given, "unreached", '"inf" or "-inf"')
    return known[given]


def _of_type(kind: type, what: str) -> Callable[[object, str], Any]:
    def read(given: object, where: str) -> Any:
        if type(given) is not kind:
            raise _wrong(given, where, what)
        return given

    return read


_list, _dict = _of_type(list, "a list"), _of_type(dict, "an object")
_bool = _of_type(bool, "true or false")


def _texts(given: Sequence[object], where: str) -> list[Any]:
    for text in given:
        if not isinstance(text, str):
            raise _wrong(text, where, "a text")
    return list(given)


def _wrong(given: object, where: str, wanted: str) -> ModelError:
    return ModelError(f"{short(repr(given), 80)} is not {wanted}", where=where, fix="correct it")
