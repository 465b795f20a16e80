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
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, extra
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace

with extra("models"):
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
        self,
        model: MDP,
        *,
        columns: Sequence[str] | None = None,
        pass_forced: bool = False,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "ansi"):
            raise ModelError(
                f"unknown render mode {render_mode!r}", where="environment", fix='use "ansi"'
            )
        mdp = model
        self.mdp, self.pass_forced, self.render_mode = mdp, pass_forced, render_mode
        self.observed, self._seen = mdp.space, np.arange(mdp.n_states)
        if columns is not None and tuple(columns) != mdp.space.names:
            self.observed = StateSpace(columns=tuple(map(mdp.space.column, columns)))
            self._seen = mdp.space.rows(self.observed.columns)
        choosing = np.logical_not(mdp.forced)[mdp.pair_state]
        numbers = np.unique(mdp.pair_action[choosing]) if choosing.any() else np.arange(1)
        self.action_names = tuple(mdp.actions[number] for number in numbers)
        self._pair = np.full((mdp.n_states, len(numbers)), -1, dtype=np.int64)
        place = np.full(mdp.n_actions, -1)
        place[numbers] = np.arange(len(numbers))
        known = place[mdp.pair_action] >= 0
        self._pair[mdp.pair_state[known], place[mdp.pair_action[known]]] = np.flatnonzero(known)
        self._pair[mdp.forced] = mdp.pair_offsets[:-1][mdp.forced][:, None]
        self.observation_space = gymnasium.spaces.Discrete(self.observed.size)
        self.action_space = gymnasium.spaces.Discrete(len(numbers))
        self._gains, self._chances = mdp.maximised.table.gains(), mdp.table.probabilities()
        self._totals: dict[int, list[float]] = {}
        self.state = mdp.start[0][0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, dict[str, Any]]:
        """Begin an episode in a state drawn from the model's start distribution."""
        super().reset(seed=seed, options=options)
        totals = list(accumulate(float(weight) for _, weight in self.mdp.start))
        self.state = self.mdp.start[self._draw(totals)][0]
        return self._seen[self.state], self._info(0, [], np.zeros(len(self.mdp.component_names)))

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, dict[str, Any]]:
        """Take an action; return observation, reward, terminated, truncated and information."""
        pair = int(self._pair[self.state, action]) if self.action_space.contains(action) else -1
        if pair < 0:
            raise ModelError(
                f"action {action} is not available",
                where=self.mdp.space.place(self.state),
                fix='choose one that info["action_mask"] marks with 1',
            )
        reward, factor, taken = 0.0, 1.0, [pair]
        bits, components = 0, np.zeros(len(self.mdp.component_names))
        while True:
            outcome = self._outcome(taken[-1])
            reward += factor * float(self._gains[outcome])
            components += factor * self.mdp.components[taken[-1]]
            if self.mdp.table.event is not None:
                bits |= int(self.mdp.table.event[outcome])
            self.state = int(self.mdp.table.next[outcome])
            over = bool(self.mdp.over[self.state])
            asked = over or not self.mdp.forced[self.state]
            if asked or not self.pass_forced or len(taken) > self.mdp.n_states:
                break
            factor *= self.mdp.discount
            taken.append(int(self.mdp.pair_offsets[self.state]))
        events = [name for bit, name in enumerate(self.mdp.events) if bits >> bit & 1]
        info = self._info(len(taken), events, components)
        return self._seen[self.state], reward, over, False, info

    def render(self) -> str | None:
        """Return the state's label where the render mode is "ansi"."""
        return self.mdp.space.label(self.state) if self.render_mode == "ansi" else None

    def _outcome(self, pair: int) -> int:
        first = int(self.mdp.table.offsets[pair])
        if pair not in self._totals:
            last = int(self.mdp.table.offsets[pair + 1])
            self._totals[pair] = list(accumulate(self._chances[first:last].tolist()))
        return first + self._draw(self._totals[pair])

    def _draw(self, totals: list[float]) -> int:
        """Return a place in cumulative weights, their last being the whole."""
        drawn = bisect_right(totals, float(self.np_random.random()) * totals[-1])
        return min(drawn, len(totals) - 1)

    def _info(self, timesteps: int, events: list[str], components: Any) -> dict[str, Any]:
        return {
            "state": self.mdp.space.label(self.state),
            "timesteps": timesteps,
            "events": events,
            "components": dict(zip(self.mdp.component_names, components.tolist(), strict=True)),
            "action_mask": (self._pair[self.state] >= 0).astype(np.int8),
        }


MDPEnv.metadata = {"render_modes": ["ansi"], "render_fps": 1}


class ScenarioEnv(MDPEnv):
    """A care scenario to act in: the agent sees the status and is never asked to skip.

    Parameters
    ----------
    scenario : Scenario or str
        A scenario, or the name or file of one.
    columns : names of columns, optional
        What the agent sees, the status alone unless given; ("subtask", "trial", "status") for all.
    readings, parameters, settings
        Changes to the scenario as in `Scenario.with_`.

    Examples
    --------
    >>> env = ScenarioEnv("yuan2025", readings={"skip_timestep": "own"}, tasks=[1])
    >>> env.observation_space, env.action_space, env.action_names
    (Discrete(16), Discrete(4), ('none', 'supportive', 'non-directive', 'directive'))
    """

    def __init__(
        self,
        scenario: Scenario | str = "yuan2025",
        *,
        columns: Sequence[str] = ("status",),
        readings: Mapping[str, str] | None = None,
        parameters: Mapping[str, object] | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        given = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        self.scenario = given.with_(readings=readings, parameters=parameters, **settings)
        super().__init__(
            self.scenario.compile(), columns=columns, pass_forced=True, render_mode=render_mode
        )


def register() -> None:
    """Register the environments with Gymnasium; once is enough."""
    if YUAN2025 not in gymnasium.registry:
        gymnasium.register(YUAN2025, entry_point="exact_mdp.mdp.environment:ScenarioEnv")


register()
