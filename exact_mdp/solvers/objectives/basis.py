"""The optimum under limits as one basis, which floats propose and integers prove.

The visits x of policies and the limits are a linear program,

    maximise  r x   subject to   Σ_l x(l) (1[s(l) = s] - γ P(l, s)) = μ(s),   c_k x ≥ b_k,   x ≥ 0,

of which a basis has one pair of each state, and one more for each limit that binds. A simplex
method in floats (HiGHS) finds one. With B its rows, a pair each, over the values V and the prices p
of the limits that bind,

    B (V, p) = r,    x B = (μ, b)

give the exact values and prices, and the exact visits. These two systems have one determinant, so
that the second one takes half the time of the first (`solvers.exact.linear`). Where x ≥ 0, p ≥ 0,
all other limits are kept and no pair gains on V, both are optimal: it is the rule of linear
programming (Applegate, Cook, Dash and Espinoza, Operations Research Letters 35, 2007). Where
floats went wrong there is no answer.

Where no policy keeps the limits, the least step t by which they are moved takes the place of the
return, as one more column; its row says that the prices sum to 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Integers, common
from exact_mdp.solvers.exact.levels import fraction
from exact_mdp.solvers.exact.linear import exact_solve
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import Limit, Values, Visits, room, totals_of, wrong_bound
from exact_mdp.solvers.objectives.optima import NOISE, equations, proposed

if TYPE_CHECKING:
    from flint import fmpz


PIVOTS = 10  # for each state: the simplex method may go round in circles
SOLVED = 0  # what SciPy says of a program


@dataclass(frozen=True, kw_only=True)
class Optimal:
    """An optimum, or a proof that there is none; see `constrained.ConstrainedSolution`."""

    shift: Fraction
    price: tuple[Fraction, ...]
    dual: Values
    flow: Mapping[int, Fraction]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Basis:
    """One pair of each state (S,), further pairs, and the limits that bind, by number."""

    pairs: Integers
    extra: list[int]
    binding: list[int]


def by_basis(of: Objectives, limits: Sequence[Limit]) -> Optimal | None:
    """Return the optimum under limits; None where floats do not find its basis."""
    if of.rows.terminal.all():
        return None
    for feasible in (True, False):
        try:
            found = _proposed(of, limits, feasible)
        except OverflowError:
            return None
        if found is not None:
            return _proven(of, limits, found, feasible)
    return None


def _signs(of: Objectives, limits: Sequence[Limit]) -> list[int]:
    return [of.sign * limit.sign for limit in limits]


def combined(
    of: Objectives, limits: Sequence[Limit], reward: Fraction, price: Sequence[Fraction]
) -> list[Fraction]:
    """Return the weights of the objectives where limits have prices."""
    weights = dict.fromkeys(of.names, Fraction(0))
    weights[of.names[0]] = reward
    for limit, own in zip(limits, price, strict=True):
        weights[limit.name] += of.sign * limit.sign * own
    return list(weights.values())


def _proposed(of: Objectives, limits: Sequence[Limit], feasible: bool) -> _Basis | None:
    """Return the basis that floats find; None where they find none."""
    from scipy import optimize

    state, size = of.mdp.pair_state, of.mdp.n_states
    moves, amounts = of.in_floats
    live = ~of.rows.terminal[state]
    stays = sp.csr_array((live * 1.0, (state, np.arange(len(state)))), (size, len(state)))
    start = np.zeros(size)
    for own, chance in of.mdp.start:
        start[own] = float(chance) * (not of.rows.terminal[own])
    rows = np.flatnonzero(~of.rows.terminal)
    limited = np.array(
        [
            s * amounts[of.names.index(x.name)]
            for s, x in zip(_signs(of, limits), limits, strict=True)
        ]
    )
    bound = np.array([float(limit.sign * limit.bound) for limit in limits])
    step = np.full((len(limits), 1), 0.0 if feasible else 1.0)
    found = optimize.linprog(
        np.append(-amounts[0] * feasible, 0.0 if feasible else 1.0),
        A_eq=sp.hstack([(stays - moves.T).tocsr()[rows], sp.csr_array((len(rows), 1))]),
        b_eq=start[rows],
        A_ub=sp.csr_array(-np.hstack([limited, step])),
        b_ub=-bound,
        bounds=(0, None),
        method="highs-ds",
        options={"maxiter": PIVOTS * size},
    )
    if found.status != SOLVED:
        return None
    visits, price = found.x[:-1] * live, np.abs(found.ineqlin.marginals)
    weights = combined(of, limits, Fraction(feasible), [Fraction(p) for p in price.tolist()])
    pairs = proposed(of, weights, of.mdp.pair_offsets[:-1].copy())
    taken = np.flatnonzero(visits > NOISE * visits.sum())
    taken = taken[np.lexsort((visits[taken], state[taken]))]  # the most visited of a state last
    last = np.diff(state[taken], append=-1) != 0
    pairs[state[taken[last]]] = taken[last]
    extra = taken[~last].tolist()
    count = len(extra) + (not feasible)
    binding = np.lexsort((limited @ visits - bound, -price))[:count]
    return _Basis(pairs=pairs, extra=extra, binding=sorted(binding.tolist()))


def _proven(
    of: Objectives, limits: Sequence[Limit], basis: _Basis, feasible: bool
) -> Optimal | None:
    """Return the exact solution of a basis; None where it is not optimal."""
    if len(basis.binding) != len(basis.extra) + (not feasible):
        return None
    live, signs = np.flatnonzero(~of.rows.terminal), _signs(of, limits)
    chosen = np.concatenate([basis.pairs[live], np.array(basis.extra, dtype=np.int64)])
    limited = [
        signs[k] * of.amounts[of.names.index(limits[k].name)].astype(object)[chosen]
        for k in basis.binding
    ]
    system = equations(of, live, chosen, limited, steps=not feasible)
    earned = (of.amounts[0].astype(object)[chosen] * feasible).tolist()
    try:
        values = exact_solve(system, [*earned, *[1] * (not feasible)])
    except (ZeroDivisionError, ModelError):  # singular, or nearly so
        return None
    first = dict.fromkeys(live.tolist(), Fraction(0))
    first.update((s, weight) for s, weight in of.mdp.start if s in first)
    given = [-limits[k].sign * limits[k].bound for k in basis.binding]
    whole, parts = common([*first.values(), *given])
    visits = exact_solve(system.transposed, whole)
    return _checked(of, limits, basis, chosen, values, (visits[0], visits[1] * parts), feasible)


def _checked(
    of: Objectives,
    limits: Sequence[Limit],
    basis: _Basis,
    chosen: Integers,
    values: tuple[list[fmpz], fmpz],
    visits: tuple[list[fmpz], fmpz],
    feasible: bool,
) -> Optimal | None:
    """Return what the solutions of both systems say; None where they are not optimal."""
    live, (x, under), (y, below) = np.flatnonzero(~of.rows.terminal), visits, values
    states, pairs = len(live), len(chosen)
    shift = Fraction(0) if feasible else fraction(int(-x[-1]), int(under))
    if min(x[:pairs]) < 0 or min(y[states:], default=0) < 0 or (shift > 0) == feasible:
        return None
    price = [Fraction(0)] * len(limits)
    for k, number in zip(basis.binding, y[states:], strict=True):
        price[k] = fraction(int(number), int(below))
    scale = of.rows.scale[of.mdp.pair_state[chosen]].tolist()
    each = zip(chosen.tolist(), x, scale, strict=False)
    flow = Visits({pair: int(n * unit) for pair, n, unit in each if n}, int(under))
    top = [0] * of.mdp.n_states
    for own, value in zip(live.tolist(), y, strict=False):
        top[own] = int(value)
    dual = Values(top, int(below))
    totals = totals_of(of, flow)
    weights = combined(of, limits, Fraction(feasible), price)
    if any(room(of, limit, totals) + shift < 0 for limit in limits):
        return None
    if wrong_bound(of, weights, dual, of.at_start(*dual)):
        return None
    return Optimal(shift=shift, price=tuple(price), dual=dual, flow=flow)
