"""What an audit says: the regret, where it arises, and a verdict on each limit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import ROUND_DOWN, Context, Decimal
from fractions import Fraction
from functools import cached_property
from math import inf, isfinite, isinf, isnan, nan
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.gate.columns import Representation
from exact_mdp.analysis.gate.data.interval import RegretInterval
from exact_mdp.analysis.gate.data.posterior import PosteriorInterval
from exact_mdp.analysis.gate.disagreements import Disagreement, Findings, either
from exact_mdp.analysis.gate.limits import UnderLimits
from exact_mdp.analysis.gate.q_error import QError, q_error
from exact_mdp.analysis.gate.regret import Regret
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, ReadAs
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, shown
from exact_mdp.solvers.objectives.limits import Limit
from exact_mdp.solvers.solution import Bounded, Certified, Claim, SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from pandas import DataFrame


SHOWN = 5  # states that `message` names
AT_A_GLANCE = 3  # of them in `print(audit)`
UNEXPLAINED = "not known: whether a policy that reads the same columns could do better"


@dataclass(frozen=True, kw_only=True)
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
    >>> found = Verdict(subject="the regret", limit="zero", decision=False, text="it is 2")
    >>> found.name, found.passed, found.told
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
    def undecided(self) -> bool:
        """Whether bounds or records leave it open."""
        return self.decision is None

    @property
    def told(self) -> str:
        """What was found, as a sentence: the name of a check that fails is not what was found."""
        holds = {True: "is", False: "is not", None: "is not known to be"}[self.decision]
        return f"{self.subject} {holds} {self.limit}: {self.text}"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Audit(Pictured):
    """What a policy loses against the optimum, where and why.

    Attributes
    ----------
    mdp : MDP
    policy : Policy
        The policy, or the greedy policy of the Q-table.
    chain : PolicyChain
        The model under it.
    regret : Regret
        Values and regret, at the start (`regret.at_start`) and in every state (`.by_state`).
    found : callable
        Makes `visits` and `disagreements` when they are first asked for.
    max_regret, max_relative_regret : Fraction, optional
        The limits; without either, the regret has to be zero.
    criterion : "total" or "average"
        Whether the values are total rewards, or rewards per step in the long run.
    limits : UnderLimits, optional
        The limits, the optimum under them and the policy's totals. The regret is against that
        optimum, and values and gaps of states are those of the reward and the priced totals.
    interval : RegretInterval, optional
        Where the regret lies in the process behind the records; the verdicts then rest on it, and
        all other numbers are those of the estimated model.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> from exact_mdp import check
    >>> audit = check(mdp, [0, 0])
    >>> print(audit.value, audit.frame()["gap"].tolist())
    2 (certified) [2.0]
    """

    mdp: MDP
    policy: Policy
    chain: PolicyChain
    regret: Regret
    found: Callable[[], Findings] = field(repr=False)
    max_regret: Fraction | None = None
    max_relative_regret: Fraction | None = None
    criterion: str = "total"
    limits: UnderLimits | None = None
    interval: RegretInterval | None = None

    # ---- numbers -----------------------------------------------------------------------------

    @property
    def value(self) -> Certified | Bounded:
        """The regret at the start."""
        return self.regret.at_start

    @property
    def error(self) -> float:
        """How far the regret may be off; 0 where it is certified."""
        return self.value.error if isinstance(self.value, Bounded) else 0.0

    @property
    def claim(self) -> Claim:
        """What the verdict can claim: that of the regret, or of the interval it rests on."""
        return self.value.claim if self.interval is None else self.interval.claim

    @property
    def read_as(self) -> ReadAs:
        """What the policy was taken from: "q" or "policy"."""
        return self.policy.read_as

    @property
    def forgiven(self) -> Fraction:
        """The regret that counts as none where no limit is given; 0 in an exact model."""
        return self.regret.forgiven

    @property
    def feasible(self) -> bool:
        """Whether some policy keeps the limits; without one there is no optimum to compare with."""
        return self.limits is None or self.limits.best.feasible

    @property
    def relative_regret(self) -> float | None:
        """Regret at the start over the absolute optimal value; None where that is, or may be, 0."""
        best, lost = self.regret.optimal, float(self.value.value)
        if not (np.isfinite(float(best.value)) and np.isfinite(lost)):
            return lost if np.isfinite(float(best.value)) and best.value else None
        low, high = (best.value, best.value) if isinstance(best, Certified) else best.interval
        if low <= 0 <= high:
            return None
        return float(Fraction(self.value.value) / abs(Fraction(best.value)))

    @property
    def regret_interval(self) -> tuple[float, float] | None:
        """The ends of the interval; None where no confidence was asked for."""
        return None if self.interval is None else (self.interval.low, self.interval.high)

    @property
    def begins(self) -> str:
        """Where runs start, from where the regret is measured, in words."""
        start = self.mdp.start
        if len(start) == 1:
            return self.mdp.space.label(start[0][0])
        return f"{len(start)} states, each with its probability"

    # ---- states ------------------------------------------------------------------------------

    @cached_property
    def _findings(self) -> Findings:
        visits, wrong = self.found()
        return visits, wrong if self.feasible else ()

    @property
    def visits(self) -> Floats:
        """(S,) expected discounted visits from the start; NaN where floats cannot bound them."""
        return self._findings[0]

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """States with a choice where it does not act optimally, the costliest first."""
        return self._findings[1]

    @property
    def never_reached(self) -> int:
        """The number of disagreements in states that the policy never reaches from the start."""
        return sum(each.expected_visits == 0 for each in self.disagreements)

    @property
    def agreement(self) -> float:
        """Share of the states with a choice in which all that the policy does is optimal.

        `unclear` states count as agreement. NaN where no policy keeps the limits.
        """
        states = int(self.mdp.asked.sum())
        if not self.feasible:
            return nan
        return 1 - len(self.disagreements) / states if states else 1.0

    @property
    def agreement_by_visits(self) -> float:
        """The same share of the policy's visits to states with a choice."""
        if not self.feasible:
            return nan
        total = float(self.visits[self.mdp.asked].sum())
        wrong = sum(each.expected_visits for each in self.disagreements)
        return 1.0 if total == 0 else float(np.maximum(0.0, 1 - wrong / total))

    @cached_property
    def unclear(self) -> int:
        """Number of states in which bounds do not decide whether the policy is optimal."""
        open_ = np.zeros(self.mdp.n_states, dtype=bool)
        open_[self.mdp.pair_state[self.regret.unclear & (self.chain.chosen > 0)]] = True
        open_[[each.state for each in self.disagreements]] = False
        return int((open_ & self.mdp.asked).sum())

    def frame(self, *, full: bool = False) -> DataFrame:
        """Return the disagreements, by the number of the state; `full` adds expected visits."""
        import pandas

        lost = sum(each.cost for each in self.disagreements)
        names = ["label", "learned", "optimal", "cost", "share", "gap"]
        rows = [
            {
                name: getattr(each, name)
                for name in ("state", *names, "expected_visits")
                if name != "share"
            }
            | {"optimal": " or ".join(each.optimal), "share": share_of(each.cost, lost)}
            for each in self.disagreements
        ]
        names += ["expected_visits"] * full
        return pandas.DataFrame(rows, columns=["state", *names]).set_index("state")

    # ---- verdicts ----------------------------------------------------------------------------

    @property
    def passed(self) -> bool:
        """Whether every limit holds; what bounds cannot decide does not pass."""
        return all(each.passed for each in self.verdicts)

    @property
    def undecided(self) -> bool:
        """Whether the bounds leave a verdict open, which then does not pass."""
        return any(each.undecided for each in self.verdicts)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What was checked: each limit given, or that the regret is zero."""
        if self.interval is not None:
            return (self._of_process(self.interval),)
        found = [] if self.limits is None else _kept(self.limits)
        if not self.feasible:
            return tuple(found)
        limit, relative, text = self.max_regret, self.max_relative_regret, f"it is {self._regret}"
        if self.limits is not None:
            text += ", against the best policy that keeps the limits"
        if limit is None and relative is None:
            decision, name = self.regret.zero, "zero" if self.limits is None else "at most 0"
            if self.forgiven:
                name += " up to the rounding of the given floats"
                text += f"; rounding can move it by {_below(self.forgiven)}"
            found.append(_verdict("the regret", name, decision, text))
        if limit is not None:
            name = f"at most {shown(limit, 10)}"
            found.append(_verdict("the regret", name, self.regret.decided(limit), text))
        if relative is not None:
            name = f"at most {shown(relative, 10)}"
            found.append(_verdict("the relative regret", name, *self._relative(relative)))
        return tuple(found)

    @property
    def _regret(self) -> str:
        return _number(self.value)

    def _of_process(self, interval: RegretInterval) -> Verdict:
        """Return what the interval decides, never the estimate."""
        limit = self.max_regret
        name = "zero" if limit is None else f"at most {shown(limit, 10)}"
        decision = interval.decided(self.forgiven if limit is None else limit)
        text = f"it is in {interval}; {self._regret} in the estimated model"
        if decision is None and isinstance(interval, PosteriorInterval):
            share = interval.within(limit or Fraction(0)).value
            text += f", {OPEN}: it is kept with probability {share:.3g} by the posterior"
        elif decision is None:
            text += f", {OPEN}: more records may decide it, or give a limit above the interval"
        return Verdict(subject="the regret", limit=name, decision=decision, text=text)

    def _relative(self, limit: Fraction) -> tuple[bool | None, str]:
        """Return whether the relative regret keeps a limit, and what it is."""
        if self.relative_regret is None:
            return False, "it is undefined, because the optimal value is, or may be, 0"
        best = self.regret.optimal
        ends = (best.value, best.value) if isinstance(best, Certified) else best.interval
        low, high = sorted(limit * abs(Fraction(end)) for end in ends)
        decision = False if self.regret.decided(high) is False else None
        if self.regret.decided(low):
            decision = True
        return decision, f"it is {self.relative_regret:.6g} ({self.claim})"

    # ---- reasons -----------------------------------------------------------------------------

    @property
    def _of_totals(self) -> bool:
        """Whether values are plain totals, of which there is more to say."""
        return self.criterion == "total" and self.limits is None

    @cached_property
    def q_error(self) -> QError | None:
        """How wrong the Q-table is; None for a policy, and under limits."""
        if self.policy.values is None or not self._of_totals:
            return None
        gap = self.regret.gap if self.mdp.sense == "max" else -self.regret.gap
        optimal = self.regret.optimal_value[self.mdp.pair_state] - gap
        visited = np.where(self.chain.weights > 0, self.visits[self.mdp.pair_state], 0.0)
        return q_error(self.mdp, self.policy, optimal, visited * self.chain.weights)

    @cached_property
    def representation(self) -> Representation | None:
        """What the policy's columns cannot express.

        None where it reads the whole state, under limits, and where it is `unexplained`. The
        verdict does not depend on it.
        """
        if not self._partial:
            return None
        try:
            return Representation.of(self.mdp, self.policy, self.regret)
        except (SolverError, ModelError):
            return None

    @property
    def unexplained(self) -> bool:
        """Whether floating point cannot tell what the policy's columns cannot express."""
        return self._partial and self.representation is None

    @property
    def _partial(self) -> bool:
        return set(self.policy.columns) != set(self.mdp.space.names) and self._of_totals

    # ---- words -------------------------------------------------------------------------------

    @property
    def question(self) -> str:
        """What was read, how rewards add up and from where: all that a number here depends on."""
        space = self.mdp.space
        sums = f"discount {self.mdp.discount}".removesuffix(".0")
        if self.criterion == "average":
            sums = "reward per step"
        steps = "" if space.untimed is None else f", horizon {space.columns[0].size - 1}"
        read = self.policy.source or "a policy"
        return f"read as {read}, {sums}{steps}, start {self.begins}"

    def __repr__(self) -> str:
        return f"Audit({self.question}; {self._outcome})"

    @property
    def _outcome(self) -> str:
        if self.limits is not None and not self.feasible:
            return f"failed: no policy keeps {', '.join(map(str, self.limits.best.limits))}"
        lost = f"regret {self._regret}"
        if self.interval is not None:
            lost = f"regret in {self.interval}; estimated {self._regret}"
        word = "passed" if self.passed else "failed, left open" if self.undecided else "failed"
        best = float(self.regret.optimal.value)
        return f"{word}: {lost} of {best:.6g}, {len(self.disagreements)} disagreements"

    def __str__(self) -> str:
        return "\n".join([self.question, self._outcome, *self._costliest(AT_A_GLANCE)])

    def message(self, *, explain: bool = True) -> str:
        """Return in words what was found, the costly states by name.

        With `explain` also what the policy's columns cannot express, which takes a search.
        """
        lines = [self.question]
        lines += [f"{'passed' if each.passed else 'failed'}: {each.told}" for each in self.verdicts]
        best, own = (
            f"{float(each.value):.10g}" for each in (self.regret.optimal, self.regret.learned)
        )
        if not self.feasible:
            return "\n".join([*lines, f"there is no optimum to compare with; learned {own}"])
        lines.append(
            f"optimal value {best}, learned {own}; not optimal in {len(self.disagreements)} of"
            f" {int(self.mdp.asked.sum())} states with a choice"
        )
        if self.unclear:
            lines.append(f"in {self.unclear} more the bounds leave it open")
        lines += self._costliest(SHOWN)
        if explain and self.representation is not None:
            lines.append(str(self.representation))
        elif explain and self.unexplained:
            lines.append(UNEXPLAINED)
        return "\n".join(lines)

    def _costliest(self, most: int) -> list[str]:
        """Return a line for each of the costliest states, one for others, one for never visited."""
        met = [each for each in self.disagreements if each.expected_visits != 0]
        lines = [
            f"  {each.label}: yours {each.learned}, optimal {either(each.optimal)}; {_lost(each)}"
            for each in met[:most]
        ]
        if len(met) > most:
            rest = sum(each.cost for each in met[most:])
            lines.append(f"  and {len(met) - most} more, {rest:.6g} in all")
        if self.never_reached:
            lines.append(f"  and {self.never_reached} that it never visits, which cost nothing")
        return lines


UNDECIDED = (
    "which the bounds do not decide: give a limit that they keep (--max-regret,"
    " max_regret=…), or ask for exact values (--certify, exact_values=True)"
)

OPEN = "which leaves the limit open"


def share_of(cost: float, lost: float) -> float | None:
    """Return a cost as a share of all that is lost; None where that is 0 or infinite."""
    return cost / lost if 0 < lost < inf else None


def _verdict(subject: str, limit: str, decision: bool | None, text: str) -> Verdict:
    if decision is None:
        text = f"{text}, {UNDECIDED}"
    return Verdict(subject=subject, limit=limit, decision=decision, text=text)


def _kept(limits: UnderLimits) -> list[Verdict]:
    """Return what is checked of limits."""
    found = [_within(limits, limit) for limit in limits.best.limits]
    if not limits.best.feasible:
        near = ", ".join(limit.text(10) for limit in limits.best.moved)
        text = f"none does (proven); the closest that can be kept: {near}"
        found.append(_verdict("there", "a policy that keeps all limits", False, text))
    return found


def _within(limits: UnderLimits, limit: Limit) -> Verdict:
    total = _number(Certified(value=limits.totals[limit.name]))
    name = f"within the limit {limit}"
    return _verdict("the policy", name, limits.keeps(limit), f"its total is {total}")


def _lost(each: Disagreement) -> str:
    """Return in words what is lost in a state."""
    if isinf(each.expected_visits) and isfinite(each.cost):
        return f"waits for ever and loses {each.cost:.6g}"
    if isnan(each.cost):
        return f"loses {each.gap:.6g} a visit; how often it is visited is not known"
    return f"loses {each.gap:.6g} x {each.expected_visits:.6g} visits = {each.cost:.6g}"


def _number(value: Certified | Bounded) -> str:
    """Return a number with its claim; an exact one may have thousands of digits, and is rounded."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


def _below(number: Fraction) -> str:
    """Return a number of two digits that is not above the given one."""
    rounded = Context(prec=2, rounding=ROUND_DOWN).create_decimal(Decimal(float(number)))
    return f"up to {rounded:g}"
