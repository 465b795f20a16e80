"""What the person does, in words: tasks and their steps, for a scenario that only counts them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mdp.errors import ModelError
from paper_repro.agents.prompts import read_toml

FOLDER = Path(__file__).parent / "activities"
PARTS = ("step", "item", "doing", "cue", "directive")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One subtask in words: what to do, and what the scripted agents say about it."""

    goal: str
    step: str
    item: str
    doing: str
    cue: str
    directive: str


@dataclass(frozen=True, kw_only=True)
class Activity:
    """An activity fitted to a scenario's tasks: one step for each subtask.

    Examples
    --------
    >>> Activity.load("shopping", tasks=[3, 1]).steps[3].goal
    'pay for the three things in cash'
    """

    name: str
    setting: str
    steps: tuple[Step, ...]

    @classmethod
    def load(cls, name: str, *, tasks: Sequence[int]) -> Activity:
        """Read an activity by name or from a `.toml` file, and fit it to the tasks.

        Raises
        ------
        ModelError
            Where it has fewer tasks or steps than the scenario, or lacks a part.
        """
        path = Path(name) if name.endswith(".toml") else FOLDER / f"{name}.toml"
        content = read_toml(path)
        try:
            written = content["task"]
            have = [len(task["step"]) for task in written]
            if len(have) < len(tasks) or any(h < n for h, n in zip(have, tasks, strict=False)):
                raise ModelError(
                    f"the activity has {have} steps in its tasks, the scenario {list(tasks)}",
                    where=str(path),
                    fix="add the steps that lack, or set fewer tasks",
                )
            steps = tuple(
                _step(task["goal"], step)
                for task, count in zip(written, tasks, strict=False)
                for step in task["step"][:count]
            )
            return cls(name=str(content["name"]), setting=str(content["setting"]), steps=steps)
        except (KeyError, TypeError) as error:
            raise ModelError(
                f"an activity without {error}",
                where=str(path),
                fix=f"give name, setting, and tasks with a goal and steps of {', '.join(PARTS)}",
            ) from error


def _step(goal: str, parts: Mapping[str, str]) -> Step:
    for name, text in (("goal", goal), *((part, parts[part]) for part in PARTS)):
        if not isinstance(text, str):
            raise TypeError(f"text as its {name}")
    return Step(goal=goal, **{part: parts[part] for part in PARTS})
