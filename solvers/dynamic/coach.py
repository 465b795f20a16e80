"""The handwashing assistant solved without its matrix, at tens of millions of states.

Users never change, so that each kind of user is a problem of its own. Values are updated in place
from the last plan step to the first (Gauss-Seidel), each time with the best action; between two
such sweeps the chosen actions are followed for some sweeps, which cost a twentieth (modified policy
iteration: M. L. Puterman and M. C. Shin, Management Science 24, 1978, 1127-1137).

The bound. A sweep with the best actions turns U into V, each state's update being off by at most ρ.
With E the greatest |V - V*| and D the greatest |V - U|, a state's update used values that are off
by at most E (new ones) or E + D (old ones), so that

    E ≤ γ (E + D) + ρ,    E ≤ (γ D + ρ) / (1 - γ).

The same holds for the value of the policy that the sweep chose, in place of V*: its regret is at
most twice the bound. A weight is a product and sum of numbers rounded once, 12 roundings at most;
the sum of five products and the sum of weights they are divided by, 18 and 17; scaling, prices and
rewards a few more. All weights are positive, so that 64 units of roundoff, of the greatest reward
and price and of γ times the greatest value, are more than enough for ρ.

Memory: 8 bytes for each state's value and 1 for its action, and the tables of what is remembered,
16 bytes for each memory and action.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from os import cpu_count
from threading import Event
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from exact_mdp.mdp.coach.model import Coach
from exact_mdp.mdp.coach.numbers import BEHAVIOURS, NEXT, RIGHT, STEPS
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.dynamic.stopping import check_tolerance
from exact_mdp.solvers.solution import Bounded, Claim, SolverError, Status

if TYPE_CHECKING:
    from pandas import DataFrame

loops = later("exact_mdp.solvers.kernels.coach")
pandas = later("pandas")

TOLERANCE = 1e-6
FOLLOWED = 10  # sweeps that follow the chosen actions, between two that choose
MOST_SWEEPS = 2_000
ROUNDINGS = 64 * UNIT * (1 + 2.0**-10)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CoachSolution(Result):
    """Values and actions of a handwashing assistant of any size, with bounds that hold.

    Attributes
    ----------
    model : Coach
    value : (S,)
    choice : (S,) int8
        The action taken in each state.
    error_bound : float
        |V(s) - V*(s)| and |V(s) - V^π(s)| are at most this in every state.
    sweeps : int
        Sweeps with the best actions, of the kind of user that took most.
    seconds : float

    Examples
    --------
    >>> from exact_mdp.solvers import solve
    >>> found = solve(Coach())
    >>> print(round(found.start_value, 6), found.claim, found.error_bound < 1e-6)
    27.290143 bounded True
    """

    model: Coach
    value: Floats
    choice: Numbers
    error_bound: float
    sweeps: int
    seconds: float

    claim: ClassVar[Claim] = Claim.BOUNDED

    @property
    def regret_bound(self) -> float:
        """The policy falls short of the optimum by at most this in every state."""
        return 2 * self.error_bound

    @property
    def start(self) -> Bounded:
        """The value at the start."""
        states = np.array([state for state, _ in self.model.start])
        found = self.value[states]
        rounding = (len(states) + 2) * 2.0**-52 * float(np.abs(found).mean())
        return Bounded(value=float(found.mean()), error=self.error_bound * SLACK + rounding)

    @property
    def start_value(self) -> float:
        """The value at the start, without its bound."""
        return self.start.value

    @cached_property
    def policy(self) -> Policy:
        """The policy that is as good as `regret_bound` says."""
        rule = self.choice.astype(np.int64)
        return Policy(space=self.model.space, actions=self.model.actions, rule=rule)

    def frame(self) -> DataFrame:
        """Return a table of the starts: each kind of user, its value and the first action."""
        states = [state for state, _ in self.model.start]
        space = self.model.space
        return pandas.DataFrame(
            {
                "start": [space.label(state) for state in states],
                "value": self.value[states],
                "action": [self.model.actions[self.choice[state]] for state in states],
            }
        )


def solve_coach(model: Coach, tol: float | None = None) -> CoachSolution:
    """Return values and actions of a handwashing assistant, to within `tol` in every state.

    Raises SolverError where double precision or the limit of sweeps is reached first.
    """
    check_tolerance("solve", tol)
    started, asked = perf_counter(), TOLERANCE if tol is None else tol
    block, behaviours = model.n_states // model.n_users, len(BEHAVIOURS)
    value = np.zeros((model.n_users, block))
    choice = np.zeros((model.n_users, block), np.int8)
    rate, leak = float(model.numbers["discount"]), float(1 - model.numbers["discount"])
    memory = model.memory
    tables = (
        np.array([[STEPS.index(step) for step in row] for row in NEXT]),
        np.array([BEHAVIOURS.index(right.split()[0]) for right in RIGHT]),
        np.array(model.asked),
        np.stack([memory.stayed, memory.moved, memory.effect, memory.price])
        .transpose(2, 1, 0)
        .copy(),
        memory.waited,
    )
    stopped = Event()
    stalls, rewards = _floats(model.stalls), _floats(model.rewards())
    repeat = float(model.repeat)

    def work(user: int) -> tuple[float, int]:
        effects = _floats(model.effects) * model.responds(user)
        prices, weights = _floats(model.prices(user)), _floats(model.weights(user))
        earned = float(np.abs(rewards).max() + np.abs(prices).max()) + abs(repeat)
        room = (np.empty(behaviours), *np.empty((2, behaviours), int), np.empty(model.n_actions))
        known, size = np.empty(model.n_actions, int), 0.0

        def sweep(*, improve: bool) -> tuple[float, float]:
            found = np.zeros(2)
            numbers = (effects, prices, stalls, rewards, repeat, rate, improve)
            loops.sweep(value[user], choice[user], weights, *tables, *numbers, *room, known, found)
            return float(found[0]), float(found[1])

        for number in range(1, MOST_SWEEPS + 1):
            if stopped.is_set():
                break
            before = size
            change, size = sweep(improve=True)
            rounding = ROUNDINGS * (earned + rate * max(before, size))
            bound = (rate * change + rounding) / leak * SLACK
            if bound <= asked:
                return bound, number
            if 2 * rounding / leak > asked:
                raise SolverError(Status.PRECISION, f"the error bound is {bound:.2g}")
            for _ in range(FOLLOWED):
                moved, size = sweep(improve=False)
                if moved <= change / 100:
                    break
        raise SolverError(Status.ITERATION_LIMIT, f"{MOST_SWEEPS} sweeps")

    with ThreadPoolExecutor(min(model.n_users, cpu_count() or 1)) as pool:
        try:
            bounds, sweeps = zip(*pool.map(work, range(model.n_users)), strict=True)
        except BaseException:
            stopped.set()  # an interrupt, or one kind of user that fails, stops the others
            raise
    return CoachSolution(
        model=model,
        value=value.reshape(-1),
        choice=choice.reshape(-1),
        error_bound=max(bounds),
        sweeps=max(sweeps),
        seconds=perf_counter() - started,
    )


def _floats(numbers: Sequence[Any]) -> Floats:
    """Return exact numbers, in rows or not, each rounded once."""
    return np.array(numbers, dtype=object).astype(np.float64)
