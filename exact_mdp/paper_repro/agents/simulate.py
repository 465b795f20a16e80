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
from exact_mdp.paper_repro.agents.log import Recording
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.texts import (
    ACTIVITY,
    HISTORY,
    TEXTS,
    Modules,
    Request,
    assistance_lines,
    fill_prompt,
)
from exact_mdp.paper_repro.paper import AVERAGES, BITS, write_file
from exact_mdp.paper_repro.silent_points import Reading

DRAWS = ("start", "policy", "transition", "behaviour", "perception", "execution")
SKIP = "skip"
NAME = "conversation.jsonl"


class Backend(Protocol):
    """Whoever answers: a script, or a language model."""

    def describe(self) -> dict[str, Any]:
        """Return the header of a recording."""

    def answer(self, request: Request) -> dict[str, Any]:
        """Return an answer in the form that the request asks for."""


def derive_seed(seed: int, timestep: int, purpose: str) -> int:
    """Return a seed for one draw of one timestep.

    >>> derive_seed(0, 3, "policy") == derive_seed(0, 3, "transition")
    False
    """
    sequence = np.random.SeedSequence([seed, timestep, DRAWS.index(purpose)])
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def sample_index(chances: Sequence[Fraction], seed: int) -> int:
    """Return an index drawn with exact probabilities.

    >>> sample_index([Fraction(0), Fraction(1)], seed=5)
    1
    """
    total = sum(chances, Fraction(0))
    point = total * Fraction(int(np.random.default_rng(seed).integers(2**62)), 2**62)
    return next(i for i, reached in enumerate(accumulate(chances)) if point < reached)


def policy_named(mdp: MDP, scenario: Scenario, name: str) -> Policy:
    """Return a policy by name: optimal, random, reported:START, always:ACTION or a file."""
    if name == "optimal":
        return Policy.of(mdp, solve(mdp))
    if name.startswith("reported:"):
        start = name.removeprefix("reported:")
        if start not in AVERAGES or tuple(scenario.statuses) != tuple(BITS):
            raise ModelError(
                f"{name} is none of the paper's policies for this scenario",
                where="--policy",
                fix=f"give reported:ACTION, ACTION one of {', '.join(AVERAGES)}, with yuan2025",
            )
        return Policy.of(mdp, Reading(scenario=scenario).find_reported_policy(start))
    return Policy.of(mdp, name)


@dataclass(frozen=True, kw_only=True, eq=False)
class Conversation:
    """A compiled scenario, a policy that acts on a perceived status, and who speaks."""

    scenario: Scenario
    mdp: MDP
    policy: Policy
    modules: Modules
    backend: Backend
    seed: int
    asked: Mapping[str, Any]  # how scenario and policy were named, for the header

    @cached_property
    def weights(self) -> np.ndarray:
        """(L,) probability of each action in its state."""
        return np.asarray(self.policy.weights(self.mdp))

    def build_header(self) -> dict[str, Any]:
        """Return everything that determines the conversation: the first entry of a recording."""
        return {
            "kind": "header",
            "format": log.FORMAT,
            "disclaimer": DISCLAIMER,
            **self.asked,
            "policy_hash": sha256(self.weights.tobytes()).hexdigest(),
            "statuses": list(self.scenario.statuses),
            "actions": list(self.mdp.actions),
            "setting": ACTIVITY["setting"],
            "steps": [{"goal": s["goal"], "step": s["step"]} for s in self.modules.steps],
            "trials": self.scenario.trials,
            "backend": self.backend.describe(),
            "texts": TEXTS["version"],
            "variant": self.modules.variant,
            "history": self.modules.history,
            "seed": self.seed,
        }

    def hold(
        self,
        out: Path,
        *,
        resume: bool = False,
        limit: int | None = None,
        progress: Callable[[dict[str, Any]], None] = lambda step: None,
    ) -> Recording:
        """Run into a folder, or `resume` the recording in it, up to `limit` timesteps in all.

        Raises ModelError if the folder holds a conversation and `resume` is not asked for, or if it
        has other settings. What was recorded before a failure stays.
        """
        record = log.open_recording(out / NAME, self.build_header(), resume=resume)
        try:
            while record.end is None and (limit is None or len(record.steps) < limit):
                if record.steps and self.mdp.terminal[record.steps[-1]["next_state"]]:
                    record.add_entry(log.compute_totals(record.steps))
                    break
                record.add_entry(self.simulate_step(record.steps))
                progress(record.steps[-1])
        finally:  # write all records, whatever stopped the run
            write_file(record.path.with_suffix(".txt"), log.format_recording(record))
        return record

    def simulate_step(self, past: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return the timestep that follows the timesteps `past`."""
        modules, timestep = self.modules, len(past)

        def seed_for_purpose(purpose: str) -> int:
            return derive_seed(self.seed, timestep, purpose)

        # Where the step begins: at the end of the one before, or in a start state.
        if past:
            state, total = int(past[-1]["next_state"]), Fraction(past[-1]["return"])
        else:
            starts = self.mdp.start
            state = starts[
                sample_index([chance for _, chance in starts], seed_for_purpose("start"))
            ][0]
            total = Fraction(0)
        subtask = self.read_coordinate(state, "subtask")
        trial, bits = self.read_coordinate(state, "trial"), self.read_coordinate(state, "status")
        label, status = self.name_status(bits)
        place = modules.describe_place(subtask, trial + 1, self.scenario.trials)
        # Prompts recall only what could be seen and heard, not the status.
        exchanges = []
        for step in past:
            exchanges.append(
                {
                    "timestep": step["timestep"],
                    "step": modules.steps[step["subtask"]]["step"],
                    "nonverbal": step["behaviour"]["nonverbal"],
                    "verbal": step["behaviour"]["verbal"],
                    "caregiver": step["assistance"],
                }
            )
        # The person behaves, and the robot perceives.
        behaviour = self.backend.answer(
            modules.ask_behaviour(place, exchanges, status, seed_for_purpose("behaviour"))
        )
        seen = self.backend.answer(
            modules.ask_perception(behaviour, seed_for_purpose("perception"))
        )
        perceived = "".join(str(int(seen[name])) for name in status)
        # The policy chooses by the perceived status, and the robot speaks.
        action = self.sample_action(state - bits + int(perceived, 2), seed_for_purpose("policy"))
        name, speech = self.mdp.actions[action], ""
        if name not in (self.mdp.actions[0], SKIP):
            asked = modules.ask_execution(
                place, exchanges, behaviour, name, dict(seen), seed_for_purpose("execution")
            )
            speech = str(self.backend.answer(asked)["speech"])
        # The model draws the next state by the true status.
        following, reward, event = self.sample_outcome(
            state, action, seed_for_purpose("transition")
        )
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
            "return": str(total + self.mdp.discount_exact**timestep * reward),
            "next_state": following,
        }

    def label_behaviours(self, path: Path, *, each: int, behave: Backend) -> None:
        """Write `each` behaviours for every status vector to a file, and the perceived statuses.

        The matrix C(s, p) = count(s, p) / each is the perception of the backend. Behaviours that
        the file holds already are not asked for again.
        """
        modules, size = self.modules, 2 ** len(self.modules.statuses)
        header = {
            "kind": "header",
            "format": log.FORMAT,
            "statuses": list(modules.statuses),
            "behave": behave.describe(),
            "perceive": self.backend.describe(),
            "texts": TEXTS["version"],
            "seed": self.seed,
        }
        record = log.open_recording(path, header, resume=True)
        for number in range(len(record.steps), each * size):
            label, status = self.name_status(number % size)
            asked, judged = (derive_seed(self.seed, number, name) for name in DRAWS[3:5])
            place = modules.describe_place(number // size, 1, self.scenario.trials)
            behaviour = behave.answer(modules.ask_behaviour(place, (), status, asked))
            seen = self.backend.answer(modules.ask_perception(behaviour, judged))
            record.add_entry(
                {
                    "kind": "step",
                    "timestep": number,
                    "status": label,
                    "perceived": "".join(str(seen[name]) for name in status),
                    "behaviour": behaviour,
                }
            )

    def name_status(self, bits: int) -> tuple[str, dict[str, int]]:
        """Return a status as its string, such as 0100, and by names."""
        names = self.modules.statuses
        label = format(bits, f"0{len(names)}b")
        return label, {name: int(bit) for name, bit in zip(names, label, strict=True)}

    def read_coordinate(self, state: int, column: str) -> int:
        """Return one coordinate of a state; the last is the status."""
        return int(self.mdp.space.values(column, np.array([state]))[0])

    def sample_action(self, state: int, seed: int) -> int:
        """Return the action that the policy draws in a state."""
        pairs = list(self.mdp.pairs_of(state))
        chances = [Fraction(float(self.weights[pair])) for pair in pairs]
        return int(self.mdp.pair_action[pairs[sample_index(chances, seed)]])

    def sample_outcome(self, state: int, action: int, seed: int) -> tuple[int, Fraction, str]:
        """Draw the outcome of an action: next state, reward, event."""
        mdp, pair = self.mdp, self.mdp.pair(state, action)
        rows = list(mdp.table.row(pair))
        picked = sample_index([row[0] for row in rows], seed)
        _, following, reward = rows[picked]
        marks, outcome = mdp.table.event, int(mdp.table.offsets[pair]) + picked
        skipped = marks is not None and int(marks[outcome]) >> mdp.events.index(SKIP) & 1
        left = self.read_coordinate(state, "subtask") != self.read_coordinate(following, "subtask")
        done = left or bool(mdp.terminal[following])
        return following, reward, "skipped" if skipped else "completed" if done else "failed"


def build_conversation(
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

    >>> talk = build_conversation(Scripted(), policy="always:directive", seed=1)
    >>> talk.simulate_step([])["action"]
    'directive'
    """
    model = Scenario.load(scenario)
    for assignment in sets:
        model = model.set(assignment)
    mdp = model.compile()
    return Conversation(
        scenario=model,
        mdp=mdp,
        policy=policy_named(mdp, model, policy),
        modules=Modules.of(model, variant=variant, history=history),
        backend=backend,
        seed=seed,
        asked={"scenario": scenario, "set": list(sets), "policy": policy},
    )


@cache
def texts_of_figures() -> dict[str, str]:
    """Return the prompts and a scripted interaction, by the figures of the paper."""
    with TemporaryDirectory() as folder:
        record = build_conversation(Scripted(), seed=3).hold(Path(folder) / "talk", limit=6)
    brief, detailed = (assistance_lines(detailed=each) for each in (False, True))
    return {
        "Figure 5": fill_prompt("behaviour"),
        "Figure 6": fill_prompt("perception"),
        "Figure 7": fill_prompt("execution", without=["status"], assistance=brief),
        "Figure 8": fill_prompt("execution", assistance=detailed),
        "Figure 11": log.format_recording(record),
        "Figure 12": "\n".join(log.format_dialogue(record.header, step) for step in record.steps),
    }
