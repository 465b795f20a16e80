"""What `exact-mdp perception` tells: the result for JSON, and the tables for people.

The command that says what acting on a perceived status costs, and what would help.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

import click

from exact_mdp.analysis.cli.options import (
    POLICY_HELP,
    float_of,
    model_options,
    policy_of,
    tell_limit,
    whole_of,
)
from exact_mdp.analysis.cli.render import Grid, at_most, number, show

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.column_policies import BestPolicy
    from exact_mdp.analysis.perception.cost import PriceOfPerception, UncertainValue
    from exact_mdp.analysis.perception.errors import ErrorCosts
    from exact_mdp.analysis.perception.needed import AccuracyNeeded
    from exact_mdp.mdp.care.counts import Counted
    from exact_mdp.mdp.model import MDP
    from exact_mdp.mdp.policies.policy import Policy
    from exact_mdp.mdp.table import Floats


SHOWN = 12  # confusions listed for people
READINGS = 64  # perceived statuses listed for people


def prices_of(price: PriceOfPerception, mdp: MDP) -> dict[str, Any]:
    return {
        "perfect": {"value": price.perfect.value, "error_bound": price.perfect.error},
        "filtering": {
            "lower": price.filtering.lower,
            "upper": price.filtering.upper,
            "closed": price.filtering.closed,
        },
        "memoryless": _best(price.memoryless) | {"policy": _reading(price, mdp)},
        "with_place": _best(price.with_place),
        "taken_as_true": {
            "value": price.taken_as_true.value,
            "error_bound": price.taken_as_true.error,
        },
        "unseeing": {
            "lower": price.unseeing.lower,
            "upper": price.unseeing.upper,
            "closed": price.unseeing.closed,
        },
    }


def _reading(price: PriceOfPerception, mdp: MDP) -> dict[str, str]:
    """Return the best memoryless policy's action for each perceived status."""
    column = mdp.space.column("status")
    actions = price.memoryless.policy.table.argmax(axis=1).tolist()
    return {column.label(z): mdp.actions[a] for z, a in enumerate(actions)}


def _best(best: BestPolicy) -> dict[str, Any]:
    return {
        "columns": list(best.columns),
        "value": best.value.value,
        "error_bound": best.value.error,
        "upper_bound": best.upper_bound,
        "mixed_upper_bound": best.mixed_upper_bound,
        "proven": best.proven,
    }


def costs_of(costs: ErrorCosts) -> dict[str, Any]:
    return {
        "errors": {
            name: {
                "missed": missed,
                "seen": seen,
                "by_sensitivity": costs.rates[name][0],
                "by_specificity": costs.rates[name][1],
            }
            for name, (missed, seen) in costs.by_status.items()
        },
        "confusions": {"loss": costs.loss, "marginal": costs.marginal, "error_bound": costs.error},
    }


def need_of(each: AccuracyNeeded) -> dict[str, Any]:
    return {
        "share": each.share,
        "target": each.target,
        "enough": float(each.enough),
        "crossings": [[float(low), float(high)] for low, high, _ in each.crossings],
        "monotone": each.monotone,
        "claim": each.value.claim,
    }


def spread_of(spread: UncertainValue, seed: int) -> dict[str, Any]:
    return {
        "mean": spread.value.value,
        "standard_error": spread.value.standard_error,
        "interval": list(spread.interval),
        "level": spread.level,
        "draws": len(spread.draws),
        "seed": seed,
        "claim": spread.value.claim,
    }


def _reading_grid(price: PriceOfPerception, mdp: MDP) -> Grid:
    reading = list(_reading(price, mdp).items())
    more = f", the first {READINGS} of {len(reading)}" if len(reading) > READINGS else ""
    proven = "proven the best" if price.memoryless.proven else "the best found"
    return Grid(
        title=f"best action by the status seen alone ({proven}){more}",
        headings=("status seen", "action"),
        rows=reading[:READINGS],
    )


def grids_of(
    price: PriceOfPerception,
    costs: ErrorCosts,
    needed: dict[str, AccuracyNeeded | None],
    spread: UncertainValue | None,
    mdp: MDP,
) -> list[Grid]:
    off = price.taken_as_true.error
    rows = [
        ("the status is known", number(price.perfect.value, price.perfect.error), ""),
        (
            "memory of what was seen and done",
            f"{price.filtering.lower:.6g} to {price.filtering.upper:.6g}",
            "bounds",
        ),
        (
            "memory of what was done, unseeing",
            f"{price.unseeing.lower:.6g} to {price.unseeing.upper:.6g}",
            "bounds",
        ),
        *(
            (
                f"best by {', '.join(best.columns)} seen",
                number(best.value.value, best.value.error),
                "proven the best" if best.proven else f"others up to {best.upper_bound:.6g}",
            )
            for best in (price.with_place, price.memoryless)
        ),
        ("seen taken for true", number(price.taken_as_true.value, off), ""),
    ]
    if spread is not None:
        low, high = spread.interval
        rows.append(
            (
                "… by the posterior",
                f"{spread.value.value:.6g}",
                f"{spread.level:.0%} in {low:.5g} to {high:.5g} (estimated)",
            )
        )
    grids = [Grid(title="value at the start", headings=("", "value", ""), rows=rows)]
    grids.append(_reading_grid(price, mdp))
    rows = [
        (
            name,
            *(f"{loss:.4f}" for loss in (missed, seen)),
            *(f"{gain:.4f}" for gain in costs.rates[name]),
        )
        for name, (missed, seen) in sorted(costs.by_status.items(), key=lambda i: -sum(i[1]))
    ]
    grids.append(
        Grid(
            title="what errors cost where the status seen is taken for true (within "
            f"{at_most(costs.error)})",
            headings=(
                "status",
                "missed",
                "seen wrongly",
                "per unit of sensitivity",
                "of specificity",
            ),
            rows=rows,
            numeric=frozenset(range(1, 5)),
        )
    )
    worst = costs.frame().head(SHOWN)
    rows = [(row[0], row[1], f"{row[2]:.4f}", f"{row[3]:.4f}") for row in worst.values.tolist()]
    grids.append(
        Grid(
            title="the costliest confusions",
            headings=("true", "perceived", "loss", "per unit of probability"),
            rows=rows,
            numeric=frozenset({2, 3}),
        )
    )
    rows = [
        (
            name,
            f"{float(each.enough):.6f}" if each.crossings else "any from 0.5",
            "yes" if each.monotone else "no",
        )
        for name, each in needed.items()
        if each is not None
    ]
    if rows:
        share = next(each.share for each in needed.values() if each is not None)
        title = (
            f"accuracy that keeps {float(share):.4g} of the value, the others perfect (certified)"
        )
        headings = ("status", "accuracy", "value rises all the way")
        grids.append(Grid(title=title, headings=headings, rows=rows, numeric=frozenset({1})))
    return grids


SECONDS = "5"


@click.command(
    short_help="What errors of perception cost, and what memory would save.", epilog=POLICY_HELP
)
@click.argument("model")
@click.option(
    "--perception",
    metavar="FILE",
    help="A confusion matrix as .csv; .toml with sensitivity and specificity; labelled examples as "
    ".csv (true,perceived) or the .jsonl of a recording.",
)
@click.option(
    "--accuracy", metavar="X", help="Each status is read rightly with this probability instead."
)
@click.option(
    "--prior",
    metavar="X",
    help="Pseudo-count of each cell, where the file holds examples; adds a credible interval.",
)
@click.option("--draws", default="2000", metavar="N", help="Draws for that interval (2000).")
@click.option("--seed", default="0", metavar="S", help="Seed of the draws (0).")
@click.option(
    "--policy",
    default="optimal",
    metavar="POLICY",
    help="What is taken for true perceptions; the optimum unless given.",
)
@click.option(
    "--share", default="19/20", metavar="X", help="Share of the value that is to be kept (19/20)."
)
@click.option(
    "--seconds",
    metavar="X",
    help="Limit of each of the two searches with memory (5). Where it ends one, the bounds vary a "
    "little with the load of the machine; --trials does not have this.",
)
@click.option(
    "--trials",
    metavar="N",
    help="Limit of each search in trials, instead of seconds: identical output in every run.",
)
@click.option(
    "--tolerance", default="0.02", metavar="X", help="Gap at which such a search ends (0.02)."
)
@model_options
def perception(
    model: str,
    perception: str | None,
    accuracy: str | None,
    prior: str | None,
    draws: str,
    seed: str,
    policy: str,
    share: str,
    seconds: str | None,
    trials: str | None,
    tolerance: str,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
) -> None:
    """Tell what acting on a perceived status costs in MODEL.

    Ways to deal with errors: knowing the status, remembering what was seen and done, the best
    fixed reading of what is seen (told action by action), and taking it for true. Then which
    errors cost most, and the accuracy that keeps a share of the value.
    """
    from exact_mdp.analysis.perception.cost import price_of_perception, value_under_counts
    from exact_mdp.analysis.perception.errors import error_costs

    # import
    from exact_mdp.mdp.io.load import load

    loaded = load(model, sets=sets, discount=discount)
    mdp = loaded.mdp
    limits = _limits(seconds, trials) | {"tol": _positive(tolerance, "--tolerance")}
    drawn = whole_of(draws, "--draws", least=2, most=10**6)
    seeded = whole_of(seed, "--seed")
    matrix, counts = _confusion(mdp, perception, accuracy, prior)
    chosen = policy_of(mdp, policy)
    needed = _needed(mdp, chosen, share)
    price = price_of_perception(mdp, matrix, policy=chosen, **limits)
    costs = error_costs(mdp, chosen, matrix)
    spread = None
    if counts is not None:
        spread = value_under_counts(mdp, chosen, counts, rng=seeded, n=drawn)
    told = perception or f"accuracy {accuracy}"
    result = {
        "model": loaded.name,
        "policy": policy,
        "perception": told,
        "discount": mdp.discount,
        "claim": price.filtering.value.claim,
        **prices_of(price, mdp),
        **costs_of(costs),
        "needed": {name: None if each is None else need_of(each) for name, each in needed.items()},
        "counted": None if spread is None else spread_of(spread, seeded),
    }
    facts = {"model": loaded.name, "policy": policy, "perception": told}
    tell_limit(loaded.mdp, option=False)
    show(result, as_json=as_json, facts=facts, grids=grids_of(price, costs, needed, spread, mdp))


def _limits(seconds: str | None, trials: str | None) -> dict[str, Any]:
    """Return what ends the searches: time, or a number of trials."""
    from exact_mdp.mdp.errors import ModelError

    if trials is None:
        return {"seconds": _positive(SECONDS if seconds is None else seconds, "--seconds")}
    if seconds is not None:
        raise ModelError("both --seconds and --trials", where="options", fix="give one of them")
    return {"seconds": inf, "max_trials": whole_of(trials, "--trials", least=1)}


def _confusion(
    mdp: MDP, path: str | None, accuracy: str | None, prior: str | None
) -> tuple[Floats, Counted | None]:
    from exact_mdp.analysis.perception.needed import confusion_at
    from exact_mdp.mdp.care.counts import read_counts
    from exact_mdp.mdp.care.perception import holds_examples, read, status_size
    from exact_mdp.mdp.errors import ModelError

    status_size(mdp)
    if (path is None) == (accuracy is None):
        raise ModelError(
            "no perception, or two of them", where="options", fix="give --perception or --accuracy"
        )
    if path is not None and prior is not None:
        weight = _positive(prior, "--prior")
        if not holds_examples(path):
            raise ModelError(
                "only labelled examples take a prior", where="--prior", fix="leave it out"
            )
        counts = read_counts(path, mdp, prior=weight)
        return counts.mean, counts
    if prior is not None:
        raise ModelError("an accuracy takes no prior", where="--prior", fix="leave it out")
    if path is not None:
        return read(path, mdp), None
    rate = float_of(accuracy, "--accuracy")
    assert rate is not None
    try:
        return confusion_at(mdp, rate), None
    except ModelError as error:
        raise ModelError(error.what, where="--accuracy", fix=error.fix) from error


def _needed(mdp: MDP, policy: Policy, share: str) -> dict[str, AccuracyNeeded | None]:
    """Return the accuracy needed, of all statuses and of each; None where no value is positive."""
    from exact_mdp.analysis.perception.needed import ALL, accuracy_needed
    from exact_mdp.analysis.perception.policies import status_names
    from exact_mdp.mdp.errors import ModelError
    from exact_mdp.solvers import evaluate

    float_of(share, "--share")
    found: dict[str, AccuracyNeeded | None] = {}
    positive = evaluate(mdp, policy).mean > 0
    for name in (ALL, *status_names(mdp)):
        try:
            found[name] = (
                accuracy_needed(mdp, policy, share=share, status=name) if positive else None
            )
        except ModelError as error:
            raise ModelError(error.what, where="--share", fix=error.fix) from error
    return found


def _positive(text: str, option: str) -> float:
    from exact_mdp.mdp.errors import ModelError

    found = float_of(text, option)
    if found is None or not found > 0:
        raise ModelError(f"{text} is not positive", where=option, fix="give more than 0")
    return found
