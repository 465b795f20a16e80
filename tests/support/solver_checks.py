"""Solvers as tests run them, and their answers on small models against the exact ones."""

import dataclasses
from fractions import Fraction as F
from typing import Any

import pytest
from cases import Case
from model_contents import is_acyclic
from oracle import evaluate_exact, solve_exact
from strategies import Rows, exact_values, model_of

from exact_mdp import (
    MDP,
    SOLVERS,
    GaussSeidel,
    ModelError,
    Solution,
    Solver,
    SolverError,
    Status,
    ValueIteration,
    solve,
)

# Sweeps alone would take their million on chains that mix slowly: these may stop before the end.
ONLY_SWEEPS: tuple[Any, ...] = (ValueIteration, GaussSeidel)


def briefly(most: int) -> dict[str, Solver]:
    every = {name: kind() for name, kind in SOLVERS.items()}
    return every | {kind.name: kind(max_iterations=most) for kind in ONLY_SWEEPS}


QUICK = briefly(6_000)
BRIEF = briefly(600)  # on random models bounds hold wherever sweeps are stopped
DIRECT = {"backward-induction", "policy-iteration", "linear-program"}


def outcome(mdp: MDP, solver: Solver) -> Solution | SolverError | ModelError:
    try:
        return solve(mdp, solver)
    except (SolverError, ModelError) as error:
        return error


def check_against_exact(rows: Rows, solver: Solver) -> None:
    mdp = rows.model()
    if solver.name == "backward-induction" and not is_acyclic(mdp):
        with pytest.raises(ModelError, match="without cycles"):
            solve(mdp, solver)
        return
    found: Any = outcome(mdp, solver)
    if isinstance(found, SolverError):
        # Sweeps take long where γ is near 1 and several chains are closed.
        assert found.status is Status.ITERATION_LIMIT
        assert solver.name in {kind.name for kind in ONLY_SWEEPS}
        found = found.solution
    assert isinstance(found, Solution)
    exact, _ = solve_exact(rows.n_states, rows.pairs, rows.discount)
    policy = dict(enumerate(found.policy.tolist()))
    worth = evaluate_exact(rows.n_states, rows.pairs, rows.discount, policy)
    values = zip(exact, worth, exact_values(found.value), found.state_error, strict=True)
    for best, reached, value, error in values:
        assert abs(best - value) <= F(float(error))
        assert abs(reached - value) <= F(float(error))
        assert best - reached <= F(found.regret_bound)
    size = float(max(map(abs, exact)) + max(abs(r) for _, _, r, _ in rows.pairs))
    if solver.name in DIRECT:
        assert found.error_bound <= 1e-9 * size + 2.0**-900  # what underflow may cost
        assert found.status is Status.DIRECT
    start = sum((weight * exact[state] for state, weight in mdp.start), F(0))
    assert abs(start - F(found.start_value)) <= F(found.start.error)


def settings_of(kind: type) -> set[str]:
    return {field.name for field in dataclasses.fields(kind)}


# Of every solver in the list, those that stop at a tolerance.
SWEEPING = [kind for kind in SOLVERS.values() if "tol" in settings_of(kind)]


def case_model(case: Case) -> MDP:
    return model_of(case.n_states, case.pairs, case.discount, start=case.start)
