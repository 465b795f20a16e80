"""The Bellman equations on a section of a parameter's range, as exact polynomials.

On a section between two breakpoints, rows are polynomials of the parameter θ. Values are ratios
N_s / D of polynomials, and the suboptimality gap h_l of pair l in state s is

    D h_l = N_s - D r_l - γ Σ p(l, s') N_s'.

The equations have one solution if transitions close no cycle, if γ Σ P < 1, or if γ Σ P ≤ 1 and
some transition of each pair leads to a state nearer to the end (see `solvers.exact.checker`).
Nothing here imports a solver: the checker of curves relies on this module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter

from flint import fmpq, fmpq_poly

from exact_mdp.analysis.vary.curves.roots import (
    Root,
    is_nonnegative,
    is_positive,
    isolate_roots,
    remove_double_roots,
)
from exact_mdp.mdp.exact import to_flint
from exact_mdp.mdp.graph import beside_goal, find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import (
    Piece,
    reward_entries,
    row_change,
    to_flint_ratios,
    transition_entries,
)

Values = tuple[Sequence[fmpq_poly], fmpq_poly]
"""N of each state, and D: values are N / D."""
Mix = Sequence[Sequence[tuple[int, fmpq]]]
"""For each state, the pairs that a policy takes there, with their probabilities."""


class SectionEquations:
    """The equations of a model that maximises, on a section from `low` to `high`.

    A state is `live` if it is not terminal for some θ. `following` holds the discounted
    probabilities of live next states, by pair; `order` the live states, next states first, or None
    if transitions close a cycle; `gap` D h of all pairs, 0 in states that are not live.
    """

    def __init__(self, family: Parametric, name: str, section: Piece) -> None:
        mdp = family.at({name: section.origin})
        self.family = family
        self.low, self.high, self.mdp = section.low, section.high, mdp
        self.change = change = row_change(family, name, section, mdp)
        # Changes are polynomials of θ - θ0, with θ0 the origin of the section.
        shift = fmpq_poly([to_flint(-section.origin), 1])
        self.rate: fmpq_poly = change.rate(shift) + to_flint(mdp.discount_exact)
        self.reward: list[fmpq_poly] = []
        for number in to_flint_ratios(*reward_entries(mdp)[1:]):
            self.reward.append(fmpq_poly([number]))
        for pair, moved in zip(change.reward.key.tolist(), change.reward.moved, strict=True):
            self.reward[pair] += moved(shift)
        keys, top, bottom = transition_entries(mdp)
        weight: dict[int, fmpq_poly] = {}
        for key, number in zip(keys.tolist(), to_flint_ratios(top, bottom), strict=True):
            weight[key] = fmpq_poly([number])
        for key, moved in zip(change.transition.key.tolist(), change.transition.moved, strict=True):
            weight[key] = weight.get(key, fmpq_poly()) + moved(shift)
        # A terminal state with a row that changes is terminal at θ0 alone, and counts as live.
        ended = mdp.terminal.copy()
        ended[mdp.pair_state[change.reward.key]] = False
        ended[mdp.pair_state[change.transition.key // mdp.n_states]] = False
        terminal: list[bool] = ended.tolist()
        self.state: list[int] = mdp.pair_state.tolist()
        self.live = [state for state, ends in enumerate(terminal) if not ends]
        self.pairs = {state: mdp.pairs_of(state) for state in self.live}
        self.following: dict[int, list[tuple[int, fmpq_poly]]] = {}
        for pairs in self.pairs.values():
            for pair in pairs:
                self.following[pair] = []
        for key, p in sorted(weight.items()):
            pair, state = divmod(key, mdp.n_states)
            if pair in self.following and not terminal[state]:
                self.following[pair].append((state, p * self.rate))
        # An order in which next states come first, if there is one.
        after: dict[int, set[int]] = {}
        for state, pairs in self.pairs.items():
            after[state] = set()
            for pair in pairs:
                after[state].update(to for to, _ in self.following[pair])
        self.order: list[int] | None = None
        with suppress(CycleError):
            self.order = [*TopologicalSorter(after).static_order()]
        self.values: Values = ((), fmpq_poly())
        self.gap = [fmpq_poly()] * mdp.n_pairs

    def compute_action_value(self, pair: int, values: Values) -> fmpq_poly:
        """Return D Q of a pair: D r + γ Σ p N; from its gap, if the values of next states stay."""
        (new, scale), (old, before), row = values, self.values, self.following[pair]
        if scale == before and all(new[to] == old[to] for to, _ in row):
            return old[self.state[pair]] - self.gap[pair]
        total = self.reward[pair] * scale
        for to, p in row:
            total = total + p * new[to]
        return total

    def has_different_actions(self, state: int) -> bool:
        """Return whether the actions of a state differ for some θ, in rewards or transitions."""
        pairs = self.pairs.get(state, range(0))
        kinds = {(str(self.reward[pair]), str(self.following[pair])) for pair in pairs}
        return len(kinds) > 1

    def update_gaps(self, values: Values, taken: Collection[int] = ()) -> set[int]:
        """Compute the gaps for new values; return the pairs whose gap has changed.

        Gaps of pairs `taken` are 0, as the values belong to the policy that takes them.
        """
        gaps = {}
        for pair in self.following:
            if pair not in taken:
                own = values[0][self.state[pair]]
                gaps[pair] = own - self.compute_action_value(pair, values)
        gaps |= dict.fromkeys(taken, fmpq_poly())
        changed = {pair for pair, gap in gaps.items() if gap != self.gap[pair]}
        for pair in changed:
            self.gap[pair] = gaps[pair]
        self.values = values
        return changed

    # ---- one solution ----------------------------------------------------------------------------

    def find_faults(self) -> Iterator[str]:
        """Yield the reasons why rows may not be probabilities, or solutions not unique."""
        low, high = self.low, self.high
        chances = []
        for row in self.following.values():
            chances += [p for _, p in row]
        nonnegative = [*_remove_duplicates(chances), *self._list_exit_probabilities()]
        if not all(is_nonnegative(p, low, high) for p in nonnegative):
            yield "a probability is negative, or probabilities pass 1"
        elif not self.one_solution():
            yield "nothing proves that the Bellman equations have one solution"
        if self.find_missed_goal() is not None:
            yield "a run may end outside the goal, which is worth infinity"

    def find_missed_goal(self) -> MDP | None:
        """Return a model of the section in which a run may miss the goal; None if there is none.

        The goal of a total counts at discount 1 alone, so an end of the section with discount
        1 is looked at, too. States that are reachable there are reachable inside.
        """
        if self.mdp.target is None:
            return None
        models = [self.mdp]
        for end in (self.low, self.high):
            if self.mdp.discount_exact != 1 and self.rate(to_flint(end)) == 1:
                models.append(self.family.at({self.change.name: end}))
        met = find_reachable_states(self.mdp)
        for mdp in models:
            if (beside_goal(mdp) & met).any():
                return mdp
        return None

    def one_solution(self) -> bool:
        """Whether the equations have one solution on the whole section, ends included."""
        # No cycle, or a sum of discounted probabilities below 1.
        low, high = self.low, self.high
        if self.order is not None or all(
            is_positive(each, low, high) for each in self._list_exit_probabilities()
        ):
            return True
        # Every pair comes nearer to the end, except at roots of the chances of doing so.
        falls = self._compute_progress_chances(None)
        if falls is None:
            return False
        # Look at these roots, and at both ends, one by one.
        nowhere = fmpq_poly()
        places = [Root(poly=nowhere, low=end, high=end) for end in (low, high)]
        for fall in falls:
            places += isolate_roots(remove_double_roots(fall), low, high)
        return all(self._compute_progress_chances(place) is not None for place in places)

    def _compute_exit_probability(self, pair: int) -> fmpq_poly:
        """Return 1 - γ Σ P of a pair, over live states."""
        return fmpq_poly([1]) - sum(p for _, p in self.following[pair])

    def _list_exit_probabilities(self) -> list[fmpq_poly]:
        return _remove_duplicates(map(self._compute_exit_probability, self.following))

    def _compute_progress_chances(self, at: Root | None) -> list[fmpq_poly] | None:
        """Return the chances that pairs come nearer to the end; None if some policy stays.

        They must be positive `at` one point of the section or, without it, at all but some points.
        """

        def is_zero(chance: fmpq_poly) -> bool:
            if at is None:
                return bool(chance.degree() < 0)
            return at.is_of(chance)

        chances: list[fmpq_poly] = []
        near, left = set[int](), self.live
        while left:
            # The next layer: states whose pairs all lead to an earlier layer, or out.
            layer = list[int]()
            for state in left:
                falls = []
                for pair in self.pairs[state]:
                    nearer = (p for to, p in self.following[pair] if to in near)
                    falls.append(sum(nearer, self._compute_exit_probability(pair)))
                if not any(map(is_zero, falls)):
                    layer.append(state)
                    chances += falls
            if not layer:
                return None
            near.update(layer)
            left = [state for state in left if state not in near]
        return _remove_duplicates(chances)


def sum_weighted(
    weights: Iterable[tuple[int, Fraction]], polynomials: Sequence[fmpq_poly]
) -> fmpq_poly:
    """Return the weighted sum of some polynomials."""
    return sum((to_flint(weight) * polynomials[k] for k, weight in weights), fmpq_poly())


def _remove_duplicates(polynomials: Iterable[fmpq_poly]) -> list[fmpq_poly]:
    """Return each polynomial once."""
    return [*{str(p): p for p in polynomials}.values()]
