"""Errors of a Q-table against the optimal action values: these explain a regret, and judge nothing.

    error(s, a) = Q(row(s), a) - Q*(s, a)

over the pairs of all states with a choice that any policy can reach, infinities left out. A table
that shares rows among states cannot be right everywhere, and a greedy policy can be optimal under
large errors. What the table promises at the start, max_a Q, stands beside its greedy policy's value
there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import by_time, rows_read
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import cell
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.solution import in_float


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
        max_a Q at the start; of costs, min_a Q.
    """

    largest: float
    where: str
    mean: float
    root_mean_square: float
    visited: float
    promised: float

    def __str__(self) -> str:
        return (
            f"promises {cell(self.promised)} at the start; its error: mean {cell(self.mean)}, "
            f"root mean square {cell(self.root_mean_square)} ({cell(self.visited)} by visits), at "
            f"most {cell(self.largest)} in {self.where}"
        )


def q_error(mdp: MDP, policy: Policy, optimal: Floats, used: Floats) -> QError | None:
    """Return the errors of the table that a policy is greedy in; None where nothing is asked.

    `optimal` are the optimal action values (L,), `used` (L,) the expected uses of pairs. Where some
    are used for ever, only these have a weight, each the same.
    """
    assert policy.values is not None
    # (K, A) over the states, or the columns that the policy reads; (N, S, A) by time
    table = by_time(mdp, policy.values, np.nan, of_actions=True)
    keys = rows_read(mdp, policy.space)[mdp.pair_state]
    named = [policy.actions.index(name) if name in policy.actions else -1 for name in mdp.actions]
    column = np.array(named)[mdp.pair_action]
    said, known = np.full(mdp.n_pairs, np.nan), (column >= 0) & (keys < len(table))
    values = table[keys[known], column[known]]
    with np.errstate(over="ignore"):
        exact = values.dtype == object
        said[known] = [in_float(x) for x in values] if exact else values.astype(np.float64)
    asked = (reachable(mdp) & ~mdp.forced & ~mdp.terminal)[mdp.pair_state]
    asked &= np.isfinite(said) & np.isfinite(optimal)
    if not asked.any():
        return None
    error = np.where(asked, said, 0.0) - np.where(asked, optimal, 0.0)
    weight = np.where(asked, np.isinf(used) if np.isinf(used).any() else used, 0.0)
    total = float(weight.sum())
    better = np.fmax if mdp.sense == "max" else np.fmin
    best = better.reduceat(said, mdp.pair_offsets[:-1])
    start = mdp.start_distribution > 0
    return QError(
        largest=float(np.abs(error).max()),
        where=mdp.where(int(np.argmax(np.abs(error)))),
        mean=float(error[asked].mean()),
        root_mean_square=float(np.sqrt((error[asked] ** 2).mean())),
        visited=float(np.sqrt(weight @ error**2 / total)) if total > 0 else 0.0,
        promised=float(mdp.start_distribution[start] @ best[start]),
    )
