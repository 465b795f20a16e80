"""The loops of the handwashing assistant without its matrix.

See `mdp.coach.model` for the rules and `solvers.dynamic.coach` for the algorithm.
"""

from __future__ import annotations

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.kernels.compiling import at, compiled


@compiled
def sweep(
    value: Floats,
    choice: Numbers,
    weights: Floats,
    following: Numbers,
    helped: Numbers,
    asked: Numbers,
    links: Numbers,
    waited: Numbers,
    effects: Floats,
    prices: Floats,
    stalls: Floats,
    rewards: Floats,
    repeat: float,
    rate: float,
    improve: bool,
    raised: Floats,
    ahead: Numbers,
    stays: Numbers,
    q: Floats,
    known: Numbers,
    found: Floats,
) -> None:
    """Update the values of one kind of user in place, from the last plan step to the first.

    Parameters
    ----------
    value, choice : (P · B · M,)
        Values and chosen actions by plan step, behaviour and memory.
    weights, following : (P, B)
        Weight of the next behaviour, and the plan step that it leads to.
    helped : (P,)
        The behaviour that a caregiver sees to.
    asked : (A,)
        What an action asks for: a behaviour, -1 nothing, -2 the caregiver.
    links : (M, A, 4)
        The next memory where the plan step stays, and where it moves; which effect and which price.
    waited : (M,)
        Which of `stalls` applies.
    rewards : (P,)
    repeat : float
        Cost of asking for what was just done.
    improve : bool
        Whether to choose the best action, or to follow `choice`.
    raised, ahead, stays, q, known : (B,), (B,), (B,), (A,), (A,)
        Room.
    found : (2,)
        Raised to the greatest change and the greatest size of a value.
    """
    (memories, actions, _), (steps, behaviours) = links.shape, weights.shape
    for step in range(steps - 1, -1, -1):
        for b in range(behaviours):
            ahead[b] = (following[step, b] * behaviours + b) * memories
            stays[b] = following[step, b] == step
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
                here = at((step * behaviours + behaviour) * memories + m)
                first, last = 0, actions
                if not improve:
                    first = choice[here]
                    last = first + 1
                best, taken = 0.0, -1
                for action in range(first, last):
                    ask = asked[action]
                    if known[action] == 0:
                        known[action] = 1
                        stay, move = links[m, action, 0], links[m, action, 1]
                        if ask == -2:
                            b = helped[step]
                            worth = value[at(ahead[b] + (stay if stays[b] else move))]
                        else:
                            worth, sum_ = 0.0, total
                            for b in range(behaviours):
                                place = ahead[b] + (stay if stays[b] else move)
                                worth += raised[b] * value[at(place)]
                            if ask >= 0:
                                added = effects[links[m, action, 2]]
                                place = ahead[ask] + (stay if stays[ask] else move)
                                worth += added * value[at(place)]
                                sum_ += added
                            worth /= sum_
                        q[action] = rate * worth - prices[links[m, action, 3]]
                    net = q[action]
                    if ask == behaviour:
                        net -= repeat
                    if taken < 0 or net > best:
                        best, taken = net, action
                best += rewards[step]
                change = abs(best - value[here])
                if change > found[0]:
                    found[0] = change
                if abs(best) > found[1]:
                    found[1] = abs(best)
                value[here] = best
                choice[here] = taken
