"""The scripted backend: seeded templates in place of a language model, the same on every machine.

A behaviour joins one phrase for each status that is present; perception looks for the cues of
`phrases/perception.toml` in what was done and said, and with `noise` ε reads each status wrongly
with probability ε, independently. So its confusion matrix is known:

    C(s, p) = Π_i (1 - ε)^[s_i = p_i] ε^[s_i ≠ p_i]

It shows that the parts work together. It is no evidence about language models.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.paper_repro.agents.prompts import look_up, read_toml
from exact_mdp.paper_repro.agents.protocol import BackendError, Reply, Request, violations

FOLDER = Path(__file__).parent / "phrases"


def _phrases(name: str) -> Any:
    return field(default_factory=lambda: read_toml(FOLDER / f"{name}.toml"), repr=False)


@dataclass(frozen=True, kw_only=True)
class Scripted:
    """Answers from templates; `noise` is the probability that perception errs in one status.

    Examples
    --------
    >>> backend = Scripted()
    >>> request = Request(
    ...     purpose="perception",
    ...     messages=(),
    ...     schema={
    ...         "type": "object",
    ...         "properties": {"anger": {"type": "integer", "enum": [0, 1]}},
    ...         "required": ["anger"],
    ...         "additionalProperties": False,
    ...     },
    ...     facts={"nonverbal": "Glares at the shelf, jaw tight.", "verbal": ""},
    ...     seed=0,
    ... )
    >>> backend.answer(request).data
    {'anger': 1}
    """

    noise: float = 0.0
    behaviours: Mapping[str, Any] = _phrases("behaviour")
    cues: Mapping[str, Any] = _phrases("perception")
    speeches: Mapping[str, Any] = _phrases("execution")

    def __post_init__(self) -> None:
        if not 0 <= self.noise <= 1:
            raise ModelError(
                f"noise is {self.noise}, not a probability",
                where="scripted backend",
                fix="choose a number from 0 to 1",
            )

    def describe(self) -> dict[str, Any]:
        """Return name and noise."""
        return {"backend": "scripted", "noise": self.noise}

    def answer(self, request: Request) -> Reply:
        """Return the answer that the request's seed chooses."""
        rng = np.random.default_rng(request.seed)
        makers: dict[str, Callable[[Request, np.random.Generator], dict[str, Any]]] = {
            "behaviour": self._behaviour,
            "perception": self._perception,
            "execution": self._execution,
        }
        data = makers[request.purpose](request, rng)
        wrong = violations(data, request.schema)
        if wrong:
            raise BackendError(
                f"a scripted answer does not fit: {wrong[0]}",
                where=request.purpose,
                fix="correct the phrases",
            )
        return Reply(data=data)

    def _behaviour(self, request: Request, rng: np.random.Generator) -> dict[str, str]:
        facts = request.facts
        present = [name for name, value in facts["status"].items() if value]
        kinds = present or ["calm"]
        tables = [look_up(self.behaviours, kind, "status") for kind in kinds]
        nonverbal = [_pick(table["nonverbal"], rng) for table in tables]
        verbal = [_pick(table["verbal"], rng) for table in tables]
        if facts["latest"] and not present and rng.random() < 0.6:
            verbal = [_pick(self.behaviours["calm"]["answering"], rng)]
        return {
            "nonverbal": " ".join(_fill(text, facts) for text in nonverbal),
            "verbal": " ".join(_fill(text, facts) for text in verbal),
        }

    def _perception(self, request: Request, rng: np.random.Generator) -> dict[str, int]:
        text = f"{request.facts['nonverbal']} {request.facts['verbal']}".lower()
        seen = {}
        for status in request.schema["properties"]:
            cued = any(cue in text for cue in look_up(self.cues, status, "status"))
            seen[status] = int(cued != (rng.random() < self.noise))
        return seen

    def _execution(self, request: Request, rng: np.random.Generator) -> dict[str, str]:
        facts = request.facts
        table = look_up(self.speeches, facts["action"], "assistance")
        told = facts.get("status", {})
        opening = [
            _pick(texts, rng)
            for status, texts in self.speeches["status"].items()
            if told.get(status)
        ]
        said = [*opening[:1], _pick(table["first"], rng)]
        if facts["detailed"]:
            said.append(_pick(table["more"], rng))
        return {"speech": " ".join(_fill(text, facts) for text in said)}


def _pick(texts: list[str], rng: np.random.Generator) -> str:
    return texts[int(rng.integers(len(texts)))]


def _fill(text: str, facts: Mapping[str, Any]) -> str:
    values = {key: str(value) for key, value in facts.items()}
    for key in ("item", "doing"):
        values[key.capitalize()] = values[key][:1].upper() + values[key][1:]
    return Template(text).substitute(values)
