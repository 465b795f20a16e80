"""Schedules, against the authors' equation."""

from math import exp, log

import numpy as np
import pytest

from exact_mdp import Constant, Exponential, ModelError
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING, as_schedule


@pytest.mark.parametrize(("low", "high", "value", "at"), [(0.03, 1, 0.8, 300), (0.1, 0.9, 0.2, 7)])
def test_a_decay_is_that_of_the_equation(low: float, high: float, value: float, at: int) -> None:
    rate = log((high - low) / (value - low)) / at
    schedule = Exponential.through(value, at=at, minimum=low, maximum=high)
    wanted = [low + (high - low) * exp(-rate * t) for t in range(at + 1)]
    assert schedule.values(at + 1) == pytest.approx(wanted, rel=1e-15)
    assert schedule.values(at + 1)[[0, at]] == pytest.approx([high, value])


@pytest.mark.parametrize(("value", "at"), [(0.03, 300), (1.0, 300), (0.8, 0), (0.8, -1)])
def test_no_decay_passes_through_an_end_or_at_no_time(value: float, at: int) -> None:
    with pytest.raises(ModelError, match="passes through"):
        Exponential.through(value, at=at, minimum=0.03)


def test_the_papers_schedules() -> None:
    assert PAPER_CONSTANT.values(3).tolist() == [0.1] * 3
    values = PAPER_DECAYING.values(301)
    assert (values[0], values[300]) == (1.0, pytest.approx(0.8))
    assert PAPER_DECAYING.minimum == 0.03


def test_a_schedule_stays_between_0_and_1() -> None:
    for good in (0, 1, 0.5, Constant(0.25)):
        assert np.ptp(as_schedule("epsilon", good, 4).values(4)) == 0
    for bad in (-0.1, 1.1, Constant(2.0)):
        with pytest.raises(ModelError, match="between 0 and 1"):
            as_schedule("epsilon", bad, 4)
