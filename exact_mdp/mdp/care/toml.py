"""Reading a scenario from TOML: every number exact, every name checked, every problem kept.

Tables flatten to parameter names: `[influence.anger]` `confusion = 0.08` is the parameter
`influence.anger.confusion`. Numbers may be written 0.08, 1 or "2/25". An influence that is left
out is 0; any other number that is missing, or a name that is not known, is an error.
`template.toml` explains each key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
    """Return the names of the scenarios that come with the package."""
    folder = files("exact_mdp.mdp") / "scenarios"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def is_scenario(name: str | Path) -> bool:
    """Return whether a text names a shipped scenario, or a file of one."""
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
    """The parts of a scenario by the content of a TOML file, and all that is wrong with it.

    The place of a problem is its key. Where there are problems, parts may be missing.
    """

    def __init__(self, content: dict[str, Any], default_name: str) -> None:
        self.content, self.problems = content, list[ModelError]()
        for key in content:
            self.read_part(key, require_known_name, key, KEYS, "key")
        self.parts: dict[str, Any] = {}
        for key, default in (("name", default_name), ("title", ""), ("source", "")):
            self.parts[key] = content.get(key, default)
            if not isinstance(self.parts[key], str):
                self._add_problem(key, f"{key} is not a string", "put it in quotes")
        for key, otherwise in (("tasks", ()), ("max_trial", "missing"), ("discount", 1)):
            self.parts[key] = self.read_part(key, SETTINGS[key], content.get(key, otherwise))
        chosen = {
            name: self.read_part(f"readings.{name}", check_reading, name, option)
            for name, option in self._read_table("readings").items()
        }
        readings = {name: chosen.get(name, options[0]) for name, options in READINGS.items()}
        statuses, actions = self._read_words("statuses"), self._read_words("actions")
        if SKIP in actions:
            self._add_problem("actions", f"an action is called {SKIP!r}", "choose another name")
        self.parts |= {"readings": readings, "statuses": statuses, "actions": actions}
        if statuses and actions:
            self._add_numbers(statuses, actions)

    def read_part(self, key: str, make: Callable[..., V], *given: Any) -> V | None:
        """Return `make(*given)`; keep a ModelError of it as a problem of a key."""
        try:
            return make(*given)
        except ModelError as error:
            self._add_problem(key, error.what, error.fix)
            return None

    def _add_problem(self, key: str, what: str, fix: str) -> None:
        self.problems.append(ModelError(what, where=key, fix=fix))

    def _add_numbers(self, statuses: tuple[str, ...], actions: tuple[str, ...]) -> None:
        """Add every parameter in the paper's order, and what goes by status."""
        weights = self._read_weights(statuses)
        flat = dict(
            pair for table in TABLES for pair in _flatten_table(table, self._read_table(table))
        )
        others = dict[str, Any]()
        for status in statuses:
            if (key := f"skip.{status}.other") in flat:
                options = [name for name in statuses if name != status]
                others[status] = self.read_part(
                    key, require_known_name, flat.pop(key), options, "other status"
                )
        rewards = [*(weights[status] for status in statuses), *SHARED_WEIGHTS]
        grid = [
            f"assistance.{action}.{status}.{rule}"
            for action in actions
            for status in statuses
            for rule in ("persistence", "onset")
        ]
        assisted = {name.rpartition(".")[0] for name in flat}
        skips = {s: ("alone", "with-other") if s in others else ("persistence",) for s in statuses}
        names = [
            *(f"{table}.{status}" for table in ("base", "persistence") for status in statuses),
            *(f"influence.{r}.{c}" for r in statuses for c in statuses if r != c),
            *(name for name in grid if name.rpartition(".")[0] in assisted),
            *(f"skip.{status}.{rule}" for status in statuses for rule in skips[status]),
            *(f"reward.{name}" for name in (*rewards, *(f"assist.{a}" for a in actions))),
        ]
        possible = {**dict.fromkeys(names), **dict.fromkeys(grid)}
        for name in flat:
            self.read_part(name, require_known_name, name, possible, "number")
        parameters = []
        for name in names:
            table = name.partition(".")[0]
            if name not in flat and table != "influence":
                self._add_problem(name, f"the number {name} is missing", "state it")
                continue
            more = {"unit": "reward"} if table == "reward" else {"low": 0, "high": 1}
            make = partial(Parameter, name=name, value=flat.get(name, 0), **more)
            parameters.append(self.read_part(name, make))
        self.parts |= {"parameters": tuple(parameters), "others": others, "weights": weights}

    def _read_weights(self, statuses: tuple[str, ...]) -> dict[str, str]:
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
        words = self.content.get(key)
        listed = isinstance(words, list) and all(isinstance(word, str) and word for word in words)
        if not listed or not words or "." in "".join(words) or len(set(words)) != len(words):
            fix = 'write, for example, ["forgetfulness", "anger"], without dots'
            self._add_problem(key, f"{key} is not a list of different names", fix)
            return ()
        what = {"statuses": "status", "actions": "action"}[key]
        count = len(self.problems)
        self.read_part(key, check_names, words, what)
        return tuple(words) if len(self.problems) == count else ()

    def _read_table(self, key: str) -> dict[str, Any]:
        """Return a table; one that is no table is a problem, and then empty."""
        table = self.content.get(key, {})
        if isinstance(table, dict):
            return table
        self._add_problem(key, f"{key} is not a table", f"write it as [{key}]")
        return {}


def _flatten_table(prefix: str, value: object) -> Iterator[tuple[str, object]]:
    """Yield every number of a table by its dotted name."""
    if not isinstance(value, dict):
        yield prefix, value
        return
    for key, below in value.items():
        yield from _flatten_table(f"{prefix}.{key}", below)
