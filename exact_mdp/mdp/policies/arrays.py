"""How an array states a policy: action values (a Q-table), or probabilities of actions.

The rule is the same for arrays and files. A row counts if a state with a choice reads it. Rows of
states in which all is over, of states with one action and, as probabilities, of states whose
actions differ in name only may hold anything. Without `kind`,

    some row that counts is not a distribution  the array is a Q-table
    every such row gives 1 to a single action   the array is a policy; of costs, where the two
                                                readings differ, it is refused
    otherwise                                   the array is ambiguous and refused

A distribution has entries of at least 0 (floats from -1e-9 to 0 are 0, as rounding leaves such
numbers) that sum to 1, up to 1e-9 or the rounding of a short type:
numbers that are all float32, float16 or bfloat16 values, whatever type holds them, or that are
printed with the digits of float32. Such rows are divided by their exact sums. A Q-table means its
greedy policy: the greatest value (of costs, the least) among the actions offered, compared in the
array's own numbers; the lowest action number wins a tie. -inf marks an action that is never taken.
NaN, +inf, and -inf for every action offered are refused. For costs the infinities change places.

In Python a policy may also be {state: action}, {state: {action: probability}}, or {state: row of
numbers}; of a Q-table (kind="q") {state: {action: value}}. {(state, action): number} is a table as
an array is, if it has every action offered; else it is {state: {action: number}}. Rows of states
that a model of `MDP.from_function` does not reach are not read, with a warning. Tensors are the
arrays that they hold. Where states are called 0, 2, 3 and there is one more, an array is refused:
its row 3 may be that of state 3.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, locate_errors, no_such
from exact_mdp.mdp.forms.names import integer_of
from exact_mdp.mdp.forms.numbers import convert_tensors, is_pandas_table, refuse_masked
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, Numbers

Flags = NDArray[np.bool_]
KINDS = ("auto", "q", "policy")
SAY = (
    'say which, as the answers differ: Policy.of(model, array, kind="policy") or kind="q"; in '
    "commands --kind policy or --kind q"
)
Q_TABLE, PROBABILITIES = "a Q-table: its greedy policy", "action probabilities"

Parts = dict[str, Any]
"""What `Policy` takes, by name."""


def numbers_of(given: object) -> Numbers:
    """Return an array of real numbers as they are, none of them rounded; lists included."""
    given = convert_tensors(given)
    with locate_errors("policy"):
        refuse_masked(given)
        if is_pandas_table(given):
            raise ModelError(
                f"a {type(given).__name__} of pandas goes by labels, and an array by position",
                fix="give table.to_numpy(), in the order of the model's states and actions; or a "
                "dictionary, which goes by names: {state: action}",
            )
    if isinstance(given, np.ndarray) and given.dtype.kind in "fiu":
        return np.asarray(given)  # of matrices, too, whose rows have two dimensions
    try:
        array: Numbers = np.array(given, dtype=object)
    except ValueError:
        array = np.array(None, dtype=object)
    array.flat[:] = [_to_python_number(number) for number in array.flat]
    kinds = {type(number) for number in array.flat}
    if kinds == {float}:
        return array.astype(np.float64)
    whole = np.asarray(given) if kinds == {int} else array
    if whole.dtype.kind in "iu":
        return whole
    if not kinds <= {int, float, Fraction} or not kinds:
        raise ModelError(
            f"{type(given).__name__} of shape {array.shape} does not hold real numbers alone",
            where="policy",
            fix="give action numbers, probabilities or action values; of names a dictionary, "
            "{state: action}",
        )
    return array


def _to_python_number(number: Any) -> Any:
    """Return a NumPy scalar as the Python number that it is, so that comparisons are exact."""
    if isinstance(number, np.longdouble) and np.isfinite(number):
        return Fraction(*number.as_integer_ratio())
    return number.item() if isinstance(number, np.generic) else number


def of_given_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of an array as `of_array` does, where its order cannot be another one.

    Where states are called 0, 2, 3 and there is one more, a table of four rows may go by position,
    or by these names with a row for 1.
    """
    columns = model.space.columns
    names = [integer_of(word) for word in (columns[0].words if len(columns) == 1 else ())]
    known = [name for name in names if name is not None]
    gap = len(known) == len(names) > 0 and max(known) >= len(names)
    if gap and min(known) >= 0 and max(known) < len(array):
        raise ModelError(
            f"states are called {', '.join(map(str, known[:4]))}{' …' * (len(known) > 4)}, and row "
            f"{known[-1]} of {len(array)} may be that of state {known[-1]}, or that of "
            f"{model.space.label(known[-1])} in the model's order",
            where="policy",
            fix="give a dictionary, which goes by names: {state: row}",
        )
    return of_array(model, array, kind)


def of_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of an array: numbers of actions, probabilities or action values.

    Numbers are (S,), others (S, A) over all states or (2^n, A) over the status vectors. Where the
    model stops after N steps, S may be the states without their time, and (N, S) and (N, S, A)
    depend on time. Extra states (the end) may be left out where they offer no choice.
    """
    timed = model.space.untimed is not None
    if array.ndim == 2 and array.shape[1] == 1 < model.n_actions and not timed:
        array = array[:, 0]  # a column of action numbers
    if array.dtype.kind in "iu" and kind != "q":
        if array.ndim == 1:
            _refuse_names(model, array)
            return action_numbers(model, array)
        if timed and array.ndim == 2 and flatten_times(model, array).ndim == 1:
            if array.shape[1] != model.n_actions:
                return action_numbers(model, array)
            if kind == "auto" and ((array >= 0) & (array < model.n_actions)).all():
                raise ModelError(
                    f"an array of shape {array.shape} may be action numbers by time and state, or "
                    "a table of states and actions, which differ",
                    where="policy",
                    fix='give probabilities (N, S, A), or say kind="q" of a Q-table: '
                    'Policy.of(model, array, kind="q"), in commands --kind q',
                )
    return policy_of_array(model, array, kind)


def policy_of_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of a table with a row for each state, of probabilities or action values."""
    array = flatten_times(model, array) if array.ndim == 3 else array
    over = find_table_axes(model, array.shape)
    if over is None:
        raise _no_policy(model, array, kind)
    (space, actions), costs = over, model.sense == "min"
    row, offered = rows_read(model, space), np.full(array.shape, actions is not model.actions)
    if actions is model.actions:
        offered[row[model.pair_state], model.pair_action] = True
    names = space.label, [f", action {action}" for action in actions]

    def read_by(states: Flags) -> Flags:
        """Return (K,) which rows some states (S,) read."""
        rows = np.zeros(space.size, dtype=bool)
        rows[row[states]] = True
        return rows

    counts, choosing = read_by(model.asked), read_by(model.asked & ~model.indifferent)
    chances = array
    if array.dtype.kind == "f":  # rounding leaves negative numbers
        chances = np.where((array < 0) & (array >= -FLOAT_ROW_TOLERANCE), 0, array)
    fits = are_distributions(chances, counts)
    wrong = counts & ~fits
    if kind == "auto" and not counts.any():  # it is asked at other values of a parameter
        wrong = ~fits & (offered.sum(axis=1) > 1)
    elif wrong.any() and (kind == "policy" or (kind == "auto" and choosing.any())):
        counts, wrong = choosing, choosing & ~fits
    if kind == "q" or (kind == "auto" and wrong.any()):
        rule = _choose_greedy(array, offered, counts, names, costs=costs)
        read = {"rule": rule, "values": array, "source": Q_TABLE}
        return {"space": space, "actions": actions, **read}
    if wrong.any():
        raise no_distribution(array[wrong][0].tolist(), space.label(int(np.flatnonzero(wrong)[0])))
    alone = ((chances == 1).sum(axis=1) == 1) & ((chances == 0).sum(axis=1) == array.shape[1] - 1)
    mixed: Flags = counts & ~np.asarray(alone, dtype=bool)
    if kind == "auto" and costs and not mixed.any():  # a cost of 1 is not the least
        least = _choose_greedy(array, offered, counts, names, costs=True)
        mixed = choosing & np.asarray(array[np.arange(len(array)), least] != 1, dtype=bool)
    if kind == "auto" and mixed.any():
        raise ModelError(
            "every row sums to 1: are these probabilities or a Q-table?",
            where=f"policy, {space.label(int(np.flatnonzero(mixed)[0]))}",
            fix=SAY,
        )
    floats = np.where(fits[:, None], chances, 0).astype(np.float64)
    lost = fits & ((floats == 0) & np.asarray(chances != 0)).any(axis=1)
    if (lost & counts).any():
        raise too_small(f"policy, {space.label(int(np.flatnonzero(lost & counts)[0]))}")
    table: Numbers = np.full(array.shape, np.nan, dtype=np.result_type(array, np.float64))
    table[fits & ~lost] = chances[fits & ~lost]
    return {"space": space, "actions": actions, "rule": table, "source": PROBABILITIES}


def no_distribution(row: list[Any], state: str) -> ModelError:
    """Return the error for probabilities that are none."""
    return ModelError(
        f"action probabilities are {row}, not a distribution",
        where=f"policy, {state}",
        fix='make them at least 0, with sum 1; of a Q-table say kind="q"',
    )


def too_small(where: str) -> ModelError:
    """Return the error for a probability above 0 that would become 0 as a float."""
    what = "a probability of an action is above 0, but smaller than any float"
    return ModelError(what, where=where, fix="give 0")


def find_table_axes(
    model: MDP, shape: tuple[int, ...]
) -> tuple[StateSpace, tuple[str, ...]] | None:
    """Return what rows and columns of a table of some shape are over; None where none fits."""
    space = space_of(model, shape[0]) if shape[1:] == (model.n_actions,) else None
    if space is not None:
        return space, model.actions
    if "status" in model.space.names:
        column = model.space.column("status")
        numbers = np.unique(model.pair_action[~model.forced[model.pair_state]])
        if shape == (column.size, len(numbers)):
            return StateSpace(columns=(column,)), tuple(model.actions[a] for a in numbers)
    return None


def _no_policy(model: MDP, array: Numbers, kind: str = "auto") -> ModelError:
    """Return the error for an array that states no policy of this model."""
    shape, table = array.shape, f"({model.n_states}, {model.n_actions})"
    turned = len(shape) == 2 and shape[0] == model.n_actions and space_of(model, shape[1])
    fix = (
        f"give {model.n_states} whole numbers of actions, or probabilities or action values in "
        f"an array {table}, a row for each state"
    )
    if "status" in model.space.names:
        fix += ", or one for each status"
    if shape == (model.n_states,) and array.dtype.kind in "iu" and kind == "q":
        fix = f'leave kind="q" out of action numbers, or give action values in an array {table}'
    elif shape == (model.n_states,) and array.dtype.kind == "f" and (array == array.round()).all():
        fix = "give array.astype(int), whole numbers of actions"
    elif shape[:1] > (model.n_states,) and any(column.objects for column in model.space.columns):
        fix += (
            "; the model has the states that can be reached from its start: of more states give "
            "{state: row}"
        )
    return ModelError(
        f"an array of shape {shape} has a row for each action: it is the wrong way round"
        if turned
        else f"an array of shape {shape} and type {array.dtype} is no policy of this model",
        where="policy",
        fix=fix,
    )


def _choose_greedy(
    values: Numbers,
    offered: Flags,
    counts: Flags,
    names: tuple[Callable[[int], str], list[str]],
    *,
    costs: bool,
) -> Integers:
    """Return (K,) the greedy actions of action values (K, A), -1 for rows that say nothing."""
    if values.dtype.kind in "iu":
        values = values.astype(object)  # beside infinities, and without overflow
    worst = "+inf" if costs else "-inf"
    values = -values if costs else values
    never: Flags = np.asarray(values == -np.inf, bool) | ~offered
    no_number = np.asarray((values != values) | (values == np.inf), bool) & offered
    silent: Flags = no_number.any(axis=1) | np.asarray(never.all(axis=1))
    if (silent & counts).any():
        row = int(np.flatnonzero(silent & counts)[0])
        wrong = np.flatnonzero(no_number[row])[:1].tolist()
        said = [
            f"an action value is {'NaN' if x != x else -x if costs else x}" for x in values[row]
        ]
        raise ModelError(
            said[wrong[0]] if wrong else f"every action offered has the value {worst}",
            where=f"Q-table, {names[0](row)}{''.join(names[1][action] for action in wrong)}",
            fix=f"give a number for every available action; {worst} for one never to be taken",
        )
    # Rows that do not count in this model may in another, at other values of its parameters.
    chosen = np.argmax(np.where(offered & ~silent[:, None], values, -np.inf), axis=1)
    return np.asarray(np.where(offered[np.arange(len(chosen)), chosen] & ~silent, chosen, -1))


def are_distributions(array: Numbers, asked: Flags) -> Flags:
    """Return (K,) True for rows that are distributions, up to the rounding of the rows `asked`.

    A softmax of A numbers divides each by their sum: A - 1 additions and a division, each off by a
    factor of 1 ± u at most. The quotients are rounded once more where they are stored or printed.
    With n = A + 1 they sum to 1 up to n u / (1 - n u).
    """
    with np.errstate(invalid="ignore"):  # NaN is not a probability
        inside = np.asarray((array >= 0) & (array <= 1 + FLOAT_ROW_TOLERANCE), bool).all(axis=1)
    rows = array[inside].astype(np.float64)
    off = np.abs(rows.sum(axis=1) - 1)
    fits: Flags = np.zeros(len(array), dtype=bool)
    fits[inside] = off <= FLOAT_ROW_TOLERANCE
    if (asked & inside & ~fits).any():
        rounding = (array.shape[1] + 1) * _unit_roundoff(rows[asked[inside]])
        fits[inside] |= off <= (rounding / (1 - rounding) if rounding < 1 else 0.0)
    return fits


def _unit_roundoff(numbers: Floats) -> float:
    """Return u of the shortest type that holds all of some numbers, or prints them as they are."""
    single = numbers.astype(np.float32)
    if not np.array_equal(numbers, single):
        return 2.0**-24 * np.array_equal(numbers, single.astype(str).astype(float))
    if not (single.view(np.uint32) & 0xFFFF).any():  # a bfloat16 is the first half of a float32
        return 2.0**-8
    return 2.0**-11 if np.array_equal(numbers, numbers.astype(np.float16)) else 2.0**-24


def space_of(model: MDP, rows: int) -> StateSpace | None:
    """Return the states that this many rows of a table stand for; None where no states fit.

    All states; without some of the extra ones, where these offer no choice; or, where the first
    column is the time, the states without it.
    """
    space = model.space
    if rows == space.size:
        return space
    if space.untimed is not None:
        untimed = space.untimed
        bare = StateSpace(columns=untimed.columns)
        return untimed if rows == untimed.size else bare if rows == bare.size else None
    if not space.regular <= rows < space.size or not model.forced[space.regular :].all():
        return None
    return StateSpace(columns=space.columns, extra=space.extra[: rows - space.regular])


def space_over(model: MDP, names: Collection[str]) -> StateSpace:
    """Return what some columns say of the states: the states themselves where all are named."""
    if set(names) >= set(model.space.names):
        return model.space
    return StateSpace(columns=tuple(map(model.space.column, names)))


def rows_read(model: MDP, space: StateSpace) -> Integers:
    """Return (S,) the row of a table over `space` that each state reads; 0 for extra ones."""
    if space.columns == model.space.columns and space.extra == model.space.extra:
        return np.arange(model.n_states)
    for column in space.columns:
        theirs = model.space.column(column.name)
        if theirs != column:
            raise ModelError(
                f"column {column.name} has {column.size} values here and {theirs.size} in the model"
                if column.size != theirs.size
                else f"the values of column {column.name} have other names here than in the model",
                where="policy",
                fix="use a policy made for this model",
            )
    return model.space.rows(space.columns)


def _refuse_names(model: MDP, numbers: Numbers) -> None:
    """Raise ModelError where action numbers may as well be names of actions, which differ."""
    answers = np.unique(numbers).tolist()
    named = [model.action_names.words.get(str(number)) for number in answers]
    if None not in named and named != answers:
        raise ModelError(
            f"{answers} are names of actions, but the numbers of an array count from 0 to "
            f"{model.n_actions - 1} in the model's order, which differ",
            where="policy",
            fix="give names: {state: action}; or Policy(space=model.space, actions=model.actions, "
            "rule=numbers)",
        )


def action_numbers(model: MDP, given: Numbers) -> Parts:
    """Return the policy of action numbers (S,) or (N, S), checked against the model's own."""
    numbers = flatten_times(model, np.asarray(given))
    space = space_of(model, len(numbers)) if numbers.ndim == 1 else None
    if space is None or numbers.dtype.kind not in "iu":
        raise _no_policy(model, numbers)
    inside = (numbers >= 0) & (numbers < model.n_actions)
    if not inside.all():
        raise no_such("action", numbers[~inside][0], model.n_actions, where="policy")
    return {"space": space, "actions": model.actions, "rule": numbers.astype(np.int64)}


def flatten_times(model: MDP, table: Numbers) -> Numbers:
    """Return a table (N, S) or (N, S, A) over times and states as one over all states.

    Where the model's first column is not the time, or the shape is another, the table is returned
    as it is. S are the states without their time, with or without the extra ones; time N, where
    all is over, may be there as well or not.
    """
    untimed = model.space.untimed
    if untimed is None or table.ndim < 2:
        return table
    times, own = model.space.columns[0].size, untimed.regular
    over = bool(model.forced[(times - 1) * own :].all())
    steps = times - 1 if over else times
    if table.shape[0] not in (steps, times) or table.shape[1] not in (own, untimed.size):
        return table
    spread = np.full((model.n_states, *table.shape[2:]), 0, dtype=table.dtype)
    spread[: steps * own] = table[:steps, :own].reshape(-1, *table.shape[2:])
    return spread


def find_distinct_rows(rows: Numbers) -> tuple[Numbers, Integers]:
    """Return the (U, K) different rows of (D, K), in order of appearance, and (D,) each row's."""
    fresh = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))[: len(rows)]
    known: dict[bytes, int] = {}
    number = [known.setdefault(row.tobytes(), len(known)) for row in rows[fresh]]
    which = np.array(number, dtype=np.int64)[np.cumsum(fresh) - 1]
    return rows[np.unique(which, return_index=True)[1]], which
