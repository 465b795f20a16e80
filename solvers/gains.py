"""What each pair would add to V, with a bound on the rounding error.

    d(l) = r(l) + γ Σ_s' P(l, s') V(s') - V(s)
         = r(l) + γ Σ_s' P(l, s') (V(s') - V(s)) - (1 - γ Σ_s' P(l, s')) V(s)

The second form is computed. Its rounding errors are set by how values differ between neighbours,
not by how large they are, and the leak 1 - γ Σ P is known almost exactly. The error is bounded
against the exact model, of which the floats are a rounding (Higham, Accuracy and Stability of
Numerical Algorithms, SIAM 2002, section 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from mdp import threads
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.rounding import SLACK, TINY, UNIT, gamma
from solvers.solution import SolverError, Status

CHUNK = 2**21
COMPILED = 20_000  # transitions from which on loading compiled loops pays


@dataclass(frozen=True, kw_only=True, eq=False)
class Gain:
    """What each pair adds to V: d(l) = r(l) + γ P_l V - V(s).

    Attributes
    ----------
    value : (L,)
        d as computed.
    error : (L,)
        How far it may be from the exact one.
    noise : (L,)
        What rounding V and q to double precision amounts to; gains closer than this are ties.
    """

    value: Floats
    error: Floats
    noise: Floats


@np.errstate(over="ignore", invalid="ignore")
def gains(mdp: MDP, value: Floats, *, reward: Floats | None = None) -> Gain:
    """Return what each pair adds to `value` (S,), with the rounding errors bounded.

    Parameters
    ----------
    reward : (L,), optional
        Exact rewards in place of the model's.

    Raises
    ------
    SolverError
        Where a value is beyond the range of floats.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [[1], [0]])
    >>> gains(mdp, np.array([1.5, 0.0])).value.tolist()
    [0.25, 0.0]
    """
    facts = rounding_facts(mdp)
    steps, flow = _differences(mdp, value)
    own = value[mdp.pair_state]
    earned = mdp.reward if reward is None else reward
    earned_error: Floats | float = 0.0 if reward is not None else facts.reward_errors(mdp)
    steps, flow = mdp.discount * steps, mdp.discount * flow
    leak = facts.leak * own
    size = np.abs(earned) + np.abs(leak)
    terms = facts.terms(mdp)
    rounding = gamma(terms + 8) * flow + gamma(4) * size + facts.leak_error * np.abs(own)
    tiny = TINY * (terms + 1) * (1 + float(np.abs(value).max())) * bool(value.any())
    error = (rounding + earned_error + tiny) * SLACK
    noise = gamma(terms + 8) * (flow + np.abs(own) + np.abs(earned)) + error
    if not (np.all(np.isfinite(value)) and np.all(np.isfinite(noise))):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return Gain(value=earned + (steps - leak), error=error, noise=noise)


def greedy(mdp: MDP, gain: Gain, keep: Integers | None = None) -> Integers:
    """Return (S,) the first pair of each state that no other beats by more than rounding.

    Parameters
    ----------
    keep : (S,) ints, optional
        Pairs to keep, too, where no other beats them by more than rounding.
    """
    first = mdp.pair_offsets[:-1]
    best = np.maximum.reduceat(gain.value - gain.noise, first)[mdp.pair_state]
    good = gain.value + gain.noise >= best
    numbers = np.where(good, np.arange(mdp.n_pairs), mdp.n_pairs)
    chosen = np.minimum.reduceat(numbers, first)
    return chosen if keep is None else np.where(good[keep], keep, chosen)


@dataclass(frozen=True, kw_only=True, eq=False)
class RoundingFacts:
    """What is known of a model's rounding errors before any values are.

    Attributes
    ----------
    merged : (L,) int32 or (0,)
        Roundings in a row where floats of the same next state were added up before; else empty.
    reward_error : (L,) or (0,)
        How far each reward may be from the exact one; empty where each was rounded once.
    leak : (L,)
        1 - γ Σ p.
    leak_error : float
        The greatest error of `leak`.
    """

    merged: NDArray[np.int32]
    reward_error: Floats
    leak: Floats
    leak_error: float

    def terms(self, mdp: MDP) -> Integers:
        """Return (L,) the number of roundings in a row."""
        return np.asarray(self.merged if len(self.merged) else np.diff(mdp.table.offsets))

    def reward_errors(self, mdp: MDP) -> Floats:
        """Return (L,) how far each reward may be from the exact one."""
        if len(self.reward_error):
            return self.reward_error
        return np.asarray(UNIT * np.abs(mdp.reward) + TINY * _earning(mdp))

    def reward_error_bound(self, mdp: MDP) -> float:
        """Return the greatest of them, or a little more."""
        if len(self.reward_error):
            return float(self.reward_error.max())
        return UNIT * max(abs(float(mdp.reward.min())), abs(float(mdp.reward.max()))) + TINY


_FACTS: WeakKeyDictionary[MDP, RoundingFacts] = WeakKeyDictionary()


def rounding_facts(mdp: MDP) -> RoundingFacts:
    """Return the facts, computed once for each model."""
    if mdp not in _FACTS:
        leak, leak_error = _leak(mdp)
        merged = np.empty(0, dtype=np.int32)
        if mdp.table.weight.dtype == np.float64 and mdp.n_transitions < len(mdp.table.next):
            merged = (2 * np.diff(mdp.table.offsets)).astype(np.int32)
        _FACTS[mdp] = RoundingFacts(
            merged=merged,
            reward_error=_reward_error(mdp),
            leak=leak,
            leak_error=leak_error,
        )
    return _FACTS[mdp]


def _leak(mdp: MDP) -> tuple[Floats, float]:
    """Return 1 - γ Σ p by pair: rational rows sum to 1, rows of floats nearly so."""
    leak = float(1 - mdp.discount_exact)
    weight, offsets = mdp.table.weight, mdp.table.offsets
    if weight.dtype != np.float64:
        return np.full(mdp.n_pairs, leak), leak * UNIT
    if len(weight) >= COMPILED:
        from solvers.kernels import bellman

        found = np.empty(mdp.n_pairs)
        ends = threads.block_ends(offsets)
        worst = np.zeros(len(ends) - 1)

        def work(number: int, first: int, last: int) -> None:
            worst[number] = bellman.leaks(first, last, offsets, weight, mdp.discount, leak, found)

        threads.run_blocks(ends, work)
        return found, float(worst.max())
    # Multiples of 2^-40 add up exactly as integers, and what is left of each float is tiny.
    scaled = np.rint(weight * 2.0**40)
    whole = np.add.reduceat(scaled.astype(np.int64), offsets[:-1]) - 2**40
    rest = np.add.reduceat(weight - scaled * 2.0**-40, offsets[:-1])
    excess = mdp.discount * (whole * 2.0**-40 + rest)
    terms = np.diff(offsets)
    error = 2 * UNIT * leak + 8 * UNIT * np.abs(excess) + gamma(terms) * terms * 2.0**-40
    return leak - excess, float(error.max())


def _reward_error(mdp: MDP) -> Floats:
    """Return how far each expected reward, as a float, may be from the exact one."""
    table = mdp.table
    if not (table.joint and np.float64 in (table.weight.dtype, table.gain.dtype)):
        return np.empty(0)
    terms = np.diff(table.offsets)
    size = np.add.reduceat(table.probabilities() * np.abs(table.gains()), table.offsets[:-1])
    return np.asarray(gamma(2 * terms + 2) * size * SLACK + terms * TINY)


def _earning(mdp: MDP) -> NDArray[np.bool_]:
    """Return (L,) True where a pair earns anything."""
    earning = np.asarray(mdp.table.gain != 0)
    if len(earning) != mdp.n_pairs:
        earning = np.logical_or.reduceat(earning, mdp.table.offsets[:-1])
    return earning


def _differences(mdp: MDP, value: Floats) -> tuple[Floats, Floats]:
    """Return (L,) Σ p (V' - V) and Σ p |V' - V|, a few million transitions at a time."""
    matrix: Any = mdp.transition
    steps, flow = np.empty(mdp.n_pairs), np.empty(mdp.n_pairs)
    if value.min() == value.max() and np.isfinite(value[0]):
        return np.zeros(mdp.n_pairs), np.zeros(mdp.n_pairs)
    if mdp.n_transitions >= COMPILED:
        from solvers.kernels import bellman

        rows = (mdp.pair_state, matrix.indptr, matrix.indices, matrix.data)
        threads.run_blocks(
            threads.block_ends(matrix.indptr),
            lambda _, first, last: bellman.gains(first, last, *rows, value, steps, flow),
        )
        return steps, flow
    cuts = np.searchsorted(matrix.indptr, np.arange(0, matrix.nnz, CHUNK)).tolist()
    for first, last in zip(cuts, [*cuts[1:], mdp.n_pairs], strict=True):
        if first == last:
            continue
        begin, end = matrix.indptr[first], matrix.indptr[last]
        counts = np.diff(matrix.indptr[first : last + 1])
        term = value[matrix.indices[begin:end]]
        term -= np.repeat(value[mdp.pair_state[first:last]], counts)
        term *= matrix.data[begin:end]
        offsets = matrix.indptr[first:last] - begin
        steps[first:last] = np.add.reduceat(term, offsets)
        flow[first:last] = np.add.reduceat(np.abs(term, out=term), offsets)
    return steps, flow
