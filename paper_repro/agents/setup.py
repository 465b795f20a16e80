"""From the words of a command line, or a recording's header, to a conversation.

The four variants of action execution side by side, on the same behaviours and actions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from exact_mdp.mdp import Scenario
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.paper_repro.agents.conversation import Conversation
from exact_mdp.paper_repro.agents.measure import bits
from exact_mdp.paper_repro.agents.modules import HISTORY, VARIANTS, Activity, Modules, Place
from exact_mdp.paper_repro.agents.prompts import FOLDER, Prompts, look_up
from exact_mdp.paper_repro.agents.protocol import Backend
from exact_mdp.paper_repro.agents.world import World, seed_of


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


@dataclass(frozen=True, kw_only=True)
class Answers:
    """What the robot says to one behaviour with one kind of assistance, by variant."""

    status: str
    action: str
    behaviour: dict[str, str]
    speech: dict[str, str]
    prompt_characters: dict[str, int]


def side_by_side(
    modules: Modules,
    backend: Backend,
    *,
    vectors: list[int],
    actions: list[str],
    seed: int,
    progress: Callable[[Answers], None] = lambda found: None,
) -> list[Answers]:
    """Return the answers of all variants for each status vector and action.

    The behaviour is made once for each vector, and the variants share their seed, so that what
    differs between them is the prompt.
    """
    found = []
    place = Place(step=modules.activity.steps[0], attempt=2, attempts=5)
    for number, (vector, action) in enumerate(product(vectors, actions)):
        status = bits(vector, modules.statuses)
        asked = modules.behaviour(place, (), "", status, seed_of(seed, vector, "behaviour"))
        behaviour = dict(backend.answer(asked).data)
        speech, length = {}, {}
        for variant in VARIANTS:
            request = replace(modules, variant=variant).execution(
                place, (), behaviour, action, status, seed_of(seed, number, "execution")
            )
            speech[variant] = str(backend.answer(request).data["speech"])
            length[variant] = sum(len(content) for _, content in request.messages)
        entry = Answers(
            status="".join(map(str, status.values())),
            action=action,
            behaviour=behaviour,
            speech=speech,
            prompt_characters=length,
        )
        found.append(entry)
        progress(entry)
    return found
