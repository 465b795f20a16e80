"""The transitions of a small model as a graph, and as text for Graphviz.

A state has an edge for each of its actions to a point, and each point one to every next state, with
its exact probability and the reward there. See https://graphviz.org/doc/info/lang.html for DOT.
"""

from __future__ import annotations

from fractions import Fraction

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import policy_of

MOST = 200  # states in a text


Move = tuple[int, str, list[tuple[int, str]], bool]
"""A state, an action, its outcomes (next state, label), and whether a policy takes it."""


def moves(model: MDP, policy: PolicyLike | None, *, most: int) -> list[Move]:
    """Return the moves of every state in which not all is over; raises ModelError beyond `most`."""
    if model.n_states > most:
        raise ModelError(
            f"a graph of {model.n_states:,} states",
            where="graph",
            fix=f"draw a model of at most {most} states, or its values: solve(model).plot()",
        )
    chosen = None if policy is None else policy_of(model, policy).weights(model)
    listed = list[Move]()
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
        listed.append((state, action, outcomes, taken))
    return listed


def dot(model: MDP | Scenario, policy: PolicyLike | None = None) -> str:
    """Return the transition graph in Graphviz's language, a policy's actions drawn heavier.

    Parameters
    ----------
    model : MDP or Scenario
        Of at most 200 states.
    policy : PolicyLike, optional

    Returns
    -------
    str
        Text for a `.dot` file.

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> print(dot(MDP.from_outcomes([(0, 0, [("1/3", 0, 0), ("2/3", 1, 5)]), (1, 0, [(1, 1, 0)])])))
    digraph {
      rankdir=LR
      0 [label="state 0"]
      1 [label="state 1", shape=doublecircle]
      a0 [shape=point]
      0 -> a0 [label="0", arrowhead=none]
      a0 -> 0 [label="1/3"]
      a0 -> 1 [label="2/3, 5"]
    }
    """
    mdp = mdp_of(model)
    lines = ["digraph {", "  rankdir=LR"]
    for state in range(mdp.n_states):
        end = ", shape=doublecircle" if mdp.over[state] else ""
        lines.append(f"  {state} [label={_quoted(mdp.space.label(state))}{end}]")
    for number, (state, action, outcomes, taken) in enumerate(moves(mdp, policy, most=MOST)):
        heavy = ", penwidth=2.5" if taken else ""
        label = _quoted(action)
        lines += [
            f"  a{number} [shape=point]",
            f"  {state} -> a{number} [label={label}, arrowhead=none{heavy}]",
        ]
        lines += [
            f"  a{number} -> {following} [label={_quoted(text)}{heavy}]"
            for following, text in outcomes
        ]
    return "\n".join([*lines, "}"])


def _number(value: Fraction) -> str:
    """Return a rational as it is where that is short, else four digits."""
    exact = str(value) if value.denominator < 10**4 else ""
    return exact if 0 < len(exact) < 12 else f"{float(value):.4g}"


def _quoted(text: str) -> str:
    """Return a label that shows the text as it is: a backslash begins an escape in DOT."""
    text = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{text}"'
