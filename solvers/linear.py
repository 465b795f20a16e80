"""Solve x = c + γ P x for a nonnegative P, with a bound on the error that is sound.

    fixed_point(transition (S, S), constant (S,), discount, order=…) -> FixedPoint(value, error)

The values of a policy, its second moments, its expected steps and (with P transposed) its visits
all have this form. The chain must leak: at discount 1 the rows of terminal states, where x is 0,
have to be empty (`policy_chain` does that).

Solving: where an order of the states is known along which the chain only falls, by substitution;
otherwise by sparse elimination (up to 500 states, or where all transitions are to near numbers), or
by BiCGSTAB, which does not fill the matrix, with elimination only where that does not converge.
Steps of iterative refinement follow.

Bounding: let k be at least |c + γ P x - x|, its rounding errors included. If e ≥ 0 satisfies
e - γ P e ≥ k, then |x - x*| ≤ e, because (I - γP)⁻¹ is nonnegative. So the error solves the same
equation with the residual for a constant; what comes out is then verified with the rounding errors
counted. That e - γ P e > 0 for some e > 0 also proves that the chain leaks
(Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences, 1979, chapter 6, M35).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.gains import COMPILED
from solvers.rounding import SLACK, TINY, UNIT, gamma
from solvers.solution import SolverError, Status

DIRECT_STATES = 500
KRYLOV_STEPS = 400
MOST_FILL = 4
REFINEMENTS = 5


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
        value = self._once(constant)
        residual = self._residual(constant, value)
        size = float(np.abs(residual).max(initial=0.0))
        for _ in range(REFINEMENTS):
            if size == 0.0 or not np.isfinite(size):
                break
            better = value + self._once(residual)
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
        if self._once == self._iteration:
            return self._iteration(constant, rtol=1e-2)
        return self._once(constant)

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

    @property
    def _once(self) -> Callable[[Floats], Floats]:
        if self.order is not None:
            return self._substitution
        if self.transition.shape[0] <= DIRECT_STATES or self._banded:
            return self._sparse
        return self._iteration

    @cached_property
    def _matrix(self) -> sp.csr_array:
        identity = sp.eye_array(self.transition.shape[0], format="csr")
        return identity - self.discount * self.transition

    @cached_property
    def _substitution(self) -> Callable[[Floats], Floats]:
        """Forward substitution in the given order, by which the matrix is triangular."""
        assert self.order is not None
        from scipy.sparse.linalg import spsolve_triangular

        order = np.argsort(self.order, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        rows = self.transition[order]
        column = place[rows.indices]
        row = np.repeat(np.arange(len(order)), np.diff(rows.indptr))
        if (column >= row).any():
            raise ValueError("the chain does not fall along the order given")
        flow = sp.csr_array((-self.discount * rows.data, column, rows.indptr), rows.shape)
        matrix = (flow + sp.eye_array(len(order), format="csr")).tocsr()
        matrix.sort_indices()

        def solve(constant: Floats) -> Floats:
            found = spsolve_triangular(matrix, constant[order], lower=True, unit_diagonal=True)
            return np.asarray(found[place])

        return solve

    def _iteration(self, constant: Floats, rtol: float = 1e-11) -> Floats:
        """BiCGSTAB, and for good sparse elimination once that fails to converge."""
        size = float(np.abs(constant).max())
        if "_sparse" not in self.__dict__ and 0 < size < np.inf:
            found = self._krylov(constant / size, rtol)  # tests for breakdown are absolute
            if found is not None and np.all(np.isfinite(found)):
                return np.asarray(found * size)
        return self._sparse(constant)

    def _krylov(self, constant: Floats, rtol: float) -> Floats | None:
        if self.transition.nnz >= COMPILED:
            from solvers.kernels import krylov

            chain, value = self.transition, np.empty_like(constant)
            rows, room = (chain.indptr, chain.indices, chain.data), np.empty((6, len(value)))
            taken = krylov.bicgstab(
                *rows, float(self.discount), constant, rtol, KRYLOV_STEPS, value, room
            )
            return value if taken >= 0 else None
        from scipy.sparse.linalg import bicgstab

        inverse = sp.diags_array(1 / self._matrix.diagonal())
        found, failed = bicgstab(self._matrix, constant, rtol=rtol, maxiter=KRYLOV_STEPS, M=inverse)
        return None if failed else np.asarray(found)

    @cached_property
    def _banded(self) -> bool:
        """Whether elimination in the given order fills in next to nothing."""
        chain = self.transition
        row = np.repeat(np.arange(chain.shape[0]), np.diff(chain.indptr))
        width = int(np.abs(chain.indices - row).max(initial=0))
        return bool(2 * width * chain.shape[0] <= MOST_FILL * chain.nnz)

    @cached_property
    def _sparse(self) -> Callable[[Floats], Floats]:
        from scipy.sparse.linalg import splu

        # Rows dominated by their diagonal need no exchanges, so a band stays one.
        ordering = {"permc_spec": "NATURAL", "diag_pivot_thresh": 0.0} if self._banded else {}
        try:
            factor: Any = splu(self._matrix.tocsc(), **ordering)
        except RuntimeError as error:
            raise SolverError(Status.NO_BOUND, f"elimination failed ({error})") from error
        return lambda constant: np.asarray(factor.solve(constant))


def policy_chain(mdp: MDP, pairs: Integers) -> tuple[sp.csr_array, Floats]:
    """Return the (S, S) transitions, terminal rows emptied, and (S,) rewards of `pairs` (S,)."""
    chain = mdp.transition[pairs]
    if mdp.terminal.any():
        chain.data[np.repeat(mdp.terminal, np.diff(chain.indptr))] = 0.0
        chain.eliminate_zeros()
    return chain, np.where(mdp.terminal, 0.0, mdp.reward[pairs])
