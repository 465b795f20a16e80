"""What records leave open of the model that was estimated from them."""

from __future__ import annotations

import numpy as np

from exact_mdp.mdp.io.transitions import CUT_OFF
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.mdp.validate import Flags


def entered(mdp: MDP) -> tuple[str, ...]:
    """Return the states of a model with counts that were entered and never left.

    It takes them for ends, which the records do not say: they may have been cut off there.
    """
    assert mdp.observations is not None
    left = np.logical_or.reduceat(mdp.observations > 0, mdp.pair_offsets[:-1])
    states = np.flatnonzero(mdp.terminal & ~left & ~cut_off(mdp))
    own = states[states < mdp.n_states - len(mdp.space.extra)]
    return tuple(mdp.space.label(state) for state in own.tolist())


def cut_off(mdp: MDP) -> Flags:
    """Return (S,) states of a model with counts that nobody left, and where episodes were cut off.

    It takes them for ends, too; nobody knows what they are worth.
    """
    return mdp.labels.get(CUT_OFF, np.zeros(mdp.n_states, dtype=bool))


def never_taken(mdp: MDP) -> Integers:
    """Return (N, 2) the states that were left, and the actions that nobody took there."""
    assert mdp.observations is not None
    seen = mdp.observations > 0
    taken = np.zeros((mdp.n_states, mdp.n_actions), dtype=bool)
    taken[mdp.pair_state[seen], mdp.pair_action[seen]] = True
    return np.argwhere(taken.any(axis=1, keepdims=True) & ~taken)
