"""The one loop of all solvers that improve values, and what brings values nearer to the optimum.

    repeat:  a pass over all pairs: T h - h, a greedy policy, bounds; then a step of the solver

A pass over values h finds low and high with h + low w ≤ V^π ≤ V* ≤ h + high w, rounding apart
(`solvers.bounds.bounds`). Where no way leads to an end (w = 1), h need be right only up to what all
values have in common, the `level`: d(h) = level, rather than 0 (relative value iteration, White, J.
Math. Anal. Appl. 6, 1963; bounds by MacQueen, J. Math. Anal. Appl. 14, 1966), so that h is as small
as values differ and loses no digits next to discount 1. Passes over large models leave out pairs
that are beaten, as values have not risen enough since they were looked at to make up for it
(MacQueen, Operations Research 15, 1967).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from functools import cached_property
from numbers import Real
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.errors import ModelError, ShapeError, locate_errors, require_type
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.forms.threads import block_ends, run_blocks
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import COMPILED, Floats, Integers
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.bounds import (
    Bounds,
    bound_optimal_values,
    evaluate_pairs,
    margin_weights,
)
from exact_mdp.solvers.bounds.gains import UNIT, largest_error, rounding_facts
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain, sweep_system
from exact_mdp.solvers.solution import (
    Solution,
    SolverError,
    Status,
    solve_negated,
    warn_of_precision,
)

RELATIVE_TOLERANCE = 1e-9
CACHED = 1_000_000  # transitions, 12 MB: beyond a cache, rows are read faster side by side
NEARLY_ONE = 1 - 1e-7  # a discount so near to 1 that values are too large to be solved for
PRICE = 2000  # sweeps in whose time the equations of a policy are solved, where no band tells it
BAND = 8  # multiplications within a band that take the time of a transition
PATIENCE, LONG = 20, 200  # passes without progress: near rounding errors, and anywhere
FEW, MANY = 100, 10_000  # passes that bring too little, whatever is done between them


class Solver(ABC):
    """An algorithm with its settings, and the one verb."""

    name: ClassVar[str]

    def solve(self, model: MDP) -> Solution:
        """Return optimal values, a policy and their error bounds; see `solvers.solve`."""
        if require_type(model, MDP, "model", "give an MDP").sense == "min":
            costs: Solution = solve_negated(model, self.solve)
            return costs
        with np.errstate(over="ignore", invalid="ignore"):
            return self.best(model)

    @abstractmethod
    def best(self, model: MDP) -> Solution:
        """Return the greatest values of a model that is maximised."""


class Values:
    """Values h on their way to V*, and what the last pass over all pairs found around them."""

    def __init__(self, mdp: MDP, value: Floats) -> None:
        """Begin with `value` (S,)."""
        self.mdp, self.value, self.weights = mdp, value, margin_weights(mdp)
        self.facts, self.live = rounding_facts(mdp), ~mdp.terminal
        self.pairs: Integers = np.full(mdp.n_states, -1)  # the greedy policy π
        self.rise = value  # (S,) T h - h
        self.low = self.high = 0.0  # h + low · w ≤ V^π ≤ V* ≤ h + high · w, but for rounding
        self.best, self.idle, self.stable = np.inf, 0, False
        self.passes, self.level = 0, 0.0
        self.relaxed, self._stepped = False, value.copy()
        self.large = mdp.n_transitions >= COMPILED or mdp.n_states > linear.FEW
        self.slow = False  # whether sweeps of a policy take longer than its equations
        self.spent, self.price = 0.0, PRICE * mdp.n_transitions / mdp.n_pairs * mdp.n_states
        self._error, self._climbed, self._before = 0.0, 0.0, np.zeros(mdp.n_states)
        self._solved: tuple[Integers, LinearSystem] | None = None

    # ---- passes over all pairs -----------------------------------------------------------------

    def improve(self) -> None:
        """Pass over all pairs; one is left only for what is better as computed."""
        mdp, before = self.mdp, self.pairs
        # Values that neither `take` nor `correct` left were improved one by one.
        self.relaxed = self.relaxed or not np.array_equal(self.value, self._stepped)
        bottom, top = self._centre_values()
        self._error = largest_error(mdp, bottom, top)
        if not self.live.any():
            self.pairs, self.low, self.high = mdp.pair_offsets[:-1], 0.0, 0.0
        elif self.large:
            self._improve_compiled(bottom, top)
        else:
            self._improve_all()
        half = self.half
        if not np.isfinite(half):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        self.passes, self.spent = self.passes + 1, self.spent + 2 * mdp.n_transitions
        self.stable = bool((self.pairs == before).all())
        self.best, self.idle = (half, 0) if half < 0.9 * self.best else (self.best, self.idle + 1)

    def _centre_values(self) -> tuple[float, float]:
        """Leave out what all values have in common, which would cost digits; return their range."""
        apart = self.weights.uniform and self.live.any()
        values = self.value[self.live] if apart and self.mdp.terminal.any() else self.value
        bottom, top = float(values.min()), float(values.max())
        middle = (top + bottom) / 2
        if apart and abs(middle) > top - bottom:
            self.value = self.live * (self.value - middle)
            self.level += self.facts.leak * middle
            return bottom - middle, top - middle
        return bottom, top

    def _improve_all(self) -> None:
        """Pass over a small model in NumPy, as loading compiled loops takes longer."""
        mdp, value, state, margin = self.mdp, self.value, self.mdp.pair_state, self.weights.margin
        matrix, first = mdp.transition, mdp.pair_offsets[:-1]
        own, (following, here) = value[state], self._places
        steps = matrix.data * (value.take(following) - value.take(here))
        ahead = np.add.reduceat(steps, matrix.indptr[:-1])
        gain = mdp.reward + (mdp.discount * ahead - self.facts.leak * own)
        self.rise = rise = np.maximum.reduceat(gain, first)
        pairs = np.where(self.pairs < 0, first, self.pairs)
        better = np.flatnonzero(rise > gain[pairs])
        if len(better):
            places = np.flatnonzero(gain == rise[state])
            pairs[better] = places[np.searchsorted(places, first[better])]
        self.pairs = pairs
        lowest, highest = rise, rise
        if not self.weights.uniform:
            ratio = gain / margin
            lowest, highest = ratio[pairs], np.maximum.reduceat(ratio, first)
        self.low = float(lowest.min(where=self.live, initial=np.inf))
        self.high = float(highest.max(where=self.live, initial=-np.inf))
        if self.weights.uniform:
            self.low, self.high = self.low / float(margin[0]), self.high / float(margin[0])

    def _improve_compiled(self, bottom: float, top: float) -> None:
        """Pass over a large model, blocks of states on as many threads as there are cores."""
        from exact_mdp.solvers.kernels import bellman

        mdp, ends, model = self.mdp, self._ends, self._model
        self.pairs, self.rise = self.pairs.copy(), np.empty(mdp.n_states)
        climb = mdp.discount * float((self.value - self._before).max())
        self._climbed += climb + 4 * UNIT * (abs(climb) + abs(self._climbed))
        self._before = self.value.copy()
        size = 2 * (top - bottom) + max(-bottom, top) + self.facts.size
        slack = self._error + 16 * UNIT * (abs(self._climbed) + size)
        known = self.value, self.pairs, self._ceilings, self._climbed, slack, self.rise
        extremes = np.empty((len(ends) - 1, 2))

        def improve_block(number: int, first: int, last: int) -> None:
            bellman.improve_states(first, last, model, *known, extremes[number])

        run_blocks(ends, improve_block, mdp.n_transitions)
        self.low, self.high = float(extremes[:, 0].min()), float(extremes[:, 1].max())

    @property
    def half(self) -> float:
        """Half of the gap between the bounds, in units of w."""
        return (self.high - self.low) / 2

    def compute_tolerance(self) -> float:
        """Return the tolerance where none is asked for: a part of the greatest value."""
        centre = self.low / 2 + self.high / 2
        largest = float(np.abs(self.value + centre * self.weights.value).max())
        return RELATIVE_TOLERANCE * max(1.0, largest)

    def bound_rounding(self) -> float:
        """Return how far rounding may have moved the bounds of the pass, at most."""
        return self.weights.bound_rounding(self._error, max(abs(self.low), abs(self.high)))

    def prove_bounds(self) -> Bounds:
        """Return the bounds of the pass, wider by all that rounding may have done to them."""
        value, weight, wide = self.value, self.weights.value, self.bound_rounding()
        low, high = self.low - wide, self.high + wide
        return Bounds(
            value=value, weight=weight, pairs=self.pairs, low=low, high=high
        ).centre_bounds()

    # ---- steps ---------------------------------------------------------------------------------

    def take(self) -> None:
        """Move on to T h, at the level between the bounds.

        Once states were improved one by one, errors differ, and a change of level could bring back
        more than a sweep removes.
        """
        if not self.relaxed:
            self._settle_level()
        self._change_values(self.rise - self.level)

    def _change_values(self, change: Floats) -> None:
        """Add to the values of all states that go on."""
        self.value = self.value + self.live * change
        self._stepped = self.value.copy()

    def relax(self) -> None:
        """Improve each state by what others have become, upward and downward (Gauss-Seidel).

        This carries values along a whole chain of states at once.
        """
        from exact_mdp.solvers.kernels import bellman

        upward = np.arange(self.mdp.n_states)
        for order in (upward, upward[::-1]):
            bellman.relax_states(order, self._model, self.value, self.level)
        self.spent += 4 * self.mdp.n_transitions

    def evaluate(self, goal: float) -> None:
        """Bring values near to those of the policy, or nearer to V* for less than that costs.

        The equations of a small model are solved. Policies of others are swept, until the residual
        falls to a goal, where chains mix soon. Where that was too slow, each round relaxes, and as
        much is spent on that as the equations of a policy cost before these are solved: most
        policies on the way are soon improved upon. One that no longer changes, while bounds hardly
        fall, is solved for at once.
        """
        if not self.large:
            self.correct()
            return
        if not self.slow:
            enough, fine = goal * self.weights.smallest, 8 * UNIT * (goal == 0)
            closed = self.weights.uniform and bool(self.live.all())
            matrix, row = self.mdp.transition, self.pairs
            if self.mdp.n_transitions > CACHED:
                matrix, row = self.system.transition, np.arange(self.mdp.n_states)
            left = self._compute_residual()
            more, done = sweep_system(matrix, row, self.mdp.discount, left, closed, enough, fine)
            if done:
                self._correct_values(more)
                return
            self.price, self.slow = self.system.work / BAND or self.price, True
        due = self.spent >= self.price or (self.stable and self.idle) or goal == 0
        if due:
            self.correct()
            self.spent, self.price = 0.0, self.system.work / BAND or self.price
        else:
            self.take()
        if not (due and (self.stable or self.idle < 5)):
            self.relax()

    def correct(self, *, closely: bool = False) -> None:
        """Solve the equations of the policy, h + γ P_π x + T_π h - h: iterative refinement.

        What is left of a residual weighs 1 / (1 - γ) times as much in values: where policies are
        improved by these alone, they have to be solved `closely`, or may go round for ever.
        """
        left, system = self._compute_residual(), self.system
        if self.weights.uniform and self.live.any() and NEARLY_ONE < self.mdp.discount < 1:
            self._correct_values(*system.solve_relatively(left, self.live * self.weights.margin))
        else:
            self._correct_values(system.solve_roughly(left, closely=closely))

    def _compute_residual(self) -> Floats:
        """Return what a step of the policy adds to values, beyond the level between the bounds."""
        self._settle_level()
        return self.live * (self.rise - self.level)

    def _correct_values(self, more: Floats, common: float = 0.0) -> None:
        """Correct the values; what all of them have in common is left out where it is no matter."""
        if self.weights.uniform:
            middle = float(more.max() + more.min()) / 2
            more = more - middle
            self.level += self.facts.leak * (middle + common)
        self._change_values(more)

    def _settle_level(self) -> None:
        """Set the level to the middle between two d / m, where there is one."""
        if self.weights.uniform:
            self.level = (self.low / 2 + self.high / 2) * float(self.weights.margin[0])

    @property
    def system(self) -> LinearSystem:
        """The equations of the policy."""
        if self._solved is None or not np.array_equal(self._solved[0], self.pairs):
            self._solved = None  # two of them would take twice the memory
            chain, _ = policy_chain(self.mdp, self.pairs)
            self._solved = self.pairs, LinearSystem(chain, self.mdp.discount)
        return self._solved[1]

    @cached_property
    def _places(self) -> tuple[Integers, Integers]:
        """Where each transition leads, and its own state: (M,), (M,)."""
        matrix = self.mdp.transition
        here = np.repeat(self.mdp.pair_state, np.diff(matrix.indptr))
        return matrix.indices.astype(np.int64), here

    @cached_property
    def _ends(self) -> list[int]:
        return block_ends(self.mdp.transition.indptr[self.mdp.pair_offsets])

    @cached_property
    def _ceilings(self) -> Floats:
        return np.asarray(self.mdp.reward + 2 * self.facts.most_reward_error)

    @cached_property
    def _model(self) -> Any:
        from exact_mdp.solvers.kernels import bellman

        return bellman.build_compiled_model(self.mdp, self.mdp.reward, self.weights.margin)


def iterate_values(mdp: MDP, solver: Any, start: Any) -> Solution:
    """Return the optimum within the solver's `tol`, if any: passes, and a `step` of it after each.

    The step gets the values, and how near those of a policy should come: a tenth of the least error
    yet, and ever less where that has not fallen for some passes; half of the tolerance where the
    policy is the same as before. Where it `evaluates` policies and
    no tolerance is asked for, values are brought as near as floats can be at last, so that ties
    show as ties. Where it does so in `exact` steps, a policy that comes back ends it, once that
    brings its values no nearer.

    Bounds near enough are proven: widened by the greatest rounding error of any pair, or where that
    is too coarse by `bound_optimal_values`, which counts it pair by pair. Bounds of the size of
    rounding errors that fall no longer say that double precision is at its limit; bounds that stay
    large say nothing for as many passes as there are states, as values are carried on by one
    transition in each. Where steps do not evaluate policies and `FEW` passes bring nothing, or
    `MANY` were too few, every second one gives way to an evaluation of its policy.
    """
    started, status, tol = perf_counter(), None, getattr(solver, "tol", None)
    evaluates, exact = solver.evaluates, solver.exact
    values = Values(mdp, read_start_values(mdp, start))
    weight = float(values.weights.value.max(initial=0.0))
    doubt, hurried, seen = 1.0, False, set[bytes]()
    polished = evaluates and not exact and tol is None
    ready = not polished
    for iteration in range(1, solver.max_iterations + 1):
        values.improve()
        half, floor, idle = values.half * weight, values.bound_rounding() * weight, values.idle
        limit = values.compute_tolerance() if tol is None else tol
        stalled = idle >= PATIENCE and half <= 4 * floor
        close = doubt * half <= limit or stalled
        if exact:
            again = values.pairs.tobytes()
            close = again in seen and (close or idle >= 5)
            seen.add(again)
        if close and (stalled or (ready and (values.stable or not polished))):
            if tol is not None:
                reached = values.prove_bounds()
            if tol is None or reached.error > limit:
                reached = bound_optimal_values(
                    mdp, values.value, strict=tol is not None
                ).centre_bounds()
            if exact:
                status = Status.DIRECT
            elif reached.error <= limit:
                status = Status.CONVERGED
            elif stalled and reached.error <= 8 * floor:
                status = Status.PRECISION
            # What fell short of the proven error is not to be taken for the whole of it again.
            doubt = reached.error / half if half > 0 else 1.0
        elif idle >= LONG + 2 * mdp.n_states:
            status = Status.NO_BOUND
        if status is not None:
            break
        part = 10.0 ** min(max(1, idle - 3), 12)
        left = 0.0 if values.stable else values.best / part
        goal = 0.0 if close else max(left, limit / 2 / (weight or 1.0))
        ready = ready or close
        hurried = hurried or (not evaluates and (idle >= FEW or iteration >= MANY))
        if hurried and iteration % 2:
            with suppress(SolverError):
                values.correct()
        else:
            solver.step(values, goal)
    if status in (None, Status.NO_BOUND):
        status = status or Status.ITERATION_LIMIT
        reached = bound_optimal_values(mdp, values.value).centre_bounds()
    return conclude_solution(
        mdp, solver, reached, status=status, iterations=iteration, started=started
    )


def conclude_solution(
    mdp: MDP, solver: Solver, bounds: Bounds, *, status: Status, iterations: int, started: float
) -> Solution:
    """Return the solution; warns where its tolerance is beyond double precision."""
    solution = Solution(
        mdp=mdp,
        value=np.array(bounds.value),
        pairs=bounds.pairs,
        state_error=bounds.state_error,
        regret_bound=bounds.regret,
        status=status,
        method=solver.name,
        solver=repr(solver),
        iterations=iterations,
        seconds=perf_counter() - started,
    )
    if status is Status.PRECISION:
        warn_of_precision(solution.error_bound)
    if status in (Status.ITERATION_LIMIT, Status.NO_BOUND):
        detail = f"{solution.error_bound:.2g} is the error bound after {iterations} iterations"
        raise SolverError(status, detail, solution)
    return solution


def check_tolerance(where: str, tol: Any) -> None:
    """Raise ModelError for a tolerance that is no positive number; True is none."""
    number = isinstance(tol, Real) and not isinstance(tol, bool)
    if tol is not None and not (number and 0 < tol < np.inf):
        shown = tol if number else repr(tol)
        raise ModelError(f"tol is {shown}", where=where, fix="choose a positive number, or None")


def check_counts(where: str, **counts: Any) -> None:
    """Raise ModelError for what is not a whole number from 1 up; True is none."""
    with locate_errors(where):
        for key, count in counts.items():
            require_count(count, key)


# ---- where to begin ------------------------------------------------------------------------------


def read_start_values(mdp: MDP, start: Any) -> Floats:
    """Return (S,) values to begin with: those given, or those of a policy; 0 where all is over."""
    value = np.zeros(mdp.n_states) if start is None else given_values(mdp, start)
    if value is None:
        policy = Policy.of(mdp, start)
        if not policy.deterministic:
            raise ModelError(
                "the policy is mixed: it draws its actions",
                where="start",
                fix="give a solution of this model, a deterministic policy, or an action number "
                "for each state",
            )
        return evaluate_pairs(mdp, np.flatnonzero(policy.weights(mdp)))
    return np.where(mdp.terminal, 0.0, value)


def given_values(mdp: MDP, start: Any) -> Floats | None:
    """Return (S,) values that are given, of a solution or as an array of floats; else None."""
    refuse_masked(start, "start")
    if isinstance(start, Solution):
        start = start.value
    if isinstance(start, list | tuple) and start and all(isinstance(x, float) for x in start):
        start = np.array(start)
    if not (isinstance(start, np.ndarray) and start.dtype.kind == "f" and start.ndim == 1):
        return None
    if start.shape != (mdp.n_states,) or not np.isfinite(start).all():
        raise ShapeError(
            f"values of shape {start.shape}, or not finite, for {mdp.n_states} states",
            where="start",
            fix="give one finite float for each state, or a policy",
        )
    return np.asarray(start, dtype=np.float64)


def negate_start(mdp: MDP, start: Any) -> Any:
    """Return what is known for the model of the other sense: values negated, a policy as it is."""
    if isinstance(start, Solution):
        return start.policy
    value = None if start is None else given_values(mdp, start)
    return start if value is None else -value
