"""Rounding errors of double precision, bounded in advance.

A sum of n products, in any order, each number rounded a few times before, is off by at most

    γ(n + few) Σ |p| |x|,   γ(n) = n u / (1 - n u),   u = 2⁻⁵³

as long as nothing underflows; what does costs at most TINY for each term (Higham, Accuracy and
Stability of Numerical Algorithms, SIAM 2002, sections 3.1 and 3.4). Bounds are themselves computed
in double precision, so `SLACK` enlarges each of them by more than that can cost: a bound is a sum
of nonnegative terms, and these keep a relative error of at most γ(n + few).

What each pair would add to V, with a bound on the rounding error.

    d(l) = r(l) + γ Σ_s' P(l, s') V(s') - V(s)
         = r(l) + γ Σ_s' P(l, s') (V(s') - V(s)) - (1 - γ) V(s)

The second form is computed, as rows sum to 1 exactly. Its rounding errors are set by how values
differ between neighbours, not by how large they are. The error is bounded against the exact model,
of which each float is a rounding (Higham, Accuracy and Stability of
Numerical Algorithms, SIAM 2002, section 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.forms import threads
from exact_mdp.mdp.model import MDP, once
from exact_mdp.mdp.table import COMPILED, Floats, Integers
from exact_mdp.solvers.solution import SolverError, Status

UNIT = 2.0**-53
TINY = 2.0**-1000
SLACK = 1 + 2.0**-20


def gamma(terms: Integers | int) -> Floats:
    """Return γ(n), a little more than n units of roundoff."""
    count = np.asarray(terms, dtype=np.float64) * UNIT
    return np.asarray(count / (1 - count) * (1 + 4 * UNIT))


FEW = float(gamma(4))


@dataclass(frozen=True, kw_only=True, eq=False)
class Gain:
    """What each pair adds to V: d(l) = r(l) + γ P_l V - V(s)."""

    value: Floats  # (L,) d as computed
    error: Floats  # (L,) how far it may be from the exact one
    noise: Floats  # (L,) what rounding V and q amounts to; gains closer than this are ties


@dataclass(frozen=True, kw_only=True, eq=False)
class Weights:
    """Weights w with their verified margins m(l) = w(s) - γ P_l w."""

    value: Floats  # (S,) w
    margin: Floats  # (L,) m, rounded; 1 for pairs of terminal states; (1,) where all are 1 - γ
    error: float  # The greatest error of any of them

    @property
    def uniform(self) -> bool:
        """Whether w is 1 and no way leads to an end: all values may rise alike by c w."""
        return len(self.margin) == 1

    @property
    def least(self) -> Floats:
        """Lower bounds of the margins."""
        return np.asarray(self.margin - self.error)

    @cached_property
    def smallest(self) -> float:
        """The least of the lower bounds."""
        return float(self.least.min())

    def ratio(self, gain: Floats) -> Floats:
        """Return (L,) the least c that is sure to satisfy gain ≤ c · margin."""
        return np.asarray(gain / np.where(gain > 0, self.least, self.margin + self.error))


@np.errstate(over="ignore", invalid="ignore")
def gains(mdp: MDP, value: Floats, *, reward: Floats | None = None) -> Gain:
    """Return what each pair adds to `value` (S,), with the rounding errors bounded."""
    facts, columns = rounding_facts(mdp), np.empty((3, mdp.n_pairs))
    still = bool(value.min() == value.max() and np.isfinite(value[0]))
    tiny = TINY * (1 + float(np.abs(value).max())) * bool(value.any())

    def work(number: int, first: int, last: int) -> None:
        here = slice(first, last)
        _differences(mdp, value, first, last, columns, still=still)
        steps, flow = mdp.discount * columns[0, here], mdp.discount * columns[1, here]
        own = value[mdp.pair_state[here]]
        earned = (mdp.reward if reward is None else reward)[here]
        earned_error = facts.reward_errors(mdp, first, last) if reward is None else 0.0
        leak, terms = facts.leak * own, facts.terms(mdp, first, last)
        size = np.abs(earned) + np.abs(leak)
        error = gamma(terms + 8) * flow + FEW * size
        error += facts.leak_error * np.abs(own) + tiny * (terms + 1)
        error = (error + earned_error) * SLACK
        columns[0, here] = earned + (steps - leak)
        columns[1, here] = error
        columns[2, here] = gamma(terms + 8) * (flow + np.abs(own) + np.abs(earned)) + error

    # In parts that stay in the cache: what is worked with on the way takes no memory to speak of.
    with np.errstate(over="ignore", invalid="ignore"):
        ends = threads.block_ends(mdp.transition.indptr, most=threads.IN_CACHE)
        threads.run_blocks(ends, work, mdp.n_transitions)
    if not (np.all(np.isfinite(value)) and np.isfinite(columns[2].max())):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return Gain(value=columns[0], error=columns[1], noise=columns[2])


def greedy(mdp: MDP, gain: Gain, keep: Integers | None = None) -> Integers:
    """Return (S,) the first pair of each state that no other beats by more than rounding."""
    offsets, chosen = mdp.pair_offsets, np.empty(mdp.n_states, dtype=np.int64)

    def work(number: int, first: int, last: int) -> None:
        here = slice(offsets[first], offsets[last])
        begin, counts = offsets[first:last], np.diff(offsets[first : last + 1])
        value, noise = gain.value[here], gain.noise[here]
        best = np.maximum.reduceat(value - noise, begin - begin[0])
        good = value + noise >= np.repeat(best, counts)
        numbers = np.where(good, np.arange(here.start, here.stop), mdp.n_pairs)
        taken = np.minimum.reduceat(numbers, begin - begin[0])
        if keep is not None:
            own = keep[first:last]
            taken = np.where(good[own - begin[0]], own, taken)
        chosen[first:last] = taken

    threads.run_blocks(threads.block_ends(offsets, most=threads.IN_CACHE), work, mdp.n_transitions)
    return chosen


def largest_error(mdp: MDP, low: float, high: float) -> float:
    """Return a bound on the error of any pair's d, for values from `low` to `high`.

    No row of floats sums up to 1.001.
    """
    facts, size = rounding_facts(mdp), max(abs(low), abs(high))
    error = facts.rounding * 1.001 * mdp.discount * (high - low)
    error += FEW * (facts.size + facts.leak * size) + facts.leak_error * size
    error += facts.most_reward_error + TINY * (1 + size) * (facts.most + 1)
    return error * SLACK


@dataclass(frozen=True, kw_only=True, eq=False)
class RoundingFacts:
    """What is known of a model's rounding errors before any values are.

    `merged` counts the roundings in a row where floats of the same next state were added up before;
    else it is empty. So is `reward_error` where each reward was rounded once.
    """

    merged: NDArray[np.int32]  # (L,) int32 or (0,)
    reward_error: Floats  # (L,) or (0,) how far each reward may be from the exact one
    leak: float  # 1 - γ
    leak_error: float  # the error of `leak`
    size: float  # the greatest |reward|
    most: int  # the most roundings in a row
    rounding: float  # γ(most + 8)
    most_reward_error: float

    def terms(self, mdp: MDP, first: int, last: int) -> Integers:
        """Return the number of roundings in a row of pairs first … last-1."""
        if len(self.merged):
            return np.asarray(self.merged[first:last])
        ends = mdp.transition.indptr  # an exact model's outcomes of a next state are one in it
        return np.asarray(ends[first + 1 : last + 1] - ends[first:last])

    def reward_errors(self, mdp: MDP, first: int, last: int) -> Floats:
        """Return how far the rewards of pairs first … last-1 may be from the exact ones."""
        if len(self.reward_error):
            return self.reward_error[first:last]
        earning = _earning(mdp, first, last)
        return np.asarray(UNIT * np.abs(mdp.reward[first:last]) + TINY * earning)


@once
def rounding_facts(mdp: MDP) -> RoundingFacts:
    """Return the facts, computed once for each model."""
    leak = float(1 - mdp.discount_exact)
    merged = np.empty(0, dtype=np.int32)
    most = int(np.diff(mdp.transition.indptr).max())
    if mdp.table.weight.dtype == np.float64 and mdp.n_transitions < len(mdp.table.next):
        merged = (2 * np.diff(mdp.table.offsets)).astype(np.int32)
        most = int(merged.max())
    size = max(-float(mdp.reward.min()), float(mdp.reward.max()))
    error, table = np.empty(0), mdp.table
    if table.joint and np.float64 in (table.weight.dtype, table.gain.dtype):
        terms = np.diff(table.offsets)
        paid = np.add.reduceat(table.probabilities() * np.abs(table.gains()), table.offsets[:-1])
        error = np.asarray(gamma(2 * terms + 2) * paid * SLACK + terms * TINY)
    return RoundingFacts(
        merged=merged,
        reward_error=error,
        leak=leak,
        leak_error=leak * UNIT,
        size=size,
        most=most,
        rounding=float(gamma(most + 8)),
        most_reward_error=float(error.max()) if len(error) else UNIT * size + TINY,
    )


def _earning(mdp: MDP, first: int, last: int) -> NDArray[np.bool_]:
    """Return True where one of the pairs first … last-1 earns anything."""
    table = mdp.table
    if len(table.gain) == mdp.n_pairs:
        return np.asarray(table.gain[first:last] != 0)
    offsets = table.offsets[first : last + 1]
    earning = np.asarray(table.gain[offsets[0] : offsets[-1]] != 0)
    return np.asarray(np.logical_or.reduceat(earning, offsets[:-1] - offsets[0]))


def _differences(
    mdp: MDP, value: Floats, first: int, last: int, columns: Floats, *, still: bool
) -> None:
    """Write Σ p (V' - V) and Σ p |V' - V| of pairs first … last-1 into `columns` (2 or more, L)."""
    matrix: Any = mdp.transition
    if still:
        columns[:2, first:last] = 0.0
        return
    if mdp.n_transitions >= COMPILED:
        from exact_mdp.solvers.kernels.linear import Rows

        rows = Rows(matrix.indptr, matrix.indices, matrix.data)
        from exact_mdp.solvers.kernels import bellman

        bellman.gains(first, last, mdp.pair_state, rows, value, columns[0], columns[1])
        return
    begin, end = matrix.indptr[first], matrix.indptr[last]
    counts = np.diff(matrix.indptr[first : last + 1])
    term = value[matrix.indices[begin:end]]
    term -= np.repeat(value[mdp.pair_state[first:last]], counts)
    term *= matrix.data[begin:end]
    columns[0, first:last] = added(term, counts)
    columns[1, first:last] = added(np.abs(term, out=term), counts)


def added(terms: Floats, counts: Integers) -> Floats:
    """Return the sums of so many terms each, added one by one, as compiled loops add them."""
    row = np.repeat(np.arange(len(counts)), counts)
    return np.asarray(np.bincount(row, terms, len(counts)), dtype=np.float64)
