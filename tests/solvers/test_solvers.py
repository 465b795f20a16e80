"""Every solver in the list, against published answers, rational arithmetic and each other."""

import dataclasses
import pickle
from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from cases import BY_NAME, CASES, Case
from hypothesis import given, settings
from model_contents import is_acyclic
from solver_checks import (
    BRIEF,
    QUICK,
    SWEEPING,
    case_model,
    check_against_exact,
    outcome,
    settings_of,
)
from strategies import Rows, model_of, models

from exact_mdp import (
    MDP,
    SOLVERS,
    Bounded,
    Certified,
    Claim,
    Estimated,
    GaussSeidel,
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
    solve,
)

PROGRAMS = [LinearProgram(solver=name) for name in ("CLARABEL", "HIGHS")]
BAD: dict[str, Sequence[object]] = {
    "tol": [0, -1.0, float("nan"), float("inf")],
    "max_iterations": [0, -3, 1.5],
    "solver": ["HIGH"],
}
HARD = [case for case in CASES if case.name.startswith("reset-chain")]


@pytest.mark.filterwarnings("ignore::exact_mdp.PrecisionWarning")
@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_published_answers(case: Case, name: str) -> None:
    mdp = case_model(case)
    found = outcome(mdp, QUICK[name])
    if isinstance(found, ModelError):
        cyclic = name == "backward-induction" and not is_acyclic(mdp)
        assert cyclic or not case.proper
        return
    if isinstance(found, SolverError):
        assert case in HARD
        if found.solution is None:
            return
        found = found.solution
    for state, value in case.values.items():
        error = abs(F(float(found.value[state])) - F(value))
        assert error <= F(float(found.state_error[state])) + F(case.tolerance)
    if found.status is Status.ITERATION_LIMIT:
        return
    size = max(1.0, float(np.abs(found.value).max()))
    assert found.error_bound <= (1e-8 if case in HARD else 1e-9) * size
    for state, actions in case.optimal.items():
        assert found.policy[state] in actions
    assert found.method == name


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "linear-program"])
@given(rows=models())
def test_exact_optimum_lies_within_the_bounds(name: str, rows: Rows) -> None:
    check_against_exact(rows, BRIEF[name])


def mixed(states: int, discount: str) -> MDP:
    """Stay, or go to one of three others: choices that are best for long and best for now."""
    here = np.arange(states)
    after = np.concatenate([(here + 1) % states, (7 * here + 3) % states, (13 * here + 5) % states])
    entries = (np.repeat([0.25, 0.25, 0.5], states), (np.tile(here, 3), after))
    go = sp.coo_array(entries, (states, states)).tocsr()
    reward = np.random.default_rng(0).normal(size=(states, 2))
    return MDP.from_arrays([sp.eye_array(states, format="csr"), go], reward, discount)


@pytest.mark.parametrize("discount", ["99/100", "999/1000", "9999/10000", "999999/1000000"])
@pytest.mark.parametrize("states", [400, 800, 3000, 6000])
def test_the_default_converges_whatever_the_size(states: int, discount: str) -> None:
    solution = solve(mixed(states, discount))
    assert solution.status is Status.CONVERGED
    assert solution.iterations < 100  # sweeps alone would take 20 / (1 - γ) of them


@pytest.mark.parametrize("states", [500, pytest.param(6000, marks=pytest.mark.slow)])
def test_discounts_next_to_1_leave_the_digits_that_tell_states_apart(states: int) -> None:
    """Values of 3e9 are found to 1, though 1e-7 of them is all that their equations keep."""
    mdp = mixed(states, "999999999/1000000000")
    found, other = solve(mdp), solve(mdp, PolicyIteration())
    assert found.status is Status.CONVERGED
    assert found.iterations < 60
    assert found.error_bound < 1 < 1e-9 * found.value.max()
    assert (np.abs(found.value - other.value) <= found.state_error + other.state_error).all()


@pytest.mark.parametrize("solver", PROGRAMS, ids=repr)
@settings(max_examples=15)
@given(rows=models())
def test_exact_optimum_lies_within_the_bounds_of_a_program(
    solver: LinearProgram, rows: Rows
) -> None:
    check_against_exact(rows, solver)


def test_solvers_agree_on_the_care_model() -> None:
    scenario = Scenario.load("yuan2025")
    for discount in (1, "19/20"):
        mdp = scenario.compile().with_(discount=discount)
        found = [solve(mdp, name) for name in SOLVERS] + [solve(mdp, one) for one in PROGRAMS]
        for one in found:
            assert one.error_bound < 1e-9
            assert one.policy.tolist() == found[0].policy.tolist()
            assert (np.abs(one.value - found[0].value) <= 2e-9).all()


def test_the_default_depends_on_cycles() -> None:
    assert solve(case_model(BY_NAME["gambler-30-1/2"])).method == "modified-policy-iteration"
    assert solve(case_model(BY_NAME["secretary-10"]), "auto").method == "backward-induction"
    assert solve(case_model(BY_NAME["secretary-10"]), "value-iteration").iterations > 1


@pytest.mark.parametrize("name", SOLVERS)
def test_names_are_those_of_the_list(name: str) -> None:
    solver = SOLVERS[name]()
    assert solver.name == name
    assert repr(solver).startswith(type(solver).__name__)
    assert hash(solver) == hash(SOLVERS[name]())


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ModelError, match="did you mean policy-iteration"):
        solve(case_model(BY_NAME["secretary-2"]), "policy-iterations")


@pytest.mark.parametrize("name", SOLVERS)
def test_a_policy_that_never_ends_is_worth_the_limit_of_discounted_values(name: str) -> None:
    mdp = MDP.from_arrays([[[0, 1], [1, 0]]], [1, -1])
    found = solve(mdp, name)
    assert (np.abs(found.value - [0.5, -0.5]) <= found.state_error).all()


@pytest.mark.parametrize("name", SOLVERS)
def test_answers_are_the_same_every_time(name: str) -> None:
    mdp = case_model(BY_NAME["pig-turn"])
    one, two = solve(mdp, name), solve(case_model(BY_NAME["pig-turn"]), name)
    assert one.value.tobytes() == two.value.tobytes()
    assert one.state_error.tobytes() == two.state_error.tobytes()
    assert one.policy.tolist() == two.policy.tolist()


@pytest.mark.parametrize("kind", SOLVERS.values())
@pytest.mark.parametrize("setting", BAD)
def test_settings_that_are_none_are_refused(kind: type, setting: str) -> None:
    for value in BAD[setting] if setting in settings_of(kind) else ():
        with pytest.raises(ModelError, match=setting):
            kind(**{setting: value})


@pytest.mark.parametrize("kind", SWEEPING)
@pytest.mark.parametrize("tol", [1e-2, 1e-6, 1e-10])
def test_the_tolerance_is_met(kind: type, tol: float) -> None:
    case = BY_NAME["gambler-100-2/5"]
    found = solve(case_model(case), kind(tol=tol))
    assert found.error_bound <= tol
    assert found.status is Status.CONVERGED
    assert all(abs(F(float(found.value[s])) - v) <= F(tol) for s, v in case.values.items())


@pytest.mark.parametrize("kind", SWEEPING)
def test_a_tolerance_beyond_double_precision_warns(kind: type) -> None:
    case = BY_NAME["gambler-100-2/5"]
    with pytest.warns(PrecisionWarning, match="certify"):
        found = solve(case_model(case), kind(tol=1e-18))
    assert found.status is Status.PRECISION
    assert 1e-18 < found.error_bound < 1e-10


def test_small_last_changes_are_no_reason_to_stop() -> None:
    # Stopping when a sweep changes less than 1e-6 gives 0.33 for a true 1/2 here.
    case = BY_NAME["reset-chain-20-1/2-goal"]
    mdp = case_model(case)
    with pytest.raises(SolverError, match="raise max_iterations") as caught:
        solve(mdp, ValueIteration(tol=1e-6, max_iterations=100))
    reached = caught.value.solution
    assert reached is not None
    assert abs(reached.start_value - 0.5) <= reached.start.error
    for kind in (ModifiedPolicyIteration, ValueIteration):
        found = solve(mdp, kind(tol=1e-6))
        assert found.error_bound <= 1e-6
        assert found.iterations < 200
        assert abs(found.start_value - 0.5) <= found.start.error


@pytest.mark.parametrize("name", ["howard-taxicab", "forest-10-24/25"])
def test_relaxed_values_are_not_shifted_for_ever(name: str) -> None:
    """Where errors differ from state to state, a shift to the middle of the bounds adds to them."""
    found = solve(case_model(BY_NAME[name]), GaussSeidel(max_iterations=200))
    assert found.status is Status.CONVERGED


@pytest.mark.parametrize("kind", [ModifiedPolicyIteration, PolicyIteration])
def test_policies_are_not_improved_for_ever(kind: type) -> None:
    mdp = case_model(BY_NAME["gambler-100-2/5"])
    with pytest.raises(SolverError, match="iteration limit") as caught:
        solve(mdp, kind(max_iterations=1))
    error = pickle.loads(pickle.dumps(caught.value))
    assert error.status is Status.ITERATION_LIMIT
    assert str(error) == str(caught.value)


@pytest.mark.parametrize("solver", [*QUICK.values(), *PROGRAMS], ids=repr)
def test_values_beyond_floats_are_refused(solver: Solver) -> None:
    big = F(5 * 10**307)
    rows = [(1, 0, big, {1: F(9, 10), 0: F(1, 10)}), (0, 0, F(0), {0: F(1)})]
    if solver.name == "backward-induction":
        steps = [(s, 0, big, {s - 1: F(1)}) for s in range(1, 9)]
        rows = [*steps, (0, 0, F(0), {0: F(1)})]
    n_states = max(s for s, *_ in rows) + 1
    with pytest.raises(SolverError):
        solve(model_of(n_states, rows, F(1)), solver)


# ---- linear programs -------------------------------------------------------------------------


@pytest.mark.parametrize("solver", PROGRAMS, ids=repr)
@pytest.mark.parametrize("name", ["pig-turn", "gambler-64-1/4", "puterman-two-state-9/10"])
def test_gaps_and_visits(solver: LinearProgram, name: str) -> None:
    case = BY_NAME[name]
    mdp = case_model(case)
    found = solve(mdp, solver)
    assert found.gaps is not None
    assert found.occupancy is not None
    q = mdp.backup(solve(mdp, PolicyIteration()).value)
    gaps = found.value[mdp.pair_state] - q
    assert np.abs(found.gaps - gaps).max() < 1e-9
    assert found.gaps.min() > -1e-12
    assert found.occupancy.min() >= 0
    assert (found.occupancy[found.gaps > 1e-9] == 0).all()
    assert float(found.occupancy @ mdp.reward) == pytest.approx(found.start_value, abs=1e-12)
    # What flows in flows out, except at the end.
    used = np.bincount(mdp.pair_state, found.occupancy, minlength=mdp.n_states)
    inflow = mdp.start_distribution + mdp.discount * (mdp.transition.T @ found.occupancy)
    assert np.abs((used - inflow)[~mdp.terminal]).max() < 1e-12


def test_an_optimiser_that_fails_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = case_model(BY_NAME["pig-turn"])

    def breaks(problem: cp.Problem, **_: object) -> None:
        raise cp.SolverError("numerical trouble")

    monkeypatch.setattr(cp.Problem, "solve", breaks)
    with pytest.raises(SolverError, match="numerical trouble"):
        solve(mdp, LinearProgram())
    monkeypatch.setattr(cp.Problem, "solve", lambda problem, **_: None)
    with pytest.raises(SolverError, match="CLARABEL says None"):
        solve(mdp, LinearProgram())


# ---- what is returned ------------------------------------------------------------------------


def test_a_solution_cannot_be_changed() -> None:
    found = solve(case_model(BY_NAME["pig-turn"]))
    with pytest.raises(ValueError, match="read-only"):
        found.value[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.claim = Claim.CERTIFIED
    assert found.claim == "bounded"
    assert str(found.start) in repr(found)
    assert "solved directly" in repr(found)


def test_the_start_may_be_spread_over_states() -> None:
    case = BY_NAME["gambler-30-1/2"]
    mdp = case_model(case).with_(start={3: "1/3", 7: "2/3"})
    found = solve(mdp, PolicyIteration())
    exact = F(1, 3) * case.values[3] + F(2, 3) * case.values[7]
    assert abs(F(found.start_value) - exact) <= F(found.start.error)
    assert found.start.error < 1e-12


def test_three_kinds_of_number() -> None:
    third = Certified(value=F(1, 3))
    assert third.claim == "certified"
    low, high = third.interval
    assert F(low) < F(1, 3) < F(high)
    bounded = Bounded(value=1.0, error=0.5)
    assert bounded.claim == "bounded"
    assert bounded.interval[0] < 0.5 < 1.5 < bounded.interval[1]
    sampled = Estimated(value=1.0, standard_error=0.5)
    assert sampled.claim == "estimated"
    assert [str(one) for one in (third, bounded, sampled)] == [
        "1/3 (certified)",
        "1 ± 0.5 (bounded)",
        "1 ± 0.5 s.e. (estimated)",
    ]
    # Python writes no integer of over 4,300 digits
    assert str(Certified(value=F(3**9500, 4**7529))) == "≈ 0.552389135964 (certified)"


@pytest.mark.parametrize("tol", ["x", True, 0, -1.0, np.inf, np.nan])
def test_a_tolerance_is_a_positive_number(tol: Any) -> None:
    with pytest.raises(ModelError, match="tol is"):
        solve(MDP.from_arrays([[[1]]], [1], discount="1/2"), tol=tol)


@pytest.mark.parametrize("form", [sp.csr_array, sp.csr_matrix, sp.csc_array])
def test_room_behind_the_entries_of_a_sparse_matrix_is_left_out(form: Any) -> None:
    rows = form(np.array([[0.5, 0.5], [0.0, 1.0]]))
    entries, places = np.append(rows.data, [7.0, 8.0]), np.append(rows.indices, [0, 99])
    roomy = rows.copy()
    roomy.data, roomy.indices = entries, places
    found = MDP.from_arrays([roomy], [[1], [0]], discount="1/2")
    assert found.transition.toarray().tolist() == [[0.5, 0.5], [0.0, 1.0]]
    assert len(roomy.data) == 5
    roomy.indptr = roomy.indptr + np.array([0, 0, 9], roomy.indptr.dtype)
    with pytest.raises(ModelError, match="indptr"):
        MDP.from_arrays([roomy], [[1], [0]], discount="1/2")
