"""The conversation of the two agents, one timestep after the other.

    status -> behaviour -> perceived status -> action -> what the robot says -> next status

The status moves by the scenario's Markov model under the action; the words change nothing in it.
The robot chooses by the perceived status, with subtask and trial known. With *none*, and when a
step is skipped, the robot says nothing and no model is asked. Source: Yuan et al. (2025),
Section 2 and Figure 2.

Next states are drawn from the exact table: u = k / 2^62 with k from a seeded generator, and the
first outcome whose cumulated probability, a fraction, exceeds u. Every draw has a generator of its
own, made from (seed, timestep, purpose): what a resumed run draws does not depend on where it
stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from hashlib import sha256
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np

from exact_mdp import MDP, ModelError, Policy, Scenario, solve
from exact_mdp.paper_repro.agents import DISCLAIMER, log
from exact_mdp.paper_repro.agents.log import Record
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.texts import (
    ACTIVITY,
    HISTORY,
    TEXTS,
    Modules,
    Request,
    assistance_lines,
    prompt,
)
from exact_mdp.paper_repro.paper import AVERAGES, BITS, write
from exact_mdp.paper_repro.silent_points import Reading

DRAWS = ("start", "policy", "transition", "behaviour", "perception", "execution")
SKIP = "skip"
NAME = "conversation.jsonl"


class Backend(Protocol):
    """Whoever answers: a script, or a language model."""

    def describe(self) -> dict[str, Any]:
        """Return what a recording says of it."""

    def answer(self, request: Request) -> dict[str, Any]:
        """Return an answer in the form that the request asks for."""


def seed_of(seed: int, timestep: int, purpose: str) -> int:
    """Return a seed for one draw of one timestep.

    >>> seed_of(0, 3, "policy") == seed_of(0, 3, "transition")
    False
    """
    sequence = np.random.SeedSequence([seed, timestep, DRAWS.index(purpose)])
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def choose(chances: Sequence[Fraction], seed: int) -> int:
    """Return an index drawn with exact probabilities.

    >>> choose([Fraction(0), Fraction(1)], seed=5)
    1
    """
    total = sum(chances, Fraction(0))
    point = total * Fraction(int(np.random.default_rng(seed).integers(2**62)), 2**62)
    return next(i for i, reached in enumerate(accumulate(chances)) if point < reached)


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A compiled scenario, and a policy that acts on a perceived status."""

    scenario: Scenario
    mdp: MDP
    policy: Policy

    @classmethod
    def of(cls, scenario: Scenario, policy: str) -> World:
        """Return the world of a scenario under a policy; see `policy_named`."""
        mdp = scenario.compile()
        return cls(scenario=scenario, mdp=mdp, policy=policy_named(mdp, scenario, policy))

    @cached_property
    def weights(self) -> np.ndarray:
        """(L,) probability of each action in its state."""
        return np.asarray(self.policy.weights(self.mdp))

    def part(self, state: int, column: str) -> int:
        """Return one coordinate of a state."""
        return int(self.mdp.space.values(column, np.array([state]))[0])

    def label(self, state: int) -> str:
        """Return the status string of a state, such as 0100."""
        return format(self.part(state, "status"), f"0{len(self.scenario.statuses)}b")

    def action(self, state: int, perceived: str, seed: int) -> int:
        """Return the action that the policy takes where a status is perceived."""
        # The status is the last column: states that differ in it alone are neighbours.
        seen = state - self.part(state, "status") + int(perceived, 2)
        pairs = list(self.mdp.pairs_of(seen))
        chances = [Fraction(float(self.weights[pair])) for pair in pairs]
        return int(self.mdp.pair_action[pairs[choose(chances, seed)]])

    def step(self, state: int, action: int, seed: int) -> tuple[int, Fraction, str]:
        """Draw what follows an action in the true state: next state, reward, event."""
        mdp, pair = self.mdp, self.mdp.pair(state, action)
        rows = list(mdp.table.row(pair))
        picked = choose([row[0] for row in rows], seed)
        _, following, reward = rows[picked]
        marks, outcome = mdp.table.event, int(mdp.table.offsets[pair]) + picked
        skipped = marks is not None and int(marks[outcome]) >> mdp.events.index(SKIP) & 1
        moved = self.part(state, "subtask") != self.part(following, "subtask")
        done = moved or bool(mdp.terminal[following])
        return following, reward, "skipped" if skipped else "completed" if done else "failed"


def policy_named(mdp: MDP, scenario: Scenario, name: str) -> Policy:
    """Return a policy by name: optimal, random, reported:START, always:ACTION or a file."""
    if name == "optimal":
        return Policy.from_choices(mdp, solve(mdp).policy)
    if name.startswith("reported:"):
        start = name.removeprefix("reported:")
        if start not in AVERAGES or tuple(scenario.statuses) != tuple(BITS):
            raise ModelError(
                f"{name} is none of the paper's policies for this scenario",
                where="--policy",
                fix=f"give reported:ACTION, ACTION one of {', '.join(AVERAGES)}, with yuan2025",
            )
        return Policy.of(mdp, Reading(scenario=scenario).reported(start))
    return Policy.of(mdp, name)


@dataclass(frozen=True, kw_only=True)
class Conversation:
    """Everything that a conversation follows from."""

    world: World
    modules: Modules
    backend: Backend
    seed: int
    asked: Mapping[str, Any]  # how scenario and policy were named, for the header

    def header(self) -> dict[str, Any]:
        """Return the first entry of the recording."""
        modules, world = self.modules, self.world
        return {
            "kind": "header",
            "format": log.FORMAT,
            "disclaimer": DISCLAIMER,
            **self.asked,
            "policy_hash": sha256(world.weights.tobytes()).hexdigest(),
            "statuses": list(world.scenario.statuses),
            "actions": list(world.mdp.actions),
            "setting": ACTIVITY["setting"],
            "steps": [{"goal": s["goal"], "step": s["step"]} for s in modules.steps],
            "trials": world.scenario.trials,
            "backend": self.backend.describe(),
            "texts": TEXTS["version"],
            "variant": modules.variant,
            "history": modules.history,
            "seed": self.seed,
        }

    def hold(
        self,
        out: Path,
        *,
        resume: bool = False,
        limit: int | None = None,
        progress: Callable[[dict[str, Any]], None] = lambda step: None,
    ) -> Record:
        """Run into a folder, or `resume` what it holds, up to `limit` timesteps in all.

        Raises ModelError where the folder holds a conversation and `resume` is not asked for, or
        one with other settings. What was recorded before a failure stays.
        """
        path, header = out / NAME, self.header()
        record = log.read(path)
        if record is not None and (not resume or record.header != header):
            raise ModelError(
                "the folder holds a conversation" + " with other settings" * resume,
                where=str(path),
                fix="name another --out" + ", or add --resume" * (not resume),
            )
        if record is None:
            record = Record(header=header)
            log.append(path, header)
        try:
            while record.end is None and (limit is None or len(record.steps) < limit):
                if record.steps and self.world.mdp.terminal[record.steps[-1]["next_state"]]:
                    record.add(path, log.totals(record.steps))
                    break
                record.add(path, self.step(record.steps))
                progress(record.steps[-1])
        finally:  # write what was recorded, whatever stopped the run
            write(path.with_suffix(".txt"), log.text(record))
        return record

    def step(self, past: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the timestep after those of `past`."""
        world, modules, timestep = self.world, self.modules, len(past)

        def seed(purpose: str) -> int:
            return seed_of(self.seed, timestep, purpose)

        if past:
            state, total = int(past[-1]["next_state"]), Fraction(past[-1]["return"])
        else:
            starts = world.mdp.start
            state = starts[choose([chance for _, chance in starts], seed("start"))][0]
            total = Fraction(0)
        subtask, trial = world.part(state, "subtask"), world.part(state, "trial")
        place = modules.place(subtask, trial + 1, world.scenario.trials)
        exchanges = [self.exchange(step) for step in past]
        label = world.label(state)
        status = {name: int(bit) for name, bit in zip(world.scenario.statuses, label, strict=True)}
        behaviour = self.backend.answer(
            modules.behaviour(place, exchanges, status, seed("behaviour"))
        )
        seen = self.backend.answer(modules.perception(behaviour, seed("perception")))
        perceived = "".join(str(int(seen[name])) for name in status)
        action = world.action(state, perceived, seed("policy"))
        name, speech = world.mdp.actions[action], ""
        if name not in (world.mdp.actions[0], SKIP):
            asked = modules.execution(
                place, exchanges, behaviour, name, dict(seen), seed("execution")
            )
            speech = str(self.backend.answer(asked)["speech"])
        following, reward, event = world.step(state, action, seed("transition"))
        return {
            "kind": "step",
            "timestep": timestep,
            "state": state,
            "subtask": subtask,
            "trial": trial,
            "status": label,
            "behaviour": dict(behaviour),
            "perceived": perceived,
            "action": name,
            "assistance": speech,
            "event": event,
            "reward": str(reward),
            "return": str(total + world.mdp.discount_exact**timestep * reward),
            "next_state": following,
        }

    def exchange(self, step: Mapping[str, Any]) -> dict[str, Any]:
        """Return what prompts recall of a timestep: what could be seen and heard, no status."""
        return {
            "timestep": step["timestep"],
            "step": self.modules.steps[step["subtask"]]["step"],
            "nonverbal": step["behaviour"]["nonverbal"],
            "verbal": step["behaviour"]["verbal"],
            "caregiver": step["assistance"],
        }


def conversation(
    backend: Backend,
    *,
    scenario: str = "yuan2025",
    sets: Sequence[str] = (),
    policy: str = "optimal",
    seed: int = 0,
    variant: str = "detailed+status",
    history: int = HISTORY,
) -> Conversation:
    """Return a conversation by names, as the commands give them.

    >>> talk = conversation(Scripted(), policy="always:directive", seed=1)
    >>> talk.step([])["action"]
    'directive'
    """
    model = Scenario.load(scenario)
    for assignment in sets:
        model = model.set(assignment)
    modules = Modules.of(model, variant=variant, history=history)
    asked = {"scenario": scenario, "set": list(sets), "policy": policy}
    return Conversation(
        world=World.of(model, policy), modules=modules, backend=backend, seed=seed, asked=asked
    )


@cache
def of_figures() -> dict[str, str]:
    """Return the prompts and a scripted interaction, by the figures of the paper."""
    with TemporaryDirectory() as folder:
        record = conversation(Scripted(), seed=3).hold(Path(folder) / "talk", limit=6)
    brief, detailed = (assistance_lines(detailed=each) for each in (False, True))
    return {
        "Figure 5": prompt("behaviour"),
        "Figure 6": prompt("perception"),
        "Figure 7": prompt("execution", without=["status"], assistance=brief),
        "Figure 8": prompt("execution", assistance=detailed),
        "Figure 11": log.text(record),
        "Figure 12": "\n".join(log.spoken(record.header, step) for step in record.steps),
    }
