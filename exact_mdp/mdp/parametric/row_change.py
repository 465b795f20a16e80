"""How the rows of a model move with one parameter: exact polynomials of its changed entries.

    P(l, s'; θ) = P(l, s') + Σ_k P_k(l, s') (θ - θ0)^k,     r(l; θ) = r(l) + Σ_k r_k(l) (θ - θ0)^k

on a piece between two breakpoints. A polynomial of degree d is fixed by d + 1 compiled models
(Newton's divided differences), without error in rational arithmetic. That the degree is
d follows from the rules of a care scenario, or from those of `moving`; that of any other family is
checked at further points: one that does not fit refutes it, and those that fit are all that is
known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.family import (
    Family,
    Moved,
    Parametric,
    parameter_of,
    room_of,
    unposed,
)
from exact_mdp.mdp.table import Integers, Numbers, merged, shown

Entries = tuple[Integers, Numbers, Numbers]
"""Keys in rising order, and the integers whose ratios are the numbers there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """An interval on which rows are polynomials; open ends are None."""

    low: Fraction | None
    high: Fraction | None

    def points(self, origin: Fraction, count: int, shrunk: int = 0) -> list[Fraction]:
        """Return `count` other points inside the piece, all on one side of `origin` within it.

        They lie on the right of it where there is room, the nearer the more often `shrunk`.
        """
        if self.high is None or origin < self.high:
            width = Fraction(1) if self.high is None else self.high - origin
        else:
            width = Fraction(-1) if self.low is None else self.low - origin
        parts = 2 ** (count.bit_length() + shrunk)  # a power of 2 keeps denominators small
        return [origin + width * k / parts for k in range(1, count + 1)]

    def turned(self, origin: Fraction) -> Piece:
        """Return the part of the piece on the left of `origin`."""
        return Piece(low=self.low, high=origin)


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """Coefficients of (θ - θ0)^k, k from 1, of the entries that move, by rising keys (N,)."""

    key: Integers
    coefficients: tuple[Numbers, ...]

    @property
    def slope(self) -> Numbers:
        """(N,) the derivatives at θ0."""
        return self.coefficients[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class RowChange:
    """How transition rows, expected rewards and the discount move with one parameter."""

    name: str
    origin: Fraction  # the value θ0 at which the coefficients hold
    piece: Piece
    transition: Change  # keys are pair · S + next state
    reward: Change  # keys are pairs
    rate: tuple[Fraction, ...]  # coefficients of (θ - θ0)^k, k from 1, of the discount
    checked: int | None  # points at which rows fit the polynomials; None for a known degree

    @property
    def discount(self) -> Fraction:
        """The derivative of the discount at θ0."""
        return self.rate[0]


def pieces(model: Parametric, name: str, origin: Fraction) -> tuple[Piece | None, Piece | None]:
    """Return the pieces to the left and to the right of a value; None beyond the range.

    They are one and the same where the value is not a breakpoint.
    """
    low, high = room_of(model, name)
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
    """Return how rows move with one parameter on a piece, from `origin`, its own value by default.

    `base` is the model there, where it is known. Raises ModelError where rows are not polynomials
    of the degree that the model states, or where states, pairs or the start change.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric.family import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> family = moving(mdp, {"p": [(0, 0)]})
    >>> change = row_change(family, "p", Piece(low=Fraction(0), high=Fraction(1)))
    >>> change.transition.key.tolist(), [str(slope) for slope in change.transition.slope]
    ([0, 1], ['1', '-1'])
    """
    degree = max(model.degree(name), 1)
    place = parameter_of(model, name).value if origin is None else origin
    family = unposed(model)
    known = isinstance(family, ScenarioFamily) or (
        isinstance(family, Family) and isinstance(family.build, Moved)
    )
    points, models = _sampled(model, name, piece, place, degree if known else degree + EXTRA)
    models.insert(0, model.at({name: place}) if base is None else base)
    for point, other in zip(points, models[1:], strict=True):
        _check_alike(models[0], other, name, point)
    steps = [point - place for point in points]
    pieces = []
    for entries in (transition_entries, reward_entries):
        change = _changes(models, steps, entries)
        for power in change.coefficients[degree:]:
            wrong = change.key[np.asarray(power != 0, dtype=bool)]
            if len(wrong):
                pair = int(wrong[0]) // (models[0].n_states if entries is transition_entries else 1)
                raise _no_polynomial(
                    "rows are not polynomials", name, degree, models[0].where(pair)
                )
        pieces.append(Change(key=change.key, coefficients=change.coefficients[:degree]))
    rates = [np.array([mdp.discount_exact], dtype=object) for mdp in models]
    rate = [power[0] for power in _newton(rates, [Fraction(0), *steps])]
    if any(rate[degree:]):
        raise _no_polynomial("the discount is not a polynomial", name, degree)
    return RowChange(
        name=name,
        origin=place,
        piece=piece,
        transition=pieces[0],
        reward=pieces[1],
        rate=tuple(rate[:degree]),
        checked=None if known else len(models),
    )


def _no_polynomial(what: str, name: str, degree: int, where: str = "") -> ModelError:
    return ModelError(
        f"{what} of degree {degree} in {name}",
        where=f"parameter {name}" + (f", {where}" if where else ""),
        fix="let build compute with the fractions that it is given, not with floats; state a "
        f'higher degree, Family(degrees={{"{name}": 2}}), and where rows pass to another '
        f'polynomial, breaks={{"{name}": […]}}; one_way and tornado take any function',
    )


EXTRA = 4  # points at which a degree that is not known is checked, beside those that it needs
SHRINKS = 64  # how often points are moved closer to θ0 where there is no model


def _sampled(
    model: Parametric, name: str, piece: Piece, origin: Fraction, count: int
) -> tuple[list[Fraction], list[MDP]]:
    """Return points, and the models there.

    Points lie inside the piece: at its ends another polynomial may begin. Where a family has no
    model at some of them, as where a probability would pass 1, they are moved closer to `origin`.
    """
    sides = [piece]
    if (piece.high is None or origin < piece.high) and (piece.low is None or piece.low < origin):
        sides.append(piece.turned(origin))
    refused: ModelError | None = None
    for side in sides:
        for shrunk in range(0, SHRINKS, 4):
            points = side.points(origin, count, shrunk)
            try:
                return points, [model.at({name: point}) for point in points]
            except ModelError as error:
                refused = refused or error
    assert refused is not None
    raise refused


def _check_alike(first: MDP, other: MDP, name: str, point: Fraction) -> None:
    """Raise ModelError unless two models differ in their numbers alone."""
    for what, one, two in (
        ("states", first.n_states, other.n_states),
        ("states and actions of pairs", _pairs(first), _pairs(other)),
        ("the start", first.start, other.start),
    ):
        if one != two:
            raise ModelError(
                f"{what} change with {name}",
                where=f"parameter {name} = {shown(point)}",
                fix="let a parameter change only probabilities, rewards and the discount",
            )


def _pairs(mdp: MDP) -> tuple[bytes, bytes]:
    return mdp.pair_state.tobytes(), mdp.pair_action.tobytes()


def _changes(
    samples: Sequence[MDP], steps: Sequence[Fraction], entries: Callable[[MDP], Entries]
) -> Change:
    """Return the polynomials through entries of models at 0 and at each of `steps`."""
    each = [entries(sample) for sample in samples]
    keys = each[0][0]
    if any(len(key) != len(keys) or (key != keys).any() for key, _, _ in each[1:]):
        keys = np.unique(np.concatenate([key for key, _, _ in each]))
    tops, bottoms = [], []
    for key, top, bottom in each:
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


def _fractions(top: Numbers, bottom: Numbers) -> Numbers:
    numbers = np.empty(len(top), dtype=object)
    numbers[:] = [Fraction(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
    return numbers


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
