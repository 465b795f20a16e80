"""The scripted backend: seeded templates in place of a language model, the same on every machine.

A behaviour joins one phrase for each status that is present; perception looks for these phrases in
the behaviour, and with `noise` ε reads each status wrongly with probability ε, independently. So
its confusion matrix is known:

    C(s, p) = Π_i (1 - ε)^[s_i = p_i] ε^[s_i ≠ p_i]

Phrases that were not heard yet in a conversation come first. It shows that the parts work together.
It says nothing about language models.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain, product
from string import Template
from typing import Any

import numpy as np

from exact_mdp import ModelError
from exact_mdp.paper_repro.agents.texts import HERE, Request

PHRASES: dict[str, Any] = tomllib.loads((HERE / "phrases.toml").read_text("utf-8"))


@dataclass(frozen=True, kw_only=True)
class Scripted:
    """Answers from templates; `noise` is the probability that perception errs in one status."""

    noise: float = 0.0

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

    def answer(self, request: Request) -> dict[str, Any]:
        """Return the answer that the request's seed chooses."""
        rng, facts = np.random.default_rng(request.seed), request.facts
        if request.purpose == "perception":
            seen = self._detect_statuses(facts, request.fields)
            return {name: int(seen[name] != (rng.random() < self.noise)) for name in seen}
        if request.purpose == "behaviour":
            present = [name for name, value in facts["status"].items() if value]
            tables = [PHRASES["behaviour"][n] for n in present or ["calm"]]
            answers = facts["latest"] and not present and rng.random() < 0.6
            spoken = "verbal"
            if answers:
                spoken = "answering"
            return {
                "nonverbal": _compose_line([table["nonverbal"] for table in tables], facts, rng),
                "verbal": _compose_line([table[spoken] for table in tables], facts, rng),
            }
        return {"speech": self._compose_speech(facts, rng)}

    def _detect_statuses(self, facts: Mapping[str, Any], names: Any) -> dict[str, bool]:
        text, tables = f"{facts['nonverbal']} {facts['verbal']}", PHRASES["behaviour"]
        found = {}
        for name in names:
            phrases = chain(*tables[name].values())
            found[name] = any(phrase in text for phrase in phrases)
        return found

    def _compose_speech(self, facts: Mapping[str, Any], rng: np.random.Generator) -> str:
        table = PHRASES["speech"][facts["action"]]
        status = facts.get("status", {})
        opening = [texts for name, texts in PHRASES["opening"].items() if status.get(name)]
        heard = self._detect_statuses(facts, list(PHRASES["opening"]))
        angry = heard.get("anger") or status.get("anger")
        if angry:
            mood = "anger"
        elif any(heard.values()):
            mood = "first"
        else:
            mood = "calm"
        said = [*opening[:1], table.get(mood, table["first"])]
        return _compose_line(said + [table["more"]] * facts["detailed"], facts, rng)


def _compose_line(
    parts: list[list[str]], facts: Mapping[str, Any], rng: np.random.Generator
) -> str:
    """Return one text of each part, in a line that was not said before, if possible."""
    said = facts.get("said", ())
    heard = " ".join(said)
    filled = []
    for texts in parts:
        filled.append([_fill_template(text, facts) for text in texts])
    fresh = []
    for texts in filled:
        fresh.append([t for t in texts if not t or t not in heard] or texts)
    drawn = [texts[int(rng.integers(len(texts)))] for texts in fresh]
    orders = [[one, *rng.permutation(texts)] for one, texts in zip(drawn, filled, strict=True)]
    lines = [" ".join(filter(None, chosen)) for chosen in product(*orders)]
    return next((line for line in lines if line not in said), lines[0])


def _fill_template(text: str, facts: Mapping[str, Any]) -> str:
    values = {key: str(value) for key, value in facts.items()}
    for key in ("item", "doing"):
        values[key.capitalize()] = values[key][:1].upper() + values[key][1:]
    return Template(text).substitute(values)
