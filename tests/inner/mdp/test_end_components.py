"""Attractors, distances and end components, against networkx and against all sets of states."""

from itertools import chain, combinations, product

import networkx as nx
import numpy as np
import pytest

from exact_mdp import MDP
from exact_mdp.mdp.end_components import PairGraph


def drawn(seed: int) -> tuple[MDP, list[tuple[int, set[int]]]]:
    """A model of 5 states with 1 or 2 pairs each, of 1 or 2 next states; and these by pair."""
    rng = np.random.default_rng(seed)
    pairs = [(s, {*rng.integers(0, 5, rng.integers(1, 3)).tolist()})
             for s in range(5) for _ in range(rng.integers(1, 3))]  # fmt: skip
    number = [sum(t == s for t, _ in pairs[:i]) for i, (s, _) in enumerate(pairs)]
    rows = [(s, a, [(f"1/{len(after)}", t, 1) for t in sorted(after)])
            for a, (s, after) in zip(number, pairs, strict=True)]  # fmt: skip
    return MDP.from_outcomes(rows, 1), pairs


def subsets(size: int) -> list[set[int]]:
    return [*map(set, chain(*(combinations(range(size), k) for k in range(1, size + 1))))]


@pytest.mark.parametrize("seed", range(30))
def test_pairs_that_lead_into_a_set(seed: int) -> None:
    mdp, pairs = drawn(seed)
    graph, inside = PairGraph.of(mdp), {0, 3}
    mask = np.isin(np.arange(5), [0, 3])
    assert graph.find_pairs_within(mask).tolist() == [after <= inside for _, after in pairs]
    assert graph.find_pairs_into(mask).tolist() == [bool(after & inside) for _, after in pairs]
    some = np.arange(len(pairs)) % 2 == 0
    assert graph.find_states_with(some).tolist() == [
        any(s == t for k, (t, _) in enumerate(pairs) if some[k]) for s in range(5)
    ]


@pytest.mark.parametrize("seed", range(30))
def test_a_distance_is_that_of_networkx(seed: int) -> None:
    mdp, pairs = drawn(seed)
    allowed = np.arange(len(pairs)) != 1
    edges = nx.DiGraph([(t, s) for k, (s, after) in enumerate(pairs) if allowed[k] for t in after])
    edges.add_nodes_from(range(5))
    far = nx.single_source_shortest_path_length(edges, 4)
    graph = PairGraph.of(mdp)
    found = graph.compute_distance(np.arange(5) == 4, allowed)
    assert found.tolist() == [far.get(s, -1) for s in range(5)]
    least = [min((found[t] for t in after if found[t] >= 0), default=5) for _, after in pairs]
    own = [found[s] if found[s] >= 0 else 5 for s, _ in pairs]
    assert graph.find_falling_pairs(found).tolist() == [
        a < b for a, b in zip(least, own, strict=True)
    ]


@pytest.mark.parametrize("seed", range(30))
def test_who_reaches_a_target_for_sure_and_who_cannot_help_it(seed: int) -> None:
    """For sure: in the largest set whose states have ways to it by pairs that stay inside."""
    mdp, pairs = drawn(seed)
    graph, every = PairGraph.of(mdp), np.ones(len(pairs), dtype=bool)
    sure: set[int] = set()
    for inside in subsets(5):
        own = [(s, after) for s, after in pairs if s in inside and after <= inside]
        back = nx.DiGraph([(t, s) for s, after in own for t in after])
        back.add_node(4)
        if 4 in inside and inside <= {4, *nx.descendants(back, 4)}:
            sure |= inside
    rounds = graph.compute_rounds(np.arange(5) == 4, every)
    assert (rounds == 0).tolist() == [s in sure for s in range(5)]
    ranks = graph.compute_ranks(np.arange(5) == 4, every)
    drawn_in = {4}  # whatever is done, a way leads there
    for _ in range(5):
        drawn_in |= {s for s in range(5) if all(after & drawn_in for t, after in pairs if t == s)}
    assert (ranks >= 0).tolist() == [s in drawn_in for s in range(5)]
    for s, after in pairs:
        assert ranks[s] <= 0 or min(ranks[t] for t in after if ranks[t] >= 0) < ranks[s]


@pytest.mark.parametrize("seed", range(30))
def test_end_components_are_the_largest_sets_that_can_be_stayed_in(seed: int) -> None:
    mdp, pairs = drawn(seed)
    number, inside = PairGraph.of(mdp).end_components(np.ones(len(pairs), dtype=bool))

    def stays(states: set[int]) -> bool:
        own = [(s, after) for s, after in pairs if s in states and after <= states]
        edges = nx.DiGraph([(s, t) for s, after in own for t in after])
        return {s for s, _ in own} == states and nx.is_strongly_connected(edges)

    all_of_them = [states for states in subsets(5) if stays(states)]
    largest = [one for one in all_of_them if not any(one < other for other in all_of_them)]
    found = [{*np.flatnonzero(number == k).tolist()} for k in range(number.max() + 1)]
    assert sorted(map(sorted, found)) == sorted(map(sorted, largest))
    assert inside.tolist() == [
        any(s in one and after <= one for one in largest) for s, after in pairs
    ]


@pytest.mark.parametrize("seed", range(40))
def test_a_base_is_in_every_recurrent_class_of_every_policy(seed: int) -> None:
    mdp, pairs = drawn(seed)
    kept = [k for k, (s, _) in enumerate(pairs) if s != seed % 5 or pairs[k - 1][0] != s]
    every = []
    for chosen in product(*([k for k in kept if pairs[k][0] == s] for s in range(5))):
        graph = nx.DiGraph([(pairs[k][0], t) for k in chosen for t in pairs[k][1]])
        every += nx.attracting_components(graph)
    shared = set.intersection(*every)
    found = PairGraph.of(mdp).find_base(np.isin(np.arange(len(pairs)), kept))
    assert found == (min(shared) if shared else None) or found in shared


@pytest.mark.parametrize("seed", range(10))
def test_pairs_are_split_into_their_outcomes(seed: int) -> None:
    mdp, pairs = drawn(seed)
    some = np.arange(len(pairs)) % 2 == 0
    split = PairGraph.of(mdp).split_pairs(some)
    wanted = [
        (s, part)
        for k, (s, after) in enumerate(pairs)
        for part in ([{t} for t in sorted(after)] if some[k] else [after])
    ]
    ends = zip(split.offsets[:-1], split.offsets[1:], strict=True)
    found = [{*split.next[a:b].tolist()} for a, b in ends]
    assert [*zip(split.pair_state.tolist(), found, strict=True)] == wanted
    assert split.states == 5
