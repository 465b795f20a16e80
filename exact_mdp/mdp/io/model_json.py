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
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache, partial
from itertools import chain, pairwise, starmap
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.components import made_of
from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.io.structured import (
    integer,
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
KIND = FORMAT, VERSION
MOST = 100_000  # actions without names
FLOATS = ("float_probabilities", "float_rewards")
SAME = ("name", "sense", "unreached", *FLOATS)
HEAD: dict[str, Any] = {
    "name": str,
    "states": natural,
    "discount": number,
    "sense": str,
    "start": {str: number},
    **dict.fromkeys(FLOATS, bool),
    "goal": optional([natural]),
    "unreached": unreached,
    "labels": {str: [natural]},
    "action_names": optional([str]),
}
"""What files of models say of them beside the rows."""


def whole(given: Any, least: float = -inf) -> int:
    """Read an integer, be it a number or a text."""
    value = given if type(given) is int else number(given)
    fits = value >= least and value.denominator == 1
    return value.numerator if fits else refuse(given, f"an integer of {least} or more")


PAIR = {
    "state": natural,
    "action": natural,
    "reward": lambda given: shaped(given, [number] if isinstance(given, list) else number),
    "denominator": partial(whole, least=1),
    "next": [natural],
    "weight": [partial(whole, least=1)],
}
MORE = {"components": {str: [number]}, "state_names": optional([str]), "pairs": [PAIR]}
OTHERWISE: dict[str, Any] = {"name": "", "unreached": "inf", "labels": {}, "components": {}}
OTHERWISE |= dict.fromkeys(FLOATS, False)
"""What stands for a key that a file of another program leaves out."""


def head_of(mdp: MDP) -> dict[str, Any]:
    """Return what a file says of a model beside its rows."""
    head: dict[str, Any] = ready(
        {
            "format": FORMAT,
            "version": VERSION,
            "states": mdp.n_states,
            "discount": mdp.discount_exact,
            **{name: getattr(mdp, name) for name in SAME},
            "unreached": str(mdp.unreached),
            "start": {str(state): share for state, share in mdp.start if share},
            "goal": None if mdp.goal is None else np.flatnonzero(mdp.goal).tolist(),
            "labels": {name: np.flatnonzero(each).tolist() for name, each in mdp.labels.items()},
            "action_names": mdp.actions,
        }
    )
    return head


def read_head(given: Any, more: dict[str, Any]) -> dict[str, Any]:
    """Return the head of a model's file, and the keys that the format has `more`."""
    if not isinstance(given, dict) or (given.get("format"), given.get("version")) != KIND:
        raise ModelError(
            f"the file is no {FORMAT} of version {VERSION}",
            fix="give a file that exact-mdp convert IN OUT wrote; in "
            "verify CERTIFICATE MODEL the certificate comes first",
        )
    read: dict[str, Any] = shaped(OTHERWISE | given, HEAD | more)
    return read


def parts_of(head: Mapping[str, Any], pairs: int) -> dict[str, Any]:
    """Return the parts of a model of so many pairs that the head of its file states."""
    states, goal = head["states"], head["goal"]
    if not 1 <= states <= pairs:
        raise ModelError(f"{states} states and {pairs} pairs", fix="give each state a pair")

    def flags(name: str, listed: Sequence[int]) -> Numbers:
        if max(listed, default=0) >= states:
            with located(name):
                refuse(listed, f"a list of states below {states}")
        return np.isin(np.arange(states), listed)

    with located("start"):
        start = tuple((whole(state, 0), share) for state, share in head["start"].items())
    return {
        "start": start,
        "goal": None if goal is None else flags("goal", goal),
        "labels": {name: flags(name, listed) for name, listed in head["labels"].items()},
        **{name: head[name] for name in SAME},
    }


def content(mdp: MDP) -> dict[str, Any]:
    """Return what the file of a model contains."""
    table = mdp.table
    (weight, below), (gain, under) = table.integer_weights(), table.integer_gains()
    joint = len(gain) != table.pairs
    under = np.repeat(under, np.diff(table.offsets)) if joint else under
    reward, following = list(map(_ratio, gain.tolist(), under.tolist())), table.next.tolist()
    weights, denominators = _integers(weight), _integers(below)
    state, action = mdp.pair_state.tolist(), mdp.pair_action.tolist()
    pairs = [
        {
            "state": state[pair],
            "action": action[pair],
            "reward": _alike(reward[first:last]) if joint else reward[pair],
            "denominator": denominators[pair],
            "next": following[first:last],
            "weight": weights[first:last],
        }
        for pair, (first, last) in enumerate(pairwise(table.offsets.tolist()))
    ]
    space, parts = mdp.space, mdp.component_names if table.components is not None else ()
    one = space.names == ("state",)
    words = [
        space.columns[0].label(state) if one and state < space.regular else label
        for state, label in enumerate(space.labels(range(space.size)))
    ]
    return head_of(mdp) | {
        "components": {
            name: [*map(_ratio, *(each.tolist() for each in mdp.component(name)))] for name in parts
        },
        "state_names": words if space != StateSpace.plain(space.size) else None,
        "pairs": pairs,
    }


def _integers(array: Numbers) -> list[int | str]:
    numbers = array.tolist()
    return numbers if magnitude(array) < 2**53 else list(map(integer, numbers))


def _alike(rewards: list[Any]) -> Any:
    return rewards if len({*rewards}) > 1 else rewards[0]


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
        head = read_head(json_of(read_text(path, most=LARGEST), str(path)), MORE)
        pairs, names, components = head["pairs"], head["action_names"], head["components"]
        parts = parts_of(head, len(pairs))
        rows = list(starmap(_row, enumerate(pairs)))
        state, action, reward, below, following, weight = map(list, zip(*rows, strict=True))
        offsets, each = np.cumsum([0, *map(len, weight)]), np.arange(len(pairs) + 1)
        joint = any(isinstance(pair["reward"], tuple) for pair in pairs)
        gain, under = over_groups(
            [*chain(*reward)] if joint else [own[0] for own in reward], offsets if joint else each
        )
        table = OutcomeTable(
            offsets=offsets,
            next=np.array([*chain(*following)], dtype=np.int64),
            weight=integers(chain(*weight)),
            denominator=integers(below),
            gain=gain,
            gain_denominator=under,
        )
        for name, amounts in components.items():
            if len(amounts) != len(pairs):
                refuse(amounts, f"a list of {len(pairs)} numbers, the component {name}")
        if components:
            table = made_of(table, [over_groups(own, each) for own in components.values()])
        return MDP(
            table,
            np.array(state, dtype=np.int64),
            np.array(action, dtype=np.int64),
            space=StateSpace.plain(head["states"], head["state_names"] or ()),
            actions=tuple(map(str, range(min(max(action), MOST) + 1))) if names is None else names,
            discount_exact=head["discount"],
            component_names=tuple(components) or ("reward",),
            **parts,
        )


def _row(number: int, pair: dict[str, Any]) -> tuple[Any, ...]:
    """Return the parts of a pair, its next states in order."""
    state, action, reward, below, *each, weight = pair.values()
    each = [*each, weight, reward if isinstance(reward, tuple) else [reward] * len(weight)]
    if not weight or len({*map(len, each)}) > 1:
        with located(f"pairs, {number}"):
            refuse(weight, "a list with a weight, or a reward, for each next state")
    following, weight, reward = zip(*sorted(zip(*each, strict=True)), strict=True)
    return state, action, reward, below, following, weight
