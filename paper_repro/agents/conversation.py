"""The conversation of the two agents, one timestep after the other.

    status -> behaviour -> perceived status -> action -> what the robot says -> next status

The status moves by the scenario's Markov model under the action; the words change nothing in it.
The robot chooses by the perceived status, with subtask and trial known. With *none*, and when a
step is skipped, the robot says nothing and no model is asked. Source: Yuan et al. (2025),
Section 2 and Figure "framework".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import Any

from exact_mdp.mdp import Scenario
from exact_mdp.mdp.care.tables import SKIP
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.paper_repro.agents import DISCLAIMER
from exact_mdp.paper_repro.agents.modules import HISTORY, VARIANTS, Modules, Place
from exact_mdp.paper_repro.agents.prompts import FOLDER, Activity, Prompts, look_up
from exact_mdp.paper_repro.agents.protocol import Backend, Reply, Request
from exact_mdp.paper_repro.agents.recording import FORMAT
from exact_mdp.paper_repro.agents.world import World, seed_of

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
