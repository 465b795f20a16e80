"""Advice for models whose total says nothing or is infinite: where, and what to ask instead."""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.components import REST
from exact_mdp.mdp.errors import FEW_NAMED, ModelError, join_few, warn_user
from exact_mdp.mdp.model import MDP


def where_endless(mdp: MDP) -> str:
    """Return in words where a policy can stay forever, or end outside the goal."""
    if mdp.ends.every_policy_ends:
        text, places = "it ends outside the goal in ", np.flatnonzero(mdp.ends.outside_goal)
        named = [f"({label})" for label in mdp.space.labels(places[:FEW_NAMED])]
    else:
        text, places = "it stays forever in ", mdp.ends.find_endless_pairs()
        named = []
        for pair in places[:FEW_NAMED].tolist():
            label = mdp.space.label(int(mdp.pair_state[pair]))
            named.append(f"({label}) with action {mdp.actions[mdp.pair_action[pair]]}")
    return text + join_few(named, len(places))


def ways_out(mdp: MDP, *others: str) -> str:
    """Return advice, with `others` at the end, for a total that is infinite or has no limit.

    In a model with a goal a horizon does not help: a run that misses it has an infinite value then,
    too.
    """
    steps = mdp.time_limit or "N"
    ways = ["choose a discount below 1 (--discount 0.95, mdp.with_(discount=0.95))"]
    if not mdp.ends.has_goal:
        ways.append(f"stop after {steps} steps (--horizon {steps}, mdp.within({steps}))")
    ways += others
    if len(ways) == 1:
        return ways[0]
    return f"{', '.join(ways[:-1])}, or {ways[-1]}"


def other_question(mdp: MDP) -> str:
    """Return advice to ask for something else than a total; a goal has no reward per step."""
    if mdp.ends.has_goal:
        return "ask for the chance of getting there (--reach LABEL, mdp.reaching(label))"
    return 'ask for the reward per step (--criterion average, criterion="average")'


def require_termination(mdp: MDP) -> None:
    """Raise ModelError unless γ < 1 or every policy ends, in the goal if there is one."""
    if not mdp.ends.has_improper_policy:
        return
    ways = ["for the optimum of all policies use solve(mdp) or certify(mdp)"]
    if mdp.ends.every_policy_ends:
        said = "a run that ends outside the goal is worth infinity, and some policy has such a run"
    else:
        said = "discount 1 needs every policy to end, and some policy does not"
        ways.append("add a way out: a terminal state stays put and earns 0")
    raise ModelError(said, where=where_endless(mdp), fix=ways_out(mdp, *ways))


def warn_of_zero_reward(mdp: MDP) -> None:
    """Warn that all values are 0 as no outcome earns a reward, if some component says more."""
    amounts = mdp.table.components
    if amounts is None or np.asarray(mdp.table.gain != 0).any():
        return
    says = np.flatnonzero(np.any(amounts != 0, axis=0)).tolist()
    names = [mdp.component_names[n] for n in says if mdp.component_names[n] != REST]
    if names:
        warn_user(
            f"the reward is 0 everywhere, so all values are 0; the components {', '.join(names)} "
            f"do not count unless one is asked for: mdp.earning({names[0]!r}), of a family "
            f"family.with_question(lambda model: model.earning({names[0]!r})), --reward {names[0]}"
        )
