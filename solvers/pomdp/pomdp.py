"""Acting on perceptions with memory: bounds on the best that any controller can be worth.

A controller that remembers what it saw and did needs no more than its belief b over the statuses
(`mdp.care.process`). The optimal value V(x, b), after perceiving, is convex in b, and is
closed in on from both sides by heuristic search (HSVI2: Smith and Simmons, Point-based POMDP
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

from dataclasses import dataclass
from math import inf
from time import perf_counter

from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError
from exact_mdp.solvers.dynamic.stopping import check_counts
from exact_mdp.solvers.pomdp.search import Search, Vectors
from exact_mdp.solvers.solution import Claim


@dataclass(frozen=True, kw_only=True, eq=False)
class BeliefSolution:
    """What the best controller with memory is worth at the start, from both sides.

    Attributes
    ----------
    process : Process
    lower, upper : float
        The optimum lies between them; so does the value of `solvers.pomdp.belief.BeliefController`
        with these vectors.
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
    def claim(self) -> Claim:
        """What is claimed: a sound interval."""
        return Claim.BOUNDED

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper bound."""
        return self.lower, self.upper

    @property
    def gap(self) -> float:
        """Upper less lower bound."""
        return self.upper - self.lower

    def __repr__(self) -> str:
        end = "" if self.closed else "; the limit came first"
        return f"BeliefSolution({self.lower:.6g} to {self.upper:.6g}, {self.trials} trials{end})"


def solve_beliefs(
    process: Process,
    *,
    tolerance: float = 1e-3,
    seconds: float = 10.0,
    max_trials: int = 100_000,
    begin: object = None,
) -> BeliefSolution:
    """Return bounds on the value of the best controller with memory, and one that is within them.

    Parameters
    ----------
    tolerance : the gap at which the search ends, in units of reward
    seconds, max_trials : limits; the bounds are sound wherever it stops. Where trials end it, not
        time, they are the same in every run
    begin : policy on perceived statuses, or a sequence of them, optional
        The lower bound is at least their values. Every available action for ever, unless given.

    Raises
    ------
    ModelError
        For limits that are no positive numbers, and rewards too large for floats.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    >>> found = solve_beliefs(Process.of(mdp, independent([0.9] * 4, [0.8] * 4)), tolerance=1e-6)
    >>> found.closed, f"{found.lower:.4f} {found.upper:.4f}"
    (True, '...')
    """
    for name, limit in (("tolerance", tolerance), ("seconds", seconds), ("max_trials", max_trials)):
        if not limit > 0:
            raise ModelError(f"{name} is {limit}", where="solve_beliefs", fix="give more than 0")
    check_counts("solve_beliefs", max_trials=max_trials)
    from tqdm import tqdm

    started = perf_counter()
    search = Search(process, begin)
    trials = 0
    lower, upper = search.lower, search.upper
    # With `disable=None` there is a bar where stderr is a terminal, and none elsewhere.
    with tqdm(desc="beliefs", unit=" trials", delay=1, disable=None, leave=False) as bar:
        while (
            upper - lower > tolerance and trials < max_trials and perf_counter() - started < seconds
        ):
            search.trial(tolerance, started + seconds)
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
        closed=upper - lower <= tolerance,
    )
