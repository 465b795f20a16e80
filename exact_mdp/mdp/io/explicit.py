"""Models from lists in the form of model checkers: choices, branches of choices, named rewards.

A state without choices is the end of the process: it stays put. Nothing is rounded: numbers are
fractions or floats.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise, starmap
from typing import Any

import numpy as np

from exact_mdp.mdp.components import REST
from exact_mdp.mdp.errors import ModelError, require_known_name, warn_user
from exact_mdp.mdp.forms.names import ByNumber, find_free_name
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import Flags

REWARD = "reward"
INITIAL, UNNAMED = "init", "unnamed"


def name_states(valuations: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return names of states such as "x=3, done=true" from the values of their variables.

    Variables with values other than whole numbers and truth values are left out. If the names are
    not different for all states, return (): the states have numbers.
    """
    listed = list(valuations)
    broken = set()
    for values in listed:
        broken |= {name for name, value in values.items() if not isinstance(value, int)}
    words = []
    for values in listed:
        parts = []
        for name, value in values.items():
            text = str(value)
            if isinstance(value, bool):
                text = text.lower()
            if name not in broken:
                parts.append(f"{name}={text}")
        words.append(", ".join(parts))
    if len(set(words)) < len(words) or not all(words):
        return ()
    return tuple(words)


def _number_actions(
    choices: Iterable[Iterable[int]], words: Sequence[str], declared: Iterable[str]
) -> tuple[list[int], tuple[str, ...]]:
    """Return the action number of each choice, and the names of the actions.

    A choice has its word as its name, or "unnamed" without a word. If several choices of a state
    have the same word, the second, third, … are named "word#2", "word#3", …, with a "'" if the file
    has that name already. Declared names come first. If no choice has a word, choices are numbered
    in each state.
    """
    # Without words, choices are numbered in each state.
    if not any(words):
        places: list[int] = []
        for own in choices:
            places += [place for place, _ in enumerate(own)]
        return places, ()
    # The second choice of a state with the same word gets a name that no choice of the file has.
    given = set(words)
    unnamed = find_free_name(UNNAMED, given)
    names: list[str] = []
    for own in choices:
        seen = Counter[str]()
        for choice in own:
            word = words[choice] or unnamed
            seen[word] += 1
            if seen[word] > 1:
                word = find_free_name(f"{word}#{seen[word]}", given)
            names.append(word)
    number = {name: place for place, name in enumerate(dict.fromkeys([*declared, *names]))}
    return [number[name] for name in names], tuple(number)


def build_explicit_model(
    where: str,
    *,
    name: str,
    first_choice: Sequence[int],
    first_branch: Sequence[int],
    targets: Sequence[int],
    chances: Sequence[Any],
    choice_words: Sequence[str],
    words: tuple[str, ...],
    initial: Sequence[int],
    rewards: Mapping[str, Mapping[str, Sequence[Any]]],
    labels: Mapping[str, Flags],
    discount: object,
    start: object,
    reward: str | None = None,
    action_names: Sequence[str] = (),
) -> MDP:
    """Return a model of another program; the caller adds what the format lacks, such as a discount.

    The choices of state s are first_choice[s] … first_choice[s+1]-1, and so are the branches of a
    choice. Rewards of "states", "choices" and "branches" are added up. `choice_words` are the names
    of the choices' actions, "" for none, and `action_names` the actions in the order of the file.
    See `mdp.io.umb.read_umb` for `reward` and `start`.
    """

    def warn_of_file(what: str) -> None:
        warn_user(f"{where}: {what}")

    if discount is None:
        warn_of_file(
            "a file of another program states no discount, and 1 is used; give the discount"
        )
    # One reward model counts; several are components of the reward.
    parts: dict[str, Any] = {}
    if reward is not None or len(rewards) == 1:
        chosen = require_known_name(
            reward or next(iter(rewards)), rewards, "reward model", "rewards"
        )
        parts["component_names"], rewards = (chosen,), {chosen: rewards[chosen]}
    elif rewards and REWARD not in rewards:
        listed = ", ".join(rewards)
        warn_of_file(
            f"the rewards {listed} are added up; name the one that counts: --reward NAME, "
            "mdp.earning(name)"
        )
    # Initial states are a label; the start is the only one, or the first.
    size = len(first_choice) - 1
    space, labels = StateSpace.plain(size, words), dict(labels)
    if start is None and not initial:
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if initial:
        labels.setdefault(INITIAL, np.isin(np.arange(size), initial))
    if len(initial) > 1 and start is None:
        first = f"the first of {len(initial)} initial states, {space.label(initial[0])}"
        warn_of_file(f"the start is {first}; --start, or start=, names another")
    # The rows of the model, and an action that stays for each state without choices.
    choices = list(starmap(range, pairwise(first_choice)))
    actions, names = _number_actions(choices, choice_words, action_names)
    rows = list[tuple[int, int, list[tuple[Any, int, Any]]]]()
    for state, own in enumerate(choices):
        for choice in own:
            outcomes = []
            for k in range(first_branch[choice], first_branch[choice + 1]):
                earned = _collect_rewards(rewards, state, choice, k)
                outcomes.append((chances[k], targets[k], earned))
            rows.append((state, actions[choice], outcomes))
        if not own:
            rows.append((state, 0, [(1, state, 0)]))
    if discount is None:
        discount = 1
    if start is None:
        start = ByNumber([(initial[0], 1)])
    return MDP.from_outcomes(
        rows,
        discount,
        start=start,
        space=space,
        actions=names,
        labels=labels,
        name=name,
        **parts,
    )


def _collect_rewards(
    rewards: Mapping[str, Mapping[str, Any]], state: int, choice: int, branch: int
) -> Any:
    """Return the reward of a branch: a number, or {name: amount} for several reward models."""
    at, amounts = {"states": state, "choices": choice, "branches": branch}, dict[str, Any]()
    for name, values in rewards.items():
        some = [as_given(own[at[over]]) for over, own in values.items() if own[at[over]]]
        if len(some) == 1:
            amounts[name] = some[0]  # a float stays a float
        else:
            amounts[name] = sum(map(exact, some), Fraction(0))
    if len(amounts) < 2:
        return next(iter(amounts.values()), 0)
    # The reward model "reward" is the sum; the others are its components.
    if REWARD in amounts:
        total, rest = amounts.pop(REWARD), find_free_name(REST, amounts)
        left = exact(total) - sum(map(exact, amounts.values()), Fraction(0))
        if left:
            amounts[rest] = left
    return amounts
