"""What `exact-mdp perception` tells: the result for JSON, and the tables for people.

The command that says what acting on a perceived status costs, and what would help.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from exact_mdp.analysis.cli.options import given, number_of, policy_from, whole_of
from exact_mdp.analysis.cli.render import Report, Table, at_most, number

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


def _grid(
    *,
    title: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    numeric: frozenset[int] = frozenset(),
) -> Table:
    columns = {heading: itemgetter(place) for place, heading in enumerate(headings)}
    return Table(title=title, rows=rows, columns=columns)


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


def _reading_grid(price: PriceOfPerception, mdp: MDP) -> Table:
    reading = list(_reading(price, mdp).items())
    more = f", the first {READINGS} of {len(reading)}" if len(reading) > READINGS else ""
    proven = "proven the best" if price.memoryless.proven else "the best found"
    return _grid(
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
) -> list[Table]:
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
    grids = [_grid(title="value at the start", headings=("", "value", " "), rows=rows)]
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
        _grid(
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
        _grid(
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
        grids.append(_grid(title=title, headings=headings, rows=rows, numeric=frozenset({1})))
    return grids


SECONDS = "5"


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
) -> Report:
    """Tell what acting on a perceived status costs in MODEL.

    Ways to deal with errors: knowing the status, remembering what was seen and done, the best
    fixed reading of what is seen (told action by action), and taking it for true. Then which
    errors cost most, and the accuracy that keeps a share of the value.
    """
    from exact_mdp.analysis.perception.cost import price_of_perception, value_under_counts
    from exact_mdp.analysis.perception.errors import error_costs

    asked = given(model, sets, discount)
    loaded, mdp = asked.loaded, asked.mdp
    limits = _limits(seconds, trials) | {"tol": _positive(tolerance, "--tolerance")}
    drawn = whole_of(draws, "--draws", least=2, most=10**6)
    seeded = whole_of(seed, "--seed")
    matrix, counts = _confusion(mdp, perception, accuracy, prior)
    chosen = policy_from(mdp, policy)
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
    return asked.report(result, facts, grids_of(price, costs, needed, spread, mdp))


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
    assert accuracy is not None
    rate = number_of(accuracy, "--accuracy")
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

    number_of(share, "--share")
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
    return number_of(text, option, positive=True)
