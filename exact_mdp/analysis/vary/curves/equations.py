"""The Bellman equations on a section of a parameter's range, as exact polynomials.

On a section between two breakpoints, rows are polynomials of the parameter θ. Values are ratios
N_s / D of polynomials, and the suboptimality gap h_l of pair l in state s is

    D h_l = N_s - D r_l - γ Σ p(l, s') N_s'.

The equations have one solution if transitions close no cycle, if γ Σ P < 1, or if no policy can
stay forever. If staying forever costs something at every step, the optimum is the solution that
belongs to a policy that ends (Bertsekas and Tsitsiklis, Mathematics of Operations Research 16,
1991).
Nothing here imports a solver: the checker of curves relies on this module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

import numpy as np
from flint import fmpq, fmpq_poly

from exact_mdp.analysis.vary.curves.roots import (
    Root,
    is_nonnegative,
    is_positive,
    isolate_roots,
    remove_double_roots,
    roots_on,
)
from exact_mdp.mdp.exact import to_flint
from exact_mdp.mdp.graph import PairGraph, find_reachable_states
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.row_change import (
    Piece,
    reward_entries,
    row_change,
    to_flint_ratios,
    transition_entries,
)
from exact_mdp.mdp.questions.ending import ends_at_label

Values = tuple[Sequence[fmpq_poly], fmpq_poly]
"""N of each state, and D: values are N / D."""
Steps = dict[int, list[tuple[int, fmpq_poly]]]
"""For each pair, next states with their probabilities."""
PolicyPairs = Sequence[Sequence[tuple[int, fmpq]]]
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
        self.rate: fmpq_poly = self._compute_rate(shift)
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
        terminal = self._find_ends()
        self.state: list[int] = mdp.pair_state.tolist()
        self.live = [state for state, ends in enumerate(terminal) if not ends]
        self.pairs: dict[int, Sequence[int]] = {state: mdp.pairs_of(state) for state in self.live}
        self.following: Steps = {}
        for pairs in self.pairs.values():
            for pair in pairs:
                self.following[pair] = []
        missing: Steps = {pair: [] for pair in self.following}  # steps to ends that are no goal
        outside: list[bool] = mdp.ends.outside_goal.tolist()
        for key, p in sorted(weight.items()):
            pair, state = divmod(key, mdp.n_states)
            if pair in self.following and not terminal[state]:
                self.following[pair].append((state, p * self.rate))
            elif pair in self.following and outside[state]:
                missing[pair].append((state, p))
        self.values: Values = ((), fmpq_poly())
        self.gap = [fmpq_poly()] * mdp.n_pairs
        # The last state of a graph is the end.
        self.end = np.arange(mdp.n_states + 1) == mdp.n_states
        self.barred = list[int]()  # pairs of live states by which a run may miss the goal
        self.may_miss_goal = self._leave_out_misses(missing)
        # An order in which next states come first, if there is one.
        after: dict[int, set[int]] = {}
        for state, pairs in self.pairs.items():
            after[state] = set()
            for pair in pairs:
                after[state].update(to for to, _ in self.following[pair])
        self.order: list[int] | None = None
        with suppress(CycleError):
            self.order = [*TopologicalSorter(after).static_order()]

    def _compute_rate(self, shift: fmpq_poly) -> fmpq_poly:
        """Return the discount as a polynomial."""
        rate: fmpq_poly = self.change.rate(shift) + to_flint(self.mdp.discount_exact)
        return rate

    def _find_ends(self) -> list[bool]:
        """Return for each state whether it is terminal for all θ.

        One with a row that changes is terminal at θ0 alone, and counts as live.
        """
        ends: list[bool] = (self.mdp.terminal & ~self.change.find_states(self.mdp)).tolist()
        return ends

    def weigh_start(self, sign: int) -> tuple[tuple[int, Fraction], ...]:
        """Return the weights of the start states among the values, times a sign."""
        return tuple((state, sign * weight) for state, weight in self.mdp.start)

    def choose_improvements(self, pairs: Collection[int]) -> Collection[int]:
        """Return, among pairs with negative gaps, the pairs that a policy takes next."""
        return pairs

    def _leave_out_misses(self, missing: Steps) -> bool:
        """Leave out the pairs by which a run may miss the goal; return whether one may do so still.

        A run that misses the goal is worth -∞ at discount 1: no optimal policy takes such a pair,
        nor a pair that leads to states from which no policy is sure of the goal. If missing is
        worth +∞, or if the discount moves, no run of the section may miss the goal.
        """
        if not any(missing.values()) or self.mdp.ends.missing_pays or self.rate != fmpq_poly([1]):
            return self._finds_missed_goal()
        # At a point where some transition vanishes more pairs may be safe, and the optimum jumps.
        found: list[tuple[list[bool], list[bool]]] = []
        for place in self._list_places(missing):
            graph = self._build_graph(place, missing)
            sure, safe = graph.find_sure_pairs(self.end)
            each = sure.tolist(), safe.tolist()
            if each not in found:
                found.append(each)
        if len(found) > 1:
            return True
        sure_states, safe_pairs = each
        for pair, is_safe in zip(missing, safe_pairs, strict=True):
            if not is_safe:
                del self.following[pair]
            if not is_safe and sure_states[self.state[pair]]:
                self.barred.append(pair)
                self.gap[pair] = fmpq_poly([1])  # never optimal
        self.live = [state for state in self.live if sure_states[state]]
        kept = self.following.keys()
        self.pairs = {s: [pair for pair in self.pairs[s] if pair in kept] for s in self.live}
        return not all(sure_states[state] for state, weight in self.mdp.start if weight)

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
        pairs = self.pairs.get(state, ())
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

    @property
    def shows_all_steps(self) -> bool:
        """Whether no probability that moves is 0 at the origin: its model has all transitions."""
        there = transition_entries(self.mdp)[0]
        return bool(np.isin(self.change.transition.key, there).all())

    # ---- one solution ----------------------------------------------------------------------------

    def find_faults(self) -> Iterator[str]:
        """Yield the reasons why rows may not be probabilities, or solutions not unique."""
        low, high = self.low, self.high
        if not self.shows_all_steps:
            yield "a probability that moves is 0 at the origin of the section"
        chances = []
        for row in self.following.values():
            chances += [p for _, p in row]
        nonnegative = [*_remove_duplicates(chances), *self._list_exit_probabilities()]
        if not all(is_nonnegative(p, low, high) for p in nonnegative):
            yield "a probability is negative, or probabilities pass 1"
        elif self.improper and not self.staying_costs():
            yield "nothing proves that the Bellman equations have one solution"
        if self.may_miss_goal:
            yield "a run may end outside the goal, which is worth infinity"

    def _finds_missed_goal(self) -> bool:
        """Return whether a run may miss the goal in some model of the section.

        The goal of a total counts at discount 1 alone, so an end of the section with discount
        1 is looked at, too. States that are reachable there are reachable inside.
        """
        if not ends_at_label(self.mdp):
            return False
        models = [self.mdp]
        # A discount may also touch 1 inside.
        if roots_on(self.rate - 1, self.low, self.high):
            models.append(self.mdp.with_(discount=1))
        for end in (self.low, self.high):
            if self.mdp.discount_exact != 1 and self.rate(to_flint(end)) == 1:
                models.append(self.family.at({self.change.name: end}))
        met = find_reachable_states(self.mdp)
        return any((mdp.ends.outside_goal & met).any() for mdp in models)

    def find_value_faults(self, values: Values) -> Iterator[str]:
        """Yield a reason if a state that is terminal throughout has a value other than 0."""
        live = set(self.live)
        if any(value.degree() >= 0 for s, value in enumerate(values[0]) if s not in live):
            yield "a terminal state is worth something"

    def find_policy_faults(self, policy: PolicyPairs, values: Values) -> Iterator[int]:
        """Yield the live states in which a policy has other values."""
        for state in self.live:
            ahead = (
                share * self.compute_action_value(pair, values) for pair, share in policy[state]
            )
            if values[0][state] != sum(ahead, fmpq_poly()):
                yield state

    def find_point_faults(self, values: Values, low: Fraction, high: Fraction) -> Iterator[str]:
        """Yield the points between two others at which gaps do not prove the optimum: none."""
        yield from ()

    def one_solution(self) -> bool:
        """Whether the equations have one solution on the whole section, ends included."""
        # No cycle, or a sum of discounted probabilities below 1.
        low, high = self.low, self.high
        if self.order is not None or all(
            is_positive(each, low, high) for each in self._list_exit_probabilities()
        ):
            return True
        return not self.staying_pairs

    @cached_property
    def improper(self) -> bool:
        """Whether some policy may never end: the equations may have several solutions."""
        return not self.one_solution()

    def staying_costs(self) -> bool:
        """Whether a policy that never ends loses at every step, and so is worth -∞.

        The optimum is then the solution that belongs to a policy that ends. If missing the goal
        pays +∞, so does staying forever.
        """
        if self.mdp.ends.missing_pays or self.rate != fmpq_poly([1]):
            return False
        return all(
            is_positive(-self.reward[pair], self.low, self.high) for pair in self.staying_pairs
        )

    @cached_property
    def staying_pairs(self) -> list[int]:
        """The pairs by which a policy may stay forever at some point of the section."""
        staying = np.zeros(len(self.following), dtype=bool)
        for _, graph in self._graphs:
            staying |= graph.end_components(~np.zeros(len(staying), dtype=bool))[1]
        pairs: list[int] = np.array([*self.following])[staying].tolist()
        return pairs

    def can_end(self, pairs: Collection[int], low: Fraction, high: Fraction) -> bool:
        """Whether some policy of the given pairs ends from every state, between two points."""
        taken = np.isin([*self.following], [*pairs])
        for place, graph in self._graphs:
            if place is not None and not place.lies_between(low, high):
                continue
            distance = graph.compute_distance(self.end, taken)
            if (distance[self.live] < 0).any():
                return False
        return True

    @cached_property
    def _graphs(self) -> list[tuple[Root | None, PairGraph]]:
        """The graph of the pairs at each of the places."""
        return [(place, self._build_graph(place, {})) for place in self._list_places({})]

    def _list_places(self, missing: Steps) -> list[Root | None]:
        """Return the points at which some transition vanishes; None stands for all others."""
        places: list[Root | None] = [None]
        for end in (self.low, self.high):
            places.append(Root(poly=fmpq_poly(), low=end, high=end))
        chances = self._list_exit_probabilities()
        for row in (*self.following.values(), *missing.values()):
            chances += [p for _, p in row]
        for chance in _remove_duplicates(chances):
            places += isolate_roots(remove_double_roots(chance), self.low, self.high)
        return places

    def _build_graph(self, place: Root | None, missing: Steps) -> PairGraph:
        """Return the graph of the pairs of live states; the last state is the end.

        With `missing` steps to other ends, it is the goal alone.
        """

        def is_zero(chance: fmpq_poly) -> bool:
            if place is None or chance.degree() < 1:
                return bool(chance.degree() < 0)
            return place.is_of(chance)

        offsets, following, end = [0], list[int](), self.mdp.n_states
        for pair, row in self.following.items():
            others = missing.get(pair, [])
            following += [to for to, p in (*row, *others) if not is_zero(p)]
            if not is_zero(self._compute_exit_probability(pair) - sum(p for _, p in others)):
                following.append(end)
            offsets.append(len(following))
        owner = np.array([self.state[pair] for pair in self.following], dtype=np.int64)
        return PairGraph(end + 1, owner, np.array(offsets), np.array(following))

    def _compute_exit_probability(self, pair: int) -> fmpq_poly:
        """Return 1 - γ Σ P of a pair, over live states."""
        return fmpq_poly([1]) - sum(p for _, p in self.following[pair])

    def _list_exit_probabilities(self) -> list[fmpq_poly]:
        return _remove_duplicates(map(self._compute_exit_probability, self.following))


def list_pairs(policy: PolicyPairs) -> list[int]:
    """Return the pairs that a policy takes."""
    pairs = []
    for each in policy:
        pairs += [pair for pair, weight in each if weight]
    return pairs


def sum_weighted(
    weights: Iterable[tuple[int, Fraction]], polynomials: Sequence[fmpq_poly]
) -> fmpq_poly:
    """Return the weighted sum of some polynomials."""
    return sum((to_flint(weight) * polynomials[k] for k, weight in weights), fmpq_poly())


def _remove_duplicates(polynomials: Iterable[fmpq_poly]) -> list[fmpq_poly]:
    """Return each polynomial once."""
    return [*{str(p): p for p in polynomials}.values()]
