"""Intervals of means, shares and quantiles, against their equations and a second library."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import binom, binomtest, bootstrap, sem

from exact_mdp import ModelError
from exact_mdp.analysis.vary.intervals import (
    NORMAL,
    MeanLoss,
    Ranged,
    compute_wilson_interval,
    confidence_of,
    estimate_quantiles,
    estimate_share,
    mean_at_least,
    mean_interval,
    mean_loss,
    mean_of,
    require_draws,
    tolerances_of,
    upper_quantile,
)

# ---- means ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_halls_interval_solves_his_cubic(seed: int) -> None:
    """g(T) √n is ± 1.96 at the two ends, with g(T) = T + k T²/3 + k² T³/27 + k/(6n)."""
    values = np.random.default_rng(seed).lognormal(0, 1, 40)
    n, found = len(values), mean_loss(values)
    k = (((values - values.mean()) / values.std()) ** 3).mean()
    ends = np.array([found.low, found.high])
    t = (values.mean() - ends) / (found.standard_error * n**0.5)
    g = t + k * t**2 / 3 + k**2 * t**3 / 27 + k / (6 * n)
    assert g * n**0.5 == pytest.approx([NORMAL, -NORMAL])


def test_without_skewness_halls_interval_is_the_normal_one() -> None:
    for values in (np.array([1.0, 3.0] * 20), np.arange(7.0)):
        found, error = mean_loss(values), sem(values)
        mean = values.mean()
        assert found.interval == pytest.approx((mean - NORMAL * error, mean + NORMAL * error))


def test_a_little_skewness_moves_the_ends() -> None:
    """By about k (1 + 2 z²) s / (6 n): both ends in the direction of the long tail."""
    n, values = 1000, np.concatenate([np.arange(999.0), [1200.0]])
    k = (((values - values.mean()) / values.std()) ** 3).mean()
    assert 0.001 < k < 0.01
    found, (low, high) = mean_loss(values), mean_of(values).interval
    shift = k * (1 + 2 * NORMAL**2) * values.std() / (6 * n)
    assert (found.low - low, found.high - high) == pytest.approx((shift, shift), rel=0.01)


@pytest.mark.parametrize("size", [1e-170, 1.0, 1e150])
def test_the_draws_that_carry_a_mean_are_as_many_as_equal_ones(size: float) -> None:
    """(Σ x)² / Σ x², whatever the unit: of equal numbers their count, of one alone 1."""
    for values, carried in (
        ([3.0] * 7, 7.0),
        ([0.0] * 9 + [5.0], 1.0),
        ([1.0, 2.0, 3.0], 36 / 14),
        ([0.25, 0.5], 0.5625 / 0.3125),
    ):
        assert mean_loss(np.array(values) * size).carried == pytest.approx(carried)
    assert mean_loss(np.zeros(4)).carried == 0
    assert mean_loss(np.zeros(4)).interval == (0, 0)


def test_a_mean_is_carried_by_few_draws_below_fifty() -> None:
    for count, few in ((49, True), (50, False), (51, False)):
        assert mean_loss(np.array([1.0] * count + [0.0] * 9)).few == few
    loss = MeanLoss(value=1.0, standard_error=1.0, low=0.0, high=3.0, carried=50.0)
    assert not loss.few


def test_a_mean_has_the_standard_error_of_another_library() -> None:
    rng = np.random.default_rng(1)
    for count in (2, 3, 10, 100):
        values = rng.normal(5, 2, count)
        found = mean_of(values)
        assert (found.value, found.standard_error) == pytest.approx((values.mean(), sem(values)))
    assert mean_of(np.array([4.0])).standard_error == np.inf
    assert mean_of(np.array([4.0])).value == 4


@pytest.mark.parametrize("size", [1.0, 1e120, 1e-120])
def test_the_bootstrap_interval_is_that_of_scipy_in_any_unit(size: float) -> None:
    for count in (10, 11, 40):
        values = np.random.default_rng(count).lognormal(0, 1, count)
        wanted = bootstrap((values,), np.mean, n_resamples=2000, rng=0).confidence_interval
        found = mean_interval(values * size)
        assert found == pytest.approx((wanted.low * size, wanted.high * size), rel=1e-9)


def test_fewer_than_ten_values_have_no_bootstrap_interval_and_equal_ones_a_point() -> None:
    rng = np.random.default_rng(0)
    assert mean_interval(rng.random(9)) is None
    assert mean_interval(rng.random(10)) is not None
    assert mean_interval(np.full(10, 3.5)) == (3.5, 3.5)
    low, high = mean_interval(np.array([1.0] * 5 + [2.0] * 5)) or (0, 0)
    assert 1 < low < 1.5 < high < 2


def bound_of(sample: np.ndarray, doubt: float) -> float:
    """The theorem's bound, its threshold tried by hand on the first twentieth of the sample."""
    first, rest = sample[: len(sample) // 20], sample[len(sample) // 20 :]
    n, u, bounds = len(rest), np.log(2 / doubt), {}
    for k in range(200):
        c = first.max() * 1e-4 * (2.0 / 1e-4) ** (k / 199)
        for part in (first, rest):
            y = [min(x, c) for x in part]
            mean = sum(y) / len(y)
            variance = sum((each - mean) ** 2 for each in y) / (len(y) - 1)
            term = 7 * c * u / (3 * (n - 1))
            bounds.setdefault(k, []).append(mean - (2 * variance * u / n) ** 0.5 - term)
    return max(max(bounds.values(), key=lambda pair: pair[0])[1], 0.0)


@pytest.mark.parametrize("count", [61, 200, 600])
@pytest.mark.parametrize("doubt", [0.05, 0.3])
def test_the_bound_on_a_mean_is_that_of_its_theorem(count: int, doubt: float) -> None:
    for seed in range(2):
        sample = np.random.default_rng(seed).lognormal(0, 1.2, count)
        assert mean_at_least(sample, doubt) == pytest.approx(bound_of(sample, doubt))
        assert mean_at_least(sample * 3, doubt) == pytest.approx(3 * bound_of(sample, doubt))


def test_nothing_is_said_of_a_mean_of_few_or_of_a_first_part_of_zeros() -> None:
    assert mean_at_least(np.full(59, 2.0), 0.5) == 0
    assert mean_at_least(np.full(60, 2.0), 0.5) == pytest.approx(bound_of(np.full(60, 2.0), 0.5))
    assert mean_at_least(np.full(60, 2.0), 0.5) > 0
    assert mean_at_least(np.append(np.zeros(50), np.ones(950)), 0.5) == 0
    assert mean_at_least(np.full(1000, 0.2), 0.5) == pytest.approx(
        bound_of(np.full(1000, 0.2), 0.5)
    )


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


# ---- quantiles -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "probability"), [(60, 0.9), (100, 0.95), (500, 0.99)])
def test_an_upper_quantile_is_the_lowest_order_statistic_that_is_sure(
    count: int, probability: float
) -> None:
    """The k-th smallest is below the quantile where at least k of n draws are."""
    values = np.random.default_rng(count).permutation(count).astype(float)  # 0 is the smallest
    sure = [k for k in range(1, count + 1) if binom.sf(k - 1, count, probability) <= 0.025]
    assert upper_quantile(values, probability) == min(sure) - 1


@pytest.mark.parametrize("count", [1, 2, 10, 200])
def test_the_ends_of_a_quantile_are_order_statistics(count: int) -> None:
    """The quantile is below the k-th smallest only where fewer than k draws are below it."""
    values = np.random.default_rng(0).permutation(count).astype(float)
    for p in (0.02, 0.3, 0.5, 0.97):
        (found,) = estimate_quantiles(values, [p])
        ranks = range(1, count + 1)
        low = [k - 1 for k in ranks if binom.cdf(k - 1, count, p) <= 0.025]
        high = [k - 1 for k in ranks if binom.cdf(k - 1, count, p) >= 0.975]
        assert found["low"] == max(low, default=-np.inf)
        assert found["high"] == min(high, default=np.inf)
        assert found["value"] == pytest.approx(p * (count - 1))
        assert found["probability"] == p


def test_an_end_counts_where_it_is_just_as_sure_as_needed() -> None:
    """Of one draw at the quantile 0.975, in floats: 1 - 0.975 is the chance that none is below."""
    (found,) = estimate_quantiles(np.array([7.0]), [0.975])
    assert found["low"] == 7
    assert found["high"] == np.inf


def test_seven_quantiles_are_given_and_mirror_each_other() -> None:
    found = [each["probability"] for each in estimate_quantiles(np.arange(9.0))]
    assert found == [0.025, 0.05, 0.25, 0.5, 0.75, 0.95, 0.975]
    assert [1 - p for p in found] == pytest.approx(found[::-1])


def test_so_many_draws_are_needed_that_the_greatest_is_surely_beyond() -> None:
    """P(all of n below) = pⁿ ≤ 0.025."""
    for p in (0.5, 0.9, 0.95, 0.99):
        least = next(n for n in range(1, 1000) if p**n <= 0.025)
        require_draws(least, p)
        require_draws(least + 1, p)
        for few in (least - 1, 0):
            with pytest.raises(ModelError, match=f"give {least:,} or more"):
                require_draws(few, p)
        with pytest.raises(ModelError, match=f"n={least}"):
            upper_quantile(np.arange(least - 1.0), p)
        assert upper_quantile(np.arange(float(least)), p) == least - 1


def test_tolerances_are_geometric_up_to_the_largest_quantile() -> None:
    rng = np.random.default_rng(2)
    regrets = [rng.exponential(size, 300) for size in (1.0, 5.0, 2.0)]
    most = max(np.quantile(each, 0.99) for each in regrets)
    for count in (51, 7):
        grid = tolerances_of(regrets, count)
        assert len(grid) == count
        assert (grid[0], grid[1], grid[-1]) == pytest.approx((0, most / 10_000, most))
        assert grid[2:] / grid[1:-1] == pytest.approx(10 ** (4 / (count - 2)))
    assert len(tolerances_of(regrets)) == 51
    assert tolerances_of([each / 100 for each in regrets])[-1] == pytest.approx(most / 100)
    assert tolerances_of([np.zeros(5), np.zeros(5)]).tolist() == [0]


def test_intervals_of_quantiles_end_at_order_statistics_that_cover() -> None:
    """By another library's distribution; none closer does."""
    for p in (0.5, 0.1):
        (interval,) = estimate_quantiles(
            np.arange(1.0, 1001.0)[::-1], [p]
        )  # sorted, the k-th smallest is k
        below, (low, high) = binom(1000, p).cdf, (interval["low"] - 1, interval["high"] - 1)
        assert below(high - 1) - below(low + 1) < below(high) - below(low)
        assert 0.95 <= below(high) - below(low) < 0.97
        assert interval["value"] == 999 * p + 1
    (least,) = estimate_quantiles(np.arange(1.0, 11.0), [0.025])
    assert (least["low"], least["high"]) == (-np.inf, 2)  # the least of ten is above it in 78 %
    for count in (1, 10, 100, 146, 2000):  # both ends are beyond by 97.5 %, or there is none
        for each in estimate_quantiles(np.arange(1.0, count + 1)):
            below = binom(count, each["probability"]).cdf
            assert below(each["low"] - 1) <= 1 - 0.975
            assert below(each["high"] - 1) >= 0.975


@pytest.mark.parametrize("count", [72, 73, 150, 2000])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
def test_the_upper_end_is_the_lowest_order_statistic_that_covers(level: float, count: int) -> None:
    rank = int(upper_quantile(np.arange(1.0, count + 1), level))
    assert binom(count, level).cdf(rank - 1) >= 0.975 > binom(count, level).cdf(rank - 2)


# ---- shares --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("successes", "count"), [(0, 20), (3, 20), (20, 20), (1, 1), (50, 1000)])
def test_wilsons_interval_is_that_of_scipy(successes: int, count: int) -> None:
    wanted = binomtest(successes, count).proportion_ci(method="wilson")
    low, high = compute_wilson_interval(successes, count)
    assert (float(low), float(high)) == pytest.approx((wanted.low, wanted.high), abs=1e-6)
    share = estimate_share(successes, count)
    assert share.interval == pytest.approx((wanted.low, wanted.high), abs=1e-6)
    assert share.value == successes / count
    assert share.standard_error == pytest.approx(binom.std(count, successes / count) / count)


def test_shares_of_none_and_of_all_end_where_a_share_ends() -> None:
    """Without a last bit of rounding beyond."""
    for count in range(1, 200):
        low, high = compute_wilson_interval([0, count], count)
        assert low[0] == 0 < low[1] < 1
        assert high[1] == 1 > high[0] > 0


def test_a_confidence_is_a_decimal_between_none_and_all() -> None:
    assert confidence_of(0.95) == Fraction(19, 20)
    assert confidence_of("0.9") == Fraction(9, 10)
    assert confidence_of(Fraction(1, 3)) == Fraction(1, 3)
    assert confidence_of("1e-300") == Fraction(1, 10**300)
    tiny = Fraction(1, 10**400)
    for given in (0, 1, -0.5, 1.5, 1.0, 0.0, tiny, 1 - tiny, 10**400):
        with pytest.raises(ModelError, match="confidence"):
            confidence_of(given)
    for word in ("x", None):
        with pytest.raises(ModelError) as error:
            confidence_of(word)
        assert error.value.where == "confidence"


def test_the_size_of_an_estimate_has_the_sizes_of_its_interval() -> None:
    """Against the sizes of all numbers of the interval, of which one may be 0."""
    for low, value, high in (
        (-3.0, -2.0, 1.0),
        (-1.0, 0.5, 2.0),
        (-3.0, -2.0, -1.0),
        (1.0, 2.0, 4.0),
    ):
        size = abs(Ranged(value=value, standard_error=0.5, low=low, high=high))
        sizes = np.abs(np.arange(4 * low, 4 * high + 1) / 4)
        assert size.value == abs(value)
        assert (size.low, size.high) == (sizes.min(), sizes.max())
