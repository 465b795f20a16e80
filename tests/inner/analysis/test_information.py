"""What knowing a parameter is worth, intervals of means and shares, and what pairs lose."""

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest
from model_contents import negated
from scipy.stats import binom

from exact_mdp import MDP, Scenario, psa
from exact_mdp.analysis.vary.distributions import row_family, uncertainty
from exact_mdp.analysis.vary.information import evpi, evppi
from exact_mdp.analysis.vary.intervals import mean_loss, mean_of, quantiles, upper_quantile, wilson
from exact_mdp.analysis.vary.psa import POOL
from exact_mdp.analysis.vary.study import solver_of

STEP = 0.02  # what the second action costs below the step


def quadratic() -> float:
    """E[max((x - 1/2)² - 1/20, 0)] less the mean, 1/30, for x uniform."""
    root = sqrt(0.05)
    return 2 * ((0.5**3 - root**3) / 3 - 0.05 * (0.5 - root)) - 1 / 30


def edge(at: float) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
    """1 above the edge, -0.02 below it, against nothing."""
    return lambda x: np.where(x > at, 1.0, -STEP), 1 - at - max(0.0, 1 - at - STEP * at)


CASES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "linear": (lambda x: x - 0.4, 0.08),
    "centred": (lambda x: x - 0.5, 0.125),
    "quadratic": (lambda x: (x - 0.5) ** 2 - 0.05, quadratic()),
    "none": (lambda x: 0.0 * x, 0.0),
    "behind": (lambda x: 0.0 * x - 0.2, 0.0),
    "edge 0.9": edge(0.9),
    "edge 0.98": edge(0.98),
    "middle": (lambda x: np.where(x > 0.5, 1.0, -1.0), 0.5),
}


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("case", CASES)
def test_intervals_cover_or_are_doubted(case: str, noise: float) -> None:
    """500 draws, 60 times; 95 % or more is not excluded by Wilson's interval of the share.

    Splines round a step off, and their residuals beside it add up: that is doubted.
    """
    gain, truth = CASES[case]
    rng, covered = np.random.default_rng(3), []
    for _ in range(60):
        x = rng.uniform(size=(500, 1))
        ahead = gain(x) + noise * rng.normal(size=x.shape)
        value = evppi(np.hstack([ahead, 0 * ahead]), x, ("x",))
        low, high = value.regression.interval
        covered += [low <= truth <= high] * value.reliable
        assert value.regression.value <= evpi(np.hstack([ahead, 0 * ahead])).value + 1e-12
    assert not covered or wilson(sum(covered), len(covered))[1] >= 0.95
    if noise == 0.3 and case in ("edge 0.9", "edge 0.98", "middle"):
        assert len(covered) <= 4
    if noise == 0.3 and case == "linear":
        assert len(covered) >= 54


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_evppi_is_cut_at_evpi_where_the_fit_promises_more(share: float) -> None:
    """A step that loses, and seldom wins: splines swing above it where nothing is to be won."""
    known = np.linspace(-1, 1, 400)[:, None]
    ahead = np.where(known > 0.3, -1.0, 0.0) + np.where(known > 0.99, 1 + share, 0.0)
    values = np.hstack([np.zeros_like(known), ahead])
    cut, most = evppi(values, known, ("x",)), evpi(values).value
    assert cut.regression.value == most == pytest.approx(share * (known > 0.99).mean())
    assert not share or "cut at EVPI of the candidates" in cut.doubts


# ---- intervals -----------------------------------------------------------------------------------


def test_the_interval_of_a_mean_that_few_draws_carry_covers_more_often_than_the_normal() -> None:
    rng, covered, plain = np.random.default_rng(2), 0, 0
    for _ in range(400):
        values = rng.exponential(size=1000) * (rng.random(1000) < 0.02)
        loss, (low, high) = mean_loss(values), mean_of(values).interval
        covered += loss.low <= 0.02 <= loss.high
        plain += low <= 0.02 <= high
        assert loss.few == (values.sum() ** 2 < 50 * (values**2).sum())
    assert plain < 0.93 * 400 < covered
    even = mean_loss(1 + rng.random(5000))
    assert np.allclose(even.interval, 1.5, atol=0.02)
    assert not even.few
    assert mean_loss(np.zeros(9)).interval == (0.0, 0.0)


def test_intervals_of_quantiles_end_at_order_statistics_that_cover() -> None:
    """By another library's distribution; none closer does."""
    for p in (0.5, 0.1):
        (interval,) = quantiles(np.arange(1.0, 1001.0)[::-1], [p])  # sorted, the k-th smallest is k
        below, (low, high) = binom(1000, p).cdf, (interval["low"] - 1, interval["high"] - 1)
        assert below(high - 1) - below(low + 1) < below(high) - below(low)
        assert 0.95 <= below(high) - below(low) < 0.97
        assert interval["value"] == 999 * p + 1
    (least,) = quantiles(np.arange(1.0, 11.0), [0.025])
    assert (least["low"], least["high"]) == (-np.inf, 2)  # the least of ten is above it in 78 %
    for count in (1, 10, 100, 146, 2000):  # both ends are beyond by 97.5 %, or there is none
        for each in quantiles(np.arange(1.0, count + 1)):
            below = binom(count, each["probability"]).cdf
            assert below(each["low"] - 1) <= 1 - 0.975
            assert below(each["high"] - 1) >= 0.975


@pytest.mark.parametrize("count", [72, 73, 150, 2000])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
def test_the_upper_end_is_the_lowest_order_statistic_that_covers(level: float, count: int) -> None:
    rank = int(upper_quantile(np.arange(1.0, count + 1), level))
    assert binom(count, level).cdf(rank - 1) >= 0.975 > binom(count, level).cdf(rank - 2)


def chain() -> MDP:
    """Return eight states with two chances to go on in each: 128 policies, each of them best."""
    rows = [(s, a, [("1/2", s + 1, 1), ("1/2", 8, 0)]) for s in range(8) for a in range(2)]
    return MDP.from_outcomes([*rows, (8, 0, [(1, 8, 0)])])


@pytest.mark.parametrize(
    "model",
    [Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).parametric(), row_family(chain())],
    ids=["care", "rows"],
)
def test_a_policy_is_counted_in_every_draw_whose_optimum_it_was(model) -> None:
    """However seldom that is."""
    how = {"uncertain": uncertainty(model, default=4), "rng": 0}
    draws = psa(model, 150, **how)
    solver, counts = solver_of(model, draws.names), np.bincount(draws.table.which)
    assert len(counts) > 2 * POOL
    for number in (int(np.flatnonzero(counts == counts.min())[-1]), int(counts.argmax())):
        policy = solver.held(draws.table.rows[number])
        assert np.array_equal(solver.row(policy), draws.table.rows[number])
        assert psa(model, 150, policy=policy, **how).candidates[0].frequency == counts[number]


def test_rows_are_drawn_together_whatever_is_asked_of_their_model() -> None:
    rows = [["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]
    family = row_family(MDP.from_arrays([rows], [1, 0, 0], "1/2"))
    for model in (family, family.posed(negated)):
        (part,) = uncertainty(model).parts
        assert (part.kind, len(part.names)) == ("dirichlet", 2)
