"""The search over all readings, as the claims and the report use it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from mdp.table import Integers
from paper_repro.reading_evidence import Evidence, evidence
from paper_repro.reading_search import STARTS, ReadingSearch, search
from paper_repro.reading_study import ReadingStudy
from paper_repro.view import Sizes, View

if TYPE_CHECKING:
    from paper_repro.claims.under import Under


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
        from paper_repro.claims.under import search_support

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
