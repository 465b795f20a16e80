"""Models as dictionaries, nested lists and quadruples, as they come from elsewhere.

    P[s][a][t], P[s, a][t], P[s, a, t]    dictionaries by state, action, next state; any hashables
    P[s][a] = [p, …]                      S probabilities by state and action, in lists
    [(s, a, t, p), …]                     quadruples, (N, 4)
    {a: matrix}                           (S, S) by action, "ass"; see `layouts_of`, and
                                          `of_tables` for matrices that are tables of pandas

An action that P does not list for a state, or lists with None or nothing, is not available there,
nor is one of infinite loss: -inf, or inf where rewards are costs. Rewards are of states, of pairs
or of transitions, in dictionaries, lists or arrays by the same keys; a list has one entry for each
state, and for each action, that P knows. Beside quadruples, rewards may also be triples (s, a, r)
or quadruples (s, a, t, r) of pairs that P lists. A state that P lists without any action is an end.
Other lists are arrays: see `mdp.build`.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from math import inf
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, ShapeError, located, suggest
from exact_mdp.mdp.forms.numbering import Numbering, action_names, numbered
from exact_mdp.mdp.forms.numbers import array_of, as_given, dense, refuse_masked
from exact_mdp.mdp.table import exact

Flags = NDArray[np.bool_]
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


def layouts_of(P: Any) -> list[str]:
    """Return the layouts that dictionaries and lists fit: "ass" only where they are matrices.

    Examples
    --------
    >>> layouts_of({"go": [[0, 1], [0, 1]]}), layouts_of({0: {0: [1]}})
    (['ass'], ['sas'])
    """
    shapes = {_shape(matrix) for matrix in (P.values() if isinstance(P, Mapping) else P)}
    (rows, columns), *others = [(0, 1) if shape is None else shape for shape in shapes] or [(0, 1)]
    if others or rows != columns:
        return ["sas"]
    return ["ass", "sas"] if columns == len(P) else ["ass"]


def plain(values: Any) -> Any:
    """Return a matrix of NumPy or SciPy as an array; others as they are."""
    refuse_masked(values, "P or R")
    if sp.issparse(values):
        return dense(array_of(values, "P or R"))
    return np.asarray(values) if isinstance(values, np.matrix) else values


def _shape(matrix: Any) -> Any:
    """Return rows and columns of a matrix, of which rows may be missing; None of anything else."""
    if sp.issparse(matrix) or (isinstance(matrix, np.ndarray) and matrix.dtype != object):
        return matrix.shape if matrix.ndim == 2 else None
    if not _is_list(matrix) or not all(row is None or _is_list(row) for row in matrix):
        return None
    widths = {len(row) for row in matrix if row is not None and len(row)}
    numbers = not any(_is_list(x) or isinstance(x, Mapping) for row in matrix for x in row or ())
    return (len(matrix), widths.pop()) if numbers and len(widths) == 1 else None


def by_action(P: Any) -> tuple[Any, Flags, list[Any] | None, dict[str, Any]]:
    """Return A matrices (S, S), which pairs (S · A,) they list, their keys, and names of actions.

    Examples
    --------
    >>> matrices, offered, keys, names = by_action({"go": [[0, 1], None]})
    >>> matrices, offered.tolist(), keys, names["actions"]
    ([[[0, 1], [0, 0]]], [True, False], ['go'], ('go',))
    """
    keys, names = None, {}
    if isinstance(P, Mapping):
        numbering = Numbering()
        for key in P:
            numbering.add(key, "an action", "P")
        keys = numbering.ordered()
        names = action_names(keys)
        P = [P[key] for key in keys]
    states = _shape(P[0])[0]
    matrices, offered = [], np.ones((len(P), states), dtype=bool)
    for matrix, there in zip(P, offered, strict=True):
        if isinstance(matrix, list | tuple):
            there[:] = [row is not None and len(row) > 0 for row in matrix]
            matrix = [
                row if used else [0] * states for row, used in zip(matrix, there, strict=True)
            ]
        matrices.append(matrix)
    return matrices, offered.T.reshape(-1), keys, names


def of_tables(P: Mapping[Any, Any], states: Sequence[Any]) -> tuple[Any, Sequence[Any]]:
    """Return {action: table of pandas} by arrays, and the states where the labels name such.

    Labels 0, 1, … are positions; others are states, in the order of the first table unless `states`
    names them.

    Examples
    --------
    >>> from pandas import DataFrame
    >>> go = DataFrame([[0, 1], [1, 0]], index=["b", "a"], columns=["a", "b"])
    >>> of_tables({"go": go}, ["a", "b"])[0]["go"].tolist()
    [[1, 0], [0, 1]]
    """
    axes = [list(axis) for table in P.values() for axis in table.axes]
    if all(axis == list(range(len(axis))) for axis in axes):
        return {key: table.to_numpy() for key, table in P.items()}, []
    order = list(states) or axes[0]
    if any(len(axis) != len(order) or {*axis} != {*order} for axis in axes):
        raise ModelError(
            f"a table of P has the labels {', '.join(map(str, axes[-1][:4]))}, and the states are "
            f"{', '.join(map(str, order[:4]))}",
            where="P",
            fix="give {action: table} with a row and a column for each state, each once",
        )
    return {key: table.loc[order, order].to_numpy() for key, table in P.items()}, order


def rewards_by_action(
    R: Mapping[Any, Any], where: str, actions: list[Any], words: Sequence[Any]
) -> Any:
    """Return rewards in a dictionary, beside a matrix for each action, as an array has them."""
    states = len(words)
    values = [plain(value) for value in R.values()]
    depths = {
        -1 if isinstance(v, Mapping) else 2 if _shape(v) else int(_is_list(v)) for v in values
    }
    of_actions, numbered = R.keys() == {*actions}, {*actions} == {*range(states)}
    for known in (range(states), words):
        if depths == {0} and R.keys() == {*known}:
            return [R[state] for state in known]
        rows = R.values() if depths == {-1} and R.keys() == {*known} else ()
        if rows and all(row.keys() == {*actions} for row in rows):
            return [[R[state][action] for action in actions] for state in known]
    if of_actions and depths == {2}:
        return [plain(R[action]) for action in actions]
    if of_actions and depths == {1} and not numbered and {*map(len, values)} == {states}:
        return [[R[action][state] for action in actions] for state in range(states)]
    raise ModelError(
        "the rewards are a dictionary, and P has a matrix for each action",
        where=where,
        fix=f"give an array ({states}, {len(actions)}) of states and actions, {{state: number}}, "
        f"{{state: {{action: number}}}} or {{action: ({states}, {states}) array}}",
    )


def rows_of(P: Any, R: Any, *, costs: bool = False) -> tuple[list[Any], dict[str, Any]]:
    """Return what `MDP.from_outcomes` takes to build the model of P and R: rows, and names.

    Examples
    --------
    >>> rows, names = rows_of({"a": {"go": {"b": 1}}, "b": {}}, {"a": 5, "b": 0})
    >>> rows, names["actions"]
    ([(0, 0, [(1, 1, Fraction(5, 1))]), (1, 0, [(1, 1, 0)])], ('go',))
    """
    if isinstance(P, Mapping):
        P = {key: plain(value) for key, value in P.items()}
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
    rows, never = [], inf if costs else -inf
    rewards = _rewards(R, P, states, pairs, never)
    for path, reward in rewards.items() if isinstance(R, Mapping) else ():
        none = reward in (never, None) or reward != reward  # NaN
        if not none and not _is_list(R.get(path[0])):
            _check_known(path, P, pairs, states, ends if reward == 0 else set(), never)
    for (state, action), row in pairs.items():
        if rewards.get((state, action), rewards.get((state,))) == never:
            continue
        earned = [(p, then, _reward(rewards, state, action, then)) for p, then in row]
        rows.append((state, action, earned))
    return numbered(rows, states, ends)


def _rewards(
    R: Any, P: Any, states: Numbering, pairs: Mapping[Path, Any], never: float
) -> dict[Path, Any]:
    """Return the rewards by state, pair or transition; raise where any would be left out."""
    as_rows = _reward_rows(R, states, pairs, never) if _are_quadruples(P) else None
    try:
        _fit(R, (), states, _widths(P, states, pairs))
    except ShapeError:
        if as_rows is None:
            raise
        return as_rows
    if as_rows is not None:
        kind = "triples (s, a, r)" if len(R[0]) == 3 else "quadruples (s, a, t, r)"
        raise ModelError(
            f"the rewards may be {kind}, or R[s][a] for each state and action",
            where="R",
            fix="say which, by a dictionary: {(s, a): r} or {(s, a, t): r}, or {s: {a: r}}",
        )
    rewards = {_path(path, states): reward for path, reward in _leaves(R)}
    strange = next((path for path in rewards if path[0] not in states.number), None)
    if strange is not None:
        raise ModelError(
            f"there is a reward of state {strange[0]!r}, which P does not know",
            where="R",
            fix="leave it out, or correct the state: "
            + suggest(str(strange[0]), map(str, states.number)),
        )
    return rewards


def _reward_rows(
    R: Any, states: Numbering, pairs: Mapping[Path, Any], never: float
) -> dict[Path, Any] | None:
    """Return what triples or quadruples say, None where R is no list of them.

    They are of pairs that P lists, except where the reward says that the action is not available,
    and each comes once.
    """
    width = next((width for width in (3, 4) if _are_rows(R, width)), 0)
    if not width or not len(R):
        return None
    found: dict[Path, Any] = {}
    for *path, reward in R.tolist() if isinstance(R, np.ndarray) else R:
        key = tuple(map(_whole, path))
        try:
            listed = key[:2] in pairs or (key[0] in states.number and reward == never)
            if not listed or key in found or not set(key[2:]) <= states.number.keys():
                return None
        except TypeError:  # no key
            return None
        found[key] = reward
    return found


def _widths(P: Any, states: Numbering, pairs: Mapping[Path, Any]) -> dict[Any, set[int]]:
    """Return how many rewards a list may give for the actions of each state: its own, or all."""
    own: dict[Any, set[int]] = {state: set() for state in states.number}
    last = dict.fromkeys(own, 0)
    words = set()
    for state, action in pairs:
        if isinstance(action, int | np.integer) and action >= 0:
            last[state] = max(last[state], int(action) + 1)
        else:
            words.add(state)
    for state, row in () if _are_quadruples(P) else _items(P):
        if _is_list(row) and state in own:
            own[state].add(len(row))
    most = max([*last.values(), *(width for widths in own.values() for width in widths)], default=0)
    return {
        state: set() if state in words else {*widths, last[state], most}
        for state, widths in own.items()
    }


def _fit(values: Any, known: Path, states: Numbering, widths: Mapping[Any, set[int]]) -> None:
    """Raise ShapeError where a list of rewards has not one for each state, action or next state."""
    if _is_list(values) and len(known) < 3:
        of_actions, size = len(known) == 1, len(states.number)
        numbered = states.number.keys() == set(range(size))
        allowed = widths.get(known[0], set()) if of_actions else {size} if numbered else set()
        if len(values) not in allowed:
            wanted = " or ".join(map(str, sorted(allowed)))
            thing = "actions" if of_actions else "states"
            places = zip(("state", "action"), known, strict=False)
            raise ShapeError(
                f"{len(values)} entries in a list for "
                + (f"{wanted} {thing}" if wanted else f"{thing} that are not numbers from 0 on"),
                where=", ".join(["R", *(f"{what} {key}" for what, key in places)]),
                fix="give one for each state, R[s], for each action, R[s][a], and for each next "
                "state, R[s][a][t]; or a dictionary {(s, a): r}; beside quadruples for P also "
                "triples (s, a, r) or quadruples (s, a, t, r), of pairs that P lists, each once",
            )
    if isinstance(values, Mapping) or _is_list(values):
        for key, value in _items(values):
            if isinstance(value, Mapping) or _is_list(value):
                more = key if isinstance(key, tuple) and key not in states.number else (key,)
                _fit(value, (*known, *more), states, widths)


def _check_known(
    path: Path,
    P: Any,
    pairs: Mapping[Path, Any],
    states: Numbering,
    ends: set[Hashable],
    never: float,
) -> None:
    """Raise ModelError for a reward of something that P does not name; 0 is earned in ends."""
    state, action = path[0], path[1:2]
    listed = not action or state in ends or path[:2] in pairs or _lists(P, state, *action)
    for what, thing, known in (
        ("action", action, action if listed else dict.fromkeys(act for _, act in pairs)),
        ("next state", path[2:], states.number),
    ):
        if thing and thing[0] not in known:
            raise ModelError(
                f"a reward of the {what} {thing[0]!r}, which P does not name",
                where=f"R, {', '.join(map(str, path))}",
                fix=suggest(str(thing[0]), map(str, known)),
            )
    if not listed:
        offered = [str(act) for s, act in pairs if s == state]
        raise ModelError(
            f"a reward of the action {action[0]!r}, which P does not offer in state {state!r}",
            where=f"R, {', '.join(map(str, path))}",
            fix=f"leave it out, or give {never:g} or NaN, as of what is not offered; or list the "
            f"action in P: {suggest(str(action[0]), offered)}"
            if offered
            else "leave it out: P offers nothing there",
        )


def _lists(P: Any, state: Any, action: Any) -> bool:
    """Return whether P lists an action, available or not."""
    if not isinstance(P, Mapping):
        return not _are_quadruples(P) and state in range(len(P)) and action in range(len(P[state]))
    row = P.get(state) or ()
    return (state, action) in P or action in (range(len(row)) if _is_list(row) else row)


def _reward(rewards: Mapping[Path, Any], state: Any, action: Any, then: Any) -> Any:
    """Return the reward of a transition: its own, or that of its pair or state."""
    where = f"R, state {state}, action {action}"
    with located(where):
        for path in ((state, action, then), (state, action), (state,)):
            if path in rewards:
                return as_given(rewards[path])
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
    refuse_masked(values, "P or R")
    if isinstance(values, Mapping) or _is_list(values):
        for key, value in _items(values):
            yield from _leaves(value, (*path, key))
    elif values is not None:
        yield path, values


def _items(values: Any) -> Any:
    return values.items() if isinstance(values, Mapping) else enumerate(plain(values))


def _is_list(values: Any) -> bool:
    return isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim > 0)


def _are_quadruples(P: Any) -> bool:
    return _are_rows(P, 4)


def _are_rows(values: Any, width: int) -> bool:
    """Return whether values are a list of rows of so many numbers or names each."""
    if isinstance(values, np.ndarray):
        return values.ndim == 2 and values.shape[1] == width
    if not isinstance(values, list | tuple) or not values or not all(map(_is_list, values)):
        return False
    nested = (list, dict, np.ndarray, type(None))
    return all(len(row) == width and not any(isinstance(x, nested) for x in row) for row in values)


def _whole(number: Any) -> Any:
    """Return a float of an array of quadruples as the whole number that it is."""
    return int(number) if isinstance(number, float) and number.is_integer() else number
