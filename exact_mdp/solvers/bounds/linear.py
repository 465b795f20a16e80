"""Solve x = c + γ P x for a nonnegative P, with a bound on the error that is sound.

    LinearSystem(transition (S, S), discount, order=…).solve(constant (S,)) -> FixedPoint

The values of a policy, its second moments, its expected steps and (with P transposed) its visits
all have this form. The chain must leak: at discount 1 the rows of terminal states, where x is 0,
have to be empty (`policy_chain` does that).

Solving: where an order of the states is known along which the chain only falls, by substitution.
Else by sweeps, where a few lead there, as in chains that mix soon, unless elimination costs less.
That is done within a band, where all transitions are to near numbers, or that costs little, as
the states are numbered or by the order of Reverse Cuthill and McKee (a ring has a narrow one); up
to 500 states, by sparse elimination, as are larger ones of few transitions where the factors stay
small: loading compiled loops would take longer. Otherwise by BiCGSTAB, which does not fill the
matrix. Where that does not converge soon, by sparse elimination, if there is room for its factors;
if not, by GMRES, and by BiCGSTAB with more patience. Steps of iterative refinement follow.

Bounding: let k be at least |c + γ P x - x|, its rounding errors included. If e ≥ 0 satisfies
e - γ P e ≥ k, then |x - x*| ≤ e, because (I - γP)⁻¹ is nonnegative. So the error solves the same
equation with the residual for a constant; what comes out is then verified with the rounding errors
counted. Where k / (1 - γ P 1) is about the same in all states, its maximum will do for e: no other
is below its minimum, as 1 = (I - γP)⁻¹ (1 - γ P 1). That e - γ P e > 0 for some e > 0 also proves
that the chain leaks
(Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences, 1979, chapter 6, M35).

Iteration is compiled (`solvers.kernels.linear`): each step of SciPy's own is some hundred calls. Of
large chains alone, GMRES is tried, which restarts after `DIRECTIONS` steps (Saad and Schultz, SIAM
J. Sci. Stat. Comput. 7, 1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse import linalg as scipy

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import ByFields
from exact_mdp.mdp.table import COMPILED, Floats, Integers, Numbers
from exact_mdp.solvers.bounds import elimination
from exact_mdp.solvers.bounds.elimination import Solve, TooLarge
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gamma
from exact_mdp.solvers.solution import Bounded, SolverError, Status

DIRECT_STATES = 500
IN_ROOM = 2000  # states: factors with limited fill may take minutes of some larger chains
MOST_FILL = 4
CHEAP = 2e7  # multiplications within the band: some milliseconds
REFINEMENTS = 5
FIRST, CORRECTION = 1e-11, 1e-4  # residuals to iterate for, as parts of the constant
SWEEPS, STEPS, PATIENT = 60, 400, 8000
TRIED, CLOSE = 6, 1e-12  # sweeps after which to ask how fast they are; a sum that is nearly 1
ABOUT = 30  # sweeps of chains that mix soon
ALIKE = 2  # how much greater than need be an error bound may be that takes no equations
DIRECTIONS, GMRES_STEPS = 20, 400


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPoint:
    """A solution and how far it may be from the exact one."""

    value: Floats  # (S,)
    error: Floats  # (S,) |value - exact| is at most this, state by state


@dataclass(frozen=True, eq=False)
class LinearSystem(ByFields):
    """The equation x = c + γ P x for one P and many c.

    Attributes
    ----------
    transition : (S, S) csr array, nonnegative
    discount : float
        γ, itself rounded at most once.
    order : (S,) ints, optional
        Known where the chain is acyclic: every entry (s, t) has order[t] < order[s]. For a
        transposed matrix that is the negative of the order.
    roundings : int
        How many times each entry of `transition` was rounded on its way from the exact number:
        1 for rows of `MDP.transition`, about A + 2 for mixtures of them.

    Examples
    --------
    >>> walk = sp.csr_array([[0.5, 0.25], [0.0, 0.0]])
    >>> found = LinearSystem(walk).solve(np.array([1.0, 1.0]))
    >>> found.value.tolist(), bool(found.error.max() < 1e-14)
    ([2.5, 1.0], True)
    """

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
        """Return x (S,) and its error (S,), for a constant that may be off by `constant_error`.

        Raises SolverError where no error can be verified: the chain does not leak, or too slowly.
        """
        value, residual = self._refined(constant)
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
        with np.errstate(divide="ignore", invalid="ignore"):
            each = excess / self._leak
        if (self._leak > 0).all() and each.max() <= ALIKE * each.min():
            return np.full_like(excess, float(each.max()) * SLACK)
        # Of a scale of 1, and nowhere so small that rounding would swallow the margin.
        wanted = excess / largest + 2.0**-10
        nothing = np.zeros_like(wanted)
        for rough in (True, False):
            error = self._nearly(wanted, CORRECTION) if rough else self.approximate(wanted)
            slack = -self._residual(nothing, error) - self._rounding(nothing, np.abs(error))
            if np.all(np.isfinite(error)) and (error > 0).all() and (slack > 0).all():
                return np.asarray(error * (float((excess / slack).max()) * SLACK))
        raise SolverError(Status.NO_BOUND)

    @cached_property
    def _leak(self) -> Floats:
        """(S,) lower bounds of 1 - γ P 1."""
        every = np.ones(self.transition.shape[0])
        nothing = np.zeros_like(every)
        return np.asarray(-self._residual(nothing, every) - self._rounding(nothing, every))

    def approximate(self, constant: Floats) -> Floats:
        """Return x (S,) for a constant (S,), refined, without any claim about its error."""
        return self._refined(constant)[0]

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _refined(self, constant: Floats) -> tuple[Floats, Floats]:
        """Return x (S,), refined, and its residual as computed."""
        value = self._nearly(constant, FIRST)
        residual = self._residual(constant, value)
        size = float(np.abs(residual).max(initial=0.0))
        for _ in range(REFINEMENTS):
            if not np.isfinite(size) or size <= self._floor(constant, value):
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
        return value, residual

    def _floor(self, constant: Floats, value: Floats) -> float:
        """Return the size of a residual that may be rounding alone: to refine it brings nothing.

        Of rows of n terms, the error bound counts n roundings whatever the residual is.
        """
        return self._negligible * UNIT * float((np.abs(constant) + np.abs(value)).max(initial=0.0))

    @cached_property
    def _negligible(self) -> float:
        return max(8.0, float(np.diff(self.transition.indptr).max()) / 4)

    def roughly(self, constant: Floats) -> Floats:
        """Return x (S,) with a residual of about a hundredth of the constant (S,), or smaller.

        For those who have tried sweeps.
        """
        return self._nearly(constant, 1e-2) if self._direct is None else self._direct(constant)

    def _residual(self, constant: Floats, value: Floats) -> Floats:
        return np.asarray(constant + self.discount * (self.transition @ value) - value)

    def _rounding(self, constant: Floats, value: Floats) -> Floats:
        """Return how far the computed residual may be from the exact one, for magnitudes."""
        terms = np.diff(self.transition.indptr)
        flow = self.discount * (self.transition @ value)
        total = gamma(terms + self.roundings + 4) * (constant + flow) + 2 * UNIT * value
        largest = float(value.max(initial=0.0))
        return np.asarray(total + TINY * (terms + 1) * (largest + (largest > 0)))

    @cached_property
    def without_one(self) -> tuple[int, LinearSystem]:
        """A state that is often visited, and the system without what leads there."""
        chain, states = self.transition, self.transition.shape[0]
        share, back = np.full(states, 1 / states), chain.T.tocsr()
        for _ in range(STEPS):
            share = back @ share
        often = int(np.argmax(share))
        kept = np.where(chain.indices == often, 0.0, chain.data)
        others = LinearSystem(
            sp.csr_array((kept, chain.indices, chain.indptr), chain.shape), self.discount
        )
        return often, others

    # ---- solvers -----------------------------------------------------------------------------

    def _nearly(self, constant: Floats, rtol: float) -> Floats:
        """Return x (S,), where it is iterated for with a residual of that part of the constant.

        Sweeps go on to the least residual there is where it is `FIRST`.
        """
        size = float(np.abs(constant).max(initial=0.0))
        if self._mixes[0] and np.isfinite(size) and size > 0:
            fine = 4 * UNIT if rtol == FIRST else 0.0
            # Tests for convergence are absolute.
            found = sweeping(self.transition, self.discount, constant / size, rtol, fine)
            if found is not None:
                return np.asarray(found * size)
            self._mixes[0] = False
        return self._iteration(constant, rtol) if self._direct is None else self._direct(constant)

    @property
    def work(self) -> float:
        """The multiplications of elimination within a band, where that is what is done; else 0."""
        return self._band[1]

    @property
    def work_as_numbered(self) -> float:
        """The same in the order that the states are numbered in."""
        return self._as_numbered[1]

    @cached_property
    def _as_numbered(self) -> tuple[tuple[int, int], float]:
        within = elimination.reach(self.transition)
        return within, _work(self.transition.shape[0], self.transition.nnz, within)

    @cached_property
    def _band(self) -> tuple[tuple[int, int], float, Numbers | None]:
        """How far transitions lead, the multiplications of elimination if it pays, else 0.

        Where it pays in another order of the states alone, that comes third.
        """
        within, work = self._as_numbered
        if work:
            return within, work, None
        order = elimination.near_order(self.transition)
        within = elimination.reach(self.transition, order)
        work = _work(self.transition.shape[0], self.transition.nnz, within)
        return within, work, order if work else None

    @cached_property
    def _direct(self) -> Solve | None:
        """The method that needs no iteration, where there is one that costs little."""
        chain, rate = self.transition, self.discount
        if self.order is not None:
            return elimination.substitution(chain, rate, self.order)
        within, work, order = self._band
        if order is not None:
            inner = elimination.band(chain[order][:, order], rate, within)
            return elimination.reordered(inner, order)
        if work:
            return elimination.band(chain, rate, within)
        return elimination.sparse(chain, rate) if chain.shape[0] <= DIRECT_STATES else None

    def _iteration(self, constant: Floats, rtol: float) -> Floats:
        """Factors in little room, else sweeps, else BiCGSTAB; what is slower once that fails."""
        size = float(np.abs(constant).max(initial=0.0))
        if size == 0.0 or not np.isfinite(size):
            return np.full(len(constant), 0.0 if size == 0.0 else np.nan)
        if self._within_room is not None:
            value = self._within_room(constant)
            left = np.abs(self._residual(constant, value)).max()
            if left <= max(rtol * size, self._floor(constant, value)):
                return value
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
    def _within_room(self) -> Solve | None:
        """Elimination in little room, of chains too small for compiled loops to pay."""
        small = self.transition.nnz < COMPILED and self.transition.shape[0] <= IN_ROOM
        return elimination.in_room(self.transition, self.discount) if small else None

    @cached_property
    def _mixes(self) -> list[bool]:
        """Whether sweeps may be fast: they were never found to be slow, and cost less."""
        if self.order is not None:
            return [False]
        work = self._as_numbered[1]
        return [work == 0 or work > ABOUT * 2 * self.transition.nnz]

    @cached_property
    def _last_resort(self) -> Solve | TooLarge:
        """Sparse elimination, or why not."""
        try:
            return elimination.sparse(self.transition, self.discount)
        except TooLarge as refusal:
            return refusal


def _work(states: int, entries: int, within: tuple[int, int]) -> float:
    """Return the multiplications of elimination `within` a band, if it pays, else 0."""
    work = 2.0 * states * (within[0] + 1) * (sum(within) + 1)
    narrow = sum(within) * states <= MOST_FILL * entries
    return work if narrow or work <= CHEAP else 0.0


def relatively(system: LinearSystem, leak: Floats) -> Solve:
    """Return what finds about h (S,), for any c (S,), with h + k = c + γ P (h + k) for some k.

    h is 0 in a state often visited. Values may be as large as 1 / (1 - γ), h is only as large as
    they differ: what leads to that state is left out, and k times the `leak` (S,) of each row,
    1 - γ Σ P, stands in its place. Leaks are given, as floats of P near 1 do not tell them; where
    rows leak unalike, what is small beside the others has to be found closely, too.
    """
    often, others = system.without_one
    leaked = others.approximate(leak)

    def found(constant: Floats) -> Floats:
        earned = others.roughly(constant)
        return np.asarray(earned - earned[often] / leaked[often] * leaked)

    return found


def at_start(mdp: MDP, found: FixedPoint) -> Bounded:
    """Return the expectation over the start distribution, with its error."""
    states = np.flatnonzero(mdp.start_distribution)
    weights = mdp.start_distribution[states]
    value, error = found.value[states], found.error[states]
    if not np.isfinite(value).all():  # a total reward that is infinite is so exactly
        return Bounded(value=float(weights @ value), error=0.0)
    rounding = 0.0 if weights.tolist() == [1.0] else float(gamma(len(states) + 3))
    bound = float(weights @ (error + rounding * np.abs(value))) * SLACK
    return Bounded(value=float(weights @ value), error=bound)


def transposed(system: LinearSystem) -> LinearSystem:
    """Return the equation x = c + γ Pᵀ x, which visits satisfy."""
    return LinearSystem(
        system.transition.T.tocsr(),
        system.discount,
        order=None if system.order is None else -system.order,
        roundings=system.roundings,
    )


def rows_of(matrix: sp.csr_array, kept: NDArray[np.bool_]) -> sp.csr_array:
    """Return a matrix with the rows that are not `kept` emptied."""
    entries = np.repeat(kept, np.diff(matrix.indptr))
    lengths = np.where(kept, np.diff(matrix.indptr), 0)
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(matrix.indptr.dtype)
    return sp.csr_array((matrix.data[entries], matrix.indices[entries], offsets), matrix.shape)


def policy_chain(mdp: MDP, pairs: Integers) -> tuple[sp.csr_array, Floats]:
    """Return the (S, S) transitions, terminal rows emptied, and (S,) rewards of `pairs` (S,)."""
    chain = mdp.transition[pairs]
    if mdp.terminal.any():
        chain.data[np.repeat(mdp.terminal, np.diff(chain.indptr))] = 0.0
        chain.eliminate_zeros()
    return chain, np.where(mdp.terminal, 0.0, mdp.reward[pairs])


def sweeping(
    chain: sp.csr_array, discount: float, constant: Floats, enough: float, fine: float = 0.0
) -> Floats | None:
    """Return x (S,) with a residual of at most `enough`, or None where sweeps would be too many.

    See `solvers.kernels.linear.swept`, which this is in NumPy for small chains.
    """
    if chain.nnz >= COMPILED:
        value, room = np.empty((2, len(constant)))
        from exact_mdp.solvers.kernels.linear import Rows

        rows = Rows(chain.indptr, chain.indices, chain.data)
        limits = (enough, fine, SWEEPS, TRIED, CLOSE)
        from exact_mdp.solvers.kernels import linear as loops

        done = loops.swept(rows, float(discount), constant, *limits, value, room)
    else:
        value, done = _swept(chain, discount, constant, enough, fine)
    return np.asarray(value) if done and np.all(np.isfinite(value)) else None


def _swept(
    chain: sp.csr_array, discount: float, constant: Floats, enough: float, fine: float
) -> tuple[Floats, bool]:
    states, before, earned = len(constant), np.inf, float(np.abs(constant).max())
    row = np.repeat(np.arange(states), np.diff(chain.indptr))

    def ones(places: Integers) -> bool:
        total = np.bincount(places, chain.data, states)
        return bool(discount < 1 and (np.abs(total - 1) < CLOSE).all())

    whole = ones(row)
    kept = not whole and ones(chain.indices)
    value = np.full(states, np.cumsum(constant)[-1] / (1 - discount) / states if kept else 0.0)
    for sweep in range(SWEEPS):
        room = constant
        if sweep or kept:
            ahead = np.bincount(row, chain.data * value[chain.indices], states)
            room = constant + discount * ahead - value
        low, high = float(room.min()), float(room.max())
        middle = (low + high) / 2 if whole else 0.0
        error = max(high - middle, middle - low)
        value += room + (discount * middle / (1 - discount) if whole else 0.0)
        goal = max(fine * max(earned, float(np.abs(value).max())), 0.0 if fine else enough)
        if error * discount <= goal:
            return value, True
        if sweep >= TRIED and not (
            error < before and error * (error / before) ** (SWEEPS - sweep) <= enough
        ):
            return value, error <= enough
        before = error
    return value, before <= enough


def quickly(chain: sp.csr_array, discount: float, constant: Floats, rtol: float) -> Floats | None:
    """Return x (S,) with a residual of about `rtol` of the constant's, or None after many steps.

    The constant is of magnitude 1 or so.
    """
    return _bicgstab(chain, discount, constant, rtol, STEPS)


def patiently(chain: sp.csr_array, discount: float, constant: Floats, rtol: float) -> Floats | None:
    """Return x (S,), or None where neither GMRES nor `PATIENT` steps of BiCGSTAB lead there."""
    if chain.nnz >= COMPILED:
        rows, shape = _rows(chain), chain.shape
        value, through = np.empty(len(constant)), np.empty(len(constant))

        from exact_mdp.solvers.kernels import linear as loops

        def applied(given: Floats) -> Floats:
            loops.applied(rows, float(discount), np.ascontiguousarray(given), value, through)
            return through.copy()

        right = scipy.LinearOperator(shape, matvec=applied, dtype=np.float64)
        restart = min(DIRECTIONS, GMRES_STEPS)
        rounds = GMRES_STEPS // restart
        given, status = scipy.gmres(right, constant, rtol=rtol, restart=restart, maxiter=rounds)
        applied(given)
        if status == 0 and np.all(np.isfinite(value)):
            return value
    return _bicgstab(chain, discount, constant, rtol, PATIENT)


def _rows(chain: sp.csr_array) -> Any:
    """Return the rows of a chain, their columns sorted, as compiled loops take them."""
    chain = chain if chain.has_sorted_indices else chain.sorted_indices()
    from exact_mdp.solvers.kernels.linear import Rows

    return Rows(chain.indptr, chain.indices, chain.data)


def _bicgstab(
    chain: sp.csr_array, discount: float, constant: Floats, rtol: float, steps: int
) -> Floats | None:
    value, room = np.empty(len(constant)), np.empty((6, len(constant)))
    rows = _rows(chain)
    from exact_mdp.solvers.kernels import linear as loops

    failed = loops.bicgstab(rows, float(discount), constant, rtol, steps, value, room) < 0
    return None if failed or not np.all(np.isfinite(value)) else value
