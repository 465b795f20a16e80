"""The main job: compute, check by simulation, draw, and write everything beside a run record."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from analysis.record import run_record
from mdp import ModelError, Scenario
from mdp.files import write_atomically
from paper_repro import reported
from paper_repro.numbers import Number, Study, all_numbers, study

SEED = 20250101


def run(out: Path, *, episodes: int, quick: bool) -> list[Number]:
    """Write numbers.json, report.md, the figures and run.json into `out`; print the table.

    Parameters
    ----------
    out : folder, made where it does not exist
    episodes : simulated episodes that check each exact mean
    quick : said in run.json
    """
    from paper_repro.figures import FIGURES, draw_all

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ModelError(
            f"cannot make the folder: {error.strerror}", where=str(out), fix="name another --out"
        ) from error
    started = time.perf_counter()
    names = ("optimal", "random", *(f"reported.{start}" for start in reported.AVERAGE_RETURN))
    steps = 1 + len(names) + len(FIGURES)
    with tqdm(total=steps, disable=not sys.stderr.isatty(), leave=False) as bar:

        def tick(what: str) -> None:
            bar.set_description(what)
            bar.update()

        tick("solving")
        result = study(Scenario.load("yuan2025"))
        numbers = all_numbers(result)
        simulated = {}
        for name in names:
            tick(f"simulating {name}")
            simulated[name] = _simulated(result, name, episodes)
        figures = draw_all(result, out / "figures", tick)
    rows = [number.as_dict() | simulated.get(number.name[7:], {}) for number in numbers]
    write_atomically(out / "numbers.json", json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_atomically(out / "report.md", _report(result, numbers, rows, figures, out))
    record = _record(result, episodes, quick, time.perf_counter() - started)
    write_atomically(out / "run.json", json.dumps(record, indent=1) + "\n")
    _print(result, numbers, out)
    return numbers


def _simulated(result: Study, name: str, episodes: int) -> dict[str, Any]:
    """Return the simulated mean; an exact one that is far from it stops the reproduction."""
    from solvers import simulate

    found = simulate(result.mdp, result.policies[name], episodes=episodes, seed=SEED)
    exact = result.evaluations[name].mean
    if abs(found.mean - exact) > 5 * found.standard_error:
        raise ModelError(
            f"the exact mean {exact:.4f} and the simulated one {found.mean:.4f} differ by more "
            "than five standard errors",
            where=f"policy {name}",
            fix="report this: one of the two is wrong",
        )
    return {"simulated": found.mean, "simulated_standard_error": found.standard_error}


def _record(result: Study, episodes: int, quick: bool, seconds: float) -> dict[str, Any]:
    scenario = result.scenario
    record = run_record(result.mdp, model=scenario.name, solver="auto", seed=SEED)
    return record | {
        "seconds": round(seconds, 2),
        "quick": quick,
        "episodes": episodes,
        "readings": dict(scenario.readings),
        "tasks": list(scenario.tasks),
        "max_trial": scenario.max_trial,
        "discount": str(scenario.discount),
    }


def _cells(number: Number) -> list[str]:
    exact = f"{number.exact:.4f}" if number.standard_error else f"{number.exact:g}"
    paper = "" if number.paper is None else f"{number.paper:g}"
    difference = "" if number.difference is None else f"{number.difference:+.4g}"
    return [
        number.name,
        f"≈ {paper}" if number.approximate else paper,
        exact,
        "0" if number.difference is not None and abs(number.difference) < 1e-12 else difference,
        "" if number.standard_error is None else f"{number.standard_error:.3f}",
        "" if number.standard_errors is None else f"{number.standard_errors:+.1f}",
        number.claim,
    ]


HEADINGS = ("number", "paper", "exact", "difference", "s.e.", "in s.e.", "claim")


def _print(result: Study, numbers: list[Number], out: Path) -> None:
    console = Console(width=None if sys.stdout.isatty() else 110, highlight=False)
    table = Table(
        title="paper / exact / difference", title_justify="left", box=None, pad_edge=False
    )
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading in ("number", "claim") else "right")
    for number in numbers:
        table.add_row(*_cells(number))
    console.print(table)
    console.print(
        f"s.e.: exact standard error of an average over {reported.EXPERIMENTS:,} experiments; "
        "≈: read off a plot by the authors; bounded: floating point, error bound proven."
    )
    filled = ", ".join(f"{status} {action}" for status, action in result.completion.items())
    console.print(f"Statuses that the paper's text leaves open, filled in as: {filled}.")
    console.print(f"Figures: {out / 'figures'} (SVG and PNG); numbers: {out / 'numbers.json'}")


def _report(
    result: Study,
    numbers: list[Number],
    rows: list[dict[str, Any]],
    figures: list[Path],
    out: Path,
) -> str:
    lines = [
        "# Reproduction of Yuan et al. (2025)",
        "",
        "Default reading of the model: "
        + ", ".join(f"{name} = {option}" for name, option in result.scenario.readings.items())
        + f"; tasks {list(result.scenario.tasks)}, discount {result.scenario.discount}.",
        "",
        "Statuses whose action the paper's text does not state are filled in so that the final "
        "policy has its highest exact value ("
        + ", ".join(f"{status}: {action}" for status, action in result.completion.items())
        + "); the last column gives the range of exact values over all ways to fill them in.",
        "",
        "| " + " | ".join((*HEADINGS, "simulated", "range", "source")) + " |",
        "|" + "---|" * (len(HEADINGS) + 3),
    ]
    for number, row in zip(numbers, rows, strict=True):
        span = "" if number.lowest is None else f"{number.lowest:.4f} to {number.highest:.4f}"
        simulated = row.get("simulated")
        shown = "" if simulated is None else f"{simulated:.3f}"
        lines.append("| " + " | ".join([*_cells(number), shown, span, number.source]) + " |")
    lines += ["", "## Figures", ""]
    for path in figures:
        if path.suffix == ".png":
            name = path.stem.replace("_", " ")
            lines += [f"![{name}]({path.relative_to(out).as_posix()})", ""]
    return "\n".join(lines)
