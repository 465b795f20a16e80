"""The part of the report about the learner's own settings: which claim holds under which.

Every claim about learning is worked out anew under each set of settings; nothing else differs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from exact_mdp.paper_repro.claims import Finding, Judged, PaperClaim, Verdict
from exact_mdp.paper_repro.claims.learning import shown_together
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.readings.learner import LEARNERS, POINTS, PROGRAM, prior
from exact_mdp.paper_repro.report.report import Part
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.solvers.solution import Estimated

WORDS = {Verdict.REPRODUCED: "yes", Verdict.NOT_REPRODUCED: "no", Verdict.NOT_DETERMINED: "open"}


def learner_part(judged: Sequence[Judged], reading: Reading) -> Part:
    """Return what becomes of the claims about learning under other settings of the learner."""
    found: dict[PaperClaim, dict[str, Finding]] = {
        each.claim: {
            "default": each.finding,
            **{other.label: each.claim.find(other) for other in reading.learners},
        }
        for each in judged
        if each.claim.varies
    }
    return Part(
        title="Which learner was it?",
        sentences=(
            "The text does not say whether the end of an episode is masked in the learner's "
            "target, or how ties break; where ε falls and which are the last 100 episodes it says "
            "in words that code may have followed otherwise. Each is varied here by itself, with "
            f"{reading.varied} runs of each schedule.",
            f"An earlier public program of the authors, for another task ({PROGRAM}), is evidence: "
            "it looks beyond the end of an episode, breaks ties at random while it learns, takes "
            "the lowest index where it records a policy, pays for the next status and evaluates "
            "without discount. It counts as one observation, as do the words of the text, with "
            "Jeffreys' prior: "
            + "; ".join(
                f"{point}: " + ", ".join(f"{o.name} {prior(point, o):.0%}" for o in options)
                for point, options in POINTS.items()
            )
            + ". Weights below are those of the settings tried, and add up to 1.",
            _anger(found),
            "The step that falls, for status 0000, is 0.5 n^-0.7 at the n-th update, and "
            f"0.5 n^-0.55 where the end is not masked: values are {_larger(reading)} times as "
            "large there, by status, and the faster fall does not reach them in as many epochs.",
        ),
        figures=(),
        tables=(_settings(found), _funnel(reading)),
    )


def _larger(reading: Reading) -> str:
    """Say by how much what is learned grows where the end is not masked, with a constant ε."""
    end = next(each for each in reading.learners if each.training.get("bootstrap_end"))
    with_end, masked = (
        np.stack([run.q.max(axis=1) for run in each.learned("constant").runs]).mean(axis=0)
        for each in (end, reading)
    )
    factor = with_end / masked
    return f"{factor.min():.1f} to {factor.max():.1f}"


def _anger(found: Mapping[PaperClaim, Mapping[str, Finding]]) -> str:
    """Say what masking the end does to the statuses with anger."""
    told = [
        f"{claim.says.rstrip('.')}: {by['default'].exact:.0%} of the runs where the end is masked, "
        f"{by['end not masked'].exact:.0%} where it is not"
        for claim, by in found.items()
        if claim.id.startswith("learning.anger.")
    ]
    return f"{'. '.join(told)}."


def _settings(found: Mapping[PaperClaim, Mapping[str, Finding]]) -> Table:
    rows: list[tuple[str, ...]] = [
        ("weight before any run", *(f"{each.weight:.0%}" for each in LEARNERS), "")
    ]
    for claim, by in found.items():
        holding = sum(
            each.weight for each in LEARNERS if by[each.label].verdict is Verdict.REPRODUCED
        )
        rows.append((claim.says, *(_cell(by[each.label]) for each in LEARNERS), f"{holding:.0%}"))
    return Table(
        title="Claims about learning under other settings of the learner",
        headings=("claim", *(each.label for each in LEARNERS), "weight where it holds"),
        rows=tuple(rows),
        note="Yes, no, or open where the runs are too few to tell, by the rule of the claim; with "
        "the share of runs, or the number, that decides. One change from the default at a time, "
        "and the settings of the earlier program.",
    )


def _cell(found: Finding) -> str:
    word = WORDS[found.verdict]
    if not isinstance(found.number, Estimated):
        return word
    if "count" in found.details or "falling_step" in found.details:
        share = found.details.get("share", found.number.value)
        return f"{word}, {share:.0%}"
    return f"{word}, {found.number.value:.1f}".replace("-", "−")


def _funnel(reading: Reading) -> Table:
    rows, held = [], np.array(True)
    for name, each in shown_together(reading).items():
        held = held & each
        rows.append((name, f"{each.mean():.2%}", f"{held.mean():.3%}", f"{int(held.sum()):,}"))
    return Table(
        title="All that is told of the two runs, taken together",
        headings=("what the two runs show", "share of pairs", "with all above", "pairs left"),
        rows=tuple(rows),
        note=f"Of the {held.size:,} pairs of a run with constant and one with decaying "
        "exploration, under the default settings.",
    )
