"""Models as model checkers list them: choices of states, branches of choices, rewards, labels.

The readers of UMB files and of what Storm builds fill in an `Explicit`, and `model_of` makes the
MDP. Rewards of states, of choices and of branches add up; a state without choices is where the
process ends, and stays put. Nothing is rounded: numbers are fractions, or floats.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.build import expected
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbers import as_given, exact_sum
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers
from exact_mdp.mdp.validate import Flags

REWARD = "reward"
INITIAL = "init"

Values = Mapping[str, Sequence[Any]]
"""Numbers of "states" (S,), "choices" (C,) and "branches" (N,)."""


@dataclass(frozen=True, kw_only=True)
class Explicit:
    """What is said of S states, C choices and N branches.

    Rewards and labels are by identifier, and `titles` are their names.
    """

    name: str
    state_to_choices: Integers  # (S+1,)
    choice_to_branches: Integers  # (C+1,)
    target: Sequence[int]  # (N,)
    probability: Sequence[Any]  # (N,)
    actions: Integers  # (C,)
    action_names: tuple[str, ...]
    initial: Flags  # (S,)
    words: tuple[str, ...]  # (S,) names of states, or none
    rewards: Mapping[str, Values]
    labels: Mapping[str, Flags]  # (S,)
    titles: Mapping[str, Mapping[str, str]]  # of "rewards" and of "aps"


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
    titles = {key: given.titles["rewards"][key] for key in given.rewards}
    earned = {key: _earned(given, values, titles[key]) for key, values in given.rewards.items()}
    parts, chosen = dict[str, Any](), reward
    if reward is None and len(earned) <= 1:
        chosen = next(iter(earned), None)
    elif reward is None and REWARD in earned:
        chosen = REWARD
    if chosen is not None:
        chosen = identifier(given, chosen)
        parts["component_names"] = (titles[chosen],)
    if reward is None and len(earned) > 1:
        others = {titles[key]: amounts for key, amounts in earned.items() if key != REWARD}
        if REWARD not in earned:
            names = ", ".join(others)
            warn(f"the rewards {names} are added up; name the one that counts (--reward, reward=)")
        parts["component_names"] = tuple(others)
        parts["components"] = {
            name: expected(given.probability, each, given.choice_to_branches)
            for name, each in others.items()
        }
    zeros = [Fraction(0)] * len(given.target)
    amounts = earned[chosen] if chosen is not None else zeros
    for each in earned.values() if chosen is None else ():
        amounts = _plus(amounts, each)
    labels = {given.titles["aps"][key]: flags for key, flags in given.labels.items()}
    initial, states = np.flatnonzero(given.initial), len(given.state_to_choices) - 1
    if len(initial) > 1:
        labels.setdefault(INITIAL, given.initial)
    if start is None and not len(initial):
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if start is None and len(initial) > 1:
        label = StateSpace.plain(states, given.words).label(int(initial[0]))
        first = f"the first of {len(initial)} initial states, {label}"
        warn(f"the start is {first}; --start, or start=, names another")
    outcomes = list(zip(given.probability, given.target, amounts, strict=True))
    ends = np.flatnonzero(np.diff(given.state_to_choices) == 0).tolist()
    state = np.repeat(np.arange(states), np.diff(given.state_to_choices)).tolist()
    rows = [
        (state[choice], action, outcomes[slice(*given.choice_to_branches[choice : choice + 2])])
        for choice, action in enumerate(given.actions.tolist())
    ]
    if "components" in parts:
        closed = {name: [*each, *[0] * len(ends)] for name, each in parts["components"].items()}
        parts["components"] = closed
    return MDP.from_outcomes(
        [*rows, *((end, 0, [(1, end, 0)]) for end in ends)],
        1 if discount is None else discount,
        start=ByNumber([(int(initial[0]), 1)]) if start is None else start,
        space=StateSpace.plain(states, given.words),
        actions=given.action_names,
        labels=labels,
        name=given.name,
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


def identifier(explicit: Explicit, wanted: str) -> str:
    """Return the identifier of the reward model called `wanted`."""
    titles = explicit.titles.get("rewards", {})
    known = {name: key for key, name in titles.items()}
    if wanted not in known and wanted not in titles:
        raise ModelError(
            f"no reward model {wanted!r}", where="rewards", fix=suggest(wanted, known) or "add one"
        )
    return wanted if wanted in titles else known[wanted]


def _earned(explicit: Explicit, values: Values, name: str) -> list[Any]:
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
    state = np.repeat(np.repeat(np.arange(len(choices)), choices), branches)
    choice = np.repeat(np.arange(len(branches)), branches)
    total: list[Any] = [Fraction(0)] * len(explicit.target)
    if of_states:
        total = _plus(total, [of_states[k] for k in state.tolist()])
    if "choices" in values:
        total = _plus(total, [values["choices"][k] for k in choice.tolist()])
    return _plus(total, values["branches"]) if "branches" in values else total


def _plus(left: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    """Return exact sums; a number to which 0 is added stays what it is."""
    pairs = zip(left, right, strict=True)
    return [a if not b else b if not a else exact_sum(as_given(a), as_given(b)) for a, b in pairs]
