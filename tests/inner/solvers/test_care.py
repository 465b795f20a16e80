"""Care models stacked by their rules: each draw's numbers are those of the model itself."""

from itertools import product

import numpy as np
import pytest

from exact_mdp import READINGS, ModelError, Scenario, certify, evaluate, parametric
from exact_mdp.solvers.care import ScenarioStack

SMALL = Scenario.load("yuan2025").with_(tasks=[2, 1], max_trial=2)
NAMES = ["base.anger", "reward.anger", "discount"]
DRAWS = np.array([[0.0, -3.0, 1.0], [0.05, -10.0, 0.5], [0.5, 1.0, 0.75]])
VARIED = ("status_cost", "skip_timestep", "skip_onset", "task_bonus", "trial_cost")


def stacked(scenario: Scenario) -> ScenarioStack:
    return ScenarioStack(scenario, scenario.compile(), NAMES)


def at(scenario: Scenario, draw: np.ndarray):  # type: ignore[no-untyped-def]
    return parametric(scenario).at(dict(zip(NAMES, draw.tolist(), strict=True)))


@pytest.mark.parametrize("options", [*product(*(READINGS[name] for name in VARIED))])
@pytest.mark.filterwarnings("ignore::exact_mdp.ScenarioWarning")
def test_rows_and_rewards_are_those_of_the_explicit_model(options: tuple[str, ...]) -> None:
    scenario = SMALL.with_(readings=dict(zip(VARIED, options, strict=True)))
    models, _ = stacked(scenario).stack_draws(DRAWS)
    for d, draw in enumerate(DRAWS):
        mdp, mine = at(scenario, draw), models.structure
        rows = np.zeros(mdp.transition.shape)
        pair = np.repeat(np.arange(mdp.n_pairs), np.diff(mine.offsets))
        np.add.at(rows, (pair, mine.column), models.chances[mine.number, d])
        unit = models.row_error
        assert np.abs(rows - mdp.transition.toarray()).sum(axis=1).max() <= unit < 1e-12
        assert np.abs(models.reward[d] - mdp.reward).max() <= models.reward_error[d, 0] < 1e-10
        assert np.array_equal(mine.ended, mdp.terminal)


def test_equal_numbers_are_stored_once() -> None:
    scenario = Scenario.load("yuan2025")
    models, _ = stacked(scenario).stack_draws(DRAWS)
    mine = models.structure
    assert len(mine.number) > 15_000
    assert len(models.chances) == mine.number.max() + 1 == 2 * 16 * 4 * 16 + 1
    assert len(models.amounts) == mine.earned.max() + 1 == 2 * 2 * 64 + 1


def test_the_optimum_of_each_draw_is_that_of_its_model() -> None:
    models, cut = stacked(SMALL).stack_draws(DRAWS)
    found = models.optimum()
    assert found is not None
    assert cut.tolist() == [False, False, False]
    start, error = models.at_start(found.value, found.error)
    for d, draw in enumerate(DRAWS):
        assert abs(start[d] - float(certify(at(SMALL, draw)).start_value)) <= error[d] < 1e-9


def test_policies_in_each_draw_earn_what_they_earn_in_its_model() -> None:
    mdp, names = SMALL.compile(), ["random", "always:directive"]
    directive = [*mdp.actions].index("directive")
    policies = [np.full(mdp.n_pairs, 0.25), (mdp.pair_action == directive).astype(float)]
    for policy in policies:
        policy[-1] = 1.0
    value, error = stacked(SMALL).stack_draws(DRAWS)[0].evaluate(policies)
    for d, draw in enumerate(DRAWS):
        own = [evaluate(at(SMALL, draw), name).start for name in names]
        assert value[d] == pytest.approx([x.value for x in own], abs=2e-9)
        assert error[d].max() < 1e-9


def test_chances_that_are_cut_off_are_noticed() -> None:
    names = ["base.anger", "influence.confusion.anger"]
    stack = ScenarioStack(SMALL, SMALL.compile(), names)
    _, cut = stack.stack_draws(np.array([[0.5, 0.1], [0.9, 0.75]]))
    assert cut.tolist() == [False, True]


def test_rewards_that_overflow_are_refused() -> None:
    with pytest.raises(ModelError, match="so large that returns overflow"):
        stacked(SMALL).stack_draws(np.array([[0.0, -1e305, 1.0]]))
