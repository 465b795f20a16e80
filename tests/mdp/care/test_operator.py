"""The care model without its matrix, against the explicit one."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from own_scenarios import own_text

import exact_mdp.mdp.care.operator as operators
from exact_mdp.analysis.gate.check import check
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.care.operator import CareOperator, Law
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.care.toml import parse
from exact_mdp.solvers import (
    BackwardInduction,
    LinearProgram,
    ModifiedPolicyIteration,
    PolicyIteration,
    ValueIteration,
    certify,
    evaluate,
    return_distribution,
    simulate,
    solve,
)
from exact_mdp.solvers.dynamic import operator as solving

READ = st.fixed_dictionaries({name: st.sampled_from(o) for name, o in READINGS.items()})
TASKS = st.sampled_from([[1], [2], [2, 1], [1, 2, 1]])
CHANCES = st.fractions(min_value=0, max_value=1, max_denominator=40)


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    scenario = Scenario.load("yuan2025").with_(
        tasks=draw(TASKS),
        max_trial=draw(st.integers(1, 3)),
        discount=draw(st.sampled_from(["1", "9/10", "1/3"])),
        readings=draw(READ),
    )
    names = [name for name in scenario.names if not name.startswith("reward.")]
    changes = draw(st.dictionaries(st.sampled_from(names), CHANCES, max_size=6))
    return scenario.with_(parameters=changes)


def folded(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> CareOperator:
    """The operator that applies its law status by status, however few there are."""
    with monkeypatch.context() as patch:
        patch.setattr(operators, "DENSE_STATUSES", 0)
        return scenario.operator()


@pytest.mark.parametrize("dense", [True, False])
@settings(max_examples=40)
@given(scenario=scenarios(), seed=st.integers(0, 2**32))
def test_operator_and_matrix_agree(dense: bool, scenario: Scenario, seed: int) -> None:
    mdp = scenario.compile()
    with pytest.MonkeyPatch.context() as patch:
        operator = scenario.operator() if dense else folded(scenario, patch)
    assert (operator.n_states, operator.n_pairs) == (mdp.n_states, mdp.n_pairs)
    assert operator.space == mdp.space
    assert operator.actions == mdp.actions
    for name in ("pair_state", "pair_action", "pair_offsets", "terminal"):
        assert np.array_equal(getattr(operator, name), getattr(mdp, name)), name
    value = np.random.default_rng(seed).normal(scale=100, size=mdp.n_states)
    value[-1] = 0
    assert np.abs(operator.backup(value) - mdp.backup(value)).max() <= 1e-11
    found, known = solve(operator), solve(mdp)
    gap = np.abs(found.value - known.value)
    assert (gap <= found.state_error + known.state_error).all()
    assert found.error_bound <= 1e-10
    # Ties are ties up to rounding in both, which may differ in what they call one.
    loss = found.value - mdp.backup(found.value)[found.pairs]
    assert np.abs(loss[:-1]).max() <= 1e-10
    assert abs(found.start_value - known.start_value) <= 1e-10
    assert found.q == pytest.approx(known.q, abs=1e-10, rel=0)  # -inf where not offered


@settings(max_examples=8)
@given(scenario=scenarios())
def test_the_exact_optimum_lies_within_the_bound(scenario: Scenario) -> None:
    exact = certify(scenario.with_(tasks=[1]).compile()).value
    with pytest.MonkeyPatch.context() as patch:
        for operator in (
            scenario.with_(tasks=[1]).operator(),
            folded(scenario.with_(tasks=[1]), patch),
        ):
            found = solve(operator)
            errors = zip(found.value.tolist(), exact, found.state_error.tolist(), strict=True)
            assert all(abs(F(value) - best) <= F(error) for value, best, error in errors)


@pytest.mark.parametrize("option", ["same", "own"])
@pytest.mark.parametrize("bonus", READINGS["task_bonus"])
def test_compiled_loops_give_the_same_bits(
    option: str, bonus: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = Scenario.load("yuan2025").with_(
        tasks=[2, 3], readings={"skip_timestep": option, "task_bonus": bonus}, discount="19/20"
    )
    operator = scenario.operator()
    plain = solving.induce(operator, Law.expect)
    for known, found in zip(plain, solving.compiled_induce(operator), strict=True):
        assert np.array_equal(known, found)
    operator = folded(scenario, monkeypatch)
    plain = solving.induce(operator, Law.expect)
    compiled = solving.induce(operator, solving.compiled_expect)
    for known, found in zip(plain, compiled, strict=True):
        assert np.array_equal(known, found)


def test_folding_agrees_with_the_law_of_seven_statuses_written_out() -> None:
    operator = parse(own_text(7, 3), Scenario).operator()
    x = np.random.default_rng(3).normal(size=128)
    for law in (operator.step, operator.skip):
        matrix = np.ones((len(law.chance), 128, 1))
        for i in range(7):
            p = law.chance[:, :, i, None]
            matrix = np.stack([matrix * (1 - p), matrix * p], axis=3).reshape(len(p), 128, -1)
        assert np.allclose(matrix.sum(axis=2), 1)
        for found in (law.expect(x), solving.compiled_expect(law, x)):
            assert np.abs(found - matrix @ x).max() <= law.error * 2.0**-53 * np.abs(x).max()


@pytest.mark.parametrize("policy", ["random", "always:directive", "optimal"])
def test_means_of_policies(policy: str) -> None:
    scenario = Scenario.load("yuan2025").with_(
        tasks=[2, 1], readings={"skip_timestep": "own", "task_bonus": "no-subtask-skipped"}
    )
    mdp, operator = scenario.compile(), scenario.operator()
    if policy == "random":
        known, given_as = evaluate(mdp, policy).mean, np.full((16, 4), 0.25)
    elif policy == "optimal":
        known, given_as = solve(mdp).start_value, solve(operator).policy
    else:
        known, given_as = evaluate(mdp, policy).mean, np.full(16, 3)
    found = solving.operator_mean(operator, given_as)
    assert abs(found.value - known) <= found.error + 1e-11
    assert found.error < 1e-10


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        *((array, "not a policy") for array in (np.zeros(5, int), np.full(16, 4))),
        *((np.full(shape, 0.5), "not a policy") for shape in ((16, 4), 16)),
        ([[1, 2], [3]], "differ in length"),
    ],
)
def test_what_is_no_policy_is_refused(policy: object, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        solving.operator_mean(Scenario.load("yuan2025").operator(), policy)


def test_fourteen_statuses_load_and_are_solved_without_a_matrix() -> None:
    scenario = parse(own_text(14, 3), Scenario).with_(tasks=[1], max_trial=1)
    with pytest.raises(ModelError, match=r"Scenario\.operator"):
        scenario.compile()
    operator = scenario.operator()
    assert operator.nbytes < 10 * 2**20
    found = solve(operator)
    assert found.value.shape == (2**14 + 1,)
    assert found.error_bound < 1e-10
    with pytest.raises(ModelError, match="15 statuses"):
        parse(own_text(15, 3), Scenario)


def test_other_solvers_are_refused() -> None:
    operator = Scenario.load("yuan2025").operator()
    with pytest.raises(ModelError, match="backward induction alone"):
        solve(operator, PolicyIteration())
    with pytest.raises(ModelError, match="unknown solver 'foo'"):
        solve(operator, "foo")
    assert BackwardInduction().solve(operator).start == solve(operator).start


@pytest.mark.parametrize(
    "use",
    [
        LinearProgram().solve,
        PolicyIteration().solve,
        ValueIteration().solve,
        ModifiedPolicyIteration().solve,
        certify,
        lambda operator: certify(operator, bounded=True),
        lambda operator: evaluate(operator, "random"),
        lambda operator: evaluate(operator, np.zeros(241, dtype=int)),
        lambda operator: return_distribution(operator, "random"),
        lambda operator: simulate(operator, "random", rng=0, n=2),
        lambda operator: check(operator, "random"),
    ],
)
def test_what_needs_a_matrix_says_so(use: Callable[[CareOperator], object]) -> None:
    with pytest.raises(ModelError, match="an operator has no matrix") as refused:
        use(Scenario.load("yuan2025").operator())
    assert "Scenario.compile()" in refused.value.fix
    for served in ("solvers.solve", "operator_mean", "backup"):
        assert served in refused.value.fix


def test_operators_and_their_solutions_can_be_pickled() -> None:
    operator = Scenario.load("yuan2025").operator()
    found = solve(operator)
    again, solution = pickle.loads(pickle.dumps((operator, found)))
    assert np.array_equal(solve(again).value, found.value)
    assert np.array_equal(solution.value, found.value)
    assert np.array_equal(solution.policy, found.policy)
    assert not hasattr(again, "nothing")


@pytest.mark.parametrize("value", [np.zeros(3), 0.0, np.zeros((241, 1)), "abc"])
def test_values_of_another_shape_are_refused(value: object) -> None:
    with pytest.raises(ModelError):
        Scenario.load("yuan2025").operator().backup(value)


@pytest.mark.parametrize("size", ["1e-320", "1e-400"])
def test_rewards_below_the_range_of_floats(size: str) -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    for names in (["reward.trial"], [n for n in scenario.names if n.startswith("reward.")]):
        tiny = scenario.with_(parameters=dict.fromkeys(names, size))
        found, exact = solve(tiny.operator()), certify(tiny.compile()).value
        errors = zip(found.value.tolist(), exact, found.state_error.tolist(), strict=True)
        assert all(abs(F(value) - best) <= F(error) for value, best, error in errors)
        assert found.error_bound < 1e-12


def test_a_solution_takes_24_bytes_for_each_state() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[2, 1], readings={"skip_timestep": "own"})
    found, known = solve(scenario.operator()), solve(scenario.compile())
    arrays = (found.value, found.pairs, found.state_error)
    assert sum(array.nbytes for array in arrays) == 24 * len(found.value)
    assert all(array.base is None for array in arrays)
    assert np.array_equal(found.policy, known.policy)


# ---- on the command line ---------------------------------------------------------------------


def test_the_command_solves_a_scenario_without_its_matrix(tmp_path: Path) -> None:
    words = ("solve", "yuan2025", "--set", "tasks=[2]", "--json")
    out, policy = tmp_path / "found.npz", tmp_path / "policy.csv"
    found = run(*words, "--operator", "--out", out, "--policy-out", policy).result
    known = run(*words).result
    assert list(found) == list(known)
    assert (found["claim"], found["method"]) == ("bounded", "backward-induction")
    assert abs(found["start_value"] - known["start_value"]) <= 1e-10
    assert found["policy"] == known["policy"]
    assert found["stationary"] is None
    with np.load(out) as arrays:
        assert arrays["q"].shape == (161, 4)
    again = run("evaluate", "yuan2025", policy, "--set", "tasks=[2]", "--json").result
    assert abs(again["mean"] - known["start_value"]) <= 1e-9
    assert json.loads((tmp_path / "found.run.json").read_text())["model_hash"] is None


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--certify",), "--certify"),
        (("--certificate", "proof.json"), "--certificate"),
        (("--method", "policy-iteration"), "--method policy-iteration"),
        (("--method", "foo"), "unknown method 'foo'"),
    ],
)
def test_the_command_refuses_what_needs_a_matrix(words: tuple[str, ...], named: str) -> None:
    done = run("solve", "yuan2025", "--operator", *words)
    assert done.status == 2
    assert named in done.err


def test_the_command_says_what_to_do_with_a_large_scenario() -> None:
    large = ("solve", "yuan2025", "--set", "tasks=[90000]")
    done = run(*large)
    assert done.status == 2
    assert "--operator" in done.err
    done = run("solve", "gymnasium:FrozenLake-v1", "--operator")
    assert done.status == 2
    assert "not a scenario" in done.err


def test_ten_thousand_subtasks_agree_with_the_explicit_model_of_a_hundred() -> None:
    scenario = Scenario.load("yuan2025")
    hundred = scenario.with_(tasks=[100])
    known, found = solve(hundred.compile()), solve(hundred.operator())
    assert abs(known.start_value - found.start_value) <= known.error_bound + found.error_bound
    large = solve(scenario.with_(tasks=[10_000]).operator())
    assert large.error_bound < 1e-10 * large.start_value
    # The last hundred subtasks are worth what a model of a hundred is worth.
    last = large.value[-len(found.value) :]
    assert np.abs(last - found.value).max() <= 1e-7
