"""The derivative of the start value by every parameter, in one backward and one forward pass.

    dV/dθ = Σ_l d(l) [∂r(l) + γ Σ_s' ∂P(l, s') V(s') + ∂γ Σ_s' P(l, s') V(s')]

d is the policy's discounted occupancy and V its value. With the policy re-optimised, the same holds
of the optimum by the envelope theorem (Milgrom and Segal, Econometrica 70, 2002) where one policy
is optimal. Where several are, V* has a derivative on each side, the greatest or least among their
own: the optimum of the model that is left with optimal actions and earns the bracket above. Where
a parameter sits on a breakpoint of the rows, each side has its own ∂P. The elasticity is
(θ / V) dV/dθ, the change of the value in per cent for one per cent of the parameter.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.vary.base_case import maximised, unending
from exact_mdp.analysis.vary.curves.derivatives import BoundedPass, Checked, ExactPass
from exact_mdp.analysis.vary.ranges import unit_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.graph import endless, is_acyclic
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.parametric.row_change import pieces, row_change
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.solvers.solution import Bounded, Certified, Claim, in_float
from exact_mdp.solvers.solver import solve

if TYPE_CHECKING:
    from pandas import DataFrame


EXACT_TRANSITIONS = 100_000
EXACT_CYCLIC_STATES = 64
EXACT_SPARSE_STATES, EXACT_SPARSE_TRANSITIONS = 200, 10_000  # of small integers over one number

Number = Certified | Bounded
Slope = Certified | Bounded | Checked


@dataclass(frozen=True, kw_only=True)
class Derivative:
    """How the start value moves with one parameter.

    Attributes
    ----------
    parameter : Parameter
    left, right : Certified, Bounded or Checked, or None beyond the parameter's range
        One-sided derivatives: as the parameter comes from below, and as it goes up. Checked where
        the degree of a `Family` is not proven.
    elasticity : float or None
        None where there is no single derivative, or the value is 0.
    """

    parameter: Parameter
    left: Slope | None
    right: Slope | None
    elasticity: float | None

    def negated(self) -> Derivative:
        """Return the derivative of the value times -1, which has the same elasticity."""
        left, right = (None if side is None else -side for side in (self.left, self.right))
        return replace(self, left=left, right=right)

    @property
    def value(self) -> Slope | None:
        """The derivative; None where the two sides differ."""
        if self.left is None or self.right is None:
            return self.right if self.left is None else self.left
        return self.left if self.left == self.right else None

    @property
    def claim(self) -> Claim:
        """The weaker one of both sides' claims; certified where there is no side."""
        claims = {side.claim for side in (self.left, self.right) if side is not None}
        order = (Claim.CHECKED, Claim.BOUNDED)
        return next((claim for claim in order if claim in claims), Claim.CERTIFIED)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Gradient(Pictured):
    """Derivatives of the start value by every parameter.

    Attributes
    ----------
    start : Certified or Bounded
        The start value; `value` is the same, and `start_value` is its number alone.
    derivatives : {parameter name: Derivative}
    steps : {setting: (backward, forward)}
        Differences of the start value for whole-number settings such as max_trial: what the last
        unit adds, and what one more would.
    reoptimised : bool
        Whether the policy follows the parameter, or is held fixed.
    """

    start: Number
    derivatives: dict[str, Derivative]
    steps: dict[str, tuple[Number | None, Number]]
    reoptimised: bool

    def __repr__(self) -> str:
        how = "re-optimised" if self.reoptimised else "held fixed"
        return f"Gradient({len(self.derivatives)} parameters, policy {how}, value {self.start})"

    def __getitem__(self, name: str) -> Derivative:
        return self.derivatives[name]

    @property
    def value(self) -> Number:
        """The start value."""
        return self.start

    @property
    def start_value(self) -> Fraction | float:
        """The start value without its claim."""
        return self.start.value

    @property
    def error(self) -> float:
        """Bound on the error of the start value; 0 where it is exact."""
        return self.start.error if isinstance(self.start, Bounded) else 0.0

    def negated(self) -> Gradient:
        """Return the gradient of costs from that of rewards which are the costs times -1."""
        return replace(
            self,
            start=-self.start,
            derivatives={name: each.negated() for name, each in self.derivatives.items()},
            steps={
                name: (None if below is None else -below, -above)
                for name, (below, above) in self.steps.items()
            },
        )

    def frame(self) -> DataFrame:
        """Return one row for each parameter, the largest elasticity first."""
        import pandas

        rows: list[dict[str, Any]] = [
            {
                "parameter": name,
                "value": float(each.parameter.value),
                "unit": unit_of(each.parameter),
                "derivative (reward per unit)": _float(each.value),
                "left": _float(each.left),
                "right": _float(each.right),
                "elasticity (% per %)": np.nan if each.elasticity is None else each.elasticity,
                "policy": "re-optimised" if self.reoptimised else "fixed",
                "claim": str(each.claim),
            }
            for name, each in self.derivatives.items()
        ]
        rows.sort(key=lambda row: -np.nan_to_num(abs(row["elasticity (% per %)"])))
        return pandas.DataFrame(rows)


def _float(number: Slope | None) -> float:
    return np.nan if number is None else in_float(number.value)


def gradient(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    exact: bool | None = None,
) -> Gradient:
    """Return the derivative of the start value by every parameter.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        "optimal" is re-optimised as a parameter moves; any other policy is held fixed.
    names : iterable of str, optional
        The parameters; all of them unless given.
    exact : bool, optional
        Rationals, or floats with error bounds; unless given, rationals for models of up to 100,000
        transitions that are acyclic or have at most 64 states (200 where there are up to 10,000
        transitions, of small integers).

    Returns
    -------
    Gradient
        Its derivatives are certified with rationals, and bounded with floats, where the degree of
        the rows is proven; where that of a `mdp.parametric.Family` is only checked at some points
        they say so.

    Raises
    ------
    ModelError
        For unknown names; at discount 1 where some policy never ends; where rows are not
        polynomials of the degree that a family states; with floats, where ties cannot be told from
        small gaps.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> found = gradient(moving(mdp, {"stay": [(0, 0)]}), names=["stay"])
    >>> print(found["stay"].value, found["stay"].elasticity)
    4 (certified) 1.0
    """
    family = parametric(model)
    names = [parameter.name for parameter in family.parameters] if names is None else names
    parameters = [parameter_of(family, name) for name in names]
    mdp = family.at({})
    if mdp.sense == "min":
        rewards, policy = maximised(family, policy)
        return gradient(rewards, policy=policy, names=names, exact=exact).negated()
    reoptimised = isinstance(policy, str) and policy == "optimal"
    if reoptimised and endless(mdp):
        raise unending("today's parameters")
    exact = _cheap(mdp) if exact is None else exact
    passed = ExactPass(mdp, policy) if exact else BoundedPass(mdp, policy)
    return Gradient(
        start=passed.start,
        derivatives={each.name: _derivative(family, mdp, passed, each) for each in parameters},
        steps=_steps(family, passed.start) if reoptimised else {},
        reoptimised=reoptimised,
    )


def _cheap(mdp: MDP) -> bool:
    """Return whether rational arithmetic is affordable."""
    if mdp.n_transitions > EXACT_TRANSITIONS:
        return False
    if mdp.table.weight.dtype == np.int64 and mdp.n_transitions <= EXACT_SPARSE_TRANSITIONS:
        return mdp.n_states <= EXACT_SPARSE_STATES or is_acyclic(mdp)
    return mdp.n_states <= EXACT_CYCLIC_STATES or is_acyclic(mdp)


def _derivative(
    family: Parametric,
    mdp: MDP,
    passed: ExactPass | BoundedPass,
    parameter: Parameter,
) -> Derivative:
    name = parameter.name
    below, above = pieces(family, name, parameter.value)
    left = right = None
    if below is not None:
        change = row_change(family, name, below, base=mdp)
        left = passed.side(change, -1)
    if above is not None:
        if above is not below:
            change = row_change(family, name, above, base=mdp)
        right = passed.side(change, 1)
    each = Derivative(parameter=parameter, left=left, right=right, elasticity=None)
    slope, start = each.value, Fraction(passed.start.value)
    if slope is None or not start:
        return each
    return replace(each, elasticity=in_float(Fraction(slope.value) * parameter.value / start))


def _steps(family: Parametric, start: Number) -> dict[str, tuple[Number | None, Number]]:
    """Return differences of the optimal value for whole-number settings."""

    def optimum(there: Parametric) -> Number:
        mdp = there.at({})
        return proven(mdp).start if isinstance(start, Certified) else solve(mdp).start

    return {
        name: (
            None if below is None else _less(start, optimum(below)),
            _less(optimum(above), start),
        )
        for name, (below, above) in family.neighbours().items()
    }


def _less(left: Number, right: Number) -> Number:
    if isinstance(left, Certified) and isinstance(right, Certified):
        return Certified(value=left.value - right.value)
    (low, high), (least, most) = left.interval, right.interval
    value = float(left.value) - float(right.value)
    return Bounded(value=value, error=max(high - least - value, value - (low - most)) * 1.0000001)
