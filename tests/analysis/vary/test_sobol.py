"""Sobol indices against closed forms; how often their intervals cover; seeds."""

from collections.abc import Callable
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_models import wager

from exact_mdp import MDP, Family, ModelError, sobol

PI = np.pi
BETS = wager("1/2", "1/2")  # V = max(p, q)


def function_model(f: Callable[..., float], *names: str) -> Family:
    """Return a model whose value is a function of its parameters."""

    def build(at: Any) -> MDP:
        return MDP.from_arrays([[[1]]], [float(f(*(float(at[name]) for name in names)))], 0)

    return Family(parameters=dict.fromkeys(names, 0), build=build)


def test_the_indices_of_ishigami() -> None:
    """Ishigami and Homma (1990): Var = 49/8 + π⁴/50 + π⁸/1800 + 1/2; x3 weighs with x1 alone."""
    model = function_model(
        lambda x, y, z: np.sin(x) + 7 * np.sin(y) ** 2 + z**4 * np.sin(x) / 10, "x", "y", "z"
    )
    shares = sobol(model, ranges=dict.fromkeys("xyz", (-PI, PI)), n=2**11, rng=0).optimal
    variance = 49 / 8 + PI**4 / 50 + PI**8 / 1800 + 1 / 2
    alone = np.array([(1 + PI**4 / 50) ** 2 / 2, 49 / 8, 0]) / variance
    joint = PI**8 * (1 / 18 - 1 / 50) / 100 / variance
    np.testing.assert_allclose(shares.first, alone, atol=0.003)
    np.testing.assert_allclose(shares.total, alone + np.array([joint, 0, joint]), atol=0.003)
    assert shares.sd == pytest.approx(variance**0.5, rel=3e-3)


def test_intervals_cover_as_often_as_they_say() -> None:
    """Of x + 2 y, both indices are 1/5 and 4/5; intervals are those of a random sample."""
    model = function_model(lambda x, y: x + 2 * y, "x", "y")
    for seed in range(20):
        shares = sobol(model, ranges={"x": (0, 1), "y": (0, 1)}, n=64, rng=seed).optimal
        for index, half in ((shares.first, shares.first_half), (shares.total, shares.total_half)):
            assert (np.abs(index - [0.2, 0.8]) < half).all()
            assert (half < 0.5).all()


def test_the_maximum_of_two_and_the_regret_of_one_have_known_indices() -> None:
    """Var max(p, q) = 1/18, of which 1/45 is each one's own; so is the regret's, max(0, q - p)."""
    how: dict[str, Any] = {"policy": "always:0", "ranges": {"p": (0, 1), "q": (0, 1)}, "rng": 1}
    shares = sobol(BETS, n=512, **how)
    for output in (shares.optimal, shares.regret):
        np.testing.assert_allclose(output.first, [0.4, 0.4], atol=0.06)
        np.testing.assert_allclose(output.total, [0.6, 0.6], atol=0.06)
        assert (abs(output.first - 0.4) < output.first_half).all()
        assert output.sd == pytest.approx((1 / 18) ** 0.5, rel=0.02)
    assert shares.regret.mean == pytest.approx(1 / 6, rel=0.02)
    np.testing.assert_allclose(shares.fixed.first, [1, 0], atol=0.02)
    one, other = (
        sobol(wager("1/2", "1/2", gain=unit), n=32, **how).optimal for unit in (F(1), F(1, 2**40))
    )
    assert other.sd == pytest.approx(one.sd / 2**40, rel=1e-9, abs=0)  # in any unit of reward
    assert other.total == pytest.approx(one.total)


def test_what_varies_little_beside_a_large_value_varies() -> None:
    """V = 10¹² + x + 2 y, of which x decides a fifth of the variance, 5/12."""
    model = function_model(lambda x, y: 1e12 + x + 2 * y, "x", "y")
    shares = sobol(model, ranges={"x": (0, 1), "y": (0, 1)}, n=256, rng=0).optimal
    np.testing.assert_allclose(shares.total, [0.2, 0.8], atol=0.02)
    assert shares.sd == pytest.approx((5 / 12) ** 0.5, rel=0.02)


def same(a: Any, b: Any) -> bool:
    return all(
        np.array_equal(value, getattr(getattr(b, output), name), equal_nan=True)
        for output in ("optimal", "fixed", "regret")
        for name, value in vars(getattr(a, output)).items()
    )


def test_seed_zero_is_a_seed_and_workers_change_nothing(tmp_path: Path) -> None:
    how: dict[str, Any] = {"policy": "always:0", "ranges": {"p": (0, 1), "q": (0, 1)}, "n": 16}
    first = sobol(BETS, rng=0, **how)
    np.random.seed(1)  # noqa: NPY002 - what others do with the global generator plays no part
    assert same(sobol(BETS, rng=0, n_jobs=2, folder=tmp_path, **how), first)
    assert same(sobol(BETS, folder=tmp_path, **how), first)  # rng=0, as elsewhere
    assert not same(sobol(BETS, rng=1, **how), first)
    with pytest.raises(ModelError, match="differs in"):
        sobol(BETS, rng=1, folder=tmp_path, **how)


def test_an_index_that_is_not_there_is_not_a_number() -> None:
    """The first action is best everywhere, so that nothing is lost by it."""
    ranges = {"p": (F(3, 5), 1), "q": (0, F(2, 5))}
    shares = sobol(BETS, policy="always:0", ranges=ranges, n=32, rng=0)
    assert (shares.names, shares.draws) == (("p", "q"), 32 * 4)
    assert (shares.regret.constant, shares.regret.mean) == (True, 0)
    np.testing.assert_allclose(shares.fixed.first, shares.optimal.first, atol=1e-9)
    frame = shares.frame("regret")
    assert frame["total (share of variance)"].isna().all()
    assert shares.regret.sd == 0
    assert set(shares.frame()["claim"]) == {"estimated"}
    assert shares.frame()["parameter"][0] == "p"


def test_what_varies_in_no_independent_point_has_no_index() -> None:
    """A rare gain that only a point with one coordinate exchanged has: nothing is known of it."""

    def build(at: Any) -> MDP:
        rare = at["p"] > F(9, 10) and at["q"] > F(9, 10)
        return MDP.from_outcomes([(0, 0, [(1, 1, int(rare))]), (1, 0, [(1, 1, 0)])])

    family = Family(parameters={"p": F(1, 3), "q": F(1, 3)}, build=build)
    shares = sobol(family, ranges={"p": (0, 1), "q": (0, 1)}, n=4, rng=22).optimal
    assert (shares.constant, shares.sd) == (True, 0)
    assert np.isnan(shares.total).all()
