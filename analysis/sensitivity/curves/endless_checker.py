"""Checks total rewards at discount 1, functions of a parameter, where some policy never ends.

A certificate of the model at one point of an open interval says where values are infinite, by which
ranks and orders the policy and all others move, and which pairs are optimal
(`solvers.proof.endless`). It rests on which transitions there are, and on signs of numbers. So what
it proves holds in the whole interval if no chance becomes 0 in it and these signs stay:

    finite      D > 0 and D h_l = N_s - D r_l - Σ p N_s' > 0, or 0 of all optimal pairs;
                N = 0 where the policy stays; N ≥ 0 where optimal pairs need not come nearer an end
    -∞          N = D w with a potential w: D h_l ≥ 0 of the pairs with which one may stay for ever,
                and those where it is 0 close no way to go round
    +∞          a closed class with one pair for each state, and E, G > 0 with
                E r + Σ p H(s') - H(s) = G: its mean reward is G / E; all others may come to one

Nothing here imports a solver. At the ends of the interval nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.sensitivity.curves.signs import nonnegative, positive_inside
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.polynomial_rows import PolynomialRows
from exact_mdp.solvers.proof.certificate import Certificate
from exact_mdp.solvers.proof.endless import EndlessClaims

if TYPE_CHECKING:
    from flint import fmpq_poly

flint = later("flint")


@dataclass(frozen=True, kw_only=True, eq=False)
class Gain:
    """A closed class of states in which one pair each earns G / E a step, with a potential H / E.

    Attributes
    ----------
    pairs : {state: pair}
    potential : {state: H}
    scale, mean : fmpq_poly
        E and G.
    """

    pairs: Mapping[int, int]
    potential: Mapping[int, fmpq_poly]
    scale: fmpq_poly
    mean: fmpq_poly


@dataclass(frozen=True, kw_only=True, eq=False)
class EndlessProof:
    """What shows, with polynomials, that values are the optimal ones on an open interval.

    Attributes
    ----------
    point : Fraction
        A value of the parameter inside.
    certificate : Certificate
        Of the model there.
    gains : tuple of Gain
        What is earned for ever where the value is +∞.
    """

    point: Fraction
    certificate: Certificate
    gains: tuple[Gain, ...]


def endless_violations(
    mdp: MDP,
    rows: PolynomialRows,
    inside: tuple[Fraction, Fraction],
    values: tuple[Sequence[fmpq_poly], fmpq_poly],
    proof: EndlessProof,
    gap: Callable[[tuple[Sequence[fmpq_poly], fmpq_poly], int], fmpq_poly],
) -> Iterator[str]:
    """Yield what does not hold of values between two points y.

    `mdp` is the model at the point of the proof, and `gap` gives D h of a pair.
    """
    certificate = proof.certificate
    claims, (numerators, scale) = certificate.endless, values
    yield from certificate.violations(mdp)
    if claims is None:  # every policy ends
        nothing = np.zeros(mdp.n_states, dtype=np.int64)
        potential = [Fraction(0)] * mdp.n_states
        claims = EndlessClaims(sign=nothing, rank=nothing + 1, order=nothing, potential=potential)
    if claims.drift is not None or mdp.terminal.tolist() != rows.terminal:
        yield "the certificate is none of a model in which some policy never ends"
        return

    def stays(poly: fmpq_poly) -> bool:
        return positive_inside(poly, *inside)

    if not all(map(stays, {str(p): p for p in rows.moving}.values())):
        yield "a probability becomes 0"
    if not stays(scale):
        yield "the denominator is not positive"
    over = mdp.terminal if mdp.goal is None else mdp.goal
    missing = 0 if mdp.goal is None else mdp.unreached
    level = dict[int, int]()
    sign, order, optimal = claims.sign, claims.order, certificate.optimal_pairs
    for pair, state in enumerate(mdp.pair_state.tolist()):
        if over[state] or sign[state] > 0 or (sign[state] < 0 and missing):
            continue
        after = _after(mdp, pair)
        alike = sign[after] == sign[state]
        falls = bool((order[after[alike]] < order[state]).any())
        if sign[state] < 0:
            slope = gap(values, pair)
            if not falls and slope.degree() < 0:
                level[pair] = state
            elif not falls and not stays(slope):
                yield f"nothing shows that the value of state {state} is -∞"
        elif alike.all():
            here = gap(values, pair)
            if optimal[pair] != (here.degree() < 0) or not (optimal[pair] or stays(here)):
                yield f"a pair of state {state} is better, or as good"
            if optimal[pair] and not falls and not missing and certificate.endless is not None:
                least = nonnegative(numerators[state], *inside)
                if claims.potential[state] or not least:
                    yield f"nothing shows that the value of state {state} cannot be more"
    around = {*level.values()}
    while out := around - {
        s for pair, s in level.items() if around.issuperset(_after(mdp, pair).tolist())
    }:
        around -= out
    for state in around:
        yield f"nothing shows that the value of state {state} is -∞"
    for state in np.flatnonzero((sign == 0) & (claims.rank == 0) & ~over).tolist():
        if not missing and numerators[state].degree() >= 0:
            yield f"the policy stays in state {state}, which is worth more or less than 0"
    if missing < inf:
        yield from _unearned(mdp, rows, sign, proof.gains, stays)


def _unearned(
    mdp: MDP,
    rows: PolynomialRows,
    sign: np.ndarray,
    gains: Iterable[Gain],
    stays: Callable[[fmpq_poly], bool],
) -> Iterator[str]:
    """Yield where +∞ is not shown to be earned."""
    reached = np.zeros(len(sign), dtype=bool)
    for each in gains:
        sound = stays(each.scale) and stays(each.mean)
        for state, pair in each.pairs.items():
            drift = each.scale * rows.reward[pair] - each.potential[state] - each.mean
            ahead = (p * each.potential[to] for to, p in rows.following[pair] if to in each.pairs)
            sound &= mdp.pair_state[pair] == state
            sound &= {*_after(mdp, pair).tolist()} <= {*each.pairs}
            sound &= sum(ahead, drift).degree() < 0
        if sound:
            reached[[*each.pairs]] = True
        else:
            yield "a class does not earn what is said"
    safe = np.flatnonzero((sign > 0)[mdp.pair_state])
    ways = [(int(mdp.pair_state[pair]), _after(mdp, pair)) for pair in safe.tolist()]
    ways = [(state, after) for state, after in ways if (sign[after] >= 0).all()]
    while more := [s for s, after in ways if not reached[s] and reached[after].any()]:
        reached[more] = True
    for state in np.flatnonzero((sign > 0) & ~reached).tolist():
        yield f"nothing shows that the value of state {state} is +∞"


def _after(mdp: MDP, pair: int) -> np.ndarray:
    """Return the states that a pair may lead to."""
    found: np.ndarray = mdp.table.next[slice(*mdp.table.offsets[pair : pair + 2].tolist())]
    return found


def without_end(
    rows: PolynomialRows, pairs: Sequence[Sequence[int]], start: Sequence[int]
) -> list[int] | None:
    """Return the states that a policy reaches before it ends or comes to rest; None if neither.

    `pairs` are those that it takes in each of S states. It rests where it earns nothing for ever;
    with a goal, it has to come there.
    """
    goal = rows.mdp.goal
    leaks = [_leaks(rows, own) for own in pairs]
    after = [{to for pair in own for to, p in rows.following[pair] if p} for own in pairs]
    earns = [any(rows.reward[pair] for pair in own) for own in pairs]
    live = {s for s, ends in enumerate(rows.terminal) if not ends}
    rests = {s for s in live if not earns[s] and goal is None}
    while left := {s for s in rests if not after[s] <= rests}:
        rests -= left
    reached = live.intersection(start) - rests
    while more := {to for s in reached for to in after[s]} - reached - rests:
        reached |= more
    if goal is not None:
        beside = rows.mdp.terminal & ~goal
        taken = [pair for s in reached for pair in pairs[s]]
        if any(beside[s] for s in start) or any(beside[_after(rows.mdp, p)].any() for p in taken):
            return None
    near = {s for s in reached if leaks[s] or after[s] & rests}
    while more := {s for s in reached - near if after[s] & near}:
        near |= more
    return sorted(reached) if near == reached else None


def _leaks(rows: PolynomialRows, pairs: Sequence[int]) -> bool:
    """Whether some pair may lead to a terminal state."""
    one = flint.fmpq_poly([1])
    return any(one - sum(p for _, p in rows.following[pair]) for pair in pairs)
