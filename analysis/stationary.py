"""Whether the optimum depends on the status alone.

A policy that reads only the status is optimal wherever it may be needed exactly where, for every
status, one action is optimal in all states of that status that have a choice and that some policy
reaches from the start:  ⋂ over such states s of {a : a optimal in s}  is not empty. Ties count:
where two actions are equally good in one state, either serves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.optimum import Optimum
from mdp.chain import reachable
from mdp.model import MDP
from mdp.policy import Policy


def status_policy(mdp: MDP, optimal: NDArray[np.bool_], *, column: str = "status") -> Policy | None:
    """Return an optimal policy that reads one column alone, or None where there is none.

    Parameters
    ----------
    mdp : MDP
    optimal : (L,) bool
        The optimal pairs.
    column : str
        Name of the column.

    Returns
    -------
    Policy or None
        The lowest action that serves, for each value of the column; a value without a reachable
        choice has none.

    Examples
    --------
    >>> import numpy as np
    >>> mdp = MDP.from_arrays(np.full((2, 2, 2), 0.5), [[1, 2], [3, 3]], discount=0.5)
    >>> policy = status_policy(mdp, np.array([False, True, True, True]), column="state")
    >>> policy.table.tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    values = mdp.space.values(column)
    size = mdp.space.column(column).size
    asked = reachable(mdp) & ~mdp.forced & (values >= 0)
    states = np.bincount(values[asked], minlength=size)
    counted = optimal & asked[mdp.pair_state]
    keys = values[mdp.pair_state[counted]] * mdp.n_actions + mdp.pair_action[counted]
    serves = np.bincount(keys, minlength=size * mdp.n_actions).reshape(size, -1) == states[:, None]
    if not serves.any(axis=1).all():
        return None
    table = np.eye(mdp.n_actions)[serves.argmax(axis=1)]
    table[states == 0] = np.nan
    return Policy.by(mdp, (column,), table)


def stationary(mdp: MDP, found: Optimum) -> bool | None:
    """Return whether the optimum depends on the status alone; None where bounds leave it open.

    Bounds rule actions out: where the others have none in common, no status policy is optimal.
    What is left is known to be optimal only where it is alone.
    """
    if status_policy(mdp, found.optimal) is None:
        return False
    if found.certificate is not None:
        return True
    left = np.add.reduceat(found.optimal.astype(np.int64), mdp.pair_offsets[:-1])
    alone = found.optimal & (left == 1)[mdp.pair_state]
    return True if status_policy(mdp, alone) is not None else None
