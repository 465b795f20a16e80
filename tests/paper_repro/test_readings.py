"""Weights, Bayes factors and equivalences of readings, against hand calculations."""

from __future__ import annotations

import numpy as np
import pytest

from exact_mdp.analysis.readings import (
    ReadingSpace,
    credible,
    effective_number,
    equivalent,
    posterior,
    support,
)
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.care.tables import READINGS

SPACE = ReadingSpace(
    options={"status_cost": ("next", "current"), "tasks": ((3,), (6,), (2,)), "discount": (1, 0.9)}
)


def test_the_last_reading_moves_fastest_and_the_first_is_the_default() -> None:
    assert len(SPACE) == 12
    assert SPACE.settings(0) == {"status_cost": "next", "tasks": (3,), "discount": 1}
    assert SPACE.settings(1)["discount"] == 0.9
    assert SPACE.codes.shape == (12, 3)
    for number, code in enumerate(SPACE.codes.tolist()):
        chosen = [SPACE.options[name][k] for name, k in zip(SPACE.names, code, strict=True)]
        assert list(SPACE.settings(number).values()) == chosen
        assert SPACE.number(**SPACE.settings(number)) == number


def test_a_reading_is_applied_to_a_scenario() -> None:
    base = Scenario.load("yuan2025")
    space = ReadingSpace(
        options={**READINGS, "tasks": ((3,), (6,)), "evaluation_discount": ("1", "19/20")}
    )
    last = space.apply(base, len(space) - 1)
    assert dict(last.readings) == {name: options[-1] for name, options in READINGS.items()}
    assert last.tasks == (6,)
    assert float(last.discount) == 0.95
    assert space.apply(base, 0) == base


@pytest.mark.parametrize("wrong", [-1, 12])
def test_readings_that_there_are_not_are_refused(wrong: int) -> None:
    with pytest.raises(ModelError, match="no reading"):
        SPACE.settings(wrong)


def test_unknown_options_are_refused() -> None:
    with pytest.raises(ModelError, match="no option"):
        SPACE.number(tasks=(7,))
    with pytest.raises(ModelError, match="no option"):
        SPACE.number(weather="fine")
    with pytest.raises(ModelError, match="has no option"):
        ReadingSpace(options={"tasks": ()})


def test_weights_are_likelihoods_over_their_sum_far_out_too() -> None:
    logs = np.log([1.0, 2.0, 5.0])
    assert posterior(logs) == pytest.approx([0.125, 0.25, 0.625])
    assert posterior(logs - 5000) == pytest.approx([0.125, 0.25, 0.625])
    assert effective_number(np.full(7, 1 / 7)) == pytest.approx(7)
    assert credible(np.array([0.1, 0.6, 0.3]), 0.9).tolist() == [1, 2]
    assert credible(np.array([0.1, 0.6, 0.3]), 1.0).tolist() == [1, 2, 0]


def test_support_is_the_ratio_of_mean_likelihoods() -> None:
    rng = np.random.default_rng(3)
    likelihood = rng.random(12) ** 4
    found = {(each.reading, each.option): each for each in support(SPACE, np.log(likelihood))}
    for column, (name, options) in enumerate(SPACE.options.items()):
        means = [likelihood[SPACE.codes[:, column] == k].mean() for k in range(len(options))]
        for mean, option in zip(means, options, strict=True):
            each = found[name, option]
            assert each.weight == pytest.approx(mean / sum(means))
            assert 10**each.log10_against == pytest.approx(max(means) / mean)


@pytest.mark.parametrize(
    ("factor", "best", "other"),
    [
        (2.9, "not identified", "open"),
        (3.1, "favoured", "less likely"),
        (21, "identified", "disfavoured"),
        (151, "identified", "excluded"),
    ],
)
def test_words_follow_the_thresholds(factor: float, best: str, other: str) -> None:
    space = ReadingSpace(options={"a": ("x", "y")})
    assert [each.verdict for each in support(space, np.log([1, factor]))] == [other, best]


def test_equal_rows_are_found_whatever_their_order() -> None:
    rng = np.random.default_rng(0)
    kinds = rng.normal(size=(5, 4))
    kinds[1, 0] = kinds[0, 0]  # the first number alone does not decide
    which = rng.integers(0, 5, 40)
    values = kinds[which] + rng.uniform(-1e-12, 1e-12, (40, 4))
    first = [int(np.flatnonzero(which == kind)[0]) for kind in which]
    assert equivalent(values, 1e-9).tolist() == first
