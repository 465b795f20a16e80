"""The scenario's Markov model as the world of a conversation: place, status, policy, next state.

Next states are drawn from the exact table: u = k / 2^62 with k from a seeded generator, and the
first outcome whose cumulated probability, a fraction, exceeds u. Every draw has a generator of its
own, made from (seed, timestep, purpose): what a resumed run draws does not depend on where it
stopped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp import MDP, Policy, Scenario
from exact_mdp.mdp.care.tables import SKIP
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.policies.arrays import check_action
from exact_mdp.paper_repro.agents.protocol import PURPOSES

DRAWS = ("start", "policy", "transition", *PURPOSES)


def seed_of(seed: int, timestep: int, purpose: str) -> int:
    """Return a seed for one draw of one timestep.

    Examples
    --------
    >>> seed_of(0, 3, "policy") == seed_of(0, 3, "transition")
    False
    """
    sequence = np.random.SeedSequence([seed, timestep, DRAWS.index(purpose)])
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def choose(chances: Sequence[Fraction], seed: int) -> int:
    """Return an index drawn with exact probabilities.

    Examples
    --------
    >>> choose([Fraction(0), Fraction(1)], seed=5)
    1
    """
    total = sum(chances, Fraction(0))
    point = total * Fraction(int(np.random.default_rng(seed).integers(2**62)), 2**62)
    return next(i for i, reached in enumerate(accumulate(chances)) if point < reached)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What one timestep led to."""

    state: int
    reward: Fraction
    event: str  # completed, failed or skipped


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A compiled scenario and a policy that acts on a perceived status."""

    scenario: Scenario
    mdp: MDP
    policy: Policy
    weights: NDArray[np.float64]

    @classmethod
    def of(cls, scenario: Scenario, policy: str) -> World:
        """Return the world of a scenario under a policy; see `policy_named`."""
        mdp = scenario.compile()
        chosen = policy_named(mdp, scenario, policy)
        return cls(scenario=scenario, mdp=mdp, policy=chosen, weights=chosen.weights(mdp))

    def start(self, seed: int) -> int:
        """Return a start state."""
        chances = [chance for _, chance in self.mdp.start]
        return self.mdp.start[choose(chances, seed_of(seed, 0, "start"))][0]

    def ended(self, state: int) -> bool:
        """Return whether the scenario is over."""
        return state >= self.mdp.space.regular

    def part(self, state: int, column: str) -> int:
        """Return one coordinate of a state."""
        return int(self.mdp.space.values(column, np.array([state]))[0])

    def vector(self, state: int) -> dict[str, int]:
        """Return the statuses of a state, each 0 or 1."""
        bits = self.label(state)
        return {name: int(bit) for name, bit in zip(self.scenario.statuses, bits, strict=True)}

    def label(self, state: int) -> str:
        """Return the status string of a state, such as 0100."""
        return self.mdp.space.column("status").label(self.part(state, "status"))

    def seen_as(self, state: int, perceived: Mapping[str, int]) -> int:
        """Return the state that the robot takes the state for: another status, the same place."""
        bits = "".join(str(int(perceived[name])) for name in self.scenario.statuses)
        # the status is the last column, so that its neighbours in number differ in it alone
        return state - self.part(state, "status") + int(bits, 2)

    def action(self, state: int, perceived: Mapping[str, int], seed: int, timestep: int) -> int:
        """Return the action that the policy takes in the state as perceived."""
        pairs = list(self.mdp.pairs_of(self.seen_as(state, perceived)))
        chances = [Fraction(float(self.weights[pair])) for pair in pairs]
        picked = pairs[choose(chances, seed_of(seed, timestep, "policy"))]
        return int(self.mdp.pair_action[picked])

    def step(self, state: int, action: int, seed: int, timestep: int) -> Outcome:
        """Draw what follows an action in the true state, from the exact outcomes."""
        pair = self.mdp.pair(state, action)
        rows = self.mdp.table.row(pair)
        picked = choose([row[0] for row in rows], seed_of(seed, timestep, "transition"))
        _, following, reward = rows[picked]
        return Outcome(
            state=following, reward=reward, event=self._event(state, following, pair, picked)
        )

    def _event(self, state: int, following: int, pair: int, picked: int) -> str:
        """Return what an outcome is; the model marks the skips."""
        marks, outcome = self.mdp.table.event, int(self.mdp.table.offsets[pair]) + picked
        if marks is not None and int(marks[outcome]) >> self.mdp.events.index(SKIP) & 1:
            return "skipped"
        here, there = self.part(state, "subtask"), self.part(following, "subtask")
        return "failed" if not self.ended(following) and here == there else "completed"


def policy_named(mdp: MDP, scenario: Scenario, name: str) -> Policy:
    """Return a policy by name: optimal, random, reported:START, always:ACTION or a file."""
    from exact_mdp.solvers import solve

    if name == "optimal":
        return Policy.from_choices(mdp, solve(mdp).policy)
    if name.startswith("reported:"):
        from exact_mdp.paper_repro import numbers, reported

        start = name.removeprefix("reported:")
        check_action(start, tuple(reported.AVERAGE_RETURN), "policy reported")
        if scenario.statuses != tuple(reported.TABLE_3):
            raise ModelError(
                "the paper's reported policy is one for its own statuses",
                where=f"scenario {scenario.name}",
                fix="choose optimal, random or a file",
            )
        completion = numbers.study(scenario).completion
        return Policy.of(mdp, reported.policy(start, completion))
    return Policy.of(mdp, name)
