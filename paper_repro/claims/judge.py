"""Working the claims out: under the default reading, and under others where the text is open.

What "under some reading" means depends on the claim. Average returns are known for all 6,912
readings and every policy that the text may mean (`paper_repro.readings.search`). Other open claims
are worked out anew under the sixteen readings that differ from the default in one point and under
the readings that the evidence supports best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.paper_repro.claims import interaction, learning, model, policies, returns
from exact_mdp.paper_repro.claims.claim import Finding, PaperClaim, Verdict
from exact_mdp.paper_repro.claims.under import (
    SCOPE_ONE_CHANGE,
    SCOPE_VIEWS,
    Readings,
    Under,
    tally,
)
from exact_mdp.paper_repro.view import View

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A claim with its finding.

    Attributes
    ----------
    claim : PaperClaim
    finding : Finding
        Under the default reading.
    under : Under, optional
        Under other readings; None where no reading touches the claim.
    """

    claim: PaperClaim
    finding: Finding
    under: Under | None = None

    @property
    def verdict(self) -> Verdict:
        """The verdict under the default reading."""
        return self.finding.verdict


def all_claims() -> list[PaperClaim]:
    """Return every claim, in the order of the paper.

    Examples
    --------
    >>> found = all_claims()
    >>> found[0].id, len({claim.id for claim in found}) == len(found)
    ('table1.timesteps', True)
    """
    parts = (model, learning, returns, policies, interaction)
    return [claim for part in parts for claim in part.claims()]


def chosen(name: str) -> PaperClaim:
    """Return a claim by its name; raises ModelError with the nearest one for an unknown name.

    Examples
    --------
    >>> chosen("return.random").paper
    70
    """
    known = {claim.id: claim for claim in all_claims()}
    if name not in known:
        raise ModelError(f"unknown claim {name!r}", where="--claim", fix=suggest(name, known))
    return known[name]


def judge(
    claims: Sequence[PaperClaim],
    view: View,
    *,
    others: Iterable[View] = (),
    readings: Readings | None = None,
    progress: Progress = lambda what: None,
) -> list[Judged]:
    """Work claims out.

    Parameters
    ----------
    claims : sequence of PaperClaim
    view : View
        The default reading.
    others : iterable of View
        Readings under which open claims are worked out again.
    readings : Readings, optional
        The search over all readings, which has the average returns of all of them.
    progress : function
        Called with what begins.
    """
    known = {} if readings is None else readings.support
    findings = []
    for claim in claims:
        progress(claim.id)
        findings.append(claim.find(view))
    again = tried_again(claims, readings)
    seen: dict[str, dict[str, Verdict]] = {claim.id: {} for claim in again}
    for other in others if again else ():
        progress(other.label)
        for name, verdict in verdicts(other, again).items():
            seen[name].setdefault(other.label, Verdict(verdict))
    scope = SCOPE_ONE_CHANGE if readings is None else SCOPE_VIEWS
    judged = []
    for claim, finding in zip(claims, findings, strict=True):
        under = known.get(claim.id)
        if under is None and seen.get(claim.id):
            listed = {view.label: finding.verdict} | seen[claim.id]
            under = tally(list(listed.items()), scope)
        judged.append(Judged(claim=claim, finding=finding, under=under))
    return judged


def tried_again(claims: Sequence[PaperClaim], readings: Readings | None) -> list[PaperClaim]:
    """Return the claims that are worked out under other readings, one by one."""
    known = {} if readings is None else readings.support
    return [claim for claim in claims if claim.open and claim.id not in known]


def verdicts(view: View, claims: Sequence[PaperClaim]) -> dict[str, str]:
    """Return the verdict of each claim under a reading, from the store where it is there."""

    def work() -> dict[str, str]:
        return {claim.id: str(claim.find(view).verdict) for claim in claims}

    names = "+".join(claim.id for claim in claims)
    return dict(view.store.json(f"verdicts-{view.place}-{_short(names)}", work))


def _short(text: str) -> str:
    from hashlib import sha256

    return sha256(text.encode()).hexdigest()[:12]
