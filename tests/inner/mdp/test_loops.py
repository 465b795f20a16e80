"""Graphs, rows and records: the same compiled or not, in blocks or at once, as by definition."""

from __future__ import annotations

from fractions import Fraction as F
from functools import cache
from pathlib import Path

import networkx as nx
import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from cases import CASES
from hypothesis import given
from hypothesis import strategies as st
from oracle import every_policy_ends
from strategies import Rows, model_of, models

from exact_mdp import MDP, ModelError, Scenario, fingerprint
from exact_mdp.mdp import graph, table
from exact_mdp.mdp.forms import rows
from exact_mdp.mdp.graph import (
    is_acyclic,
    reachable,
    require_termination,
    termination,
    topological_levels,
)


def proves(mdp: MDP, rank: np.ndarray) -> bool:
    """Whether `rank` proves that every policy ends: every pair reaches a smaller one in a step."""
    matrix, going = mdp.transition, ~mdp.terminal
    least = np.minimum.reduceat(rank[matrix.indices], matrix.indptr[:-1])
    falls = (least < rank[mdp.pair_state])[going[mdp.pair_state]].all()
    return bool(falls and (rank[going] > 0).all() and not rank[~going].any())


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
        assert set(np.flatnonzero(reachable(mdp, sorted(start), chosen))) == expected
    edges = edges_of(mdp, [*range(mdp.n_pairs)])
    assert set(np.flatnonzero(reachable(mdp))) == {0} | nx.descendants(edges, 0)
    edges.remove_edges_from([(s, s) for s in np.flatnonzero(mdp.terminal)])
    levels = topological_levels(mdp)
    assert is_acyclic(mdp) == (levels is not None) == nx.is_directed_acyclic_graph(edges)

    @cache
    def longest(state: int) -> int:
        return max((1 + longest(after) for after in edges.successors(state)), default=0)

    assert levels is None or levels.tolist() == [longest(s) for s in range(mdp.n_states)]
    found = termination(mdp)
    assert found.proven == every_policy_ends(rows.n_states, rows.pairs) == proves(mdp, found.rank)
    if found.proven:
        require_termination(mdp.with_(discount=1))
        return
    chosen = [mdp.pair(s, int(a)) for s, a in enumerate(found.policy)]
    trapped = set(found.trapped.tolist())  # where that policy stays for ever
    assert trapped
    assert not trapped & set(np.flatnonzero(mdp.terminal))
    assert all({t for _, t, _ in mdp.table.row(chosen[s])} <= trapped for s in trapped)
    with pytest.raises(ModelError, match="discount 1 needs every policy to end"):
        require_termination(mdp.with_(discount=1))


def test_models_end_as_they_say_and_a_policy_that_does_not_is_named() -> None:
    for case in CASES:
        mdp = model_of(case.n_states, case.pairs, case.discount)
        assert case.discount < 1 or termination(mdp).proven == case.proper
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 0, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, states=["left", "right", "end"], actions=["go", "stop"])
    with pytest.raises(ModelError, match="every policy to end, and one does not") as caught:
        require_termination(mdp)
    assert caught.value.where == (
        "it stays for ever in (state left) with action go, (state right) with action go"
    )
    assert "choose a discount below 1 (--discount 0.95" in caught.value.fix
    require_termination(mdp.with_(discount="1/2"))
    with pytest.raises(ModelError, match="and 5 more"):
        require_termination(MDP.from_arrays([np.eye(9)], np.ones(9)))
    care = Scenario.load("yuan2025").with_(tasks=[1000]).compile()
    levels = topological_levels(care)
    assert levels.max() == 5000  # four further trials of each subtask, then the next
    assert proves(care, levels)
    assert proves(care, termination(care).rank)


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
    assert set(np.flatnonzero(graph.closure(edges, first))) == reached


@given(
    st.integers(1, 8),
    st.lists(st.tuples(st.integers(0, 7), st.sets(st.integers(0, 7), min_size=1)), min_size=1),
    st.data(),
)
def test_rounds_are_the_same_in_lists_and_compiled(size: int, pairs, data) -> None:
    """And as their definition has them: what joins depends on the rounds before alone."""
    pairs = sorted((state % size, {s % size for s in after}) for state, after in pairs)
    some = np.array(data.draw(st.lists(st.booleans(), min_size=len(pairs), max_size=len(pairs))))
    first = np.array(data.draw(st.lists(st.booleans(), min_size=size, max_size=size)))
    waiting = np.array(data.draw(st.lists(st.integers(1, 3), min_size=size, max_size=size)))
    rank, left, before = np.where(first, 0, -1), some.copy(), np.flatnonzero(first)
    for number in range(1, size + 1):
        met = [k for k, (_, after) in enumerate(pairs) if left[k] and after & set(before.tolist())]
        left[met] = False
        used = [s for k, (s, _) in enumerate(pairs) if some[k] > left[k]]
        before = np.flatnonzero((rank < 0) & (np.bincount(used, minlength=size) >= waiting))
        rank[before] = number
    offsets = np.cumsum([0, *(len(after) for _, after in pairs)])
    following = np.array([s for _, after in pairs for s in sorted(after)])
    owner = np.array([state for state, _ in pairs])
    backward = graph.Backward.of(offsets, following, owner, size)
    for limit in (0, 10**9):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(graph, "COMPILED", limit)
            found = backward.rounds(first, some, waiting)
        assert found[0].tolist() == rank.tolist()
        assert (rank >= 0).all() or found[1].tolist() == left.tolist()


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


@given(
    st.integers(0, 10**6),
    st.sampled_from([5, 9, 300]),
    st.sampled_from(sorted(FAULTS)),
    st.sampled_from([0.0, 8e-10, 2e-9]),
    st.booleans(),
    st.sampled_from([np.int32, np.int64]),
)
def test_rows_are_taken_as_without_compiled_loops(
    seed: int, states: int, fault: str, off: float, ordered: bool, wide: type
) -> None:
    """The same models and the same refusals; arrays of the caller stay as they are."""
    rng = np.random.default_rng(seed)
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
    found: list[MDP | str] = []
    for limit in (0, 10**9):
        parts = {name: array.copy() for name, array in given_.items()}
        matrix = sp.csr_array((parts["data"], parts["columns"], parts["indptr"]), (states, states))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("exact_mdp.mdp.forms.columns.COMPILED", limit)
            patch.setattr(table, "COMPILED", limit)
            try:
                pairs = np.arange(states), np.zeros(states, int)
                found.append(MDP.from_pairs(*pairs, matrix, np.ones(states), "1/2"))
            except ModelError as error:
                found.append(str(error))
        assert all(np.array_equal(parts[n], array, equal_nan=True) for n, array in given_.items())
    one, two = found
    if isinstance(one, str) or isinstance(two, str):
        assert one == two
        return
    for name in ("offsets", "next", "weight"):
        assert getattr(one.table, name).dtype == getattr(two.table, name).dtype
        assert getattr(one.table, name).tolist() == getattr(two.table, name).tolist()
    assert (one.transition != two.transition).nnz == 0
    if one.table.weight.dtype != np.float64:
        return
    top, bottom = rows.exactly(one.table.weight, one.table.offsets)
    below = np.repeat(bottom, np.diff(one.table.offsets)).tolist()
    exact = [F(a, b) for a, b in zip(top.tolist(), below, strict=True)]
    assert exact == [p for pair in range(states) for p, _, _ in one.table.row(pair)]


@pytest.mark.parametrize("size", [1, 3, 100])
def test_records_are_the_same_in_blocks(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["episode", "state", "action", "reward", "next_state", "truncated"]
    rows = [
        (1, "a", "x", 0, "b", False), (1, "b", "y", 1, "trap", True), (2, "a", "x", 0, "b", False),
        (2, "b", "y", 2, None, False), (3, "a", "y", 1, None, True), (4, "a", "x", 0, "a", True),
    ]  # fmt: skip
    log = pd.DataFrame(rows, columns=names)
    log.to_csv(tmp_path / "log.csv", index=False)
    log.to_parquet(tmp_path / "log.parquet")
    wanted = MDP.from_transitions(log, "1/2")
    monkeypatch.setattr("exact_mdp.mdp.io.transitions.ROWS", size)
    for each in (log, tmp_path / "log.csv", tmp_path / "log.parquet"):
        mdp = MDP.from_transitions(each, "1/2")
        assert fingerprint(mdp) == fingerprint(wanted)
        assert mdp.labels["cut off"].tolist() == wanted.labels["cut off"].tolist()
