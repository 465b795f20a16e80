"""Models and care scenarios as Gymnasium environments, for the agents of other libraries.

    import gymnasium
    env = gymnasium.make("exact_mdp.mdp.environment:exact_mdp/Yuan2025-v0")

An environment draws next state and reward together from the exact outcomes of the model. An agent
observes the number of the state, or the number of a combination of some of its columns; the end of
a scenario has no columns and is observed as combination 0. Importing this module registers the
scenario; so does the entry point `gymnasium.envs` with versions of Gymnasium that load plug-ins.
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
        The current state; the agent may observe only a part of it.
    observed : StateSpace
        The space of the observations: `observed.label(observation)` is one in words.

    Parameters
    ----------
    model : MDP
    columns : names of columns, optional
        The columns that the agent observes; the whole state by default.
    pass_forced : bool
        Pass states with a single action at once, without asking the agent. Their rewards are added
        to the reward of the step, discounted by the model's discount, and `info["timesteps"]` is
        the number of timesteps that passed. A cycle of such states is passed once. Otherwise any
        action number stands for the only action there.

    Notes
    -----
    Actions are numbered as in the model, without the actions that are never a choice. If some
    states lack an action that others have, `info["action_mask"]` marks the available ones, and any
    other raises ModelError. `info` also holds `state` (its label), `timesteps`, `events` (names of
    the model's events that happened) and `components`: the expected reward by component of the
    states and actions passed through. An episode ends in a state in which it is over (`mdp.over`):
    not in a terminal state with components that are still counted. Costs become rewards, with the
    sign changed.

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
        # The observation of each state.
        self.observed, self._seen = model.space, np.arange(model.n_states)
        if columns is not None and tuple(columns) != model.space.names:
            self.observed = StateSpace(columns=tuple(map(model.space.column, columns)))
            self._seen = model.space.rows(self.observed.columns)
        # Actions that are a choice in some state; one action if there is never a choice.
        choosing = np.logical_not(model.forced)[model.pair_state]
        numbers = np.arange(1)
        if choosing.any():
            numbers = np.unique(model.pair_action[choosing])
        self.action_names = tuple(model.actions[number] for number in numbers)
        # The pair (S, A) of each state and action, or -1; a single action has all numbers.
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
        place = self._sample_index(float(weight) for _, weight in self.mdp.start)
        self.state = self.mdp.start[place][0]
        info = self._build_info(0, 0, np.zeros(len(self.mdp.component_names)))
        return self._seen[self.state], info

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, dict[str, Any]]:
        """Take an action; return observation, reward, terminated, truncated and information."""
        mdp, table = self.mdp, self.mdp.table
        pair = -1
        if self.action_space.contains(action):
            pair = int(self._pair[self.state, action])
        if pair < 0:
            raise ModelError(
                f"action {action} is not available",
                where=mdp.space.place(self.state),
                fix='choose one that info["action_mask"] marks with 1',
            )
        reward, factor, timesteps, events = 0.0, 1.0, 0, 0
        components = np.zeros(len(mdp.component_names))
        # One timestep, and then more as long as states have a single action and are to be passed.
        while True:
            first, last = int(table.offsets[pair]), int(table.offsets[pair + 1])
            outcome = first + self._sample_index(self._chances[first:last].tolist())
            reward += factor * float(self._gains[outcome])
            components += factor * mdp.components[pair]
            if table.event is not None:
                events |= int(table.event[outcome])
            self.state, timesteps = int(table.next[outcome]), timesteps + 1
            over = bool(mdp.over[self.state])
            # After S timesteps without a choice the states are a cycle.
            passed = self.pass_forced and mdp.forced[self.state] and timesteps <= mdp.n_states
            if over or not passed:
                info = self._build_info(timesteps, events, components)
                return self._seen[self.state], reward, over, False, info
            factor, pair = factor * mdp.discount, int(mdp.pair_offsets[self.state])

    def _sample_index(self, weights: Iterable[float]) -> int:
        """Return a random index, drawn with the given weights."""
        totals = list(accumulate(weights))
        drawn = bisect_right(totals, float(self.np_random.random()) * totals[-1])
        return min(drawn, len(totals) - 1)

    def _build_info(self, timesteps: int, events: int, components: Floats) -> dict[str, Any]:
        """Return the `info` of a step."""
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
    """Return the environment of a care scenario; states with a single action are passed.

    Parameters
    ----------
    scenario : Scenario or str
        A scenario, or the name or file of one.
    columns : names of columns, optional
        The columns that the agent observes; only the status by default, and ("subtask", "trial",
        "status") for all.
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
    if isinstance(scenario, Scenario):
        given = scenario
    else:
        given = Scenario.load(scenario)
    return MDPEnv(given.with_(**changes).compile(), columns=columns, pass_forced=True)


def register() -> None:
    """Register the environments with Gymnasium; once is enough."""
    if YUAN2025 not in gymnasium.registry:
        gymnasium.register(YUAN2025, entry_point="exact_mdp.mdp.environment:scenario_env")


register()
