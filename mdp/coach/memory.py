"""What the handwashing assistant remembers: time, prompts, and the last prompt. All of it is ours.

Six counters, each of which stops at its last value ("or more"):

    waited     steps since the plan step last moved
    prompted   prompts so far
    ignored    prompts in a row after which the plan step stayed
    repeated   how often in a row the last prompt was given again, at any level
    level      of the last prompt, 0 before the first one and after a caregiver's help
    prompt     which one it was

`waited` makes doing nothing likelier, `prompted` the next prompt dearer; `ignored` and `repeated`
weaken it. The factors make 11 · 11 · 8 · 4 · 4 · 6 = 92,928 memories in the full model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from exact_mdp.mdp.table import Integers, Numbers

NOTHING, CAREGIVER = -1, -2  # what an action asks for that is no prompt


@dataclass(frozen=True, kw_only=True)
class Memory:
    """What each action makes of what the assistant remembers, and what memory does to the rest.

    Attributes
    ----------
    stayed, moved : (A, M)
        The next memory where the plan step stays, and where it moves.
    effect, price : (A, M)
        Which of `Coach.effects` and `Coach.prices` an action has.
    waited : (M,)
        Which of `Coach.stalls` applies.
    """

    stayed: Numbers
    moved: Numbers
    effect: Numbers
    price: Numbers
    waited: Integers

    @classmethod
    def of(cls, sizes: tuple[int, ...], asked: Sequence[int], levels: int) -> Memory:
        """Return the memory of the sizes (W, C, I, R, levels + 1, prompts), for what actions ask.

        Where prompts have one level, the last one is not remembered, and sizes end with (1, 1).
        """
        count = prod(sizes)
        waited, prompted, ignored, repeated, level, prompt = np.unravel_index(
            np.arange(count), sizes
        )

        def up(values: Integers, size: int) -> Integers:
            return np.minimum(values + 1, size - 1)

        shape = (len(asked), count)
        stayed, moved = np.empty(shape, np.int32), np.empty(shape, np.int32)
        effect, price = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
        zero, longer = np.zeros(count, np.int64), up(waited, sizes[0])
        for action, ask in enumerate(asked):
            kept = (prompted, ignored, repeated, level, prompt)
            if ask == CAREGIVER:
                kept = (prompted, zero, zero, zero, zero)
                price[action] = 1
            elif ask != NOTHING:
                which, strength = divmod(action - 1, levels)
                again, said = zero, (zero, zero)
                if levels > 1:
                    same = (level > 0) & (prompt == which)
                    again, said = (
                        np.where(same, up(repeated, sizes[3]), 0),
                        (zero + strength + 1, zero + which),
                    )
                kept = (up(prompted, sizes[1]), up(ignored, sizes[2]), again, *said)
                effect[action] = 1 + (strength * sizes[2] + ignored) * sizes[3] + again
                price[action] = 2 + strength * sizes[1] + prompted
            stayed[action] = np.ravel_multi_index((longer, *kept), sizes)
            moved[action] = np.ravel_multi_index((zero, kept[0], zero, *kept[2:]), sizes)
        return cls(stayed=stayed, moved=moved, effect=effect, price=price, waited=waited)
