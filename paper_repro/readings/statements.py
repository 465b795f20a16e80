"""What the search over the readings says, in plain sentences: found, not found, cannot be.

Each sentence is worked out from the numbers beside it; the thresholds are those of
`analysis.readings` (Bayes factors of 3, 20 and 150) and `paper_repro.readings.joint` (three
standard deviations).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exact_mdp.analysis.readings import EXCLUDED, FAVOURED, IDENTIFIED, OptionSupport, option_label
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import ROUNDING, TOLERANCE, Evidence
from exact_mdp.paper_repro.readings.joint import STATEMENTS, TOGETHER, Joint, contradictions
from exact_mdp.paper_repro.readings.learning import SETTINGS, LearningEvidence, combined
from exact_mdp.paper_repro.readings.search import STARTS, ReadingSearch
from exact_mdp.paper_repro.readings.verdict import AS_FOUND

WITHOUT_RANDOM = "without the random strategy"  # the variant that leaves that curve out


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """One finding.

    Attributes
    ----------
    kind : str
        identified, favoured, not identified, fit, cannot hold together, equivalent, optimal, or
        learning; method for those that say how the others come about.
    text : str
    """

    kind: str
    text: str


def statements(
    found: Mapping[str, Evidence],
    joints: Mapping[int, Sequence[Joint]],
    learned: LearningEvidence | None = None,
) -> list[Sentence]:
    """Return what is identified, what is not, and what cannot hold together.

    Parameters
    ----------
    found : mapping
        As `variants` gives it, the main one first.
    joints : {experiments: sets}
        As `joint` gives them.
    learned : LearningEvidence, optional
    """
    main = next(iter(found.values()))
    return [
        *_fit(main),
        *_options(main.support, "reading", found.get(WITHOUT_RANDOM)),
        *_options(main.completion_support(), "the policy's"),
        *_sensitivity(found),
        *_together(main, joints),
        *_optimal(main.search),
        *_equivalent(main.search),
        *(_learning(main, learned) if learned is not None else ()),
    ]


def method(main: Evidence) -> list[Sentence]:
    """Return how the sentences of `statements` come about, with the limits that they use."""
    space, options = main.search.space, len(main.search.completions)
    texts = (
        f"How it is done: each of {len(space):,} readings with each of {options} completions of "
        "the policies gives exact means and variances. A reported average is taken as normal about "
        "its exact mean with the exact standard error; its likelihood is the probability of the "
        f"interval ± {ROUNDING:g} that is rounded to it. The numbers read off the plot are taken "
        f"as normal with a standard deviation of {TOLERANCE:g}.",
        "Weights follow from a uniform prior over the readings, completions averaged out. An "
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
    return [Sentence(kind="method", text=text) for text in texts]


def _fit(found: Evidence) -> Iterator[Sentence]:
    space = found.search.space
    first, second = (int(number) for number in found.ranking[:2])
    ratio = float(np.exp(found.marginal[first] - found.marginal[second]))
    default = float(np.exp(found.marginal[first] - found.marginal[0]))
    place = int(np.flatnonzero(found.ranking == 0)[0]) + 1
    yield Sentence(
        kind="fit",
        text=f"No single reading wins: the best supported one ({space.label(first)}) has "
        f"{found.weights[first]:.1%} of the weight and is {ratio:.2f} times as likely as the "
        f"second; {len(found.credible())} of {len(space):,} readings are needed for 95 % of the "
        f"weight, and the weights are as spread as {found.effective_number:.0f} equal ones.",
    )
    yield Sentence(
        kind="fit",
        text=f"The default reading is number {place:,} in the order, with {found.weights[0]:.3%} "
        f"of the weight; the best supported reading makes the reported numbers {default:.0f} "
        "times as likely.",
    )


def _options(
    listed: Sequence[OptionSupport], what: str, without: Evidence | None = None
) -> Iterator[Sentence]:
    """Say what is found of each reading, and what of it hangs on the random strategy's curve."""
    others = {} if without is None else _best(without)
    names = dict.fromkeys(each.reading for each in listed)
    for name in names:
        options = [each for each in listed if each.reading == name]
        best = min(options, key=lambda each: each.log10_against)
        weights = ", ".join(f"{option_label(each.option)} {each.weight:.1%}" for each in options)
        out = [option_label(each.option) for each in options if each.verdict == "excluded"]
        also = f"; excluded: {', '.join(out)}" if out and len(out) < len(options) - 1 else ""
        title = f"{what} {name.replace('_', ' ')}"
        if best.verdict == "not identified":
            text = f"{title} is not identified ({weights}){also}."
        else:
            text = f"{title}: {option_label(best.option)} is {best.verdict} ({weights}){also}."
            verdict = f"{best.verdict} {option_label(best.option)}"
            if others.get(name, verdict) != verdict:
                wholly = " wholly" if others[name] == "not identified" else ""
                text += (
                    f" This rests{wholly} on the number read off the random strategy's curve: "
                    f"without it, {others[name]}."
                )
        yield Sentence(kind=best.verdict, text=text[0].upper() + text[1:])


def _sensitivity(found: Mapping[str, Evidence]) -> Iterator[Sentence]:
    from scipy.special import logsumexp

    main = next(iter(found.values()))
    whole = float(logsumexp(main.marginal))
    for other in found.values():
        if other.experiments != main.experiments:
            factor = float(np.exp(logsumexp(other.marginal) - whole))
            yield Sentence(
                kind="fit",
                text=f"That the averages are over {other.experiments:,} runs and not "
                f"{main.experiments:,}: Bayes factor {factor:.2g}, all readings averaged out.",
            )
    for name, other in list(found.items())[1:]:
        best, others = _best(main), _best(other)
        changed = [key for key in best if others[key] != best[key]]
        yield Sentence(
            kind="fit",
            text=f"Variant: {name}. {len(other.credible())} readings hold 95 % of the weight; "
            + (
                "the verdicts change for "
                + ", ".join(f"{key.replace('_', ' ')} (now {others[key]})" for key in changed)
                if changed
                else "no verdict on a reading changes"
            )
            + ".",
        )


def _best(found: Evidence) -> dict[str, str]:
    """Return for each reading what is said of its best option."""
    words = {}
    for each in found.support:
        if each.log10_against == 0:
            named = each.verdict != "not identified"
            words[each.reading] = each.verdict + (f" {option_label(each.option)}" if named else "")
    return words


def _together(found: Evidence, joints: Mapping[int, Sequence[Joint]]) -> Iterator[Sentence]:
    space = found.search.space
    for experiments, sets in joints.items():
        numbers = ("a2", "a3", "a1", "converged", "random", "ranking")
        for each in sets:
            if set(each.statements) == set(numbers):
                yield Sentence(
                    kind="fit" if each.possible else "cannot hold together",
                    text=f"With {experiments:,} experiments, all reported returns and their "
                    f"ranking can be within {max(each.score, 0.01):.2f} standard deviations at "
                    f"once; {each.readings} readings allow {TOGETHER:g}.",
                )
        smallest = contradictions(list(sets))
        if not smallest:
            yield Sentence(
                kind="fit",
                text=f"With {experiments:,} experiments, every set of statements can hold "
                "together under some reading.",
            )
        for each in smallest:
            listed = "; ".join(STATEMENTS[name] for name in each.statements)
            where = space.label(each.reading)
            yield Sentence(
                kind="cannot hold together",
                text=f"With {experiments:,} experiments, under no reading: {listed}. At best "
                f"{each.score:.1f} standard deviations ({where}).",
            )


def _optimal(search: ReadingSearch) -> Iterator[Sentence]:
    regret = search.optimum[:, None] - search.mean[:, :, STARTS.index(AS_FOUND[0])]
    reading, completion = np.unravel_index(int(regret.argmin()), regret.shape)
    least = float(regret[reading, completion])
    sure = least > 2 * float(search.error.max())
    yield Sentence(
        kind="optimal",
        text=(
            "The final policy, as the text states it, is optimal under no reading, however it is "
            "completed, against the best policy that knows subtask and trial, which the paper's "
            f"policies do not: its least regret is {least:.3f} points of return"
            if sure
            else "There is a reading under which the final policy is optimal up to rounding"
        )
        + f" ({search.space.label(int(reading))}; "
        f"{reported.told(search.completions[int(completion)])}).",
    )
    for status, action in reported.STATED.items():
        for other in dict.fromkeys((action, reported.STATED["0100"], reported.STATED["1000"])):
            count = int(search.optimal_under(status, other).sum())
            yield Sentence(
                kind="optimal",
                text=f"In {status}, {other} is optimal under {count:,} of {len(search.space):,} "
                "readings (first trial of the first subtask)"
                + (", as the text states." if other == action else "."),
            )


def _equivalent(search: ReadingSearch) -> Iterator[Sentence]:
    first = search.equivalent()
    count = len(np.unique(first))
    yield Sentence(
        kind="equivalent",
        text=f"{len(first) - count:,} of {len(first):,} readings give every policy of the search "
        f"the same mean and variance as an earlier one: no reported return can tell them apart; "
        f"{count:,} differ.",
    )


def _learning(found: Evidence, learned: LearningEvidence) -> Iterator[Sentence]:
    shares = learned.hits / learned.seeds
    for column, schedule in enumerate(SETTINGS):
        wanted = reported.UNIQUE_POLICIES[schedule]
        low, high = (int(shares[:, column].argmin()), int(shares[:, column].argmax()))
        from_, to = learned.interval(high, column)
        yield Sentence(
            kind="learning",
            text=f"{wanted} unique policies under {schedule} exploration appear in "
            f"{shares[low, column]:.0%} to {shares[high, column]:.0%} of {learned.seeds} runs "
            f"under the {len(learned.readings)} readings trained (95 % interval of the largest: "
            f"{from_:.0%} to {to:.0%}).",
        )
    fits = learned.compatible.mean(axis=2)
    agreement = {status: float(share.mean()) for status, share in learned.agreement().items()}
    least = sorted(agreement, key=agreement.__getitem__)[:3]
    worst = ", ".join(f"{status} ({agreement[status]:.0%})" for status in least)
    yield Sentence(
        kind="learning",
        text="Runs whose last policies all do what the text states are at most "
        f"{fits.max():.0%} of any reading's; final policies agree least with the text, 1000 and "
        f"0100 as written, in {worst}.",
    )
    numbers, weights, left = combined(found, learned)
    apart = float(np.exp(np.ptp(learned.log_likelihood)))
    yield Sentence(
        kind="learning",
        text=f"These counts make the trained readings differ by a factor of {apart:.1f} at most, "
        f"sampling included. With them, the best supported of the trained readings "
        f"({found.search.space.label(int(numbers[0]))}) has {weights[0]:.1%} of their weight; "
        f"readings that were not trained hold {left:.0%} by the returns alone.",
    )
