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

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from analysis.proven_optimum import proven
from analysis.sensitivity.gradient_exact import ExactPass
from analysis.sensitivity.gradient_result import Derivative, Gradient, Number, floating
from mdp.chain import is_acyclic
from mdp.model import MDP
from mdp.parametric import Parametric, parameter_of, parametric
from mdp.row_change import Piece, RowChange, pieces, row_change
from mdp.scenario import Scenario
from solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from analysis.sensitivity.gradient_bounds import BoundedPass

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
    >>> from mdp.parametric import moving
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
        from analysis.sensitivity.gradient_bounds import BoundedPass

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
    from solvers import solve

    return solve(mdp).start


def _less(left: Number, right: Number) -> Number:
    if isinstance(left, Certified) and isinstance(right, Certified):
        return Certified(value=left.value - right.value)
    (low, high), (least, most) = left.interval, right.interval
    value = float(left.value) - float(right.value)
    return Bounded(value=value, error=max(high - least - value, value - (low - most)) * 1.0000001)
