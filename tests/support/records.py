"""A process of three states and an end, records of it, and a policy to be judged by them."""

from fractions import Fraction as F

import numpy as np
import pandas as pd

from exact_mdp import MDP, PolicyLike

NAMES = ["episode", "state", "action", "reward", "next_state"]
LEVEL = F(19, 20)
# States 0, 1, 2 and the end, actions 0 and 1; a reward is 1 with a chance of its own.
ROWS = np.array(
    [
        [[0.1, 0.5, 0.1, 0.3], [0.2, 0.1, 0.4, 0.3]],
        [[0.0, 0.3, 0.3, 0.4], [0.3, 0.3, 0.0, 0.4]],
        [[0.2, 0.2, 0.3, 0.3], [0.1, 0.0, 0.2, 0.7]],
    ]
)
CHANCES = np.array([[0.2, 0.7], [0.5, 0.4], [0.9, 0.1]])
POLICY = [0, 1, 0, 0]
RATE = 0.9
STAGES = np.array([[0, 1, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0]])  # actions (N, S), by time


def recorded(rng: np.random.Generator, episodes: int) -> pd.DataFrame:
    """Return episodes of a behaviour that takes both actions equally often, all at once."""
    parts, state, alive, time = [], np.zeros(episodes, dtype=int), np.arange(episodes), 0
    while len(alive):
        action = rng.integers(2, size=len(alive))
        total = ROWS[state, action].cumsum(axis=1)
        then = (rng.random((len(alive), 1)) > total).sum(axis=1).clip(max=3)
        reward = (rng.random(len(alive)) < CHANCES[state, action]).astype(int)
        parts.append(np.stack([alive, np.full_like(alive, time), state, action, reward, then], 1))
        state, alive, time = then[then < 3], alive[then < 3], time + 1
    rows = np.concatenate(parts)
    rows = rows[np.lexsort([rows[:, 1], rows[:, 0]])]
    frame = pd.DataFrame(rows[:, [0, 2, 3, 4]], columns=NAMES[:4])
    return frame.assign(next_state=pd.array(rows[:, 5], dtype="Int64").astype(object)).assign(
        next_state=lambda table: table["next_state"].where(table["next_state"] < 3, None)
    )


def estimated(frame: pd.DataFrame) -> MDP:
    mdp = MDP.from_transitions(frame, discount="9/10")
    assert mdp.n_states == 4
    return mdp


def patients(seed: int, episodes: int) -> pd.DataFrame:
    """Return episodes of one step: half of the patients are severe, and lose 1 by action 0."""
    rng = np.random.default_rng([episodes, seed])
    severe, action = rng.integers(2, size=(2, episodes))
    frame = pd.DataFrame({"episode": range(episodes), "state": severe, "action": action})
    return frame.assign(reward=np.where(severe, action, 1), next_state=None)


def by_stage(rows: np.ndarray, reward: np.ndarray, rate: float, own: np.ndarray) -> np.ndarray:
    """Return V* and V^π (2, S) at time 0: rows (S, A, S), rewards (S, A), actions (N, S)."""
    value = np.zeros((2, len(rows)))
    for actions in own[::-1]:
        values = reward[None] + rate * np.einsum("sat,vt->vsa", rows, value)
        value = np.stack([values[0].max(axis=1), values[1][np.arange(len(rows)), actions]])
    return value


def staged_policy(mdp: MDP) -> PolicyLike:
    """Return STAGES as a policy of `mdp.within(3)`."""
    within = mdp.within(3)
    actions = np.zeros(within.n_states, dtype=int)
    for state in range(within.n_states):
        at = within.space.as_dict(state)
        if "time" in at and int(at["time"]) < 3 and str(at["state"]).isdecimal():
            actions[state] = STAGES[int(at["time"]), int(at["state"])]
    return actions
