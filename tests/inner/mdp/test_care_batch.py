"""The batched engine against the explicit model, and against exact fractions."""

import json
from fractions import Fraction as F
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from care_oracle import ACTIONS, READINGS, Oracle
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, Policy, Scenario, StateSpace, evaluate, solve
from exact_mdp.solvers.care import Batch, optimal, policy_values

YUAN = Scenario.load("yuan2025")
CHANCES = [p.name for p in YUAN.parameters if p.low is not None]
WEIGHTS = [p.name for p in YUAN.parameters if p.low is None]


def status_of(number: int) -> tuple[int, ...]:
    return tuple(number >> shift & 1 for shift in (3, 2, 1, 0))


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
    found = optimal(scenario, names, draws, gaps=True, actions=True)
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
    moments = policy_values(scenario, names, draws, policy[None], second_moment=True)
    told = oracle.evaluate(
        lambda state: {ACTIONS[policy[int("".join(map(str, state[3])), 2)]]: F(1)},
        distribution=False,
    )
    assert abs(F(moments.mean[0, 0]) - told["mean"]) <= F(moments.error[0])
    assert abs(F(moments.variance[0, 0]) - told["variance"]) <= F(moments.variance_error[0])


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
    shares = rng.dirichlet(np.ones(4), size=(2, 16))
    pure = rng.integers(0, 4, size=(3, 16))
    found = optimal(scenario, names, draws, actions=True)
    mixed = policy_values(scenario, names, draws, shares, second_moment=True)
    plain = policy_values(scenario, names, draws, pure, second_moment=True)
    best = policy_values(scenario, names, draws, found.actions, second_moment=True)
    for d, row in enumerate(draws):
        mdp = compiled(scenario, names, row)
        start = solve(mdp).start
        assert abs(found.start[d] - start.value) <= found.error[d] + start.error
        assert best.mean[d, d] == pytest.approx(found.start[d], abs=found.error[d])
        by_status = StateSpace(columns=(mdp.space.column("status"),))
        for policies, moments in ((shares, mixed), (pure, plain)):
            for n, policy in enumerate(policies):
                share = policy if policy.ndim == 2 else np.eye(4)[policy]
                table = np.zeros((16, mdp.n_actions))
                table[:, :4] = share
                told = evaluate(mdp, Policy(space=by_status, actions=mdp.actions, rule=table))
                assert moments.mean[d, n] == pytest.approx(told.mean, abs=1e-9)
                assert np.sqrt(moments.variance[d, n]) == pytest.approx(told.sd, rel=1e-7)


@pytest.mark.parametrize("name", ["tea", "yuan2025"])
def test_shipped_scenarios_are_solved_as_they_are(name: str) -> None:
    scenario = Scenario.load(name)
    found, start = optimal(scenario), solve(scenario.compile()).start
    assert abs(found.start[0] - start.value) <= found.error[0] + start.error
    assert found.error[0] < 1e-9


@pytest.mark.parametrize(("gaps", "actions"), list(product([False, True], repeat=2)))
def test_the_order_of_draws_and_what_is_kept_change_no_bit(gaps: bool, actions: bool) -> None:
    names, draws = sampled(1100, seed=3)
    one = optimal(YUAN, names, draws, gaps=True, actions=True)
    two = optimal(YUAN, names, draws[::-1], gaps=gaps, actions=actions)
    assert one.start.tobytes() == two.start[::-1].tobytes()
    for kept, asked, known in ((two.gaps, gaps, one.gaps), (two.actions, actions, one.actions)):
        assert (kept is not None) == asked
        assert kept is None or np.array_equal(kept[::-1], known)


def test_a_policy_among_many_is_that_policy_alone() -> None:
    policies = np.random.default_rng(4).integers(0, 4, size=(1300, 16))
    many = policy_values(YUAN, (), None, policies, second_moment=True)
    assert policy_values(YUAN, (), None, policies[7:8]).mean[0, 0] == many.mean[0, 7]


def test_a_policy_for_every_state_is_that_of_a_status_where_it_does_not_look() -> None:
    rng = np.random.default_rng(5)
    scenario = YUAN.with_(readings={"task_bonus": "no-subtask-skipped"}, tasks=[2, 1])
    policies, shares = rng.integers(0, 4, (2, 16)), rng.dirichlet(np.ones(4), (2, 16))
    for given_ in (policies, shares):
        wide = np.broadcast_to(given_[:, None, None, None], (2, 3, 5, 2, *given_.shape[1:]))
        one = policy_values(scenario, (), None, given_, second_moment=True)
        two = policy_values(scenario, (), None, wide, second_moment=True)
        assert np.array_equal(one.mean, two.mean)
        assert np.array_equal(one.variance, two.variance)


@pytest.mark.parametrize(
    ("names", "draws", "message"),
    [
        (["base.angr"], [[0.1]], "unknown parameter 'base.angr'"),
        (["base.anger"], [[1.5]], r"base.anger is drawn as 1.5, outside \[0, 1\]"),
        (["base.anger"], [[-1e-9]], "base.anger is drawn as -1e-09"),
        (["discount"], [[1.01]], "discount is drawn as 1.01"),
        (["reward.trial"], [[np.inf]], "reward.trial is drawn as inf"),
        (["reward.trial"], [[np.nan]], "reward.trial is drawn as nan"),
        (["base.anger"], [0.1], "shape"),
        (["base.anger"], np.empty((0, 1)), "shape"),
        (["base.anger", "base.anger"], [[0.1, 0.1]], "drawn twice"),
    ],
)
def test_draws_that_cannot_be_are_refused(names, draws, message) -> None:
    with pytest.raises(ModelError, match=message):
        optimal(YUAN, names, draws)


@pytest.mark.parametrize(
    "policies",
    [
        np.zeros((1, 15), dtype=int),
        np.full((1, 16), 4),
        np.full((1, 16), -1),
        np.zeros((1, 16)),
        np.zeros((0, 16), dtype=int),
        np.full((1, 16, 4), 0.3),
        np.full((1, 16, 4), np.nan),
    ],
)
def test_policies_that_cannot_be_are_refused(policies: np.ndarray) -> None:
    with pytest.raises(ModelError, match="polic"):
        policy_values(YUAN, (), None, policies)


def simple(folder: Path, actions: int) -> Scenario:
    """Return a scenario of one status, in which all but the second action differ by price alone."""
    words = [f"a{number}" for number in range(actions)]
    lines = [
        'name = "simple"\ntitle = "one status"\nsource = "made up"\nstatuses = ["x"]',
        f"actions = {json.dumps(words)}\ntasks = [2]\nmax_trial = 3\ndiscount = 1",
        '[readings]\nskip_onset = "base"\n[base]\nx = 0.25\n[persistence]\nx = 0.9',
        "[assistance.a1.x]\npersistence = 0.3\nonset = 0.1\n[skip.x]\npersistence = 0.4",
        "[reward]\nx = -1\ntrial = -1\nsubtask-complete = 20\nsubtask-skip = -8",
        "timestep = -0.5\ntask-complete = 10\n[reward.assist]\na0 = 0\na1 = -2",
        *(f"{word} = -3" for word in words[2:]),
    ]
    file = folder / "simple.toml"
    file.write_text("\n".join(lines))
    return Scenario.load(file)


def test_more_weights_than_chances_have_room(tmp_path: Path) -> None:
    scenario, actions = simple(tmp_path, 8), 8
    names, draws = ["base.x", "persistence.x"], np.array([[0.2, 0.7], [0.6, 0.5]])
    batch = Batch(scenario, names, draws)
    room = batch.room()
    assert len(room.numbers) == len(batch.base)  # `place` writes all of them
    assert room.assist.shape == (actions,)
    found = optimal(scenario, names, draws, actions=True)
    last = policy_values(scenario, names, draws, np.full((1, 2), actions - 1))
    assert found.actions is not None
    assert found.actions.min() >= 0
    for d, row in enumerate(draws):
        mdp = compiled(scenario, names, row)
        start = solve(mdp).start
        assert abs(found.start[d] - start.value) <= found.error[d] + start.error
        told = evaluate(mdp, f"always:a{actions - 1}")
        assert abs(last.mean[d, 0] - told.mean) <= last.error[d] + told.start.error
    table = np.zeros((1, *found.actions.shape[1:]), dtype=int) + actions - 1
    staged = policy_values(scenario, names, draws, table)
    assert np.array_equal(staged.mean, last.mean)


def test_actions_that_have_no_number_are_not_kept(tmp_path: Path) -> None:
    many, few = simple(tmp_path, 130), simple(tmp_path, 8)
    assert optimal(many).start == pytest.approx(optimal(few).start)
    with pytest.raises(ModelError, match="130 actions"):
        optimal(many, actions=True)


def test_rewards_that_overflow_are_refused_before_they_do() -> None:
    names = ["reward.trial", "reward.assist.directive"]
    for call in (
        lambda: optimal(YUAN, names, [[1e308, -1e308]], actions=True),
        lambda: policy_values(YUAN, names, [[1e307, 0]], np.zeros((1, 16), dtype=int)),
        lambda: policy_values(
            YUAN, names, [[1e160, 0]], np.zeros((1, 16), dtype=int), second_moment=True
        ),
    ):
        with pytest.raises(ModelError, match="overflow"):
            call()
    assert np.isfinite(optimal(YUAN, names, [[1e200, 0]], actions=True).start).all()


def test_shares_that_sum_to_one_but_for_rounding_are_those_of_a_policy() -> None:
    shares = np.random.default_rng(6).dirichlet(np.ones(4), size=(1, 16))
    exact, off = (policy_values(YUAN, (), None, each) for each in (shares, shares * (1 - 9e-13)))
    assert abs(exact.mean - off.mean).item() < 1e-12 * abs(exact.mean).item()


def test_policies_that_change_from_stage_to_stage_are_those_of_the_explicit_model() -> None:
    rng = np.random.default_rng(7)
    scenario = YUAN.with_(tasks=[2, 1], max_trial=2)
    names, draws = sampled(2, seed=8)
    found = optimal(scenario, names, draws, actions=True)
    assert found.actions is not None
    tables = np.concatenate([found.actions, rng.integers(0, 4, (2, *found.actions.shape[1:]))])
    pure = policy_values(scenario, names, draws, tables, second_moment=True)
    mixed = policy_values(scenario, names, draws, np.eye(4)[tables], second_moment=True)
    assert np.allclose(pure.mean, mixed.mean, rtol=1e-12)
    assert np.allclose(pure.variance, mixed.variance, rtol=1e-10)
    assert np.allclose(np.diag(pure.mean[:, :2]), found.start, rtol=1e-12)
