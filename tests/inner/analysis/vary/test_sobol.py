"""Sobol indices against scipy's estimators and loops over the draws."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from refusal_tables import refused
from scipy import stats

from exact_mdp import MDP, Family, ModelError, sobol
from exact_mdp.analysis.vary.ranges import Range
from exact_mdp.analysis.vary.sobol import (
    _build_design,
    _compute_indices,
    _estimate_indices,
)
from exact_mdp.solvers.claims import NORMAL

SPANS = [
    Range(low=-1, high=3),
    Range(low=Fraction(1, 3), high=Fraction(1, 2)),
    Range(low=0, high=8),
]
FUNCTIONS = (
    lambda x: x[0] + 2 * x[1] - x[2],
    lambda x: x[0] * x[1] + x[2] ** 2,
    lambda x: np.sin(x[0]) + 7 * np.cos(x[2]),
)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("n", [2, 64])
def test_the_design_exchanges_one_column_of_each_point_at_a_time(count: int, n: int) -> None:
    spans = SPANS[:count]
    draws = _build_design(spans, n, np.random.default_rng(0)).reshape(n, count + 2, count)
    points = stats.qmc.Sobol(2 * count, rng=np.random.default_rng(0)).random(n)
    low, high = np.array([[float(s.low), float(s.high)] for s in spans]).T
    a, b = low + points[:, :count] * (high - low), low + points[:, count:] * (high - low)
    assert np.array_equal(draws[:, 0], a)
    assert np.array_equal(draws[:, -1], b)
    for k in range(count):
        wanted = a.copy()
        wanted[:, k] = b[:, k]
        assert np.array_equal(draws[:, k + 1], wanted)
    assert np.all((draws >= low) & (draws <= high))


def test_no_draw_is_beyond_the_end_of_its_range() -> None:
    """low + u (high - low) may round to more than high."""
    span = Range(low=Fraction(-1, 3), high=Fraction(1, 10**17))
    draws = _build_design([span] * 2, 4096, np.random.default_rng(0))
    assert float(span.low) <= draws.min()
    assert draws.max() <= float(span.high)


@pytest.mark.parametrize("seed", range(4))
def test_indices_are_those_of_scipy(seed: int) -> None:
    rng, count, n = np.random.default_rng(seed), 3, 32
    points = _build_design(SPANS, n, rng)
    for function in FUNCTIONS:
        output = function(points.T).reshape(n, count + 2)
        a, ab, b = output[:, 0], output[:, 1:-1].T, output[:, -1]
        found = _compute_indices(output)
        wanted = stats.sobol_indices(
            n=n, func={"f_A": a[None], "f_B": b[None], "f_AB": ab[:, None, :]}
        )
        assert found[0] == pytest.approx(wanted.first_order.ravel())
        assert found[1] == pytest.approx(wanted.total_order.ravel())


@pytest.mark.parametrize("seed", range(6))
def test_indices_are_means_over_points_and_their_intervals_a_bootstrap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, count = int(rng.integers(2, 20)), int(rng.integers(1, 4))
    output, resamples = rng.normal(3, 2, (n, count + 2)), rng.integers(n, size=(50, n))

    def shares(rows: np.ndarray) -> np.ndarray:
        both = [row[0] for row in rows] + [row[-1] for row in rows]
        mean = sum(both) / len(both)
        variance = sum((each - mean) ** 2 for each in both) / len(both)
        first = [
            sum((row[-1] - mean) * (row[k] - row[0]) for row in rows) / n / variance
            for k in range(1, count + 1)
        ]
        total = [
            sum((row[k] - row[0]) ** 2 for row in rows) / n / (2 * variance)
            for k in range(1, count + 1)
        ]
        return np.array([first, total])

    found, (first, total) = _estimate_indices(output, 0.0, resamples), shares(output)
    assert found.first == pytest.approx(first)
    assert found.total == pytest.approx(total)
    both = np.concatenate([output[:, 0], output[:, -1]])
    assert (found.mean, found.sd) == pytest.approx((both.mean(), np.std(both, ddof=1)))
    varied = [rows for rows in output[resamples] if len({*rows[:, 0], *rows[:, -1]}) > 1]
    one, other = NORMAL * np.std([shares(rows) for rows in varied], axis=0, ddof=1)
    assert found.first_half == pytest.approx(one)
    assert found.total_half == pytest.approx(other)
    assert not found.constant


def test_an_output_that_does_not_vary_has_no_indices() -> None:
    resamples = np.random.default_rng(0).integers(4, size=(9, 4))
    output = np.full((4, 4), 2.0)
    output[:, 1] = [1, 2, 3, 4]  # between the halves nothing counts
    for noise in (0.0, 1e-9):
        found = _estimate_indices(output, noise, resamples)
        assert (found.mean, found.sd, found.constant) == (2, 0, True)
        for each in (found.first, found.first_half, found.total, found.total_half):
            assert each.shape == (2,)
            assert np.isnan(each).all()
    output[0, 0] += 2.0**-10
    assert _estimate_indices(output, 2.0**-10, resamples).constant
    assert not _estimate_indices(output, 2.0**-11, resamples).constant


def test_resamples_that_do_not_vary_are_left_out_and_one_alone_has_no_spread() -> None:
    output = np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    flat, one, other = [1, 2, 1], [0, 1, 2], [0, 0, 1]
    two = _estimate_indices(output, 0.0, np.array([flat, one, other]))
    same = _estimate_indices(output, 0.0, np.array([one, other]))
    assert two.first_half.tolist() == same.first_half.tolist()
    assert two.total_half.tolist() == same.total_half.tolist()
    single = _estimate_indices(output, 0.0, np.array([flat, one]))
    assert np.isnan(single.first_half).all()
    assert np.isfinite(single.first).all()


# ---- models --------------------------------------------------------------------------------------


def built(at: Any) -> MDP:
    """One step, in which the first action pays x + y z and the second z."""
    x, y, z = (at[name] for name in ("x", "y", "z"))
    return MDP.from_outcomes(
        [(0, 0, [(1, 1, x + y * z)]), (0, 1, [(1, 1, z)]), (1, 0, [(1, 1, 0)])], discount="1/2"
    )


WORTH = {"x": 1, "y": 2, "z": 3}
MODEL = Family(parameters=WORTH, build=built)
RANGES: dict[str, Any] = {"y": (-1, 1), "x": (0, 2), "z": (0, "1/2")}


def test_a_model_is_solved_at_each_point_of_the_design() -> None:
    n, held = 16, [1, 0]
    found = sobol(MODEL, ranges=RANGES, n=n, rng=5, policy=held)
    spans = [Range(low=low, high=high) for low, high in RANGES.values()]
    child = np.random.SeedSequence(5).spawn(2)
    points = _build_design(spans, n, np.random.default_rng(child[0]))
    y, x, z = points.T
    values = {"optimal": np.maximum(x + y * z, z), "fixed": z,
              "regret": np.maximum(x + y * z - z, 0)}  # fmt: skip
    resamples = np.random.default_rng(child[1]).integers(n, size=(200, n))
    for name, value in values.items():
        wanted, indices = _estimate_indices(value.reshape(n, -1), 0.0, resamples), found.of(name)
        for part in ("mean", "sd", "first", "first_half", "total", "total_half"):
            assert getattr(indices, part) == pytest.approx(getattr(wanted, part), abs=1e-9), part
    assert found.names == ("y", "x", "z")
    assert (found.n, found.draws, found.seed) == (16, 80, 5)
    assert found.model == "model"
    said = "=unknown output 'value'", "=output", "choose one of optimal, fixed, regret"
    refused(lambda: found.of("value"), *said)
    again = sobol(MODEL, ranges=RANGES, n=n, rng=6, policy=held)
    assert again.optimal.mean != found.optimal.mean


def test_an_optimum_that_is_held_has_no_regret_to_explain() -> None:
    """Today's optimum pays x + y z, which is the most at each point of these ranges."""
    found = sobol(MODEL, ranges={"x": (1, 2), "y": (2, 3)}, n=8)
    assert found.regret.constant
    assert (found.regret.mean, found.regret.sd) == (0, 0)
    assert not found.optimal.constant
    assert np.array_equal(found.optimal.first, found.fixed.first)
    tables = found.report().tables
    assert len(tables["shares of regret"].rows) == 0
    assert len(tables["shares of optimal"].rows) == 2
    assert f"n 8; optimum {found.optimal.mean:.6g}, sd {found.optimal.sd:.3g}" in repr(found)


def test_tables_have_the_indices_the_largest_total_first() -> None:
    found = sobol(MODEL, ranges=RANGES, n=32, rng=0, policy=[0, 0])
    for output in ("optimal", "regret", "fixed"):
        frame, indices = found.frame(output), found.of(output)
        columns = ["first order (share of variance)", "first order ±",
                   "total (share of variance)", "total ±"]  # fmt: skip
        rows = sorted(
            zip(found.names, indices.first, indices.first_half, indices.total, indices.total_half,
                strict=True),
            key=lambda row: -row[3],
        )  # fmt: skip
        assert frame["parameter"].tolist() == [row[0] for row in rows]
        assert frame.index.tolist() == [0, 1, 2]
        assert [*frame] == ["parameter", "unit", "low", "high", *columns, "claim"]
        assert frame[columns].to_numpy().tolist() == [[*row[1:]] for row in rows]
        spans = {"x": (0, 2), "y": (-1, 1), "z": (0, 0.5)}
        assert [*zip(frame["low"], frame["high"], strict=True)] == [spans[row[0]] for row in rows]
    facts = found.report().facts
    told = facts["total_interval"].value
    ends = [found.optimal.total - found.optimal.total_half,
            found.optimal.total + found.optimal.total_half]  # fmt: skip
    assert np.array([told[name] for name in found.names]) == pytest.approx(np.transpose(ends))
    assert [*facts["first_order"].value.values()] == pytest.approx(found.optimal.first.tolist())
    assert [*facts["total"].value.values()] == pytest.approx(found.optimal.total.tolist())
    lost = facts["regret"].value
    assert (lost["mean"], lost["sd"]) == (found.regret.mean, found.regret.sd)
    assert [*lost["first_order"].values()] == pytest.approx(found.regret.first.tolist())
    assert (facts["draws"], facts["samples"], facts["confidence"]) == (160, 32, 0.95)
    assert facts["ranges"].value == {"y": [-1, 1], "x": [0, 2], "z": [0, 0.5]}


def test_parameters_that_explain_as_much_keep_their_order() -> None:
    names = [f"x{k}" for k in range(40)]
    model = Family(parameters=dict.fromkeys(names, 1), build=lambda at: built(WORTH))
    found = sobol(model, n=2)
    assert found.frame()["parameter"].tolist() == names
    totals = np.arange(40) % 3 / 2
    other = replace(found, optimal=replace(found.optimal, total=totals))
    assert other.frame()["parameter"].tolist() == names[2::3] + names[1::3] + names[::3]


def test_rewards_per_step_have_indices_too() -> None:
    """x is earned in each step, but not in one after it with chance z: x / (1 + z)."""

    def build(at: Any) -> MDP:
        x, z = at["x"], at["z"]
        rows = [(0, 0, [(z, 1, x), (1 - z, 0, x)]), (1, 0, [(1, 0, 0)])]
        return MDP.from_outcomes(rows, discount="1/2")

    model = Family(parameters={"x": 1, "z": Fraction(1, 2)}, build=build)
    found = sobol(model, ranges={"x": (1, 2), "z": (0, 1)}, n=16, criterion="average")
    child = np.random.SeedSequence(0).spawn(2)  # 0 is the seed unless one is given
    spans = [Range(low=1, high=2), Range(low=0, high=1)]
    x, z = _build_design(spans, 16, np.random.default_rng(child[0])).T
    resamples = np.random.default_rng(child[1]).integers(16, size=(200, 16))
    wanted = _estimate_indices((x / (1 + z)).reshape(16, -1), 0.0, resamples)
    assert found.seed == 0
    assert found.optimal.mean == pytest.approx(wanted.mean)
    for part in ("first", "first_half", "total", "total_half"):
        assert getattr(found.optimal, part) == pytest.approx(getattr(wanted, part), abs=1e-9)
    assert found.report().facts["criterion"].value == "average"


def test_how_work_is_done_is_told_to_the_study(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def note(*_: Any, **how: Any) -> None:
        asked.append(how)
        raise ModelError("enough")

    monkeypatch.setattr("exact_mdp.analysis.vary.sobol.study", note)
    usual = {"n_jobs": 1, "folder": None, "progress": False}
    for how in ({}, {"n_jobs": None, "folder": "here", "progress": True}):
        with pytest.raises(ModelError, match="enough"):
            sobol(MODEL, n=2, **how)
        assert asked.pop() == {"criterion": "total"} | usual | how


def test_names_and_shares_choose_what_varies_and_samples_are_powers_of_2() -> None:
    found = sobol(MODEL, names=["z"], relative=Fraction(1, 2), n=2)
    assert found.names == ("z",)
    assert [(float(r.low), float(r.high)) for r in found.spans.values()] == [(1.5, 4.5)]
    for n, near in ((3, "2 or 4"), (6, "4 or 8"), (1000, "512 or 1024")):
        with pytest.raises(ModelError, match=f"{n} samples") as error:
            sobol(MODEL, ranges=RANGES, n=n)
        assert error.value.fix == f"ask for {near}"
    for wrong in (1, 0, 2.5):
        with pytest.raises(ModelError, match="n"):
            sobol(MODEL, ranges=RANGES, n=wrong)
    with pytest.raises(ModelError, match="fewer samples"):
        sobol(MODEL, ranges=RANGES, n=2**40)


@pytest.mark.parametrize("names", [["x"], ["x", "y", "z"]])
def test_room_is_asked_for_all_points_of_1024_samples(
    names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def note(count: int, parameters: int, fix: str) -> None:
        asked.append((count, parameters))
        raise ModelError("full", where="here", fix=fix)

    monkeypatch.setattr("exact_mdp.analysis.vary.sobol.require_room_for_points", note)
    with pytest.raises(ModelError, match="full"):
        sobol(MODEL, names=names)
    assert asked == [(1024 * (len(names) + 2), len(names))]
