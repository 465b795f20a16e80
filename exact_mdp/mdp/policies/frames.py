"""Tables of pandas as policies: rows by the names of states, columns by the names of actions.

Labels say what the keys of a dictionary would, see `mdp.forms.names`; where no names are whole
numbers they may be all of the numbers 0 … n-1, in any order. Levels that are named stand in any
order. What comes back is without labels: an array in the model's order, or actions by the number of
the state.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.forms.names import ByNumber, Reading, labels_of, parts_of
from exact_mdp.mdp.model import MDP

Readings = list[tuple[Any, ModelError | None]]
"""What a table may say, each with the error to raise where it fits besides, and differs."""


def unlabelled(model: MDP, policy: Any) -> Readings | None:
    """Return a table of pandas without its labels; None for all else.

    Raises
    ------
    ModelError
        Where labels are neither names nor all of the numbers, or one comes twice.
    """
    pandas = sys.modules.get("pandas")  # who has a table has imported it
    if pandas is None or not isinstance(policy, pandas.DataFrame | pandas.Series):
        return None
    if policy.ndim == 2 and policy.shape[1] == 1 < model.n_actions:
        policy = policy.iloc[:, 0]
    with located("policy"):
        labels = labels_of(policy.index, (model.space.untimed or model.space).parts)
    readings, size, by_status = _states(model, labels)
    found: Readings = []
    for rows, error in readings:
        if len(set(rows)) < len(rows):
            raise ModelError("a state appears twice", where="policy, index", fix="keep one of them")
        if policy.ndim == 1:
            keys: Any = map(str, policy.index) if by_status else rows
            said = zip(keys, policy.tolist(), strict=True)
            given = {row: action for row, action in said if not pandas.isna(action)}
            found.append((given if by_status else ByNumber(given), error))
            continue
        with located("policy"):
            names = labels_of(policy.columns, parts_of(model.action_objects))
        for columns, other in _actions(model, names):
            values = policy.to_numpy()[:, np.argsort(columns)]
            table = np.full((size, len(columns)), np.nan, dtype=object)
            table[rows] = values
            whole = sorted(rows) == list(range(len(rows)))
            found.append((values[np.argsort(rows)] if whole else table, error or other))
    return found


def _states(model: MDP, labels: list[Any]) -> tuple[list[Reading], int, bool]:
    """Return the rows that labels stand for, how many there are, and whether of statuses."""
    if "status" in model.space.names:
        column = model.space.column("status")
        words = [column.label(value) for value in range(column.size)]
        if set(map(str, labels)) <= set(words):
            return [Reading([words.index(str(label)) for label in labels])], len(words), True
    space = model.space.untimed or model.space
    try:
        return space.readings(labels), space.size, False
    except ModelError as error:
        if _are_numbers(labels) and not space.numbered:
            return [Reading([int(label) for label in labels])], len(labels), False
        counted = "the array alone, table.to_numpy()" if space.numbered else "the numbers from 0 on"
        raise ModelError(
            f"the index holds no states: {error.what}",
            where="policy, index",
            fix=f"give names of states, or {counted}",
        ) from error


def _actions(model: MDP, labels: list[Any]) -> list[Reading]:
    """Return the numbers of the actions that labels stand for."""
    used = np.unique(model.pair_action[~model.forced[model.pair_state]]).tolist()
    whole = [list(range(model.n_actions)), *([used] if "status" in model.space.names else [])]
    with suppress(ModelError):
        readings = model.action_names.readings(labels)
        if sorted(readings[0].numbers) in whole:
            return [reading for reading in readings if sorted(reading.numbers) in whole]
    raise ModelError(
        f"the columns are {', '.join(list(map(str, labels))[:6])}",
        where="policy, columns",
        fix=f"name them {', '.join(model.actions[:6])}{' …' * (model.n_actions > 6)}",
    )


def _are_numbers(labels: list[Any]) -> bool:
    whole = all(isinstance(label, int | np.integer) for label in labels)
    return whole and sorted(labels) == list(range(len(labels)))
