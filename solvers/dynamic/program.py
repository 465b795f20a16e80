"""What a linear program proves, and how large its factors would be.

Weak duality: where V + c w satisfies all constraints of the primal (see `solvers.bounds.bounds`),
and y are the visits of a policy, which solve the equations of the dual,

    Σ_l r(l) y(l)  ≤  optimal start value  ≤  Σ_s α(s) (V(s) + c w(s)),   α the start distribution.

Both sides are worked out apart, one from visits and rewards, the other from values and margins, and
each with its rounding errors.

An optimiser factors matrices with the pattern of the states' equations. Put in the order of Reverse
Cuthill and McKee, which keeps entries near the diagonal, a factor lies within that band: an upper
bound, which other orders may beat (George and Liu, Computer Solution of Large Sparse Positive
Definite Systems, 1981, chapter 4). That order takes seconds to find, and where few steps lead
everywhere it need not be looked for: N states within r steps of one are within 2 r of each other,
so that whatever the order, the first and the last of them are N - 1 places apart, and some edge
between them spans at least (N - 1) / (2 r) (the local density bound; Chinn, Chvátalová, Dewdney
and Gibbs, Journal of Graph Theory 6, 1982).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, spans
from exact_mdp.solvers.bounds.bounds import Bounds, levels
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain

MOST_OPERATIONS = 5e10  # for one factor; an optimiser makes about twenty, at 10^9 a second
MOST_ENTRIES = 4e8  # 3.2 GB
FREE_STATES = 2000  # so few are not worth an estimate
KRYLOV_STEPS = 200
SPREAD = 10
PATIENCE = 3
FARTHEST = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class Visits:
    """Discounted visits from the start under a policy, and what they lack of solving the dual.

    Attributes
    ----------
    value : (S,)
        y; 0 in terminal states, where nothing is earned.
    residual : (S,)
        |α - y + γ Pᵀ y| is at most this, for the exact α, γ and P of the policy.
    """

    value: Floats
    residual: Floats


def visits(mdp: MDP, pairs: Integers) -> Visits:
    """Return the visits under `pairs` (S,)."""
    chain, _ = policy_chain(mdp, pairs)
    flow, rate, alpha = sp.csr_array(chain.T), mdp.discount, mdp.start_distribution
    level = levels(mdp)
    if level is not None or rate == 1 or mdp.n_states <= FREE_STATES:
        order = None if level is None else -level
        value = LinearSystem(flow, rate, order=order).approximate(alpha)
    else:
        value = _sweeps(flow, rate, alpha)
    live = ~mdp.terminal
    residual = np.abs(alpha - value + rate * (flow @ value))
    terms = np.diff(flow.indptr) + 6
    residual += gamma(terms) * (alpha + rate * (flow @ np.abs(value))) + 4 * UNIT * np.abs(value)
    tiny = TINY * (terms + 1) * (1 + float(np.abs(value).max()))
    return Visits(value=value * live, residual=(residual * SLACK + tiny) * live)


def _sweeps(flow: sp.csr_array, rate: float, alpha: Floats) -> Floats:
    """Return y = α + γ Pᵀ y at γ < 1, up to rounding, without filling any matrix."""
    from scipy.sparse.linalg import bicgstab

    matrix = sp.eye_array(len(alpha), format="csr") - rate * flow
    first = alpha
    for _ in range(SPREAD):  # a start in one state leaves Krylov's method no direction to go
        first = alpha + rate * (flow @ first)
    value, _ = bicgstab(matrix, alpha, x0=first, rtol=1e-13, maxiter=KRYLOV_STEPS)
    better = np.abs(alpha - matrix @ value).sum() < np.abs(alpha - matrix @ first).sum()
    value = value if better else first
    # What is left falls by γ in each sweep, if by nothing else: |Pᵀ x| ≤ |x|, added up.
    least, quiet, enough = np.inf, 0, 1e-13 * float(alpha.sum())
    while least > enough and quiet < PATIENCE:
        after = alpha + rate * (flow @ value)
        left, value = float(np.abs(after - value).sum()), after
        least, quiet = (left, 0) if left < 0.999 * least else (least, quiet + 1)
    return np.asarray(value)


def sides(mdp: MDP, found: Bounds, met: Visits) -> tuple[float, float]:
    """Return lower and upper bound on the optimal start value, from visits and from values.

    With f = α - y + γ Pᵀ y, the start value of the policy is r y + f V^π.
    """
    reward, live = mdp.reward[found.pairs], ~mdp.terminal
    size = np.abs(reward) * live
    worth = float((reward * live) @ met.value)
    doubt = float(met.residual @ (np.abs(found.value) + found.state_error))
    terms = gamma(mdp.n_states + np.diff(mdp.table.offsets)[found.pairs] + 8)
    doubt += float((terms * size) @ np.abs(met.value))
    doubt += _reward_doubt(mdp, found.pairs, met)
    alpha = mdp.start_distribution
    top = float(alpha @ found.value)
    above = float(alpha @ (max(found.high, 0.0) * found.weight))
    above += float(gamma(mdp.n_states + 4)) * float(alpha @ np.abs(found.value))
    return worth - doubt * SLACK - UNIT * abs(worth), top + above * SLACK + UNIT * abs(top)


def _reward_doubt(mdp: MDP, pairs: Integers, met: Visits) -> float:
    """Return what gains that cancel in an expected reward may add to its error."""
    if not (mdp.table.joint and np.float64 in (mdp.table.weight.dtype, mdp.table.gain.dtype)):
        return 0.0
    size = np.add.reduceat(
        mdp.table.probabilities() * np.abs(mdp.table.gains()), mdp.table.offsets[:-1]
    )[pairs]
    terms = gamma(np.diff(mdp.table.offsets)[pairs] + 4)
    return float((terms * size) @ np.abs(met.value))


def check_size(mdp: MDP, by: str) -> None:
    """Raise ModelError where factors could be too large for an optimiser."""
    if mdp.n_states <= FREE_STATES:
        return
    for width in (_density, _band):
        band = width(mdp)
        entries, operations = mdp.n_states * band, mdp.n_states * band**2
        if entries > MOST_ENTRIES or operations > MOST_OPERATIONS:
            break
    else:
        return
    raise ModelError(
        f"the linear program has {mdp.n_states:,} variables, {mdp.n_pairs:,} constraints and "
        f"{mdp.n_transitions:,} entries; factors could take {entries * 8 / 1e9:,.1f} GB and "
        f"{operations:.1g} operations each{', or more' if width is _density else ''}",
        where=f"LinearProgram(solver={by!r})",
        fix="start from a known policy, which needs no optimiser: LinearProgram(start=solve(mdp))",
    )


def _density(mdp: MDP) -> float:
    """Return the greatest (N - 1) / (2 r) of the states within r steps of a start state.

    Every order has a band of that width somewhere; that it is so wide nearly everywhere, as the
    refusal supposes, holds where steps lead equally far from all states.
    """
    matrix = mdp.transition
    cuts = matrix.indptr[mdp.pair_offsets]
    seen = np.zeros(mdp.n_states, dtype=bool)
    frontier: Integers = np.array([mdp.start[0][0]])
    seen[frontier] = True
    count, widest = 1, 0.0
    for radius in range(1, FARTHEST + 1):
        found = matrix.indices[spans(cuts[frontier], cuts[frontier + 1])]
        frontier = np.unique(found[~seen[found]])
        if not len(frontier):
            break
        seen[frontier] = True
        count += len(frontier)
        widest = max(widest, (count - 1) / (2 * radius))
    return widest


def _band(mdp: MDP) -> float:
    """Return the mean width of the band that the states' equations lie in."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    matrix, states = mdp.transition, mdp.n_states
    shape = (states, states)
    rows = np.repeat(mdp.pair_state, np.diff(matrix.indptr))
    graph = sp.csr_array((np.ones(matrix.nnz, dtype=np.int8), (rows, matrix.indices)), shape)
    graph = (graph + graph.T).tocsr()
    if graph.nnz > states * np.sqrt(states):
        return states / 2  # so dense that no order helps much
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    place = np.empty(states, dtype=np.int64)
    place[order] = np.arange(states)
    filled = np.flatnonzero(np.diff(graph.indptr))
    nearest = np.minimum.reduceat(place[graph.indices], graph.indptr[filled])
    reach = np.maximum(place[filled] - nearest, 0).astype(np.float64)
    # Successors of one state meet in the factored matrix, twice as far apart.
    return float(min(2 * np.sqrt((reach**2).mean()), states / 2) + 1)
