"""The frame that solvers share: their settings, when to stop, and what to say at the end.

A pass over V = h + c w gives sound bounds h + low w ≤ V^π ≤ V* ≤ h + high w
(`solvers.bounds.sweeps`), so V* is within (high - low) w / 2 of the middle, which is what is
returned once that is small enough. A bound of the size of rounding errors that falls no longer says
that double precision is at its limit; one that stays large for many passes says nothing, as news of
the end travels one step in each.

Values are brought close to those of a policy by sweeps, V ← T_π V, where its chain mixes, or by
linear equations: with d = T_π V - V, V ← V + (I - γ P_π)⁻¹ d. Sweeps go on until the error within
the policy falls to a goal. Where the rate at which it falls says that they would take too many,
what is missing is found from the equations, solved only roughly each time: d is computed anew from
V, so that the errors of one correction are the next one's task (iterative refinement; Dembo,
Eisenstat and Steihaug, SIAM J. Numer. Anal. 19, 1982, on how exactly to solve). Where the equations
are eliminated within a band, what that costs is known: as much is spent on passes over all pairs
before the next policy is evaluated, as most policies on the way are soon improved upon.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import wraps
from numbers import Real
from time import perf_counter
from typing import Any, Protocol, TypeVar

import numpy as np

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import COMPILED, Floats, Integers
from exact_mdp.mdp.validate import counted
from exact_mdp.solvers.bounds.bounds import Bounds, margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.bounds.linear import Banded, LinearSystem, policy_chain, relatively
from exact_mdp.solvers.bounds.sweeps import CompiledSweeps, Judged, Pass, Sweeps, sweeps_of
from exact_mdp.solvers.dynamic import pace
from exact_mdp.solvers.dynamic.known import values_of
from exact_mdp.solvers.solution import Solution, SolverError, Status, warn_of_precision

RELATIVE_TOLERANCE = 1e-9
CORRECTIONS = 30
MANY, FEW = 10_000, 100  # a tenth in each 100 passes is nine digits in 20,000
NEARLY_ONE = 1 - 1e-7  # a discount so near to 1 that values are too large to be solved for
PASS = 20_000  # operations in the time of the calls of one pass
ROUNDS = 200  # of a small model in one compiled call, which cannot be interrupted
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
            return solve(self, model.maximised).negated(model)
        return solve(self, model)

    return door


class Run:
    """The passes of a solver that improves values, from 0 or from those that its `start` gives.

    They go on until the error is proven small.

        run = Run(mdp, solver)              # the solver has `tol` and `max_iterations`
        for found in run:                   # a pass: T V - V around the values so far
            run.values.take(found)          # V ← T V
        return run.solution

    Attributes
    ----------
    values : Iterate
        The values, to be brought nearer to V* between two passes.
    iteration : int
        The number of the pass, from 1.
    ready : bool
        Whether that pass was close enough, rounding errors not counted.
    solution : Solution
        Once the loop has ended; warns where the tolerance is beyond double precision, and raises
        SolverError at the limit of iterations.
    """

    def __init__(self, mdp: MDP, solver: Any, *, polish: bool = False, sweeps: int = 0) -> None:
        """`polish` asks for one more pass once the values are ready, before they are judged.

        With `sweeps`, each pass is a round of modified policy iteration: the loop's body is
        `round`, which compiled code may have gone through many times.
        """
        self._most, self._blank = sweeps, getattr(solver, "start", None) is None
        self._started, self.mdp, self._solver = perf_counter(), mdp, solver
        self._tol, self._polish = solver.tol, polish
        found = sweeps_of(mdp, margin_weights(mdp), strict=self._tol is not None)
        self._weight = float(found.weights.value.max(initial=0.0))
        self.values = Iterate(found, values_of(mdp, getattr(solver, "start", None)))
        self.iteration, self.ready = 0, False
        self._half = self._best = np.inf
        self._mark, self._since = np.inf, 0
        self._idle, self._stalled, self._doubt = 0, False, 1.0
        self._hurried = False
        self._end: tuple[Status, Bounds] | None = None

    def __iter__(self) -> Iterator[Pass]:
        while self._end is None:
            self._hasten()
            self.iteration += 1
            found = self.values.improve(keep=self._since >= pace.SHORT)
            polished = self.ready or not self._polish
            self.ready, patience = self._close(found), self._patience
            # Where nothing is gained, to polish may be what undoes it.
            if self.ready and (polished or self._since >= patience):
                self._end = self._verdict(found)
            if self._end is None and self._since >= patience + pace.PATIENCE:
                self._end = Status.NO_BOUND, self._bounds(found)
            if self._end is None and self.iteration == self._solver.max_iterations:
                self._end = Status.ITERATION_LIMIT, self._bounds(found)
            if self._end is None:
                yield found

    def round(self, found: Pass) -> None:
        """Move on to T V, and from the second pass on to its policy's values."""
        self.values.take(found)
        if self.iteration > 1:
            goal = 0.0 if self.ready else self.goal
            self.values.evaluate(goal, self._most, error=self._half)

    def _hasten(self) -> None:
        """Go through the rounds before the next pass that may be the last, if they are compiled."""
        sweeps, values = self.values.sweeps, self.values
        if not (self._most and isinstance(sweeps, CompiledSweeps) and sweeps.alone):
            return
        alike = self._blank and self.iteration == 0
        if alike or sweeps.mdp.terminal.all():
            return  # nothing for there: values that are all the same need no transition
        count = max(1, ROUNDS * COMPILED // max(COMPILED, sweeps.mdp.n_transitions))
        arrived = False
        while not arrived:
            settings = {
                "tol": float(self._tol or 0.0),
                "relative": RELATIVE_TOLERANCE,
                "polish": self._polish,
                "patience": self._patience,
                "spell": pace.PATIENCE,
                "weight": self._weight,
                "most": self._most,
                "last": self._solver.max_iterations,
                "work": values.work,
                "price": float(values.price),
            }
            state = {
                "shift": values.shift,
                "least": values.least,
                "most": values.most,
                "iteration": self.iteration,
                "ready": self.ready,
                "half": self._half,
                "best": self._best,
                "idle": self._idle,
                "mark": self._mark,
                "since": self._since,
                "doubt": self._doubt,
                "slow": values.slow,
                "spent": float(values.spent),
            }
            state, arrived, due = values.hasten(count, settings, state)
            self.iteration, self.ready = state.iteration, state.ready
            self._half, self._best, self._idle = state.half, state.best, state.idle
            self._mark, self._since = state.mark, state.since
            if due:
                values.correct(0.0 if self.ready else self.goal, error=self._half)

    def hurry(self) -> None:
        """Where passes bring too little, move close to the values of the last pass's policy.

        That is where `MANY` were too few, or would be: where each `FEW` do not bring the error down
        by a tenth. Its linear equations do not mind how slowly news travels. Where there is no room
        for them, passes go on as before.
        """
        if not self._hurried and (self.iteration >= MANY or self._since >= FEW):
            self._hurried, self._since = True, 0
        if self._hurried:
            with suppress(SolverError):
                self.values.evaluate(self.goal, 0, error=self._half)

    @property
    def solution(self) -> Solution:
        """What was found."""
        assert self._end is not None
        status, reached = self._end
        return conclude(
            self.mdp,
            self._solver,
            reached,
            status=status,
            iterations=self.iteration,
            started=self._started,
            stats=self.values.stats,
        )

    @property
    def _patience(self) -> float:
        """How many passes may bring nothing; any number where policies are not evaluated."""
        if not (self._most or self._hurried):
            return np.inf
        values = self.values
        return pace.patience(len(values.value), float(values.price), values.work)

    @property
    def goal(self) -> float:
        """How close to come to a policy's values, in units of w."""
        return float(pace.goal(self._best, self._idle, self._weight, self._tol or 0.0))

    def _limit(self, value: Floats) -> float:
        """Return the greatest absolute error allowed."""
        if self._tol is not None:
            return float(self._tol)
        return RELATIVE_TOLERANCE * max(1.0, float(np.abs(value).max()))

    def _close(self, found: Pass) -> bool:
        """Take note of a pass; return whether it may be the last."""
        value = self.values.value
        reached = pace.advanced(
            found.low,
            found.high,
            found.floor,
            self._weight,
            float(self._tol or 0.0),
            self._best,
            self._idle,
            self._mark,
            self._since,
            self._patience,
        )
        self._half, self._best, self._idle, self._mark, self._since, self._stalled = reached
        if self._stalled:
            return True
        # What the tolerance is relative to is worked out only where it has to be.
        middle = self._middle(found) if self._tol is None else value
        return self._doubt * self._half <= self._limit(middle)

    def _verdict(self, found: Pass) -> tuple[Status, Bounds] | None:
        """Return how it ended, or None where more passes are needed."""
        end = self._bounds(found)
        if end.error <= self._limit(end.value):
            return Status.CONVERGED, end
        # What fell short of the proven error is not to be taken for the whole of it again.
        self._doubt = end.error / self._half if self._half > 0 else 1.0
        near = end.error <= 8 * found.floor * self._weight
        return (Status.PRECISION, end) if self._stalled and near else None

    def _bounds(self, found: Pass) -> Bounds:
        """Return the proven bounds of a pass, around their middle."""
        judged, weight = self.values.judge(found), self.values.sweeps.weights.value
        middle, live = self._middle(judged), weight > 0
        centre = (judged.low + judged.high) / 2
        # The middle is rounded three times, and the lines below a few times more.
        lost = 2 * UNIT * (np.abs(middle) + 2 * abs(centre) * weight)[live] / weight[live]
        rounding = float(lost.max(initial=0.0)) + 8 * UNIT * abs(centre)
        return Bounds(
            value=middle,
            weight=weight,
            pairs=judged.pairs,
            low=(judged.low - centre) * SLACK - rounding,
            high=(judged.high - centre) * SLACK + rounding,
        )

    def _middle(self, found: Pass) -> Floats:
        centre = (found.low + found.high) / 2
        return np.asarray(self.values.value + centre * self.values.sweeps.weights.value)


@dataclass(eq=False)
class Iterate:
    """Values V = h + c w that are being improved."""

    sweeps: Sweeps
    value: Floats  # (S,) h
    shift: float = 0.0  # c, which is 0 but where a shift of all values is only a shift
    least: float = -np.inf  # No state is worth less than this, nor more than the next, about
    most: float = np.inf
    slow: bool = False  # Whether sweeps were found to be too slow for this model
    relaxed: bool = False  # Whether states were ever improved one by one, by `relax`
    spent: float = 0.0  # Operations of passes over all pairs since the last correction
    price: float = 0.0  # Operations of a correction
    stats: dict[str, int] = field(default_factory=dict)  # How often what was done
    ahead: Pass | None = None  # The next pass, where compiled rounds have found it

    def improve(self, *, keep: bool = False) -> Pass:
        """Return a pass over all pairs, whose policy is the one to `evaluate`.

        To `keep` the last one's pairs is to leave them only for what is better by more than
        rounding: where nothing was gained for some passes, ties alone may make policies alternate.
        """
        self.spent += self.work
        if self.ahead is not None:
            found, self.ahead = self.ahead, None
            return found
        self._centre()
        return self.sweeps.improve(self.value, self.shift, keep=keep)

    @property
    def work(self) -> float:
        """Operations of a pass over all pairs."""
        return float(PASS + 2 * self.sweeps.mdp.n_transitions)

    def hasten(
        self, count: int, settings: dict[str, Any], state: dict[str, Any]
    ) -> tuple[Any, bool, bool]:
        """Go through at most `count` compiled rounds; see `solvers.kernels.rounds`.

        Returns the state, whether the next pass is not one for there, and whether to `correct`.
        """
        assert isinstance(self.sweeps, CompiledSweeps)
        reached, found, stopped, due, swept, left = self.sweeps.rounds(
            count, settings, state, self.value
        )
        self.shift, self.least, self.most = reached.shift, reached.least, reached.most
        self.slow, self.spent = reached.slow, reached.spent
        self._count("policies evaluated by sweeps", swept)
        self._count("policies left unevaluated", left)
        self.ahead = found
        return reached, stopped, due

    def judge(self, found: Pass) -> Judged:
        """Return the proven bounds of a pass found here."""
        if isinstance(found, Judged):
            return found
        return self.sweeps.judge(self.value, self.shift)

    def _centre(self) -> None:
        """Hold what all values have in common as a shift, which costs no digits."""
        if self.sweeps.uniform:
            live = ~self.sweeps.mdp.terminal
            values = self.value[live]
            low, high = float(values.min()), float(values.max())
            middle = (low + high) / 2
            if abs(middle) > high - low:
                self.value[live] -= middle
                self.shift += middle

    def take(self, found: Pass) -> None:
        """Move on to T V, and to the middle between the bounds where that is only a shift.

        Errors that are alike in all states stay alike under T, and the middle removes them. Once
        states were improved one by one, errors differ, and the shift to the middle could bring
        back more than a sweep removes: from then on T V is taken as it is. So it is where margins
        are unlike: there the shift decides which pairs seem better.
        """
        if self.sweeps.alike and not self.relaxed:
            ends = float(self.value.min()), float(self.value.max())
            middle, self.least, self.most = pace.middle(
                found.low, found.high, *ends, self.least, self.most
            )
            self.shift += self.sweeps.mdp.discount * (middle - self.shift)
        self.value += found.step

    def relax(self, *, backward: bool) -> None:
        """Improve each state in turn, upward or downward in number, by what others have become."""
        self.sweeps.relax(self.value, self.shift, backward=backward)
        self.relaxed = True

    def evaluate(self, goal: float, most: int, *, error: float = np.inf) -> None:
        """Move close to the values of the policy of the last pass, where it has one.

        `goal` is the error within the policy, in units of w, at which to stop; 0 for as little as
        possible. `most` sweeps are too many. See `correct` for `error`.
        """
        if self.sweeps.policy is None:
            return
        if not self.slow and self._sweep(goal, most):
            self._count("policies evaluated by sweeps")
            return
        self.slow = True
        if self.spent < self.price:
            # More passes bring the policy on for less than it takes to evaluate it.
            self._count("policies left unevaluated")
            return
        self.correct(goal, error=error)

    def correct(self, goal: float, *, error: float = np.inf) -> None:
        """Solve the equations of the policy of the last pass, as nearly as `evaluate` is asked.

        In large models good news is then carried along all states, up and down, before the next
        policy, unless the `error` of the last pass is what doing so may leave: the rounding of the
        shift, of one state after another.
        """
        self._correct(goal)
        self.spent = 0.0
        left = len(self.value) * UNIT * abs(self.shift)
        if self.sweeps.mdp.n_transitions >= COMPILED and goal > 0 and error > left:
            self.sweeps.relax(self.value, self.shift, backward=False)
            self.sweeps.relax(self.value, self.shift, backward=True)

    def _sweep(self, goal: float, most: int) -> bool:
        """Follow the policy; return whether that came as close as asked for."""
        done, self.shift = self.sweeps.settle(self.value, self.shift, goal, most)
        return done

    def _count(self, what: str, times: int = 1) -> None:
        if times:
            self.stats[what] = self.stats.get(what, 0) + times

    def _correct(self, goal: float) -> None:
        pairs = self.sweeps.policy
        assert pairs is not None
        system: LinearSystem | Banded | None = None
        error, relative = np.inf, None
        kept, shift = self.value.copy(), self.shift
        margin = np.where(self.sweeps.mdp.terminal, 0.0, self.sweeps.weights.margin[pairs])
        for _ in range(CORRECTIONS):
            step, low, high = self.sweeps.follow(self.value, self.shift)
            # Only where a shift takes up what errors have in common is the rest all there is.
            before = error
            error = (high - low) / 2 if self.sweeps.uniform else max(-low, high)
            if not error <= before:  # it went astray
                self.value[:], self.shift = kept, shift
                return
            if error <= goal or error > before / 2:
                if self._relative and error <= goal:  # a shift matters where rows leak unalike
                    self.shift += (low + high) / 2
                return
            if system is None:
                system = self._equations(pairs)
                self.price = system.work
                self._count(f"policies evaluated by {system.method}")
                if isinstance(system, LinearSystem) and self._relative:
                    relative = relatively(system, margin)
            kept[:], shift = self.value, self.shift
            if self.sweeps.uniform:
                middle = (low + high) / 2
                self.shift += middle
                step -= middle * margin
            if relative is not None:
                better, level = relative(step)
                self.value += better
                self.shift += level
            else:
                self.value += system.roughly(step)

    @property
    def _relative(self) -> bool:
        """Whether what values have in common is to be solved for apart."""
        return self.sweeps.uniform and self.sweeps.mdp.discount > NEARLY_ONE

    def _equations(self, pairs: Integers) -> LinearSystem | Banded:
        """Return those of a policy that was followed just now."""
        mdp = self.sweeps.mdp
        if isinstance(self.sweeps, CompiledSweeps) and not self._relative:
            found = Banded.of(self.sweeps.held, mdp.terminal, mdp.discount)
            if found is not None:
                return found
        return LinearSystem(policy_chain(mdp, pairs)[0], mdp.discount)


def conclude(
    mdp: MDP,
    solver: Solver,
    found: Any,
    *,
    status: Status,
    iterations: int,
    started: float,
    **parts: Any,
) -> Solution:
    """Return the solution; warns where its tolerance is beyond double precision.

    `found` are Bounds, or what has a value, pairs, state_error and regret, too;
    `started` is the `perf_counter()` at which the solver began, `parts` are more of a Solution.
    """
    solution = Solution(
        mdp=mdp,
        value=np.array(found.value),
        pairs=found.pairs,
        state_error=found.state_error,
        regret_bound=found.regret,
        status=status,
        method=solver.name,
        solver=repr(solver),
        iterations=iterations,
        seconds=perf_counter() - started,
        **parts,
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
