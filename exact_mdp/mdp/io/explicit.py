"""Models as model checkers list them: choices of states, branches of choices, rewards, labels.

The readers of UMB files and of what Storm builds fill in an `Explicit`, and `model_of` makes the
MDP. Rewards of states, of choices and of branches add up; a state without choices is where the
process ends, and stays put. Nothing is rounded: a number is two integers, or a float.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from exact_mdp.mdp.components import ComponentTable, completed, of_columns
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.exact import lcm_by_group
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    EXACT_IN_INT64,
    Integers,
    Numbers,
    OutcomeTable,
    dyadic,
    magnitude,
    multiply,
    ones,
    reduced,
)
from exact_mdp.mdp.validate import Flags, as_discount, as_start

REWARD = "reward"
INITIAL = "init"


class Ratios(NamedTuple):
    """Numbers (K,): integers over positive integers (K,), or floats over ones."""

    top: Numbers
    bottom: Numbers


@dataclass(frozen=True, kw_only=True)
class Explicit:
    """What is said of S states, C choices and N branches.

    Rewards and labels are by identifier, and `titles` are their names. Of files that exact-mdp
    wrote, `own` is what the format has no other place for, and `header` describes the model.
    """

    name: str
    state_to_choices: Integers  # (S+1,)
    choice_to_branches: Integers  # (C+1,)
    target: Integers  # (N,)
    probability: Ratios  # (N,)
    actions: Integers  # (C,)
    action_names: tuple[str, ...]
    initial: Flags  # (S,)
    words: tuple[str, ...]  # (S,) names of states, or none
    rewards: Mapping[str, Mapping[str, Ratios]]  # of states (S,), choices (C,), branches (N,)
    labels: Mapping[str, Flags]  # (S,)
    titles: Mapping[str, Mapping[str, str]]  # of "rewards" and of "aps"
    listed_actions: tuple[str, ...] = ()  # as the file lists them
    own: Mapping[str, Any] = field(default_factory=dict)
    header: Mapping[str, Any] | None = None


def ratios(values: Sequence[Any]) -> Ratios:
    """Return numbers as arrays: floats where one is, or integers over integers."""
    if any(isinstance(value, float) for value in values):
        return Ratios(np.array([float(value) for value in values]), ones(len(values)))
    return Ratios(
        _narrow(np.array([value.numerator for value in values], dtype=object)),
        _narrow(np.array([value.denominator for value in values], dtype=object)),
    )


def named_by(valuations: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return each state's variables as words, where whole numbers and truth values tell them apart.

    Else there are no words: states have their numbers.
    """
    words = []
    for values in valuations:
        if not all(isinstance(value, int) for value in values.values()):
            return ()
        shown = {k: str(v).lower() if isinstance(v, bool) else v for k, v in values.items()}
        words.append(", ".join(f"{name}={value}" for name, value in shown.items()))
    return tuple(words) if len(set(words)) == len(words) else ()


def model_of(
    found: Explicit, where: str, *, reward: str | None, discount: object, start: object
) -> MDP:
    """Return a model of another program, of which the caller says what the format does not.

    See `mdp.io.umb.load` for `reward` and `start`.
    """

    def warn(what: str) -> None:
        warnings.warn(f"{where}: {what}", stacklevel=4)

    if discount is None:
        warn("a file of another program states no discount, and 1 is used; give the discount")
    found, titles = _closed(found), {k: found.titles["rewards"][k] for k in found.rewards}
    states, parts = len(found.state_to_choices) - 1, dict[str, Any]()
    if reward is not None or REWARD in found.rewards or len(found.rewards) == 1:
        chosen = identifier(found, reward or (REWARD if len(titles) > 1 else next(iter(titles))))
        table = table_of(found, found.rewards[chosen])
        parts["component_names"] = (titles[chosen],)
    else:
        table = table_of(found, {})
    if reward is None and len(titles) > 1:
        others = {key: each for key, each in found.rewards.items() if key != REWARD}
        columns = {titles[key]: expected(found, each) for key, each in others.items()}
        if REWARD not in found.rewards:
            names = ", ".join(columns)
            warn(f"the rewards {names} are added up; name the one that counts (--reward, reward=)")
            amount, below = of_columns(list(columns.values())).exact()
            total = Ratios(np.asarray(amount.astype(object).sum(axis=1)), below)
            gain, below = over(total, np.arange(len(below) + 1))
            table = replace(table, gain=gain, gain_denominator=below)
        parts["component_names"], parts["component_table"] = completed(columns, table)
    labels = {found.titles["aps"][key]: flags for key, flags in found.labels.items()}
    initial, space = np.flatnonzero(found.initial), StateSpace.plain(states, found.words)
    if len(initial) > 1:
        labels.setdefault(INITIAL, found.initial)
    if start is None and not len(initial):
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if start is None and len(initial) > 1:
        first = f"the first of {len(initial)} initial states, {space.label(initial[0])}"
        warn(f"the start is {first}; --start, or start=, names another")
    state = np.repeat(np.arange(states), np.diff(found.state_to_choices))
    order = np.lexsort((found.actions, state))
    if (np.diff(order) < 0).any():
        table = table.of_pairs(order)
        if known := parts.get("component_table"):
            parts["component_table"] = ComponentTable(
                amount=known.amount[order], denominator=known.denominator[order]
            )
    return MDP(
        table,
        state,
        found.actions[order],
        space=space,
        actions=found.action_names,
        discount_exact=as_discount(1 if discount is None else discount),
        start=as_start(ByNumber({int(initial[0]): 1}) if start is None else start, space),
        labels=labels,
        name=found.name,
        **parts,
    )


def actions_of(
    given: Integers | None, names: tuple[str, ...], state_to_choices: Integers
) -> tuple[Integers, tuple[str, ...]]:
    """Return each choice's action, and the names of all.

    Where two choices of a state have the same action, or none has one, actions are the places of
    the choices in their state.
    """
    counts = np.diff(state_to_choices)
    if given is not None and len(set(names)) == len(names):
        state = np.repeat(np.arange(len(counts)), counts)
        if len(np.unique(state * len(names) + given)) == len(given):
            return given, names
    places = np.arange(state_to_choices[-1]) - np.repeat(state_to_choices[:-1], counts)
    return places, tuple(map(str, range(int(places.max(initial=0)) + 1)))


def identifier(found: Explicit, wanted: str) -> str:
    """Return the identifier of the reward model called `wanted`."""
    titles = found.titles.get("rewards", {})
    known = {name: key for key, name in titles.items()}
    if wanted not in known and wanted not in titles:
        raise ModelError(
            f"no reward model {wanted!r}", where="rewards", fix=suggest(wanted, known) or "add one"
        )
    return wanted if wanted in titles else known[wanted]


def _closed(found: Explicit) -> Explicit:
    """Return the content with a choice to stay in each state where the process ends.

    Branches that never happen are left out, and those of a choice sorted.
    """
    offsets, choices = found.choice_to_branches, np.diff(found.state_to_choices)
    ended = np.flatnonzero(choices == 0)
    for name, values in found.rewards.items():
        if "states" in values and np.asarray(values["states"].top[ended] != 0).any():
            state = ended[np.asarray(values["states"].top[ended] != 0, dtype=bool)][0]
            raise ModelError(
                "a reward in a state without choices",
                where=f"state {state}, reward {found.titles['rewards'][name]}",
                fix="add a choice that stays there, or drop the reward",
            )
    choice = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    kept = np.flatnonzero(np.asarray(found.probability.top != 0, dtype=bool))
    kept = kept[np.lexsort((found.target[kept], choice[kept]))]
    place = found.state_to_choices[ended]
    lengths = np.insert(np.bincount(choice[kept], minlength=len(offsets) - 1), place, 1)
    begins = np.searchsorted(choice[kept], place)

    def filled(values: Ratios, order: Integers | None, at: Integers, one: int) -> Ratios:
        top, bottom = (part if order is None else part[order] for part in values)
        return Ratios(np.insert(top, at, one), np.insert(bottom, at, 1))

    branches = partial(filled, order=kept, at=begins)
    alone = partial(filled, order=None, at=place)
    return replace(
        found,
        state_to_choices=np.concatenate([[0], np.cumsum(np.maximum(choices, 1))]),
        choice_to_branches=np.concatenate([[0], np.cumsum(lengths)]),
        target=np.insert(found.target[kept], begins, ended),
        probability=branches(found.probability, one=1),
        actions=np.insert(found.actions, place, 0),
        rewards={
            key: {
                over: branches(each, one=0)
                if over == "branches"
                else alone(each, one=0)
                if over == "choices"
                else each
                for over, each in values.items()
            }
            for key, values in found.rewards.items()
        },
    )


def table_of(found: Explicit, reward: Mapping[str, Ratios]) -> OutcomeTable:
    """Return the table of outcomes, with the rewards of one reward model."""
    offsets = found.choice_to_branches
    if not np.diff(offsets).all():
        raise ModelError(
            "transition probabilities sum to 0, not 1",
            where=f"choice {int(np.flatnonzero(np.diff(offsets) == 0)[0])}",
            fix="add its branches",
        )
    weight, denominator = over(found.probability, offsets)
    fixed, each = _fixed(found, reward), np.arange(len(offsets))
    if "branches" in reward and np.asarray(reward["branches"].top != 0).any():
        spread = Ratios(*(np.repeat(part, np.diff(offsets)) for part in fixed))
        fixed, each = _plus(spread, reward["branches"]), offsets
    gain, gain_denominator = over(fixed, each)
    return OutcomeTable(
        offsets=offsets,
        next=found.target,
        weight=weight,
        denominator=denominator,
        gain=gain,
        gain_denominator=gain_denominator,
    )


def _fixed(found: Explicit, reward: Mapping[str, Ratios]) -> Ratios:
    """Return the rewards of choices (C,), those of their states among them."""
    total = reward.get("choices")
    if "states" in reward:
        counts = np.diff(found.state_to_choices)
        of_state = Ratios(*(np.repeat(part, counts) for part in reward["states"]))
        total = of_state if total is None else _plus(of_state, total)
    count = len(found.actions)
    return Ratios(np.zeros(count, np.int64), ones(count)) if total is None else total


def expected(found: Explicit, reward: Mapping[str, Ratios]) -> tuple[Numbers, Numbers]:
    """Return the exact expected reward of each choice."""
    fixed = _fixed(found, reward)
    if "branches" in reward:
        return reduced(*table_of(found, reward).expected_gain_exact())
    return fixed


def _plus(left: Ratios, right: Ratios) -> Ratios:
    """Return the exact sums of numbers; the others where all of one are 0."""
    for one, other in ((left, right), (right, left)):
        if not np.asarray(one.top != 0).any():
            return other
    (a, b), (c, d) = (
        dyadic(top, np.arange(len(top) + 1)) if top.dtype == np.float64 else (top, bottom)
        for top, bottom in (left, right)
    )
    total = multiply(a, d, terms=2) + multiply(c, b, terms=2)
    return Ratios(*reduced(total, multiply(b, d)))


def over(values: Ratios, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return numbers with one denominator for each group of them."""
    top, bottom = values
    if top.dtype == np.float64:
        return top, ones(len(offsets) - 1)
    common = lcm_by_group(np.asarray(bottom), offsets)
    top = multiply(top, np.repeat(common, np.diff(offsets)) // bottom)
    return _narrow(top), _narrow(common)


def _narrow(values: Numbers) -> Numbers:
    """Return integers as 64-bit ones where they fit."""
    return values.astype(np.int64) if magnitude(values) < EXACT_IN_INT64 else values
