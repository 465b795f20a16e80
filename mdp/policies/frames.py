"""Tables of pandas as policies: rows by the names of states, columns by the names of actions.

Labels are names, or else all the numbers 0 … n-1, in any order. What comes back is without them: an
array in the model's order, or actions by the number of the state.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP


class Labelled(dict[int, Any]):
    """Actions by the number of a state."""


def labelled(model: MDP, policy: Any) -> Any:
    """Return a table of pandas without its labels, and all else as it is.

    Raises
    ------
    ModelError
        Where labels are neither names nor all of the numbers, or one comes twice.
    """
    pandas = sys.modules.get("pandas")  # who has a table has imported it
    if pandas is None or not isinstance(policy, pandas.DataFrame | pandas.Series):
        return policy
    if policy.ndim == 2 and policy.shape[1] == 1 < model.n_actions:
        policy = policy.iloc[:, 0]
    rows, size, by_status = _states(model, list(policy.index))
    if len(set(rows)) < len(rows):
        raise ModelError("a state appears twice", where="policy, index", fix="keep one of them")
    if policy.ndim == 1:
        keys: Any = map(str, policy.index) if by_status else rows
        said = zip(keys, policy.tolist(), strict=True)
        found = {row: action for row, action in said if not pandas.isna(action)}
        return found if by_status else Labelled(found)
    columns = _actions(model, list(policy.columns))
    values = policy.to_numpy()
    if sorted(rows) == list(range(len(rows))):
        return values[np.argsort(rows)][:, np.argsort(columns)]
    table = np.full((size, len(columns)), np.nan, dtype=object)
    table[rows] = values[:, np.argsort(columns)]
    return table


def _states(model: MDP, labels: list[Any]) -> tuple[list[int], int, bool]:
    """Return the row of each label, how many rows there are, and whether they are of statuses."""
    if "status" in model.space.names:
        column = model.space.column("status")
        words = [column.label(value) for value in range(column.size)]
        if set(map(str, labels)) <= set(words):
            return [words.index(str(label)) for label in labels], len(words), True
    space = model.space.untimed or model.space
    try:
        return [space.number(label) for label in labels], space.size, False
    except ModelError as error:
        if _are_numbers(labels):
            return [int(label) for label in labels], len(labels), False
        raise ModelError(
            f"the index holds no states: {error.what}",
            where="policy, index",
            fix="give names of states, or the numbers from 0 on",
        ) from error


def _actions(model: MDP, labels: list[Any]) -> list[int]:
    """Return the number of the action that each label stands for."""
    words = [str(label) for label in labels]
    if sorted(words) == sorted(model.actions):
        return [model.actions.index(word) for word in words]
    numbers = np.unique(model.pair_action[~model.forced[model.pair_state]])
    if "status" in model.space.names and sorted(words) == sorted(
        model.actions[number] for number in numbers
    ):
        return [model.actions.index(word) for word in words]
    if _are_numbers(labels):
        return [int(label) for label in labels]
    raise ModelError(
        f"the columns are {', '.join(words[:6])}",
        where="policy, columns",
        fix=f"name them {', '.join(model.actions[:6])}{' …' * (model.n_actions > 6)}",
    )


def _are_numbers(labels: list[Any]) -> bool:
    whole = all(isinstance(label, int | np.integer) for label in labels)
    return whole and sorted(labels) == list(range(len(labels)))
