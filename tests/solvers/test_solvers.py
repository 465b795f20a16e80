"""Every solver in the list: settings, how a run ends, numbers, programs, and what is returned."""

import dataclasses
import pickle
from fractions import Fraction as F
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from cases import BY_NAME
from made_models import garnet
from model_contents import negated
from strategies import model_of, of_case

from exact_mdp import (
    MDP,
    SOLVERS,
    BackwardInduction,
    Bounded,
    Certified,
    Claim,
    Estimated,
    LinearProgram,
    ModelError,
    ModifiedPolicyIteration,
    PolicyIteration,
    PrecisionWarning,
    Scenario,
    Solver,
    SolverError,
    Status,
    ValueIteration,
    certify,
    solve,
)

SWEEPING: list[Any] = [kind for kind in SOLVERS.values() if hasattr(kind, "tol")]


def case_model(name: str) -> MDP:
    return of_case(BY_NAME[name])


def test_the_default_depends_on_cycles() -> None:
    assert solve(case_model("gambler-30-1/2")).method == "modified-policy-iteration"
    assert solve(case_model("secretary-10"), "auto").method == "backward-induction"
    assert solve(case_model("secretary-10"), "value-iteration").iterations > 1
    mdp = Scenario.load("yuan2025").with_(tasks=[3, 1]).compile()
    turn = np.random.default_rng(7).permutation(mdp.n_states)  # in no order of their steps
    order = np.argsort(turn[mdp.pair_state], kind="stable")
    other = MDP.from_pairs(
        turn[mdp.pair_state][order],
        mdp.pair_action[order],
        mdp.transition[order][:, np.argsort(turn)],
        mdp.reward[order],
        start=int(turn[0]),
    )
    solution, known = solve(other), solve(mdp)
    assert solution.method == "backward-induction"
    apart = np.abs(solution.value[turn] - known.value)
    assert (apart <= solution.state_error[turn] + known.state_error + 1e-12).all()


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_has_a_name_and_gives_the_same_every_time(name: str) -> None:
    solver = SOLVERS[name]()
    assert solver.name == name
    assert repr(solver).startswith(type(solver).__name__)
    assert hash(solver) == hash(SOLVERS[name]())
    one, two = (solve(case_model("pig-turn"), name) for _ in range(2))
    assert one.value.tobytes() == two.value.tobytes()
    assert one.state_error.tobytes() == two.state_error.tobytes()
    assert one.policy.rule.tolist() == two.policy.rule.tolist()


@pytest.mark.parametrize("costs", [False, True])
@pytest.mark.parametrize("name", [name for name, kind in SOLVERS.items() if hasattr(kind, "start")])
def test_what_is_known_saves_work_and_changes_no_answer(name: str, costs: bool) -> None:
    mdp = garnet(120, seed=1, discount="0.99").with_(sense="min" if costs else "max")
    cold = solve(mdp, name)
    starts: dict[str, Any] = {
        "solution": cold,
        "values": np.array(cold.value),
        "policy": cold.policy,
        "far": 1e3 * np.random.default_rng(0).normal(size=120),
        "bad": np.zeros(120, dtype=np.int64),
    }
    for what, start in starts.items():
        solution = solve(mdp, name, start=start)
        assert np.abs(solution.value - cold.value).max() <= solution.error_bound + cold.error_bound
        assert solution.error_bound < 1e-6
        if what in ("solution", "values", "policy"):
            assert solution.iterations <= max(3, cold.iterations // 2), what
    acyclic = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])
    assert solve(acyclic, start=[0, 0]).value.tolist() == [1, 0]


# ---- how a run ends ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", SWEEPING)
def test_a_tolerance_is_met_or_a_warning_says_so(kind: Any) -> None:
    for tol in (1e-2, 1e-6, 1e-10):
        solution = solve(case_model("gambler-100-2/5"), kind(tol=tol))
        assert solution.error_bound <= tol
        assert solution.status is Status.CONVERGED
    with pytest.warns(PrecisionWarning, match="certify"):
        solution = solve(case_model("gambler-100-2/5"), kind(tol=1e-18))
    assert solution.status is Status.PRECISION
    assert 1e-18 < solution.error_bound < 1e-10


def test_small_last_changes_are_no_reason_to_stop() -> None:
    # Stopping when a sweep changes less than 1e-6 gives 0.33 for a true 1/2 here.
    mdp = case_model("reset-chain-20-1/2-goal")
    with pytest.raises(SolverError, match="raise max_iterations") as caught:
        solve(mdp, ValueIteration(tol=1e-6, max_iterations=100))
    reached = caught.value.solution
    assert reached is not None
    assert abs(reached.start_value - 0.5) <= reached.start.error
    for kind in (ModifiedPolicyIteration, ValueIteration):
        solution = solve(mdp, kind(tol=1e-6))
        assert solution.error_bound <= 1e-6
        assert solution.iterations < 200
        assert abs(solution.start_value - 0.5) <= solution.start.error


@pytest.mark.parametrize("solver", [ModifiedPolicyIteration, PolicyIteration])
def test_too_few_iterations_name_all_that_goes_on(solver: Any) -> None:
    said = r"iteration limit.*PolicyIteration.*certify\(\)"
    with pytest.raises(SolverError, match=said) as caught:
        solve(case_model("gambler-100-2/5"), solver(max_iterations=1))
    error = pickle.loads(pickle.dumps(caught.value))
    assert error.status is Status.ITERATION_LIMIT
    assert str(error) == str(caught.value)


@pytest.mark.parametrize("kind", SWEEPING)
def test_what_was_reached_is_of_the_model_that_was_asked_for(kind: Any) -> None:
    """Costs are those of the user; values of merged states, where staying is free, are not said."""
    rows = [(0, 0, [("9/10", 0, -1), ("1/10", 1, 0)]), (0, 1, [("1/2", 0, -3), ("1/2", 1, -1)])]
    rows += [(1, 0, [("9/10", 1, -2), ("1/10", 2, 0)]), (2, 0, [(1, 2, 0)])]
    costs = negated(MDP.from_outcomes(rows))
    for ask in (solve, lambda model, solver: solver.solve(model)):
        with pytest.raises(SolverError) as caught:
            ask(costs, kind(max_iterations=1))
        reached = caught.value.solution
        assert reached is not None
        assert reached.mdp is costs
        assert reached.start.interval[0] <= certify(costs).start_value <= reached.start.interval[1]
    with pytest.raises(SolverError) as caught:
        solve(MDP.from_outcomes([*rows[:3], (1, 1, [(1, 1, 0)]), rows[3]]), kind(max_iterations=1))
    assert caught.value.solution is None


@pytest.mark.parametrize(
    "solver", [*(kind() for kind in SOLVERS.values()), LinearProgram(solver="HIGHS")], ids=repr
)
def test_values_beyond_floats_are_refused(solver: Solver) -> None:
    big = F(5 * 10**307)
    rows = [(1, 0, big, {1: F(9, 10), 0: F(1, 10)}), (0, 0, F(0), {0: F(1)})]
    if solver.name == "backward-induction":
        rows = [(s, 0, big, {s - 1: F(1)}) for s in range(1, 9)] + rows[1:]
    with pytest.raises(SolverError):
        solve(model_of(max(s for s, *_ in rows) + 1, rows, F(1)), solver)


def test_an_end_too_far_away_is_refused() -> None:
    with pytest.raises(SolverError, match="certify"):
        solve(case_model("reset-chain-100-7/10-steps"), PolicyIteration())


# ---- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "joint"),
    [
        ([(F(1), 1, F(1, 10**400))], False),
        ([(F(1), 1, F(-1, 10**400))], False),
        ([(F(1, 2), 1, F(1, 10**400)), (F(1, 2), 1, F(2, 10**400))], True),
        ([(1e-200, 1, 1e-200), (1 - 1e-200, 1, 0.0)], True),
        ([(F(1), 1, F(0))], False),
    ],
)
def test_rewards_below_the_range_of_floats_are_allowed_for(row: Any, joint: bool) -> None:
    end = [(type(row[0][0])(1), 1, type(row[0][2])(0))]
    mdp = MDP.from_outcomes([(0, 0, row), (1, 0, end)])
    assert mdp.table.joint is joint
    exact = sum(F(p) * F(r) for p, _, r in row)
    solution = solve(mdp, BackwardInduction())
    assert solution.value[0] == 0
    assert abs(exact) <= F(float(solution.state_error[0])) < F(1, 10**280)
    assert exact or not solution.state_error.any()


@pytest.mark.parametrize("name", ["backward-induction", "policy-iteration"])
def test_rewards_that_cancel_are_known_no_better_than_their_sum(name: str) -> None:
    """Floats add up to 0 here, where the exact expected reward is 1/180 or so."""
    outcomes = [(0.1, 1, 1e15), (0.2, 1, 3e15), (0.7, 1, -1e15)]
    mdp = MDP.from_outcomes([(0, 0, outcomes), (1, 0, [(1, 1, 0)])])
    exact = sum(F(p) * F(reward) for p, _, reward in outcomes)
    solution = solve(mdp, name)
    assert F(1, 1000) < abs(F(solution.value[0]) - exact) <= F(float(solution.state_error[0]))


# ---- linear programs -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pig-turn", "gambler-64-1/4", "puterman-two-state-9/10", "care",
                                  "garnet"])  # fmt: skip
def test_a_program_is_as_exact_as_the_others(name: str) -> None:
    made = {
        "care": Scenario.load("yuan2025").compile,
        "garnet": lambda: garnet(120, seed=0, discount=0.95),
    }
    mdp = made[name]() if name in made else case_model(name)
    low, high = solve(mdp, LinearProgram()).start.interval
    assert high - low < 1e-9
    assert F(low) <= certify(mdp).start_value <= F(high)


def test_an_optimiser_that_fails_or_errs_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp, honest = case_model("pig-turn"), cp.Problem.solve

    def breaks(problem: cp.Problem, **_: object) -> None:
        raise cp.SolverError("numerical trouble")

    def errs(problem: cp.Problem, **more: Any) -> Any:
        honest(problem, **more)
        for variable in problem.variables():
            variable.value = 1.001 * variable.value
        problem._value *= 1.001

    for way, words in (
        (breaks, "numerical trouble"),
        (lambda problem, **_: None, "CLARABEL says None"),
        (errs, "found a mean value of"),
    ):
        monkeypatch.setattr(cp.Problem, "solve", way)
        with pytest.raises(SolverError, match=words):
            solve(mdp, LinearProgram())


# ---- what is returned ----------------------------------------------------------------------------


def test_a_solution_cannot_be_changed() -> None:
    solution = solve(case_model("pig-turn"))
    with pytest.raises(ValueError, match="read-only"):
        solution.value[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        solution.claim = Claim.CERTIFIED
    assert solution.claim == "bounded"
    assert str(solution.start) in repr(solution)
    assert "solved directly" in repr(solution)


def test_three_kinds_of_number() -> None:
    third = Certified(value=F(1, 3))
    low, high = third.interval
    assert F(low) < F(1, 3) < F(high)
    bounded = Bounded(value=1.0, error=0.5)
    assert bounded.interval[0] < 0.5 < 1.5 < bounded.interval[1]
    sampled = Estimated(value=1.0, standard_error=0.5)
    assert [(one.claim.value, str(one)) for one in (third, bounded, sampled)] == [
        ("certified", "1/3 (certified)"),
        ("bounded", "1 ± 0.5 (bounded)"),
        ("estimated", "1 ± 0.5 s.e. (estimated)"),
    ]
    assert str(Estimated(value=1408.1, standard_error=162.0)) == "1408.1 ± 160 s.e. (estimated)"
    # Python writes no integer of over 4,300 digits
    assert str(Certified(value=F(3**9500, 4**7529))) == "≈ 0.552389135964 (certified)"


@pytest.mark.parametrize("form", [sp.csr_array, sp.csr_matrix, sp.csc_array])
def test_room_behind_the_entries_of_a_sparse_matrix_is_left_out(form: Any) -> None:
    rows = form(np.array([[0.5, 0.5], [0.0, 1.0]]))
    entries, places = np.append(rows.data, [7.0, 8.0]), np.append(rows.indices, [0, 99])
    roomy = rows.copy()
    roomy.data, roomy.indices = entries, places
    model = MDP.from_arrays([roomy], [[1], [0]], discount="1/2")
    assert model.transition.toarray().tolist() == [[0.5, 0.5], [0.0, 1.0]]
    assert len(roomy.data) == 5
    roomy.indptr = roomy.indptr + np.array([0, 0, 9], roomy.indptr.dtype)
    with pytest.raises(ModelError, match="indptr"):
        MDP.from_arrays([roomy], [[1], [0]], discount="1/2")


@pytest.mark.parametrize("kind", SWEEPING)
@pytest.mark.parametrize("name", ["howard-taxicab", "forest-10-24/25"])
def test_relaxed_values_are_not_shifted_for_ever(name: str, kind: Any) -> None:
    """Where errors differ from state to state, a shift to the middle of the bounds adds to them."""
    solution = solve(case_model(name), kind(max_iterations=200))
    assert solution.status is Status.CONVERGED


def test_small_values_beside_large_ones_are_found_as_closely() -> None:
    """A tolerance that is a part of the largest value is no reason to stop at the first pass."""
    rows = [(0, 0, [(1, 0, 0)]), (1, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (2, 0, [(1, 0, 10**9)])]
    assert solve(MDP.from_outcomes(rows, "1/2")).value[1] == pytest.approx(4 / 3, rel=1e-12)
