"""Rows that compiled loops take over are those that SciPy and NumPy make, and so are refusals."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError
from exact_mdp.mdp import build
from exact_mdp.mdp.forms.rows import COMPARED, last_action

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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "COMPILED", 0)
        one = made(parts, states)
        patch.setattr(build, "COMPILED", 10**9)
        two = made(given_, states)
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


@given(st.lists(st.tuples(st.integers(-1, 3), st.integers(-1, 3)), max_size=6), st.booleans())
def test_pairs_are_seen_to_be_in_order(pairs: list[tuple[int, int]], ordered: bool) -> None:
    if ordered:
        pairs = sorted(set(pairs))
    state, action = (np.array([pair[part] for pair in pairs], dtype=np.int64) for part in (0, 1))
    whole = (
        pairs == sorted(set(pairs))
        and [*dict.fromkeys(state.tolist())] == [*range(len(set(state.tolist())))]
        and all(number >= 0 for number in action.tolist())
    )
    assert last_action(state, action) == (max(action.tolist(), default=-1) if whole else -1)
