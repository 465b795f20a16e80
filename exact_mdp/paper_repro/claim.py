"""Claims of the paper, the findings about them, and the rules that decide.

A claim is a function of a `Reading`: its docstring says what the paper says, its body checks that.
An *input* went into the model, so its agreement shows a faithful transcription and no more. A
*finding* is a conclusion of the paper. The rules:

entries    every number of a table is the same rational number in the model
about      within 5 of a number that the text says approximately
average    the chance that an average of so many experiments is as far from its exact mean, by a
           normal distribution with the exact standard error, is .0027 (three of them) or more
share      in 95 % or more of the training runs; if in fewer, only the share is stated; if in none,
           the claim is not reproduced
statement  a predicate of the exact model
open       nothing here can decide it

An estimate decides only if its error leaves no doubt: a number that is three standard errors from
the limit, or so many runs that a share of all or none of them has a narrow confidence interval.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from fractions import Fraction
from math import ceil, erfc, sqrt
from typing import TYPE_CHECKING, Any, Literal

from exact_mdp import Bounded, Certified, Estimated
from exact_mdp.paper_repro.paper import ABOUT

if TYPE_CHECKING:
    from exact_mdp.paper_repro.silent_points import Reading

Number = Certified | Bounded | Estimated
CHANCE = 0.0027  # that a normal number is further off than three standard errors
NEARLY_ALL = 0.95  # of our runs, for a claim to count as reproduced
RARE = 0.01  # a smaller chance counts as none: our choice; 299 runs without a case show it
MEAN_RETURN = "mean return in points"


class ClaimVerdict(StrEnum):
    """The verdict on a claim."""

    AGREES = "agrees"  # of an input
    DIFFERS = "differs"
    REPRODUCED = "reproduced"
    COMPATIBLE = "compatible"  # an average within chance
    SEEN = "seen in some runs"
    DEPENDS = "depends on the reading"  # not under the default one, but under others
    NOT_REPRODUCED = "not reproduced"
    NOT_DETERMINED = "not determined"


HOLDS = {ClaimVerdict.AGREES, ClaimVerdict.REPRODUCED, ClaimVerdict.COMPATIBLE, ClaimVerdict.SEEN}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """The result of checking a claim under one reading."""

    verdict: ClaimVerdict
    why: str  # in a sentence or two
    says: str = ""  # the verdict with its number, "seen in 24 % of runs"; else the bare word
    number: Number | None = None  # the exact counterpart of the paper's number
    number_is: str = ""  # what that number is
    paper: Fraction | float | None = None
    standard_error: float | None = None  # the exact one of the paper's average
    details: Mapping[str, Any] = field(default_factory=dict)  # more, for `numbers.json`


@dataclass(frozen=True, kw_only=True)
class PaperClaim:
    """One claim: its name, its places in the paper, its words, and the function that checks it.

    `open` claims hinge on what the text leaves open and are tried under other readings; those that
    `learn` take training runs. A claim that `follows` another one fails because that one does: both
    are one fact.
    """

    id: str
    places: tuple[str, ...]
    says: str
    rule: str
    kind: Literal["input", "finding"]
    check: Callable[[Reading], Finding]
    code: str
    open: bool = False
    learns: bool = False
    follows: str = ""

    def find(self, reading: Reading) -> Finding:
        """Check the claim under a reading."""
        finding = self.check(reading)
        words = {
            ClaimVerdict.REPRODUCED: ClaimVerdict.AGREES,
            ClaimVerdict.NOT_REPRODUCED: ClaimVerdict.DIFFERS,
        }
        if self.kind == "input":
            finding = replace(finding, verdict=words.get(finding.verdict, finding.verdict))
        if finding.says:
            return finding
        return replace(finding, says=str(finding.verdict))


CLAIMS: dict[str, PaperClaim] = {}
"""Every claim by its name, in the order of the paper; filled by the sections."""


def register_claim(
    name: str,
    *places: str,
    rule: str = "statement",
    kind: Literal["input", "finding"] = "finding",
    each: Mapping[str, str] | None = None,
    **more: Any,
) -> Callable[[Callable[..., Finding]], Callable[..., Finding]]:
    """Return a decorator that makes a function a claim, or one claim for `each` of some words.

    The function then takes the word too; {word} in the name and the docstring stands for it, and
    {means} for its meaning.
    """

    def keep_claim(function: Callable[..., Finding]) -> Callable[..., Finding]:
        where = function.__module__.rpartition(".")[2]
        text = " ".join((function.__doc__ or "").split())
        for word, means in (each or {"": ""}).items():
            one = name.format(word=word)
            CLAIMS[one] = PaperClaim(
                id=one,
                places=places,
                says=text.format(word=word, means=means),
                rule=rule,
                kind=kind,
                check=_bind_word(function, word) if each else function,
                code=f"{where}.py, {function.__name__}",
                **more,
            )
        return function

    return keep_claim


def _bind_word(function: Callable[..., Finding], word: str) -> Callable[[Reading], Finding]:
    return lambda reading: function(reading, word)


# ---- the rules -----------------------------------------------------------------------------------


def judge_statement(holds: bool, why: str, **more: Any) -> Finding:
    """Judge by a predicate."""
    if holds:
        verdict = ClaimVerdict.REPRODUCED
    else:
        verdict = ClaimVerdict.NOT_REPRODUCED
    return Finding(verdict=verdict, why=why, **more)


def compare_entries(
    paper: Mapping[str, Fraction], model: Mapping[str, Fraction], note: str = ""
) -> Finding:
    """Compare the numbers of a table with the model's, all exact."""
    off = {name: model[name] for name, number in paper.items() if model[name] != number}
    why = f"{len(paper) - len(off)} of {len(paper)} entries agree{note}"
    why += "".join(f"; {name} is {value}" for name, value in off.items())
    return judge_statement(
        not off,
        why,
        number=Certified(value=Fraction(len(paper) - len(off))),
        number_is="entries that agree",
        paper=Fraction(len(paper)),
        details={"entries": {name: str(value) for name, value in model.items()}},
    )


def compare_approximately(paper: float, number: Number, why: str = "", **more: Any) -> Finding:
    """Compare a number that the text says approximately."""
    apart = float(abs(number.value - paper))
    if apart <= ABOUT:
        wording = f"within {ABOUT:g} of {paper:g}"
    else:
        wording = f"more than {ABOUT:g} from {paper:g}"
    said = "; ".join(filter(None, [f"{wording}, which the text says approximately", why]))
    more = {"paper": paper, "number": number, "number_is": MEAN_RETURN, **more}
    return judge_distance(apart, ABOUT, said, **more)


def judge_distance(apart: float, limit: float, why: str, *, number: Number, **more: Any) -> Finding:
    """Judge by whether a distance is within a limit; an estimate near the limit decides nothing."""
    if isinstance(number, Estimated) and abs(apart - limit) <= 3 * number.standard_error:
        why += "; too few runs to tell on which side of the limit the number is"
        return judge_undecided(why, number=number, **more)
    return judge_statement(apart <= limit, why, number=number, **more)


def compare_average(
    paper: float, mean: float, sd: float, n: int, *, error: float, why: str
) -> Finding:
    """Compare an average of n experiments with its exact mean, by their exact standard error."""
    standard_error = sd / sqrt(n)
    # The two-sided tail of the normal distribution.
    chance = erfc(abs(mean - paper) / standard_error / sqrt(2))
    number = Bounded(value=mean, error=error)
    numbers: dict[str, Any] = {"paper": paper, "number": number, "number_is": MEAN_RETURN}
    return judge_by_chance(chance, why, standard_error=standard_error, **numbers)


def judge_by_chance(chance: float, why: str, **more: Any) -> Finding:
    """Judge by the probability of a result that is at least as far off."""
    within = chance >= CHANCE
    if within:
        verdict = ClaimVerdict.COMPATIBLE
    else:
        verdict = ClaimVerdict.NOT_REPRODUCED
    return Finding(verdict=verdict, why=why, says=f"{verdict}, {format_chance(chance)}", **more)


def format_chance(chance: float) -> str:
    """Return a probability for reading; a smaller one than any float is not printed as 0.

    >>> format_chance(0.01), format_chance(0.0)
    ('p = 0.01', 'p < 1e-300')
    """
    if chance < 1e-300:
        return "p < 1e-300"
    return f"p = {chance:.2g}"


def format_per_cent(share: float) -> str:
    """Return a share for reading; only 1 is printed as 100 %.

    >>> [format_per_cent(share) for share in (0.0, 0.0002, 0.0175, 0.24, 0.9975)]
    ['none', 'under 0.1 %', '1.8 %', '24 %', 'over 99 %']
    """
    if share == 0:
        return "none"
    if share < 0.001:
        return "under 0.1 %"
    if 0.995 <= share < 1:
        return "over 99 %"
    if share < 0.095:
        return f"{100 * share:.1f} %"
    return f"{100 * share:.0f} %"


def judge_by_runs(
    count: int, total: int, what: str, why: str, *, independent: int | None = None, **more: Any
) -> Finding:
    """Judge by how many of our own runs show it; so many of them are independent, or all."""
    part, sample = count / total, independent or total
    # The upper end of the confidence interval for none of so many (Clopper and Pearson); by
    # symmetry the lower end for all of them is as far from 1.
    upper = 1 - 0.05 ** (1 / sample)
    details = {"count": count, "runs": total, **more.pop("details", {})}
    if count == 0:
        details["chance_below"] = below = ceil(1000 * upper) / 1000
        why += f"; {sample} of the {what} are independent, so with 95 % confidence the chance is "
        why += f"below {100 * below:.1f} %"
    says = f"seen in {format_per_cent(part)} of {total:,} {what}"
    if part >= NEARLY_ALL and 1 - upper >= NEARLY_ALL:
        verdict = ClaimVerdict.REPRODUCED
    elif 0 < part < NEARLY_ALL:
        verdict = ClaimVerdict.SEEN
    elif count == 0 and upper < RARE:
        verdict = ClaimVerdict.NOT_REPRODUCED
    else:
        verdict = ClaimVerdict.NOT_DETERMINED
    if verdict is not ClaimVerdict.SEEN:
        says = f"{verdict}, {says}"
    # Jeffreys' estimate of the share gives the standard error.
    smooth = (count + 0.5) / (total + 1)  # not 0 where all runs are alike
    number = Estimated(value=part, standard_error=sqrt(smooth * (1 - smooth) / total))
    more = {"number": number, "number_is": f"share of the {what}", **more}
    return Finding(verdict=verdict, why=why, says=says, details=details, **more)


def judge_undecided(why: str, **more: Any) -> Finding:
    """Say why nothing here can decide a claim."""
    return Finding(verdict=ClaimVerdict.NOT_DETERMINED, why=why, **more)


# ---- all claims, checked -------------------------------------------------------------------------


def judge_claims(
    claims: list[PaperClaim], default: Reading, others: list[Reading], best: Reading
) -> Iterator[dict[str, Any]]:
    """Yield each claim with its finding, as `numbers.json` holds it.

    Open claims are tried under `others` and under the best supported reading, too; if they hold
    under some of these and not under the default, the verdict says so.
    """
    for each in claims:
        finding = each.find(default)
        entry = entry_of(each, finding)
        # Claims that depend on the reading, or on training, are judged under the best one, too.
        if each.open or each.learns:
            there = each.find(best)
            entry["verdict_under_best_supported_reading"] = there.says
            if each.open:
                # Open claims are tried under every single change.
                tried = {other.label: each.find(other).verdict for other in others}
                tried |= {default.label: finding.verdict, best.label: there.verdict}
                holding = [label for label, verdict in tried.items() if verdict in HOLDS]
                entry["under_other_readings"] = {
                    "tried": len(tried),
                    "reproduced": len(holding),
                    "example": next(iter(holding), ""),
                }
                if depends_on_reading(finding, tried.values()):
                    entry["verdict"] = entry["verdict_says"] = str(ClaimVerdict.DEPENDS)
        yield entry


def depends_on_reading(finding: Finding, others: Iterable[ClaimVerdict]) -> bool:
    """Return whether a claim fails under the default reading and holds under another."""
    fails = finding.verdict in (ClaimVerdict.NOT_REPRODUCED, ClaimVerdict.DIFFERS)
    return fails and any(verdict in HOLDS for verdict in others)


def entry_of(each: PaperClaim, finding: Finding) -> dict[str, Any]:
    """Return a claim with a finding, as JSON."""
    number, paper, errors = finding.number, finding.paper, finding.standard_error
    if number is None:
        exact = None
    else:
        exact = number.value
    if exact is None or paper is None:
        apart = None
    else:
        apart = float(exact - paper)
    return {
        "name": each.id,
        "kind": each.kind,
        "source": ", ".join(each.places),
        "says": each.says,
        "paper": None if paper is None else float(paper),
        "exact": None if exact is None else float(exact),
        "exact_is": finding.number_is or None,
        "exact_rational": str(exact) if isinstance(exact, Fraction) else None,
        "difference": apart,
        "claim": None if number is None else str(number.claim),
        "error_bound": number.error if isinstance(number, Bounded) else None,
        # It is 0 if the sample shows no spread, which says nothing about the error.
        "estimate_standard_error": getattr(number, "standard_error", None) or None,
        "standard_error": errors,
        "difference_in_standard_errors": apart / errors if apart is not None and errors else None,
        "approximate": each.rule == "about",
        "rule": each.rule,
        "verdict": str(finding.verdict),
        "verdict_says": finding.says,
        "verdict_of_default_reading": str(finding.verdict),
        "verdict_under_best_supported_reading": None,
        "why": finding.why,
        "under_other_readings": None,
        "rerun": f"python -m exact_mdp.paper_repro claim {each.id}",
        "code": each.code,
        "follows": each.follows or None,
        **finding.details,
    }
