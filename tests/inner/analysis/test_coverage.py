"""Intervals of what knowing a parameter is worth cover the truth, or are doubted."""

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest

from exact_mdp.analysis.vary.information import estimate_evpi, estimate_evppi
from exact_mdp.analysis.vary.intervals import compute_wilson_interval

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
        value = estimate_evppi(np.hstack([ahead, 0 * ahead]), x, ("x",))
        low, high = value.regression.interval
        covered += [low <= truth <= high] * value.reliable
        assert value.regression.value <= estimate_evpi(np.hstack([ahead, 0 * ahead])).value + 1e-12
    assert not covered or compute_wilson_interval(sum(covered), len(covered))[1] >= 0.95
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
    cut, most = estimate_evppi(values, known, ("x",)), estimate_evpi(values).value
    assert cut.regression.value == most == pytest.approx(share * (known > 0.99).mean())
    assert not share or "cut at EVPI of the candidates" in cut.doubts
