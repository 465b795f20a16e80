"""The values of a policy, as exact functions of one parameter.

On a section on which rows are polynomials, the values of a policy are polynomials where the model
is acyclic, else N_s / D with D = det(I - γ P_π) > 0. By Cramer's rule N and D have at most the
degree Σ_s d_s, where d_s is the greatest degree in the rows of state s: so they come by
interpolation. Where the discount alone moves they come from powers of P_π,

    N(γ) = D(γ) Σ_k γ^k P^k r   up to degree n - 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING

import flint

from exact_mdp.analysis.vary.curves.equations import Equations, Mix, Values
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.parametric.row_change import polynomials

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly


LARGEST = 300  # states of a model with cycles
CYCLIC_DEGREE = 200

Entries = Sequence[tuple[int, "fmpq_poly"]]


def values_of(equations: Equations, mix: Mix) -> Values:
    """Return the values of a policy; raises ModelError where a model with cycles is too large."""
    value = [flint.fmpq_poly()] * equations.mdp.n_states
    if equations.order is not None:
        values = value, flint.fmpq_poly([1])
        for state in equations.order:
            ahead = (equations.ahead(pair, values) * share for pair, share in mix[state])
            value[state] = sum(ahead, flint.fmpq_poly())
        return values
    live, change = equations.live, equations.change
    degree, place, count = _degree(equations), {s: k for k, s in enumerate(live)}, len(live)
    side = [sum((equations.reward[l] * w for l, w in mix[s]), flint.fmpq_poly()) for s in live]
    entries = [
        (place[state] * count + place[to], share * p)
        for state in live
        for pair, share in mix[state]
        for to, p in equations.following[pair]
    ]
    still = not len(change.transition.key) and not len(change.reward.key)
    if still and equations.rate.degree() > 0:
        numerators, scale = _by_powers(equations.rate, entries, side)
    else:
        numerators, scale = _interpolated(equations, degree, entries, side)
    for state, numerator in zip(live, numerators, strict=True):
        value[state] = numerator
    return value, scale


def _degree(equations: Equations) -> int:
    """Return the degree that values have at most, of a model with cycles."""
    live, where = len(equations.live), f"parameter {equations.change.name}"
    degree = 0
    for pairs in equations.pairs.values():
        entries = (p for pair in pairs for _, p in equations.following[pair])
        rewards = (equations.reward[pair] for pair in pairs)
        degree += max(0, *(each.degree() for each in chain(entries, rewards)))
    if live > LARGEST:
        raise ModelError(
            f"{live} states with cycles among them",
            where=where,
            fix=f"with cycles, use at most {LARGEST} states that are not terminal",
        )
    if degree > CYCLIC_DEGREE:
        raise ModelError(
            f"{live} states on cycles give rational functions of degree {degree}",
            where=where,
            fix=f"thresholds are exact up to degree {CYCLIC_DEGREE}; use a smaller model",
        )
    return degree


def _interpolated(
    equations: Equations, degree: int, entries: Entries, side: Sequence[fmpq_poly]
) -> tuple[list[fmpq_poly], fmpq_poly]:
    """Return N, of live states, and D from their values at `degree` + 1 points inside."""
    low, size, count = equations.low, degree + 1, len(side)
    step = (equations.high - low) / (size + 1)
    samples: list[list[fmpq]] = []
    for k in range(1, size + 1):
        at, matrix = rational(low + step * k), [rational(0)] * count**2
        matrix[:: count + 1] = [rational(1)] * count
        for place, p in entries:
            matrix[place] -= p(at)
        system = flint.fmpq_mat(count, count, matrix)
        scale = system.det()
        values = system.solve(flint.fmpq_mat(count, 1, [each(at) for each in side])).entries()
        samples.append([*(scale * each for each in values), scale])
    number = flint.fmpq_poly([rational(-low / step), rational(1 / step)])  # of a point
    *tops, below = (each(number) for each in polynomials(range(1, size + 1), samples))
    return tops, below


def _by_powers(
    rate: fmpq_poly, entries: Entries, side: Sequence[fmpq_poly]
) -> tuple[list[fmpq_poly], fmpq_poly]:
    """Return N, of live states, and D from powers of the matrix."""
    count = len(side)
    numbers = [rational(0)] * count**2
    for place, p in entries:
        numbers[place] += (p / rate)[0]
    matrix, unit = flint.fmpq_mat(count, count, numbers).numer_denom()  # P = A / q
    vector, times = flint.fmpq_mat(count, 1, [each[0] for each in side]).numer_denom()
    columns = []
    for _ in range(count):
        columns.append(vector.entries())
        vector = matrix * vector
    below = flint.fmpz_poly(matrix.charpoly().coeffs()[::-1])  # det(I - z A), z = γ / q
    numerators = [
        flint.fmpq_poly((below * flint.fmpz_poly(list(powers))).coeffs()[:count])(rate / unit)
        for powers in zip(*columns, strict=True)
    ]
    return numerators, flint.fmpq_poly(below)(rate / unit) * times
