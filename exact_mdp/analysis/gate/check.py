"""The audit of a policy or Q-table from anywhere against the exact optimum.

    audit = check(model, policy, max_regret=…)   # how much it loses, where, and why
    audit = check(model, policy, subject_to=…)   # and whether it keeps limits on expected totals
    assert_policy_optimal(model, policy)         # the same as an assertion

The verdicts compare the regret at the start with the limits given, exactly where it is certified.
Where it is bounded, the upper bound has to keep the limit: what the bounds do not decide does not
pass. Without a limit the regret has to be zero: exactly, but for what the rounding of given floats
can move (`analysis.gate.forgiveness`).

A model estimated from records may be wrong. With `confidence`, the verdicts are about the process
that the records are from: an interval for its regret (`analysis.gate.data`) has to keep the limit.

No number in a verdict is sampled: see `analysis.gate.regret` for what is lost,
`analysis.gate.disagreements` for the price of each state, `analysis.gate.reasons` for what the
policy's columns cannot express and for the errors of a Q-table. Ties are known: an action as good
as the best is optimal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import ROUND_DOWN, Context, Decimal
from fractions import Fraction
from functools import cached_property, partial
from math import inf, isfinite, isinf, isnan, nan
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.average import average_regret
from exact_mdp.analysis.gate.data import off_policy, posterior, robust
from exact_mdp.analysis.gate.data.interval import Evidence, RegretInterval, confidence_of
from exact_mdp.analysis.gate.disagreements import Disagreement, Findings, either, findings
from exact_mdp.analysis.gate.limits import UnderLimits, limit_of
from exact_mdp.analysis.gate.reasons import (
    QError,
    Representation,
    pair_values,
    q_error,
    representation,
)
from exact_mdp.analysis.gate.regret import LAST_CYCLE, Regret, cheap, regret
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike, ReadAs
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, shown
from exact_mdp.solvers.solution import Bounded, Certified, Claim, SolverError
from exact_mdp.solvers.solver import Criterion, is_average, mdp_of, require_no_horizon
from exact_mdp.solvers.values.policy_chain import PolicyChain, policy_of

if TYPE_CHECKING:
    from pandas import DataFrame


# Loaded where an audit asks for an interval.

SHOWN = 5
AT_A_GLANCE = 3  # of them in `print(audit)`
UNEXPLAINED = "not known: whether a policy that reads the same columns could do better"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One thing that was checked, by name, whether it holds, and what was found in words."""

    name: str
    passed: bool
    text: str

    @property
    def undecided(self) -> bool:
        """Whether it does not pass because bounds or records leave it open."""
        return not self.passed and (OPEN in self.text or self.text.endswith(UNDECIDED))

    @property
    def told(self) -> str:
        """What was found, as a sentence: the name of a check that fails is not what was found.

        Examples
        --------
        >>> Verdict(name="the regret is zero", passed=False, text="it is 2 (certified)").told
        'the regret is not zero: it is 2 (certified)'
        """
        if self.passed:
            return f"{self.name}: {self.text}"
        words = "is not known to be" if self.undecided else "is not"
        return f"{self.name.replace(' is', f' {words}', 1)}: {self.text}"


Decision = tuple[bool | None, Callable[[], tuple[str, str]]]
"""Whether something holds (None: it stays open); its name, and what was found."""


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
        Makes `visits` and `disagreements` when they are first asked for: a verdict does not need
        them.
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

    def __repr__(self) -> str:
        lost = f"regret {_number(self.value)}"
        if self.interval is not None:
            lost = f"regret in {self.interval}; estimated {_number(self.value)}"
        word = "failed, left open" if self.undecided else "failed"
        if self.limits is not None and not self.feasible:
            kept = ", ".join(map(str, self.limits.best.limits))
            return f"Audit(failed: no policy keeps {kept}; {self._question})"
        return (
            f"Audit({'passed' if self.passed else word}: {lost} of "
            f"{float(self.regret.optimal.value):.6g}, {len(self.disagreements)} disagreements; "
            f"{self._question})"
        )

    @property
    def feasible(self) -> bool:
        """Whether some policy keeps the limits; without one there is no optimum to compare with."""
        return self.limits is None or self.limits.best.feasible

    @property
    def _question(self) -> str:
        """What was read, and how rewards add up: all that a number of the audit depends on."""
        known, space = self.policy.source or "a policy", self.mdp.space
        sums = f"discount {self.mdp.discount}".removesuffix(".0")
        if self.criterion == "average":
            sums = "reward per step"
        steps = "" if space.untimed is None else f", horizon {space.columns[0].size - 1}"
        return f"read as {known}, {sums}{steps}"

    def __str__(self) -> str:
        return "\n".join([repr(self), *self._costliest(AT_A_GLANCE)])

    @property
    def visits(self) -> Floats:
        """(S,) expected discounted visits of the policy from the start; undiscounted at discount 1.

        NaN where floats cannot bound them, in a model too large for rational arithmetic.
        """
        return self._findings[0]

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """States with a choice where it does not act optimally, the costliest first."""
        return self._findings[1]

    @cached_property
    def _findings(self) -> Findings:
        visits, wrong = self.found()
        return visits, wrong if self.feasible else ()

    @property
    def begins(self) -> str:
        """Where runs start, from where the regret is measured, in words."""
        start = self.mdp.start
        if len(start) == 1:
            return self.mdp.space.label(start[0][0])
        return f"{len(start)} states, each with its probability"

    @property
    def never_reached(self) -> int:
        """The number of disagreements in states that the policy never reaches from the start."""
        return sum(each.expected_visits == 0 for each in self.disagreements)

    def frame(self, *, full: bool = False) -> DataFrame:
        """Return the disagreements, by the number of the state, the costliest first.

        `cost` is the value lost in the state, and `share` its share of all that is lost; `full`
        adds expected visits, what one correction gains, and what one mistake costs alone.
        """
        import pandas

        lost = sum(each.cost for each in self.disagreements)
        names = ["label", "learned", "optimal", "cost", "share", "gap"]
        if full:
            names += ["expected_visits", "gain_if_corrected", "loss_if_alone"]
        known = set(names) - {"optimal", "share"} | {"state"}
        rows = [
            {name: getattr(each, name) for name in known}
            | {"optimal": " or ".join(each.optimal), "share": share_of(each.cost, lost)}
            for each in self.disagreements
        ]
        return pandas.DataFrame(rows, columns=["state", *names]).set_index("state")

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
        """What the verdict can claim: that of the regret, or of the interval where it rests on one.

        The regret in the estimated model keeps its own: `audit.value.claim`.
        """
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
    def relative_regret(self) -> float | None:
        """Regret at the start over the absolute optimal value; None where that is, or may be, 0."""
        best, lost = self.regret.optimal, float(self.value.value)
        if not (np.isfinite(float(best.value)) and np.isfinite(lost)):
            return lost if np.isfinite(float(best.value)) and best.value else None
        low, high = (best.value, best.value) if isinstance(best, Certified) else best.interval
        if low <= 0 <= high:
            return None
        return float(Fraction(self.value.value) / abs(Fraction(best.value)))

    # ---- verdicts ----------------------------------------------------------------------------

    @property
    def regret_interval(self) -> tuple[float, float] | None:
        """The ends of the interval; None where no confidence was asked for."""
        return None if self.interval is None else (self.interval.low, self.interval.high)

    @property
    def passed(self) -> bool:
        """Whether every limit holds; what bounds cannot decide does not pass."""
        return all(decision is True for decision, _ in self._decisions)

    @property
    def undecided(self) -> bool:
        """Whether the bounds leave a verdict open, which then does not pass."""
        return any(decision is None for decision, _ in self._decisions)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What was checked: each limit given, or that the regret is zero."""
        found = []
        for decision, words in self._decisions:
            name, text = words()
            text = text if decision is not None else f"{text}, {self._open}"
            found.append(Verdict(name=name, passed=decision is True, text=text))
        return tuple(found)

    @property
    def _open(self) -> str:
        if self.interval is None:
            return UNDECIDED
        if isinstance(self.interval, posterior.PosteriorInterval):
            limit = self.max_regret or Fraction(0)
            share = self.interval.within(limit).value
            return f"{OPEN}: it is kept with probability {share:.3g} by the posterior"
        return f"{OPEN}: more records may decide it, or give a limit above the interval"

    @cached_property
    def _decisions(self) -> tuple[Decision, ...]:
        """What is checked, by limit: whether it holds, and the words for that."""
        if self.interval is not None:
            return (self._of_process(self.interval),)
        found, text = _kept(self.limits), f"it is {_number(self.value)}"
        if not self.feasible:
            return tuple(found)
        held = self.limits is not None
        if held:
            text += ", against the best policy that keeps the limits"
        limit, relative = self.max_regret, self.max_relative_regret
        if limit is None and relative is None:
            name = f"the regret is {'at most 0' if held else 'zero'}"

            found.append((self.regret.zero, partial(self._unless_rounding, name, text)))
        if limit is not None:
            name = f"the regret is at most {shown(limit, 10)}"
            found.append(_decision(name, self.regret.decided(limit), text))
        if relative is not None:
            name = f"the relative regret is at most {shown(relative, 10)}"
            found.append(_decision(name, *self._relative(relative)))
        return tuple(found)

    def _unless_rounding(self, name: str, text: str) -> tuple[str, str]:
        if not self.forgiven:
            return name, text
        moved = f"; rounding can move it by {_below(self.forgiven)}"
        return f"{name} up to the rounding of the given floats", text + moved

    def _of_process(self, interval: RegretInterval) -> Decision:
        """Return what the interval decides, never the estimate."""
        limit = self.max_regret
        if limit is None:
            name, decision = "the regret is zero", interval.decided(self.forgiven)
        else:
            name, decision = f"the regret is at most {shown(limit, 10)}", interval.decided(limit)
        text = f"it is in {interval}; {_number(self.value)} in the estimated model"
        return _decision(name, decision, text)

    def _relative(self, limit: Fraction) -> tuple[bool | None, str]:
        """Return whether the relative regret keeps a limit, and what it is."""
        best = self.regret.optimal
        if self.relative_regret is None:
            return False, "it is undefined, because the optimal value is, or may be, 0"
        text = f"it is {self.relative_regret:.6g} ({self.claim})"
        if isinstance(best, Certified):
            return self.regret.decided(limit * abs(Fraction(best.value))), text
        low, high = sorted(abs(Fraction(end)) for end in best.interval)
        if self.regret.decided(limit * low):
            return True, text
        return (False if self.regret.decided(limit * high) is False else None), text

    # ---- agreement ---------------------------------------------------------------------------

    @cached_property
    def _choosing(self) -> NDArray[np.bool_]:
        return self.mdp.asked

    @property
    def agreement(self) -> float:
        """Share of the states with a choice in which all that the policy does is optimal.

        Terminal states do not count, and `unclear` ones as agreement. 1 where there is no choice;
        NaN where no policy keeps the limits.
        """
        if not self.feasible:
            return nan
        states = int(self._choosing.sum())
        return 1 - len(self.disagreements) / states if states else 1.0

    @cached_property
    def unclear(self) -> int:
        """Number of states in which bounds do not decide whether the policy is optimal."""
        used = self.regret.unclear & (self.chain.chosen > 0)
        states = np.unique(self.mdp.pair_state[used])
        listed = {each.state for each in self.disagreements}
        return sum(self._choosing[s] and s not in listed for s in states.tolist())

    @property
    def agreement_by_visits(self) -> float:
        """The same share of the policy's visits to states with a choice."""
        if not self.feasible:
            return nan
        total = float(self.visits[self._choosing].sum())
        wrong = sum(each.expected_visits for each in self.disagreements)
        return 1.0 if total == 0 else float(np.maximum(0.0, 1 - wrong / total))

    # ---- reasons -----------------------------------------------------------------------------

    @cached_property
    def q_error(self) -> QError | None:
        """How wrong the Q-table is; None for a policy, and under limits."""
        if self.policy.values is None or self.criterion == "average" or self.limits is not None:
            return None
        said = pair_values(self.mdp, self.policy, self.policy.values)
        gap = self.regret.gap if self.mdp.sense == "max" else -self.regret.gap
        optimal = self.regret.optimal_value[self.mdp.pair_state] - gap
        visited = np.where(self.chain.weights > 0, self.visits[self.mdp.pair_state], 0.0)
        used = visited * self.chain.weights
        return q_error(self.mdp, said, optimal, used)

    @cached_property
    def representation(self) -> Representation | None:
        """What the policy's columns cannot express.

        None where it reads the whole state, under limits, where some policy never ends at discount
        1, or where floating point cannot bound the values that the search needs (`unexplained`).
        The verdict does not depend on it.
        """
        if self._reads_all:
            return None
        try:
            return representation(self.mdp, self.policy, self.regret)
        except (SolverError, ModelError):
            return None

    @property
    def unexplained(self) -> bool:
        """Whether floating point cannot tell what the policy's columns cannot express."""
        return not self._reads_all and self.representation is None

    @property
    def _reads_all(self) -> bool:
        reads = set(self.policy.columns) == set(self.mdp.space.names)
        return reads or self.criterion == "average" or self.limits is not None

    def message(self, *, explain: bool = True) -> str:
        """Return in words what was found, the costly states by name.

        Parameters
        ----------
        explain : bool
            Say also what the policy's columns cannot express, which takes a search.

        Returns
        -------
        str
            Several lines.
        """
        lost, listed, source = self.regret, self.disagreements, self.policy.source
        lines = [f"the array was read as {source}"] if source else []
        lines += [f"{'passed' if each.passed else 'failed'}: {each.told}" for each in self.verdicts]
        best, own = (f"{float(each.value):.10g}" for each in (lost.optimal, lost.learned))
        if not self.feasible:
            return "\n".join([*lines, f"there is no optimum to compare with; learned {own}"])
        lines.append(
            f"optimal value {best}, learned {own}; not optimal in {len(listed)} of"
            f" {int(self._choosing.sum())} states with a choice"
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
        """Return a line for each of the costliest states, and one for the others."""
        listed = self.disagreements
        lines = [
            f"  {each.label}: yours {each.learned}, optimal {either(each.optimal)};"
            + (
                f" waits for ever and loses {each.cost:.6g}"
                if isinf(each.expected_visits) and isfinite(each.cost)
                else f" loses {each.gap:.6g} x {each.expected_visits:.6g} visits = {each.cost:.6g}"
                if not isnan(each.cost)
                else f" loses {each.gap:.6g} a visit; how often it is visited is not known"
            )
            for each in listed[:most]
        ]
        if len(listed) > most:
            rest = sum(each.cost for each in listed[most:])
            lines.append(f"  and {len(listed) - most} more, {rest:.6g} in all")
        return lines


UNDECIDED = (
    "which the bounds do not decide: give a limit that they keep (--max-regret,"
    " max_regret=…), or ask for exact values (--certify, exact_values=True)"
)

OPEN = "which leaves the limit open"


def share_of(cost: float, lost: float) -> float | None:
    """Return a cost as a share of all that is lost; None where that is 0 or infinite."""
    return cost / lost if 0 < lost < inf else None


First = TypeVar("First")
Second = TypeVar("Second")


def _both(first: First, second: Second) -> tuple[First, Second]:
    return first, second


def _decision(name: str, decision: bool | None, text: str) -> Decision:
    return decision, partial(_both, name, text)


def _kept(limits: UnderLimits | None) -> list[Decision]:
    """Return what is checked of limits."""
    if limits is None:
        return []
    found = list[Decision]()
    for limit in limits.best.limits:
        total = Certified(value=limits.totals[limit.name])
        name = f"the policy is within the limit {limit}"
        found.append(_decision(name, limits.keeps(limit), f"its total is {_number(total)}"))
    if not limits.best.feasible:
        near = ", ".join(limit.text(10) for limit in limits.best.moved)
        text = f"none does (proven); the closest that can be kept: {near}"
        found.append(_decision("there is a policy that keeps all limits", False, text))
    return found


def _number(value: Certified | Bounded) -> str:
    """Return a number with its claim; an exact one may have thousands of digits, and is rounded."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


def _below(number: Fraction) -> str:
    """Return a number of two digits that is not above the given one."""
    rounded = Context(prec=2, rounding=ROUND_DOWN).create_decimal(Decimal(float(number)))
    return f"up to {rounded:g}"


# ---- the two verbs -----------------------------------------------------------------------------


def check(
    model: MDP | Scenario,
    policy: PolicyLike,
    *,
    max_regret: object | None = None,
    max_relative_regret: object | None = None,
    exact_values: bool | None = None,
    kind: str = "auto",
    horizon: int | None = None,
    criterion: Criterion = "total",
    subject_to: Mapping[str, Any] | None = None,
    like: Audit | None = None,
    confidence: object | None = None,
    by: str | Evidence = "robust",
) -> Audit:
    """Return how much a policy or Q-table loses against the optimum, where and why.

    Parameters
    ----------
    model : MDP or Scenario
    policy : PolicyLike
        "optimal", "random", "always:ACTION", a mapping, an array, a Policy, a Solution, a training
        run or a path, Q-tables included. Of these the greedy policy counts, the lowest action
        number on a tie.
    max_regret, max_relative_regret : number or "p/q", optional
        Limits for the regret at the start and for its ratio to the absolute optimal value, which is
        undefined where that is 0, and does not pass. Without either, the audit passes only where
        the regret is zero: in a model of floats, where it is at most what the rounding of the
        numbers given can move (`Audit.forgiven`). A limit of 0 forgives nothing.
    exact_values : bool, optional
        Rational arithmetic or bounds in floats; see `analysis.gate.regret.regret`. Unless given,
        bounds that leave a verdict open are followed by rational arithmetic in models of up to
        100,000 transitions without cycles of over 500 states.
    kind : "auto", "q" or "policy"
        What a two-dimensional array or a file of one holds; `mdp.policies.arrays` states the rule
        of "auto", and `Audit.read_as` says what was taken.
    horizon : int, optional
        Stop after this many steps, without a further reward: the audit is that of
        `mdp.within(horizon)`. What is learned over states is the same at every time there; tables
        (N, S, A) depend on time.
    criterion : "total" or "average"
        Whether the total reward counts, discounted as the model says, or the average reward per
        step in the long run; see `analysis.gate.average`.
    subject_to : {name: ">= p/q" or "<= p/q"}, optional
        Limits on expected totals that the policy has to keep, as `solve` takes them. The regret is
        then against the optimum under these limits, exactly, and nothing is forgiven.
    like : Audit, optional
        An audit of another policy by the same model object (`like.mdp is model`): its optimum is
        not computed again.
    confidence : number, optional
        Of a model estimated from records: let the verdict rest on an interval, at this confidence,
        for the regret in the process behind the records, `Audit.interval`. The audit then passes
        where the upper end keeps `max_regret`.
    by : "robust", "posterior" or "off-policy", or one of these with settings
        What the interval is made by: `Robust`, `Posterior` or `OffPolicy(records=…)`.

    Returns
    -------
    Audit

    Raises
    ------
    ModelError
        For a policy that does not fit the model, an array that may be read in two ways, or a limit
        that is not a number of at least 0; where a total swings for ever at discount 1; for a
        confidence where the model has no counts, or with a limit of the relative regret.
    SolverError
        Where floats cannot bound the answer in a model too large for rational arithmetic.

    Examples
    --------
    >>> wait, cut = [[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]], [[1, 0, 0]] * 3
    >>> forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
    >>> audit = check(forest, [0, 1, 1])
    >>> audit.passed, round(float(audit.regret.at_start.value), 3), round(audit.agreement, 3)
    (False, 63.062, 0.333)
    """
    evidence = _evidence(by, confidence)
    other = max_relative_regret is not None or subject_to is not None or is_average(criterion)
    if evidence is not None and other:
        raise ModelError(
            "records bound the total regret alone",
            where="confidence",
            fix="give max_regret, without a relative limit, limits on totals or an average reward",
        )
    endless = mdp = mdp_of(model)
    if horizon is not None:
        mdp = mdp.within(horizon)
    limits: dict[str, Any] = {
        "max_regret": None if max_regret is None else limit_of("max_regret", max_regret),
        "max_relative_regret": None
        if max_relative_regret is None
        else limit_of("max_relative_regret", max_relative_regret),
    }
    held = policy_of(mdp, policy, kind=kind, criterion=criterion)
    under = None
    if subject_to is not None:
        if is_average(criterion):
            raise ModelError(
                "limits hold of total rewards, not of an average",
                where="subject_to",
                fix="leave criterion out",
            )
        under, exact_values = UnderLimits.of(mdp, held, subject_to), True
    rewards = (mdp if under is None else under.priced).maximised
    costs = mdp.sense == "min"
    chain = PolicyChain.of(rewards, held)
    if is_average(criterion):
        require_no_horizon(horizon)
        exact_values = cheap(mdp, LAST_CYCLE) if exact_values is None else exact_values
        lost, visits, wrong = average_regret(rewards, chain, exact=exact_values)
        return Audit(
            mdp=mdp,
            policy=held,
            chain=PolicyChain.of(mdp, held) if costs else chain,
            regret=lost.negated() if costs else lost,
            found=partial(_both, visits, wrong),
            criterion=criterion,
            **limits,
        )

    known = None
    if like is not None and under is None and like.limits is None:
        if like.mdp is not mdp or like.criterion != criterion:
            raise ModelError(
                "the audit is of another model",
                where="like",
                fix="give its model: check(audit.mdp, policy, like=audit)",
            )
        known = like.regret.optimum

    def audit(exactly: bool | None) -> Audit:
        lost = regret(rewards, chain, exact=exactly, optimum=known)
        signed = lost.negated() if costs else lost
        return Audit(
            mdp=mdp,
            policy=held,
            chain=PolicyChain.of(mdp, held) if costs else chain,
            regret=signed if under is None else under.regret(signed),
            found=partial(findings, rewards, chain, lost),
            limits=under,
            **limits,
        )

    try:
        result = audit(exact_values)
    except SolverError:  # floats cannot bound the answer, which rational arithmetic may give
        if exact_values is not None or not cheap(mdp, LAST_CYCLE):
            raise
        result = audit(True)
    if exact_values is None and result.undecided and cheap(mdp, LAST_CYCLE):
        with suppress(ModelError):  # a cycle that is too ill-conditioned leaves it undecided
            result = audit(True)
    if evidence is None:
        return result
    found = evidence.interval(endless, chain, confidence_of(confidence), horizon)
    return replace(result, interval=found)


def assert_policy_optimal(
    model: MDP | Scenario,
    policy: PolicyLike,
    max_regret: object | None = None,
    *,
    max_relative_regret: object | None = None,
    kind: str = "auto",
    horizon: int | None = None,
    criterion: Criterion = "total",
    subject_to: Mapping[str, Any] | None = None,
    confidence: object | None = None,
    by: str | Evidence = "robust",
) -> Audit:
    """Raise AssertionError, naming the costly states, unless the regret keeps its limits.

    Parameters
    ----------
    model : MDP or Scenario
    policy : PolicyLike
        A policy or Q-table; see `check`.
    max_regret, max_relative_regret : number or "p/q", optional
        Limits at the start; both must hold. Without either the regret must be zero; see `check`.
    kind : "auto", "q" or "policy"
        What a two-dimensional array holds; see `check`.
    horizon : int, optional
        Stop after this many steps; see `check`.
    criterion : "total" or "average"
        What counts; see `check`.
    subject_to : {name: ">= p/q" or "<= p/q"}, optional
        Limits on expected totals, which the policy has to keep too; see `check`.
    confidence, by
        Decide by an interval of the regret in the process behind the records; see `check`.

    Returns
    -------
    Audit
        For further checks.

    Raises
    ------
    AssertionError
        Where a limit does not hold.
    ModelError
        As `check` does.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> assert_policy_optimal(mdp, [0, 0])
    Traceback (most recent call last):
    AssertionError: failed: the regret is not zero: it is 2 (certified)
    optimal value 3, learned 1; not optimal in 1 of 1 states with a choice
      state 0: yours 0, optimal 1; loses 2 x 1 visits = 2
    """
    __tracebackhide__ = True  # pytest shows the line of the test, not this one
    audit = check(
        model,
        policy,
        max_regret=max_regret,
        max_relative_regret=max_relative_regret,
        kind=kind,
        horizon=horizon,
        criterion=criterion,
        subject_to=subject_to,
        confidence=confidence,
        by=by,
    )
    if not audit.passed:
        raise AssertionError(audit.message())
    return audit


def _evidence(by: object, confidence: object | None) -> Evidence | None:
    """Return what an interval is made by; None where no confidence is asked for."""
    if confidence is None:
        if by != "robust":
            raise ModelError(
                "no confidence is given for the interval", where="by", fix="give confidence=0.95"
            )
        return None
    if not isinstance(by, str):
        if isinstance(by, type) or not isinstance(by, Evidence):
            raise ModelError(
                f"{by!r} is not a kind of interval",
                where="by",
                fix='give "robust", "posterior" or "off-policy", or one of their classes',
            )
        return by
    kinds: dict[str, Any] = {
        "robust": robust.Robust,
        "posterior": posterior.Posterior,
        "off-policy": off_policy.OffPolicy,
    }
    if by not in kinds:
        raise ModelError(f"unknown kind of interval {by!r}", where="by", fix=suggest(by, kinds))
    chosen: Evidence = kinds[by]()
    return chosen
