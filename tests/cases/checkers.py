"""Benchmarks of probabilistic model checkers, with the exact answers they publish.

A property of the least value of something is a model of its negative. A probability of reaching
a set is the expectation of a reward of 1 on the way in.
"""

from collections.abc import Callable
from fractions import Fraction

from .case import Case, Pair, end, row

F = Fraction
HALF = F(1, 2)
STORM = "moves-rwth/storm "
STORM_TESTS = STORM + "src/test/storm/modelchecker/prctl/mdp/"
STORM_MODELS = STORM + "resources/examples/testfiles/mdp/"
QCOMP = "ahartmanns/qcomp benchmarks/"


# The die of Knuth and Yao: seven states in which a coin is flipped, then the faces (7 to 12).
DIE = {0: (1, 2), 1: (3, 4), 2: (5, 6), 3: (1, 7), 4: (8, 9), 5: (10, 11), 6: (2, 12)}


def two_dice(name: str, reward: Callable[[bool, int], int], value: Fraction) -> Case:
    """Two dice made of coin flips; the choice is which of them to flip for. It never matters:
    the least and the greatest value are published, and equal.

    `reward` is given whether the dice are done after the flip, and their sum if they are.
    """
    pairs: list[Pair] = []
    for first in range(13):
        for second in range(13):
            here = 13 * first + second
            if first > 6 and second > 6:
                pairs += end(here)
            for which, die in enumerate((first, second)):
                if die > 6:
                    continue
                after = [(n, second) if which == 0 else (first, n) for n in DIE[die]]
                earned = sum((HALF * reward(min(a, b) > 6, a + b - 12) for a, b in after), F(0))
                pairs.append((here, which, earned, row(*((13 * a + b, HALF) for a, b in after))))
    available: dict[int, set[int]] = {}
    for state, action, _, _ in pairs:
        available.setdefault(state, set()).add(action)
    return Case(
        name=f"two-dice-{name}",
        source=STORM_MODELS + "two_dice.tra; " + STORM_TESTS + "MdpPrctlModelCheckerTest.cpp, Dice",
        pairs=tuple(pairs),
        discount=F(1),
        values={0: value},
        optimal={state: frozenset(every) for state, every in available.items()},
    )


def consensus(
    k: int, name: str, step: int, last: Callable[[int, int], int], value: Fraction
) -> Case:
    """The shared coin of Aspnes and Herlihy (1990) for two processes; a scheduler picks who moves.

    Each process flips a coin, writes it to a shared counter and checks whether the counter has
    come far enough to decide; if not, it flips again. `step` is the reward of every step, `last`
    what the two decisions earn at the end.
    """
    top = 4 * (k + 1)

    def moves(pc: int, coin: int, counter: int) -> list[tuple[int, int, int, Fraction]]:
        if pc == 0:
            return [(1, 0, counter, HALF), (1, 1, counter, HALF)]
        if pc == 1:
            return [(2, 0, counter + (1 if coin else -1), F(1))]
        if counter <= 2 or counter >= top - 2:
            return [(3, int(counter > 2), counter, F(1))]
        return [(0, coin, counter, F(1))]

    first = ((0, 0), (0, 0), 2 * (k + 1))
    number = {first: 0}
    queue, pairs = [first], list[Pair]()
    for state in queue:
        one, two, counter = state
        if one[0] == two[0] == 3:
            pairs += end(number[state])
            continue
        for which, (pc, coin) in enumerate((one, two)):
            if pc == 3:
                continue
            outcomes, reward = [], F(step)
            for new_pc, new_coin, new_counter, p in moves(pc, coin, counter):
                mine = (new_pc, new_coin)
                after = (mine, two, new_counter) if which == 0 else (one, mine, new_counter)
                if after not in number:
                    number[after] = len(number)
                    queue.append(after)
                if after[0][0] == after[1][0] == 3:
                    reward += p * last(after[0][1], after[1][1])
                outcomes.append((number[after], p))
            pairs.append((number[state], which, reward, row(*outcomes)))
    return Case(
        name=f"consensus-{k}-{name}",
        source="moves-rwth/stormpy resources/examples/testfiles/mdp/coin2-2.nm; "
        + QCOMP
        + "mdp/consensus/index.json",
        pairs=tuple(pairs),
        discount=F(1),
        values={0: value},
    )


def reset_chain(n: int, p: Fraction, steps: bool) -> Case:
    """A walk that falls back to the middle again and again: n states to the goal, n to the sink.

    Value iteration moves so little per sweep that it stops far too early. From a distance d of
    the goal the goal is reached with probability 2^-d + (1 - 2^-d) p; the end is expected after
    3 * 2^(n-1) - 2 steps from the middle.
    """
    reach = F(0) if steps else F(1)
    cost = F(1) if steps else F(0)
    pairs: list[Pair] = [*end(0), *end(2 * n)]
    for x in range(1, 2 * n):
        if x == n:
            outcomes = row((n - 1, p), (n + 1, 1 - p))
        else:
            outcomes = row((x - 1 if x < n else x + 1, HALF), (n, HALF))
        pairs.append((x, 0, cost + reach * outcomes.get(0, F(0)), outcomes))
    middle = F(3 * 2 ** (n - 1) - 2) if steps else p
    values = {}
    for x in range(2 * n + 1):
        near = F(1, 2 ** min(x, 2 * n - x))
        if steps:
            values[x] = middle if x == n else (2 + middle) * (1 - near)
        else:
            values[x] = middle if x == n else (1 - near) * middle + (near if x < n else 0)
    values[0] = values[2 * n] = F(0)
    return Case(
        name=f"reset-chain-{n}-{p}-{'steps' if steps else 'goal'}",
        source="Haddad and Monmege, Theoretical Computer Science 735 (2018) 111-131; "
        + QCOMP
        + "dtmc/haddad-monmege, haddad-monmege.pm and index.json",
        pairs=tuple(pairs),
        discount=F(1),
        values=values,
        start=n,
    )


CASES = (
    two_dice("flips", lambda done, total: 1, F(22, 3)),
    two_dice("sum-2", lambda done, total: int(done and total == 2), F(1, 36)),
    two_dice("sum-4", lambda done, total: int(done and total == 4), F(3, 36)),
    consensus(2, "most-steps", 1, lambda a, b: 0, F(75)),
    consensus(2, "fewest-steps", -1, lambda a, b: 0, F(-48)),
    consensus(2, "least-heads", 0, lambda a, b: -int(a == b == 1), F(-49, 128)),
    consensus(2, "most-disagreement", 0, lambda a, b: int(a != b), F(13, 120)),
    consensus(4, "most-steps", 1, lambda a, b: 0, F(243)),
    consensus(4, "most-disagreement", 0, lambda a, b: int(a != b), F(251, 4080)),
    reset_chain(20, HALF, False),
    reset_chain(20, F(7, 10), False),
    reset_chain(20, F(7, 10), True),
    reset_chain(100, F(7, 10), True),
)
