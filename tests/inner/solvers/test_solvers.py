"""Every solver in compiled loops, and a linear program whose answer is wrong."""

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction as F
from importlib import import_module

import pytest
from cases import BY_NAME
from hypothesis import given
from oracle import solve_exact
from solver_checks import BRIEF, QUICK, SWEEPING, case_model, check_against_exact
from strategies import Rows, model_of, models

from exact_mdp import MDP, SOLVERS, LinearProgram, SolverError, Status, solve


@contextmanager
def compiled_always() -> Iterator[None]:
    """Have models of any size solved in compiled loops."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("gains",):
            patch.setattr(import_module(f"exact_mdp.solvers.bounds.{name}"), "COMPILED", 0)
        patch.setattr(import_module("exact_mdp.solvers.dynamic.iterate"), "LOOPS", 0)
        yield


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "linear-program"])
@given(rows=models())
def test_exact_optimum_lies_within_the_bounds_of_compiled_loops(name: str, rows: Rows) -> None:
    with compiled_always():
        check_against_exact(rows, BRIEF[name])


@pytest.mark.parametrize("name", [kind.name for kind in SWEEPING])
@pytest.mark.parametrize("discount", [F(1), F(999, 1000)])
def test_margins_that_differ_are_no_reason_to_give_up(name: str, discount: F) -> None:
    """One pair stays with 0.9, the other with 0.1: what a pair adds is not what it promises."""
    rows = [(0, 0, F(-1), {0: F(9, 10), 1: F(1, 10)}), (0, 1, F(-1), {0: F(1, 10), 1: F(9, 10)})]
    rows += [(1, 0, F(0), {1: F(1)})]
    with compiled_always():
        solution = solve(model_of(2, rows, discount), QUICK[name])
    exact, _ = solve_exact(2, rows, discount)
    assert solution.status is Status.CONVERGED
    assert abs(float(exact[0]) - solution.value[0]) <= solution.error_bound < 1e-6


def test_an_optimiser_that_errs_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = case_model(BY_NAME["pig-turn"])
    honest = LinearProgram._optimised

    def errs(self: LinearProgram, mdp: MDP) -> tuple:
        pairs, objective, *rest = honest(self, mdp)
        return pairs, objective * 1.001, *rest

    monkeypatch.setattr(LinearProgram, "_optimised", errs)
    with pytest.raises(SolverError, match="found a mean value of"):
        solve(mdp, LinearProgram())
