"""Where random numbers come from: always a seed or a generator that the caller gives (SPEC 7).

Runs, draws and workers get streams of their own by `SeedSequence.spawn` from one whole number, so
that the same number gives the same bytes whatever the number of workers.
"""

from __future__ import annotations

from operator import index
from typing import TypeAlias

import numpy as np

from exact_mdp.mdp.errors import ModelError

RNG: TypeAlias = int | np.random.Generator


def seed_of(rng: RNG) -> int:
    """Return the whole number that a run starts from: the given one, or a draw of the generator.

    Anything else raises ModelError; a run never takes its seed from the clock.

    >>> seed_of(7), seed_of(np.random.default_rng(0)) == seed_of(np.random.default_rng(0))
    (7, True)
    """
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**63))
    try:
        seed = index(rng)
    except TypeError:
        seed = -1
    if seed < 0 or isinstance(rng, bool | np.bool_):
        raise ModelError(
            f"{rng!r} is not a source of random numbers",
            where="rng",
            fix="give a whole number from 0, or numpy.random.default_rng(7)",
        )
    return seed
