"""The interval of a share that holds after every run at once, and the verdict that stops by it."""

from fractions import Fraction as F
from itertools import count
from math import log, pi

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.special import betaln
from scipy.stats import binomtest

from exact_mdp.analysis.learning.trainers import (
    GRID,
    _is_share_reached,
    count_fewest_misses,
    is_share_excluded,
    share_intervals,
)

SHARES = st.fractions(F(1, 50), F(49, 50), max_denominator=50)
LIMIT, ALPHA, LONGEST = F(9, 10), F(1, 20), 250


def won(share: F, hits: int, misses: int) -> F:
    """E_n as a bettor earns it: trial by trial, on the share that Krichevsky and Trofimov guess."""
    purse, k, n = F(1), 0, 0
    for trial in [True] * hits + [False] * misses:
        guess = (k + F(1, 2)) / (n + 1)
        purse *= guess / share if trial else (1 - guess) / (1 - share)
        k, n = k + trial, n + 1
    return purse


@given(SHARES, st.integers(0, 30), st.integers(0, 30))
def test_what_is_won_is_the_mixture_and_a_martingale(share: F, hits: int, misses: int) -> None:
    purse = won(share, hits, misses)
    assert purse == share * won(share, hits + 1, misses) + (1 - share) * won(
        share, hits, misses + 1
    )
    if purse > 1:  # `is_share_excluded` finds the same number, to a billionth
        assert is_share_excluded(share, hits, misses, 1 / purse)
        assert not is_share_excluded(share, hits, misses, (1 - F(1, 10**9)) / purse)
    p = float(share)
    mixture = betaln(hits + 0.5, misses + 0.5) - betaln(0.5, 0.5)
    assert log(purse) == pytest.approx(mixture - hits * log(p) - misses * log(1 - p), abs=1e-9)


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.sampled_from([F(1, 20), F(1, 100)]))
def test_intervals_hold_all_shares_not_excluded_so_far(trials: list[bool], alpha: F) -> None:
    low, high = F(0), F(1)
    for n, (left, right) in enumerate(share_intervals(trials, alpha), 1):
        k = sum(trials[:n])
        assert low <= left <= right <= high  # they only narrow
        for end, sign in ((left, 1), (right, -1)):
            if end not in (low, high):
                assert is_share_excluded(end, k, n - k, alpha)
                assert not is_share_excluded(end + F(sign, GRID), k, n - k, alpha)
        inside = [j for j in range(1, 100) if left < F(j, 100) < right]
        assert not any(is_share_excluded(F(j, 100), k, n - k, alpha) for j in inside)
        low, high = left, right


@example(F(3, 4), F(1, 2))  # E_1 is 1/α
@given(SHARES, st.fractions(F(1, 1000), F(1, 2), max_denominator=1000))
def test_the_fewest_runs_that_can_fail(share: F, alpha: F) -> None:
    assert count_fewest_misses(share, alpha) == next(
        n for n in count(1) if is_share_excluded(share, 0, n, alpha)
    )


@pytest.fixture(scope="module")
def decisions() -> np.ndarray:
    """1 where the gate has passed after n runs of which k did (n, k), -1 where failed, 0 open."""
    table = np.zeros((LONGEST + 1, LONGEST + 1), dtype=int)
    for n in range(1, LONGEST + 1):
        for k in range(n + 1):
            decided = _is_share_reached(k, n, LIMIT, ALPHA)
            table[n, k] = 0 if decided is None else 1 if decided else -1
    return table


def law(decisions: np.ndarray, share: float) -> tuple[float, float, float]:
    """How likely the gate passes and fails, and after how many runs it stops on average."""
    alive, passes, fails, runs = np.array([1.0]), 0.0, 0.0, 0.0
    for n in range(1, LONGEST + 1):
        runs += alive.sum()
        alive = np.append(alive, 0) * (1 - share) + np.append(0, alive) * share
        verdict = decisions[n, : n + 1]
        passes, fails = passes + alive[verdict > 0].sum(), fails + alive[verdict < 0].sum()
        alive = np.where(verdict == 0, alive, 0)
    return passes, fails, runs


@pytest.mark.parametrize("share", [0.9, 0.905, 0.95])
def test_a_good_trainer_hardly_ever_fails(decisions: np.ndarray, share: float) -> None:
    """Exactly, by recursion; and in streams, each stopped where it suits a false alarm best."""
    assert law(decisions, share)[1] <= float(ALPHA)
    assert law(decisions, 0.899)[0] <= float(ALPHA)  # a bad share is passed as rarely
    hits = np.cumsum(np.random.default_rng(20).random((4000, LONGEST)) < share, axis=1)
    alarms = int((decisions[np.arange(1, LONGEST + 1), hits] < 0).any(axis=1).sum())
    assert binomtest(alarms, 4000).proportion_ci(0.999, method="wilson").low <= float(ALPHA)


def test_the_fewest_runs_for_a_tiny_share() -> None:
    n = count_fewest_misses(F(1, 10**15), F(1, 100))
    assert n / 1e15 - log(pi * n) / 2 == pytest.approx(log(100))
