"""The one loop of all solvers that improve values, and what brings values nearer to the optimum.

    repeat:  a pass over all pairs: T V - V, a greedy policy, bounds; then a step of the solver

A pass over values h finds low and high with h + low w ≤ V^π ≤ V* ≤ h + high w, rounding apart
(`solvers.bounds.bounds`). Once these are near enough, they are proven: widened by the greatest
rounding error of any pair, or where that is too coarse by `verify`, which counts it pair by pair.
Where no way leads to an end (w = 1), h need be right only up to what all values have in common, the
`level`: d(h) = level, rather than 0 (relative value iteration, White, J. Math. Anal. Appl. 6, 1963;
bounds by MacQueen, J. Math. Anal. Appl. 14, 1966), so that h is as small as values differ and
loses no digits next to discount 1.

Steps are

    take       h ← T h
    relax      h(s) ← (T h)(s), one state after another, upward and downward in turn: carries values
               along a whole chain of states at once (Gauss-Seidel)
    evaluate   h ← h + x, x = T_π h - h + γ P_π x: by sweeps, until the residual falls to a goal,
               where chains mix soon
    correct    the same by elimination or BiCGSTAB, however slowly chains mix; one correction a pass

Where sweeps of a policy were too slow, each round relaxes, and as much is spent on that as the
equations of a policy cost before these are solved: most policies on the way are soon improved upon.
One that no longer changes, while bounds hardly fall, is solved for at once.

Passes over large models leave out pairs that are beaten, as values have not risen enough since they
were looked at to make up for it (MacQueen, Operations Research 15, 1967; Hastings and van Nunen,
in Markov Decision Theory, 1977). Small models are passed over in NumPy, and policies solved for
directly, as loading compiled loops takes longer than solving them.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property, partial, wraps
from numbers import Real
from time import perf_counter
from typing import Any, Protocol, TypeVar

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError, ShapeError, located
from exact_mdp.mdp.forms.numbers import refuse_masked
from exact_mdp.mdp.forms.threads import block_ends, run_blocks
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import counted
from exact_mdp.solvers.bounds.bounds import Bounds, levels, margin_weights, verify
from exact_mdp.solvers.bounds.gains import UNIT, largest_error, rounding_facts
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.solution import Solution, SolverError, Status, least, warn_of_precision

RELATIVE_TOLERANCE = 1e-9
LOOPS = 10_000  # transitions: from here on compiled loops are worth the third of a second to load
NEARLY_ONE = 1 - 1e-7  # a discount so near to 1 that values are too large to be solved for
PRICE = 2000  # sweeps in whose time the equations of a policy are solved, where no band tells it
PASSES = 3  # in NumPy, as long as solving them there: 2 to 4 do best on 50 to 400 states
BAND = 8  # multiplications within a band that take the time of a transition
PATIENCE, LONG = 20, 200  # passes without progress: near rounding errors, and anywhere
FEW, MANY = 100, 10_000  # passes that bring too little, whatever is done between them
S = TypeVar("S")


class Solver(Protocol):
    """Settings of an algorithm, and the one verb."""

    @property
    def name(self) -> str:
        """Name of the algorithm, as in `SOLVERS`."""

    def solve(self, model: MDP) -> Solution:
        """Return values, a policy and their error bounds."""


def of_costs(solve: Callable[[S, MDP], Solution]) -> Callable[[S, MDP], Solution]:
    """Return a solver's method that takes models of costs too, whose negation it maximises."""

    @wraps(solve)
    def door(self: S, model: MDP) -> Solution:
        if isinstance(model, MDP) and model.sense == "min":
            solution: Solution = least(model, partial(solve, self))
            return solution
        with np.errstate(over="ignore", invalid="ignore"):
            return solve(self, model)

    return door


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """What one pass over all pairs found around h, but for rounding errors."""

    step: Floats  # (S,) T h - h
    low: float  # h + low · w ≤ V^π ≤ V* ≤ h + high · w, for the greedy policy π
    high: float

    @property
    def half(self) -> float:
        """Half of the gap between the bounds, in units of w."""
        return (self.high - self.low) / 2


class Values:
    """Values h on their way to V*, and the greedy policy of the last pass."""

    def __init__(self, mdp: MDP, value: Floats) -> None:
        """Begin with `value` (S,)."""
        self.mdp, self.value, self.weights = mdp, value, margin_weights(mdp)
        self.facts, self.live = rounding_facts(mdp), ~mdp.terminal
        self.pairs: Integers = np.full(mdp.n_states, -1)
        self.best, self.idle, self.stable = np.inf, 0, False
        self.passes, self.level, self.relaxed = 0, 0.0, False
        self.large = mdp.n_transitions >= LOOPS
        self.slow = not self.large  # whether sweeps are too slow, or equations cost less
        self.spent, self.price = 0.0, 2.0 * PASSES * mdp.n_transitions
        if self.large:
            self.price = PRICE * mdp.n_transitions / mdp.n_pairs * mdp.n_states
        self._error, self._rise, self._before = 0.0, 0.0, np.zeros(mdp.n_states)
        self._solved: tuple[Integers, LinearSystem] | None = None

    # ---- passes over all pairs -----------------------------------------------------------------

    def improve(self) -> Pass:
        """Return a pass over all pairs; a pair is left only for what is better as computed."""
        mdp, before = self.mdp, self.pairs
        if self.weights.uniform and self.live.any():
            self._centre()
        bottom, top = float(self.value.min()), float(self.value.max())
        self._error = largest_error(mdp, bottom, top)
        if self.large:
            from exact_mdp.solvers.kernels import bellman

            self.pairs, step = before.copy(), np.empty(mdp.n_states)
            climb = mdp.discount * float((self.value - self._before).max())
            self._rise += climb + 4 * UNIT * (abs(climb) + abs(self._rise))
            self._before = self.value.copy()
            size = 2 * (top - bottom) + max(-bottom, top) + self.facts.size
            slack = self._error + 16 * UNIT * (abs(self._rise) + size)
            known = self.pairs, self._ceilings, self._rise, slack
            low, high = self._blocks(bellman.improve, self.value, *known, step)
        else:
            step, low, high = self._improve_all()
        if not self.live.any():
            low = high = 0.0
        if not np.isfinite(high - low):
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        self.passes, self.spent = self.passes + 1, self.spent + 2 * mdp.n_transitions
        self.stable = bool((self.pairs == before).all())
        half = (high - low) / 2
        self.best, self.idle = (half, 0) if half < 0.9 * self.best else (self.best, self.idle + 1)
        return Pass(step=step, low=low, high=high)

    def _improve_all(self) -> tuple[Floats, float, float]:
        """Return T h - h (S,), and the least and greatest ratio; what `bellman.improve` does."""
        mdp, value, state = self.mdp, self.value, self.mdp.pair_state
        matrix, row = mdp.transition, self._entry_pair
        own = value[state]
        ahead = np.bincount(row, matrix.data * (value[matrix.indices] - own[row]), mdp.n_pairs)
        gain = mdp.reward + (mdp.discount * ahead - self.facts.leak * own)
        first = mdp.pair_offsets[:-1]
        step = np.maximum.reduceat(gain, first)
        before = np.where(self.pairs < 0, first, self.pairs)
        better = np.flatnonzero(step > gain[before])
        if len(better):
            places = np.flatnonzero(gain == step[state])
            before[better] = places[np.searchsorted(places, first[better])]
        self.pairs = before
        ratio = gain / self.weights.margin
        low = float(ratio[before[self.live]].min(initial=np.inf))
        return step, low, float(ratio[self._open].max(initial=-np.inf))

    def _centre(self) -> None:
        """Leave out what all values have in common, which would cost digits."""
        values = self.value[self.live] if self.mdp.terminal.any() else self.value
        span, middle = float(np.ptp(values)), float(values.max() + values.min()) / 2
        if abs(middle) > span:
            self.value = self.live * (self.value - middle)
            self.level += self.facts.leak * middle

    def relative(self, swept: Pass) -> float:
        """Return the tolerance where none is asked for: a part of the greatest value."""
        centre = swept.low / 2 + swept.high / 2
        largest = float(np.abs(self.value + centre * self.weights.value).max())
        return RELATIVE_TOLERANCE * max(1.0, largest)

    def floor(self, swept: Pass) -> float:
        """Return how far rounding may have moved the bounds of a pass, at most."""
        weights, large = self.weights, max(abs(swept.low), abs(swept.high))
        return (self._error + large * (weights.error + 8 * UNIT)) / weights.smallest

    def proven(self, swept: Pass) -> Bounds:
        """Return the bounds of a pass, wider by all that rounding may have done to them."""
        value, weight, wide = self.value, self.weights.value, self.floor(swept)
        low, high = swept.low - wide, swept.high + wide
        return Bounds(value=value, weight=weight, pairs=self.pairs, low=low, high=high).centred()

    # ---- steps ---------------------------------------------------------------------------------

    def take(self, swept: Pass) -> None:
        """Move on to T h, at the level between the bounds.

        Once states were improved one by one, errors differ, and a change of level could bring back
        more than a sweep removes.
        """
        if not self.relaxed:
            self._between(swept.low, swept.high)
        self.value = self.value + self.live * (swept.step - self.level)

    def relax(self) -> None:
        """Improve each state in turn by what others have become."""
        from exact_mdp.solvers.kernels import bellman

        upward = np.arange(self.mdp.n_states)
        for order in (upward, upward[::-1]):
            bellman.relax(order, self._model, self.value, self.level)
        self.relaxed, self.spent = True, self.spent + 4 * self.mdp.n_transitions

    def evaluate(self, swept: Pass, goal: float) -> None:
        """Bring values near to those of the policy, or nearer to V* for less than that costs."""
        if not self.slow:
            enough, fine = goal * self.weights.smallest, 8 * UNIT * (goal == 0)
            more, done = self.system.swept(self._left(swept), enough, fine=fine)
            if done:
                self._add(more)
                return
            self.price, self.slow = self.system.work / BAND or self.price, True
        due = self.spent >= self.price or (self.stable and self.idle) or goal == 0
        if due:
            self.correct(swept)
        else:
            self.take(swept)
        if self.large and not (due and (self.stable or self.idle < 5)):
            self.relax()

    def correct(self, swept: Pass, *, closely: bool = False) -> None:
        """Solve the equations of the policy: a step of iterative refinement.

        What is left of a residual weighs 1 / (1 - γ) times as much in values: where policies are
        improved by these alone, they have to be solved `closely`, or may go round for ever.
        """
        left, system = self._left(swept), self.system
        if self.weights.uniform and self.live.any() and NEARLY_ONE < self.mdp.discount < 1:
            self._add(*system.relatively(left, self.live * self.weights.margin))
        else:
            self._add(system.roughly(left, closely=closely))
        self.spent = 0.0
        if self.large:
            self.price = system.work / BAND or self.price

    def _left(self, swept: Pass) -> Floats:
        """Return what a step of the policy adds to values, beyond the level between the bounds."""
        self._between(swept.low, swept.high)
        left = swept.step - self.level
        left *= self.live
        return left

    def _add(self, more: Floats, common: float = 0.0) -> None:
        """Correct the values; what all of them have in common is left out where it is no matter."""
        if self.weights.uniform:
            middle = float(more.max() + more.min()) / 2
            more -= middle
            self.level += self.facts.leak * (middle + common)
        more *= self.live
        self.value = self.value + more

    def _between(self, low: float, high: float) -> None:
        """Set the level to the middle between two d / m, where there is one."""
        if self.weights.uniform:
            self.level = (low / 2 + high / 2) * float(self.weights.margin[0])

    @property
    def system(self) -> LinearSystem:
        """The equations of the policy."""
        if self._solved is None or not np.array_equal(self._solved[0], self.pairs):
            self._solved = self.pairs, LinearSystem(self._chain(), self.mdp.discount)
        return self._solved[1]

    def _chain(self) -> sp.csr_array:
        """Return the transitions of the policy, (S, S)."""
        if not self.large:
            return policy_chain(self.mdp, self.pairs)[0]
        from exact_mdp.solvers.kernels import bellman

        rows, states = self._rows, self.mdp.n_states
        count = bellman.take_rows(self._model, self.pairs, rows)
        parts = rows.data[:count], rows.indices[:count], rows.indptr  # until the next policy
        return sp.csr_array(parts, shape=(states, states))

    @cached_property
    def _entry_pair(self) -> Integers:
        """The pair of each transition."""
        return np.repeat(np.arange(self.mdp.n_pairs), np.diff(self.mdp.transition.indptr))

    @cached_property
    def _open(self) -> Any:
        """The pairs of states that are not terminal."""
        return self.live[self.mdp.pair_state] if self.mdp.terminal.any() else slice(None)

    # ---- what compiled loops take --------------------------------------------------------------

    def _blocks(self, work: Any, *what: Any) -> tuple[float, float]:
        """Run `work` on all blocks of states; return the least and the greatest ratio."""
        ends, model = self._ends, self._model
        extremes = np.empty((len(ends) - 1, 2))
        if len(ends) == 2:
            work(0, ends[1], model, *what, extremes[0])
        else:
            run_blocks(ends, lambda n, first, last: work(first, last, model, *what, extremes[n]))
        low, high = zip(*extremes.tolist(), strict=True)
        return min(low), max(high)

    @cached_property
    def _ends(self) -> list[int]:
        return block_ends(self.mdp.transition.indptr[self.mdp.pair_offsets])

    @cached_property
    def _rows(self) -> Any:
        """Room for the rows of any policy."""
        from exact_mdp.solvers.kernels.linear import Rows

        mdp, matrix = self.mdp, self.mdp.transition
        most = np.maximum.reduceat(np.diff(matrix.indptr), mdp.pair_offsets[:-1]).sum()
        indptr = np.zeros(mdp.n_states + 1, dtype=matrix.indptr.dtype)
        return Rows(indptr, np.empty(most, dtype=matrix.indices.dtype), np.empty(most))

    @cached_property
    def _ceilings(self) -> Floats:
        return np.asarray(self.mdp.reward + 2 * self.facts.most_reward_error)

    @cached_property
    def _model(self) -> Any:
        from exact_mdp.solvers.kernels import bellman

        return bellman.model_of(self.mdp, self.mdp.reward, self.weights.margin, self.facts.leak)


def iterate(
    mdp: MDP,
    solver: Any,
    step: Callable[[Values, Pass, float], None],
    *,
    tol: float | None = None,
    evaluates: bool = False,
    exact: bool = False,
) -> Solution:
    """Return the optimum within `tol`: passes, and a `step` of the solver after each.

    `step` gets the values, the last pass, and how near values of a policy should come: a tenth of
    the least error yet, and ever less where that has not fallen for some passes. Where it
    `evaluates` policies and no tolerance is asked for, values are brought as near as floats can be
    at last, so that ties show as ties. Where it does so in `exact` steps, a policy that comes back
    ends it, once that brings its values no nearer.

    Bounds of the size of rounding errors that fall no longer say that double precision is at its
    limit; bounds that stay large say nothing for as many passes as there are states, as values are
    carried on by one transition in each. Where steps do not evaluate policies and `FEW` passes
    bring nothing, or `MANY` were too few, each is followed by an evaluation of its policy.
    """
    started, status = perf_counter(), None
    values = Values(mdp, values_of(mdp, solver.start))
    weight = float(values.weights.value.max(initial=0.0))
    doubt, hurried, seen = 1.0, False, set[bytes]()
    polished = evaluates and not exact and tol is None
    ready = not polished
    for iteration in range(1, solver.max_iterations + 1):
        swept = values.improve()
        half, floor, idle = swept.half * weight, values.floor(swept) * weight, values.idle
        limit = values.relative(swept) if tol is None else tol
        stalled = idle >= PATIENCE and half <= 4 * floor
        close = doubt * half <= limit or stalled
        if exact:
            again = values.pairs.tobytes()
            close = again in seen and (close or idle >= 5)
            seen.add(again)
        if close and (stalled or (ready and (values.stable or not polished))):
            reached = values.proven(swept) if tol is not None else None
            if reached is None or reached.error > limit:
                reached = verify(mdp, values.value, strict=tol is not None).centred()
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
        goal = 0.0 if close else max(values.best / part, limit / 2 / (weight or 1.0))
        ready = ready or close
        hurried = hurried or (not evaluates and (idle >= FEW or iteration >= MANY))
        if hurried and iteration % 2:
            with suppress(SolverError):
                values.correct(swept)
        else:
            step(values, swept, goal)
    if status in (None, Status.NO_BOUND):
        status = status or Status.ITERATION_LIMIT
        reached = verify(mdp, values.value).centred()
    return conclude(mdp, solver, reached, status=status, iterations=iteration, started=started)


def conclude(
    mdp: MDP, solver: Solver, bounds: Any, *, status: Status, iterations: int, started: float
) -> Solution:
    """Return the solution; warns where its tolerance is beyond double precision.

    `bounds` are Bounds, or what has a value, pairs, state_error and regret, too;
    `started` is the `perf_counter()` at which the solver began.
    """
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
        message = f"the error bound is {solution.error_bound:.2g}: {status}"
        warn_of_precision(message)
    if status in (Status.ITERATION_LIMIT, Status.NO_BOUND):
        detail = f"{solution.error_bound:.2g} is the error bound after {iterations} iterations"
        raise SolverError(status, detail, solution)
    return solution


def check_settings(solver: Any) -> None:
    """Raise ModelError for a `tol` that is not positive, or another number below 1."""
    name = type(solver).__name__
    settings = {
        field.name: getattr(solver, field.name) for field in fields(solver) if field.name != "start"
    }
    check_tolerance(name, settings.pop("tol", None))
    check_counts(name, **settings)


def check_tolerance(where: str, tol: Any) -> None:
    """Raise ModelError for a tolerance that is no positive number; True is none."""
    number = isinstance(tol, Real) and not isinstance(tol, bool)
    if tol is not None and not (number and 0 < tol < np.inf):
        shown = tol if number else repr(tol)
        raise ModelError(f"tol is {shown}", where=where, fix="choose a positive number, or None")


def check_counts(where: str, **counts: Any) -> None:
    """Raise ModelError for what is not a whole number from 1 up; True is none."""
    with located(where):
        for key, count in counts.items():
            counted(count, key)


# ---- where to begin ------------------------------------------------------------------------------


def values_of(mdp: MDP, start: Any) -> Floats:
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
        value = evaluated(mdp, np.flatnonzero(policy.weights(mdp)))
    return np.where(mdp.terminal, 0.0, value)


def evaluated(mdp: MDP, pairs: Integers) -> Floats:
    """Return (S,) the values of the policy that takes `pairs` (S,), up to rounding."""
    chain, reward = policy_chain(mdp, pairs)
    return LinearSystem(chain, mdp.discount, order=levels(mdp)).approximate(reward)


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


def opposite(mdp: MDP, start: Any) -> Any:
    """Return what is known for the model of the other sense: values negated, a policy as it is."""
    if isinstance(start, Solution):
        return start.negated(start.mdp.maximised) if start.mdp.sense == "min" else start.policy
    value = None if start is None else given_values(mdp, start)
    return start if value is None else -value
