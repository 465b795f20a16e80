"""Solutions: the values of all states with their error bounds, and a policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.questions.ending import describe_sense
from exact_mdp.mdp.report import Report
from exact_mdp.mdp.result import ROWS_SHOWN, DataFrame, Pictured, data_frame, plain_report
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.claims import Bounded, Claim, SolverError, Status


class Valued:
    """A result with the `value` (S,) of each state of an `mdp`, and its `error` bound (S,)."""

    @property
    def error_bound(self) -> float:
        """The greatest error of a state whose value is known."""
        own: Any = self
        return float(own.error.max(where=~np.isnan(own.value), initial=0.0))

    @cached_property
    def start(self) -> Bounded:
        """The value of the start distribution with its error bound."""
        own: Any = self
        return at_start(own.mdp, own)

    @property
    def start_value(self) -> float:
        """The value of the start distribution."""
        return self.start.value


def at_start(mdp: MDP, valued: Any) -> Bounded:
    """Return the expectation of numbers `valued.value` (S,) over the start, with its error."""
    states = np.flatnonzero(mdp.start_distribution)
    weights = mdp.start_distribution[states]
    value, error = valued.value[states], valued.error[states]
    # An infinite total reward has no error.
    if not np.isfinite(value).all():
        return Bounded(value=float(weights @ value), error=0.0)
    # The sum over the start rounds; a single state of probability 1 does not.
    units = (len(states) + 3) * 2.0**-52  # twice as many as there are roundings
    rounding = units
    if weights.tolist() == [1.0]:
        rounding = 0.0
    bound = float(weights @ (error + rounding * np.abs(value))) * (1 + 2 * units)
    return Bounded(value=float(weights @ value), error=bound)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Found(Valued):
    """Values with error bounds in every state, and a policy: the base of all solutions."""

    mdp: MDP
    value: Floats  # (S,)
    pairs: Integers | None  # (S,) the pair that the policy takes in each state
    state_error: Floats  # (S,)
    status: Status
    iterations: int
    seconds: float
    claim: Claim = Claim.BOUNDED

    @cached_property
    def policy(self) -> Any:
        """The policy, whose `rule` (S,) holds action numbers; None if it was given."""
        if self.pairs is None:
            return None
        mdp = self.mdp
        return Policy(space=mdp.space, actions=mdp.actions, rule=mdp.pair_action[self.pairs])

    @property
    def error(self) -> Floats:
        """(S,) the error bound of each value."""
        return self.state_error

    def frame(self) -> DataFrame:
        """Return the value, its error bound and the action of each state."""
        return self._tabulate_states(self.mdp.n_states)

    def _tabulate_states(self, n: int) -> DataFrame:
        columns = {"value": self.value[:n], "error": self.error[:n]}
        if self.pairs is None:
            taken = {}
        else:
            taken = {"action": self.mdp.pair_action[self.pairs[:n]]}
        return tabulate_by_state(self.mdp, columns | taken)

    def report(self) -> Report:
        """Return the facts of the result and a table of its first states."""
        return plain_report(self, self._tabulate_states(ROWS_SHOWN), self.mdp.n_states)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Solution(Found, Pictured):
    """Values and policy of a solved model, with bounds that hold in every state.

    Attributes
    ----------
    mdp : MDP
    value : (S,)
        State values V.
    pairs : (S,) int64
        The pair that the policy takes in each state.
    state_error : (S,)
        Upper bounds on |V(s) - V*(s)| and |V(s) - V^π(s)|, for the policy π of this solution.
    regret_bound : float
        An upper bound on V*(s) - V^π(s), or for costs V^π(s) - V*(s), in every state.
    status : Status
    method, solver : str
        Name of the algorithm, as in `SOLVERS`, and the solver with its settings.
    iterations : int
    seconds : float
    claim : Claim

    Examples
    --------
    >>> from exact_mdp.solvers import solve
    >>> solution = solve(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]))
    >>> solution.value.tolist(), solution.policy.rule.tolist(), solution.start.interval
    ([3.0, 0.0], [1, 0], (2.99..., 3.00...))
    >>> solution.frame().action.tolist(), solution.q.tolist(), solution.gap_table.tolist()
    (['1', '0'], [[1.0, 3.0], [0.0, 0.0]], [[2.0, 0.0], [0.0, 0.0]])
    """

    pairs: Integers
    regret_bound: float
    method: str
    solver: str

    @property
    def q(self) -> Floats:
        """(S, A) action values r + γ P V; -inf (for costs inf) if an action is not available."""
        return self.mdp.by_action(self.mdp.backup(self.value), self.mdp.sense.worst)

    @property
    def gap_table(self) -> Floats:
        """(S, A) the suboptimality gap of each action; NaN if it is not available."""
        here, there = self.value[self.mdp.pair_state], self.mdp.backup(self.value)
        return self.mdp.by_action(self.mdp.sense.losses(here, there))

    def negated(self, mdp: MDP) -> Self:
        """Return this solution for `mdp`, the model with negated rewards."""
        return replace(self, mdp=mdp, value=0.0 - self.value)

    def __repr__(self) -> str:
        asked = describe_sense(self.mdp)
        asked = asked and f" ({asked})"
        return (
            f"{type(self).__name__}({self.method}: start value {self.start}{asked}, "
            f"regret at most {self.regret_bound:.1g}, iterations: {self.iterations}, "
            f"{self.seconds:.3g} s; {self.status})"
        )


class Answer(Protocol):
    """An answer about a model of maximised rewards, which can be turned into one about costs."""

    def negated(self, mdp: MDP) -> Self:
        """Return this answer for `mdp`, the model with negated rewards."""


AnswerOf = TypeVar("AnswerOf", bound=Answer)


def answer_maximised(mdp: MDP, answer: Callable[[MDP], AnswerOf]) -> AnswerOf:
    """Return the answer of a model, given a function that knows maximised rewards alone.

    A model of costs is answered by its negation, even by the solution in a SolverError.
    """
    if not mdp.sense.costs:
        return answer(mdp)
    try:
        return answer(mdp.maximised).negated(mdp)
    except SolverError as error:
        if error.solution is not None:
            error.solution = error.solution.negated(mdp)
        raise


def tabulate_by_state(mdp: MDP | None, columns: Mapping[str, Any]) -> DataFrame:
    """Return columns beside the labels of the first states, or their numbers without a model."""
    states = range(len(next(iter(columns.values()))))
    if mdp is None:
        return data_frame({"state": states, **columns})
    names = {"state": mdp.space.labels(states), **columns}
    if "action" in columns:
        names["action"] = [mdp.actions[action] for action in columns["action"].tolist()]
    return data_frame(names)
