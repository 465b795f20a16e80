"""The rows of a model as functions of one parameter: exact polynomials of the changed entries.

    P(l, s'; θ) = P(l, s') + Σ_k P_k(l, s') (θ - θ0)^k,     r(l; θ) = r(l) + Σ_k r_k(l) (θ - θ0)^k

on a piece between two breakpoints, as FLINT polynomials of y = θ - θ0. A polynomial of degree d is
determined by d + 1 models, exactly in rational arithmetic. The degree follows from the rules of a
care scenario, or of `moving`. For any other family it is checked at further points on both sides of
θ0: a point that does not fit refutes it, and points that fit are evidence, not a proof. The ends of
the piece are among the points, so a line with one kink is detected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.exact import to_flint
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.family import Family, Moved, Parametric, room_of
from exact_mdp.mdp.table import Integers, Numbers, format_rational

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
    """The change of the entries that depend on θ, as polynomials of y that are 0 at y = 0."""

    key: Integers  # (N,) rising
    moved: list[fmpq_poly]

    @property
    def slope(self) -> list[fmpq]:
        """The derivatives at y = 0."""
        return [each[1] for each in self.moved]


@dataclass(frozen=True, kw_only=True, eq=False)
class RowChange:
    """The change of transition rows, expected rewards and the discount with one parameter."""

    name: str
    piece: Piece
    transition: Change  # keys are pair · S + next state
    reward: Change  # keys are pairs
    rate: fmpq_poly  # the change of the discount
    checked: int | None  # points at which rows fit the polynomials; None for a known degree

    def find_states(self, mdp: MDP) -> Mask:
        """Return (S,) True for states with a row or a reward that changes."""
        moving = np.zeros(mdp.n_states, dtype=bool)
        moving[mdp.pair_state[self.reward.key]] = True
        moving[mdp.pair_state[self.transition.key // mdp.n_states]] = True
        return moving


def find_pieces(
    model: Parametric, name: str, origin: Fraction
) -> tuple[Piece | None, Piece | None]:
    """Return the pieces to the left and to the right of a value θ0; None beyond the range.

    They are the same piece unless θ0 is a breakpoint. A piece extends three quarters of the way to
    the next breakpoint, where another polynomial may begin, or to the end of the range; without an
    end, three quarters of 1.
    """
    # The range of the parameter; without a limit, one unit to either side.
    low, high = room_of(model, name)
    if low is None:
        low = origin - 1
    if high is None:
        high = origin + 1
    # Pieces reach three quarters of the way to the next breakpoint on either side.
    cuts = model.breakpoints(name)
    below = max((cut for cut in cuts if cut < origin), default=low)
    above = min((cut for cut in cuts if cut > origin), default=high)
    below, above = ((origin + 3 * end) / 4 for end in (below, above))
    left: Piece | None = Piece(low=below, high=above, origin=origin)
    right = left
    # A breakpoint has a piece on each side; an end of the range has one side only.
    if origin in cuts:
        left = Piece(low=below, high=origin, origin=origin)
        right = Piece(low=origin, high=above, origin=origin)
    if origin == low:
        left = None
    if origin == high:
        right = None
    return left, right


def row_change(model: Parametric, name: str, piece: Piece, base: MDP) -> RowChange:
    """Return the change of the rows with one parameter on a piece; `base` is the model at θ0.

    Raises ModelError if rows are not polynomials of the stated degree, or if states, pairs or the
    start change.
    """
    degree, origin = max(model.degree(name), 1), piece.origin
    known = isinstance(model, ScenarioFamily) or (
        isinstance(model, Family) and isinstance(model.build, Moved)
    )
    # Build models at `count` points besides θ0; five more than needed check an unproven degree.
    count = degree
    if not known:
        count += 5
    sampled = {origin: base, **_build_sample_models(model, name, piece, count)}
    points, models = [*sampled], [*sampled.values()]
    for point, other in sampled.items():
        with locate_errors(f"parameter {name} = {format_rational(point)}"):
            check_alike(base, other, start=True)
            _require_same_ends(base, other)
    # Fit a polynomial through the points for each entry that changes.
    steps = [to_flint(point - origin) for point in points]
    changes = []
    for entries in (transition_entries, reward_entries):
        changes.append(_interpolate_changes(models, steps, entries))
    # A higher degree than stated shows that some point does not fit.
    for change, targets in zip(changes, (base.n_states, 1), strict=True):
        for key, moved in zip(change.key.tolist(), change.moved, strict=True):
            if moved.degree() > degree:
                where = f", {base.where(key // targets)}"
                raise _no_polynomial("rows are not polynomials", name, degree, points, moved, where)
    rate = interpolate_polynomials(steps, [[to_flint(mdp.discount_exact)] for mdp in models])[0]
    if rate.degree() > degree:
        raise _no_polynomial("the discount is not a polynomial", name, degree, points, rate)
    checked = None
    if not known:
        checked = len(models)
    return RowChange(
        name=name,
        piece=piece,
        transition=changes[0],
        reward=changes[1],
        rate=rate - rate[0],
        checked=checked,
    )


def _no_polynomial(
    what: str, name: str, degree: int, at: list[Fraction], through: fmpq_poly, where: str = ""
) -> ModelError:
    """Return the error for a wrong degree; it names the first point off the polynomial.

    `through` is the polynomial through all points `at`, of too high a degree.
    """
    # The polynomial through the first points, and the first point that it misses.
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
    # A relative difference below 1e-12 is a rounding error: build computes with floats.
    scaled = apart * 10**12
    if scaled <= 1 or scaled <= size:
        raised = f"{what} of degree {degree} in {name}, but equal to one within {float(apart):.0e}"
        fix = f"{floats}: so small a difference comes from rounding; {any_function}"
    else:
        raised = f"{what} of degree {degree} in {name}"
        fix = f'state breaks={{"{name}": [value, …]}} where the formula changes, or a higher '
        fix += f'degree, degrees={{"{name}": {degree + 1}}}; a quotient is a polynomial of no '
        fix += f"degree; {floats}; {any_function}"
    return ModelError(raised, where=f"parameter {name} = {format_rational(missed)}{where}", fix=fix)


def _build_sample_models(
    model: Parametric, name: str, piece: Piece, count: int
) -> dict[Fraction, MDP]:
    """Return the models at `count` points other than the origin, the nearest first.

    The points are spread over both sides of the origin, up to the ends of the piece. If the family
    has no model at some of them, for example since a probability would exceed 1, the points of that
    side are moved closer to the origin; if that fails, to the other side.
    """
    origin, refused = piece.origin, list[ModelError]()
    sides = [end - origin for end in (piece.high, piece.low) if end != origin]

    def build_side(side: Fraction, count: int) -> dict[Fraction, MDP]:
        """Return the models at points up to a distance `side`, which is halved 63 times at most."""
        parts = 2 ** count.bit_length()  # a power of 2 keeps denominators small
        for halved in range(64):
            width = side / 2**halved / parts
            points = [origin + width * (k * parts // count) for k in range(count, 0, -1)]
            try:
                return {point: model.at({name: point}) for point in points}
            except ModelError as error:
                refused.append(error)
        return {}

    counts = [count]
    if len(sides) == 2:
        counts = [count - count // 2, count // 2]
    found = []
    for side, points in zip(sides, counts, strict=True):
        if points:
            found.append(build_side(side, points))
    # If one side has no models, the other side gets all points.
    if not all(found):
        others = [side for side, own in zip(sides, found, strict=False) if own]
        found = [build_side(side, count) for side in others or sides[len(found) :]]
    if not any(found):
        raise refused[0]
    models: dict[Fraction, MDP] = {}
    for own in found:
        models |= own
    return dict(sorted(models.items(), key=lambda each: abs(each[0] - origin)))


def check_alike(first: MDP, other: MDP, *, start: bool) -> None:
    """Raise ModelError unless two models differ in probabilities and rewards only.

    The start is compared only with `start`, goals only if both models have one (a goal exists only
    at discount 1), and components not at all: models with changed rewards may have none.
    """
    parts: list[tuple[str, Any, Any]] = [
        ("numbers of states", first.n_states, other.n_states),
        ("names of states", first.space, other.space),
        ("states of pairs", first.pair_state.tobytes(), other.pair_state.tobytes()),
        ("actions of pairs", first.pair_action.tobytes(), other.pair_action.tobytes()),
        ("names of actions", first.actions, other.actions),
        ("senses", first.sense, other.sense),
    ]
    if first.goal is not None and other.goal is not None:
        parts.append(("goals", first.goal.tobytes(), other.goal.tobytes()))
    if start:
        parts.append(("probabilities of the start", first.start, other.start))
    # In a model with time in its states, pairs may also change since episodes end in other states.
    for what, one, two in parts:
        if one != two and what.endswith("of pairs") and first.space.untimed is not None:
            raise ModelError(
                f"{what} change: in a model of N steps, a state in which the episode is over has "
                "one action",
                fix="choose other values: at this one, a state that is never left has the reward 0",
            )
        if one != two:
            raise ModelError(
                f"{what} change",
                fix="let build return the same states, actions, pairs, start and sense for all "
                "values: MDP.from_function(…, impossible=True) keeps states whose probability is "
                "0 at some; give an action that is not available a reward so low that it is never "
                "taken",
            )


def _require_same_ends(first: MDP, other: MDP) -> None:
    """Raise ModelError if a state of a model of N steps is over in one of two models only.

    It then stays at its time instead of moving to the next, so that its rows are not polynomials.
    """
    differs = first.over != other.over
    if first.space.untimed is not None and differs.any():
        raise ModelError(
            "the episode is over in a state that is left at other values: it is never left here, "
            "and has the reward 0",
            where=first.space.place(int(differs.argmax())),
            fix="choose a range without this value",
        )


def _interpolate_changes(
    models: Sequence[MDP], steps: Sequence[fmpq], entries: Callable[[MDP], Entries]
) -> Change:
    """Return the change of entries from the first model, which is at y = 0, as polynomials."""
    # The entries of all models; an entry that a model lacks is 0 there.
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
    # Entries that differ between models, compared as fractions by cross multiplication.
    moved = np.zeros(len(keys), dtype=bool)
    for top, bottom in zip(tops[1:], bottoms[1:], strict=True):
        moved |= np.asarray(top * bottoms[0] != tops[0] * bottom, dtype=bool)
    samples = []
    for top, bottom in zip(tops, bottoms, strict=True):
        samples.append(to_flint_ratios(top[moved], bottom[moved]))
    through = interpolate_polynomials(steps, samples)
    return Change(key=keys[moved], moved=[each - each[0] for each in through])


def interpolate_polynomials(
    points: Sequence[fmpq | int], samples: Sequence[Sequence[fmpq]]
) -> list[fmpq_poly]:
    """Return the polynomial through each column of samples, which have a row for each point."""
    # Solve the Vandermonde system for the coefficients of all columns at once.
    size, count = len(points), len(samples[0])
    powers: list[fmpq | int] = []
    for x in points:
        powers += [x**power for power in range(size)]
    numbers: list[fmpq] = []
    for row in samples:
        numbers += row
    fitted = fmpq_mat(size, size, powers).solve(fmpq_mat(size, count, numbers)).entries()
    return [fmpq_poly(fitted[column::count]) for column in range(count)]


def transition_entries(mdp: MDP) -> Entries:
    """Return the entries of the transition matrix, with keys pair · S + next state."""
    offsets, following, weight, denominator = mdp.table.rows.merged
    lengths = np.diff(offsets)
    pair = np.repeat(np.arange(mdp.n_pairs), lengths)
    return pair * mdp.n_states + following, weight, np.repeat(denominator, lengths)


def reward_entries(mdp: MDP) -> Entries:
    """Return the expected rewards, with the pairs as keys."""
    top, bottom = mdp.table.expected_gain_exact
    return np.arange(mdp.n_pairs), top, bottom


def to_flint_ratios(top: Numbers, bottom: Numbers) -> list[fmpq]:
    """Return the ratios of integers as FLINT's rationals."""
    return [fmpq(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
