"""The derivatives of the start value for all parameters, in one backward and one forward pass.

For averages see `.average_gradient`; for totals,

    dV/dθ = Σ_l d(l) c(l),    c(l) = ∂r(l) + γ Σ_s' ∂P(l, s') V(s') + ∂γ Σ_s' P(l, s') V(s')

d is the policy's occupancy measure and V its value. The same holds for the optimum if one policy is
optimal (the envelope theorem: Milgrom and Segal, Econometrica 70, 2002). If several are, V* has a
derivative on each side: the optimum of the model with the optimal actions alone and with reward c.
At a breakpoint of the rows, each side has its own ∂P. The elasticity is (θ / V) dV/dθ.

In floating point, with errors of at most e_V and e_d in V and d,

    |error| ≤ Σ_l [e_d |c| + (d + e_d) (γ Σ |∂P| e_V + |∂γ| Σ P e_V)] + rounding;

gaps within the error bound count as ties, and are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.regret import EXACT_TRANSITIONS
from exact_mdp.analysis.vary.curves.average_gradient import (
    bounded_average_pass,
    exact_average_pass,
)
from exact_mdp.analysis.vary.curves.pair_slopes import (
    Number,
    Pass,
    UndecidedInFloats,
    compute_pair_slopes,
    find_newly_live_states,
    list_slopes,
    make_tie_error,
    refuse_silence,
)
from exact_mdp.analysis.vary.curves.walk import make_improper_error
from exact_mdp.analysis.vary.ranges import list_usual_parameters, unit_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options, require_list
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.graph import Mask, find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.parametric.row_change import (
    Piece,
    RowChange,
    find_pieces,
    row_change,
    to_flint_ratios,
    transition_entries,
)
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.advice import warn_of_zero_reward
from exact_mdp.mdp.report import Report, Shown, Table, format_cell, list_claim_facts
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Integers, to_common_denominator, to_integer_array
from exact_mdp.solvers.arguments import OfCriterion, is_average
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, compute_advantages, gamma
from exact_mdp.solvers.claims import Bounded, Certified, Claim, ClaimedNumber, LowHigh, in_float
from exact_mdp.solvers.endless.quotient import of_pairs
from exact_mdp.solvers.exact.certify import certify_and_check
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain

SLOPE, ELASTICITY = "derivative (reward per unit)", "elasticity (% per %)"  # columns of a table


@dataclass(frozen=True, kw_only=True)
class Checked(ClaimedNumber):
    """A number that relies on the degree of a polynomial, which is checked but not proven."""

    number: Number  # correct if the degree holds
    points: int  # at which the model and the polynomial agree

    claim: ClassVar[Claim] = Claim.CHECKED
    advice = "compare float(number), which leaves the error out"

    @property
    def bounds(self) -> LowHigh:
        """The two ends between which the number lies if the degree holds."""
        return self.number.bounds

    @property
    def value(self) -> Fraction | float:
        """The number without its claim."""
        return self.number.value

    @property
    def error(self) -> float:
        """Bound on its error if the degree holds."""
        if isinstance(self.number, Bounded):
            return self.number.error
        return 0.0

    def __float__(self) -> float:
        return float(self.number)

    def __abs__(self) -> Checked:
        if float(self) < 0:
            return replace(self, number=-self.number)
        return self

    def __str__(self) -> str:
        text = str(self.number).partition(" (")[0]
        return f"{text} ({self.claim}: the degree holds at {self.points} points, and is not proven)"


Slope = Certified | Bounded | Checked


@dataclass(frozen=True, kw_only=True)
class Derivative:
    """The left and the right derivative of the start value for one parameter."""

    parameter: Parameter
    left: Slope | None  # None at the lower end of the parameter's range
    right: Slope | None  # None at the upper end
    elasticity: float | None  # None if the two sides differ, or the value is 0

    @property
    def value(self) -> Slope | None:
        """The derivative; None if the two sides differ."""
        if self.left is None:
            return self.right
        if self.right is None or self.left == self.right:
            return self.left
        return None

    @property
    def claim(self) -> Claim:
        """The weaker claim of both sides; certified if there is none."""
        claims = {side.claim for side in (self.left, self.right) if side is not None}
        for claim in (Claim.CHECKED, Claim.BOUNDED):
            if claim in claims:
                return claim
        return Claim.CERTIFIED


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Gradient(OfCriterion, Pictured):
    """Derivatives of the start value for every parameter."""

    model: str
    start: Number
    derivatives: dict[str, Derivative]
    reoptimised: bool  # or the policy is held fixed
    criterion: str = "total"  # or "average": the value is the reward per step

    def __repr__(self) -> str:
        how = "held fixed"
        if self.reoptimised:
            how = "re-optimised"
        count = len(self.derivatives)
        return f"Gradient({count} parameters, policy {how}, {self.measure} {self.start})"

    def __getitem__(self, name: str) -> Derivative:
        return self.derivatives[name]

    @property
    def start_value(self) -> Fraction | float:
        """The start value without its claim."""
        return self.start.value

    def report(self) -> Report:
        """Return derivatives and elasticities for every parameter."""
        each = self.derivatives.items()
        exact, errors = dict[str, Any](), dict[str, float]()
        for name, slope in each:
            exact[name] = None
            if isinstance(slope.value, Certified):
                exact[name] = slope.value.value
            errors[name] = max(getattr(s, "error", 0.0) for s in (slope.left, slope.right))
        facts = {
            **self.criterion_facts,
            **list_claim_facts("start_value", self.start),
            "policy": "re-optimised" if self.reoptimised else "fixed",
            "derivatives": {name: _slope_to_float(d.value) for name, d in each},
            "left": Shown({name: _slope_to_float(d.left) for name, d in each}),
            "right": Shown({name: _slope_to_float(d.right) for name, d in each}),
            "elasticities": Shown({name: d.elasticity for name, d in each}),
            "exact_derivatives": Shown(exact),
            "error_bounds": Shown(errors),
        }
        # The bound of each derivative stands in `error_bounds`.
        del facts["error_bound"]
        # At a kink the table shows both one-sided derivatives.
        rows = self._list_derivative_rows()
        for row in rows:
            if self.derivatives[row["parameter"]].value is None:
                row[SLOPE] = (
                    f"{format_cell(row['left'], '.6g')} | {format_cell(row['right'], '.6g')}"
                )
        table = Table(
            title="derivatives of the start value, per unit of the parameter",
            rows=rows,
            columns={
                "parameter": "parameter",
                "today": "value",
                "derivative": f"{SLOPE}:.6g",
                "elasticity": f"{ELASTICITY}:.4g",
            },
        )
        return Report(title="gradient", facts=facts, tables={"derivatives": table})

    def frame(self) -> DataFrame:
        """Return one row for each parameter, the largest elasticity first."""
        return data_frame(self._list_derivative_rows())

    def _list_derivative_rows(self) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        for name, each in self.derivatives.items():
            rows.append(
                {
                    "parameter": name,
                    "value": float(each.parameter.value),
                    "unit": unit_of(each.parameter),
                    SLOPE: _slope_to_float(each.value),
                    "left": _slope_to_float(each.left),
                    "right": _slope_to_float(each.right),
                    ELASTICITY: np.nan if each.elasticity is None else each.elasticity,
                    "policy": "re-optimised" if self.reoptimised else "fixed",
                    "claim": str(each.claim),
                }
            )
        rows.sort(key=lambda row: -np.nan_to_num(abs(row[ELASTICITY])))
        return rows


def _slope_to_float(number: Slope | None) -> float:
    if number is None:
        return np.nan
    return in_float(number.value)


@named_options
def gradient(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    exact: bool | None = None,
    criterion: str = "total",
) -> Gradient:
    """Return the derivative of the start value for every parameter.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        "optimal" is re-optimised as a parameter moves; any other policy is held fixed.
    names : iterable of str, optional
        The parameters; by default all of them, but the discount for an average.
    exact : bool, optional
        True for rationals, False for floats with error bounds; by default, rationals for models of
        up to 100,000 transitions that are acyclic or have at most 64 states (200 states if there
        are up to 10,000 transitions, of small integers), and where floats cannot tell several
        actions apart.
    criterion : "total" or "average"
        As for `study`.

    Returns
    -------
    Gradient
        Certified with rationals and bounded with floats, if the degree of the rows is proven; if
        the degree of a `Family` is only checked at some points, the derivatives say so.

    Raises
    ------
    ModelError
        For unknown names; at discount 1 if some policy never ends, unless each of its steps costs
        something; for rows that are not
        polynomials of the stated degree; with floats, if ties cannot be told from small gaps; for
        an average, if it may jump at today's value.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> slopes = gradient(moving(mdp, {"stay": [(0, 0)]}), names=["stay"])
    >>> print(slopes["stay"].value, slopes["stay"].elasticity)
    4 (certified) 1.0
    """
    family = parametric(model)
    average = is_average(criterion)
    if names is None and average:
        names = list_usual_parameters(family)  # an average does not depend on the discount
    if names is None:
        parameters = list(family.parameters)
    else:
        parameters = [parameter_of(family, name) for name in require_list(names, "names")]
    # Derivatives of a total at discount 1 need runs that end, of all policies or of the given one.
    mdp = family.at({})
    reoptimised = isinstance(policy, str) and policy == "optimal"

    def is_finite(model: MDP) -> bool:
        """Return whether the optimum, or the given policy, has a finite value in a model."""
        if average:
            return True
        if reoptimised:
            return model.ends.has_finite_optimum
        if not model.ends.has_improper_policy:
            return True
        return PolicyChain.of(model, policy).reaches_goal_from_start

    if not is_finite(mdp):
        beside, goal = mdp.ends.every_policy_ends, mdp.ends.has_goal
        raise make_improper_error("today's parameters", beside=beside, goal=goal, ranges=False)
    # One backward and one forward pass serve all parameters.
    if exact is None and not _is_quick(mdp):
        with suppress(UndecidedInFloats):
            return gradient(model, policy=policy, names=names, exact=False, criterion=criterion)
    exact = exact is not False
    if average and exact:
        passed = exact_average_pass(mdp, policy)
    elif average:
        passed = bounded_average_pass(mdp, policy)
    elif exact:
        passed = _exact_pass(mdp, policy)
    else:
        passed = _bounded_pass(mdp, policy)
    start, _ = passed
    derivatives = {}
    for each in parameters:
        derivatives[each.name] = _compute_derivative(family, mdp, passed, each, is_finite)
    sides = [side for each in derivatives.values() for side in (each.left, each.right)]
    if not any(number is not None and number.value for number in (start, *sides)):
        warn_of_zero_reward(mdp)
    return Gradient(
        model=family.name,
        start=start,
        derivatives=derivatives,
        reoptimised=reoptimised,
        criterion=criterion,
    )


def _is_quick(mdp: MDP) -> bool:
    """Return whether exact derivatives take about a second at most.

    With cycles, which need a dense exact solution, that takes few states, or not so few with sparse
    rows whose probabilities are small integers over one denominator: measured.
    """
    if mdp.n_transitions > EXACT_TRANSITIONS:
        return False
    most = 64
    if mdp.n_transitions <= 10_000 and mdp.table.weight.dtype == np.int64:
        most = 200
    return mdp.n_states <= most or mdp.ends.is_acyclic


def _compute_derivative(
    family: Parametric,
    mdp: MDP,
    passed: Pass,
    parameter: Parameter,
    is_finite: Callable[[MDP], bool],
) -> Derivative:
    start, slope = passed

    @cache
    def compute_row_change(piece: Piece) -> RowChange:
        return row_change(family, parameter.name, piece, mdp)

    def compute_side(piece: Piece | None, sign: int) -> Slope | None:
        if piece is None:
            return None
        number, points = slope(compute_row_change(piece), sign), compute_row_change(piece).checked
        _require_finite_side(compute_row_change(piece), mdp, sign, family, is_finite)
        if points is None:
            return number
        return Checked(number=number, points=points)

    # Each side has its own polynomials if today's value is a breakpoint.
    below, above = find_pieces(family, parameter.name, parameter.value)
    left, right = compute_side(below, -1), compute_side(above, 1)
    each = Derivative(parameter=parameter, left=left, right=right, elasticity=None)
    if each.value is None or not start.value:
        return each
    # The elasticity (θ / V) dV/dθ.
    share = Fraction(each.value.value) * parameter.value / Fraction(start.value)
    return replace(each, elasticity=in_float(share))


def _require_finite_side(
    change: RowChange,
    mdp: MDP,
    sign: int,
    family: Parametric,
    is_finite: Callable[[MDP], bool],
) -> None:
    """Raise ModelError if totals may be infinite next to today's value, on one side of it.

    They may be only if a transition appears there; a model nearby then has the same ones.
    """
    moving = change.transition.key
    if mdp.discount_exact != 1 or np.isin(moving, transition_entries(mdp)[0]).all():
        return
    origin, end = change.piece.origin, change.piece.high
    if sign < 0:
        end = change.piece.low
    # The nearest of some points at which no transition vanishes: each does so at few points.
    roots = sum(moved.degree() for moved in change.transition.moved)
    for k in range(roots + 1):
        near = family.at({change.name: origin + (end - origin) * Fraction(1 + k, 10**6 + roots)})
        if np.isin(moving, transition_entries(near)[0]).all():
            break
    if not is_finite(near):
        raise ModelError(
            "next to today's value, the total may be infinite",
            where=f"parameter {change.name}",
            fix="choose a discount below 1 (--discount 0.95), or leave this parameter out (names=)",
        )


# ---- one pass ------------------------------------------------------------------------------------


def _exact_pass(mdp: MDP, policy: PolicyLike) -> Pass:
    """Return the value at the start in rationals, and a function that gives its derivatives."""
    # Backward: the values of the policy, or of the optimum.
    certificate = None
    if isinstance(policy, str) and policy == "optimal":
        certificate = certify_and_check(mdp)
        policy = certificate.policy
    chain, undecided = PolicyChain.held_fixed(mdp, policy)
    if certificate is None:
        level = chain.exact_value
        values, start = level.to_fractions(), Certified(value=level.compute_mean(mdp.start))
    else:
        values, start = certificate.value, certificate.start
    # An infinite value is 0 here: a parameter that leads to it is refused below.
    finite = [v if isinstance(v, Fraction) else Fraction(0) for v in values]
    value = np.array([*map(to_flint, finite)])

    # Forward: the expected uses of pairs. A terminal state below discount 1 is visited forever.
    uses = np.array([to_flint(0)] * mdp.n_pairs)
    for state, seen in enumerate(chain.exact_visits.to_fractions()):
        if seen:
            if mdp.terminal[state] and mdp.discount_exact != 1:
                seen = seen / (1 - mdp.discount_exact)
            for pair, weight in chain.exact_weights(state).items():
                uses[pair] = to_flint(seen) * to_flint(weight)
    row_keys, top, bottom = transition_entries(mdp)
    rows = row_keys, np.array(to_flint_ratios(top, bottom))

    infinite = _infinite_states(chain)
    if certificate is None:
        met = chain.reached
    else:
        met = find_reachable_states(mdp)

    def compute_slope(change: RowChange, sign: int) -> Certified:
        keys, slopes, gain_keys, gains = list_slopes(mdp, change, lambda x: x, rows)
        begun = find_newly_live_states(mdp, change)
        if certificate is None:
            refuse_silence(mdp, begun & met & undecided, change.name)
        unique = certificate is None or (certificate.unique and not (begun & met).any())
        if certificate is None or unique:
            used = np.asarray(uses != 0)
        else:
            seen = find_reachable_states(mdp, pairs=certificate.optimal_pairs)
            used = certificate.optimal_pairs & seen[mdp.pair_state]
        # Only pairs that some optimal policy, or the given one, uses contribute.
        among = used[keys // mdp.n_states]
        keys, slopes = keys[among], slopes[among]
        _refuse_infinite(mdp, keys[np.asarray(slopes != 0)], infinite, change.name)
        earned = compute_pair_slopes(keys, slopes, gain_keys, gains, value, mdp.n_pairs)
        _refuse_endless(mdp, earned != 0, change.name)
        if certificate is None or unique:
            return Certified(value=from_flint(to_flint(0) + uses @ earned))
        # Several optimal policies: the optimum of c among the optimal pairs.
        top, bottom = to_common_denominator(
            [sign * from_flint(to_flint(0) + each) for each in earned]
        )
        table = mdp.table.with_reward(to_integer_array(top), to_integer_array([bottom] * len(top)))
        tied = np.flatnonzero(certificate.optimal_pairs)
        best = certify_and_check(of_pairs(mdp.with_(table=table), tied))
        return Certified(value=sign * Fraction(best.start_value))

    return start, compute_slope


def _infinite_states(chain: PolicyChain) -> Mask:
    """Return (S,) True for states whose total at discount 1 may be infinite."""
    mdp = chain.mdp
    if mdp.discount_exact != 1:
        return np.zeros(mdp.n_states, dtype=bool)
    return ~chain.reaches_goal


def _refuse_infinite(mdp: MDP, keys: Integers, infinite: Mask, name: str) -> None:
    """Raise ModelError if moving a parameter leads to states with a total that may be infinite."""
    pair, following = np.divmod(keys, mdp.n_states)
    wrong = np.flatnonzero(infinite[following])
    if len(wrong):
        raise ModelError(
            "a probability that the parameter moves leads to a state whose total may be infinite",
            where=f"parameter {name}, {mdp.where(int(pair[wrong[0]]))}",
            fix="choose a discount below 1 (--discount 0.95), or a parameter that leaves this row",
        )


def _bounded_pass(mdp: MDP, policy: PolicyLike) -> Pass:
    """Return the value at the start in floats, and a function that gives its derivatives.

    Both sides have the same derivative, as several optimal policies are refused.
    """
    # Backward: the values of the policy. Pairs within the error bound of the best are ties.
    met, undecided = find_reachable_states(mdp), ~mdp.forced
    if isinstance(policy, str) and policy == "optimal":
        solution = solve(mdp)
        if not np.isfinite(solution.value).all():
            place = mdp.space.place(int((~np.isfinite(solution.value)).argmax()))
            what = (
                "the optimal value of a state is infinite, and floats cannot compare actions there"
            )
            raise UndecidedInFloats(what, where=place, fix="ask for exact=True")
        gain = compute_advantages(mdp, solution.value)
        tied = mdp.sense.sign * gain.value >= -2 * (solution.error_bound + gain.noise)
        several = np.add.reduceat(tied, mdp.pair_offsets[:-1]) != 1
        several &= find_reachable_states(mdp, pairs=tied) & ~mdp.terminal
        if several.any():
            raise make_tie_error(mdp.space.place(int(several.argmax())))
        policy, optimum = solution, True
    else:
        given, undecided = PolicyChain.held_fixed(mdp, policy)
        met, optimum = given.reached, False
    evaluation = evaluate(mdp, policy)
    chain, live = evaluation.chain, np.isfinite(evaluation.value)
    infinite = _infinite_states(chain)
    value = np.where(live, evaluation.value, 0.0)
    value_error = np.where(live, evaluation.error, 0.0)

    # Forward: the expected uses of pairs, and `doubt`, the bound on their errors.
    seen = chain.discounted.visits
    if mdp.discount_exact == 1:
        stay = 0.0
    else:
        stay = 1 / (1 - mdp.discount)
    factor = np.where(mdp.terminal, stay, 1.0)[mdp.pair_state] * chain.weights
    uses = seen.value[mdp.pair_state] * factor
    if stay:
        rounding = float(gamma(8 + chain.roundings)) / max(1 - mdp.discount, UNIT)
    else:
        rounding = float(gamma(4 + chain.roundings))
    doubt = seen.error[mdp.pair_state] * factor * SLACK + rounding * uses
    count, lengths = mdp.n_pairs, np.diff(mdp.transition.indptr)
    pair = np.repeat(np.arange(count), lengths)
    rows = pair * mdp.n_states + mdp.transition.indices, mdp.transition.data
    terms = int(lengths.max()) * 2 + count + 8

    def compute_slope(change: RowChange, _: int) -> Bounded:
        begun = find_newly_live_states(mdp, change) & met & undecided
        if optimum and begun.any():
            where = f"parameter {change.name}, {mdp.space.place(int(begun.argmax()))}"
            raise make_tie_error(where)
        refuse_silence(mdp, begun, change.name)
        moves = list_slopes(mdp, change, lambda x: float(from_flint(x)), rows)
        leads = moves[0][(moves[1] != 0) & (uses[moves[0] // mdp.n_states] > 0)]
        _refuse_infinite(mdp, leads, infinite, change.name)
        # c, a bound on |c| with all terms positive, and the error of c by errors of V.
        keys, slopes, gain_keys, gains = map(np.abs, moves)
        earned = compute_pair_slopes(*moves, value, count)
        size = compute_pair_slopes(keys, slopes, gain_keys, gains, np.abs(value), count)
        off = compute_pair_slopes(keys, slopes, gain_keys, 0 * gains, value_error, count)
        _refuse_endless(mdp, size > 0, change.name)
        used = uses + doubt
        error = doubt @ size + used @ off + float(gamma(terms)) * (used @ size)
        return Bounded(value=float(uses @ earned), error=float(error * SLACK + TINY * terms))

    return evaluation.numbers["mean"], compute_slope


def _refuse_endless(mdp: MDP, earns: NDArray[np.bool_], name: str) -> None:
    """Raise ModelError if a parameter makes a terminal state earn at discount 1, without end."""
    wrong = np.flatnonzero(earns.astype(bool) & mdp.terminal[mdp.pair_state])
    if mdp.discount_exact == 1 and len(wrong):
        raise ModelError(
            "a terminal state would earn forever",
            where=f"parameter {name}, {mdp.where(int(wrong[0]))}",
            fix="choose a discount below 1",
        )
