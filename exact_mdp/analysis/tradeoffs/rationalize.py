"""The weights of the reward for which a policy is optimal: the inverse of solving, exactly.

The reward is r = Σ_c w_c c with w = 1 today. A policy π is optimal from the start under w if and
only if w · (v(π) - v(ρ)) ≥ 0 for every policy ρ, with v the expected totals of the components. The
least change, t* = min over these w of max over c of |w_c - 1|, is a linear program whose rows are
found as they are needed: a policy that beats π at the latest weights is a new row. For one weight
alone the set of weights is an interval, found in the same way.

The proof consists of values V that no policy exceeds at the weights found, with μ V = w · v(π), and
of policies whose rows, with the multipliers of linear programming, exclude any change below t*. (Ng
and Russell, ICML 2000, state the cone for policies that are optimal in all states.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from operator import neg
from typing import ClassVar

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import named_options
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, data_frame
from exact_mdp.solvers.arguments import is_average, mdp_of, require_average_applies
from exact_mdp.solvers.claims import Certified
from exact_mdp.solvers.exact.duals import solve_inequalities, weigh_values
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.averages import reduce_to_totals
from exact_mdp.solvers.objectives.simplex import list_unit_vectors, solve_linear_program
from exact_mdp.solvers.objectives.totals import (
    OccupancyMeasure,
    Point,
    TotalsProof,
    flow_of,
    flow_under,
    list_proof_fields,
    solve_weighted,
)
from exact_mdp.solvers.values.policy_chain import policy_of

ZERO, ONE = Fraction(0), Fraction(1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cut:
    """A policy, by its visits, that must not be worth more than the given one; its multiplier."""

    flow: OccupancyMeasure
    multiplier: Fraction


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightInterval:
    """Multipliers of one weight for which a policy is optimal, or None; with the proof."""

    low: Fraction | None
    high: Fraction | float | None
    at_low: Level | None  # values that no policy exceeds at the ends; at infinity, of this alone
    at_high: Level | None
    cuts: tuple[OccupancyMeasure, ...]  # visits of policies that are better beyond the ends


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rationalization(TotalsProof):
    """The least change of the weights of a reward that makes a policy optimal from the start."""

    change: Fraction  # the greatest relative one: 1 if only dropping weights is enough
    multipliers: tuple[Fraction, ...]  # one for each component of the reward, 1 today
    flow: OccupancyMeasure  # expected visits of pairs under the policy
    dual: Level  # values that no policy exceeds under the weights
    cuts: tuple[Cut, ...]  # policies that would stay better after any smaller change
    intervals: tuple[WeightInterval, ...]  # one for each component alone

    kinds: ClassVar[tuple[str, ...]] = ("weights",)

    def _find_violations(self, mdp: MDP) -> list[str]:
        if self.objectives != tuple(mdp.component_names):
            return ["the weighted totals are not the components of the reward"]
        return super()._find_violations(mdp)

    def _list_flows(self) -> list[OccupancyMeasure]:
        flows = [self.flow, *(cut.flow for cut in self.cuts)]
        for own in self.intervals:
            flows += own.cuts
        return flows

    @property
    def possible(self) -> bool:
        """Whether a change below 1 is enough, so that no weight is dropped or changes its sign."""
        return self.change < 1

    @property
    def weights(self) -> dict[str, Fraction]:
        """A multiplier for each component of the reward, 1 today."""
        return dict(zip(self.of.names, self.multipliers, strict=True))

    @property
    def alone(self) -> dict[str, tuple[Fraction, Fraction | float] | None]:
        """For each component the multipliers, 0 or more, that are enough alone, or None."""
        intervals: dict[str, tuple[Fraction, Fraction | float] | None] = {}
        for name, own in zip(self.of.names, self.intervals, strict=True):
            intervals[name] = None
            if own.low is not None and own.high is not None:
                intervals[name] = own.low, own.high
        return intervals

    def __repr__(self) -> str:
        done = "no change below 1"
        if self.possible:
            done = f"a change of {float(self.change):.6g}"
        return f"Rationalization({done} makes the policy optimal; certified)"

    def report(self) -> Report:
        """Return the weights, the change, and the interval of each weight alone."""
        table = Table(
            title="multipliers of the weights",
            rows=self.frame(),
            columns={"component": "component"}
            | {name: f"{name}:.6g" for name in ("multiplier", "alone from", "to")},
            note="alone: the multipliers of this weight for which the policy is optimal, the "
            "others unchanged",
        )
        return Report(
            title="weights that make a policy optimal",
            facts={
                "claim": Shown(self.claim),
                "possible": Shown(
                    self.possible,
                    "the policy is optimal already"
                    if not self.change
                    else "the policy is optimal with these weights"
                    if self.possible
                    else "with no weights short of dropping them all (proven)",
                ),
                "change": Shown(self.change, Certified(value=self.change)),
                "weights": self.weights,
                "alone": Shown({name: ends and list(ends) for name, ends in self.alone.items()}),
            },
            tables={"weights": table},
        )

    def frame(self) -> DataFrame:
        """Return a row for each component: its multiplier, and those that are enough alone."""
        rows = []
        for name, weight in self.weights.items():
            rows.append((name, weight, *(self.alone[name] or (None, None))))
        return data_frame(rows, columns=["component", "multiplier", "alone from", "to"])


@named_options
def rationalize(
    model: MDP | Scenario, policy: PolicyLike, *, criterion: str = "total"
) -> Rationalization:
    """Return the least change of the weights of the reward that makes a policy optimal.

    Parameters
    ----------
    model : MDP or Scenario
        With components of the reward. At discount 1, policies that never end, or miss a goal, are
        left out if they lose without limit in some component.
    policy : PolicyLike
    criterion : "total" or "average"
        As for `tradeoff`.

    Returns
    -------
    Rationalization

    Raises
    ------
    ModelError
        For a policy that does not fit, or whose totals are not finite; if a component may grow
        without limit.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    >>> parts = {"gain": [6, 3, 0], "effort": [-1, 0, 0]}
    >>> weights = rationalize(MDP.from_outcomes(rows, components=parts), {"0": "1", "1": "0"})
    >>> weights.weights, weights.alone["effort"], weights.violations()
    ({'gain': Fraction(1, 2), 'effort': Fraction(3, 2)}, (Fraction(3, 1), inf), [])
    """
    mdp = mdp_of(model)
    if is_average(criterion):
        require_average_applies(mdp)
        if isinstance(policy, str) and policy == "optimal":
            policy = policy_of(mdp, policy, criterion="average")
        mdp, _ = reduce_to_totals(mdp, mdp.component_names)
    of = Objectives(mdp, mdp.component_names)
    own = flow_of(of, policy)
    search = _WeightSearch(of, own.compute_totals(of))
    multipliers, change, dual, cuts = search.find_least_change()
    return Rationalization(
        change=change,
        multipliers=tuple(multipliers),
        flow=own,
        dual=dual,
        cuts=cuts,
        intervals=tuple(search.find_interval(k) for k in range(len(of.names))),
        **list_proof_fields(of, "weights"),
    )


class _WeightSearch:
    """The policies found so far: their visits, and their totals less the given policy's."""

    def __init__(self, of: Objectives, totals: Point) -> None:
        self.of, self.totals = of, totals
        self.policies: list[tuple[OccupancyMeasure, Point]] = []

    def prove_optimality(self, weights: Sequence[Fraction]) -> Level | None:
        """Return the proof that the policy is optimal for weights; None if another beats it."""
        pairs, value = solve_weighted(self.of, weights)
        if value.compute_mean(self.of.mdp.start) == weigh_values(weights, self.totals):
            return value
        flow = flow_under(self.of, pairs)
        lead = tuple(a - b for a, b in zip(flow.compute_totals(self.of), self.totals, strict=True))
        self.policies.append((flow, lead))
        return None

    def find_least_change(self) -> tuple[list[Fraction], Fraction, Level, tuple[Cut, ...]]:
        """Return weights and the change, with proofs of optimality and of the change."""
        size = len(self.totals)
        # |w - 1| is at most the change: a column for each weight and either sign.
        bounds = []
        for sign in (ONE, -ONE):
            for row in list_unit_vectors(size, sign):
                bounds.append([*row, ONE])
        gain = [ONE] * size + [-ONE] * size
        while True:
            columns = bounds.copy()
            for _, lead in self.policies:
                columns.append([*map(neg, lead), ZERO])
            x, (*weights, change) = solve_linear_program(
                [*gain, *[ZERO] * len(self.policies)], columns, [*[ZERO] * size, ONE]
            )
            dual = self.prove_optimality(weights)
            if dual is not None:
                each = zip(self.policies, x[2 * size :], strict=False)
                cuts = tuple(Cut(flow=other, multiplier=own) for (other, _), own in each if own)
                return weights, change, dual, cuts

    def find_interval(self, k: int) -> WeightInterval:
        """Return the multipliers of one component under which the policy is optimal."""
        size = len(self.totals)

        def prove_multiplier(x: Fraction | float) -> Level | None:
            weights = [Fraction(x != inf)] * size
            if isinstance(x, float):
                weights[k] = ONE
            else:
                weights[k] = x
            return self.prove_optimality(weights)

        # Begin with this component alone, a multiplier of infinity: a better policy there is a
        # bound.
        prove_multiplier(inf)
        while True:
            # Each policy allows multipliers on one side of a number: intersect all of these.
            lines = [(lead[k], sum(lead) - lead[k]) for _, lead in self.policies]
            low, high = solve_inequalities(lines)
            # The policies that determine the two ends are the proof that nothing beyond them will
            # do.
            each = [solve_inequalities([line]) for line in lines]
            binding = [i for i, own in enumerate(each) if low > 0 and own[0] == low][:1]
            binding += [i for i, own in enumerate(each) if high < inf and own[1] == high][:1]
            cuts = tuple(self.policies[i][0] for i in sorted({*binding}))
            if low > high:
                return WeightInterval(low=None, high=None, at_low=None, at_high=None, cuts=cuts)
            # An end that is not proven optimal has added a better policy: try again.
            at_low = prove_multiplier(low)
            at_high = at_low and prove_multiplier(high)
            if at_low and at_high:
                return WeightInterval(low=low, high=high, at_low=at_low, at_high=at_high, cuts=cuts)
