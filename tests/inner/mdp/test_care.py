"""Care models in batches and in blocks, against exact fractions and the explicit model."""

from dataclasses import fields
from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import pytest
from own_scenarios import check_own, own_text, scenario_of
from refusal_tables import refused

from exact_mdp import MDP, READINGS, ModelError, Scenario, evaluate, solve, study
from exact_mdp.mdp.care import compile as blocks
from exact_mdp.mdp.care.compile import check_explicit, size
from exact_mdp.mdp.table import OutcomeTable
from exact_mdp.solvers.care import optimal, policy_values

YUAN = Scenario.load("yuan2025")
CHANCES = [p.name for p in YUAN.parameters if p.low is not None]
WEIGHTS = [p.name for p in YUAN.parameters if p.low is None]
TODAY = np.empty((1, 0))


def staged(scenario: Scenario, shares: np.ndarray) -> np.ndarray:
    stages = optimal(scenario, (), TODAY).actions.shape[1:-1]
    return np.broadcast_to(shares[:, None, None, None], (len(shares), *stages, *shares.shape[1:]))


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
    scenario = YUAN.with_(
        readings=readings, tasks=[2, 1], max_trial=2, discount=["19/20", 1, 0][seed % 3]
    )
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
        solution = solve(mdp)
        start, gaps = solution.start, solution.gap_table[:16, :4]
        assert abs(batch.start[d] - start.value) <= batch.error[d] + start.error
        assert batch.gaps[d] == pytest.approx(gaps, abs=2 * (batch.error[d] + solution.error_bound))
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


def test_shipped_scenarios_and_one_with_more_weights_than_chances() -> None:
    """Two statuses, eight actions: arrays are as long as what they hold."""
    draws = np.array([[0.2, 0.7], [0.6, 0.5]])
    cases = [(scenario_of(own_text(2, 8)), ["base.s0", "persistence.s0"], draws)]
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
        ({"reward.trial": [np.inf]}, "reward.trial is inf"),
        ({"reward.trial": [np.nan]}, "reward.trial is nan"),
        ({"base.anger": []}, "point"),
        ({"reward.trial": [1e308], "reward.assist.directive": [-1e308]}, "overflow"),
    ],
)
def test_draws_that_cannot_be_are_refused(points: Any, message: str) -> None:
    refused(lambda: study(YUAN, points), message)
    assert np.isfinite(study(YUAN, {"reward.trial": [1e200]}).optimal).all()


# ---- models built in blocks ----------------------------------------------------------------------


@pytest.mark.parametrize("option", READINGS["skip_timestep"])
@pytest.mark.parametrize("tasks", [[1], [2, 1]])
def test_the_size_of_a_table_is_known_beforehand(option: str, tasks: list[int]) -> None:
    others = ("status_cost", "skip_onset", "task_bonus")
    for chosen in product(*(READINGS[name] for name in others)):
        readings = dict(zip(others, chosen, strict=True)) | {"skip_timestep": option}
        scenario = Scenario.load("yuan2025").with_(tasks=tasks, max_trial=2, readings=readings)
        (outcomes, denominator), table = size(scenario.laws), scenario.compile().table
        assert len(table.next) <= outcomes <= 3 * len(table.next)
        assert max(int(bottom) for bottom in table.denominator) <= denominator


def weighted(
    statuses: int, *, same: bool, subtasks: int = 2, base: F = F(1, 10**12 + 39)
) -> Scenario:
    """Made-up numbers, one trial; statuses that weigh the same, or all sums of them distinct."""
    numbers = {f"reward.s{i}": -1 if same else -(2**i) for i in range(statuses)}
    numbers |= {"base.s0": base, "base.s1": base}
    scenario = scenario_of(own_text(statuses, 2))
    return scenario.with_(tasks=[subtasks], max_trial=1, parameters=numbers)


@pytest.mark.parametrize("statuses", [3, 5])
@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("base", [F(1, 3), F(1, 10**12 + 39)])
def test_last_trials_of_statuses_with_weights_of_their_own(
    statuses: int, same: bool, base: F, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = weighted(statuses, same=same, base=base)
    table, (outcomes, denominator) = scenario.compile().table, size(scenario.laws)
    assert (table.weight.dtype == object) == (base != F(1, 3))
    assert (denominator >= 2**62) == (base != F(1, 3))
    check_own(scenario, range(0, table.pairs - 1, 1 if statuses == 3 else 37))
    assert len(table.next) <= outcomes
    monkeypatch.setattr(blocks, "ENTRIES", 1)
    parts = weighted(statuses, same=same, base=base).compile().table
    for field in fields(OutcomeTable):
        assert np.array_equal(getattr(table, field.name), getattr(parts, field.name)), field.name


def test_what_is_too_large_to_build_is_refused_for_a_reason_that_is_true() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[90_000])
    with pytest.raises(ModelError, match=r"7,200,000 states and up to [\d,]+ outcomes") as refused:
        scenario.compile()
    assert "statuses, more" not in refused.value.what
    with pytest.raises(ModelError, match=r"^11 statuses, more than 10"):
        scenario_of(own_text(11, 2))
    # 9 statuses have as many transitions either way, but not as many outcomes.
    check_explicit(weighted(9, same=True, subtasks=4).laws)
    with pytest.raises(ModelError, match=r"2,048 states and up to [\d,]+ outcomes of 230 bytes"):
        check_explicit(weighted(9, same=False, subtasks=4).laws)
    check_explicit(weighted(9, same=False, subtasks=4, base=F(1, 3)).laws)
