"""The main job: check every claim, draw the figures, write all results and a run record.

results.json   everything that the report is written from
numbers.json   the claims with a number
report.md      the report
figures/       each figure as SVG and PNG
run.json       versions, commit and date

Finished training runs are kept in OUT/work until the job is done, so an interrupted job goes on
where it stopped. `expected.toml` pins the result of each claim; it is written by hand.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import floor, log10
from pathlib import Path
from textwrap import fill
from typing import Any

from exact_mdp import Estimated, ModelError, evaluate
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.errors import require_extra, require_known_name
from exact_mdp.mdp.report import DIGITS, format_error_bound
from exact_mdp.paper_repro import (
    section_2,
    section_3,
    section_4_1_learning,
    section_4_1_policies,
    section_4_2,
)
from exact_mdp.paper_repro.advice import advise
from exact_mdp.paper_repro.claim import (
    CLAIMS,
    ClaimVerdict,
    PaperClaim,
    depends_on_reading,
    judge_claims,
)
from exact_mdp.paper_repro.drawing import FIGURES, save_figure
from exact_mdp.paper_repro.paper import AVERAGES, FINAL, OPEN, ORDERS, write_file
from exact_mdp.paper_repro.readme import format_exact, format_paper_number, render_readme
from exact_mdp.paper_repro.silent_points import (
    SEED,
    Reading,
    build_default_reading,
    change_settings,
    compute_support,
    describe_readings,
    one_change,
)

# Importing the sections fills CLAIMS.
PARTS = (section_2, section_3, section_4_1_learning, section_4_1_policies, section_4_2)
HERE = Path(__file__).parent
EXPECTED = HERE / "expected.toml"


def show_progress(text: str) -> None:
    """Show the current task, if standard error is a terminal."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text:.78}", end="", file=sys.stderr, flush=True)


def round_numbers(data: Any) -> Any:
    """Return results with the digits that every processor gives, ten of each number.

    Sums in another order differ in the twelfth digit at most, where numbers nearly cancel out. An
    error bound holds for the rounded number, and is itself rounded up.
    """
    if isinstance(data, Mapping):
        bound, number = data.get("error_bound"), data.get("exact")
        data = {key: round_numbers(value) for key, value in data.items()}
        if bound is not None and number:
            unit = 10.0 ** (floor(log10(abs(number))) - DIGITS + 1)
            data["error_bound"] = float(format_error_bound(bound + unit / 2))
        return data
    if isinstance(data, list | tuple):
        return [round_numbers(value) for value in data]
    if isinstance(data, float):
        return float(f"{data:.{DIGITS}g}")
    return data


def as_json(data: object) -> str:
    """Return data as JSON text."""
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def run_reproduction(out: Path, *, quick: bool, readme: Path | None = None) -> dict[str, Any]:
    """Write everything into `out`, and the report with its figures into `readme`, too."""
    started, runs = time.perf_counter(), 400  # training runs of each schedule
    if quick:
        runs = 100
    require_matplotlib()
    # This fails here, before any work, if the folder cannot be written to.
    write_file(out / "run.json", as_json({"started": True}))
    # Find out first which readings the reported returns support.
    reading = build_default_reading(runs=runs, folder=out / "work")
    evidence = compute_support(reading, show_progress)
    changed = one_change(reading)
    best = replace(evidence.best, runs=runs // 4)
    claims = []
    for entry in judge_claims(list(CLAIMS.values()), reading, changed, best):
        claims.append(entry)
        show_progress(f"{len(claims)} of {len(CLAIMS)} claims: {entry['name']}")
    results = {
        "quick": quick,
        "runs": runs,
        "values": compute_values(reading),
        "advice": advise(reading, [*changed, best]),
        "readings": describe_readings(evidence, [reading, *changed]),
        "claims": claims,
    }
    # Numbers are rounded only where they are written.
    written = round_numbers(results)
    numbers = [each for each in written["claims"] if each["exact"] is not None]
    write_file(out / "results.json", as_json(written))
    write_file(out / "numbers.json", as_json(numbers))
    write_file(out / "report.md", render_readme(written))
    for picture in FIGURES.values():
        show_progress(f"figure {picture.name}")
        save_figure(picture, reading, out / "figures")
        if readme is not None:
            drawn = out / "figures" / f"{picture.name}.png"
            write_file(readme / "figures" / drawn.name, drawn.read_bytes())
    if readme is not None:
        write_file(readme / "results.json", as_json(written))
        write_file(readme / "README.md", render_readme(written, code="./"))
    # The record of the run comes last: only a complete run has one.
    record = run_record(reading.mdp, model="yuan2025", solver="auto", seed=SEED)
    scenario = reading.scenario
    record |= {
        "quick": quick,
        "training_runs": runs,
        "readings": dict(scenario.readings),
        "tasks": list(scenario.tasks),
        "max_trial": scenario.max_trial,
        "discount": str(scenario.discount),
        "seconds": round(time.perf_counter() - started, 2),
    }
    write_file(out / "run.json", as_json(record))
    shutil.rmtree(out / "work", ignore_errors=True)
    show_progress("")
    return results


def require_matplotlib() -> None:
    """Raise ModelError, before anything is computed, if no figure could be drawn."""
    with require_extra("plots"):
        import matplotlib.pyplot as plt
    del plt


def compute_values(reading: Reading) -> dict[str, Any]:
    """Return the exact values that the report names: each reported policy in both orders.

    And the final one with directive assistance where the text says nothing.
    """
    named = {name: reading.evaluate_policy(name).mean for name in ("optimal", "random")}
    orders = {}
    for o in ORDERS:
        orders[o] = {start: reading.evaluate_policy(start, o).mean for start in AVERAGES}
    silent = {}
    for statuses in (OPEN[1:], OPEN):
        silent[", ".join(statuses)] = evaluate(
            reading.mdp, reading.find_reported_policy(FINAL) | dict.fromkeys(statuses, "directive")
        ).mean
    return {**named, **orders, "directive_in": silent}


def find_claim(name: str) -> PaperClaim:
    """Return a claim by its name; raises ModelError for an unknown one."""
    if there := [each.id for each in CLAIMS.values() if name in each.places]:
        said = f"{name} is a place, and no claim"
        raise ModelError(said, where="claim", fix=f"choose one of {', '.join(there)}")
    return CLAIMS[require_known_name(name, CLAIMS, "claim", "claim")]


def draw_figure(name: str, out: Path, runs: int) -> list[Path]:
    """Draw one figure into a folder; raises ModelError for an unknown one."""
    by_place = {}
    for each in FIGURES.values():
        if each.place:
            by_place[each.place.removeprefix("Figure ")] = each
    number = name.lower().removeprefix("figure").strip()
    picture = by_place.get(number) or FIGURES[require_known_name(name, FIGURES, "figure", "figure")]
    require_matplotlib()
    return save_figure(picture, build_default_reading(runs=runs), out)


def changed_reading(base: Reading, sets: Sequence[str]) -> Reading:
    """Return a reading with KEY=VALUE changes: of the text, the scenario or training.KEY."""
    scenario, order = base.scenario, base.order
    training: dict[str, Any] = {}
    for each in sets:
        name, _, text = each.partition("=")
        if name.startswith("training."):
            try:
                value = json.loads(text)
            except ValueError:
                value = text
            training[name.removeprefix("training.")] = value
        elif name == "readings.respectively":
            order = require_known_name(text.replace("-", " "), ORDERS, "order", name)
        else:
            scenario = scenario.set(each)
    label = ", ".join(sets) or base.label
    reading = replace(base, scenario=scenario, order=order, training=training, label=label)
    if training:
        change_settings("decaying", training)  # refuses what does not fit
    return reading


def format_claim(name: str, sets: Sequence[str], runs: int) -> str:
    """Return one claim with everything found about it, as text.

    An open claim is tried under the readings with one change, too.
    """
    claim = find_claim(name)
    reading = changed_reading(build_default_reading(runs=runs), sets)
    finding = claim.find(reading)
    number, here = finding.number, ""
    if number is not None:
        spread = 0.0
        if isinstance(number, Estimated):
            spread = number.standard_error
        error = ""
        if spread:
            error = f" ± {spread:.2g}"
        value = f"{float(number.value):.10g}"
        if "chance_below" in finding.details:
            value = f"under {finding.details['chance_below']:.3f}"
        here = f"{value}{error} ({number.claim}), {finding.number_is}"
    lines = {
        "paper": "" if finding.paper is None else f"{float(finding.paper):g}",
        "here": here,
        "verdict": finding.says,
        "why": finding.why,
        "reading": reading.label,
        "code": f"paper_repro/{claim.code}",
    }
    if claim.learns:
        lines["runs"] = f"{runs} of each exploration schedule"
    if claim.open and not sets:
        others = [(each.label, claim.find(each)) for each in one_change(reading)]
        listed = [f"{one.says}: {label}" for label, one in others if one.says != finding.says]
        same = sum(one.verdict is finding.verdict for _, one in others)
        summary = f"{same} of {len(others)} with one change have the same verdict"
        lines["other readings"] = "\n    ".join([summary, *listed])
        if depends_on_reading(finding, [one.verdict for _, one in others]):
            lines["verdict"] = f"{ClaimVerdict.DEPENDS}; {finding.says} under the default one"
    width = max(map(len, lines)) + 2
    body = [f"  {key + ':':{width}}{text}" for key, text in lines.items() if text]
    return "\n".join([f"{claim.id} ({', '.join(claim.places)})", claim.says, *body])


def list_claims() -> str:
    """Return all claims with their places, one below the other, and the names of the figures."""
    lines, wide = [], 100
    for claim in CLAIMS.values():
        says = fill(
            claim.says,
            wide,
            initial_indent="    ",
            subsequent_indent="    ",
            break_on_hyphens=False,
        )
        lines.append(f"{claim.id} ({', '.join(claim.places)})\n{says}")
    named = []
    for each in FIGURES.values():
        name = each.name
        if each.place:
            name += f" ({each.place})"
        named.append(name)
    return "\n".join([*lines, fill(f"figures: {', '.join(named)}", wide, subsequent_indent="    ")])


def format_claim_table(results: Mapping[str, Any]) -> str:
    """Return all claims as a table: paper, exact, difference, verdict."""
    lines = [f"{'claim':40}{'paper':>10}{'exact':>20}{'difference':>12}  verdict"]
    for each in results["claims"]:
        apart = each["difference"]
        if apart is None:
            gap = ""
        else:
            gap = f"{apart:+.4g}".replace("-", "−")
        lines.append(
            f"{each['name']:40}{format_paper_number(each):>10}{format_exact(each):>20}"
            f"{gap:>12}  {each['verdict_says']}"
        )
    return "\n".join(lines)


def compare_with_pinned(claims: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return where claims differ from the pinned values."""
    pinned = tomllib.loads(EXPECTED.read_text("utf-8"))
    names = {entry["name"] for entry in claims}
    off = [f"{name} is pinned, and no claim" for name in sorted(pinned.keys() - names)]
    for entry in claims:
        name, verdict = entry["name"], entry["verdict_of_default_reading"]
        wanted = pinned.get(name)
        if wanted is None:
            off.append(f"{name} is not pinned")
            continue
        if isinstance(wanted["verdict"], list):
            verdicts = wanted["verdict"]
        else:
            verdicts = [wanted["verdict"]]
        if verdict not in verdicts:
            off.append(f"{name} is {verdict}, not {' or '.join(verdicts)}")
        if ("value" in wanted) != (entry["exact"] is not None):
            off.append(f"{name} has {'no' if 'value' in wanted else 'a'} number")
        elif "value" in wanted and abs(entry["exact"] - wanted["value"]) > wanted["tolerance"]:
            off.append(f"{name} is {entry['exact']!r}, not {wanted['value']!r}")
    return off
