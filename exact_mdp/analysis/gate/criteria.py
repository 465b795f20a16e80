"""What an audit is about: the total reward, the reward per step, or the total under limits.

The reward per step is lost where less can be earned later, and where a policy stays and earns less:

    g* - g = Σ d(s) (g*(s) - E g*(s')) + Σ μ(s) (g*(s) - r + h*(s) - E h*(s'))

with d its visits to states that it leaves for good, and μ the share of time in the others. Under
limits c_k ≥ b_k, with prices λ_k (`solvers.objectives.limits`), every policy π has

    r* - r(π) = Σ_l x_π(l) gap(l) + λ (c(π) - b)

with its visits x_π and what pairs fall short of the optimum V where r + λ c is earned (Altman,
Constrained Markov Decision Processes, 1999, chapter 3): an audit of the priced model names the
states; the last term is the value of the room left under the limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from math import nan
from typing import Any, ClassVar

import numpy as np

from exact_mdp.analysis.gate.forgiveness import per_use, round_finite_values
from exact_mdp.analysis.gate.reasons import Findings, find_policy_disagreements, list_disagreements
from exact_mdp.analysis.gate.regret import (
    LAST_CYCLE,
    Regret,
    certify_and_check,
    include_near_ties,
    is_cheap_to_certify,
    policy_regret,
)
from exact_mdp.analysis.gate.waiting import chain_of_pairs
from exact_mdp.analysis.optimum import require_sound_proof
from exact_mdp.mdp.report import Shown, Table, format_cell
from exact_mdp.mdp.table import Floats, to_common_denominator, to_integer_array
from exact_mdp.solvers.bounds.gains import SLACK
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.objectives.limits import ConstrainedSolution, Limit, solve_under
from exact_mdp.solvers.solution import Bounded, Certified
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.average import AverageEvaluation, evaluate_average
from exact_mdp.solvers.values.policy_chain import PolicyChain, flow_of


@dataclass(frozen=True)
class Verdict:
    """One thing that was checked, such as "the regret" "at most 1/2", and what was found."""

    subject: str
    limit: str
    decision: bool | None  # None where bounds or records leave it open, which does not pass
    text: str

    @property
    def name(self) -> str:
        """What was checked."""
        return f"{self.subject} is {self.limit}"

    @property
    def passed(self) -> bool:
        """Whether it holds."""
        return self.decision is True

    @property
    def told(self) -> str:
        """What was found, as a sentence: the name of a check that fails is not what was found."""
        holds = {True: "is", False: "is not", None: "is not known to be"}[self.decision]
        return f"{self.subject} {holds} {self.limit}: {self.text}"

    def __str__(self) -> str:
        return f"{'passed' if self.passed else 'failed'}: {self.told}"


def format_claimed_number(value: Certified | Bounded) -> str:
    """Return a number with its claim; an exact one may have thousands of digits, and is rounded."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


@dataclass(frozen=True, kw_only=True, eq=False)
class Total:
    """The total reward of a policy, discounted as the model says."""

    chain: PolicyChain

    name: ClassVar[str] = "total"
    least: ClassVar[str] = "zero"  # what the regret has to be where no limit of it is given
    against: ClassVar[str] = ""
    plain: ClassVar[bool] = True  # whether values are totals of the reward, and nothing else

    @property
    def sums(self) -> str:
        """How rewards add up, in words."""
        return f"discount {self.chain.mdp.discount}".removesuffix(".0")

    @property
    def feasible(self) -> bool:
        """Whether there is an optimum to compare with."""
        return True

    def compute_regret(self, exact: bool | None) -> Regret:
        """Return what the policy loses against the optimum: exactly, or in bounds."""
        return policy_regret(self.chain, exact=exact)

    def find_disagreements(self, lost: Regret) -> Findings:
        """Return where the policy loses what it loses."""
        return find_policy_disagreements(self.chain, lost)

    def list_verdicts(self) -> Iterator[Verdict]:
        """Yield the verdicts beside those on the regret."""
        return iter(())

    def list_facts(self) -> dict[str, Any]:
        """Return what a report says of limits; null without them."""
        names = ("feasible", "limits", "kept", "totals", "prices", "closest", "room")
        return dict.fromkeys(names)

    def list_tables(self) -> dict[str, Table]:
        """Return the tables of these facts."""
        return {}


class Average(Total):
    """The reward of a policy per step, in the long run."""

    name = "average"
    plain = False

    @property
    def sums(self) -> str:
        """How rewards add up, in words."""
        return "reward per step"

    @cached_property
    def own(self) -> AverageEvaluation:
        """What the policy earns per step; raises SolverError where floats cannot tell."""
        return evaluate_average(self._undiscounted)

    @cached_property
    def _undiscounted(self) -> PolicyChain:
        return replace(self.chain, mdp=self.chain.mdp.maximised.undiscounted)

    def compute_regret(self, exact: bool | None) -> Regret:
        """Return what the policy loses per step: exactly unless that takes long."""
        mdp = self.chain.mdp
        exact = is_cheap_to_certify(mdp, LAST_CYCLE) if exact is None else exact
        return (self._certify_regret() if exact else self._bound_regret()).of_sense(mdp.sense)

    def find_disagreements(self, lost: Regret) -> Findings:
        """Return where the policy loses what it loses; bounds do not tell."""
        chain = self._undiscounted
        certified = isinstance(lost.at_start, Certified)
        visits = _compute_long_run_visits(chain) if certified else self.own.visits
        return list_disagreements(chain, lost, visits, np.full(chain.mdp.n_states, -1))

    def _certify_regret(self) -> Regret:
        """Return the exact regret, of rewards.

        One use of a pair can move the gain by what was rounded in its own row, and on the way to
        where the policy stays by what that moves of g*: the means of both are forgiven.
        """
        chain = self._undiscounted
        step, best = chain.mdp, certify_and_check(self.chain.mdp.maximised, "average")
        mine, (lost, short) = certify_and_check(chain.model, "average"), best.losses
        gap = np.where(chain.exactly.classes.recurrent[step.pair_state], lost + short, lost)
        optimal = np.asarray(gap == 0, dtype=bool)
        gap, whole = gap.astype(np.float64), best.start_value - mine.start_value
        movable: Callable[[], Fraction] = Fraction
        if step.floats:
            # The rounding of a row, and of the best one, can cause the whole gap.
            most = _per_use(chain, best)
            near = gap * SLACK <= most + most[best.pairs][step.pair_state]
            moved = _compute_gain_allowance(
                chain_of_pairs(step, best.pairs), best
            ) + _compute_gain_allowance(chain, mine)
            movable = partial(Fraction, moved * SLACK)
            optimal = include_near_ties(chain, optimal, near, whole, movable)
        both = (best.start, best.value_float), (mine.start, mine.value_float)
        apart = (best.value - mine.value).astype(np.float64)
        return Regret.from_values(*both, optimal, by_state=apart, gap=gap, movable=movable)

    def _bound_regret(self) -> Regret:
        mdp, own = self.chain.mdp.maximised, self.own
        best, gap = solve(mdp, criterion="average"), np.zeros(mdp.n_pairs)
        other = np.bincount(best.pairs, minlength=mdp.n_pairs) == 0
        both = (best.start, best.value), (own.start, own.value)
        apart = np.maximum(best.value - own.value, 0.0)
        return Regret.from_values(*both, gap == 0, by_state=apart, gap=gap, unclear=other)


def _compute_long_run_visits(chain: PolicyChain) -> Floats:
    """Return (S,) the share of time; in transient states the expected visits from the start."""
    share, met = chain.exactly.compute_limit_distribution(chain.mdp.start)
    return np.where(chain.exactly.classes.recurrent, share, met).astype(np.float64)


def _per_use(chain: PolicyChain, proof: Certificate) -> Floats:
    """Return (L,) what the rounding of a row moves of the bias; on the way, of the gain."""
    step, stays = chain.mdp, chain.exactly.classes.recurrent[chain.mdp.pair_state]
    on_the_way = per_use(step, round_finite_values(proof.value), rewards=False)
    return np.where(stays, per_use(step, round_finite_values(proof.bias)), on_the_way)


def _compute_gain_allowance(chain: PolicyChain, proof: Certificate) -> float:
    """Return what the rounding of floats can move of a policy's gain at the start."""
    uses = _compute_long_run_visits(chain)[chain.mdp.pair_state] * chain.weights
    return float(uses @ _per_use(chain, proof))


@dataclass(frozen=True, kw_only=True, eq=False)
class UnderLimits(Total):
    """The total reward of a policy that has to keep limits on other totals, exactly."""

    best: ConstrainedSolution  # the optimum, proven

    least = "at most 0"
    against = ", against the best policy that keeps the limits"
    plain = False

    @classmethod
    def of(cls, chain: PolicyChain, subject_to: Mapping[str, Any]) -> UnderLimits:
        """Return the criterion of limits, as `solve` takes them."""
        return cls(chain=chain, best=require_sound_proof(solve_under(chain.mdp, subject_to)))

    @property
    def feasible(self) -> bool:
        """Whether some policy keeps the limits."""
        return self.best.feasible

    @cached_property
    def _attained(self) -> list[Fraction]:
        of = self.best.of
        assert self.chain.policy is not None
        return [of.sign * total for total in flow_of(of, self.chain.policy).compute_totals(of)]

    @property
    def earned(self) -> Fraction:
        """The return of the policy."""
        return self._attained[0]

    @property
    def totals(self) -> dict[str, Fraction]:
        """The policy's totals of what is limited."""
        return dict(zip(self.best.of.names[1:], self._attained[1:], strict=True))

    @property
    def room(self) -> Fraction:
        """What the room that the policy leaves under the limits is worth: λ (c(π) - b)."""
        left = (limit.sign * (self.totals[limit.name] - limit.bound) for limit in self.best.limits)
        return sum((p * room for p, room in zip(self.best.price, left, strict=True)), Fraction(0))

    def keeps_limit(self, limit: Limit) -> bool:
        """Return whether the policy keeps a limit."""
        return limit.sign * (self.totals[limit.name] - limit.bound) >= 0

    @cached_property
    def _total(self) -> Total:
        """The audit of the model that earns r + λ c; of itself where no policy keeps the limits."""
        of, best = self.best.of, self.best
        if not best.feasible:
            return Total(chain=replace(self.chain, mdp=of.mdp))
        whole, below = to_common_denominator(best.weights)
        scale = of.rows.scale[of.mdp.pair_state].astype(object)
        table = replace(
            of.mdp.table,
            gain=to_integer_array((of.sign * of.weigh_amounts(whole).astype(object)).tolist()),
            gain_denominator=to_integer_array((scale * below).tolist()),
        )
        priced = of.mdp.with_(table=table, goal=None)
        return Total(chain=replace(self.chain, mdp=priced))

    def compute_regret(self, exact: bool | None) -> Regret:
        """Return the regret against the optimum under limits; NaN where no policy keeps them."""
        best = self.best.start or Certified(value=nan)
        lost = replace(
            self._total.compute_regret(True),
            optimal=best,
            learned=Certified(value=self.earned),
            at_start=Certified(value=self.best.of.sign * (best.value - self.earned)),
            movable=Fraction,  # nothing is forgiven
        )
        if not self.feasible:
            none = np.full_like(lost.by_state, nan)
            lost = replace(lost, by_state=none, optimal_value=none)
        return lost

    def find_disagreements(self, lost: Regret) -> Findings:
        """Return where the policy loses what it loses, of the priced model."""
        return self._total.find_disagreements(lost)

    def list_verdicts(self) -> Iterator[Verdict]:
        """Yield the verdict on each limit, and on whether any policy keeps them all."""
        for limit in self.best.limits:
            total = format_claimed_number(Certified(value=self.totals[limit.name]))
            name = f"within the limit {limit}"
            yield Verdict("the policy", name, self.keeps_limit(limit), f"its total is {total}")
        if not self.feasible:
            near = ", ".join(limit.format_limit(10) for limit in self.best.moved)
            text = f"none does (proven); the closest that can be kept: {near}"
            yield Verdict("there", "a policy that keeps all limits", False, text)

    def list_facts(self) -> dict[str, Any]:
        """Return what a report says of the limits."""
        best = self.best
        room = f"{format_cell(self.room)}: the value of the room left under the limits"
        return {
            "feasible": best.feasible,
            "limits": [str(limit) for limit in best.limits],
            "kept": Shown([self.keeps_limit(limit) for limit in best.limits]),
            "totals": Shown(self.totals),
            "prices": Shown(best.prices if best.feasible else None),
            "closest": Shown(best.closest),
            "room": Shown(self.room, room) if best.feasible else None,
        }

    def list_tables(self) -> dict[str, Table]:
        """Return each limit with the policy's total, and its price or the closest to be kept."""
        answers = ["yes" if self.keeps_limit(limit) else "NO" for limit in self.best.limits]
        return {"limits of the policy": self.best.table(self.totals, answers)}
