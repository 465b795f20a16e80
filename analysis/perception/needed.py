"""The accuracy of perception from which on a policy keeps a share of its value, exactly.

With accuracy x a status is read rightly with probability x where it is present and where it is
absent, the statuses independently. Every entry of the confusion matrix is then a polynomial in x,
and so is the value of a policy that takes what it perceives for true, as states never come back:

    V(x) = Σ_k c_k x^k,   c_k rational.

It is computed as it stands, so that the accuracies at which it crosses a target are isolated
exactly (`analysis.sensitivity.curves.real_roots`): all of them, and whether there is only one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.perception.values import Passes
from exact_mdp.analysis.sensitivity.curves.real_roots import Root, roots, sign, simple
from exact_mdp.mdp.care.perception import status_names
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.symbolic import fraction, rational
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, exact
from exact_mdp.solvers.solution import Certified

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly
    from pandas import DataFrame

flint, pandas = later("flint"), later("pandas")

ALL = "all"
LOWEST = Fraction(1, 2)  # an accuracy that says nothing
WIDTH = Fraction(1, 10**12)


def confusion_at(model: MDP, accuracy: float, status: str = ALL) -> Floats:
    """Return the confusion (Z, Z) at one accuracy of a status, the others perfect, or of all."""
    if not 0 <= accuracy <= 1:
        raise ModelError(f"accuracy is {accuracy}", where="accuracy", fix="choose from 0 to 1")
    found = np.ones((1, 1))
    for changed in _uncertain(model, status):
        x = accuracy if changed else 1.0
        found = np.kron(found, np.array([[x, 1 - x], [1 - x, x]]))
    return found


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AccuracyNeeded(Result):
    """The accuracy that keeps a share of what a policy is worth where it sees the truth.

    Attributes
    ----------
    status : str
        The status that is perceived with errors, or "all".
    share, target : Fraction
        What is to be kept, as a share of V(1) and as a value.
    perfect : Fraction
        V(1), certified.
    crossings : tuple of (low, high, rising)
        Every accuracy above 1/2 and below 1 at which V crosses or touches the target, between two
        rationals at most 1e-12 apart, and whether V goes up there.
    enough : Fraction
        From this accuracy on, up to 1, the target is kept: the last crossing's upper end; 1/2 where
        there is none.
    monotone : bool
        Whether V rises all the way from 1/2 to 1.
    polynomial : tuple of Fraction
        The coefficients c_k of V.
    """

    status: str
    share: Fraction
    target: Fraction
    perfect: Fraction
    crossings: tuple[tuple[Fraction, Fraction, bool], ...]
    enough: Fraction
    monotone: bool
    polynomial: tuple[Fraction, ...]

    @property
    def value(self) -> Certified:
        """The accuracy that is enough; roots are isolated in rational arithmetic."""
        return Certified(value=self.enough)

    def frame(self) -> DataFrame:
        """Return one row for each crossing."""
        rows = [(float(low), float(high), rising) for low, high, rising in self.crossings]
        return pandas.DataFrame(rows, columns=["low accuracy", "high accuracy", "rising"])


def accuracy_needed(
    model: MDP, policy: PolicyLike = "optimal", *, share: object = "19/20", status: str = ALL
) -> AccuracyNeeded:
    """Return the accuracy from which on a policy on perceptions keeps a share of its value.

    Parameters
    ----------
    model : MDP
        With a column `status`.
    policy : PolicyLike
    share : number or "p/q"
        Of the value where it sees the truth, from 0 to 1.
    status : str
        The status that is perceived with errors, the others perfectly; or "all".

    Returns
    -------
    AccuracyNeeded

    Raises
    ------
    ModelError
        Where that value is not positive, so that a share of it cannot be a target.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> found = accuracy_needed(Scenario.load("yuan2025").with_(tasks=[1]).compile())
    >>> f"{float(found.enough):.6f}", found.monotone, len(found.crossings)
    ('...', True, 1)
    """
    part = exact(share)
    if not 0 <= part <= 1:
        raise ModelError(f"share is {share}", where="share", fix="choose one from 0 to 1")
    poly = _value_polynomial(model, policy, status)
    perfect = fraction(poly(rational(Fraction(1))))
    if perfect <= 0:
        raise ModelError(
            f"the value with perfect perception is {float(perfect):.6g}, not positive",
            where="share",
            fix="ask for curves of the value instead",
        )
    target = part * perfect
    above = poly - rational(target)
    crossings = tuple(_crossings(above))
    slope = poly.derivative()
    # No sign of the slope changes inside, and it is nowhere negative: it rises all the way.
    turning = [root for root in _inside(slope) if _sides(slope, root) != (1, 1)]
    return AccuracyNeeded(
        status=status,
        share=part,
        target=target,
        perfect=perfect,
        crossings=crossings,
        enough=crossings[-1][1] if crossings else LOWEST,
        monotone=not turning and sign(slope, Fraction(3, 4)) >= 0,
        polynomial=tuple(fraction(each) for each in poly.coeffs()),
    )


def _value_polynomial(mdp: MDP, policy: PolicyLike, status: str) -> fmpq_poly:
    """Return the value at the start as an exact polynomial of the accuracy."""
    zero: fmpq_poly = flint.fmpq_poly([])
    passes = Passes(mdp)
    shares = [[_exact_shares(row) for row in rows] for rows in passes.table(policy).tolist()]
    entries, rate = _entries(_uncertain(mdp, status)), rational(mdp.discount_exact)
    value: dict[int, fmpq_poly] = {}
    gain_top, gain_bottom = mdp.table.expected_gain_exact()
    for state in np.concatenate(passes.layers).tolist():
        place, true = divmod(state, passes.statuses)
        done: dict[int, fmpq_poly] = {}
        for distance, seen in entries[true]:
            for action, share in shares[place][seen]:
                done[action] = done.get(action, zero) + distance * share
        total = zero
        for action, weight in done.items():
            pair = mdp.pair(state, action)
            ahead = zero
            for p, following, _ in mdp.table.row(pair):
                if following in value:
                    ahead = ahead + value[following] * rational(p)
            gain = rational(Fraction(int(gain_top[pair]), int(gain_bottom[pair])))
            total = total + weight * (ahead * rate + gain)
        value[state] = total
    start = zero
    for state, chance in mdp.start:
        start = start + value.get(state, zero) * rational(chance)
    return start


def _uncertain(mdp: MDP, status: str) -> list[bool]:
    names = status_names(mdp)
    if status != ALL and status not in names:
        raise ModelError(
            f"unknown status {status!r}", where="accuracy", fix=suggest(status, [*names, ALL])
        )
    return [status in (ALL, name) for name in names]


def _entries(bits: Sequence[bool]) -> list[list[tuple[fmpq_poly, int]]]:
    """Return, for each true status, the polynomials C(s, z) that are not 0, with z."""
    right, wrong = flint.fmpq_poly([0, 1]), flint.fmpq_poly([1, -1])
    count = sum(bits)
    by_distance = [right ** (count - h) * wrong**h for h in range(count + 1)]
    mask = sum(1 << (len(bits) - 1 - bit) for bit, on in enumerate(bits) if on)
    return [
        [
            (by_distance[(true ^ seen).bit_count()], seen)
            for seen in range(2 ** len(bits))
            if (true ^ seen) & ~mask == 0
        ]
        for true in range(2 ** len(bits))
    ]


def _exact_shares(row: Sequence[float]) -> list[tuple[int, fmpq]]:
    """Return the actions taken with their exact probabilities."""
    shares = [(action, Fraction(share)) for action, share in enumerate(row) if share]
    total = sum((share for _, share in shares), Fraction(0))
    return [(action, rational(share / total)) for action, share in shares]


def _crossings(above: fmpq_poly) -> Iterable[tuple[Fraction, Fraction, bool]]:
    for root in _inside(above):
        narrow = root.narrowed(WIDTH)
        yield narrow.low, narrow.high, _sides(above, root) == (-1, 1)


def _inside(poly: fmpq_poly) -> list[Root]:
    """Return the roots between 1/2 and 1, both left out."""
    if poly.degree() < 1:
        return []
    return list(roots(simple(poly), LOWEST, Fraction(1)))


def _sides(poly: fmpq_poly, root: Root) -> tuple[int, int]:
    """Return the signs of a polynomial just below and just above a root."""
    gap = Fraction(0) if root.low < root.high else Fraction(1, 2**80)
    # An end of the open interval may be another root: the interval is then made smaller.
    while root.low < root.high and 0 in (sign(poly, root.low), sign(poly, root.high)):
        root = root.narrowed((root.high - root.low) / 2)
        gap = Fraction(0) if root.low < root.high else Fraction(1, 2**80)
    return sign(poly, root.low - gap), sign(poly, root.high + gap)
