"""A total reward at discount 1 along a parameter, where some policy never ends.

End components decide (`solvers.endless.structure`): where a policy can stay for nothing, where it
gains or loses for ever. At one value of the parameter they are found as for any model; rests are
merged, what leads to infinite values is left out, and the states of components that lose may stop
at any time for 0. In that model every policy that ends has a rational value, and the sweep of
`.optimal_stretches` follows the best one. What was found at one value holds up to the first where

    a probability becomes 0            end components are others beyond
    a policy improves by never ending  it gains for ever beyond, or no longer loses all
    the mean reward of a class is 0    that gained for ever (`_gain`)

There the range is cut, and the structure is found again beyond. The optimum of stopping is the
potential w ≥ 0, w ≥ r + P w, that shows for all values at once that components lose.

At the very values at which it is cut the total may be another one than on both sides: staying may
be worth 0 there and nowhere else. They are left to `solvers.certify`, as are models where rewards
cancel for ever, or +∞ and -∞ come together, which are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import count, pairwise
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.curves.endless_checker import (
    EndlessProof,
    Gain,
    without_end,
)
from exact_mdp.analysis.sensitivity.curves.gap_polynomials import Rows, interpolated
from exact_mdp.analysis.sensitivity.curves.optimal_stretches import (
    WIDTH,
    Bracket,
    Stretch,
    Sweep,
    moved,
)
from exact_mdp.analysis.sensitivity.curves.real_roots import roots, simple
from exact_mdp.analysis.sensitivity.curves.signs import positive_inside
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import per_step
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, Posed
from exact_mdp.mdp.parametric.polynomial_rows import PolynomialRows
from exact_mdp.mdp.parametric.row_change import Piece, row_change
from exact_mdp.mdp.parametric.symbolic import rational
from exact_mdp.mdp.table import Integers, shown
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.structure import Structure, finite, structure

if TYPE_CHECKING:
    from flint import fmpq_poly

flint = later("flint")

SHARES = (1, 5, 10, 20, 40, 80, 160)  # of the range that is left, as powers of 1/2


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """A part of the range with one structure of end components, and its stretches.

    Attributes
    ----------
    rows : PolynomialRows
        Of the model, y = θ - origin.
    origin : Fraction
    low, high : Fraction
        Its ends, as y.
    stretches : tuple of Stretch
    """

    rows: PolynomialRows
    origin: Fraction
    low: Fraction
    high: Fraction
    stretches: tuple[Stretch, ...]

    def __iter__(self) -> Iterator[Stretch]:
        return iter(self.stretches)

    def rows_of(self, pairs: Sequence[Sequence[int]]) -> Rows:
        """Return the rows of the states that a policy reaches; `pairs` are what it takes in each.

        Raises ModelError unless it ends, or comes to where it earns nothing any more.
        """
        rows = self.rows
        reached = without_end(rows, pairs, [state for state, _ in rows.mdp.start])
        if reached is None:
            raise ModelError(
                "the policy held fixed may go on for ever, and earn or lose",
                where=f"parameter {rows.change.name}, at discount 1",
                fix="hold a policy that ends, or give a discount below 1 (discount=0.95)",
            )
        return Rows(rows.mdp, rows.change, only={*reached})


def regions(family: Parametric, name: str, low: Fraction, high: Fraction) -> Iterator[Region]:
    """Yield the regions of a section of the range on which rows are polynomials, from the left.

    Raises ModelError where nothing proves what is optimal next to a value.
    """
    section = Piece(low=low, high=high)
    base = family.at({name: (low + high) / 2})
    change = row_change(family, name, section, origin=(low + high) / 2, base=base)
    cuts = gone(PolynomialRows.of(base, change), low, high)
    for begin, end in pairwise([(low, low), *cuts, (high, high)]):
        here: Bracket | None = begin
        while here is not None:
            finder = _Finder(family, name, section, here, end)
            region = finder.region()
            yield region
            here = finder.stopped


def gone(rows: PolynomialRows, low: Fraction, high: Fraction) -> list[Bracket]:
    """Return brackets of the values between two at which some probability becomes 0."""
    origin, found = rows.change.origin, list[Bracket]()
    for poly in {str(p): p for p in rows.moving}.values():
        for root in roots(simple(poly), low - origin, high - origin):
            near = root.narrowed(WIDTH / 16).simplest()
            found.append((near.low + origin, near.high + origin))
    return _joined(found)


class _Finder:
    """Finds the region that begins at a bracket, within a section and up to another bracket."""

    def __init__(
        self, family: Parametric, name: str, section: Piece, begin: Bracket, end: Bracket
    ) -> None:
        self.family, self.name, self.section = family, name, section
        self.begin, self.end = begin, end
        self.stopped: Bracket | None = None

    def region(self) -> Region:
        """Return the region whose structure holds from its lower end on."""
        refused: ModelError | None = None
        low, width = self.begin[1], self.end[0] - self.begin[1]
        for share in SHARES:
            point = _between(low + width / 2 ** (share + 1), low + width / 2**share)
            try:
                if (found := self._at(point)) is not None:
                    return found
            except ModelError as error:
                refused = refused or error
        where = f"parameter {self.name}, next to {shown(low)}"
        if refused is None:
            what = "nothing proves which policies are optimal"
            raise ModelError(what, where=where, fix="choose a range beyond it")
        raise ModelError(refused.what, where=f"{where}, {refused.where}", fix=refused.fix)

    def _at(self, point: Fraction) -> Region | None:
        """Return the region, its structure found at a point; None where it is another one before.

        Numbers that are 0 at the point have to be so throughout.
        """
        low, high = self.begin[1] - point, self.end[0] - point
        mdp = self.family.at({self.name: point})
        rows = self._rows(self.family, mdp, point)
        found = structure(per_step(mdp))
        if found.drift is not None or found.tilted:
            what = "rewards cancel for ever" if found.tilted else "+∞ and -∞ come together"
            raise ModelError(
                f"{what}, which curves and thresholds do not follow",
                where="discount 1",
                fix="give a discount below 1 (discount=0.95), or a range without such values",
            )
        if mdp.terminal.tolist() != rows.terminal or any(p and not p[0] for p in rows.moving):
            return None
        if any(rows.reward[pair] for pair in np.flatnonzero(found.inside).tolist()):
            return None
        gains = tuple(_gain(rows, pairs, (low, high)) for pairs in _classes(found))
        if not all(positive_inside(each.mean, low, Fraction(0)) for each in gains):
            return None
        lost = _first_root([each.mean for each in gains], high)
        high = high if lost is None else lost[0]
        frozen = _Frozen.of(found)
        merged = Posed(family=self.family, ask=frozen)
        base = merged.at({self.name: point})
        sweep = Sweep(
            Rows(base, self._rows(merged, base, point).change),
            lambda value: merged.at({self.name: value}),
            low + point,
            high + point,
        )
        if not sweep.settled(Fraction(0)):
            return None
        merging = _Merging(found, frozen, frozen.derived(mdp).source, gains, point)
        parts = [
            part
            for stretch in sweep.walk(Fraction(0))
            for part in merging.parts(stretch, lambda value: self.family.at({self.name: value}))
        ]
        stopped = sweep.stopped or lost
        self.stopped = None if stopped is None else (stopped[0] + point, stopped[1] + point)
        parts[0] = replace(parts[0], before=self.begin)
        parts[-1] = replace(parts[-1], after=self.stopped or self.end)
        high = parts[-1].after[0] - point
        return Region(rows=rows, origin=point, low=low, high=high, stretches=tuple(parts))

    def _rows(self, family: Parametric, base: MDP, origin: Fraction) -> PolynomialRows:
        change = row_change(family, self.name, self.section, origin=origin, base=base)
        return PolynomialRows.of(base, change)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frozen:
    """The merged model of one structure, for any value of the parameter.

    `label` (S,) is the merged state of each, -1 for the end; `pairs` (K,) are those that are left;
    the states of `stops` may end at any time.
    """

    pairs: Integers
    label: Integers
    stops: tuple[int, ...]

    @classmethod
    def of(cls, found: Structure) -> _Frozen:
        whole, _ = finite(found)
        end, parts = whole.mdp.n_states - 1, found.components
        label = np.where(whole.label == end, -1, whole.label)
        own = (whole.source >= 0) & (whole.source < found.mdp.n_pairs)
        stops = whole.mdp.pair_state[whole.source < 0].tolist()
        losing = np.isin(parts.label, found.losing) & (parts.label >= 0)
        label[losing] = end + np.arange(int(losing.sum()))
        inside = np.flatnonzero(parts.inside & losing[found.mdp.pair_state])
        return cls(
            pairs=np.concatenate([np.sort(whole.source[own]), inside]),
            label=label,
            stops=(*stops, *label[losing].tolist()),
        )

    def derived(self, mdp: MDP) -> Derived:
        rests = [(stop, Fraction(0)) for stop in self.stops]
        return derived(mdp, self.pairs, self.label, rests=rests)

    def __call__(self, mdp: MDP) -> MDP:
        return self.derived(mdp).mdp


@dataclass(frozen=True, eq=False)
class _Merging:
    """Brings stretches of the merged model back to the states and pairs of the model."""

    found: Structure
    frozen: _Frozen
    source: Integers
    gains: tuple[Gain, ...]
    origin: Fraction

    def parts(self, stretch: Stretch, at: Callable[[Fraction], MDP]) -> Iterator[Stretch]:
        """Yield the parts of a stretch between points at which one more pair is as good.

        The total may be another one there, if that pair closes a way to go round.
        """
        points = _joined([(low, high) for low, high, _ in stretch.touches])
        for before, after in pairwise([stretch.before, *points, stretch.after]):
            inner, mdp = self._inside(before[1], after[0], at)
            certificate = proven(mdp)
            touches = [
                (*after, int(self.source[pair]))
                for low, high, pair in stretch.touches
                if after[0] <= low < high <= after[1] and self._open(int(self.source[pair]))
            ]
            numerators, scale = stretch.values
            nothing = flint.fmpq_poly()
            value = [numerators[k] if k >= 0 else nothing for k in self.frozen.label.tolist()]
            start = certificate.start_value
            yield Stretch(
                before=before,
                after=after,
                optimal=certificate.optimal_pairs,
                touches=touches,
                values=(value, scale),
                worth=moved((self._start(value), scale), self.origin)
                if isfinite(start)
                else (flint.fmpq_poly([1 if start > 0 else -1]), nothing),
                proof=EndlessProof(point=inner, certificate=certificate, gains=self.gains),
            )

    def _inside(
        self, low: Fraction, high: Fraction, at: Callable[[Fraction], MDP]
    ) -> tuple[Fraction, MDP]:
        """Return a point between two, and its model, where no more states are terminal.

        A state beside a goal that earns for ever is terminal where it earns 0.
        """
        for share in count(4):
            width = (high - low) / share
            mdp = at(inner := _between(low + width, low + 2 * width))
            if (mdp.terminal == self.found.mdp.terminal).all():
                break
        return inner, mdp

    def _start(self, value: Sequence[fmpq_poly]) -> fmpq_poly:
        nothing = flint.fmpq_poly()
        return sum((rational(w) * value[s] for s, w in self.found.mdp.start), nothing)

    def _open(self, pair: int) -> bool:
        """Whether a source is a pair of a state whose value is finite."""
        mdp = self.found.mdp
        return 0 <= pair < mdp.n_pairs and self.found.sign[mdp.pair_state[pair]] == 0


def _classes(found: Structure) -> Iterator[dict[int, int]]:
    """Yield the closed classes of a policy that earns +∞, the pair of each state."""
    if len(found.core):
        taken = np.zeros(found.mdp.n_pairs, dtype=bool)
        taken[found.gaining[2]] = True
        number, inside = found.graph.end_components(taken)
        pairs = np.flatnonzero(inside)
        owner = found.mdp.pair_state[pairs]
        for each in range(int(number.max()) + 1):
            here = number[owner] == each
            yield dict(zip(owner[here].tolist(), pairs[here].tolist(), strict=True))


def _gain(rows: PolynomialRows, pairs: Mapping[int, int], span: Bracket) -> Gain:
    """Return what a closed class earns a step: g + h(s) = r + Σ p h, with h = 0 in one state.

    By Cramer's rule h = H / E and g = G / E have the degrees of the rows together at most.
    """
    states = [*pairs]
    place, size = {state: k for k, state in enumerate(states)}, len(states)
    entries = {s: (rows.reward[p], *(q for _, q in rows.following[p])) for s, p in pairs.items()}
    degree = sum(max(each.degree() for each in own) for own in entries.values())
    low, high = span
    points = [rational(low + (high - low) * (k + 1) / (degree + 2)) for k in range(degree + 1)]
    samples = []
    for y in points:
        matrix, side = [rational(0)] * size**2, [rows.reward[p](y) for p in pairs.values()]
        for k, pair in enumerate(pairs.values()):
            matrix[k * size + k] += 1
            for to, p in rows.following[pair]:
                matrix[k * size + place[to]] -= p(y)
            matrix[k * size] = rational(1)  # the place of h in the first state is that of g
        system = flint.fmpq_mat(size, size, matrix)
        scale = system.det()
        solved = system.solve(flint.fmpq_mat(size, 1, side)).entries()
        samples.append([*(scale * each for each in solved), scale])
    mean, *others, scale = (interpolated(points, c) for c in zip(*samples, strict=True))
    flip = 1 if scale(rational(0)) > 0 else -1
    heights = [flint.fmpq_poly(), *others]
    return Gain(
        pairs=pairs,
        potential={state: flip * h for state, h in zip(states, heights, strict=True)},
        scale=flip * scale,
        mean=flip * mean,
    )


def _first_root(polynomials: Sequence[fmpq_poly], high: Fraction) -> Bracket | None:
    """Return a bracket of the first root between 0 and a point, of those that are positive at 0."""
    found = []
    for poly in polynomials:
        root = next(roots(simple(poly), Fraction(0), high), None)
        if root is not None:
            near = root.narrowed(WIDTH / 16).simplest()
            found.append((near.low, near.high))
    return min(found, default=None)


def _joined(brackets: Iterable[Bracket]) -> list[Bracket]:
    """Return brackets in rising order, those that meet as one."""
    joined: list[Bracket] = []
    for low, high in sorted(brackets):
        if joined and low <= joined[-1][1]:
            low, high = joined[-1][0], max(joined.pop()[1], high)
        joined.append((low, high))
    return joined


def _between(low: Fraction, high: Fraction) -> Fraction:
    """Return a fraction of small denominator between two numbers."""
    middle, most = (low + high) / 2, 1
    while not low <= (near := middle.limit_denominator(most)) <= high:
        most *= 2
    return near
