"""What Yuan et al. (2025) report: transcribed from the paper, independently of the scenario file.

The policies are stated in Section 4.1: every status with anger gets verbal supportive assistance;
forgetful and confused gets directive; forgetful only and confused only get "directive or
non-directive, respectively"; three variants differ in status 0000. The actions in the four
remaining statuses (disengaged, not angry) are shown only in the paper's figure of the learned
policies, which its source does not include. They are completed here by the choice that gives the
final policy its highest exact value; `completions` lists all of them, so that the spread over the
unknown part can be stated beside each number.
"""

from __future__ import annotations

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

STATED = {"1000": "directive", "0100": "non-directive", "1100": "directive"}  # Section 4.1
UNSTATED = ("0001", "0101", "1001", "1101")


def completions() -> list[dict[str, str]]:
    """Return every way to fill in the statuses whose action the paper's text does not state.

    Examples
    --------
    >>> len(completions())
    256
    """
    return [dict(zip(UNSTATED, chosen, strict=True)) for chosen in product(ACTIONS, repeat=4)]


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
