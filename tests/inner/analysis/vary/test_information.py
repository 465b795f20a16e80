"""What knowing parameters is worth: closed forms, a second library's regression, and loops."""

from itertools import combinations
from math import comb

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.stats import sem

from exact_mdp import ModelError
from exact_mdp.analysis.vary.information import (
    _build_spline_basis,
    _find_largest_sum,
    _solve_normal_equations,
    estimate_evpi,
    estimate_evppi,
    too_wide,
)

# ---- EVPI ----------------------------------------------------------------------------------------


def test_evpi_is_the_mean_of_the_greatest_less_the_greatest_mean() -> None:
    rng = np.random.default_rng(0)
    for count in (2, 5, 40):
        values = rng.normal(size=(count, 3))
        loss = estimate_evpi(values)
        most = [max(row) for row in values.tolist()]
        best = max(range(3), key=lambda n: sum(values[:, n]))
        assert loss.value == pytest.approx(np.mean(most) - values[:, best].mean())
        assert loss.standard_error == pytest.approx(sem(np.subtract(most, values[:, best])))
    assert estimate_evpi(np.ones((4, 1))).value == 0


# ---- the regression ------------------------------------------------------------------------------


def splines(draws: np.ndarray, knots: int) -> np.ndarray:
    """Cubic splines of each column by another library: at `knots` equal shares of the draws."""
    columns = [np.ones((len(draws), 1))]
    for x in draws.T:
        inner = [np.quantile(x, k / (knots + 1)) for k in range(1, knots + 1)]
        ends = [x.min()] * 4 + inner + [x.max()] * 4
        columns.append(BSpline.design_matrix(x, ends, 3).toarray())
    return np.hstack(columns)


def products(draws: np.ndarray) -> np.ndarray:
    scaled = (draws - draws.mean(axis=0)) / draws.std(axis=0)
    pairs = combinations(range(draws.shape[1]), 2)
    return np.array([scaled[:, i] * scaled[:, j] for i, j in pairs]).reshape(-1, len(draws)).T


@pytest.mark.parametrize(
    ("count", "known", "knots", "crossed"),
    [
        (20, 1, None, False),  # a line: two terms for 20 draws
        (39, 1, None, False),
        (40, 1, 0, False),
        (59, 1, 1, False),
        (70, 1, 2, False),
        (100, 1, 3, False),  # the fifth root of 100 is 2.5
        (3000, 1, 5, False),
        (20_000, 1, 7, False),
        (100, 2, 1, True),  # 2 (1 + 3) + 1 and a product are just a tenth of the draws
        (90, 2, 1, False),
        (100, 3, 0, False),
        (130, 3, 1, False),
        (1000, 3, 4, True),
        (100, 4, None, False),
        (110, 4, None, True),
        (8000, 21, 6, True),  # 21 (6 + 3) + 1 + 210 terms are the most there may be
        (8000, 22, 6, False),
        (4000, 99, 1, False),
        (4100, 100, 0, False),
    ],
)
def test_the_terms_span_the_splines_and_products_that_draws_allow(
    count: int, known: int, knots: int | None, crossed: bool
) -> None:
    draws = np.random.default_rng(count).uniform(-3, 5, (count, known))
    terms = _build_spline_basis(draws)
    wanted = known + 1 if knots is None else known * (knots + 3) + 1
    assert terms.shape == (count, wanted + crossed * comb(known, 2))
    if known < 10:  # of the same rank together: the same functions
        own = np.hstack([np.ones((count, 1)), draws] if knots is None else [splines(draws, knots)])
        every = np.hstack([own, products(draws)] if crossed else [own])
        rank = np.linalg.matrix_rank
        scaled = terms / np.linalg.norm(terms, axis=0)
        together = np.hstack([scaled, every / np.linalg.norm(every, axis=0)])
        assert rank(scaled) == rank(together, tol=1e-9) == terms.shape[1]


@pytest.mark.parametrize("seed", range(5))
def test_normal_equations_give_the_least_squares_of_another_library(seed: int) -> None:
    """Of columns of any size, of which some are 0 or the sum of others."""
    rng = np.random.default_rng(seed)
    terms, sides = (
        rng.normal(size=(30, 5)) * 10.0 ** rng.integers(-12, 12, 5),
        rng.normal(size=(30, 2)),
    )
    more = np.column_stack([terms, np.zeros(30), terms[:, 0] + terms[:, 1]])
    for given in (terms, more):
        size = np.linalg.norm(terms, axis=0)
        best = terms @ np.linalg.solve(
            terms.T @ terms / size[:, None], terms.T @ sides / size[:, None]
        )
        found = given @ _solve_normal_equations(given.T @ given, given.T @ sides)
        assert found == pytest.approx(best, abs=1e-5)


def test_what_draws_do_not_tell_apart_gets_one_coefficient() -> None:
    """Of two columns that differ by less than 6 · 10^-7 of themselves: the root of 4 · 10^-13."""
    rng = np.random.default_rng(0)
    for apart, told in ((3e-7, False), (3e-6, True)):
        one, more = rng.normal(size=(2, 40))
        terms = np.column_stack([one, one + apart * more])
        found = _solve_normal_equations(terms.T @ terms, terms.T @ more[:, None])[:, 0]
        own = one @ more / (one @ one) / 2
        assert (found == pytest.approx([own, own], rel=1e-4)) != told


def longest(draws: np.ndarray, residuals: np.ndarray) -> tuple[float, bool]:
    """The greatest sum of 8, 16, … neighbours, in standard deviations of such a sum, by loops."""
    count, found, windows = len(draws), [(0.0, 0.0)], 0
    for column in residuals.T:
        spread = (sum(each**2 for each in column) / count) ** 0.5
        if not spread:
            continue
        for x in draws.T:
            ordered, length = column[np.argsort(x, kind="stable")], 8
            while 2 * length <= count:
                windows += count
                for first in range(count - length + 1):
                    total = abs(sum(ordered[first : first + length]))
                    found.append((total / (spread * length**0.5), total))
                length *= 2
    size, total = max(found)
    return total, size > (2 * np.log(max(windows, 2))) ** 0.5


@pytest.mark.parametrize("seed", range(12))
def test_the_longest_pattern_of_residuals_is_that_of_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, known, candidates = (*rng.integers([16, 1, 1], [70, 4, 4]),)
    if seed == 3:
        count = 16
    draws, residuals = rng.random((count, known)), rng.normal(size=(count, candidates))
    residuals[:, rng.random(candidates) < 0.3] = 0
    if seed % 3 == 0:
        draws = draws.round(1)  # of equal draws, the first comes first
    if seed % 2:
        residuals += 1.5 * (draws[:, :1] > 0.5)
    total, surprising = longest(draws, residuals)
    assert _find_largest_sum(draws, residuals) == (pytest.approx(total), surprising)


def test_a_pattern_surprises_at_the_root_of_twice_the_logarithm_of_the_windows() -> None:
    """Of 40 windows of each of two lengths the greatest sum is hardly above √(2 ln 80) = 2.96."""
    x = np.arange(40.0)[:, None]
    for size, said in ((1.35, False), (1.45, True)):
        residuals = np.where(np.arange(40) % 2, 1.0, -1.0)
        residuals[10:26] = size
        total, surprising = longest(x, residuals[:, None])
        assert _find_largest_sum(x, residuals[:, None]) == (pytest.approx(total), surprising)
        assert said in (True, False)
    assert _find_largest_sum(x, np.zeros((40, 2))) == (0, False)
    flat = np.where(np.arange(40) % 2, 1.0, -1.0)
    flat[20] = -0.5  # no sum is longer than half a residual
    assert _find_largest_sum(x, flat[:, None]) == (pytest.approx(0.5), False)
    begins = np.array([1.0] * 7 + [-7.0] + [0.0] * 8)  # seven neighbours are not eight
    assert _find_largest_sum(x[:16], begins[:, None])[0] == longest(x[:16], begins[:, None])[0] == 7
    assert _find_largest_sum(x[:15], np.ones((15, 1))) == (0, False)


# ---- EVPPI ---------------------------------------------------------------------------------------


def regression(terms: np.ndarray, of: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Least squares, by another library, of columns scaled to length 1."""
    size = np.linalg.norm(terms, axis=0)
    return np.asarray(at / size @ np.linalg.lstsq(terms / size, of, rcond=1e-7)[0])


Expected = tuple[float, float, float, float, list[str]]


def expected(values: np.ndarray, draws: np.ndarray) -> Expected:
    """EVPPI, its standard error, the lower estimate, its standard error, and what is doubtful."""
    count, best = len(values), int(values.mean(axis=0).argmax())
    ahead, terms = values - values[:, [best]], _build_spline_basis(draws)
    fitted = regression(terms, ahead, terms)
    greatest, chosen = fitted.max(axis=1), fitted.argmax(axis=1)
    gain = greatest - fitted[:, fitted.mean(axis=0).argmax()]
    promised, most = gain.mean(), estimate_evpi(values).value
    value, own = min(promised, most), [ahead[d, c] for d, c in enumerate(chosen)]
    earned = []
    for k in range(5):
        tested = np.arange(count * k // 5, count * (k + 1) // 5)
        others = np.setdiff1d(np.arange(count), tested)
        rule = regression(terms[others], ahead[others], terms[tested]).argmax(axis=1)
        earned += [ahead[d, c] for d, c in zip(tested, rule, strict=True)]
    lower, taken = float(np.mean(earned)), sorted({*chosen.tolist()} - {best})
    total, surprising = longest(draws, (ahead - fitted)[:, taken])
    sure, missed = float(sem(own)), total / count
    apart, astray = value - lower, promised - np.mean(own)
    said, noise = [], 1e-9 * value
    if abs(apart) > max(sure, noise) or lower < value / 2:
        said.append("the fit's choices earn less or more in draws that it has not seen")
    if abs(astray) > max(sure / 2, noise):
        said.append("the fit promises less or more than its choices earn")
    if surprising and missed > max(sure / 10, noise):
        said.append("the fit misses a pattern along a parameter")
    carried = gain.sum() ** 2 / (gain**2).sum() if gain.any() else 0
    if carried < 50:
        said.append(f"few draws carry it: {carried:.0f}")
    if promised > most * (1 + 1e-9):
        said.append("cut at EVPI of the candidates")
    if not value:
        said = ["the fit changes the choice in no draw"]
    error = (sure**2 + apart**2 + missed**2 + (2 * astray) ** 2) ** 0.5
    return value, error, lower, float(sem(earned)), [*said, *too_wide(error, most, count)]


def problem(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Values of two to four candidates that depend on one to three parameters, and on chance."""
    rng = np.random.default_rng(seed)
    count, candidates, known = (*rng.integers([20, 2, 1], [200, 5, 4]).tolist(),)
    draws = rng.uniform(1, 4, (count, known))
    slopes = rng.normal(size=(known, candidates))
    values = draws @ slopes * rng.choice([0.1, 1, 3])
    if seed % 2:
        values += rng.normal(size=candidates) * (draws[:, :1] > rng.uniform(1, 4)) * 3
    if seed % 3 == 0:
        values -= values.mean(axis=0)
    return values + rng.choice([0.05, 0.3, 2.0]) * rng.normal(size=values.shape), draws


def test_evppi_is_what_its_definition_says_and_doubts_what_is_doubtful() -> None:
    seen: dict[str, int] = {}
    for seed in range(60):
        values, draws = problem(seed)
        found, (value, error, lower, own, said) = (
            estimate_evppi(values, draws, ("x",)),
            expected(values, draws),
        )
        assert found.parameters == ("x",)
        assert found.regression.value == pytest.approx(value, abs=1e-9)
        assert found.regression.standard_error == pytest.approx(error, abs=1e-9)
        assert (found.lower.value, found.lower.standard_error) == pytest.approx((lower, own))
        assert [*found.doubts] == said
        assert found.reliable == (not said)
        for each in said or ["none"]:
            seen[each.split(":")[0]] = seen.get(each.split(":")[0], 0) + 1
    assert len(seen) >= 6, seen


@pytest.mark.parametrize("size", [1e-7 / 3, 0.1, 1.0, 7.0, 1e7 / 3])
@pytest.mark.parametrize("count", [100, 101, 200, 300, 1000])
def test_a_fit_that_is_exact_up_to_rounding_is_reliable(size: float, count: int) -> None:
    """One of two candidates earns 1 and the other loses 9, by a parameter of two values."""
    x = np.random.default_rng(0).integers(0, 2, (count, 1))
    values = size * np.hstack([0 * x, 1 - 10 * x, 10 * x - 9])
    found = estimate_evppi(values, 1.0 * x, ("x",))
    assert found.doubts == ()
    assert (found.regression.value, found.lower.value) == pytest.approx((size, size), rel=1e-12)
    assert found.regression.standard_error < 1e-12 * size


def test_a_choice_that_earns_nothing_where_much_is_promised_is_doubtful() -> None:
    """A line through losses of 1 in the lower draws promises gains in the upper ones."""
    x = np.arange(30.0)[:, None]
    values = np.hstack([np.zeros((30, 1)), np.where(x < 4, -1.0, 0.0)])
    values[0, 1] = 0.5  # where it is not chosen: EVPI is 1/60
    found = estimate_evppi(values, x, ("x",))
    assert found.regression.value == pytest.approx(1 / 60)
    assert "the fit promises less or more than its choices earn" in found.doubts


@pytest.mark.parametrize("seed", range(3))
def test_the_units_of_parameters_do_not_matter(seed: int) -> None:
    """By powers of 2, not even in the last digit; and not where they begin."""
    values, draws = problem(seed)
    draws = np.hstack([draws, draws[:, :1] ** 2])
    found, known = estimate_evppi(values, draws, ("x",)), draws.shape[1]
    units = 2.0 ** np.linspace(-400, 400, known).round()
    assert estimate_evppi(values, draws * units, ("x",)) == found
    moved = estimate_evppi(values, draws + 1e6 * np.arange(known), ("x",))
    assert moved.regression.value == pytest.approx(found.regression.value, rel=1e-6)


def test_what_is_known_of_nothing_that_varies_or_of_one_candidate_is_worth_nothing() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(50, 2))
    for found in (
        estimate_evppi(values, np.ones((50, 2)), ("x", "y")),
        estimate_evppi(values[:, :1], rng.random((50, 1)), ("x",)),
    ):
        assert (found.regression.value, found.regression.standard_error) == (0, 0)
        assert (found.lower.value, found.lower.standard_error) == (0, 0)
        assert found.reliable
    x = rng.random((50, 1))
    with_constant = estimate_evppi(values, np.hstack([np.ones((50, 1)), x]), ("c", "x"))
    alone = estimate_evppi(values, x, ("x",))
    assert estimate_evppi(values, np.hstack([x, np.zeros((50, 1))]), ("x",)) == alone
    assert with_constant.regression == alone.regression
    assert with_constant.doubts == alone.doubts


def test_a_regression_takes_at_least_20_draws_and_the_first_20_000() -> None:
    rng = np.random.default_rng(0)
    assert estimate_evppi(rng.normal(size=(20, 2)), rng.random((20, 1)), ("x",)).parameters == (
        "x",
    )
    for count, said in ((19, "19 draws for"), (1, "1 draw for")):
        with pytest.raises(ModelError, match=f"{said} a regression") as error:
            estimate_evppi(rng.normal(size=(count, 2)), rng.random((count, 1)), ("x",))
        assert (error.value.where, error.value.fix) == ("EVPPI", "ask for at least 20")
    x = rng.random((20_005, 1))
    values = np.hstack([x - 0.5, 0 * x])
    values[20_000:] = 1e9
    found = estimate_evppi(values, x, ("x",))
    assert found == estimate_evppi(values[:20_000], x[:20_000], ("x",))
    assert found.regression.value == pytest.approx(1 / 8, rel=0.02)


def test_a_standard_error_above_evpi_says_how_many_draws_halve_it() -> None:
    """The error falls with the root of the number of draws, and is rounded to one digit."""
    for error, most in ((0.1, 0.2), (0.2, 0.2), (1.0, 0.0), (np.nan, 1.0)):
        assert too_wide(error, most, 100) == []
    (said,) = too_wide(0.3, 0.2, 100)
    assert "above EVPI (0.2)" in said
    assert said.endswith("take about n=900 to bring it to half of EVPI")
    assert too_wide(0.5, 0.05, 50)[0].endswith("take about n=20,000 to bring it to half of EVPI")
    (said,) = too_wide(0.5, 0.05, 75)
    assert said.endswith("take n=20,000, as a regression uses no more")
