"""What `exact-mdp train` prints for people."""

from __future__ import annotations

from typing import Any

from analysis.cli_output import Grid, number
from analysis.learning import Interval

SHOWN = 10  # policies in the table


def facts(result: dict[str, Any]) -> dict[str, str]:
    regret, selected = result["regret"], result["selected"]
    low, high = result["optimal_fraction_interval"]
    told = {
        "model": result["model"],
        "settings": result["settings"],
        "runs": f"{result['seeds']:,} from seed {result['seed']}, {result['steps']:,} steps",
        "discount": f"{number(result['discount'])} (values); the learner's own is in its settings",
        "optimal value": number(result["optimal_value"], result["optimal_value_error"]),
        "value of acting at random": number(result["random_value"]),
        "mean regret": _with_interval(regret["mean"], regret["mean_interval"]),
        "quantiles of regret": ", ".join(
            f"{float(share):.0%}: {number(value)}" for share, value in regret["quantiles"].items()
        ),
        "runs that end optimal": f"{result['optimal_fraction']:.1%} ({low:.1%} to {high:.1%})",
    }
    if result["best_value"] < result["optimal_value"] - result["optimal_value_error"]:
        proof = "proven" if result["best_value_proven"] else "the best found"
        read = ", ".join(result["columns"]) or "nothing"
        told[f"best that reads {read}"] = (
            f"{number(result['best_value'])}, {proof}; {result['best_fraction']:.1%} end with it"
        )
    told["mean regret of the best of five"] = number(selected["regret"]["mean"])
    if result["cut_short"]:
        told["episodes cut short"] = f"{result['cut_short']:,}"
    if result["written"]:
        told["written"] = ", ".join(result["written"])
    return told


def _with_interval(value: float, interval: Interval | None) -> str:
    if interval is None:
        return number(value)
    return f"{number(value)} (95 %: {interval[0]:.4g} to {interval[1]:.4g})"


def grids(result: dict[str, Any]) -> list[Grid]:
    most = result["policies"][0]["policy"]
    rows = []
    for entry in result["policies"][:SHOWN]:
        if entry is result["policies"][0] or most is None:
            shown = (
                "as most runs" if most is None else ", ".join(f"{k} {a}" for k, a in most.items())
            )
        else:
            unlike = {k: a for k, a in entry["policy"].items() if a != most[k]}
            shown = ", ".join(f"{k} {a}" for k, a in unlike.items())
        rows.append((str(entry["count"]), number(entry["value"]), number(entry["regret"]), shown))
    more = len(result["policies"]) - len(rows)
    title = "final greedy policies, and where they differ from the first"
    found = [
        Grid(
            title=f"{title} ({more} more)" if more else title,
            headings=("runs", "value", "regret", "policy"),
            rows=rows,
            numeric=frozenset({0, 1, 2}),
        ),
        Grid(
            title="how many policies are greedy in the last episodes of a run",
            headings=("policies", "runs", "share", "95 %"),
            rows=[
                (
                    many,
                    str(entry["count"]),
                    f"{entry['count'] / result['seeds']:.1%}",
                    "{:.1%} to {:.1%}".format(*entry["interval"]),
                )
                for many, entry in result["distinct_in_last"].items()
            ],
            numeric=frozenset({0, 1, 2}),
        ),
    ]
    changed = sorted(result["changed_in_last"].items(), key=lambda item: -item[1]["fraction"])
    if changed:
        found.append(
            Grid(
                title="where these policies differ",
                headings=("row", "share of runs", "95 %"),
                rows=[
                    (row, f"{each['fraction']:.1%}", "{:.1%} to {:.1%}".format(*each["interval"]))
                    for row, each in changed
                ],
                numeric=frozenset({1}),
            )
        )
    if result["unstable"]:
        found.append(_theory(result["unstable"]))
    return found


def _theory(found: dict[str, Any]) -> Grid:
    rows = [
        (
            name,
            f"{entry['fixed_point']:.3f}",
            f"{entry['gap']:.3f}",
            f"{entry['noise']:.3f}",
            f"{entry['linear']:.1%}",
            f"{entry['switching']:.1%}",
            f"{entry['observed']:.1%}",
            "{:.1%} to {:.1%}".format(*entry["interval"]),
        )
        for name, entry in found["actions"].items()
    ]
    return Grid(
        title=f"{found['row']}: fixed point of the learner, noise at rate {found['rate']:g}, and "
        "predicted and observed shares of final policies",
        headings=("action", "Q", "gap", "noise", "linear", "switching", "observed", "95 %"),
        rows=rows,
        numeric=frozenset(range(1, 8)),
    )
