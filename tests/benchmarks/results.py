"""The tables and the figure of the comparison."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from contenders import ALONE, FAR, OURS, SECONDS
from matplotlib.ticker import NullFormatter

from exact_mdp import plots
from exact_mdp.analysis.plots.style import LINES, MARKS
from exact_mdp.mdp.io.files import write_atomically

PACKAGES = ("numpy", "scipy", "numba", "quantecon", "mdpsolver", "stormpy", "highspy")
INK = (
    "#0072B2", "#D55E00", "#009E73", "#4D4D4D", "#CC79A7", "#E69F00", "#56B4E9", "#000000",
    "#999933", "#882255",
)  # fmt: skip
LARGE = 5e6  # bytes of arrays from which on memory says more of the model than of the process
Row = dict[str, Any]
Rows = Sequence[Row]


def write(rows: Rows, bandwidth: float, folder: Path) -> None:
    """Write RESULTS.md, results.json and the figure into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "results.json", json.dumps(list(rows), indent=1) + "\n")
    write_atomically(folder / "RESULTS.md", "\n".join(_page(rows, bandwidth)) + "\n")
    # Powers of ten on the axes are formulas; names of states, which are none, do not occur here.
    with plots.style(), plt.rc_context({"text.parse_math": True}):
        if _leading(rows):
            (figure := _ratios(rows)).savefig(folder / "results_ratio.png")
            plt.close(figure)


def _page(rows: Rows, bandwidth: float) -> list[str]:
    dates = _between(row["measured"] for row in rows if "measured" in row) or "not dated"
    minutes = sum(row.get("spent", 0.0) for row in rows) / 60
    rounds = _between(len(row["seconds"]) for row in rows if "seconds" in row)
    rounds += " round" if rounds == "1" else " rounds"
    lines = [
        "# Timings beside other solvers",
        "",
        "![Our time over that of the best peer, against size](results_ratio.png)",
        "",
        "Our time over that of the best peer, each with its best repeat; below 1 we are ahead. Of "
        "each peer the setting that does best on the model counts, and building the model counts "
        "on both sides, but for Storm.",
        "",
        *_summary(rows),
        f"{dates}; {_processor()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}; one read of memory runs at {bandwidth / 1e9:.0f} GB/s. "
        + ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
        + ".",
        "",
        f"Written by `make bench`, whose runs took {minutes:.0f} minutes. Each solver is "
        f"given the same arrays, in a process of its own, in turn, in {rounds} (one if it takes "
        f"more than {FAR} times as long as ours, and at most {SECONDS} seconds); a time is "
        "the best of three repeats or more, half a second of them, after a first call, and "
        "includes what a user waits for: taking over the arrays, finding structure, solving, "
        "bounding. Python lists for mdpsolver and Storm's matrix are made beforehand, untimed, and "
        "only up to 4 million transitions; Storm's time is for *solving alone*, as that column is. "
        "An answer counts where it is within 1e-6 (or 1e-9 of the largest value) of a reference "
        "that its Bellman residual proves; *error* is the distance from it. The reference has an "
        "error of its own, so that *error* may be above *proven bound* and the bound still hold: "
        "an answer counts only where *error* is at most the bound and the proven error of the "
        "reference together. "
        "*times ours* is the ratio of medians, with the range over rounds; above 1 means slower "
        "than exact-mdp. Memory is the peak beyond the arrays, in multiples of their size, where "
        "they take 5 MB and more. The first call of a process, imports aside, is in brackets, of "
        "seconds and of memory: ours loads the compiler in it.",
        "",
    ]
    for family in dict.fromkeys(row["family"] for row in rows):
        lines += [
            f"## {family}",
            "",
            "| states | transitions | solver | seconds (first) | times ours | solving alone | "
            "times ours | memory (first) | error | proven bound |",
            "|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|",
        ]
        for row in (row for row in rows if row["family"] == family):
            lines.append("| " + " | ".join(_cells(row, rows)) + " |")
        lines.append("")
    return lines[:-1]


def _cells(row: Row, rows: Rows) -> list[str]:
    head = [f"{row['states']:,}", f"{row['transitions']:,}", row["contender"]]
    error = f"{row['error']:.1e}" if "error" in row else ""
    if row["verdict"] != "right":
        return [*head, row["verdict"], "", "", "", "", error, ""]
    alone, memory = row["note"] == ALONE, ""
    if row["bytes"] >= LARGE:  # rows of older runs have the memory of all calls alone
        first = row.get("first memory")
        memory = f"{row['memory'] / row['bytes']:.1f}"
        memory += "" if first is None else f" ({first / row['bytes']:.1f})"
    return [
        *head,
        "" if alone else f"{np.median(row['seconds']):.4g} ({np.median(row['first']):.2g})",
        "" if alone else _times(row, rows, "seconds"),
        f"{np.median(row['solving']):.4g}",
        _times(row, rows, "solving"),
        memory,
        error,
        "" if row["bound"] is None else f"{row['bound']:.1e}",
    ]


def _times(row: Row, rows: Rows, what: str) -> str:
    """How many times ours it took: the ratio of medians, and the range over rounds."""
    for ours in rows:
        same = (ours["family"], ours["size"]) == (row["family"], row["size"])
        if same and ours["contender"] in (OURS, OURS + " LP") and what in ours and ours is not row:
            ratios = [a / b for a, b in zip(row[what], ours[what], strict=False)]
            middle = np.median(row[what]) / np.median(ours[what])
            return f"{middle:.2g} ({min(ratios):.2g} to {max(ratios):.2g})"
    return ""


def _leading(rows: Rows) -> list[tuple[Row, float, str]]:
    """Our rows with our time over that of the best peer on the same model, and who that is."""
    leading = []
    right = [row for row in rows if row["verdict"] == "right"]
    for ours in (row for row in right if row["contender"] in (OURS, OURS + " LP")):
        ratios = []
        for row in right:
            same = (row["family"], row["states"]) == (ours["family"], ours["states"])
            if same and not row["contender"].startswith(OURS):
                what = "solving" if row["note"] == ALONE else "seconds"
                ratios.append((min(ours[what]) / min(row[what]), row["contender"]))
        if ratios:
            leading.append((ours, *max(ratios)))
    return leading


def _summary(rows: Rows) -> list[str]:
    lines = ["| model | states | ours / best peer | best peer | first call of a process |"]
    lines += ["|---|---:|---:|---|---:|"]
    for row, ratio, peer in _leading(rows):
        cells = row["family"], f"{row['states']:,}", f"{ratio:.2g}", peer
        lines.append(f"| {' | '.join(cells)} | {np.median(row['first']):.2g} s |")
    return [*lines, ""]


def _between(values: Iterable[Any]) -> str:
    """The least and the largest of some values, in words."""
    ordered = sorted(set(values))
    return " to ".join(map(str, dict.fromkeys([*ordered[:1], *ordered[-1:]])))


# ---- the figure ----------------------------------------------------------------------------------


def _ratios(rows: Rows) -> plt.Figure:
    """Draw our time over that of the best peer against size, a line for each family."""
    figure, ax = plt.subplots(figsize=(7, 4.2))
    leading = _leading(rows)
    for number, family in enumerate(dict.fromkeys(row["family"] for row, *_ in leading)):
        own = sorted((row["states"], ratio) for row, ratio, _ in leading if row["family"] == family)
        ax.loglog(
            *zip(*own, strict=True), linestyle=LINES[number % len(LINES)],
            marker=MARKS[number % len(MARKS)], color=INK[number % len(INK)], markersize=4,
            label=family,
        )  # fmt: skip
    for axis in (ax.xaxis, ax.yaxis):  # powers of ten as numbers, and nothing between them
        axis.set_major_formatter(lambda x, _: f"{x:,.0f}" if 1 <= x < 1e6 else f"{x:g}")
        axis.set_minor_formatter(NullFormatter())
    ax.axhline(1, color="0.6", linewidth=1)
    ax.set(xlabel="states", ylabel="our time / that of the best peer")
    ax.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _processor() -> str:
    """What the machine says of its processor, where it says anything."""
    known = Path("/proc/cpuinfo")
    lines = known.read_text().splitlines() if known.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
