"""Small models of PRISM's own tests with any question's published answer, restated.

Source: prismmodelchecker/prism-tests, functionality/verify/mdps/rewards (rewpoliter, mdp_rewards,
total-reward-2, total-reward-3) and bugfixes/mdp-rewards-gs-loops, each with its .props file.
"""

import tomllib
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from pathlib import Path

from golden.sources import model

F = Fraction


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


def _of(model: str, *rows: tuple[str | None, str, str, Fraction | float]) -> list[Asked]:
    return [
        Asked(model=model, until=until, reward=reward, sense=sense, value=value)
        for until, reward, sense, value in rows
    ]


PUBLISHED = [
    *_of("rewpoliter", ("s=5", "cost", "min", F(38))),
    *_of("gs-loops", ("s=1", "r", "max", F(2))),
    *_of(
        "mdp_rewards",
        ("s=1", "a", "max", F(5)), ("s=2", "a", "max", F(17)), ("s=3", "a", "max", F(39)),
        (None, "a", "max", F(39)), (None, "a", "min", F(25)),
        (None, "b", "max", inf), (None, "b", "min", inf),
    ),
    *_of(
        "total-reward-2",
        (None, "steps", "max", inf), (None, "s0", "max", inf), (None, "s0_a", "max", F(3)),
        ("s=1", "s0_a", "max", inf), ("s=1 or 2", "s0_a", "max", inf), (None, "s0_b", "max", inf),
        (None, "s1", "max", inf),
    ),
    *_of(
        "total-reward-3",
        (None, "steps", "max", inf), (None, "s0", "max", F(3, 2)), (None, "s0_a", "max", F(3)),
        ("s=1", "s0_a", "max", inf), ("s=1 or 2", "s0_a", "max", F(3)),
        (None, "s0_b", "max", F(1, 100_000)), (None, "s1", "max", inf),
    ),
]  # fmt: skip
