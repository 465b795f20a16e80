"""Models as model checkers list them: choices of states, branches of choices, rewards by name.

A state without choices is where the process ends, and stays put. Nothing is rounded: numbers are
fractions, or floats.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise, starmap
from typing import Any

import numpy as np

from exact_mdp.mdp.components import REST
from exact_mdp.mdp.errors import ModelError, known
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import Flags

REWARD = "reward"
INITIAL = "init"


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
    where: str,
    *,
    name: str,
    first_choice: Sequence[int],
    first_branch: Sequence[int],
    targets: Sequence[int],
    chances: Sequence[Any],
    actions: Sequence[int],
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
    of "states", "choices" and "branches", which add up. Where two choices of a state have the same
    action, or none has one, actions are the places of the choices in their state. See
    `mdp.io.umb.load` for `reward` and `start`.
    """

    def warn(what: str) -> None:
        warnings.warn(f"{where}: {what}", stacklevel=4)

    if discount is None:
        warn("a file of another program states no discount, and 1 is used; give the discount")
    parts: dict[str, Any] = {}
    if reward is not None or len(rewards) == 1:
        chosen = known(reward or next(iter(rewards)), rewards, "reward model", "rewards")
        parts["component_names"], rewards = (chosen,), {chosen: rewards[chosen]}
    elif rewards and REWARD not in rewards:
        names = ", ".join(rewards)
        warn(f"the rewards {names} are added up; name the one that counts (--reward, reward=)")
    size = len(first_choice) - 1
    space, labels = StateSpace.plain(size, words), dict(labels)
    if start is None and not initial:
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if len(initial) > 1:
        labels.setdefault(INITIAL, np.isin(np.arange(size), initial))
        if start is None:
            first = f"the first of {len(initial)} initial states, {space.label(initial[0])}"
            warn(f"the start is {first}; --start, or start=, names another")
    choices = list(starmap(range, pairwise(first_choice)))
    named = len(actions) > 0 and all(len({actions[c] for c in own}) == len(own) for own in choices)
    rows = list[tuple[int, int, list[tuple[Any, int, Any]]]]()
    for state, own in enumerate(choices):
        for choice in own:
            outcomes = [
                (chances[k], targets[k], _earned(rewards, state, choice, k))
                for k in range(first_branch[choice], first_branch[choice + 1])
            ]
            rows.append((state, actions[choice] if named else choice - own.start, outcomes))
        if not own:
            rows.append((state, 0, [(1, state, 0)]))
    return MDP.from_outcomes(
        rows,
        1 if discount is None else discount,
        start=ByNumber([(initial[0], 1)]) if start is None else start,
        space=space,
        actions=action_names if named else (),
        labels=labels,
        name=name,
        **parts,
    )


def _earned(rewards: Mapping[str, Mapping[str, Any]], state: int, choice: int, branch: int) -> Any:
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
