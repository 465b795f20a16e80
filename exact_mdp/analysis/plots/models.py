"""Pictures of a model: its transitions, the front of its totals; influences in a care model."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from itertools import permutations
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.layout import MOST_NAMED
from exact_mdp.analysis.plots.style import (
    BLACK,
    BLUE,
    COLUMN_SIZE,
    HIGH,
    INK,
    LOW,
    MARKS,
    Look,
    add_bars,
    apply_style,
    axes_or_new,
    is_narrow,
    label_axes,
    make_swatch,
)
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, require_extra
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.choices import state_names
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from exact_mdp.analysis.perception import ErrorCosts
    from exact_mdp.analysis.tradeoffs.front import Front

MANY = 80  # outcomes above which no graph can be read


@apply_style
def plot_transitions(
    model: MDP | Scenario, policy: PolicyLike | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw states as circles, actions as points, and the outcomes of actions as arrows.

    Parameters
    ----------
    model : MDP or Scenario
        Of at most 40 states, with at most 80 outcomes to draw.
    policy : PolicyLike, optional
        Its actions are black, others grey; with more than 8 states only its actions are drawn.
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, 0), ("2/3", 1, 5)]), (1, 0, [(1, 1, 0)])])
    >>> sorted(text.get_text() for text in plot_transitions(mdp).texts)
    ['0', '0', '1', '1/3', '2/3, 5']
    """
    with require_extra("plots"):
        import networkx as nx
    model = mdp_of(model)
    if model.n_states > MOST_NAMED:
        raise _too_much(f"{model.n_states:,} states", f"a model of at most {MOST_NAMED} states")
    # The actions of the policy are drawn in black, others in grey, or not at all if there are many.
    chosen = np.zeros(model.n_pairs)
    if policy is not None:
        chosen = policy_of(model, policy).weights(model)
    listed = np.flatnonzero(~model.over[model.pair_state]).tolist()
    plain = not (chosen[listed] > 0).any()
    few = plain or model.n_states <= 8
    drawn = {pair for pair in listed if few or chosen[pair] > 0}
    count = sum(len(model.table.row(pair)) for pair in drawn)
    if count > MANY:
        raise _too_much(
            f"{count:,} outcomes", f"at most {MANY}: the outcomes of a policy, or fewer states"
        )
    # One node for each state, one for each action, and an edge for each outcome.
    graph, names = nx.DiGraph(), state_names(model.space)
    size, font = 420 + 130 * min(max(map(len, names)), 12), 8 if model.n_states <= 20 else 6
    for state, name in enumerate(names):
        fill = "white"
        if model.over[state]:
            fill = "0.85"
        graph.add_node(state, label=name, size=size, fill=fill)
    for number, pair in enumerate(listed):
        point, look = f"a{number}", {"width": 1.0, "ink": "0.7"}
        if plain or chosen[pair] > 0:
            look["ink"] = "black"
        graph.add_node(point, size=12, fill="black")
        action = model.actions[model.pair_action[pair]]
        graph.add_edge(int(model.pair_state[pair]), point, label=action, **look)
        for chance, following, gain in model.table.row(pair):
            text = _format_rational(chance) + (f", {_format_rational(gain)}" if gain else "")
            before = graph.get_edge_data(point, following, {}).get("label")
            if before is not None:
                text = f"{before}; {text}"
            graph.add_edge(point, following, label=text, **look)
    place = nx.kamada_kawai_layout(graph.to_undirected())
    # The places of states do not depend on the policy.
    graph.remove_nodes_from([f"a{n}" for n, pair in enumerate(listed) if pair not in drawn])
    if ax is None:
        side = min(24.0, 2 + 1.4 * len(graph) ** 0.5)
        ax = plt.subplots(figsize=(1.2 * side, side), layout="constrained")[1]
    _draw_graph(ax, graph, place, font=font, head=9, bend=0.2, at=0.5)
    ax.margins(0.05)
    what = "Transitions; at an arrow its probability, and its reward if any"
    return label_axes(ax, what, model.name)


def _too_much(what: str, instead: str) -> ModelError:
    fix = f"draw {instead}, or its values: solve(model).plot()"
    return ModelError(f"a graph of {what}", where="graph", fix=fix)


def _format_rational(value: Fraction) -> str:
    """Return a rational as it is if that is short, else with four digits."""
    exact = ""
    if value.denominator < 10**4:
        exact = str(value)
    if 0 < len(exact) < 12:
        return exact
    return f"{float(value):.4g}"


def _draw_graph(
    ax: Axes, graph: Any, place: Any, *, font: int, head: int, bend: float, at: float
) -> None:
    """Draw nodes with a size, a fill and perhaps a label, and edges with a label, ink and width."""
    import networkx as nx

    sizes, fills, inks, widths = [], [], [], []
    for _, look in graph.nodes(data=True):
        sizes.append(look["size"])
        fills.append(look["fill"])
    for *_, look in graph.edges(data=True):
        inks.append(look["ink"])
        widths.append(look["width"])
    names = nx.get_node_attributes(graph, "label")
    curved = {"ax": ax, "connectionstyle": f"arc3,rad={bend}"}
    nx.draw_networkx_nodes(
        graph, place, ax=ax, node_size=sizes, node_color=fills, edgecolors="black"
    )
    nx.draw_networkx_labels(graph, place, names, ax=ax, font_size=font)
    nx.draw_networkx_edges(
        graph, place, node_size=sizes, edge_color=inks, width=widths, arrowsize=head, **curved
    )
    nx.draw_networkx_edge_labels(
        graph,
        place,
        nx.get_edge_attributes(graph, "label"),
        font_size=font - 1,
        rotate=False,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        label_pos=at,
        **curved,
    )
    ax.set_axis_off()


@apply_style
def draw_front(
    front: Front, *, policies: Mapping[str, PolicyLike] | None = None, ax: Axes | None = None
) -> Axes:
    """Draw a front of two totals, and policies by name with their distance from it."""
    if len(front.names) != 2:
        what = "a front of three totals has no flat picture"
        raise ModelError(what, where="plot", fix="name two totals")
    ax, at = axes_or_new(ax), np.array(front.vertices, dtype=np.float64)
    ax.plot(*at.T, color=BLUE, marker="o", markersize=4, label="front", zorder=2)
    for number, (name, policy) in enumerate((policies or {}).items()):
        own, far = np.array(front.totals(policy)), float(front.distance(policy))
        place, gains = own.astype(float), front.of.sign * (np.array(front.vertices) - own)
        dominated = ((gains >= 0).all(axis=1) & (gains > 0).any(axis=1)).any()
        if far:
            where = f"distance {far:.3g}"
        elif dominated:
            where = "dominated"
        else:
            where = "on the front"
        # Open marks, each larger than the one before: marks at the same place can all be seen.
        look: Look = {"color": INK[number % len(INK)], "fillstyle": "none", "zorder": 3}
        mark = MARKS[1 + number % (len(MARKS) - 1)]
        ax.plot(*place, mark, label=f"{name} ({where})", markersize=7 + 3 * number, **look)
        if far:
            ends = np.array([place, place + front.of.sign * far])
            ax.plot(*ends.T, color=BLACK, linewidth=0.8, linestyle=":")
    first, second = front.names
    names = {"x": f"expected total of {first}", "y": f"expected total of {second}"}
    if front.mdp is None:
        model = ""
    else:
        model = front.mdp.name
    return label_axes(ax, f"The front of {second} against {first}", model, **names)


# ---- care ----------------------------------------------------------------------------------------


@apply_style
def plot_influence(scenario: Scenario, *, ax: Axes | None = None) -> Axes:
    """Draw which status makes which likelier; widths and labels are percentage points per timestep.

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
    with require_extra("plots"):
        import networkx as nx
    ax, graph = axes_or_new(ax, high=6.0), nx.DiGraph()
    font = 9
    if is_narrow(ax):
        font = COLUMN_SIZE
    radius = 5 * font  # points: the text in a circle fits
    for status in scenario.statuses:
        numbers = [float(scenario[f"{kind}.{status}"]) for kind in ("base", "persistence")]
        text = "{}\nsets in {:.0%}\nstays {:.0%}".format(status, *numbers)
        graph.add_node(status, label=text, size=3.2 * radius**2, fill="white")
    forwards = scenario.readings["influence_orientation"] == "row-to-column"
    for names in permutations(scenario.statuses, 2):
        amount = float(scenario[f"influence.{'.'.join(names)}"])
        if amount:
            look = {"label": f"+{100 * amount:g}", "width": 0.6 + 16 * amount, "ink": "0.55"}
            graph.add_edge(*(names if forwards else names[::-1]), **look)
    angles = 3 * np.pi / 4 - 2 * np.pi * np.arange(len(graph)) / len(graph)  # four make a square
    place = {}
    for node, angle in zip(graph, angles, strict=True):
        place[node] = np.cos(angle), np.sin(angle)
    # Labels are nearer to the beginning of an arrow, so that they do not meet.
    _draw_graph(ax, graph, place, font=font, head=16, bend=0.11, at=0.35)
    # The centres are this far from the edges that circles are whole; a title takes a tenth.
    share = radius / (0.9 * 72 / ax.figure.dpi * min(ax.bbox.width, ax.bbox.height))
    ax.margins(share / (1 - min(2 * share, 0.9)))
    return label_axes(ax, "Who raises whom, in points of chance per timestep", scenario.name)


@apply_style
def plot_error_costs(costs: ErrorCosts, *, ax: Axes | None = None) -> Axes:
    """Draw the loss by status: missed where present, and seen where absent."""
    by_cost = sorted(costs.by_status.items(), key=lambda item: -sum(item[1]))
    names = [name for name, _ in by_cost]
    drawn = []
    for row, (_, (missed, invented)) in enumerate(by_cost):
        drawn.append((row - 0.2, missed, LOW | {"height": 0.38}))
        drawn.append((row + 0.2, invented, HIGH | {"height": 0.38}))
    ax = add_bars(axes_or_new(ax, names * 2), names, drawn)
    for place, loss, _ in drawn:
        ax.text(loss, place, f" {loss:.2f}", va="center", fontsize=8)
    ax.margins(x=0.12)
    return label_axes(
        ax,
        "What errors in reading each status cost",
        x="loss against perfect perception (reward)",
        handles=[make_swatch("present, not seen", LOW), make_swatch("absent, but seen", HIGH)],
    )
