"""The first page of the report: what was found, in words that need no mathematics.

A sentence is one of two for its claim, chosen by the verdict; its numbers are computed. What the
words explain besides (that a hint keeps statuses from setting in, say) rests on the inputs of the
model, which are claims of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims import Judged, Verdict
from exact_mdp.paper_repro.claims.claim import Kind
from exact_mdp.paper_repro.numbers import FINAL
from exact_mdp.paper_repro.view import View

ABOUT = (
    "The paper lets a simulated robot learn, by trial and error, which kind of spoken help to give "
    "a simulated person living with dementia. The simulation follows fixed probabilities. So the "
    "best possible help can also be computed, without trial and error, and everything that the "
    "paper reports can be held against it. That is done here, claim by claim."
)
LIMITS = (
    "This is about a simulation with invented probabilities, by its authors' own account a "
    "simplification. It says nothing about any person, and it is not medical advice."
)


@dataclass(frozen=True, kw_only=True)
class Plain:
    """One finding in plain words.

    Attributes
    ----------
    verdict : Verdict
    text : str
    claim : str
        The claim that it rests on.
    """

    verdict: Verdict
    text: str
    claim: str


PLAIN_ACTIONS = {
    "none": "no help",
    "supportive": "encouragement",
    "non-directive": "a hint",
    "directive": "clear instruction",
}

# For each claim what to say where it is reproduced, and where it is not.
WORDS: dict[str, tuple[str, str]] = {
    "policy.anger": (
        "When the person is angry, encouragement is best, whatever else is the matter. The paper "
        "says so, and it is exactly right.",
        "When the person is angry, encouragement is not always best, as the paper says it is.",
    ),
    "policy.1100": (
        "When the person is forgetful and confused, but neither angry nor disengaged, clear "
        "instruction is best, as the paper says.",
        "When the person is forgetful and confused, clear instruction is not best, unlike what "
        "the paper says.",
    ),
    "policy.0100": (
        "When the person is confused only, a hint is best, as the paper says.",
        "When the person is confused only, the paper's policy, as its sentence is written, gives a "
        "hint; clear instruction is better. This costs {confused:.1f} of {optimum:.1f} points on "
        "average.",
    ),
    "policy.0000": (
        "When nothing is the matter, a hint is best: it keeps the person from becoming forgetful "
        "or confused. The paper finds this too.",
        "When nothing is the matter, a hint is not best, unlike what the paper finds.",
    ),
    "learning.superior": (
        "What the robot learns is better than help at random in every one of our training runs.",
        "What the robot learns is not always better than help at random.",
    ),
    "return.random": (
        "Help at random earns {random:.0f} points on average, about as the paper's plot shows.",
        "Help at random earns {random:.0f} points on average, where the paper's plot shows about "
        "{plotted}: either the text is to be read otherwise, or the paper's simulation differs "
        "from it.",
    ),
    "return.together": (
        "The three averages that the paper gives agree with exact computation where what the text "
        "leaves open is filled in as fits them best, the best of {ways} ways: with {one} when the "
        "person is forgetful only, {other} when confused only, which is the paper's sentence "
        "{order}.",
        "The three averages that the paper gives do not agree with exact computation, in whichever "
        "of {ways} ways what the text leaves open is filled in, under the reading of the text that "
        "is used here first; other readings are tried below.",
    ),
    "policy.final-is-optimal": (
        "The paper's final policy is the best there is.",
        "The paper's final policy stays {near:.1f} to {far:.1f} points below the best possible "
        "{optimum:.1f}, depending on how “respectively” is read: {reported:.1f} with the sentence "
        "as written, {fitting:.1f} with it {order} and the rest filled in as fits the averages "
        "best. Nothing that the text leaves open closes the gap: {least:.1f} points at least.",
    ),
}


def plain(judged: Sequence[Judged], view: View) -> list[Plain]:
    """Return the findings in plain words, for the claims that were worked out."""
    by_name = {each.claim.id: each for each in judged}
    values = view.study.evaluations
    final = f"reported.{FINAL}"
    open_ = view.study.completions
    filled = open_.choices[open_.fitting]
    best, fitting = values["optimal"].mean, float(open_.mean[FINAL][open_.fitting])
    lost = sorted((best - values[final].mean, best - fitting))
    costs = {}
    if "policy.final-is-optimal" in by_name:
        costs = by_name["policy.final-is-optimal"].finding.details["cost_by_status"]
    numbers = {
        "optimum": best,
        "random": values["random"].mean,
        "plotted": reported.RANDOM_RETURN,
        "reported": values[final].mean,
        "fitting": fitting,
        "near": lost[0],
        "far": lost[1],
        "least": best - open_.range(FINAL)[1],
        "confused": costs.get("0100", 0.0),
        "ways": len(open_.choices),
        "one": PLAIN_ACTIONS[filled["1000"]],
        "other": PLAIN_ACTIONS[filled["0100"]],
        "order": reported.order(filled),
    }
    found = []
    for name, (yes, no) in WORDS.items():
        if name not in by_name:
            continue
        verdict = by_name[name].verdict
        text = yes if verdict is Verdict.REPRODUCED else no
        found.append(Plain(verdict=verdict, text=text.format(**numbers), claim=name))
    return found


def counts(judged: Sequence[Judged], kind: Kind) -> dict[str, int]:
    """Return how many inputs, or findings, have each verdict."""
    listed = [each.verdict for each in judged if each.claim.kind == kind]
    return {str(v): listed.count(v) for v in Verdict}


def counted(judged: Sequence[Judged]) -> str:
    """Return the counts in words: inputs first, then findings."""
    inputs, findings = counts(judged, "input"), counts(judged, "finding")
    same, apart, unsettled = inputs.values()
    rest = [f"{apart} differ" if apart else "", f"{unsettled} stay open" if unsettled else ""]
    more = "".join(f", {text}" for text in rest if text)
    yes, no, unknown = findings.values()
    return (
        f"{sum(inputs.values())} inputs (numbers, settings and definitions) were transcribed into "
        f"the model: {same} are the paper's{more}. Of {sum(findings.values())} findings {yes} are "
        f"reproduced, {no} are not, and {unknown} cannot be decided here."
    )
