"""How the rows of a model move with one parameter: exact polynomials of its changed entries.

    P(l, s'; θ) = P(l, s') + Σ_k P_k(l, s') (θ - θ0)^k,     r(l; θ) = r(l) + Σ_k r_k(l) (θ - θ0)^k

on a piece between two breakpoints, as FLINT's polynomials of y = θ - θ0. A polynomial of degree d
is fixed by d + 1 compiled models, without error in rational arithmetic. That the degree is d
follows from the rules of a care scenario, or from those of `moving`; that of any other family is
checked at further points on both sides of θ0: one that does not fit refutes it, and those that fit
are all that is known. With both ends among them, they show a line that has one kink.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, pairwise

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.exact import to_flint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.family import Family, Moved, Parametric, room_of
from exact_mdp.mdp.space import TIME
from exact_mdp.mdp.table import Integers, Numbers, format_rational, merge_outcomes

Entries = tuple[Integers, Numbers, Numbers]
"""Keys in rising order, and the integers whose ratios are the numbers there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """An interval, ends included, on which rows are polynomials, around θ0."""

    low: Fraction
    high: Fraction
    origin: Fraction


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """What is added to the entries that move, polynomials of y that are 0 at y = 0."""

    key: Integers  # (N,) rising
    moved: list[fmpq_poly]

    @property
    def slope(self) -> list[fmpq]:
        """The derivatives at y = 0."""
        return [each[1] for each in self.moved]


@dataclass(frozen=True, kw_only=True, eq=False)
class RowChange:
    """How transition rows, expected rewards and the discount move with one parameter."""

    name: str
    piece: Piece
    transition: Change  # keys are pair · S + next state
    reward: Change  # keys are pairs
    rate: fmpq_poly  # what is added to the discount
    checked: int | None  # points at which rows fit the polynomials; None for a known degree


def find_pieces(
    model: Parametric, name: str, origin: Fraction
) -> tuple[Piece | None, Piece | None]:
    """Return the pieces to the left and to the right of a value; None beyond the range.

    They are one and the same where the value, θ0 of both, is not a breakpoint. They reach three
    quarters of the way to the next one, where another polynomial may begin, or of 1.
    """
    low, high = room_of(model, name)
    low, high = origin - 1 if low is None else low, origin + 1 if high is None else high
    cuts = model.breakpoints(name)
    below = max((cut for cut in cuts if cut < origin), default=low)
    above = min((cut for cut in cuts if cut > origin), default=high)
    below, above = ((origin + 3 * end) / 4 for end in (below, above))
    cut = origin in cuts
    left = Piece(low=below, high=origin if cut else above, origin=origin)
    right = replace(left, low=origin, high=above) if cut else left
    return None if origin == low else left, None if origin == high else right


def row_change(model: Parametric, name: str, piece: Piece, base: MDP) -> RowChange:
    """Return how rows move with one parameter on a piece; `base` is the model at θ0.

    Raises ModelError where rows are not polynomials of the degree that the model states, or where
    states, pairs or the start change.
    """
    degree, origin = max(model.degree(name), 1), piece.origin
    known = isinstance(model, ScenarioFamily) or (
        isinstance(model, Family) and isinstance(model.build, Moved)
    )
    count = degree if known else degree + EXTRA
    sampled = {origin: base, **_build_sample_models(model, name, piece, count)}
    points, models = [*sampled], [*sampled.values()]
    for point, other in sampled.items():
        with locate_errors(f"parameter {name} = {format_rational(point)}"):
            check_alike(base, other, start=True)
    steps = [to_flint(point - origin) for point in points]
    changes = [
        _interpolate_changes(models, steps, entries)
        for entries in (transition_entries, reward_entries)
    ]
    for change, targets in zip(changes, (base.n_states, 1), strict=True):
        for key, moved in zip(change.key.tolist(), change.moved, strict=True):
            if moved.degree() > degree:
                where = f", {base.where(key // targets)}"
                raise _no_polynomial("rows are not polynomials", name, degree, points, moved, where)
    rate = interpolate_polynomials(steps, [[to_flint(mdp.discount_exact)] for mdp in models])[0]
    if rate.degree() > degree:
        raise _no_polynomial("the discount is not a polynomial", name, degree, points, rate)
    return RowChange(
        name=name,
        piece=piece,
        transition=changes[0],
        reward=changes[1],
        rate=rate - rate[0],
        checked=None if known else len(models),
    )


def _no_polynomial(
    what: str, name: str, degree: int, at: list[Fraction], through: fmpq_poly, where: str = ""
) -> ModelError:
    """Return the error that names the first point that the polynomial of those before it misses."""
    steps = [to_flint(point - at[0]) for point in at]
    near = interpolate_polynomials(
        steps[: degree + 1], [[through(y)] for y in steps[: degree + 1]]
    )[0]
    missed, y = next(
        (point, y) for point, y in zip(at, steps, strict=True) if near(y) != through(y)
    )
    apart: fmpq = abs(near(y) - through(y))
    size: fmpq = abs(through(y))
    floats = "let build compute with the fractions that it is given, not with floats"
    any_function = "one_way and tornado take any function"
    scaled = apart * to_flint(ROUNDED)
    if scaled <= 1 or scaled <= size:
        raised = f"{what} of degree {degree} in {name}, but equal to one within {float(apart):.0e}"
        fix = f"{floats}: a difference so small comes of rounding; {any_function}"
    else:
        raised = f"{what} of degree {degree} in {name}"
        fix = f'state breaks={{"{name}": [value, …]}} where the formula changes, or a higher '
        fix += f'degree, degrees={{"{name}": {degree + 1}}}; a quotient is a polynomial of no '
        fix += f"degree; {floats}; {any_function}"
    return ModelError(raised, where=f"parameter {name} = {format_rational(missed)}{where}", fix=fix)


ROUNDED = Fraction(10**12)  # a share of a number that a few roundings may take from it, inverted
EXTRA = 5  # points beyond those that a degree needs, which check it; the result says how many
SHRINKS = 64  # halvings of the distance to θ0 where there is no model, before that is refused


def _build_sample_models(
    model: Parametric, name: str, piece: Piece, count: int
) -> dict[Fraction, MDP]:
    """Return the models at `count` points other than the origin, the nearest first.

    They are spread over both sides of it, to the ends of the piece. Where a family has no model, as
    where a probability would pass 1, those of that side are moved closer to the origin, and then to
    the other side.
    """
    origin, refused = piece.origin, list[ModelError]()
    sides = [end - origin for end in (piece.high, piece.low) if end != origin]

    def build_side(side: Fraction, count: int) -> dict[Fraction, MDP]:
        parts = 2 ** count.bit_length()  # a power of 2 keeps denominators small
        for halved in range(SHRINKS):
            width = side / 2**halved / parts
            points = [origin + width * (k * parts // count) for k in range(count, 0, -1)]
            try:
                return {point: model.at({name: point}) for point in points}
            except ModelError as error:
                refused.append(error)
        return {}

    counts = [count - count // 2, count // 2] if len(sides) == 2 else [count]
    found = [build_side(side, own) for side, own in zip(sides, counts, strict=True) if own]
    if not all(found):  # the side that has models, or was not asked, holds all points
        others = [side for side, own in zip(sides, found, strict=False) if own]
        found = [build_side(side, count) for side in others or sides[len(found) :]]
    if not any(found):
        raise refused[0]
    return dict(sorted(chain(*map(dict.items, found)), key=lambda each: abs(each[0] - origin)))


def check_alike(first: MDP, other: MDP, *, start: bool) -> None:
    """Raise ModelError unless two models differ in their numbers alone; `start` is compared, too.

    Components are not: models whose rewards move may have none. A goal is kept at discount 1 alone.
    """
    goals = [mdp.goal for mdp in (first, other) if mdp.goal is not None]
    for what, one, two in (
        ("numbers of states", first.n_states, other.n_states),
        ("names of states", first.space, other.space),
        ("states of pairs", first.pair_state.tobytes(), other.pair_state.tobytes()),
        ("actions of pairs", first.pair_action.tobytes(), other.pair_action.tobytes()),
        ("names of actions", first.actions, other.actions),
        ("senses", first.sense, other.sense),
        *(("goals", one.tobytes(), two.tobytes()) for one, two in pairwise(goals)),
        *[("probabilities of the start", first.start, other.start)] * start,
    ):
        if one != two and what.endswith("of pairs") and TIME in first.space.names:
            raise ModelError(
                f"{what} change: in a model of so many steps a state in which all is over has one "
                "action",
                fix="choose other values: not one at which nothing is earned in a state that is "
                "not left",
            )
        if one != two:
            raise ModelError(
                f"{what} change",
                fix="let build return the same states, actions, pairs, start and sense for all "
                "values: MDP.from_function(…, impossible=True) keeps states whose probability is "
                "0 at some; give an action that is not offered a reward so low that it is never "
                "taken",
            )


def _interpolate_changes(
    models: Sequence[MDP], steps: Sequence[fmpq], entries: Callable[[MDP], Entries]
) -> Change:
    """Return the polynomials through entries of models, of which the first is at y = 0."""
    each = [entries(model) for model in models]
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
    samples = [
        to_flint_ratios(top[moved], below[moved]) for top, below in zip(tops, bottoms, strict=True)
    ]
    through = interpolate_polynomials(steps, samples)
    return Change(key=keys[moved], moved=[each - each[0] for each in through])


def interpolate_polynomials(
    points: Sequence[fmpq | int], samples: Sequence[Sequence[fmpq]]
) -> list[fmpq_poly]:
    """Return the polynomials through columns of samples, which have a row for each point."""
    size, count = len(points), len(samples[0])
    powers = fmpq_mat(size, size, [x**power for x in points for power in range(size)])
    numbers = [number for row in samples for number in row]
    fitted = powers.solve(fmpq_mat(size, count, numbers)).entries()
    return [fmpq_poly(fitted[column::count]) for column in range(count)]


def transition_entries(mdp: MDP) -> Entries:
    """Return the transition matrix: keys are pair · S + next state."""
    offsets, following, weight, denominator = merge_outcomes(mdp.table)
    lengths = np.diff(offsets)
    pair = np.repeat(np.arange(mdp.n_pairs), lengths)
    return pair * mdp.n_states + following, weight, np.repeat(denominator, lengths)


def reward_entries(mdp: MDP) -> Entries:
    """Return the expected rewards: keys are pairs."""
    top, bottom = mdp.table.expected_gain_exact()
    return np.arange(mdp.n_pairs), top, bottom


def to_flint_ratios(top: Numbers, bottom: Numbers) -> list[fmpq]:
    """Return the ratios of integers."""
    return [fmpq(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
