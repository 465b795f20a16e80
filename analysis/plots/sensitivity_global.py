"""Figures of the global analyses: Sobol indices and Morris effects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import axes_or_new, plain_text
from exact_mdp.mdp.errors import ModelError

if TYPE_CHECKING:
    from exact_mdp.analysis.sensitivity.draws.global_ import Morris, Sobol
    from exact_mdp.mdp.table import Floats, Integers

FIRST, TOTAL, LINE = "#56B4E9", "#FFFFFF", "#000000"
HALF = 0.38  # height of one of a parameter's two bars
OUTPUT = {
    "optimal": "start value, policy re-optimised",
    "fixed": "start value, policy held fixed",
    "regret": "regret of the policy held fixed",
}


@plain_text
def plot_sobol(
    found: Sobol, *, output: str = "optimal", most: int = 12, ax: Axes | None = None
) -> Axes:
    """Draw first-order and total indices of the parameters that weigh most, with intervals.

    Parameters
    ----------
    output : "optimal" (policy re-optimised), "fixed" (policy held) or "regret" (of the held one)

    Raises
    ------
    ModelError
        Where the output does not vary, and has no indices.
    """
    ax, each = axes_or_new(ax), found.of(output)
    if each.constant:
        raise ModelError(
            f"the {OUTPUT[output]} is the same at every draw",
            where="plot_sobol",
            fix="draw another output, or state wider ranges",
        )
    order = np.argsort(-each.total, kind="stable")[:most]
    places = np.arange(len(order))
    for offset, numbers, half, colour, hatch, label in (
        (-HALF / 2, each.first, each.first_half, FIRST, "//", "first order: alone"),
        (HALF / 2, each.total, each.total_half, TOTAL, "", "total: alone and with others"),
    ):
        ax.barh(
            places + offset,
            numbers[order],
            HALF,
            xerr=half[order],
            color=colour,
            hatch=hatch,
            edgecolor=LINE,
            label=label,
            error_kw={"ecolor": LINE, "elinewidth": 1, "capsize": 2},
        )
    _parameters(ax, found, order)
    ax.axvline(0, color=LINE, linewidth=0.8)
    ax.set_xlim(right=max(1.0, ax.get_xlim()[1]))
    ax.set_title(f"variance of the {OUTPUT[output]}")
    ax.set_xlabel("share of the variance")
    ax.legend(loc="lower right", frameon=False, title=f"{found.confidence:.0%} intervals")
    return ax


@plain_text
def plot_morris(
    found: Morris, *, output: str = "optimal", labelled: int = 8, ax: Axes | None = None
) -> Axes:
    """Draw every parameter at (μ*, σ), with intervals; the largest by name where there is room.

    Above the line σ = μ* an effect varies more than its size: it depends on other parameters, or
    is not linear.

    Parameters
    ----------
    output : as for `plot_sobol`
    """
    ax, each = axes_or_new(ax), found.of(output)
    ax.errorbar(
        each.mu_star,
        each.sigma,
        xerr=each.mu_star_half,
        yerr=each.sigma_half,
        fmt="o",
        markersize=4,
        color=LINE,
        ecolor="0.6",
        elinewidth=0.8,
    )
    reach = float(max((each.mu_star + each.mu_star_half).max(), (each.sigma).max())) or 1.0
    top = float((each.sigma + each.sigma_half).max()) or 1.0
    ax.plot([0, reach], [0, reach], "--", color="0.5", linewidth=0.8)
    ax.set_xlim(left=-0.02 * reach, right=1.3 * reach)
    ax.set_ylim(bottom=-0.03 * top, top=1.1 * top)
    ax.text(0.96 * min(reach, top), 0.99 * min(reach, top), "σ = μ*", ha="right", va="bottom")
    written: list[tuple[float, float]] = []
    for place in np.argsort(-each.mu_star, kind="stable").tolist():
        x, y = float(each.mu_star[place]), float(each.sigma[place])
        crowded = any(abs(x - u) < 0.4 * reach and abs(y - v) < 0.04 * top for u, v in written)
        if len(written) == labelled or x < 0.02 * reach or crowded:
            continue
        written.append((x, y))
        ax.annotate(
            found.names[place],
            (x, y),
            xytext=(6, -2),
            textcoords="offset points",
            va="top",
            fontsize=7,
        )
    ax.set_title(f"effects on the {OUTPUT[output]}")
    ax.set_xlabel("μ*, mean size (reward per range)")
    ax.set_ylabel("σ, standard deviation (reward per range)")
    return ax


@plain_text
def plot_morris_bars(
    found: Morris, *, output: str = "optimal", most: int = 15, ax: Axes | None = None
) -> Axes:
    """Draw μ* of the parameters that matter most, with intervals, and σ as a diamond.

    Parameters
    ----------
    output : as for `plot_sobol`
    """
    ax, each = axes_or_new(ax), found.of(output)
    order = np.argsort(-each.mu_star, kind="stable")[:most]
    places = np.arange(len(order))
    signs: Floats = each.mu[order] >= 0
    for up, colour, hatch, label in (
        (True, FIRST, "//", "μ*, rises on average"),
        (False, TOTAL, "", "μ*, falls on average"),
    ):
        these = np.flatnonzero(signs == up)
        if len(these):
            ax.barh(
                places[these],
                each.mu_star[order][these],
                0.7,
                xerr=each.mu_star_half[order][these],
                color=colour,
                hatch=hatch,
                edgecolor=LINE,
                label=label,
                error_kw={"ecolor": LINE, "elinewidth": 1, "capsize": 2},
            )
    ax.plot(each.sigma[order], places, "D", color=LINE, markersize=4, label="σ")
    _parameters(ax, found, order)
    ax.set_title(f"effects on the {OUTPUT[output]}")
    ax.set_xlabel("effect (reward per range)")
    ax.legend(loc="lower right", frameon=False)
    return ax


def _parameters(ax: Axes, found: Sobol | Morris, order: Integers) -> None:
    """Name the parameters, the first on top, with the ranges that they are drawn from."""
    labels = []
    for place in order.tolist():
        span = found.ranges[found.names[place]]
        labels.append(f"{found.names[place]} [{float(span.low):.3g}, {float(span.high):.3g}]")
    ax.set_yticks(range(len(order)), labels)
    ax.invert_yaxis()
