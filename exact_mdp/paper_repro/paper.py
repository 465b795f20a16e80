"""What Yuan et al. (2025) say, as numbers; read from `paper.toml`.

Every status with anger gets supportive assistance; 1100 gets directive; 1000 and 0100 get
"directive or non-directive, respectively", which can be read in two orders; three variants differ
in status 0000 (Section 4.1). The actions in the four remaining statuses are shown only in a figure
that the source of the paper does not include.
"""

from __future__ import annotations

import tomllib
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

from exact_mdp import ModelError
from exact_mdp.mdp.io.files import write_atomically

PAPER: dict[str, Any] = tomllib.loads((Path(__file__).parent / "paper.toml").read_text("utf-8"))
PLACES: dict[str, str] = PAPER["places"]
SETTINGS: dict[str, Any] = PAPER["settings"]
REPORTED: dict[str, Any] = PAPER["reported"]
TABLE_4: dict[str, int] = PAPER["table4"]

ACTIONS = ("none", "supportive", "non-directive", "directive")  # Table 2: a0 to a3
STATUSES = tuple(map("".join, product("01", repeat=4)))  # forgetful, confused, angry, disengaged
BITS = {"forgetfulness": 8, "confusion": 4, "anger": 2, "disengagement": 1}
ANGRY = tuple(status for status in STATUSES if status[2] == "1")
OPEN = ("0001", "0101", "1001", "1101")  # the text says nothing of these

AVERAGES: dict[str, float] = REPORTED["averages"]  # by the action in status 0000
FINAL = next(iter(AVERAGES))  # the order of the paper's final policy
EXPERIMENTS: int = REPORTED["experiments"]
ABOUT = 5.0  # the distance allowed from a number that the text calls approximate: our choice
ORDERS = {  # of "directive or non-directive, respectively" for 1000 and 0100
    "as written": {"1000": "directive", "0100": "non-directive"},
    "swapped": {"1000": "non-directive", "0100": "directive"},
}


def table_3() -> dict[str, Fraction]:
    """Return the twenty numbers of Table 3 by name."""
    numbers = {}
    for row, (base, entries) in PAPER["table3"].items():
        numbers[f"base.{row}"] = Fraction(base, 100)
        for column, entry in zip(BITS, entries, strict=True):
            if row == column:
                name = f"persistence.{row}"
            else:
                name = f"influence.{row}.{column}"
            numbers[name] = Fraction(entry, 100)
    return numbers


def describe_status(status: str) -> str:
    """Return a status in words.

    >>> describe_status("1100"), describe_status("0000")
    ('forgetful, confused', 'well')
    """
    names = ("forgetful", "confused", "angry", "disengaged")
    return ", ".join(n for n, bit in zip(names, status, strict=True) if bit == "1") or "well"


def format_loss(points: float) -> str:
    """Return points that are lost, for reading; a small loss is not shown as 0.

    >>> format_loss(4.161), format_loss(0.0003)
    ('4.16', 'under 0.01')
    """
    if 0 < points < 0.005:
        return "under 0.01"
    return f"{points:.2f}"


def has_stated_actions(policy: dict[str, str], order: str) -> bool:
    """Return whether a policy takes the actions stated for 1100, 1000 and 0100, in one order."""
    stated = {"1100": REPORTED["stated"]["1100"], **ORDERS[order]}
    return all(policy[status] == action for status, action in stated.items())


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all, in a folder that is made; raises ModelError if it fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"cannot write the file: {error.strerror}"
        raise ModelError(what, where=str(path), fix="name another folder") from error
    write_atomically(path, content)
