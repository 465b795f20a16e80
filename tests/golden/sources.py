"""The models of the golden answers: exact numbers, made by public names from models.toml."""

import tomllib
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from exact_mdp import MDP

FOLDER = Path(__file__).parent / "models"
MODELS = tomllib.loads((Path(__file__).parent / "models.toml").read_text("utf-8"))


def parts(text: str) -> dict[str, Fraction]:
    """Return "a 1/2, b 3" as numbers by name."""
    pairs = (each.split() for each in text.split(", ") if each)
    return {name: Fraction(number) for name, number in pairs}


def model(name: str, spec: Mapping[str, Any]) -> MDP:
    """Build a model from rows of text; the total of the components is the reward."""
    rows = spec["rows"]
    states = list(dict.fromkeys(state for state, *_ in rows))
    actions = list(dict.fromkeys(action for _, action, *_ in rows))
    amounts = [parts(rewards) for _, _, rewards, _ in rows]
    names = list(dict.fromkeys(name for row in amounts for name in row))
    outcomes = [
        (states.index(s), actions.index(a), [(p, states.index(t), sum(row.values()))
         for t, p in parts(after).items()])
        for (s, a, _, after), row in zip(rows, amounts, strict=True)
    ]  # fmt: skip
    return MDP.from_outcomes(
        outcomes,
        spec["discount"],
        actions=actions,
        states=states,
        name=name,
        sense=spec["sense"],
        labels={key: [s in named for s in states] for key, named in spec["labels"].items()},
        start={states.index(s): p for s, p in spec["start"].items()},
        components={name: [row.get(name, 0) for row in amounts] for name in names},
    )


def write(folder: Path = FOLDER) -> None:
    """Write every model; policies and records stand in the folder as they are."""
    for name, spec in MODELS.items():
        model(name, spec).save(folder / f"{name}.npz")
