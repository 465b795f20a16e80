"""Commands about one policy: its value and spread, its returns, a simulation of it."""

from __future__ import annotations

from itertools import islice
from math import isnan
from typing import Any

import click

from exact_mdp.analysis.cli.options import (
    POLICY_HELP,
    horizon_option,
    kind_option,
    model_options,
    perception_option,
    policy_of,
    read_as,
    stopped,
    tell_limit,
    whole_of,
)
from exact_mdp.analysis.cli.render import Grid, at_most, decimal, number, show

MOST_EPISODES = 10**9
LISTED_RETURNS = 1000  # longer distributions are left to --json


@click.command(
    short_help="Mean, spread, steps, reward components and quantiles of a policy.",
    epilog=POLICY_HELP,
)
@click.argument("model")
@click.argument("policy")
@click.option(
    "--quantiles/--no-quantiles",
    default=True,
    help="Whether to work out the quantiles, which can take long in large models.",
)
@kind_option
@perception_option
@horizon_option
@model_options
def evaluate(
    model: str,
    policy: str,
    quantiles: bool,
    kind: str,
    perception: str | None,
    horizon: str | None,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
) -> None:
    """Compute the mean return of POLICY in MODEL, and how it comes about."""
    from exact_mdp import solvers
    from exact_mdp.mdp.io.load import load

    loaded, steps = stopped(load(model, sets=sets, discount=discount), horizon)
    given = policy_of(loaded.mdp, policy, perception, kind=kind)
    found = solvers.evaluate(loaded.mdp, given)
    shares = found.quantiles if quantiles else None
    missing = "left out" if not quantiles else found.quantiles_missing
    result: dict[str, Any] = {
        "model": loaded.name,
        "policy": policy,
        "read_as": given.read_as,
        "perception": perception,
        "discount": loaded.mdp.discount,
        "horizon": steps,
        "claim": found.claim,
        "mean": found.mean,
        "error_bound": found.error_bound,
        "sd": found.sd,
        "steps": found.steps,
        "ends": found.ends,
        "skip_probability": found.skip_probability,
        "event_probability": found.event_probability,
        "components": found.components,
        "quantiles": shares,
        "quantiles_missing": missing or None,
        "error_bounds": {name: bounded.error for name, bounded in found.numbers.items()},
    }
    errors = result["error_bounds"]
    facts = read_as(given) | {
        "model": loaded.name,
        "policy": policy,
        **({"perception": perception} if perception else {}),
        "discount": number(loaded.mdp.discount),
        **({"horizon": f"{steps:,} steps"} if steps else {}),
        "claim": f"{found.claim}, the mean within {at_most(found.error_bound)}",
        "mean": number(found.mean, found.error_bound),
        "sd": _told(found.sd, errors["sd"]),
        "steps": _told(found.steps, errors["steps"]) if found.ends else "inf: it may never end",
    }
    for name, chance in found.event_probability.items():
        facts[f"probability of a {name}"] = _told(chance, errors[f"event.{name}"])
    if missing:
        facts["quantiles"] = f"none: {missing}"
    rows = [
        (name, _told(value, errors[f"component.{name}"]))
        for name, value in found.components.items()
    ]
    grids = [_numbers("expected total of each reward component", ("component", "total"), rows)]
    if shares is not None:
        rows = [(f"{share:.0%}", number(value)) for share, value in shares.items()]
        grids.append(_numbers("quantiles of the return", ("share", "return"), rows))
    tell_limit(loaded.mdp)
    show(result, as_json=as_json, facts=facts, grids=grids)


@click.command(
    short_help="The exact distribution of a policy's return, at discount 1.", epilog=POLICY_HELP
)
@click.argument("model")
@click.argument("policy")
@click.option("--exact", is_flag=True, help="Give the probabilities as rationals, too.")
@kind_option
@perception_option
@horizon_option
@model_options
def returns(
    model: str,
    policy: str,
    exact: bool,
    kind: str,
    perception: str | None,
    horizon: str | None,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
) -> None:
    """Compute the probability of every return that POLICY can have in MODEL, at discount 1."""
    from exact_mdp import solvers
    from exact_mdp.mdp.io.load import load
    from exact_mdp.solvers.values.returns import return_distribution

    loaded, steps = stopped(load(model, sets=sets, discount=discount), horizon)
    given = policy_of(loaded.mdp, policy, perception, kind=kind)
    found = return_distribution(loaded.mdp, given, exact=exact)
    moments = solvers.evaluate(loaded.mdp, given)
    values, chances = [decimal(value) for value in found.values], found.probabilities.tolist()
    error = float(found.error.max())
    result: dict[str, Any] = {
        "model": loaded.name,
        "policy": policy,
        "read_as": given.read_as,
        "perception": perception,
        "discount": loaded.mdp.discount,
        "horizon": steps,
        "claim": found.claim,
        "mean": moments.mean,
        "sd": moments.sd,
        "error_bounds": {"mean": moments.error_bound, "sd": moments.numbers["sd"].error},
        "error_bound": error,
        "remaining": found.remaining,
        "distribution": dict(zip(values, chances, strict=True)),
    }
    if found.exact is not None:
        result["exact_distribution"] = dict(zip(values, found.exact, strict=True))
    facts = read_as(given) | {
        "model": loaded.name,
        "policy": policy,
        **({"horizon": f"{steps:,} steps"} if steps else {}),
        "mean": number(moments.mean, moments.error_bound),
        "sd": number(moments.sd, moments.numbers["sd"].error),
        "returns": f"{len(values):,}",
        "claim": f"{found.claim}, each probability within {at_most(error)}",
    }
    if found.remaining:
        facts["not listed"] = f"returns of probability {at_most(found.remaining)} at most"
    rows = [
        (name, number(chance), number(found.cdf(value)))
        for name, chance, value in islice(
            zip(values, chances, found.values, strict=True), LISTED_RETURNS
        )
    ]
    more = len(values) - len(rows)
    title = "distribution" + (f" (the first {len(rows):,}; --json prints all)" if more else "")
    headings = ("return", "probability", "at most that")
    grid = Grid(title=title, headings=headings, rows=rows, numeric=frozenset({0, 1, 2}))
    tell_limit(loaded.mdp)
    show(result, as_json=as_json, facts=facts, grids=[grid])


@click.command(
    short_help="An estimate of a policy's mean return by simulation.", epilog=POLICY_HELP
)
@click.argument("model")
@click.argument("policy")
@click.option("--episodes", required=True, metavar="N", help="Number of episodes.")
@click.option(
    "--seed", default="0", metavar="S", help="Seed of the random numbers; 0 unless given."
)
@kind_option
@perception_option
@horizon_option
@model_options
def simulate(
    model: str,
    policy: str,
    episodes: str,
    seed: str,
    kind: str,
    perception: str | None,
    horizon: str | None,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
) -> None:
    """Estimate the mean return of POLICY in MODEL from N episodes."""
    from exact_mdp.mdp.io.load import load
    from exact_mdp.solvers.values.simulate import simulate as sample

    count, first = whole_of(episodes, "--episodes", 1, MOST_EPISODES), whole_of(seed, "--seed")
    endless = load(model, sets=sets, discount=discount)
    loaded, steps = stopped(endless, horizon)
    given = policy_of(loaded.mdp, policy, perception, kind=kind)
    found = sample(endless.mdp, given, count, first, horizon=steps)
    low, high = found.estimate.interval
    result: dict[str, Any] = {
        "model": loaded.name,
        "policy": policy,
        "read_as": given.read_as,
        "perception": perception,
        "discount": loaded.mdp.discount,
        "horizon": steps,
        "claim": found.claim,
        "mean": found.mean,
        "standard_error": found.standard_error,
        "interval": [low, high],
        "sd": found.sd,
        "steps": float(found.steps.mean()),
        "event_probability": found.events,
        "episodes": found.episodes,
        "seed": first,
        "truncated": found.truncated,
        "truncation_error": found.truncation_error,
    }
    error = found.standard_error
    facts = read_as(given) | {
        "model": loaded.name,
        "policy": policy,
        **({"perception": perception} if perception else {}),
        "discount": number(loaded.mdp.discount),
        **({"horizon": f"{steps:,} steps"} if steps else {}),
        "episodes": f"{found.episodes:,}, seed {first}",
        "mean": f"{number(found.mean, error / 10)} ({found.claim}, standard error {error:.2g})",
        "95 % interval": f"{number(low, error / 10)} to {number(high, error / 10)}",
        "sd": number(found.sd, error / 10),
        "steps": number(result["steps"], 1e-4),
    }
    for name, share in found.events.items():
        facts[f"share with a {name}"] = number(share, 1e-4)
    if found.truncated:
        cut = f", each return within {at_most(found.truncation_error)}"
        facts["cut off"] = f"{found.truncated:,} episodes{'' if steps else cut}"
    tell_limit(loaded.mdp)
    show(result, as_json=as_json, facts=facts, grids=())


def _told(value: float, error: float) -> str:
    return "unknown: double precision cannot bound it" if isnan(value) else number(value, error)


def _numbers(title: str, headings: tuple[str, str], rows: list[tuple[str, str]]) -> Grid:
    return Grid(title=title, headings=headings, rows=rows, numeric=frozenset({1}))
