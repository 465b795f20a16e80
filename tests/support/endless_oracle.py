"""lim inf of the expected total reward, of chains by their limits, of models over all policies.

With g + h = r + P h and g = P g, n steps earn n g + h - P^n h. Where g = 0, the last term runs
through the phases P^k Π h, k = 0 … d-1, with d the common period of all classes and Π the limit of
P^(dn): lim inf is h less the greatest of them. All is solved by elimination in Fractions.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from math import inf, lcm

F = Fraction
Vector = list[Fraction]
Matrix = list[Vector]
Row = tuple[int, int, Fraction, dict[int, Fraction]]


def eliminated(matrix: Matrix, right: Matrix) -> Matrix:
    """Solve A X = B for a nonsingular A."""
    size = len(matrix)
    rows = [[*matrix[i], *right[i]] for i in range(size)]
    for i in range(size):
        pivot = next(k for k in range(i, size) if rows[k][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for k in range(size):
            if k != i and rows[k][i]:
                rows[k] = [x - rows[k][i] * y for x, y in zip(rows[k], rows[i], strict=True)]
    return [row[size:] for row in rows]


def times(left: Matrix, right: Matrix) -> Matrix:
    columns = list(zip(*right, strict=True))
    return [
        [sum((a * b for a, b in zip(row, c, strict=True)), F(0)) for c in columns] for row in left
    ]


def classes(chain: Matrix) -> list[list[int]]:
    """The recurrent classes, by transitive closure."""
    size = len(chain)
    reach = [{i, *(j for j in range(size) if chain[i][j])} for i in range(size)]
    for k, i in product(range(size), repeat=2):
        if k in reach[i]:
            reach[i] |= reach[k]
    for k, i in product(range(size), repeat=2):
        if k in reach[i]:
            reach[i] |= reach[k]
    return [
        sorted(c)
        for c in {frozenset(r) for i, r in enumerate(reach) if all(i in reach[j] for j in r)}
    ]


def limit(chain: Matrix) -> Matrix:
    """The Cesàro limit of a chain's powers."""
    size = len(chain)
    found = [[F(0)] * size for _ in range(size)]
    recurrent = {}
    for each in classes(chain):
        inner = [[F(i == j) - chain[i][j] for j in each] for i in each]
        turned = [list(column) for column in zip(*inner, strict=True)]
        turned[-1] = [F(1)] * len(each)
        share = eliminated(turned, [[F(i == len(each) - 1)] for i in range(len(each))])
        for i in each:
            recurrent[i] = {j: x[0] for j, x in zip(each, share, strict=True)}
            for j, x in recurrent[i].items():
                found[i][j] = x
    passing = [i for i in range(size) if i not in recurrent]
    if passing:
        inner = [[F(i == j) - chain[i][j] for j in passing] for i in passing]
        right = [
            [sum((chain[i][k] * found[k][j] for k in recurrent), F(0)) for j in range(size)]
            for i in passing
        ]
        for i, row in zip(passing, eliminated(inner, right), strict=True):
            found[i] = row
    return found


def phases(chain: Matrix, reward: Vector) -> Iterator[list[Fraction | float]]:
    """The limits of the expected total reward along each phase, one after the other."""
    size = len(chain)
    star = limit(chain)
    gain = [x[0] for x in times(star, [[r] for r in reward])]
    # h = (I - P + P*)⁻¹ (I - P*) r
    inner = [[F(i == j) - chain[i][j] + star[i][j] for j in range(size)] for i in range(size)]
    bias = eliminated(inner, [[r - g] for r, g in zip(reward, gain, strict=True)])
    period = 1
    for each in classes(chain):
        period = lcm(period, _period(chain, each))
    power = chain
    for _ in range(period - 1):
        power = times(power, chain)
    late = times(limit(power), bias)
    for _ in range(period):
        yield [
            inf if g > 0 else -inf if g < 0 else bias[i][0] - late[i][0] for i, g in enumerate(gain)
        ]
        late = times(chain, late)


def _period(chain: Matrix, states: Sequence[int]) -> int:
    here, seen = {states[0]}, []
    while here not in seen:
        seen.append(here)
        here = {j for i in here for j in range(len(chain)) if chain[i][j]}
    return len(seen) - seen.index(here)


def total(chain: Matrix, reward: Vector) -> list[Fraction | float]:
    """lim inf of the expected total reward from each state."""
    return [min(values) for values in zip(*phases(chain, reward), strict=True)]


def policies(pairs: Sequence[Row], size: int) -> Iterator[tuple[Matrix, Vector]]:
    """Every deterministic policy as a chain with rewards."""
    by_state = [[pair for pair in pairs if pair[0] == s] for s in range(size)]
    for chosen in product(*by_state):
        yield (
            [[p.get(j, F(0)) for j in range(size)] for *_, p in chosen],
            [r for *_, r, _ in chosen],
        )


def best(pairs: Sequence[Row], size: int) -> tuple[list[Fraction | float], bool]:
    """The greatest lim inf from each state, and whether some policy has no limit from some state.

    That is so where its phases differ, or classes of positive and of negative mean cancel.
    """
    values: list[Fraction | float] = [-inf] * size
    swings = False
    for chain, reward in policies(pairs, size):
        each = list(phases(chain, reward))
        own = [min(x) for x in zip(*each, strict=True)]
        values = [max(a, b) for a, b in zip(values, own, strict=True)]
        swings |= any(len(set(x)) > 1 for x in zip(*each, strict=True))
        swings |= _cancels(chain, reward)
    return values, swings


def _cancels(chain: Matrix, reward: Vector) -> bool:
    star = limit(chain)
    gain = [x[0] for x in times(star, [[r] for r in reward])]
    return any(
        not g and any(star[i][j] and gain[j] for j in range(len(gain))) for i, g in enumerate(gain)
    )


def reaching(pairs: Sequence[Row], size: int, missed: float, sign: int) -> list[Fraction | float]:
    """The greatest (1) or least (-1) totals until state 0; runs that miss it are worth `missed`."""
    values: list[Fraction | float] = [-sign * inf] * size
    for chain, reward in policies(pairs, size):
        sure = limit(chain)
        ends = [sure[i][0] == 1 for i in range(size)]
        inner = [i for i in range(size) if ends[i] and i]
        own: list[Fraction | float] = [missed] * size
        own[0] = F(0)
        if inner:
            matrix = [[F(i == j) - chain[i][j] for j in inner] for i in inner]
            solved = eliminated(matrix, [[reward[i]] for i in inner])
            for i, row in zip(inner, solved, strict=True):
                own[i] = row[0]
        values = [max(a, b) if sign > 0 else min(a, b) for a, b in zip(values, own, strict=True)]
    return values
