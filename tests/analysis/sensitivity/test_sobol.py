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


def chain() -> Parametric:
    """V = p (2 + q (3 + 4 r)): each step is passed with its own probability, or all is over."""
    gains, end = (2, 3, 4), 3
    rows: list[Any] = [
        (state, 0, [(HALF, min(state + 1, end), gain), (HALF, 4, 0)])
        for state, gain in enumerate(gains)
    ]
    rows += [(3, 0, [(1, 3, 0)]), (4, 0, [(1, 4, 0)])]
    return moving(MDP.from_outcomes(rows, 1), {n: [(i, i + 1)] for i, n in enumerate("pqr")})


def choice() -> Parametric:
    """V = max(p, q): two actions, each earns 1 with its own probability."""
    rows = [
        (0, 0, [(HALF, 1, 1), (HALF, 2, 0)]),
        (0, 1, [(HALF, 1, 1), (HALF, 2, 0)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return moving(MDP.from_outcomes(rows, 1), {"p": [(0, 1)], "q": [(1, 1)]})


CHAIN_RANGES = {"p": (F(1, 2), F(9, 10)), "q": (F(1, 10), F(3, 5)), "r": (0, 1)}


def mean(low: F, high: F) -> F:
    return (low + high) / 2


def square(low: F, high: F) -> F:
    """E[x²] of a uniform x."""
    return (low * low + low * high + high * high) / 3


def closed_form() -> tuple[F, dict[str, F], dict[str, F]]:
    """Variance, first-order and total indices of p (2 + q (3 + 4 r)), worked out by hand.

    With m for means and s for second moments, u = 3 + 4 r, w = 2 + q u:
    E[w] = 2 + m_q m_u,  E[w²] = 4 + 4 m_q m_u + s_q s_u,  V = p w.
    """
    spans = {name: tuple(map(F, span)) for name, span in CHAIN_RANGES.items()}
    m = {name: mean(*span) for name, span in spans.items()}
    s = {name: square(*span) for name, span in spans.items()}
    m_u, s_u = 3 + 4 * m["r"], 9 + 24 * m["r"] + 16 * s["r"]
    v = {name: s[name] - m[name] ** 2 for name in "pqr"}
    v_u = s_u - m_u**2
    m_w, s_w = 2 + m["q"] * m_u, 4 + 4 * m["q"] * m_u + s["q"] * s_u
    variance = s["p"] * s_w - (m["p"] * m_w) ** 2
    first = {
        "p": v["p"] * m_w**2,
        "q": m["p"] ** 2 * m_u**2 * v["q"],
        "r": m["p"] ** 2 * m["q"] ** 2 * v_u,
    }
    total = {"p": v["p"] * s_w, "q": s["p"] * s_u * v["q"], "r": s["p"] * s["q"] * v_u}
    return (
        variance,
        {name: part / variance for name, part in first.items()},
        {name: part / variance for name, part in total.items()},
    )


# ---- Sobol ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def of_chain() -> Any:
    return sobol(chain(), ranges=CHAIN_RANGES, n=128, rng=0)


def test_indices_are_those_of_the_closed_form(of_chain: Any) -> None:
    variance, first, total = closed_form()
    assert of_chain.names == ("p", "q", "r")
    assert of_chain.draws == 128 * 5
    found = of_chain.optimal
    assert found.sd == pytest.approx(float(variance) ** 0.5, rel=0.02)
    for place, name in enumerate("pqr"):
        assert found.first[place] == pytest.approx(float(first[name]), abs=0.02)
        assert found.total[place] == pytest.approx(float(total[name]), abs=0.02)
        # The intervals are of a purely random sample and wider than the scrambled one's error.
        assert abs(found.first[place] - float(first[name])) < found.first_half[place] < 0.2
        assert abs(found.total[place] - float(total[name])) < found.total_half[place] < 0.2
    assert of_chain.regret.constant
    assert of_chain.regret.mean == 0
    np.testing.assert_allclose(of_chain.fixed.first, found.first, atol=1e-9)


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


def test_an_index_that_is_not_there_is_not_a_number(of_chain: Any) -> None:
    frame = of_chain.frame("regret")
    assert frame["total (share of variance)"].isna().all()
    assert frame.attrs["sd (reward)"] == 0
    assert set(of_chain.frame()["claim"]) == {"estimated"}
    assert of_chain.frame()["parameter"][0] == "q"
    with pytest.raises(ModelError, match="unknown output"):
        of_chain.frame("loss")


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
