"""What is decided of a policy, and what was found: a verdict for each limit.

A policy passes only by proof: a decision that bounds or records leave open is None, and no pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf, isfinite, isinf

from exact_mdp.solvers.solution import Bounded, Certified

UNDECIDED = (
    "which the bounds do not decide: give a limit that they keep (--max-regret,"
    " max_regret=…), or ask for exact values (--certify, exact_values=True)"
)


@dataclass(frozen=True)
class Verdict:
    """One thing that was checked, such as "the regret" "at most 1/2", and what was found.

    Attributes
    ----------
    subject, limit : str
    decision : bool or None
        Whether it holds; None where bounds or records leave that open, which does not pass.
    text : str
        What was found.

    Examples
    --------
    >>> verdict = Verdict("the regret", "zero", False, "it is 2")
    >>> verdict.name, verdict.passed, verdict.told
    ('the regret is zero', False, 'the regret is not zero: it is 2')
    """

    subject: str
    limit: str
    decision: bool | None
    text: str

    @property
    def name(self) -> str:
        """What was checked."""
        return f"{self.subject} is {self.limit}"

    @property
    def passed(self) -> bool:
        """Whether it holds."""
        return self.decision is True

    @property
    def told(self) -> str:
        """What was found, as a sentence: the name of a check that fails is not what was found."""
        holds = {True: "is", False: "is not", None: "is not known to be"}[self.decision]
        return f"{self.subject} {holds} {self.limit}: {self.text}"

    def __str__(self) -> str:
        return f"{'passed' if self.passed else 'failed'}: {self.told}"


def number(value: Certified | Bounded) -> str:
    """Return a number with its claim; an exact one may have thousands of digits, and is rounded."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


def share_of(lost: Certified | Bounded, best: Certified | Bounded) -> float | None:
    """Return a regret over the absolute optimal value; None where that is, or may be, 0."""
    low, high = (best.value, best.value) if isinstance(best, Certified) else best.interval
    if not isfinite(float(best)) or low <= 0 <= high:
        return None
    return inf if isinf(float(lost)) else float(Fraction(lost.value) / abs(Fraction(best.value)))
