"""The readings of the text in words: a title for each, and what each of its options says."""

from __future__ import annotations

import tomllib
from pathlib import Path

from exact_mdp.analysis.readings import ReadingSpace, option_label
from exact_mdp.mdp.care.scenario import Scenario

WORDS = tomllib.loads((Path(__file__).parent / "wording.toml").read_text("utf-8"))


def title(name: str) -> str:
    """Return what a reading is about; a status, or "respectively", is itself.

    >>> title("skip_onset"), title("0101")
    ('New statuses on a skip', '0101')
    """
    return str(WORDS[name]["title"]) if name in WORDS else name


def said(name: str, option: object) -> str:
    """Return what an option of a reading says; the action itself where `name` is a status.

    >>> said("tasks", (3, 1)), said("0101", "none")
    ('a task of 3 subtasks, one of 1', 'none')
    """
    return str(WORDS[name][option_label(option)]) if name in WORDS else option_label(option)


def in_words(label: str) -> str:
    """Return what a reading's label "name = option" says; another label is itself.

    >>> in_words("influence_orientation = column-to-row"), in_words("default")
    ('Table 3 from column to row', 'default')
    """
    name, _, option = label.partition(" = ")
    return said(name, option) if option in WORDS.get(name, {}) else label


def changes(space: ReadingSpace, number: int) -> str:
    """Return what one combination of options changes from the default."""
    found = [
        said(name, option)
        for name, option in space.settings(number).items()
        if option != space.options[name][0]
    ]
    return ", ".join(found) or "the default"


def options_of(scenario: Scenario) -> dict[str, str]:
    """Return what each reading of a scenario says, by its title."""
    chosen = dict(scenario.readings) | {
        "tasks": scenario.tasks,
        "evaluation_discount": scenario.discount,
    }
    return {title(name): said(name, option) for name, option in chosen.items()}
