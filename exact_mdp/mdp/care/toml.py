"""Reading a scenario from TOML: every number exact, every name checked, every problem kept.

Tables flatten to parameter names: `[influence.anger]` `confusion = 0.08` is the parameter
`influence.anger.confusion`. Numbers may be written 0.08, 1 or "2/25". An influence that is left
out is 0; any other number that is missing, or a name that is not known, is an error.
`template.toml` explains each key.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from fractions import Fraction
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from exact_mdp.mdp.care.tables import (
    READINGS,
    SHARED_WEIGHTS,
    SKIP,
    Tables,
    as_max_trial,
    as_tasks,
    check_reading,
)
from exact_mdp.mdp.errors import LONGEST, ModelError, check_names, known, shown_text, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import as_discount

V = TypeVar("V")
TABLES: Mapping[str, str] = {
    "base": "STATUS = probability that it appears without assistance.",
    "persistence": "STATUS = probability that it stays without assistance.",
    "influence": "[influence.ROW] STATUS = what a present ROW adds to the probability of STATUS; "
    "left out means 0.",
    "assistance": "[assistance.ACTION.STATUS] persistence and onset of STATUS under ACTION; left "
    "out means as without assistance.",
    "skip": "[skip.STATUS] persistence when a subtask is skipped; or other, alone and with-other.",
    "reward": "A weight for each status, trial, subtask-complete, subtask-skip, timestep and "
    "task-complete; [reward.assist] one for each action.",
}
KEYS: Mapping[str, str] = {
    "name": "Name of the scenario; that of the file unless given.",
    "title": "What the scenario is, in one line.",
    "source": "Where the numbers come from.",
    "statuses": "Names of the statuses; each is present or absent.",
    "actions": "Names of the actions.",
    "tasks": "Number of subtasks of each task, in order.",
    "max_trial": "Trials allowed in a subtask before it is skipped.",
    "discount": "From 0 to 1; 1 unless given.",
    "readings": "How open points of the paper's text are read.",
    "status_weight": "STATUS = name of the weight that it is charged to; its own unless given.",
    **TABLES,
}
"""Every key of a scenario file with its meaning: the one list of them, which the docs show."""


def shipped() -> list[str]:
    """Return the names of the scenarios that come with the package."""
    folder = files("exact_mdp.mdp") / "scenarios"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def load(name: str | Path) -> Tables:
    """Return what a shipped scenario, or that of a file, states; see `Scenario.load`."""
    where = str(name)
    if where.lower().endswith(".toml"):
        text = read_text(name, most=SMALL)
    elif where in shipped():
        source = files("exact_mdp.mdp") / "scenarios" / f"{where}.toml"
        text = source.read_text(encoding="utf-8")
    else:
        raise ModelError(
            f"unknown scenario {where!r}",
            where="scenarios",
            fix=f"{suggest(where, shipped())} (or give the path of a .toml file)",
        )
    reader = Reader(toml_of(text, where))
    tables = reader.read(default_name=Path(where).stem)
    for _, error in reader.problems:
        place = f"{where}, {error.where}" if error.where else where
        raise ModelError(error.what, where=place, fix=error.fix) from error
    assert tables is not None
    return tables


class Reader:
    """What the content of a TOML file states, and all that is wrong with it, by key."""

    def __init__(self, content: dict[str, Any]) -> None:
        self.content = content
        self.problems: list[tuple[str, ModelError]] = []

    def take(self, key: str, make: Callable[..., V], *given: Any, otherwise: V) -> V:
        """Return `make(*given)`; keep a ModelError of it as a problem of a key."""
        try:
            return make(*given)
        except ModelError as error:
            placed = ModelError(error.what, where=error.where or key, fix=error.fix)
            self.problems.append((key, placed))
            return otherwise

    def read(self, *, default_name: str) -> Tables | None:
        """Return the tables; where there are problems, some without what they are about, or None.

        What cannot be read is taken as 0, or as the least that it may be.
        """
        for key in list(self.content):
            if not self.take(key, known, key, KEYS, "key", "top level", otherwise=""):
                meant = _meant(key, [k for k in TABLES if k not in self.content])
                self.content |= dict.fromkeys(meant, self.content[key])
        statuses, actions = self._words("statuses"), self._words("actions")
        if SKIP in actions:
            self._add("actions", f"an action is called {SKIP!r}", "choose another name")
        readings = {name: options[0] for name, options in READINGS.items()}
        for name, option in self._table("readings").items():
            first = READINGS.get(name, ("",))[0]
            readings[name] = self.take(
                f"readings.{name}", check_reading, name, option, otherwise=first
            )
        settings: dict[str, Any] = {
            key: self.take(key, _text, self.content, key, default, otherwise=default)
            for key, default in (("name", default_name), ("title", ""), ("source", ""))
        }
        others: Any = (
            ("tasks", as_tasks, (), (1,)),
            ("max_trial", as_max_trial, "missing", 1),
            ("discount", as_discount, 1, Fraction(1)),
        )
        for key, convert, default, otherwise in others:
            given = self.content.get(key, default)
            settings[key] = self.take(key, convert, given, otherwise=otherwise)
        if not statuses or not actions:
            return None
        weights = self._weights(statuses)
        others, flat = self._flatten(statuses)
        make = partial(
            Tables,
            **settings,
            statuses=statuses,
            actions=actions,
            readings={name: readings[name] for name in READINGS},
            parameters=self._parameters(flat, self._names(statuses, actions, others, weights)),
            others=others,
            weights=weights,
        )
        return self.take("", make, otherwise=None)

    def _add(self, key: str, what: str, fix: str, where: str = "") -> None:
        self.problems.append((key, ModelError(what, where=where or key, fix=fix)))

    def _parameters(
        self, flat: Mapping[str, Fraction], wanted: Mapping[str, dict[str, Any]]
    ) -> tuple[Parameter, ...]:
        missing = [n for n in wanted if n not in flat and not n.startswith("influence.")]
        refused = {key for key, _ in self.problems}
        for name in flat:
            table, *parts = name.split(".")
            if self.take(name, known, name, wanted, "number", table, otherwise=""):
                continue
            above = {".".join((table, *parts[:count])) for count in range(3)}
            for meant in [] if above & refused else _slip(name, missing):
                missing.remove(meant)
        for name in missing:
            table = name.partition(".")[0]
            self._add(name, f"the number {name} is missing", "state it", table)
        nothing = Fraction(0)
        return tuple(
            self.take(
                name,
                partial(Parameter, name=name, value=flat.get(name, nothing), **more),
                otherwise=Parameter(name=name, value=nothing, **more),
            )
            for name, more in wanted.items()
        )

    def _names(
        self,
        statuses: tuple[str, ...],
        actions: tuple[str, ...],
        others: Mapping[str, str],
        weights: Mapping[str, str],
    ) -> dict[str, dict[str, Any]]:
        """Return every parameter of the scenario, with its range or unit, in the paper's order."""
        assistance: dict[str, list[str]] = {}
        for action in self._table("assistance"):
            key = f"assistance.{action}"
            if self.take(key, known, action, actions, "action", "assistance", otherwise=""):
                assistance[action] = list(self._table("assistance", action))
            for status in assistance.get(action, ()):
                self.take(f"{key}.{status}", known, status, statuses, "status", key, otherwise="")
        names = [f"{table}.{status}" for table in ("base", "persistence") for status in statuses]
        names += [f"influence.{r}.{c}" for r in statuses for c in statuses if r != c]
        for action in actions:
            for status in statuses:
                if status in assistance.get(action, ()):
                    rule = f"assistance.{action}.{status}"
                    names += [f"{rule}.persistence", f"{rule}.onset"]
        for status in statuses:
            rules = ("alone", "with-other") if status in others else ("persistence",)
            names += [f"skip.{status}.{rule}" for rule in rules]
        rewards = [*(weights[status] for status in statuses), *SHARED_WEIGHTS]
        rewards += [f"assist.{action}" for action in actions]
        return {
            **{name: {"low": 0, "high": 1} for name in names},
            **{f"reward.{weight}": {"unit": "reward"} for weight in rewards},
        }

    def _flatten(self, statuses: tuple[str, ...]) -> tuple[dict[str, str], dict[str, Fraction]]:
        """Return the `other` statuses of the skip rules, and every number by its dotted name."""
        others: dict[str, str] = {}
        flat: dict[str, Fraction] = {}

        def visit(prefix: str, value: object) -> None:
            parts = prefix.split(".")
            if isinstance(value, dict):
                for key, below in value.items():
                    visit(f"{prefix}.{key}", below)
            elif parts[0] == "skip" and parts[-1] == "other" and len(parts) == 3:
                options = [name for name in statuses if name != parts[1]]
                given = (parts[1], str(value), options if parts[1] in statuses else [])
                other = self.take(prefix, _other, *given, otherwise=(*options, "")[0])
                if other:
                    others[parts[1]] = other
            else:
                flat[prefix] = self.take(prefix, exact, value, otherwise=Fraction(0))

        for table in TABLES:
            visit(table, self._table(table))
        return others, flat

    def _weights(self, statuses: tuple[str, ...]) -> dict[str, str]:
        given = self._table("status_weight")
        for status in given:
            key = f"status_weight.{status}"
            self.take(key, known, status, statuses, "status", "status_weight", otherwise="")
        weights = {
            status: self._plain(f"status_weight.{status}", str(given.get(status, status)))
            for status in statuses
        }
        taken = [*weights.values(), *SHARED_WEIGHTS, "assist"]
        if len(set(taken)) != len(taken) or any("." in weight for weight in taken):
            self._add(
                "status_weight",
                "two reward weights have the same name, or one has a dot in it",
                "give each status a weight name of its own",
            )
        return weights

    def _words(self, key: str) -> tuple[str, ...]:
        words = self.content.get(key)
        listed = isinstance(words, list) and all(isinstance(word, str) and word for word in words)
        if not listed or not words or "." in "".join(words) or len(set(words)) != len(words):
            fix = 'write, for example, ["forgetfulness", "anger"], without dots'
            self._add(key, f"{key} is not a list of different names", fix)
            return ()
        return tuple(dict.fromkeys(self._plain(key, word) for word in words))

    def _plain(self, key: str, word: str) -> str:
        """Return a name; of one that is unsafe or too long, which is a problem, its beginning."""
        what = {"statuses": "status", "actions": "action"}.get(key, "weight")
        check = partial(check_names, [word], what, where=key)
        count = len(self.problems)
        self.take(key, check, otherwise=None)
        return word if len(self.problems) == count else shown_text(word)[:40]

    def _table(self, *path: str) -> dict[str, Any]:
        """Return the table at a path; one that is no table is a problem once, and then empty."""
        key, within = ".".join(path), self.content
        for part in path[:-1]:
            within = within[part]
        table = within.get(path[-1], {})
        if isinstance(table, dict):
            return table
        self._add(key, f"{key} is not a table", f"write it as [{key}]")
        within[path[-1]] = {}
        return {}


def _meant(name: str, missing: Collection[str]) -> list[str]:
    """Return the missing word that an unknown one is a slip for, if any."""
    return get_close_matches(name[:LONGEST], missing, n=1, cutoff=0.6)


def _slip(name: str, missing: Collection[str]) -> list[str]:
    """Return the missing number that an unknown one is a slip for: one part of its name is."""
    parts = name.split(".")
    for number, part in enumerate(parts[1:], start=1):
        here = ".".join(parts[:number]) + "."
        end = "".join(f".{each}" for each in parts[number + 1 :])
        least = len(here) + len(end)
        options = {
            each[len(here) : len(each) - len(end)]: each
            for each in missing
            if len(each) > least and each.startswith(here) and each.endswith(end)
        }
        if meant := _meant(part, [each for each in options if "." not in each]):
            return [options[meant[0]]]
    return []


def _other(status: str, other: str, options: Collection[str]) -> str:
    if other not in options:
        raise ModelError(
            f"the other status is {other!r}",
            where=f"skip.{status}.other",
            fix=suggest(other, options) if options else "name two statuses of this scenario",
        )
    return other


def _text(content: dict[str, Any], key: str, default: str) -> str:
    text = content.get(key, default)
    if not isinstance(text, str):
        raise ModelError(f"{key} is not a string", where=key, fix="put it in quotes")
    return text
