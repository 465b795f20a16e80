"""`exact-mdp perception`: the cost of acting on a perceived status."""

from __future__ import annotations

from operator import itemgetter
from typing import Any

from exact_mdp.analysis.cli.options import given, number_of, whole_of
from exact_mdp.analysis.cli.render import Report, Table, at_most, between
from exact_mdp.analysis.perception.accuracy import confusion_at
from exact_mdp.analysis.perception.errors import ErrorCosts, error_costs
from exact_mdp.analysis.perception.values import UncertainValue, value_under_counts
from exact_mdp.mdp.care.perception import (
    Counted,
    holds_examples,
    read,
    read_counts,
    status_size,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.policy_chain import policy_of

SHOWN = 12  # confusions listed for people


def perception(
    model: str,
    perception: str | None,
    accuracy: str | None,
    prior: str | None,
    draws: str,
    seed: str,
    policy: str,
    sets: tuple[str, ...],
    discount: str | None,
) -> Report:
    """Report what acting on a perceived status costs, and which errors cost most."""
    asked = given(model, sets, discount)
    mdp = asked.mdp
    n, rng = whole_of(draws, "--draws", least=2, most=10**6), whole_of(seed, "--seed")
    matrix, counts = _confusion(mdp, perception, accuracy, prior)
    optimum = solve(mdp)
    chosen = policy_of(mdp, optimum if policy == "optimal" else policy)
    costs = error_costs(mdp, chosen, matrix)
    spread = None if counts is None else value_under_counts(mdp, chosen, counts, rng=rng, n=n)
    facts = {"policy": policy, "perception": perception or f"accuracy {accuracy}"}
    result = facts | {
        "claim": costs.value.claim,
        "perfect": optimum.start,
        "taken_as_true": costs.value,
        "errors": _errors(costs),
        "confusions": {"loss": costs.loss, "marginal": costs.marginal, "error_bound": costs.error},
        "counted": None if spread is None else _spread(spread, rng),
    }
    tables = [
        _ways(optimum.start, costs.value, spread),
        *_cost_tables(costs),
    ]
    return asked.report(result, facts, tables)


# ---- what was asked ------------------------------------------------------------------------------


def _confusion(
    mdp: MDP, path: str | None, accuracy: str | None, prior: str | None
) -> tuple[Floats, Counted | None]:
    """Return the confusion matrix, and the counts behind it where a prior is given."""
    status_size(mdp)
    if (path is None) == (accuracy is None):
        raise ModelError(
            "no perception, or two of them", where="options", fix="give --perception or --accuracy"
        )
    if accuracy is not None:
        if prior is not None:
            raise ModelError("an accuracy takes no prior", where="--prior", fix="leave it out")
        rate = number_of(accuracy, "--accuracy")
        try:
            return confusion_at(mdp, rate), None
        except ModelError as error:
            raise ModelError(error.what, where="--accuracy", fix=error.fix) from error
    assert path is not None
    if prior is None:
        return read(path, mdp), None
    weight = number_of(prior, "--prior", positive=True)
    if not holds_examples(path):
        raise ModelError("only labelled examples take a prior", where="--prior", fix="leave it out")
    counts = read_counts(path, mdp, prior=weight)
    return counts.mean, counts


# ---- what is told --------------------------------------------------------------------------------


def _errors(costs: ErrorCosts) -> dict[str, dict[str, float]]:
    names = ("missed", "seen", "by_sensitivity", "by_specificity")
    return {
        status: dict(zip(names, (*lost, *costs.rates[status]), strict=True))
        for status, lost in costs.by_status.items()
    }


def _spread(spread: UncertainValue, seed: int) -> dict[str, Any]:
    return {
        "mean": spread.value.value,
        "standard_error": spread.value.standard_error,
        "interval": list(spread.interval),
        "level": spread.level,
        "draws": len(spread.draws),
        "seed": seed,
        "claim": spread.value.claim,
    }


def _ways(perfect: Bounded, seen: Bounded, spread: UncertainValue | None) -> Table:
    """Return the table of the values at the start."""
    rows: list[tuple[Any, ...]] = [
        ("the status is known", perfect, ""),
        ("seen taken for true", seen, ""),
    ]
    if spread is not None:
        told = f"{spread.level:.0%} in {between(*spread.interval)} (estimated)"
        rows.append(("… by the posterior", spread.value, told))
    columns = {"": itemgetter(0), "value": itemgetter(1), " ": itemgetter(2)}
    return Table(title="value at the start", rows=rows, columns=columns)


def _cost_tables(costs: ErrorCosts) -> list[Table]:
    rows = [{"status": status} | each for status, each in _errors(costs).items()]
    worst = costs.frame().columns
    return [
        Table(
            title="what errors cost where the status seen is taken for true (within "
            f"{at_most(costs.error)})",
            rows=sorted(rows, key=lambda row: -row["missed"] - row["seen"]),
            columns={
                "status": "status",
                "missed": "missed:.4f",
                "seen wrongly": "seen:.4f",
                "per unit of sensitivity": "by_sensitivity:.4f",
                "of specificity": "by_specificity:.4f",
            },
        ),
        Table(
            title="the costliest confusions",
            rows=costs.frame(),
            columns={
                "true": worst[0],
                "perceived": worst[1],
                "loss": f"{worst[2]}:.4f",
                "per unit of probability": f"{worst[3]}:.4f",
            },
            first=SHOWN,
        ),
    ]
