"""An agent of a well-known library learns in the environment, and the toolkit judges it exactly.

Needs Stable-Baselines3 (`pip install stable-baselines3`), which no lock file holds: it brings
PyTorch along. Raffin et al., Journal of Machine Learning Research 22, 2021.
"""

import gymnasium
import numpy as np
import pytest

from exact_mdp.analysis import check
from exact_mdp.mdp import Policy
from exact_mdp.mdp.environment import YUAN2025
from exact_mdp.solvers import evaluate

pytestmark = pytest.mark.slow


@pytest.mark.filterwarnings("default")  # those of the library are not ours to mend
def test_ppo_learns_to_assist() -> None:
    library = pytest.importorskip("stable_baselines3")
    env = gymnasium.make(f"exact_mdp.mdp.environment:{YUAN2025}")
    agent = library.PPO(
        "MlpPolicy", env, gamma=0.95, n_steps=512, learning_rate=2e-3, seed=0, device="cpu"
    )
    agent.learn(20_000)
    mdp = env.unwrapped.mdp
    chosen = [int(agent.predict(np.array(seen), deterministic=True)[0]) for seen in range(16)]
    learned = Policy.by(mdp, ("status",), chosen)
    audit = check(mdp, learned, max_regret=20)
    assert audit.passed
    assert evaluate(mdp, learned).mean > evaluate(mdp, "random").mean + 30
