"""Acting on perceptions with memory: bounds on the value of the best controller.

A controller that remembers what it saw and did needs no more than its belief b over the statuses
(`mdp.care.process`). The optimal value V(x, b), after perceiving, is convex in b, and
heuristic search bounds it from both sides (HSVI2: Smith and Simmons, Point-based POMDP
algorithms: improved analysis and implementation, UAI 2005):

    lower    max over vectors α of place x of Σ_s α(s) b(s); each is the value of some controller
    upper    the fast informed bound, and the sawtooth under points (b_i, v_i) that were backed up:
             Σ_s c(s) b(s) + min_i (v_i - Σ_s c(s) b_i(s)) min_s b(s) / b_i(s), c the corners

A trial follows the action of greatest upper bound and the perception of the greatest remaining gap
to the end of the horizon, and backs up both bounds on its way back. Places never come back, so
trials are finite at any discount. Both bounds hold whenever the search is stopped, rounding
included; where there is time they meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from time import perf_counter
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.dynamic.stopping import check_counts
from exact_mdp.solvers.pomdp.search import Search, Vectors
from exact_mdp.solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame

pandas, tqdm = later("pandas"), later("tqdm")


@dataclass(frozen=True, kw_only=True, eq=False)
class BeliefProblem:
    """A model whose status is perceived with errors, to be acted in with memory; `solve` takes it.

    Attributes
    ----------
    model : MDP
        With a column `status`, the one that moves fastest.
    confusion : (Z, Z)
        Probabilities of the perceived status (column) given the true one (row).
    events : sequence of str, optional
        Names of the model's events that the actor notices; all of them unless given.
    seconds, max_trials : float, int
        Limits of the search.

    Examples
    --------
    >>> from exact_mdp import Scenario, solve
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    >>> problem = BeliefProblem(model=mdp, confusion=independent([0.9] * 4, [0.8] * 4))
    >>> solve(problem, tol=1e-6).closed
    True
    """

    model: MDP
    confusion: ArrayLike
    events: Sequence[str] | None = None
    seconds: float = 10.0
    max_trials: int = 100_000

    def solve_with(self, solver: object, tol: float | None) -> BeliefSolution:
        """Return what `solve_beliefs` gives; `solve` calls this."""
        if solver != "auto":
            raise ModelError(
                "a belief problem has one algorithm", where="solve", fix="leave the solver out"
            )
        return solve_beliefs(
            Process.of(self.model, self.confusion, events=self.events),
            tol=1e-3 if tol is None else tol,
            seconds=self.seconds,
            max_trials=self.max_trials,
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BeliefSolution(Result):
    """The value of the best controller with memory at the start, from both sides.

    Attributes
    ----------
    process : Process
    lower, upper : float
        The optimum lies between them; so does the value of the controller that takes, in belief
        b at place x, the action of the vector of x with the greatest α · b.
    vectors : tuple of Vectors
        For each of the P places.
    trials : int
    seconds : float
    closed : bool
        Whether the gap met the tolerance; otherwise time or trials ran out.
    """

    process: Process
    lower: float
    upper: float
    vectors: tuple[Vectors, ...]
    trials: int
    seconds: float
    closed: bool

    @property
    def value(self) -> Bounded:
        """The middle of the interval, and its half width."""
        half = (self.upper - self.lower) / 2
        return Bounded(value=self.lower + half, error=half * (1 + 1e-9) + 2e-16 * abs(self.upper))

    start = value

    @property
    def error(self) -> float:
        """Half the width of the interval."""
        return self.value.error

    @property
    def start_value(self) -> float:
        """The middle of the interval."""
        return self.value.value

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound."""
        return self.lower, self.upper

    def action(self, place: int, belief: Floats) -> str:
        """Return the action to take at a place, in a belief (Z,) after perceiving."""
        known = self.vectors[place]
        number = int(known.action[int((known.value @ belief).argmax())])
        return self.process.mdp.actions[number]

    def frame(self) -> DataFrame:
        """Return both bounds, and how the search ended."""
        row = {"lower (reward)": self.lower, "upper (reward)": self.upper}
        return pandas.DataFrame([row | {"trials": self.trials, "closed": self.closed}])

    def __repr__(self) -> str:
        end = "" if self.closed else "; the limit came first"
        return f"BeliefSolution({self.lower:.6g} to {self.upper:.6g}, {self.trials} trials{end})"


def solve_beliefs(
    process: Process,
    *,
    tol: float = 1e-3,
    seconds: float = 10.0,
    max_trials: int = 100_000,
    begin: object = None,
) -> BeliefSolution:
    """Return bounds on the value of the best controller with memory, and one that is within them.

    Parameters
    ----------
    process : Process
    tol : float
        The gap at which the search ends, in units of reward.
    seconds, max_trials : float, int
        Limits; the bounds are sound wherever it stops. Where trials end it, not time, they are the
        same in every run.
    begin : PolicyLike on perceived statuses, or a sequence of them, optional
        The lower bound is at least their values. Every available action for ever, unless given.

    Returns
    -------
    BeliefSolution

    Raises
    ------
    ModelError
        For limits that are not positive numbers, and rewards too large for floats.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    >>> found = solve_beliefs(Process.of(mdp, independent([0.9] * 4, [0.8] * 4)), tol=1e-6)
    >>> found.closed, f"{found.lower:.4f} {found.upper:.4f}"
    (True, '...')
    """
    for name, limit in (("tol", tol), ("seconds", seconds), ("max_trials", max_trials)):
        if not limit > 0:
            raise ModelError(f"{name} is {limit}", where="solve_beliefs", fix="give more than 0")
    check_counts("solve_beliefs", max_trials=max_trials)
    started = perf_counter()
    search, trials = Search(process, begin), 0
    lower, upper = search.lower, search.upper
    # With `disable=None` there is a bar where stderr is a terminal, and none elsewhere.
    with tqdm.tqdm(desc="beliefs", unit=" trials", delay=1, disable=None, leave=False) as bar:
        while upper - lower > tol and trials < max_trials and perf_counter() - started < seconds:
            search.trial(tol, started + seconds)
            trials += 1
            lower, upper = search.lower, search.upper
            bar.set_postfix_str(f"gap {upper - lower:.3g}", refresh=False)
            bar.update()
    if not -inf < lower <= upper < inf:
        raise ModelError(
            f"the bounds came out as {lower} and {upper}",
            where="solve_beliefs",
            fix="scale the rewards, so that sums of them stay far below 1e308",
        )
    return BeliefSolution(
        process=process,
        lower=lower,
        upper=upper,
        vectors=search.vectors(),
        trials=trials,
        seconds=perf_counter() - started,
        closed=upper - lower <= tol,
    )
