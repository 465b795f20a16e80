"""The learner's own settings as readings: what the text leaves open of them, and a prior.

The text says how often the learner learns and how it explores, but not whether the end of an
episode is masked in the target (worth 0) or read as status 0000, nor how ties break; where ε falls
and which are the last 100 episodes it says in words that code may have followed otherwise. Whether
ε falls within an epoch cannot matter: from one to the next it falls by 0.0008 at most.

An earlier public program of the authors, for another task, is evidence (PLWDCareSim,
`Qlearning_PreviousStateApplied.py`, github.com/ZhaoRobotLab/PLWDCareSim): its target looks beyond
the end, ties are broken at random while it learns, and a recorded policy takes the lowest index. It
also pays for the next status and evaluates without discount, as the default reading does. It is one
observation, and so are the words of the text. With Jeffreys' prior over the k options of a point,

    weight of the option observed = (1 + 1/2) / (1 + k/2),    of each other = (1/2) / (1 + k/2).

Points are taken as independent; weights are normalised over the settings that are tried: the
default, each with one change, and those of the earlier program.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

PROGRAM = "github.com/ZhaoRobotLab/PLWDCareSim, Qlearning_PreviousStateApplied.py"


@dataclass(frozen=True, kw_only=True)
class Option:
    """One way to read a point; `changes` are settings of the learner by name."""

    name: str
    changes: Mapping[str, Any]
    observed: str = ""  # where: "program", "text", or nowhere


POINTS: Mapping[str, tuple[Option, ...]] = {
    "end of an episode": (
        Option(name="end masked", changes={}),
        Option(name="end not masked", changes={"bootstrap_end": True}, observed="program"),
    ),
    "ties": (
        Option(name="first on ties", changes={}),
        Option(name="last on ties", changes={"ties": "last"}),
        Option(name="random on ties", changes={"ties": "random"}, observed="program"),
    ),
    "ε is 0.8 at": (
        Option(name="epoch 300", changes={}, observed="text"),
        Option(name="ε 0.8 at episode 300", changes={"decay_at": 10.0}),
    ),
    "the last 100": (
        Option(name="episodes", changes={}, observed="text"),
        Option(name="last 100 epochs", changes={"counted": "epochs"}),
    ),
}
"""The default option of each point first."""


@dataclass(frozen=True, kw_only=True)
class Learner:
    """One set of settings that is tried."""

    label: str
    changes: Mapping[str, Any]
    weight: float


def prior(point: str, option: Option) -> float:
    """Return the weight of an option of a point.

    >>> [prior("ties", option) for option in POINTS["ties"]]
    [0.2, 0.2, 0.6]
    """
    return (bool(option.observed) + 0.5) / (1 + len(POINTS[point]) / 2)


def _tried() -> tuple[Learner, ...]:
    default = {point: options[0] for point, options in POINTS.items()}
    program = {
        point: next((o for o in options if o.observed == "program"), default[point])
        for point, options in POINTS.items()
    }
    sets = {"default": default}
    for point, options in POINTS.items():
        sets |= {other.name: {**default, point: other} for other in options[1:]}
    sets["as in the earlier program"] = program
    weights = {
        label: prod(prior(point, option) for point, option in chosen.items())
        for label, chosen in sets.items()
    }
    return tuple(
        Learner(
            label=label,
            changes={k: v for option in chosen.values() for k, v in option.changes.items()},
            weight=weights[label] / sum(weights.values()),
        )
        for label, chosen in sets.items()
    )


LEARNERS = _tried()
"""The settings that are tried, the default first."""
