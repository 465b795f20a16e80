"""What no public door shows of kernels: blocks of work on threads, and proofs
of bounds around any values."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import Rows, exact_gains, exact_values, models

from exact_mdp.mdp.forms import threads
from exact_mdp.solvers.bounds.bounds import lower, margin_weights, verify
from exact_mdp.solvers.bounds.gains import gains

NUMBERS = st.one_of(
    st.floats(-10, 10), st.sampled_from([0.0, 1e9, -1e9, 1e-9, 1 / 3, 1e15, 2.0**-1060])
)


@given(models(), st.booleans(), st.data())
def test_bounds_are_proven_by_exact_inequalities(
    rows: Rows, floats: bool, data: st.DataObject
) -> None:
    """V + c w ≥ r + γ P (V + c w) of every pair, V + c' w ≤ r + γ P (V + c' w) of the policy's."""
    mdp = rows.model(floats=floats)
    drawn = data.draw(st.lists(NUMBERS, min_size=mdp.n_states, max_size=mdp.n_states))
    value = np.where(mdp.terminal, 0.0, np.array(drawn))
    gain, found = gains(mdp, value), verify(mdp, value)
    exact = exact_gains(mdp, exact_values(value))
    for x, g, e in zip(exact, exact_values(gain.value), gain.error, strict=True):
        assert abs(x - g) <= F(float(e))
    picked = np.array([data.draw(st.sampled_from(mdp.pairs_of(s))) for s in range(mdp.n_states)])
    for bounds in (found, replace(found, pairs=picked, low=lower(mdp, gain, picked))):
        middle, weight = exact_values(bounds.value), exact_values(bounds.weight)
        for end, sign, pairs in (
            (bounds.high, 1, range(mdp.n_pairs)),
            (bounds.low, -1, bounds.pairs),
        ):
            moved = [v + F(end) * w for v, w in zip(middle, weight, strict=True)]
            more = exact_gains(mdp, moved)
            assert all(sign * more[l] <= 0 for l in pairs if not mdp.terminal[mdp.pair_state[l]])
            assert not any(moved[s] for s in np.flatnonzero(mdp.terminal))


@given(models(), st.booleans())
def test_margins_lie_where_they_were_verified(rows: Rows, floats: bool) -> None:
    mdp = rows.model(floats=floats)
    found = margin_weights(mdp)
    weight, margin = exact_values(found.value), np.broadcast_to(found.margin, mdp.n_pairs)
    for pair, (least, most) in enumerate(
        zip(margin - found.error, margin + found.error, strict=True)
    ):
        state = int(mdp.pair_state[pair])
        if mdp.terminal[state]:
            assert weight[state] == 0
            continue
        later = sum((p * weight[t] for p, t, _ in mdp.table.row(pair)), F(0))
        exact = weight[state] - mdp.discount_exact * later
        assert 0 < F(float(least)) <= exact <= F(float(most))


def test_what_fails_on_a_thread_is_raised() -> None:
    def fails(number: int, first: int, last: int) -> None:
        raise ValueError(f"{first} {last}")

    with pytest.raises(ValueError, match=r"^\d+ \d+$"):
        threads.run_blocks([0, 1, 2, 3], fails)


def test_threads_ignore_what_their_caller_ignores() -> None:
    seen = np.zeros(50)

    def overflows(number: int, first: int, last: int) -> None:
        seen[number] = np.multiply(1e308, np.full(1, 10.0))[0]

    with np.errstate(over="ignore"):  # a warning would be an error
        threads.run_blocks(range(51), overflows)
    assert np.isinf(seen).all()


def test_blocks_cover_all_once() -> None:
    work = np.cumsum(np.concatenate([[0], np.random.default_rng(1).integers(1, 9, 5_000)]))
    for number in (1, 2, 3):
        ends = threads.block_ends(work, number)
        assert (ends[0], ends[-1]) == (0, 5_000)
        assert all(first < last for first, last in pairwise(ends))
        assert len(ends) - 1 == (1 if number == 1 else threads.PER_THREAD * number)
        most = int(work[-1]) // 40
        ends = threads.block_ends(work, number, most=most)
        assert np.diff(work[ends]).max() <= most + 9
