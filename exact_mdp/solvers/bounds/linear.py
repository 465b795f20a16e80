"""Solve x = c + γ P x for a nonnegative P, with a bound on the error that is sound.

The values of a policy, its second moments, its expected steps and (with P transposed) its visits
all have this form. At discount 1 the rows of terminal states, where x is 0, have to be empty.

Small chains, and chains with small factors, are solved by elimination. Others are solved by sweeps
if a few suffice, else by BiCGSTAB, and if that does not converge by elimination after all, as long
as the factors fit in memory. Iterative refinement follows. Let k be at least |c + γ P x - x|, its
rounding errors included. If e ≥ 0 satisfies e - γ P e ≥ k, then |x - x*| ≤ e, because (I - γP)⁻¹ is
nonnegative. So the error solves the same equation with the residual as its constant. An e > 0 with
e - γ P e > 0 also proves that I - γP is invertible (Berman and Plemmons, Nonnegative Matrices in
the Mathematical Sciences, 1979, chapter 6, M35).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    COMPILED,
    MOST_NUMBERS,
    ByFields,
    Floats,
    Integers,
    Numbers,
    concatenate_ranges,
)
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, BoundedVector, gamma
from exact_mdp.solvers.claims import SolverError, Status

# Elimination takes milliseconds up to so many states, or transitions, and spares a process with one
# small model the second in which the compiler is loaded; within a band, up to so many
# multiplications, or if the band has at most NARROW times the entries of the chain.
FEW, SPARSE = 500, 5000
CHEAP, NARROW = 2e7, 4
# Each refinement gains the digits of CORRECTION; it stops as soon as one brings little.
REFINEMENTS = 5
FIRST, CORRECTION = 1e-11, 1e-4  # residuals to iterate for, as parts of the constant
SWEEPS = 100  # the most sweeps before BiCGSTAB is tried
# Steps of BiCGSTAB before elimination is tried instead, and if elimination is impossible.
STEPS, PATIENT = 400, 8000
LEAST = 1e-14  # cosines of vectors below this are nothing but rounding

Solve = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class LinearSystem(ByFields):
    """The equation x = c + γ P x for one P and many c."""

    transition: sp.csr_array  # (S, S), nonnegative
    discount: float = 1.0  # γ, itself rounded at most once
    order: Integers | None = None  # (S,) where every entry (s, t) has order[t] < order[s]
    roundings: int = 1  # roundings between an exact probability and its entry in `transition`

    @property
    def states(self) -> int:
        """The number of states, S."""
        return len(self.transition.indptr) - 1

    # ---- errors ------------------------------------------------------------------------------

    @np.errstate(over="ignore", invalid="ignore")
    def solve(self, constant: Floats, constant_error: Floats | float = 0.0) -> BoundedVector:
        """Return x (S,) and its error (S,); raises SolverError if no error can be verified."""
        # The constant k of the error's equation: residual, its rounding, and the error of c.
        value, residual = self._refine_solution(constant)
        rounding = self._bound_rounding(np.abs(constant), np.abs(value))
        excess = (np.abs(residual) * (1 + 4 * UNIT) + rounding + constant_error) * SLACK
        return BoundedVector(value=value, error=self._bound_error(excess))

    def approximate(self, constant: Floats) -> Floats:
        """Return x (S,) for a constant (S,), refined, without any claim about its error."""
        return self._refine_solution(constant)[0]

    def _bound_error(self, excess: Floats) -> Floats:
        """Return e (S,) with e - γ P e ≥ `excess`, verified."""
        largest = float(excess.max())
        if largest == 0.0:
            return np.zeros_like(excess)
        if not np.isfinite(largest):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        # Scaled to 1, and nowhere so small that rounding would swallow the margin.
        wanted = excess / largest + 2.0**-10
        nothing = np.zeros_like(wanted)
        # Any e with e - γ P e > 0 can be scaled to a bound: a rough solution is tried first.
        for rough in (True, False):
            if rough:
                error = self._solve_nearly(wanted, CORRECTION)
            else:
                error = self.approximate(wanted)
            # A lower bound on e - γ P e.
            slack = -self._compute_residual(nothing, error) - self._bound_rounding(
                nothing, np.abs(error)
            )
            if np.all(np.isfinite(error)) and (error > 0).all() and (slack > 0).all():
                return np.asarray(error * (float((excess / slack).max()) * SLACK))
        raise SolverError(Status.NO_BOUND)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _refine_solution(self, constant: Floats) -> tuple[Floats, Floats]:
        """Return x (S,), refined, and its residual in floats."""
        value = self._solve_nearly(constant, FIRST)
        residual = self._compute_residual(constant, value)
        size = float(np.abs(residual).max())
        # The error bound counts n roundings for rows of n terms, however small the residual is:
        # below a part of these, refinement brings nothing.
        floor = max(8.0, float(np.diff(self.transition.indptr).max()) / 4) * UNIT
        floor *= float((np.abs(constant) + np.abs(value)).max())
        for _ in range(REFINEMENTS):
            if not np.isfinite(size) or size <= floor:
                break
            # The correction solves the same equation with the residual as its constant.
            better = value + self._solve_nearly(residual, CORRECTION)
            after = self._compute_residual(constant, better)
            smaller = float(np.abs(after).max())
            if not smaller < size:
                break
            value, residual = better, after
            if smaller > size / 2:
                break
            size = smaller
        return value, residual

    def _compute_residual(self, constant: Floats, value: Floats) -> Floats:
        return np.asarray(constant + self.discount * (self.transition @ value) - value)

    def _bound_rounding(self, constant: Floats, value: Floats) -> Floats:
        """Return a bound on the residual's rounding error, given |c| and |x|."""
        # c + γ Σ p x is a sum of products; the difference from x rounds once more.
        terms = np.diff(self.transition.indptr)
        flow = self.discount * (self.transition @ value)
        total = gamma(terms + self.roundings + 4) * (constant + flow) + 2 * UNIT * value
        largest = float(value.max())
        return np.asarray(total + TINY * (terms + 1) * (largest + (largest > 0)))

    # ---- solving -----------------------------------------------------------------------------

    def solve_roughly(self, constant: Floats, *, closely: bool = False) -> Floats:
        """Return x (S,) with a residual of a hundredth of the constant (S,); `closely` refined."""
        if self._direct:
            return self._direct(constant)
        if closely:
            return self.approximate(constant)
        # Inner products of very small or large numbers leave the range of floats: scale by a power
        # of 2, which rounds no number that counts beside the largest.
        _, power = np.frexp(np.abs(constant).max())
        return np.ldexp(self._solve_iteratively(np.ldexp(constant, -power), 1e-2), power)

    def solve_relatively(self, constant: Floats, leak: Floats) -> tuple[Floats, float]:
        """Return h (S,) and k with h + k = c + γ P (h + k), where h is 0 in one frequent state.

        Values may be as large as 1 / (1 - γ), while h is only as large as their differences.
        Transitions to that state are left out; k times the `leak` (S,) of each row, 1 - γ Σ P,
        takes their place. Leaks are arguments because the floats of P lose them near 1; if rows
        have different leaks, even a small one has to be solved for closely.
        """
        # x = h + k solves h = c + γ P h - k leak. Without transitions to the frequent state, both
        # c and the leak have solutions that are not large; k is chosen so that h is 0 there.
        often, others = self._without_one
        leaked, value, chain = others.approximate(leak), np.zeros_like(constant), self.transition
        level = 0.0
        row = np.repeat(np.arange(len(value)), np.diff(chain.indptr))
        # Each round solves for the residual of the rounds before.
        for _ in range(REFINEMENTS):
            # Differences of neighbours lose no digits to the common part of the values.
            steps = chain.data * (value[chain.indices] - value[row])
            ahead = np.bincount(row, steps, len(value))
            earned = others.solve_roughly(constant + self.discount * ahead - leak * value)
            common = earned[often] / leaked[often]
            value, constant = value + (earned - common * leaked), constant - common * leak
            level += common
        return value, float(level)

    @cached_property
    def _without_one(self) -> tuple[int, LinearSystem]:
        """A state that is visited often, and the system without transitions to it."""
        # Power iteration: after some steps the largest share shows such a state.
        chain, states = self.transition, self.states
        share, back = np.full(states, 1 / states), chain.T.tocsr()
        for _ in range(STEPS):
            share = back @ share
        often = int(np.argmax(share))
        data = np.where(chain.indices == often, 0.0, chain.data)
        rows = sp.csr_array((data, chain.indices, chain.indptr), chain.shape)
        return often, LinearSystem(rows, self.discount)

    def _solve_nearly(self, constant: Floats, rtol: float) -> Floats:
        """Return x (S,), if by iteration then with a residual of `rtol` times the constant."""
        size = float(np.abs(constant).max())
        if size == 0.0:
            return np.zeros(len(constant))
        if not np.isfinite(size):
            return np.full(len(constant), np.nan)
        if self._direct:
            return self._direct(constant)
        # Tests for convergence and breakdown are absolute: scale the constant to 1.
        scaled = constant / size
        # Sweeps are the cheapest, but not tried again once they were slow.
        if not self._slow:
            fine, states = 0.0, np.arange(len(scaled))
            if rtol == FIRST:
                fine = 4 * UNIT
            chain, closed = self.transition, self._closed
            value, done = sweep_system(chain, states, self.discount, scaled, closed, rtol, fine)
            if done:
                return size * value
            self._slow.append(True)
        return size * self._solve_iteratively(scaled, rtol)

    @cached_property
    def _slow(self) -> list[bool]:
        """A list that is empty until sweeps were found to be slow."""
        return []

    @cached_property
    def _closed(self) -> bool:
        """Whether all rows sum to 1, up to rounding, so no state leads to an end."""
        total = self.transition.sum(axis=1)
        return bool(max(total.max() - 1, 1 - total.min()) < 1e-12)

    def _solve_iteratively(self, constant: Floats, rtol: float) -> Floats:
        """Return x (S,) by BiCGSTAB, or by elimination in a band, narrow or as the last resort."""
        # To look for a band takes as long as many sweeps, which are therefore tried before.
        entries = sum(self._band[1:]) * len(constant)
        # Iterate unless elimination is cheap, or has been paid for already.
        if not self.work and "_within_band" not in vars(self):
            steps = STEPS
            if entries > MOST_NUMBERS:
                steps = PATIENT
            value = self._solve_by_bicgstab(constant, rtol, steps)
            if value is not None and np.isfinite(value).all():
                return value
        if entries > MOST_NUMBERS:
            detail = f"iteration does not converge, and the factors of {len(constant):,} equations "
            detail += f"with {self.transition.nnz:,} transitions may have {entries:.1e} entries"
            raise SolverError(Status.TOO_LARGE, detail)
        return self._within_band(constant)

    def _solve_by_bicgstab(self, constant: Floats, rtol: float, steps: int) -> Floats | None:
        """Return x (S,) by BiCGSTAB; None if `steps` do not suffice."""
        # Right preconditioning M: solve (I - γP) M y = c, and x = M y.
        from exact_mdp.solvers.kernels import linear as loops

        chain, rate = self.transition, float(self.discount)
        chain.sort_indices()
        rows = loops.SparseRows(chain.indptr, chain.indices, chain.data)

        def apply_preconditioner(given: Floats) -> Floats:
            out = np.empty_like(given)
            loops.apply_preconditioner(rows, rate, given, out)
            return out

        def apply_system(given: Floats) -> Floats:
            out = np.empty_like(given)
            loops.write_residual(rows, rate, apply_preconditioner(given), out)
            return out

        value = _run_bicgstab(apply_system, constant, rtol, steps)
        if value is None:
            return None
        return apply_preconditioner(value)

    @cached_property
    def _direct(self) -> Solve | None:
        """Solve by elimination; None if that is expensive."""
        chain = self.transition
        # A few states: LAPACK, within a band if this takes fewer operations than S³ / 3.
        if self.states <= FEW:
            lower, upper = self._reach
            if 6 * (lower + 1) * (lower + upper + 1) < self.states**2:
                return _factor_banded(self.discount, lower, upper, chain)
            return _factor_dense(self.discount, chain)
        # An acyclic chain is triangular in topological order: substitution fills in nothing.
        if self.order is not None:
            order = np.argsort(self.order, kind="stable")
            if chain.nnz < COMPILED:
                return self._factor_in_order(self._factor_sparse, order)
            return self._factor_in_order(self._make_substitution, order)
        # Few transitions, or states whose transitions lead near.
        if chain.nnz <= SPARSE and not self.work:
            return self._factor_sparse(chain)
        if chain.nnz <= SPARSE or self._narrow:
            return self._within_band
        return None

    @cached_property
    def _reach(self) -> tuple[int, int]:
        """The bandwidths below and above the diagonal, with states as numbered."""
        return _compute_bandwidths(self.transition, np.arange(self.states))

    @property
    def _narrow(self) -> bool:
        """Whether the band, with states as numbered, is filled well by the chain's entries."""
        chain = self.transition
        return bool(sum(self._reach) * self.states <= NARROW * chain.nnz)

    @cached_property
    def work(self) -> float:
        """The number of multiplications of elimination within a band, if it is small; else 0."""
        _, lower, upper = self._band
        width, states = lower + upper + 1, self.states
        work = 2.0 * states * (lower + 1) * width
        if work <= CHEAP or width * states <= NARROW * self.transition.nnz:
            return work
        return 0.0

    @cached_property
    def _band(self) -> tuple[Numbers | None, int, int]:
        """An order of the states (None: by number), and its bandwidths below and above."""
        chain, (lower, upper) = self.transition, self._reach
        if self._narrow:
            return None, lower, upper
        # Reverse Cuthill-McKee, on the pattern made symmetric, makes bands narrow.
        one = sp.csr_array((np.ones(chain.nnz, np.int8), chain.indices, chain.indptr), chain.shape)
        order = csgraph.reverse_cuthill_mckee((one + one.T).tocsr(), symmetric_mode=True)
        down, up = _compute_bandwidths(chain, np.argsort(order))
        if down + up < lower + upper:
            return (order, down, up)
        return (None, lower, upper)

    @cached_property
    def _within_band(self) -> Solve:
        return self._factor_in_order(
            partial(_factor_banded, self.discount, *self._band[1:]), self._band[0]
        )

    def _factor_sparse(self, chain: sp.csr_array) -> Solve:
        matrix = sp.csc_array(sp.eye_array(self.states) - self.discount * chain)
        matrix.indices, matrix.indptr = (x.astype(np.intc) for x in (matrix.indices, matrix.indptr))
        how = "NATURAL"
        if self.order is None:
            how = "COLAMD"
        try:
            factors: Any = splu(matrix, permc_spec=how, diag_pivot_thresh=0.0)
        except RuntimeError as error:
            raise SolverError(Status.NO_BOUND, f"elimination failed ({error})") from error
        return lambda constant: np.asarray(factors.solve(constant))

    def _make_substitution(self, chain: sp.csr_array) -> Solve:
        """Return forward substitution, for a chain whose states lead to earlier states only."""
        from exact_mdp.solvers.kernels import linear as loops

        chain.sort_indices()
        rows, rate = loops.SparseRows(chain.indptr, chain.indices, chain.data), float(self.discount)

        def solve(constant: Floats) -> Floats:
            out = np.empty_like(constant)
            loops.apply_preconditioner(rows, rate, constant, out)
            return out

        return solve

    def _factor_in_order(
        self, made: Callable[[sp.csr_array], Solve], order: Numbers | None
    ) -> Solve:
        """Return elimination of the chain with its states in another order."""
        if order is None:
            return made(self.transition)
        place, inner = np.argsort(order), made(self.transition[order][:, order])
        return lambda constant: inner(constant[order])[place]


def _run_bicgstab(moves: Solve, constant: Floats, rtol: float, steps: int) -> Floats | None:
    """Return y with `moves`(y) = constant (S,), or None if `steps` do not suffice.

    Van der Vorst, SIAM Journal on Scientific and Statistical Computing 13, 1992.
    """
    from exact_mdp.solvers.kernels.linear import compute_inner_product

    value, fresh = np.zeros_like(constant), True
    enough = rtol * np.sqrt(compute_inner_product(constant, constant))
    for _ in range(steps):
        # (Re)start with the residual as its own shadow: at first, and after a breakdown, when the
        # residual has become orthogonal to the shadow.
        if fresh:
            shadow = residual = constant - moves(value)
            step = onward = np.zeros_like(residual)
            rho = alpha = omega = 1.0
            length = size = np.sqrt(compute_inner_product(residual, residual))
        if size <= enough:
            return value
        # The biconjugate direction, and the step along it.
        before, rho = rho, compute_inner_product(shadow, residual)
        step = residual + rho / before * (alpha / omega) * (step - omega * onward)
        onward = moves(step)
        along = compute_inner_product(shadow, onward)
        far = np.sqrt(compute_inner_product(onward, onward))
        fresh = not (abs(rho) > LEAST * length * size and abs(along) > LEAST * length * far)
        if fresh:
            continue
        alpha = rho / along
        value += alpha * step
        residual = residual - alpha * onward
        size = np.sqrt(compute_inner_product(residual, residual))
        if size <= enough:
            return value
        # The stabilising half step: ω minimises the residual along its own image.
        turn = moves(residual)
        square = compute_inner_product(turn, turn)
        along = compute_inner_product(turn, residual)
        fresh = not abs(along) > LEAST * np.sqrt(square) * size
        if fresh:
            continue
        omega = along / square
        value += omega * residual
        residual = residual - omega * turn
        size = np.sqrt(compute_inner_product(residual, residual))
        if not np.isfinite(size):
            return None
    return None


def _factor_dense(discount: float, chain: sp.csr_array) -> Solve:
    """Return a solver by LAPACK's LU factors of the dense matrix."""
    # LAPACK reads columns: it gets the transpose, and solves the transpose of that.
    matrix = -discount * chain.toarray()
    matrix.flat[:: len(matrix) + 1] += 1.0
    factors, exchanged, failed = lapack.dgetrf(matrix.T, overwrite_a=True)
    if failed:
        raise SolverError(Status.NO_BOUND, f"elimination failed (pivot of state {failed - 1})")
    return lambda constant: np.asarray(lapack.dgetrs(factors, exchanged, constant, trans=1)[0])


def _factor_banded(discount: float, lower: int, upper: int, chain: sp.csr_array) -> Solve:
    """Return a solver by LAPACK's LU factors of the band matrix."""
    # Entry (i, j) lies in row lower + upper + i - j of column j; pivoting needs `lower` rows more.
    states = len(chain.indptr) - 1
    row = np.repeat(np.arange(states), np.diff(chain.indptr))
    places = np.zeros((2 * lower + upper + 1, states), order="F")
    places[lower + upper + row - chain.indices, chain.indices] = -discount * chain.data
    places[lower + upper] += 1.0
    factors, exchanged, failed = lapack.dgbtrf(places, lower, upper, overwrite_ab=True)
    if failed:
        raise SolverError(Status.NO_BOUND, f"elimination failed (pivot of state {failed - 1})")
    return lambda constant: np.asarray(lapack.dgbtrs(factors, lower, upper, constant, exchanged)[0])


def _compute_bandwidths(chain: sp.csr_array, place: Integers) -> tuple[int, int]:
    """Return the bandwidths below and above the diagonal, with states at these places (S,)."""
    ahead = place[chain.indices] - np.repeat(place, np.diff(chain.indptr))
    return int(-ahead.min(initial=0)), int(ahead.max(initial=0))


def sweep_system(
    matrix: sp.csr_array,
    row: Integers,
    discount: float,
    constant: Floats,
    closed: bool,
    enough: float,
    fine: float,
) -> tuple[Floats, bool]:
    """Return x (S,) and whether its residual is `enough`; see `kernels.linear.sweep_system`."""
    from exact_mdp.solvers.kernels import linear as loops

    value, room = np.zeros((2, len(constant)))
    rows, rate = loops.SparseRows(matrix.indptr, matrix.indices, matrix.data), float(discount)
    # After six sweeps their speed is estimated.
    limits = (enough, fine, SWEEPS, 6)
    done = loops.sweep_states(rows, row, rate, constant, closed and rate < 1, *limits, value, room)
    return np.asarray(value), bool(done)


def transpose_system(system: LinearSystem) -> LinearSystem:
    """Return the equation x = c + γ Pᵀ x, which visits satisfy."""
    # Transposed transitions lead the other way round.
    order = None
    if system.order is not None:
        order = -system.order
    return LinearSystem(
        system.transition.T.tocsr(), system.discount, order=order, roundings=system.roundings
    )


def select_rows(
    matrix: sp.csr_array, rows: Integers, states: NDArray[np.bool_], *, inner: bool = False
) -> sp.csr_array:
    """Return the rows (S, S) of some states; other rows, and if `inner` columns, are empty."""
    if states.all():
        return matrix[rows]
    first, last = matrix.indptr[rows], matrix.indptr[rows + 1]
    lengths, entries = last - first, concatenate_ranges(first, last)
    column, inside = matrix.indices[entries], np.repeat(states, lengths)
    # Entries that lead to an end would only widen the band.
    if inner:
        inside &= states[column]
    ends = np.append(0, np.cumsum(inside))[np.append(0, np.cumsum(lengths))]
    parts = matrix.data[entries][inside], column[inside], ends.astype(matrix.indptr.dtype)
    return sp.csr_array(parts, (len(rows), len(rows)))


def policy_chain(
    mdp: MDP, pairs: Integers, reward: Floats | None = None
) -> tuple[sp.csr_array, Floats]:
    """Return transitions (S, S) between states that are not terminal, and rewards (S,)."""
    live = ~mdp.terminal
    if reward is None:
        earned = mdp.reward
    else:
        earned = reward
    chain = select_rows(mdp.transition, pairs, live, inner=True)
    return chain, np.where(live, earned[pairs], 0.0)
