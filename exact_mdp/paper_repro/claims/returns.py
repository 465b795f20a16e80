"""Claims about average returns (Section 4.1): exact means and spreads instead of experiments.

The three averages depend on what the text leaves open: 512 completions, two orders of
"respectively" among them. Each average is judged by the completion which fits all three best, taken
together, among those that training can be expected to end with (`readings.completions`): a best of
some, so that agreement is weak evidence and disagreement strong. The number shown beside a verdict
is that of this completion. The number that is pinned, because no training run moves it, is that of
the order as written, filled in so that the final policy has its highest value; the best of all 512
stands beside both.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import (
    JOINT_LIMIT,
    READ_OFF_A_PLOT,
    Claims,
    Finding,
    plotted,
    statement,
    undecided,
)
from exact_mdp.paper_repro.reading import SEED, Reading
from exact_mdp.paper_repro.readings.completions import LEFT_OUT, STANDARD_ERRORS, learnable
from exact_mdp.paper_repro.readings.reported_policy import ranked, sums
from exact_mdp.paper_repro.readings.search import Averages, of_order
from exact_mdp.paper_repro.reported import COMPLETIONS, EXPERIMENTS, FINAL, RANDOM_RETURN, STARTS
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.values.returns import return_distribution

CLAIMS = Claims()
DRAWS = 2000  # of the weights of the completions
EDGE = 10.0  # the line of what counts as learnable is drawn so many times higher and lower, too
OTHER_RUNS = 10_000  # Section 3.2.5 gives this number where Section 4.1 gives 1,000


def agreement(
    found: Averages, random: Floats | float, optimum: Floats | float
) -> dict[str, NDArray[np.bool_]]:
    """Return by claim whether it holds under one reading, or (R,) under each of R readings.

    Each average and the ranking are judged by the learnable completion that fits the three averages
    best; the three together by their chance, averaged over all completions with their weights: no
    edge of what counts as learnable decides it. The superiority is judged by all completions.
    """
    mean, score = found.at_fitting(found.mean), found.at_fitting(found.score)
    doubt = 2 * np.asarray(found.error)
    holds = {
        "return.optimal": np.asarray(optimum >= reported.CONVERGED_RETURN),
        "return.random": np.abs(random - RANDOM_RETURN) <= READ_OFF_A_PLOT,
        "return.superior": found.mean.min(axis=(-2, -1)) > random + doubt,
        "return.together": found.expected_probability >= JOINT_LIMIT,
        "return.ranking": (-np.diff(mean, axis=-1) > doubt[..., None]).all(axis=-1),
    }
    for place, start in enumerate(STARTS):
        holds[f"return.reported.{start}"] = np.abs(score[..., place]) <= STANDARD_ERRORS
    return holds


def _holds(reading: Reading, name: str, found: Averages) -> bool:
    """Say whether a claim holds under one reading."""
    random, optimum = (reading.evaluations[each].mean for each in ("random", "optimal"))
    return bool(agreement(found, random, optimum)[name])


def _mean(reading: Reading, name: str) -> Bounded:
    return reading.evaluations[name].start


def _spread(reading: Reading, name: str) -> dict[str, Any]:
    """Return details of a policy's return: spread, and the simulated mean that checks it."""
    found: dict[str, Any] = {"sd": reading.evaluations[name].sd}
    if reading.label == "default":
        sampled = reading.simulated(name)
        found["simulated"] = sampled["mean"]
        found["simulated_standard_error"] = sampled["standard_error"]
    return found


@CLAIMS.add("return.optimal", "Section 4.1, Figure 9", paper=reported.CONVERGED_RETURN, open=True)
def _ceiling(reading: Reading) -> Finding:
    """An average return of about 140, which the learned policies reach, is no more than any policy
    can have."""
    best = _mean(reading, "optimal")
    margin = best.value - reported.CONVERGED_RETURN
    side = "below" if margin > 0 else "above"
    return statement(
        _holds(reading, "return.optimal", reading.averages),
        f"{reported.CONVERGED_RETURN} is {abs(margin):.1f} {side} the optimum, the highest average "
        "that any policy can have; what policies learned here average is told with the learning "
        "claims of this section",
        best,
        difference=margin,
        **_spread(reading, "optimal"),
    )


@CLAIMS.add("return.random", "Section 4.1, Figure 9", "plotted", paper=RANDOM_RETURN, open=True)
def _random(reading: Reading) -> Finding:
    """The random strategy reaches an average return of around 70."""
    spread = _spread(reading, "random")
    return plotted(RANDOM_RETURN, _mean(reading, "random"), **spread)


@CLAIMS.add("return.superior", "Section 4.1", open=True)
def _superior(reading: Reading) -> Finding:
    """The learned policies are superior to the random strategy."""
    return statement(
        _holds(reading, "return.superior", reading.averages),
        f"in each of the {len(COMPLETIONS)} ways to fill in what the text leaves open, a reported "
        f"policy is worth {reading.averages.mean.min():.1f} or more, random actions "
        f"{reading.evaluations['random'].mean:.1f}",
    )


def _average(reading: Reading, start: str) -> Finding:
    """Show both orders of the sentence; judge by the completion that fits all three best."""
    name, found, place = f"reported.{start}", reading.weighed, STARTS.index(start)
    exact, paper = _mean(reading, name), reported.AVERAGE_RETURN[start]
    mean, score = found.mean[:, place], found.score[:, place]
    lowest, highest = found.range(start)
    written, swapped, fitting, of_all = found.named.values()

    def told(number: int) -> str:
        off = round(float(score[number]), 1) + 0.0  # no negative nothing
        return f"{mean[number]:.2f} ({off:+.1f} s.e.)".replace("-", "−")

    shown = statement(
        _holds(reading, f"return.reported.{start}", found),
        f"judged by the best joint fit of {_of(found)}: {told(fitting)}; "
        f"{_fit(found, fitting)}. 1000 and 0100 as written: {told(written)}; swapped: "
        f"{told(swapped)}, each filled in so that the final policy has its highest value. Best of "
        f"all {len(COMPLETIONS)}: {told(of_all)}",
        exact,
        difference=exact.value - paper,
        standard_error=reading.evaluations[name].sd / EXPERIMENTS**0.5,
        **_spread(reading, name),
        lowest=lowest,
        highest=highest,
        as_written=float(mean[written]),
        swapped=float(mean[swapped]),
        best_fit=float(mean[fitting]),
        best_fit_in_standard_errors=float(score[fitting]),
    )
    judged = replace(
        shown,
        number=Bounded(value=float(mean[fitting]), error=float(found.error)),
        difference=float(mean[fitting]) - paper,
        standard_error=float(found.variance[fitting, place] / EXPERIMENTS) ** 0.5,
    )
    return replace(shown, judged=judged)


for _start, _paper in reported.AVERAGE_RETURN.items():
    CLAIMS.add(
        f"return.reported.{_start}",
        "Section 4.1",
        "average",
        says=f"The policy with {_start} assistance in status 0000 averages {_paper} over "
        f"{EXPERIMENTS:,} experiments.",
        paper=_paper,
        open=True,
        learns=True,
    )(partial(_average, start=_start))


def _of(found: Averages) -> str:
    return f"the {int(found.learnable.sum())} that training can be expected to end with"


def _fit(found: Averages, completion: int) -> str:
    """Say how well a completion fits, which it is, and how often training ends with it."""
    assert found.log_weights is not None
    return (
        f"χ² = {float(found.chi_squared[completion]):.2f} on {len(STARTS)} degrees of freedom, "
        f"p = {float(found.probabilities[completion]):.2g}, weight "
        f"{np.exp(found.log_weights[completion]):.2g} ({reported.told(COMPLETIONS[completion])})"
    )


@CLAIMS.add("return.together", "Section 4.1", open=True, learns=True)
def _together(reading: Reading) -> Finding:
    """The three averages, taken together."""
    # Squared standard errors add up to χ² under each completion; its chance is averaged.
    found, chance = reading.weighed, reading.weighed.probabilities
    weights = np.exp(reading.completions.log_weights)
    expected, each = float(found.expected_probability), chance[found.learnable]
    orders = ", ".join(
        f"{order} p = {np.where(found.learnable, chance, 0.0)[of_order(order)].max():.2g}"
        for order in reported.ORDERS
    )
    drawn = reading.completions.draws(DRAWS, SEED)
    likely = np.quantile(np.exp(drawn) @ chance, [0.025, 0.975]).tolist()
    bests = [
        np.where(learnable(drawn, LEFT_OUT * factor), chance, 0.0).max(axis=1)
        for factor in (EDGE, 1 / EDGE)
    ]
    low, high = (float(np.quantile(*one)) for one in zip(bests, (0.025, 0.975), strict=True))
    of_all = int(found.fitting_of_all)
    return statement(
        _holds(reading, "return.together", found),
        f"averaged over all {len(COMPLETIONS)} completions, by how often training ends with each, "
        f"averages this far off have p = {expected:.2g} ({likely[0]:.2g} to {likely[1]:.2g} with "
        f"the uncertainty of these weights); to agree means p of {JOINT_LIMIT:.2%} or more. One by "
        f"one, {_of(found)} have p = {each.min():.2g} to {each.max():.2g}. Which is the best of "
        "them depends on where the line is drawn: with that uncertainty, and a line between "
        f"{LEFT_OUT * EDGE:.2%} and {LEFT_OUT / EDGE:.3%} of the weight, its p lies between "
        f"{low:.2g} and {high:.2g}. The best here: {_fit(found, int(found.fitting))}. Best of each "
        f"order: {orders}. Best of all {len(COMPLETIONS)}: {_fit(found, of_all)}",
        shown=f"p = {expected:.2g}",
        chi_squared=float(found.chi_squared[int(found.fitting)]),
        probability=float(found.probability),
        probability_interval=[low, high],
        expected_probability=expected,
        expected_probability_interval=likely,
        probability_of_any=float(chance[of_all]),
        weight_of_any=float(weights[of_all]),
    )


@CLAIMS.add("return.ranking", "Section 4.1", open=True, learns=True)
def _ranking(reading: Reading) -> Finding:
    """In status 0000 non-directive assistance is better than directive, and that better than
    supportive."""
    # Judge, as the averages, by the learnable completion that fits them best; show both orders.
    found = reading.weighed
    holds = _holds(reading, "return.ranking", found)
    told = "; ".join(
        f"{name} " + ", ".join(f"{mean:.2f}" for mean in found.mean[number])
        for name, number in found.named.items()
    )
    fall = " > ".join(f"{mean:.1f}" for mean in found.mean[int(found.fitting)])
    return statement(
        holds,
        f"exact values of {', '.join(STARTS)}: {told}; judged by the best learnable fit",
        shown=fall if holds else "not in this order",
    )


@CLAIMS.add("return.ranking.by-experiments", "Section 4.1")
def _ranking_by_experiments(reading: Reading) -> Finding:
    """1,000 experiments tell this ranking."""
    policies = [reading.policies[f"reported.{start}"] for start in STARTS]
    try:
        laws = [return_distribution(reading.mdp, policy) for policy in policies]
        chance = ranked(*(sums(law, EXPERIMENTS) for law in laws))
    except ModelError as refused:  # at a discount, or with rewards of very small units
        return undecided(f"open, because no exact law of the sums can be listed: {refused.what}")
    return statement(
        chance.value - chance.error >= 0.95,
        f"{EXPERIMENTS:,} experiments with each rank them so with probability "
        f"{chance.value:.4f}, by exact convolution, with 1000 and 0100 as written; 95 % or more "
        "counts as told",
        chance,
        f"{chance.value:.2%}",
    )


@CLAIMS.add(
    "return.experiments", "Section 4.1, Section 3.2.5", "open", kind="input", paper=EXPERIMENTS
)
def _experiments(reading: Reading) -> Finding:
    """The final policies were compared by 1,000 experiments each."""
    sd = reading.evaluations[f"reported.{FINAL}"].sd
    few, many = (sd / runs**0.5 for runs in (EXPERIMENTS, OTHER_RUNS))
    return undecided(
        f"Section 3.2.5 says {OTHER_RUNS:,}, Section 4.1 {EXPERIMENTS:,}; standard errors "
        f"of the final policy's average are {many:.2f} and {few:.2f}. The smaller number is used "
        "here, which is kinder to the paper"
    )
