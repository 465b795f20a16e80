"""What Yuan et al. (2025) report: transcribed from the paper, independently of the scenario file.

The policies are stated in Section 4.1: every status with anger gets verbal supportive assistance;
forgetful and confused gets directive; forgetful only and confused only get "directive or
non-directive, respectively", which can be read in two orders; three variants differ in status 0000.
The actions in the four remaining statuses (disengaged, not angry) are shown only in the paper's
figure of the learned policies, which its source does not include. `COMPLETIONS` lists every way to
fill in what is open, so that the spread over it can be stated beside each number.

`PLACES` names the sections, tables, equations and figures of the paper's source, titles shortened:
every claim is taken from some of them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.table import Integers

ACTIONS = ("none", "supportive", "non-directive", "directive")  # Table 2: a0 to a3
NUMBER = {action: number for number, action in enumerate(ACTIONS)}
STATUSES = tuple(map("".join, product("01", repeat=4)))  # forgetful, confused, angry, disengaged
STATUS_WORDS = {
    status: " and ".join(
        name
        for name, bit in zip(("forgetful", "confused", "angry", "disengaged"), status, strict=True)
        if bit == "1"
    )
    or "well"
    for status in STATUSES
}
ANGRY = tuple(status for status in STATUSES if status[2] == "1")

# Table 3, in per cent: base, then influence on forgetful, confused, angry, disengaged at t+1.
# The diagonal holds the persistence.
TABLE_3 = {
    "forgetfulness": (30, (99, 5, 6, 2)),
    "confusion": (30, (7, 99, 8, 2)),
    "anger": (5, (7, 8, 100, 10)),
    "disengagement": (20, (7, 10, 20, 99)),
}

# Section 2.1.2, in per cent: the chance that a present status stays; an absent one stays absent.
ASSISTANCE = {
    "supportive": {"anger": 5, "disengagement": 5},
    "non-directive": {"forgetfulness": 40, "confusion": 60},
    "directive": {"forgetfulness": 5, "confusion": 5},
}

# Section 2.1.3, in per cent: the chance that a status persists when a subtask is skipped.
SKIP = {
    "forgetfulness": {"alone": 20, "with-other": 50},
    "confusion": {"alone": 20, "with-other": 50},
    "anger": {"persistence": 50},
    "disengagement": {"persistence": 50},
}

TABLE_4 = {
    "forget": -1,
    "confuse": -1,
    "anger": -5,
    "disengaged": -1,
    "trial": -1,
    "subtask-complete": 50,
    "subtask-skip": -10,
    "timestep": -1,
    "task-complete": 20,
    "assist.none": 0,
    "assist.supportive": -1,
    "assist.non-directive": -3,
    "assist.directive": -5,
}

EXPERIMENTS = 1_000  # Section 4.1: runs behind each of the three averages
AVERAGE_RETURN = {"non-directive": 144.3, "directive": 139.2, "supportive": 133.5}  # Section 4.1
CONVERGED_RETURN = 140  # Section 4.1: "approximately", read off a plot
RANDOM_RETURN = 70  # Section 4.1: "around", read off a plot
STARTS = tuple(AVERAGE_RETURN)  # the action in 0000 of each of the three policies, best first
FINAL = STARTS[0]  # that of the paper's final policy
UNIQUE_POLICIES = {"constant": 3, "decaying": 2}  # Section 4.1: over the last 100 episodes

STATED = {"1000": "directive", "0100": "non-directive", "1100": "directive"}  # Section 4.1
UNSTATED = ("0001", "0101", "1001", "1101")
ORDERS = {  # "directive or non-directive, respectively"
    "as written": {"1000": STATED["1000"], "0100": STATED["0100"]},
    "swapped": {"1000": STATED["0100"], "0100": STATED["1000"]},
}

# What the text leaves open, in every way that it can be read: both orders of "respectively", the
# one as written first, with all actions in `UNSTATED`.
COMPLETIONS: tuple[Mapping[str, str], ...] = tuple(
    {**order, **dict(zip(UNSTATED, chosen, strict=True))}
    for order in ORDERS.values()
    for chosen in product(ACTIONS, repeat=4)
)


def order(completion: Mapping[str, str]) -> str:
    """Return which order of "respectively" a completion follows.

    >>> len(COMPLETIONS), order(COMPLETIONS[0]), order(COMPLETIONS[511])
    (512, 'as written', 'swapped')
    """
    return next(name for name, pair in ORDERS.items() if pair.items() <= completion.items())


def told(completion: Mapping[str, str]) -> str:
    """Return a completion in one line, as its order and the actions in `UNSTATED`.

    >>> told(COMPLETIONS[0])
    'as written; 0001 none, 0101 none, 1001 none, 1101 none'
    """
    actions = ", ".join(f"{status} {completion[status]}" for status in UNSTATED)
    return f"{order(completion)}; {actions}"


def policy(start: str, completion: Mapping[str, str]) -> dict[str, str]:
    """Return the reported policy with action `start` in status 0000, by status.

    >>> policy("non-directive", COMPLETIONS[0])["0010"]
    'supportive'
    """
    angry = dict.fromkeys(ANGRY, "supportive")
    return dict(sorted({"0000": start, **STATED, **completion, **angry}.items()))


def policies(completions: Sequence[Mapping[str, str]] = COMPLETIONS) -> Integers:
    """Return (C · 3, 16) action numbers by status vector, the action in 0000 moving fastest.

    >>> policies(COMPLETIONS[:1]).tolist()[0]
    [2, 0, 1, 1, 2, 0, 1, 1, 3, 0, 1, 1, 3, 0, 1, 1]
    """
    found = [policy(start, each).values() for each in completions for start in STARTS]
    return np.array([[NUMBER[action] for action in actions] for actions in found], dtype=np.int64)


def states(policy: Integers, orders: Sequence[str] = tuple(ORDERS)) -> bool:
    """Return whether a policy (16,) has the actions stated for 1100, 1000 and 0100.

    >>> swapped = policies()[-1]
    >>> states(swapped), states(swapped, ["as written"])
    (True, False)
    """
    taken = dict(zip(STATUSES, (ACTIONS[number] for number in policy), strict=True))
    pairs = (ORDERS[order] for order in orders)
    return taken["1100"] == STATED["1100"] and any(p.items() <= taken.items() for p in pairs)


def compatible(policy: Integers) -> bool:
    """Return whether a policy (16,) can be one that the paper describes.

    >>> compatible(policies()[-1]), compatible(np.zeros(16, dtype=int))
    (True, False)
    """
    angry = policy[[int(status, 2) for status in ANGRY]]
    start = ACTIONS[policy[0]]
    return bool((angry == NUMBER["supportive"]).all()) and states(policy) and start in STARTS


# ---- the paper's sections, and what else it numbers --------------------------------------------

_NAMED = tomllib.loads((Path(__file__).parent / "places.toml").read_text("utf-8"))
PAPER: dict[str, Any] = _NAMED["paper"]  # title, authors, date, identifier, link
SECTIONS: dict[str, str] = _NAMED["sections"]
NUMBERED: dict[str, tuple[str, str]] = _NAMED["numbered"]
PLACES = SECTIONS | {place: title for place, (_, title) in NUMBERED.items()}
FIGURES = {place: title for place, title in PLACES.items() if place.startswith("Figure")}


def section_of(place: str) -> str:
    """Return the section that a place stands in.

    >>> section_of("Table 3"), section_of("Section 4.1")
    ('Section 2.1.1', 'Section 4.1')
    """
    return NUMBERED[place][0] if place in NUMBERED else place
