"""Reading a scenario from TOML: every number exact, every name checked.

Tables flatten to parameter names: `[influence.anger]` `confusion = 0.08` is the parameter
`influence.anger.confusion`. Numbers may be written 0.08, 1 or "2/25". An influence that is left
out is 0; any other number that is missing, or a name that is not known, is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
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
    exact_at,
    known,
)
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.parametric.parameter import Parameter
from exact_mdp.mdp.validate import as_discount

TABLES = ("base", "persistence", "influence", "assistance", "skip", "reward")
SETTINGS = ("name", "title", "source", "statuses", "actions", "tasks", "max_trial", "discount")
T = TypeVar("T", bound=Tables)
KEYS = (*SETTINGS, "readings", "status_weight", *TABLES)


def shipped() -> list[str]:
    """Return the names of the scenarios that come with the package.

    Examples
    --------
    >>> "yuan2025" in shipped()
    True
    """
    folder = files("exact_mdp.mdp") / "scenarios"
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name[-5:] == ".toml")


def load(name: str | Path, kind: type[T]) -> T:
    """Return a shipped scenario, or that of a file, as `kind`; see `Scenario.load`."""
    text = str(name)
    if not text.lower().endswith(".toml"):
        if text not in shipped():
            raise ModelError(
                f"unknown scenario {text!r}",
                where="scenarios",
                fix=f"{suggest(text, shipped())} (or give the path of a .toml file)",
            )
        source = files("exact_mdp.mdp") / "scenarios" / f"{text}.toml"
        return parse(source.read_text(encoding="utf-8"), kind, where=text)
    return parse(read_text(name, most=SMALL), kind, where=text)


def parse(text: str, kind: type[T], *, where: str = "scenario") -> T:
    """Return the scenario that a TOML text states, as `kind`; `where` names it in errors."""
    content = toml_of(text, where)
    try:
        return _scenario(content, kind, default_name=Path(where).stem)
    except ModelError as error:
        place = f"{where}, {error.where}" if error.where else where
        raise ModelError(error.what, where=place, fix=error.fix) from error


def _scenario(content: dict[str, Any], kind: type[T], *, default_name: str) -> T:
    for key in content:
        known(key, KEYS, "key", "top level")
    statuses, actions = _words(content, "statuses"), _words(content, "actions")
    if SKIP in actions:
        raise ModelError(
            f"an action is called {SKIP!r}", where="actions", fix="choose another name for it"
        )
    readings = {name: options[0] for name, options in READINGS.items()}
    for name, option in _table(content, "readings").items():
        readings[name] = check_reading(name, option)
    weights = _weights(content, statuses)
    others, flat = _flatten(content)
    for status, other in others.items():
        if status not in statuses or other not in statuses or other == status:
            raise ModelError(
                f"the other status is {other!r}",
                where=f"skip.{status}.other",
                fix=suggest(other, [name for name in statuses if name != status]),
            )
    wanted = _names(content, statuses, actions, others, weights)
    for name in flat:
        known(name, wanted, "number", name.partition(".")[0])
    for name in wanted:
        if name not in flat and not name.startswith("influence."):
            raise ModelError(
                f"the number {name} is missing", where=name.partition(".")[0], fix="state it"
            )
    return kind(
        name=_text(content, "name", default_name),
        title=_text(content, "title", ""),
        source=_text(content, "source", ""),
        statuses=statuses,
        actions=actions,
        tasks=as_tasks(content.get("tasks", ())),
        max_trial=as_max_trial(content.get("max_trial", "missing")),
        discount=as_discount(content.get("discount", 1)),
        readings=readings,
        parameters=tuple(
            Parameter(name=name, value=flat.get(name, Fraction(0)), low=low, high=high)
            for name, (low, high) in wanted.items()
        ),
        others=others,
        weights=weights,
    )


def _names(
    content: dict[str, Any],
    statuses: tuple[str, ...],
    actions: tuple[str, ...],
    others: Mapping[str, str],
    weights: Mapping[str, str],
) -> dict[str, tuple[Fraction | None, Fraction | None]]:
    """Return every parameter that the scenario has, with its range, in the paper's order."""
    assistance = _table(content, "assistance")
    for action in assistance:
        known(action, actions, "action", "assistance")
        for status in _table(assistance, action):
            known(status, statuses, "status", f"assistance.{action}")
    names = [f"{table}.{status}" for table in ("base", "persistence") for status in statuses]
    names += [f"influence.{r}.{c}" for r in statuses for c in statuses if r != c]
    for action in actions:
        for status in statuses:
            if status in assistance.get(action, {}):
                rule = f"assistance.{action}.{status}"
                names += [f"{rule}.persistence", f"{rule}.onset"]
    for status in statuses:
        rules = ("alone", "with-other") if status in others else ("persistence",)
        names += [f"skip.{status}.{rule}" for rule in rules]
    rewards = [*(weights[status] for status in statuses), *SHARED_WEIGHTS]
    rewards += [f"assist.{action}" for action in actions]
    return {
        **dict.fromkeys(names, (Fraction(0), Fraction(1))),
        **{f"reward.{weight}": (None, None) for weight in rewards},
    }


def _flatten(content: dict[str, Any]) -> tuple[dict[str, str], dict[str, Fraction]]:
    """Return the `other` statuses of the skip rules, and every number by its dotted name."""
    others: dict[str, str] = {}
    flat: dict[str, Fraction] = {}

    def visit(prefix: str, value: object) -> None:
        parts = prefix.split(".")
        if isinstance(value, dict):
            for key, below in value.items():
                visit(f"{prefix}.{key}", below)
        elif parts[0] == "skip" and parts[-1] == "other" and len(parts) == 3:
            others[parts[1]] = str(value)
        else:
            flat[prefix] = exact_at(prefix, value)

    for table in TABLES:
        visit(table, _table(content, table))
    return others, flat


def _weights(content: dict[str, Any], statuses: tuple[str, ...]) -> dict[str, str]:
    given = _table(content, "status_weight")
    for status in given:
        known(status, statuses, "status", "status_weight")
    weights = {status: str(given.get(status, status)) for status in statuses}
    taken = [*weights.values(), *SHARED_WEIGHTS, "assist"]
    if len(set(taken)) != len(taken) or any("." in weight for weight in taken):
        raise ModelError(
            "two reward weights have the same name, or one has a dot in it",
            where="status_weight",
            fix="give each status a weight name of its own",
        )
    return weights


def _words(content: dict[str, Any], key: str) -> tuple[str, ...]:
    words = content.get(key)
    listed = isinstance(words, list) and all(isinstance(word, str) and word for word in words)
    if not listed or not words or "." in "".join(words) or len(set(words)) != len(words):
        raise ModelError(
            f"{key} is not a list of different names",
            where=key,
            fix='write, for example, ["forgetfulness", "anger"], without dots',
        )
    return tuple(words)


def _table(content: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise ModelError(f"{key} is not a table", where=key, fix=f"write it as [{key}]")
    return table


def _text(content: dict[str, Any], key: str, default: str) -> str:
    text = content.get(key, default)
    if not isinstance(text, str):
        raise ModelError(f"{key} is not a string", where=key, fix="put it in quotes")
    return text
