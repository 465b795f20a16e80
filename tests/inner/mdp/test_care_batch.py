"""The batched engine against the explicit model, and against exact fractions."""

import json
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
from care_oracle import ACTIONS, READINGS, Oracle
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, Policy, Scenario, StateSpace, evaluate, solve, study
from exact_mdp.solvers.care import optimal, policy_values

YUAN = Scenario.load("yuan2025")
CHANCES = [p.name for p in YUAN.parameters if p.low is not None]
WEIGHTS = [p.name for p in YUAN.parameters if p.low is None]
TODAY = np.empty((1, 0))


def status_of(number: int) -> tuple[int, ...]:
    return tuple(number >> shift & 1 for shift in (3, 2, 1, 0))


def staged(scenario: Scenario, shares: np.ndarray) -> np.ndarray:
    """Policies by status (N, V, A), as policies by state."""
    stages = optimal(scenario, (), TODAY).actions.shape[1:-1]
    wide = shares[:, None, None, None]
    return np.broadcast_to(wide, (len(shares), *stages, *shares.shape[1:]))


@st.composite
def worlds(draw: st.DrawFn):
    """Draw readings, a layout, parameters as dyadic numbers, and a policy by status."""
    readings = {name: draw(st.sampled_from(options)) for name, options in READINGS.items()}
    tasks = draw(st.sampled_from([(1,), (2,), (1, 1), (2, 1)]))
    trials = draw(st.integers(1, 2))
    values = {}
    for name in draw(st.sets(st.sampled_from(CHANCES), max_size=12)):
        values[name] = F(draw(st.sampled_from([0, 1, 2, 5, 8, 13, 15, 16])), 16)
    for name in draw(st.sets(st.sampled_from(WEIGHTS), max_size=4)):
        values[name] = F(draw(st.integers(-40, 40)), 4)
    discount = draw(st.sampled_from([F(1), F(1, 2), F(0)]))
    policy = draw(st.lists(st.integers(0, 3), min_size=16, max_size=16))
    return readings, tasks, trials, values, discount, np.array(policy)


@settings(max_examples=3)
@given(worlds())
def test_values_are_those_of_the_exact_reference(world) -> None:
    against_the_reference(world)


@pytest.mark.slow
@settings(max_examples=12)
@given(worlds())
def test_values_of_more_worlds_are_those_of_the_exact_reference(world) -> None:
    against_the_reference(world)


def against_the_reference(world) -> None:
    readings, tasks, trials, values, discount, policy = world
    oracle = Oracle(readings, tasks, trials, discount, values)
    scenario = YUAN.with_(readings=readings, tasks=tasks, max_trial=trials)
    names = [*values, "discount"]
    draws = [[float(v) for v in [*values.values(), discount]]]
    found = optimal(scenario, names, draws)
    best = oracle.value(oracle.start)
    assert abs(F(found.start[0]) - best) <= F(found.error[0])
    for number in range(16):
        state = (0, 0, 1, status_of(number))
        gaps = dict(zip(ACTIONS, found.gaps[0, number], strict=True))
        largest = max(gaps[name] for name in oracle.optimal_actions(state))
        assert largest <= 2 * found.error[0]
        assert ACTIONS[found.actions[0, 0, 0, 0, number]] in {
            name for name, gap in gaps.items() if gap <= 2 * found.error[0]
        }
    value, error = policy_values(scenario, names, draws, staged(scenario, np.eye(4)[policy][None]))
    right = oracle.evaluate(
        lambda state: {ACTIONS[policy[int("".join(map(str, state[3])), 2)]]: F(1)},
        distribution=False,
    )
    assert abs(F(value[0, 0]) - right["mean"]) <= F(error[0])


def sampled(count: int, seed: int) -> tuple[list[str], np.ndarray]:
    rng = np.random.default_rng(seed)
    chances = rng.uniform(0, 1, (count, len(CHANCES)))
    return [*CHANCES, *WEIGHTS], np.hstack([chances, rng.normal(0, 20, (count, len(WEIGHTS)))])


def compiled(scenario: Scenario, names: list[str], row: np.ndarray) -> MDP:
    return scenario.with_(parameters=dict(zip(names, row.tolist(), strict=True))).compile()


def some_readings(count: int) -> list[dict[str, str]]:
    rng = np.random.default_rng(0)
    return [
        {name: options[rng.integers(len(options))] for name, options in READINGS.items()}
        for _ in range(count)
    ]


@pytest.mark.parametrize("readings", some_readings(14))
def test_values_are_those_of_the_explicit_model(readings: dict[str, str]) -> None:
    scenario = YUAN.with_(readings=readings, tasks=[2, 1], max_trial=2, discount="19/20")
    names, draws = sampled(2, seed=1)
    rng = np.random.default_rng(2)
    shares = np.concatenate(
        [rng.dirichlet(np.ones(4), (2, 16)), np.eye(4)[rng.integers(0, 4, (3, 16))]]
    )
    found = optimal(scenario, names, draws)
    values, error = policy_values(scenario, names, draws, staged(scenario, shares))
    best, _ = policy_values(scenario, names, draws, np.eye(4)[found.actions])
    for d, row in enumerate(draws):
        mdp = compiled(scenario, names, row)
        start = solve(mdp).start
        assert abs(found.start[d] - start.value) <= found.error[d] + start.error
        assert best[d, d] == pytest.approx(found.start[d], abs=found.error[d])
        by_status = StateSpace(columns=(mdp.space.column("status"),))
        for n, share in enumerate(shares):
            table = np.zeros((16, mdp.n_actions))
            table[:, :4] = share
            own = evaluate(mdp, Policy(space=by_status, actions=mdp.actions, rule=table)).start
            assert abs(values[d, n] - own.value) <= error[d] + own.error


@pytest.mark.parametrize("name", ["tea", "yuan2025"])
def test_shipped_scenarios_are_solved_as_they_are(name: str) -> None:
    scenario = Scenario.load(name)
    found, start = optimal(scenario, (), TODAY), solve(scenario.compile()).start
    assert abs(found.start[0] - start.value) <= found.error[0] + start.error
    assert found.error[0] < 1e-9


def test_the_order_of_draws_changes_no_bit() -> None:
    names, draws = sampled(1100, seed=3)
    one, two = optimal(YUAN, names, draws), optimal(YUAN, names, draws[::-1])
    assert one.start.tobytes() == two.start[::-1].tobytes()
    assert np.array_equal(one.gaps, two.gaps[::-1])
    assert np.array_equal(one.actions, two.actions[::-1])


def test_a_policy_among_many_is_that_policy_alone() -> None:
    rng = np.random.default_rng(4)
    policies = staged(YUAN, np.eye(4)[rng.integers(0, 4, size=(300, 16))])
    many, _ = policy_values(YUAN, (), TODAY, policies)
    assert policy_values(YUAN, (), TODAY, policies[7:8])[0][0, 0] == many[0, 7]


def test_policies_that_change_from_stage_to_stage_are_those_of_the_explicit_model() -> None:
    rng = np.random.default_rng(7)
    scenario = YUAN.with_(readings={"task_bonus": "no-subtask-skipped"}, tasks=[2, 1], max_trial=2)
    names, draws = sampled(2, seed=8)
    tables = rng.dirichlet(np.ones(4), (2, *optimal(scenario, (), TODAY).actions.shape[1:]))
    values, error = policy_values(scenario, names, draws, tables)
    for d, row in enumerate(draws):
        mdp = compiled(scenario, names, row)
        for n, table in enumerate(tables):
            own = evaluate(mdp, np.append(table.reshape(-1), 1.0)).start
            assert abs(values[d, n] - own.value) <= error[d] + own.error


def test_more_weights_than_chances_have_room(tmp_path: Path) -> None:
    """One status, eight actions that differ by price: arrays are as long as what they hold."""
    words = [f"a{number}" for number in range(8)]
    lines = [
        f'name = "simple"\nstatuses = ["x"]\nactions = {json.dumps(words)}\ntasks = [2]',
        'max_trial = 3\n[readings]\nskip_onset = "base"\n[base]\nx = 0.25\n[persistence]\nx = 0.9',
        "[assistance.a1.x]\npersistence = 0.3\nonset = 0.1\n[skip.x]\npersistence = 0.4",
        "[reward]\nx = -1\ntrial = -1\nsubtask-complete = 20\nsubtask-skip = -8",
        "timestep = -0.5\ntask-complete = 10\n[reward.assist]\na0 = 0",
        *(f"{word} = -3" for word in words[1:]),
    ]
    (tmp_path / "simple.toml").write_text("\n".join(lines))
    scenario, names = Scenario.load(tmp_path / "simple.toml"), ["base.x", "persistence.x"]
    found = optimal(scenario, names, draws := np.array([[0.2, 0.7], [0.6, 0.5]]))
    for d, row in enumerate(draws):
        start = solve(compiled(scenario, names, row)).start
        assert abs(found.start[d] - start.value) <= found.error[d] + start.error


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ({"base.angr": [0.1]}, "unknown parameter 'base.angr'"),
        ({"base.anger": [1.5]}, "base.anger"),
        ({"base.anger": [-1e-9]}, "base.anger"),
        ({"discount": [1.01]}, "discount"),
        ({"reward.trial": [np.inf]}, "reward.trial|finite"),
        ({"reward.trial": [np.nan]}, "reward.trial|finite"),
        ({"base.anger": []}, "point"),
        ({"reward.trial": [1e308], "reward.assist.directive": [-1e308]}, "overflow"),
    ],
)
def test_draws_that_cannot_be_are_refused(points, message) -> None:
    with pytest.raises(ModelError, match=message):
        study(YUAN, points)


def test_large_rewards_that_do_not_overflow_are_solved() -> None:
    found = study(YUAN, {"reward.trial": [1e200]})
    assert np.isfinite(found.optimal).all()
