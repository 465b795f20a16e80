"""The settings of the learner: what a falling step settles, what varies, and what is joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from exact_mdp.paper_repro.claims import Verdict, chosen
from exact_mdp.paper_repro.claims.learning import gap_first, optimal_first, taken_first
from exact_mdp.paper_repro.reading import QUICK, Reading, default
from exact_mdp.paper_repro.readings.training import SETTINGS, settings_of
from exact_mdp.solvers import solve

SMALL = replace(QUICK, runs=20, varied=20)


@pytest.fixture(scope="module")
def view() -> Reading:
    return default(SMALL)


def test_a_falling_step_settles_the_first_status(view: Reading) -> None:
    found = chosen("learning.first-status-unsettled").find(view)
    assert found.verdict is Verdict.NOT_DETERMINED  # 40 runs cannot tell 100 % from 95 %
    assert taken_first(view).max() < 0.8 * 40
    assert taken_first(view.falling).tolist() == [0, 0, 40, 0]
    best = solve(view.mdp).policy
    assert optimal_first(view) == {2} == {int(np.asarray(best)[view.mdp.start[0][0]])}
    # What a constant rate leaves is noise: it dwarfs the difference, and a falling step ends it.
    for schedule in SETTINGS:
        kept, fallen = gap_first(view, schedule), gap_first(view.falling, schedule)
        assert kept.std() > 5 > 2 > fallen.std()
        assert 1.2 < fallen.mean() < 2.2


def test_nothing_but_the_step_differs(view: Reading) -> None:
    for schedule, own in SETTINGS.items():
        other = settings_of(schedule, view.falling.training)
        assert replace(other, rate=own.rate, rate_power=own.rate_power) == own
    assert view.falling.key == view.key
    assert view.falling is view.falling
