"""What an audit of a policy found: verdicts, agreement, reasons, and the message.

The verdicts compare the regret at the start with the limits given, exactly where it is certified.
Where it is bounded, the upper bound has to keep the limit: what the bounds do not decide does not
pass. Without a limit the regret has to be zero: exactly, but for what the rounding of given floats
can move (`analysis.gate.forgiveness`).
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import ROUND_DOWN, Context, Decimal
from fractions import Fraction
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.disagreements import Disagreement
from exact_mdp.analysis.gate.q_error import QError, q_error
from exact_mdp.analysis.gate.regret import Regret
from exact_mdp.analysis.gate.representation import Representation, representation
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, ReadAs
from exact_mdp.mdp.table import Floats, shown
from exact_mdp.solvers.solution import Bounded, Certified, Claim, SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain

SHOWN = 5
UNEXPLAINED = "floating point cannot tell what the columns that the policy reads cost"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One thing that was checked.

    Attributes
    ----------
    name : str
        What was checked, such as "regret is at most 1/10".
    passed : bool
    text : str
        What was found.
    """

    name: str
    passed: bool
    text: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Audit:
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
    visits : (S,)
        Its expected discounted visits from the start; undiscounted at discount 1.
    disagreements : tuple of Disagreement
        States with a choice where it does not act optimally, the costliest first.
    said : (L,), optional
        Action values of the Q-table.
    read_as : "q" or "policy"
        What the policy was taken from.
    source : str
        The same in words, where a two-dimensional array was read; else empty.
    max_regret, max_relative_regret : Fraction, optional
        The limits; without either, the regret has to be zero.
    """

    mdp: MDP
    policy: Policy
    chain: PolicyChain
    regret: Regret
    visits: Floats
    disagreements: tuple[Disagreement, ...]
    said: Floats | None = None
    read_as: ReadAs = "policy"
    source: str = ""
    max_regret: Fraction | None = None
    max_relative_regret: Fraction | None = None

    def __repr__(self) -> str:
        lost = f"regret {_number(self.regret.at_start)}"
        return (
            f"Audit({'passed' if self.passed else 'failed'}: {lost} of "
            f"{float(self.regret.optimal.value):.6g}, {len(self.disagreements)} disagreements)"
        )

    @property
    def claim(self) -> Claim:
        """Certified, or bounded."""
        return self.regret.claim

    @property
    def forgiven(self) -> Fraction:
        """The regret that counts as none where no limit is given; 0 in an exact model."""
        return self.regret.forgiven

    @property
    def relative_regret(self) -> float | None:
        """Regret at the start over the absolute optimal value; None where that is, or may be, 0."""
        best = self.regret.optimal
        if isinstance(best, Certified):
            undefined = best.value == 0
        else:
            undefined = best.interval[0] <= 0 <= best.interval[1]
        if undefined:
            return None
        return float(Fraction(self.regret.at_start.value) / abs(Fraction(best.value)))

    # ---- verdicts ----------------------------------------------------------------------------

    @property
    def passed(self) -> bool:
        """Whether every limit holds; what bounds cannot decide does not pass."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def undecided(self) -> bool:
        """Whether the bounds leave a verdict open, which then does not pass."""
        return None in self._decisions

    @cached_property
    def _decisions(self) -> tuple[bool | None, ...]:
        found = []
        if self.max_regret is None and self.max_relative_regret is None:
            found.append(self.regret.zero)
        if self.max_regret is not None:
            found.append(self.regret.decided(self.max_regret))
        if self.max_relative_regret is not None:
            found.append(self._relative(self.max_relative_regret))
        return tuple(found)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What was checked: each limit given, or that the regret is zero."""
        found, text = [], f"it is {_number(self.regret.at_start)}"
        if self.max_regret is None and self.max_relative_regret is None:
            found.append(self._zero(text))
        if self.max_regret is not None:
            name = f"the regret is at most {shown(self.max_regret, 10)}"
            found.append(_verdict(name, self.regret.decided(self.max_regret), text))
        if self.max_relative_regret is not None:
            name = f"the relative regret is at most {shown(self.max_relative_regret, 10)}"
            if self.relative_regret is None:
                text = "it is undefined, because the optimal value is, or may be, 0"
                found.append(Verdict(name=name, passed=False, text=text))
            else:
                text = f"it is {self.relative_regret:.6g} ({self.claim})"
                found.append(_verdict(name, self._relative(self.max_relative_regret), text))
        return tuple(found)

    def _zero(self, text: str) -> Verdict:
        """Return the verdict without a limit, with what it forgives."""
        decision = self.regret.zero
        if not self.regret.forgiveness.high:
            return _verdict("the regret is zero", decision, text)
        text += f"; rounding can move it by {_below(self.forgiven)}"
        return _verdict("the regret is zero up to the rounding of the given floats", decision, text)

    def _relative(self, limit: Fraction) -> bool | None:
        best = self.regret.optimal
        if self.relative_regret is None:
            return False
        if isinstance(best, Certified):
            return self.regret.decided(limit * abs(best.value))
        low, high = sorted(abs(Fraction(end)) for end in best.interval)
        if self.regret.decided(limit * low):
            return True
        return False if self.regret.decided(limit * high) is False else None

    # ---- agreement ---------------------------------------------------------------------------

    @cached_property
    def _choosing(self) -> NDArray[np.bool_]:
        return np.asarray(~self.mdp.forced & ~self.mdp.terminal)

    @property
    def agreement(self) -> float:
        """Share of the states with a choice in which all that the policy does is optimal.

        Terminal states do not count, and `unclear` ones as agreement. 1 where there is no choice.
        """
        states = int(self._choosing.sum())
        return 1 - len(self.disagreements) / states if states else 1.0

    @cached_property
    def unclear(self) -> int:
        """Number of states in which bounds do not tell whether what the policy does is optimal."""
        used = self.regret.unclear & (self.chain.chosen > 0)
        states = np.unique(self.mdp.pair_state[used])
        listed = {each.state for each in self.disagreements}
        return sum(self._choosing[s] and s not in listed for s in states.tolist())

    @property
    def agreement_by_visits(self) -> float:
        """The same share of the policy's visits to states with a choice."""
        total = float(self.visits[self._choosing].sum())
        wrong = sum(each.expected_visits for each in self.disagreements)
        return max(0.0, 1 - wrong / total) if total > 0 else 1.0

    # ---- reasons -----------------------------------------------------------------------------

    @cached_property
    def q_error(self) -> QError | None:
        """How wrong the Q-table is; None for a policy."""
        if self.said is None:
            return None
        optimal = self.regret.optimal_value[self.mdp.pair_state] - self.regret.gap
        used = self.visits[self.mdp.pair_state] * self.chain.weights
        return q_error(self.mdp, self.said, optimal, used)

    @cached_property
    def representation(self) -> Representation | None:
        """What the policy's columns cannot express.

        None where it reads the whole state, or where floating point cannot bound the values that
        the search needs (`unexplained`); the verdict does not depend on it.
        """
        if self._reads_all:
            return None
        try:
            return representation(self.mdp, self.policy, self.regret)
        except SolverError:
            return None

    @property
    def unexplained(self) -> bool:
        """Whether floating point cannot tell what the policy's columns cannot express."""
        return not self._reads_all and self.representation is None

    @property
    def _reads_all(self) -> bool:
        return set(self.policy.columns) == set(self.mdp.space.names)

    def message(self, *, explain: bool = True) -> str:
        """Return in words what was found, the costly states by name.

        Parameters
        ----------
        explain : bool
            Say also what the policy's columns cannot express, which takes a search.
        """
        lost = self.regret
        lines = [f"the array was read as {self.source}"] if self.source else []
        lines += [
            f"{'passed' if each.passed else 'failed'}: {each.name}; {each.text}"
            for each in self.verdicts
        ]
        lines.append(
            f"optimal value {float(lost.optimal.value):.10g}, learned"
            f" {float(lost.learned.value):.10g}; not optimal in {len(self.disagreements)} of"
            f" {int(self._choosing.sum())} states with a choice"
        )
        if self.unclear:
            lines.append(f"in {self.unclear} more the bounds do not tell")
        for each in self.disagreements[:SHOWN]:
            lines.append(
                f"  ({each.label}): {each.learned}, not {' or '.join(each.optimal)};"
                f" gap {each.gap:.6g} x {each.expected_visits:.6g} visits = {each.cost:.6g}"
            )
        if len(self.disagreements) > SHOWN:
            rest = sum(each.cost for each in self.disagreements[SHOWN:])
            lines.append(f"  and {len(self.disagreements) - SHOWN} more, {rest:.6g} in all")
        if explain and self.representation is not None:
            lines.append(_why(self.representation))
        elif explain and self.unexplained:
            lines.append(UNEXPLAINED)
        return "\n".join(lines)


def _verdict(name: str, decision: bool | None, text: str) -> Verdict:
    if decision is None:
        text += (
            ", which the bounds do not decide: give a limit that they keep (--max-regret,"
            " max_regret=…), or ask for exact values (--certify, exact_values=True)"
        )
    return Verdict(name=name, passed=decision is True, text=text)


def _number(value: Certified | Bounded) -> str:
    """Return a number with its claim; an exact one may have thousands of digits, and is rounded."""
    if isinstance(value, Certified):
        return f"{float(value.value):.10g} ({value.claim})"
    return str(value)


def _below(number: Fraction) -> str:
    """Return a number of two digits that is not above the given one."""
    rounded = Context(prec=2, rounding=ROUND_DOWN).create_decimal(Decimal(float(number)))
    return f"up to {rounded:g}"


def _why(found: Representation) -> str:
    best = found.best
    read = ", ".join(best.columns) or "nothing"
    proof = "proven" if best.proven else f"no other is worth over {best.upper_bound:.10g}"
    return (
        f"the best policy that reads {read} alone is worth {best.value.value:.10g} ({proof});"
        f" of the regret, {float(found.loss.value):.6g} is due to what the policy reads and"
        f" {float(found.learning_error.value):.6g} to what was learned"
    )
