"""Any model, and the care scenarios, as Gymnasium environments, for agents from elsewhere to learn.

    import gymnasium
    env = gymnasium.make("exact_mdp.mdp.environment:exact_mdp/Yuan2025-v0")

An environment draws next state and reward together from the exact outcomes of the model. An agent
sees the number of the state, or of the combination of the columns that it may read; the end of a
scenario has no columns and is seen as combination 0. Importing this module registers the scenario;
so does the entry point `gymnasium.envs` with versions of Gymnasium that load plug-ins.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, require_extra
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats

with require_extra("models"):
    import gymnasium

YUAN2025 = "exact_mdp/Yuan2025-v0"


class MDPEnv(gymnasium.Env[np.int64, np.int64]):
    """A finite MDP to act in.

    Attributes
    ----------
    mdp : MDP
    state : int
        The state that the environment is in, whatever the agent sees of it.
    observed : StateSpace
        What the observations stand for: `observed.label(observation)`.

    Parameters
    ----------
    model : MDP
    columns : names of columns, optional
        What the agent sees; the whole state unless given.
    pass_forced : bool
        Do not ask the agent where there is no choice: such states are passed at once. Their
        rewards are added to that of the step, discounted by the model's own discount, and
        `info["timesteps"]` says how many timesteps went by. In a circle of such states that is
        done once round. Otherwise any action number stands for the only action there.

    Notes
    -----
    The action numbers are those of the model, less the actions that never are a choice. Where some
    states lack an action that others have, `info["action_mask"]` tells which can be taken, and
    another one raises ModelError. `info` also holds `state` (its label), `timesteps`, `events`
    (names of the model's events that happened) and `components`: the expected reward by component
    of the states and actions passed through. An episode ends where all is over (`mdp.over`): not in
    a state that earns nothing, but has components that are counted. Costs are paid as rewards,
    which they are times -1.

    Examples
    --------
    >>> env = MDPEnv(MDP.from_outcomes([(0, 0, [(1, 1, 5)]), (1, 0, [(1, 1, 0)])]))
    >>> env.reset(seed=0)[0], env.step(0)[:4]
    (np.int64(0), (np.int64(1), 5.0, True, False))
    """

    def __init__(
        self, model: MDP, *, columns: Sequence[str] | None = None, pass_forced: bool = False
    ) -> None:
        self.mdp, self.pass_forced, self.state = model, pass_forced, model.start[0][0]
        self.observed, self._seen = model.space, np.arange(model.n_states)
        if columns is not None and tuple(columns) != model.space.names:
            self.observed = StateSpace(columns=tuple(map(model.space.column, columns)))
            self._seen = model.space.rows(self.observed.columns)
        choosing = np.logical_not(model.forced)[model.pair_state]
        numbers = np.unique(model.pair_action[choosing]) if choosing.any() else np.arange(1)
        self.action_names = tuple(model.actions[number] for number in numbers)
        pairs = np.full((model.n_states, model.n_actions), -1, dtype=np.int64)
        pairs[model.pair_state, model.pair_action] = np.arange(model.n_pairs)
        pairs[model.forced] = model.pair_offsets[:-1][model.forced][:, None]
        self._pair = pairs[:, numbers]
        self.observation_space = gymnasium.spaces.Discrete(self.observed.size)
        self.action_space = gymnasium.spaces.Discrete(len(numbers))
        self._gains, self._chances = (
            model.maximised.table.compute_gains(),
            model.table.compute_probabilities(),
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, dict[str, Any]]:
        """Begin an episode in a state drawn from the model's start distribution."""
        super().reset(seed=seed, options=options)
        self.state = self.mdp.start[
            self._sample_index(float(weight) for _, weight in self.mdp.start)
        ][0]
        return self._seen[self.state], self._build_info(
            0, 0, np.zeros(len(self.mdp.component_names))
        )

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, dict[str, Any]]:
        """Take an action; return observation, reward, terminated, truncated and information."""
        mdp, table = self.mdp, self.mdp.table
        pair = int(self._pair[self.state, action]) if self.action_space.contains(action) else -1
        if pair < 0:
            raise ModelError(
                f"action {action} is not available",
                where=mdp.space.place(self.state),
                fix='choose one that info["action_mask"] marks with 1',
            )
        reward, factor, timesteps, events = 0.0, 1.0, 0, 0
        components = np.zeros(len(mdp.component_names))
        while True:
            first, last = int(table.offsets[pair]), int(table.offsets[pair + 1])
            outcome = first + self._sample_index(self._chances[first:last].tolist())
            reward += factor * float(self._gains[outcome])
            components += factor * mdp.components[pair]
            events |= 0 if table.event is None else int(table.event[outcome])
            self.state, timesteps = int(table.next[outcome]), timesteps + 1
            over = bool(mdp.over[self.state])
            passed = self.pass_forced and mdp.forced[self.state] and timesteps <= mdp.n_states
            if over or not passed:
                info = self._build_info(timesteps, events, components)
                return self._seen[self.state], reward, over, False, info
            factor, pair = factor * mdp.discount, int(mdp.pair_offsets[self.state])

    def _sample_index(self, weights: Iterable[float]) -> int:
        """Return a place, drawn by its weight."""
        totals = list(accumulate(weights))
        drawn = bisect_right(totals, float(self.np_random.random()) * totals[-1])
        return min(drawn, len(totals) - 1)

    def _build_info(self, timesteps: int, events: int, components: Floats) -> dict[str, Any]:
        return {
            "state": self.mdp.space.label(self.state),
            "timesteps": timesteps,
            "events": [name for bit, name in enumerate(self.mdp.events) if events >> bit & 1],
            "components": dict(zip(self.mdp.component_names, components.tolist(), strict=True)),
            "action_mask": (self._pair[self.state] >= 0).astype(np.int8),
        }


def scenario_env(
    scenario: Scenario | str = "yuan2025", *, columns: Sequence[str] = ("status",), **changes: Any
) -> MDPEnv:
    """Return a care scenario to act in: the agent sees the status and is never asked to skip.

    Parameters
    ----------
    scenario : Scenario or str
        A scenario, or the name or file of one.
    columns : names of columns, optional
        What the agent sees, the status alone unless given; ("subtask", "trial", "status") for all.
    **changes
        Changes to the scenario as in `Scenario.with_`.

    Returns
    -------
    MDPEnv

    Raises
    ------
    ModelError
        For an unknown scenario, column or change.

    Examples
    --------
    >>> env = scenario_env("yuan2025", readings={"skip_timestep": "own"}, tasks=[1])
    >>> env.observation_space, env.action_space, env.action_names
    (Discrete(16), Discrete(4), ('none', 'supportive', 'non-directive', 'directive'))
    """
    given = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    return MDPEnv(given.with_(**changes).compile(), columns=columns, pass_forced=True)


def register() -> None:
    """Register the environments with Gymnasium; once is enough."""
    if YUAN2025 not in gymnasium.registry:
        gymnasium.register(YUAN2025, entry_point="exact_mdp.mdp.environment:scenario_env")


register()
