"""Small models of PRISM's own tests, questions about them, and the published answers.

Source: prismmodelchecker/prism-tests, functionality/verify/mdps/rewards (rewpoliter, mdp_rewards,
total-reward-2, total-reward-3) and bugfixes/mdp-rewards-gs-loops, each with its .props file.
"""

import tomllib
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from pathlib import Path

from golden.sources import model


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A model, a question about it, and the published answer."""

    model: str
    until: str | None  # the total reward where it is None
    reward: str
    sense: str
    value: Fraction | float
    start: int = 0


SPECS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
DEFAULTS = {"discount": 1, "sense": "max", "start": {"0": 1}}
MODELS = {name: model(name, DEFAULTS | spec) for name, spec in SPECS.items()}


PUBLISHED = [
    Asked(
        model=name,
        until=until or None,
        reward=reward,
        sense=sense,
        value=inf if value == "inf" else Fraction(value),
    )
    for name, spec in SPECS.items()
    for until, reward, sense, value in spec["asked"]
]
