"""The command that says what acting on a perceived status costs, and what would help."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any

import click

from analysis.cli_common import (
    POLICY_HELP,
    float_of,
    model_options,
    policy_of,
    tell_limit,
    whole_of,
)
from analysis.cli_output import show

if TYPE_CHECKING:
    from analysis.perception_needed import AccuracyNeeded
    from mdp.model import MDP
    from mdp.perception_counts import Counted
    from mdp.policy import Policy
    from mdp.table import Floats

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
    from analysis.perception import error_costs, price_of_perception, value_under_counts
    from analysis.perception_report import costs_of, grids_of, need_of, prices_of, spread_of
    from mdp.load import load

    loaded = load(model, sets=sets, discount=discount)
    mdp = loaded.mdp
    limits = _limits(seconds, trials) | {"tolerance": _positive(tolerance, "--tolerance")}
    drawn = whole_of(draws, "--draws", least=2, most=10**6)
    seeded = whole_of(seed, "--seed")
    matrix, counts = _confusion(mdp, perception, accuracy, prior)
    chosen = policy_of(mdp, policy)
    needed = _needed(mdp, chosen, share)
    price = price_of_perception(mdp, matrix, policy=chosen, **limits)
    costs = error_costs(mdp, chosen, matrix)
    spread = None
    if counts is not None:
        spread = value_under_counts(mdp, chosen, counts, seed=seeded, draws=drawn)
    told = perception or f"accuracy {accuracy}"
    result = {
        "model": loaded.name,
        "policy": policy,
        "perception": told,
        "discount": mdp.discount,
        "claim": price.filtering.claim,
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
    from mdp.errors import ModelError

    if trials is None:
        return {"seconds": _positive(SECONDS if seconds is None else seconds, "--seconds")}
    if seconds is not None:
        raise ModelError("both --seconds and --trials", where="options", fix="give one of them")
    return {"seconds": inf, "max_trials": whole_of(trials, "--trials", least=1)}


def _confusion(
    mdp: MDP, path: str | None, accuracy: str | None, prior: str | None
) -> tuple[Floats, Counted | None]:
    from analysis.perception_needed import confusion_at
    from mdp.errors import ModelError
    from mdp.perception import holds_examples, read, status_size
    from mdp.perception_counts import read_counts

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
    from analysis.perception_needed import ALL, accuracy_needed
    from analysis.perception_policies import status_names
    from mdp.errors import ModelError
    from solvers import evaluate

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
    from mdp.errors import ModelError

    found = float_of(text, option)
    if found is None or not found > 0:
        raise ModelError(f"{text} is not positive", where=option, fix="give more than 0")
    return found
