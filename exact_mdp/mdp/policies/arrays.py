"""Policies from arrays: action values (a Q-table), or probabilities of actions.

The rule is the same for arrays and files. A row counts if a state with a choice reads it. Other
rows may hold anything: rows of states with one action or in which the episode is over and, in an
array of probabilities, rows of states whose actions differ in name only. Without `kind`,

    some row that counts is not a distribution  the array is a Q-table
    every such row gives 1 to a single action   the array is a policy; for costs it is refused if
                                                the Q-table would be another policy
    otherwise                                   the array is ambiguous and refused

A distribution has entries of at least 0 (floats from -1e-9 to 0 count as 0, since rounding leaves
such numbers) that sum to 1, up to 1e-9 or the rounding of a short type: numbers that are all
float32, float16 or bfloat16 values, whatever the type of the array, or that are printed with the
digits of float32. Such rows are divided by their exact sums. A Q-table stands for its greedy
policy: the greatest value (for costs, the least) among the available actions, compared in the
array's own numbers; the lowest action number wins a tie. -inf marks an action that is never taken.
NaN, +inf, and a row of -inf for all available actions are refused. For costs the infinities change
places.

In Python a policy may also be {state: action}, {state: {action: probability}}, or {state: row of
numbers}; a Q-table may be {state: {action: value}}, with kind="q" if all values are from 0 to 1.
{(state, action): number} is a table like an array, if it has all available actions; else it is
{state: {action: number}}. If the states of a model were made from whole numbers or tuples of these
(`MDP.from_function`), an array may be q[state][action], or actions [state], over more states, with
an axis for each part of a tuple. Rows of states that the model does not reach are ignored, with a
warning. Tensors are read as arrays. If states are named 0, 2, 3 and there is one more, an array is
refused: its row 3 may belong to state 3 or to the fourth state. So is a table over states made from
0, 3, 1 and "end": its row 1 may belong to state 1 or to the second state. A list of an action for
each state of the model follows the model's order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from fractions import Fraction
from math import prod
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, join_few, locate_errors, no_such, warn_user
from exact_mdp.mdp.forms.names import integer_of
from exact_mdp.mdp.forms.numbers import convert_tensors, is_pandas_table, refuse_masked
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.horizon import flatten_times
from exact_mdp.mdp.space import StateSpace, find_table_space
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, Numbers, to_python_number
from exact_mdp.mdp.validate import Flags

KINDS = ("auto", "q", "policy")
SAY = (
    'say which, since the answers differ: Policy.of(model, array, kind="policy") or kind="q"; in '
    "commands --kind policy or --kind q"
)
Q_TABLE, PROBABILITIES = "a Q-table: its greedy policy", "action probabilities"

Parts = dict[str, Any]
"""The arguments of `Policy`, by name."""


def numbers_of(given: object) -> Numbers:
    """Return an array or nested lists as an array of real numbers, without rounding."""
    given = convert_tensors(given)
    with locate_errors("policy"):
        refuse_masked(given)
        if is_pandas_table(given):
            raise ModelError(
                f"a pandas {type(given).__name__} goes by labels, and an array by position",
                fix="give table.to_numpy(), in the order of the model's states and actions; or a "
                "dictionary, which goes by names: {state: action}",
            )
    if isinstance(given, np.ndarray) and given.dtype.kind in "fiu":
        return np.asarray(given)  # np.matrix becomes an array
    # Numbers of several types become objects, so that none is rounded.
    try:
        array: Numbers = np.array(given, dtype=object)
    except ValueError:
        array = np.array(None, dtype=object)
    array.flat[:] = [to_python_number(number) for number in array.flat]
    kinds = {type(number) for number in array.flat}
    if kinds == {float}:
        return array.astype(np.float64)
    if kinds == {int}:
        whole = np.asarray(given)
        if whole.dtype.kind in "iu":  # they fit in 64 bits
            return whole
    if not kinds <= {int, float, Fraction} or not kinds:
        raise ModelError(
            f"{type(given).__name__} of shape {array.shape} does not hold real numbers only",
            where="policy",
            fix="give action numbers, probabilities or action values; for names, a dictionary "
            "{state: action}",
        )
    return array


def of_given_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of an array as `of_array` does, unless the order of its rows is ambiguous.

    If states are named 0, 2, 3 and there is one more, a table of four rows may go by position, or
    by these names with a row for 1.
    """
    own = _find_rows_by_object(model, array, kind)
    if own is not None:
        return of_array(model, own, kind)
    columns = (model.space.untimed or model.space).columns
    names: list[int | None] = []
    if len(columns) == 1:
        names = [integer_of(word) for word in columns[0].words]
    known = [name for name in names if name is not None]
    # A gap: all names are whole numbers, and some is too large to be a position.
    gap = len(known) == len(names) > 0 and max(known) >= len(names)
    if gap and min(known) >= 0 and max(known) < len(array) and not _has_times(model, array):
        few = join_few(known, len(known))
        raise ModelError(
            f"states are named {few}, and row {known[-1]} of {len(array)} may be for state "
            f"{known[-1]}, or for {model.space.label(known[-1])} in the model's order",
            where="policy",
            fix="give a dictionary, which goes by names: {state: row}",
        )
    return of_array(model, array, kind)


def _has_times(model: MDP, array: Numbers) -> bool:
    """Return whether an array is (N, S) or (N, S, A), by time and state."""
    return flatten_times(model, array) is not array


def _find_rows_by_object(model: MDP, array: Numbers, kind: str) -> Numbers | None:
    """Return the rows of the states of a model from functions, in an array over more states.

    The states are whole numbers, or tuples of these, and the array has an axis for each of their
    parts: q[s], with a row of A numbers, or a[s], with whole numbers of actions. A state without a
    choice may be anything else. None for other states, and if the rows fit by position.
    """
    space = model.space.untimed or model.space
    objects = space.columns[0].objects if len(space.columns) == 1 else ()
    if not objects or _has_times(model, array):
        return None
    parts = max(len(thing) if isinstance(thing, tuple) else 1 for thing in objects)
    grid, row = array.shape[:parts], array.shape[parts:]
    acts = not row and array.dtype.kind in "iu" and kind != "q"
    if not acts and row != (model.n_actions,):
        return None
    choosing = {*rows_read(model, space)[model.ends.must_choose].tolist()}
    states, places = list[int](), list[Any]()
    for state, thing in enumerate(objects):
        place: Any = thing
        if not isinstance(thing, tuple):
            place = (thing,)
        whole = len(place) == len(grid) and all(isinstance(part, int) for part in place)
        if whole and all(0 <= part < length for part, length in zip(place, grid, strict=True)):
            states.append(state)
            places.append(place)
        elif state in choosing:
            return None
    if not places:
        return None
    number = np.ravel_multi_index(np.transpose(places), grid)
    if find_table_axes(model, (*grid, model.n_actions)) is not None:
        differ = np.flatnonzero(number != states).tolist()
        if acts or not differ:  # numbers of actions are in the model's order, as in solutions
            return None
        first = states[differ[0]]
        raise ModelError(
            f"row {first} may be of state {first}, by its name, or of {space.label(first)}, "
            "in the model's order",
            where="policy",
            fix="give a dictionary, which goes by names: {state: row}",
        )
    every = array.reshape(-1, *row)
    rows = np.repeat(every[number[:1]], len(objects), axis=0)
    rows[states] = every[number]
    others = np.setdiff1d(np.arange(prod(grid)), number)
    if len(others):
        unread = np.transpose(np.unravel_index(others[:4], grid)).tolist()
        labels = [str(tuple(place)) for place in unread]
        if len(grid) == 1:
            labels = [str(place[0]) for place in unread]
        warn_unread(labels, len(others), prod(grid))
    return rows


def warn_unread(labels: Sequence[str], count: int, rows: int) -> None:
    """Warn that `count` of some rows are of states that the model does not reach."""
    warn_user(
        f"{count} of {rows} rows are not read: their states are not in the model, "
        f"which has only the states that can be reached from its start: {join_few(labels, count)}"
    )


def of_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of an array: action numbers, probabilities or action values.

    Action numbers have the shape (S,), the others (S, A) over all states or (2^n, A) over the
    status vectors. If the model stops after N steps, S may be the states without their time, and
    (N, S) and (N, S, A) depend on time. Extra states (the end) may be missing if they have no
    choice.
    """
    timed = model.space.untimed is not None
    if array.ndim == 2 and array.shape[1] == 1 < model.n_actions and not timed:
        array = array[:, 0]  # a column of action numbers
    if array.dtype.kind in "iu" and kind != "q":
        if array.ndim == 1:
            _refuse_names(model, array)
            return action_numbers(model, array)
        if timed and array.ndim == 2 and flatten_times(model, array).ndim == 1:
            if array.shape[1] != model.n_actions or find_table_axes(model, array.shape) is None:
                return action_numbers(model, array)
            if kind == "auto" and ((array >= 0) & (array < model.n_actions)).all():
                raise ModelError(
                    f"an array of shape {array.shape} may be action numbers by time and state, or "
                    "a table of states and actions, and the two differ",
                    where="policy",
                    fix=f"give probabilities (N, S, A), numpy.eye({model.n_actions})[array]; or "
                    'say kind="q" for a Q-table: Policy.of(model, array, kind="q"), in commands '
                    "--kind q",
                )
    return policy_of_array(model, array, kind)


def policy_of_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of a table with a row for each state, of probabilities or action values."""
    if array.ndim == 3:
        array = flatten_times(model, array)
    over = find_table_axes(model, array.shape)
    if over is None:
        raise _no_policy(model, array, kind)
    # The row of each state, and the actions that are available in each row.
    (space, actions), costs = over, model.sense.costs
    row, offered = rows_read(model, space), np.full(array.shape, actions is not model.actions)
    if actions is model.actions:
        offered[row[model.pair_state], model.pair_action] = True
    names = space.label, [f", action {action}" for action in actions]

    def read_by(states: Flags) -> Flags:
        """Return (K,) True for the rows that some states (S,) read."""
        rows = np.zeros(space.size, dtype=bool)
        rows[row[states]] = True
        return rows

    # Rows that count, and rows of distributions.
    counts = read_by(model.ends.must_choose)
    choosing = read_by(model.ends.choice_matters)
    chances = array
    if array.dtype.kind == "f":  # rounding may leave small negative numbers
        chances = np.where((array < 0) & (array >= -FLOAT_ROW_TOLERANCE), 0, array)
    fits = are_distributions(chances, counts)
    wrong = counts & ~fits
    # If no row counts here, some may count at other values of the parameters.
    if kind == "auto" and not counts.any():
        wrong = ~fits & (offered.sum(axis=1) > 1)
    elif wrong.any() and (kind == "policy" or (kind == "auto" and choosing.any())):
        counts, wrong = choosing, choosing & ~fits
    # Action values: take the greedy policy.
    if kind == "q" or (kind == "auto" and wrong.any()):
        rule = _choose_greedy(array, offered, counts, names, costs=costs)
        read = {"rule": rule, "values": array, "source": Q_TABLE}
        return {"space": space, "actions": actions, **read}
    if wrong.any():
        raise no_distribution(array[wrong][0].tolist(), space.label(int(np.flatnonzero(wrong)[0])))
    # Probabilities. Without `kind`, rows that mix actions could also be action values.
    alone = ((chances == 1).sum(axis=1) == 1) & ((chances == 0).sum(axis=1) == array.shape[1] - 1)
    mixed: Flags = counts & ~np.asarray(alone, dtype=bool)
    # For costs the greedy action of such a row is not the action with 1.
    if kind == "auto" and costs and not mixed.any():
        least = _choose_greedy(array, offered, counts, names, costs=True)
        mixed = choosing & np.asarray(array[np.arange(len(array)), least] != 1, dtype=bool)
    if kind == "auto" and mixed.any():
        raise ModelError(
            "every row sums to 1: are these probabilities or a Q-table?",
            where=f"policy, {space.label(int(np.flatnonzero(mixed)[0]))}",
            fix=SAY,
        )
    # A positive probability must not become 0 as a float.
    floats = np.where(fits[:, None], chances, 0).astype(np.float64)
    lost = fits & ((floats == 0) & np.asarray(chances != 0)).any(axis=1)
    if (lost & counts).any():
        raise too_small(f"policy, {space.label(int(np.flatnonzero(lost & counts)[0]))}")
    table: Numbers = np.full(array.shape, np.nan, dtype=np.result_type(array, np.float64))
    table[fits & ~lost] = chances[fits & ~lost]
    return {"space": space, "actions": actions, "rule": table, "source": PROBABILITIES}


def no_distribution(row: list[Any], state: str) -> ModelError:
    """Return the error for action probabilities that are not a distribution."""
    return ModelError(
        f"action probabilities are {row}, not a distribution",
        where=f"policy, {state}",
        fix='make them at least 0, with sum 1; for a Q-table say kind="q"',
    )


def too_small(where: str) -> ModelError:
    """Return the error for a positive probability that would be 0 as a float."""
    what = "a probability of an action is above 0, but smaller than any float"
    return ModelError(what, where=where, fix="give 0")


def find_table_axes(
    model: MDP, shape: tuple[int, ...]
) -> tuple[StateSpace, tuple[str, ...]] | None:
    """Return the states of the rows and the actions of the columns of a table; None if none fit."""
    if shape[1:] == (model.n_actions,):
        space = find_table_space(model.space, shape[0], model.forced)
        if space is not None:
            return space, model.actions
    # A table over the status vectors has columns for the actions that are a choice somewhere.
    if "status" in model.space.names:
        column = model.space.column("status")
        numbers = np.unique(model.pair_action[~model.forced[model.pair_state]])
        if shape == (column.size, len(numbers)):
            return StateSpace(columns=(column,)), tuple(model.actions[a] for a in numbers)
    return None


def _no_policy(model: MDP, array: Numbers, kind: str = "auto") -> ModelError:
    """Return the error for an array that is not a policy of this model, with advice."""
    # States count without their time, by which a table may still differ.
    states = (model.space.untimed or model.space).size
    shape, table = array.shape, f"({states}, {model.n_actions})"
    fix = (
        f"give {states} whole numbers of actions, or probabilities or action values in "
        f"an array {table}, a row for each state"
    )
    if "status" in model.space.names:
        fix += ", or one for each status"
    if states < model.n_states:
        fix += f"; if they depend on time, ({model.space.columns[0].size - 1}, {table[1:]}"
    if shape == (states,) and array.dtype.kind in "iu" and kind == "q":
        fix = f'leave kind="q" out of action numbers, or give action values in an array {table}'
    elif shape == (states,) and array.dtype.kind == "f" and (array == array.round()).all():
        fix = "give array.astype(int), whole numbers of actions"
    elif shape[:1] > (states,) and any(column.objects for column in model.space.columns):
        fix += (
            "; the model has only the states that can be reached from its start: for more states "
            "give {state: row}"
        )
    elif shape[:1] > (states,) and model.observations is not None:
        fix += "; the model has only the states of its records: give {state: row} of these"
    what = f"an array of shape {shape} and type {array.dtype} is not a policy of this model"
    if (
        len(shape) == 2
        and shape[0] == model.n_actions
        and find_table_space(model.space, shape[1], model.forced)
    ):
        what = f"an array of shape {shape} has a row for each action: it is the wrong way round"
    return ModelError(what, where="policy", fix=fix)


def _choose_greedy(
    values: Numbers,
    offered: Flags,
    counts: Flags,
    names: tuple[Callable[[int], str], list[str]],
    *,
    costs: bool,
) -> Integers:
    """Return the greedy action of each row of action values (K, A); -1 for rows without one."""
    if values.dtype.kind in "iu":
        values = values.astype(object)  # as objects, they can be compared with infinity
    given, worst = values, "-inf"
    if costs:
        values, worst = -values, "+inf"
    # A row has no greedy action if a value is not a number, or if all actions are excluded.
    never: Flags = np.asarray(values == -np.inf, bool) | ~offered
    no_number = np.asarray((values != values) | (values == np.inf), bool) & offered
    silent: Flags = no_number.any(axis=1) | np.asarray(never.all(axis=1))
    if (silent & counts).any():
        row = int(np.flatnonzero(silent & counts)[0])
        what = f"every available action has the value {worst}"
        where = f"Q-table, {names[0](row)}"
        # Name the first action whose value is not a number.
        for action in np.flatnonzero(no_number[row])[:1].tolist():
            where += names[1][action]
            value = given[row][action]
            what = f"an action value is {value}"
            if value != value:
                what = "an action value is NaN"
        fix = f"give a number for every available action; {worst} for one never to be taken"
        raise ModelError(what, where=where, fix=fix)
    # Rows that do not count here may count at other values of the parameters.
    chosen = np.argmax(np.where(offered & ~silent[:, None], values, -np.inf), axis=1)
    return np.asarray(np.where(offered[np.arange(len(chosen)), chosen] & ~silent, chosen, -1))


def are_distributions(array: Numbers, counted: Flags) -> Flags:
    """Return (K,) True for rows that are distributions, up to the rounding of the rows `counted`.

    A softmax of A numbers divides each by their sum: A - 1 additions and a division, each with a
    relative error of at most u. The quotients are rounded once more when they are stored or
    printed. With n = A + 1, their sum is 1 up to n u / (1 - n u).
    """
    with np.errstate(invalid="ignore"):  # NaN is not a probability
        inside = np.asarray((array >= 0) & (array <= 1 + FLOAT_ROW_TOLERANCE), bool).all(axis=1)
    rows = array[inside].astype(np.float64)
    off = np.abs(rows.sum(axis=1) - 1)
    fits: Flags = np.zeros(len(array), dtype=bool)
    fits[inside] = off <= FLOAT_ROW_TOLERANCE
    if (counted & inside & ~fits).any():
        rounding = (array.shape[1] + 1) * _unit_roundoff(rows[counted[inside]])
        if rounding < 1:
            fits[inside] |= off <= rounding / (1 - rounding)
    return fits


def _unit_roundoff(numbers: Floats) -> float:
    """Return the unit roundoff u of the shortest type that holds, or prints, all of the numbers.

    It is 0 for doubles, which have no shorter type.
    """
    single = numbers.astype(np.float32)
    if not np.array_equal(numbers, single):
        if np.array_equal(numbers, single.astype(str).astype(float)):
            return 2.0**-24
        return 0.0
    if not (single.view(np.uint32) & 0xFFFF).any():  # a bfloat16 is the first half of a float32
        return 2.0**-8
    if np.array_equal(numbers, numbers.astype(np.float16)):
        return 2.0**-11
    return 2.0**-24


def space_over(model: MDP, names: Collection[str]) -> StateSpace:
    """Return the space over some columns; the model's own space if all columns are named."""
    if set(names) >= set(model.space.names):
        return model.space
    return StateSpace(columns=tuple(map(model.space.column, names)))


def rows_read(model: MDP, space: StateSpace) -> Integers:
    """Return (S,) the row of each state in a table over `space`; 0 for extra states."""
    if space.columns == model.space.columns and space.extra == model.space.extra:
        return np.arange(model.n_states)
    for column in space.columns:
        theirs = model.space.column(column.name)
        if theirs == column:
            continue
        what = f"the values of column {column.name} have other names here than in the model"
        if column.size != theirs.size:
            what = (
                f"column {column.name} has {column.size} values here and {theirs.size} in the model"
            )
        raise ModelError(what, where="policy", fix="use a policy made for this model")
    return model.space.rows(space.columns)


def _refuse_names(model: MDP, numbers: Numbers) -> None:
    """Raise ModelError if action numbers may also be names of actions, and the two differ."""
    answers = np.unique(numbers).tolist()
    named = [model.action_names.words.get(str(number)) for number in answers]
    if None not in named and named != answers:
        raise ModelError(
            f"{answers} are names of actions, but the numbers of an array count from 0 to "
            f"{model.n_actions - 1} in the model's order, and the two differ",
            where="policy",
            fix="give names: {state: action}; or Policy(space=model.space, actions=model.actions, "
            "rule=numbers)",
        )


def action_numbers(model: MDP, given: Numbers) -> Parts:
    """Return the policy of action numbers (S,) or (N, S), checked against the model's own."""
    numbers = flatten_times(model, np.asarray(given))
    space = None
    if numbers.ndim == 1:
        space = find_table_space(model.space, len(numbers), model.forced)
    if space is None or numbers.dtype.kind not in "iu":
        raise _no_policy(model, numbers)
    inside = (numbers >= 0) & (numbers < model.n_actions)
    if not inside.all():
        raise no_such("action", numbers[~inside][0], model.n_actions, where="policy")
    return {"space": space, "actions": model.actions, "rule": numbers.astype(np.int64)}


def find_distinct_rows(rows: Numbers) -> tuple[Numbers, Integers]:
    """Return the different rows (U, K) of an array (D, K), and the number (D,) of each row.

    They are numbered in order of appearance.
    """
    # Only rows that differ from the row before are compared with all others.
    fresh = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))[: len(rows)]
    known: dict[bytes, int] = {}
    number = [known.setdefault(row.tobytes(), len(known)) for row in rows[fresh]]
    which = np.array(number, dtype=np.int64)[np.cumsum(fresh) - 1]
    return rows[np.unique(which, return_index=True)[1]], which
