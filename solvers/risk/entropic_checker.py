"""Checks the best policy for the entropic risk of the return, by fractions alone.

Nothing here imports a solver, nor intervals of another library. With t = exp(-λ u), the numbers
G_s = E t^k of the claimed policy are sums of powers of t with rational coefficients, worked out
from the end on. Where G_s is the least (λ > 0) or greatest (λ < 0) over the pairs of every state,
no policy has less (more), whatever it remembers (Howard and Matheson, Management Science 18, 1972).

A difference of two such sums that is not 0 has a sign: t is transcendental for rational λ ≠ 0. The
sign is that of the sum over fractions around the powers of t, once these are narrow enough. With
y = x / 2^m ≤ 1/2, Taylor's sum of exp(y) up to y^n / n! is too low by at most 2 y^(n+1) / (n+1)!,
and exp(x) is its 2^m-th power; each step is rounded outwards.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from fractions import Fraction
from functools import lru_cache
from math import gcd, lcm

from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.risk.lattice import Lattice

Powers = tuple[Mapping[int, int], int]
"""Σ c_k t^k as {k: numerator of c_k}, over one positive denominator."""
Bracket = tuple[Fraction, Fraction]

BITS, MOST_BITS = 64, 2**14


def entropic_violations(
    lattice: Lattice,
    aversion: Fraction,
    policy: Integers,
    optimal: Integers,
    value: Bracket,
    returns: Mapping[Fraction, Fraction],
) -> list[str]:
    """Return what does not hold of a policy: nothing where it is the best.

    `value` encloses its certainty equivalent, and `returns` has the probabilities of its returns,
    of rewards.
    """
    mdp, wrong = lattice.mdp, list[str]()
    rate = aversion * lattice.unit
    worth: list[Powers] = [({0: 1}, 1)] * mdp.n_states
    for state in lattice.order:
        every = {pair: _ahead(lattice, pair, worth) for pair in lattice.pairs[state]}
        taken = [pair for pair in every if mdp.pair_action[pair] == policy[state]]
        if len(taken) != 1:
            return [f"the policy takes no action of state {state}"]
        worth[state] = every[taken[0]]
        signs = {pair: sign(_less(own, worth[state]), rate) for pair, own in every.items()}
        if any(each is None for each in signs.values()):
            wrong.append(f"no interval tells the pairs of state {state} apart")
        elif any((each or 0) * aversion < 0 for each in signs.values()):
            wrong.append(f"another pair of state {state} is better")
        if [pair for pair in every if signs[pair] == 0] != [p for p in every if optimal[p]]:
            wrong.append(f"the pairs of state {state} are not those that are best")
    total: defaultdict[int, Fraction] = defaultdict(Fraction)
    for state, weight in mdp.start:
        for k, c in worth[state][0].items():
            total[k] += weight * Fraction(c, worth[state][1])
    mean = {k: c for k, c in total.items() if c}
    if {lattice.unit * k: c for k, c in mean.items()} != dict(returns):
        wrong.append("the returns have other probabilities")
    if not _encloses(value, mean, rate, aversion):
        wrong.append("the certainty equivalent is outside its bound")
    return wrong


def _ahead(lattice: Lattice, pair: int, worth: list[Powers]) -> Powers:
    weights, scale, ends = lattice.rows[pair]
    unit = lcm(*(worth[to][1] for to, _ in ends))
    total: defaultdict[int, int] = defaultdict(int)
    for weight, (to, k) in zip(weights, ends, strict=True):
        own, below = worth[to]
        for power, c in own.items():
            total[power + k] += weight * (unit // below) * c
    shared = gcd(scale * unit, *total.values())
    return {k: c // shared for k, c in total.items()}, scale * unit // shared


def _less(one: Powers, other: Powers) -> dict[int, int]:
    """Return a difference, times a positive integer."""
    (mine, below), (yours, under) = one, other
    gap = {k: mine.get(k, 0) * under - yours.get(k, 0) * below for k in {*mine, *yours}}
    return {k: c for k, c in gap.items() if c}


def sign(powers: Mapping[int, int], rate: Fraction) -> int | None:
    """Return the sign of Σ c_k exp(-rate k); None where narrow fractions do not tell.

    Examples
    --------
    >>> sign({0: 1, 1: -2}, Fraction(1)), sign({}, Fraction(1))
    (1, 0)
    """
    if not powers:
        return 0
    for low, high in brackets(powers, rate):
        if low > 0 or high < 0:
            return 1 if low > 0 else -1
    return None


def brackets(powers: Mapping[int, int | Fraction], rate: Fraction) -> Iterator[Bracket]:
    """Yield ever narrower fractions around Σ c_k t^k, times the least power of t."""
    least, bits = min(powers), BITS
    while bits <= MOST_BITS:
        low = high = Fraction(0)
        for k, c in powers.items():
            here = exponential(rate * (least - k), bits)
            low, high = low + c * here[c < 0], high + c * here[c > 0]
        yield low, high
        bits *= 2


def _encloses(
    value: Bracket, mean: Mapping[int, Fraction], rate: Fraction, aversion: Fraction
) -> bool:
    """Whether -log(Σ c_k t^k) / λ is inside: exp(-λ low) ≥ (λ < 0: ≤) the sum, and so on."""
    least = min(mean)
    ends = sorted(-aversion * end + rate * least for end in value)
    bits = BITS
    for low, high in brackets(mean, rate):
        first, last = exponential(ends[0], bits), exponential(ends[1], bits)
        if first[1] <= low and high <= last[0]:
            return True
        if high < first[0] or last[1] < low:
            return False
        bits *= 2
    return False


@lru_cache(maxsize=10_000)
def exponential(x: Fraction, bits: int) -> Bracket:
    """Return fractions around exp(x), with about so many correct bits."""
    if x < 0:
        turned = exponential(-x, bits)
        return _outward(1 / turned[1], 1 / turned[0], bits)
    if not x:
        return Fraction(1), Fraction(1)
    halvings = (2 * x.numerator // x.denominator).bit_length() + 1
    one = 1 << (bits + 16)
    y = x * one / 2**halvings
    down, up = y.numerator // y.denominator, -(-y.numerator // y.denominator)
    less = more = low = high = one  # the last terms, and their sums, times `one`
    count = 0
    while more > 1:
        count += 1
        less, more = less * down // (count * one), -(-more * up // (count * one))
        low, high = low + less, high + more
    found = _outward(Fraction(low, one), Fraction(high + 2 * more, one), bits)
    for _ in range(halvings):
        found = _outward(found[0] ** 2, found[1] ** 2, bits)
    return found


def _outward(low: Fraction, high: Fraction, bits: int) -> Bracket:
    """Return positive numbers rounded to so many bits, downwards and upwards."""
    return _rounded(low, bits), -_rounded(-high, bits)


def _rounded(x: Fraction, bits: int) -> Fraction:
    size = abs(x.numerator).bit_length() - x.denominator.bit_length()
    unit = Fraction(2) ** (size - bits)
    return x // unit * unit
