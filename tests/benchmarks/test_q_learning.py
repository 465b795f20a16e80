"""Steps and seeds a second: the compiled learner, a plain NumPy loop, and Gymnasium's loop.

All three train Q-learning over the 16 statuses with ε = 0.1, α = 0.05, γ = 0.95 on the same model,
one after the other in the same process, on one core; rates are per second of that core's time.
"""

from collections.abc import Callable
from time import thread_time

import gymnasium
import numpy as np
import pytest

from exact_mdp.mdp import MDP, Scenario
from exact_mdp.mdp.environment import YUAN2025
from exact_mdp.solvers.learning.q_learning import QLearning, Trainer
from exact_mdp.solvers.learning.sampler import child, rows_of
from exact_mdp.solvers.learning.training import train_many

pytestmark = pytest.mark.bench

EPSILON, RATE, DISCOUNT = 0.1, 0.05, 0.95
SLOW_EPISODES = 3000


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").compile()


def rate_of(train: Callable[[], int], repeats: int) -> float:
    """Return the largest number of steps a second over some repeats."""
    rates = []
    for _ in range(repeats):
        started = thread_time()
        steps = train()
        rates.append(steps / (thread_time() - started))
    return max(rates)


def numpy_loop(mdp: MDP, episodes: int, seed: int) -> int:
    """The learner as one would write it with NumPy: arrays for the model, a loop for the steps."""
    draw, q = np.random.default_rng(seed), np.zeros((16, 4))
    key, table = rows_of(mdp).key, mdp.table
    chances, gains = table.probabilities(), table.gains()
    totals = np.cumsum(chances)
    totals -= np.repeat(
        totals[table.offsets[:-1]] - chances[table.offsets[:-1]], np.diff(table.offsets)
    )
    steps = 0
    for _ in range(episodes):
        state = mdp.start[0][0]
        while not mdp.terminal[state]:
            row = key[state]
            action = draw.integers(4) if draw.random() < EPSILON else np.argmax(q[row])
            pair = mdp.pair_offsets[state] + action
            first, last = table.offsets[pair], table.offsets[pair + 1]
            place = first + np.searchsorted(totals[first : last - 1], draw.random(), side="right")
            state = table.next[place]
            ahead = 0.0 if mdp.terminal[state] else np.max(q[key[state]])
            q[row, action] += RATE * (gains[place] + DISCOUNT * ahead - q[row, action])
            steps += 1
    return steps


def gymnasium_loop(env: gymnasium.Env, episodes: int, seed: int) -> int:
    """The learner against Gymnasium's interface."""
    draw, q, steps = np.random.default_rng(seed), np.zeros((16, 4)), 0
    env.reset(seed=seed)
    for _ in range(episodes):
        seen, over = env.reset()[0], False
        while not over:
            action = draw.integers(4) if draw.random() < EPSILON else np.argmax(q[seen])
            following, reward, over, _, _ = env.step(action)
            ahead = 0.0 if over else np.max(q[following])
            q[seen, action] += RATE * (reward + DISCOUNT * ahead - q[seen, action])
            seen, steps = following, steps + 1
    return steps


def test_steps_a_second(care: MDP, benchmark, capsys: pytest.CaptureFixture[str]) -> None:
    trainer = Trainer(QLearning(), care)
    trainer.run(0)
    run = benchmark.pedantic(trainer.run, args=(1,), rounds=15)
    ours = rate_of(lambda: trainer.run(1).steps, 15)
    plain = rate_of(lambda: numpy_loop(care, SLOW_EPISODES, 1), 3)
    env = gymnasium.make(f"mdp.environment:{YUAN2025}", disable_env_checker=True)
    theirs = rate_of(lambda: gymnasium_loop(env, SLOW_EPISODES, 1), 3)
    figures = {
        "steps of one training": run.steps,
        "steps/s, compiled": ours,
        "steps/s, NumPy loop": plain,
        "steps/s, Gymnasium loop": theirs,
        "compiled / NumPy loop": ours / plain,
        "compiled / Gymnasium loop": ours / theirs,
        "seconds of one training": run.steps / ours,
    }
    benchmark.extra_info.update(figures)
    with capsys.disabled():
        print()
        for name, value in figures.items():
            print(f"  {name:<28}{value:>16,.4g}" if value < 1e3 else f"  {name:<28}{value:>16,.0f}")
    assert ours > 50 * plain
    assert ours > 50 * theirs


@pytest.mark.parametrize("jobs", [1, 2])
def test_seeds_a_second(care: MDP, benchmark, jobs: int) -> None:
    QLearning(epochs=1).train(care, child(0, 0))
    runs = benchmark.pedantic(
        train_many, args=(care, QLearning(), 64), kwargs={"rng": 0, "n_jobs": jobs}, rounds=2
    )
    benchmark.extra_info["seeds/s"] = len(runs) / benchmark.stats.stats.min
