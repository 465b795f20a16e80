"""How the spread of a fixed policy's return, and what the return is made of, move with parameters.

    M(s) = E[r²] + 2 γ E[r V(s')] + γ² E[M(s')],      Var = Σ μ M - (Σ μ V)²

M is the second moment of the return. Its derivative needs V' in every state, which one more
forward pass replaces: Σ_l d₂(l) 2 γ E[r V'(s')] = Σ_l z(l) c(l), where d₂ are visits discounted by
γ² and z those that begin with 2 γ E[r; s'] under d₂ (c: what a pair earns in the gradient).
A component's total moves as the value does, with the component's rewards. Source of the second
moment: Sobel, Journal of Applied Probability 19 (1982).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf, isqrt, ldexp
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.sensitivity.base import unit_of
from exact_mdp.analysis.sensitivity.derivatives import Checked, claimed, earnings
from exact_mdp.analysis.sensitivity.exact_chain import ExactChain, fraction, rational
from exact_mdp.analysis.sensitivity.gradient import floating
from exact_mdp.analysis.sensitivity.rational_rows import by_pair, by_pair_slopes, dot, worth
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.row_change import (
    Entries,
    Piece,
    Samples,
    changes,
    joint_entries,
    pieces,
    row_change,
    sampled,
    square_entries,
)
from exact_mdp.mdp.table import Numbers
from exact_mdp.solvers.bounds.gains import TINY, UNIT
from exact_mdp.solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from flint import fmpq
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Movement:
    """Derivatives of a fixed policy's value, variance and components by one parameter.

    The side is the right one, but the left one at the upper end of the parameter's range. `sd` is
    None where the return does not vary: its spread then has no derivative.
    """

    parameter: Parameter
    mean: Certified | Checked
    variance: Certified | Checked
    sd: Bounded | None
    components: dict[str, Bounded]


def moments_gradient(
    source: Scenario | MDP | Parametric, policy: object, *, names: Iterable[str] | None = None
) -> dict[str, Movement]:
    """Return how a fixed policy's mean, variance and components move with each parameter.

    Parameters
    ----------
    policy : anything that `solvers.evaluate` takes
    names : iterable of str, optional
        The parameters; all of them unless given.

    Raises
    ------
    ModelError
        For unknown names; at discount 1 where an episode may never end.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])  # geometric: 1/q, (1 - q)/q²
    >>> found = moments_gradient(moving(mdp, {"stay": [(0, 0)]}), [0, 0], names=["stay"])
    >>> str(found["stay"].mean), str(found["stay"].variance)
    ('4 (certified)', '12 (certified)')
    """
    model = parametric(source)
    chosen = [parameter.name for parameter in model.parameters] if names is None else list(names)
    for name in chosen:
        parameter_of(model, name)
    passed = _Moments(model.at({}), policy)
    return {name: passed.along(model, name) for name in chosen}


def movement_frame(found: dict[str, Movement]) -> DataFrame:
    """Return one row for each parameter; derivatives are per unit of the parameter."""
    from pandas import DataFrame

    return DataFrame(
        [
            {
                "parameter": name,
                "value": float(each.parameter.value),
                "unit": unit_of(each.parameter),
                "mean (reward per unit)": floating(each.mean.value),
                "variance (reward² per unit)": floating(each.variance.value),
                "claim": str(each.variance.claim),
                "sd (reward per unit)": np.nan if each.sd is None else each.sd.value,
                **{f"{part} (reward per unit)": b.value for part, b in each.components.items()},
                "policy": "fixed",
            }
            for name, each in found.items()
        ]
    )


class _Moments:
    """Everything that does not depend on the parameter."""

    def __init__(self, mdp: MDP, policy: object) -> None:
        self.mdp, self.chain = mdp, ExactChain(mdp, policy)
        chain, zero = self.chain, rational(0)
        self.value = chain.values(chain.reward)
        self.joint = by_pair(joint_entries(mdp), mdp.n_states, mdp.n_pairs)
        _, top, bottom = square_entries(mdp)
        square = [rational(Fraction(int(a), int(b))) for a, b in zip(top, bottom, strict=True)]
        self.crossed = [dot(row, self.value) for row in self.joint]
        pairs = zip(square, self.crossed, strict=True)
        self.second = chain.values([q + 2 * chain.rate * x for q, x in pairs], power=2)
        start = chain.start
        self.uses = chain.uses(chain.visits)
        self.squared_uses = chain.uses(chain.discounted(start, power=2))
        begin = [zero] * mdp.n_states
        for row, used in zip(self.joint, self.squared_uses, strict=True):
            if used:
                for state, amount in row:
                    begin[state] += 2 * chain.rate * used * amount
        self.crossed_uses = chain.uses(chain.discounted(begin))
        self.mean = dot(list(enumerate(start)), self.value)
        self.variance = dot(list(enumerate(start)), self.second) - self.mean**2
        columns = mdp.components.T.tolist()
        self.parts = [chain.values([rational(Fraction(c)) for c in column]) for column in columns]
        self.part_sizes = [
            chain.values([rational(Fraction(abs(c))) for c in column]) for column in columns
        ]

    def along(self, model: Parametric, name: str) -> Movement:
        parameter = parameter_of(model, name)
        left, right = pieces(model, name, parameter.value)
        piece = right or left
        if piece is None:
            raise ModelError("an empty range", where=f"parameter {name}", fix="widen it")
        chain = self.chain
        change = row_change(model, name, piece, base=self.mdp)
        earned = earnings(chain, change, self.value)
        mean = worth(self.uses, earned)
        second = worth(self.crossed_uses, earned)
        found = sampled(
            model, name, piece, model.moment_degree(name), origin=parameter.value, base=self.mdp
        )
        second += worth(self.squared_uses, self._second_earnings(found))
        checked = found.checked(None if found.proof is None else found.proof.moments)
        checked = change.checked if checked is None else checked
        transition = by_pair_slopes(change.transition.key, change.transition.slope, self.mdp)
        rate = rational(change.discount)
        if rate:
            for pair, used in enumerate(self.squared_uses):
                if used:
                    ahead = self.crossed[pair] + chain.rate * chain.ahead(pair, self.second)
                    second += 2 * rate * used * ahead
        for pair, row in transition.items():
            second += self.squared_uses[pair] * chain.rate**2 * dot(row, self.second)
        variance = second - 2 * self.mean * mean
        return Movement(
            parameter=parameter,
            mean=claimed(fraction(mean), change.checked),
            variance=claimed(fraction(variance), checked),
            sd=self._sd(fraction(variance)),
            components=self._components(model, name, piece, transition, rate),
        )

    def _second_earnings(self, found: Samples) -> dict[int, fmpq]:
        """Return ∂E[r²] + 2 γ Σ ∂E[r; s'] V(s') of the pairs where it is not 0."""
        rate = self.chain.rate
        earned: dict[int, fmpq] = {}
        square = found.fitted(square_entries)
        for pair, slope in zip(square.key.tolist(), square.slope, strict=True):
            earned[pair] = rational(slope)
        joint = found.fitted(joint_entries)
        for pair, row in by_pair_slopes(joint.key, joint.slope, self.mdp).items():
            earned[pair] = earned.get(pair, rational(0)) + 2 * rate * dot(row, self.value)
        return earned

    def _sd(self, slope: Fraction) -> Bounded | None:
        """Return Var' / (2 sd) = ± √(Var'² / (4 Var)); None where the return does not vary."""
        if not self.variance:
            return None
        value = root(slope**2 / (4 * fraction(self.variance)))
        return Bounded(value=-value if slope < 0 else value, error=8 * UNIT * value + TINY)

    def _components(
        self,
        model: Parametric,
        name: str,
        piece: Piece,
        transition: dict[int, list[tuple[int, fmpq]]],
        rate: fmpq,
    ) -> dict[str, Bounded]:
        """Return ∂ of each component's total; its rows are floats, each rounded once."""
        origin, degree = parameter_of(model, name).value, max(model.degree(name), 1)
        drawn = sampled(model, name, piece, degree, origin=origin, base=self.mdp)
        # Rounded numbers are no polynomials: the bound says how far a slope may be off.
        samples, steps = drawn.models[: degree + 1], drawn.steps[:degree]
        unit = rational(Fraction(UNIT)) * sum((abs(w) for w in _weights(steps)), rational(0))
        found = {}
        for number, part in enumerate(self.mdp.component_names):
            value, size = self.parts[number], self.part_sizes[number]

            def entries(mdp: MDP, column: int = number) -> Entries:
                ratios = [float(c).as_integer_ratio() for c in mdp.components[:, column]]
                return np.arange(mdp.n_pairs), *_objects(ratios)

            moved = changes(samples, steps, entries)
            largest = np.max([np.abs(mdp.components[:, number]) for mdp in samples], axis=0)
            total = error = rational(0)
            for pair, slope in zip(moved.key.tolist(), moved.slope, strict=True):
                total += self.uses[pair] * rational(slope)
                error += self.uses[pair] * rational(Fraction(float(largest[pair]))) * unit
            for pair, row in transition.items():
                total += self.uses[pair] * self.chain.rate * dot(row, value)
                bound = [(state, abs(slope)) for state, slope in row]
                error += self.uses[pair] * rational(Fraction(UNIT)) * dot(bound, size)
            if rate:
                for pair, used in enumerate(self.uses):
                    if used:
                        total += used * rate * self.chain.ahead(pair, value)
                        ahead = self.chain.ahead(pair, size)
                        error += used * abs(rate) * rational(Fraction(UNIT)) * ahead
            shown = float(fraction(total))
            bound_of = float(fraction(error)) * (1 + 4 * UNIT) + UNIT * abs(shown)
            found[part] = Bounded(value=shown, error=bound_of)
        return found


def root(number: Fraction) -> float:
    """Return the square root as a float, also of what is too small or too large for one.

    Examples
    --------
    >>> root(Fraction(1, 10**400)), root(Fraction(10**400)), root(Fraction(0))
    (1e-200, 1e+200, 0.0)
    """
    if not number:
        return 0.0
    size = number.numerator.bit_length() - number.denominator.bit_length()
    shift = (160 - size) // 2  # the root of number · 4^shift has about 80 bits
    scaled = number * Fraction(4) ** shift
    found = isqrt(scaled.numerator // scaled.denominator)
    try:
        return ldexp(found, -shift)
    except OverflowError:
        return inf


def _weights(steps: Sequence[Fraction]) -> list[fmpq]:
    """Return what each sample, the first at 0, counts in the derivative at 0."""
    found = []
    points = [Fraction(0), *steps]
    for k, own in enumerate(points):
        others = [p for j, p in enumerate(points) if j != k]
        scale = Fraction(1)
        for other in others:
            scale *= own - other
        slope = Fraction(0)
        for skipped in range(len(others)):
            term = Fraction(1)
            for j, other in enumerate(others):
                if j != skipped:
                    term *= -other
            slope += term
        found.append(rational(slope / scale))
    return found


def _objects(ratios: Sequence[tuple[int, int]]) -> tuple[Numbers, Numbers]:
    top, bottom = np.empty(len(ratios), dtype=object), np.empty(len(ratios), dtype=object)
    top[:], bottom[:] = [a for a, _ in ratios], [b for _, b in ratios]
    return top, bottom
