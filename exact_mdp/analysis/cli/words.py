"""What the words of options mean: numbers, pairs, settings, limits, files to write."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exact_mdp.mdp.errors import ModelError, suggest

if TYPE_CHECKING:
    Converter = click.ParamType[int]
else:  # older versions of click have no parameter here
    Converter = click.ParamType


class Whole(Converter):
    """A whole number within limits, which the docstring's type states: "N, 1 to 100"."""

    name = "whole number"

    def __init__(self, form: str) -> None:
        limits = re.search(r"(\d+) to (\d+)", form)
        self.least, self.most = map(int, limits.groups()) if limits else (0, 10**18)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number that a text states."""
        return self.of(str(value), param.opts[-1] if param else "")

    def of(self, text: str, where: str) -> int:
        """Return the number that a text states."""
        digits = text.isascii() and text.isdigit() and len(text) <= 40
        if digits and self.least <= int(text) <= self.most:
            return int(text)
        raise ModelError(
            f"{text!r} is not a whole number from {self.least} to {self.most:,}",
            where=where,
            fix="choose one in that range",
        )


def refuse(options: Mapping[str, Any], of: str, fix: str = "leave it out") -> None:
    """Raise ModelError for the first of some options that is given."""
    for option, value in options.items():
        if value:
            raise ModelError(f"{option} does not apply to {of}", where=option, fix=fix)


def typed() -> list[str]:
    """Return the words of this command."""
    context = click.get_current_context(silent=True)
    return [] if context is None else list(context.find_root().obj or ())


def limits_from(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return what --subject-to says, as `solve` takes it."""
    limits: dict[str, list[str]] = {}
    for text in texts:
        name, *limit = re.split("(>=|<=)", text, maxsplit=1)
        if not limit:
            raise ModelError(
                f"{text!r} is no limit",
                where="--subject-to",
                fix='write "NAME >= -1/2" or "NAME <= 1/20"',
            )
        limits.setdefault(name.strip(), []).append("".join(limit))
    return limits


def number_of(text: str, option: str, *, positive: bool = False) -> float:
    """Return the number that an option states, as a float."""
    from exact_mdp.mdp.table import float_of  # loads NumPy, and help needs this module

    number = float_of(text, option)
    if positive and not number > 0:
        raise ModelError(f"{text} is not positive", where=option, fix="give more than 0")
    return number


def pairs_of(texts: Sequence[str], option: str, form: str = "NAME=VALUE") -> dict[str, str]:
    """Return what NAME=VALUE texts say."""
    pairs = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not value.strip():
            raise ModelError(f"{text!r} is not {form}", where=option, fix=f"write {form}")
        pairs[name.strip()] = value.strip()
    return pairs


def settings_of(kind: type, texts: Sequence[str], option: str) -> dict[str, Any]:
    """Return the fields of a dataclass that NAME=VALUE texts state, each as its type says.

    NAME.PART=VALUE is one entry of a mapping.
    """
    known = {each.name: str(each.type) for each in fields(kind)}
    settings: dict[str, Any] = {}
    for name, text in pairs_of(texts, option).items():
        where, (key, _, part) = f"{option} {name}", name.partition(".")
        if key not in known:
            what = f"{key!r} does not apply to {getattr(kind, 'by', kind.__name__)}"
            raise ModelError(what, where=option, fix=suggest(key, known))
        form = known[key]
        value: Any = text
        if form.startswith(("int", "RNG")):
            value = Whole("0 to 999999999").of(text, where)
        elif form in ("float", "Schedule"):
            value = number_of(text, where)
        elif form == "bool":
            if text not in ("true", "false"):
                raise ModelError(f"{text!r} is no truth value", where=where, fix="write true")
            value = text == "true"
        elif form.startswith(("tuple", "Ends", "Given")) and text != "known":
            value = tuple(each.strip() for each in text.split(","))
        elif form.startswith("Mapping"):
            value = settings.get(key, {}) | {part: text}
        settings[key] = value
    return settings


def check_outputs(*files: tuple[str | None, tuple[str, ...]]) -> None:
    """Raise ModelError, before any work, where a file (path, allowed endings) cannot be written."""
    taken = []
    for name, endings in files:
        if name is None:
            continue
        path = Path(name)
        if path.suffix.lower() not in endings:
            raise ModelError(
                f"cannot write {path.suffix or 'a file without ending'} here",
                where=name,
                fix=f"name it {' or '.join(endings)}",
            )
        if not path.parent.is_dir():
            raise ModelError("there is no such folder", where=str(path.parent), fix="make it first")
        if path.resolve() in taken:
            raise ModelError("two results go to one file", where=name, fix="name another file")
        taken.append(path.resolve())
