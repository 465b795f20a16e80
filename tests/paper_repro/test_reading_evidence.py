"""Likelihoods, rankings and joint statements, against plain loops and normal distributions."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from math import exp, log, sqrt

import numpy as np
import pytest
from reading_cases import ENDS, SMALL, small_search
from reading_twin import moments_of
from scipy.stats import norm

from exact_mdp.mdp import ModelError
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import (
    ALIKE,
    STATEMENTS,
    VARIANTS,
    Joint,
    contradictions,
    distances,
    evidence,
    joint,
    largest_possible,
    variants,
)
from exact_mdp.paper_repro.reported import STARTS, policies


def plain_log_likelihood(
    mean: np.ndarray, variance: np.ndarray, random: float, experiments: int
) -> float:
    """The likelihood of one reading and completion, spelled out."""
    total = 0.0
    for start, m, v in zip(STARTS, mean, variance, strict=True):
        x, s = reported.AVERAGE_RETURN[start], sqrt(v / experiments)
        total += log((norm.cdf(x + 0.05, m, s) - norm.cdf(x - 0.05, m, s)) / 0.1)
    total += norm.logpdf(70, random, 5) + norm.logpdf(140, np.mean(mean), 5)
    return float(total)


@pytest.mark.parametrize("experiments", [1_000, 10_000])
def test_the_likelihood_is_that_of_rounded_averages(experiments: int) -> None:
    found = evidence(small_search(), experiments=experiments)
    search, checked = found.search, 0
    for reading in range(0, len(SMALL), 7):
        for completion in range(0, 512, 23):
            mean, variance = search.mean[reading, completion], search.variance[reading, completion]
            # Far out, the difference of two distribution functions loses its digits.
            if np.abs(search.averages.score[reading, completion]).max() < 5 * sqrt(
                1_000 / experiments
            ):
                plain = plain_log_likelihood(
                    mean, variance, float(search.random_mean[reading]), experiments
                )
                assert found.total[reading, completion] == pytest.approx(plain, rel=1e-7)
                checked += 1
    assert checked > 3


def test_far_out_the_likelihood_is_the_normal_density() -> None:
    found = evidence(small_search())
    search = found.search
    far = np.unravel_index(int(found.averages.argmin()), found.averages.shape)
    mean, spread = search.mean[far], np.sqrt(search.variance[far] / found.experiments)
    reported_ = np.array([reported.AVERAGE_RETURN[start] for start in STARTS])
    density = norm.logpdf(reported_, mean, spread).sum()
    assert density < -500
    assert found.averages[far] == pytest.approx(density, rel=0.02)
    assert np.isfinite(found.total).all()


def test_the_best_completion_is_the_likeliest_and_marginal_the_average() -> None:
    found = evidence(small_search())
    for reading in (0, 5, 50):
        logs = found.total[reading]
        assert logs.max() == logs[found.completion[reading]]
        shift = logs.max()
        average = shift + log(np.mean([exp(x - shift) for x in logs]))
        assert found.marginal[reading] == pytest.approx(average)
    assert found.weights.sum() == pytest.approx(1)
    assert (np.diff(found.weights[found.ranking]) <= 0).all()


def test_the_ranking_is_that_of_the_twin() -> None:
    """Readings evaluated by matrices of their own, scored by SciPy's normal distribution."""
    search = small_search()
    found = evidence(search)
    chosen = [*found.ranking[:6].tolist(), *found.ranking[20:60:13].tolist()]
    logs = []
    for number in chosen:
        mean, variance = (m.reshape(-1, 3) for m in moments_of(SMALL.settings(number), policies()))
        x = np.array([reported.AVERAGE_RETURN[start] for start in STARTS])
        s = np.sqrt(variance / 1_000)
        mass = norm.sf((np.abs(x - mean) - 0.05) / s) - norm.sf((np.abs(x - mean) + 0.05) / s)
        total = np.log(np.maximum(mass, 1e-300) / 0.1).sum(axis=1)
        total += norm.logpdf(140, mean.mean(axis=1), 5)
        logs.append(np.log(np.exp(total).mean()) + norm.logpdf(70, search.random_mean[number], 5))
    assert logs == pytest.approx(found.marginal[chosen], abs=1e-6)
    assert logs == sorted(logs, reverse=True)


def test_equivalent_readings_are_equally_likely() -> None:
    found = evidence(small_search())
    first = found.search.equivalent()
    assert found.marginal == pytest.approx(found.marginal[first], abs=1e-6)


def test_completions_are_weighed_with_the_readings_averaged_out() -> None:
    found = evidence(small_search())
    joined = np.exp(found.total - found.total.max())
    swapped = joined[:, 256:].sum() / joined.sum()
    support = {(each.reading, each.option): each.weight for each in found.completion_support()}
    assert support["respectively", "swapped"] == pytest.approx(swapped)
    supportive = [each["0001"] == "supportive" for each in found.search.completions]
    assert support["0001", "supportive"] == pytest.approx(
        joined[:, supportive].sum() / joined.sum()
    )


def test_variants_are_the_evidence_with_their_settings() -> None:
    weights = np.broadcast_to(ENDS.log_weights, small_search().mean.shape[:2])
    found = variants(evidence(small_search(), log_weights=weights))
    assert list(found) == [*VARIANTS, ALIKE]
    assert all((each.log_weights is None) == (name == ALIKE) for name, each in found.items())
    alone = found["the three averages alone"]
    assert np.array_equal(alone.total, alone.averages)
    ten = found["10,000 experiments, tolerance 5"]
    assert np.array_equal(ten.averages, evidence(small_search(), experiments=10_000).averages)
    wide = found["tolerance 20 for the random strategy"]
    assert wide.random == pytest.approx(norm.logpdf(70, small_search().random_mean, 20))


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ModelError, match="experiments"):
        evidence(small_search(), experiments=0)
    with pytest.raises(ModelError, match="random_tolerance"):
        evidence(small_search(), random_tolerance=0.0)


def few_completions() -> list[int]:
    return list(range(0, 512, 41))


def test_joint_scores_are_the_least_of_the_worst() -> None:
    search = small_search()
    kept = few_completions()
    small = replace(
        search,
        completions=tuple(search.completions[k] for k in kept),
        mean=search.mean[:, kept],
        variance=search.variance[:, kept],
    )
    found = evidence(small)
    parts = distances(found)
    sets = joint(found)
    assert len(sets) == 2 ** len(STATEMENTS) - 1
    assert [len(each.statements) for each in sets] == sorted(len(s.statements) for s in sets)
    for each in sets[::9]:
        worst = np.max([parts[name] for name in each.statements], axis=0)
        assert each.score == pytest.approx(worst.min(), rel=1e-6)
        assert worst[each.reading, each.completion] == pytest.approx(each.score, rel=1e-6)
        assert each.readings == (worst.min(axis=1) <= 3).sum()


def test_distances_are_in_standard_deviations() -> None:
    found = evidence(small_search())
    parts, search = distances(found), found.search
    for reading, completion in ((0, 0), (30, 400)):
        mean = search.mean[reading, completion]
        error = search.variance[reading, completion] / 1_000
        s = np.sqrt(error + 0.1**2 / 12)
        for place, name in enumerate(("a2", "a3", "a1")):
            off = abs(mean[place] - reported.AVERAGE_RETURN[STARTS[place]]) / s[place]
            assert parts[name][reading, completion] == pytest.approx(off)
        lacking = max(
            (mean[1] - mean[0]) / sqrt(error[0] + error[1]),
            (mean[2] - mean[1]) / sqrt(error[1] + error[2]),
            0.0,
        )
        assert parts["ranking"][reading, completion] == pytest.approx(lacking)
        random = abs(search.random_mean[reading] - 70) / 5
        assert parts["random"][reading, completion] == pytest.approx(random)
        lost = (search.optimum[reading] - mean[0]) / sqrt(error[0])
        assert parts["optimal"][reading, completion] == pytest.approx(lost)
        assert parts["respectively"][reading, completion] == (0 if completion < 256 else np.inf)


def test_contradictions_are_the_smallest_and_possible_sets_the_largest() -> None:
    scores = {"a2": 1.0, "a3": 2.0, "a1": 4.0, "random": 2.5}

    def score(names: tuple[str, ...]) -> float:
        return 5.0 if {"a2", "random"} <= set(names) else max(scores[name] for name in names)

    sets = [
        Joint(statements=names, score=score(names), reading=0, completion=0, readings=1)
        for size in range(1, 5)
        for names in combinations(scores, size)
    ]
    assert [each.statements for each in contradictions(sets)] == [("a1",), ("a2", "random")]
    assert [each.statements for each in largest_possible(sets)] == [("a2", "a3"), ("a3", "random")]
