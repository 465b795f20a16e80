"""The three modules as requests: behaviour, perception and action execution.

    behaviour  (role, task, history, latest assistance, guidelines, status, format)  -> what is done
    perception (purpose, definitions, behaviour, format)                             -> status seen
    execution  (role, task, history, behaviour, action, format, guidelines, status?) -> what is said

Source: Yuan et al. (2025), Sections 2.2, 3.1 and 3.3. Perception is given the behaviour alone. The
status that execution may be given is the perceived one: the robot has no other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from exact_mdp.paper_repro.agents.prompts import Activity, Prompts, Step, encode
from exact_mdp.paper_repro.agents.protocol import Request
from exact_mdp.paper_repro.agents.schema import (
    behaviour_schema,
    execution_schema,
    perception_schema,
)

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
        facts = self._facts(place) | {"latest": latest, "status": dict(status)}
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
        facts = self._facts(place) | {"action": action, "detailed": detailed, **behaviour}
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
