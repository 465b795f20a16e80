"""How an array states a policy: action values (a Q-table), or probabilities of actions.

The rule is the same for arrays and files. A row counts if a state with a choice reads it. Rows of
states in which all is over, of states with one action and, as probabilities, of states whose
actions differ in name only may hold anything. Without `kind`,

    some row that counts is not a distribution  the array is a Q-table
    every such row gives 1 to a single action   the array is a policy; of costs, where the two
                                                readings differ, it is refused
    otherwise                                   the array is ambiguous and refused

A distribution has entries of at least 0 that sum to 1, up to 1e-9 or the rounding of a short type:
numbers that are all float32, float16 or bfloat16 values, whatever type holds them, or that are
printed with the digits of float32. Such rows are divided by their exact sums. A Q-table means its
greedy policy: the greatest value (of costs, the least) among the actions offered, compared in the
array's own numbers; the lowest action number wins a tie. -inf marks an action that is never taken.
NaN, +inf, and -inf for every action offered are refused. For costs the infinities change places.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, no_such
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, Numbers

Flags = NDArray[np.bool_]
KINDS = ("auto", "q", "policy")
SAY = (
    'say which, as the answers differ: Policy.of(model, array, kind="policy") or kind="q"; in '
    "commands --kind policy or --kind q"
)
UNIT_32 = 2.0**-24  # the unit roundoff of float32
Q_TABLE, PROBABILITIES = "a Q-table: its greedy policy", "action probabilities"

Parts = dict[str, Any]
"""What `Policy` takes, by name."""


def policy_of_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy that an array of real numbers gives.

    It is (S, A) over all states, or (2^n, A) over the status vectors. Where the model stops after
    N steps, S may be the states without their time, and (N, S, A) depends on time. Extra states
    (the end) may be left out where they offer no choice.
    """
    given, array = array, by_time(model, array, 0, of_actions=True)
    space, actions, offered = _layout(model, array.shape)
    row, costs = rows_read(model, space), model.sense == "min"

    def read_by(states: Flags) -> Flags:
        """Return (K,) which rows some states (S,) read."""
        rows = np.zeros(space.size, dtype=bool)
        rows[row[states]] = True
        return rows

    def place(row: int, action: int | None = None) -> str:
        """Return the index of an entry in the array as it was given, and what it is of."""
        untimed = model.space.untimed
        index = [row]
        if array is not given and untimed is not None:
            index = [*divmod(row, untimed.regular)]
        words = space.label(row)
        if action is not None:
            index, words = [*index, action], f"{words}, action {actions[action]}"
        return f"{index} ({words})"

    counts = read_by(model.asked)
    fits = are_distributions(array, counts)
    wrong = counts & ~fits
    if kind == "auto" and not counts.any():  # it is asked at other values of a parameter
        wrong = ~fits & (offered.sum(axis=1) > 1)
    elif wrong.any() and kind != "q":
        choosing = read_by(model.asked & ~model.indifferent)
        if kind == "policy" or choosing.any():
            counts, wrong = choosing, choosing & ~fits
    if kind == "q" or (kind == "auto" and wrong.any()):
        rule = _greedy(array, offered, counts, place, costs=costs)
        read = {"rule": rule, "values": array, "source": Q_TABLE}
        return {"space": space, "actions": actions, **read}
    if wrong.any():
        raise no_distribution(array[wrong][0].tolist(), place(int(np.flatnonzero(wrong)[0])))
    alone = ((array == 1).sum(axis=1) == 1) & ((array == 0).sum(axis=1) == array.shape[1] - 1)
    mixed = counts & ~np.asarray(alone, dtype=bool)
    if kind == "auto" and costs and not mixed.any():  # a cost of 1 is not the least
        least = _greedy(array, offered, counts, place, costs=True)
        mixed = read_by(model.asked & ~model.indifferent)
        mixed &= array[np.arange(len(array)), least] != 1
    if kind == "auto" and mixed.any():
        raise ModelError(
            "every row sums to 1: are these probabilities or a Q-table?",
            where=f"policy{place(int(np.flatnonzero(mixed)[0]))}",
            fix=SAY,
        )
    floats = np.where(fits[:, None], array, 0).astype(np.float64)
    lost = fits & ((floats == 0) & np.asarray(array != 0)).any(axis=1)
    if (lost & counts).any():
        raise too_small(f"policy{place(int(np.flatnonzero(lost & counts)[0]))}")
    table: Numbers = np.full(array.shape, np.nan, dtype=np.result_type(array, np.float64))
    table[fits & ~lost] = array[fits & ~lost]
    return {"space": space, "actions": actions, "rule": table, "source": PROBABILITIES}


def whole_fix(array: Floats) -> str:
    """Return how to give action numbers, of floats that were given."""
    if (array == np.round(array)).all():
        return "give them as integers: policy.astype(int)"
    return "give actions, such as q.argmax(axis=1), or the Q-table itself"


def no_distribution(row: list[Any], place: str) -> ModelError:
    """Return the error for probabilities that are none."""
    return ModelError(
        f"action probabilities are {row}, not a distribution",
        where=f"policy{place}",
        fix='make them at least 0, with sum 1; of a Q-table say kind="q"',
    )


def too_small(where: str) -> ModelError:
    """Return the error for a probability above 0 that would become 0 as a float."""
    what = "a probability of an action is above 0, but smaller than any float"
    return ModelError(what, where=where, fix="give 0")


def numbers_of(given: object) -> Numbers:
    """Return an array of real numbers as they are, none of them rounded; lists included."""
    refuse_masked(given, "policy")
    if isinstance(given, np.ndarray) and given.dtype.kind in "fiu":
        return np.asarray(given)  # of matrices, too, whose rows have two dimensions
    try:
        array: Numbers = np.array(given, dtype=object)
    except ValueError:
        array = np.array(None, dtype=object)
    array.flat[:] = [_plain(number) for number in array.flat]
    kinds = {type(number) for number in array.flat}
    if kinds == {float}:
        return array.astype(np.float64)
    whole = np.asarray(given) if kinds == {int} else array
    if whole.dtype.kind in "iu":
        return whole
    if not kinds <= {int, float, Fraction} or not kinds:
        raise ModelError(
            "the policy is None"
            if given is None
            else f"{type(given).__name__} of shape {array.shape} does not hold real numbers alone",
            where="policy",
            fix="give action numbers, probabilities or action values",
        )
    return array


def _plain(number: Any) -> Any:
    """Return a NumPy scalar as the Python number that it is, so that comparisons are exact."""
    if isinstance(number, np.longdouble) and np.isfinite(number):
        return Fraction(*number.as_integer_ratio())
    return number.item() if isinstance(number, np.generic) else number


def space_read(model: MDP, shape: tuple[int, ...]) -> StateSpace | None:
    """Return what the rows of a table of some shape are; None where no reading fits."""
    try:
        return _layout(model, shape)[0]
    except ModelError:
        return None


def _layout(model: MDP, shape: tuple[int, ...]) -> tuple[StateSpace, tuple[str, ...], Flags]:
    """Return what rows and columns of an array are over, and (K, A) what can be chosen."""
    actions = model.actions
    space = space_of(model, shape[0]) if shape[1:] == (model.n_actions,) else None
    meant = {"all states": model.n_states}
    if model.space.extra and space_of(model, regular := model.space.regular):
        meant[f"all but {', '.join(model.space.extra)}"] = regular
    if model.space.untimed is not None:
        meant["the states without their time"] = model.space.untimed.size
    expected = [f"({rows}, {model.n_actions}) over {states}" for states, rows in meant.items()]
    if space is None and "status" in model.space.names:
        column = model.space.column("status")
        numbers = np.unique(model.pair_action[~model.forced[model.pair_state]])
        actions = tuple(model.actions[number] for number in numbers)
        space = StateSpace(columns=(column,)) if shape == (column.size, len(actions)) else None
        expected.append(f"({column.size}, {len(actions)}) over the statuses")
    if space is None:
        if shape[:1] == (model.n_actions,) and len(shape) == 2 and space_of(model, shape[1]):
            raise ModelError(
                f"an array of shape {shape} has a row for each action: it is the wrong way round",
                where="policy",
                fix=f"give its transpose, of shape {shape[::-1]}: a row for each state",
            )
        raise ModelError(
            f"an array of shape {shape} is no policy of this model",
            where="policy",
            fix=f"give {' or '.join(expected)}",
        )
    offered = np.full((space.size, len(actions)), actions is not model.actions)
    if actions is model.actions:
        offered[rows_read(model, space)[model.pair_state], model.pair_action] = True
    return space, actions, offered


def _greedy(
    values: Numbers, offered: Flags, counts: Flags, place: Callable[..., str], *, costs: bool
) -> Integers:
    """Return (K,) the greedy actions of action values (K, A), -1 for rows that say nothing."""
    worst, best = ("+inf", "-inf") if costs else ("-inf", "+inf")
    if values.dtype.kind in "iu":
        values = values.astype(object)  # beside infinities, and without overflow
    values = -values if costs else values
    never: Flags = np.asarray(values == -np.inf, bool) | ~offered
    silent = np.zeros(len(values), dtype=bool)
    every = f"every action offered has the value {worst}"
    for what, entries in (
        ("an action value is NaN", np.asarray(values != values, bool) & offered),
        (f"an action value is {best}", np.asarray(values == np.inf, bool) & offered),
        (every, never & np.asarray(never.all(axis=1))[:, None]),
    ):
        rows = entries.any(axis=1)
        wrong = np.flatnonzero(rows & counts)
        if len(wrong):
            row = int(wrong[0])
            action = None if what is every else int(entries[row].argmax())
            raise ModelError(
                what,
                where=f"Q-table{place(row, action)}",
                fix=f"give a number for every available action; {worst} for one never to be taken",
            )
        silent |= rows
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
    fits = np.zeros(len(array), dtype=bool)
    fits[inside] = off <= FLOAT_ROW_TOLERANCE
    if (asked & inside & ~fits).any():
        rounding = (array.shape[1] + 1) * _unit_roundoff(rows[asked[inside]])
        fits[inside] |= off <= (rounding / (1 - rounding) if rounding < 1 else 0.0)
    return fits


def _unit_roundoff(numbers: Floats) -> float:
    """Return u of the shortest type that holds all of some numbers, or prints them as they are."""
    if not np.array_equal(numbers, single := numbers.astype(np.float32)):
        return UNIT_32 if np.array_equal(numbers, single.astype(str).astype(float)) else 0.0
    if not (single.view(np.uint32) & 0xFFFF).any():  # a bfloat16 is the first half of a float32
        return 2.0**-8
    return 2.0**-11 if np.array_equal(numbers, numbers.astype(np.float16)) else UNIT_32


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


def of_array(model: MDP, array: Numbers, kind: str = "auto") -> Parts:
    """Return the policy of an array: numbers of actions, probabilities or action values."""
    timed = model.space.untimed is not None
    if array.ndim == 2 and array.shape[1] == 1 < model.n_actions and not timed:
        array = array[:, 0]  # a column of action numbers
    if array.dtype.kind in "iu" and kind != "q":
        if array.ndim == 1:
            _refuse_names(model, array)
            return action_numbers(model, array)
        if timed and array.ndim == 2 and by_time(model, array, 0).ndim == 1:
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
    if array.ndim == 2 or (timed and array.ndim == 3):
        return policy_of_array(model, array, kind)
    table = f"({model.n_states}, {model.n_actions})"
    if array.size == model.n_states * model.n_actions and array.ndim:
        raise ModelError(
            f"an array of shape {array.shape} is not {table}, a row for each state",
            where="policy",
            fix=f"reshape{table}, if its values come state by state, the actions of each in order",
        )
    if kind == "q":
        raise ModelError(
            f"a Q-table has shape {table}, a row for each state, not {array.shape}",
            where="policy",
            fix='give a value for each state and action; of action numbers leave out kind="q"',
        )
    if array.ndim == 1 and array.dtype.kind == "f":
        raise ModelError(
            "action numbers are whole numbers, not floats",
            where="policy",
            fix=whole_fix(array),
        )
    raise ModelError(
        f"a policy of shape {array.shape} and type {array.dtype}",
        where="policy",
        fix=f"give ({model.n_states},) action numbers, or {table} probabilities or action values",
    )


def _refuse_names(model: MDP, numbers: Numbers) -> None:
    """Raise ModelError where action numbers may as well be names of actions, which differ."""
    answers = np.unique(numbers).tolist()
    named = [next(iter(model.action_names.named(number)), None) for number in answers]
    for number, meant in zip(answers, named, strict=True):
        if meant is None or None in named:
            continue
        fix = "give names, as text or in {state: action}, or Policy.from_choices(model, numbers)"
        if not 0 <= number < model.n_actions:
            raise ModelError(
                f"{number} is the name of an action, but the numbers of an array count from 0 to "
                f"{model.n_actions - 1} in the model's order",
                where="policy",
                fix=fix,
            )
        if number != meant:
            error = model.action_names.either(number, meant, number)
            raise ModelError(error.what, where="policy", fix=fix)


def action_numbers(model: MDP, given: Numbers) -> Parts:
    """Return the policy of action numbers (S,) or (N, S), checked against the model's own."""
    numbers = by_time(model, np.asarray(given), 0)
    space = space_of(model, len(numbers)) if numbers.ndim == 1 else None
    if space is None or numbers.dtype.kind not in "iu":
        raise ModelError(
            f"action numbers of shape {numbers.shape} and type {numbers.dtype}",
            where="policy",
            fix=f"give one whole number for each of the {model.n_states} states",
        )
    inside = (numbers >= 0) & (numbers < model.n_actions)
    if not inside.all():
        raise no_such("action", numbers[~inside][0], model.n_actions, where="policy")
    return {"space": space, "actions": model.actions, "rule": numbers.astype(np.int64)}


def by_time(model: MDP, table: Numbers, rest: float, *, of_actions: bool = False) -> Numbers:
    """Return a table (N, S) or (N, S, A) over times and states as one over all states.

    Where the model's first column is not the time, or the shape is another, the table is returned
    as it is. S are the states without their time, with or without the extra ones; time N, where
    all is over, may be there as well or not, and `rest` is put there.
    """
    untimed = model.space.untimed
    if untimed is None or table.ndim != 2 + of_actions:
        return table
    times, own = model.space.columns[0].size, untimed.regular
    over = bool(model.forced[(times - 1) * own :].all())
    steps = times - 1 if over else times
    if table.shape[0] not in (steps, times) or table.shape[1] not in (own, untimed.size):
        return table
    kind = table.dtype if float(rest).is_integer() else np.result_type(table.dtype, np.float64)
    spread = np.full((model.n_states, *table.shape[2:]), rest, dtype=kind)
    spread[: steps * own] = table[:steps, :own].reshape(-1, *table.shape[2:])
    return spread


def distinct(rows: Numbers) -> tuple[Numbers, Integers]:
    """Return the (U, K) different rows of (D, K), in order of appearance, and (D,) each row's."""
    fresh = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))[: len(rows)]
    known: dict[bytes, int] = {}
    number = [known.setdefault(row.tobytes(), len(known)) for row in rows[fresh]]
    which = np.array(number, dtype=np.int64)[np.cumsum(fresh) - 1]
    return rows[np.unique(which, return_index=True)[1]], which
