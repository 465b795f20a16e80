"""The four variants of action execution side by side, on the same behaviours and actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

from paper_repro.agents.measure import bits
from paper_repro.agents.modules import VARIANTS, Modules, Place
from paper_repro.agents.protocol import Backend
from paper_repro.agents.world import seed_of


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
