"""Graphs, against their definition; rows, the same compiled or not; work on threads."""

from fractions import Fraction as F
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
from exact_mdp.mdp.graph import find_reachable_states


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
