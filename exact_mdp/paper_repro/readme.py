"""The report as Markdown: README.md of this folder, and report.md of a run.

Everything that takes long to compute is in `results.json`, as a run writes it; the tables of the
paper, the prompts and the scripted conversation are computed here. So the page can be rewritten
from the results in a second, and a test compares the committed page with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, log10
from pathlib import Path
from typing import Any

from exact_mdp.paper_repro.agents.simulate import texts_of_figures
from exact_mdp.paper_repro.agents.texts import ASSISTANCE
from exact_mdp.paper_repro.claim import (
    CHANCE,
    NEARLY_ALL,
    RARE,
    ClaimVerdict,
    format_per_cent,
)
from exact_mdp.paper_repro.compiled import (
    compute_effect,
    compute_status_probability,
    derive_weights,
)
from exact_mdp.paper_repro.drawing import FIGURES
from exact_mdp.paper_repro.paper import (
    ABOUT,
    ACTIONS,
    AVERAGES,
    BITS,
    FINAL,
    OPEN,
    ORDERS,
    PAPER,
    PLACES,
    TABLE_4,
    describe_status,
    format_loss,
)
from exact_mdp.paper_repro.silent_points import OPTIONS, Reading, build_default_reading

TEMPLATE = Path(__file__).parent / "README.md.j2"
FIRST_FIGURE = "cost_of_choices"  # at the top of the page
SECTIONS = ("Section 1", "Section 4.1", "Section 4.2")  # those with findings


def format_rounded(value: float | None, *, digits: int = 4) -> str:
    """Return a number for reading: few digits, and a true minus sign; nothing for None."""
    if value is None:
        return ""
    if value == int(value) and abs(value) < 1e9:
        text = f"{int(value):,}"
    else:
        text = f"{value:.{digits}g}"
    return text.replace("-", "−")


def format_signed(value: float) -> str:
    """Return a number with its sign and one decimal.

    >>> format_signed(-0.01), format_signed(-2.66)
    ('+0.0', '−2.7')
    """
    return f"{value:+z.1f}".replace("-", "−")


def format_exact(entry: Mapping[str, Any]) -> str:
    """Return the exact number of a claim with how it is known.

    Of a share that no run shows only the upper end is known.
    """
    if entry["exact"] is None:
        return ""
    if "chance_below" in entry:
        return f"under {entry['chance_below']:.3f}"
    if error := entry["estimate_standard_error"]:
        places = max(1 - floor(log10(error)), 0)
        return f"{entry['exact']:.{places}f} ± {error:.{places}f}".replace("-", "−")
    return format_rounded(entry["exact"], digits=5 if abs(entry["exact"]) >= 100 else 4)


def format_paper_number(entry: Mapping[str, Any]) -> str:
    """Return the paper's number with the digits that it has there."""
    if entry["paper"] is None:
        return ""
    return ("≈ " if entry["approximate"] else "") + format_rounded(entry["paper"], digits=10)


def count_verdicts(claims: list[Mapping[str, Any]], kind: str) -> str:
    """Return how many claims of a kind have each verdict, in words."""
    verdicts = [entry["verdict"] for entry in claims if entry["kind"] == kind]
    return ", ".join(f"{v} {verdicts.count(v)}" for v in ClaimVerdict if v in verdicts)


def format_losses(loss: Sequence[float]) -> str:
    """Return a range of points lost.

    >>> format_losses([4.161, 4.161]), format_losses([0.0003, 5.912])
    ('4.16 points', 'under 0.01 to 5.91 points')
    """
    return " to ".join(dict.fromkeys(map(format_loss, loss))) + " points"


def format_limit(row: Mapping[str, Any]) -> str:
    """Return until when an assistance stays the best one, in words."""
    if not row["ends"]:
        return f"it costs at most {-row['limit']:g} points (in the paper {-row['today']:g})"
    return (
        f"it leaves {row['ends']} in at most {100 * row['limit']:.0f} % of cases "
        f"(in the paper {100 * row['today']:.0f} %)"
    )


def format_best_supported(entry: Mapping[str, Any]) -> str:
    """Return the verdict under the reading chosen by the returns, which cannot check returns."""
    verdict = entry["verdict_under_best_supported_reading"] or ""
    if verdict and entry["name"].startswith("return."):
        return f"{verdict} (circular)"
    return str(verdict)


def group_failed(claims: Sequence[Mapping[str, Any]]) -> list[tuple[Any, list[Any]]]:
    """Return the claims that are not reproduced, each with those that follow from it."""
    failed = {e["name"]: e for e in claims if e["verdict"] == ClaimVerdict.NOT_REPRODUCED}
    groups = []
    for name, entry in failed.items():
        if entry["follows"] not in failed:
            groups.append((entry, [e for e in failed.values() if e["follows"] == name]))
    return groups


def build_tables(reading: Reading) -> dict[str, list[list[str]]]:
    """Return Tables 1 to 4 as the compiled model has them: headings, then rows."""
    mdp, scenario, weight_of = reading.mdp, reading.scenario, derive_weights(reading)
    best, random = reading.evaluate_policy("optimal"), reading.evaluate_policy("random")

    def per_cent(share: Any) -> str:
        return f"{float(100 * share):g} %"

    def table_2(action: int, name: str) -> list[str]:
        stays = {}
        for s, b in BITS.items():
            stays[s] = [compute_status_probability(mdp, b, a, s) for a in (action, 0)]
        listed = [f"{s} {per_cent(with_)}" for s, (with_, alone) in stays.items() if with_ != alone]
        said = ASSISTANCE.get(name, {"brief": "the robot keeps silent", "examples": []})
        weight = format_rounded(float(weight_of[f"assist.{name}"]))
        words = [said["brief"], " ".join(said["examples"]), ", ".join(listed) or "none"]
        return [f"a{action} {name}", *words, weight]

    def table_3(row: str, bit: int) -> list[str]:
        base, stays = (
            per_cent(compute_status_probability(mdp, 0, 0, row)),
            per_cent(compute_status_probability(mdp, bit, 0, row)),
        )
        added = {c: "+" + per_cent(compute_effect(mdp, row, c)) for c in BITS if c != row}
        return [row, base, *({**added, row: stays}[column] for column in BITS)]

    return {
        "Table 1": [
            ["term", "in the model"],
            ["scenario", f"all tasks, from status 0000 to the end; {mdp.n_states} states"],
            [
                "task",
                f"subtasks in a row, with a bonus at the end; {list(scenario.tasks)} subtasks",
            ],
            [
                "subtask",
                "completed by a trial that ends in status 0000, or skipped, as happens in "
                f"{random.skip_probability:.1%} of episodes of random actions",
            ],
            ["trial", f"one attempt at a subtask; up to {scenario.trials}"],
            [
                "timestep",
                f"one assistance and what follows; {best.steps:.2f} are expected in an episode "
                f"under the optimal policy, {random.steps:.2f} under random actions",
            ],
        ],
        "Table 2": [
            ["assistance", "meaning", "example", "statuses that stay with", "w_assist"],
            *(table_2(action, name) for action, name in enumerate(ACTIONS)),
        ],
        "Table 3": [
            ["status at t", "base", *(f"{name} at t+1" for name in BITS)],
            *(table_3(row, bit) for row, bit in BITS.items()),
        ],
        "Table 4": [
            ["weight", "value"],
            *([name, format_rounded(float(weight_of[name]))] for name in TABLE_4),
        ],
    }


def render_readme(results: Mapping[str, Any], *, code: str = "") -> str:
    """Return the page; `code` is the beginning of links to files of the code, or empty."""
    import jinja2

    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "number": format_rounded,
        "exact": format_exact,
        "paper": format_paper_number,
        "signed": format_signed,
        "per_cent": format_per_cent,
        "points": format_losses,
        "limit": format_limit,
        "best_supported": format_best_supported,
        "status": describe_status,
    }
    environment.filters["code"] = _build_link_filter(code)
    claims = results["claims"]
    by_name = {entry["name"]: entry for entry in claims}
    failed = group_failed(claims)
    unsettled = by_name["learning.first-status-unsettled"]
    well = results["advice"][0]["best"]
    findings = [entry for entry in claims if entry["kind"] == "finding"]
    groups = {}
    for name in SECTIONS:
        groups[name] = [entry for entry in findings if entry["source"].startswith(name)]
    return environment.from_string(TEMPLATE.read_text("utf-8")).render(
        **results,
        claim=by_name,
        groups=groups,
        inputs=[entry for entry in claims if entry["kind"] == "input"],
        counted={
            "input": count_verdicts(claims, "input"),
            "finding": count_verdicts(claims, "finding"),
            "failed": sum(1 + len(followers) for _, followers in failed),
        },
        failed=failed,
        unsettled=unsettled,
        settled=[
            unsettled[step][ACTIONS.index(well)] / sum(unsettled[step])
            for step in ("constant_step", "falling_step")
        ],
        first_figure=FIGURES[FIRST_FIGURE],
        smallest_weight=min(w for name, w in TABLE_4.items() if not name.startswith("subtask")),
        about=ABOUT,
        chance=CHANCE,
        nearly_all=NEARLY_ALL,
        rare=RARE,
        places=PLACES,
        document=PAPER,
        points=OPTIONS,
        open_statuses=OPEN,
        averages=AVERAGES,
        orders=list(ORDERS),
        final=FINAL,
        tables=build_tables(build_default_reading()),
        figures=list(FIGURES.values()),
        texts=texts_of_figures(),
    )


def _build_link_filter(prefix: str) -> Any:
    def format_link(place: str) -> str:
        file, _, function = place.partition(", ")
        if prefix:
            return f"[{file}]({prefix}{file}) `{function}`"
        return f"{file} `{function}`"

    return format_link
