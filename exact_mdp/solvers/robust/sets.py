"""Sets of distributions around the rows of a model, and nature's best choice from each.

The row of pair l has outcomes i with nominal probability p_i, next state s_i and reward g_i. Its
value under a distribution q is Σ q_i x_i with x_i = g_i + γ V(s_i). Outcomes that a row does not
have stay impossible. The sets of all rows are independent, and nature chooses again whenever a pair
is used; for stationary policies, as here, a nature that chooses once does as well (Iyengar,
Mathematics of Operations Research 30, 2005).

    {q : lower_i ≤ q_i ≤ upper_i, Σ q_i = 1}   Givan, Leach and Dean, Artificial Intelligence 122,
        2000: in increasing order of x, outcomes get their upper bound as long as all others can
        still have their lower bound
    {q : Σ |q_i - p_i| ≤ ρ}   Strehl and Littman, Journal of Computer and System Sciences 74, 2008:
        ρ/2 of the mass moves from the greatest x to the least
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.forms.numbers import float_array
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import BLOCK, FLOAT_ROW_TOLERANCE, Floats, Integers, exact, format_rational
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gamma
from exact_mdp.solvers.claims import SolverError, Status


@dataclass(frozen=True, kw_only=True, eq=False)
class RowBlock:
    """K rows of n outcomes in one array, so that NumPy solves all inner problems at once.

    A shorter row is padded with copies of its first outcome, of probability 0.
    """

    place: Integers  # (K,) positions of the rows among the given pairs
    pair: Integers  # (K,)
    outcome: Integers  # (K, n) numbers of the outcomes in the model's table
    filled: NDArray[np.bool_]  # (K, n) True for padding
    next: Integers  # (K, n)
    probability: Floats  # (K, n)
    gain: Floats  # (K, n)
    largest: Floats  # (K,) the greatest |gain| of each row


LEFT = 8 * UNIT  # a probability up to this one is the rest that rounding leaves


class Ambiguity(ABC):
    """A set of distributions for each row, independent of others: (s, a)-rectangular."""

    @abstractmethod
    def minimise(self, block: RowBlock, payoff: Floats) -> tuple[Floats, Floats]:
        """Return members q (K, n) of the sets and b (K,): no member's mean is below Σ q x - b.

        Both hold up to rounding, which `solve_inner_problem` accounts for.
        """

    @abstractmethod
    def check(self, model: MDP) -> None:
        """Raise ModelError if this is not a set of distributions for the rows of a model."""

    def keeps_outcomes(self, model: MDP) -> Mask:
        """Return (L,) True for pairs all of whose outcomes are possible under every member.

        A set that does not say so keeps pairs with a single outcome.
        """
        return np.asarray(np.diff(model.table.offsets) == 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Intervals(Ambiguity):
    """Every probability within its own interval, by outcome of the model's table.

    Attributes
    ----------
    lower, upper : (N,)
        In the order of `mdp.table.next`; `relative` computes them.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> intervals = Intervals.relative(mdp, 0.2)
    >>> intervals.lower.tolist(), intervals.upper.tolist()
    ([0.4, 0.4, 0.8], [0.6, 0.6, 1.0])
    """

    lower: Floats
    upper: Floats

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            array = float_array(getattr(self, name), name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def relative(cls, model: MDP, share: object) -> Intervals:
        """Return the intervals p (1 ± share) within [0, 1].

        With a share below 1 every outcome stays possible.

        Parameters
        ----------
        model : MDP
        share : number
            0.1 for ± 10 %.

        Returns
        -------
        Intervals

        Examples
        --------
        >>> from exact_mdp import MDP, Intervals
        >>> mdp = MDP.from_arrays([[[0.5, 0.5], [0, 1]]], [[1], [0]])
        >>> Intervals.relative(mdp, 0.1).lower[:2].round(3).tolist()
        [0.45, 0.45]
        """
        part = radius_of(share, "a relative radius")
        p = model.table.compute_probabilities()
        return cls(lower=np.maximum(p * (1 - part), 0.0), upper=np.minimum(p * (1 + part), 1.0))

    def check(self, model: MDP) -> None:
        """Raise ModelError if a row has no distribution within its intervals."""
        shape = model.table.next.shape
        if self.lower.shape != shape or self.upper.shape != shape:
            raise ModelError(
                f"bounds of shapes {self.lower.shape} and {self.upper.shape}, not {shape}",
                where="intervals",
                fix="give one bound for each outcome of the model's table",
            )
        first = model.table.offsets[:-1]
        good = (self.lower >= 0) & (self.lower <= self.upper) & (self.upper <= 1)  # no NaN passes
        least, most = np.add.reduceat(self.lower, first), np.add.reduceat(self.upper, first)
        bad = ~np.logical_and.reduceat(good, first)
        bad |= ~((least <= 1 + FLOAT_ROW_TOLERANCE) & (most >= 1 - FLOAT_ROW_TOLERANCE))
        if bad.any():
            pair = int(np.flatnonzero(bad)[0])
            raise ModelError(
                "no distribution lies within the intervals of a row: lower bounds sum to "
                f"{least[pair]:g}, upper bounds to {most[pair]:g}",
                where=model.where(pair),
                fix="give 0 ≤ lower ≤ upper ≤ 1 with sums below and above 1",
            )

    def keeps_outcomes(self, model: MDP) -> Mask:
        """See `Ambiguity.keeps_outcomes`."""
        kept = np.logical_and.reduceat(self.lower > 0, model.table.offsets[:-1])
        return super().keeps_outcomes(model) | kept

    def minimise(self, block: RowBlock, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.minimise`."""
        # Every outcome gets its lower bound; the remaining mass goes to the least payoffs first,
        # each up to its upper bound.
        lower = np.where(block.filled, 0.0, self.lower[block.outcome])
        room = np.where(block.filled, 0.0, self.upper[block.outcome]) - lower
        order = np.argsort(payoff, axis=1)
        room = np.take_along_axis(room, order, axis=1)
        before = np.cumsum(room, axis=1) - room
        given = np.clip(1 - lower.sum(axis=1)[:, None] - before, 0.0, room)
        given += np.take_along_axis(lower, order, axis=1)
        np.put_along_axis(lower, order, given, axis=1)
        return lower, np.zeros(len(lower))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball(Ambiguity):
    """Distributions within a radius of the nominal row."""

    NAME: ClassVar[str]

    radius: Any  # one number for all pairs, or (L,) one for each

    def __post_init__(self) -> None:
        radius: Any = self.radius
        if isinstance(radius, np.ndarray | list | tuple):
            radius = np.array([radius_of(each, self.NAME) for each in radius])
            radius.setflags(write=False)
        else:
            radius = radius_of(radius, self.NAME)
        object.__setattr__(self, "radius", radius)

    def check(self, model: MDP) -> None:
        """Raise ModelError unless there is one radius, or one for each pair."""
        if isinstance(self.radius, np.ndarray) and len(self.radius) != model.n_pairs:
            raise ModelError(
                f"{len(self.radius)} radii for {model.n_pairs} pairs",
                where="radius",
                fix="give one for each",
            )

    def list_radii(self, block: RowBlock) -> Floats:
        """Return (K,) the radius of each row of a block."""
        each = self.radius
        if isinstance(each, np.ndarray):
            return each[block.pair]
        return np.full(len(block.pair), each)


@dataclass(frozen=True, kw_only=True, eq=False)
class L1Ball(Ball):
    """Distributions within an L1 distance of the nominal row: Σ |q - p| ≤ radius, from 0 to 2."""

    NAME = "an L1 radius"

    def keeps_outcomes(self, model: MDP) -> Mask:
        """See `Ambiguity.keeps_outcomes`."""
        p, pair = model.table.compute_probabilities(), model.table.pair
        radius = np.broadcast_to(self.radius, model.n_pairs)
        # The rest of an outcome has to be more than rounding, as in `minimise`.
        kept = p - radius[pair] / 2 > LEFT
        every = np.logical_and.reduceat(kept, model.table.offsets[:-1])
        return super().keeps_outcomes(model) | every

    def minimise(self, block: RowBlock, payoff: Floats) -> tuple[Floats, Floats]:
        """See `Ambiguity.minimise`."""
        # Move mass from the greatest payoffs to the least: half the radius, as it counts twice.
        p = block.probability
        order = np.argsort(-payoff, axis=1)
        lowest = order[:, -1:]
        mass = np.take_along_axis(p, order, axis=1)
        free = 1 - mass[:, -1]
        moved = np.minimum(self.list_radii(block) / 2, free)[:, None]
        before = np.cumsum(mass, axis=1) - mass
        taken = np.clip(moved - before, 0.0, mass)
        # An outcome with nothing left but rounding becomes impossible.
        mass = np.where(taken >= mass - LEFT, 0.0, mass - taken)
        q = np.empty_like(p)
        np.put_along_axis(q, order, mass, axis=1)
        gained = np.take_along_axis(q, lowest, axis=1) + moved
        np.put_along_axis(q, lowest, gained, axis=1)
        return q, np.zeros(len(q))


def radius_of(given: object, what: str) -> float:
    """Return a radius as a float; raise ModelError unless it is finite and at least 0."""
    number = exact(given, "radius")
    if not 0 <= number <= np.finfo(float).max:
        fix = "choose one from 0 up, no larger than a float can be"
        raise ModelError(f"{what} of {format_rational(number)}", where="radius", fix=fix)
    return float(number)


@contextmanager
def advise_on_sets() -> Iterator[None]:
    """Make a SolverError say what helps with sets of rows."""
    try:
        yield
    except SolverError as error:
        raise SolverError(error.status.with_sets, error.detail) from error


# ---- rows side by side ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Inner:
    """Nature's optimum of U rows, in [low, high]; `distributions` have about the `value`."""

    low: Floats
    high: Floats
    value: Floats
    distributions: list[Floats]  # (K, n) the distributions of each block


def side_by_side(
    pairs: Integers, rows: tuple[Integers, Integers], outcomes: tuple[Integers, Floats, Floats]
) -> list[RowBlock]:
    """Return rows (U,), given by their starts and lengths, in blocks of about the same length.

    Outcomes are next states, probabilities, which need not sum to 1, and rewards.
    """
    (start, length), (following, probability, gain), blocks = rows, outcomes, []
    # Widths are powers of 2, so at most half of a block is padding.
    width = 2 ** np.ceil(np.log2(length)).astype(np.int64)
    for n in np.unique(width).tolist():
        alike, column = np.flatnonzero(width == n), np.arange(n)
        for place in np.array_split(alike, -(-len(alike) * n // BLOCK)):
            filled = column >= length[place][:, None]
            outcome = start[place][:, None] + np.where(filled, 0, column)
            p = np.where(filled, 0.0, probability[outcome])
            blocks.append(
                RowBlock(
                    place=place,
                    pair=np.asarray(pairs[place]),
                    outcome=outcome,
                    filled=filled,
                    next=following[outcome],
                    probability=p / p.sum(axis=1, keepdims=True),
                    gain=gain[outcome],
                    largest=np.abs(gain[outcome]).max(axis=1),
                )
            )
    return blocks


def solve_inner_problem(
    ambiguity: Ambiguity,
    blocks: Sequence[RowBlock],
    value: Floats,
    *,
    discount: float,
    against: bool,
    rewards: bool = True,
) -> Inner:
    """Return the value of each row at values (S,) after nature's choice.

    Nature minimises the values of rows if it is `against` the agent, else it maximises them.
    Without `rewards` only later values count.
    """
    count = sum(len(block.place) for block in blocks)
    low, high, middle = np.empty(count), np.empty(count), np.empty(count)
    distributions = []
    for block in blocks:
        # The payoff x of each outcome, and the size on which its rounding depends.
        later = value[block.next]
        payoff = discount * later
        size = np.abs(payoff).max(axis=1)
        if rewards:
            payoff += block.gain
            size += block.largest
        # Differences of payoffs are up to twice their size.
        if not np.isfinite(4 * size).all():
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        # A maximum is minus the minimum of -x; the tolerance `short` is on nature's side.
        if payoff.shape[1] == 1:
            # A single outcome is certain.
            q, below, above = np.ones_like(payoff), np.zeros(len(payoff)), np.zeros(len(payoff))
        elif against:
            q, below = ambiguity.minimise(block, payoff)
            above = np.zeros(len(q))
        else:
            q, above = ambiguity.minimise(block, -payoff)
            below = np.zeros(len(q))
        # Differences from the first payoff lose no digits to the common part.
        base = payoff[:, :1]
        worst = base[:, 0] + np.einsum("kn,kn->k", q, payoff - base)
        n = payoff.shape[1]
        # A payoff is rounded four times; the mass of q misses the set by (2 n + 6) units, over
        # payoffs that are up to twice `size` apart; the sum is rounded n times.
        error = (gamma(8 * n + 32) * size + TINY * n * (size > 0)) * SLACK
        low[block.place] = worst - error - below
        high[block.place] = worst + error + above
        middle[block.place] = worst
        distributions.append(q)
    return Inner(low=low, high=high, value=middle, distributions=distributions)


def list_entries(
    blocks: Sequence[RowBlock], distributions: Sequence[Floats]
) -> tuple[Integers, Integers, Floats, Floats]:
    """Return place, next state and probability (N,) of all outcomes, and rows' rewards (U,)."""
    earned = np.zeros(sum(len(block.place) for block in blocks))
    nothing: Integers = np.zeros(0, dtype=np.int64)
    place, following, weight = [nothing], [nothing], [np.zeros(0)]
    for block, chances in zip(blocks, distributions, strict=True):
        earned[block.place] = np.einsum("kn,kn->k", chances, block.gain)
        positive = chances > 0
        place.append(np.repeat(block.place, positive.sum(axis=1)))
        following.append(block.next[positive])
        weight.append(chances[positive])
    return np.concatenate(place), np.concatenate(following), np.concatenate(weight), earned
