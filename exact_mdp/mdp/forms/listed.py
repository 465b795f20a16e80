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
    """Return whether transitions come in a form of this module, not as an array."""
    if isinstance(P, Mapping) or _are_rows(P, 4):
        return True
    if not isinstance(P, list | tuple) or not all(isinstance(row, list | tuple) for row in P):
        return False
    cells = [cell for row in P for cell in row]
    odd = any(cell is None or isinstance(cell, Mapping) for cell in cells)
    return odd or (len(set(map(len, P))) > 1 and any(map(_is_list, cells)))


def layouts_of(P: Any) -> list[str]:
    """Return the layouts that dictionaries and lists fit: "ass" only where they are matrices."""
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
    """Return A matrices (S, S), which pairs (S · A,) they list, keys, and names of actions."""
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

    Labels 0, 1, … are positions.
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
    """Return what `MDP.from_outcomes` takes to build the model of P and R: rows, and names."""
    listed = _Listed(P, never=inf if costs else -inf)
    rewards, rows = listed.rewards(R), []
    for (state, action), outcomes in listed.pairs.items():
        if rewards.get((state, action), rewards.get((state,))) != listed.never:
            earned = [(p, then, _reward(rewards, state, action, then)) for p, then in outcomes]
            rows.append((state, action, earned))
    return numbered(rows, listed.states, listed.ends)


class _Listed:
    """What P lists: states, the actions that it names in each, and the outcomes of pairs."""

    def __init__(self, P: Any, never: float) -> None:
        self.never, self.by_row = never, _are_rows(P, 4)
        if isinstance(P, Mapping):
            P = {key: plain(value) for key, value in P.items()}
        self.states, self.ends = Numbering(), set[Hashable]()
        self.pairs: dict[Path, list[tuple[Any, Any]]] = {}
        self.named: dict[Any, dict[Any, None]] = {}  # available or not
        leaves = [] if self.by_row else list(_leaves(P))
        if not self.by_row and all(len(path) == 3 for path, _ in leaves):
            going = {path[0] for path, _ in leaves}
            for state, row in _items(P):
                self.states.add(state, "a state", "P")
                self.named[state] = dict.fromkeys(range(len(row)) if _is_list(row) else row or ())
                self.ends |= set() if state in going else {state}
        for state, action, following, chance in _quadruples(P, self.by_row, leaves):
            where = f"P, state {state}, action {action}"
            self.states.add(state, "a state", "P")
            self.states.add(following, "a next state", where)
            with located(f"{where}, next state {following}"):
                outcomes = self.pairs.setdefault((state, action), [])
                outcomes += [(chance, following)] if exact(chance) else []
            self.named.setdefault(state, {})[action] = None
        offered: dict[Any, list[Any]] = {state: [] for state in self.states.number}
        for state, action in self.pairs:
            offered[state].append(action)
        self.offered = offered
        self.most = max(
            (_width(each) or 0 for each in (*self.named.values(), *offered.values())), default=0
        )

    def rewards(self, R: Any) -> dict[Path, Any]:
        """Return the rewards by state, pair or transition; raise where any would be left out."""
        as_rows = self._of_rows(R) if self.by_row else None
        try:
            leaves = list(self._leaves(R, ()))
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
        for path, reward, in_list in leaves:
            if not in_list and not (reward == self.never or reward != reward):
                self._check(path, reward)
        return {path: reward for path, reward, _ in leaves}

    def _of_rows(self, R: Any) -> dict[Path, Any] | None:
        """Return what triples or quadruples of listed pairs say; None where R is no such list."""
        if not (_are_rows(R, 3) or _are_rows(R, 4)) or not len(R):
            return None
        rewards: dict[Path, Any] = {}
        for *path, reward in R.tolist() if isinstance(R, np.ndarray) else R:
            key = tuple(map(_whole, path))
            try:
                known = key[:2] in self.pairs or reward == self.never
                if not known or key in rewards or not {key[0], *key[2:]} <= {*self.offered}:
                    return None
            except TypeError:  # no key
                return None
            rewards[key] = reward
        return rewards

    def _leaves(self, values: Any, path: Path) -> Iterator[tuple[Path, Any, bool]]:
        """Yield state, pair or transition, its reward, and whether a list of actions has it."""
        refuse_masked(values, "P or R")
        if not isinstance(values, Mapping) and not _is_list(values):
            if not 0 < len(path) <= 3 or (len(path) == 1 and path[0] not in self.offered):
                raise _no_entry(path, "R")
            if path[0] not in self.offered:
                raise ModelError(
                    f"there is a reward of state {path[0]!r}, which P does not know",
                    where="R",
                    fix="leave it out, or correct the state: "
                    + suggest(str(path[0]), map(str, self.offered)),
                )
            if values is not None:
                yield path, values, False
            return
        if _is_list(values) and len(path) < 3:
            self._check_length(values, path)
        for key, value in _items(values):
            spread = isinstance(key, tuple) and key not in self.offered
            for leaf, reward, in_list in self._leaves(value, (*path, *(key if spread else (key,)))):
                yield leaf, reward, in_list or (_is_list(values) and len(path) < 2)

    def _check_length(self, values: Any, path: Path) -> None:
        """Raise ShapeError where a list has not one reward for each state, action or next state."""
        count = len(self.offered)
        allowed: set[Any] = {count} if {*self.offered} == {*range(count)} else set()
        if len(path) == 1:
            named = self.named.get(path[0], {}), self.offered.get(path[0], [])
            widths = [*map(_width, named)]
            allowed = set() if None in widths else {*widths, self.most}
        if len(values) not in allowed:
            wanted = " or ".join(map(str, sorted(allowed)))
            thing = "actions" if len(path) == 1 else "states"
            places = zip(("state", "action"), path, strict=False)
            raise ShapeError(
                f"{len(values)} entries in a list for "
                + (f"{wanted} {thing}" if wanted else f"{thing} that are not numbers from 0 on"),
                where=", ".join(["R", *(f"{what} {key}" for what, key in places)]),
                fix="give one for each state, R[s], for each action, R[s][a], and for each next "
                "state, R[s][a][t]; or a dictionary {(s, a): r}; beside quadruples for P also "
                "triples (s, a, r) or quadruples (s, a, t, r), of pairs that P lists, each once",
            )

    def _check(self, path: Path, reward: Any) -> None:
        """Raise ModelError for a reward of something that P does not name; 0 is earned in ends."""
        state, action = path[0], path[1:2]
        here = not action or action[0] in self.named.get(state, ())
        here |= reward == 0 and state in self.ends
        every = dict.fromkeys(action for _, action in self.pairs)
        for what, thing, known in (
            ("action", action, action if here else every),
            ("next state", path[2:], self.offered),
        ):
            if thing and thing[0] not in known:
                raise ModelError(
                    f"a reward of the {what} {thing[0]!r}, which P does not name",
                    where=f"R, {', '.join(map(str, path))}",
                    fix=suggest(str(thing[0]), map(str, known)),
                )
        if not here:
            offered = [*map(str, self.offered[state])]
            raise ModelError(
                f"a reward of the action {action[0]!r}, which P does not offer in state {state!r}",
                where=f"R, {', '.join(map(str, path))}",
                fix=f"leave it out, or give {self.never:g} or NaN, as of what is not offered; or "
                f"list the action in P: {suggest(str(action[0]), offered)}"
                if offered
                else "leave it out: P offers nothing there",
            )


def _width(actions: Any) -> int | None:
    """Return how many entries a list by actions has; None where some are no numbers."""
    if not all(isinstance(action, int | np.integer) and action >= 0 for action in actions):
        return None
    return int(max(actions, default=-1)) + 1


def _reward(rewards: Mapping[Path, Any], state: Any, action: Any, then: Any) -> Any:
    """Return the reward of a transition: its own, or that of its pair or state."""
    where = f"R, state {state}, action {action}"
    with located(where):
        for path in ((state, action, then), (state, action), (state,)):
            if path in rewards:
                return as_given(rewards[path])
    raise ModelError("there is no reward", where=where, fix="give 0 where nothing is earned")


def _quadruples(P: Any, by_row: bool, leaves: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield state, action, next state and probability."""
    if by_row:
        for *path, chance in P.tolist() if isinstance(P, np.ndarray) else P:
            yield *map(_whole, path), chance
        return
    names = list(P) if isinstance(P, Mapping) else range(len(P))
    for path, chance in leaves:
        first = path[0] if path else None
        spread = (*first, *path[1:]) if len(path) < 3 and isinstance(first, tuple) else path
        if len(spread) != 3:
            raise _no_entry(path, "P")
        state, action, following = spread
        row: Any = P[state][action] if len(path) == 3 else None
        if _is_list(row):
            if len(row) != len(names):
                raise ShapeError(
                    f"rows of different lengths: {len(row)} probabilities, {len(names)} states",
                    where=f"P, state {state}, action {action}",
                    fix="give one probability for each state",
                )
            following = names[following]
        yield state, action, following, chance


def _no_entry(path: Path, where: str) -> ModelError:
    return ModelError(
        f"{where} has an entry by {', '.join(map(repr, path)) or 'nothing'}",
        where=where,
        fix="give P[s][a][t], P[s, a][t] or P[s, a, t], and R[s], R[s][a] or R[s, a]; "
        "lists P[s][a] of S numbers; or quadruples (s, a, t, p)",
    )


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
