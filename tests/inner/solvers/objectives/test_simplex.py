"""Small linear programs in fractions, against scipy's HiGHS and the conditions of an optimum."""

from fractions import Fraction as F

import numpy as np
import pytest
from scipy.optimize import linprog

from exact_mdp.solvers.objectives.simplex import solve_linear_program


@pytest.mark.parametrize("seed", range(40))
def test_x_is_an_optimum_and_y_proves_it(seed: int) -> None:
    """With right sides of either sign, and zeros among them, where steps have no length."""
    rng = np.random.default_rng(seed)
    rows, size = int(rng.integers(1, 4)), int(rng.integers(4, 8))
    columns = [[F(int(k)) for k in rng.integers(-3, 4, rows)] for _ in range(size)]
    known = [F(int(k)) for k in rng.integers(0, 3, size)]  # a point that keeps the equations
    b = [sum((x * column[i] for x, column in zip(known, columns, strict=True)), F(0))
         for i in range(rows)]  # fmt: skip
    columns.append([F(0)] * rows)  # and a budget on all of x, which bounds the program
    columns, b = [[*column, F(1)] for column in columns], [*b, sum(known, F(2))]
    c = [F(int(k), 2) for k in rng.integers(-5, 6, size)] + [F(0)]
    x, y = solve_linear_program(c, columns, b)
    assert min(x) >= 0
    for i, right in enumerate(b):
        assert sum(v * column[i] for v, column in zip(x, columns, strict=True)) == right
    for own, column in zip(c, columns, strict=True):
        assert sum(v * a for v, a in zip(y, column, strict=True)) >= own
    best = sum(v * own for v, own in zip(x, c, strict=True))
    assert best == sum(v * right for v, right in zip(y, b, strict=True))
    found = linprog([-float(v) for v in c], A_eq=np.array(columns, float).T, b_eq=[*map(float, b)])
    assert float(best) == pytest.approx(-found.fun, abs=1e-9)
    assert sum(v != 0 for v in x) <= len(b)
