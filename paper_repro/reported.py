"""What Yuan et al. (2025) report: transcribed from the paper, independently of the scenario file.

The policies are stated in Section 4.1: every status with anger gets verbal supportive assistance;
forgetful and confused gets directive; forgetful only and confused only get "directive or
non-directive, respectively", which can be read in two orders; three variants differ in status 0000.
The actions in the four remaining statuses (disengaged, not angry) are shown only in the paper's
figure of the learned policies, which its source does not include. `completions` lists every way to
fill in what is open, so that the spread over it can be stated beside each number.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

ACTIONS = ("none", "supportive", "non-directive", "directive")  # Table 2: a0 to a3

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
UNIQUE_POLICIES = {"constant": 3, "decaying": 2}  # Section 4.1: over the last 100 episodes

STATED = {"1000": "directive", "0100": "non-directive", "1100": "directive"}  # Section 4.1
UNSTATED = ("0001", "0101", "1001", "1101")
ORDERS = {  # "directive or non-directive, respectively"
    "as written": {"1000": STATED["1000"], "0100": STATED["0100"]},
    "swapped": {"1000": STATED["0100"], "0100": STATED["1000"]},
}


def completions() -> list[dict[str, str]]:
    """Return the actions that the paper's text leaves open, in every way that it can be read.

    Both orders of "respectively", the one as written first, with all actions in `UNSTATED`.

    Examples
    --------
    >>> len(completions()), completions()[0]["1000"], completions()[256]["1000"]
    (512, 'directive', 'non-directive')
    """
    return [
        {**order, **dict(zip(UNSTATED, chosen, strict=True))}
        for order in ORDERS.values()
        for chosen in product(ACTIONS, repeat=4)
    ]


def order(completion: Mapping[str, str]) -> str:
    """Return which order of "respectively" a completion follows.

    Examples
    --------
    >>> order(completions()[0]), order(completions()[511])
    ('as written', 'swapped')
    """
    return next(
        name for name, pair in ORDERS.items() if all(completion[s] == a for s, a in pair.items())
    )


def told(completion: Mapping[str, str]) -> str:
    """Return a completion in one line, as its order and the actions in `UNSTATED`.

    Examples
    --------
    >>> told(completions()[0])
    'as written; 0001 none, 0101 none, 1001 none, 1101 none'
    """
    actions = ", ".join(f"{status} {completion[status]}" for status in UNSTATED)
    return f"{order(completion)}; {actions}"


def policy(start: str, completion: dict[str, str]) -> dict[str, str]:
    """Return the reported policy with action `start` in status 0000, by status.

    Examples
    --------
    >>> policy("non-directive", completions()[0])["0010"]
    'supportive'
    """
    angry = {
        label: "supportive" for label in map("".join, product("01", repeat=4)) if label[2] == "1"
    }
    return dict(sorted({"0000": start, **STATED, **completion, **angry}.items()))
