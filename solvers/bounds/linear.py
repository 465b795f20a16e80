"""Solve x = c + γ P x for a nonnegative P, with a bound on the error that is sound.

    fixed_point(transition (S, S), constant (S,), discount, order=…) -> FixedPoint(value, error)

The values of a policy, its second moments, its expected steps and (with P transposed) its visits
all have this form. The chain must leak: at discount 1 the rows of terminal states, where x is 0,
have to be empty (`policy_chain` does that).

Solving: where an order of the states is known along which the chain only falls, by substitution;
where all transitions are to near numbers, by elimination within that band; up to 500 states, by
sparse elimination. Otherwise by BiCGSTAB, which does not fill the matrix. Where that does not
converge soon, by sparse elimination, if there is room for its factors; if not, by GMRES, and by
BiCGSTAB with more patience. Steps of iterative refinement follow.

Bounding: let k be at least |c + γ P x - x|, its rounding errors included. If e ≥ 0 satisfies
e - γ P e ≥ k, then |x - x*| ≤ e, because (I - γP)⁻¹ is nonnegative. So the error solves the same
equation with the residual for a constant; what comes out is then verified with the rounding errors
counted. That e - γ P e > 0 for some e > 0 also proves that the chain leaks
(Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences, 1979, chapter 6, M35).

Krylov methods for x = c + γ P x, which fill no matrix: BiCGSTAB, and GMRES where that swings.

Large chains take the compiled loops of `solvers.kernels.krylov`; small ones SciPy's, preconditioned
by the diagonal, so that no compiler is loaded. Chains of many states are large, too: threads of a
library for linear algebra would wait for each other where other work goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.bounds import elimination
from exact_mdp.solvers.bounds.elimination import Solve, TooLarge, matrix_of
from exact_mdp.solvers.bounds.gains import COMPILED, SLACK, TINY, UNIT, gamma
from exact_mdp.solvers.solution import SolverError, Status

DIRECT_STATES = 500
MOST_FILL = 4
CHEAP = 5_000_000  # multiplications within the band, for which iterating in SciPy takes longer
REFINEMENTS = 5
FIRST, CORRECTION = 1e-11, 1e-4  # residuals to iterate for, as parts of the constant


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPoint:
    """A solution and how far it may be from the exact one.

    Attributes
    ----------
    value : (S,)
    error : (S,)
        |value - exact| is at most this, state by state.
    """

    value: Floats
    error: Floats


def fixed_point(
    transition: sp.csr_array,
    constant: Floats,
    discount: float = 1.0,
    *,
    order: Integers | None = None,
    roundings: int = 1,
    constant_error: Floats | float = 0.0,
) -> FixedPoint:
    """Return the solution of x = c + γ P x and a bound on its error in every state.

    For several constants and one matrix, make one `LinearSystem` and call its `solve`.

    Parameters
    ----------
    transition : (S, S) csr array, nonnegative
    constant : (S,)
    discount : float
        γ, itself rounded at most once.
    order : (S,) ints, optional
        Known where the chain is acyclic: every entry (s, t) has order[t] < order[s]. For a
        transposed matrix that is the negative of the order.
    roundings : int
        How many times each entry of `transition` was rounded on its way from the exact number:
        1 for rows of `MDP.transition`, about A + 2 for mixtures of them.
    constant_error : (S,) or float
        How far the constant may be from the exact one.

    Raises
    ------
    ValueError
        For numbers that are not finite, and where there is no state.
    SolverError
        Where no bound can be verified: the chain does not leak, or it does so too slowly.

    Examples
    --------
    >>> walk = sp.csr_array([[0.5, 0.25], [0.0, 0.0]])
    >>> found = fixed_point(walk, np.array([1.0, 1.0]))
    >>> found.value.tolist(), bool(found.error.max() < 1e-14)
    ([2.5, 1.0], True)
    """
    system = LinearSystem(transition, discount, order=order, roundings=roundings)
    return system.solve(constant, constant_error)


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """The equation x = c + γ P x for one P and many c; see `fixed_point` for the arguments."""

    transition: sp.csr_array
    discount: float = 1.0
    order: Integers | None = None
    roundings: int = 1

    def __post_init__(self) -> None:
        rows, columns = self.transition.shape
        if not rows or rows != columns:
            raise ValueError(f"transitions of shape {(rows, columns)} are not those of a chain")
        if not (np.isfinite(self.discount) and np.isfinite(self.transition.data).all()):
            raise ValueError("a transition probability or the discount is not a finite number")

    @np.errstate(over="ignore", invalid="ignore")
    def solve(self, constant: Floats, constant_error: Floats | float = 0.0) -> FixedPoint:
        """Return x (S,) and its error (S,); raises SolverError where none can be verified."""
        value = self.approximate(constant)
        residual = self._residual(constant, value)
        rounding = self._rounding(np.abs(constant), np.abs(value))
        excess = (np.abs(residual) * (1 + 4 * UNIT) + rounding + constant_error) * SLACK
        return FixedPoint(value=value, error=self._dominating(excess))

    def _dominating(self, excess: Floats) -> Floats:
        """Return e (S,) with e - γ P e ≥ `excess`, verified."""
        largest = float(excess.max(initial=0.0))
        if largest == 0.0:
            return np.zeros_like(excess)
        if not np.isfinite(largest):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        # Of a scale of 1, and nowhere so small that rounding would swallow the margin.
        wanted = excess / largest + 2.0**-10
        error = self.approximate(wanted)
        margin = self._residual(np.zeros_like(error), error)
        slack = -margin - self._rounding(np.zeros_like(error), np.abs(error))
        if not (np.all(np.isfinite(error)) and (error > 0).all() and (slack > 0).all()):
            raise SolverError(Status.NO_BOUND)
        scale = float((excess / slack).max())
        return np.asarray(error * (scale * SLACK))

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def approximate(self, constant: Floats) -> Floats:
        """Return x (S,) for a constant (S,), refined, without any claim about its error."""
        value = self._nearly(constant, FIRST)
        residual = self._residual(constant, value)
        size = float(np.abs(residual).max(initial=0.0))
        for _ in range(REFINEMENTS):
            if size == 0.0 or not np.isfinite(size):
                break
            better = value + self._nearly(residual, CORRECTION)
            after = self._residual(constant, better)
            smaller = float(np.abs(after).max())
            if not smaller < size:
                break
            value, residual = better, after
            if smaller > size / 2:
                break
            size = smaller
        return value

    def roughly(self, constant: Floats) -> Floats:
        """Return x (S,) with a residual of about a hundredth of the constant (S,), or smaller."""
        return self._nearly(constant, 1e-2)

    def _residual(self, constant: Floats, value: Floats) -> Floats:
        return np.asarray(constant + self.discount * (self.transition @ value) - value)

    def _rounding(self, constant: Floats, value: Floats) -> Floats:
        """Return how far the computed residual may be from the exact one, for magnitudes."""
        terms = np.diff(self.transition.indptr)
        flow = self.discount * (self.transition @ value)
        total = gamma(terms + self.roundings + 4) * (constant + flow) + 2 * UNIT * value
        largest = float(value.max(initial=0.0))
        return np.asarray(total + TINY * (terms + 1) * (largest + (largest > 0)))

    # ---- solvers -----------------------------------------------------------------------------

    def _nearly(self, constant: Floats, rtol: float) -> Floats:
        """Return x (S,), where it is iterated for with a residual of that part of the constant."""
        return self._iteration(constant, rtol) if self._direct is None else self._direct(constant)

    @cached_property
    def _direct(self) -> Solve | None:
        """The method that needs no iteration, where there is one that costs little."""
        chain, rate = self.transition, self.discount
        if self.order is not None:
            return elimination.substitution(chain, rate, self.order)
        within = elimination.reach(chain)
        if sum(within) * chain.shape[0] <= MOST_FILL * chain.nnz:
            return elimination.band(chain, rate, within)
        states, quick = chain.shape[0], chain.nnz < COMPILED
        if states <= DIRECT_STATES or (quick and states * within[0] * within[1] <= CHEAP):
            return elimination.sparse(chain, rate)
        return None

    def _iteration(self, constant: Floats, rtol: float) -> Floats:
        """BiCGSTAB, and for good something slower once that fails to converge."""
        size = float(np.abs(constant).max(initial=0.0))
        if size == 0.0 or not np.isfinite(size):
            return np.full(len(constant), 0.0 if size == 0.0 else np.nan)
        scaled = constant / size  # tests for breakdown are absolute
        if "_last_resort" not in vars(self):
            found = quickly(self.transition, self.discount, scaled, rtol)
            if found is not None:
                return np.asarray(found * size)
        if not isinstance(self._last_resort, TooLarge):
            return self._last_resort(constant)
        found = patiently(self.transition, self.discount, scaled, rtol)
        if found is None:
            raise TooLarge(self._last_resort.detail)
        return np.asarray(found * size)

    @cached_property
    def _last_resort(self) -> Solve | TooLarge:
        """Sparse elimination, or why not."""
        try:
            return elimination.sparse(self.transition, self.discount)
        except TooLarge as refusal:
            return refusal


def policy_chain(mdp: MDP, pairs: Integers) -> tuple[sp.csr_array, Floats]:
    """Return the (S, S) transitions, terminal rows emptied, and (S,) rewards of `pairs` (S,)."""
    chain = mdp.transition[pairs]
    if mdp.terminal.any():
        chain.data[np.repeat(mdp.terminal, np.diff(chain.indptr))] = 0.0
        chain.eliminate_zeros()
    return chain, np.where(mdp.terminal, 0.0, mdp.reward[pairs])


STEPS = 400
PATIENT = 8000
LONG = 5000  # states from which on SciPy's inner products run on threads of their own
DIRECTIONS = 20
GMRES_STEPS = 400


def quickly(chain: sp.csr_array, discount: float, constant: Floats, rtol: float) -> Floats | None:
    """Return x (S,), or None where that takes more than `STEPS` steps.

    Parameters
    ----------
    chain : (S, S) csr array
    constant : (S,)
        c, of magnitude 1 or so.
    rtol : float
        The residual's norm is to be about this part of the constant's.

    Examples
    --------
    >>> walk = sp.csr_array([[0.5, 0.25], [0.0, 0.0]])
    >>> quickly(walk, 1.0, np.array([1.0, 1.0]), 1e-12).round(9).tolist()
    [2.5, 1.0]
    """
    return _bicgstab(chain, discount, constant, rtol, STEPS)


def patiently(chain: sp.csr_array, discount: float, constant: Floats, rtol: float) -> Floats | None:
    """Return x (S,), or None where neither GMRES nor `PATIENT` steps of BiCGSTAB lead there."""
    if chain.nnz >= COMPILED:
        from exact_mdp.solvers.kernels import krylov

        value, basis = np.empty(len(constant)), np.empty((DIRECTIONS + 2, len(constant)))
        small = np.empty((DIRECTIONS + 4, DIRECTIONS + 1))
        rows = _rows(chain, discount)
        taken = krylov.gmres(*rows, constant, rtol, GMRES_STEPS, value, basis, small)
        if taken >= 0 and np.all(np.isfinite(value)):
            return value
    return _bicgstab(chain, discount, constant, rtol, PATIENT)


def _rows(chain: sp.csr_array, discount: float) -> tuple[Numbers, Numbers, Floats, float]:
    """Return the arrays of the chain, their columns sorted, and γ."""
    chain = chain if chain.has_sorted_indices else chain.sorted_indices()
    return chain.indptr, chain.indices, chain.data, float(discount)


def _bicgstab(
    chain: sp.csr_array, discount: float, constant: Floats, rtol: float, steps: int
) -> Floats | None:
    if chain.nnz >= COMPILED or chain.shape[0] >= LONG:
        from exact_mdp.solvers.kernels import krylov

        value, room = np.empty(len(constant)), np.empty((6, len(constant)))
        rows = _rows(chain, discount)
        failed = krylov.bicgstab(*rows, constant, rtol, steps, value, room) < 0
    else:
        from scipy.sparse.linalg import bicgstab

        matrix = matrix_of(chain, discount)
        inverse = sp.diags_array(1 / matrix.diagonal())
        value, status = bicgstab(matrix, constant, rtol=rtol, maxiter=steps, M=inverse)
        failed = status != 0
    return None if failed or not np.all(np.isfinite(value)) else np.asarray(value)
