"""The worst law that makes frequencies likely, against scipy's optimiser on the same region."""

import numpy as np
import pytest
from scipy.optimize import minimize

from exact_mdp.solvers.robust.likelihood import Likelihood
from exact_mdp.solvers.robust.sets import RowBlock


def block(p: np.ndarray) -> RowBlock:
    rows, n = p.shape
    zero = np.zeros((rows, n), dtype=np.int64)
    return RowBlock(place=np.arange(rows), pair=np.arange(rows), outcome=zero, filled=zero > 0,
                 next=zero, probability=p, gain=zero * 0.0, largest=np.zeros(rows))  # fmt: skip


@pytest.mark.parametrize("radius", [1e-4, 0.05, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_the_law_is_in_the_region_and_no_other_is_worse(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    p, x = rng.dirichlet(np.ones(4), 1), rng.normal(size=(1, 4))
    q, short = Likelihood(radius=radius).minimise(block(p), x)
    assert q.sum() == pytest.approx(1)
    assert (p * np.log(p / q)).sum() <= radius * (1 + 1e-9)
    limits = [
        {"type": "eq", "fun": lambda q: q.sum() - 1},
        {"type": "ineq", "fun": lambda q: radius - (p[0] * np.log(p[0] / q)).sum()},
    ]
    found = minimize(lambda q: q @ x[0], p[0], bounds=[(1e-9, 1)] * 4, constraints=limits,
                     options={"ftol": 1e-14, "maxiter": 500})  # fmt: skip
    assert q[0] @ x[0] - short[0] <= found.fun + 1e-7
    assert q[0] @ x[0] == pytest.approx(found.fun, abs=2e-6)
    assert 0 <= short[0] < 1e-9


def test_an_outcome_that_was_never_seen_may_happen() -> None:
    """With p = (1, 0): all q with log(1/q_1) ≤ β, so that q_2 is up to 1 - e^-β."""
    p, x = np.array([[1.0, 0.0]]), np.array([[5.0, 2.0]])
    q, short = Likelihood(radius=0.5).minimise(block(p), x)
    assert q[0] == pytest.approx([np.exp(-0.5), 1 - np.exp(-0.5)])
    assert short[0] < 1e-12


def test_a_radius_of_0_leaves_the_frequencies() -> None:
    p, x = np.array([[0.25, 0.75]]), np.array([[5.0, 2.0]])
    q, short = Likelihood(radius=0).minimise(block(p), x)
    assert q.tolist() == p.tolist()
    assert short[0] == 0
