"""The tables of a care scenario: probabilities, weights, tasks and readings.

A person has n binary statuses. Under an action the next statuses are independent; status i is 1
with the probability

    p_i(s, a) = assistance.a.i.persistence or .onset        if action a has a table for status i,
                min(1, base_i + Σ_{j≠i, s_j=1} influence)   if it does not and s_i = 0,
                persistence_i                               if it does not and s_i = 1.

A trial that ends with every status 0 completes the subtask; after max_trial failed trials it is
skipped. The numbers and the rules follow Yuan et al. (2025), Tables 3 and 4 and Sections 2.1 and
3.2. If their text can be read in more than one way, a *reading* chooses one.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from exact_mdp.mdp.errors import ModelError, check_names, require_known_name
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.result import ROWS_SHOWN, plain_report
from exact_mdp.mdp.table import Integers, exact
from exact_mdp.mdp.validate import as_discount, require_count

if TYPE_CHECKING:
    from pandas import DataFrame


READINGS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "influence_orientation": ("row-to-column", "column-to-row"),
        "influence_on_present": ("none", "additive"),
        "status_cost": ("next", "current"),
        "trial_cost": ("every-trial", "failed-trials"),
        "max_trial_rule": ("at", "after"),
        "skip_timestep": ("same", "own"),
        "skip_onset": ("none", "base", "reset"),
        "task_bonus": ("always", "last-subtask-completed", "no-subtask-skipped"),
    }
)
"""All readings with their options, the default first."""

SKIP = "skip"
MAPPINGS = ("readings", "others", "weights")
SHARED_WEIGHTS = ("trial", "subtask-complete", "subtask-skip", "timestep", "task-complete")
BONUSES = ("subtask-complete", "task-complete")  # the weights that are gains; others are costs


@dataclass(frozen=True, kw_only=True)
class ScenarioTables:
    """The numbers, tasks and readings of a care scenario; the base class of `Scenario`.

    Attributes
    ----------
    statuses, actions : tuple of str
    tasks : tuple of int
        Number of subtasks of each task, in order.
    max_trial : int
        Trials allowed in a subtask (see reading `max_trial_rule`).
    discount : Fraction
    readings : mapping
        One option for each name in `READINGS`.
    parameters : tuple of Parameter
        All numbers of the tables.
    others : mapping
        For each status whose persistence on a skip depends on another status, that other status.
    weights : mapping
        For each status, the name of the reward weight to which it is charged.
    """

    name: str
    statuses: tuple[str, ...]
    actions: tuple[str, ...]
    tasks: tuple[int, ...]
    max_trial: int
    discount: Fraction
    readings: Mapping[str, str]
    parameters: tuple[Parameter, ...]
    others: Mapping[str, str]
    weights: Mapping[str, str]
    title: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        for mapping in MAPPINGS:
            object.__setattr__(self, mapping, MappingProxyType(dict(getattr(self, mapping))))
        check_scenario(self)

    def __repr__(self) -> str:
        parts = [
            f"{len(self.statuses)} statuses",
            f"{len(self.actions)} actions",
            f"tasks {list(self.tasks)}",
            f"max_trial {self.max_trial}",
            f"discount {self.discount}",
        ]
        own = [f"{n}={option}" for n, option in self.readings.items() if option != READINGS[n][0]]
        return f"Scenario({self.name}: {', '.join([*parts, *own])})"

    def frame(self) -> DataFrame:
        """Return the parameters as a table, with exact numbers.

        Returns
        -------
        DataFrame
            One row for each parameter: its name, value, lowest and highest value (None without a
            limit).

        Examples
        --------
        >>> from exact_mdp import Scenario
        >>> print(Scenario.load("yuan2025").frame().head(2).to_csv(index=False))
        parameter,value,low,high
        base.forgetfulness,3/10,0,1
        base.confusion,3/10,0,1
        """
        import pandas

        rows = [(each.name, each.value, each.low, each.high) for each in self.parameters]
        return pandas.DataFrame(rows, columns=["parameter", "value", "low", "high"], dtype=object)

    def _repr_html_(self) -> str:
        return plain_report(self, self.frame(), len(self.parameters)).html(ROWS_SHOWN)

    def __reduce__(self) -> tuple[Any, ...]:
        parts = {each.name: getattr(self, each.name) for each in fields(self)}
        views = {name: dict(parts[name]) for name in MAPPINGS}  # views cannot be pickled
        return partial(type(self), **parts | views), ()

    @property
    def trials(self) -> int:
        """Number of failed trials after which a subtask is skipped."""
        return self.max_trial + (self.readings["max_trial_rule"] == "after")

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the reward weights; these are the components of the reward."""
        charged = tuple(self.weights[status] for status in self.statuses)
        return (*charged, *SHARED_WEIGHTS, *(f"assist.{action}" for action in self.actions))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameter names."""
        return tuple(parameter.name for parameter in self.parameters)

    def values(self) -> dict[str, Fraction]:
        """Return the values of all parameters, {name: value}."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    def __getitem__(self, name: str) -> Fraction:
        return self.parameters[self._find_position(name)].value

    def _find_position(self, name: str) -> int:
        """Return the index of a parameter; raise ModelError if the name is unknown."""
        if name not in self.names:
            readings = (f"readings.{reading}" for reading in READINGS)
            require_known_name(
                name, [*self.names, *SETTINGS, *readings], "parameter", f"scenario {self.name}"
            )
        return self.names.index(name)

    def with_(
        self,
        *,
        readings: Mapping[str, str] | None = None,
        parameters: Mapping[str, object] | None = None,
        **changes: Any,
    ) -> Self:
        """Return a scenario with other readings, parameters, tasks, max_trial or discount.

        Parameters
        ----------
        readings : {reading: option}, optional
        parameters : {parameter name: number or "p/q"}, optional
        **changes
            `tasks`, `max_trial`, `discount`, or any parameter or `readings.NAME` by its dotted
            name (`**{"base.anger": "1/10"}`).

        Returns
        -------
        Scenario

        Raises
        ------
        ModelError
            For an unknown name (the most similar one is suggested) or a number out of range.
        """
        chosen, numbers, parts = dict(self.readings), list(self.parameters), dict[str, Any]()
        # All changes by name: settings, readings (`readings.NAME`) and parameters.
        given = {f"readings.{name}": option for name, option in (readings or {}).items()}
        for name, value in [*given.items(), *(parameters or {}).items(), *changes.items()]:
            reading = name.removeprefix("readings.")
            if reading in SETTINGS:
                parts[AS_READINGS.get(reading, reading)] = SETTINGS[reading](value)
            elif reading != name:
                chosen[reading] = check_reading(reading, value)
            else:
                position = self._find_position(name)
                number = exact(value, f"parameter {name}")
                numbers[position] = replace(numbers[position], value=number)
        return replace(self, readings=chosen, parameters=tuple(numbers), **parts)

    def set(self, assignment: str) -> Self:
        """Return a scenario with one change `KEY=VALUE`, as on the command line.

        Examples
        --------
        >>> from exact_mdp import Scenario
        >>> Scenario.load("yuan2025").set("tasks=[3,1]").tasks
        (3, 1)
        """
        key, equals, value = assignment.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise ModelError(
                f"{assignment!r} is not a setting", where="--set", fix="write KEY=VALUE"
            )
        return self.with_(parameters={key.strip(): value.strip()})


def bits_of(count: int) -> Integers:
    """Return the status vectors (2^n, n); the first status is the most significant bit."""
    return (np.arange(2**count)[:, None] >> np.arange(count - 1, -1, -1)) & 1


def as_tasks(value: object) -> tuple[int, ...]:
    """Return tasks from a list of positive integers, or its text "[3,1]"."""
    if isinstance(value, str):
        with suppress(ValueError, RecursionError):
            value = json.loads(value)
    listed: list[Any] = []
    if isinstance(value, Sequence) and not isinstance(value, str):
        listed = list(value)
    if listed and all(type(number) is int and number > 0 for number in listed):
        return tuple(listed)
    raise ModelError(
        "tasks is not a list of positive whole numbers, or is empty",
        where="tasks",
        fix="give the number of subtasks of each task, such as [3] or [3, 1]",
    )


def as_max_trial(value: object) -> int:
    """Return max_trial from a positive integer or its text."""
    if isinstance(value, str) and value.isascii() and value.isdigit():
        value = int(value[:20])  # 20 digits are too many in any case
    return require_count(value, "max_trial")


SETTINGS: dict[str, Callable[[object], Any]] = {
    "tasks": as_tasks,
    "max_trial": as_max_trial,
    "discount": as_discount,
    "evaluation_discount": as_discount,
}
"""Settings other than readings and parameters, with the function that converts each."""
AS_READINGS = {"evaluation_discount": "discount"}  # the name in the paper's readings


def check_reading(name: str, option: object) -> str:
    """Return the option; raise ModelError if the reading or the option is unknown."""
    require_known_name(name, READINGS, "reading", "readings")
    return require_known_name(option, READINGS[name], "option", f"reading {name}")


def check_scenario(scenario: ScenarioTables) -> None:
    """Raise ModelError unless the scenario's parts fit together."""
    check_names((scenario.name,), "scenario", where="name")
    check_names(scenario.statuses, "status", where="statuses")
    check_names(scenario.actions, "action", where="actions")
    check_names(scenario.weights.values(), "weight", where="status_weight")
    for key in ("title", "source"):
        text = getattr(scenario, key).replace("\n", "").replace("\t", "")
        check_names([text], key, where=key, longest=20_000)
    for key, convert in SETTINGS.items():
        convert(getattr(scenario, AS_READINGS.get(key, key)))
    for name in READINGS:
        check_reading(name, scenario.readings.get(name, ""))
    # Even the names and numbers of more states would not fit in memory.
    where, count = f"scenario {scenario.name}", len(scenario.statuses)
    states, most = sum(scenario.tasks) * scenario.trials * 2**count, 200_000_000
    if states > most:
        what = f"the model would have {states:,} states, more than {most:,}"
        raise ModelError(what, where=where, fix="use fewer subtasks, trials or statuses")
    # Each of the 2^10 vectors of 10 statuses may be followed by each: 10^6 transitions a trial.
    if count > 10:
        raise ModelError(f"{count} statuses, more than 10", where=where, fix="merge statuses")
