"""Models with named parameters, for sensitivity analysis.

A parametric model has named parameters with ranges, and gives the model at any values of them.
Along one parameter, with the others fixed, every transition probability and expected reward is a
polynomial of known degree between known breakpoints. Exact derivatives therefore come from exact
differences of a few models; a second, symbolic model is not needed.

When one probability of a row changes, the others must change with it. The rows of a scenario follow
from its rules. In any other row, the outcomes that are not named keep their proportions,

    p_j(θ) = p_j (1 - Σ θ) / (1 - Σ p),     sums over the named outcomes of the row.

The parameters of a plain MDP are its discount and its rewards, if there are few different rewards.
A reward other than 0 is named by its number (`reward.-1`). `moving` names others, and
probabilities.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from exact_mdp.mdp.care.toml import is_scenario
from exact_mdp.mdp.components import adds_up, require_amounts, with_outcome_amounts
from exact_mdp.mdp.errors import ModelError, check_names, locate_errors, require_type, suggest_name
from exact_mdp.mdp.forms.columns import table_of
from exact_mdp.mdp.forms.numbers import one_kind
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.questions.origin import Origin, origin_of
from exact_mdp.mdp.table import (
    Integers,
    Numbers,
    OutcomeTable,
    exact,
    format_beside_limits,
    format_rational,
)
from exact_mdp.mdp.validate import require_count

DISCOUNT = "discount"
# A plain MDP with more different rewards has none of them as parameters: a sensitivity analysis of
# more would be long to compute and to read.
MOST_REWARDS = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Parametric(ABC):
    """A family of models with the same states and pairs, one for each choice of parameters.

    Attributes
    ----------
    asks : tuple of functions
        Functions that turn each model into another, such as `attrgetter("maximised")`: the
        questions that are asked about it. A question replaces rows by constant rows and keeps the
        others, so no degree grows.
    """

    asks: tuple[Callable[[MDP], MDP], ...] = ()

    if TYPE_CHECKING:

        @property
        def name(self) -> str:
            """The name of the model."""

        @property
        def parameters(self) -> tuple[Parameter, ...]:
            """All parameters, with their values and ranges."""

    def at(self, values: Mapping[str, object]) -> MDP:
        """Return the model at other values of some parameters; the others keep their values.

        Raises ModelError for unknown names and values out of range.
        """
        moved = moved_from(self, values)
        mdp = self.own
        if moved:
            mdp = self.build_model(moved)
        for ask in self.asks:
            mdp = ask(mdp)
        return mdp

    @abstractmethod
    def build_model(self, moved: Mapping[str, Fraction]) -> MDP:
        """Return the model at values that differ from the present ones."""

    @cached_property
    def own(self) -> MDP:
        """The model at the present values."""
        return self.build_model({})

    def with_question(self, ask: Callable[[MDP], MDP]) -> Self:
        """Return the family with one more question about each of its models."""
        return replace(self, asks=(*self.asks, ask))

    @abstractmethod
    def degree(self, name: str) -> int:
        """Return the degree of rows and expected rewards in a parameter between breakpoints."""

    @abstractmethod
    def breakpoints(self, name: str) -> tuple[Fraction, ...]:
        """Return the values at which a row may change from one polynomial to another."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Family(Parametric):
    """A parametric model given by a function.

    Derivatives and thresholds depend on the degrees, which cannot be proven for a function. They
    are checked at further points: a degree that does not fit is refused, and results that depend on
    a degree that fits are called checked. The degrees of a scenario, and of a model with named
    entries (`moving`), are known.

    Attributes
    ----------
    parameters : tuple of Parameter
        Or {name: value}, for parameters without ranges.
    build : function
        From {parameter name: Fraction}, with all parameters, to the model.
    degrees : {name: degree}
        Degrees of transition probabilities, expected rewards and the discount; 1 by default.
    breaks : {name: breakpoints}
        Values at which the polynomials change; none by default.
    rows : {label: parameter names}
        Parameters that are probabilities of one row, which are drawn together.

    Examples
    --------
    >>> family = Family(
    ...     parameters=(Parameter(name="p", value=Fraction(1, 2)),),
    ...     build=lambda at: MDP.from_arrays([[[at["p"], 1 - at["p"]], [0, 1]]], [1, 0]),
    ... )
    >>> family.at({"p": "1/3"}).table.row(0)[0]
    (Fraction(1, 3), 0, Fraction(1, 1))
    >>> from exact_mdp import gradient  # V = 1 / (1 - p)
    >>> print(gradient(family)["p"].value)
    4 (checked: the degree holds at 7 points, and is not proven)
    """

    parameters: tuple[Parameter, ...]
    build: Callable[[Mapping[str, Fraction]], MDP]
    name: str = "model"
    degrees: Mapping[str, int] = field(default_factory=dict)
    breaks: Mapping[str, Sequence[Fraction]] = field(default_factory=dict)
    rows: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_names((self.name,), "model")
        require_type(
            self.build, Callable, "build", "give a function from {name: value} to the model"
        )
        for what in ("degrees", "breaks", "rows"):
            require_type(getattr(self, what), Mapping, what, "give a dictionary by the names")
        check_names(self.rows, "row", where="rows")
        degrees, breaks = {}, {}
        with locate_errors("degrees", instead=True):
            for name, degree in self.degrees.items():
                degrees[name] = require_count(degree, f"the degree in {name}", 0)
        for name, given in self.breaks.items():
            breaks[name] = _parse_numbers(given, f"breaks, {name}")
        parts = {
            "parameters": _read_parameters(self.parameters),
            "degrees": degrees,
            "breaks": breaks,
        }
        for what, part in parts.items():
            object.__setattr__(self, what, part)
        # Their names must be names of parameters.
        for what, names in (("degrees", [*degrees]), ("breaks", [*breaks])):
            for name in names:
                with locate_errors(what):
                    parameter_of(self, name)

    def build_model(self, moved: Mapping[str, Fraction]) -> MDP:
        """See `Parametric.build_model`."""
        built = self.build({**{p.name: p.value for p in self.parameters}, **moved})
        fix = "end it with: return MDP.from_arrays(P, R)"
        mdp: MDP = require_type(built, MDP, "what build returns", fix)
        return mdp

    def degree(self, name: str) -> int:
        """See `Parametric.degree`."""
        return self.degrees.get(parameter_of(self, name).name, 1)

    def breakpoints(self, name: str) -> tuple[Fraction, ...]:
        """See `Parametric.breakpoints`."""
        return tuple(self.breaks.get(parameter_of(self, name).name, ()))


def _read_parameters(given: Any) -> tuple[Parameter, ...]:
    """Return the parameters of a list, or of {name: value}."""
    if isinstance(given, Mapping):
        return tuple(Parameter(name=name, value=value) for name, value in given.items())
    if not isinstance(given, list | tuple) or not all(isinstance(p, Parameter) for p in given):
        raise ModelError(
            f"parameters are {given!r}",
            where="parameters",
            fix='give {name: value}, or a tuple of Parameter(name="p", value="1/2", low=0, high=1)',
        )
    check_names([parameter.name for parameter in given], "parameter", where="parameters")
    return tuple(given)


def _parse_numbers(numbers: Any, where: str) -> tuple[Fraction, ...]:
    """Return a list of numbers exactly."""
    with locate_errors(where):
        fix = "put the numbers in brackets"
        return tuple(map(exact, require_type(numbers, list | tuple | np.ndarray, "", fix)))


def parametric(source: Any) -> Parametric:
    """Return the parametric model of a scenario, or of a plain model with rewards and discount.

    Parameters
    ----------
    source : Scenario, MDP or Family
        Or the name or file of a scenario or model, as in `load`.

    Returns
    -------
    Family
        A given family is returned unchanged.

    Examples
    --------
    >>> [p.name for p in parametric(MDP.from_arrays([[[1]]], ["5/2"], "1/2")).parameters]
    ['reward.2.5', 'discount']
    """
    if isinstance(source, Parametric):
        return source
    if isinstance(source, str | Path):
        import exact_mdp

        if is_scenario(source):
            source = exact_mdp.Scenario.load(source)
        else:
            source = exact_mdp.load(source)
    if not isinstance(source, MDP):
        if not hasattr(source, "parametric"):
            fix = "give an MDP, a Scenario, or a Family of models"
            raise ModelError(f"{type(source).__name__} is not a model", where="model", fix=fix)
        family: Parametric = source.parametric()
        return family
    origin = origin_of(source)
    if origin is not None:
        return pose_questions(parametric(origin.model), origin)
    rewards = _name_rewards(source.table)
    if len(rewards) > MOST_REWARDS:
        rewards = {}
    return moving(source, {}, rewards)


def pose_questions(family: Parametric, origin: Origin) -> Parametric:
    """Return a family with the questions of an origin asked about each of its models."""
    for question in origin.questions:
        family = family.with_question(question)
    return family


def _list_rewards(table: OutcomeTable, most: float = inf) -> set[Fraction]:
    """Return the different rewards; not all of them if there are more than `most`."""
    bottom: Numbers = table.gain_denominator
    if len(table.gain) != len(bottom):
        bottom = np.repeat(bottom, np.diff(table.offsets))
    # Search block by block, and stop as soon as there are too many.
    rewards = set[Fraction]()
    for first in range(0, len(bottom), 2**12):
        here = slice(first, first + 2**12)
        ratios = set(zip(table.gain[here].tolist(), bottom[here].tolist(), strict=True))
        rewards |= {exact(top) / below for top, below in ratios}
        if len(rewards) > most:
            break
    return rewards


def _name_rewards(table: OutcomeTable) -> dict[str, Fraction]:
    """Return {name: reward} for the rewards other than 0; if there are many, only some of them."""
    rewards = _list_rewards(table, MOST_REWARDS + 1) - {0}
    names = {f"reward.{format_rational(reward)}": reward for reward in sorted(rewards)}
    # Rewards that differ in late digits only are named by their fractions.
    if len(names) < len(rewards):
        names = {f"reward.{reward}": reward for reward in sorted(rewards)}
    return names


def moving(
    model: MDP,
    entries: Mapping[str, Sequence[tuple[object, object]]],
    rewards: Mapping[str, object] | None = None,
) -> Family:
    """Return the family of a model with some probabilities, rewards and the discount as parameters.

    Parameters
    ----------
    model : MDP
    entries : {parameter name: [(pair, next state), …]}
        The entries whose probability the parameter is; they must be equal now. A pair is its number
        or (state, action); see `mdp.forms.names` for ways to name states and actions.
    rewards : {parameter name: number or "p/q"}, optional
        The reward that the parameter replaces, in all outcomes that earn it.

    Returns
    -------
    Family
        In it, the entries of a row that are not named share the remaining probability.

    Raises
    ------
    ModelError
        If entries of one parameter differ, all entries of a row are named, or no outcome earns a
        reward.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]], [1, 0, 0])
    >>> family = moving(mdp, {"loop": [(0, 0)]}, {"gain": 1})
    >>> [(str(p), str(r)) for p, _, r in family.at({"loop": "1/5", "gain": 3}).table.row(0)]
    [('1/5', '3'), ('2/5', '3'), ('2/5', '3')]
    """
    require_type(model, MDP, "model", "give an MDP")
    require_type(entries, Mapping, "entries", "give {name: [((state, action), next state), …]}")
    if entries:
        require_amounts(model.table, "a row that moves")
    if rewards is None:
        rewards = {}
    require_type(rewards, Mapping, "rewards", "give {name: reward}")
    # The parameters that are probabilities, and the named entries of each row.
    named: dict[int, dict[int, str]] = {}
    moved = []
    for name, listed in entries.items():
        places = _find_entries(model, listed, f"parameter {name}")
        values = set[Fraction]()
        for pair, state in places:
            row = model.table.row(pair)
            values.add(sum((p for p, following, _ in row if following == state), Fraction(0)))
        if len(values) != 1:
            raise ModelError(
                f"{len(values)} different probabilities",
                where=f"parameter {name}",
                fix="give entries that have the same probability, at least one",
            )
        for pair, state in places:
            if named.setdefault(pair, {}).setdefault(state, name) != name:
                raise ModelError(
                    "an entry is set by two parameters",
                    where=f"parameter {name}, {model.where(pair)}",
                    fix="give each entry to one parameter",
                )
        moved.append(Parameter(name=name, value=values.pop(), low=Fraction(0), high=Fraction(1)))
    # The greatest value of each, with the others fixed: the unnamed entries of its rows become 0.
    today = {parameter.name: parameter.value for parameter in moved}
    highest = dict.fromkeys(today, Fraction(1))
    for pair, names in named.items():
        total = sum((today[name] for name in names.values()), Fraction(0))
        if total >= 1 or not all(today[name] for name in names.values()):
            raise ModelError(
                "an entry has probability 0, or every entry of the row is named",
                where=model.where(pair),
                fix="name positive entries, and leave at least one of the row unnamed",
            )
        for name, count in Counter(names.values()).items():
            highest[name] = min(highest[name], today[name] + (1 - total) / count)
    earned = _match_rewards(model, rewards)
    gains = [Parameter(name=name, value=reward, unit="reward") for reward, name in earned.items()]
    rate = Parameter(name=DISCOUNT, value=model.discount_exact, low=Fraction(0), high=Fraction(1))
    origin = origin_of(model)
    # Terminal values are discounted in the rewards already: the discount is not a parameter then.
    parameters = [*moved, *gains]
    if origin is None or not origin.paid:
        parameters.append(rate)
    return Family(
        parameters=tuple(parameters),
        build=Moved(
            model=model, parameters=(*moved, *gains), named=named, earned=earned, highest=highest
        ),
        name=model.name or "model",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Moved:
    """The builder of `moving`; its rows have degree 1 in each parameter.

    Named entries are the parameters themselves, the other entries of a row share the remaining
    probability in fixed proportions, and a reward, or the discount, is a parameter or constant.
    """

    model: MDP
    parameters: tuple[Parameter, ...]  # all but the discount
    named: Mapping[int, Mapping[int, str]]  # {pair: {next state: parameter name}}
    earned: Mapping[Fraction, str]  # {reward: parameter name}
    highest: Mapping[str, Fraction]  # the greatest value of a probability, with the others fixed

    @cached_property
    def _amounts(self) -> dict[str, list[Fraction]]:
        """The amounts of each component of the reward by outcome; {} if only means are known.

        They are used if only probabilities change: after a change the reward is not the sum of its
        components.
        """
        table, names = self.model.table, self.model.component_names
        if table.components is None or table.averaged or not adds_up(table):
            return {}
        top, below = table.components, table.component_denominator
        if len(top) == table.pairs:
            top = top[table.pair]
        below = below[table.pair].tolist()
        amounts = {}
        for name, column in zip(names, top.T, strict=True):
            pairs = zip(column.tolist(), below, strict=True)
            amounts[name] = [exact(a) / b for a, b in pairs]
        return amounts

    @cached_property
    def _columns(self) -> tuple[Numbers, Numbers, Numbers]:
        """The next state, the exact probability and the exact reward of each outcome (N,)."""
        table = self.model.table
        chances, gains = np.empty((2, len(table.next)), dtype=object)
        for pair in range(table.pairs):
            here = slice(*table.offsets[pair : pair + 2].tolist())
            row = table.row(pair)
            chances[here] = [p for p, _, _ in row]
            gains[here] = [gain for _, _, gain in row]
        return np.asarray(table.next), chances, gains

    @cached_property
    def _rewarded(self) -> dict[Fraction, Integers]:
        """The outcomes that earn each reward with a name."""
        gains = self._columns[2]
        return {reward: np.flatnonzero(gains == reward) for reward in self.earned}

    def __call__(self, values: Mapping[str, Fraction]) -> MDP:
        """Return the model at values of all parameters."""
        model, rate = self.model, values.get(DISCOUNT, self.model.discount_exact)
        if all(values[p.name] == p.value for p in self.parameters):
            return model.with_(discount=rate)
        # Change the rows with named entries; an outcome of probability 0 is dropped.
        following, chances, gains = self._columns
        places, lengths = np.arange(len(following)), np.diff(model.table.offsets)
        if self.named:
            chances, kept = chances.copy(), np.ones(len(chances), dtype=bool)
            for pair in sorted(self.named):
                here = slice(*model.table.offsets[pair : pair + 2].tolist())
                chances[here] = self._move_row(pair, following[here], chances[here], values)
                kept[here] = chances[here] != 0
                lengths[pair] = kept[here].sum()
            places = places[kept]
        # Change the rewards.
        moved = {r: values[name] for r, name in self.earned.items() if values[name] != r}
        if moved:
            gains = gains.copy()
            for reward, value in moved.items():
                gains[self._rewarded[reward]] = value
        # The components of the outcomes that are left, unless rewards change.
        parts: dict[str, Any] = {}
        if not moved:
            for name, amounts in self._amounts.items():
                parts[name] = one_kind([amounts[place] for place in places.tolist()])
        table = table_of(
            np.append(0, np.cumsum(lengths)),
            following[places],
            chances[places],
            gains[places],
            model.n_states,
            {},
            parts,
            by_pair=False,
            own=True,
        )
        if model.table.components is None:  # mean rewards remain means
            table = replace(table, averaged=model.table.averaged)
        own: dict[str, Any] = {}
        if parts:
            table = with_outcome_amounts(table, parts)
            own["component_names"] = model.component_names
        return model.with_(table=table, discount=rate, events=(), **own)

    def _move_row(
        self, pair: int, following: Numbers, row: Numbers, values: Mapping[str, Fraction]
    ) -> list[Fraction]:
        """Return the new probabilities of a pair's outcomes; today they are `row`.

        Named entries have their values, and the others share the remaining probability.
        """
        names = self.named[pair]
        left = 1 - sum((values[name] for name in names.values()), Fraction(0))
        if left < 0:
            raise ModelError(
                "named probabilities sum to "
                f"{format_beside_limits(1 - left, Fraction(1))}, more than 1",
                where=self.model.where(pair),
                fix="choose smaller values",
            )
        # Several outcomes may lead to one next state; they keep their proportions as well.
        outcomes = list(zip(following.tolist(), row.tolist(), strict=True))
        rest = sum((p for to, p in outcomes if to not in names), Fraction(0))
        today = {parameter.name: parameter.value for parameter in self.parameters}
        factor = {to: values[name] / today[name] for to, name in names.items()}
        return [p * factor.get(to, left / rest) for to, p in outcomes]


def _find_entries(model: MDP, listed: Any, where: str) -> list[tuple[int, int]]:
    """Return the numbers of the pairs and next states of a list of entries."""
    places = []
    with locate_errors(where):
        for place in require_type(listed, Iterable, "", "give a list of (pair, next state)"):
            if not isinstance(place, list | tuple) or len(place) != 2:
                raise ModelError(f"an entry is {place!r}", fix="give (pair, next state)")
            pair, following = place
            if isinstance(pair, tuple | list) and len(pair) == 2:
                pair = model.pair(*pair)
            if not isinstance(pair, int | np.integer) or not 0 <= pair < model.n_pairs:
                raise ModelError(
                    f"there is no pair {pair!r}",
                    fix=f"give (state, action), or a number from 0 to {model.n_pairs - 1}",
                )
            places.append((int(pair), model.space.number(following)))
    return places


def _match_rewards(model: MDP, rewards: Mapping[str, object]) -> dict[Fraction, str]:
    """Return {reward: parameter name}; raise ModelError for a reward that no outcome earns."""
    named = {exact(reward): name for name, reward in rewards.items()}
    if not named:
        return {}
    known = _list_rewards(model.table)
    for reward, name in named.items():
        if reward not in known or len(named) != len(rewards):
            raise ModelError(
                f"no outcome earns {format_rational(reward)}, or two parameters set one reward",
                where=f"parameter {name}",
                fix="give each parameter a reward of the model",
            )
    return named


def place_of(model: Parametric) -> str:
    """Return the place of an error in a model: "model", with its name if it has one."""
    if model.name == "model":
        return "model"
    return f"model {model.name}"


def parameter_of(model: Parametric, name: str) -> Parameter:
    """Return a parameter by name; raise ModelError, with the most similar name, if unknown."""
    for parameter in model.parameters:
        if parameter.name == name:
            return parameter
    names = [parameter.name for parameter in model.parameters]
    fix = suggest_name(name, names)
    if fix.startswith("choose"):  # list the names: a user sees them nowhere else
        fix = f"choose one of {', '.join(names[:100])}"
        if len(names) > 100:
            fix += " …"
    if not names:
        fix = "the model has no parameters"
    if isinstance(model, Family) and isinstance(model.build, Moved):
        fix += (
            '; in Python name others yourself: moving(model, {"NAME": [((state, action), next '
            'state)]}, {"NAME": reward}), and give that as the model'
        )
    elif isinstance(model, Family):
        fix += "; or add it to parameters= of the Family, whose build gets its value"
    raise ModelError(f"unknown parameter {name!r}", where=place_of(model), fix=fix)


def room_of(model: Parametric, name: str) -> tuple[Fraction | None, Fraction | None]:
    """Return the lowest and the highest value of a parameter while the others are fixed."""
    parameter, build = parameter_of(model, name), getattr(model, "build", None)
    if isinstance(build, Moved):
        return parameter.low, build.highest.get(name, parameter.high)
    return parameter.low, parameter.high


def moved_from(model: Parametric, values: Mapping[str, object]) -> dict[str, Fraction]:
    """Return the values that differ from the present ones; raise ModelError if out of range."""
    require_type(values, Mapping, "values", "give {name: value}")
    numbers = {name: exact(value, f"parameter {name}") for name, value in values.items()}
    for name, number in numbers.items():
        parameter_of(model, name).check(number)
    today = {parameter.name: parameter.value for parameter in model.parameters}
    return {name: number for name, number in numbers.items() if number != today[name]}
