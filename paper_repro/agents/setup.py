"""From the words of a command line, or a recording's header, to a conversation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mdp import Scenario
from mdp.errors import ModelError, suggest
from paper_repro.agents.activity import Activity
from paper_repro.agents.conversation import Conversation
from paper_repro.agents.modules import HISTORY, VARIANTS, Modules
from paper_repro.agents.prompts import FOLDER, Prompts, look_up
from paper_repro.agents.protocol import Backend
from paper_repro.agents.world import World


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
    >>> from paper_repro.agents.scripted import Scripted
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
