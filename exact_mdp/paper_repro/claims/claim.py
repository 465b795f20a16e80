"""What a claim of the paper is, what is found about it, and the rules that decide.

A claim is one statement of the paper with its place and a function that works out, for one reading
of the text, what is true there. An *input* is what the model was built from, a number, a setting or
a definition, and what the text says of these: that it is the same shows a faithful transcription,
no more. A *finding* is what the paper concludes. The verdict follows one of seven rules, `RULES`;
a number read off a plot has to be within half of the last digit that such a reading carries, and an
event, something that one training run ended with, is not refuted by being rare: that a run like the
paper's is nothing unusual does not say that most runs are like it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from math import sqrt
from types import MappingProxyType
from typing import Any, Literal

from exact_mdp.analysis.learning.outcomes import share_interval
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.readings.completions import LEFT_OUT, STANDARD_ERRORS
from exact_mdp.solvers.solution import Bounded, Certified, Claim, Estimated

Kind = Literal["input", "finding"]
Number = Certified | Bounded | Estimated
JOINT_LIMIT = LEFT_OUT  # chance of a normal number further off than three standard errors
READ_OFF_A_PLOT = 5.0
RARE = 0.05

RULES: Mapping[str, str] = MappingProxyType(
    {
        "entry": "the same rational number",
        "average": f"within {STANDARD_ERRORS:g} exact standard errors, under the completion of "
        "the text that fits the averages best, taken together, of those that training can be "
        "expected to end with",
        "plotted": f"within {READ_OFF_A_PLOT:g} of a number read off a plot; a hard limit, where "
        "the comparison of readings uses a normal error of that standard deviation",
        "event": f"a run like the paper's is seen in at least {RARE:.0%} of the training runs "
        "here, by Wilson's interval; most runs may well end otherwise",
        "usual": "most of the training runs here do so, by Wilson's interval",
        "statement": "a stated predicate of the exact model",
        "open": "cannot be decided here",
    }
)


class Verdict(StrEnum):
    """What is found of a claim."""

    REPRODUCED = "reproduced"
    DEPENDS = "depends on the reading"  # not under the default one, but under others
    NOT_REPRODUCED = "not reproduced"
    NOT_DETERMINED = "not determined"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is found about a claim under one reading."""

    verdict: Verdict
    why: str  # one line
    number: Number | None = None  # the exact counterpart of what the paper says
    shown: str = ""  # how it reads, where it is not a plain number
    difference: float | None = None  # exact less paper
    standard_error: float | None = None  # the exact one, of the paper's average
    judged: Finding | None = None  # with the number that the verdict is of, where it is another
    details: Mapping[str, Any] = field(default_factory=dict)  # more, for `numbers.json`

    @property
    def exact(self) -> float | None:
        """The exact number, rounded once; None for a statement without one."""
        return None if self.number is None else float(self.number.value)

    @property
    def claim(self) -> Claim | None:
        """Certified, bounded or estimated; None without a number."""
        return None if self.number is None else self.number.claim

    @property
    def standard_errors(self) -> float | None:
        """The difference in standard errors of the paper's average."""
        if self.difference is None or not self.standard_error:
            return None
        return self.difference / self.standard_error


Work = Callable[[Reading], Finding | Fraction]


@dataclass(frozen=True, kw_only=True)
class PaperClaim:
    """One claim of the paper: where it stands, what it says, and how it is worked out and judged.

    Attributes
    ----------
    id : str
        Its name in `numbers.json` and on the command line.
    source : str
        The places that it is taken from, keys of `reported.PLACES`, separated by ", ".
    says : str
        The claim in our words.
    rule : str
        Key of `RULES`.
    work : function of a Reading
        Returns a Finding, or under the rule "entry" the exact number of the model.
    kind : "input" or "finding"
        Whether the model was built from it.
    paper : float or Fraction, optional
        The paper's number.
    unit : str
        "%" where numbers are shares.
    open : bool
        Whether the paper's text leaves open what decides it, so that other readings are tried.
    learns : bool
        Whether it takes training runs.
    """

    id: str
    source: str
    says: str
    rule: str
    work: Work
    kind: Kind = "finding"
    paper: float | Fraction | None = None
    unit: str = ""
    open: bool = False
    learns: bool = False

    @property
    def varies(self) -> bool:
        """Whether the learner's own settings may decide it."""
        return self.learns and not self.open

    @property
    def places(self) -> list[str]:
        """The places that it is taken from, one by one."""
        return self.source.split(", ")

    @property
    def rerun(self) -> str:
        """The command that works out this claim alone."""
        return f"python -m paper_repro --claim {self.id}"

    def find(self, reading: Reading) -> Finding:
        """Work the claim out under a reading."""
        found = self.work(reading)
        if isinstance(found, Finding):
            return found
        assert isinstance(self.paper, Fraction), self.id
        return entry(self.paper, found)


class Claims(list[PaperClaim]):
    """The claims of one part of the paper, in its order; `add` puts one in."""

    def add(
        self, name: str, source: str, rule: str = "statement", *, says: str = "", **more: Any
    ) -> Callable[[Work], Work]:
        """Return a decorator that adds a claim, which the function words and works out."""

        def keep(work: Work) -> Work:
            told = says or " ".join((work.__doc__ or "").split())
            self.append(PaperClaim(id=name, source=source, says=told, rule=rule, work=work, **more))
            return work

        return keep

    def entry(
        self,
        name: str,
        source: str,
        says: str,
        paper: Fraction | int | str,
        exact: Work,
        **more: Any,
    ) -> None:
        """Add an input: a number of the paper that the model has to hold exactly."""
        number = Fraction(paper)
        self.add(name, source, "entry", says=says, kind="input", paper=number, **more)(exact)


# ---- the rules ---------------------------------------------------------------------------------


def statement(
    holds: bool,
    why: str,
    number: Number | None = None,
    shown: str = "",
    **details: Any,
) -> Finding:
    """Judge by a predicate, with its reason `why`."""
    apart = {name: details.pop(name, None) for name in ("difference", "standard_error")}
    verdict = Verdict.REPRODUCED if holds else Verdict.NOT_REPRODUCED
    return Finding(verdict=verdict, why=why, number=number, shown=shown, details=details, **apart)


def entry(paper: Fraction, exact: Fraction, why: str = "") -> Finding:
    """Compare a number of the paper with the model's, both exact.

    >>> entry(Fraction(3, 10), Fraction(3, 10)).verdict.value
    'reproduced'
    """
    same = paper == exact
    why = why or ("the same number" if same else f"the model has {exact}")
    return statement(same, why, Certified(value=exact), difference=float(exact - paper))


def plotted(paper: float, number: Bounded | Estimated, why: str = "", **details: Any) -> Finding:
    """Compare a number that the authors read off a plot with ours.

    >>> plotted(140, Bounded(value=143.2, error=0)).verdict.value
    'reproduced'
    """
    difference = number.value - paper
    near = abs(difference) <= READ_OFF_A_PLOT
    where, away = ("within", "of") if near else ("more than", "away from")
    why = why or f"{where} {READ_OFF_A_PLOT:g} {away} a number that was read off a plot"
    return statement(near, why, number, difference=difference, **details)


def event(count: int, total: int, why: str, *, limit: float = RARE, **details: Any) -> Finding:
    """Judge an outcome of learning by how often our own runs end with it, one or more of them.

    >>> event(40, 100, "of 100 runs").verdict.value, event(0, 500, "").verdict.value
    ('reproduced', 'not reproduced')
    """
    low, high = share_interval(count, total)
    verdict = Verdict.NOT_DETERMINED
    if low >= limit:
        verdict = Verdict.REPRODUCED
    elif high < limit:
        verdict = Verdict.NOT_REPRODUCED
    share = count / total
    return Finding(
        verdict=verdict,
        why=why,
        number=Estimated(value=share, standard_error=share_error(count, total)),
        shown=f"{share:.0%} of {total} (95 % interval {low:.0%} to {high:.0%})",
        details={"count": count, "runs": total, "interval": [low, high], **details},
    )


def share_error(count: int, total: int) -> float:
    """Return the standard error of a share, smoothed: it is not 0 where all runs are alike."""
    share = (count + 0.5) / (total + 1)
    return sqrt(share * (1 - share) / total)


def usual(count: int, total: int, why: str, **details: Any) -> Finding:
    """Judge what learning is said to lead to by whether most of our own runs do so.

    >>> usual(45, 100, "of 100 runs").verdict.value, usual(90, 100, "").verdict.value
    ('not determined', 'reproduced')
    """
    return event(count, total, why, limit=0.5, **details)


def undecided(why: str) -> Finding:
    """Say what would decide a claim that nothing here can decide."""
    return Finding(verdict=Verdict.NOT_DETERMINED, why=why)
