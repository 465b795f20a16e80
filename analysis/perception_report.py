"""What `exact-mdp perception` tells: the result for JSON, and the tables for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.cli_output import Grid, at_most, number

if TYPE_CHECKING:
    from analysis.perception import ErrorCosts, PriceOfPerception, UncertainValue
    from analysis.perception_needed import AccuracyNeeded
    from analysis.status_policies import BestPolicy
    from mdp.model import MDP

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
        "claim": each.claim,
    }


def spread_of(spread: UncertainValue, seed: int) -> dict[str, Any]:
    return {
        "mean": spread.mean,
        "standard_error": spread.standard_error,
        "interval": list(spread.interval),
        "level": spread.level,
        "draws": len(spread.draws),
        "seed": seed,
        "claim": spread.claim,
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
                f"{spread.mean:.6g}",
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
