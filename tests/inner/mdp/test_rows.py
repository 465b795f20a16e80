"""Rows that compiled loops take over are those of SciPy and NumPy; integer rows are the model."""

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import Rows, models

from exact_mdp import MDP, ModelError
from exact_mdp.mdp import rows, table
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.forms import columns as funnel
from exact_mdp.mdp.forms.rows import COMPARED

FAULTS = {
    "none": lambda parts: None,
    "a place twice": lambda parts: parts["columns"].__setitem__(1, parts["columns"][0]),
    "a zero": lambda parts: parts["data"].__setitem__(slice(0, 2), [0.0, parts["data"][:2].sum()]),
    "a negative number": lambda parts: parts["data"].__setitem__(0, -0.25),
    "not a number": lambda parts: parts["data"].__setitem__(0, np.nan),
    "infinite": lambda parts: parts["data"].__setitem__(2, np.inf),
    "a sum of more than 1": lambda parts: parts["data"].__setitem__(0, parts["data"][0] + 2e-9),
    "a sum that will do": lambda parts: parts["data"].__setitem__(0, parts["data"][0] + 8e-10),
    "a column too high": lambda parts: parts["columns"].__setitem__(0, 10**6),
    "a column below 0": lambda parts: parts["columns"].__setitem__(3, -1),
    "an empty row": lambda parts: parts["indptr"].__setitem__(1, 0),
}


def made(parts: dict[str, np.ndarray], states: int) -> MDP | str:
    pairs = len(parts["indptr"]) - 1
    matrix = sp.csr_array((parts["data"], parts["columns"], parts["indptr"]), (pairs, states))
    try:
        return MDP.from_pairs(np.arange(pairs), np.zeros(pairs, int), matrix, np.ones(pairs), "1/2")
    except ModelError as error:
        return str(error)


@given(
    seed=st.integers(0, 10**6),
    states=st.sampled_from([5, 9, COMPARED + 40, 300]),
    fault=st.sampled_from(sorted(FAULTS)),
    ordered=st.booleans(),
    wide=st.sampled_from([np.int32, np.int64]),
)
def test_rows_are_taken_as_without_compiled_loops(
    seed: int, states: int, fault: str, ordered: bool, wide: type
) -> None:
    rng = np.random.default_rng(seed)
    lengths = rng.integers(4, states, states, endpoint=True)
    columns = [rng.permutation(states)[:n] for n in lengths]
    columns = [np.sort(row) for row in columns] if ordered else columns
    parts = {
        "data": np.concatenate([rng.dirichlet(np.ones(n)) for n in lengths]),
        "columns": np.concatenate(columns).astype(wide),
        "indptr": np.concatenate([[0], np.cumsum(lengths)]).astype(wide),
    }
    FAULTS[fault](parts)
    given_ = {name: array.copy() for name, array in parts.items()}
    found = []
    for limit in (0, 10**9):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(funnel, "COMPILED", limit)
            patch.setattr(table, "COMPILED", limit)
            found.append(made(parts if limit == 0 else given_, states))
    one, two = found
    for name, array in parts.items():
        assert np.array_equal(array, given_[name], equal_nan=True)  # the caller's own
    if isinstance(one, str) or isinstance(two, str):
        assert one == two
        return
    for name in ("offsets", "next", "weight"):
        assert getattr(one.table, name).dtype == getattr(two.table, name).dtype
        assert getattr(one.table, name).tolist() == getattr(two.table, name).tolist()
    assert not np.shares_memory(one.table.weight, parts["data"])
    assert np.abs(one.transition.toarray() - two.transition.toarray()).max() == 0
    assert one.table.rising == two.table.rising


CHANCES = st.lists(st.floats(1e-12, 1), min_size=1, max_size=8)
OFF = st.sampled_from([0.0, 1e-16, -1e-16, 3e-10, -3e-10, 9.9e-10, -9.9e-10])


def nearly_one(parts: list[float], off: float) -> list[float]:
    total = sum(parts)
    found = [part / total for part in parts]
    found[0] += off if found[0] + off > 0 else 0.0
    return found


@given(st.lists(st.tuples(CHANCES, OFF), min_size=1, max_size=6))
def test_rows_mean_the_same_one_by_one_by_arrays_and_compiled(drawn) -> None:
    each = [nearly_one(*row) for row in drawn]
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in each])]).astype(np.int64)
    found = []
    for limit in (0, 10**9):
        weight = np.concatenate([np.array(row) for row in each])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(table, "COMPILED", limit)
            table.settle_rows(weight, offsets)
        found.append(weight)
    assert found[0].tolist() == found[1].tolist()
    top, bottom = rows.exactly(found[0], offsets)
    below = np.repeat(bottom, np.diff(offsets)).tolist()
    exact = [F(a, b) for a, b in zip(top.tolist(), below, strict=True)]
    assert exact == [p for row in each for p in rows.meant(row)]


@settings(max_examples=100, deadline=None)
@given(models())
def test_integer_rows_are_the_model(rows: Rows) -> None:
    for floats in (False, True):
        mdp = rows.model(floats=floats)
        found = bellman_rows(mdp)
        assert found is bellman_rows(mdp)
        assert not any(array.flags.writeable for array in vars(found).values())
        for pair in range(mdp.n_pairs):
            scale = int(found.scale[mdp.pair_state[pair]])
            earned, share = F(0), {}
            for p, t, r in mdp.table.row(pair):
                earned += p * r
                share[t] = share.get(t, F(0)) + p * mdp.discount_exact
            span = range(found.offsets[pair], found.offsets[pair + 1])
            listed = {int(found.next[i]): F(int(found.weight[i]), scale) for i in span}
            assert listed == {t: p for t, p in share.items() if p}
            assert F(int(found.constant[pair]), scale) == earned


@pytest.mark.parametrize("least", [0, 10**9])
def test_what_a_matrix_remembers_of_its_order_is_not_believed(
    least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SciPy keeps what it once found, though indices may be written in place since."""
    monkeypatch.setattr(funnel, "COMPILED", least)
    parts = (np.array([1.0, 0.5, 0.5, 1]), np.array([1, 0, 2, 2]), np.array([0, 1, 3, 4]))
    matrix = sp.csr_array(parts, shape=(3, 3))
    assert matrix.has_canonical_format
    matrix.indices[1:3] = [2, 0]
    mdp = MDP.from_pairs([0, 1, 2], [0] * 3, matrix, [1.0, 1, 0])
    assert mdp.table.next.tolist() == [1, 0, 2, 2]
    assert matrix.indices.tolist() == [1, 2, 0, 2]
