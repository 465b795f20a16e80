"""Reading a scenario from TOML: exact numbers, checked names, and a list of all problems.

Nested tables become dotted parameter names: `confusion = 0.08` in `[influence.anger]` is the
parameter `influence.anger.confusion`. Numbers may be written 0.08, 1 or "2/25". A missing influence
is 0; any other missing number, or an unknown name, is an error. `template.toml` explains each key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from exact_mdp.mdp.care.tables import (
    READINGS,
    SETTINGS,
    SHARED_WEIGHTS,
    SKIP,
    check_reading,
)
from exact_mdp.mdp.errors import ModelError, check_names, require_known_name, suggest_name
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.parameter import Parameter

V = TypeVar("V")
TABLES = ("base", "persistence", "influence", "assistance", "skip", "reward")
KEYS = (
    *("name", "title", "source", "statuses", "actions", "tasks", "max_trial", "discount"),
    *("readings", "status_weight", *TABLES),
)


def list_shipped_scenarios() -> list[str]:
    """Return the names of the scenarios in the package."""
    folder = files("exact_mdp.mdp") / "scenarios"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def is_scenario(name: str | Path) -> bool:
    """Return whether a text is the name of a shipped scenario, or of a scenario file."""
    return str(name) in list_shipped_scenarios() or Path(name).suffix.lower() == ".toml"


def read_scenario_parts(name: str | Path) -> dict[str, Any]:
    """Return the parts of a scenario, shipped or in a file; see `Scenario.load`."""
    where = str(name)
    if where.lower().endswith(".toml"):
        text = read_text(name, most=SMALL)
    elif where in list_shipped_scenarios():
        source = files("exact_mdp.mdp") / "scenarios" / f"{where}.toml"
        text = source.read_text(encoding="utf-8")
    else:
        raise ModelError(
            f"unknown scenario {where!r}",
            where="scenarios",
            fix=f"{suggest_name(where, list_shipped_scenarios())} "
            "(or give the path of a .toml file)",
        )
    reader = Reader(toml_of(text, where), Path(where).stem)
    for error in reader.problems:
        raise ModelError(error.what, where=f"{where}, {error.where}", fix=error.fix) from error
    return reader.parts


class Reader:
    """A reader of the content of a TOML file, with the parts of a scenario and a list of problems.

    The place of a problem is its key. If there are problems, parts may be missing.
    """

    def __init__(self, content: dict[str, Any], default_name: str) -> None:
        self.content, self.problems = content, list[ModelError]()
        # Single values.
        for key in content:
            self.read_part(key, require_known_name, key, KEYS, "key")
        self.parts: dict[str, Any] = {}
        for key, default in (("name", default_name), ("title", ""), ("source", "")):
            self.parts[key] = content.get(key, default)
            if not isinstance(self.parts[key], str):
                self._add_problem(key, f"{key} is not a string", "put it in quotes")
        for key, otherwise in (("tasks", ()), ("max_trial", "missing"), ("discount", 1)):
            self.parts[key] = self.read_part(key, SETTINGS[key], content.get(key, otherwise))
        # Readings: the first option of each is the default.
        readings: dict[str, Any] = {name: options[0] for name, options in READINGS.items()}
        for name, option in self._read_table("readings").items():
            checked = self.read_part(f"readings.{name}", check_reading, name, option)
            if name in READINGS:
                readings[name] = checked
        # Statuses and actions, on which the names of the parameters depend.
        statuses, actions = self._read_words("statuses"), self._read_words("actions")
        if SKIP in actions:
            self._add_problem("actions", f"an action is named {SKIP!r}", "choose another name")
        self.parts |= {"readings": readings, "statuses": statuses, "actions": actions}
        if statuses and actions:
            self._add_numbers(statuses, actions)

    def read_part(self, key: str, make: Callable[..., V], *given: Any) -> V | None:
        """Return `make(*given)`; record its ModelError as a problem of the key."""
        try:
            return make(*given)
        except ModelError as error:
            self._add_problem(key, error.what, error.fix)
            return None

    def _add_problem(self, key: str, what: str, fix: str) -> None:
        """Record a problem of a key."""
        self.problems.append(ModelError(what, where=key, fix=fix))

    def _add_numbers(self, statuses: tuple[str, ...], actions: tuple[str, ...]) -> None:
        """Add all parameters in the paper's order, and the `others` and `weights` of statuses."""
        weights = self._read_weights(statuses)
        flat = dict[str, Any]()
        for table in TABLES:
            flat |= _flatten_table(table, self._read_table(table))
        # Statuses whose persistence on a skip depends on another one.
        others = dict[str, Any]()
        for status in statuses:
            key = f"skip.{status}.other"
            if key in flat:
                options = [name for name in statuses if name != status]
                others[status] = self.read_part(
                    key, require_known_name, flat.pop(key), options, "other status"
                )
        # The names of all parameters that the scenario must have, and those that it may have.
        names, grid = _list_parameter_names(statuses, actions, weights, others, flat)
        possible = {**dict.fromkeys(names), **dict.fromkeys(grid)}
        for name in flat:
            self.read_part(name, require_known_name, name, possible, "number")
        parameters = []
        for name in names:
            table = name.partition(".")[0]
            if name not in flat and table != "influence":
                self._add_problem(name, f"the number {name} is missing", "state it")
                continue
            more: dict[str, Any] = {"low": 0, "high": 1}
            if table == "reward":
                more = {"unit": "reward"}
            make = partial(Parameter, name=name, value=flat.get(name, 0), **more)
            parameters.append(self.read_part(name, make))
        self.parts |= {"parameters": tuple(parameters), "others": others, "weights": weights}

    def _read_weights(self, statuses: tuple[str, ...]) -> dict[str, str]:
        """Return the name of the reward weight of each status."""
        given = self._read_table("status_weight")
        for status in given:
            self.read_part(
                f"status_weight.{status}", require_known_name, status, statuses, "status"
            )
        weights = {status: str(given.get(status, status)) for status in statuses}
        taken = [*weights.values(), *SHARED_WEIGHTS, "assist"]
        if len(set(taken)) != len(taken) or any("." in weight for weight in taken):
            self._add_problem(
                "status_weight",
                "two reward weights have the same name, or one has a dot in it",
                "give each status a weight name of its own",
            )
        return weights

    def _read_words(self, key: str) -> tuple[str, ...]:
        """Return a list of names; a list with a problem is read as empty."""
        words = self.content.get(key)
        listed = isinstance(words, list) and all(isinstance(word, str) and word for word in words)
        if not listed or not words or "." in "".join(words) or len(set(words)) != len(words):
            fix = 'write, for example, ["forgetfulness", "anger"], without dots'
            self._add_problem(key, f"{key} is not a list of different names", fix)
            return ()
        what = {"statuses": "status", "actions": "action"}[key]
        count = len(self.problems)
        self.read_part(key, check_names, words, what)
        if len(self.problems) > count:
            return ()
        return tuple(words)

    def _read_table(self, key: str) -> dict[str, Any]:
        """Return a table; anything else is a problem, and read as an empty table."""
        table = self.content.get(key, {})
        if isinstance(table, dict):
            return table
        self._add_problem(key, f"{key} is not a table", f"write it as [{key}]")
        return {}


def _list_parameter_names(
    statuses: tuple[str, ...],
    actions: tuple[str, ...],
    weights: Mapping[str, str],
    others: Mapping[str, Any],
    given: Mapping[str, Any],
) -> tuple[list[str], list[str]]:
    """Return the names of the parameters of a scenario, and all names of assistance.

    Assistance of an action for a status is a parameter only if the scenario has a number of it.
    """
    names, grid = list[str](), list[str]()
    for table in ("base", "persistence"):
        names += [f"{table}.{status}" for status in statuses]
    for row in statuses:
        names += [f"influence.{row}.{column}" for column in statuses if row != column]
    assisted = {name.rpartition(".")[0] for name in given}
    for action in actions:
        for status in statuses:
            table = f"assistance.{action}.{status}"
            both = [f"{table}.persistence", f"{table}.onset"]
            grid += both
            if table in assisted:
                names += both
    for status in statuses:
        if status in others:
            names += [f"skip.{status}.alone", f"skip.{status}.with-other"]
        else:
            names.append(f"skip.{status}.persistence")
    names += [f"reward.{weights[status]}" for status in statuses]
    names += [f"reward.{weight}" for weight in SHARED_WEIGHTS]
    names += [f"reward.assist.{action}" for action in actions]
    return names, grid


def _flatten_table(prefix: str, value: object) -> Iterator[tuple[str, object]]:
    """Yield the dotted name and the value of every number of a table."""
    if not isinstance(value, dict):
        yield prefix, value
        return
    for key, below in value.items():
        yield from _flatten_table(f"{prefix}.{key}", below)
