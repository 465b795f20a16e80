"""The Bellman equations on a section of a parameter's range, as exact polynomials of it.

On a section between two breakpoints, rows are polynomials of the parameter θ. Values are ratios
N_s / D of polynomials. Pair l of state s falls short of them by h_l, its gap:

    D h_l = N_s - D r_l - γ Σ p(l, s') N_s'.

The equations have one solution where transitions close no cycle, where γ Σ P < 1, or where
γ Σ P ≤ 1 and some transition of each pair leads to a state that is nearer to the end (see
`solvers.exact.checker`). Nothing here imports a solver: the checker of curves rests on it.
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
"""Of each state, the pairs that a policy takes there, with their probabilities."""


class SectionEquations:
    """The equations of a model that maximises, on a section from `low` to `high`.

    `live` states are those in which something happens for some θ. `following` holds the discounted
    probabilities of live states, by pair; `order` the live states from the end on, None where
    transitions close a cycle; `gap` D h of all pairs, 0 in states that are not live.
    """

    def __init__(self, family: Parametric, name: str, section: Piece) -> None:
        mdp = family.at({name: section.origin})
        self.family = family
        self.low, self.high, self.mdp = section.low, section.high, mdp
        self.change = change = row_change(family, name, section, mdp)
        shift = fmpq_poly([to_flint(-section.origin), 1])
        self.rate: fmpq_poly = change.rate(shift) + to_flint(mdp.discount_exact)
        self.reward: list[fmpq_poly] = [
            fmpq_poly([r]) for r in to_flint_ratios(*reward_entries(mdp)[1:])
        ]
        for pair, moved in zip(change.reward.key.tolist(), change.reward.moved, strict=True):
            self.reward[pair] += moved(shift)
        keys, top, bottom = transition_entries(mdp)
        weight: dict[int, fmpq_poly] = {
            key: fmpq_poly([p])
            for key, p in zip(keys.tolist(), to_flint_ratios(top, bottom), strict=True)
        }
        for key, moved in zip(change.transition.key.tolist(), change.transition.moved, strict=True):
            weight[key] = weight.get(key, fmpq_poly()) + moved(shift)
        # A state that is left, or earns, next to θ0 is terminal at that very value alone.
        over = mdp.terminal.copy()
        over[mdp.pair_state[change.reward.key]] = False
        over[mdp.pair_state[change.transition.key // mdp.n_states]] = False
        terminal: list[bool] = over.tolist()
        self.state: list[int] = mdp.pair_state.tolist()
        self.live = [state for state, ends in enumerate(terminal) if not ends]
        self.pairs = {state: mdp.pairs_of(state) for state in self.live}
        self.following: dict[int, list[tuple[int, fmpq_poly]]] = {
            pair: [] for pairs in self.pairs.values() for pair in pairs
        }
        for key, p in sorted(weight.items()):
            pair, state = divmod(key, mdp.n_states)
            if pair in self.following and not terminal[state]:
                self.following[pair].append((state, p * self.rate))
        after = {
            state: {to for pair in pairs for to, _ in self.following[pair]}
            for state, pairs in self.pairs.items()
        }
        self.order: list[int] | None = None
        with suppress(CycleError):
            self.order = [*TopologicalSorter(after).static_order()]
        self.values: Values = ((), fmpq_poly())
        self.gap = [fmpq_poly()] * mdp.n_pairs

    def compute_action_value(self, pair: int, values: Values) -> fmpq_poly:
        """Return D Q of a pair: D r + γ Σ p N; from its gap, where nothing that follows is new."""
        (new, scale), (old, before), row = values, self.values, self.following[pair]
        if scale == before and all(new[to] == old[to] for to, _ in row):
            return old[self.state[pair]] - self.gap[pair]
        total = self.reward[pair] * scale
        for to, p in row:
            total = total + p * new[to]
        return total

    def has_different_actions(self, state: int) -> bool:
        """Return whether the actions of a state differ for some θ, in what they earn or lead to."""
        pairs = self.pairs.get(state, range(0))
        kinds = {(str(self.reward[pair]), str(self.following[pair])) for pair in pairs}
        return len(kinds) > 1

    def update_gaps(self, values: Values, taken: Collection[int] = ()) -> set[int]:
        """Work out the gaps of other values; return the pairs whose gap is another.

        Gaps of pairs `taken` are 0: the values are those of the policy that takes them.
        """
        gaps = {
            pair: values[0][self.state[pair]] - self.compute_action_value(pair, values)
            for pair in self.following
            if pair not in taken
        }
        gaps |= dict.fromkeys(taken, fmpq_poly())
        changed = {pair for pair, gap in gaps.items() if gap != self.gap[pair]}
        for pair in changed:
            self.gap[pair] = gaps[pair]
        self.values = values
        return changed

    # ---- one solution ----------------------------------------------------------------------------

    def find_faults(self) -> Iterator[str]:
        """Yield why rows may be no probabilities, or the equations have several solutions."""
        low, high = self.low, self.high
        chances = [p for row in self.following.values() for _, p in row]
        if not all(
            is_nonnegative(p, low, high)
            for p in [*_remove_duplicates(chances), *self._list_exit_probabilities()]
        ):
            yield "a probability is negative, or probabilities pass 1"
        elif not self.one_solution():
            yield "nothing proves that the Bellman equations have one solution"
        if self.find_missed_goal() is not None:
            yield "a run may end beside the goal, which is worth infinity"

    def find_missed_goal(self) -> MDP | None:
        """Return a model of the section in which a run may end beside the goal; None without one.

        The goal of a total counts at discount 1 alone: where only the discount of an end is 1, the
        models inside have none. What can be reached there can be reached inside.
        """
        if self.mdp.target is None:
            return None
        models = [self.mdp]
        for end in (self.low, self.high):
            if self.mdp.discount_exact != 1 and self.rate(to_flint(end)) == 1:
                models.append(self.family.at({self.change.name: end}))
        met = find_reachable_states(self.mdp)
        return next((mdp for mdp in models if (beside_goal(mdp) & met).any()), None)

    def one_solution(self) -> bool:
        """Whether the equations have one solution on the whole section, ends included."""
        low, high = self.low, self.high
        if self.order is not None or all(
            is_positive(each, low, high) for each in self._list_exit_probabilities()
        ):
            return True
        falls = self._compute_progress_chances(None)
        if falls is None:
            return False
        nowhere = fmpq_poly()
        places = [Root(poly=nowhere, low=end, high=end) for end in (low, high)]
        places += (
            root for fall in falls for root in isolate_roots(remove_double_roots(fall), low, high)
        )
        return all(self._compute_progress_chances(place) is not None for place in places)

    def _compute_exit_probability(self, pair: int) -> fmpq_poly:
        """Return 1 - γ Σ P of a pair, over live states."""
        return fmpq_poly([1]) - sum(p for _, p in self.following[pair])

    def _list_exit_probabilities(self) -> list[fmpq_poly]:
        return _remove_duplicates(map(self._compute_exit_probability, self.following))

    def _compute_progress_chances(self, at: Root | None) -> list[fmpq_poly] | None:
        """Return the chances of coming nearer to the end, from the end on; None where it stays.

        Nearer at one point of the section, or, without one, at all but some.
        """
        chances: list[fmpq_poly] = []
        near, left = set[int](), self.live
        while left:
            layer = list[int]()
            for state in left:
                falls = [
                    sum(
                        (p for to, p in self.following[pair] if to in near),
                        self._compute_exit_probability(pair),
                    )
                    for pair in self.pairs[state]
                ]
                if all(p.degree() >= 0 if at is None else not at.is_of(p) for p in falls):
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
    """Return a sum of some of the polynomials, each with a weight."""
    return sum((to_flint(weight) * polynomials[k] for k, weight in weights), fmpq_poly())


def _remove_duplicates(polynomials: Iterable[fmpq_poly]) -> list[fmpq_poly]:
    """Return every polynomial once."""
    return [*{str(p): p for p in polynomials}.values()]
