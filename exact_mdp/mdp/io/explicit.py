"""Models as model checkers list them: choices of states, branches of choices, rewards by name.

A state without choices is where the process ends, and stays put. Nothing is rounded: numbers are
fractions, or floats.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise, starmap
from typing import Any

import numpy as np

from exact_mdp.mdp.components import REST
from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import Flags

REWARD = "reward"
INITIAL, UNNAMED = "init", "unnamed"


def name_states(valuations: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return each state's variables as words, where whole numbers and truth values tell them apart.

    Variables with other values are left out. Where the rest does not tell the states apart there
    are no words: states have their numbers.
    """
    listed = list(valuations)
    broken = {
        name for values in listed for name, value in values.items() if not isinstance(value, int)
    }
    words = []
    for values in listed:
        shown = {k: str(v).lower() if isinstance(v, bool) else v for k, v in values.items()}
        words.append(", ".join(f"{k}={v}" for k, v in shown.items() if k not in broken))
    return tuple(words) if len(set(words)) == len(words) and all(words) else ()


def _number_actions(
    choices: Iterable[Iterable[int]], words: Sequence[str], declared: Iterable[str]
) -> tuple[list[int], tuple[str, ...]]:
    """Return the action number of each choice, and the names of the actions.

    A choice keeps its word. One without a word is called "unnamed", and the second, third, …
    choice of a state that has the same word "word#2", "word#3", …; with "'" behind where the file
    has that name. Names that are declared come first. Where no choice has a word, actions are
    the places of the choices in their state.
    """
    if not any(words):
        return [place for own in choices for place, _ in enumerate(own)], ()
    given = set(words)

    def own_name(name: str) -> str:
        while name in given:
            name += "'"
        return name

    unnamed = own_name(UNNAMED)
    names: list[str] = []
    for own in choices:
        seen = Counter[str]()
        for choice in own:
            word = words[choice] or unnamed
            seen[word] += 1
            names.append(word if seen[word] == 1 else own_name(f"{word}#{seen[word]}"))
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
    action_names: Sequence[str],
    words: tuple[str, ...],
    initial: Sequence[int],
    rewards: Mapping[str, Mapping[str, Sequence[Any]]],
    labels: Mapping[str, Flags],
    reward: str | None,
    discount: object,
    start: object,
) -> MDP:
    """Return a model of another program, of which the caller says what the format does not.

    The choices of state s are first_choice[s] … first_choice[s+1]-1, and so on; rewards are those
    of "states", "choices" and "branches", which add up. `choice_words` names the action of each
    choice, "" where it has none, and `action_names` are in the order of the file. See
    `mdp.io.umb.load` for `reward` and `start`.
    """

    def warn_of_file(what: str) -> None:
        warnings.warn(f"{where}: {what}", stacklevel=4)

    if discount is None:
        warn_of_file(
            "a file of another program states no discount, and 1 is used; give the discount"
        )
    parts: dict[str, Any] = {}
    if reward is not None or len(rewards) == 1:
        chosen = require_known_name(
            reward or next(iter(rewards)), rewards, "reward model", "rewards"
        )
        parts["component_names"], rewards = (chosen,), {chosen: rewards[chosen]}
    elif rewards and REWARD not in rewards:
        listed = ", ".join(rewards)
        warn_of_file(
            f"the rewards {listed} are added up; name the one that counts (--reward, reward=)"
        )
    size = len(first_choice) - 1
    space, labels = StateSpace.plain(size, words), dict(labels)
    if start is None and not initial:
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if initial:
        labels.setdefault(INITIAL, np.isin(np.arange(size), initial))
    if len(initial) > 1 and start is None:
        first = f"the first of {len(initial)} initial states, {space.label(initial[0])}"
        warn_of_file(f"the start is {first}; --start, or start=, names another")
    choices = list(starmap(range, pairwise(first_choice)))
    actions, names = _number_actions(choices, choice_words, action_names)
    rows = list[tuple[int, int, list[tuple[Any, int, Any]]]]()
    for state, own in enumerate(choices):
        for choice in own:
            outcomes = [
                (chances[k], targets[k], _collect_rewards(rewards, state, choice, k))
                for k in range(first_branch[choice], first_branch[choice + 1])
            ]
            rows.append((state, actions[choice], outcomes))
        if not own:
            rows.append((state, 0, [(1, state, 0)]))
    return MDP.from_outcomes(
        rows,
        1 if discount is None else discount,
        start=ByNumber([(initial[0], 1)]) if start is None else start,
        space=space,
        actions=names,
        labels=labels,
        name=name,
        **parts,
    )


def _collect_rewards(
    rewards: Mapping[str, Mapping[str, Any]], state: int, choice: int, branch: int
) -> Any:
    """Return what a branch earns: a number, or several by name."""
    at, amounts = {"states": state, "choices": choice, "branches": branch}, dict[str, Any]()
    for name, values in rewards.items():
        some = [as_given(own[at[over]]) for over, own in values.items() if own[at[over]]]
        amounts[name] = some[0] if len(some) == 1 else sum(map(exact, some), Fraction(0))
    if len(amounts) < 2:
        return next(iter(amounts.values()), 0)
    if REWARD in amounts:  # of which the others are parts
        total, rest = amounts.pop(REWARD), REST if REST not in amounts else f"{REST}'"
        if left := exact(total) - sum(map(exact, amounts.values()), Fraction(0)):
            amounts[rest] = left
    return amounts
