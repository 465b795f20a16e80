"""Derivatives of the start value by the parameters, as they are told.

The derivative of the start value by every parameter, in one backward and one forward pass.

    dV/dθ = Σ_l d(l) [∂r(l) + γ Σ_s' ∂P(l, s') V(s') + ∂γ Σ_s' P(l, s') V(s')]

d is the policy's discounted occupancy and V its value. With the policy re-optimised, the same holds
of the optimum by the envelope theorem (Milgrom and Segal, Econometrica 70, 2002) where one policy
is optimal. Where several are, V* has a derivative on each side, the greatest or least among their
own: the optimum of the model that is left with optimal actions and earns the bracket above. Where
a parameter sits on a breakpoint of the rows, each side has its own ∂P. The elasticity is
(θ / V) dV/dθ, the change of the value in per cent for one per cent of the parameter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.base import unit_of
from exact_mdp.analysis.sensitivity.derivatives import BoundedPass, Checked, ExactPass
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.chain import is_acyclic
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.row_change import Piece, RowChange, pieces, row_change
from exact_mdp.solvers.solution import Bounded, Certified, Claim

if TYPE_CHECKING:
    from pandas import DataFrame


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
        order = (Claim.ESTIMATED, Claim.BOUNDED)
        return next((claim for claim in order if claim in claims), Claim.CERTIFIED)


@dataclass(frozen=True, kw_only=True, eq=False)
class Gradient:
    """Derivatives of the start value by every parameter.

    Attributes
    ----------
    start_value : Certified or Bounded
    derivatives : {parameter name: Derivative}
    steps : {setting: (backward, forward)}
        Differences of the start value for whole-number settings such as max_trial: what the last
        unit adds, and what one more would.
    reoptimised : bool
        Whether the policy follows the parameter, or is held fixed.
    """

    start_value: Number
    derivatives: dict[str, Derivative]
    steps: dict[str, tuple[Number | None, Number]]
    reoptimised: bool

    def __getitem__(self, name: str) -> Derivative:
        return self.derivatives[name]

    def frame(self) -> DataFrame:
        """Return one row for each parameter, the largest elasticity first."""
        from pandas import DataFrame

        rows = [
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
        return DataFrame(rows)


def floating(number: Fraction | float) -> float:
    """Return a number as a float; an infinite one where it is beyond the range of floats.

    Examples
    --------
    >>> floating(Fraction(1, 4)), floating(Fraction(-(10**400)))
    (0.25, -inf)
    """
    try:
        return float(number)
    except OverflowError:
        return inf if number > 0 else -inf


def _float(number: Slope | None) -> float:
    return np.nan if number is None else floating(number.value)


EXACT_TRANSITIONS = 100_000
EXACT_CYCLIC_STATES = 64


def gradient(
    source: Scenario | MDP | Parametric,
    policy: object = "optimal",
    *,
    names: Iterable[str] | None = None,
    exact: bool | None = None,
) -> Gradient:
    """Return the derivative of the start value by every parameter.

    Parameters
    ----------
    source : Scenario, MDP or Parametric
    policy : "optimal", or anything that `solvers.evaluate` takes
        The optimum is re-optimised; any other policy is held fixed.
    names : iterable of str, optional
        The parameters; all of them unless given.
    exact : bool, optional
        Rationals, or floats with error bounds; unless given, rationals for models of up to 100,000
        transitions that are acyclic or have at most 64 states.

    Returns
    -------
    Gradient
        Its derivatives are certified with rationals, and bounded with floats, where the degree of
        the rows is proven; where that of a `mdp.parametric.Family` is only checked at some points
        they say so.

    Raises
    ------
    ModelError
        For unknown names; where rows are no polynomials of the degree that a family states; with
        floats, where ties cannot be told from small gaps.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> found = gradient(moving(mdp, {"stay": [(0, 0)]}), names=["stay"])
    >>> print(found["stay"].value, found["stay"].elasticity)
    4 (certified) 1.0
    """
    model = parametric(source)
    chosen = [parameter.name for parameter in model.parameters] if names is None else list(names)
    for name in chosen:
        parameter_of(model, name)
    mdp = model.at({})
    exact = cheap(mdp) if exact is None else exact
    best = isinstance(policy, str) and policy == "optimal"
    if not exact:
        return _gradient(model, mdp, BoundedPass(mdp, policy), chosen, best)
    return _gradient(model, mdp, ExactPass(mdp, policy), chosen, best)


def cheap(mdp: MDP) -> bool:
    """Return whether rational arithmetic is no burden."""
    if mdp.n_transitions > EXACT_TRANSITIONS:
        return False
    return mdp.n_states <= EXACT_CYCLIC_STATES or is_acyclic(mdp)


def _gradient(
    model: Parametric,
    mdp: MDP,
    passed: ExactPass | BoundedPass,
    names: Sequence[str],
    reoptimised: bool,
) -> Gradient:
    start = passed.start_value
    found = {}
    for name in names:
        parameter = parameter_of(model, name)
        below, above = pieces(model, name, parameter.value)
        known: dict[Piece, RowChange] = {}
        for piece in (below, above):
            if piece is not None and piece not in known:
                known[piece] = row_change(model, name, piece, base=mdp)
        left = None if below is None else passed.side(known[below], -1)
        right = None if above is None else passed.side(known[above], 1)
        each = Derivative(parameter=parameter, left=left, right=right, elasticity=None)
        slope, worth = each.value, Fraction(start.value)
        if slope is not None and worth:
            ratio = floating(Fraction(slope.value) * parameter.value / worth)
            each = Derivative(parameter=parameter, left=left, right=right, elasticity=ratio)
        found[name] = each
    return Gradient(
        start_value=start,
        derivatives=found,
        steps=_steps(model, start) if reoptimised else {},
        reoptimised=reoptimised,
    )


def _steps(model: Parametric, start: Number) -> dict[str, tuple[Number | None, Number]]:
    """Return differences of the optimal value for whole-number settings."""
    found: dict[str, tuple[Number | None, Number]] = {}
    for name, (below, above) in model.neighbours().items():
        less = None if below is None else _less(start, _optimal(below.at({}), start))
        found[name] = (less, _less(_optimal(above.at({}), start), start))
    return found


def _optimal(mdp: MDP, like: Number) -> Number:
    if isinstance(like, Certified):
        return proven(mdp).start
    from exact_mdp.solvers import solve

    return solve(mdp).start


def _less(left: Number, right: Number) -> Number:
    if isinstance(left, Certified) and isinstance(right, Certified):
        return Certified(value=left.value - right.value)
    (low, high), (least, most) = left.interval, right.interval
    value = float(left.value) - float(right.value)
    return Bounded(value=value, error=max(high - least - value, value - (low - most)) * 1.0000001)
