"""The result of an audit: the regret, where it arises, and a verdict on each limit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import inf, isfinite, isinf, isnan, nan
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.criteria import (
    Disagreement,
    Findings,
    Total,
    Verdict,
    format_alternatives,
    format_claimed_number,
)
from exact_mdp.analysis.gate.data.interval import RegretInterval
from exact_mdp.analysis.gate.reasons import QError, Representation, q_error
from exact_mdp.analysis.gate.regret import Regret
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, ReadAs
from exact_mdp.mdp.questions.ending import describe_sense
from exact_mdp.mdp.questions.horizon import count_steps, describe_time_limit
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Judged, data_frame
from exact_mdp.mdp.space import TIME
from exact_mdp.mdp.table import Floats, format_rational
from exact_mdp.solvers.bounds.bounds import Bounds
from exact_mdp.solvers.claims import Bounded, Certified, Claim, SolverError, in_float
from exact_mdp.solvers.exact.certificate import Contradiction, require_sound_proof
from exact_mdp.solvers.exact.regret import RegretCertificate, certify_regret
from exact_mdp.solvers.values.policy_chain import PolicyChain

UNEXPLAINED = "not known: whether another policy that sees no more of the state could do better"
UNDECIDED = (
    "which the bounds do not decide: give a limit that they keep (--max-regret,"
    " max_regret=…), or ask for exact values (--certify, exact_values=True)"
)
COLUMNS = (
    "yours: the policy's action; optimal: the best action; value lost: expected visits times the "
    "loss of each; share: of all that is lost"
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Audit(Judged):
    """The loss of a policy against the optimum: how much, where and why.

    `audit.regret` compares and formats as a number, the regret at the start; `float(audit)` is this
    number, without its error. With records it is the regret in the estimated model, and
    `audit.interval` compares.

    Attributes
    ----------
    criterion : Total, Average or UnderLimits
        The loss that is measured, with the policy and its model; under limits also the policy's
        totals. The regret is then against the optimum that keeps the limits, and values and gaps of
        states refer to the reward plus the priced totals.
    regret : Regret
        Values and regret, at the start (`regret.at_start`) and in every state (`.by_state`).
    max_regret, max_relative_regret : Fraction, optional
        The limits; without either, the regret has to be zero.
    interval : RegretInterval, optional
        A confidence interval for the regret in the process behind the records; the verdicts then
        rest on it, and all other numbers refer to the estimated model.
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

    def __float__(self) -> float:
        return float(self.value)

    @property
    def error(self) -> float:
        """The error bound of the regret; 0 if it is certified."""
        if isinstance(self.value, Bounded):
            return self.value.error
        return 0.0

    @property
    def claim(self) -> Claim:
        """The claim of the verdict: the claim of the regret, or of the interval it rests on."""
        if self.interval is not None:
            return self.interval.claim
        return self.value.claim

    @property
    def read_as(self) -> ReadAs:
        """How the policy was read: as action values ("q") or as a policy ("policy")."""
        return self.policy.read_as

    @property
    def forgiven(self) -> Fraction:
        """The rounding allowance: a regret up to it counts as zero if no limit is given.

        It is 0 in an exact model.
        """
        return self.regret.forgiven

    @property
    def feasible(self) -> bool:
        """Whether some policy keeps the limits; if none does, no optimum exists."""
        return self.criterion.feasible

    @property
    def relative_regret(self) -> float | None:
        """Regret at the start over the absolute optimal value; None if that is, or may be, 0."""
        lost, best = self.value.value, self.regret.optimal
        low, high = best.bounds
        if not isfinite(float(best)) or low <= 0 <= high:
            return None
        if lost == inf:
            return inf
        return in_float(Fraction(lost) / abs(Fraction(best.value)))

    @property
    def regret_interval(self) -> tuple[float, float] | None:
        """The ends of the interval; None if no confidence was given."""
        if self.interval is None:
            return None
        return self.interval.low, self.interval.high

    @property
    def begins(self) -> str:
        """The start, in words."""
        start = self.mdp.start
        if len(start) == 1:
            return self.mdp.space.label(start[0][0])
        return f"{len(start)} states, each with its probability"

    # ---- states ------------------------------------------------------------------------------

    @cached_property
    def _findings(self) -> Findings:
        visits, wrong = self.criterion.find_disagreements(self.regret)
        if not self.feasible:
            wrong = ()
        return visits, wrong

    @property
    def visits(self) -> Floats:
        """(S,) expected discounted visits from the start; NaN if floats cannot bound them."""
        return self._findings[0]

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """States with a choice where the policy is not optimal, the costliest first."""
        return self._findings[1]

    @property
    def never_reached(self) -> int:
        """Number of disagreements in states that the policy never reaches from the start."""
        return sum(each.expected_visits == 0 for each in self.disagreements)

    @property
    def agreement(self) -> float:
        """Share of the states with a choice in which the policy takes optimal actions only.

        `unclear` states count as agreement. NaN if no policy keeps the limits.
        """
        return self._compute_agreement(np.ones(self.mdp.n_states))

    @property
    def agreement_by_visits(self) -> float:
        """The same share, with states weighted by the policy's visits."""
        return self._compute_agreement(self.visits)

    def _compute_agreement(self, weight: Floats) -> float:
        if not self.feasible:
            return nan
        total = float(weight[self.mdp.ends.must_choose].sum())
        wrong = float(sum(weight[each.state] for each in self.disagreements))
        if total == 0:
            return 1.0
        return float(np.maximum(0.0, 1 - wrong / total))

    @cached_property
    def unclear(self) -> int:
        """Number of states in which bounds do not decide whether the policy is optimal."""
        # A state with a proven disagreement is decided, whatever its other pairs leave open.
        open_ = np.zeros(self.mdp.n_states, dtype=bool)
        open_[self.mdp.pair_state[self.regret.unclear & (self.chain.chosen > 0)]] = True
        open_[[each.state for each in self.disagreements]] = False
        return int((open_ & self.mdp.ends.must_choose).sum())

    def frame(self, *, full: bool = False) -> DataFrame:
        """Return the disagreements, indexed by state number; `full` adds expected visits."""
        rows = []
        for row in self._listed:
            rows.append(
                row
                | {"label": row["state"], "state": row["number"]}
                | {"optimal": " or ".join(row["optimal_actions"])}
            )
        names = ["state", "label", "learned", "optimal", "cost", "share", "gap"]
        if full:
            names.append("expected_visits")
        return data_frame(rows, columns=names).set_index("state")

    @cached_property
    def _listed(self) -> list[dict[str, Any]]:
        """Each disagreement as a row of a table, with its share of a finite total loss."""
        lost = sum(each.cost for each in self.disagreements)
        rows = []
        for each in self.disagreements:
            share = None
            if 0 < lost < inf:
                share = each.cost / lost
            row = {
                "state": each.label,
                "number": each.state,
                "columns": self.mdp.space.as_dict(each.state),
                "learned": each.learned,
                "optimal": each.optimal[0],
                "optimal_actions": each.optimal,
                "gap": each.gap,
                "expected_visits": each.expected_visits,
                "cost": each.cost,
                "share": share,
            }
            rows.append(row)
        return rows

    @cached_property
    def cells(self) -> list[dict[str, Any]]:
        """The disagreements by state, at all times, for a policy that does not read the time.

        Each has the number of `times` at which the policy is not optimal there, and what they cost
        together; the costliest first. In a model without a time there are none.
        """
        untimed = self.mdp.space.untimed
        if untimed is None or TIME in self.policy.space.names:
            return []
        cells: dict[str, dict[str, Any]] = {}
        for row in self._listed:
            label = untimed.label(row["number"] % untimed.regular)
            nothing = {"optimal": [], "times": 0, "expected_visits": 0.0, "cost": 0.0}
            cell = cells.setdefault(label, {"state": label, "learned": row["learned"], **nothing})
            cell["optimal"] += [a for a in row["optimal_actions"] if a not in cell["optimal"]]
            cell["times"] += 1
            cell["expected_visits"] += row["expected_visits"]
            cell["cost"] += row["cost"]
        return sorted(cells.values(), key=lambda cell: -cell["cost"])

    # ---- verdicts ----------------------------------------------------------------------------

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdict on each limit; without one, on whether the regret is zero."""
        interval, limit = self.interval, self.max_regret
        if interval is None:
            return tuple(self._judge_model())
        # With records the interval decides, never the estimate.
        if limit is None:
            name = "zero"
            decision = interval.keeps_limit(self.forgiven)
        else:
            name = f"at most {format_rational(limit, 10)}"
            decision = interval.keeps_limit(limit)
        text = f"it is in {interval}; {format_claimed_number(self.value)} in the estimated model"
        if decision is None:
            more = "more records may decide it, or give a limit above the interval"
            if interval.draws is not None:
                kept = interval.within(limit or Fraction(0)).value
                more = f"it is kept with probability {kept:.3g} by the posterior"
            text += f", which leaves the limit open: {more}"
        return (Verdict("the regret", name, decision, text),)

    def _judge_model(self) -> Iterator[Verdict]:
        """Yield the verdict on each limit; without one, on whether the regret is zero."""
        regret, criterion, share = self.regret, self.criterion, self.max_relative_regret
        yield from criterion.list_verdicts()
        if not criterion.feasible:
            return
        text = f"it is {format_claimed_number(regret.at_start)}{criterion.against}"
        if self.max_regret is None and share is None:
            # Without a limit the regret must be zero, up to the rounding allowance.
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
                # The optimal value may lie anywhere between its bounds, and so may the limit.
                ends = [abs(Fraction(end)) for end in regret.optimal.bounds]
                low, high = share * min(ends), share * max(ends)
                if regret.keeps_limit(low):
                    decision = True
                elif regret.keeps_limit(high) is False:
                    decision = False
                else:
                    decision = None
                text = f"it is {ratio:.6g} ({regret.claim})"
            yield _make_verdict(
                "the relative regret", f"at most {format_rational(share, 10)}", decision, text
            )

    @property
    def passed(self) -> bool:
        """Whether every limit is proven to hold; an open verdict does not pass."""
        return all(each.passed for each in self.verdicts)

    @property
    def undecided(self) -> bool:
        """Whether bounds or records leave a verdict open."""
        # An exact regret decides every limit.
        if self.interval is None and isinstance(self.value, Certified):
            return False
        return any(each.decision is None for each in self.verdicts)

    @cached_property
    def certificate(self) -> RegretCertificate:
        """The proof of the regret, which `certificate.save(path)` writes for `exact-mdp verify`.

        It states the optimum, the policy, its value and its regret: also if it fails.

        Raises
        ------
        ModelError
            If the verdict rests on bounds, records or limits, which it does not prove.

        Examples
        --------
        >>> from exact_mdp import check
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> check(mdp, [0, 0]).certificate
        RegretCertificate(regret 2: worth 1 at the start, the optimum 3)
        """
        lost, known = self.regret, (self.regret.optimal, self.regret.learned, self.regret.at_start)
        if self.interval is not None:
            raise ModelError(
                "a certificate proves a regret in the model, and this verdict rests on an interval "
                "from records",
                where="certificate",
                fix="leave out confidence",
            )
        if not self.criterion.plain and self.criterion.name != "average":
            raise ModelError(
                "a certificate proves a regret against the optimum without limits",
                where="certificate",
                fix="leave out the limits; solve() with them has a certificate of its own",
            )
        bounded = ""
        if not all(isinstance(each, Certified) for each in known):
            bounded = f"the regret is bounded, not exact: {lost.at_start}"
        elif isinstance(lost.optimum, Bounds):
            bounded = "the regret is exact, but bounds prove that some actions are not optimal"
        if bounded:
            raise ModelError(
                bounded,
                where="certificate",
                fix="ask for exact values, however long they take: --certify, exact_values=True",
            )
        proof = certify_regret(self.chain, average=self.criterion.name == "average")
        if proof.regret != lost.at_start.value:
            raise Contradiction(f"the proof says {proof.regret}, the audit {lost.at_start.value}")
        return require_sound_proof(proof)

    # ---- reasons -----------------------------------------------------------------------------

    @cached_property
    def q_error(self) -> QError | None:
        """The errors of the Q-table; None for a policy, and under limits."""
        if self.policy.values is None or not self.criterion.plain:
            return None
        # Q*(l) = V*(s) - gap(l), or plus the gap in a model of costs.
        gap = self.mdp.sense.orient(self.regret.gap)
        optimal = self.regret.optimal_value[self.mdp.pair_state] - gap
        visited = np.where(self.chain.weights > 0, self.visits[self.mdp.pair_state], 0.0)
        return q_error(self.mdp, self.policy, optimal, visited * self.chain.weights)

    @cached_property
    def representation(self) -> Representation | None:
        """The loss that is due to columns that the policy does not read.

        None if it reads the whole state, under limits, and if floats cannot tell. The verdict
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
        """The numbers that go into a test report."""
        known = {"claim": str(self.claim), "regret": float(self.value.value)}
        known["agreement"] = self.agreement
        if self.interval:
            known["regret_interval"] = str(self.interval)
        return known

    # ---- words -------------------------------------------------------------------------------

    @property
    def question(self) -> str:
        """How the policy was read, how rewards add up, and the start, in words."""
        space = self.mdp.space
        steps = ""
        if space.untimed is not None:
            steps = f", horizon {count_steps(self.mdp)}"
        read = self.policy.source or "a policy"
        sums, sense = self.criterion.sums, describe_sense(self.mdp)
        if sense:
            sums += f", {sense}"
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
        if self.passed:
            word = "passed"
        elif self.undecided:
            word = "failed, left open"
        else:
            word = "failed"
        best = float(self.regret.optimal.value)
        count = len(self.disagreements)
        noun = "disagreements"
        if count == 1:
            noun = "disagreement"
        return f"{word}: {lost} of {best:.6g}, {count} {noun}"

    def __str__(self) -> str:
        lines = [self.question, self._outcome, *self._describe_costliest(3)]
        if self.cells and self._partial and self.representation is not None:
            lines.append(str(self.representation))
        return "\n".join([*lines, *self._unlimited])

    @property
    def _unlimited(self) -> list[str]:
        option = ""
        if self.criterion.name == "total":
            option = "horizon={}"
        return describe_time_limit(self.mdp, option)

    def message(self, *, explain: bool = True) -> str:
        """Return the findings in words, with the costliest states by name.

        With `explain` also the loss due to columns that the policy does not read, which takes a
        search.
        """
        lines = [self.question, *map(str, self.verdicts)]
        best, own = (f"{float(x.value):.10g}" for x in (self.regret.optimal, self.regret.learned))
        if not self.feasible:
            return "\n".join([*lines, f"there is no optimum to compare with; learned {own}"])
        lines.append(
            f"optimal value {best}, learned {own}; not optimal in {len(self.disagreements)} of"
            f" {int(self.mdp.ends.must_choose.sum())} states with a choice"
        )
        if self.unclear:
            lines.append(f"in {self.unclear} more the bounds leave it open")
        lines += self._describe_costliest(5)
        if explain and self._partial:
            lines.append(str(self.representation or UNEXPLAINED))
        return "\n".join([*lines, *self._unlimited])

    def _describe_costliest(self, most: int) -> list[str]:
        """Return a line for each of the `most` costliest states, and one for the others."""
        if self.cells:
            lines = []
            for cell in self.cells[:most]:
                lines.append(
                    f"  {cell['state']}: yours {cell['learned']}, optimal "
                    f"{format_alternatives(cell['optimal'])}, at {cell['times']} of "
                    f"{count_steps(self.mdp)} times; loses {cell['cost']:.6g}"
                )
            if len(self.cells) > most:
                cost = sum(cell["cost"] for cell in self.cells[most:])
                lines.append(f"  and {len(self.cells) - most} more, {cost:.6g} in all")
            return lines
        met = [each for each in self.disagreements if each.expected_visits != 0]
        lines = []
        for each in met[:most]:
            lines.append(
                f"  {each.label}: yours {each.learned}, "
                f"optimal {format_alternatives(each.optimal)}; {_describe_loss(each)}"
            )
        if len(met) > most:
            cost = sum(each.cost for each in met[most:])
            lines.append(f"  and {len(met) - most} more, {cost:.6g} in all")
        if self.never_reached:
            others = ""
            if lines:
                others = "and "
            lines.append(f"  {others}{self.never_reached} that it never visits, which cost nothing")
        return lines

    def report(self, *, explain: bool = True) -> Report:
        """Return the verdicts, the loss, where it arises, and why; `explain` as in `message`."""
        if explain:
            why = self.representation
        else:
            why = None
        notes = []
        if explain and self._partial and why is None:
            notes.append(UNEXPLAINED)
        if self.interval is not None:
            notes += self.interval.report().notes
        return Report(
            title=f"audit: {self.question}",
            facts=self._list_facts(why),
            tables=self.criterion.list_tables() | self._list_tables(why),
            notes=[*notes, *self._unlimited],
            passed=self.passed,
        )

    def _list_facts(self, why: Representation | None) -> dict[str, Any]:
        """Return the facts of the report, in the order in which people read them."""
        lost, by_visits = self.regret, self.agreement_by_visits
        exact_regret = None
        if isinstance(self.value, Certified):
            exact_regret = self.value.value
        checks = [{"name": v.name, "passed": v.passed, "text": v.text} for v in self.verdicts]
        facts: dict[str, Any] = {
            "passed": Shown(self.passed, "yes" if self.passed else "no: FAILED"),
            "checks": Shown(checks, "; ".join(each.told for each in self.verdicts)),
        }
        if self.interval is not None:
            facts |= self.interval.list_facts(self.max_regret)
        facts |= {
            "claim": Shown(self.claim),
            "regret_claim": Shown(self.value.claim),
            "regret": self._show_number(self.value),
            "exact_regret": Shown(exact_regret),
            "error_bound": Shown(self.error),
            "forgiven": Shown(float(self.forgiven)),
            "relative_regret": self._show_relative_regret(),
            "optimal_value": self._show_number(lost.optimal),
            "learned_value": Shown(float(lost.learned.value), lost.learned),
            "max_regret": Shown(self.max_regret),
            "max_relative_regret": Shown(self.max_relative_regret),
            "agreement": Shown(self.agreement, self._describe_agreement()),
            "agreement_by_visits": Shown(by_visits),
            "unclear": Shown(self.unclear, self.unclear or None),
            "disagreements": Shown(self._listed, None) if self.cells else self._listed,
            "cells": Shown(self.cells, None),
            "regret_by_state": Shown(self._list_regrets()),
            **self.criterion.list_facts(),
        }
        if why is None:
            facts |= {"representation": None, "rows": None}
        else:
            facts |= why.list_facts()
        facts["q_error"] = self.q_error
        return facts

    def _show_number(self, value: Certified | Bounded) -> Shown:
        """Return a number that people see only if there is an optimum to compare with."""
        return Shown(float(value.value), value if self.feasible else None)

    def _show_relative_regret(self) -> Shown:
        ratio = self.relative_regret
        if not self.feasible:
            return Shown(ratio, None)
        if ratio is not None:
            return Shown(ratio, ratio)
        infinite = "0, or may be"
        if isinf(self.regret.optimal.value):
            infinite = "infinite"
        return Shown(None, f"undefined: the optimal value is {infinite}")

    def _describe_agreement(self) -> str:
        by_visits = self.agreement_by_visits
        if isnan(by_visits):
            share = "an unknown share"
        else:
            share = f"{by_visits:.1%}"
        text = f"{self.agreement:.1%} of the states with a choice, {share} of the visits to them"
        if isnan(self.agreement):
            text = "undefined: there is no optimum to agree with"
        if self.never_reached:
            states, cost = (
                ("states are", "cost") if self.never_reached > 1 else ("state is", "costs")
            )
            text += f"; {self.never_reached} wrong {states} never reached from {self.begins}, "
            text += f"and {cost} nothing: mdp.with_(start=…), or --start, begins elsewhere"
        return text

    def _list_regrets(self) -> dict[str, float] | None:
        """Return the regret by state; None if a report of so many states would be too long."""
        if self.mdp.n_states > 1000:
            return None
        labels = map(self.mdp.space.label, range(self.mdp.n_states))
        return dict(zip(labels, self.regret.by_state.tolist(), strict=True))

    def _list_tables(self, why: Representation | None) -> dict[str, Table]:
        """Return the tables of disagreements, and of rows whose change alone gains."""
        if self.cells:
            return {"cells": self._list_cells(), "rows of the policy": self._list_changes(why)}
        columns = {"state": "state", "yours": "learned", "optimal": "either"}
        numbers = {"value lost": "cost:.6g", "visits": "expected_visits:.6g", "share": "share:.1%"}
        met = [row for row in self._listed if row["expected_visits"] != 0]
        wrong = Table(
            title="where it is not optimal, the costliest first",
            note=COLUMNS,
            rows=[row | {"either": format_alternatives(row["optimal_actions"])} for row in met],
            columns=columns | numbers,
            first=10,
        )
        return {"disagreements": wrong, "rows of the policy": self._list_changes(why)}

    def _list_cells(self) -> Table:
        """Return the table of disagreements by state, whatever the time."""
        columns = {"state": "state", "yours": "learned", "optimal": "either", "times": "times"}
        return Table(
            title="where it is not optimal at some times, the costliest first",
            rows=[cell | {"either": format_alternatives(cell["optimal"])} for cell in self.cells],
            columns=columns | {"value lost": "cost:.6g", "visits": "expected_visits:.6g"},
            first=10,
        )

    def _list_changes(self, why: Representation | None) -> Table:
        """Return the table of the rows of the policy whose change alone gains."""
        return Table(
            title="rows of the policy, each changed alone",
            rows=why.rows if why else (),
            columns={"row": "row", "yours": "learned", "better": "best", "gain": "gain"},
        )


def _describe_loss(each: Disagreement) -> str:
    """Return the loss in a state, in words."""
    if isinf(each.expected_visits) and isfinite(each.cost):
        return f"waits forever and loses {each.cost:.6g}"
    if isnan(each.cost):
        return f"loses {each.gap:.6g} a visit; how often it is visited is not known"
    return f"loses {each.gap:.6g} x {each.expected_visits:.6g} visits = {each.cost:.6g}"


def _make_verdict(subject: str, limit: str, decision: bool | None, text: str) -> Verdict:
    """Return a verdict; one that bounds leave open says how to decide it."""
    if decision is None:
        text += f", {UNDECIDED}"
    return Verdict(subject, limit, decision, text)
