"""A small search that several tests share: 96 readings, all completions."""

from __future__ import annotations

from functools import lru_cache

from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.paper_repro.readings.findings import ReadingStudy, reading_study
from exact_mdp.paper_repro.readings.search import DISCOUNTS, ReadingSearch, search

SMALL = ReadingSpace(
    options={
        "status_cost": ("next", "current"),
        "skip_timestep": ("same", "own"),
        "skip_onset": ("none", "reset"),
        "task_bonus": ("always", "last-subtask-completed", "no-subtask-skipped"),
        "tasks": ((3,), (1, 1, 1)),
        "evaluation_discount": DISCOUNTS,
    }
)


@lru_cache
def small_search() -> ReadingSearch:
    return search(space=SMALL, n_jobs=1)


@lru_cache
def small_study() -> ReadingStudy:
    return reading_study(
        seed=3, space=SMALL, sizes={"trained": 3, "seeds": 4, "judged": 1}, n_jobs=1
    )
