"""One of some listed strategies, chosen at the start and kept: the model of this choice.

    V(start) = max over strategies π_k of  V_{π_k}(start)

The first step belongs to the choice: pair k of the start draws a state from the start distribution
and takes the step of π_k there, into a copy of the model in which π_k is the only policy. So what
is asked of an optimal policy (thresholds, maps, curves, tornados) is asked of the best strategy.
"""

from __future__ import annotations

from collections.abc import Mapping

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.values.policy_chain import PolicyChain


def choose_once(model: Scenario | MDP, strategies: Mapping[str, PolicyLike]) -> MDP:
    """Return the model in which one of some strategies is chosen at the start, and kept.

    Its actions are the names of the strategies, and its reward is the model's; components, labels
    and events are left out.

    Parameters
    ----------
    model : Scenario or MDP
        Without a goal: ask `until` or `reaching` first, and then choose.
    strategies : {name: PolicyLike}

    Returns
    -------
    MDP

    Raises
    ------
    ModelError
        Without strategies, for a model with a goal, and as `Policy.of` does.

    Examples
    --------
    Treating, for 60, pays if the illness, which lasts for two years, costs more than 30 a year.

    >>> from exact_mdp import Family, thresholds
    >>> def build(at):
    ...     ill = MDP.from_arrays(
    ...         [[["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]],
    ...         [[-at["loss"], -60], [0, 0]],
    ...         layout="ass",
    ...     )
    ...     return choose_once(ill, {"wait": "always:0", "treat": "always:1"})
    >>> model = Family(parameters={"loss": 20}, build=build)
    >>> thresholds(model, "loss", ranges={"loss": (0, 100)}).frame()["threshold"].tolist()
    [30.0]
    """
    mdp = mdp_of(model)
    if not isinstance(strategies, Mapping) or not strategies:
        fix = "give {name: policy}, at least one"
        raise ModelError("there is no strategy", where="strategies", fix=fix)
    if mdp.goal is not None:
        fix = "compare the strategies by evaluate, one after the other"
        raise ModelError("a run that misses the goal has no copy", where="model", fix=fix)
    size, rows, names = mdp.n_states, [], ["choose"]
    for number, (name, form) in enumerate(strategies.items()):
        own, first = PolicyChain.of(mdp, form).model, 1 + number * size
        steps = [
            [(p, first + to, reward) for p, to, reward in own.table.row(state)]
            for state in range(size)
        ]
        start = [
            (share * p, to, reward) for state, share in mdp.start for p, to, reward in steps[state]
        ]
        rows.append((0, number, start))
        rows += [(first + state, number, outcomes) for state, outcomes in enumerate(steps)]
        names += [f"{name}: {mdp.space.plain_label(state)}" for state in range(size)]
    return MDP.from_outcomes(
        rows,
        mdp.discount_exact,
        sense=mdp.sense,
        states=names,
        actions=list(strategies),
        name=mdp.name,
    )
