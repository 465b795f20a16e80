"""Validation: every part of a model, and every row, is checked before use."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields
from fractions import Fraction
from functools import cached_property
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
    wrong_type,
)
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbers import as_given, convert_tensors, is_pandas_table, refuse_masked
from exact_mdp.mdp.forms.rows import put_right, rationalize_row
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.sense import Sense
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
# Rows of floats that `mdp.forms.rows` has normalized sum to 1 up to rounding; rows that it left
# alone miss 1 by the whole tolerance. Half of it separates the two.
LEFT = FLOAT_ROW_TOLERANCE / 2


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of a model before they are checked; see `MDP`."""

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
    sense: Sense = Sense.MAX
    labels: Mapping[str, Flags] = field(default_factory=dict)
    goal: Flags | None = None
    target: Flags | None = None
    unreached: float = inf
    observations: Integers | None = None
    episodes: int | None = None
    float_probabilities: bool = False
    float_rewards: bool = False
    action_objects: tuple[Hashable, ...] = ()

    @cached_property
    def n_states(self) -> int:
        """Number of states, S."""
        return self.space.size

    @cached_property
    def n_actions(self) -> int:
        """Number of actions, A."""
        return len(self.actions)

    @cached_property
    def n_pairs(self) -> int:
        """Number of available state-action pairs, L."""
        return len(self.pair_state)

    def where(self, pair: int) -> str:
        """Return the state and action of a pair, in words for messages."""
        state = self.space.place(int(self.pair_state[pair]))
        return f"{state}, action {self.actions[self.pair_action[pair]]}"


OPTIONS = ("discount", "start", "states", "actions", "components", "labels", "sense", "name")
"""Common options of the constructors, named in advice; every other part of a model is one too."""
KNOWN = {*OPTIONS, *(part.name for part in fields(Parts))}
COUNTED = {"observations": "make the model with MDP.from_transitions, which counts them"}


def check_options(names: Iterable[str], never: Mapping[str, str]) -> None:
    """Raise ModelError for an option that no model has, or that is in `never` {name: advice}."""
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
    # Types and names come first: all later checks, and their messages, rely on them.
    for name, kind in KINDS.items():
        given = getattr(model, name)
        if not isinstance(given, kind):
            wanted = str(getattr(kind, "__name__", kind)).rpartition(".")[2]
            raise wrong_type(given, name, f"give a {wanted}")
    for parameter in model.parameters:
        require_type(parameter, Parameter, "parameters", "give a tuple of Parameter")
    check_names((model.name,), "model")
    check_names(model.actions, "action", where="actions")
    check_names(model.component_names, "component", where="reward components")
    check_names(model.events, "event", where="events")
    _check_sense(model)
    _check_pairs(model)
    _check_table(model)
    # Rows of floats were checked when they were normalized.
    if not model.table.rows.sound:
        _check_rows(model)
    _check_observations(model)
    _check_start(model)
    _check_episodes(model)
    _check_discount(model.discount_exact)


def _check_sense(model: Parts) -> None:
    """Raise ModelError unless the sense is "max" or "min", and `unreached` infinite."""
    if model.sense not in list(Sense):
        near = suggest_name(str(model.sense), list(Sense))
        raise ModelError(
            f"the sense is {model.sense!r}",
            where="sense",
            fix=f"{near}: rewards are maximised, costs minimised",
        )
    if model.unreached not in (inf, -inf):
        raise ModelError(
            f"the value of a run that misses the goal is {model.unreached}",
            where="unreached",
            fix="give math.inf or -math.inf",
        )


def _check_observations(model: Parts) -> None:
    """Raise ModelError unless the rows are frequencies of the observations, if there are any."""
    seen = model.observations
    if seen is None:
        return
    if seen.shape != (model.n_pairs,) or seen.dtype != np.int64 or seen.min() < 0:
        raise ModelError(
            f"observations of type {seen.dtype} and shape {seen.shape} for {model.n_pairs} pairs",
            where="observations",
            fix="give the number of observations of each pair, whole numbers from 0 up",
        )
    # An observed row is its counts over their sum.
    off = (seen > 0) & (seen != model.table.denominator)
    if model.table.weight.dtype != np.int64 or off.any():
        raise ModelError(
            "the probabilities are not counts over the observations",
            where="observations",
            fix="make the model with MDP.from_transitions",
        )


def as_labels(labels: object, space: StateSpace) -> dict[str, Flags]:
    """Return the labels as read-only arrays (S,) of truth values, by name."""
    if not isinstance(labels, Mapping):
        raise ModelError(
            f"labels are a {type(labels).__name__}",
            where="labels",
            fix="give {name: (S,) truth values}, or {name: states}",
        )
    check_names(map(str, labels), "label", where="labels")
    return {str(name): as_flags(values, space, f"label {name}") for name, values in labels.items()}


def as_flags(values: object, space: StateSpace, where: str) -> Flags:
    """Return a read-only array (S,) of truth values, from such an array or a list of states."""
    array, size = np.asarray(values), space.size
    # Anything but truth values is a list of states, which are True.
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
    """Return the numbers of the states in a list; an array of integers holds state numbers."""
    # Zeros and ones, one for each state, could mean either: the user must say.
    if array.shape == (space.size,) and array.dtype.kind in "iuf" and np.isin(array, (0, 1)).all():
        raise ModelError(
            f"an array of 0s and 1s for {space.size} states is ambiguous: truth values, or state "
            "numbers?",
            fix="give one truth value, True or False, for each state; or a set of states: {0, 1}",
        )
    if isinstance(values, np.ndarray) and array.dtype.kind in "iu":
        outside = array[(array < 0) | (array >= space.size)]
        if len(outside):
            raise no_such("state", outside[0], space.size)
        return array
    # A tuple may itself be the name of one state.
    if isinstance(values, tuple) and space.lookup.has_name(values):
        return [space.number(values)]
    return space.numbers(values)


def require_count(number: object, where: str, least: int = 1) -> int:
    """Return a whole number as an int; raise ModelError for anything else or below `least`."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or number < least:
        fix = f"give a whole number, {least} or more"
        raise ModelError(f"{where} is {number!r}", where=where, fix=fix)
    return int(number)


def as_discount(discount: object) -> Fraction:
    """Return a discount as an exact number in [0, 1]."""
    if discount is None:
        raise ModelError(
            "the discount is None, which is not a number",
            where="discount",
            fix='give discount=0.95, or discount="19/20"; the default is 1',
        )
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


def as_share(given: object, name: str) -> Fraction:
    """Return a share above 0 and at most 1 as an exact number."""
    share = exact(given, name)
    if not 0 < share <= 1:
        raise ModelError(
            f"{name} is {format_rational(share)}", where=name, fix="choose from 0 to 1, not 0"
        )
    return share


def as_start(start: object, space: StateSpace) -> ByNumber:
    """Return the initial distribution for a state, {state: probability}, or a vector."""
    if start is None:
        return ByNumber([(0, Fraction(1))])
    start = convert_tensors(start)
    with locate_errors("start"):
        weights: dict[int, Any] | None
        if isinstance(start, ByNumber):
            weights = dict(start)
        else:
            space = _without_time(start, space)
            weights = numbers_by_state(start, space)
        if weights is None:  # a single state
            weights = {space.number(start): 1}
        # The probabilities are a row like any other: floats stand for rational numbers.
        given = np.array([as_given(weight) for weight in weights.values()], dtype=object)
        chances = map(exact, rationalize_row(put_right(given, np.array([0, len(given)])).tolist()))
        pairs = sorted(zip(weights, chances, strict=True))
    return ByNumber((state, weight) for state, weight in pairs if weight != 0)


def _without_time(start: object, space: StateSpace) -> StateSpace:
    """Return the space that names the states of a start: without the time, they are of time 0."""
    if space.untimed is None or not isinstance(start, str | tuple | Mapping):
        return space
    names = [*start] if isinstance(start, Mapping) else [start]
    at_first = StateSpace(columns=space.untimed.columns)  # which have the same numbers at time 0
    if not all(map(at_first.lookup.can_find, names)):
        return space
    for name in names:
        if space.lookup.can_find(name) and space.number(name) != at_first.number(name):
            own, other = (space.label(each.number(name)) for each in (space, at_first))
            what = f"{name!r} may be {own!r}, or {other!r}"
            raise ModelError(what, fix=f'write "{own}" or "{other}"')
    return at_first


def numbers_by_state(numbers: Any, space: StateSpace) -> dict[int, Any] | None:
    """Return {state number: number} for a mapping or a vector; None for anything else."""
    refuse_masked(numbers)
    if is_pandas_table(numbers) and numbers.ndim == 1:
        if numbers.index.nlevels > 1:
            raise ModelError(
                "the table has several levels of labels, and their order may differ from the "
                "model's",
                fix="give {state: number}",
            )
        numbers = dict(zip(numbers.index, numbers, strict=True))
    if isinstance(numbers, Mapping):
        return once_each(zip(space.numbers(numbers), numbers.values(), strict=True), space.label)
    vector = isinstance(numbers, np.ndarray) and numbers.ndim == 1
    listed = isinstance(numbers, list | tuple) and not _is_state(numbers, space)
    if vector or listed:
        if len(numbers) != space.size:
            raise ShapeError(
                f"{len(numbers)} entries for {space.size} states",
                fix="give one number for each state, or {state: number}",
            )
        return dict(enumerate(numbers))
    return None


def _is_state(given: object, space: StateSpace) -> bool:
    """Return whether `given` is a tuple that names a state: column values, or an object."""
    if not isinstance(given, tuple):
        return False
    if len(given) == len(space.columns) > 1:
        return True
    return any(each.objects for each in space.columns) or space.lookup.has_name(given)


def _check_pairs(model: Parts) -> None:
    """Raise ModelError unless pairs are in range, sorted, unique, and one at least per state."""
    state, action = model.pair_state, model.pair_action
    if state.shape != action.shape or state.ndim != 1:
        raise ShapeError(
            f"pair_state has shape {state.shape}, pair_action {action.shape}",
            where="pairs",
            fix="give one state and one action for each pair",
        )
    if not len(state):
        raise ModelError("the model has no state-action pair", where="pairs", fix="add a state")
    _in_range(state, model.n_states, "state", "pairs")
    _in_range(action, model.n_actions, "action", "pairs")
    # Compare each pair with the one before: a later state, or the same state and a later action.
    next_state, same_state = state[1:] > state[:-1], state[1:] == state[:-1]
    if not (next_state | (same_state & (action[1:] > action[:-1]))).all():
        same = np.flatnonzero(same_state & (action[1:] == action[:-1]))
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
    # The pairs are sorted, so a jump in their states shows a state without a pair. No array of
    # length S is made: S may be a typing error that no memory could hold.
    if np.count_nonzero(next_state) + 1 != model.n_states:
        present = state[np.flatnonzero(np.diff(state, prepend=-1))]
        gaps = np.flatnonzero(present != np.arange(len(present)))
        missing = len(present)
        if len(gaps):
            missing = int(gaps[0])
        raise ModelError(
            "a state has no action",
            where=model.space.place(missing),
            fix="add an action; a state where the process ends stays put with probability 1",
        )


def _check_table(model: Parts) -> None:
    """Raise ModelError unless the arrays of the table fit together and hold finite numbers."""
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
        if name == "weight" and table.rows.sound:
            continue
        array = getattr(table, name)
        # NaN and infinity show in the minimum or the maximum, without another array.
        ends = [array.min(initial=0), array.max(initial=0)]
        if array.dtype == np.float64 and not np.isfinite(ends).all():
            place = int(np.flatnonzero(~np.isfinite(array))[0])
            kind = {"weight": DistributionError, "gain": ModelError}[name]
            raise kind(
                f"a {what} is {array[place]}",
                where=model.where(_pair_of(table, place, len(array))),
                fix="give a finite number",
            )


def _describe_misfit(table: OutcomeTable, pairs: int) -> str:
    """Return a message that says how the arrays of a table do not fit together, or ""."""
    # Each array has the length N of the outcomes or the length L of the pairs.
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
    # Numbers are 64-bit integers, Python integers of any size, or floats.
    for name in ("weight", "gain", "denominator", "gain_denominator"):
        array = getattr(table, name)
        whole = array.dtype == object and {*map(type, array.tolist())} == {int}
        if not whole and array.dtype not in (np.int64, np.float64):
            return f"{name} holds numbers that are neither 64-bit or Python integers nor floats"
    if not min(table.denominator.min(), table.gain_denominator.min()) > 0:
        return "a denominator is not positive"
    # Strictly rising next states are sorted; otherwise equal neighbours are allowed, falls are not.
    if not table.rows.rising:
        falls, pair = table.next[1:] < table.next[:-1], table.pair
        if (falls & (pair[1:] == pair[:-1])).any():
            return "outcomes of a pair are not sorted by next state"
    return ""


def _check_rows(model: Parts) -> None:
    """Raise an error unless each row has positive probabilities that sum to 1."""
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
            fix="probabilities are positive; leave out outcomes with probability 0",
        )
    # Integers must sum to the denominator exactly; floats may miss it by rounding.
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
        raise DistributionError(
            f"transition probabilities sum to {_format_sum(total)}, not 1",
            where=model.where(pair),
            fix="add the missing outcome, or correct a probability in this row; divide rows of a "
            "short type, such as float16, by their sums in float64",
        )


def _format_sum(total: Fraction) -> str:
    """Return a sum other than 1 in words; a sum that would print as 1 by its distance from 1."""
    off = total - 1
    if abs(off) >= 1e-9:
        return format_rational(total, 12)
    if off > 0:
        return f"1 + {format_rational(off, 3)}"
    return f"1 - {format_rational(-off, 3)}"


def _check_start(model: Parts) -> None:
    """Raise an error unless the start is a distribution over states, each named once."""
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
    """Raise ModelError unless each start probability is a count over the number of episodes."""
    number = model.episodes
    if number is None:
        return
    if type(number) is not int or number < 1:
        raise ModelError(
            f"{number!r} episodes", where="episodes", fix="give a whole number from 1, or None"
        )
    if any((weight * number).denominator > 1 for _, weight in model.start):
        raise ModelError(
            f"the start probabilities are not counts over {number:,} episodes",
            where="episodes",
            fix="give episodes=None if the start was not counted from episodes",
        )


def _in_range(values: Integers, size: int, what: str, where: str) -> None:
    """Raise ModelError for the first value outside 0 … size-1."""
    if len(values) and not 0 <= values.min() <= values.max() < size:
        bad = (values < 0) | (values >= size)
        raise no_such(what, values[np.flatnonzero(bad)[0]], size, where=where)


def _pair_of(table: OutcomeTable, index: int, length: int) -> int:
    """Return the pair of entry `index` of an array with one entry per pair or per outcome."""
    if length == table.pairs != len(table.next):
        return index
    return int(np.searchsorted(table.offsets, index, side="right")) - 1


# ---- random numbers: the caller always gives a seed or a generator -------------------------------

RNG: TypeAlias = int | np.random.Generator


def seed_of(rng: RNG) -> int:
    """Return the seed of a run: the given whole number, or a number drawn from the generator.

    Runs, draws and workers get streams of their own from it by `SeedSequence.spawn`, so results
    do not depend on the number of workers.
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
