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
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from analysis.sensitivity.exact_chain import ExactChain, fraction, rational
from analysis.sensitivity.units import unit_of
from mdp.chain import is_acyclic
from mdp.chain import spans as spans_of
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.parameters import Parameter
from mdp.parametric import Parametric, parameter_of, parametric
from mdp.row_change import Piece, RowChange, pieces, row_change
from mdp.scenario import Scenario
from mdp.table import OutcomeTable, common, integers
from solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from flint import fmpq
    from pandas import DataFrame

    from solvers.certificate import Certificate

EXACT_TRANSITIONS = 100_000
EXACT_CYCLIC_STATES = 64

Number = Certified | Bounded


@dataclass(frozen=True, kw_only=True)
class Derivative:
    """How the start value moves with one parameter.

    Attributes
    ----------
    parameter : Parameter
    left, right : Certified or Bounded, or None beyond the parameter's range
        One-sided derivatives: as the parameter comes from below, and as it goes up.
    elasticity : float or None
        None where there is no single derivative, or the value is 0.
    """

    parameter: Parameter
    left: Number | None
    right: Number | None
    elasticity: float | None

    @property
    def value(self) -> Number | None:
        """The derivative; None where the two sides differ."""
        if self.left is None or self.right is None:
            return self.right if self.left is None else self.left
        return self.left if self.left == self.right else None


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
                "claim": str(self.start_value.claim),
            }
            for name, each in self.derivatives.items()
        ]
        rows.sort(key=lambda row: -np.nan_to_num(abs(row["elasticity (% per %)"])))
        return DataFrame(rows)


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

    Raises
    ------
    ModelError
        For unknown names; with floats, where ties cannot be told from small gaps.

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


class ExactPass:
    """Value and occupancy of a policy in rationals, and the derivatives that they give."""

    def __init__(self, mdp: MDP, policy: object) -> None:
        self.mdp = mdp
        self.certificate: Certificate | None = None
        if isinstance(policy, str) and policy == "optimal":
            self.certificate = proven(mdp)
            policy = self.certificate.policy
        self.chain = ExactChain(mdp, policy)
        self.value = self.chain.values(self.chain.reward)
        self.uses = self.chain.uses(self.chain.visits)
        self.used = [bool(use) for use in self.uses]

    @property
    def start_value(self) -> Certified:
        """The policy's value at the start."""
        pairs = zip(self.chain.start, self.value, strict=True)
        return Certified(value=fraction(sum((m * v for m, v in pairs), rational(0))))

    def side(self, change: RowChange, sign: int) -> Certified:
        """Return the derivative on one side: sign 1 for the right one, -1 for the left one."""
        if self.certificate is None or self.certificate.unique:
            earned = earnings(self.chain, change, self.value, self.used)
            total = sum((self.uses[pair] * gain for pair, gain in earned.items()), rational(0))
            return Certified(value=fraction(total))
        mdp, optimal = self.mdp, self.certificate.optimal_pairs
        everything = earnings(self.chain, change, self.value)
        gains = [sign * fraction(everything.get(pair, rational(0))) for pair in range(mdp.n_pairs)]
        tied = rewarded(mdp, np.flatnonzero(optimal), gains)
        return Certified(value=sign * proven(tied).start_value)


def earnings(
    chain: ExactChain,
    change: RowChange,
    value: Sequence[fmpq],
    wanted: Sequence[bool] | None = None,
) -> dict[int, fmpq]:
    """Return ∂r + γ ∂P V + ∂γ P V of the wanted pairs (L,), where it is not zero by rule."""
    mdp = chain.mdp
    wanted = [True] * mdp.n_pairs if wanted is None else wanted
    found: dict[int, fmpq] = {}
    zero = rational(0)
    pair, state = np.divmod(change.transition.key, mdp.n_states)
    for row, following, slope in zip(
        pair.tolist(), state.tolist(), change.transition.slope, strict=True
    ):
        if wanted[row]:
            found[row] = found.get(row, zero) + rational(slope) * value[following]
    found = {row: chain.rate * gain for row, gain in found.items()}
    for row, slope in zip(change.reward.key.tolist(), change.reward.slope, strict=True):
        if wanted[row] or mdp.terminal[mdp.pair_state[row]]:
            found[row] = found.get(row, zero) + rational(slope)
    if change.discount:
        rate = rational(change.discount)
        for row in range(mdp.n_pairs):
            if wanted[row]:
                found[row] = found.get(row, zero) + rate * chain.ahead(row, value)
    if chain.whole:
        refuse_endless(mdp, [row for row, gain in found.items() if gain], change.name)
    return found


def refuse_endless(mdp: MDP, rows: Sequence[int], name: str) -> None:
    """Raise ModelError where a parameter makes a terminal state earn, without end at discount 1."""
    for row in rows:
        if mdp.terminal[mdp.pair_state[row]]:
            raise ModelError(
                "a terminal state would earn for ever",
                where=f"parameter {name}, {mdp.where(row)}",
                fix="choose a discount below 1",
            )


def rewarded(mdp: MDP, pairs: np.ndarray, gains: Sequence[Fraction]) -> MDP:
    """Return the model that offers some of the pairs (K,) only and earns `gains` (L,) on them."""
    table = mdp.table
    chosen = spans_of(table.offsets[pairs], table.offsets[pairs + 1])
    top, bottom = common([gains[pair] for pair in pairs.tolist()])
    lengths = np.diff(table.offsets)[pairs]
    gain = integers(top)
    below = integers([bottom] * len(pairs))
    return mdp.with_(
        table=OutcomeTable(
            offsets=np.concatenate([[0], np.cumsum(lengths)]),
            next=table.next[chosen],
            weight=table.weight[chosen],
            denominator=table.denominator[pairs],
            gain=gain,
            gain_denominator=below,
        ),
        pair_state=mdp.pair_state[pairs],
        pair_action=mdp.pair_action[pairs],
        events=(),
    )


def proven(mdp: MDP) -> Certificate:
    """Return a certificate that its checker has accepted."""
    from solvers.certificate import certify

    found = certify(mdp)
    if faults := found.violations():
        raise RuntimeError(f"a certificate does not hold: {faults[0]}")
    return found


def _gradient(
    model: Parametric, mdp: MDP, passed: ExactPass, names: Sequence[str], reoptimised: bool
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
        slope, worth = each.value, float(start.value)
        if slope is not None and worth:
            ratio = float(slope.value) * float(parameter.value) / worth
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


def _float(number: Number | None) -> float:
    return np.nan if number is None else float(number.value)
