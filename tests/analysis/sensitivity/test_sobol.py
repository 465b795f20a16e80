"""Sobol indices against closed forms and scipy's; draws of whole models; seeds."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, Parametric, moving, sobol

F = Fraction
HALF = F(1, 2)


def choice() -> Parametric:
    """V = max(p, q): two actions, each earns 1 with its own probability."""
    rows = [
        (0, 0, [(HALF, 1, 1), (HALF, 2, 0)]),
        (0, 1, [(HALF, 1, 1), (HALF, 2, 0)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return moving(MDP.from_outcomes(rows, 1), {"p": [(0, 1)], "q": [(1, 1)]})


# ---- Sobol ---------------------------------------------------------------------------------------


def test_the_maximum_of_two_and_the_regret_of_one_have_known_indices() -> None:
    """Var max(p, q) = 1/18, of which 1/45 is each one's own; so is the regret's, max(0, q - p)."""
    found = sobol(choice(), policy="always:0", ranges={"p": (0, 1), "q": (0, 1)}, n=512, rng=1)
    for output in (found.optimal, found.regret):
        np.testing.assert_allclose(output.first, [0.4, 0.4], atol=0.06)
        np.testing.assert_allclose(output.total, [0.6, 0.6], atol=0.06)
        assert (abs(output.first - 0.4) < output.first_half).all()
        assert output.sd == pytest.approx((1 / 18) ** 0.5, rel=0.02)
    assert found.regret.mean == pytest.approx(1 / 6, rel=0.02)
    np.testing.assert_allclose(found.fixed.first, [1, 0], atol=0.02)


def same(a: Any, b: Any) -> bool:
    return all(
        np.array_equal(value, getattr(getattr(b, output), name), equal_nan=True)
        for output in ("optimal", "fixed", "regret")
        for name, value in vars(getattr(a, output)).items()
    )


def test_seed_zero_is_a_seed_and_workers_change_nothing(tmp_path: Path) -> None:
    how: dict[str, Any] = {"policy": "always:0", "ranges": {"p": (0, 1), "q": (0, 1)}, "n": 16}
    first = sobol(choice(), rng=0, **how)
    np.random.seed(1)  # noqa: NPY002 - what others do with the global generator plays no part
    assert same(sobol(choice(), rng=0, n_jobs=2, folder=tmp_path, **how), first)
    assert same(sobol(choice(), rng=0, folder=tmp_path, **how), first)
    assert not same(sobol(choice(), rng=1, **how), first)
    with pytest.raises(ModelError, match="differs in"):
        sobol(choice(), rng=1, folder=tmp_path, **how)


# ---- draws ---------------------------------------------------------------------------------------


def test_an_index_that_is_not_there_is_not_a_number() -> None:
    """The first action is best everywhere, so that nothing is lost by it."""
    ranges = {"p": (F(3, 5), 1), "q": (0, F(2, 5))}
    found = sobol(choice(), policy="always:0", ranges=ranges, n=32, rng=0)
    assert (found.names, found.draws) == (("p", "q"), 32 * 4)
    assert found.regret.constant
    assert found.regret.mean == 0
    np.testing.assert_allclose(found.fixed.first, found.optimal.first, atol=1e-9)
    frame = found.frame("regret")
    assert frame["total (share of variance)"].isna().all()
    assert frame.attrs["sd (reward)"] == 0
    assert set(found.frame()["claim"]) == {"estimated"}
    assert found.frame()["parameter"][0] == "p"
    with pytest.raises(ModelError, match="unknown output"):
        found.frame("loss")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"n": 0}, "n is 0"),
        ({"n": 100}, "not a power of 2"),
        ({"n": True}, "n is True"),
        ({"rng": -1}, "-1 is not a source"),
        ({"names": ["x"]}, "unknown parameter 'x'"),
        ({"ranges": {"p": (HALF, HALF)}}, "empty"),
        ({"ranges": {"p": (0, 2)}}, "outside"),
        ({"confidence": 1.0}, "confidence"),
        ({"relative": F(0)}, "share of 0"),
        ({"policy": "nobody"}, "nobody"),
        ({"n_jobs": 0}, "n_jobs"),
    ],
)
def test_bad_requests_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        sobol(choice(), **({"n": 4, "rng": 0} | change))


def test_the_spread_of_small_rewards_is_a_spread() -> None:
    """Shares of variance do not depend on the unit of reward."""
    half, found = HALF, []
    for unit in (F(1), F(1, 2**40)):
        rows = [(0, 0, [(half, 1, 5 * unit), (half, 2, 0)]), (1, 0, [(1, 3, unit)])]
        rows += [(2, 0, [(F(1, 3), 3, 0), (F(2, 3), 1, 2 * unit)]), (3, 0, [(1, 3, 0)])]
        model = moving(MDP.from_outcomes(rows), {"p": [(0, 1)], "q": [(2, 1)]})
        found.append(sobol(model, n=32, rng=1).optimal)
    assert found[1].sd == pytest.approx(found[0].sd / 2**40, rel=1e-9, abs=0)
    assert found[1].total == pytest.approx(found[0].total)
