"""Betting and stopping: problems whose optimal play and value are known in closed form."""

from fractions import Fraction

from .case import Case, Pair, actions, best, end

F = Fraction
BOLD = "Dubins and Savage, How to Gamble If You Must (McGraw-Hill 1965)"
RUIN = (
    "Feller, An Introduction to Probability Theory and Its Applications I (Wiley 1968), "
    "section XIV.2"
)


def gambler(goal: int, p: Fraction) -> Case:
    """Stake 1 to min(s, goal - s) of a fortune s on a coin that wins with probability p.

    In a fair game every play is as good as any other. In favour of the gambler timid play, a
    stake of 1, is the best and is worth the formula of the gambler's ruin. Against her, bold play
    is optimal (all, or what it takes to reach the goal) and worth F(s / goal), where
    F(x) = p F(2x) up to 1/2 and F(x) = p + (1 - p) F(2x - 1) from there.
    """
    q = 1 - p
    pairs: list[Pair] = [*end(0), *end(goal)]
    for s in range(1, goal):
        for stake in range(1, min(s, goal - s) + 1):
            pairs.append((s, stake, p * (s + stake == goal), {s + stake: p, s - stake: q}))
    most = {s: min(s, goal - s) for s in range(1, goal)}
    optimal: dict[int, frozenset[int]] = {}
    if p < q:
        values = _bold(goal, p)
    elif p == q:
        values = {s: F(s, goal) for s in most}
        optimal = {s: frozenset(range(1, stake + 1)) for s, stake in most.items()}
    else:
        values = {s: (1 - (q / p) ** s) / (1 - (q / p) ** goal) for s in most}
        optimal = {s: frozenset({1}) for s in most}
    return Case(
        name=f"gambler-{goal}-{p}",
        source="Sutton and Barto, Reinforcement Learning (MIT Press 2018), example 4.3; "
        + (BOLD if p < q else RUIN),
        pairs=tuple(pairs),
        discount=F(1),
        values={0: F(0), **values, goal: F(0)},
        policy=most if p < q else {},
        optimal=optimal,
        start=goal // 2,
    )


def _bold(goal: int, p: Fraction) -> dict[int, Fraction]:
    """Follow each fortune under bold play until it comes back to itself or the game is over."""
    values = {}
    for s in range(1, goal):
        earned, weight, x, path = F(0), F(1), s, {}
        while x not in (0, goal) and x not in path:
            path[x] = (earned, weight)
            if 2 * x <= goal:
                weight, x = weight * p, 2 * x
            else:
                earned, weight, x = earned + weight * p, weight * (1 - p), 2 * x - goal
        if x == goal:
            values[s] = earned + weight
        elif x == 0:
            values[s] = earned
        else:  # v(x) = (earned - before) / w + (weight / w) v(x), from the first visit to x
            before, w = path[x]
            values[s] = before + w * ((earned - before) / w) / (1 - weight / w)
    return values


def secretary(n: int, skipped: int, ties: bool = False) -> Case:
    """Choose the best of n applicants, seen one by one; state k - 1: the k-th is the best so far.

    Accepting (0) succeeds with probability k / n; the next one who beats all before is the j-th
    with probability k / (j (j - 1)). With c skipped the best is found with probability
    (c / n) (1 / c + 1 / (c + 1) + ... + 1 / (n - 1)).
    """
    pairs: list[Pair] = end(n)
    for k in range(1, n + 1):
        pairs.append((k - 1, 0, F(k, n), {n: F(1)}))
        if k < n:
            later = {j - 1: F(k, j * (j - 1)) for j in range(k + 1, n + 1)}
            pairs.append((k - 1, 1, F(0), {**later, n: F(k, n)}))
    chance = F(skipped, n) * sum(F(1, k) for k in range(skipped, n))
    return Case(
        name=f"secretary-{n}",
        source="Gilbert and Mosteller, Journal of the American Statistical Association 61 (1966), "
        "section 2; Ferguson, Statistical Science 4 (1989) 282-289",
        pairs=tuple(pairs),
        discount=F(1),
        values={0: chance},
        optimal={
            k - 1: frozenset({0, 1} if ties and k == skipped else {int(k <= skipped)})
            for k in range(1, n)
        },
    )


def pig() -> Case:
    """One turn of the dice game Pig: hold (0), or roll (1) and lose the turn's total on a 1.

    At a total of 20 another roll gains (2 + ... + 6) / 6 and loses 20 / 6 on average: a tie.
    """
    most = 30  # a total of more than 20 is held, so the table may end here
    pairs: list[Pair] = end(most)
    for total in range(most):
        pairs.append((total, 0, F(total), {most: F(1)}))
        if total + 6 < most:
            pairs.append(
                (total, 1, F(0), {**{total + pips: F(1, 6) for pips in range(2, 7)}, most: F(1, 6)})
            )
    scores = {20: 0.099713, 21: 0.094991, 22: 0.074189, 23: 0.054196, 24: 0.035198, 25: 0.017173}
    return Case(
        name="pig-turn",
        source="Neller and Presser, Optimal Play of the Dice Game Pig, UMAP Journal 25 (2004) "
        "25-47; the distribution of the score: Neller, Nifty Assignments 2010, Hold-at-20 "
        "Outcomes",
        pairs=tuple(pairs),
        discount=F(1),
        values={0: sum(score * share for score, share in scores.items())},
        tolerance=1e-4,
        optimal=best(*[[1]] * 20, [0, 1], *[[0]] * 9),
        wrong_policy=actions([*[1] * 24, *[0] * 7]),  # which rolls on to 24
    )


CASES = (
    gambler(100, F(2, 5)),
    gambler(64, F(1, 4)),
    gambler(30, F(1, 2)),
    gambler(30, F(11, 20)),
    secretary(2, 1, ties=True),
    secretary(10, 3),
    secretary(50, 18),
    pig(),
)
