"""Diagrams of a care model: who influences whom, and how the status moves under an action."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from exact_mdp.analysis.plots.style import axes_or_new, plain_text
from exact_mdp.mdp import Scenario


def influence_graph(scenario: Scenario) -> nx.DiGraph:
    """Return the influences as a directed graph; an edge points at the status that it raises."""
    graph = nx.DiGraph()
    graph.add_nodes_from(scenario.statuses)
    forwards = scenario.readings["influence_orientation"] == "row-to-column"
    for row in scenario.statuses:
        for column in scenario.statuses:
            if row != column and (amount := scenario[f"influence.{row}.{column}"]):
                origin, target = (row, column) if forwards else (column, row)
                graph.add_edge(origin, target, amount=float(amount))
    return graph


@plain_text
def plot_influence(scenario: Scenario, *, ax: Axes | None = None) -> Axes:
    """Draw the influence graph; widths and labels are percentage points per timestep."""
    ax = axes_or_new(ax)
    graph = influence_graph(scenario)
    place = nx.circular_layout(graph)
    amounts = [graph.edges[edge]["amount"] for edge in graph.edges]
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
        width=[40 * amount for amount in amounts],
        edge_color="0.45",
        connectionstyle="arc3,rad=0.14",
        arrowsize=11,
    )
    nx.draw_networkx_edge_labels(
        graph,
        place,
        {edge: f"+{100 * graph.edges[edge]['amount']:g}" for edge in graph.edges},
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
    law: NDArray[np.float64],
    statuses: Sequence[str],
    *,
    threshold: float = 0.1,
    ax: Axes | None = None,
) -> Axes:
    """Draw the moves between status vectors whose probability is at least `threshold`.

    Parameters
    ----------
    law : (2^n, 2^n) probabilities of the next vector (column) given the present one (row)
    statuses : names of the n status bits
    threshold : probability below which a move is left out
    """
    ax = axes_or_new(ax)
    bits = len(statuses)
    graph = nx.DiGraph()
    graph.add_nodes_from(range(2**bits))
    for row, column in zip(*np.nonzero(law >= threshold), strict=True):
        graph.add_edge(int(row), int(column), probability=float(law[row, column]))
    place = _layers(bits)
    widths = [3.2 * graph.edges[edge]["probability"] for edge in graph.edges]
    inks = [str(0.75 - 0.75 * graph.edges[edge]["probability"]) for edge in graph.edges]
    done = ["0.85" if vector == 0 else "white" for vector in graph]
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
        width=widths,
        edge_color=inks,
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
