"""Parsers of option values: numbers, pairs, settings, limits, and files to write."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from exact_mdp.mdp.errors import ModelError, require_known_name, suggest_name
from exact_mdp.mdp.io.formats import join_endings
from exact_mdp.mdp.table import exact, float_of


def refuse_options(options: Mapping[str, Any], of: str, fix: str = "leave it out") -> None:
    """Raise ModelError for the first of some options that is given."""
    for option, value in options.items():
        if value:
            raise ModelError(f"{option} does not apply to {of}", where=option, fix=fix)


def list_command_words() -> list[str]:
    """Return the words of the command that runs, without the program's name."""
    context = click.get_current_context(silent=True)
    if context is None:
        return []
    return list(context.find_root().obj or ())


def limits_from(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return the limits of --subject-to, as `solve` takes them."""
    limits: dict[str, list[str]] = {}
    for text in texts:
        name, *limit = re.split("(>=|<=)", text, maxsplit=1)
        if not limit:
            raise ModelError(
                f"{text!r} is not a limit",
                where="--subject-to",
                fix='write "NAME >= -1/2" or "NAME <= 1/20"',
            )
        limits.setdefault(name.strip(), []).append("".join(limit))
    return limits


def parse_whole_number(text: str, where: str) -> int:
    """Return the nonnegative whole number in a text."""
    number = exact(text, where)
    if number.denominator != 1 or number < 0:
        raise ModelError(f"{text} is not a whole number from 0", where=where, fix="round it")
    return int(number)


def pairs_of(texts: Sequence[str], option: str, form: str = "NAME=VALUE") -> dict[str, str]:
    """Return the values of NAME=VALUE texts by name."""
    pairs = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not value.strip() or not name.strip():
            raise ModelError(f"{text!r} is not {form}", where=option, fix=f"write {form}")
        pairs[name.strip()] = value.strip()
    return pairs


def _parse_parts(text: str, _: str) -> Any:
    """Return the parts of a text between commas, or the word "known"."""
    if text == "known":
        return text
    return tuple(each.strip() for each in text.split(","))


# The parser of a dataclass's field, by the first word of its type.
READ: dict[str, Callable[[str, str], Any]] = {
    **dict.fromkeys(("int", "RNG"), parse_whole_number),
    **dict.fromkeys(("float", "Schedule"), float_of),
    **dict.fromkeys(("tuple", "Ends", "Given"), _parse_parts),
    "bool": lambda text, where: (
        require_known_name(text, ("true", "false"), "truth value", where) == "true"
    ),
}


def settings_of(kind: type, texts: Sequence[str], option: str) -> dict[str, Any]:
    """Return the fields of a dataclass given by NAME=VALUE texts, parsed by their types.

    NAME.PART=VALUE is one entry of a mapping.
    """
    types = {each.name: re.split(r"\W", str(each.type))[0] for each in fields(kind)}
    settings: dict[str, Any] = {}
    for name, text in pairs_of(texts, option).items():
        key, _, part = name.partition(".")
        if key not in types:
            what = f"{key!r} does not apply to {getattr(kind, 'by', kind.__name__)}"
            raise ModelError(what, where=option, fix=suggest_name(key, types))
        if types[key] == "Mapping":
            settings[key] = settings.get(key, {}) | {part: text}
        elif types[key] in READ:
            settings[key] = READ[types[key]](text, f"{option} {name}")
        else:
            settings[key] = text
    return settings


def check_outputs(files: Iterable[tuple[str, Sequence[str]]]) -> None:
    """Raise ModelError if a file (path, allowed endings) cannot be written; called before work."""
    for name, endings in files:
        path = Path(name)
        if path.suffix.lower() not in endings:
            raise ModelError(
                f"cannot write {path.suffix or 'a file without ending'} here",
                where=name,
                fix=f"name it {join_endings(endings)}",
            )
        if not path.parent.is_dir():
            raise ModelError("there is no such folder", where=str(path.parent), fix="make it first")
