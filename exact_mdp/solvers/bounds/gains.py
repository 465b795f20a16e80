"""Advantages of pairs in double precision, with bounds on their rounding errors.

    d(l) = r(l) + γ Σ_s' P(l, s') V(s') - V(s)
         = r(l) + γ Σ_s' P(l, s') (V(s') - V(s)) - (1 - γ) V(s)

Rows sum to 1 exactly, so both forms are equal. The second is computed because its rounding errors
depend on the differences of neighbouring values, not on their size. Errors are relative to the
exact model, of which each float is a rounding. The error of a sum of n products, each factor of
which was rounded a few times, is at most

    γ(n + few) Σ |p| |x|,   γ(n) = n u / (1 - n u),   u = 2⁻⁵³

(Higham, Accuracy and Stability of Numerical Algorithms, SIAM 2002, sections 3.1 and 3.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.forms import threads
from exact_mdp.mdp.forms.rows import NEXT
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.table import COMPILED, Floats, Integers, OutcomeTable
from exact_mdp.solvers.claims import SolverError, Status

UNIT = NEXT / 2  # half of the distance from 1 to the next float
TINY = 2.0**-1000  # above the underflow of a product, 2⁻¹⁰⁷⁵, times any factor that follows
POLICIES = 1000  # the most steps of policy iteration in floats; a few dozen are usual
RELATIVE_TOLERANCE = 1e-9  # relative to the largest value, if no tolerance is given
SLACK = 1 + 2.0**-20  # makes up for the rounding of a bound: a sum of up to 2³⁰ positive terms


def gamma(terms: Any) -> Any:
    """Return γ(n), a little more than n units of roundoff."""
    count = terms * UNIT
    return count / (1 - count) * (1 + 4 * UNIT)


FEW = gamma(4)


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedVector:
    """A vector in floats, with a bound on the error of each number."""

    value: Floats  # (K,)
    error: Floats  # (K,) |value - exact| is at most this


@dataclass(frozen=True, kw_only=True, eq=False)
class Advantages(BoundedVector):
    """The advantages of all pairs (L,) over V: d(l) = r(l) + γ P_l V - V(s)."""

    noise: Floats  # (L,) the effect of rounding V and q; advantages closer than this are ties


@dataclass(frozen=True, kw_only=True, eq=False)
class Weights:
    """Weights w with their verified margins m(l) = w(s) - γ P_l w."""

    value: Floats  # (S,) w
    margin: Floats  # (L,) m, rounded; 1 for pairs of terminal states; (1,) if all are 1 - γ
    error: float  # the greatest error of a margin

    @property
    def uniform(self) -> bool:
        """Whether w is 1 and no state leads to an end, so all margins are 1 - γ."""
        return len(self.margin) == 1

    @cached_property
    def smallest(self) -> float:
        """A lower bound on all margins."""
        return float(self.margin.min() - self.error)

    def bound_rounding(self, error: float, size: float) -> float:
        """Return the error of a ratio c of at most `size`, for advantages with this `error`."""
        return (error + size * (self.error + 8 * UNIT)) / self.smallest

    def compute_ratios(self, gain: Floats) -> Floats:
        """Return (L,) the least c for which gain ≤ c · margin is certain."""
        return np.asarray(gain / (self.margin - np.copysign(self.error, gain)))


class RoundingFacts:
    """The facts about a model on which rounding errors depend, whatever the values."""

    def __init__(self, mdp: MDP) -> None:
        self.leak = float(1 - mdp.discount_exact)  # 1 - γ, rounded once
        self.size = max(-float(mdp.reward.min()), float(mdp.reward.max()))  # the greatest |reward|
        self.most = int(count_roundings(mdp).max())  # roundings in a row
        self.most_reward_error = float(reward_errors(mdp).max())


rounding_facts = cache_on_model(RoundingFacts)


def count_roundings(mdp: MDP) -> Integers:
    """Return (L,) the number of terms of each row's sum, for its rounding error."""
    table = mdp.table
    # Floats of the same next state were added up before, with as many roundings again.
    if table.weight.dtype == np.float64 and mdp.n_transitions < len(table.next):
        return 2 * np.diff(table.offsets)
    return np.asarray(np.diff(mdp.transition.indptr))


def reward_errors(mdp: MDP) -> Floats:
    """Return (L,) bounds on the errors of the rewards."""
    return _expectation_errors(mdp.table, mdp.reward)


@cache_on_model
def component_errors(mdp: MDP) -> Floats:
    """Return (L, C) bounds on the errors of the expected components."""
    errors = []
    for number, amounts in enumerate(mdp.components.T):
        errors.append(_expectation_errors(mdp.table.with_component_reward(number), amounts))
    return np.stack(errors, axis=1)


def _expectation_errors(table: OutcomeTable, earned: Floats) -> Floats:
    """Return (L,) bounds on the errors of the expected rewards of a table."""
    # A sum over outcomes in floats: γ(n) times the sum of absolute values.
    if table.joint and np.float64 in (table.weight.dtype, table.gain.dtype):
        outcomes = np.diff(table.offsets)
        paid = table.compute_probabilities() * np.abs(table.compute_gains())
        total = np.add.reduceat(paid, table.offsets[:-1])
        return np.asarray(gamma(2 * outcomes + 2) * total * SLACK + outcomes * TINY)
    # All other rewards are exact numbers, rounded once.
    return np.asarray(UNIT * np.abs(earned) + TINY * bool(table.gain.any()))


@np.errstate(over="ignore", invalid="ignore")
def compute_advantages(mdp: MDP, value: Floats, *, reward: Floats | None = None) -> Advantages:
    """Return the advantage of each pair over `value` (S,), with a bound on its rounding error.

    A `reward` (L,) other than the model's counts as exact.
    """
    facts, columns, terms_of = rounding_facts(mdp), np.empty((3, mdp.n_pairs)), count_roundings(mdp)
    if reward is None:
        earned_of, unknown = mdp.reward, reward_errors(mdp)
    else:
        earned_of, unknown = reward, np.zeros(mdp.n_pairs)
    # Underflow in products; none if all values are 0.
    tiny = 0.0
    if value.any():
        tiny = TINY * (1 + float(np.abs(value).max()))

    def compute_block(number: int, first: int, last: int) -> None:
        # d = r + γ Σ p (V' - V) - (1 - γ) V, its error, and its noise, one column each.
        here = slice(first, last)
        _sum_differences(mdp, value, first, last, columns)
        steps, flow = mdp.discount * columns[0, here], mdp.discount * columns[1, here]
        own, terms, earned = value[mdp.pair_state[here]], terms_of[here], earned_of[here]
        error = row_error(facts.leak, terms, flow, earned, own) + unknown[here] + tiny * (terms + 1)
        columns[0, here] = earned + (steps - facts.leak * own)
        columns[1, here] = error * SLACK
        size = flow + np.abs(own) + np.abs(earned)
        columns[2, here] = gamma(terms + 8) * size + columns[1, here]

    # In blocks that fit into the cache, so that intermediate arrays need almost no memory.
    with np.errstate(over="ignore", invalid="ignore"):
        ends = threads.block_ends(mdp.transition.indptr, most=threads.IN_CACHE)
        threads.run_blocks(ends, compute_block, mdp.n_transitions)
    if not (np.all(np.isfinite(value)) and np.isfinite(columns[2].max())):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return Advantages(value=columns[0], error=columns[1], noise=columns[2])


def row_error(leak: Any, terms: Any, flow: Any, earned: Any, own: Any) -> Any:
    """Return a bound on the rounding error of d, without underflow and the error of the reward.

    `flow` is Σ γ p |V' - V|, `own` is V, and `leak` is 1 - γ, rounded once. Shapes broadcast.
    """
    leaked = leak * np.abs(own)
    return gamma(terms + 8) * flow + FEW * (np.abs(earned) + leaked) + UNIT * leaked


def largest_error(mdp: MDP, low: float, high: float) -> float:
    """Return a bound on the error of any pair's d, for values from `low` to `high`."""
    # The sum of a row of floats is below 1.001.
    facts, size = rounding_facts(mdp), max(abs(low), abs(high))
    flow = 1.001 * mdp.discount * (high - low)
    error = row_error(facts.leak, facts.most, flow, facts.size, size)
    error += facts.most_reward_error + TINY * (1 + size) * (facts.most + 1)
    return float(error * SLACK)


def choose_greedy_pairs(mdp: MDP, *levels: Advantages, keep: Integers | None = None) -> Integers:
    """Return (S,) the first pair of each state that no other beats by more than rounding.

    Each level breaks the ties of the level before. A pair of `keep` (S,) stays if none beats it.
    """
    left = np.ones(mdp.n_pairs, dtype=bool)
    for gain in levels:
        least = np.where(left, gain.value - gain.noise, -np.inf)
        best = np.maximum.reduceat(least, mdp.pair_offsets[:-1])[mdp.pair_state]
        left &= gain.value + gain.noise >= best
    chosen = first_of(mdp, left)
    if keep is None:
        return chosen
    return np.where(left[keep], keep, chosen)


def first_of(mdp: MDP, some: NDArray[np.bool_]) -> Integers:
    """Return (S,) the first of some pairs (L,) in each state."""
    numbers = np.where(some, np.arange(mdp.n_pairs), mdp.n_pairs)
    return np.asarray(np.minimum.reduceat(numbers, mdp.pair_offsets[:-1]))


def _sum_differences(mdp: MDP, value: Floats, first: int, last: int, columns: Floats) -> None:
    """Write Σ p (V' - V) and Σ p |V' - V| of pairs first … last-1 into `columns` (2 or more, L)."""
    matrix: Any = mdp.transition
    if mdp.n_transitions >= COMPILED:
        from exact_mdp.solvers.kernels import bellman
        from exact_mdp.solvers.kernels.linear import SparseRows

        rows = SparseRows(matrix.indptr, matrix.indices, matrix.data)
        bellman.sum_differences(first, last, mdp.pair_state, rows, value, columns[0], columns[1])
        return
    begin, end = matrix.indptr[first], matrix.indptr[last]
    row = np.repeat(np.arange(last - first), np.diff(matrix.indptr[first : last + 1]))
    term = value[matrix.indices[begin:end]]
    term -= value[mdp.pair_state[first:last]][row]
    term *= matrix.data[begin:end]
    # `bincount` adds in the order of entries, as the compiled loop does: the floats are the same.
    columns[0, first:last] = np.bincount(row, term, last - first)
    columns[1, first:last] = np.bincount(row, np.abs(term, out=term), last - first)
