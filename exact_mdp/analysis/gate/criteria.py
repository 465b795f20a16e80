"""What an audit is about: the total reward, the reward per step, or the total under limits.

The total reward: what is lost, and where, is said in `analysis.gate.regret` and
`analysis.gate.disagreements`. The reward per step:

    regret = g* - g = Σ d(s) (g*(s) - E g*(s')) + Σ μ(s) (g*(s) - r + h*(s) - E h*(s'))

with the expectations over what the policy does in s, d its expected visits to states that it leaves
for good, and μ the share of time that it spends in the others. In the first, only what can still be
earned per step counts; in the others it has lost none of that. So each state has a price, and these
sum to the regret. One use of a pair can move the gain by what was rounded in its own row (e in
`analysis.gate.forgiveness`, with h* for the values), so that what is forgiven is the mean of that,
and on the way to where the policy stays what the row can move of g*: of both policies.

The total under limits c_k ≥ b_k, with r* the optimum and λ_k their prices
(`solvers.objectives.limits`): no policy earns more of r + λ c than V, r* = μ V - λ b, and

    r* - r(π) = Σ_l x_π(l) gap(l) + λ (c(π) - b)    for every policy π,

x_π being its expected visits and gap what a pair falls short of V where r + λ c is earned
(Lagrangian duality: Altman, Constrained Markov Decision Processes, 1999, chapter 3). So an audit of
the priced model names the states in which the regret arises; the last term is the value of the room
that π leaves under its limits. A policy that breaks them may earn more than r*, and fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from math import nan
from typing import Any, ClassVar

import numpy as np

from exact_mdp.analysis.gate.disagreements import Disagreement, Findings, Loss, findings, listed
from exact_mdp.analysis.gate.exact_policy import flow_of
from exact_mdp.analysis.gate.forgiveness import per_use, rounded
from exact_mdp.analysis.gate.regret import LAST_CYCLE, Regret, cheap, policy_regret, proven
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Shown, Table, cell
from exact_mdp.mdp.table import Floats, Numbers, common, integers
from exact_mdp.solvers.bounds.bounds import Bounds
from exact_mdp.solvers.bounds.gains import SLACK
from exact_mdp.solvers.endless.chain import AverageEvaluation, ExactChain, expansion, long_run
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.levels import Level, surplus
from exact_mdp.solvers.objectives.limits import ConstrainedSolution, Limit, solve_under
from exact_mdp.solvers.solution import Bounded, Certified, SolverError, regret
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.policy_chain import PolicyChain, average


@dataclass(frozen=True)
class Verdict:
    """One thing that was checked, such as "the regret" "at most 1/2", and what was found.

    Attributes
    ----------
    subject, limit : str
    decision : bool or None
        Whether it holds; None where bounds or records leave that open, which does not pass.
    text : str
        What was found.

    Examples
    --------
    >>> verdict = Verdict("the regret", "zero", False, "it is 2")
    >>> verdict.name, verdict.passed, verdict.told
    ('the regret is zero', False, 'the regret is not zero: it is 2')
    """

    subject: str
    limit: str
    decision: bool | None
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


def number(value: Certified | Bounded) -> str:
    """Return a number with its claim; an exact one may have thousands of digits, and is rounded."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


@dataclass(frozen=True, kw_only=True, eq=False)
class Total:
    """The total reward of a policy, discounted as the model says.

    Attributes
    ----------
    chain : PolicyChain
    optimum : Certificate or Bounds, optional
        That of the model, which is found unless it is given.
    """

    chain: PolicyChain
    optimum: Certificate | Bounds | None = None

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

    def loss(self, exact: bool | None) -> Loss:
        """Return what the policy loses against the optimum, and where; exactly, or in bounds."""
        lost = policy_regret(self.chain, exact=exact, optimum=self.optimum)
        return lost, partial(findings, self.chain, lost)

    def verdicts(self) -> Iterator[Verdict]:
        """Yield the verdicts beside those on the regret."""
        return iter(())

    def facts(self) -> dict[str, Any]:
        """Return what a report says of limits; null without them."""
        names = ("feasible", "limits", "kept", "totals", "prices", "closest", "room")
        return dict.fromkeys(names)

    def tables(self) -> dict[str, Table]:
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

    def loss(self, exact: bool | None) -> Loss:
        """Return what the policy loses per step, and where; exactly unless that takes long."""
        mdp, given = self.chain.mdp, self.chain
        rewards, step = mdp.maximised, mdp.maximised.undiscounted
        chain = PolicyChain(mdp=step, chosen=given.chosen, policy=given.policy)
        exact = cheap(mdp, LAST_CYCLE) if exact is None else exact
        own: AverageEvaluation | None = None
        try:
            own = average(chain)
            visits = own.visits
        except SolverError:
            if not exact:
                raise
            visits = np.full(mdp.n_states, np.nan)  # the verdict stands without them
        if exact:
            lost = _certified(rewards, step, chain)
            gap = np.add.reduceat(chain.weights * lost.gap, mdp.pair_offsets[:-1])
            disagreements = listed(chain, lost, np.stack([gap, visits, visits * gap]), gap > 0)
        else:
            assert own is not None
            lost, disagreements = _bounded(rewards, own), ()
        return lost.of_sense(mdp.sense), partial(_both, visits, disagreements)


def _both(visits: Floats, disagreements: tuple[Disagreement, ...]) -> Findings:
    return visits, disagreements  # an audit can be pickled, and a lambda cannot


def _certified(mdp: MDP, step: MDP, chain: PolicyChain) -> Regret:
    best = proven(mdp, "average")
    rows = bellman_rows(step)
    alone = chain.rows(Fraction(1))
    own = ExactChain(alone)
    gain, bias, second = expansion(own, own.reward)
    levels = [Level.of(each.tolist()) for each in (gain, bias, second)]
    if any(any(tops) for tops, _ in surplus(alone, *levels)):
        raise RuntimeError("the exact gain of a policy does not solve its equations")
    learned = sum((p * gain[state] for state, p in mdp.start), Fraction(0))
    lost, short = best.losses
    gap = np.where(own.classes.recurrent[mdp.pair_state], lost + short, lost)
    optimal = np.asarray(gap == 0, dtype=bool)
    forgiven = Fraction(0)
    if mdp.floats:
        # The rounding of a row, and of the best one, can cause the whole gap.
        most = per_use(step, rounded(best.bias))
        most = most + most[best.pairs][step.pair_state]
        optimal |= gap.astype(np.float64) * SLACK <= most
        ideal = ExactChain(rows.of_pairs(best.pairs))
        uses = [chain.exact_weights(state) for state in range(mdp.n_states)]
        sure = [{l: Fraction(1)} for l in best.pairs.tolist()]
        forgiven = _movable(step, own, uses, gain, bias)
        forgiven += _movable(step, ideal, sure, best.value, best.bias)
    return Regret(
        optimal=Certified(value=best.start_value),
        learned=Certified(value=learned),
        at_start=Certified(value=best.start_value - learned),
        optimal_value=best.value_float,
        learned_value=gain.astype(np.float64),
        by_state=(best.value - gain).astype(np.float64),
        optimal_pairs=optimal,
        unclear=np.zeros(mdp.n_pairs, dtype=bool),
        gap=np.where(optimal, 0.0, gap.astype(np.float64)),
        optimum=None,
        movable=partial(Fraction, forgiven),
    )


def _movable(
    step: MDP, own: ExactChain, uses: list[dict[int, Fraction]], gain: Numbers, bias: Numbers
) -> Fraction:
    """Return what the rounding of floats can move of a policy's gain at the start.

    `uses` are the probabilities of its pairs in each state.
    """

    def each(by_pair: Floats) -> Numbers:
        means = [sum(p * Fraction(float(by_pair[l])) for l, p in use.items()) for use in uses]
        return np.array(means, dtype=object)

    inside = own.classes.recurrent
    on_the_way = each(per_use(step, rounded(gain), rewards=False))
    on_the_way[inside] = Fraction(0)
    moved = long_run(own, each(per_use(step, rounded(bias)))) + own.total(on_the_way)
    return sum((p * moved[state] for state, p in step.start), Fraction(0))


def _bounded(mdp: MDP, own: AverageEvaluation) -> Regret:
    solution = solve(mdp, criterion="average")
    best = Bounded(value=solution.start.value, error=solution.start.error)
    mine = Bounded(value=own.start.value, error=own.start.error)
    taken = np.zeros(mdp.n_pairs, dtype=bool)
    taken[solution.pairs] = True
    return Regret(
        optimal=best,
        learned=mine,
        at_start=regret(best, mine),
        optimal_value=solution.value,
        learned_value=own.value,
        by_state=np.maximum(solution.value - own.value, 0.0),
        optimal_pairs=np.ones(mdp.n_pairs, dtype=bool),
        unclear=~taken,
        gap=np.zeros(mdp.n_pairs),
        optimum=None,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class UnderLimits(Total):
    """The total reward of a policy that has to keep limits on other totals, exactly.

    Attributes
    ----------
    best : ConstrainedSolution
        The optimum, proven.
    """

    best: ConstrainedSolution

    least = "at most 0"
    against = ", against the best policy that keeps the limits"
    plain = False

    @classmethod
    def of(cls, chain: PolicyChain, subject_to: Mapping[str, Any]) -> UnderLimits:
        """Return the criterion of limits, as `solve` takes them."""
        best = solve_under(chain.mdp, subject_to)
        if faults := best.violations():
            raise RuntimeError(f"the proof of an optimum under limits does not hold: {faults[0]}")
        return cls(chain=chain, best=best)

    @property
    def feasible(self) -> bool:
        """Whether some policy keeps the limits."""
        return self.best.feasible

    @cached_property
    def _attained(self) -> list[Fraction]:
        of = self.best.of
        assert self.chain.policy is not None
        return [of.sign * total for total in flow_of(of, self.chain.policy).totals(of)]

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

    def keeps(self, limit: Limit) -> bool:
        """Return whether the policy keeps a limit."""
        return limit.sign * (self.totals[limit.name] - limit.bound) >= 0

    @cached_property
    def priced(self) -> MDP:
        """The model that earns r + λ c; the model itself where no policy keeps the limits."""
        of, best = self.best.of, self.best
        if not best.feasible:
            return of.mdp
        whole, below = common(best.weights)
        scale = of.rows.scale[of.mdp.pair_state].astype(object)
        table = replace(
            of.mdp.table,
            gain=integers((of.sign * of.weighted(whole).astype(object)).tolist()),
            gain_denominator=integers((scale * below).tolist()),
        )
        return of.mdp.with_(table=table, goal=None)

    def loss(self, exact: bool | None) -> Loss:
        """Return the regret against the optimum under limits, and where it arises.

        Where no policy keeps the limits, there is no optimum: it is NaN, and so is the regret.
        """
        chain = PolicyChain(mdp=self.priced, chosen=self.chain.chosen, policy=self.chain.policy)
        priced, disagreements = Total(chain=chain).loss(True)
        best, none = self.best.start or Certified(value=nan), np.full_like(priced.by_state, nan)
        lost = replace(
            priced,
            optimal=best,
            learned=Certified(value=self.earned),
            at_start=Certified(value=self.best.of.sign * (best.value - self.earned)),
        )
        if not self.feasible:
            lost = replace(lost, by_state=none, optimal_value=none)
        return lost, disagreements

    def verdicts(self) -> Iterator[Verdict]:
        """Yield the verdict on each limit, and on whether any policy keeps them all."""
        for limit in self.best.limits:
            total = number(Certified(value=self.totals[limit.name]))
            name = f"within the limit {limit}"
            yield Verdict("the policy", name, self.keeps(limit), f"its total is {total}")
        if not self.feasible:
            near = ", ".join(limit.text(10) for limit in self.best.moved)
            text = f"none does (proven); the closest that can be kept: {near}"
            yield Verdict("there", "a policy that keeps all limits", False, text)

    def facts(self) -> dict[str, Any]:
        """Return what a report says of the limits."""
        best = self.best
        room = f"{cell(self.room)}: the value of the room left under the limits"
        return {
            "feasible": best.feasible,
            "limits": [str(limit) for limit in best.limits],
            "kept": Shown([self.keeps(limit) for limit in best.limits]),
            "totals": Shown(self.totals),
            "prices": Shown(best.prices if best.feasible else None),
            "closest": Shown(best.closest),
            "room": Shown(self.room, room) if best.feasible else None,
        }

    def tables(self) -> dict[str, Table]:
        """Return each limit with the policy's total, and its price or the closest to be kept."""
        answers = ["yes" if self.keeps(limit) else "NO" for limit in self.best.limits]
        return {"limits of the policy": self.best.table(self.totals, answers)}
