"""All that is found about the readings, in one call and in plain sentences.

`reading_study(seed=0)` searches all readings, trains under some of them, weighs all by the
evidence, asks which statements can hold together, and audits the reported policy. Training comes in
two steps: under readings drawn at random, which say how likely each completion of the text is where
nothing else is known, then under those that are supported best with these weights. The exact part
takes under a minute on two cores; the training adds a few minutes (fewer with `quick`). With a
folder, what is finished is kept there, and the next call goes on from it.

Each sentence is worked out from the numbers in it; the thresholds are those of
`analysis.readings` (Bayes factors of 3, 20 and 150) and `paper_repro.readings.evidence`
(three standard deviations).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from exact_mdp.analysis.readings import (
    EXCLUDED,
    FAVOURED,
    IDENTIFIED,
    OptionSupport,
    ReadingSpace,
)
from exact_mdp.mdp.table import Integers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import (
    ALIKE,
    EXPERIMENTS,
    ROUNDING,
    STATEMENTS,
    TOGETHER,
    TOLERANCE,
    Evidence,
    Joint,
    contradictions,
    evidence,
    joint,
    variants,
)
from exact_mdp.paper_repro.readings.reported_policy import PolicyUnderReading, under_best_readings
from exact_mdp.paper_repro.readings.search import (
    PAPER_READINGS,
    ReadingSearch,
    search,
    searched,
)
from exact_mdp.paper_repro.readings.training import (
    SEEDS,
    SETTINGS,
    TRAINED,
    LearningEvidence,
    at_random,
    combined,
    completion_weights,
    learning,
    to_train,
)
from exact_mdp.paper_repro.readings.wording import changes, said, title

QUICK = {"sampled": 6, "trained": 5, "seeds": 20, "judged": 2}
FULL = {"sampled": 16, "trained": TRAINED, "seeds": SEEDS, "judged": 5}
WITHOUT_RANDOM = "without the random strategy"  # the variant that leaves that curve out


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingStudy:
    """Which reading it is, as far as the paper's numbers tell."""

    search: ReadingSearch
    evidence: Mapping[str, Evidence]  # by the name of the variant; the first is the main one
    joints: Mapping[int, Sequence[Joint]]  # every set of statements, for 1,000 and 10,000 runs
    sampled: LearningEvidence  # under readings drawn at random
    learned: LearningEvidence  # under the default and the best supported readings
    policies: Sequence[PolicyUnderReading]  # under the default and the best supported readings

    @property
    def main(self) -> Evidence:
        """The evidence with 1,000 experiments and tolerances of 5."""
        return next(iter(self.evidence.values()))

    @property
    def sentences(self) -> list[Sentence]:
        """The findings in plain English."""
        return sentences(self.evidence, self.joints, self.learned)


def reading_study(
    *,
    seed: int,
    space: ReadingSpace = PAPER_READINGS,
    out: str | Path | None = None,
    quick: bool = False,
    sizes: Mapping[str, int] | None = None,
    **how: Any,
) -> ReadingStudy:
    """Return the whole study.

    `seed` is that of the learning runs; everything else is exact. `sizes` says, named as in
    `QUICK`, under how many readings is trained, how often, and under how many of the best supported
    ones the policies are audited. The other arguments are those of `search`.
    """
    size, folder = sizes or (QUICK if quick else FULL), None if out is None else Path(out)
    main, sampled, learned = weighed(
        seed=seed, space=space, out=folder, quick=quick, sizes=size, **how
    )
    evidence = variants(main)
    by_experiments = {each.experiments: each for each in reversed(evidence.values())}
    return ReadingStudy(
        search=main.search,
        evidence=evidence,
        joints={n: joint(by_experiments[n]) for n in EXPERIMENTS},
        sampled=sampled,
        learned=learned,
        policies=under_best_readings(main, size["judged"]),
    )


def weighed(
    *,
    seed: int,
    space: ReadingSpace = PAPER_READINGS,
    out: Path | None = None,
    quick: bool = False,
    sizes: Mapping[str, int] | None = None,
    **how: Any,
) -> tuple[Evidence, LearningEvidence, LearningEvidence]:
    """Return the evidence with the completions weighed, and the training that weighs them."""
    size, kind = sizes or (QUICK if quick else FULL), "-quick" if quick else ""
    found = search(space=space, out=out and out / "search", **how)

    def trained(name: str, readings: Integers) -> LearningEvidence:
        folder = out and out / f"{name}{kind}"
        return learning(found, readings, seeds=size["seeds"], seed=seed, out=folder, **how)

    sampled = trained("sampled", at_random(space, size["sampled"], seed))
    first = evidence(found, log_weights=completion_weights(space, sampled))
    best = to_train(first, size["trained"])
    learned = trained("learning", np.array(list(dict.fromkeys([*best.tolist(), 0]))))
    weights = completion_weights(space, sampled, [learned])
    return replace(first, log_weights=weights), sampled, learned


def weighed_before(out: Path | None, *, quick: bool) -> bool:
    """Return whether a folder holds all that `weighed` works out, which is then read at once."""
    if out is None or not searched(out / "search"):
        return False
    size, kind = QUICK if quick else FULL, "-quick" if quick else ""
    return all(
        len(list((out / f"{name}{kind}").glob("*.npz"))) >= size[what]
        for name, what in (("sampled", "sampled"), ("learning", "trained"))
    )


# ---- in plain sentences ------------------------------------------------------------------------


class Sentence(NamedTuple):
    """One finding.

    Its kind is identified, favoured, not identified, fit, cannot hold together, equivalent,
    optimal, or learning; method for those that say how the others come about.
    """

    kind: str
    text: str


def sentences(
    found: Mapping[str, Evidence],
    joints: Mapping[int, Sequence[Joint]],
    learned: LearningEvidence | None = None,
) -> list[Sentence]:
    """Return what is identified, what is not, and what cannot hold together.

    From `variants`, the main one first, and by number of experiments what `joint` gives.
    """
    main = next(iter(found.values()))
    return [
        *_fit(main, found.get(ALIKE)),
        *_options(main.support, "", found.get(WITHOUT_RANDOM)),
        *_options(main.completion_support(), "the policy's"),
        *_variants(found),
        *_together(main, joints),
        *_optimal(main.search),
        _equivalent(main.search),
        *(_learning(main, learned) if learned is not None else ()),
    ]


def method(main: Evidence) -> list[Sentence]:
    """Return how the other sentences come about, with the limits that they use."""
    space, options = main.search.space, len(main.search.completions)
    texts = (
        f"How it is done: each of {len(space):,} readings with each of {options} completions of "
        "the policies gives exact means and variances. A reported average is taken as normal about "
        "its exact mean with the exact standard error; its likelihood is the probability of the "
        f"interval ± {ROUNDING:g} that is rounded to it. The numbers read off the plot are taken "
        f"as normal with a standard deviation of {TOLERANCE:g}.",
        "Weights follow from a uniform prior over the readings, completions averaged out; a "
        "completion has the weight with which training of both schedules ends with it, estimated "
        "under the readings that were trained and, for all others, under readings drawn at "
        "random. An "
        f"option is identified where every other has a Bayes factor of at least {IDENTIFIED:g} "
        f"against it, favoured from {FAVOURED:g}, and excluded where the factor against it is "
        f"{EXCLUDED:g} or more.",
        "Statements can hold together where some reading and completion leaves none of them "
        f"further off than {TOGETHER:g} standard deviations: for a number read off the plot "
        f"{TOGETHER * TOLERANCE:g}, three times the hard limit of the claims.",
        "Sentences that begin with “Variant” repeat the whole with another number of experiments, "
        "other standard deviations for the numbers read off the plot, or without them, and name "
        "the verdicts that change.",
    )
    return [Sentence("method", text) for text in texts]


def _fit(found: Evidence, alike: Evidence | None) -> Iterator[Sentence]:
    space = found.search.space
    first, second = found.ranking[:2].tolist()
    ratio, default = np.exp(found.marginal[first] - found.marginal[[second, 0]]).tolist()
    yield Sentence(
        "fit",
        f"No single reading wins: the best supported one ({changes(space, first)}) has "
        f"{found.weights[first]:.1%} of the weight and is {ratio:.2f} times as likely as the "
        f"second; {len(found.credible())} of {len(space):,} readings are needed for 95 % of the "
        f"weight, and the weights are as spread as {found.effective_number:.0f} equal ones.",
    )
    unweighed = (
        ""
        if alike is None
        else (
            f" Were all completions alike, it would be number {alike.rank():,} with "
            f"{100 * alike.weights[0]:.2g}%."
        )
    )
    yield Sentence(
        "fit",
        f"The default reading is number {found.rank():,} in the order, with "
        f"{100 * found.weights[0]:.2g}% of the weight; the best supported reading makes the "
        f"reported numbers {default:,.0f} times as likely.{unweighed}",
    )


def _options(
    listed: Sequence[OptionSupport], what: str, without: Evidence | None = None
) -> Iterator[Sentence]:
    """Say what is found of each reading, and what of it depends on the random strategy's curve."""
    others = {} if without is None else _best(without.support)
    for name, verdict in _best(listed).items():
        options = [each for each in listed if each.reading == name]
        best = min(options, key=lambda each: each.log10_against)
        weights = ", ".join(f"{said(name, each.option)} {each.weight:.1%}" for each in options)
        out = [said(name, each.option) for each in options if each.verdict == "excluded"]
        also = f"; excluded: {', '.join(out)}" if out and len(out) < len(options) - 1 else ""
        about = f"{what} {title(name)}".strip()
        if best.verdict == "not identified":
            text = f"{about} is not identified ({weights}){also}."
        else:
            text = f"{about}: {said(name, best.option)} is {best.verdict} ({weights}){also}."
            if others.get(name, verdict) != verdict:
                wholly = " wholly" if others[name] == "not identified" else ""
                text += (
                    f" This rests{wholly} on the number read off the random strategy's curve: "
                    f"without it, {others[name]}."
                )
        yield Sentence(best.verdict, text[0].upper() + text[1:])


def _best(support: Sequence[OptionSupport]) -> dict[str, str]:
    """Return for each reading what is said of its best option."""
    return {
        each.reading: each.verdict
        if each.verdict == "not identified"
        else f"{each.verdict} {said(each.reading, each.option)}"
        for each in support
        if each.log10_against == 0
    }


def _variants(found: Mapping[str, Evidence]) -> Iterator[Sentence]:
    main = next(iter(found.values()))
    whole, best = float(special.logsumexp(main.marginal)), _best(main.support)
    for other in found.values():
        if other.experiments != main.experiments:
            factor = float(np.exp(special.logsumexp(other.marginal) - whole))
            yield Sentence(
                "fit",
                f"That the averages are over {other.experiments:,} runs and not "
                f"{main.experiments:,}: Bayes factor {factor:.2g}, all readings averaged out.",
            )
    for name, other in list(found.items())[1:]:
        changed = [
            f"“{title(reading)}” (now {verdict})"
            for reading, verdict in _best(other.support).items()
            if verdict != best[reading]
        ]
        told = "no verdict on a reading changes"
        if changed:
            told = f"the verdicts change for {', '.join(changed)}"
        yield Sentence(
            "fit",
            f"Variant: {name}. {len(other.credible())} readings hold 95 % of the weight; {told}.",
        )


def _together(found: Evidence, joints: Mapping[int, Sequence[Joint]]) -> Iterator[Sentence]:
    returns = set(STATEMENTS) - {"respectively", "optimal"}
    for experiments, sets in joints.items():
        start = f"With {experiments:,} experiments, "
        (every,) = (each for each in sets if set(each.statements) == returns)
        yield Sentence(
            "fit" if every.possible else "cannot hold together",
            f"{start}all reported returns and their ranking can be within "
            f"{max(every.score, 0.01):.2f} standard deviations at once; {every.readings} readings "
            f"allow {TOGETHER:g}.",
        )
        smallest = contradictions(sets)
        if not smallest:
            yield Sentence(
                "fit", f"{start}every set of statements can hold together under some reading."
            )
        for each in smallest:
            listed = "; ".join(STATEMENTS[name][0] for name in each.statements)
            yield Sentence(
                "cannot hold together",
                f"{start}under no reading: {listed}. At best {each.score:.1f} standard deviations "
                f"({changes(found.search.space, each.reading)}).",
            )


def _optimal(search: ReadingSearch) -> Iterator[Sentence]:
    regret = search.regret
    reading, completion = np.unravel_index(int(regret.argmin()), regret.shape)
    least = float(regret[reading, completion])
    told = "There is a reading under which the final policy is optimal up to rounding"
    if least > 2 * float(search.error.max()):
        told = (
            "The final policy, as the text states it, is optimal under no reading, however it is "
            "completed, against the best policy that knows subtask and trial, which the paper's "
            f"policies do not: its least regret is {least:.3f} points of return"
        )
    filled = reported.told(search.completions[int(completion)])
    yield Sentence("optimal", f"{told} ({changes(search.space, int(reading))}; {filled}).")
    for status, action in reported.STATED.items():
        others = dict.fromkeys((action, reported.STATED["0100"], reported.STATED["1000"]))
        counts = [f"{o} under {int(search.optimal_under(status, o).sum()):,}" for o in others]
        yield Sentence(
            "optimal",
            f"In {status} the text states {action}. Optimal there, in the first trial of the first "
            f"subtask: {', '.join(counts)} of {len(search.space):,} readings.",
        )


def _equivalent(search: ReadingSearch) -> Sentence:
    first = search.equivalent()
    count = len(np.unique(first))
    return Sentence(
        "equivalent",
        f"{len(first) - count:,} of {len(first):,} readings give every policy of the search "
        f"the same mean and variance as an earlier one: no reported return can tell them apart; "
        f"{count:,} differ.",
    )


def _learning(found: Evidence, learned: LearningEvidence) -> Iterator[Sentence]:
    shares = learned.hits / learned.seeds
    for column, schedule in enumerate(SETTINGS):
        wanted, share = reported.UNIQUE_POLICIES[schedule], shares[:, column]
        low, high = learned.interval(int(share.argmax()), column)
        yield Sentence(
            "learning",
            f"{wanted} unique policies under {schedule} exploration appear in "
            f"{share.min():.0%} to {share.max():.0%} of {learned.seeds} runs "
            f"under the {len(learned.readings)} readings trained (95 % interval of the largest: "
            f"{low:.0%} to {high:.0%}).",
        )
    fits = learned.compatible.mean(axis=2)
    agreement = {status: float(share.mean()) for status, share in learned.agreement().items()}
    least = sorted(agreement, key=agreement.__getitem__)[:3]
    worst = ", ".join(f"{status} ({agreement[status]:.0%})" for status in least)
    yield Sentence(
        "learning",
        "Runs whose last policies all do what the text states are at most "
        f"{fits.max():.0%} of any reading's; final policies agree least with the text, 1000 and "
        f"0100 as written, in {worst}.",
    )
    numbers, weights, left = combined(found, learned)
    apart = float(np.exp(np.ptp(learned.log_likelihood)))
    yield Sentence(
        "learning",
        f"These counts make the trained readings differ by a factor of {apart:.1f} at most, "
        f"sampling included. With them, the best supported of the trained readings "
        f"({changes(found.search.space, int(numbers[0]))}) has {weights[0]:.1%} of their weight; "
        f"readings that were not trained hold {left:.0%} by the returns alone.",
    )
