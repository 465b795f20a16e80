"""The batched engine of care and its rules, against exact fractions and the explicit model."""

from __future__ import annotations

import json
from fractions import Fraction as F
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from care_oracle import ACTIONS, Oracle
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, READINGS, ModelError, Scenario, evaluate, solve, study
from exact_mdp.mdp.care import rules
from exact_mdp.mdp.care.laws import chances, excess
from exact_mdp.mdp.care.tables import Tables
from exact_mdp.solvers.care import optimal, policy_values

YUAN = Scenario.load("yuan2025")
CHANCES = [p.name for p in YUAN.parameters if p.low is not None]
WEIGHTS = [p.name for p in YUAN.parameters if p.low is None]
TODAY = np.empty((1, 0))


# ---- the batched engine --------------------------------------------------------------------------


@st.composite
def worlds(draw: st.DrawFn) -> Any:
    """Draw readings, a layout, parameters as dyadic numbers, and a policy by status."""
    readings = {name: draw(st.sampled_from(options)) for name, options in READINGS.items()}
    tasks = draw(st.sampled_from([(1,), (2,), (1, 1), (2, 1)]))
    values = {}
    for name in draw(st.sets(st.sampled_from(CHANCES), max_size=12)):
        values[name] = F(draw(st.sampled_from([0, 1, 2, 5, 8, 13, 15, 16])), 16)
    for name in draw(st.sets(st.sampled_from(WEIGHTS), max_size=4)):
        values[name] = F(draw(st.integers(-40, 40)), 4)
    discount = draw(st.sampled_from([F(1), F(1, 2), F(0)]))
    policy = draw(st.lists(st.integers(0, 3), min_size=16, max_size=16))
    return readings, tasks, draw(st.integers(1, 2)), values, discount, np.array(policy)


def staged(scenario: Scenario, shares: np.ndarray) -> np.ndarray:
    """Policies by status (N, V, A), as policies by state."""
    stages = optimal(scenario, (), TODAY).actions.shape[1:-1]
    return np.broadcast_to(shares[:, None, None, None], (len(shares), *stages, *shares.shape[1:]))


def against_the_reference(world: Any) -> None:
    readings, tasks, trials, values, discount, policy = world
    oracle = Oracle(readings, tasks, trials, discount, values)
    scenario = YUAN.with_(readings=readings, tasks=tasks, max_trial=trials)
    names, draws = [*values, "discount"], [[float(v) for v in [*values.values(), discount]]]
    batch = optimal(scenario, names, draws)
    assert abs(F(batch.start[0]) - oracle.value(oracle.start)) <= F(batch.error[0])
    for number in range(16):
        status = tuple(number >> shift & 1 for shift in (3, 2, 1, 0))
        gaps = dict(zip(ACTIONS, batch.gaps[0, number], strict=True))
        near = {name for name, gap in gaps.items() if gap <= 2 * batch.error[0]}
        assert oracle.optimal_actions((0, 0, 1, status)) <= near
        assert ACTIONS[batch.actions[0, 0, 0, 0, number]] in near
    value, error = policy_values(scenario, names, draws, staged(scenario, np.eye(4)[policy][None]))
    exact = oracle.evaluate(
        lambda state: {ACTIONS[policy[int("".join(map(str, state[3])), 2)]]: F(1)},
        distribution=False,
    )
    assert abs(F(value[0, 0]) - exact["mean"]) <= F(error[0])


@settings(max_examples=3)
@given(worlds())
def test_values_are_those_of_the_exact_reference(world: Any) -> None:
    against_the_reference(world)


@pytest.mark.slow
@settings(max_examples=12)
@given(worlds())
def test_values_of_more_worlds_are_those_of_the_exact_reference(world: Any) -> None:
    against_the_reference(world)


def sampled(count: int, seed: int) -> tuple[list[str], np.ndarray]:
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(0, 1, (count, len(CHANCES)))
    return [*CHANCES, *WEIGHTS], np.hstack([drawn, rng.normal(0, 20, (count, len(WEIGHTS)))])


def compiled(scenario: Scenario, names: list[str], row: np.ndarray) -> MDP:
    return scenario.with_(parameters=dict(zip(names, row.tolist(), strict=True))).compile()


@pytest.mark.parametrize("seed", range(14))
def test_values_are_those_of_the_explicit_model(seed: int) -> None:
    """Of policies that change from stage to stage, mixed and not."""
    rng = np.random.default_rng(seed)
    readings = {name: options[rng.integers(len(options))] for name, options in READINGS.items()}
    scenario = YUAN.with_(readings=readings, tasks=[2, 1], max_trial=2, discount="19/20")
    names, draws = sampled(2, seed=seed)
    batch = optimal(scenario, names, draws)
    stages = batch.actions.shape[1:]
    tables = np.concatenate(
        [rng.dirichlet(np.ones(4), (2, *stages)), np.eye(4)[rng.integers(0, 4, (2, *stages))]]
    )
    values, error = policy_values(scenario, names, draws, tables)
    best, _ = policy_values(scenario, names, draws, np.eye(4)[batch.actions])
    for d, row in enumerate(draws):
        mdp = compiled(scenario, names, row)
        start = solve(mdp).start
        assert abs(batch.start[d] - start.value) <= batch.error[d] + start.error
        assert best[d, d] == pytest.approx(batch.start[d], abs=batch.error[d])
        if mdp.n_actions == 4:
            for n, table in enumerate(tables):
                own = evaluate(mdp, np.append(table.reshape(-1), 1.0)).start
                assert abs(values[d, n] - own.value) <= error[d] + own.error


def test_neither_the_order_nor_the_company_changes_a_bit() -> None:
    names, draws = sampled(1100, seed=3)
    one, two = optimal(YUAN, names, draws), optimal(YUAN, names, draws[::-1])
    assert one.start.tobytes() == two.start[::-1].tobytes()
    assert np.array_equal(one.gaps, two.gaps[::-1])
    assert np.array_equal(one.actions, two.actions[::-1])
    policies = staged(YUAN, np.eye(4)[np.random.default_rng(4).integers(0, 4, size=(300, 16))])
    many, _ = policy_values(YUAN, (), TODAY, policies)
    assert policy_values(YUAN, (), TODAY, policies[7:8])[0][0, 0] == many[0, 7]


def test_shipped_scenarios_and_one_with_more_weights_than_chances(tmp_path: Path) -> None:
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
    simple, names = Scenario.load(tmp_path / "simple.toml"), ["base.x", "persistence.x"]
    draws = np.array([[0.2, 0.7], [0.6, 0.5]])
    cases = [(simple, names, draws)]
    cases += [(Scenario.load(name), [], TODAY) for name in ("tea", "yuan2025")]
    for scenario, chosen, rows in cases:
        batch = optimal(scenario, chosen, rows)
        assert batch.error.max() < 1e-9
        for d, row in enumerate(rows):
            start = solve(compiled(scenario, chosen, row)).start
            assert abs(batch.start[d] - start.value) <= batch.error[d] + start.error


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
def test_draws_that_cannot_be_are_refused(points: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        study(YUAN, points)
    assert np.isfinite(study(YUAN, {"reward.trial": [1e200]}).optimal).all()


# ---- the rules -----------------------------------------------------------------------------------

EVERY = (("complete", 0), ("skip", 1))
CHANGES: dict[str, tuple[Any, str, Any]] = {
    "pay the bonus on a skip": (rules, "BONUS", dict.fromkeys(rules.BONUS, EVERY)),
    "never pay the bonus": (rules, "BONUS", dict.fromkeys(rules.BONUS, ())),
    "charge a trial on a skip": (rules, "CHARGES", (*rules.CHARGES, ("skip", "trial", None))),
    "charge nothing on completing": (
        rules, "CHARGES", tuple(row for row in rules.CHARGES if row[0] != "complete"),
    ),
    "charge statuses twice": (rules, "STATUS_COST", {"next": (1, 1), "current": (1, 1)}),
    "charge no statuses": (rules, "STATUS_COST", {"next": (0, 0), "current": (0, 0)}),
    "skip one trial later": (Tables, "trials", property(lambda tables: tables.max_trial + 1)),
}  # fmt: skip
VARIANTS = (
    {},
    {"task_bonus": "no-subtask-skipped", "status_cost": "current"},
    {"task_bonus": "last-subtask-completed", "skip_timestep": "own", "skip_onset": "base"},
    {"task_bonus": "no-subtask-skipped", "skip_timestep": "own", "trial_cost": "failed-trials"},
)


def start_values(scenario: Scenario) -> np.ndarray:
    """The optimum and the mean of a policy, in which matrix and batch agree."""
    mdp, flags = scenario.compile(), rules.Rules(scenario).flags
    best, mean = solve(mdp).start.value, evaluate(mdp, "always:directive")
    assert optimal(scenario, (), TODAY).start[0] == pytest.approx(best, abs=1e-9)
    always = np.broadcast_to(np.eye(4)[3], (1, 3, scenario.trials, flags, 16, 4))
    value, _ = policy_values(scenario, (), TODAY, always)
    assert value[0, 0] == pytest.approx(mean.mean, abs=1e-9)
    assert sum(mean.components.values()) == pytest.approx(mean.mean, abs=1e-9)
    return np.array([best, mean.mean])


@pytest.mark.parametrize("readings", VARIANTS)
@pytest.mark.parametrize("change", CHANGES)
def test_a_rule_that_is_changed_in_its_one_place_is_followed_by_all(
    change: str, readings: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = YUAN.with_(tasks=[2, 1], max_trial=2, discount="19/20", readings=readings)
    before = start_values(scenario)
    monkeypatch.setattr(*CHANGES[change])
    assert (abs(start_values(scenario) - before) > 1e-6).all()


PRESENT = ("influence_on_present", "influence_orientation", "skip_onset")


@pytest.mark.parametrize("readings", [*product(*(READINGS[name] for name in PRESENT))])
def test_every_chance_above_1_is_counted(readings: tuple[str, ...]) -> None:
    given = dict(zip(PRESENT, readings, strict=True))
    scenario = YUAN.with_(readings=given, tasks=[1], max_trial=2)
    laws, words = chances(scenario), excess(scenario)
    values = [*(parameter.value for parameter in scenario.parameters), F(0)]
    which = [*laws.step.reshape(-1).tolist(), *laws.skip.reshape(-1).tolist()]
    count = sum(sum(values[k] for k in laws.terms[number]) > 1 for number in which)
    assert (words is None) == (count == 0)
    assert words is None or count == 1 or f"so are {count - 1} others" in words
