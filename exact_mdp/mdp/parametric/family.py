"""Models with named parameters: what a sensitivity analysis needs to know of them.

A parametric model says which numbers it has, within which ranges, and what the model is at other
values of them. Along one parameter, the others held, every transition probability and expected
reward is a polynomial of a known degree between known breakpoints, so that exact derivatives come
from exact differences of a few compiled models and no second model is needed.

When one probability of a row moves, the others make room: a scenario's rows follow from its rules;
in any other row, outcomes that are not named keep their proportions,

    p_j(θ) = p_j (1 - Σ θ) / (1 - Σ p),     sums over the named outcomes of the row.

A plain MDP has its discount and its rewards as parameters, each reward that differs from 0 by its
number (`reward.-1`), as long as there are few of them; `moving` names others, and probabilities.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, reduce
from itertools import chain
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
from exact_mdp.mdp.questions import Origin, origin_of
from exact_mdp.mdp.table import Numbers, OutcomeTable, exact, format_beside_limits, format_rational
from exact_mdp.mdp.validate import require_count

DISCOUNT = "discount"
MOST_REWARDS = 20  # of a plain MDP, that are parameters without being named
LISTED = 100  # names of parameters in a message


@dataclass(frozen=True, kw_only=True, eq=False)
class Parametric(ABC):
    """A family of models with the same states and pairs, one for each choice of parameters.

    Attributes
    ----------
    asks : tuple of functions
        Questions about each model, such as `attrgetter("maximised")`, whose answers are the models.
        The rows that a question replaces are constant, and others stay: no degree grows.
    """

    asks: tuple[Callable[[MDP], MDP], ...] = ()

    if TYPE_CHECKING:

        @property
        def name(self) -> str:
            """What the model is called."""

        @property
        def parameters(self) -> tuple[Parameter, ...]:
            """Every parameter with its value and the range that it may take."""

    def at(self, values: Mapping[str, object]) -> MDP:
        """Return the model at other values of some parameters; the others keep theirs.

        Raises ModelError for unknown names and values out of range.
        """
        moved = moved_from(self, values)
        return reduce(lambda mdp, ask: ask(mdp), self.asks, self.made(moved) if moved else self.own)

    @abstractmethod
    def made(self, moved: Mapping[str, Fraction]) -> MDP:
        """Return the model at values that differ from today's."""

    @cached_property
    def own(self) -> MDP:
        """The model at today's values."""
        return self.made({})

    def posed(self, ask: Callable[[MDP], MDP]) -> Self:
        """Return the family with one more question about each of its models."""
        return replace(self, asks=(*self.asks, ask))

    @abstractmethod
    def degree(self, name: str) -> int:
        """Return the degree of rows and expected rewards in a parameter between breakpoints."""

    @abstractmethod
    def breakpoints(self, name: str) -> tuple[Fraction, ...]:
        """Return the values at which a row may pass from one polynomial to another."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Family(Parametric):
    """A parametric model made of a function.

    Derivatives and thresholds rest on the degrees, which nothing proves of a function. They are
    checked at further points: a wrong one is refused, and what rests on a right one is called
    checked. Of a model with named entries (`moving`) and of a scenario the degrees are known.

    Attributes
    ----------
    parameters : tuple of Parameter
        Or {name: value}, numbers that may be any.
    build : function
        From {parameter name: Fraction}, all of them, to the model.
    degrees : {name: degree}
        Of transition probabilities, expected rewards and the discount; 1 where left out.
    breaks : {name: breakpoints}
        None where left out.
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
        with locate_errors("degrees", instead=True):
            degrees = {
                n: require_count(d, f"the degree in {n}", 0) for n, d in self.degrees.items()
            }
        breaks = {
            name: _parse_numbers(given, f"breaks, {name}") for name, given in self.breaks.items()
        }
        parts = {
            "parameters": _read_parameters(self.parameters),
            "degrees": degrees,
            "breaks": breaks,
        }
        for what, part in parts.items():
            object.__setattr__(self, what, part)
        for what, names in (("degrees", degrees), ("breaks", breaks)):
            for name in names:
                with locate_errors(what):
                    parameter_of(self, name)

    def made(self, moved: Mapping[str, Fraction]) -> MDP:
        """See `Parametric.made`."""
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
    """Return parameters that are given as such, or as {name: value}."""
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
    with locate_errors(where):
        fix = "put the numbers in brackets"
        return tuple(map(exact, require_type(numbers, list | tuple | np.ndarray, "", fix)))


def parametric(source: Any) -> Parametric:
    """Return what a scenario, or a plain model with its rewards and its discount, may vary.

    Parameters
    ----------
    source : Scenario, MDP or Family
        Or the name or file of one of the first two, as `load` takes it.

    Returns
    -------
    Family
        Or the family that was given.

    Examples
    --------
    >>> [p.name for p in parametric(MDP.from_arrays([[[1]]], ["5/2"], "1/2")).parameters]
    ['reward.2.5', 'discount']
    """
    if isinstance(source, Parametric):
        return source
    if isinstance(source, str | Path):
        import exact_mdp

        read = exact_mdp.Scenario.load if is_scenario(source) else exact_mdp.load
        source = read(source)
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
    return moving(source, {}, rewards if len(rewards) <= MOST_REWARDS else {})


def pose_questions(family: Parametric, origin: Origin) -> Parametric:
    """Return a family about each of whose models the questions of an origin are asked."""
    return reduce(lambda asked, question: asked.posed(question), origin.questions, family)


def _name_rewards(table: OutcomeTable) -> dict[str, Fraction]:
    """Return the rewards other than 0 by name; more than `MOST_REWARDS` where there are many."""
    bottom: Numbers = table.gain_denominator
    if len(table.gain) != len(bottom):
        bottom = np.repeat(bottom, np.diff(table.offsets))
    rewards: set[Fraction] = set()
    for first in range(0, len(bottom), 2**12):
        here = slice(first, first + 2**12)
        ratios = set(zip(table.gain[here].tolist(), bottom[here].tolist(), strict=True))
        rewards |= {exact(top) / below for top, below in ratios if top}
        if len(rewards) > MOST_REWARDS:
            break
    names = {f"reward.{format_rational(reward)}": reward for reward in sorted(rewards)}
    return names if len(names) == len(rewards) else {f"reward.{r}": r for r in sorted(rewards)}


def moving(
    model: MDP,
    entries: Mapping[str, Sequence[tuple[object, object]]],
    rewards: Mapping[str, object] | None = None,
) -> Family:
    """Return a model with probabilities of its rows and rewards as parameters, and its discount.

    Parameters
    ----------
    model : MDP
    entries : {parameter name: [(pair, next state), …]}
        The entries that a parameter sets, all of the same probability now. A pair is its number, or
        (state, action); `mdp.forms.names` says how states and actions are given.
    rewards : {parameter name: number or "p/q"}, optional
        The reward that a parameter sets wherever it is earned.

    Returns
    -------
    Family
        Entries that are not named share what the named ones of their row leave.

    Raises
    ------
    ModelError
        Where entries of one parameter differ, or a row has nothing left that could make room;
        where no outcome earns a reward.

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
    rewards = {} if rewards is None else rewards
    require_type(rewards, Mapping, "rewards", "give {name: reward}")
    named: dict[int, dict[int, str]] = {}
    moved = []
    for name, listed in entries.items():
        places = _find_entries(model, listed, f"parameter {name}")
        values = {_find_probability(model, pair, state) for pair, state in places}
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
    today = {parameter.name: parameter.value for parameter in moved}
    highest = dict.fromkeys(today, Fraction(1))
    for pair, names in named.items():
        total = sum((today[name] for name in names.values()), Fraction(0))
        if total >= 1 or not all(today[name] for name in names.values()):
            raise ModelError(
                "an entry has probability 0, or the named entries are all of a row",
                where=model.where(pair),
                fix="name positive entries, and leave at least one of the row unnamed",
            )
        for name, count in Counter(names.values()).items():
            highest[name] = min(highest[name], today[name] + (1 - total) / count)
    earned = _match_rewards(model, rewards)
    gains = [Parameter(name=name, value=reward, unit="reward") for reward, name in earned.items()]
    rate = Parameter(name=DISCOUNT, value=model.discount_exact, low=Fraction(0), high=Fraction(1))
    origin = origin_of(model)
    # Beside values at the horizon, which are discounted in its rewards, the discount does not move.
    rates = [] if origin is not None and origin.paid else [rate]
    return Family(
        parameters=(*moved, *gains, *rates),
        build=Moved(
            model=model, parameters=(*moved, *gains), named=named, earned=earned, highest=highest
        ),
        name=model.name or "model",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Moved:
    """The builder of `moving`, whose rows are of degree 1 in each parameter.

    Named entries are the parameters themselves, the others of their row share what is left in fixed
    proportions, and a reward, or the discount, is a parameter or constant.
    """

    model: MDP
    parameters: tuple[Parameter, ...]  # all but the discount
    named: Mapping[int, Mapping[int, str]]  # {pair: {next state: parameter name}}
    earned: Mapping[Fraction, str]  # {reward: parameter name}
    highest: Mapping[str, Fraction]  # that a probability may be while the others keep theirs

    @cached_property
    def _amounts(self) -> dict[str, list[Fraction]]:
        """The amounts of each component of the reward, by outcome; none where only means are known.

        A reward that moves is no longer the sum of its components, so that they are kept where
        probabilities move alone.
        """
        table, names = self.model.table, self.model.component_names
        if table.components is None or table.averaged or not adds_up(table):
            return {}
        top, below = table.components, table.component_denominator
        if len(top) == table.pairs:
            top = top[table.pair]
        below = below[table.pair].tolist()
        return {
            name: [exact(a) / b for a, b in zip(column.tolist(), below, strict=True)]
            for name, column in zip(names, top.T, strict=True)
        }

    def __call__(self, values: Mapping[str, Fraction]) -> MDP:
        """Return the model at values of all parameters."""
        model, rate = self.model, values.get(DISCOUNT, self.model.discount_exact)
        if all(values[p.name] == p.value for p in self.parameters):
            return model.with_(discount=rate)
        moved = {r: values[name] for r, name in self.earned.items() if values[name] != r}
        rows = [
            [
                (p, to, moved.get(gain, gain), place)
                for p, to, gain, place in self._move_row(pair, values)
            ]
            for pair in range(model.n_pairs)
        ]
        chances, following, gains, places = zip(*chain(*rows), strict=True)
        amounts = {} if moved else self._amounts
        parts: dict[str, Any] = {
            name: one_kind([own[place] for place in places]) for name, own in amounts.items()
        }
        table = table_of(
            np.cumsum([0, *map(len, rows)]),
            np.array(following, dtype=model.table.next.dtype),
            one_kind(chances),
            one_kind(gains),
            model.n_states,
            {},
            parts,
            by_pair=False,
            own=True,
        )
        if model.table.components is None:  # means of rewards stay means
            table = replace(table, averaged=model.table.averaged)
        own: dict[str, Any] = {}
        if parts:
            table = with_outcome_amounts(table, parts)
            own["component_names"] = model.component_names
        return model.with_(table=table, discount=rate, events=(), **own)

    def _move_row(
        self, pair: int, values: Mapping[str, Fraction]
    ) -> list[tuple[Fraction, int, Fraction, int]]:
        """Return the outcomes of a pair, named ones at their values, and their numbers."""
        first = int(self.model.table.offsets[pair])
        row = [(*outcome, first + k) for k, outcome in enumerate(self.model.table.row(pair))]
        names = self.named.get(pair, {})
        if not names:
            return row
        left = 1 - sum((values[name] for name in names.values()), Fraction(0))
        if left < 0:
            raise ModelError(
                "named probabilities sum to "
                f"{format_beside_limits(1 - left, Fraction(1))}, more than 1",
                where=self.model.where(pair),
                fix="choose smaller values",
            )
        rest = sum((p for p, to, _, _ in row if to not in names), Fraction(0))
        factor = {
            to: values[name] / _find_probability(self.model, pair, to) for to, name in names.items()
        }
        outcomes = [(factor.get(to, left / rest) * p, to, gain, k) for p, to, gain, k in row]
        return [outcome for outcome in outcomes if outcome[0]]


def _find_entries(model: MDP, listed: Any, where: str) -> list[tuple[int, int]]:
    """Return the numbers of entries that are given as pairs and next states."""
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
    """Return the names of rewards; raises ModelError for one that no outcome earns."""
    named = {exact(reward): name for name, reward in rewards.items()}
    if not named:
        return {}
    known = {gain for pair in range(model.n_pairs) for _, _, gain in model.table.row(pair)}
    for reward, name in named.items():
        if reward not in known or len(named) != len(rewards):
            raise ModelError(
                f"no outcome earns {format_rational(reward)}, or two parameters set one reward",
                where=f"parameter {name}",
                fix="give each parameter a reward of the model",
            )
    return named


def place_of(model: Parametric) -> str:
    """Return where an error in a model is, by its name where it has one."""
    return "model" if model.name == "model" else f"model {model.name}"


def parameter_of(model: Parametric, name: str) -> Parameter:
    """Return a parameter by name; raises ModelError, with the nearest name, for unknown ones."""
    for parameter in model.parameters:
        if parameter.name == name:
            return parameter
    names = [parameter.name for parameter in model.parameters]
    fix = suggest_name(name, names)
    if fix.startswith("choose"):  # no other place lists them
        fix = f"choose one of {', '.join(names[:LISTED])}{' …' * (len(names) > LISTED)}"
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
    """Return between which values a parameter may move while the others keep theirs."""
    parameter, build = parameter_of(model, name), getattr(model, "build", None)
    highest = build.highest if isinstance(build, Moved) else {}
    return parameter.low, highest.get(name, parameter.high)


def moved_from(model: Parametric, values: Mapping[str, object]) -> dict[str, Fraction]:
    """Return the values that differ from today's, each checked against its parameter's range."""
    require_type(values, Mapping, "values", "give {name: value}")
    numbers = {name: exact(value, f"parameter {name}") for name, value in values.items()}
    for name, number in numbers.items():
        parameter_of(model, name).check(number)
    today = {parameter.name: parameter.value for parameter in model.parameters}
    return {name: number for name, number in numbers.items() if number != today[name]}


def _find_probability(mdp: MDP, pair: int, state: int) -> Fraction:
    return sum((p for p, following, _ in mdp.table.row(pair) if following == state), Fraction(0))
