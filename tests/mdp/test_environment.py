"""The Gymnasium environments: their interface, their law, and a learner that is not ours."""

import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from refusal_tables import refused

from exact_mdp import MDP, MDPEnv, Scenario, evaluate

YUAN = "exact_mdp/Yuan2025-v0"  # registered with MDPEnv

ROOT = Path(__file__).resolve().parents[2]
READINGS = [{}, {"skip_timestep": "own"}, {"task_bonus": "no-subtask-skipped"}]


def care_env(**settings: Any) -> Any:
    return gymnasium.make(YUAN, **settings).unwrapped


@pytest.mark.parametrize("readings", READINGS, ids=str)
@pytest.mark.parametrize("columns", [("status",), ("subtask", "trial", "status")])
def test_gymnasium_accepts_the_scenario(readings: dict[str, str], columns: tuple[str, ...]) -> None:
    check_env(care_env(readings=readings, columns=columns), skip_render_check=True)
    check_env(MDPEnv(Scenario.load("tea").compile()), skip_render_check=True)


def test_it_is_registered_by_its_entry_point_and_made_by_its_name() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    module, _, function = project["entry-points"]["gymnasium.envs"]["exact_mdp"].partition(":")
    gymnasium.registry.pop(YUAN)
    getattr(import_module(module), function)()
    env = gymnasium.make(YUAN, tasks=[3, 1], columns=("trial", "status"))
    assert env.observation_space.n == 80
    assert env.unwrapped.mdp.space.column("subtask").size == 4
    _, info = env.reset(seed=1)
    assert info["state"] == "subtask 0, trial 0, status 0000"


@pytest.mark.parametrize("readings", READINGS, ids=str)
def test_episodes_have_the_exact_means(readings: dict[str, str]) -> None:
    env = care_env(readings=readings)
    exact = evaluate(env.mdp, "random")
    returns, steps, skips, parts = [], [], [], []
    env.action_space.seed(0)
    for episode in range(1500):
        env.reset(seed=7 if episode == 0 else None)
        total, count, skipped, pieces, over = 0.0, 0, False, 0.0, False
        while not over:
            _, reward, over, _, info = env.step(env.action_space.sample())
            total, count = total + reward, count + info["timesteps"]
            skipped |= "skip" in info["events"]
            pieces += sum(info["components"].values())
        returns.append(total)
        steps.append(count)
        skips.append(skipped)
        parts.append(pieces)
    for sample, mean in (
        (returns, exact.mean),
        (steps, exact.steps),
        (skips, exact.skip_probability),
        (parts, exact.mean),
    ):
        assert abs(np.mean(sample) - mean) < 4 * np.std(sample) / np.sqrt(len(sample))


def test_an_action_that_is_not_offered_is_refused() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 2, [(1, 2, 1)]), (1, 0, [(1, 2, 5)]), (1, 1, [(1, 2, 7)])]
    env = MDPEnv(MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]))
    _, info = env.reset()
    assert info["action_mask"].tolist() == [1, 0, 1]
    refused(lambda: env.step(np.int64(1)), "not available")
    refused(lambda: env.step(np.int64(3)), "not available")
    assert env.step(np.int64(0))[:4] == (1, 0.0, False, False)
    assert env.step(np.int64(1))[:4] == (2, 7.0, True, False)


def test_forced_states_are_passed_through_with_their_discounted_rewards() -> None:
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 0, 0)]), (1, 0, [(1, 2, 8)]), (2, 1, [(1, 3, 16)])]
    mdp = MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], discount="1/2")
    env = MDPEnv(mdp, pass_forced=True)
    env.reset()
    seen, reward, over, _, info = env.step(np.int64(0))
    assert (seen, reward, over, info["timesteps"]) == (3, 1 + 8 / 2 + 16 / 4, True, 3)
    asked = MDPEnv(mdp)
    asked.reset()
    assert asked.step(np.int64(0))[:2] == (1, 1.0)
    assert asked.step(np.int64(1))[:2] == (2, 8.0)


def test_a_circle_of_forced_states_is_left_again() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 0, 0)]), (1, 0, [(1, 2, 1)]), (2, 0, [(1, 1, 1)])]
    env = MDPEnv(MDP.from_outcomes(rows, discount="1/2"), pass_forced=True)
    env.reset()
    assert not env.step(np.int64(0))[2]


def test_starts_are_drawn_from_the_start_distribution() -> None:
    rows = [(state, 0, [(1, 2, 0)]) for state in range(3)]
    env = MDPEnv(MDP.from_outcomes(rows, start={0: "1/4", 1: "3/4"}))
    env.reset(seed=3)
    share = np.mean([env.reset()[0] for _ in range(2000)])
    assert abs(share - 0.75) < 4 * np.sqrt(0.75 * 0.25 / 2000)
