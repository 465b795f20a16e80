"""Models as dictionaries, quadruples and nested lists, as they come from elsewhere.

    {s: {a: {t: p}}}      dictionaries by state, action and next state; any hashables
    [(s, a, t, p), …]     quadruples, (N, 4)
    P[s][a] = [p, …]      lists, with None or nothing for what is not available; see `filled`

Rewards beside the first two are {s: r}, {s: {a: r}}, {s: {a: {t: r}}}, or, where states and actions
are whole numbers, an array (S,) or (S, A). What P does not list is not available, nor is what has
the reward -inf (inf where rewards are costs). In the first form a state without actions is an end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, ShapeError, located, of_type
from exact_mdp.mdp.forms.numbering import Numbering, numbered
from exact_mdp.mdp.forms.numbers import array_of, as_given, dense
from exact_mdp.mdp.table import exact

Path = tuple[Any, ...]
REWARDS = "{s: reward}, {s: {a: reward}} or {s: {a: {next state: reward}}}"


def is_listed(P: Any) -> bool:
    """Return whether transitions are dictionaries or quadruples, which go by name."""
    if isinstance(P, Mapping):
        return all(actions is None or isinstance(actions, Mapping) for actions in P.values())
    if isinstance(P, np.ndarray):
        return P.ndim == 2 and P.shape[1] == 4
    nested = (list, dict, np.ndarray, type(None))
    return (
        bool(isinstance(P, list | tuple) and P)
        and all(_is_list(row) and len(row) == 4 for row in P)
        and not any(isinstance(cell, nested) for row in P for cell in row)
    )


def filled(P: Any, R: Any, layout: str | None) -> tuple[Any, Any, NDArray[np.bool_] | None]:
    """Return lists P[s][a] and R[s][a] in full, and which pairs (S · A,) P lists; None for all."""
    if not _is_list(P) or isinstance(P, np.ndarray) or not all(map(_is_list, P)):
        return P, R, None
    cells = [cell for rows in P for cell in rows]
    known = [cell is not None and not (_is_list(cell) and not len(cell)) for cell in cells]
    most, uneven = max(map(len, P), default=0), len(set(map(len, P))) > 1
    lists = all(_is_list(cell) for cell, there in zip(cells, known, strict=True) if there)
    if not lists or (all(known) and not uneven):
        return P, R, None
    if layout != "sas" and (layout or most == len(P)):
        raise ModelError(
            "lists that leave rows out go by state, then action",
            where="P",
            fix='say layout="sas" if P[state][action] is a row',
        )
    there, rows = np.zeros((len(P), most), dtype=bool), list[list[Any]]()
    for state, own in enumerate(P):
        there[state, : len(own)] = [cell is not None and len(cell) > 0 for cell in own]
        rows.append([own[a] if there[state, a] else [0] * len(P) for a in range(most)])
    if isinstance(R, list | tuple) and all(map(_is_list, R)):
        R = [[*own, *[0] * (most - len(own))] for own in R]
    return rows, R, there.reshape(-1)


def keys_of(P: Mapping[Any, Any]) -> list[Any]:
    """Return the keys of matrices in the order of the model: numbers 0, 1, … are places."""
    numbering = Numbering()
    for key in P:
        numbering.add(key, "a key", "P")
    return numbering.ordered()


def rows_of(P: Any, R: Any, *, costs: bool = False) -> tuple[list[Any], dict[str, Any]]:
    """Return what `MDP.from_outcomes` takes to build the model of P and R: rows, and names."""
    states, actions = Numbering(), Numbering()
    listed: dict[Any, dict[Any, list[tuple[Any, Any]]]] = {}
    for state, own in P.items() if isinstance(P, Mapping) else ():
        states.add(state, "a state", "P")
        listed[state] = {action: [] for action in own or {}}
    for state, action, then, chance in _quadruples(P):
        place = f"P, state {state}, action {action}"
        for numbering, thing in ((states, state), (actions, action), (states, then)):
            numbering.add(thing, "a state or action", place)
        with located(f"{place}, next state {then}"):
            outcomes = listed.setdefault(state, {}).setdefault(action, [])
            outcomes += [(chance, then)] if exact(chance) else []
    never = inf if costs else -inf
    if isinstance(R, Mapping):
        rewards = dict(_leaves(R))
        _check(rewards, listed, states, never)
    else:
        rewards = _by_number(R, listed, [*states.number])
    rows = [
        (state, action, [(p, then, _reward(rewards, state, action, then)) for p, then in outcomes])
        for state, own in listed.items()
        for action, outcomes in own.items()
        if (outcomes or not isinstance(P, Mapping) or P[state][action])
        and rewards.get((state, action), rewards.get((state,))) != never
    ]
    ends = [state for state, own in listed.items() if not any(own.values())]
    return numbered(rows, states, ends)


def _quadruples(P: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield state, action, next state and probability."""
    if not isinstance(P, Mapping):
        for *path, chance in P.tolist() if isinstance(P, np.ndarray) else P:
            state, action, then = map(_whole, path)
            yield state, action, then, chance
        return
    for state, actions in P.items():
        for action, after in (actions or {}).items():
            fix = "give {state: {action: {next state: probability}}}"
            after = {} if after is None else of_type(after, Mapping, f"P, state {state}", fix)
            for then, chance in after.items():
                yield state, action, then, chance


def _leaves(R: Mapping[Any, Any], path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the rewards in nested dictionaries, each with its keys."""
    for key, reward in R.items():
        if isinstance(reward, Mapping):
            yield from _leaves(reward, (*path, key))
        elif reward is not None:
            yield (*path, key), reward


def _check(rewards: Mapping[Path, Any], listed: Any, states: Numbering, never: float) -> None:
    """Raise ModelError for a reward of what P does not list; in ends 0 is earned."""
    for (state, *more), reward in rewards.items():
        own = listed.get(state, {})
        nothing = reward == never or reward != reward or (reward == 0 and not any(own.values()))
        known = state in states.number and (not more or more[0] in own or nothing)
        if not known or len(more) > 2 or not states.number.keys() >= {*more[1:]}:
            raise ModelError(
                f"a reward of {', '.join(map(repr, (state, *more)))}, which P does not list",
                where="R",
                fix=f"leave it out, or correct its keys: give {REWARDS}",
            )


def _by_number(R: Any, listed: Any, states: list[Any]) -> dict[Path, Any]:
    """Return rewards in an array (S,) or (S, A), of states and actions that are numbers."""
    array, pairs = dense(array_of(R, "R")), [(s, a) for s, own in listed.items() for a in own]
    whole = all(isinstance(thing, int) and thing >= 0 for pair in pairs for thing in pair)
    size = len(states), max((action for _, action in pairs), default=-1) + 1 if whole else 0
    if {*states} != {*range(len(states))} or array.shape not in (size[:1], size):
        raise ShapeError(
            f"rewards have shape {array.shape}",
            where="R",
            fix=f"give {REWARDS}; or, where these are whole numbers, an array {size}",
        )
    if array.ndim == 2 and size[1] in (3, 4) and len(pairs) == size[0]:
        raise ModelError(
            f"rewards of shape {array.shape} may be of states and actions, or rows (s, a, r) or "
            "(s, a, t, r), which are not read",
            where="R",
            fix=f"give {REWARDS}",
        )
    entries = array.tolist()
    return {(s, a): entries[s] if array.ndim == 1 else entries[s][a] for s, a in pairs}


def _reward(rewards: Mapping[Path, Any], state: Any, action: Any, then: Any) -> Any:
    """Return the reward of a transition: its own, or that of its pair or state."""
    where = f"R, state {state}, action {action}"
    with located(where):
        for path in ((state, action, then), (state, action), (state,)):
            if path in rewards:
                return as_given(rewards[path])
    raise ModelError("there is no reward", where=where, fix="give 0 where nothing is earned")


def _is_list(values: Any) -> bool:
    return isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim > 0)


def _whole(number: Any) -> Any:
    """Return a float of an array of quadruples as the whole number that it is."""
    return int(number) if isinstance(number, float) and number.is_integer() else number
