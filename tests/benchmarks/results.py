"""The table and the figures of the comparison."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from contenders import ALONE
from matplotlib.ticker import NullFormatter

from exact_mdp.analysis.plots.style import LINES, save, style
from exact_mdp.mdp.io.files import write_atomically

PACKAGES = ("numpy", "scipy", "numba", "quantecon", "mdpsolver", "stormpy", "highspy")
INK = ("#0072B2", "#D55E00", "#009E73", "#4D4D4D", "#CC79A7")
MARKERS = "osD^v"
LARGE = 5e6  # bytes of arrays from which on memory says more of the model than of the process
Rows = Sequence[dict[str, Any]]


def write(rows: Rows, bandwidth: float, folder: Path, *, rounds: int) -> None:
    """Write RESULTS.md, results.json and the figures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "results.json", json.dumps(list(rows), indent=1) + "\n")
    write_atomically(folder / "RESULTS.md", "\n".join(_page(rows, bandwidth, rounds)) + "\n")
    with style():
        for name, what in (("results_time", "seconds"), ("results_memory", "memory")):
            large = [row for row in rows if what == "seconds" or row["bytes"] >= LARGE]
            if not large:
                continue
            figure = _figure(large, bandwidth, what)
            save(figure, folder, name)
            plt.close(figure)


def _page(rows: Rows, bandwidth: float, rounds: int) -> list[str]:
    lines = [
        "# Timings beside other solvers",
        "",
        f"{datetime.now(UTC):%Y-%m-%d}; {_processor()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}; one read of memory runs at {bandwidth / 1e9:.0f} GB/s. "
        + ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
        + ".",
        "",
        "Written by `make bench`. Each solver is given the same arrays, in a process of its own, "
        f"in turn, {rounds} rounds; a time is the best of three repeats after a first call, and "
        "includes what a user waits for: taking over the arrays, finding structure, solving, "
        "bounding. Python lists for mdpsolver and Storm's matrix are made beforehand, untimed, and "
        "only up to 4 million transitions; Storm's time is for *solving alone*, as that column is. "
        "An answer counts where it is within 1e-6 (or 1e-9 of the largest value) of a reference "
        "that its Bellman residual proves; *error* is the distance from it, its own included. "
        "*times ours* is the ratio of medians, with the range over rounds; above 1 means slower "
        "than exact-mdp. Memory is the peak beyond the arrays, in multiples of their size, where "
        "they take 5 MB and more. The first call of a process, imports aside, is in brackets: ours "
        "loads the compiler in it.",
        "",
    ]
    for family in dict.fromkeys(row["family"] for row in rows):
        lines += [
            f"## {family}",
            "",
            "| states | transitions | solver | seconds (first) | times ours | solving alone | "
            "times ours | memory | error | proven bound |",
            "|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|",
        ]
        for row in (row for row in rows if row["family"] == family):
            lines.append("| " + " | ".join(_cells(row, rows)) + " |")
        lines.append("")
    lines.append("![Time against size](results_time.png)")
    if any(row["bytes"] >= LARGE for row in rows):
        lines += ["", "![Memory against size](results_memory.png)"]
    return lines


def _cells(row: dict[str, Any], rows: Rows) -> list[str]:
    head = [f"{row['states']:,}", f"{row['transitions']:,}", row["contender"]]
    if row["verdict"] != "right":
        error = f"{row['error']:.1e}" if "error" in row else ""
        return [*head, row["verdict"], "", "", "", "", error, ""]
    whole = f"{np.median(row['seconds']):.4g} ({np.median(row['first']):.2g})"
    alone = row["note"] == ALONE
    return [
        *head,
        "" if alone else whole,
        "" if alone else _ratio(row, rows, "seconds"),
        f"{np.median(row['solving']):.4g}",
        _ratio(row, rows, "solving"),
        f"{row['memory'] / row['bytes']:.1f}" if row["bytes"] >= LARGE else "",
        f"{row['error']:.1e}",
        "" if row["bound"] is None else f"{row['bound']:.1e}",
    ]


def _ratio(row: dict[str, Any], rows: Rows, what: str) -> str:
    """Return how many times ours it took: the ratio of medians, and the range over rounds."""
    for ours in rows:
        same = (ours["family"], ours["size"]) == (row["family"], row["size"])
        if same and ours["contender"].startswith("exact-mdp") and what in ours:
            pairs = [a / b for a, b in zip(row[what], ours[what], strict=False)]
            middle = np.median(row[what]) / np.median(ours[what])
            if ours is not row:
                return f"{middle:.2g} ({min(pairs):.2g} to {max(pairs):.2g})"
    return ""


def _figure(rows: Rows, bandwidth: float, what: str) -> plt.Figure:
    families = list(dict.fromkeys(row["family"] for row in rows))
    columns = min(4, len(families))
    height = -(-len(families) // columns)
    figure, axes = plt.subplots(
        height, columns, figsize=(3.4 * columns, 3.0 * height), squeeze=False
    )
    for ax, family in zip(axes.flat, families, strict=False):
        mine = [row for row in rows if row["family"] == family and row["verdict"] == "right"]
        for number, name in enumerate(dict.fromkeys(row["contender"] for row in mine)):
            own = [row for row in mine if row["contender"] == name]
            x = np.array([row["states"] for row in own], dtype=float)
            y = np.array([max(_number(row, what), 1e-9) for row in own])
            label = name
            if len(x) > 1:
                label += f", slope {np.polyfit(np.log(x), np.log(y), 1)[0]:.2f}"
            ax.loglog(
                x, y, LINES[number % len(LINES)], marker=MARKERS[number % len(MARKERS)],
                color=INK[number % len(INK)], markersize=4, label=label,
            )  # fmt: skip
        sizes = {row["states"]: row["bytes"] for row in rows if row["family"] == family}
        amount = np.array(list(sizes.values())) / (bandwidth if what == "seconds" else 1)
        once = "read once at full speed" if what == "seconds" else "the arrays themselves"
        ax.loglog(list(sizes), amount, color="0.6", linewidth=1, label=once)
        ax.set(title=family, xlabel="states", ylabel="seconds" if what == "seconds" else "bytes")
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.legend(frameon=False, fontsize=6, loc="upper center", bbox_to_anchor=(0.5, -0.27))
    for ax in list(axes.flat)[len(families) :]:
        ax.set_axis_off()
    return figure


def _number(row: dict[str, Any], what: str) -> float:
    return float(np.median(row["seconds"])) if what == "seconds" else float(row["memory"])


def _processor() -> str:
    """Return what the machine says of its processor, where it says anything."""
    known = Path("/proc/cpuinfo")
    for line in known.read_text().splitlines() if known.exists() else ():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
