"""The facts and tables of a probabilistic sensitivity analysis, for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from analysis.cli_output import Grid, number
from analysis.sensitivity.intervals import FEW
from analysis.sensitivity.psa_result import PSA
from analysis.sensitivity.report import only_first
from analysis.sensitivity.value_of_information import PartialInformation

SHOWN = 16  # rows of a table


def facts_of(result: Mapping[str, Any], found: PSA) -> dict[str, str]:
    """Return the facts of a result."""
    value, regret, bounds = result["value"], result["regret"], result["evpi_bounds"]
    accepted = result["acceptability"]
    clipped = found.clipped
    return {
        "draws": f"{result['draws']:,}, seed {result['seed']}; every draw re-solved",
        "drawn, held": f"{len(result['drawn'])}, {len(result['fixed'])} parameters; "
        f"effective sample size {result['effective_sample_size']:g} unless stated",
        "start value today": number(result["start_value"], result["error_bound"]),
        "V* over the draws": f"mean {_told(value)}, sd {value['sd']:.4g}, "
        f"95 % of draws {_middle(value['quantiles'])}",
        "policy held fixed": result["policy"],
        "its regret": f"mean {_told(regret)}, 95 % of draws {_middle(regret['quantiles'])}",
        "it is optimal in": f"{accepted['probability'][0]:.1%} of draws",
        "EVPI": f"{_pair(bounds['low'])} to {_pair(bounds['high'])} (best policy found: "
        f"{bounds['best_policy']})",
        **({"chances cut off at 1": f"in {clipped.value:.2%} of draws"} if clipped else {}),
        **_warned(result),
        "claim": "estimated; ± is the standard error",
    }


def grids_of(
    result: Mapping[str, Any], found: PSA, partial: Mapping[str, PartialInformation]
) -> list[Grid]:
    """Return the tables: optimal actions, policies, and where there are any losses and EVPPI."""
    losses = result["expected_loss"]
    return [
        _actions(found),
        _policies(result["candidates"]),
        *([] if losses is None else [_losses(losses)]),
        *([_information(partial)] if partial else []),
    ]


def _actions(found: PSA) -> Grid:
    """Return how often each action is optimal."""
    share, low, high = found.probability_optimal()
    rows = [
        (label, *(f"{share[x, a]:.4f}" for a in range(len(found.actions))))
        for x, label in enumerate(found.labels[:SHOWN])
    ]
    where = "at subtask 0, trial 0; " if found.compiled else ""
    reach = float(np.maximum(high - share, share - low).max())
    return Grid(
        title=f"share of draws in which an action is optimal, {where}ends of Wilson's 95 % "
        f"intervals are within {reach:.2g}{only_first(len(found.labels), SHOWN)}",
        headings=("status" if found.compiled else "state", *found.actions),
        rows=rows,
        numeric=frozenset(range(1, 1 + len(found.actions))),
    )


def _policies(candidates: Iterable[Mapping[str, Any]]) -> Grid:
    """Return what each policy is worth on average."""
    return Grid(
        title="policies held fixed in every draw",
        headings=("policy", "mean value", "expected loss", "s.e.", "optimal in"),
        rows=[
            (
                each["name"],
                f"{each['mean']['value']:.6g}",
                f"{each['expected_loss']['value']:.4g}",
                f"{each['expected_loss']['standard_error']:.1g}",
                f"{each['probability_optimal']:.1%}",
            )
            for each in candidates
        ],
        numeric=frozenset(range(1, 5)),
    )


def _losses(losses: Mapping[str, Any]) -> Grid:
    """Return what each policy loses, by how much is known."""
    return Grid(
        title="expected loss by effective sample size of what nothing is stated of, "
        f"{losses['draws']:,} draws each; ~ marks what fewer than {FEW:g} draws carry",
        headings=("policy", *(f"{point:g}" for point in losses["points"])),
        rows=[
            (
                name,
                *(
                    f"{loss:.4g}{'~' if 0 < carried < FEW else ''}"
                    for loss, carried in zip(each["loss"], each["draws_that_carry_it"], strict=True)
                ),
            )
            for name, each in losses["policies"].items()
        ],
        numeric=frozenset(range(1, 1 + len(losses["points"]))),
    )


def _information(partial: Mapping[str, PartialInformation]) -> Grid:
    """Return what knowing some parameters would be worth, the most valuable first."""
    ordered = sorted(partial.items(), key=lambda item: -item[1].regression.value)[:SHOWN]
    return Grid(
        title="EVPPI, choosing among these policies: by regression, at most their EVPI, "
        "and a lower estimate; ? marks what is not to be relied on",
        headings=("known", "regression", "s.e.", "lower", "s.e.", ""),
        rows=[
            (
                name,
                f"{each.regression.value:.4g}",
                f"{each.regression.standard_error:.1g}",
                f"{each.lower.value:.4g}",
                f"{each.lower.standard_error:.1g}",
                "" if each.reliable else "?",
            )
            for name, each in ordered
        ],
        numeric=frozenset({1, 2, 3, 4}),
    )


def _warned(result: Mapping[str, Any]) -> dict[str, str]:
    """Return a line on means that few draws carry, whose intervals may be too short."""
    means = {
        "regret": result["regret"],
        "EVPI's upper end": result["evpi_bounds"]["high"],
        "EVPI's lower end": result["evpi_bounds"]["low"],
    }
    few = [
        f"{name} by {told['draws_that_carry_it']:.0f}"
        for name, told in means.items()
        if told["few_draws"] and told.get("value", told.get("mean"))
    ]
    if not few:
        return {}
    return {"carried by few draws": f"{', '.join(few)}: take more draws to rely on it"}


def _told(spread: Mapping[str, Any]) -> str:
    return f"{number(spread['mean'], spread['standard_error'])} ± {spread['standard_error']:.1g}"


def _pair(estimate: Mapping[str, Any]) -> str:
    error = estimate["standard_error"]
    return f"{number(estimate['value'], error)} ± {error:.1g}"


def _middle(found: Sequence[Mapping[str, Any]]) -> str:
    values = {each["probability"]: each["value"] for each in found}
    return f"{values[0.025]:.4g} to {values[0.975]:.4g}"
