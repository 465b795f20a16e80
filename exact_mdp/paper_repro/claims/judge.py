"""Working the claims out: under the default reading, and under others where the text is open.

What "under some reading" means depends on the claim. Average returns are known for all 6,912
readings and every policy that the text may mean (`paper_repro.readings.search`). Other open claims
are worked out anew under the sixteen readings that differ from the default in one point and under
the readings that the evidence supports best.

`expected.toml` pins what each claim comes to. It is written by hand: each published number with its
value, a tolerance and the reason for both. `python -m paper_repro --candidates` prints what a run
finds in the same form; whoever changes the file compares the two and says why. No code writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.paper_repro.claims import interaction, learning, model, policies, returns
from exact_mdp.paper_repro.claims.claim import Finding, PaperClaim, Verdict
from exact_mdp.paper_repro.reading import Reading, Sizes
from exact_mdp.paper_repro.readings.evidence import Evidence
from exact_mdp.paper_repro.readings.wording import changes, in_words

EXPECTED = Path(__file__).parent.parent / "expected.toml"
SCOPE_ONE_CHANGE = "readings tried (the default, and those with one change)"
SCOPE_SUPPORTED = "readings tried (the default, those with one change, and the best supported)"


SCOPE_LEARNER = "settings of the learner tried (the default, one change, and an earlier program's)"


@dataclass(frozen=True, kw_only=True)
class OtherReadings:
    """How many of the readings tried agree with a claim."""

    tried: int
    reproduced: int
    example: str  # one that agrees, the default first; empty where none does
    scope: str  # which readings were tried

    @property
    def text(self) -> str:
        """One line."""
        share = f"{self.reproduced:,} of {self.tried:,} {self.scope}"
        if 0 < self.reproduced < self.tried and self.example != "default":
            return f"{share}, such as {self.example}"
        return share


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A claim with its finding under the default reading.

    `others` says how many other readings agree; it is None where no reading touches the claim.
    """

    claim: PaperClaim
    finding: Finding
    others: OtherReadings | None = None

    @property
    def verdict(self) -> Verdict:
        """The verdict: of the default reading, unless it fails there and holds under others."""
        elsewhere = self.others is not None and self.others.reproduced > 0
        if elsewhere and self.finding.verdict is Verdict.NOT_REPRODUCED:
            return Verdict.DEPENDS
        return self.finding.verdict


def all_claims() -> list[PaperClaim]:
    """Return every claim, in the order of the paper.

    >>> found = all_claims()
    >>> found[0].id, len({claim.id for claim in found}) == len(found)
    ('simulator.open-source', True)
    """
    parts = (model.CLAIMS, learning.CLAIMS, returns.CLAIMS, policies.CLAIMS, interaction.claims())
    return [claim for part in parts for claim in part]


def chosen(name: str) -> PaperClaim:
    """Return a claim by its name; raises ModelError with the nearest one for an unknown name.

    >>> chosen("return.random").paper
    70
    """
    known = {claim.id: claim for claim in all_claims()}
    if name not in known:
        raise ModelError(f"unknown claim {name!r}", where="--claim", fix=suggest(name, known))
    return known[name]


def judge(
    claims: Sequence[PaperClaim],
    reading: Reading,
    *,
    others: Iterable[Reading] = (),
    learners: Iterable[Reading] = (),
    evidence: Evidence | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> list[Judged]:
    """Work claims out under the default reading, and open ones under others too.

    With the evidence of all readings, claims about average returns are judged under all of them.
    `learners` are readings with other settings of the learner, for the claims about learning.
    """
    known = {} if evidence is None else agreeing(evidence)
    findings = []
    for claim in claims:
        progress(claim.id)
        findings.append(claim.find(reading))
    again = tried_again(claims, evidence)
    seen: dict[str, dict[str, Verdict]] = {
        claim.id: {reading.label: finding.verdict}
        for claim, finding in zip(claims, findings, strict=True)
    }
    for other in others if again else ():
        progress(other.label)
        for name, verdict in verdicts(other, again).items():
            seen[name].setdefault(other.label, Verdict(verdict))
    varied = [claim for claim in claims if claim.varies]
    for other in learners if varied else ():
        progress(other.label)
        for name, verdict in verdicts(other, varied).items():
            seen[name][other.label] = Verdict(verdict)
    scope = SCOPE_ONE_CHANGE if evidence is None else SCOPE_SUPPORTED
    scopes = {claim.id: SCOPE_LEARNER for claim in varied}
    return [
        Judged(
            claim=claim,
            finding=finding,
            others=known.get(claim.id, _tally(tried, scopes.get(claim.id, scope))),
        )
        for claim, finding, tried in zip(claims, findings, seen.values(), strict=True)
    ]


def tried_again(claims: Sequence[PaperClaim], evidence: Evidence | None) -> list[PaperClaim]:
    """Return the claims that are worked out under other readings, one by one."""
    known = {} if evidence is None else agreeing(evidence)
    return [claim for claim in claims if claim.open and claim.id not in known]


def verdicts(reading: Reading, claims: Sequence[PaperClaim]) -> dict[str, str]:
    """Return the verdict of each claim under a reading, from the store where it is there."""

    def work() -> dict[str, str]:
        return {claim.id: str(claim.find(reading).verdict) for claim in claims}

    names = sha256("+".join(claim.id for claim in claims).encode()).hexdigest()[:12]
    return dict(reading.store.json(f"verdicts-{reading.place}-{names}-{reading.runs}", work))


def _tally(tried: dict[str, Verdict], scope: str) -> OtherReadings | None:
    """Count the readings that agree; None where the default one alone was tried."""
    if len(tried) == 1:
        return None
    agree = [label for label, verdict in tried.items() if verdict is Verdict.REPRODUCED]
    example = in_words(agree[0]) if agree else ""
    return OtherReadings(tried=len(tried), reproduced=len(agree), example=example, scope=scope)


@cache
def agreeing(evidence: Evidence) -> dict[str, OtherReadings]:
    """Return, for claims about average returns, how many of all readings agree.

    An example is the default or else the best supported reading that agrees.
    """
    search, found = evidence.search, {}
    weighed = replace(search.averages, log_weights=evidence.log_weights)
    listed = returns.agreement(weighed, search.random_mean, search.optimum)
    for name, holds in listed.items():
        ranked = [0] if holds[0] else evidence.ranking[holds[evidence.ranking]]
        example = changes(search.space, int(ranked[0])) if len(ranked) and ranked[0] else "default"
        found[name] = OtherReadings(
            tried=len(holds),
            reproduced=int(holds.sum()),
            example=example if len(ranked) else "",
            scope="readings",
        )
    return found


def best_supported(evidence: Evidence, base: Reading, sizes: Sizes) -> Iterator[Reading]:
    """Yield the readings that the evidence supports best."""
    search = evidence.search
    for number in evidence.ranking[: sizes.supported].tolist():
        yield base.other(search.space.label(number), search.reading(number))


# ---- pinned values -----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Pinned:
    """What a claim is expected to come to under the default reading."""

    verdict: str | list[str]  # a list where the number of runs decides
    reason: str  # why the value is believed, and why the tolerance is what it is
    value: float | None = None  # None for a claim without a number
    tolerance: float | None = None


def expected(path: Path = EXPECTED) -> dict[str, Pinned]:
    """Read the pinned values by claim.

    >>> expected()["table3.base.anger"].value
    0.05
    """
    try:
        data = toml_of(read_text(path, most=SMALL), str(path), number=float)
        return {name: Pinned(**entry) for name, entry in data.items()}
    except TypeError as error:
        raise ModelError(str(error), where=str(path), fix="write it like the others") from error


def disagreements(judged: Sequence[Judged], pinned: dict[str, Pinned]) -> list[str]:
    """Return, claim by claim, what differs from the pinned values; nothing where all agree."""
    found = []
    for each in judged:
        name, exact = each.claim.id, each.finding.exact
        if name not in pinned:
            found.append(f"{name} is not pinned")
            continue
        known = pinned[name]
        allowed = [known.verdict] if isinstance(known.verdict, str) else known.verdict
        verdict = str(each.finding.verdict)
        if verdict not in allowed:
            found.append(f"{name}: {verdict}, pinned {' or '.join(allowed)}")
        if (exact is None) != (known.value is None):
            found.append(f"{name}: {exact}, pinned {known.value}")
        elif exact is not None and known.value is not None:
            off = abs(exact - known.value)
            if not off <= (known.tolerance or 0.0):
                found.append(
                    f"{name}: {exact!r}, pinned {known.value!r} within {known.tolerance or 0.0:g}"
                )
    return found


def candidates(judged: Sequence[Judged]) -> str:
    """Return what a run finds, in the form of `expected.toml`; the reasons are to be written."""
    lines = []
    for each in judged:
        lines += [f'["{each.claim.id}"]', f'verdict = "{each.finding.verdict}"']
        if each.finding.exact is not None:
            lines.append(f"value = {each.finding.exact!r}")
            lines.append("tolerance = 0.0")
        lines += ['reason = ""', ""]
    return "\n".join(lines)
