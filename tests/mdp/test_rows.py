"""What rows of floats mean: exact fractions that sum to 1."""

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from exact_mdp import MDP, DistributionError, certify, fingerprint

# ---- what rows of floats mean -------------------------------------------------------------------


def row_of(chances: list[object], **told: object) -> list[F]:
    """Return the exact probabilities of a row, as a model has them."""
    size = len(chances)
    rest = [[0] * k + [1] + [0] * (size - k - 1) for k in range(1, size)]
    mdp = MDP.from_arrays([[chances, *rest]], [1] * size, "9/10")
    exact = {state: p for p, state, _ in mdp.table.row(0)}
    return [exact.get(state, F(0)) for state in range(size)]


@pytest.mark.parametrize("parts", [3, 6, 7, 9, 10, 12, 100, 1000, 10**6])
def test_fractions_that_people_write_are_what_they_wrote(parts: int) -> None:
    for top in {1, 2, parts // 3, parts // 2, parts - 1}:
        left = parts - top
        counts = [top, left // 2, left - left // 2]
        assert row_of([n / parts for n in counts]) == [F(n, parts) for n in counts]
    assert row_of([1 / 3, (1 - 1 / 3) / 2, (1 - 1 / 3) / 2]) == [F(1, 3)] * 3
    assert row_of([0.1 + 0.2, 0.7]) == [F(3, 10), F(7, 10)]


CHANCES = st.lists(st.floats(1e-12, 1), min_size=1, max_size=8)
OFF = st.sampled_from([0.0, 1e-16, -1e-16, 3e-10, -3e-10, 9.9e-10, -9.9e-10])


def nearly_one(parts: list[float], off: float) -> list[float]:
    total = sum(parts)
    found = [part / total for part in parts]
    found[0] += off if found[0] + off > 0 else 0.0
    return found


@given(CHANCES, OFF, st.randoms(use_true_random=False))
def test_every_row_sums_to_1_exactly_whatever_the_order(parts, off, random) -> None:
    row = nearly_one(parts, off)
    exact = row_of(row)
    assert sum(exact) == 1
    assert min(exact) > 0
    again = sorted(range(len(row)), key=lambda _: random.random())
    assert row_of([row[k] for k in again]) == [exact[k] for k in again]
    same = {value: {exact[k] for k in range(len(row)) if row[k] == value} for value in row}
    assert all(len(each) == 1 for each in same.values())
    # Nothing moves by more than the row misses 1, and two units in the last place.
    for value, meant in zip(row, exact, strict=True):
        assert abs(F(value) - meant) <= abs(sum(map(F, row)) - 1) + 2 * F(np.spacing(value))


@given(CHANCES, OFF)
def test_a_model_keeps_the_floats_next_to_what_its_rows_mean(parts, off) -> None:
    row = nearly_one(parts, off)
    mdp = MDP.from_arrays([[row] * len(row)], [1] * len(row), "9/10")
    floats, exact = mdp.transition[[0]].toarray()[0], row_of(row)
    assert [float(p) for p in exact] == floats.tolist()
    assert row_of(floats.tolist()) == exact
    told = MDP.from_arrays([[exact] * len(row)], [1] * len(row), "9/10")
    assert fingerprint(told) == fingerprint(mdp)
    assert (mdp.floats, told.floats) == (True, False)
    assert list(certify(told).value) == list(certify(mdp).value)


def test_beside_exact_numbers_the_floats_alone_give_way() -> None:
    assert row_of(["1/3", 0.6666666666666666]) == [F(1, 3), F(2, 3)]
    odd = F(123456789, 1000000007)
    row = row_of([odd, 0.4, float(F(6, 10) - odd) + 5e-10])
    assert (row[0], row[1]) == (odd, F(0.4))
    for row in (["1/3", "666666667/1000000000"], [1, 1e-12], [F(0.1), F(0.9)]):
        with pytest.raises(DistributionError):
            row_of(row)


def test_numbers_are_read_before_they_are_added() -> None:
    """A row in which a place comes twice means what it meant before."""
    third, rest = 1 / 3, (1 - 1 / 3) / 2
    mdp = MDP.from_outcomes(
        [(0, 0, [(rest, 0, 1), (third, 0, 1), (rest, 1, 1)]), (1, 0, [(1, 1, 0)])]
    )
    assert mdp.table.row(0) == [(F(2, 3), 0, F(1)), (F(1, 3), 1, F(1))]
    place = ([rest, third, rest, 1.0], ([0, 0, 0, 1], [0, 0, 1, 1]))
    twice = MDP.from_pairs([0, 1], [0, 0], sp.coo_array(place, (2, 2)), [1, 0])
    assert fingerprint(twice) == fingerprint(mdp)
    assert mdp.floats
    assert twice.floats


@pytest.mark.parametrize("seed", range(4))
def test_symmetric_actions_tie(seed: int) -> None:
    """Actions whose rows differ in their order alone, before states that are worth the same."""
    rng = np.random.default_rng(seed)
    for row in (rng.dirichlet(np.ones(5)), np.full(5, 0.2), np.array([3, 3, 2, 2, 1]) / 11):
        actions = [np.concatenate([[0], rng.permutation(row)]) for _ in range(4)]
        end = np.eye(6)[1:]
        mdp = MDP.from_arrays(
            np.array([np.vstack([action, end]) for action in actions]), [0, 1, 1, 1, 1, 1], "9/10"
        )
        assert certify(mdp).optimal[0].all()
