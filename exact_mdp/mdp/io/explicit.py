"""Models as model checkers list them: choices of states, branches of choices, rewards, labels.

`model_of` makes the MDP. Rewards of states, of choices and of branches add up; a state without
choices is where the process ends, and stays put. Nothing is rounded: numbers are fractions, or
floats.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any

import numpy as np

from exact_mdp.mdp.build import expected
from exact_mdp.mdp.errors import ModelError, known
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbers import as_given, exact_sum
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers
from exact_mdp.mdp.validate import Flags

REWARD = "reward"
INITIAL = "init"


@dataclass(frozen=True, kw_only=True)
class Explicit:
    """What is said of S states, C choices and N branches."""

    name: str
    state_to_choices: Integers  # (S+1,)
    choice_to_branches: Integers  # (C+1,)
    target: Sequence[int]  # (N,)
    probability: Sequence[Any]  # (N,)
    actions: Integers | None  # (C,)
    action_names: tuple[str, ...]
    initial: Flags  # (S,)
    words: tuple[str, ...]  # (S,) names of states, or none
    rewards: Mapping[str, Mapping[str, Sequence[Any]]]  # of "states", "choices" and "branches"
    labels: Mapping[str, Flags]  # (S,)


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
    given: Explicit, where: str, *, reward: str | None, discount: object, start: object
) -> MDP:
    """Return a model of another program, of which the caller says what the format does not.

    See `mdp.io.umb.load` for `reward` and `start`.
    """

    def warn(what: str) -> None:
        warnings.warn(f"{where}: {what}", stacklevel=4)

    if discount is None:
        warn("a file of another program states no discount, and 1 is used; give the discount")
    offsets, parts = given.state_to_choices, dict[str, Any]()
    earned = {name: _earned(given, values, name) for name, values in given.rewards.items()}
    counting, ends = [*earned.values()], np.flatnonzero(np.diff(offsets) == 0).tolist()
    if reward is None and len(earned) > 1:
        others = {name: amounts for name, amounts in earned.items() if name != REWARD}
        if REWARD in earned:
            counting = [earned[REWARD]]
        else:
            names = ", ".join(others)
            warn(f"the rewards {names} are added up; name the one that counts (--reward, reward=)")
        parts["components"] = {
            name: [*expected(given.probability, each, given.choice_to_branches), *[0] * len(ends)]
            for name, each in others.items()
        }
    elif earned or reward is not None:
        chosen = known(reward or next(iter(earned)), earned, "reward model", "rewards")
        parts["component_names"], counting = (chosen,), [earned[chosen]]
    amounts = reduce(_plus, counting, [Fraction(0)] * len(given.target))
    labels, states = dict(given.labels), len(offsets) - 1
    initial = np.flatnonzero(given.initial)
    if len(initial) > 1:
        labels.setdefault(INITIAL, given.initial)
    if start is None and not len(initial):
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if start is None and len(initial) > 1:
        label = StateSpace.plain(states, given.words).label(int(initial[0]))
        first = f"the first of {len(initial)} initial states, {label}"
        warn(f"the start is {first}; --start, or start=, names another")
    outcomes = list(zip(given.probability, given.target, amounts, strict=True))
    state = np.repeat(np.arange(states), np.diff(offsets))
    actions, action_names = _actions(given, state)
    rows = [
        (state[choice], action, outcomes[slice(*given.choice_to_branches[choice : choice + 2])])
        for choice, action in enumerate(actions.tolist())
    ]
    return MDP.from_outcomes(
        [*rows, *((end, 0, [(1, end, 0)]) for end in ends)],
        1 if discount is None else discount,
        start=ByNumber([(int(initial[0]), 1)]) if start is None else start,
        space=StateSpace.plain(states, given.words),
        actions=action_names,
        labels=labels,
        name=given.name,
        **parts,
    )


def _actions(given: Explicit, state: Integers) -> tuple[Integers, tuple[str, ...]]:
    """Return each choice's action, and the names of all.

    Where two choices of a state have the same action, or none has one, actions are the places of
    the choices in their state.
    """
    actions, names = given.actions, given.action_names
    if actions is not None:
        pairs = state * len(names) + actions
        if len(set(names)) == len(names) and len(np.unique(pairs)) == len(pairs):
            return actions, names
    places = np.arange(len(state)) - given.state_to_choices[state]
    return places, tuple(map(str, range(int(places.max(initial=0)) + 1)))


def _earned(explicit: Explicit, values: Mapping[str, Sequence[Any]], name: str) -> list[Any]:
    """Return the rewards (N,) of branches, those of their choices and states among them."""
    choices, branches = np.diff(explicit.state_to_choices), np.diff(explicit.choice_to_branches)
    of_states = values.get("states", [])
    for end in np.flatnonzero(choices == 0).tolist() if of_states else ():
        if of_states[end]:
            raise ModelError(
                "a reward in a state without choices",
                where=f"state {end}, reward {name}",
                fix="add a choice that stays there, or drop the reward",
            )
    choice = np.repeat(np.arange(len(branches)), branches)
    place = {
        "states": np.repeat(np.arange(len(choices)), choices)[choice],
        "choices": choice,
        "branches": np.arange(len(choice)),
    }
    total: list[Any] = [Fraction(0)] * len(choice)
    for over, each in place.items():
        if over in values:
            total = _plus(total, [values[over][k] for k in each.tolist()])
    return total


def _plus(left: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    """Return exact sums; a number to which 0 is added stays what it is."""
    pairs = zip(left, right, strict=True)
    return [a if not b else b if not a else exact_sum(as_given(a), as_given(b)) for a, b in pairs]
