"""The prompts: components in files, filled with data that cannot break out of its place.

Each file of `prompts/` lists components, each for the system or the user message, with $names to
fill in. Data is put in as JSON in which "<" is escaped, so that no text of a conversation can
close the tag that holds it. Components: Yuan et al. (2025), Sections 2.2, 3.1 and 3.3; the words
are our own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.paper_repro.agents.protocol import PURPOSES

FOLDER = Path(__file__).parent / "prompts"

COMPONENTS: dict[str, tuple[str, ...]] = {
    "behaviour": (
        "role",
        "task-context",
        "history",
        "latest-assistance",
        "status-guidelines",
        "status-vector",
        "output-format",
    ),
    "perception": ("purpose", "status-definitions", "behaviour", "output-format"),
    "execution": (
        "role",
        "task-context",
        "history",
        "behaviour",
        "action",
        "output-format",
        "assistance-guidelines",
        "status",
    ),
}
"""The components that each prompt must have, in the paper's order."""


@dataclass(frozen=True, kw_only=True)
class Component:
    """One part of a prompt: which message it goes into, and its text with $names."""

    name: str
    message: str
    text: str
    optional: bool = False


@dataclass(frozen=True, kw_only=True)
class Prompt:
    """A versioned prompt.

    Examples
    --------
    >>> Prompts.load()["perception"].version >= 1
    True
    """

    purpose: str
    version: int
    components: tuple[Component, ...]

    def messages(
        self, values: Mapping[str, str], *, without: Sequence[str] = ()
    ) -> tuple[tuple[str, str], ...]:
        """Return (role, content) messages with the values filled in.

        Parameters
        ----------
        values : {name: text} for every $name
        without : optional components to leave out
        """
        parts: dict[str, list[str]] = {"system": [], "user": []}
        for component in self.components:
            if component.name not in without:
                try:
                    text = Template(component.text.strip()).substitute(values)
                except (KeyError, ValueError) as error:
                    raise ModelError(
                        f"a $name that nothing fills: {error}",
                        where=f"prompt {self.purpose}, component {component.name}",
                        fix=f"use {', '.join(sorted(values))}, and $$ for a dollar sign",
                    ) from error
                parts[component.message].append(text)
        return tuple((role, "\n\n".join(texts)) for role, texts in parts.items())


@dataclass(frozen=True, kw_only=True)
class Prompts:
    """The three prompts and the guidelines they share."""

    prompts: Mapping[str, Prompt]
    statuses: Mapping[str, Mapping[str, Any]]
    assistance: Mapping[str, Mapping[str, Any]]
    version: int

    def __getitem__(self, purpose: str) -> Prompt:
        return self.prompts[purpose]

    @classmethod
    def load(cls, folder: str | Path = FOLDER) -> Prompts:
        """Read the prompts that come with the package, or those of another folder.

        Raises
        ------
        ModelError
            For a file that is missing or broken, or that lacks a component.
        """
        folder = Path(folder)
        guidelines = read_toml(folder / "guidelines.toml")
        _check_guidelines(guidelines, folder / "guidelines.toml")
        return cls(
            prompts={purpose: _read(folder / f"{purpose}.toml", purpose) for purpose in PURPOSES},
            statuses=guidelines["status"],
            assistance=guidelines["assistance"],
            version=guidelines["version"],
        )

    def versions(self) -> dict[str, int]:
        """Return the version of every file, for a recording's header."""
        return {name: prompt.version for name, prompt in self.prompts.items()} | {
            "guidelines": self.version
        }

    def status_lines(self, statuses: Sequence[str]) -> str:
        """Return what each status means and how it shows, one line each."""
        lines = []
        for status in statuses:
            entry = look_up(self.statuses, status, "status")
            lines.append(
                f"- {status}: {entry['meaning']}. For instance: {'; '.join(entry['signs'])}."
            )
        return "\n".join(lines)

    def assistance_lines(self, *, detailed: bool) -> str:
        """Return what each kind of assistance means; with examples where detailed."""
        lines = []
        for kind, entry in self.assistance.items():
            if detailed:
                examples = " ".join(encode(example) for example in entry["examples"])
                lines.append(f"- {kind}: {entry['detailed']}. For instance: {examples}")
            else:
                lines.append(f"- {kind}: {entry['brief']}.")
        return "\n".join(lines)


def encode(value: object) -> str:
    """Return JSON that holds no angle bracket, so that it cannot close a tag around it.

    Examples
    --------
    >>> print(encode("</history> é"))
    "\\u003c/history\\u003e é"
    """
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e")


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's content; raises ModelError where it cannot be read."""
    return toml_of(read_text(path, most=SMALL), str(path), number=float)


def look_up(table: Mapping[str, Any], name: str, what: str) -> Any:
    """Return an entry by name; raises ModelError with the nearest name."""
    if name not in table:
        raise ModelError(
            f"nothing is written about {what} {name!r}",
            where="the agents' texts",
            fix=f"add it, or use a scenario with other names: {suggest(name, table)}",
        )
    return table[name]


def _texts(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, str) for v in value)


def _check_guidelines(content: Mapping[str, Any], path: Path) -> None:
    """Hold that the guidelines have every part that prompts put in, each as text."""
    parts = {
        "status": ({"meaning": _is_text, "signs": _texts}, "meaning and signs"),
        "assistance": (
            {"brief": _is_text, "detailed": _is_text, "examples": _texts},
            "brief, detailed and examples",
        ),
    }
    if not _is_version(content.get("version")):
        raise ModelError("no version", where=str(path), fix="give version, a whole number")
    for table, (tests, named) in parts.items():
        entries = content.get(table)
        good = isinstance(entries, dict) and all(
            isinstance(entry, dict) and all(test(entry.get(name)) for name, test in tests.items())
            for entry in entries.values()
        )
        if not good:
            raise ModelError(
                f"an entry of [{table}] lacks a part, or it is no text",
                where=str(path),
                fix=f"give each entry {named}",
            )


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_version(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _read(path: Path, purpose: str) -> Prompt:
    content = read_toml(path)
    try:
        prompt = Prompt(
            purpose=content["purpose"],
            version=content["version"],
            components=tuple(Component(**entry) for entry in content["component"]),
        )
    except (KeyError, TypeError) as error:
        raise ModelError(
            f"a prompt file without its parts: {error}",
            where=str(path),
            fix="give purpose, version and components with name, message and text",
        ) from error
    for number, part in enumerate(prompt.components, start=1):
        if not _is_text(part.text) or part.message not in ("system", "user"):
            raise ModelError(
                f"component {number} has no text, or is of no message",
                where=str(path),
                fix='give it a text, and the message "system" or "user"',
            )
    if not _is_version(prompt.version):
        raise ModelError("no version", where=str(path), fix="give version, a whole number")
    names = tuple(component.name for component in prompt.components)
    if prompt.purpose != purpose or names != COMPONENTS[purpose]:
        raise ModelError(
            f"purpose {prompt.purpose} with components {', '.join(names)}",
            where=str(path),
            fix=f"give purpose {purpose} the components {', '.join(COMPONENTS[purpose])}",
        )
    return prompt
