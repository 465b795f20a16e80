"""The settings of the learner: what a falling step settles, what varies, and what is joint."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exact_mdp.paper_repro.claims import Verdict, chosen, judge
from exact_mdp.paper_repro.claims.learning import (
    gap_first,
    optimal_first,
    shown_together,
    taken_first,
)
from exact_mdp.paper_repro.reading import QUICK, Reading, default
from exact_mdp.paper_repro.readings.learner import LEARNERS, POINTS, prior
from exact_mdp.paper_repro.readings.training import SETTINGS, settings_of
from exact_mdp.solvers import solve
from exact_mdp.solvers.learning.q_learning import TrainingRun

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


# ---- settings as readings ----------------------------------------------------------------------


def test_each_set_of_settings_is_another_learner_and_weights_add_up() -> None:
    assert sum(each.weight for each in LEARNERS) == pytest.approx(1)
    for point, options in POINTS.items():
        assert sum(prior(point, option) for option in options) == pytest.approx(1)
        assert not options[0].changes
    default, *others = LEARNERS
    assert default.label == "default"
    known = [dict(each.changes) for each in LEARNERS]
    assert all(known.count(each) == 1 for each in known)
    for each in others:
        settings_of("decaying", each.changes)  # is accepted
    program = others[-1]
    assert program.changes == {"bootstrap_end": True, "ties": "random"}
    assert program.weight == max(each.weight for each in LEARNERS)
    # By hand: 3/4 and 3/5 for what it does, 1/4 and 1/5 for the default.
    assert program.weight / default.weight == pytest.approx((0.75 * 0.6) / (0.25 * 0.2))


def test_epsilon_falls_as_it_is_told() -> None:
    assert settings_of("decaying", {"decay_at": 300.0}) == SETTINGS["decaying"]
    fast = settings_of("decaying", {"decay_at": 10.0}).exploration.values(6000)
    assert fast[[0, 10]] == pytest.approx([1, 0.8])
    assert fast[-1] == pytest.approx(0.03)
    assert settings_of("constant", {"decay_at": 10.0}) == SETTINGS["constant"]


@pytest.fixture(scope="module")
def short(view: Reading) -> Reading:
    return replace(view, training={"epochs": 150})


def test_the_last_policies_may_be_those_of_epochs(short: Reading) -> None:
    by_epochs = short.taught("epochs", runs=20, counted="epochs")
    for run, other in zip(
        short.learned("constant").runs, by_epochs.learned("constant").runs, strict=True
    ):
        kept = [run.policies[number].tolist() for number in run.snapshots[-100:-1]]
        assert [other.policies[number].tolist() for number in other.last[:-1]] == kept[-99:]
        assert other.final.tolist() == run.final.tolist()
        assert len(other.last) == 100


def test_settings_are_counted_beside_the_default(short: Reading) -> None:
    others = [short.taught(f"epochs {n}", runs=20, epochs=n) for n in (20, 40)]
    claims = [chosen("learning.unique.constant"), chosen("table3.base.anger")]
    learned, table = judge(claims, short, learners=others)
    assert learned.others is not None
    assert learned.others.tried == 3
    assert "settings of the learner" in learned.others.text
    assert table.others is None


# ---- what is joint -----------------------------------------------------------------------------


def plain_pair(first: TrainingRun, second: TrainingRun) -> list[bool]:
    """What a pair of runs shows, spelled out."""
    one, two = (
        [run.policies[n].tolist() for n in set(run.last.tolist())] for run in (first, second)
    )
    every = one + two

    def elsewhere(policies: list[list[int]]) -> int:
        return len({tuple(policy[1:]) for policy in policies})

    a, b = first.final.tolist(), second.final.tolist()
    return [
        (len(one), len(two)) == (3, 2),
        elsewhere(one) == elsewhere(two) == 1,
        {policy[0] for policy in every} == {1, 2, 3},
        a[0] != b[0],
        a[1:] == b[1:],
        all(policy[s] == 1 for policy in every for s in (2, 3, 6, 7, 10, 11, 14, 15)),
        all(p[12] == 3 and {p[8], p[4]} == {2, 3} for p in every),
    ]


def test_pairs_are_judged_as_spelled_out(short: Reading) -> None:
    runs, others = (short.learned(schedule).runs for schedule in SETTINGS)
    parts = list(shown_together(short).values())
    seen = set()
    for i, first in enumerate(runs):
        for j, second in enumerate(others):
            shown = plain_pair(first, second)
            assert [bool(part[i, j]) for part in parts] == shown
            seen |= {(k, each) for k, each in enumerate(shown)}
    assert len(seen) >= 9  # parts that hold in some pairs and not in others


def test_a_pair_like_the_papers_is_seen() -> None:
    rest = [1, 1, 1, 3, 1, 1, 1, 2, 1, 1, 1, 3, 1, 1, 1]

    def run(*starts: int) -> TrainingRun:
        policies = np.array([[start, *rest] for start in starts], dtype=np.int16)
        return TrainingRun(
            space=None, q=np.zeros((16, 4)), policies=policies, snapshots=np.zeros(1, np.int32),
            last=np.arange(len(starts), dtype=np.int32), returns=np.zeros(1), steps=0, cut_short=0,
        )  # fmt: skip

    class Stub:
        def learned(self, schedule: str) -> SimpleNamespace:
            runs = [run(1, 3, 2), run(1, 2)] if schedule == "constant" else [run(2, 3)] * 2
            return SimpleNamespace(runs=runs, final=np.array([each.final for each in runs]))

    held = np.logical_and.reduce(list(shown_together(Stub()).values()))
    assert held.tolist() == [[True, True], [False, False]]


@pytest.mark.parametrize("apart", [0.0, 2.0, -7.0, 7.0])
def test_how_far_the_schedules_are_apart_is_told_as_it_is(apart: float) -> None:
    """Twice the standard error of 40 experiments of standard deviation 20 is 6.3."""
    values = {"constant": np.array([139.0, 141.0]), "decaying": np.array([139.0, 141.0]) + apart}
    stub: Any = SimpleNamespace(
        learned=lambda schedule: SimpleNamespace(converged=values[schedule]),
        evaluations={"optimal": SimpleNamespace(sd=20.0)},
    )
    found = chosen("learning.similar").find(stub)
    alike = abs(apart) < 6
    assert found.verdict is (Verdict.REPRODUCED if alike else Verdict.NOT_REPRODUCED)
    assert found.shown == f"{apart:+.2f} points apart".replace("-", "−")
    assert ("at most twice" in found.why) == alike == ("more than twice" not in found.why)
