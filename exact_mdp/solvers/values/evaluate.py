"""The return of a policy: its mean, its spread, its components, and where it is earned.

    V(s)   = E[r + γ V(s')]                              mean return
    Var(s) = E[(r + γ V(s') - V(s))²] + γ² E[Var(s')]    its variance
    d(s')  = μ(s') + γ Σ_s d(s) P(s, s')                 expected discounted visits
    τ(s)   = 1 + Σ_s' P(s, s') τ(s')                     expected steps until a terminal state
    h(s)   = Σ p + Σ' p h(s')                            probability that an event ever happens

Expectations run over the joint distribution of reward and next state, which a table of expected
rewards does not hold. The second equation adds up squares and so loses no digits to cancellation
(Sobel, Journal of Applied Probability 19, 1982). In the last one the first sum runs over the
outcomes with the event, the second over the others (Puterman, Markov Decision Processes, 1994,
section 6.9; Kemeny and Snell, Finite Markov Chains, 1960, chapter 3). The total of a component is
the sum of visits times rewards.
Every number comes with a bound on its error that is sound in floating point.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, wraps
from math import inf, isfinite, nan, sqrt
from typing import ClassVar, Literal, overload

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.exact import BellmanRows
from exact_mdp.mdp.graph import Mask, find_reachable_nodes
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.advice import ways_out
from exact_mdp.mdp.report import Report, Shown, Table, list_claim_facts
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.arguments import (
    is_average,
    mdp_of,
    require_average_applies,
    require_no_horizon,
)
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, BoundedVector, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.claims import Bounded, Claim, SolverError, in_float
from exact_mdp.solvers.solution import at_start
from exact_mdp.solvers.total import solve_total
from exact_mdp.solvers.values.average import AverageEvaluation, evaluate_average
from exact_mdp.solvers.values.policy_chain import OfPolicy, PolicyChain, PolicyEquations
from exact_mdp.solvers.values.policy_values import find_policy_values
from exact_mdp.solvers.values.returns import return_distribution

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)  # of returns, and of the values of training runs
UNKNOWN = Bounded(value=nan, error=inf)


def _or_unknown(number: Callable[..., Bounded]) -> Callable[..., Bounded]:
    """Return UNKNOWN instead of raising SolverError."""

    @wraps(number)
    def call_or_unknown(*given: object) -> Bounded:
        with suppress(SolverError):
            return number(*given)
        return UNKNOWN

    return call_or_unknown


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Evaluation(OfPolicy, Pictured):
    """A policy's values; everything else about its return is computed on first use.

    Attributes
    ----------
    chain : PolicyChain
        The model under the policy.
    value, error : (S,)
        Mean return from every state, which may be infinite, and a bound on its error. NaN and
        infinity if the mean is unknown: at discount 1 in states that no episode visits, if the
        policy may go on forever in some of them.
    given : PolicyChain
        The chain before classes of states without rewards were made terminal.
    settled : bool
        False if an episode may go on forever and earn rewards: then only the mean is known.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> run = evaluate(Scenario.load("yuan2025"), "random")
    >>> print(f"{run.mean:.4f} {run.sd:.4f} {run.steps:.4f} {run.skip_probability:.4f}")
    85.0285 71.5334 7.4267 0.5481
    >>> print(run.start)
    85.0285... ± ... (bounded)
    """

    chain: PolicyChain
    given: PolicyChain
    value: Floats
    error: Floats
    settled: bool = True

    claim: ClassVar[Claim] = Claim.BOUNDED

    @property
    def ends(self) -> bool:
        """True if every episode ends with probability 1."""
        return self.given.ends_from_start

    @property
    def numbers(self) -> dict[str, Bounded]:
        """Every number from the start with its error bound, by name.

        A number that double precision cannot bound is NaN, with an infinite error.
        """
        numbers = {"mean": self.start, "sd": self._sd, "variance": self._start_variance}
        numbers["steps"] = self._steps
        numbers |= {f"component.{name}": number for name, number in self._components.items()}
        return numbers | {f"event.{name}": number for name, number in self._events.items()}

    def frame(self) -> DataFrame:
        """Return every number from the start with its error bound."""
        rows = [(name, number.value, number.error) for name, number in self.numbers.items()]
        return data_frame(rows, columns=["number", "value", "error"])

    def report(self) -> Report:
        """Return the mean, its components and quantiles."""
        shares, finite = self.quantiles or {}, isfinite(self.mean)
        rows = [{"share": share, "return": value} for share, value in shares.items()]
        return Report(
            title="value of a policy",
            facts={
                **list_claim_facts("mean", self.start),
                "sd": Shown(self.sd, self._sd if finite else "undefined: the mean is infinite"),
                "steps": Shown(self.steps, self._steps if self.ends else "inf: it may never end"),
                "ends": Shown(self.ends),
                "skip_probability": Shown(self.skip_probability),
                "event_probability": Shown(self.event_probability, self._events),
                "components": Shown(self.components),
                "quantiles": Shown(self.quantiles, self.quantiles_missing or None),
                "quantiles_missing": Shown(self.quantiles_missing or None),
                "error_bounds": Shown({name: each.error for name, each in self.numbers.items()}),
            },
            tables={
                "totals": Table(
                    title="expected total of each reward component",
                    rows=self._components,
                    columns={"component": "", "total": "value"},
                ),
                "returns": Table(
                    title="quantiles of the return",
                    rows=rows,
                    columns={"share": "share:.0%", "return": "return"},
                ),
            },
        )

    def __repr__(self) -> str:
        return f"Evaluation(mean {self.start}, sd {self.sd:.6g})"

    # ---- the mean and its components ----------------------------------------------------------

    @property
    def components(self) -> dict[str, float]:
        """Expected discounted total of each reward component; they sum to `mean`.

        At discount 1, a component that is earned forever is infinite; NaN if signs differ.
        """
        return {name: number.value for name, number in self._components.items()}

    @cached_property
    def _components(self) -> dict[str, Bounded]:
        mdp, chain = self.mdp, self.chain
        if mdp.components.shape[1] == 1:
            return {mdp.component_names[0]: self.start}
        if not self.settled:
            return {name: self._evaluate_component(name) for name in mdp.component_names}
        try:
            discounted = self._discounted
        except SolverError:
            return dict.fromkeys(mdp.component_names, UNKNOWN)
        # A total is the sum, over all pairs, of expected visits times the component's amount.
        used, doubt = (_pair_visits(chain, x) for x in (discounted.value, discounted.error))
        with np.errstate(over="ignore", invalid="ignore"):
            total, error = self._sum_components(used, doubt)
        numbers = {}
        for name, value, bound in zip(mdp.component_names, total, error, strict=True):
            numbers[name] = UNKNOWN
            if bound < inf:
                numbers[name] = Bounded(value=float(value), error=float(bound))
        if mdp.discount_exact == 1:
            # Visits say nothing of terminal states, and a component may be earned there forever.
            given = self.given
            stays = (mdp.terminal & given.reached)[mdp.pair_state] & (given.weights > 0)
            over = stays & given.mdp.terminal[mdp.pair_state]
            for name, often, ends in zip(
                numbers, *(given.mdp.components[each].T for each in (stays, over)), strict=True
            ):
                if often.any():
                    # Amounts of both signs in different ends: the total has no limit.
                    if (ends < 0).any() and (ends > 0).any():
                        numbers[name] = UNKNOWN
                    else:
                        numbers[name] = self._evaluate_component(name)
        return numbers

    def _evaluate_component(self, name: str) -> Bounded:
        """Return the total of a component under a policy that goes on forever."""
        mdp, given = self.given.mdp, self.given
        # A run that misses the goal has an infinite return, which no component accounts for.
        if mdp.ends.has_goal:
            return UNKNOWN
        # Solve the model of this reward alone, in which the policy's actions are the only ones.
        table = mdp.table.with_reward(*mdp.component(name))
        alone = mdp.with_(table=table, component_names=(name,))
        chain = PolicyChain(mdp=alone, chosen=given.chosen, policy=given.policy)
        with suppress(SolverError, ModelError):
            return solve_total(chain.model).start
        return UNKNOWN

    # ---- the spread --------------------------------------------------------------------------

    @property
    def only_means(self) -> bool:
        """Whether rewards are known only as means over outcomes, which leaves the spread open."""
        table = self.given.mdp.table
        return table.averaged and table.components is None

    @property
    def sd(self) -> float:
        """Standard deviation of the return from the start."""
        return self._sd.value

    @property
    def variance(self) -> Floats:
        """(S,) variance of the return from every state, without error bounds.

        NaN where `value` is not finite, and everywhere if only means of rewards over outcomes are
        known. Near discount 1 only a few digits may be right. `numbers` has the variance from the
        start, with its error bound.
        """
        if not self.settled or self.only_means:
            return np.full(len(self.value), np.nan)
        return np.where(np.isfinite(self.value), self._variance.value, np.nan)

    @cached_property
    def _variance(self) -> BoundedVector:
        chain, rate = self.chain, self.mdp.discount
        live: Mask = ~self.mdp.terminal & np.isfinite(self.value)
        if not chain.gain.any():
            return BoundedVector(value=np.zeros(len(live)), error=np.zeros(len(live)))
        value, error = np.where(live, self.value, 0.0), np.where(live, self.error, 0.0)
        here, there = value[chain.source], value[chain.table.next]
        # An overflow here is refused when the equations are solved.
        with np.errstate(over="ignore", invalid="ignore"):
            # The surprise of an outcome: how far r + γ V(s') is from V(s).
            surprise = chain.gain + rate * there - here
            # Its error: the three operations round, and V itself has an error.
            off = TINY + 5 * UNIT * (np.abs(chain.gain) + rate * np.abs(there) + np.abs(here))
            off += rate * error[chain.table.next] + error[chain.source]
            # The constant is the mean square of surprises. |(x + e)² - x²| <= (2 |x| + |e|) |e|.
            constant = chain.sum_by_state(chain.probability * surprise**2)
            doubt = chain.sum_by_state(chain.probability * (2 * np.abs(surprise) + off) * off)
            doubt += gamma(chain.outcomes + chain.roundings + 5) * constant + TINY
        # Variances are discounted by γ².
        rate_exact = self.mdp.discount_exact
        if rate_exact == 1:
            equations = chain.discounted
        else:
            equations = chain.build_equations(rate_exact**2)
        point = equations.solve(np.where(live, constant, 0.0), np.where(live, doubt, 0.0) * SLACK)
        # A variance cannot be negative; clip rounding errors at 0.
        return BoundedVector(value=np.maximum(point.value, 0.0), error=point.error)

    @cached_property
    @_or_unknown
    def _start_variance(self) -> Bounded:
        if not self.settled or self.only_means:
            return UNKNOWN
        # The law of total variance: the mean variance within start states, and the variance of
        # their means.
        within = at_start(self.mdp, self._variance)
        if np.count_nonzero(self.mdp.start_distribution) == 1:
            return within
        away = self.value - self.mean
        off = self.error + self.start.error + 2 * TINY + 2 * UNIT * np.abs(away)
        with np.errstate(over="ignore"):
            square = BoundedVector(
                value=away**2, error=(2 * np.abs(away) + off) * off + UNIT * away**2
            )
            between = at_start(self.mdp, square)
        total = within.value + between.value
        if not total < inf:
            return UNKNOWN
        return Bounded(value=total, error=(within.error + between.error + UNIT * total) * SLACK)

    @cached_property
    def _sd(self) -> Bounded:
        variance = self._start_variance
        if not np.isfinite(variance.error):
            return variance
        # The root is concave: the error is greatest at one of the ends of the interval.
        sd, least = sqrt(variance.value), sqrt(max(variance.value - variance.error, 0.0))
        most = sqrt(variance.value + variance.error)
        return Bounded(value=sd, error=max(sd - least, most - sd) + 4 * UNIT * most)

    @property
    def quantiles(self) -> dict[float, float] | None:
        """The 5, 25, 50, 75 and 95 % quantiles of the return, by probability.

        None if the distribution of the return cannot be listed: `quantiles_missing` says why.
        """
        if isinstance(self._quantiles, dict):
            return self._quantiles
        return None

    @property
    def quantiles_missing(self) -> str:
        """The reason for missing quantiles; empty if there are quantiles."""
        if isinstance(self._quantiles, str):
            return self._quantiles
        return ""

    @cached_property
    def _quantiles(self) -> dict[float, float] | str:
        try:
            distribution = return_distribution(self.mdp, self.chain)
        except ModelError as error:
            return error.what
        return {share: in_float(distribution.quantile(share)) for share in QUANTILES}

    # ---- visits ------------------------------------------------------------------------------

    @property
    def steps(self) -> float:
        """Expected number of timesteps until a terminal state; infinite if it may never come.

        NaN if the end comes, but so late that the number is beyond the range of floats.
        """
        return self._steps.value

    @cached_property
    @_or_unknown
    def _steps(self) -> Bounded:
        if not self.ends:
            return Bounded(value=inf, error=0.0)
        going = (self.chain.proper & ~self.mdp.terminal).astype(np.float64)
        return at_start(self.mdp, self.chain.undiscounted.solve(going))

    @property
    def occupancy(self) -> Floats:
        """(L,) expected discounted number of uses of each pair; at discount 1 zero at an end."""
        return _pair_visits(self.chain, self._discounted.value)

    @property
    def occupancy_table(self) -> Floats:
        """(S, A) occupancy by state and action; NaN where an action is not available."""
        return self.mdp.by_action(self.occupancy)

    @property
    def visits(self) -> Floats:
        """(S,) expected number of visits to each state, from the start.

        Undiscounted if every episode ends; arriving at a terminal state counts as one visit, so
        that its entry is the probability of ending there. Discounted if an episode may not end.
        """
        if self.ends and self.mdp.discount_exact != 1:
            return self.chain.undiscounted.visits.value
        return self._discounted.value

    @cached_property
    def _discounted(self) -> BoundedVector:
        if not self.settled:
            raise ModelError(
                "the policy goes on forever, so the number of visits is infinite",
                where="visits",
                fix=ways_out(self.mdp),
            )
        return self.chain.discounted.visits

    # ---- events ------------------------------------------------------------------------------

    @property
    def event_probability(self) -> dict[str, float]:
        """Probability that each event of the model ever happens in an episode, undiscounted."""
        return {name: number.value for name, number in self._events.items()}

    @property
    def skip_probability(self) -> float | None:
        """Probability that a subtask is skipped; None if the model has no event `skip`."""
        return self.event_probability.get("skip")

    @cached_property
    def _events(self) -> dict[str, Bounded]:
        bits = self.chain.table.event
        if bits is None:
            return {}
        numbers = {}
        for bit, name in enumerate(self.mdp.events):
            numbers[name] = self._compute_event_probability(bits >> bit & 1 == 1)
        return numbers

    @_or_unknown
    def _compute_event_probability(self, happens: Mask) -> Bounded:
        """Return the probability that one of the marked outcomes (N,) ever happens."""
        chain, states = self.chain, self.mdp.n_states
        source, following = chain.source, chain.table.next
        live = ~self.mdp.terminal[source]
        # The probability that the event happens at once.
        chance = chain.sum_by_state(np.where(happens & live, chain.probability, 0.0))
        # Elsewhere the probability is 0; among these states the equation has a single solution.
        possible = find_reachable_nodes(chain.graph.T.tocsr(), chance > 0)
        # An outcome without the event leads on; its row sums to less than 1.
        on = ~happens & possible[source] & possible[following] & live
        entries = (chain.probability[on], (source[on], following[on]))
        matrix = sp.csr_array(entries, (states, states))
        roundings = chain.roundings + int(chain.outcomes.max())
        system = LinearSystem(matrix, 1.0, order=chain.order, roundings=roundings)

        # The same equations in integers, needed only if floats cannot bound the solution.
        def rows() -> BellmanRows:
            weight, below = chain.exact_outcomes
            return BellmanRows(
                pair_offsets=np.arange(states + 1),
                terminal=self.mdp.terminal,
                scale=below,
                constant=np.zeros_like(below),
                offsets=np.append(0, np.cumsum(np.bincount(source[on], minlength=states))),
                next=following[on],
                weight=weight[on],
            )

        point = PolicyEquations(chain, possible, system, rows).solve(
            chance, gamma(chain.outcomes + chain.roundings) * chance
        )
        ever = BoundedVector(value=np.clip(point.value, 0.0, 1.0), error=point.error)
        return at_start(self.mdp, ever)


def _pair_visits(chain: PolicyChain, visits: Floats) -> Floats:
    """Return (L,) expected discounted uses of each pair; at discount 1 zero at an end."""
    mdp = chain.mdp
    # Visits count one arrival at a terminal state, where a policy stays for 1 / (1 - γ) steps.
    if mdp.discount_exact == 1:
        stay = 0.0
    else:
        stay = float(1 / (1 - mdp.discount_exact))
    return (visits * np.where(mdp.terminal, stay, 1.0))[mdp.pair_state] * chain.weights


@overload
def evaluate(
    model: MDP | Scenario,
    policy: PolicyLike,
    *,
    kind: str = ...,
    horizon: int | None = ...,
    criterion: Literal["total"] = ...,
) -> Evaluation: ...
@overload
def evaluate(
    model: MDP | Scenario, policy: PolicyLike, *, kind: str = ..., criterion: Literal["average"]
) -> AverageEvaluation: ...
@named_options
def evaluate(
    model: MDP | Scenario,
    policy: PolicyLike,
    *,
    kind: str = "auto",
    horizon: int | None = None,
    criterion: str = "total",
) -> Evaluation | AverageEvaluation:
    """Return a policy's expected return, its spread, its components and its visits.

    Parameters
    ----------
    model : MDP or Scenario
    policy : PolicyLike
        "optimal", a solution or a certificate, whatever `Policy.of` takes, or (L,) probabilities of
        pairs.
    kind : "auto", "q" or "policy"
        What a two-dimensional array holds; see `mdp.policies.arrays`.
    horizon : int, optional
        Stop after this many steps, without a further reward: evaluate the policy in
        `mdp.within(horizon)`. A policy over states is the same at every time there; solutions of
        `solve(mdp, horizon=…)` and tables (N, S, A) depend on time.
    criterion : "total" or "average"
        "average" gives the average reward per step in the long run, whatever the discount, the bias
        of each state, and the share of time spent there. "optimal" then has the best average.

    Returns
    -------
    Evaluation or AverageEvaluation

    Raises
    ------
    ModelError
        At discount 1 if one state of the start has value +∞ and another -∞.
    SolverError
        If double precision cannot bound the error, and rational arithmetic would take too long
        (over 4,000 states) or finds a value beyond the range of floats.

    Examples
    --------
    >>> wait, leave = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([wait, leave], [[1, 5], [0, 0]])
    >>> evaluation = evaluate(mdp, [0, 0])
    >>> evaluation.mean, evaluation.steps, evaluation.components, evaluation.quantiles[0.5]
    (2.0, 2.0, {'reward': 2.0}, 1.0)
    """
    mdp = mdp_of(model)
    if is_average(criterion):
        require_no_horizon(horizon)
        require_average_applies(mdp)
        return evaluate_average(PolicyChain.of(mdp, policy, kind=kind, criterion="average"))
    if horizon is not None:
        mdp = mdp.within(horizon)
    given = PolicyChain.of(mdp, policy, kind=kind)
    found = find_policy_values(given)
    return Evaluation(
        chain=found.chain,
        given=given,
        value=found.value,
        error=found.error,
        settled=found.settled,
    )
