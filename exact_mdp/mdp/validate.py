"""What must hold of a model before anything is computed from it; every row is checked."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields
from fractions import Fraction
from math import inf
from operator import index
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import (
    DistributionError,
    ModelError,
    NegativeError,
    ShapeError,
    check_names,
    locate_errors,
    no_option,
    no_such,
    once_each,
    require_type,
    suggest_name,
)
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbers import as_given, convert_tensors, is_pandas_table, refuse_masked
from exact_mdp.mdp.forms.rows import put_right, rationalize_row
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    FLOAT_ROW_TOLERANCE,
    Integers,
    OutcomeTable,
    exact,
    format_beside_limits,
    format_rational,
    row_sums,
)

Flags = NDArray[np.bool_]
SENSES = ("max", "min")
LEFT = (
    FLOAT_ROW_TOLERANCE / 2
)  # rows that `mdp.forms.rows` settled miss 1 by rounding, others by more


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a model, as they are given and before they are checked; see `MDP`."""

    table: OutcomeTable
    pair_state: Integers
    pair_action: Integers
    _: KW_ONLY
    space: StateSpace
    actions: tuple[str, ...]
    discount_exact: Fraction = Fraction(1)
    start: tuple[tuple[int, Fraction], ...] = ((0, Fraction(1)),)
    component_names: tuple[str, ...] = ("reward",)
    events: tuple[str, ...] = ()
    name: str = ""
    parameters: tuple[Parameter, ...] = ()
    time_limit: int | None = None
    sense: str = "max"
    labels: Mapping[str, Flags] = field(default_factory=dict)
    goal: Flags | None = None
    target: Flags | None = None
    unreached: float = inf
    observations: Integers | None = None
    episodes: int | None = None
    float_probabilities: bool = False
    float_rewards: bool = False
    action_objects: tuple[Hashable, ...] = ()

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return self.space.size

    @property
    def n_actions(self) -> int:
        """Number of actions, A."""
        return len(self.actions)

    @property
    def n_pairs(self) -> int:
        """Number of available state-action pairs, L."""
        return len(self.pair_state)

    def where(self, pair: int) -> str:
        """Return the printed state and action of a pair, for messages."""
        state = self.space.place(int(self.pair_state[pair]))
        return f"{state}, action {self.actions[self.pair_action[pair]]}"


OPTIONS = ("discount", "start", "states", "actions", "components", "labels", "sense", "name")
"""What constructors are given by name; they take every other part of a model as well."""
KNOWN = {*OPTIONS, *(part.name for part in fields(Parts))}
COUNTED = {"observations": "make the model with MDP.from_transitions, which counts them"}


def check_options(names: Iterable[str], never: Mapping[str, str]) -> None:
    """Raise ModelError for a name that is none of a model's parts, or one of others, with a fix."""
    for name in names:
        if name in never:
            raise ModelError(f"there is no option {name}=", where="MDP", fix=never[name])
        if name not in KNOWN:
            raise no_option(name, OPTIONS, "MDP")


KINDS: dict[str, Any] = {
    "table": OutcomeTable,
    "pair_state": np.ndarray,
    "pair_action": np.ndarray,
    "space": StateSpace,
    "discount_exact": Fraction,
    **dict.fromkeys(("actions", "component_names", "events", "parameters", "start"), tuple),
    "action_objects": tuple,
    "observations": np.ndarray | None,
    "float_probabilities": bool,
    "float_rewards": bool,
}
"""Types of the parts that `MDP` itself takes; the others are converted, or checked by value."""


def check_model(model: Parts) -> None:
    """Raise ModelError, naming the place and the remedy, unless `model` is a finite MDP."""
    for name, kind in KINDS.items():
        wanted = str(getattr(kind, "__name__", kind)).rpartition(".")[2]
        require_type(getattr(model, name), kind, name, f"give a {wanted}")
    for parameter in model.parameters:
        require_type(parameter, Parameter, "parameters", "give a tuple of Parameter")
    check_names((model.name,), "model")
    check_names(model.actions, "action", where="actions")
    check_names(model.component_names, "component", where="reward components")
    check_names(model.events, "event", where="events")
    _check_sense(model)
    _check_pairs(model)
    _check_table(model)
    if not vars(model.table).get("sound", False):  # else each row was looked at when it was settled
        _check_rows(model)
    _check_observations(model)
    _check_start(model)
    _check_episodes(model)
    _check_discount(model.discount_exact)


def _check_sense(model: Parts) -> None:
    if model.sense not in SENSES:
        raise ModelError(
            f"the sense is {model.sense!r}",
            where="sense",
            fix=f"{suggest_name(str(model.sense), SENSES)}: rewards are maximised, costs minimised",
        )
    if model.unreached not in (inf, -inf):
        raise ModelError(
            f"a run that misses the goal is worth {model.unreached}",
            where="unreached",
            fix="give math.inf or -math.inf",
        )


def _check_observations(model: Parts) -> None:
    seen = model.observations
    if seen is None:
        return
    if seen.shape != (model.n_pairs,) or seen.dtype != np.int64 or seen.min() < 0:
        raise ModelError(
            f"observations of type {seen.dtype} and shape {seen.shape} for {model.n_pairs} pairs",
            where="observations",
            fix="give the number of observations of each pair, whole numbers from 0 up",
        )
    # A row that was counted has its counts over their sum.
    off = (seen > 0) & (seen != model.table.denominator)
    if model.table.weight.dtype != np.int64 or off.any():
        raise ModelError(
            "the probabilities are not counts over the observations",
            where="observations",
            fix="make the model with MDP.from_transitions",
        )


def as_labels(labels: object, space: StateSpace) -> dict[str, Flags]:
    """Return labels as read-only arrays (S,) of truth values by name."""
    if not isinstance(labels, Mapping):
        raise ModelError(
            f"labels are a {type(labels).__name__}",
            where="labels",
            fix="give {name: (S,) truth values}, or {name: states}",
        )
    check_names(map(str, labels), "label", where="labels")
    return {str(name): as_flags(values, space, f"label {name}") for name, values in labels.items()}


def as_flags(values: object, space: StateSpace, where: str) -> Flags:
    """Return one truth value for each state (S,), read-only; states may be named instead."""
    array, size = np.asarray(values), space.size
    if array.dtype != bool and not isinstance(values, Mapping):
        with locate_errors(where):
            array = np.isin(np.arange(size), _find_states(values, array, space))
    if array.shape != (size,) or array.dtype != bool:
        raise ModelError(
            f"an array of type {array.dtype} and shape {array.shape} for {size} states",
            where=where,
            fix="give one truth value (bool) for each state, or the numbers of some states",
        )
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    return array


def _find_states(values: object, array: NDArray[Any], space: StateSpace) -> Integers | list[int]:
    """Return the numbers of states that are named; an array, and only that, goes by numbers."""
    if array.shape == (space.size,) and array.dtype.kind in "iuf" and np.isin(array, (0, 1)).all():
        raise ModelError(
            f"noughts and ones for {space.size} states may be truth values, or numbers of states",
            fix="give one truth value, True or False, for each state; or a set of states: {0, 1}",
        )
    if isinstance(values, np.ndarray) and array.dtype.kind in "iu":
        outside = array[(array < 0) | (array >= space.size)]
        if len(outside):
            raise no_such("state", outside[0], space.size)
        return array
    alone = isinstance(values, tuple) and space.lookup.has_name(values)
    return [space.number(values)] if alone else space.numbers(values)


def require_count(number: object, where: str, least: int = 1) -> int:
    """Return a whole number as an int; raise ModelError for anything else and below the least."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < least:
        fix = f"give a whole number, {least} or more"
        raise ModelError(f"{where} is {number!r}", where=where, fix=fix)
    return int(number)


def as_discount(discount: object) -> Fraction:
    """Return a discount as an exact number in [0, 1]."""
    if discount is None:
        raise ModelError(
            "no discount is given, but None: not a number",
            where="discount",
            fix='give discount=0.95, or discount="19/20"; it is 1 where it is left out',
        )
    if type(discount) is float and 0 <= discount <= 1:
        return Fraction(discount)
    value = exact(discount, "discount")
    _check_discount(value)
    return value


def _check_discount(value: Fraction) -> None:
    if not 0 <= value.numerator <= value.denominator:
        raise ModelError(
            f"discount is {format_beside_limits(value, Fraction(0), Fraction(1))}, outside [0, 1]",
            where="discount",
            fix="choose a discount from 0 to 1: a rate of 3 % a step is the factor 100/103",
        )


def as_start(start: object, space: StateSpace) -> ByNumber:
    """Return an initial distribution from a state, {state: probability}, or a vector."""
    if start is None:
        return ByNumber([(0, Fraction(1))])
    start = convert_tensors(start)
    with locate_errors("start"):
        weights = dict(start) if isinstance(start, ByNumber) else numbers_by_state(start, space)
        if weights is None:
            weights = {space.number(start): 1}
        given = np.empty(len(weights), dtype=object)
        given[:] = [as_given(weight) for weight in weights.values()]
        chances = map(exact, rationalize_row(put_right(given, np.array([0, len(given)])).tolist()))
        pairs = sorted(zip(weights, chances, strict=True))
    return ByNumber((state, weight) for state, weight in pairs if weight != 0)


def numbers_by_state(numbers: Any, space: StateSpace) -> dict[int, Any] | None:
    """Return numbers by state from {state: number} or from a vector; None for anything else."""
    refuse_masked(numbers)
    if is_pandas_table(numbers) and numbers.ndim == 1:
        if numbers.index.nlevels > 1:
            raise ModelError(
                "a table has several levels of labels, whose order may be another one",
                fix="give {state: number}",
            )
        numbers = dict(zip(numbers.index, numbers, strict=True))
    if isinstance(numbers, Mapping):
        return _by_number(numbers, numbers.values(), space)
    if (isinstance(numbers, np.ndarray) and numbers.ndim == 1) or (
        isinstance(numbers, list | tuple) and not _is_state(numbers, space)
    ):
        if len(numbers) != space.size:
            raise ShapeError(
                f"{len(numbers)} entries for {space.size} states",
                fix="give one for each state, or name states: {state: number}",
            )
        return dict(enumerate(numbers))
    return None


def _by_number(states: object, numbers: Iterable[object], space: StateSpace) -> dict[int, Any]:
    return once_each(zip(space.numbers(states), numbers, strict=True), space.label)


def _is_state(given: object, space: StateSpace) -> bool:
    """Return whether a tuple is a state: column values, or the object that a state is."""
    if not isinstance(given, tuple):
        return False
    many = len(space.columns) > 1 and len(given) == len(space.columns)
    return many or any(each.objects for each in space.columns) or space.lookup.has_name(given)


def _check_pairs(model: Parts) -> None:
    state, action = model.pair_state, model.pair_action
    if state.shape != action.shape or state.ndim != 1:
        raise ShapeError(
            f"pair_state has shape {state.shape}, pair_action {action.shape}",
            where="pairs",
            fix="give one state and one action for each pair",
        )
    if not len(state):
        raise ModelError("a model without state-action pairs", where="pairs", fix="add a state")
    _in_range(state, model.n_states, "state", "pairs")
    _in_range(action, model.n_actions, "action", "pairs")
    ahead, level = state[1:] > state[:-1], state[1:] == state[:-1]
    if not (ahead | (level & (action[1:] > action[:-1]))).all():
        same = np.flatnonzero(level & (action[1:] == action[:-1]))
        if len(same):
            raise ModelError(
                "a state-action pair appears twice",
                where=model.where(int(same[0])),
                fix="merge the two rows, or drop one",
            )
        raise ModelError(
            "pairs are not sorted by state, then action",
            where="pairs",
            fix="use MDP.from_pairs, which sorts them",
        )
    # Sorted as they are, the states that have a pair show the first that has none; nothing is
    # counted by state, whose number may be a typing error beyond all memory.
    if np.count_nonzero(ahead) + 1 != model.n_states:
        present = state[np.flatnonzero(np.diff(state, prepend=-1))]
        gaps = np.flatnonzero(present != np.arange(len(present)))
        missing = int(gaps[0]) if len(gaps) else len(present)
        raise ModelError(
            "a state without action",
            where=model.space.place(missing),
            fix="add an action; a state where the process ends stays put with probability 1",
        )


def _check_table(model: Parts) -> None:
    """Raise ModelError unless the arrays of the table fit together, and hold finite numbers."""
    table = model.table
    misfit = _describe_misfit(table, model.n_pairs)
    if misfit:
        raise ModelError(
            misfit,
            where="outcome table",
            fix="use MDP.from_pairs or MDP.from_outcomes, which make the table",
        )
    _in_range(table.next, model.n_states, "next state", "transitions")
    for name, what in (("weight", "probability"), ("gain", "reward")):
        array = getattr(table, name)
        # NaN is its own least and greatest number.
        ends = [array.min(initial=0), array.max(initial=0)]
        if array.dtype == np.float64 and not np.isfinite(ends).all():
            place = int(np.flatnonzero(~np.isfinite(array))[0])
            raise (DistributionError if name == "weight" else ModelError)(
                f"a {what} is {array[place]}",
                where=model.where(_pair_of(table, place, len(array))),
                fix="give a finite number",
            )


def _describe_misfit(table: OutcomeTable, pairs: int) -> str:
    """Return what is wrong with the form of a table's arrays, or nothing."""
    outcomes, offsets = len(table.next), table.offsets
    lengths = {
        "offsets": {pairs + 1},
        "weight": {outcomes},
        "denominator": {pairs},
        "gain_denominator": {pairs},
        "gain": {outcomes, pairs},
        "event": {outcomes},
    }
    for name, allowed in lengths.items():
        array = getattr(table, name)
        if array is not None and (array.ndim != 1 or len(array) not in allowed):
            return f"{name} has shape {array.shape}, not ({min(allowed)},)"
    if offsets[0] != 0 or offsets[-1] != outcomes or (offsets[1:] < offsets[:-1]).any():
        return "offsets do not run from 0 to the number of outcomes"
    for name in ("weight", "gain", "denominator", "gain_denominator"):
        array = getattr(table, name)
        whole = array.dtype == object and {*map(type, array.tolist())} == {int}
        if not whole and array.dtype not in (np.int64, np.float64):
            return f"{name} holds numbers that are neither 64-bit or Python integers nor floats"
    if not min(table.denominator.min(), table.gain_denominator.min()) > 0:
        return "a denominator is not positive"
    if not table.rising:
        falls, pair = table.next[1:] < table.next[:-1], table.pair
        if (falls & (pair[1:] == pair[:-1])).any():
            return "outcomes of a pair are not sorted by next state"
    return ""


def _check_rows(model: Parts) -> None:
    table = model.table
    steps = np.diff(table.offsets)
    if steps.min() == 0:
        raise DistributionError(
            "transition probabilities sum to 0, not 1",
            where=model.where(int(np.flatnonzero(steps == 0)[0])),
            fix="add the outcomes of this pair; an action that is not available has no row, or the "
            "reward -inf in an array",
        )
    if not table.weight.min() > 0:
        index = int(np.flatnonzero(table.weight <= 0)[0])
        pair = _pair_of(table, index, len(table.next))
        weight = exact(table.weight[index]) / exact(table.denominator[pair])
        raise NegativeError(
            f"a probability is {format_rational(weight, 12)}",
            where=model.where(pair),
            fix="probabilities are positive; leave out those that are 0",
        )
    if table.weight.dtype == np.float64:
        with np.errstate(over="ignore"):  # infinity is not 1 either
            sums = np.add.reduceat(table.weight, table.offsets[:-1])
        wrong = ~(np.abs(sums - table.denominator) <= LEFT * table.denominator)
    else:
        sums = row_sums(table.weight, table.offsets)
        wrong = np.asarray(sums != table.denominator, dtype=bool)
    if wrong.any():
        pair = int(np.flatnonzero(wrong)[0])
        total = exact(sums[pair]) / exact(table.denominator[pair])
        off = total - 1
        near = f"1 {'+' if off > 0 else '-'} {format_rational(abs(off), 3)}"
        raise DistributionError(
            "transition probabilities sum to "
            f"{near if abs(off) < 1e-9 else format_rational(total, 12)}, "
            "not 1",
            where=model.where(pair),
            fix="add the missing outcome, or correct a probability in this row; divide rows of a "
            "short type, such as float16, by their sums in float64",
        )


def _check_start(model: Parts) -> None:
    if len(model.start) == 1:
        ((state, weight),) = model.start
        if 0 <= state < model.n_states and weight == 1:
            return
    states = [state for state, _ in model.start]
    weights = [weight for _, weight in model.start]
    if any(not 0 <= state < model.n_states for state in states) or len(set(states)) != len(states):
        raise ModelError(
            f"the start names a state twice, or one that does not exist: {states[:4]}",
            where="start",
            fix=f"choose states from 0 to {model.n_states - 1}, each once",
        )
    total = sum(weights, Fraction(0))
    if any(weight < 0 for weight in weights) or total != 1:
        raise DistributionError(
            f"start probabilities sum to {format_beside_limits(total, Fraction(1))}, not 1, "
            "or one is negative",
            where="start",
            fix="give a distribution over states",
        )


def _check_episodes(model: Parts) -> None:
    number = model.episodes
    if number is None:
        return
    if type(number) is not int or number < 1:
        raise ModelError(
            f"{number!r} episodes", where="episodes", fix="give a whole number from 1, or None"
        )
    if any((weight * number).denominator > 1 for _, weight in model.start):
        raise ModelError(
            f"the start probabilities are no shares of {number:,} episodes",
            where="episodes",
            fix="give episodes=None where the start was not counted",
        )


def _in_range(values: Integers, size: int, what: str, where: str) -> None:
    if len(values) and not 0 <= values.min() <= values.max() < size:
        bad = (values < 0) | (values >= size)
        raise no_such(what, values[np.flatnonzero(bad)[0]], size, where=where)


def _pair_of(table: OutcomeTable, index: int, length: int) -> int:
    if length == table.pairs != len(table.next):
        return index
    return int(np.searchsorted(table.offsets, index, side="right")) - 1


# ---- random numbers: always a seed or a generator that the caller gives -------------------------

RNG: TypeAlias = int | np.random.Generator


def seed_of(rng: RNG) -> int:
    """Return the whole number that a run starts from: the given one, or a draw of the generator.

    Runs, draws and workers get streams of their own from it by `SeedSequence.spawn`: results do
    not depend on the number of workers.
    """
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**63))
    try:
        seed = index(rng)
    except TypeError:
        seed = -1
    if seed < 0 or isinstance(rng, bool | np.bool_):
        raise ModelError(
            f"{rng!r} is not a source of random numbers",
            where="rng",
            fix="give a whole number from 0, or numpy.random.default_rng(7)",
        )
    return seed
