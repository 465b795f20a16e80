"""Numbers read back out of a compiled care model, as exact rationals.

A table of the paper is compared with what the solvers really use: the chance that a status is 1
next is summed up from the outcomes of a compiled row, not taken from the scenario file.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from exact_mdp.mdp import MDP


def marginal(mdp: MDP, vector: int, action: int, bit: int, *, trial: int = 0) -> Fraction:
    """Return the exact probability that a status bit is 1 next.

    Parameters
    ----------
    vector : status vector now
    action : action number, or the only one of a state without a choice
    bit : 8, 4, 2, 1 for forgetfulness, confusion, anger, disengagement

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> marginal(Scenario.load("yuan2025").compile(), 0b0010, 0, 8)
    Fraction(37, 100)
    """
    state = mdp.space.index(subtask=0, trial=trial, status=vector)
    pairs = mdp.pairs_of(state)
    pair = pairs[0] if len(pairs) == 1 else mdp.pair(state, action)
    rows = mdp.table.row(pair)
    following = np.maximum(mdp.space.values("status", np.array([s for _, s, _ in rows])), 0)
    chances = (row[0] for row, now in zip(rows, following.tolist(), strict=True) if now & bit)
    return sum(chances, Fraction(0))


def gains(mdp: MDP, trials: int) -> Iterator[tuple[int, int, int, int, bool, bool, Fraction]]:
    """Yield what every visible outcome earns: all but those of a subtask's last trial.

    Yields
    ------
    action, status, next status, subtask, completed, ended, reward
        Of each outcome with positive probability from a trial before the last one, from which no
        subtask is skipped, so that the next status is that of the next state.
    """
    space, table = mdp.space, mdp.table
    trial, subtask, status = (space.values(name) for name in ("trial", "subtask", "status"))
    for state in range(space.regular):
        if trial[state] >= trials - 1:
            continue
        for pair in mdp.pairs_of(state):
            for probability, following, gain in table.row(pair):
                if not probability:
                    continue
                ended = following >= space.regular
                done = ended or subtask[following] != subtask[state]
                after = 0 if ended else int(status[following])
                action = int(mdp.pair_action[pair])
                place = int(subtask[state])
                yield action, int(status[state]), after, place, bool(done), bool(ended), gain
