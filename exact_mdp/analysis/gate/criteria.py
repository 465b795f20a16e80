"""The criteria of an audit: the total reward, the reward per step, and the total under limits.

Each finds the regret of a policy π, and the states in which it arises. Those of a total cost

    cost(s) = d(s) gap(s, π(s)),    d the policy's discounted visits from the start,

and costs sum to the regret; if a policy stays forever, see `analysis.gate.class_losses`. A policy
loses reward per step in transient states that lead to a smaller gain, and in recurrent
states in which it earns less:

    g* - g = Σ d(s) (g*(s) - E g*(s')) + Σ μ(s) (g*(s) - r + h*(s) - E h*(s'))

with d the expected visits to transient states and μ the stationary distribution of the others.
Under limits c_k ≥ b_k, with shadow prices λ_k (`solvers.objectives.limits`), every policy π has

    r* - r(π) = Σ_l x_π(l) gap(l) + λ (c(π) - b)

with its occupancy measure x_π and the suboptimality gaps of the model whose reward is r + λ c
(Altman, Constrained Markov Decision Processes, 1999, chapter 3). An audit of this priced model
names the states; the last term is the value of the slack that the policy leaves in the limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from math import nan
from typing import Any, ClassVar

import numpy as np

from exact_mdp.analysis.gate.class_losses import (
    charge_class_losses,
    final_class,
    find_attaining_pairs,
)
from exact_mdp.analysis.gate.forgiveness import per_use, round_finite_values
from exact_mdp.analysis.gate.regret import (
    LAST_CYCLE,
    Regret,
    StateLosses,
    include_near_ties,
    is_cheap_to_certify,
    policy_regret,
)
from exact_mdp.mdp.errors import FEW_NAMED, ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Shown, Table, format_cell
from exact_mdp.mdp.table import Floats, Integers, to_common_denominator, to_integer_array
from exact_mdp.solvers.bounds.gains import SLACK
from exact_mdp.solvers.claims import Bounded, Certified, SolverError
from exact_mdp.solvers.exact.certificate import Certificate, require_sound_proof
from exact_mdp.solvers.exact.certify import certify_and_check
from exact_mdp.solvers.objectives.limits import ConstrainedSolution, Limit, solve_under
from exact_mdp.solvers.objectives.totals import flow_of
from exact_mdp.solvers.solution import answer_maximised
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.average import AverageEvaluation, evaluate_average
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True)
class Verdict:
    """The outcome of one check, such as "the regret" is "at most 1/2"."""

    subject: str
    limit: str
    decision: bool | None  # None if bounds or records leave it open; it then fails
    text: str

    @property
    def name(self) -> str:
        """The condition that was checked."""
        return f"{self.subject} is {self.limit}"

    @property
    def passed(self) -> bool:
        """Whether the condition is proven to hold."""
        return self.decision is True

    @property
    def told(self) -> str:
        """The outcome as a sentence, such as "the regret is not zero: it is 2"."""
        holds = {True: "is", False: "is not", None: "is not known to be"}[self.decision]
        return f"{self.subject} {holds} {self.limit}: {self.text}"

    def __str__(self) -> str:
        word = "failed"
        if self.passed:
            word = "passed"
        return f"{word}: {self.told}"


def format_claimed_number(value: Certified | Bounded) -> str:
    """Return a number with its claim, rounded to ten digits if it is exact."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


@dataclass(frozen=True, kw_only=True, eq=False)
class Total:
    """The total reward of a policy, discounted as the model says."""

    chain: PolicyChain

    name: ClassVar[str] = "total"
    least: ClassVar[str] = "zero"  # the condition on the regret if no limit is given
    against: ClassVar[str] = ""
    plain: ClassVar[bool] = True  # whether values are plain totals of the reward

    @property
    def sums(self) -> str:
        """How rewards add up, in words."""
        return f"discount {self.chain.mdp.discount}".removesuffix(".0")

    @property
    def feasible(self) -> bool:
        """Whether there is an optimum to compare with."""
        return True

    def compute_regret(self, exact: bool | None) -> Regret:
        """Return the regret of the policy: exactly, or within bounds."""
        return policy_regret(self.chain, exact=exact)

    def find_disagreements(self, lost: Regret) -> Findings:
        """Return the visits and the states in which the regret arises."""
        return find_policy_disagreements(self.chain, lost)

    def list_verdicts(self) -> Iterator[Verdict]:
        """Yield the verdicts other than those on the regret."""
        return iter(())

    def list_facts(self) -> dict[str, Any]:
        """Return the facts about limits for a report; None for each without limits."""
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
        """The policy's average reward; raises SolverError if floats cannot bound it."""
        return evaluate_average(self._undiscounted)

    @cached_property
    def _undiscounted(self) -> PolicyChain:
        return replace(self.chain, mdp=self.chain.mdp.maximised.undiscounted)

    def compute_regret(self, exact: bool | None) -> Regret:
        """Return the regret per step: exactly unless that takes long."""
        mdp = self.chain.mdp
        if exact is None:
            exact = is_cheap_to_certify(mdp, LAST_CYCLE)
        find_regret = self._bound_regret
        if exact:
            find_regret = self._certify_regret
        return answer_maximised(mdp, find_regret)

    def find_disagreements(self, lost: Regret) -> Findings:
        """Return the visits and the states in which the regret arises; none if it is bounded."""
        chain = self._undiscounted
        if isinstance(lost.at_start, Certified):
            visits = _compute_long_run_visits(chain)
        else:
            visits = self.own.visits
        return list_disagreements(chain, lost, visits, np.full(chain.mdp.n_states, -1))

    def _certify_regret(self, mdp: MDP) -> Regret:
        """Return the exact regret in the model of maximised rewards.

        The rounding of a row moves the gain once for each use of its pair: through the bias in
        recurrent states, through g* in transient ones. The rounding allowance is the sum of both
        over the visits of the optimum and of the policy.
        """
        # A pair loses gain, and in recurrent states also bias.
        chain = self._undiscounted
        step, best = chain.mdp, certify_and_check(mdp, "average")
        mine, (lost, short) = certify_and_check(chain.model, "average"), best.losses
        gap = np.where(chain.exactly.classes.recurrent[step.pair_state], lost + short, lost)
        optimal = np.asarray(gap == 0, dtype=bool)
        gap, whole = gap.astype(np.float64), best.start_value - mine.start_value
        movable: Callable[[], Fraction] = Fraction
        if step.floats:
            # A pair is a near tie if rounding in its row and in the best row may cause its gap.
            most = _per_use(chain, best)
            near = gap * SLACK <= most + most[best.pairs][step.pair_state]
            ideal = PolicyChain.of_pairs(step, best.pairs)
            moved = _compute_gain_allowance(ideal, best) + _compute_gain_allowance(chain, mine)
            movable = partial(Fraction, moved * SLACK)
            optimal = include_near_ties(chain, optimal, near, whole, movable)
        losses = partial(
            StateLosses,
            optimal_value=best.value_float,
            learned_value=mine.value_float,
            by_state=(best.value - mine.value).astype(np.float64),
            optimal_pairs=optimal,
            gap=gap,
        )
        return Regret.from_values(best.start, mine.start, losses, movable=movable)

    def _bound_regret(self, mdp: MDP) -> Regret:
        """Return a bound on the regret in the model of maximised rewards."""
        own = self.own
        best, gap = solve(mdp, criterion="average"), np.zeros(mdp.n_pairs)
        # Bounds prove no gap of a pair: all are taken as optimal, those the optimum skips as open.
        other = np.bincount(best.pairs, minlength=mdp.n_pairs) == 0
        losses = partial(
            StateLosses,
            optimal_value=best.value,
            learned_value=own.value,
            by_state=np.maximum(best.value - own.value, 0.0),
            optimal_pairs=gap == 0,
            gap=gap,
            unclear=other,
        )
        return Regret.from_values(best.start, own.start, losses)


def _without_optimum(lost: Regret) -> StateLosses:
    """Return the losses of a regret against which there is no optimum: NaN in all states."""
    none = np.full(lost.losses.by_state.shape, nan)
    return replace(lost.losses, by_state=none, optimal_value=none)


def _compute_long_run_visits(chain: PolicyChain) -> Floats:
    """Return (S,) the stationary distribution; for transient states, the expected visits."""
    share, met = chain.exactly.compute_limit_distribution(chain.mdp.start)
    return np.where(chain.exactly.classes.recurrent, share, met).astype(np.float64)


def _per_use(chain: PolicyChain, proof: Certificate) -> Floats:
    """Return (L,) how far rounding in each row can move the gain, per use of the pair.

    It acts through the bias in recurrent states, and through the gain of next states in others.
    """
    step, recurrent = chain.mdp, chain.exactly.classes.recurrent[chain.mdp.pair_state]
    transient = per_use(step, round_finite_values(proof.value), rewards=False)
    return np.where(recurrent, per_use(step, round_finite_values(proof.bias)), transient)


def _compute_gain_allowance(chain: PolicyChain, proof: Certificate) -> float:
    """Return how far the rounding of floats can move a policy's gain at the start."""
    uses = _compute_long_run_visits(chain)[chain.mdp.pair_state] * chain.weights
    return float(uses @ _per_use(chain, proof))


@dataclass(frozen=True, kw_only=True, eq=False)
class UnderLimits(Total):
    """The total reward of a policy that has to keep limits on other totals; always exact."""

    best: ConstrainedSolution  # the certified optimum under the limits

    least = "at most 0"
    against = ", against the best policy that keeps the limits"
    plain = False

    @classmethod
    def of(cls, chain: PolicyChain, subject_to: Mapping[str, Any]) -> UnderLimits:
        """Return the criterion for limits as `solve` takes them."""
        best = solve_under(chain.mdp, subject_to)
        if best.of.reduced:
            raise ModelError(
                "a regret under limits is known only where every policy ends, in the goal if there "
                "is one",
                where="subject_to",
                fix="compare with solve(model, subject_to=…), the optimum, or choose a discount "
                "below 1 (--discount 0.95)",
            )
        return cls(chain=chain, best=require_sound_proof(best))

    @property
    def feasible(self) -> bool:
        """Whether some policy keeps the limits."""
        return self.best.feasible

    @cached_property
    def _attained(self) -> list[Fraction]:
        """The policy's expected totals: of the reward, then of each limited component."""
        of = self.best.of
        assert self.chain.policy is not None
        return [of.sign * total for total in flow_of(of, self.chain.policy).compute_totals(of)]

    @property
    def earned(self) -> Fraction:
        """The expected return of the policy."""
        return self._attained[0]

    @property
    def totals(self) -> dict[str, Fraction]:
        """The policy's total of each limited component."""
        return dict(zip(self.best.of.names[1:], self._attained[1:], strict=True))

    @property
    def room(self) -> Fraction:
        """The value of the slack that the policy leaves in the limits: λ (c(π) - b)."""
        value = Fraction(0)
        for price, limit in zip(self.best.price, self.best.limits, strict=True):
            value += price * limit.sign * (self.totals[limit.name] - limit.bound)
        return value

    def keeps_limit(self, limit: Limit) -> bool:
        """Return whether the policy keeps a limit."""
        return limit.sign * (self.totals[limit.name] - limit.bound) >= 0

    @cached_property
    def _total(self) -> Total:
        """The criterion of the model with reward r + λ c; without prices if none are feasible."""
        of, best = self.best.of, self.best
        if not best.feasible:
            return Total(chain=replace(self.chain, mdp=of.mdp))
        # Exact integers over common denominators: of the weights (1, λ), and of each pair's row.
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
        """Return the regret against the optimum under limits; NaN if no policy keeps them."""
        best = self.best.start or Certified(value=nan)
        priced = self._total.compute_regret(True)
        lost = replace(
            priced,
            optimal=best,
            learned=Certified(value=self.earned),
            at_start=Certified(value=self.best.of.mdp.sense.loss(best.value, self.earned)),
            movable=Fraction,  # no rounding allowance
        )
        if not self.feasible:
            lost = replace(lost, find_losses=partial(_without_optimum, priced))
        return lost

    def find_disagreements(self, lost: Regret) -> Findings:
        """Return the visits and the states in which the regret arises, in the priced model."""
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
        """Return the facts about limits for a report."""
        best, prices, room = self.best, None, None
        if best.feasible:
            prices = best.prices
            text = f"{format_cell(self.room)}: the value of the room left under the limits"
            room = Shown(self.room, text)
        return {
            "feasible": best.feasible,
            "limits": [str(limit) for limit in best.limits],
            "kept": Shown([self.keeps_limit(limit) for limit in best.limits]),
            "totals": Shown(self.totals),
            "prices": Shown(prices),
            "closest": Shown(best.closest),
            "room": room,
        }

    def list_tables(self) -> dict[str, Table]:
        """Return each limit with the policy's total, and its price or the closest feasible one."""
        answers = ["yes" if self.keeps_limit(limit) else "NO" for limit in self.best.limits]

        return {"limits of the policy": self.best.table(self.totals, answers)}


# ---- the states ----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """A state in which a policy does something that is not optimal."""

    state: int
    label: str
    learned: str  # the policy's action, or its actions with their probabilities
    optimal: tuple[str, ...]  # all optimal actions
    gap: float  # the loss of one use; in a class that the policy never leaves, of staying
    expected_visits: float  # discounted, from the start
    cost: float  # expected_visits · gap, plus the loss of staying; costs sum to the regret


Findings = tuple[Floats, tuple[Disagreement, ...]]  # visits (S,), and the disagreements


def find_policy_disagreements(chain: PolicyChain, regret: Regret) -> Findings:
    """Return the visits of the policy of `chain`, and the states that make up its regret.

    At discount 1 visits are infinite in recurrent states that are not terminal. They are NaN if
    floats cannot bound them and rational arithmetic would be slow.
    """
    mdp = chain.mdp
    label = np.full(mdp.n_states, -1)
    if mdp.discount_exact == 1 and not chain.ends_from_start:
        label = np.where(chain.reached, final_class(chain), -1)
    # Recurrent classes become terminal, so their visits are the finite arrivals.
    leaving = chain
    if (label >= 0).any():
        leaving = chain.make_terminal(label >= 0)
    came = _compute_state_visits(leaving, exactly=isinstance(regret.at_start, Certified))
    return list_disagreements(chain, regret, np.where(chain.reached, came, 0.0), label)


def _compute_state_visits(chain: PolicyChain, *, exactly: bool) -> Floats:
    """Return (S,) expected visits; `exactly` asks for exact ones if floats lose digits."""
    try:
        visits = chain.discounted.visits
        # An error of 2^-40 of the largest number leaves more digits right than a report shows.
        if not exactly or visits.error.max() <= 2.0**-40 * visits.value.max():
            return visits.value
    except SolverError:
        if not exactly:
            return np.full(chain.mdp.n_states, np.nan)
    return chain.exact_visits.to_floats()


def list_disagreements(
    chain: PolicyChain, regret: Regret, came: Floats, label: Integers
) -> Findings:
    """Return visits (S,) and the states that make up the regret, the costliest first.

    `label` (S,) numbers the recurrent classes, -1 elsewhere; `came` (S,) are visits, or arrivals
    in these classes.
    """
    mdp, weights, first = chain.mdp, chain.weights, chain.mdp.pair_offsets[:-1]
    visits, optimal = np.where(label >= 0, np.inf, came), regret.optimal_pairs
    # The mean gap of a state's actions; a state is wrong if it takes any pair that is not optimal.
    gap = np.add.reduceat(weights * np.where(weights > 0, regret.gap, 0.0), first)
    wrong = np.add.reduceat(weights * ~optimal, first) > 0
    # Cost is visits times gap, without the undefined products of 0 and infinity.
    cost = np.where(gap > 0, visits, 0.0) * np.where(visits > 0, gap, 0.0)
    # A recurrent class may lose without any gap, by staying: that is charged to its wrong states.
    staying = charge_class_losses(label, came, regret.by_state, gap, wrong)
    gap, cost = np.where(staying > 0, regret.by_state, gap), cost + staying
    states, disagreements = np.flatnonzero(wrong & ~mdp.terminal), []
    # The costliest first, then the largest gap, then the smallest number.
    for state in states[np.lexsort((states, -gap[states], -cost[states]))].tolist():
        right = [pair for pair in mdp.pairs_of(state) if optimal[pair]]
        if isinstance(regret.optimum, Certificate):
            right = find_attaining_pairs(mdp, regret.optimum, optimal, state)
        disagreements.append(
            Disagreement(
                state=state,
                label=mdp.space.label(state),
                learned=action_of(chain, state),
                optimal=tuple(mdp.actions[mdp.pair_action[pair]] for pair in right),
                gap=float(gap[state]),
                expected_visits=float(visits[state]),
                cost=float(cost[state]),
            )
        )
    return visits, tuple(disagreements)


def action_of(chain: PolicyChain, state: int) -> str:
    """Return the action that a policy takes in a state, or its actions with probabilities."""
    mdp, weights = chain.mdp, chain.weights
    taken = [pair for pair in mdp.pairs_of(state) if weights[pair] > 0]
    names = {pair: str(mdp.actions[mdp.pair_action[pair]]) for pair in taken}
    if len(taken) == 1:
        return names[taken[0]]
    if len(taken) > FEW_NAMED:
        # Many actions: say so if all are equally likely, else name the likeliest.
        if len({f"{weights[pair]:.4g}" for pair in taken}) == 1:
            return f"any of {len(taken)}"
        taken.sort(key=lambda pair: -weights[pair])
    return _join_few([f"{weights[pair]:.4g} {names[pair]}" for pair in taken], ", ")


def format_alternatives(names: Sequence[str]) -> str:
    """Return optimal actions as alternatives, in words."""
    return _join_few(names, " or ")


def _join_few(texts: Sequence[str], between: str) -> str:
    """Return some texts joined; of many, the first few and a count of the others."""
    if len(texts) <= FEW_NAMED:
        return between.join(texts)
    named = texts[: FEW_NAMED - 1]
    return between.join([*named, f"{len(texts) - len(named)} others"])
