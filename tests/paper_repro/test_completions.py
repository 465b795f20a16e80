"""How often training ends with each completion: against plain loops, simulation and real runs."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reading_cases import ENDS, small_search, small_study

from exact_mdp.mdp import ModelError
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.reading import QUICK, default
from exact_mdp.paper_repro.readings.completions import (
    LEFT_OUT,
    PARTS,
    LearnedCompletions,
    by_reading,
    counted,
    learnable,
    pooled,
)
from exact_mdp.paper_repro.readings.findings import weighed_before
from exact_mdp.paper_repro.readings.training import at_random, completion_weights
from exact_mdp.paper_repro.reported import COMPLETIONS, NUMBER, UNSTATED


def plain_weights(counts: np.ndarray) -> np.ndarray:
    """The weights, spelled out."""
    found = np.ones(len(COMPLETIONS))
    for number, each in enumerate(COMPLETIONS):
        for runs in counts:
            order = list(reported.ORDERS).index(reported.order(each))
            found[number] *= (runs[0][order] + 0.5) / (sum(runs[0]) + 1)
            for part, status in enumerate(UNSTATED, start=1):
                taken = runs[part][NUMBER[each[status]]]
                found[number] *= (taken + 0.5) / (sum(runs[part]) + 2)
    return found / found.sum()


def drawn_counts(seed: int, *shape: int) -> np.ndarray:
    counts = np.random.default_rng(seed).integers(0, 30, (*shape, 2, 5, 4))
    counts[..., 0, 2:] = 0
    return counts


@given(st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_weights_are_products_of_smoothed_shares(seed: int) -> None:
    found = LearnedCompletions(counts=drawn_counts(seed))
    assert np.exp(found.log_weights) == pytest.approx(plain_weights(found.counts), rel=1e-9)


def test_final_policies_are_counted_by_what_they_choose() -> None:
    policies = reported.policies()[::3]  # one for each completion
    for number in (0, 100, 300, 511):
        each, found = COMPLETIONS[number], counted(policies[[number, number]])
        assert found.shape == (5, 4)
        assert found[0].tolist() == ([2, 0, 0, 0] if number < 256 else [0, 2, 0, 0])
        for part, status in enumerate(UNSTATED, start=1):
            assert found[part, NUMBER[each[status]]] == found[part].sum() == 2
    assert counted(np.zeros((3, 7, 16), dtype=int))[:, 0].sum() == 0  # neither order


@given(st.integers(0, 2**32), st.floats(0.1, 8))
@settings(max_examples=30, deadline=None)
def test_the_learnable_are_the_fewest_that_hold_nearly_all_of_the_weight(
    seed: int, power: float
) -> None:
    weights = np.random.default_rng(seed).random((2, 40)) ** power
    weights /= weights.sum(axis=1, keepdims=True)
    for row, inside in zip(weights, learnable(np.log(weights)), strict=True):
        assert row[inside].sum() >= 1 - LEFT_OUT - 1e-12
        assert row[inside].sum() - row[inside].min() < 1 - LEFT_OUT
        assert row[~inside].max(initial=0) <= row[inside].min()


def test_draws_are_spread_about_the_weights() -> None:
    drawn = np.exp(ENDS.draws(4000, 1))
    weights = np.exp(ENDS.log_weights)
    likely = np.argsort(-weights)[:5]
    error = drawn[:, likely].std(axis=0) / np.sqrt(4000)
    # A mean of products over a sum is near the product of means, not equal to it.
    assert np.abs(drawn[:, likely].mean(axis=0) - weights[likely]).max() < 5 * error.max() + 0.005
    low, high = ENDS.intervals[0, 2, 3]
    assert low < 104 / 400 < high
    assert (high - low) == pytest.approx(4 * np.sqrt(0.26 * 0.74 / 400), rel=0.05)


def test_what_no_run_ends_with_is_not_learnable() -> None:
    unseen = [
        number
        for number, each in enumerate(COMPLETIONS)
        if each["1001"] == "none" and each["1101"] == "non-directive"
    ]
    assert not ENDS.learnable[unseen].any()
    assert ENDS.learnable.sum() == 11
    assert COMPLETIONS[int(ENDS.log_weights.argmax())]["1101"] == "supportive"


# ---- many readings -----------------------------------------------------------------------------


@pytest.mark.parametrize("concentration", [3.0, 30.0, 300.0])
def test_the_prior_is_as_wide_as_the_readings_differ(concentration: float) -> None:
    rng, mean = np.random.default_rng(7), np.array([0.1, 0.5, 0.1, 0.3])
    counts = np.zeros((200, 2, 5, 4), dtype=int)
    counts[..., 0, :2] = 10
    for place in np.ndindex(200, 2, 4):
        share = rng.dirichlet(concentration * mean)
        counts[(*place[:2], place[2] + 1)] = rng.multinomial(100, share)
    prior = pooled(counts)[:, 1:]
    assert prior / prior.sum(axis=-1, keepdims=True) == pytest.approx(
        np.broadcast_to(mean, (2, 4, 4)), abs=0.05
    )
    assert (prior.sum(axis=-1) > concentration / 2).all()
    assert (prior.sum(axis=-1) < concentration * 2).all()
    assert pooled(counts)[:, 0].sum(axis=-1).min() > 100  # readings that are all alike


def test_a_reading_has_its_own_runs_and_what_others_ended_with() -> None:
    sampled, own = drawn_counts(1, 6), drawn_counts(2, 2)
    found = by_reading(sampled, own, np.array([-1, 1, 0, -1]))
    assert np.array_equal(found[0], found[3])
    prior = pooled(sampled)
    alike = LearnedCompletions(counts=own[1] + prior - np.where(prior > 0, 0.5, 0))
    assert found[1] == pytest.approx(alike.log_weights)
    assert np.exp(found).sum(axis=1) == pytest.approx(1)


def test_every_reading_is_weighed_and_a_pair_of_discounts_alike() -> None:
    study = small_study()
    weights = study.main.log_weights
    assert np.array_equal(weights[::2], weights[1::2])
    assert 0 in study.learned.readings
    again = completion_weights(study.search.space, study.sampled, [study.learned])
    assert np.array_equal(weights, again)
    logs = study.main.total[5] + weights[5]
    assert study.main.marginal[5] == pytest.approx(np.log(np.exp(logs - 5.0).sum()) + 5.0)
    assert study.main.completion[5] == logs.argmax()
    order = study.main.marginal[study.main.ranking]
    assert all(a >= b for a, b in pairwise(order))
    assert study.main.ranking[study.main.rank(3) - 1] == 3


def test_readings_are_drawn_once_each_at_the_first_discount() -> None:
    space = small_search().space
    found = at_random(space, 20, 1)
    assert len(set(found.tolist())) == 20
    assert (found % 2 == 0).all()
    with pytest.raises(ModelError, match="readings"):
        at_random(space, 49, 1)


def test_a_folder_is_read_only_where_all_of_it_is_there(tmp_path: Path) -> None:
    def put(name: str, count: int) -> None:
        (tmp_path / name).mkdir(exist_ok=True)
        for number in range(count):
            (tmp_path / name / f"{number:06d}.npz").touch()

    put("search", 72)
    put("sampled-quick", 6)
    put("learning-quick", 4)
    assert not weighed_before(tmp_path, quick=True)
    put("learning-quick", 5)
    assert weighed_before(tmp_path, quick=True)
    assert not weighed_before(tmp_path, quick=False)
    assert not weighed_before(None, quick=True)


# ---- real runs ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_statuses_settle_independently_in_real_runs() -> None:
    """Permuting each status by itself keeps the shares: the real counts are nothing unusual."""
    reading = default(QUICK)
    rng = np.random.default_rng(0)
    for schedule in ("constant", "decaying"):
        final = reading.learned(schedule).final[:, [int(status, 2) for status in UNSTATED]]

        def dependence(rows: np.ndarray) -> float:
            _, joint = np.unique(rows, axis=0, return_counts=True)
            return float((joint * np.log(joint)).sum())  # grows with dependence, shares fixed

        shuffled = [
            dependence(np.stack([rng.permutation(column) for column in final.T], axis=1))
            for _ in range(400)
        ]
        assert dependence(final) <= np.quantile(shuffled, 0.999)
    counts = reading.completions.counts
    assert counts[:, 1:].sum(axis=-1).tolist() == [[QUICK.runs] * 4] * 2
    assert len(PARTS) == counts.shape[1]
