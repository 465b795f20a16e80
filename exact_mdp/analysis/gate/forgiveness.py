"""How far the rounding of given floats can move a value: all that a verdict on zero forgives.

A float stands for whatever it was rounded from, half a unit in its last place to either side. What
is rounded in the row of pair l moves the difference of two values, to first order, by at most

    f(l) = |u*(l) - u(l)| (Σ_i p_i ρ_i + M(r)) + γ M(x)
    M(x) = (Σ_i ω_i) (max x_i - min x_i) + |Σ_i p_i - 1| max |x_i|
    x_i  = u*(l) V*(s_i) - u(l) V^π(s_i)

with ρ_i and ω_i the rounding of its rewards and probabilities, and u, u* the uses of the pair from
the start by the policy and by an optimal one: what both do alike moves both alike. The
probabilities that were rounded summed to 1, so that what a sum misses is rounding for certain. M(r)
counts where rewards are those of outcomes. A policy whose regret is at most Σ_l f(l) cannot be told
from the optimum by those who know no more than the floats. Nothing outside what is reached from the
start has any say in it, and it is 0 where all numbers are exact. It is computed from below and
above, and as a rational where these two do not decide.

A pair ties with the best action where its gap is at most what rounding can move: by using the pair
and then acting optimally, and by acting optimally,

    gap(s, a) ≤ e(s, a) + γ Σ_s' P(s, a, s') F*(s') + F*(s)
    e(l) = Σ_i p_i ρ_i + M(r) + γ M(V*(s_i))
    F*(s) = e_*(s) + γ Σ_s' P_*(s, s') F*(s')
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise
from math import fsum, inf, isfinite

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.exact_policy import (
    ExactPolicy,
    exact_gaps,
    exact_policy,
    visited_exactly,
)
from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.table import Floats, Integers, Numbers, divide, spans
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.proof.certificate import Certificate
from exact_mdp.solvers.solution import SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Range:
    """Numbers (K,) known from below and above."""

    low: Floats
    high: Floats


def of_floats(mdp: MDP) -> bool:
    """Return whether any number of the model was given as a float that rounding may have moved."""
    return bool(_roundings(mdp)[1].any() or mdp.table.gain_rounding().any())


@once
def _roundings(mdp: MDP) -> tuple[Floats, Floats, Floats]:
    """Return what is rounded in each pair (L,): its expected reward, its row and the row's sum."""
    table, first = mdp.table, mdp.table.offsets[:-1]
    rounded, missing = table.gain_rounding(), np.zeros(table.pairs)
    moved = np.add.reduceat(table.weight_rounding(), first)
    if not table.sums_to_one and table.weight.dtype == np.float64:
        chances, ends = table.weight.tolist(), pairwise(table.offsets.tolist())
        missing[:] = [abs(fsum([-1.0, *chances[begin:end]])) for begin, end in ends]
    elif not table.sums_to_one:
        missing[:] = np.abs(divide(table.row_sums() - table.denominator, table.denominator))
    if len(rounded) != table.pairs:
        gain, each = table.gains(), table.probabilities() * rounded
        span = np.maximum.reduceat(gain, first) - np.minimum.reduceat(gain, first)
        size = np.maximum.reduceat(np.abs(gain), first)
        rounded = np.add.reduceat(each, first) + moved * span + missing * size
    return rounded, moved, missing


def per_use(mdp: MDP, known: FixedPoint, pairs: Integers | None = None) -> Range:
    """Return e(l) of some pairs (K,), or of all, for values (S,) known up to an error."""
    table = mdp.table
    (rounded, moved, missing), first = _roundings(mdp), table.offsets[:-1]
    following = table.next
    if pairs is not None:
        rounded, moved, missing = rounded[pairs], moved[pairs], missing[pairs]
        first, following = _outcomes(mdp, pairs)
    # What is not known (NaN) lies where the policy never comes.
    there = np.nan_to_num(known.value, nan=0.0)[following]
    off = np.nan_to_num(known.error, nan=0.0, posinf=0.0)[following]
    with np.errstate(over="ignore", invalid="ignore"):
        span = np.maximum.reduceat(there, first) - np.minimum.reduceat(there, first)
        size, doubt = np.maximum.reduceat(np.abs(there), first), np.maximum.reduceat(off, first)
        few = moved * np.maximum(span - 2 * doubt, 0.0) + missing * np.maximum(size - doubt, 0.0)
        many = moved * (span + 2 * doubt) + missing * (size + doubt)
        least, most = rounded + mdp.discount * few, rounded + mdp.discount * many
    return Range(low=least / SLACK, high=most * SLACK + TINY * (most > 0))


def _outcomes(mdp: MDP, pairs: Integers) -> tuple[Integers, Integers]:
    """Return where the outcomes of each of some pairs (K,) begin, and their next states."""
    begins, ends = mdp.table.offsets[pairs], mdp.table.offsets[pairs + 1]
    first = np.concatenate([[0], np.cumsum(ends - begins)[:-1]])
    return first, mdp.table.next[spans(begins, ends)]


def exactly_per_use(mdp: MDP, value: Sequence[Fraction], pair: int) -> Fraction:
    """Return e(l) of one pair as a rational, for exact values of all states."""
    rewards, moves = _exact_roundings(mdp, pair)
    return rewards + mdp.discount_exact * moves(
        [value[following] for _, following, _ in mdp.table.row(pair)]
    )


def _exact_roundings(
    mdp: MDP, pair: int
) -> tuple[Fraction, Callable[[Sequence[Fraction]], Fraction]]:
    """Return what is rounded in a pair's expected reward, and how far its row moves values x_i."""
    table = mdp.table
    begin, end = int(table.offsets[pair]), int(table.offsets[pair + 1])
    rounding, moved = table.gain_rounding(), table.weight_rounding()[begin:end]
    row, zero = table.row(pair), Fraction(0)
    rounded = sum(map(Fraction, moved.tolist()), zero)
    missing = abs(sum((p for p, _, _ in row), zero) - 1) if rounded else zero

    def moves(x: Sequence[Fraction]) -> Fraction:
        return rounded * (max(x) - min(x)) + missing * max(abs(number) for number in x)

    if len(rounding) == table.pairs:
        return Fraction(float(rounding[pair])), moves
    each = zip(row, map(Fraction, rounding[begin:end].tolist()), strict=True)
    return sum((p * off for (p, _, _), off in each), zero) + moves([r for _, _, r in row]), moves


def in_all(chain: PolicyChain, known: FixedPoint) -> Range:
    """Return F (S,) of a pure policy, for known values; up to infinity where floats fail."""
    mdp, each = chain.mdp, per_use(chain.mdp, known, chain.pairs)
    counted = ~mdp.terminal
    if mdp.discount_exact == 1:
        counted &= chain.ends
    low, high = np.where(counted, each.low, 0.0), np.where(counted, each.high, 0.0)
    if not high.any():
        return Range(low=high, high=high)
    try:
        found = chain.discounted.solve((low + high) / 2, (high - low) / 2 * SLACK)
    except SolverError:
        return Range(low=np.zeros_like(low), high=np.full_like(high, inf))
    return Range(
        low=np.maximum(found.value - found.error, 0.0) / SLACK,
        high=(np.maximum(found.value, 0.0) + found.error) * SLACK,
    )


@dataclass(eq=False)
class Forgiveness:
    """What the rounding of the given floats can move at the start: proven bounds.

    `least` and `most` are known from the first; `narrow` finds closer ones, by equations, when they
    are first needed, and `make` works it out exactly, where that is possible.
    """

    least: Fraction = Fraction(0)
    most: Fraction | float = Fraction(0)
    narrow: Callable[[], tuple[Fraction, Fraction | float]] | None = None
    make: Callable[[], Fraction] | None = None

    @property
    def low(self) -> Fraction:
        """A lower bound, as close as floats allow."""
        return self._closely()[0]

    @property
    def high(self) -> Fraction | float:
        """An upper bound, as close as floats allow."""
        return self._closely()[1]

    def covers(self, low: Fraction | float, high: Fraction | float) -> bool | None:
        """Return whether a regret from `low` to `high` is at most this; None where that is open.

        An exact regret, of which both are the same, leaves nothing open.
        """
        if high <= self.least:
            return True
        if low > self.most:
            return False
        least, most = self._closely()
        if least < low <= most and low == high and self.make is not None:
            least = most = self.least = self.most = self.make()
            self.make = None
        if high <= least:
            return True
        return False if low > most or low == high else None

    def _closely(self) -> tuple[Fraction, Fraction | float]:
        if self.narrow is not None:
            self.least, self.most = self.narrow()
            self.narrow = None
        return self.least, self.most


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """A policy with its values (S,) and how far these may be off (S,)."""

    chain: PolicyChain
    found: FixedPoint

    def uses(self) -> tuple[Floats, Floats]:
        """Return the uses (L,) of every pair from the start, and their errors; SolverError."""
        chain, mdp = self.chain, self.chain.mdp
        found = visits(mdp, chain.discounted)
        live = (chain.reached & ~mdp.terminal)[mdp.pair_state]
        many = np.where(live, found.value[mdp.pair_state], 0.0)
        off = np.where(live, found.error[mdp.pair_state], 0.0)
        return many * chain.weights, (off + 4 * UNIT * many) * chain.weights

    def worth(self) -> tuple[Floats, Floats]:
        """Return the values (S,) and errors; 0 where they are not known, which is not reached."""
        value, error = self.found.value, self.found.error
        off = np.where(np.isnan(value), 0.0, np.nan_to_num(error, posinf=0.0))
        return np.nan_to_num(value, nan=0.0), off


def moved_at_start(mdp: MDP, own: Side, best: Side) -> tuple[Fraction, Fraction | float]:
    """Return bounds of what rounding can move in the difference of two values at the start."""
    try:
        u, du = own.uses()
        v, dv = (u, du) if own.chain is best.chain else best.uses()
    except SolverError:
        return Fraction(0), inf
    (a, da), (b, db) = own.worth(), best.worth()
    if own.chain is best.chain:  # x is nearly 0, and rewards that are used alike move alike
        span_at_most = 2 * float((np.abs(b - a) * (1 + UNIT) + da + db).max())
        _, moved, missing = _roundings(mdp)
        high = float(((moved + missing) * (u + du)).sum()) * mdp.discount * span_at_most * SLACK
        return Fraction(0), Fraction(high + TINY) if isfinite(high) else inf
    # Pairs that neither policy uses move nothing.
    used = np.flatnonzero((own.chain.weights > 0) | (best.chain.weights > 0))
    first, there = _outcomes(mdp, used)
    pair = np.repeat(np.arange(len(used)), np.diff(first, append=len(there)))
    rounded, moved, missing = (part[used] for part in _roundings(mdp))
    u, du, v, dv = (part[used] for part in (u, du, v, dv))
    with np.errstate(over="ignore", invalid="ignore"):
        mine, ideal = u[pair] * a[there], v[pair] * b[there]
        off = du[pair] * np.abs(a[there]) + (u + du)[pair] * da[there]
        off += dv[pair] * np.abs(b[there]) + (v + dv)[pair] * db[there]
        off = (off + 3 * UNIT * (np.abs(mine) + np.abs(ideal))) * SLACK + TINY
        x = ideal - mine
        span = np.maximum.reduceat(x, first) - np.minimum.reduceat(x, first)
        size, doubt = np.maximum.reduceat(np.abs(x), first), np.maximum.reduceat(off, first)
        few = moved * np.maximum(span - 2 * doubt, 0.0) + missing * np.maximum(size - doubt, 0.0)
        many = moved * (span + 2 * doubt) + missing * (size + doubt)
        apart, unsure = np.abs(v - u), (du + dv) * SLACK + 2 * UNIT * np.abs(v - u)
        least = rounded * np.maximum(apart - unsure, 0.0)
        least += mdp.discount * few
        most = rounded * (apart + unsure) + mdp.discount * many
        low, high = float(least.sum()) / SLACK, float(most.sum()) * SLACK
    if not isfinite(high):
        return Fraction(0), inf
    return Fraction(low), Fraction(high)


def _exactly_at_start(
    mdp: MDP, own: tuple[PolicyChain, Numbers], best: tuple[PolicyChain, Numbers]
) -> Fraction:
    """Return the same as a rational, for exact values (S,)."""
    uses: list[dict[int, Fraction]] = []
    for chain, _ in (own, best):
        many = visited_exactly(chain)
        states = np.flatnonzero(chain.reached & ~mdp.terminal).tolist()
        uses.append({p: many[s] * w for s in states for p, w in chain.exact_weights(s).items()})
    mine, ideal = uses
    (_, a), (_, b) = own, best
    total = Fraction(0)
    for pair in mine.keys() | ideal.keys():
        u, v = mine.get(pair, Fraction(0)), ideal.get(pair, Fraction(0))
        rewards, moves = _exact_roundings(mdp, pair)
        x = [v * b[t] - u * a[t] for _, t, _ in mdp.table.row(pair)]
        total += abs(v - u) * rewards + mdp.discount_exact * moves(x)
    return total


def policy_taking(mdp: MDP, marked: Flags) -> PolicyChain:
    """Return the chain that takes the first marked pair (L,) of every state."""
    numbers = np.where(marked, np.arange(mdp.n_pairs), mdp.n_pairs)
    chosen = np.zeros(mdp.n_pairs)
    chosen[np.minimum.reduceat(numbers, mdp.pair_offsets[:-1])] = 1.0
    return PolicyChain(mdp=mdp, chosen=chosen)


def tie_range(
    mdp: MDP, known: FixedPoint, best: PolicyChain, pairs: Integers | None = None
) -> Range:
    """Return (K,) the gap up to which some pairs, or all, tie with the best, for V* as known."""
    if pairs is not None and not len(pairs):
        return Range(low=np.empty(0), high=np.empty(0))
    each, later = per_use(mdp, known, pairs), in_all(best, known)
    rows, state = mdp.transition, mdp.pair_state
    if pairs is not None:
        rows, state = rows[pairs], state[pairs]
    low, high = (
        here + mdp.discount * (rows @ after) + after[state]
        for here, after in ((each.low, later.low), (each.high, later.high))
    )
    return Range(low=low / SLACK, high=high * SLACK)


def widest_tie(mdp: MDP, known: FixedPoint) -> float:
    """Return an upper bound of every pair's `tie_range` that takes no equations.

    With E the most that e(l) can be, F* ≤ E w / m, as w - γ P w ≥ m > 0 (`solvers.bounds.bounds`).
    """
    return _most_per_use(mdp, known) * (1 + 2 * _most_uses(mdp)) * SLACK


def widest(mdp: MDP, *known: FixedPoint) -> Fraction | float:
    """Return an upper bound of `moved_at_start` for the known values of both that needs no visits.

    Σ_l f(l) ≤ Σ_l u(l) e(l) + Σ_l u*(l) e*(l), e and e* of each one's own values.
    """
    often = _most_uses(mdp)
    found = sum(_most_per_use(mdp, one) for one in known) * often * SLACK + TINY
    return Fraction(found) if isfinite(found) else inf


def _most_per_use(mdp: MDP, known: FixedPoint) -> float:
    """Return the most that e(l) of any pair can be, for values (S,) where they are not NaN."""
    (rounded, moved, missing), there = _roundings(mdp), ~np.isnan(known.value)
    value, error = known.value, float(known.error.max(where=there, initial=0.0))
    with np.errstate(over="ignore", invalid="ignore"):
        high, low = value.max(where=there, initial=-inf), value.min(where=there, initial=inf)
        span = float(high - low) + 2 * error
        size = max(abs(float(high)), abs(float(low))) + error
        row = float(moved.max()) * span + float(missing.max()) * size
        return (float(rounded.max()) + mdp.discount * row) * SLACK + TINY


def _most_uses(mdp: MDP) -> float:
    """Return an upper bound of the uses of all pairs from any state by any policy."""
    weights = margin_weights(mdp)
    with np.errstate(over="ignore"):
        return float(weights.value.max() / weights.least.min()) * SLACK


def exact_ties(mdp: MDP, best: Certificate, tie: Range, pairs: Integers) -> Flags:
    """Return (L,) which of some pairs tie with the best, decided in rational arithmetic."""
    found = np.zeros(mdp.n_pairs, dtype=bool)
    later: Sequence[Fraction] | None = None
    for pair, (top, bottom) in exact_gaps(mdp, best, pairs.tolist()).items():
        low, high = float(tie.low[pair]), float(tie.high[pair])
        found[pair] = _at_most(top, bottom, low)
        if found[pair] or (isfinite(high) and not _at_most(top, bottom, high)):
            continue
        if later is None:
            later = _exactly_in_all(policy_taking(mdp, best.optimal_pairs), best.value.tolist())
        limit = exactly_per_use(mdp, best.value.tolist(), pair)
        row = mdp.table.row(pair)
        limit += mdp.discount_exact * sum((p * later[t] for p, t, _ in row), Fraction(0))
        found[pair] = Fraction(top, bottom) <= limit + later[int(mdp.pair_state[pair])]
    return found


def _at_most(top: int, bottom: int, limit: float) -> bool:
    """Return whether top / bottom ≤ limit, without a common divisor of long integers."""
    over, under = limit.as_integer_ratio()
    return top * under <= over * bottom


def _exactly_in_all(chain: PolicyChain, value: Sequence[Fraction]) -> Sequence[Fraction]:
    """Return F (S,) of a policy as rationals, for its exact values."""
    mdp, earned = chain.mdp, [Fraction(0)] * chain.mdp.n_states
    for state in np.flatnonzero(~mdp.terminal).tolist():
        for pair, share in chain.exact_weights(state).items():
            earned[state] += share * exactly_per_use(mdp, value, pair)
    return exact_policy(chain, earned).value


def exact_forgiveness(
    mdp: MDP,
    chain: PolicyChain,
    own: ExactPolicy | Certificate,
    best: Certificate,
    ideal: PolicyChain | None = None,
) -> Forgiveness:
    """Return what rounding can move at the start, for exact values of a policy and the optimum.

    The values may be infinite in states that are not reached. `ideal` is an optimal policy, that of
    the first optimal pairs unless given.
    """
    if not of_floats(mdp):
        return Forgiveness()
    ideal = policy_taking(mdp, best.optimal_pairs) if ideal is None else ideal
    sides = []
    for of, values in ((chain, own), (ideal, best)):
        worth = np.nan_to_num(values.value_float, posinf=0.0, neginf=0.0)  # rounded once
        sides.append(
            Side(chain=of, found=FixedPoint(value=worth, error=UNIT * np.abs(worth) + TINY))
        )
    finite = [
        np.array([x if isinstance(x, Fraction) else Fraction(0) for x in each.value], object)
        for each in (own, best)
    ]
    return Forgiveness(
        most=inf,
        narrow=partial(moved_at_start, mdp, *sides),
        make=partial(_exactly_at_start, mdp, (chain, finite[0]), (ideal, finite[1])),
    )
