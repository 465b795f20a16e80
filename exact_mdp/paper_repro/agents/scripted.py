"""The scripted backend: seeded templates in place of a language model, the same on every machine.

A behaviour joins one phrase for each status that is present; perception looks for the cues of
`phrases/perception.toml` in what was done and said, and with `noise` ε reads each status wrongly
with probability ε, independently. So its confusion matrix is known:

    C(s, p) = Π_i (1 - ε)^[s_i = p_i] ε^[s_i ≠ p_i]

Nobody says a line twice in a conversation: phrases that were not heard yet come first, and once all
were, no two lines are put together of the same ones.
It shows that the parts work together. It is no evidence about language models.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
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
        spoken = "verbal"
        if facts["latest"] and not present and rng.random() < 0.6:
            spoken = "answering"
        return {
            "nonverbal": _line([table["nonverbal"] for table in tables], facts, rng),
            "verbal": _line([table[spoken] for table in tables], facts, rng),
        }

    def _perception(self, request: Request, rng: np.random.Generator) -> dict[str, int]:
        return {
            status: int(self._cued(request.facts, status) != (rng.random() < self.noise))
            for status in request.schema["properties"]
        }

    def _cued(self, facts: Mapping[str, Any], status: str) -> bool:
        text = f"{facts['nonverbal']} {facts['verbal']}".lower()
        return any(cue in text for cue in look_up(self.cues, status, "status"))

    def _execution(self, request: Request, rng: np.random.Generator) -> dict[str, str]:
        facts = request.facts
        table = look_up(self.speeches, facts["action"], "assistance")
        told = facts.get("status", {})
        opening = [texts for name, texts in self.speeches["status"].items() if told.get(name)]
        heard = [name for name in self.cues if told.get(name) or self._cued(facts, name)]
        mood = "anger" if "anger" in heard else "other" if heard else "calm"
        said = [*opening[:1], table.get(mood, table)["first"]]
        if facts["detailed"]:
            said.append(table["more"])
        return {"speech": _line(said, facts, rng)}


def _line(parts: list[list[str]], facts: Mapping[str, Any], rng: np.random.Generator) -> str:
    """Return one text of each part, in a line that was not said before."""
    said = facts.get("said", ())
    filled = [[_fill(text, facts) for text in texts] for texts in parts]
    heard = " ".join(said)
    fresh = [[t for t in texts if not t or t not in heard] or texts for texts in filled]
    drawn = [texts[int(rng.integers(len(texts)))] for texts in fresh]
    # The drawn texts come first; after them, all others in the order of a shuffle.
    orders = [[one, *rng.permutation(texts)] for one, texts in zip(drawn, filled, strict=True)]
    lines = (" ".join(filter(None, chosen)) for chosen in product(*orders))
    line = next((line for line in lines if not line or line not in said), None)
    return _line([*parts, parts[-1]], facts, rng) if line is None else line


def _fill(text: str, facts: Mapping[str, Any]) -> str:
    values = {key: str(value) for key, value in facts.items()}
    for key in ("item", "doing"):
        values[key.capitalize()] = values[key][:1].upper() + values[key][1:]
    return Template(text).substitute(values)
