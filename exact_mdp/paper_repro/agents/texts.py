"""The words of the agents: prompts, guidelines, an activity; and the three questions made of them.

    behaviour  (role, task, history, latest assistance, guidelines, status, format)  -> behaviour
    perception (purpose, definitions, behaviour, format)                             -> status seen
    execution  (role, task, history, behaviour, action, format, guidelines, status?) -> speech

Source: Yuan et al. (2025), Sections 2.2, 3.1 and 3.3; the words are our own. Perception is given
the behaviour alone. The status that execution may be given is the perceived one: the robot has no
other. Data is put in as JSON in which "<" is escaped, so that no text of a conversation can close
the tag that holds it.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

from exact_mdp import ModelError, Scenario

HERE = Path(__file__).parent
TEXTS: dict[str, Any] = tomllib.loads((HERE / "texts.toml").read_text("utf-8"))
ACTIVITY: dict[str, Any] = tomllib.loads((HERE / "shopping.toml").read_text("utf-8"))
PROMPTS: dict[str, dict[str, str]] = TEXTS["prompt"]
ASSISTANCE: dict[str, dict[str, Any]] = TEXTS["assistance"]
VARIANTS = {
    "brief": (False, False),
    "brief+status": (False, True),
    "detailed": (True, False),
    "detailed+status": (True, True),
}
"""The paper's four variants of action execution: (detailed guidelines, status given)."""

HISTORY = 6
"""Exchanges that a prompt recalls, unless said otherwise."""

Status = Mapping[str, int]
Exchanges = Sequence[Mapping[str, Any]]
Place = Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Request:
    """One question to a backend."""

    purpose: str  # "behaviour", "perception" or "execution"
    messages: tuple[tuple[str, str], ...]  # role and content: what a language model reads
    fields: Mapping[str, str]  # {name: "text" or "bit"}, the form of the answer
    facts: Mapping[str, Any]  # the same content as data, for a backend that reads no prose
    seed: int  # chooses among the possible answers


def status_lines(statuses: Sequence[str]) -> str:
    """Return a line for each status: its meaning and its signs."""
    entries = {status: TEXTS["status"][status] for status in statuses}
    lines = []
    for status, entry in entries.items():
        lines.append(f"- {status}: {entry['meaning']}. For instance: {'; '.join(entry['signs'])}.")
    return "\n".join(lines)


def assistance_lines(*, detailed: bool) -> str:
    """Return the meaning of each kind of assistance; with examples if detailed."""
    lines = []
    for kind, entry in ASSISTANCE.items():
        examples = " ".join(to_safe_json(example) for example in entry["examples"])
        long = f"{entry['detailed']}. For instance: {examples}"
        lines.append(f"- {kind}: {long if detailed else entry['brief'] + '.'}")
    return "\n".join(lines)


def fill_prompt(purpose: str, *, without: Sequence[str] = (), **values: str) -> str:
    """Return the text of a prompt, with the $names filled in that are given."""
    parts = [text for name, text in PROMPTS[purpose].items() if name not in without]
    return Template("\n\n".join(parts)).safe_substitute(values)


def to_safe_json(value: object) -> str:
    """Return JSON that holds no angle bracket, so that it cannot close a tag around it.

    >>> print(to_safe_json("</history> é"))
    "\\u003c/history\\u003e é"
    """
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e")


@dataclass(frozen=True, kw_only=True)
class Modules:
    """Makes the three requests; `steps` are the words of each subtask."""

    steps: tuple[dict[str, str], ...]
    statuses: tuple[str, ...]
    variant: str = "detailed+status"
    history: int = HISTORY

    @classmethod
    def of(cls, scenario: Scenario, **more: Any) -> Modules:
        """Return the modules for a scenario; raises ModelError if no texts exist for it."""
        lacking = {*scenario.statuses, *scenario.actions[1:]} - {*TEXTS["status"], *ASSISTANCE}
        if lacking:
            raise ModelError(
                f"the agents have no words for {', '.join(sorted(lacking))}",
                where=f"scenario {scenario.name}",
                fix="use a scenario with the statuses and assistances of yuan2025",
            )
        tasks, have = list(scenario.tasks), [len(task["step"]) for task in ACTIVITY["task"]]
        if len(have) < len(tasks) or any(h < n for h, n in zip(have, tasks, strict=False)):
            raise ModelError(
                f"the activity has {have} steps in its tasks, the scenario {tasks}",
                where="tasks",
                fix="set fewer",
            )
        steps = []
        for task, n in zip(ACTIVITY["task"], tasks, strict=False):
            for step in task["step"][:n]:
                steps.append({"goal": task["goal"], **step})
        return cls(steps=tuple(steps), statuses=tuple(scenario.statuses), **more)

    def describe_place(self, subtask: int, attempt: int, attempts: int) -> dict[str, str]:
        """Return the words for a trial at a subtask."""
        trial = {"attempt": str(min(attempt, attempts)), "attempts": str(attempts)}
        return {"setting": ACTIVITY["setting"], **self.steps[subtask % len(self.steps)], **trial}

    def ask_behaviour(self, place: Place, past: Exchanges, status: Status, seed: int) -> Request:
        """Ask what the person does and says in a status."""
        latest = ""
        if past:
            latest = str(past[-1]["caregiver"])
        said = []
        for exchange in past:
            for part in ("nonverbal", "verbal"):
                said.append(exchange[part])
        return self._build_request(
            "behaviour",
            {"nonverbal": "text", "verbal": "text"},
            {**place, "latest": latest, "status": dict(status), "said": said},
            seed,
            **place,
            history=self._format_history(past),
            latest=to_safe_json(latest),
            guidelines=status_lines(self.statuses),
            status=to_safe_json(dict(status)),
        )

    def ask_perception(self, behaviour: Mapping[str, str], seed: int) -> Request:
        """Ask which statuses a behaviour shows. The question does not contain the true status."""
        return self._build_request(
            "perception",
            dict.fromkeys(self.statuses, "bit"),
            dict(behaviour),
            seed,
            guidelines=status_lines(self.statuses),
            behaviour=to_safe_json(dict(behaviour)),
            names=", ".join(self.statuses),
        )

    def ask_execution(
        self,
        place: Place,
        past: Exchanges,
        behaviour: Mapping[str, str],
        action: str,
        perceived: Status,
        seed: int,
    ) -> Request:
        """Ask what the robot says to give one kind of assistance."""
        detailed, named = VARIANTS[self.variant]
        said = [exchange["caregiver"] for exchange in past]
        facts = {**place, **behaviour, "action": action, "detailed": detailed, "said": said}
        return self._build_request(
            "execution",
            {"speech": "text"},
            facts | ({"status": dict(perceived)} if named else {}),
            seed,
            () if named else ("status",),
            **place,
            history=self._format_history(past),
            behaviour=to_safe_json(dict(behaviour)),
            action=action,
            assistance=assistance_lines(detailed=detailed),
            status=to_safe_json(dict(perceived)),
        )

    def _build_request(
        self,
        purpose: str,
        fields: Mapping[str, str],
        facts: Mapping[str, Any],
        seed: int,
        without: Sequence[str] = (),
        **values: str,
    ) -> Request:
        """Return a request: the first component is the system message, the others the user's."""
        system, _, rest = fill_prompt(purpose, without=without, **values).partition("\n\n")
        messages = (("system", system), ("user", rest))
        return Request(purpose=purpose, messages=messages, fields=fields, facts=facts, seed=seed)

    def _format_history(self, past: Exchanges) -> str:
        recalled = past[max(len(past) - self.history, 0) :]
        return "\n".join(to_safe_json(exchange) for exchange in recalled)
