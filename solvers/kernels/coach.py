"""The loops of the handwashing assistant without its matrix.

See `mdp.coach.model` for the rules and `solvers.dynamic.coach` for the algorithm.
"""

from __future__ import annotations

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.kernels.compiling import compiled


@compiled
def sweep(
    value: Floats,
    choice: Numbers,
    weights: Floats,
    following: Numbers,
    helped: Numbers,
    asked: Numbers,
    stayed: Numbers,
    moved: Numbers,
    effect: Numbers,
    effects: Floats,
    price: Numbers,
    prices: Floats,
    waited: Numbers,
    stalls: Floats,
    rewards: Floats,
    repeat: float,
    rate: float,
    improve: bool,
    raised: Floats,
    q: Floats,
    known: Numbers,
    found: Floats,
) -> None:
    """Update the values of one kind of user in place, from the last plan step to the first.

    Parameters
    ----------
    value, choice : (P, B, M)
        Values and chosen actions by plan step, behaviour and memory.
    weights, following : (P, B)
        Weight of the next behaviour, and the plan step that it leads to.
    helped : (P,)
        The behaviour that a caregiver sees to.
    asked : (A,)
        What an action asks for: a behaviour, -1 nothing, -2 the caregiver.
    stayed, moved, effect, price, waited
        See `mdp.coach.model.Memory`; `effects`, `prices`, `stalls` are what they point into.
    rewards : (P,)
    repeat : float
        Cost of asking for what was just done.
    improve : bool
        Whether to choose the best action, or to follow `choice`.
    raised, q, known : (B,), (A,), (A,)
        Room.
    found : (2,)
        The greatest change and the greatest size of a value; to be at least what it was.
    """
    steps, behaviours, memories = value.shape
    actions = len(asked)
    for step in range(steps - 1, -1, -1):
        for m in range(memories - 1, -1, -1):
            total = 0.0
            for b in range(behaviours):
                raised[b] = weights[step, b]
                if b == 0:
                    raised[b] *= stalls[waited[m]]
                total += raised[b]
            for action in range(actions):
                known[action] = 0
            for behaviour in range(behaviours):
                first, last = 0, actions
                if not improve:
                    first = choice[step, behaviour, m]
                    last = first + 1
                best, taken = 0.0, -1
                for action in range(first, last):
                    ask = asked[action]
                    if known[action] == 0:
                        known[action] = 1
                        if ask == -2:
                            b = helped[step]
                            there = following[step, b]
                            if there == step:
                                worth = value[there, b, stayed[action, m]]
                            else:
                                worth = value[there, b, moved[action, m]]
                        else:
                            worth, sum_ = 0.0, total
                            stay, move = stayed[action, m], moved[action, m]
                            for b in range(behaviours):
                                there = following[step, b]
                                if there == step:
                                    worth += raised[b] * value[there, b, stay]
                                else:
                                    worth += raised[b] * value[there, b, move]
                            if ask >= 0:
                                added = effects[effect[action, m]]
                                there = following[step, ask]
                                worth += added * value[there, ask, stay if there == step else move]
                                sum_ += added
                            worth /= sum_
                        q[action] = rate * worth - prices[price[action, m]]
                    net = q[action]
                    if ask == behaviour:
                        net -= repeat
                    if taken < 0 or net > best:
                        best, taken = net, action
                best += rewards[step]
                change = abs(best - value[step, behaviour, m])
                if change > found[0]:
                    found[0] = change
                if abs(best) > found[1]:
                    found[1] = abs(best)
                value[step, behaviour, m] = best
                choice[step, behaviour, m] = taken
