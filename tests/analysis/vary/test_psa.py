"""Probabilistic sensitivity analysis against independent loops and closed forms."""

import re
from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Scenario,
    evaluate,
    moving,
    parametric,
    psa,
    solve,
    uncertainty,
)

YUAN = Scenario.load("yuan2025")
SMALL = YUAN.with_(tasks=[1], max_trial=2)


@pytest.fixture(scope="module")
def care() -> Any:
    return psa(YUAN, 3000, rng=0, effective_sample_size=20)


def test_every_draw_is_solved_and_every_policy_evaluated_in_it(care: Any) -> None:
    table = care.table
    for d in (0, 17, 2999):
        drawn = dict(zip(care.names, table.points[d].tolist(), strict=True))
        mdp = YUAN.with_(parameters=drawn).compile()
        own = [solve(mdp).start, *(evaluate(mdp, each.weights).start for each in care.candidates)]
        value = [table.optimal[d], *table.fixed[d]]
        for one, error, other in zip(value, table.error[d], own, strict=True):
            assert abs(one - other.value) <= error + other.error


def test_no_candidate_beats_the_optimum_and_evpi_lies_between_its_ends(care: Any) -> None:
    table, evpi = care.table, care.evpi()
    assert (table.fixed - table.optimal[:, None] <= table.error[:, :1] + table.error[:, 1:]).all()
    assert 0 <= evpi.low.value <= evpi.high.value
    assert repr(evpi).endswith(f"(best policy: {evpi.best})")
    assert repr(evpi) == care.report().facts["evpi"].text
    assert care.evpi_of_candidates().value <= evpi.high.value + 1e-9
    best = table.fixed.mean(axis=0).max()
    assert evpi.high.value == pytest.approx(table.optimal.mean() - best)
    for each in care.evppi().values():
        assert each.regression.value <= care.evpi_of_candidates().value + 1e-15
        assert each.reliable == (each.doubts == ())
    regret = care.regret()
    costly = np.argsort(-regret)[:20]  # the draws in which most is lost have their policies
    left = (table.optimal - table.fixed.max(axis=1)).clip(0)
    assert left[costly].mean() < regret[costly].mean() / 2
    first = replace(table, fixed=table.fixed[:, :1], error=table.error[:, :2])
    alone = replace(care, table=first, candidates=care.candidates[:1])
    doubts = alone.evppi({"base.anger": ["base.anger"]})["base.anger"].doubts
    assert any("candidate" in doubt for doubt in doubts)


def test_shares_of_optimal_actions_are_those_of_the_draws(care: Any) -> None:
    share, low, high = care.probability_optimal()
    assert share.shape == (16, 4)
    assert (low <= share).all()
    assert (share <= high).all()
    assert (share.sum(axis=1) >= 1).all()  # ties count for each
    losing = (care.table.lost > 2 * care.table.error[:, :1]).mean(axis=0)
    assert np.allclose(share[0], 1 - losing)


def test_a_policy_that_is_often_best_by_little_is_a_candidate() -> None:
    """Of three wagers on a chance p ~ Beta(1, 1), the middle one is best in an eighth of the draws.

    They pay 0, p - 1/2 and 4 p - 19/8: the draws in which most is lost are all of the third.
    EVPI = ∫ max(0, p - 1/2, 4 p - 19/8) dp = (1/8)² / 2 + (3/8) (1/8 + 13/8) / 2 = 43/128.
    """
    p = F(1, 2)
    rows = [
        (0, 0, [(F(1), 3, F(0))]),
        (0, 1, [(p, 3, F(1, 2)), (1 - p, 1, F(-1, 2))]),
        (0, 2, [(p, 3, F(13, 8)), (1 - p, 2, F(-19, 8))]),
        *((s, 0, [(F(1), 3, F(0))]) for s in (1, 2)),
        (3, 0, [(F(1), 3, F(0))]),
    ]
    moved = moving(MDP.from_outcomes(rows, 1), {"p": [(1, 3), (2, 3)]})
    analysis = psa(moved, 400, rng=5, uncertain=uncertainty(moved, default=2))
    assert len(analysis.candidates) == 3
    rich = [(s, a, [(q, to, r + 10**12 * (s == 0)) for q, to, r in each]) for s, a, each in rows]
    offset = moving(MDP.from_outcomes(rich, 1), {"p": [(1, 3), (2, 3)]})
    low = psa(offset, 400, rng=5, uncertain=uncertainty(offset, default=2)).evpi().low
    assert low.value == pytest.approx(analysis.evpi().low.value, abs=0.01)
    among, evpi, known = analysis.evpi_of_candidates(), analysis.evpi(), analysis.evppi()["p"]
    assert among.value == pytest.approx(evpi.high.value, rel=1e-9)
    assert evpi.low.value == pytest.approx(evpi.high.value)
    for each in (among, evpi.low, evpi.high, known.regression, known.lower):
        assert abs(each.value - 43 / 128) < 4 * each.standard_error


def test_where_weights_alone_are_uncertain_todays_optimum_is_the_best_policy() -> None:
    names = [name for name in YUAN.names if name.startswith("reward.")]
    weights = uncertainty(parametric(YUAN), {"reward": {"relative_sd": 0.5}}, names=names)
    analysis = psa(YUAN, 3000, rng=7, uncertain=weights)
    evpi = analysis.evpi()
    assert 0 < evpi.low.value < evpi.high.value
    assert evpi.best == "optimum today"
    today = solve(YUAN.compile()).start_value
    # By linearity the best policy is today's, whose mean value over the draws is V*(mean).
    fixed = analysis.table.fixed[:, 0]
    assert abs(fixed.mean() - today) < 4 * fixed.std() / len(fixed) ** 0.5
    # The difference of pairs has the same mean as E[V*] - V*(mean), and far less noise.
    assert evpi.high.value == pytest.approx((analysis.table.optimal - fixed).mean())
    assert evpi.high.standard_error < fixed.std() / len(fixed) ** 0.5 / 2
    little = uncertainty(
        parametric(SMALL), {"reward": {"relative_sd": 1e-4}}, names=["reward.trial"]
    )
    for policy in ("optimal", "always:directive"):  # today's optimum is that of every draw
        evpi = psa(SMALL, 400, rng=0, uncertain=little, policy=policy).evpi()
        assert evpi.low.value == evpi.high.value == 0.0
        assert evpi.high.interval == (0.0, 0.0)
    # Around another mean, today's optimum is not the best policy: one other is best in every draw.
    name = "reward.assist.directive"
    far = uncertainty(parametric(YUAN), {name: {"mean": -60, "sd": 1}}, names=[name])
    analysis = psa(YUAN, 100, rng=0, uncertain=far)
    assert analysis.regret().min() > 1
    assert analysis.evpi().low.value == analysis.evpi().high.value == 0.0


def test_workers_and_sample_sizes_change_no_byte(tmp_path: Path) -> None:
    one = psa(SMALL, 9000, rng=0, n_jobs=1)
    two = psa(SMALL, 9000, rng=0, n_jobs=2, folder=tmp_path / "run")
    again = psa(SMALL, 9000, rng=0, n_jobs=1, folder=tmp_path / "run")
    for other in (two, again):
        for name in ("points", "optimal", "fixed", "counts", "lost"):
            assert getattr(one.table, name).tobytes() == getattr(other.table, name).tobytes()
        assert [c.name for c in one.candidates] == [c.name for c in other.candidates]
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").rglob("*.npz")}
    more = psa(SMALL, 9001, rng=0, folder=tmp_path / "run")  # whole pieces are used again
    assert len(more) == 9001
    assert more.table.optimal[:9000].tobytes() == one.table.optimal.tobytes()
    assert sum(path.stat().st_mtime_ns == at for path, at in written.items()) >= 2
    with pytest.raises(ModelError, match="seed"):
        psa(SMALL, 9000, rng=1, folder=tmp_path / "run")
    short = psa(SMALL, np.int64(100), rng=np.uint8(0))  # a count of NumPy is a count
    assert type(short.seed) is int
    assert short.table.optimal.tobytes() == one.table.optimal[:100].tobytes()
    assert psa(SMALL, 100, rng=1).table.optimal.tobytes() != short.table.optimal.tobytes()


def test_a_folder_is_not_used_for_models_that_are_the_same_today_alone(tmp_path: Path) -> None:
    def optima(slope: int) -> np.ndarray:
        model = Family(
            parameters={"x": 1},
            build=lambda at: MDP.from_arrays([[[1]]], [1 + slope * (at["x"] - 1)], "1/2"),
        )
        stated = {"x": {"distribution": "uniform", "low": 0, "high": 2}}
        return psa(model, 30, uncertain=stated, folder=tmp_path).table.optimal

    assert optima(1).tolist() == optima(1).tolist()
    with pytest.raises(ModelError, match="of other work: its record differs in first_draw"):
        optima(5)


def test_a_policy_is_told_by_status_where_it_depends_on_nothing_else() -> None:
    second = SMALL.compile().space.values("trial") == 1
    for policy, expected in (("always:directive", {"directive"}), (second.astype(int), None)):
        actions = psa(SMALL, 5, rng=0, policy=policy).candidates[0].actions
        assert (actions and {*actions.values()}) == expected
        assert actions is None or len(actions) == 16


def test_cut_off_chances_are_counted() -> None:
    sure = YUAN.with_(parameters={"base.anger": "0.9", "influence.disengagement.anger": "0.09"})
    analysis = psa(sure, 2000, rng=8, effective_sample_size=10)
    numbers = dict(zip(analysis.names, analysis.table.points.T, strict=True))
    over = np.zeros(len(analysis), dtype=bool)
    for target in YUAN.statuses:
        others = [name for name in numbers if re.fullmatch(rf"influence\.\w+\.{target}", name)]
        over |= numbers[f"base.{target}"] + np.sum([numbers[each] for each in others], axis=0) > 1
    assert analysis.clipped.value == pytest.approx(over.mean())
    assert analysis.clipped.value > 0.3
    few = psa(YUAN, 32, rng=1).clipped  # that none of 32 is cut off does not show that none ever is
    assert few.value == few.interval[0] == 0 < 0.1 < few.interval[1]


def test_the_random_rows_of_a_model_are_drawn() -> None:
    mdp = MDP.from_arrays([[["1/4", "3/4"], [0, 1]]], [1, 0], "1/2")
    analysis = psa(mdp, 50, rng=0)
    assert analysis.names == ("(state 0, 0): to state 0",)
    stay = analysis.table.points[:, 0]
    assert analysis.table.optimal == pytest.approx(1 / (1 - stay / 2))


def test_a_state_that_cannot_be_reached_makes_no_action_optimal() -> None:
    """In every draw the second action gives up 5, whatever another state is worth."""
    rows = [(0, a, [("1/2", s, gain) for s in (1, 2)]) for a, gain in enumerate((5, 0))]
    rows += [*((s, 0, [(1, 3, 0)]) for s in (1, 2, 3)), (4, 0, [(1, 3, 10**13)])]
    family = moving(MDP.from_outcomes(rows), {"p": [(0, 1)]})
    share, _, _ = psa(family, 20, rng=1).probability_optimal()
    assert np.array(share).tolist() == [[1.0, 0.0]]
