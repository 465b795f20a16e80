"""Models as dictionaries, nested lists and quadruples, as they come from elsewhere.

    P[s][a][t], P[s, a][t], P[s, a, t]    dictionaries by state, action, next state; any hashables
    P[s][a] = [p, …]                      S probabilities by state and action, in lists
    [(s, a, t, p), …]                     quadruples, (N, 4)

An action that P does not list for a state, or lists with None or nothing, is not available there,
nor is one of infinite loss: -inf, or inf where rewards are costs. Rewards are of states, of pairs
or of transitions, in dictionaries, lists or arrays by the same keys. A state that P lists without
any action is an end. Other lists are arrays: see `mdp.build`.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from math import inf
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, located
from exact_mdp.mdp.forms.numbering import Numbering, numbered
from exact_mdp.mdp.table import Given, exact, given, rounding_of

Path = tuple[Any, ...]


def is_listed(P: Any) -> bool:
    """Return whether transitions come in a form of this module, not as an array.

    Examples
    --------
    >>> is_listed({0: {}}), is_listed([(0, 0, 0, 1)]), is_listed([[[1]], []]), is_listed([[[1]]])
    (True, True, True, False)
    """
    if isinstance(P, Mapping) or _are_quadruples(P):
        return True
    if not isinstance(P, list | tuple) or not all(isinstance(row, list | tuple) for row in P):
        return False
    cells = [cell for row in P for cell in row]
    odd = any(cell is None or isinstance(cell, Mapping) for cell in cells)
    return odd or (len(set(map(len, P))) > 1 and any(map(_is_list, cells)))


def rows_of(P: Any, R: Any, *, costs: bool = False) -> tuple[list[Any], dict[str, Any]]:
    """Return what `MDP.from_outcomes` takes to build the model of P and R: rows, and names.

    Examples
    --------
    >>> rows, names = rows_of({"a": {"go": {"b": 1}}, "b": {}}, {"a": 5, "b": 0})
    >>> rows, names["actions"]
    ([(0, 0, [(1, 1, Fraction(5, 1))]), (1, 0, [(1, 1, 0)])], ('go',))
    """
    states, ends = Numbering(), set[Hashable]()
    listed = list(_quadruples(P))
    if not _are_quadruples(P) and all(len(path) == 3 for path, _ in _leaves(P)):
        for state, row in _items(P):
            states.add(state, "a state", "P")
            if not any(True for _ in _leaves(row)):
                ends.add(state)
    pairs: dict[Path, list[tuple[Any, Any]]] = {}
    for state, action, following, chance in listed:
        states.add(state, "a state", "P")
        states.add(following, "a next state", f"P, state {state}, action {action}")
        with located(f"P, state {state}, action {action}, next state {following}"):
            row = pairs.setdefault((state, action), [])
            row += [(chance, following)] if exact(chance) else []
    rewards = {_path(path, states): reward for path, reward in _leaves(R)}
    rows, never = [], inf if costs else -inf
    for (state, action), row in pairs.items():
        if rewards.get((state, action), rewards.get((state,))) == never:
            continue
        earned = [(p, then, _reward(rewards, state, action, then)) for p, then in row]
        rows.append((state, action, earned))
    return numbered(rows, states, ends)


def _reward(rewards: Mapping[Path, Any], state: Any, action: Any, then: Any) -> Any:
    """Return the reward of a transition: its own, or that of its pair or state, earned in full."""
    where = f"R, state {state}, action {action}"
    with located(where):
        if (state, action, then) in rewards:
            return given(rewards[state, action, then])
        for path in ((state, action), (state,)):
            if path in rewards:
                value = given(rewards[path])
                return Given(value, rounding=rounding_of(value), certain=True)
    raise ModelError("there is no reward", where=where, fix="give 0 where nothing is earned")


def _quadruples(P: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield state, action, next state and probability."""
    if _are_quadruples(P):
        for *path, chance in P.tolist() if isinstance(P, np.ndarray) else P:
            yield *map(_whole, path), chance
        return
    names = list(P) if isinstance(P, Mapping) else range(len(P))
    for path, chance in _leaves(P):
        if len(path) == 3:
            state, action, following = path
            row = P[state][action]
            if _is_list(row):
                if len(row) != len(names):
                    raise ShapeError(
                        f"rows of different lengths: {len(row)} probabilities, {len(names)} states",
                        where=f"P, state {state}, action {action}",
                        fix="give one probability for each state",
                    )
                following = names[following]
            yield state, action, following, chance
        else:
            yield *_spread(path, 3, "P"), chance


def _path(path: Path, states: Numbering) -> Path:
    """Return the state, action and next state that a reward is of, or the first ones of these."""
    first = path[0] if path else None
    if len(path) == 3 or (isinstance(first, Hashable) and first in states.number):
        return path
    return _spread(path, (2, 3), "R")


def _spread(path: Path, lengths: int | tuple[int, ...], where: str) -> Path:
    first = path[0] if path else None
    spread = (*first, *path[1:]) if isinstance(first, tuple) else path
    if len(spread) not in np.atleast_1d(lengths):
        raise ModelError(
            f"{where} has an entry by {', '.join(map(repr, path)) or 'nothing'}",
            where=where,
            fix="give P[s][a][t], P[s, a][t] or P[s, a, t], and R[s], R[s][a] or R[s, a]; "
            "lists P[s][a] of S numbers; or quadruples (s, a, t, p)",
        )
    return spread


def _leaves(values: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the numbers in nested dictionaries and lists, each with its keys."""
    if isinstance(values, Mapping) or _is_list(values):
        for key, value in _items(values):
            yield from _leaves(value, (*path, key))
    elif values is not None:
        yield path, values


def _items(values: Any) -> Any:
    return values.items() if isinstance(values, Mapping) else enumerate(values)


def _is_list(values: Any) -> bool:
    return isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim > 0)


def _are_quadruples(P: Any) -> bool:
    if isinstance(P, np.ndarray):
        return P.ndim == 2 and P.shape[1] == 4
    if not isinstance(P, list | tuple) or not P or not all(_is_list(row) for row in P):
        return False
    nested = (list, dict, np.ndarray, type(None))
    return all(len(row) == 4 and not any(isinstance(x, nested) for x in row) for row in P)


def _whole(number: Any) -> Any:
    """Return a float of an array of quadruples as the whole number that it is."""
    return int(number) if isinstance(number, float) and number.is_integer() else number
