"""The pieces of a parameter's range on which the set of optimal actions does not change.

On a section between two breakpoints, rows are polynomials of the parameter. A policy stays optimal
until the first root at which the gap of some pair turns negative. At a point just beyond this root
the policy is improved, and the new policy's gaps show that it is optimal from the root on: if one
of them turns negative between the root and the point, the point is moved closer. No threshold is
missed, however close two of them lie. The optimal policy at the end of a section is the first
policy of the next section, so only one model is solved.

The values of a policy are polynomials on a section if the model is acyclic, otherwise N_s / D with
D = det(I - γ P_π) > 0. By Cramer's rule N and D have at most the degree Σ_s d_s, where d_s is the
greatest degree in the rows of state s, so they can be interpolated. If only the discount
moves, they come from powers of P_π,

    N(γ) = D(γ) Σ_k γ^k P^k r   up to degree n - 1.

Averages have the equations of `.average_equations`, also of policies with several recurrent
classes; there a policy is improved in its gain first, then in its relative values (Puterman, Markov
Decision Processes, 1994, section 9.2.3).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from fractions import Fraction
from functools import reduce
from itertools import chain, count, islice, pairwise
from math import ceil, floor

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly, fmpz_poly

from exact_mdp.analysis.vary.curves.average_equations import AverageEquations
from exact_mdp.analysis.vary.curves.checker import Bracket, CurvePiece
from exact_mdp.analysis.vary.curves.equations import (
    PolicyPairs,
    SectionEquations,
    Values,
    list_pairs,
)
from exact_mdp.analysis.vary.curves.roots import (
    Root,
    compute_sign,
    count_sign_variations,
    is_positive,
    isolate_roots,
    odd_part,
    remove_double_roots,
)
from exact_mdp.analysis.vary.ranges import Range
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import to_flint
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import Piece, interpolate_polynomials
from exact_mdp.mdp.table import Integers, format_rational
from exact_mdp.solvers.claims import Bounded, Certified
from exact_mdp.solvers.exact.certify import certify_and_check

# The largest models with cycles: rational functions of degree 80 take two seconds, of 200 minutes.
LARGEST = 300  # states that are not terminal
CYCLIC_DEGREE = 200

Entries = Sequence[tuple[int, fmpq_poly]]


class Sweep:
    """A walk over one section of a parameter with the optimal policy; `held` is held fixed."""

    def __init__(self, equations: SectionEquations, held: PolicyPairs | None, sign: int) -> None:
        self.equations, self.gap = equations, equations.gap
        self.low, self.high = equations.low, equations.high
        self.fixed: Values | None = None
        if held is not None:
            self.fixed = compute_policy_values(equations, held)
        self.start = equations.weigh_start(sign)
        self.ahead: dict[int, list[Root]] = {}  # by pair, the roots at which its gap turns
        self.policy: Integers  # a pair of each state, by `_follow_policy`

    def yield_pieces(self, policy: Integers) -> Iterator[CurvePiece]:
        """Yield the pieces, beginning with a policy (S,) that may not be optimal."""
        # The lower end of the section counts as a root: find the policy just beyond it.
        self._follow_policy(policy)
        first = Root(poly=fmpq_poly(), low=self.low, high=self.low)
        steps = ((self.high - self.low) / 64 * Fraction(3, 64) ** k for k in count())
        here = self._cross_root(first, ((self.low, self.low + step) for step in steps))[1]
        before: Bracket = (self.low, self.low)
        while before[0] < self.high:
            # The policy is optimal up to the next root; cross it to find the next policy.
            root = self._find_next_root(here)
            optimal = np.array([poly.degree() < 0 for poly in self.gap])
            values, after = self.equations.values, (self.high, self.high)
            if root is not None:
                after = self._cross_root(root, self._yield_narrowing_brackets(root, here))
            yield CurvePiece(
                low=before,
                high=after,
                section=self.equations.change.piece,
                optimal=optimal,
                start=self.start,
                values=values,
                fixed_values=self.fixed,
            )
            here, before = after[1], after

    def _follow_policy(self, policy: Integers) -> None:
        """Make `policy` (S,) the current one: compute its values and gaps."""
        self.policy = policy
        values = compute_policy_values(
            self.equations, [[(pair, to_flint(1))] for pair in policy.tolist()]
        )
        for pair in self.equations.update_gaps(values, set(policy.tolist())):
            self.ahead.pop(pair, None)

    # ---- the roots ahead -------------------------------------------------------------------------

    def _find_roots(self, pair: int, here: Fraction) -> list[Root]:
        """Return the roots beyond a point at which a gap changes its sign."""
        known = self.ahead.get(pair)
        if known is None or (known and known[0].low < here):
            poly, known = self.gap[pair], []
            if count_sign_variations(poly, here, self.high):
                # Narrow each root once, so that later comparisons are quick.
                width = (self.high - self.low) / 2**8
                turning = isolate_roots(odd_part(poly), here, self.high)
                known = [root.narrow_to_width(width) for root in turning]
            self.ahead[pair] = known
        return known

    def _find_next_root(self, here: Fraction) -> Root | None:
        """Return the first root beyond `here` at which a gap turns negative."""
        first = []
        for pair in self.equations.following:
            roots = self._find_roots(pair, here)
            first += roots[:1]
        if not first:
            return None
        return reduce(_find_earlier_root, first)

    # ---- beyond a root ---------------------------------------------------------------------------

    def _cross_root(self, root: Root, brackets: Iterable[Bracket]) -> Bracket:
        """Follow the policy that is optimal from a root on; return the bracket that proves it."""
        former = self.policy
        # 400 brackets, with three more digits in each, separate all thresholds 10^-1200 apart.
        for low, high in islice(brackets, 400):
            self._improve_policy(low, high)
            if all(
                self._is_clear(pair, root, low, high) for pair in self._find_near_pairs(low, high)
            ):
                return low, high
            self.ahead.clear()
            self._follow_policy(former)
        raise RuntimeError("endless thresholds, or two that cannot be separated")

    def _yield_narrowing_brackets(self, root: Root, here: Fraction) -> Iterator[Bracket]:
        """Yield ever narrower intervals around a root, between decimals."""
        # 13 digits make a bracket narrower than the 1e-12 that is promised.
        for digits in count(13, 3):
            unit = Fraction(1, 10**digits)
            root = root.narrow_to_width(unit * Fraction(5, 8))
            low, high = floor(root.low / unit) * unit, ceil(root.high / unit) * unit
            if low == high:
                low, high = low - unit, high + unit
            if here < low and high < self.high:
                yield low, high

    def _find_near_pairs(self, low: Fraction, high: Fraction) -> list[int]:
        """Return the pairs whose gap may turn in a bracket, by the roots known so far."""
        near = []
        for pair in self.equations.following:
            if self.gap[pair].degree() < 0:
                continue
            known = self.ahead.get(pair)
            if known is None or any(r.low <= high and low <= r.high for r in known):
                near.append(pair)
        return near

    def _improve_policy(self, low: Fraction, high: Fraction) -> None:
        """Follow a policy that is optimal at the end of a bracket (policy iteration)."""
        at = to_flint(high)
        while True:
            near, pairs = self._find_near_pairs(low, high), self.policy.copy()
            falls = {pair: gap for pair in near if (gap := self.gap[pair](at)) < 0}
            if not falls:
                return
            # In descending order of gaps, the best pair of a state is set last.
            taken = self.equations.choose_improvements(falls)
            for _, pair in sorted(((falls[pair], pair) for pair in taken), reverse=True):
                pairs[self.equations.state[pair]] = pair
            self._follow_policy(pairs)

    def _is_clear(self, pair: int, root: Root, low: Fraction, high: Fraction) -> bool:
        """Whether a gap does not turn in (low, high], except at the root of the threshold."""
        poly = self.gap[pair]
        if compute_sign(poly, high) <= 0:
            return False
        if not self._find_roots(pair, low):
            return True
        odd = odd_part(poly)
        inside = len([*isolate_roots(odd, low, high)])
        return inside == 0 or (inside == 1 and low < root.high and root.is_of(odd))


def _find_earlier_root(one: Root, other: Root) -> Root:
    """Return the smaller of two roots."""
    # Narrow both until their intervals are disjoint, or their common part proves them equal.
    while not (one.high <= other.low or other.high <= one.low):
        low, high = max(one.low, other.low), min(one.high, other.high)
        if (low < high or compute_sign(one.poly, low) == 0) and Root(
            poly=one.poly, low=low, high=high
        ).is_of(other.poly):
            if one.high - one.low <= other.high - other.low:
                return one
            return other
        width = max(one.high - one.low, other.high - other.low) / 4
        one, other = one.narrow_to_width(width), other.narrow_to_width(width)
    if one.high <= other.low:
        return one
    return other


def make_improper_error(
    where: str, *, beside: bool = False, goal: bool = False, ranges: bool = True
) -> ModelError:
    """Return the error of an analysis that needs finite values, and may take `ranges`.

    The reason is that some policy never ends and does not lose at every step, or that some run
    ends `beside` the goal.
    """
    # Below discount 1, and within a horizon, a run that misses a goal is worth what it earns.
    ways = ["give a discount below 1 (--discount 0.95)"]
    if beside:
        what, ends = "some run may end outside the goal, and is worth infinity", "at the goal"
    else:
        what, ends = "some policy never ends, and some of its steps cost nothing", "for sure"
        if goal:
            ways = ["let every step before the goal cost something"]
        else:
            ways.append("a number of steps (--horizon N, mdp.within(N))")
    if ranges:
        ways.append(f"a range in which every run ends {ends}")
    return ModelError(what, where=f"the total at discount 1, {where}", fix=", or ".join(ways))


# ---- sections ----------------------------------------------------------------------------------


@cache_on_model
def find_optimal_pairs(mdp: MDP) -> tuple[Integers, Certified | Bounded]:
    """Return an optimal pair of each state of a model, and the certified value at the start."""
    certificate = certify_and_check(mdp)
    optimal = np.flatnonzero(certificate.optimal_pairs)
    return optimal[np.searchsorted(optimal, mdp.pair_offsets[:-1])], certificate.start


@cache_on_model
def find_best_average(mdp: MDP) -> tuple[Integers, Certified | Bounded]:
    """Return a pair of each state with the best average and bias, and the average at the start."""
    certificate = certify_and_check(mdp, "average")
    return certificate.pairs, certificate.start


def pieces_of(
    family: Parametric,
    name: str,
    span: Range,
    sign: int,
    held: PolicyPairs | None,
    *,
    kind: type[SectionEquations] = SectionEquations,
) -> tuple[list[CurvePiece], list[SectionEquations]]:
    """Return the pieces over a range, and their sections; sign is -1 for costs.

    `held` is the policy held fixed, if any, and `kind` the equations: of totals or of averages.
    """
    find_best = find_best_average if kind is AverageEquations else find_optimal_pairs
    inside = (cut for cut in family.breakpoints(name) if span.low < cut < span.high)
    pieces, sections, policy = list[CurvePiece](), list[SectionEquations](), None
    for low, high in pairwise(sorted({span.low, *inside, span.high})):
        equations = _build_section_equations(family, name, low, high, kind)
        _require_finite_values(equations, held)
        sweep = Sweep(equations, held, sign)
        # The optimal policy of the section before may never end in this one.
        if policy is None or equations.improper:
            policy, _ = find_best(equations.mdp)
        for piece in sweep.yield_pieces(policy):
            if isinstance(equations, AverageEquations):
                _require_one_structure(equations, piece)
            pieces.append(piece)
        policy = sweep.policy
        sections.append(equations)
    return pieces, sections


def _require_finite_values(equations: SectionEquations, held: PolicyPairs | None) -> None:
    """Raise ModelError unless the optimum, and the policy held fixed, are finite on a section."""
    low, high = equations.low, equations.high
    between = (
        f"for some {equations.change.name} from {format_rational(low)} to {format_rational(high)}"
    )
    if equations.may_miss_goal:
        raise make_improper_error(between, beside=True)
    if equations.improper and not equations.staying_costs():
        raise make_improper_error(between, goal=equations.mdp.ends.has_goal)
    where = f"the total at discount 1, {between}"
    if equations.improper and not equations.can_end([*equations.following], low, high):
        raise ModelError(
            "from some state no policy ends, and the total is infinite",
            where=where,
            fix="choose a range in which every state has a way to the end",
        )
    if held is None:
        return
    taken, fix = list_pairs(held), "leave the policy out, or take one that reaches the end for sure"
    if not set(taken).isdisjoint(equations.barred):
        raise ModelError("the policy held fixed may miss the goal", where=where, fix=fix)
    if equations.improper and not equations.can_end(taken, low, high):
        raise ModelError(
            "the policy held fixed never ends from some state, and its total is infinite",
            where=where,
            fix=fix,
        )


def _require_one_structure(equations: AverageEquations, piece: CurvePiece) -> None:
    """Raise ModelError if averages of a piece may jump where a transition vanishes."""
    low, high = piece.low[0], piece.high[1]
    found = [*equations.find_point_faults(piece.values, low, high)]
    for values in (piece.values, piece.fixed_values):
        if values is not None and not is_positive(values[1], low, high):
            ends = [Root(poly=values[1], low=end, high=end) for end in (low, high)]
            inside = isolate_roots(remove_double_roots(values[1]), low, high)
            at_ends = (end for end in ends if end.is_of(values[1]))
            found += map(equations.format_place, (*at_ends, *inside))
    if found:
        raise ModelError(
            "a transition vanishes, and the states in which a policy may stay forever are others: "
            "the average may jump",
            where=found[0],
            fix="choose a range without this value",
        )


def _build_section_equations(
    family: Parametric,
    name: str,
    low: Fraction,
    high: Fraction,
    kind: type[SectionEquations] = SectionEquations,
) -> SectionEquations:
    """Return the equations of a section from an origin at which no moving probability is 0.

    That is the middle, or another point if some probability is 0 there, which is so at few points.
    """
    for share in chain([Fraction(1, 2)], (Fraction(37 + k, 97 + 2 * k) for k in count())):
        origin = low + (high - low) * share
        equations = kind(family, name, Piece(low=low, high=high, origin=origin))
        if equations.shows_all_steps:
            return equations
    raise AssertionError("unreachable")


# ---- the values of a policy --------------------------------------------------------------------


def compute_policy_values(equations: SectionEquations, policy: PolicyPairs) -> Values:
    """Return the values of a policy; raise ModelError if a model with cycles is too large."""
    if isinstance(equations, AverageEquations):
        return _compute_gain_and_bias(equations, policy)
    value = [fmpq_poly()] * equations.mdp.n_states
    if equations.order is not None:
        # Acyclic: backward induction, next states first.
        values = value, fmpq_poly([1])
        for state in equations.order:
            total = fmpq_poly()
            for pair, share in policy[state]:
                total += equations.compute_action_value(pair, values) * share
            value[state] = total
        return values
    # The system (D I - γ P_π) N = r_π over the live states, by the place of each entry.
    live, change = equations.live, equations.change
    degree, place, count = _bound_degree(equations), {s: k for k, s in enumerate(live)}, len(live)
    side, entries = [], list[tuple[int, fmpq_poly]]()
    for state in live:
        reward = fmpq_poly()
        for pair, share in policy[state]:
            reward = reward + equations.reward[pair] * share
            for to, p in equations.following[pair]:
                entries.append((place[state] * count + place[to], share * p))
        side.append(reward)
    still = not len(change.transition.key) and not len(change.reward.key)
    if still and equations.rate.degree() > 0:
        numerators, scale = _by_powers(equations.rate, entries, side)
    else:
        numerators, scale = _interpolate_values(equations, degree, entries, side)
    for state, numerator in zip(live, numerators, strict=True):
        value[state] = numerator
    return value, scale


def _compute_gain_and_bias(equations: AverageEquations, policy: PolicyPairs) -> Values:
    """Return relative values and gains of a policy, which may have several recurrent classes.

    The base of a class, its first state, has the relative value 0, and so its equation gives the
    gain of the class. A state that ends in one class for sure has its gain; any other state has
    the unknown gain Σ p g and, like all, an unknown relative value.
    """
    size = equations.mdp.n_states
    label, ends = equations.label_classes(policy)
    bases = [int(np.argmax(label == number)) for number in range(int(label.max()) + 1)]
    # The place of each unknown: the relative value of a state, its gain at a base; then the gains.
    apart = [state for state in range(size) if ends[state] < 0]
    gain_at = {state: size + k for k, state in enumerate(apart)}
    for state in range(size):
        if ends[state] >= 0:
            gain_at[state] = bases[ends[state]]
    count = size + len(apart)
    side, entries = [fmpq_poly()] * count, list[tuple[int, fmpq_poly]]()
    for state in range(size):
        if state not in bases:
            entries.append((state * count + gain_at[state], fmpq_poly([-1])))
        for pair, share in policy[state]:
            side[state] = side[state] + equations.reward[pair] * share
            for to, p in equations.following[pair]:
                if to not in bases:
                    entries.append((state * count + to, share * p))
                if ends[state] < 0:
                    entries.append((gain_at[state] * count + gain_at[to], share * p))
    found, scale = _interpolate_values(equations, _bound_degree(equations, apart), entries, side)
    bias = [fmpq_poly() if state in bases else found[state] for state in range(size)]
    gain = [found[gain_at[state]] for state in range(size)]
    return equations.complete_values(bias, gain), scale


def _bound_degree(equations: SectionEquations, twice: Collection[int] = ()) -> int:
    """Return an upper bound on the degree of values in a model with cycles (Cramer's rule).

    The states in `twice` have two equations.
    """
    live, where = len(equations.live) + len(twice), f"parameter {equations.change.name}"
    degree = 0
    for state, pairs in equations.pairs.items():
        degrees = [0]
        for pair in pairs:
            degrees.append(equations.reward[pair].degree())
            degrees += [p.degree() for _, p in equations.following[pair]]
        degree += max(degrees) * (1 + (state in twice))
    if live > LARGEST:
        raise ModelError(
            f"{live} states with cycles among them",
            where=where,
            fix=f"with cycles, use at most {LARGEST} states that are not terminal",
        )
    if degree > CYCLIC_DEGREE:
        raise ModelError(
            f"{live} states on cycles give rational functions of degree {degree}",
            where=where,
            fix=f"thresholds are exact up to degree {CYCLIC_DEGREE}; use a smaller model",
        )
    return degree


def _interpolate_values(
    equations: SectionEquations, degree: int, entries: Entries, side: Sequence[fmpq_poly]
) -> tuple[list[fmpq_poly], fmpq_poly]:
    """Return N of live states, and D, from their values at `degree` + 1 points inside."""
    low, size, states = equations.low, degree + 1, len(side)
    step = (equations.high - low) / (size + 1)
    numbers, samples = list[int](), list[list[fmpq]]()
    # D is 0 at a few points at most, where a policy that may stay forever does so: its degree is
    # below `size`, so that twice as many points are enough.
    for k in range(1, 2 * size):
        if len(samples) == size:
            break
        at, matrix = to_flint(low + step * k), [to_flint(0)] * states**2
        matrix[:: states + 1] = [to_flint(1)] * states
        for place, p in entries:
            matrix[place] -= p(at)
        # At each point D is the determinant, and N = D V.
        system = fmpq_mat(states, states, matrix)
        scale = system.det()
        if not scale:
            continue
        values = system.solve(fmpq_mat(states, 1, [each(at) for each in side])).entries()
        samples.append([*(scale * each for each in values), scale])
        numbers.append(k)
    if len(samples) < size:
        raise RuntimeError("a policy that never ends has no values")
    # Polynomials of the number k of a point become polynomials of θ = low + step k.
    number = fmpq_poly([to_flint(-low / step), to_flint(1 / step)])
    *tops, below = (each(number) for each in interpolate_polynomials(numbers, samples))
    return tops, below


def _by_powers(
    rate: fmpq_poly, entries: Entries, side: Sequence[fmpq_poly]
) -> tuple[list[fmpq_poly], fmpq_poly]:
    """Return N of live states, and D, from powers of the matrix P_π."""
    count = len(side)
    numbers = [to_flint(0)] * count**2
    for place, p in entries:
        numbers[place] += (p / rate)[0]
    matrix, unit = fmpq_mat(count, count, numbers).numer_denom()  # P = A / q
    vector, times = fmpq_mat(count, 1, [each[0] for each in side]).numer_denom()
    # The vectors A^k r, in integers.
    columns = []
    for _ in range(count):
        columns.append(vector.entries())
        vector = matrix * vector
    below = fmpz_poly(matrix.charpoly().coeffs()[::-1])  # det(I - z A), z = γ / q
    numerators = []
    for powers in zip(*columns, strict=True):
        numerators.append(
            fmpq_poly((below * fmpz_poly(list(powers))).coeffs()[:count])(rate / unit)
        )
    return numerators, fmpq_poly(below)(rate / unit) * times
