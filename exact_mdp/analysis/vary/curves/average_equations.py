"""The equations of gain and bias on a section of a parameter's range, as exact polynomials.

Gains g_s = G_s / D and relative values h_s = N_s / D are ratios of polynomials of the parameter θ.
The gap of pair l in state s is its loss of the gain, or else of the relative value,

    G_s - Σ p(l, s') G_s',    or if this is 0 for all θ,    G_s + N_s - D r_l - Σ p(l, s') N_s'.

Where D > 0, no gap is negative, and one pair of each state has the gap 0, those pairs have the best
average g (Puterman, Markov Decision Processes, 1994, theorem 9.1.2), whatever relative values are
chosen. If a gap of the first kind is 0 at a single θ, its pair may be better there by the second
kind; but where no transition vanishes, the average of every policy is continuous in θ, and the best
is g there, too. At the points where one vanishes, this second kind is looked at.
Nothing here imports a solver: the checker of curves relies on this module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from fractions import Fraction

import numpy as np
import scipy.sparse as sp
from flint import fmpq_poly

from exact_mdp.analysis.vary.curves.equations import (
    PolicyPairs,
    SectionEquations,
    Values,
    sum_weighted,
)
from exact_mdp.analysis.vary.curves.roots import Root, compute_sign
from exact_mdp.mdp.graph import find_reachable_nodes, strong_components
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import Piece
from exact_mdp.mdp.table import Integers, format_rational


class AverageEquations(SectionEquations):
    """The equations of a model that maximises its average, on a section from `low` to `high`.

    Every state is live. Values are N of each state, then G of each state, then G at the start.
    """

    def __init__(self, family: Parametric, name: str, section: Piece) -> None:
        super().__init__(family, name, section)
        self.order = None
        self.of_gain = set[int]()  # the pairs whose gap is a loss of gain

    def _find_ends(self) -> list[bool]:
        return [False] * self.mdp.n_states

    def _compute_rate(self, shift: fmpq_poly) -> fmpq_poly:
        return fmpq_poly([1])

    def weigh_start(self, sign: int) -> tuple[tuple[int, Fraction], ...]:
        """Return the weight of the gain at the start among the values."""
        return ((2 * self.mdp.n_states, Fraction(sign)),)

    def complete_values(self, bias: list[fmpq_poly], gain: list[fmpq_poly]) -> list[fmpq_poly]:
        """Return the values from N and G of all states."""
        return [*bias, *gain, sum_weighted(self.mdp.start, gain)]

    def _compute_gain_gap(self, pair: int, values: Values) -> fmpq_poly:
        """Return G_s - Σ p G of a pair."""
        size, numbers = self.mdp.n_states, values[0]
        gap = numbers[size + self.state[pair]]
        for to, p in self.following[pair]:
            gap = gap - p * numbers[size + to]
        return gap

    def _compute_bias_gap(self, pair: int, values: Values) -> fmpq_poly:
        """Return G_s + N_s - D r - Σ p N of a pair."""
        numbers, state = values[0], self.state[pair]
        gap = numbers[self.mdp.n_states + state] + numbers[state] - values[1] * self.reward[pair]
        for to, p in self.following[pair]:
            gap = gap - p * numbers[to]
        return gap

    def update_gaps(self, values: Values, taken: Collection[int] = ()) -> set[int]:
        """See `SectionEquations.update_gaps`."""
        changed, self.of_gain = set[int](), set()
        for pair in self.following:
            gap = fmpq_poly()
            if pair not in taken:
                gap = self._compute_gain_gap(pair, values)
                if gap.degree() >= 0:
                    self.of_gain.add(pair)
                else:
                    gap = self._compute_bias_gap(pair, values)
            if gap != self.gap[pair]:
                self.gap[pair] = gap
                changed.add(pair)
        self.values = values
        return changed

    def choose_improvements(self, pairs: Collection[int]) -> Collection[int]:
        """Return the gaining pairs among some with negative gaps, if there are any."""
        return [pair for pair in pairs if pair in self.of_gain] or pairs

    def label_classes(self, policy: PolicyPairs) -> tuple[Integers, Integers]:
        """Return (S,) the recurrent class of each state, or -1, and the one it ends in, or -1.

        A transient state from which several classes can be reached ends in none of them for sure.
        """
        graph = self._build_policy_graph(policy)
        part = strong_components(graph)
        source = np.repeat(np.arange(len(part)), np.diff(graph.indptr))
        closed = np.ones(int(part.max()) + 1, dtype=bool)
        closed[part[source[part[source] != part[graph.indices]]]] = False
        label = np.where(closed, np.cumsum(closed) - 1, -1)[part]
        back, count = graph.T.tocsr(), np.zeros(len(part), dtype=np.int64)
        ends = np.full(len(part), -1)
        for number in range(int(closed.sum())):
            before = find_reachable_nodes(back, label == number)
            count += before
            ends[before] = number
        return label, np.where(count == 1, ends, -1)

    def _build_policy_graph(self, policy: PolicyPairs) -> sp.csr_array:
        edges = set[tuple[int, int]]()
        for state, pairs in enumerate(policy):
            for pair, weight in pairs:
                if weight:
                    edges.update((state, to) for to, p in self.following[pair] if p.degree() >= 0)
        sources, ends = np.array(sorted(edges)).T
        shape = (self.mdp.n_states,) * 2
        return sp.csr_array((np.ones(len(sources)), (sources, ends)), shape)

    # ---- what the checker asks -------------------------------------------------------------------

    @property
    def improper(self) -> bool:
        """False: any solution proves the average, also if there are several."""
        return False

    def find_value_faults(self, values: Values) -> Iterator[str]:
        """Yield a reason if the gain at the start does not follow from the start states."""
        size = self.mdp.n_states
        if [*values[0]] != self.complete_values([*values[0][:size]], [*values[0][size : 2 * size]]):
            yield "the gain at the start is another one"

    def find_policy_faults(self, policy: PolicyPairs, values: Values) -> Iterator[int]:
        """Yield the states in which the values are not the gain and bias of a policy."""
        for state in self.live:
            lost, late = fmpq_poly(), fmpq_poly()
            for pair, share in policy[state]:
                lost = lost + share * self._compute_gain_gap(pair, values)
                late = late + share * self._compute_bias_gap(pair, values)
            if lost.degree() >= 0 or late.degree() >= 0:
                yield state

    def find_point_faults(self, values: Values, low: Fraction, high: Fraction) -> Iterator[str]:
        """Yield the points between two others at which a pair may gain beyond its gaps.

        At such a point a transition vanishes, and averages may jump.
        """
        for place in self._vanishing:
            if not place.lies_between(low, high):
                continue
            for pair in self.following:
                if self._may_gain_at(pair, values, place):
                    yield self.format_place(place)
                    break

    def _may_gain_at(self, pair: int, values: Values, place: Root) -> bool:
        gap = self._compute_gain_gap(pair, values)
        if gap.degree() < 0:
            return False
        if place.low < place.high:
            return place.is_of(gap)
        sign = compute_sign(gap, place.low)
        return sign < 0 or (
            sign == 0 and compute_sign(self._compute_bias_gap(pair, values), place.low) < 0
        )

    def format_place(self, place: Root) -> str:
        """Return a point in words."""
        place = place.narrow_to_width(Fraction(1, 10**12))
        if place.low == place.high:
            return f"{self.change.name} = {format_rational(place.low)}"
        return f"{self.change.name} ≈ {float((place.low + place.high) / 2):.6g}"

    @property
    def _vanishing(self) -> list[Root]:
        """The points at which some transition vanishes."""
        chances = [p for row in self.following.values() for _, p in row]
        found = []
        for place in self._list_places({}):
            if place is not None and any(p.degree() > 0 and place.is_of(p) for p in chances):
                found.append(place)
        return found
