"""The transition graph of a small model."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from exact_mdp.analysis.graph import moves
from exact_mdp.analysis.plots.style import plain_text, titled
from exact_mdp.mdp import MDP, Scenario
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.solver import mdp_of

nx = later("networkx")

MOST = 40  # states
FEW = 8  # states up to which all actions are drawn beside the policy's
CURVE = "arc3,rad=0.2"


@plain_text
def plot_transitions(
    model: MDP | Scenario, policy: PolicyLike | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw states as circles, actions as points, and where each leads with what probability.

    Parameters
    ----------
    model : MDP or Scenario
        Of at most 40 states; `exact_mdp.analysis.graph.dot` takes more, and suits models in which
        every state leads to many others.
    policy : PolicyLike, optional
        Its actions are black, others grey; of over 8 states its actions alone are drawn.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    ModelError
        For a larger model.

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, 0), ("2/3", 1, 5)]), (1, 0, [(1, 1, 0)])])
    >>> sorted(text.get_text() for text in plot_transitions(mdp).texts)
    ['0', '0', '1', '1/3', '2/3, 5']
    """
    model = mdp_of(model)
    found, graph = moves(model, policy, most=MOST), nx.DiGraph()
    plain = not any(move.taken for move in found)
    labels = dict[tuple[object, object], str]()
    graph.add_nodes_from(range(model.n_states))
    for number, move in enumerate(found):
        point = f"a{number}"
        graph.add_edge(move.state, point, taken=move.taken)
        labels[move.state, point] = move.action
        for following, text in move.outcomes:
            graph.add_edge(point, following, taken=move.taken)
            before = labels.get((point, following))
            labels[point, following] = text if before is None else f"{before}; {text}"
    place = nx.kamada_kawai_layout(graph.to_undirected())
    if not plain and model.n_states > FEW:  # where they stand does not depend on the policy
        unused = [f"a{number}" for number, move in enumerate(found) if not move.taken]
        graph.remove_nodes_from(unused)
        labels = {edge: label for edge, label in labels.items() if graph.has_edge(*edge)}
    if ax is None:
        side = min(24.0, 2 + 1.4 * len(graph) ** 0.5)
        ax = plt.subplots(figsize=(1.2 * side, side), layout="constrained")[1]
    states = range(model.n_states)
    names = {state: model.space.label(state).removeprefix("state ") for state in states}
    wide = max(map(len, names.values()))
    size, font = 420 + 130 * min(wide, 12), 8 if model.n_states <= 20 else 6
    fills = ["0.85" if model.terminal[state] else "white" for state in states]
    nx.draw_networkx_nodes(
        graph, place, list(states), ax=ax, node_size=size, node_color=fills, edgecolors="black"
    )
    nx.draw_networkx_labels(graph, place, names, ax=ax, font_size=font)
    points = [node for node in graph if node not in names]
    nx.draw_networkx_nodes(graph, place, points, ax=ax, node_size=12, node_color="black")
    inks = ["black" if plain or taken else "0.7" for _, _, taken in graph.edges(data="taken")]
    sizes = [12 if node in points else size for node in graph]
    edges = {"ax": ax, "connectionstyle": CURVE}
    nx.draw_networkx_edges(graph, place, node_size=sizes, edge_color=inks, arrowsize=9, **edges)
    nx.draw_networkx_edge_labels(
        graph,
        place,
        labels,
        font_size=font - 1,
        rotate=False,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        **edges,
    )
    ax.margins(0.05)
    ax.set_axis_off()
    titled(ax, "at an arrow: probability, reward (none where it is 0)")
    return ax
