"""How the rows of a model move with one parameter: exact polynomials of its changed entries.

    P(l, s'; θ) = P(l, s') + Σ_k P_k(l, s') (θ - θ0)^k,     r(l; θ) = r(l) + Σ_k r_k(l) (θ - θ0)^k

on a piece between two breakpoints. A polynomial of degree d is fixed by d + 1 compiled models
(Newton's divided differences); in rational arithmetic that is no approximation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from mdp.bellman import distinct, merged
from mdp.model import MDP
from mdp.parametric import Parametric, parameter_of
from mdp.table import Integers, Numbers

Entries = tuple[Integers, Numbers, Numbers]
"""Keys in rising order, and the integers whose ratios are the numbers there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """An interval on which rows are polynomials; open ends are None."""

    low: Fraction | None
    high: Fraction | None

    def points(self, origin: Fraction, count: int) -> list[Fraction]:
        """Return `count` other points of the piece, all on one side of `origin` within it."""
        if self.high is None or origin < self.high:
            width = Fraction(1) if self.high is None else self.high - origin
        else:
            width = Fraction(-1) if self.low is None else self.low - origin
        return [origin + width * k / count for k in range(1, count + 1)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """Coefficients of (θ - θ0)^k, k from 1, of the entries that move.

    Attributes
    ----------
    key : (N,) int64
        The entries: pair · S + next state, or the pair.
    coefficients : tuple of (N,) arrays of Fraction
    """

    key: Integers
    coefficients: tuple[Numbers, ...]

    @property
    def slope(self) -> Numbers:
        """(N,) the derivatives at θ0."""
        return self.coefficients[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class RowChange:
    """How transition rows, expected rewards and the discount move with one parameter.

    Attributes
    ----------
    name : str
    origin : Fraction
        The value θ0 at which the coefficients hold.
    piece : Piece
    transition, reward : Change
        Keys are pair · S + next state, and the pair.
    discount : Fraction
        Derivative of the discount.
    """

    name: str
    origin: Fraction
    piece: Piece
    transition: Change
    reward: Change
    discount: Fraction


def pieces(model: Parametric, name: str, origin: Fraction) -> tuple[Piece | None, Piece | None]:
    """Return the pieces to the left and to the right of a value; None beyond the range.

    They are one and the same where the value is not a breakpoint.
    """
    parameter = parameter_of(model, name)
    low, high = parameter.low, parameter.high
    cuts = model.breakpoints(name)
    below = max((cut for cut in cuts if cut < origin), default=low)
    above = min((cut for cut in cuts if cut > origin), default=high)
    if origin not in cuts:
        whole = Piece(low=below, high=above)
        left, right = whole, whole
    else:
        left, right = Piece(low=below, high=origin), Piece(low=origin, high=above)
    return None if origin == low else left, None if origin == high else right


def row_change(
    model: Parametric,
    name: str,
    piece: Piece,
    *,
    origin: Fraction | None = None,
    base: MDP | None = None,
) -> RowChange:
    """Return how rows move with one parameter on a piece.

    Parameters
    ----------
    origin : Fraction, optional
        A value on the piece; the parameter's own unless given.
    base : MDP, optional
        The model there, where it is at hand.

    Examples
    --------
    >>> from mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> family = moving(mdp, {"p": [(0, 0)]})
    >>> found = row_change(family, "p", Piece(low=Fraction(0), high=Fraction(1)))
    >>> found.transition.key.tolist(), [str(slope) for slope in found.transition.slope]
    ([0, 1], ['1', '-1'])
    """
    place = parameter_of(model, name).value if origin is None else origin
    points = piece.points(place, model.degree(name))
    samples = [model.at({name: place}) if base is None else base]
    samples += [model.at({name: point}) for point in points]
    steps = [point - place for point in points]
    rate = (samples[1].discount_exact - samples[0].discount_exact) / steps[0]
    return RowChange(
        name=name,
        origin=place,
        piece=piece,
        transition=changes(samples, steps, transition_entries),
        reward=changes(samples, steps, reward_entries),
        discount=rate,
    )


def changes(
    samples: Sequence[MDP], steps: Sequence[Fraction], entries: Callable[[MDP], Entries]
) -> Change:
    """Return the polynomials through entries of models at 0 and at each of `steps`."""
    found = [entries(sample) for sample in samples]
    keys = found[0][0]
    if any(len(key) != len(keys) or (key != keys).any() for key, _, _ in found[1:]):
        keys = np.unique(np.concatenate([key for key, _, _ in found]))
    tops, bottoms = [], []
    for key, top, bottom in found:
        place = np.searchsorted(keys, key)
        above, below = np.zeros(len(keys), dtype=object), np.ones(len(keys), dtype=object)
        above[place], below[place] = top.astype(object), bottom.astype(object)
        tops.append(above)
        bottoms.append(below)
    moved = np.zeros(len(keys), dtype=bool)
    for top, bottom in zip(tops[1:], bottoms[1:], strict=True):
        moved |= np.asarray(top * bottoms[0] != tops[0] * bottom, dtype=bool)
    if len(steps) == 1:  # one division instead of a dozen
        (low, high), (under, over) = (t[moved] for t in tops), (b[moved] for b in bottoms)
        (step,) = steps
        rise = (high * under - low * over) * step.denominator
        slope = _fractions(rise, under * over * step.numerator)
        return Change(key=keys[moved], coefficients=(slope,))
    values = [
        _fractions(top[moved], bottom[moved]) for top, bottom in zip(tops, bottoms, strict=True)
    ]
    return Change(key=keys[moved], coefficients=_newton(values, [Fraction(0), *steps]))


def transition_entries(mdp: MDP) -> Entries:
    """Return the transition matrix: keys are pair · S + next state."""
    offsets, following, weight, denominator = merged(mdp.table)
    lengths = np.diff(offsets)
    pair = np.repeat(np.arange(mdp.n_pairs), lengths)
    return pair * mdp.n_states + following, weight, np.repeat(denominator, lengths)


def reward_entries(mdp: MDP) -> Entries:
    """Return the expected rewards: keys are pairs."""
    top, bottom = mdp.table.expected_gain_exact()
    return np.arange(mdp.n_pairs), top, bottom


def square_entries(mdp: MDP) -> Entries:
    """Return the expected squares of rewards: keys are pairs."""
    weight, bottom, gain, below = _outcomes(mdp)
    total = np.add.reduceat(weight * gain * gain, mdp.table.offsets[:-1])
    return np.arange(mdp.n_pairs), total, bottom * below * below


def joint_entries(mdp: MDP) -> Entries:
    """Return E[r; next state is s'] of every pair: keys are pair · S + next state."""
    weight, bottom, gain, below = _outcomes(mdp)
    first, offsets = distinct(mdp.table)
    pair = np.repeat(np.arange(mdp.n_pairs), np.diff(offsets))
    total = np.asarray(np.add.reduceat(weight * gain, first))
    return pair * mdp.n_states + mdp.table.next[first], total, (bottom * below)[pair]


def _outcomes(mdp: MDP) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return weights and gains of all outcomes as Python integers, with their denominators."""
    weight, bottom = mdp.table.integer_weights()
    gain, below = mdp.table.integer_gains()
    if len(gain) == mdp.n_pairs:
        gain = np.repeat(gain, np.diff(mdp.table.offsets))
    return (
        weight.astype(object),
        bottom.astype(object),
        gain.astype(object),
        below.astype(object),
    )


def _fractions(top: Numbers, bottom: Numbers) -> Numbers:
    found = np.empty(len(top), dtype=object)
    found[:] = [Fraction(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
    return found


def _newton(values: list[Numbers], points: list[Fraction]) -> tuple[Numbers, ...]:
    """Return the coefficients of powers from 1 of the polynomials through (points, values)."""
    order = len(points) - 1
    divided = list(values)
    for level in range(1, order + 1):
        for k in range(order, level - 1, -1):
            divided[k] = (divided[k] - divided[k - 1]) / (points[k] - points[k - level])
    total = [divided[order]] + [0 * divided[order]] * order
    for k in range(order - 1, -1, -1):  # Horner: multiply by (x - points[k]), add divided[k]
        shifted = [0 * total[0], *total[:-1]]
        total = [a - points[k] * b for a, b in zip(shifted, total, strict=True)]
        total[0] = total[0] + divided[k]
    return tuple(total[1:])
