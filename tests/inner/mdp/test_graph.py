"""The graph of a model, held against networkx and against definitions written out."""

from fractions import Fraction as F
from functools import cache

import networkx as nx
import numpy as np
import pytest
import scipy.sparse as sp
from cases import CASES
from hypothesis import given
from hypothesis import strategies as st
from oracle import every_policy_ends
from strategies import Rows, model_of, models

from exact_mdp import MDP, ModelError, Scenario
from exact_mdp.mdp import graph
from exact_mdp.mdp.graph import (
    components,
    is_acyclic,
    reachable,
    require_termination,
    termination,
    topological_levels,
)


def check_rank(mdp: MDP, rank: np.ndarray) -> bool:
    """Whether `rank` proves that every policy ends: every pair reaches a smaller one in a step."""
    matrix = mdp.transition
    if rank.shape != (mdp.n_states,) or (rank[mdp.terminal] != 0).any():
        return False
    least = np.minimum.reduceat(rank[matrix.indices], matrix.indptr[:-1])
    other = ~mdp.terminal[mdp.pair_state]
    return bool((rank[~mdp.terminal] > 0).all() and (least < rank[mdp.pair_state])[other].all())


def graph_of(mdp: MDP, pairs: list[int] | None = None) -> nx.DiGraph:
    edges = nx.DiGraph()
    edges.add_nodes_from(range(mdp.n_states))
    for pair in range(mdp.n_pairs) if pairs is None else pairs:
        for _, state, _ in mdp.table.row(pair):
            edges.add_edge(int(mdp.pair_state[pair]), state)
    return edges


@given(models(), st.data())
def test_reachable_states_are_those_of_networkx(rows: Rows, data: st.DataObject) -> None:
    mdp = rows.model()
    start = data.draw(st.sets(st.integers(0, mdp.n_states - 1), max_size=2))
    pairs = sorted(data.draw(st.sets(st.integers(0, mdp.n_pairs - 1))))
    edges = graph_of(mdp, pairs)
    expected = set(start).union(*(nx.descendants(edges, s) for s in start))
    assert set(np.flatnonzero(reachable(mdp, sorted(start), pairs))) == expected
    mask = np.isin(np.arange(mdp.n_pairs), pairs)
    assert set(np.flatnonzero(reachable(mdp, sorted(start), mask))) == expected
    whole = {0} | nx.descendants(graph_of(mdp), 0)
    assert set(np.flatnonzero(reachable(mdp))) == whole


@given(models())
def test_components_are_those_of_networkx(rows: Rows) -> None:
    mdp = rows.model()
    count, labels = components(mdp)
    expected = {frozenset(part) for part in nx.strongly_connected_components(graph_of(mdp))}
    assert {frozenset(np.flatnonzero(labels == n)) for n in range(count)} == expected


@given(models())
def test_levels_are_the_longest_paths(rows: Rows) -> None:
    mdp = rows.model()
    edges = graph_of(mdp)
    edges.remove_edges_from([(s, s) for s in np.flatnonzero(mdp.terminal)])
    levels = topological_levels(mdp)
    assert is_acyclic(mdp) == (levels is not None) == nx.is_directed_acyclic_graph(edges)
    if levels is None:
        return

    @cache
    def longest(state: int) -> int:
        return max((1 + longest(after) for after in edges.successors(state)), default=0)

    assert levels.tolist() == [longest(state) for state in range(mdp.n_states)]


@given(models(discounts=(F(1, 2), F(1))))
def test_termination_is_proven_or_refuted(rows: Rows) -> None:
    mdp = rows.model()
    found = termination(mdp)
    assert found.proven == every_policy_ends(rows.n_states, rows.pairs)
    assert found.proven == check_rank(mdp, found.rank)
    if found.proven:
        require_termination(mdp.with_(discount=1))
        return
    # The policy is one, and stays where it was said to stay.
    assert found.policy is not None
    chosen = [mdp.pair(s, int(a)) for s, a in enumerate(found.policy)]
    trapped = set(found.trapped.tolist())
    assert trapped
    assert not trapped & set(np.flatnonzero(mdp.terminal))
    for state in trapped:
        assert {after for _, after, _ in mdp.table.row(chosen[state])} <= trapped
    with pytest.raises(ModelError, match="discount 1 needs every policy to end"):
        require_termination(mdp.with_(discount=1))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_published_models_end_as_they_say(case) -> None:
    mdp = model_of(case.n_states, case.pairs, case.discount)
    if case.discount == 1:
        assert termination(mdp).proven == case.proper


@given(models(discounts=(F(1),)), st.data())
def test_a_spoilt_rank_is_refused(rows: Rows, data: st.DataObject) -> None:
    mdp = rows.model()
    rank = termination(mdp).rank
    assert check_rank(mdp, rank)
    assert not check_rank(mdp, rank[1:])
    if mdp.terminal.all():
        return
    spoilt = rank.copy()
    # A state whose rank is the least of all has no successor of smaller rank.
    spoilt[data.draw(st.sampled_from(np.flatnonzero(~mdp.terminal).tolist()))] = 0
    assert not check_rank(mdp, spoilt)
    lifted = rank.copy()
    lifted[mdp.terminal] = 1
    assert not check_rank(mdp, lifted)


def test_the_policy_that_never_ends_is_named() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 0, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, states=["left", "right", "end"], actions=["go", "stop"])
    with pytest.raises(ModelError) as caught:
        require_termination(mdp)
    assert str(caught.value) == (
        "discount 1 needs every policy to end, and one does not\n"
        "  where: it stays for ever in (state left) with action go, (state right) with action go\n"
        "  fix:   choose a discount below 1 (--discount 0.95, mdp.with_(discount=0.95)), "
        "stop after N steps (--horizon N, mdp.within(N)), or use solve(mdp) or certify(mdp), "
        "or add a way out: a terminal state stays put and earns 0"
    )
    require_termination(mdp.with_(discount="1/2"))


def test_many_trapped_states_are_counted() -> None:
    mdp = MDP.from_arrays([np.eye(9)], np.ones(9))
    with pytest.raises(ModelError, match="and 5 more"):
        require_termination(mdp)


def test_a_thousand_subtasks_fall_level_by_level() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1000]).compile()
    levels = topological_levels(mdp)
    assert levels is not None
    assert mdp.n_states == 80_001
    # Four further trials of each subtask, then the next.
    assert levels.max() == 5000
    assert check_rank(mdp, levels)
    assert check_rank(mdp, termination(mdp).rank)


def test_the_columns_of_a_graph_may_be_a_strided_view() -> None:
    columns = np.repeat(np.array([1, 2, 1], dtype=np.int32), 2)[::2]
    edges = sp.csr_array((np.ones(3), columns, np.arange(4, dtype=np.int32)), (3, 3))
    assert not edges.indices.flags.c_contiguous
    assert graph.strong_components(edges).tolist() == [0, 1, 1]


@given(st.integers(1, 12), st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11))), st.data())
def test_components_and_closures_are_those_of_networkx(
    size: int, ends: list[tuple[int, int]], data: st.DataObject
) -> None:
    """Components are numbered by their first nodes, or so that no edge leads to a higher one."""
    known = nx.DiGraph([(source % size, target % size) for source, target in ends])
    known.add_nodes_from(range(size))
    edges = sp.csr_array(nx.to_scipy_sparse_array(known, nodelist=range(size), dtype=float))
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
def test_rounds_are_the_same_in_lists_and_compiled(
    size: int, pairs: list[tuple[int, set[int]]], data: st.DataObject
) -> None:
    """And as their definition has them: what joins depends on the rounds before alone."""
    pairs = sorted((state % size, {s % size for s in after}) for state, after in pairs)
    some = np.array(data.draw(st.lists(st.booleans(), min_size=len(pairs), max_size=len(pairs))))
    first = np.array(data.draw(st.lists(st.booleans(), min_size=size, max_size=size)))
    waiting = np.array(data.draw(st.lists(st.integers(1, 3), min_size=size, max_size=size)))
    rank, left, before = np.where(first, 0, -1), some.copy(), np.flatnonzero(first)
    for number in range(1, size + 1):
        met = [k for k, (_, after) in enumerate(pairs) if left[k] and after & set(before.tolist())]
        left[met] = False
        used = np.bincount(
            [s for k, (s, _) in enumerate(pairs) if some[k] > left[k]], minlength=size
        )
        before = np.flatnonzero((rank < 0) & (used >= waiting))
        rank[before] = number
    offsets = np.cumsum([0, *(len(after) for _, after in pairs)])
    following = np.array([s for _, after in pairs for s in sorted(after)])
    owner = np.array([state for state, _ in pairs])
    backward = graph.Backward.of(offsets, following, owner, size)
    for compiled in (False, True):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(graph, "COMPILED", 0 if compiled else 10**9)
            found = backward.rounds(first, some, waiting)
        assert found[0].tolist() == rank.tolist()
        if (rank < 0).any():
            assert found[1].tolist() == left.tolist()
