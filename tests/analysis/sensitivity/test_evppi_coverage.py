"""Where nothing is doubted, the 95 % interval of an EVPPI holds the truth about that often."""

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest

from exact_mdp.analysis.sensitivity.psa.value_of_information import evppi

Z = 1.959963984540054
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


def wilson(hits: int, count: int) -> tuple[float, float]:
    share = hits / count
    middle = (share + Z**2 / (2 * count)) / (1 + Z**2 / count)
    half = Z / (1 + Z**2 / count) * sqrt(share * (1 - share) / count + Z**2 / (4 * count**2))
    return middle - half, middle + half


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


@pytest.mark.parametrize("case", ["edge 0.9", "edge 0.95", "edge 0.98", "middle"])
def test_a_step_that_shows_is_doubted(case: str) -> None:
    """Splines round a step off; their residuals beside it add up."""
    gain, _ = CASES[case]
    rng = np.random.default_rng(4)
    doubted = 0
    for _ in range(30):
        x = rng.uniform(size=(500, 1))
        ahead = gain(x) + 0.3 * rng.normal(size=x.shape)
        doubted += not evppi(np.hstack([ahead, 0 * ahead]), x, ("x",)).reliable
    assert doubted >= 28


def test_a_good_fit_is_not_doubted() -> None:
    rng = np.random.default_rng(5)
    reliable = 0
    for _ in range(30):
        x = rng.uniform(size=(500, 1))
        ahead = x - 0.4 + 0.3 * rng.normal(size=x.shape)
        reliable += evppi(np.hstack([ahead, 0 * ahead]), x, ("x",)).reliable
    assert reliable >= 27
