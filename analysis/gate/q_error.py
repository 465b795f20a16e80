"""How wrong a Q-table is about the optimal action values, and about what it will earn.

    error(s, a) = Q(row(s), a) - Q*(s, a)

over the pairs of all states with a choice that any policy can reach, infinities left out. A table
that shares rows among states cannot be right everywhere, and a greedy policy can be optimal under
large errors: these numbers explain, they do not judge. What the table promises at the start,
max_a Q, is set beside what its greedy policy is worth there.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf

import numpy as np

from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import by_time, rows_read
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Numbers


@dataclass(frozen=True, kw_only=True)
class QError:
    """Errors of a Q-table against the optimal action values.

    Attributes
    ----------
    largest : float
        The greatest |error|.
    where : str
        State and action of that error.
    mean : float
        Mean error: above 0 where the table promises too much.
    root_mean_square : float
    visited : float
        Root mean square error of the actions taken, each weighted by the policy's visits.
    promised : float
        max_a Q at the start.
    """

    largest: float
    where: str
    mean: float
    root_mean_square: float
    visited: float
    promised: float


def pair_values(mdp: MDP, policy: Policy, table: Numbers) -> Floats:
    """Return (L,) what a Q-table says of each pair; NaN where it says nothing.

    Parameters
    ----------
    policy : Policy
        The table's greedy policy, which knows its rows and actions.
    table : (K, A)
        Rows of the states, or of the columns that the policy reads; (N, S, A) by time.
    """
    table = by_time(mdp, table, np.nan, of_actions=True)
    keys = rows_read(mdp, policy.space)[mdp.pair_state]
    column = np.array(
        [policy.actions.index(name) if name in policy.actions else -1 for name in mdp.actions]
    )[mdp.pair_action]
    found = np.full(mdp.n_pairs, np.nan)
    said = (column >= 0) & (keys < len(table))
    found[said] = _floats(table[keys[said], column[said]])
    return found


def _floats(values: Numbers) -> Floats:
    """Return numbers of any type as floats, infinite where they are beyond these."""
    if values.dtype == object:
        return np.array([_float(value) for value in values], dtype=np.float64)
    with np.errstate(over="ignore"):
        return values.astype(np.float64)


def _float(value: float | Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        return inf if value > 0 else -inf


def q_error(mdp: MDP, said: Floats, optimal: Floats, used: Floats) -> QError | None:
    """Return the errors of action values, or None where no state with a choice can be reached.

    Parameters
    ----------
    said, optimal : (L,)
        Action values of the table, and the optimal ones.
    used : (L,)
        How often the policy uses each pair, from the start.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> said, optimal = np.array([2.0, 2.0, 0.0, 0.0]), np.array([1.0, 3.0, 0.0, 0.0])
    >>> found = q_error(mdp, said, optimal, np.array([1.0, 0.0, 0.0, 0.0]))
    >>> found.largest, found.mean, found.promised
    (1.0, 0.0, 2.0)
    """
    asked = (reachable(mdp) & ~mdp.forced & ~mdp.terminal)[mdp.pair_state] & np.isfinite(said)
    if not asked.any():
        return None
    error = np.where(asked, np.where(asked, said, 0.0) - optimal, 0.0)
    worst = int(np.argmax(np.abs(error)))
    weight = np.where(asked, used, 0.0)
    total = float(weight.sum())
    best = np.fmax.reduceat(said, mdp.pair_offsets[:-1])
    start = mdp.start_distribution > 0
    return QError(
        largest=float(np.abs(error).max()),
        where=mdp.where(worst),
        mean=float(error[asked].mean()),
        root_mean_square=float(np.sqrt((error[asked] ** 2).mean())),
        visited=float(np.sqrt(weight @ error**2 / total)) if total > 0 else 0.0,
        promised=float(mdp.start_distribution[start] @ best[start]),
    )
