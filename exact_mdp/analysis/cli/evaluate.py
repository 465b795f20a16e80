"""What commands about one policy do: its value and spread, its returns, a simulation of it."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import accumulate
from typing import Any

from exact_mdp.analysis.cli.options import Given, given, whole_of
from exact_mdp.analysis.cli.render import Report, Table, at_most, between, decimal, number
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.values.evaluate import evaluate as evaluate_model
from exact_mdp.solvers.values.returns import return_distribution
from exact_mdp.solvers.values.simulate import simulate as sample

MOST_EPISODES = 10**9
LISTED_RETURNS = 1000  # longer distributions are left to --json
UNDEFINED = "undefined: the mean is infinite"
LISTED_STATES = 1000  # models with more states are left to Python for the numbers of each


def evaluate(*, quantiles: bool, **shared: Any) -> Report:
    """Evaluate a policy."""
    asked = given(**shared)
    if asked.average:
        return _average(asked)
    found = evaluate_model(asked.mdp, asked.policy)
    shares = found.quantiles if quantiles else None
    missing = "left out" if not quantiles else found.quantiles_missing
    numbers = found.numbers
    result = {
        "claim": found.claim,
        "mean": found.mean,
        "error_bound": found.start.error,
        "sd": found.sd,
        "steps": found.steps,
        "ends": found.ends,
        "skip_probability": found.skip_probability,
        "event_probability": found.event_probability,
        "components": found.components,
        "quantiles": shares,
        "quantiles_missing": missing or None,
        "error_bounds": {name: number.error for name, number in numbers.items()},
    }
    facts = {
        "mean": numbers["mean"],
        "sd": _spread(numbers["mean"], numbers["sd"]),
        "steps": numbers["steps"] if found.ends else "inf: it may never end",
        **{
            f"probability of a {name}": numbers[f"event.{name}"] for name in found.event_probability
        },
        "quantiles": f"none: {missing}" if missing else None,
    }
    totals = [{"name": name, "total": numbers[f"component.{name}"]} for name in found.components]
    returned = [{"share": share, "value": value} for share, value in (shares or {}).items()]
    tables = [
        Table(
            title="expected total of each reward component",
            rows=totals,
            columns={"component": "name", "total": "total"},
        ),
        Table(
            title="quantiles of the return",
            rows=returned,
            columns={"share": "share:.0%", "return": "value"},
        ),
    ]
    return asked.report(result, facts, tables)


def _average(asked: Given) -> Report:
    """Evaluate the average reward per step of a policy."""
    found = evaluate_model(asked.mdp, asked.policy, criterion="average")
    frame, few = found.frame(), asked.mdp.n_states <= LISTED_STATES
    result = {
        "claim": found.claim,
        "mean": found.start.value,
        "error_bound": found.start.error,
        "recurrent_classes": len(found.classes.base),
        "components": {name: number.value for name, number in found.components.items()},
        "by_state": frame.set_index("state").to_dict("index") if few else None,
    }
    facts = {"reward per step": found.start, "recurrent classes": len(found.classes.base)}
    parts = [{"name": name, "share": number} for name, number in found.components.items()]
    columns = {name: name for name in ("state", "gain", "bias", "share")}
    tables = [
        Table(
            title="reward per step of each component",
            rows=parts,
            columns={"component": "name", "per step": "share"},
        ),
        Table(title="gain, bias and share of time", rows=frame, columns=columns),
    ]
    return asked.report(result, facts, tables)


def returns(*, exact: bool, **shared: Any) -> Report:
    """Compute the distribution of a policy's return."""
    asked = given(**shared)
    found = return_distribution(asked.mdp, asked.policy, exact=exact)
    moments = evaluate_model(asked.mdp, asked.policy)
    mean, sd = moments.numbers["mean"], moments.numbers["sd"]
    law = found.as_dict()
    values, chances = [decimal(value) for value in law], [*law.values()]
    error = float(found.frame()["error"].max())
    result = {
        "claim": found.claim,
        "mean": mean.value,
        "sd": sd.value,
        "error_bounds": {"mean": mean.error, "sd": sd.error},
        "error_bound": error,
        "remaining": found.remaining,
        "never_ends": found.never_ends,
        "distribution": dict(zip(values, chances, strict=True)),
    }
    if found.exact is not None:
        exactly: dict[Fraction | float, Fraction | float] = {}
        exactly |= zip(found.values, found.exact, strict=True)
        exactly |= {sign: each.value for sign, each in found.unending.items()}
        result["exact_distribution"] = {decimal(value): exactly[value] for value in law}
    facts = {
        "mean": mean,
        "sd": _spread(mean, sd),
        "returns": len(values),
        "never ends": f"with probability {found.never_ends:.10g}, and the return is infinite"
        if found.unending
        else None,
        "claim": f"{found.claim}, each probability within {at_most(error)}",
        "not listed": f"returns of probability {at_most(found.remaining)} at most"
        if found.remaining
        else None,
    }
    listed = zip(values, chances, accumulate(chances), strict=True)
    table = Table(
        title="distribution",
        rows=[{"return": name, "chance": chance, "sum": most} for name, chance, most in listed],
        columns={
            "return": "return",
            "probability": "chance",
            "at most that": "sum",
        },
        first=LISTED_RETURNS,
    )
    return asked.report(result, facts, [table])


def _spread(mean: Bounded, sd: Bounded) -> Bounded | str:
    return sd if math.isfinite(mean.value) else UNDEFINED


def simulate(*, episodes: str, seed: str, **shared: Any) -> Report:
    """Simulate a policy."""
    count, first = whole_of(episodes, "--episodes", 1, MOST_EPISODES), whole_of(seed, "--seed")
    asked = given(**shared)
    model = asked.endless.mdp if asked.question is None else asked.question(asked.endless.mdp)
    found = sample(model, asked.policy, count, first, horizon=asked.steps)
    steps, error = found.mean_steps, found.standard_error / 10
    finite = math.isfinite(found.mean)
    result = {
        "claim": found.claim,
        "mean": found.mean,
        "standard_error": found.standard_error,
        "interval": found.value.interval,
        "sd": found.sd,
        "steps": steps,
        "event_probability": found.events,
        "episodes": found.episodes,
        "seed": first,
        "never_ends": found.never_ends,
        "truncated": found.truncated,
        "truncation_error": found.truncation_error,
    }
    cut = "" if asked.steps else f", each return within {at_most(found.truncation_error)}"
    facts = {
        "episodes": f"{found.episodes:,}, seed {first}",
        "mean": found.value if finite else f"{found.mean} ({found.claim})",
        "95 % interval": between(*found.value.interval, error) if finite else None,
        "sd": number(found.sd, error) if finite else UNDEFINED,
        "steps": f"{steps}: some never end" if found.endless else steps,
        **{f"share with a {name}": share for name, share in found.events.items()},
        "never end": f"a share of {found.never_ends:.4g} of the episodes, of infinite return"
        if found.never_ends
        else None,
        "cut off": f"{found.truncated:,} episodes{cut}" if found.truncated else None,
    }
    return asked.report(result, facts)
