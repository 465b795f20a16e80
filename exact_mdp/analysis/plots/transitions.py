"""The transition graph of a small model, with exact probabilities and rewards."""

from __future__ import annotations

from fractions import Fraction

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from exact_mdp.analysis.plots.style import described, picture
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, extra
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import policy_of

MOST = 40  # states
FEW = 8  # states up to which all actions are drawn beside the policy's
MANY = 150  # outcomes above which no graph can be read
CURVE = "arc3,rad=0.2"

Move = tuple[int, str, list[tuple[int, str]], bool]
"""A state, an action, its outcomes (next state, label), and whether a policy takes it."""


@picture
def plot_transitions(
    model: MDP | Scenario, policy: PolicyLike | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw states as circles, actions as points, and where each leads with what probability.

    Parameters
    ----------
    model : MDP or Scenario
        Of at most 40 states, with at most 150 outcomes to draw.
    policy : PolicyLike, optional
        Its actions are black, others grey; of over 8 states its actions alone are drawn.
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
    listed, graph = _moves(model, policy), nx.DiGraph()
    plain = not any(taken for *_, taken in listed)
    few = plain or model.n_states <= FEW
    count = sum(len(outcomes) for *_, outcomes, taken in listed if few or taken)
    if count > MANY:
        raise _too_much(
            f"{count:,} outcomes", f"at most {MANY}: those of a policy, or fewer states"
        )
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


def _moves(model: MDP, policy: PolicyLike | None) -> list[Move]:
    """Return the moves of every state in which not all is over; raises ModelError beyond 40."""
    if model.n_states > MOST:
        raise _too_much(f"{model.n_states:,} states", f"a model of at most {MOST} states")
    chosen = None if policy is None else policy_of(model, policy).weights(model)
    moves = list[Move]()
    for pair in range(model.n_pairs):
        state = int(model.pair_state[pair])
        if model.over[state]:
            continue
        outcomes = [
            (following, _number(chance) + (f", {_number(gain)}" if gain else ""))
            for chance, following, gain in model.table.row(pair)
        ]
        taken = chosen is not None and bool(chosen[pair] > 0)
        action = model.actions[int(model.pair_action[pair])]
        moves.append((state, action, outcomes, taken))
    return moves


def _too_much(what: str, instead: str) -> ModelError:
    fix = f"draw {instead}, or its values: solve(model).plot()"
    return ModelError(f"a graph of {what}", where="graph", fix=fix)


def _number(value: Fraction) -> str:
    """Return a rational as it is where that is short, else four digits."""
    exact = str(value) if value.denominator < 10**4 else ""
    return exact if 0 < len(exact) < 12 else f"{float(value):.4g}"
