"""What is asked of the agents: prompts made of components, activities in words, three requests.

    behaviour  (role, task, history, latest assistance, guidelines, status, format)  -> what is done
    perception (purpose, definitions, behaviour, format)                             -> status seen
    execution  (role, task, history, behaviour, action, format, guidelines, status?) -> what is said

Source: Yuan et al. (2025), Sections 2.2, 3.1 and 3.3; the words are our own. Perception is given
the behaviour alone. The status that execution may be given is the perceived one: the robot has no
other. Each file of `prompts/` lists components, each for the system or the user message, with
$names to fill in. Data is put in as JSON in which "<" is escaped, so that no text of a conversation
can close the tag that holds it.
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
from exact_mdp.paper_repro.agents.protocol import (
    PURPOSES,
    TEXT,
    Request,
    Schema,
    behaviour_schema,
    execution_schema,
    listed,
    perception_schema,
    record,
    violations,
    whole,
)

FOLDER = Path(__file__).parent / "prompts"
ACTIVITIES = Path(__file__).parent / "activities"

COMPONENTS: dict[str, tuple[str, ...]] = {
    "behaviour": (
        "role", "task-context", "history", "latest-assistance", "status-guidelines",
        "status-vector", "output-format",
    ),
    "perception": ("purpose", "status-definitions", "behaviour", "output-format"),
    "execution": (
        "role", "task-context", "history", "behaviour", "action", "output-format",
        "assistance-guidelines", "status",
    ),
}  # fmt: skip
"""The components that each prompt must have, in the paper's order: the role in the system message,
all else in the user message."""

_MESSAGE = {"type": "string", "enum": ["system", "user"]}
_COMPONENT = record({"name": TEXT, "message": _MESSAGE, "text": TEXT}, others=True)
_STATUS = record({"meaning": TEXT, "signs": listed(TEXT, 1)}, others=True)
_KIND = record({"brief": TEXT, "detailed": TEXT, "examples": listed(TEXT, 1)}, others=True)
PROMPT = record({"purpose": TEXT, "version": whole(), "component": listed(_COMPONENT)}, others=True)
GUIDELINES = record(
    {
        "version": whole(),
        "status": record({}, others=_STATUS),
        "assistance": record({}, others=_KIND),
    },
    others=True,
)
_STEP = record(dict.fromkeys(("step", "item", "doing", "cue", "directive"), TEXT))
_TASK = record({"goal": TEXT, "step": listed(_STEP)}, others=True)
ACTIVITY = record({"name": TEXT, "setting": TEXT, "task": listed(_TASK)}, others=True)


def read_toml(path: Path, schema: Schema | None = None) -> dict[str, Any]:
    """Return a TOML file's content; raises ModelError where it cannot be read or does not fit."""
    content = toml_of(read_text(path, most=SMALL), str(path), number=float)
    wrong = violations(content, schema, "the file") if schema else []
    if wrong:
        raise ModelError(wrong[0], where=str(path), fix="compare it with the file of the package")
    return content


def look_up(table: Mapping[str, Any], name: str, what: str) -> Any:
    """Return an entry by name; raises ModelError with the nearest name."""
    if name not in table:
        raise ModelError(
            f"nothing is written about {what} {name!r}",
            where="the agents' texts",
            fix=f"add it, or use a scenario with other names: {suggest(name, table)}",
        )
    return table[name]


def encode(value: object) -> str:
    """Return JSON that holds no angle bracket, so that it cannot close a tag around it.

    Examples
    --------
    >>> print(encode("</history> é"))
    "\\u003c/history\\u003e é"
    """
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e")


@dataclass(frozen=True, kw_only=True)
class Prompt:
    """A versioned prompt: components with a name, a message and a text with $names."""

    purpose: str
    version: int
    components: tuple[Mapping[str, str], ...]

    @classmethod
    def load(cls, path: Path, purpose: str) -> Prompt:
        """Read a prompt's file, which must have the components of its purpose."""
        content = read_toml(path, PROMPT)
        names = tuple(component["name"] for component in content["component"])
        if content["purpose"] != purpose or names != COMPONENTS[purpose]:
            raise ModelError(
                f"purpose {content['purpose']} with components {', '.join(names)}",
                where=str(path),
                fix=f"give purpose {purpose} the components {', '.join(COMPONENTS[purpose])}",
            )
        parts = tuple(content["component"])
        return cls(purpose=purpose, version=content["version"], components=parts)

    def messages(
        self, values: Mapping[str, str], *, without: Sequence[str] = ()
    ) -> tuple[tuple[str, str], ...]:
        """Return (role, content) messages with every $name filled in.

        Parameters
        ----------
        values : {name: text}
        without : components to leave out
        """
        parts: dict[str, list[str]] = {"system": [], "user": []}
        for component in self.components:
            if component["name"] in without:
                continue
            try:
                text = Template(component["text"].strip()).substitute(values)
            except (KeyError, ValueError) as error:
                raise ModelError(
                    f"a $name without a value: {error}",
                    where=f"prompt {self.purpose}, component {component['name']}",
                    fix=f"use {', '.join(sorted(values))}, and $$ for a dollar sign",
                ) from error
            parts[component["message"]].append(text)
        return tuple((role, "\n\n".join(texts)) for role, texts in parts.items())

    def shown(self, *, without: Sequence[str] = ()) -> str:
        """Return the prompt for reading: each message with its components, $names left open."""
        lines = []
        for role in ("system", "user"):
            parts = [c for c in self.components if c["message"] == role]
            lines += [f"{role}:", *(c["text"].strip() for c in parts if c["name"] not in without)]
        return "\n\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class Prompts:
    """The three prompts and the guidelines they share.

    Examples
    --------
    >>> Prompts.load()["perception"].version >= 1
    True
    """

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
        guidelines = read_toml(folder / "guidelines.toml", GUIDELINES)
        return cls(
            prompts={name: Prompt.load(folder / f"{name}.toml", name) for name in PURPOSES},
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
        found = ((status, look_up(self.statuses, status, "status")) for status in statuses)
        return "\n".join(
            f"- {status}: {entry['meaning']}. For instance: {'; '.join(entry['signs'])}."
            for status, entry in found
        )

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


@dataclass(frozen=True, kw_only=True)
class Step:
    """One subtask in words: what to do, and what the scripted agents say about it."""

    goal: str
    step: str
    item: str
    doing: str
    cue: str
    directive: str


@dataclass(frozen=True, kw_only=True)
class Activity:
    """An activity fitted to a scenario's tasks: one step for each subtask.

    Examples
    --------
    >>> Activity.load("shopping", tasks=[3, 1]).steps[3].goal
    'pay for the three things in cash'
    """

    name: str
    setting: str
    steps: tuple[Step, ...]

    @classmethod
    def load(cls, name: str, *, tasks: Sequence[int]) -> Activity:
        """Read an activity by name or from a `.toml` file, and fit it to the tasks.

        Raises
        ------
        ModelError
            Where it has fewer tasks or steps than the scenario, or lacks a part.
        """
        path = Path(name) if name.endswith(".toml") else ACTIVITIES / f"{name}.toml"
        content = read_toml(path, ACTIVITY)
        have = [len(task["step"]) for task in content["task"]]
        if len(have) < len(tasks) or any(h < n for h, n in zip(have, tasks, strict=False)):
            raise ModelError(
                f"the activity has {have} steps in its tasks, the scenario {list(tasks)}",
                where=str(path),
                fix="add the missing steps, or set fewer tasks",
            )
        steps = tuple(
            Step(goal=task["goal"], **step)
            for task, count in zip(content["task"], tasks, strict=False)
            for step in task["step"][:count]
        )
        return cls(name=content["name"], setting=content["setting"], steps=steps)


VARIANTS = {
    "brief": (False, False),
    "brief+status": (False, True),
    "detailed": (True, False),
    "detailed+status": (True, True),
}
"""The paper's four variants of action execution: (detailed guidelines, status given)."""

HISTORY = 6
"""Exchanges that a prompt recalls, unless said otherwise."""


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where in the activity a conversation stands."""

    step: Step
    attempt: int
    attempts: int


@dataclass(frozen=True, kw_only=True)
class Modules:
    """Makes the three requests for a scenario's statuses and one activity."""

    prompts: Prompts
    activity: Activity
    statuses: tuple[str, ...]
    variant: str = "detailed+status"
    history: int = HISTORY

    def behaviour(
        self,
        place: Place,
        past: Sequence[Mapping[str, Any]],
        latest: str,
        status: Mapping[str, int],
        seed: int,
    ) -> Request:
        """Ask what the person does and says in a status."""
        values = self._task(place) | {
            "history": self._history(past),
            "latest": encode(latest),
            "guidelines": self.prompts.status_lines(self.statuses),
            "status": encode(dict(status)),
        }
        said = [exchange[part] for exchange in past for part in ("nonverbal", "verbal")]
        facts = self._facts(place) | {"latest": latest, "status": dict(status), "said": said}
        return self._request("behaviour", values, behaviour_schema(), facts, seed)

    def perception(self, behaviour: Mapping[str, str], seed: int) -> Request:
        """Ask which statuses a behaviour shows. The true status is no part of the question."""
        values = {
            "guidelines": self.prompts.status_lines(self.statuses),
            "behaviour": encode(dict(behaviour)),
            "names": ", ".join(self.statuses),
        }
        schema = perception_schema(self.statuses)
        return self._request("perception", values, schema, dict(behaviour), seed)

    def execution(
        self,
        place: Place,
        past: Sequence[Mapping[str, Any]],
        behaviour: Mapping[str, str],
        action: str,
        perceived: Mapping[str, int],
        seed: int,
    ) -> Request:
        """Ask what the robot says to give one kind of assistance."""
        detailed, told = VARIANTS[self.variant]
        values = self._task(place) | {
            "history": self._history(past),
            "behaviour": encode(dict(behaviour)),
            "action": action,
            "assistance": self.prompts.assistance_lines(detailed=detailed),
        }
        said = [exchange["caregiver"] for exchange in past]
        facts = self._facts(place) | {"action": action, "detailed": detailed, "said": said}
        facts |= behaviour
        if told:
            values["status"] = encode(dict(perceived))
            facts["status"] = dict(perceived)
        without = () if told else ("status",)
        return self._request("execution", values, execution_schema(), facts, seed, without)

    def _request(
        self,
        purpose: str,
        values: Mapping[str, str],
        schema: Mapping[str, Any],
        facts: Mapping[str, Any],
        seed: int,
        without: Sequence[str] = (),
    ) -> Request:
        messages = self.prompts[purpose].messages(values, without=without)
        return Request(purpose=purpose, messages=messages, schema=schema, facts=facts, seed=seed)

    def _history(self, past: Sequence[Mapping[str, Any]]) -> str:
        recalled = past[len(past) - min(self.history, len(past)) :]
        return "\n".join(encode(exchange) for exchange in recalled)

    def _task(self, place: Place) -> dict[str, str]:
        return {
            "setting": self.activity.setting,
            "goal": place.step.goal,
            "step": place.step.step,
            "attempt": str(place.attempt),
            "attempts": str(place.attempts),
        }

    def _facts(self, place: Place) -> dict[str, Any]:
        step = place.step
        return {
            "item": step.item,
            "doing": step.doing,
            "step": step.step,
            "cue": step.cue,
            "directive": step.directive,
            "attempt": place.attempt,
        }
