"""Diagrams of a care model: who influences whom, and how the status moves under an action."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import axes_or_new, plain_text
from exact_mdp.mdp import Scenario
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Floats

nx = later("networkx")


@plain_text
def plot_influence(scenario: Scenario, *, ax: Axes | None = None) -> Axes:
    """Draw who raises whom; widths and labels are percentage points per timestep.

    Parameters
    ----------
    scenario : Scenario
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> ax = plot_influence(Scenario.load("yuan2025"))
    >>> ax.texts[0].get_text().splitlines()[0]
    'forgetfulness'
    """
    ax, graph = axes_or_new(ax), nx.DiGraph()
    graph.add_nodes_from(scenario.statuses)
    forwards = scenario.readings["influence_orientation"] == "row-to-column"
    for row in scenario.statuses:
        for column in scenario.statuses:
            if row != column and (amount := scenario[f"influence.{row}.{column}"]):
                origin, target = (row, column) if forwards else (column, row)
                graph.add_edge(origin, target, amount=float(amount))
    place = nx.circular_layout(graph)
    amounts = {edge: graph.edges[edge]["amount"] for edge in graph.edges}
    labels = {
        status: f"{status}\nbase {float(scenario[f'base.{status}']):.0%}\n"
        f"stays {float(scenario[f'persistence.{status}']):.0%}"
        for status in scenario.statuses
    }
    nx.draw_networkx_nodes(
        graph, place, ax=ax, node_size=5600, node_color="white", edgecolors="black"
    )
    nx.draw_networkx_labels(graph, place, labels, ax=ax, font_size=8)
    nx.draw_networkx_edges(
        graph,
        place,
        ax=ax,
        node_size=5600,
        width=[40 * amount for amount in amounts.values()],
        edge_color="0.45",
        connectionstyle="arc3,rad=0.14",
        arrowsize=11,
    )
    nx.draw_networkx_edge_labels(
        graph,
        place,
        {edge: f"+{100 * amount:g}" for edge, amount in amounts.items()},
        ax=ax,
        font_size=8,
        label_pos=0.32,
        connectionstyle="arc3,rad=0.14",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        rotate=False,
    )
    ax.set_axis_off()
    ax.margins(0.18)
    return ax


@plain_text
def plot_status_transitions(
    law: Floats,
    statuses: Sequence[str],
    *,
    threshold: float = 0.1,
    ax: Axes | None = None,
) -> Axes:
    """Draw the moves between status vectors; the likelier, the darker and thicker.

    Parameters
    ----------
    law : (2^n, 2^n)
        Probabilities of the next vector (column) given the present one (row).
    statuses : sequence of n str
    threshold : float
        Probability below which a move is left out.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> ax = plot_status_transitions(np.eye(4), ["anger", "confusion"])
    >>> [text.get_text() for text in ax.texts]
    ['00', '01', '10', '11']
    """
    ax, bits, graph = axes_or_new(ax), len(statuses), nx.DiGraph()
    graph.add_nodes_from(range(2**bits))
    for row, column in zip(*np.nonzero(law >= threshold), strict=True):
        graph.add_edge(int(row), int(column))
    chances = [float(law[edge]) for edge in graph.edges]
    done = ["0.85" if vector == 0 else "white" for vector in graph]
    place = _layers(bits)
    nx.draw_networkx_nodes(
        graph, place, ax=ax, node_size=620, node_color=done, edgecolors="black", linewidths=0.8
    )
    nx.draw_networkx_labels(
        graph, place, {v: format(v, f"0{bits}b") for v in graph}, ax=ax, font_size=7
    )
    nx.draw_networkx_edges(
        graph,
        place,
        ax=ax,
        node_size=620,
        width=[3.2 * chance for chance in chances],
        edge_color=[str(0.75 - 0.75 * chance) for chance in chances],
        arrowsize=7,
        connectionstyle="arc3,rad=0.10",
    )
    ax.set_axis_off()
    return ax


def _layers(bits: int) -> dict[int, tuple[float, float]]:
    """Return places of the vectors, left to right by how many statuses are present."""
    place = {}
    seen = [0] * (bits + 1)
    for vector in range(2**bits):
        present = vector.bit_count()
        width = comb(bits, present)
        # A zigzag keeps moves within a layer from running through other nodes.
        aside = 0.22 * (-1) ** seen[present] if width > 1 else 0.0
        place[vector] = (present + aside, (width - 1) / 2 - seen[present])
        seen[present] += 1
    return place
