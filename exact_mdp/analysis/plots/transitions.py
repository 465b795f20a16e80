"""The transition graph of a small model; a heat map where the graph would be a tangle."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from exact_mdp.analysis.graph import moves
from exact_mdp.analysis.plots.style import described, picture, shaded
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import extra
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import PolicyChain

MOST = 40  # states
FEW = 8  # states up to which all actions are drawn beside the policy's
MANY = 150  # outcomes above which no graph can be read
CURVE = "arc3,rad=0.2"


@picture
def plot_transitions(
    model: MDP | Scenario, policy: PolicyLike | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw states as circles, actions as points, and where each leads with what probability.

    Parameters
    ----------
    model : MDP or Scenario
        Of at most 40 states; `exact_mdp.analysis.graph.dot` takes more. With more than 150 outcomes
        to draw, it becomes a heat map of the probabilities from state to state.
    policy : PolicyLike, optional
        Its actions are black, others grey; of over 8 states its actions alone are drawn. In a heat
        map it chooses the actions; without one all are as likely.
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
    with extra("plots"):
        import networkx as nx
    model = mdp_of(model)
    listed, graph = moves(model, policy, most=MOST), nx.DiGraph()
    plain = not any(taken for *_, taken in listed)
    few = plain or model.n_states <= FEW
    count = sum(len(outcomes) for *_, outcomes, taken in listed if few or taken)
    if count > MANY:
        return _heat_map(model, policy, count, ax)
    labels = dict[tuple[object, object], str]()
    graph.add_nodes_from(range(model.n_states))
    for number, (state, action, outcomes, taken) in enumerate(listed):
        point = f"a{number}"
        graph.add_edge(state, point, taken=taken)
        labels[state, point] = action
        for following, text in outcomes:
            graph.add_edge(point, following, taken=taken)
            before = labels.get((point, following))
            labels[point, following] = text if before is None else f"{before}; {text}"
    place = nx.kamada_kawai_layout(graph.to_undirected())
    if not few:  # where they stand does not depend on the policy
        graph.remove_nodes_from([f"a{n}" for n, (*_, taken) in enumerate(listed) if not taken])
        labels = {edge: label for edge, label in labels.items() if graph.has_edge(*edge)}
    if ax is None:
        side = min(24.0, 2 + 1.4 * len(graph) ** 0.5)
        ax = plt.subplots(figsize=(1.2 * side, side), layout="constrained")[1]
    states = range(model.n_states)
    names = {state: model.space.label(state).removeprefix("state ") for state in states}
    wide = max(map(len, names.values()))
    size, font = 420 + 130 * min(wide, 12), 8 if model.n_states <= 20 else 6
    fills = ["0.85" if model.over[state] else "white" for state in states]
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
    what = "Transitions; at an arrow its probability, and its reward if any"
    return described(ax, what, model.name)


def _heat_map(model: MDP, policy: PolicyLike | None, outcomes: int, ax: Axes | None) -> Axes:
    """Draw the probability of every next state, by shade."""
    if ax is None:
        side = 2.5 + 0.22 * model.n_states
        ax = plt.subplots(figsize=(1.15 * side, side), layout="constrained")[1]
    names = [name.removeprefix("state ") for name in model.space.labels(range(model.n_states))]
    chain = PolicyChain.of(model, "random" if policy is None else policy)
    chances = chain.transition.toarray() + np.diag(model.terminal * 1.0)  # an end stays
    mesh = shaded(ax, chances, names, names, {}, most=None, fontsize=7)
    ax.tick_params(axis="x", rotation=90)
    ax.set_aspect("equal")
    ax.figure.colorbar(mesh, ax=ax, label="probability", shrink=0.8)
    acting = "all actions equally likely" if policy is None else "as the policy acts"
    what = f"Transitions, {acting}; {outcomes:,} outcomes are too many for a graph"
    return described(ax, what, model.name, x="next state", y="state")
