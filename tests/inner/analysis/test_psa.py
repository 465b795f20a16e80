"""What probabilistic sensitivity analysis is made of: intervals, EVPPI, drawn rows."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence
from scipy.special import betainc
from scipy.stats import binom, binomtest

from exact_mdp import MDP, ModelError, Scenario, psa, uncertainty
from exact_mdp.analysis.vary.distributions import row_family
from exact_mdp.analysis.vary.information import evpi, evppi
from exact_mdp.analysis.vary.intervals import mean_loss, mean_of, quantiles, wilson
from exact_mdp.analysis.vary.psa import MISSING
from exact_mdp.analysis.vary.study import CareSolver

YUAN = Scenario.load("yuan2025")
SMALL = YUAN.with_(tasks=[1], max_trial=2)


def excess(mean: float, size: float, sure: float) -> float:
    """E[max(p, sure)] for p ~ Beta(mean size, (1 - mean) size)."""
    a, b = mean * size, (1 - mean) * size
    below = betainc(a, b, sure)
    return sure * below + mean * (1 - betainc(a + 1, b, sure))


@pytest.mark.parametrize(("mean", "size", "other"), [(0.3, 8, 0.4), (0.5, 3, 0.5), (0.2, 60, 0.6)])
def test_evppi_of_one_of_two_chances_is_the_closed_form(mean, size, other) -> None:
    rng = np.random.default_rng(3)
    p = rng.beta(mean * size, (1 - mean) * size, size=20_000)
    q = rng.beta(other * 10, (1 - other) * 10, size=len(p))
    values = np.column_stack([p, q])
    found = evppi(values, p[:, None], ("p",))
    exact = excess(mean, size, other) - max(mean, other)
    assert abs(found.regression.value - exact) < 4 * found.regression.standard_error + 1e-9
    assert abs(found.lower.value - exact) < 4 * found.lower.standard_error + 1e-9
    both = evppi(values, values, ("p", "q"))
    whole = evpi(values)
    assert abs(both.regression.value - whole.value) < 4 * whole.standard_error
    assert found.regression.value < both.regression.value + 4 * whole.standard_error


@pytest.mark.parametrize("worth", [0.0, 0.5])
def test_evppi_is_cut_at_evpi_where_the_fit_promises_more(worth: float) -> None:
    """A step that loses, and seldom wins: splines swing above it where nothing is to be won."""
    known = np.linspace(-1, 1, 400)[:, None]
    ahead = np.where(known > 0.3, -1.0, 0.0) + np.where(known > 0.99, 1 + worth, 0.0)
    values = np.hstack([np.zeros_like(known), ahead])
    found, most = evppi(values, known, ("x",)), evpi(values).value
    assert most == pytest.approx(worth * (known > 0.99).mean())
    assert found.regression.value == most
    if worth:
        assert "cut at EVPI of the candidates" in found.doubts


def test_candidates_are_sought_where_most_is_lost_and_evppi_is_at_most_their_evpi() -> None:
    found = psa(YUAN, 3000, rng=3)
    among = found.evpi_of_candidates()
    for each in found.evppi().values():
        assert each.regression.value <= among.value + 1e-15
        assert each.reliable == (each.doubts == ())
    regret = found.regret()
    left = (found.optimal - found.values.max(axis=1)).clip(0)
    top = np.argsort(-regret)[:20]
    assert left[top].mean() < regret[top].mean() / 2  # the costly draws have their policies
    alone = replace(found, values=found.values[:, :1], candidates=found.candidates[:1])
    doubted = alone.evppi({"base.anger": ["base.anger"]})["base.anger"]
    assert (MISSING in doubted.doubts) == (
        2 * found.evpi().low.standard_error < found.evpi().low.value
    )


def test_the_lower_estimate_is_on_average_no_more_than_what_knowing_is_worth() -> None:
    rng, count = np.random.default_rng(1), 400
    lower, regression, doubted = [], [], 0
    for _ in range(150):
        known = rng.choice([-1.0, 1.0], size=(count, 1))
        second = 1 + known + (0.8 * count) ** 0.5 * rng.normal(size=(count, 1))
        found = evppi(np.hstack([np.zeros((count, 1)), second]), known, ("x",))  # worth nothing
        lower.append(found.lower.value)
        regression.append(found.regression.value)
        doubted += not found.reliable
    spread = np.std(lower) / len(lower) ** 0.5
    assert np.mean(lower) < 2 * spread
    assert np.mean(regression) > 0.05  # which noise pulls up
    assert doubted > 100


def test_the_interval_of_a_mean_that_few_draws_carry_covers_more_often_than_the_normal_one() -> (
    None
):
    rng, covered, plain = np.random.default_rng(2), 0, 0
    for _ in range(400):
        values = rng.exponential(size=1000) * (rng.random(1000) < 0.02)
        told = mean_loss(values)
        covered += told.low <= 0.02 <= told.high
        low, high = mean_of(values).interval
        plain += low <= 0.02 <= high
        assert told.few == (values.sum() ** 2 < 50 * (values**2).sum())
    assert plain < 0.93 * 400
    assert 0.93 * 400 < covered <= 400
    even = mean_loss(1 + rng.random(5000))
    assert np.allclose(even.interval, mean_of(1 + np.zeros(5000)).value + 0.5, atol=0.02)
    assert not even.few
    assert mean_loss(np.zeros(9)).interval == (0.0, 0.0)


def test_a_larger_sample_uses_the_folder_of_a_smaller_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    psa(SMALL, 5000, rng=0, folder=tmp_path)
    done: list[int] = []
    solved = CareSolver.solved

    def counting(self: CareSolver, names: object, draws: np.ndarray, *first: int) -> object:
        done.append(len(draws))
        return solved(self, names, draws, *first)

    monkeypatch.setattr(CareSolver, "solved", counting)
    more = psa(SMALL, 6000, rng=0, folder=tmp_path)
    assert done == [6000 - CareSolver.block]
    assert more.values.tobytes() == psa(SMALL, 6000, rng=0).values.tobytes()


def test_intervals_are_those_of_scipy() -> None:
    for successes, count in ((0, 10), (3, 10), (10, 10), (997, 1000)):
        low, high = wilson(successes, count)
        theirs = binomtest(successes, count).proportion_ci(method="wilson")
        assert (float(low), float(high)) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


def test_intervals_of_quantiles_end_at_the_order_statistics_that_they_name() -> None:
    """The ⌊np - z √(np(1-p))⌋-th smallest and the ⌈np + z √(np(1-p))⌉ + 1-th; the ends clipped."""
    half, early = quantiles(np.arange(1.0, 1001.0)[::-1], [0.5, 0.1])
    assert (half.low, half.value, half.high) == (469, 500.5, 532)
    assert (early.low, early.high) == (81, 120)
    for found, p in ((half, 0.5), (early, 0.1)):  # sorted, the k-th smallest is k
        cover = binom.cdf(found.high - 1, 1000, p) - binom.cdf(found.low - 1, 1000, p)
        shorter = binom.cdf(found.high - 2, 1000, p) - binom.cdf(found.low, 1000, p)
        assert shorter < cover
        assert 0.95 <= cover < 0.97
    (least,) = quantiles(np.arange(1.0, 11.0), [0.025])
    assert (least.low, least.high) == (1, 3)


# ---- how often the intervals of an EVPPI cover --------------------------------------------------

STEP = 0.02  # what the second action costs below the step


def quadratic() -> float:
    """E[max((x - 1/2)² - 1/20, 0)] less the mean, 1/30, for x uniform."""
    root = sqrt(0.05)
    return 2 * ((0.5**3 - root**3) / 3 - 0.05 * (0.5 - root)) - 1 / 30


def step(edge: float) -> float:
    """1 above the edge, -0.02 below it, against nothing."""
    gain = 1 - edge
    return gain - max(0.0, gain - STEP * edge)


CASES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "linear": (lambda x: x - 0.4, 0.08),
    "centred": (lambda x: x - 0.5, 0.125),
    "quadratic": (lambda x: (x - 0.5) ** 2 - 0.05, quadratic()),
    "none": (lambda x: 0.0 * x, 0.0),
    "behind": (lambda x: 0.0 * x - 0.2, 0.0),
    "edge 0.9": (lambda x: np.where(x > 0.9, 1.0, -STEP), step(0.9)),
    "edge 0.95": (lambda x: np.where(x > 0.95, 1.0, -STEP), step(0.95)),
    "edge 0.98": (lambda x: np.where(x > 0.98, 1.0, -STEP), step(0.98)),
    "middle": (lambda x: np.where(x > 0.5, 1.0, -1.0), 0.5),
}


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("case", CASES)
def test_intervals_without_doubt_cover(case: str, noise: float) -> None:
    """500 draws, 60 times; 95 % or more is not excluded by Wilson's interval of the share."""
    gain, truth = CASES[case]
    rng = np.random.default_rng(3)
    hits = count = 0
    for _ in range(60):
        x = rng.uniform(size=(500, 1))
        ahead = gain(x) + noise * rng.normal(size=x.shape)
        found = evppi(np.hstack([ahead, 0 * ahead]), x, ("x",))
        low, high = found.regression.interval
        if found.reliable:
            count, hits = count + 1, hits + (low <= truth <= high)
    if count:
        assert wilson(hits, count)[1] >= 0.95


@pytest.mark.parametrize(
    "case, least, most",
    [("edge 0.9", 28, 30), ("edge 0.95", 28, 30), ("edge 0.98", 28, 30), ("middle", 28, 30),
     ("linear", 0, 3)],
)  # fmt: skip
def test_a_step_that_shows_is_doubted_and_a_good_fit_is_not(
    case: str, least: int, most: int
) -> None:
    """Splines round a step off; their residuals beside it add up."""
    gain, _ = CASES[case]
    rng = np.random.default_rng(4)
    doubted = 0
    for _ in range(30):
        x = rng.uniform(size=(500, 1))
        ahead = gain(x) + 0.3 * rng.normal(size=x.shape)
        doubted += not evppi(np.hstack([ahead, 0 * ahead]), x, ("x",)).reliable
    assert least <= doubted <= most


ROW = "(state 0, 0)"
ONE, TWO = f"{ROW}: to state 1", f"{ROW}: to state 2"
FAMILY = row_family(
    MDP.from_arrays([[["1/2", "1/4", "1/4"], ["2/3", "1/3", 0], [0, 0, 1]]], [1, 0, 0])
)


@pytest.mark.parametrize(
    ("stated", "size"),
    [
        ({}, 7.0),
        ({ROW: {"effective_sample_size": 5}}, 5.0),
        ({ONE: {"effective_sample_size": 5}, TWO: {"effective_sample_size": 5}}, 5.0),
        ({ROW: {"effective_sample_size": 5}, ONE: {"effective_sample_size": 5}}, 5.0),
        ({ROW: {"fixed": True}}, None),
        ({ONE: {"fixed": True}, TWO: {"fixed": True}}, None),
    ],
)
def test_what_is_stated_of_a_row_holds_for_all_of_it(stated, size) -> None:
    found = uncertainty(FAMILY, stated, default=7)
    sizes = {part.label: part.size for part in found.parts}
    assert sizes.get(ROW) == size
    assert sizes["(state 1, 0)"] == 7.0
    assert {ONE, TWO} <= (set(found.names) if size else set(found.fixed))
    assert not set(found.names) & set(found.fixed)


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({ONE: {"effective_sample_size": 5}}, "different settings"),
        ({TWO: {"fixed": True}}, "different settings"),
        ({ROW: {"effective_sample_size": 5}, TWO: {"fixed": True}}, "different settings"),
        ({ROW: {"relative_sd": 0.3}}, "are Dirichlet"),
        ({"(state 0, 1)": {"fixed": True}}, "unknown parameter"),
    ],
)
def test_what_does_not_fit_a_row_is_refused(stated, message) -> None:
    with pytest.raises(ModelError, match=message):
        uncertainty(FAMILY, stated)


def test_a_row_is_drawn_whole_or_not_at_all() -> None:
    for names in ([ROW], [ONE, TWO]):
        found = uncertainty(FAMILY, names=names)
        assert found.names == (ONE, TWO)
        assert set(found.fixed) == {"(state 1, 0): to state 1", "reward.1", "discount"}
    for name in (ONE, TWO):
        with pytest.raises(ModelError, match="without the others"):
            uncertainty(FAMILY, names=[name])
    with pytest.raises(ModelError, match="in two rows"):
        uncertainty(replace(FAMILY, rows={"a": (ONE,), "b": (ONE, TWO)}))
    with pytest.raises(ModelError, match="not a probability of a row"):
        uncertainty(replace(FAMILY, rows={"a": ("discount",)}))
    assert {part.kind for part in uncertainty(replace(FAMILY, rows={})).parts} == {"beta"}


def test_rows_of_any_model_are_dirichlet_and_stay_distributions() -> None:
    rows = [
        (0, 0, [(F(1, 2), 0, F(1)), (F(1, 3), 1, F(0)), (F(1, 6), 2, F(2))]),
        (1, 0, [(F(1), 2, F(0))]),
        (2, 0, [(F(1), 2, F(0))]),
    ]
    family = row_family(MDP.from_outcomes(rows, F(9, 10)))
    (names,) = family.rows.values()
    found = uncertainty(family)
    assert [(part.kind, part.label) for part in found.parts] == [("dirichlet", *family.rows)]
    drawn = found.draw(SeedSequence(3), 5)
    for row in drawn.tolist():
        mdp = family.at(dict(zip(names, row, strict=True)))
        chance = {state: p for p, state, _ in mdp.table.row(0)}
        assert sum(chance.values()) == 1
        assert [float(chance[state]) for state in (1, 2)] == pytest.approx(row)


def test_a_model_without_chance_has_nothing_to_draw() -> None:
    with pytest.raises(ModelError, match="no parameter is uncertain"):
        psa(row_family(MDP.from_arrays([[[1]]], [1], "1/2")), 2)


def test_rows_of_floats_that_sum_to_one_but_for_rounding_can_be_drawn() -> None:
    third = 1 / 3
    outcomes = [(third, 0, 0.0), (0.1, 1, 1.0), (1 - third - 0.1 + 1e-16, 2, 0.0)]
    ends = [(state, 0, [(1.0, state, 0.0)]) for state in (1, 2)]
    mdp = MDP.from_outcomes([(0, 0, outcomes), *ends], 0.9)
    family = row_family(mdp)
    (names,) = family.rows.values()
    drawn = uncertainty(family).draw(SeedSequence(4), 3)
    for row in drawn.tolist():
        chances = [p for p, _, _ in family.at(dict(zip(names, row, strict=True))).table.row(0)]
        assert sum(chances) == 1
