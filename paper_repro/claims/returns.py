"""Claims about average returns (Section 4.1): exact means and spreads instead of experiments.

The three averages depend on what the text leaves open: 512 completions, two orders of
"respectively" among them. The exact number beside each average is that of the order as written,
filled in so that the final policy has its highest value. The verdict is that of the completion
which fits the three averages best, taken together (`paper_repro.numbers`): a best of 512, so that
agreement is weak evidence and disagreement strong.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import (
    JOINT_LIMIT,
    STANDARD_ERRORS,
    Finding,
    PaperClaim,
    Verdict,
    plotted,
    statement,
    undecided,
)
from exact_mdp.paper_repro.numbers import FINAL
from exact_mdp.paper_repro.view import View
from exact_mdp.solvers.solution import Bounded

ORDER = sorted(reported.AVERAGE_RETURN, key=lambda start: -reported.AVERAGE_RETURN[start])
OTHER_RUNS = 10_000  # Section 3.2.5 gives this number where Section 4.1 gives 1,000


def claims() -> Iterator[PaperClaim]:
    """Yield the claims about returns."""
    where = ("Section 4.1",)
    yield PaperClaim(
        id="return.optimal",
        places=(*where, "Figure 9"),
        says="The learned policies reach an average return of about 140; no policy can reach more "
        "than the optimum.",
        rule="statement",
        paper=reported.CONVERGED_RETURN,
        find=_ceiling,
        open=True,
    )
    yield PaperClaim(
        id="return.random",
        places=(*where, "Figure 9"),
        says="The random strategy reaches an average return of around 70.",
        rule="plotted",
        paper=reported.RANDOM_RETURN,
        find=_random,
        open=True,
    )
    yield PaperClaim(
        id="return.superior",
        places=where,
        says="The learned policies are superior to the random strategy.",
        rule="statement",
        find=_superior,
        open=True,
    )
    for start in ORDER:
        yield PaperClaim(
            id=f"return.reported.{start}",
            places=where,
            says=f"The policy with {start} assistance in status 0000 averages "
            f"{reported.AVERAGE_RETURN[start]} over {reported.EXPERIMENTS:,} experiments.",
            rule="average",
            paper=reported.AVERAGE_RETURN[start],
            find=partial(_average, start=start),
            open=True,
        )
    yield PaperClaim(
        id="return.together",
        places=where,
        says="The three averages, taken together.",
        rule="statement",
        find=_together,
        open=True,
    )
    yield PaperClaim(
        id="return.ranking",
        places=where,
        says=f"In status 0000 {ORDER[0]} assistance is better than {ORDER[1]}, and that better "
        f"than {ORDER[2]}.",
        rule="statement",
        find=_ranking,
        open=True,
    )
    yield PaperClaim(
        id="return.ranking.by-experiments",
        places=where,
        says=f"{reported.EXPERIMENTS:,} experiments tell this ranking.",
        rule="statement",
        find=_ranking_by_experiments,
    )
    yield PaperClaim(
        id="return.experiments",
        places=(*where, "Section 3.2.5"),
        says=f"The final policies were compared by {reported.EXPERIMENTS:,} experiments each.",
        rule="open",
        kind="input",
        paper=reported.EXPERIMENTS,
        find=_experiments,
    )


def _mean(view: View, name: str) -> Bounded:
    found = view.study.evaluations[name]
    return Bounded(value=found.mean, error=found.error_bound)


def _spread(view: View, name: str) -> dict[str, object]:
    """Return details of a policy's return: spread, and the simulated mean that checks it."""
    found: dict[str, object] = {"sd": view.study.evaluations[name].sd}
    if view.label == "default":
        sampled = view.simulated(name)
        found["simulated"] = sampled["mean"]
        found["simulated_standard_error"] = sampled["standard_error"]
    return found


def _ceiling(view: View) -> Finding:
    best = _mean(view, "optimal")
    margin = best.value - reported.CONVERGED_RETURN
    below = f"{reported.CONVERGED_RETURN} is {abs(margin):.1f} {'below' if margin > 0 else 'above'}"
    return Finding(
        verdict=Verdict.REPRODUCED if margin >= 0 else Verdict.NOT_REPRODUCED,
        why=f"{below} the highest average that any policy can have",
        number=best,
        difference=margin,
        details=_spread(view, "optimal"),
    )


def _random(view: View) -> Finding:
    return plotted(reported.RANDOM_RETURN, _mean(view, "random"), **_spread(view, "random"))


def _superior(view: View) -> Finding:
    least = min(view.study.completions.range(start)[0] for start in ORDER)
    count = len(view.study.completions.choices)
    random = _mean(view, "random")
    return statement(
        least > random.value + random.error,
        f"in each of the {count} ways to fill in what the text leaves open, a reported policy is "
        f"worth {least:.1f} or more, random actions {random.value:.1f}",
    )


def _average(view: View, *, start: str) -> Finding:
    """Show both orders of the sentence; judge by the completion that fits all three best."""
    name, found = f"reported.{start}", view.study.completions
    lowest, highest = found.range(start)
    details = _spread(view, name) | {"lowest": lowest, "highest": highest}
    exact, paper = _mean(view, name), reported.AVERAGE_RETURN[start]
    mean, score = found.mean[start], found.score(start)
    written, swapped, fitting = (found.best(), found.best("swapped"), found.fitting)

    def told(place: int) -> str:
        return f"{mean[place]:.2f} ({_signed(score[place])} s.e.)"

    return Finding(
        verdict=_judged(abs(float(score[fitting])) <= STANDARD_ERRORS),
        why=f"1000 and 0100 as written: {told(written)}; swapped: {told(swapped)}, each filled in "
        "so that the final policy has its highest value. Judged by the best joint fit of "
        f"{len(found.choices)}: {told(fitting)}; {_fit(view)}",
        number=exact,
        difference=exact.value - paper,
        standard_error=view.study.evaluations[name].sd / reported.EXPERIMENTS**0.5,
        details=details
        | {
            "as_written": float(mean[written]),
            "swapped": float(mean[swapped]),
            "best_fit": float(mean[fitting]),
            "best_fit_in_standard_errors": float(score[fitting]),
        },
    )


def _signed(number: float) -> str:
    return f"{number:+.1f}".replace("-", "−")


def _judged(holds: bool) -> Verdict:
    return Verdict.REPRODUCED if holds else Verdict.NOT_REPRODUCED


def _fit(view: View) -> str:
    """Say how well the completion that fits best does, and which it is."""
    found = view.study.completions
    return (
        f"χ² = {float(found.chi_squared[found.fitting]):.2f} on {len(ORDER)} degrees of freedom, "
        f"p = {found.probability:.2g} before allowing for the choice among "
        f"{len(found.choices)} ({reported.told(found.choices[found.fitting])})"
    )


def _together(view: View) -> Finding:
    """Add up squared standard errors, under the completion that makes the sum least."""
    from scipy.stats import chi2

    found = view.study.completions
    places = {order: _least(view, order) for order in reported.ORDERS}
    orders = ", ".join(
        f"{order} p = {float(chi2.sf(found.chi_squared[place], len(ORDER))):.2g}"
        for order, place in places.items()
    )
    return statement(
        found.probability >= JOINT_LIMIT,
        f"the best joint fit of {len(found.choices)}: {_fit(view)}; the limit is "
        f"{JOINT_LIMIT:.2g}. Best of each order: {orders}",
        chi_squared=float(found.chi_squared[found.fitting]),
        probability=found.probability,
    )


def _least(view: View, order: str) -> int:
    """Return the completion of one order that fits best."""
    found = view.study.completions
    listed = [n for n, each in enumerate(found.choices) if reported.order(each) == order]
    return min(listed, key=lambda number: float(found.chi_squared[number]))


def _ranking(view: View) -> Finding:
    """Judge, as the averages, by the completion that fits them best; show both orders."""
    found = view.study.completions
    shown = {
        "as written": found.best(),
        "swapped": found.best("swapped"),
        "best joint fit": found.fitting,
    }
    means = {name: [float(found.mean[s][n]) for s in ORDER] for name, n in shown.items()}
    best = means["best joint fit"]
    holds = all(a - b > 2 * found.error for a, b in pairwise(best))
    told = "; ".join(f"{name} " + ", ".join(f"{m:.2f}" for m in of) for name, of in means.items())
    return statement(
        holds,
        f"exact values of {', '.join(ORDER)}: {told} (by which it is judged)",
        shown=" > ".join(f"{m:.1f}" for m in best) if holds else "not in this order",
    )


def _ranking_by_experiments(view: View) -> Finding:
    from exact_mdp.paper_repro.readings.ranking import ranked, sums
    from exact_mdp.solvers.values.returns import return_distribution

    laws = [
        return_distribution(view.mdp, view.study.policies[f"reported.{start}"]) for start in ORDER
    ]
    chance = ranked(*(sums(law, reported.EXPERIMENTS) for law in laws))
    return statement(
        chance.value - chance.error >= 0.95,
        f"{reported.EXPERIMENTS:,} experiments with each rank them so with probability "
        f"{chance.value:.4f}, by exact convolution, with 1000 and 0100 as written; 95 % or more "
        "counts as told",
        chance,
        f"{chance.value:.2%}",
    )


def _experiments(view: View) -> Finding:
    few, many = (
        view.study.evaluations[f"reported.{FINAL}"].sd / runs**0.5
        for runs in (reported.EXPERIMENTS, OTHER_RUNS)
    )
    return undecided(
        f"Section 3.2.5 says {OTHER_RUNS:,}, Section 4.1 {reported.EXPERIMENTS:,}; standard errors "
        f"of the final policy's average are {many:.2f} and {few:.2f}. The smaller number is used "
        "here, which is kinder to the paper"
    )
