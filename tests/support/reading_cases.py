"""What several tests share: a small search of 96 readings, and what 400 runs ended with."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.paper_repro.readings.completions import LearnedCompletions
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

# Of 400 runs of each schedule under the default reading, by part and option (`counted`).
ENDS = LearnedCompletions(
    counts=np.array(
        [
            [[7, 41, 0, 0], [0, 397, 2, 1], [0, 294, 2, 104], [0, 309, 10, 81], [0, 282, 0, 118]],
            [[3, 29, 0, 0], [0, 400, 0, 0], [0, 310, 1, 89], [0, 296, 3, 101], [0, 267, 10, 123]],
        ]
    )
)


@lru_cache
def small_search() -> ReadingSearch:
    return search(space=SMALL, n_jobs=1)


@lru_cache
def small_study() -> ReadingStudy:
    return reading_study(
        seed=3, space=SMALL, sizes={"sampled": 2, "trained": 3, "seeds": 4, "judged": 1}, n_jobs=1
    )
