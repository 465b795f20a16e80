"""Graphs and end components, against networkx and all sets; compiled rows; work on threads."""

from fractions import Fraction as F
from itertools import chain, combinations, product
from typing import Any

import networkx as nx
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import laws
from strategies import Rows, models

from exact_mdp import MDP, ModelError
from exact_mdp.mdp import graph, table
from exact_mdp.mdp.forms import threads
from exact_mdp.mdp.graph import PairGraph, find_reachable_states


def edges_of(mdp: MDP, pairs: list[int]) -> nx.DiGraph:
    edges = nx.DiGraph()
    edges.add_nodes_from(range(mdp.n_states))
    rows = [(int(mdp.pair_state[pair]), mdp.table.row(pair)) for pair in pairs]
    edges.add_edges_from((state, after) for state, row in rows for _, after, _ in row)
    return edges


@given(models(discounts=(F(1, 2), F(1))), st.data())
def test_what_is_reached_in_how_many_steps_and_whether_it_ends(rows: Rows, data) -> None:
    mdp = rows.model()
    start = data.draw(st.sets(st.integers(0, mdp.n_states - 1), max_size=2))
    pairs = sorted(data.draw(st.sets(st.integers(0, mdp.n_pairs - 1))))
    edges = edges_of(mdp, pairs)
    expected = set(start).union(*(nx.descendants(edges, s) for s in start))
    for chosen in (pairs, np.isin(np.arange(mdp.n_pairs), pairs)):
        assert set(np.flatnonzero(find_reachable_states(mdp, sorted(start), chosen))) == expected
    edges = edges_of(mdp, [*range(mdp.n_pairs)])
    assert set(np.flatnonzero(find_reachable_states(mdp))) == {0} | nx.descendants(edges, 0)


@given(st.integers(1, 12), st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11))), st.data())
def test_components_and_closures_are_those_of_networkx(size: int, ends, data) -> None:
    """Components are numbered by their first nodes, or so that no edge leads to a higher one."""
    known = nx.DiGraph([(source % size, target % size) for source, target in ends])
    known.add_nodes_from(range(size))
    edges = sp.csr_array(nx.to_scipy_sparse_array(known, nodelist=range(size), dtype=float))
    edges.indices = np.repeat(edges.indices, 2)[::2]  # a strided view
    first = np.array(data.draw(st.lists(st.booleans(), min_size=size, max_size=size)))
    parts, order = graph.strong_components(edges), graph.components_in_order(edges)
    expected = {frozenset(part) for part in nx.strongly_connected_components(known)}
    for label in (parts, order):
        numbers = range(label.max() + 1)
        assert {frozenset(np.flatnonzero(label == number)) for number in numbers} == expected
    assert all(order[source] >= order[target] for source, target in known.edges)
    assert [*dict.fromkeys(parts.tolist())] == [*range(len(expected))]
    begins = np.flatnonzero(first).tolist()
    reached = set(begins).union(*(nx.descendants(known, node) for node in begins))
    assert set(np.flatnonzero(graph.find_reachable_nodes(edges, first))) == reached


# ---- rows ----------------------------------------------------------------------------------------

FAULTS: dict[str, list[tuple[str, int, float]]] = {  # array, place, number
    "none": [],
    "a place twice": [("columns", 1, 1)],
    "a zero": [("data", 0, 0.0)],
    "a negative number": [("data", 0, -0.25)],
    "not a number": [("data", 0, np.nan)],
    "infinite": [("data", 2, np.inf)],
    "a column too high": [("columns", 0, 10**6)],
    "a column below 0": [("columns", 3, -1)],
    "an empty row": [("indptr", 1, 0)],
}


@pytest.mark.parametrize("fault", FAULTS)
@given(
    seed=st.integers(0, 10**6),
    off=st.sampled_from([0.0, 8e-10, 2e-9]),
    ordered=st.booleans(),
    wide=st.sampled_from([np.int32, np.int64]),
)
@settings(max_examples=10)
def test_rows_are_taken_as_without_compiled_loops(
    fault: str, seed: int, off: float, ordered: bool, wide: type
) -> None:
    """The same models and the same refusals; arrays of the caller stay as they are."""
    rng = np.random.default_rng(seed)
    states = int(rng.choice([5, 9, 100]))
    lengths = rng.integers(4, states, states, endpoint=True)
    columns = [rng.permutation(states)[:n] for n in lengths]
    given_ = {
        "data": np.concatenate([rng.dirichlet(np.ones(n)) for n in lengths]),
        "columns": np.concatenate([np.sort(c) if ordered else c for c in columns]).astype(wide),
        "indptr": np.concatenate([[0], np.cumsum(lengths)]).astype(wide),
    }
    given_["data"][0] += off
    for name, place, number in FAULTS[fault]:
        given_[name][place] = number
    answers: list[Any] = []
    for limit in (0, 10**9):
        parts = {name: array.copy() for name, array in given_.items()}
        matrix = sp.csr_array((parts["data"], parts["columns"], parts["indptr"]), (states, states))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("exact_mdp.mdp.forms.columns.COMPILED", limit)
            patch.setattr(table, "COMPILED", limit)
            pairs = np.arange(states), np.zeros(states, int)
            try:
                mdp = MDP.from_pairs(*pairs, matrix, np.ones(states), "1/2")
            except ModelError as error:
                answers.append(str(error))
            else:
                weight = mdp.table.weight
                answers.append((laws(mdp), mdp.transition.toarray().tolist(), weight.dtype.kind))
        assert all(np.array_equal(parts[n], array, equal_nan=True) for n, array in given_.items())
    assert answers[0] == answers[1]


# ---- threads -------------------------------------------------------------------------------------


def test_work_on_threads_raises_and_ignores_as_its_caller_does() -> None:
    seen = np.zeros(50)

    def overflows(number: int, first: int, last: int) -> None:
        seen[number] = np.multiply(1e308, np.full(1, 10.0))[0]

    def fails(number: int, first: int, last: int) -> None:
        raise ValueError(f"{first} {last}")

    with np.errstate(over="ignore"):  # a warning would be an error
        threads.run_blocks(range(51), overflows)
    assert np.isinf(seen).all()
    with pytest.raises(ValueError, match=r"^\d+ \d+$"):
        threads.run_blocks([0, 1, 2, 3], fails)


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
