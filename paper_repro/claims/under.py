"""All readings of the text, and what becomes of a claim under them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import (
    JOINT_LIMIT,
    READ_OFF_A_PLOT,
    STANDARD_ERRORS,
    Verdict,
)
from exact_mdp.paper_repro.readings.evidence import Evidence, evidence
from exact_mdp.paper_repro.readings.search import STARTS, ReadingSearch, search
from exact_mdp.paper_repro.readings.study import ReadingStudy
from exact_mdp.paper_repro.view import Sizes, View

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Under:
    """How many of the readings tried agree with a claim.

    Attributes
    ----------
    tried, reproduced : int
    example : str
        One reading that agrees, the default first; empty where none does.
    scope : str
        Which readings were tried.
    """

    tried: int
    reproduced: int
    example: str
    scope: str

    @property
    def text(self) -> str:
        """One line."""
        share = f"{self.reproduced:,} of {self.tried:,} {self.scope}"
        if 0 < self.reproduced < self.tried and self.example != "default":
            return f"{share}, such as {self.example}"
        return share


SCOPE_ONE_CHANGE = "readings tried (the default, and those with one change)"
SCOPE_VIEWS = "readings tried (the default, those with one change, and the best supported)"


def tally(verdicts: Sequence[tuple[str, Verdict]], scope: str = SCOPE_VIEWS) -> Under:
    """Count the readings that agree.

    Examples
    --------
    >>> tally([("default", Verdict.NOT_REPRODUCED), ("tasks = [2]", Verdict.REPRODUCED)]).reproduced
    1
    """
    agree = [label for label, verdict in verdicts if verdict is Verdict.REPRODUCED]
    return Under(
        tried=len(verdicts),
        reproduced=len(agree),
        example=agree[0] if agree else "",
        scope=scope,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """Exact averages of all readings and what the evidence says of them.

    Attributes
    ----------
    search : ReadingSearch
    evidence : Evidence
    """

    search: ReadingSearch
    evidence: Evidence

    @classmethod
    def of(cls, study: ReadingStudy) -> Readings:
        """Return what a whole study holds."""
        return cls(search=study.search, evidence=study.main)

    @classmethod
    def run(
        cls, folder: Path | None, *, scheduler: str | None = None, progress: bool = False
    ) -> Readings:
        """Search alone, or read what `reading_study` or an earlier search left in the folder."""
        found = search(scheduler=scheduler, out=folder and folder / "search", progress=progress)
        return cls(search=found, evidence=evidence(found))

    @property
    def starts(self) -> tuple[str, ...]:
        """Actions in status 0000, in the order of the arrays' last axis."""
        return STARTS

    @cached_property
    def ranking(self) -> Integers:
        """(R,) readings, the best supported first."""
        return self.evidence.ranking

    @cached_property
    def support(self) -> dict[str, Under]:
        """How many of all readings agree with each claim that their averages decide."""
        return search_support(self)

    def label(self, number: int) -> str:
        """Name a reading by what it changes."""
        return self.search.space.label(number)

    def best(self, base: View, sizes: Sizes) -> Iterator[View]:
        """Yield the best supported readings as views."""
        for number in self.ranking[: sizes.supported].tolist():
            yield View(
                scenario=self.search.reading(number),
                label=self.label(number),
                runs=sizes.alternative_runs,
                episodes=base.episodes,
                store=base.store,
            )


def search_support(readings: Readings) -> dict[str, Under]:
    """Return, for claims about average returns, how many of all readings agree.

    Each reading is judged as the default one is (`paper_repro.claims.returns`): the averages and
    their ranking by the completion that fits the three averages best, the superiority by all.
    """
    from scipy.stats import chi2

    search = readings.search
    mean = {start: search.mean[:, :, i] for i, start in enumerate(readings.starts)}
    spread = {
        start: np.sqrt(search.variance[:, :, i] / reported.EXPERIMENTS)
        for i, start in enumerate(readings.starts)
    }
    far = {start: (mean[start] - x) / spread[start] for start, x in reported.AVERAGE_RETURN.items()}
    order = sorted(reported.AVERAGE_RETURN, key=lambda start: -reported.AVERAGE_RETURN[start])
    total: Floats = sum((z**2 for z in far.values()), np.zeros(()))
    fitting = (np.arange(len(total)), total.argmin(axis=1))
    falls = [mean[a][fitting] - mean[b][fitting] > 2 * search.error for a, b in pairwise(order)]
    least = np.min([each.min(axis=1) for each in mean.values()], axis=0)
    near = np.abs(search.random_mean - reported.RANDOM_RETURN) <= READ_OFF_A_PLOT
    found: dict[str, Flags] = {
        "return.optimal": search.optimum >= reported.CONVERGED_RETURN,
        "return.random": near,
        "return.superior": least > search.random_mean,
        "return.ranking": np.logical_and.reduce(falls),
        "return.together": chi2.sf(total[fitting], len(order)) >= JOINT_LIMIT,
    }
    found |= {
        f"return.reported.{start}": np.abs(z[fitting]) <= STANDARD_ERRORS
        for start, z in far.items()
    }
    return {name: _counted(readings, agrees) for name, agrees in found.items()}


def _counted(readings: Readings, agrees: Flags) -> Under:
    """Count, and take for an example the best supported reading that agrees."""
    if agrees[0]:
        example = "default"
    elif agrees.any():
        ranked = readings.ranking[agrees[readings.ranking]]
        example = readings.label(int(ranked[0]))
    else:
        example = ""
    return Under(tried=len(agrees), reproduced=int(agrees.sum()), example=example, scope="readings")
