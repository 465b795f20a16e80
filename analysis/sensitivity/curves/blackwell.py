"""The policy that is optimal for all discounts close to 1, and the discount from which it is.

A policy π is Blackwell optimal if some γ̄ < 1 exists such that π is optimal for every γ in [γ̄, 1)
(Blackwell, Annals of Mathematical Statistics 33, 1962; Puterman, Markov Decision Processes, 1994,
section 10.1). With the gap polynomials of `.gap_polynomials`,

    D(γ) h_l(γ),   D > 0 on [0, 1),   h_l = V_π(s) - Q_π(l),

this is decided at γ = 1: the first derivative there that is not 0 gives each its sign just below.
Policies that are optimal at 1 - 2^-k are tried, k = 4, 8, 16, …; finitely many thresholds lie
below 1, so that one of them is Blackwell optimal. γ̄ is the greatest root below 1 at which a gap
turns negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.sensitivity.base_case import maximised
from exact_mdp.analysis.sensitivity.curves.checker import Section, Values, blackwell_violations
from exact_mdp.analysis.sensitivity.curves.gap_polynomials import Gaps
from exact_mdp.analysis.sensitivity.curves.optimal_stretches import Sweep
from exact_mdp.analysis.sensitivity.curves.real_roots import Root, roots, sign, simple
from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.analysis.sensitivity.thresholds import divided_family, sections_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.proof.certify import certify
from exact_mdp.solvers.solution import Claim

if TYPE_CHECKING:
    from flint import fmpq_poly
    from pandas import DataFrame

pandas = later("pandas")
WIDTH = Fraction(1, 10**12)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Blackwell(Result):
    """A Blackwell optimal policy.

    Attributes
    ----------
    low, high : Fraction
        The discount from which the policy is optimal lies between them, at most 1e-12 apart; equal
        where it is a rational found exactly, or 0.
    policy : (S,) int64
        Action numbers: the first of those that are Blackwell optimal.
    optimal : (L,) bool
        All pairs that are optimal for every discount close to 1.
    mdp : MDP
    family : Parametric
        What is maximised, at every discount.
    section : Section
        Of the discount, 0 to 1.
    values : (N of each of S states, D)
        The policy's values.
    """

    low: Fraction
    high: Fraction
    policy: Integers
    optimal: NDArray[np.bool_]
    mdp: MDP
    family: Parametric
    section: Section
    values: Values

    claim: ClassVar[Claim] = Claim.CERTIFIED

    def __repr__(self) -> str:
        return f"Blackwell(optimal for discounts from {float(self.high):.12g} to 1; certified)"

    def violations(self) -> list[str]:
        """Return what does not hold, in words: nothing where it is sound (`.checker`)."""
        mdp = self.mdp
        pairs = [mdp.pairs_of(state) for state in range(mdp.n_states)]
        first = [next((mdp.pair_action[p] for p in own if self.optimal[p]), -1) for own in pairs]
        wrong = [] if np.array_equal(first, self.policy) else ["the policy takes other pairs"]
        bracket = (self.low, self.high)
        return wrong + blackwell_violations(
            self.family, self.section, self.values, self.optimal, bracket
        )

    def frame(self) -> DataFrame:
        """Return the action of each state."""
        mdp = self.mdp
        names = [mdp.actions[action] for action in self.policy]
        return pandas.DataFrame({"state": mdp.space.labels(range(mdp.n_states)), "action": names})


def blackwell(model: Scenario | MDP | Parametric) -> Blackwell:
    """Return the policy that is optimal for all discounts close to 1, whatever the model's own.

    Parameters
    ----------
    model : Scenario, MDP or Parametric

    Returns
    -------
    Blackwell

    Raises
    ------
    ModelError
        For a model with cycles that is too large (`.gap_polynomials`).

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> found = blackwell(MDP.from_outcomes(rows, "1/2"))  # Puterman (1994), section 3.1
    >>> found.high, found.policy.tolist()
    (Fraction(10, 11), [0, 0])
    """
    family = divided_family(parametric(model))
    mdp = family.at({})
    if mdp.sense == "min":
        family, _ = maximised(family, "optimal")
    (section,) = sections_of(family, "discount", Range(low=Fraction(0), high=Fraction(1)))
    assert isinstance(section, Sweep)
    gaps, origin = Gaps(section.rows, (section.low, section.high)), section.origin
    steps = 4
    while True:
        near = certify(family.at({"discount": 1 - Fraction(1, 2**steps)}))
        marked = np.flatnonzero(near.optimal_pairs)
        pairs = marked[np.flatnonzero(np.diff(mdp.pair_state[marked], prepend=-1))]
        gaps.follow(pairs)
        if all(_before(poly, section.high) >= 0 for poly in gaps.gap):
            break
        steps *= 2
    turns = [turn for poly in gaps.gap for turn in _turns(poly, section.low, section.high)]
    last = max(turns, key=lambda root: root.high, default=None)
    low, high = (-origin, -origin) if last is None else (last.low, last.high)
    optimal = np.array([poly.degree() < 0 for poly in gaps.gap])
    first = np.flatnonzero(optimal)
    chosen = first[np.flatnonzero(np.diff(mdp.pair_state[first], prepend=-1))]
    return Blackwell(
        low=low + origin,
        high=high + origin,
        policy=mdp.pair_action[chosen],
        optimal=optimal,
        mdp=mdp,
        family=family,
        section=Section(low=section.low + origin, high=section.high + origin, origin=origin),
        values=gaps.values,
    )


def _before(poly: fmpq_poly, end: Fraction) -> int:
    """Return the sign of a polynomial just below a point."""
    flip = 1
    while poly.degree() >= 0:
        here = sign(poly, end)
        if here:
            return flip * here
        poly, flip = poly.derivative(), -flip
    return 0


def _turns(poly: fmpq_poly, low: Fraction, high: Fraction) -> Iterator[Root]:
    """Yield the greatest root inside, narrow, below which a polynomial is negative."""
    below = low
    last = None
    for root in roots(simple(poly), low, high):
        near = root.narrowed(WIDTH).simplest().beyond(below)
        if sign(poly, (below + near.low) / 2) < 0:
            last = near
        below = near.high
    if last is not None:
        yield last
