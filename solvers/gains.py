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

from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.rounding import SLACK, TINY, UNIT, gamma
from solvers.solution import SolverError, Status

CHUNK = 2**21


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
    model = _model(mdp)
    steps, flow = _differences(mdp, value)
    own = value[mdp.pair_state]
    earned = mdp.reward if reward is None else reward
    earned_error = model.reward_error if reward is None else 0.0
    steps, flow = mdp.discount * steps, mdp.discount * flow
    leak = model.leak * own
    size = np.abs(earned) + np.abs(leak)
    rounding = gamma(model.terms + 8) * flow + gamma(4) * size + model.leak_error * np.abs(own)
    tiny = TINY * (model.terms + 1) * (1 + float(np.abs(value).max())) * bool(value.any())
    error = (rounding + earned_error + tiny) * SLACK
    noise = gamma(model.terms + 8) * (flow + np.abs(own) + np.abs(earned)) + error
    if not (np.all(np.isfinite(value)) and np.all(np.isfinite(noise))):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return Gain(value=earned + (steps - leak), error=error, noise=noise)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Model:
    """Rounding facts (L,): roundings in a row, error of rewards, leak 1 - γ Σ p, and its error."""

    terms: Integers
    reward_error: Floats
    leak: Floats
    leak_error: Floats


_MODELS: WeakKeyDictionary[MDP, _Model] = WeakKeyDictionary()


def _model(mdp: MDP) -> _Model:
    if mdp not in _MODELS:
        terms = np.diff(mdp.table.offsets)
        leak, leak_error = _leak(mdp, terms)
        if mdp.table.weight.dtype == np.float64 and mdp.n_transitions < len(mdp.table.next):
            terms = 2 * terms  # floats of the same next state were added up, with rounding
        _MODELS[mdp] = _Model(
            terms=terms, reward_error=_reward_error(mdp, terms), leak=leak, leak_error=leak_error
        )
    return _MODELS[mdp]


def _leak(mdp: MDP, terms: Integers) -> tuple[Floats, Floats]:
    """Return 1 - γ Σ p by pair: rational rows sum to 1, rows of floats nearly so."""
    leak = float(1 - mdp.discount_exact)
    weight = mdp.table.weight
    if weight.dtype != np.float64:
        return np.full(mdp.n_pairs, leak), np.full(mdp.n_pairs, leak * UNIT)
    # Multiples of 2^-40 add up exactly as integers, and what is left of each float is tiny.
    scaled = np.rint(weight * 2.0**40)
    first = mdp.table.offsets[:-1]
    whole = np.add.reduceat(scaled.astype(np.int64), first) - 2**40
    rest = np.add.reduceat(weight - scaled * 2.0**-40, first)
    excess = mdp.discount * (whole * 2.0**-40 + rest)
    error = 2 * UNIT * leak + 8 * UNIT * np.abs(excess) + gamma(terms) * terms * 2.0**-40
    return leak - excess, np.asarray(error)


def _reward_error(mdp: MDP, terms: Integers) -> Floats:
    """Return how far each expected reward, as a float, may be from the exact one."""
    table = mdp.table
    if table.joint and np.float64 in (table.weight.dtype, table.gain.dtype):
        size = np.add.reduceat(table.probabilities() * np.abs(table.gains()), table.offsets[:-1])
        return np.asarray(gamma(terms + 2) * size * SLACK + terms * TINY)
    earning = table.gain != 0
    if len(earning) != mdp.n_pairs:
        earning = np.logical_or.reduceat(earning, table.offsets[:-1])
    return np.asarray(UNIT * np.abs(mdp.reward) + TINY * earning)


def _differences(mdp: MDP, value: Floats) -> tuple[Floats, Floats]:
    """Return (L,) Σ p (V' - V) and Σ p |V' - V|, a few million transitions at a time."""
    matrix: Any = mdp.transition
    steps, flow = np.empty(mdp.n_pairs), np.empty(mdp.n_pairs)
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
