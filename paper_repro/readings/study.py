"""All about the readings in one call: search, evidence, joint statements, learning, verdicts.

`reading_study(seed=0)` is what the report and the figures are made from. The exact part takes under
a minute on two cores; the learning runs add a few minutes (fewer with `quick`). With a folder, what
is finished is kept there, and the next call goes on from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.paper_repro.readings.evidence import EXPERIMENTS, Evidence, variants
from exact_mdp.paper_repro.readings.joint import Joint, joint
from exact_mdp.paper_repro.readings.learning import (
    SEEDS,
    TRAINED,
    LearningEvidence,
    learning,
    to_train,
)
from exact_mdp.paper_repro.readings.search import PAPER_READINGS, STARTS, ReadingSearch, search
from exact_mdp.paper_repro.readings.statements import Sentence, statements
from exact_mdp.paper_repro.readings.verdict import ReadingVerdict, verdicts

QUICK_SEEDS, QUICK_TRAINED = 20, 5
QUICK_JUDGED, JUDGED = 2, 5


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingStudy:
    """Which reading it is, as far as the paper's numbers tell.

    Attributes
    ----------
    search : ReadingSearch
    evidence : mapping
        By the name of the variant; the first is the main one.
    joints : mapping
        Joint attainability of every set of statements, for 1,000 and 10,000 experiments.
    learned : LearningEvidence
    verdicts : tuple of ReadingVerdict
        On the reported policy, under the default and the best supported readings.
    """

    search: ReadingSearch
    evidence: Mapping[str, Evidence]
    joints: Mapping[int, tuple[Joint, ...]]
    learned: LearningEvidence
    verdicts: tuple[ReadingVerdict, ...]

    @property
    def main(self) -> Evidence:
        """The evidence with 1,000 experiments and tolerances of 5."""
        return next(iter(self.evidence.values()))

    @cached_property
    def sentences(self) -> list[Sentence]:
        """The findings in plain English."""
        return statements(self.evidence, self.joints, self.learned)

    def ranking(self, count: int = 30) -> list[dict[str, object]]:
        """Return the best supported readings as rows of a table.

        `mean` and `standard_error` are those of the three policies with the best completion, by
        their action in 0000; `same_as` is the first reading with the same figures throughout.
        """
        found, same = self.main, self.search.equivalent()
        rows: list[dict[str, object]] = []
        for place, number in enumerate(found.ranking[:count].tolist(), start=1):
            completion = int(found.completion[number])
            error = np.sqrt(self.search.variance[number, completion] / found.experiments)
            mean = self.search.mean[number, completion]
            rows.append(
                {
                    "rank": place,
                    "reading": number,
                    "label": self.search.space.label(number),
                    "weight": float(found.weights[number]),
                    "log_likelihood": float(found.marginal[number]),
                    "profile_log_likelihood": float(found.profile[number]),
                    "mean": dict(zip(STARTS, mean.tolist(), strict=True)),
                    "standard_error": dict(zip(STARTS, error.tolist(), strict=True)),
                    "random": float(self.search.random_mean[number]),
                    "optimum": float(self.search.optimum[number]),
                    "completion": dict(self.search.completions[completion]),
                    "same_as": int(same[number]),
                }
            )
        return rows


def reading_study(
    *,
    seed: int,
    space: ReadingSpace = PAPER_READINGS,
    out: str | Path | None = None,
    quick: bool = False,
    trained: int | None = None,
    seeds: int | None = None,
    judged: int | None = None,
    n_jobs: int | None = None,
    scheduler: str | None = None,
    progress: bool = False,
) -> ReadingStudy:
    """Return the whole study.

    Parameters
    ----------
    seed : int
        Of the learning runs; everything else is exact.
    space : ReadingSpace
        The readings to search.
    out : path, optional
        Folder for finished pieces.
    quick : bool
        Train under fewer readings, from fewer seeds, with verdicts on fewer readings; the search
        over the readings stays whole.
    trained, seeds : int, optional
        Readings to train under, and runs of each schedule; by `quick` unless given.
    judged : int, optional
        Best supported readings with a verdict on the reported policy, beside the default; by
        `quick` unless given.
    n_jobs : int, optional
        Processes; all cores where None.
    scheduler : str, optional
        A Dask cluster instead, "tcp://host:port" or "local"; see `solvers.parallel.many.many`.
    progress : bool
        Show bars on standard error where that is a terminal.
    """
    folder = None if out is None else Path(out)
    count = (QUICK_JUDGED if quick else JUDGED) if judged is None else judged
    found = search(
        space=space,
        n_jobs=n_jobs,
        scheduler=scheduler,
        out=folder and folder / "search",
        progress=progress,
    )
    evidence = variants(found)
    main = next(iter(evidence.values()))
    by_experiments = {each.experiments: each for each in reversed(evidence.values())}
    by_experiments[main.experiments] = main
    learned = learning(
        found,
        to_train(main, trained or (QUICK_TRAINED if quick else TRAINED)),
        seeds=seeds or (QUICK_SEEDS if quick else SEEDS),
        seed=seed,
        n_jobs=n_jobs,
        scheduler=scheduler,
        out=folder and folder / ("learning-quick" if quick else "learning"),
        progress=progress,
    )
    return ReadingStudy(
        search=found,
        evidence=evidence,
        joints={n: tuple(joint(by_experiments[n])) for n in EXPERIMENTS},
        learned=learned,
        verdicts=tuple(verdicts(main, count)),
    )
