"""Linear programs: generated constraints, both sides of the duality, and refusals by size."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest
import scipy.sparse as sp
from cases.reference import solve_exact
from hypothesis import given, settings
from large_models import garnet
from oracle import ACTIONS
from strategies import Rows, models

from exact_mdp.mdp import MDP, ModelError, Policy, Scenario
from exact_mdp.mdp.space import StateSpace
from exact_mdp.solvers import LinearProgram, ModifiedPolicyIteration, certify, solve
from exact_mdp.solvers.dynamic import linear_program as programs
from exact_mdp.solvers.dynamic import policy_iteration


@settings(max_examples=60)
@given(rows=models())
def test_both_sides_hold_the_exact_optimum(rows: Rows) -> None:
    mdp = rows.model()
    exact, _ = solve_exact(rows.n_states, rows.pairs, rows.discount)
    start = sum((weight * exact[state] for state, weight in mdp.start), F(0))
    first = mdp.pair_action[mdp.pair_offsets[:-1]]
    found = LinearProgram(start=first).solve(mdp)
    run = found.program
    assert run is not None
    assert F(run.lower) <= start <= F(run.upper)
    size = float(max(map(abs, exact)) + max(abs(r) for _, _, r, _ in rows.pairs))
    assert run.gap <= 1e-7 * max(size, 1)


def test_optimiser_and_generated_constraints_agree() -> None:
    mdp = garnet(120, seed=0, discount=0.95)
    known = solve(mdp, LinearProgram())
    found = solve(mdp, LinearProgram(start=np.zeros(120, dtype=int)))
    assert known.policy.tolist() == found.policy.tolist()
    assert np.abs(known.value - found.value).max() <= known.error_bound + found.error_bound
    assert np.abs(known.occupancy - found.occupancy).max() < 1e-9
    assert known.program.by == "CLARABEL"
    assert found.program.by == "constraint generation"
    assert known.program.used == known.program.constraints == 360
    assert 120 < found.program.used < 360
    for run in (known.program, found.program):
        assert run.lower <= found.start_value <= run.upper
        assert run.gap < 1e-11


@pytest.mark.parametrize("discount", [0.9, 0.99])
def test_a_program_too_large_for_an_optimiser_is_proved_from_a_known_policy(
    discount: float,
) -> None:
    mdp = garnet(20_000, seed=0, discount=discount)
    with pytest.raises(ModelError, match=r"factors could take [\d.]+ GB") as refused:
        LinearProgram().solve(mdp)
    assert "LinearProgram(start=solve(mdp))" in refused.value.fix
    known = solve(mdp, ModifiedPolicyIteration(tol=1e-6))
    found = LinearProgram(start=known).solve(mdp)
    run = found.program
    assert run.rounds <= 3
    assert run.gap < 1e-9 * abs(found.start_value)
    assert run.lower <= found.start_value + found.start.error
    assert known.start_value - known.start.error <= run.upper
    # The visits solve the dual's equations, and so add up to 1 / (1 - γ).
    assert found.occupancy.sum() == pytest.approx(1 / (1 - discount), rel=1e-10)
    assert (found.gaps > -1e-9).all()


def test_a_grid_is_not_refused() -> None:
    side = 100
    state = np.arange(side * side)
    rows, columns = np.divmod(state, side)
    moves = []
    for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        to = np.clip(rows + dr, 0, side - 1) * side + np.clip(columns + dc, 0, side - 1)
        matrix = sp.csr_array((np.ones(len(state)), (state, to)), (len(state), len(state)))
        moves.append(0.8 * matrix + 0.2 * sp.eye_array(len(state), format="csr"))
    mdp = MDP.from_arrays(moves, -np.ones((len(state), 4)), 0.9)
    programs.check_size(mdp, "CLARABEL")
    assert programs._band(mdp) < 5 * side


def test_the_care_model_from_its_own_optimum() -> None:
    mdp = Scenario.load("yuan2025").compile()
    found = LinearProgram(start=solve(mdp)).solve(mdp)
    assert found.program.rounds == 1
    exact = certify(mdp).start_value
    assert F(found.program.lower) <= exact <= F(found.program.upper)
    assert found.program.gap < 1e-9


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (np.zeros(3, int), r"shape \(3,\)"),
        (np.zeros(241), "what is asked for is a policy"),
        (np.full(241, 9), "outside 0 … 3"),
        ("optimal", "unknown kind of policy"),
        ([[1, 2], [3]], "does not hold real numbers"),
        (
            Policy(space=StateSpace(columns=()), actions=ACTIONS, rule=np.full((1, 4), 0.25)),
            "draws",
        ),
    ],
)
def test_what_is_no_policy_of_the_model_is_refused(start: object, message: str) -> None:
    mdp = Scenario.load("yuan2025").compile()
    with pytest.raises(ModelError, match=message):
        LinearProgram(start=start).solve(mdp)


def test_a_policy_that_decides_is_a_start() -> None:
    mdp = Scenario.load("yuan2025").compile()
    always = Policy.of(mdp, "always:directive")
    found = LinearProgram(start=always).solve(mdp)
    known = LinearProgram(start=always.choices(mdp)).solve(mdp)
    assert np.array_equal(found.value, known.value)
    assert found.program.used == known.program.used
    assert "start=…" in found.solver
    assert "start" not in solve(mdp, LinearProgram()).solver


def test_all_constraints_on_the_way_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = garnet(200, seed=3, discount=0.95)
    seen = []

    def evaluated(mdp: MDP, pairs: np.ndarray) -> np.ndarray:
        seen.append(pairs.copy())
        return before(mdp, pairs)

    before = policy_iteration.evaluated
    monkeypatch.setattr(policy_iteration, "evaluated", evaluated)
    found = LinearProgram(start=np.zeros(200, dtype=int)).solve(mdp)
    assert len(seen) == found.program.rounds > 2
    assert found.program.used == len(np.unique([*np.concatenate(seen), *found.pairs]))


def test_refusals_of_random_models_need_no_order_of_the_states(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mdp = garnet(20_000, seed=0)
    assert 1000 < programs._density(mdp) <= programs._band(mdp)
    monkeypatch.setattr(programs, "_band", lambda _: pytest.fail("an order was looked for"))
    with pytest.raises(ModelError, match=r"factors could take .* or more"):
        programs.check_size(mdp, "CLARABEL")
    care = Scenario.load("yuan2025").with_(tasks=[40]).compile()
    assert programs._density(care) < 50
