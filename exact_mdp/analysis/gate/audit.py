"""What an audit says: the regret, where it arises, and a verdict on each limit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf, isfinite, isinf, isnan, nan
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.criteria import Total, Verdict, format_claimed_number
from exact_mdp.analysis.gate.data.interval import RegretInterval
from exact_mdp.analysis.gate.reasons import (
    Disagreement,
    Findings,
    QError,
    Representation,
    format_alternatives,
    q_error,
)
from exact_mdp.analysis.gate.regret import Regret, interval_of
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, ReadAs
from exact_mdp.mdp.questions import describe_sense, describe_time_limit
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, format_rational
from exact_mdp.solvers.solution import Bounded, Certified, Claim, SolverError, in_float
from exact_mdp.solvers.values.policy_chain import PolicyChain

SHOWN = 5  # states that `message` names
AT_A_GLANCE = 3  # of them in `print(audit)`
IN_TABLE = 10  # and in the table for people
LISTED_STATES = 1000  # models with more states are left to Python for the regret of each
UNEXPLAINED = "not known: whether another policy that sees no more of the state could do better"
UNDECIDED = (
    "which the bounds do not decide: give a limit that they keep (--max-regret,"
    " max_regret=…), or ask for exact values (--certify, exact_values=True)"
)
COLUMNS = (
    "yours: what the policy does; optimal: what it should do; value lost: expected visits times "
    "what each loses; share: of all that is lost"
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Audit(Pictured):
    """What a policy loses against the optimum, where and why.

    Attributes
    ----------
    criterion : Total, Average or UnderLimits
        What counts, of which policy and model; under limits also the policy's totals. The regret is
        then against the optimum that keeps them, and values and gaps of states are those of the
        reward and the priced totals.
    regret : Regret
        Values and regret, at the start (`regret.at_start`) and in every state (`.by_state`).
    max_regret, max_relative_regret : Fraction, optional
        The limits; without either, the regret has to be zero.
    interval : RegretInterval, optional
        Where the regret lies in the process behind the records; the verdicts then rest on it, and
        all other numbers are those of the estimated model.
    """

    criterion: Total
    regret: Regret
    max_regret: Fraction | None = None
    max_relative_regret: Fraction | None = None
    interval: RegretInterval | None = None

    @property
    def chain(self) -> PolicyChain:
        """The model under the policy."""
        return self.criterion.chain

    @property
    def mdp(self) -> MDP:
        """The model."""
        return self.chain.mdp

    @property
    def policy(self) -> Policy:
        """The policy, or the greedy policy of the Q-table."""
        assert self.chain.policy is not None
        return self.chain.policy

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
        return self.criterion.feasible

    @property
    def relative_regret(self) -> float | None:
        """Regret at the start over the absolute optimal value; None where that is, or may be, 0."""
        lost, best = self.value.value, self.regret.optimal
        low, high = interval_of(best)
        if not isfinite(float(best)) or low <= 0 <= high:
            return None
        return inf if lost == inf else in_float(Fraction(lost) / abs(Fraction(best.value)))

    @property
    def regret_interval(self) -> tuple[float, float] | None:
        """The ends of the interval; None where no confidence was asked for."""
        return None if self.interval is None else (self.interval.low, self.interval.high)

    @property
    def begins(self) -> str:
        """Where runs start, from where the regret is measured, in words."""
        start, several = self.mdp.start, "states, each with its probability"
        return self.mdp.space.label(start[0][0]) if len(start) == 1 else f"{len(start)} {several}"

    # ---- states ------------------------------------------------------------------------------

    @cached_property
    def _findings(self) -> Findings:
        visits, wrong = self.criterion.find_disagreements(self.regret)
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
        return self._compute_agreement(np.ones(self.mdp.n_states))

    @property
    def agreement_by_visits(self) -> float:
        """The same share of the policy's visits to states with a choice."""
        return self._compute_agreement(self.visits)

    def _compute_agreement(self, weight: Floats) -> float:
        if not self.feasible:
            return nan
        total = float(weight[self.mdp.asked].sum())
        wrong = float(sum(weight[each.state] for each in self.disagreements))
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
        rows = [
            row
            | {"label": row["state"], "state": row["number"]}
            | {"optimal": " or ".join(row["optimal_actions"])}
            for row in self._listed
        ]
        names = ["state", "label", "learned", "optimal", "cost", "share", "gap", "expected_visits"]
        return data_frame(rows, columns=names[: 8 if full else 7]).set_index("state")

    @cached_property
    def _listed(self) -> list[dict[str, Any]]:
        """Each disagreement with its share of all that is lost, where that is finite."""
        lost = sum(each.cost for each in self.disagreements)
        return [
            {
                "state": each.label,
                "number": each.state,
                "columns": self.mdp.space.as_dict(each.state),
                "learned": each.learned,
                "optimal": each.optimal[0],
                "optimal_actions": each.optimal,
                "gap": each.gap,
                "expected_visits": each.expected_visits,
                "cost": each.cost,
                "share": each.cost / lost if 0 < lost < inf else None,
            }
            for each in self.disagreements
        ]

    # ---- verdicts ----------------------------------------------------------------------------

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What was checked: each limit given, or that the regret is zero."""
        interval, limit = self.interval, self.max_regret
        if interval is None:
            return tuple(self._of_model())
        # Of records the interval decides, never the estimate; without a limit, that it is 0.
        name = "zero" if limit is None else f"at most {format_rational(limit, 10)}"
        decision = interval.keeps_limit(self.forgiven if limit is None else limit)
        text = f"it is in {interval}; {format_claimed_number(self.value)} in the estimated model"
        if decision is None:
            more = "more records may decide it, or give a limit above the interval"
            if interval.draws is not None:
                kept = interval.within(limit or Fraction(0)).value
                more = f"it is kept with probability {kept:.3g} by the posterior"
            text += f", which leaves the limit open: {more}"
        return (Verdict("the regret", name, decision, text),)

    def _of_model(self) -> Iterator[Verdict]:
        """Yield the verdict on each limit given; without one, on whether the regret is zero."""
        regret, criterion, share = self.regret, self.criterion, self.max_relative_regret
        yield from criterion.list_verdicts()
        if not criterion.feasible:
            return
        text = f"it is {format_claimed_number(regret.at_start)}{criterion.against}"
        if self.max_regret is None and share is None:
            name = criterion.least
            if regret.forgiven:
                name += " up to the rounding of the given floats"
                text += f"; rounding can move it by up to {float(regret.forgiven):.2g}"
            zero = regret.keeps_limit(Fraction(0)) or regret.keeps_limit(regret.forgiven)
            yield _make_verdict("the regret", name, zero, text)
        if self.max_regret is not None:
            name = f"at most {format_rational(self.max_regret, 10)}"
            yield _make_verdict("the regret", name, regret.keeps_limit(self.max_regret), text)
        if share is not None:
            ratio = self.relative_regret
            decision: bool | None = False
            text = "it is undefined, because the optimal value is, or may be, 0"
            if ratio is not None:
                low, high = sorted(
                    share * abs(Fraction(end)) for end in interval_of(regret.optimal)
                )
                decision = regret.keeps_limit(low) or (
                    False if regret.keeps_limit(high) is False else None
                )
                text = f"it is {ratio:.6g} ({regret.claim})"
            yield _make_verdict(
                "the relative regret", f"at most {format_rational(share, 10)}", decision, text
            )

    @property
    def passed(self) -> bool:
        """Whether every limit holds; what bounds cannot decide does not pass."""
        return all(each.passed for each in self.verdicts)

    @property
    def undecided(self) -> bool:
        """Whether bounds or records leave a verdict open, which then does not pass."""
        return any(each.decision is None for each in self.verdicts)

    # ---- reasons -----------------------------------------------------------------------------

    @cached_property
    def q_error(self) -> QError | None:
        """How wrong the Q-table is; None for a policy, and under limits."""
        if self.policy.values is None or not self.criterion.plain:
            return None
        gap = self.regret.gap if self.mdp.sense == "max" else -self.regret.gap
        optimal = self.regret.optimal_value[self.mdp.pair_state] - gap
        visited = np.where(self.chain.weights > 0, self.visits[self.mdp.pair_state], 0.0)
        return q_error(self.mdp, self.policy, optimal, visited * self.chain.weights)

    @cached_property
    def representation(self) -> Representation | None:
        """What the policy's columns cannot express.

        None where it reads the whole state, under limits, and where floats cannot tell. The verdict
        does not depend on it.
        """
        if not self._partial:
            return None
        try:
            return Representation.of(self.mdp, self.policy, self.regret)
        except (SolverError, ModelError):
            return None

    @property
    def _partial(self) -> bool:
        return set(self.policy.columns) != set(self.mdp.space.names) and self.criterion.plain

    @property
    def measures(self) -> dict[str, Any]:
        """What a test report keeps of it."""
        known = {"claim": str(self.claim), "regret": float(self.value.value)}
        known |= {"agreement": self.agreement}
        return known | ({"regret_interval": str(self.interval)} if self.interval else {})

    # ---- words -------------------------------------------------------------------------------

    @property
    def question(self) -> str:
        """What was read, how rewards add up and from where: all that a number here depends on."""
        space = self.mdp.space
        steps = "" if space.untimed is None else f", horizon {space.columns[0].size - 1}"
        read = self.policy.source or "a policy"
        asked = describe_sense(self.mdp)
        sums = self.criterion.sums + (asked and f", {asked}")
        return f"read as {read}, {sums}{steps}, start {self.begins}"

    def __repr__(self) -> str:
        return f"Audit({self.question}; {self._outcome})"

    @property
    def _outcome(self) -> str:
        if not self.feasible:
            return f"failed: no policy keeps {', '.join(self.criterion.list_facts()['limits'])}"
        lost = f"regret {format_claimed_number(self.value)}"
        if self.interval is not None:
            lost = f"regret in {self.interval}; estimated {format_claimed_number(self.value)}"
        word = "passed" if self.passed else "failed, left open" if self.undecided else "failed"
        best = float(self.regret.optimal.value)
        count = len(self.disagreements)
        return f"{word}: {lost} of {best:.6g}, {count} disagreement{'s' * (count != 1)}"

    def __str__(self) -> str:
        lines = [self.question, self._outcome, *self._describe_costliest(AT_A_GLANCE)]
        return "\n".join([*lines, *self._unlimited])

    @property
    def _unlimited(self) -> list[str]:
        return describe_time_limit(self.mdp, "horizon={}" * (self.criterion.name == "total"))

    def message(self, *, explain: bool = True) -> str:
        """Return in words what was found, the costly states by name.

        With `explain` also what the policy's columns cannot express, which takes a search.
        """
        lines = [self.question, *map(str, self.verdicts)]
        best, own = (f"{float(x.value):.10g}" for x in (self.regret.optimal, self.regret.learned))
        if not self.feasible:
            return "\n".join([*lines, f"there is no optimum to compare with; learned {own}"])
        lines.append(
            f"optimal value {best}, learned {own}; not optimal in {len(self.disagreements)} of"
            f" {int(self.mdp.asked.sum())} states with a choice"
        )
        if self.unclear:
            lines.append(f"in {self.unclear} more the bounds leave it open")
        lines += self._describe_costliest(SHOWN)
        if explain and self._partial:
            lines.append(str(self.representation or UNEXPLAINED))
        return "\n".join([*lines, *self._unlimited])

    def _describe_costliest(self, most: int) -> list[str]:
        """Return a line for each of the costliest states, one for others, one for never visited."""
        met = [each for each in self.disagreements if each.expected_visits != 0]
        lines = [
            f"  {each.label}: yours {each.learned}, "
            f"optimal {format_alternatives(each.optimal)}; {_describe_loss(each)}"
            for each in met[:most]
        ]
        if len(met) > most:
            rest = sum(each.cost for each in met[most:])
            lines.append(f"  and {len(met) - most} more, {rest:.6g} in all")
        if self.never_reached:
            others = "and " if lines else ""
            lines.append(f"  {others}{self.never_reached} that it never visits, which cost nothing")
        return lines

    def report(self, *, explain: bool = True) -> Report:
        """Return the verdicts, what is lost, where, and why; `explain` as in `message`."""
        mdp, lost, by_visits = self.mdp, self.regret, self.agreement_by_visits
        why = self.representation if explain else None
        labels = map(mdp.space.label, range(mdp.n_states))  # made where they are read
        by_state = zip(labels, lost.by_state.tolist(), strict=True)
        infinite = "infinite" if isinf(lost.optimal.value) else "0, or may be"
        undefined = f"undefined: the optimal value is {infinite}"
        ratio = self.relative_regret
        share = "an unknown share" if isnan(by_visits) else f"{by_visits:.1%}"
        agree = f"{self.agreement:.1%} of the states with a choice, {share} of the visits to them"
        if isnan(self.agreement):
            agree = "undefined: there is no optimum to agree with"
        if self.never_reached:
            agree += f"; {self.never_reached} wrong states are never reached from {self.begins}, "
            agree += "and cost nothing: mdp.with_(start=…), or --start, begins elsewhere"

        def claimed(value: Certified | Bounded) -> Shown:
            return Shown(float(value.value), value if self.feasible else None)

        checks = [{"name": v.name, "passed": v.passed, "text": v.text} for v in self.verdicts]
        facts: dict[str, Any] = {
            "passed": Shown(self.passed, "yes" if self.passed else "no: FAILED"),
            "checks": Shown(checks, "; ".join(each.told for each in self.verdicts)),
            **(self.interval.list_facts(self.max_regret) if self.interval is not None else {}),
            "claim": Shown(self.claim),
            "regret_claim": Shown(self.value.claim),
            "regret": claimed(self.value),
            "exact_regret": Shown(self.value.value if isinstance(self.value, Certified) else None),
            "error_bound": Shown(self.error),
            "forgiven": Shown(float(self.forgiven)),
            "relative_regret": Shown(
                ratio, (undefined if ratio is None else ratio) if self.feasible else None
            ),
            "optimal_value": claimed(lost.optimal),
            "learned_value": Shown(float(lost.learned.value), lost.learned),
            "max_regret": Shown(self.max_regret),
            "max_relative_regret": Shown(self.max_relative_regret),
            "agreement": Shown(self.agreement, agree),
            "agreement_by_visits": Shown(by_visits),
            "unclear": Shown(self.unclear, self.unclear or None),
            "disagreements": self._listed,
            "regret_by_state": Shown(dict(by_state) if mdp.n_states <= LISTED_STATES else None),
            **self.criterion.list_facts(),
            **(dict.fromkeys(("representation", "rows")) if why is None else why.list_facts()),
            "q_error": self.q_error,
        }
        columns = {"state": "state", "yours": "learned", "optimal": "either"}
        numbers = {"value lost": "cost:.6g", "visits": "expected_visits:.6g", "share": "share:.1%"}
        met = [row for row in facts["disagreements"] if row["expected_visits"] != 0]
        wrong = Table(
            title="where it is not optimal, the costliest first",
            note=COLUMNS,
            rows=[row | {"either": format_alternatives(row["optimal_actions"])} for row in met],
            columns=columns | numbers,
            first=IN_TABLE,
        )
        changes = Table(
            title="rows of the policy, each changed alone",
            rows=why.rows if why else (),
            columns={"row": "row", "yours": "learned", "better": "best", "gain": "gain"},
        )
        notes = [UNEXPLAINED] if explain and self._partial and why is None else []
        if self.interval is not None:
            notes += self.interval.report().notes
        return Report(
            title=f"audit: {self.question}",
            facts=facts,
            tables=self.criterion.list_tables()
            | {"disagreements": wrong, "rows of the policy": changes},
            notes=[*notes, *self._unlimited],
            passed=self.passed,
        )


def _describe_loss(each: Disagreement) -> str:
    """Return in words what is lost in a state."""
    if isinf(each.expected_visits) and isfinite(each.cost):
        return f"waits for ever and loses {each.cost:.6g}"
    if isnan(each.cost):
        return f"loses {each.gap:.6g} a visit; how often it is visited is not known"
    return f"loses {each.gap:.6g} x {each.expected_visits:.6g} visits = {each.cost:.6g}"


def _make_verdict(subject: str, limit: str, decision: bool | None, text: str) -> Verdict:
    return Verdict(subject, limit, decision, text + f", {UNDECIDED}" * (decision is None))
