"""The conversation of the two agents, one timestep after the other.

    status -> behaviour -> perceived status -> action -> what the robot says -> next status

The status moves by the scenario's Markov model under the action; the words change nothing in it.
The robot chooses by the perceived status, with subtask and trial known. With *none*, and when a
step is skipped, the robot says nothing and no model is asked. Source: Yuan et al. (2025),
Section 2 and Figure "framework".

Next states are drawn from the exact table: u = k / 2^62 with k from a seeded generator, and the
first outcome whose cumulated probability, a fraction, exceeds u. Every draw has a generator of its
own, made from (seed, timestep, purpose): what a resumed run draws does not depend on where it
stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import sha256
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.tables import SKIP
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import check_action
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.agents import DISCLAIMER
from exact_mdp.paper_repro.agents.prompts import (
    FOLDER,
    HISTORY,
    VARIANTS,
    Activity,
    Modules,
    Place,
    Prompts,
    look_up,
)
from exact_mdp.paper_repro.agents.protocol import PURPOSES, Backend, Reply, Request
from exact_mdp.paper_repro.agents.recording import FORMAT
from exact_mdp.paper_repro.readings.search import averages
from exact_mdp.solvers.solver import solve

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
    if name == "optimal":
        return Policy.from_choices(mdp, solve(mdp).policy)
    if name.startswith("reported:"):
        start = name.removeprefix("reported:")
        check_action(start, tuple(reported.AVERAGE_RETURN), "policy reported")
        if scenario.statuses != tuple(reported.TABLE_3):
            raise ModelError(
                "the paper's reported policy is one for its own statuses",
                where=f"scenario {scenario.name}",
                fix="choose optimal, random or a file",
            )
        completion = reported.COMPLETIONS[averages(scenario).best()]
        return Policy.of(mdp, reported.policy(start, completion))
    return Policy.of(mdp, name)


SILENT = ("none", SKIP)


@dataclass(frozen=True, kw_only=True)
class Conversation:
    """Everything that a conversation follows from.

    Attributes
    ----------
    world : the Markov model and the policy
    modules : the prompts, the activity and the variant of action execution
    backend : who answers
    seed : int
    asked : how scenario and policy were named, for the header
    """

    world: World
    modules: Modules
    backend: Backend
    seed: int
    asked: Mapping[str, Any]

    def header(self) -> dict[str, Any]:
        """Return the first entry of the recording."""
        modules, world = self.modules, self.world
        return {
            "kind": "header",
            "format": FORMAT,
            "disclaimer": DISCLAIMER,
            **self.asked,
            "model_hash": fingerprint(world.mdp),
            "policy_hash": sha256(world.weights.tobytes()).hexdigest(),
            "statuses": list(world.scenario.statuses),
            "actions": list(world.mdp.actions),
            "activity": modules.activity.name,
            "setting": modules.activity.setting,
            "steps": [{"goal": s.goal, "step": s.step} for s in modules.activity.steps],
            "trials": world.scenario.trials,
            "backend": self.backend.describe(),
            "prompts": modules.prompts.versions(),
            "variant": modules.variant,
            "history": modules.history,
            "seed": self.seed,
        }

    def steps(self, past: Sequence[Mapping[str, Any]] = ()) -> Iterator[dict[str, Any]]:
        """Yield the entries of the timesteps after those of `past`, to the end."""
        world, exchanges = self.world, [self._exchange(step) for step in past]
        state = int(past[-1]["next_state"]) if past else world.start(self.seed)
        total = Fraction(past[-1]["return"]) if past else Fraction(0)
        timestep = len(past)
        while not world.ended(state):
            entry = self._step(state, timestep, exchanges)
            total += world.mdp.discount_exact**timestep * Fraction(entry["reward"])
            entry["return"] = str(total)
            yield entry
            exchanges.append(self._exchange(entry))
            state, timestep = entry["next_state"], timestep + 1

    def _step(
        self, state: int, timestep: int, exchanges: Sequence[Mapping[str, Any]]
    ) -> dict[str, Any]:
        world, modules, calls = self.world, self.modules, []
        latest = str(exchanges[-1]["caregiver"]) if exchanges else ""
        subtask, trial = world.part(state, "subtask"), world.part(state, "trial")
        place = Place(
            step=modules.activity.steps[subtask],
            attempt=min(trial + 1, world.scenario.trials),
            attempts=world.scenario.trials,
        )

        def ask(request: Request) -> Mapping[str, Any]:
            reply = self.backend.answer(request)
            calls.append(_call(request, reply))
            return reply.data

        def seed(purpose: str) -> int:
            return seed_of(self.seed, timestep, purpose)

        status = world.vector(state)
        behaviour = ask(modules.behaviour(place, exchanges, latest, status, seed("behaviour")))
        seen = ask(modules.perception(behaviour, seed("perception")))
        perceived = {name: int(seen[name]) for name in status}
        action = world.action(state, perceived, self.seed, timestep)
        name, speech = world.mdp.actions[action], ""
        if name not in SILENT:
            speech = ask(
                modules.execution(place, exchanges, behaviour, name, perceived, seed("execution"))
            )["speech"]
        outcome = world.step(state, action, self.seed, timestep)
        return {
            "kind": "step",
            "timestep": timestep,
            "state": state,
            "subtask": subtask,
            "trial": trial,
            "status": world.label(state),
            "behaviour": dict(behaviour),
            "perceived": "".join(str(bit) for bit in perceived.values()),
            "action": name,
            "assistance": speech,
            "event": outcome.event,
            "reward": str(outcome.reward),
            "return": "0",
            "next_state": outcome.state,
            "calls": calls,
        }

    def _exchange(self, step: Mapping[str, Any]) -> dict[str, Any]:
        """Return what prompts recall of a timestep: what could be seen and heard, no status."""
        return {
            "timestep": step["timestep"],
            "step": self.modules.activity.steps[step["subtask"]].step,
            "nonverbal": step["behaviour"]["nonverbal"],
            "verbal": step["behaviour"]["verbal"],
            "caregiver": step["assistance"],
        }


def totals(steps: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the last entry of a finished recording."""
    calls = [call for step in steps for call in step["calls"]]
    events = [step["event"] for step in steps]
    return {
        "kind": "end",
        "timesteps": len(steps),
        "return": steps[-1]["return"],
        "completed": events.count("completed"),
        "skipped": events.count("skipped"),
        "misperceived": sum(step["status"] != step["perceived"] for step in steps),
        "requests": len(calls),
        "attempts": sum(call["attempts"] for call in calls),
        "prompt_tokens": sum(call["prompt_tokens"] for call in calls),
        "completion_tokens": sum(call["completion_tokens"] for call in calls),
    }


def uncounted(steps: Sequence[Mapping[str, Any]]) -> int:
    """Return how many answers came without a count of their tokens."""
    return sum(call["prompt_tokens"] == 0 for step in steps for call in step["calls"])


def _call(request: Request, reply: Reply) -> dict[str, Any]:
    return {"purpose": request.purpose, "request": request.digest, **vars(reply)}


def modules_of(
    scenario: Scenario,
    *,
    activity: str = "shopping",
    variant: str = "detailed+status",
    history: int = HISTORY,
    prompts: str | Path = FOLDER,
) -> Modules:
    """Return the three modules for a scenario; raises ModelError where its words are unknown."""
    if variant not in VARIANTS:
        raise ModelError(
            f"unknown variant {variant!r}", where="--variant", fix=suggest(variant, VARIANTS)
        )
    if history < 0:
        raise ModelError(
            f"history is {history}", where="--history", fix="give the number of exchanges recalled"
        )
    texts = Prompts.load(prompts)
    for status in scenario.statuses:
        look_up(texts.statuses, status, "status")
    for action in scenario.actions[1:]:
        look_up(texts.assistance, action, "assistance")
    return Modules(
        prompts=texts,
        activity=Activity.load(activity, tasks=scenario.tasks),
        statuses=scenario.statuses,
        variant=variant,
        history=history,
    )


def conversation(
    backend: Backend,
    *,
    scenario: str = "yuan2025",
    sets: Sequence[str] = (),
    policy: str = "optimal",
    seed: int = 0,
    activity: str = "shopping",
    variant: str = "detailed+status",
    history: int = HISTORY,
    prompts: str | Path = FOLDER,
) -> Conversation:
    """Return a conversation by names, as the commands give them.

    Examples
    --------
    >>> from exact_mdp.paper_repro.agents.scripted import Scripted
    >>> talk = conversation(Scripted(), policy="always:directive", seed=1)
    >>> next(talk.steps())["action"]
    'directive'
    """
    model = Scenario.load(scenario)
    for assignment in sets:
        model = model.set(assignment)
    modules = modules_of(
        model, activity=activity, variant=variant, history=history, prompts=prompts
    )
    asked = {
        "scenario": scenario,
        "set": list(sets),
        "policy": policy,
        "activity_named": activity,
        "prompts_named": "" if Path(prompts) == FOLDER else str(prompts),
    }
    return Conversation(
        world=World.of(model, policy), modules=modules, backend=backend, seed=seed, asked=asked
    )


def recorded(header: Mapping[str, Any], backend: Backend) -> Conversation:
    """Return the conversation that a recording's header describes, with another backend."""
    try:
        return conversation(
            backend,
            scenario=header["scenario"],
            sets=header["set"],
            policy=header["policy"],
            seed=header["seed"],
            activity=header["activity_named"],
            variant=header["variant"],
            history=header["history"],
            prompts=header["prompts_named"] or FOLDER,
        )
    except (KeyError, TypeError) as error:
        raise ModelError(
            f"the header lacks {error}", where="recording", fix="name a conversation.jsonl of a run"
        ) from error
