"""The optimum under limits, against the linear program of visits in scipy's HiGHS."""

from fractions import Fraction as F

import numpy as np
import pytest
from oracle import rows_of
from scipy.optimize import linprog

from exact_mdp import MDP, solve
from exact_mdp.solvers.objectives.limits import limits_of


def drawn(seed: int, sense: str) -> tuple[MDP, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    chances = rng.multinomial(6, [1 / 3] * 3, size=(3, 2))
    rows = [(s, a, [(F(int(k), 6), t, int(rng.integers(-5, 6))) for t, k in enumerate(row) if k])
            for s, each in enumerate(chances) for a, row in enumerate(each)]  # fmt: skip
    a, b = rng.integers(-4, 5, (2, 6))
    mdp = MDP.from_outcomes(rows, "3/4", sense=sense, start={0: "1/3", 2: "2/3"})
    return mdp.with_(components={"a": a.tolist(), "b": b.tolist()}), a, b


def visits(mdp: MDP) -> tuple[np.ndarray, np.ndarray]:
    """The equations of expected visits: what leaves a state is the start and what enters it."""
    balance = np.zeros((3, 6))
    for pair, (s, _, _, law) in enumerate(rows_of(mdp)):
        balance[s, pair] += 1
        for t, p in law.items():
            balance[t, pair] -= 0.75 * float(p)
    return balance, mdp.start_distribution


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("seed", range(12))
def test_the_optimum_is_that_of_the_program_of_visits(seed: int, sense: str) -> None:
    mdp, a, b = drawn(seed, sense)
    balance, start = visits(mdp)
    earned = np.array([float(r) for _, _, r, _ in rows_of(mdp)])
    sign = -1 if sense == "max" else 1
    limits = {"a": ">= 1", "b": "<= 2"}
    found = linprog(sign * earned, A_ub=[-a, b], b_ub=[-1, 2], A_eq=balance, b_eq=start)
    best = solve(mdp, subject_to=limits)
    assert best.violations() == []
    if not best.feasible:
        assert found.status == 2
        least = linprog([0] * 6 + [1], A_ub=[[*-a, -1], [*b, -1]], b_ub=[-1, 2],
                        A_eq=np.hstack([balance, np.zeros((3, 1))]), b_eq=start)  # fmt: skip
        assert float(best.shift) == pytest.approx(least.fun, abs=1e-8)
        return
    assert float(best.start_value) == pytest.approx(sign * found.fun, abs=1e-8)
    prices = [abs(float(best.prices[name])) for name in ("a", "b")]
    assert prices == pytest.approx(np.abs(found.ineqlin.marginals), abs=1e-7)
    assert best.totals["a"] >= 1
    assert best.totals["b"] <= 2


def test_limits_are_read_by_name_sign_and_bound() -> None:
    one, two, three = limits_of({"a": [">= 1/2", "<= 3"], "b": "<=-2"})
    assert (one.name, one.sign, one.bound) == ("a", 1, F(1, 2))
    assert (two.name, two.sign, two.bound) == ("a", -1, F(3))
    assert (three.name, three.sign, three.bound, str(three)) == ("b", -1, F(-2), "b <= -2")
