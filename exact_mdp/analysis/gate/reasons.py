"""Why a policy loses: what its columns cannot express, and what was learned wrongly on top.

    V*(start) - V^π(start) = [V*(start) - best] + [best - V^π(start)]

where `best` is the value of the best deterministic policy that reads the same columns as π
(`analysis.gate.column_policies`). The first bracket is the *representation loss*: no learner that
reads these columns can avoid it. The second is the *learning error*; it is negative where π mixes
and gains by that.

A Q-table may also be wrong about the optimal action values, and about what it will earn:

    error(s, a) = Q(row(s), a) - Q*(s, a)

over the pairs of all states with a choice that any policy can reach, infinities left out. A table
that shares rows among states cannot be right everywhere, and a greedy policy can be optimal under
large errors: these numbers explain, they do not judge. What the table promises at the start,
max_a Q, is set beside the value of its greedy policy there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from exact_mdp.analysis.gate.column_policies import BestPolicy, best_policy
from exact_mdp.analysis.gate.regret import Regret, policy_regret
from exact_mdp.analysis.gate.relaxation import Relaxations, Rows, one_hot
from exact_mdp.mdp.graph import reachable
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import by_time, rows_read
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.solution import Bounded, Certified, difference, in_float
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True)
class RowChange:
    """One row of a policy's table, changed alone.

    Attributes
    ----------
    row : str
        The row, such as "status 0100".
    learned, best : str
        The action in the table, and the one with which the policy's start value is highest.
    gain : float
        By how much.
    """

    row: str
    learned: str
    best: str
    gain: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Representation:
    """What the columns that a policy reads allow.

    Attributes
    ----------
    best : BestPolicy
        For the columns that the policy reads.
    loss : Certified or Bounded
        What the best policy found falls short of the optimum; where the search for it did not come
        to an end, the true loss may be smaller, by up to `uncertainty`.
    learning_error : Certified or Bounded
        The rest of the regret; it then is larger by as much.
    """

    mdp: MDP
    policy: Policy
    best: BestPolicy
    loss: Certified | Bounded
    learning_error: Certified | Bounded

    @property
    def uncertainty(self) -> float:
        """How much more than the best policy found another one may be worth."""
        return 0.0 if self.best.proven else abs(self.best.upper_bound - self.best.value.value)

    def __str__(self) -> str:
        best = self.best
        read = ", ".join(best.columns) or "nothing"
        beyond = "above" if self.mdp.sense == "max" else "below"
        proof = "proven" if best.proven else f"no other has one {beyond} {best.upper_bound:.10g}"
        return (
            f"the best policy that reads {read} alone has the value {best.value.value:.10g}"
            f" ({proof}); of the regret, {float(self.loss.value):.6g} is due to what the policy"
            f" reads and {float(self.learning_error.value):.6g} to what was learned"
        )

    @cached_property
    def rows(self) -> tuple[RowChange, ...]:
        """The rows of a deterministic policy's table whose change alone gains, the most first."""
        return row_changes(self.mdp.maximised, self.policy) if self.policy.deterministic else ()


def representation(mdp: MDP, policy: Policy, lost: Regret) -> Representation:
    """Return how much of a policy's regret `lost` its columns explain."""
    best = best_policy(mdp, columns_read(mdp, policy), start=policy)
    optimum = lost.optimum
    rewards = mdp.maximised
    loss = policy_regret(rewards, PolicyChain.of(rewards, best.policy), optimum=optimum).at_start
    return Representation(
        mdp=mdp,
        policy=policy,
        best=best,
        loss=loss,
        learning_error=difference(lost.at_start, loss),
    )


def row_changes(mdp: MDP, policy: Policy) -> tuple[RowChange, ...]:
    """Return the rows of a policy's table whose change alone gains, the most first."""
    rows = Rows.of(mdp, columns_read(mdp, policy))
    own = rows.choices(policy)
    others = rows.available & rows.asked[:, None] & ~one_hot(own, mdp.n_actions)
    row, action = np.nonzero(others)
    choices = np.repeat(own[None], len(row) + 1, axis=0)
    choices[np.arange(len(row)), row] = action
    values, errors = Relaxations(rows).evaluate(choices)
    gain = values[:-1] - values[-1]
    gain[gain <= 2 * errors.max()] = 0.0
    found = []
    for each in np.unique(row):
        mine = np.flatnonzero(row == each)
        best = mine[gain[mine].argmax()]
        if gain[best] > 0:
            found.append(
                RowChange(
                    row=rows.space.label(int(each)) or "all states",
                    learned=mdp.actions[own[each]],
                    best=mdp.actions[action[best]],
                    gain=float(gain[best]),
                )
            )
    return tuple(sorted(found, key=lambda change: -change.gain))


def columns_read(mdp: MDP, policy: Policy) -> tuple[str, ...]:
    """Return the columns that a policy reads, in the model's order."""
    return tuple(name for name in mdp.space.names if name in policy.columns)


# ---- errors of a Q-table ------------------------------------------------------------------------


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


def pair_values(mdp: MDP, policy: Policy, table: Numbers) -> Floats:
    """Return (L,) what a Q-table says of each pair; NaN where it says nothing.

    The table is (K, A) over the states, or the columns that its greedy policy reads; (N, S, A) by
    time.
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
        return np.array([in_float(value) for value in values], dtype=np.float64)
    with np.errstate(over="ignore"):
        return values.astype(np.float64)


def q_error(mdp: MDP, said: Floats, optimal: Floats, used: Floats) -> QError | None:
    """Return the errors of action values, or None where no state with a choice can be reached.

    `said` and `optimal` are (L,) action values; `used` (L,) the expected uses of pairs. Where some
    are used for ever, only these have a weight, each the same.
    """
    asked = (reachable(mdp) & ~mdp.forced & ~mdp.terminal)[mdp.pair_state]
    asked &= np.isfinite(said) & np.isfinite(optimal)
    if not asked.any():
        return None
    error = np.where(asked, said, 0.0) - np.where(asked, optimal, 0.0)
    worst = int(np.argmax(np.abs(error)))
    weight = np.where(asked, np.isinf(used) if np.isinf(used).any() else used, 0.0)
    total = float(weight.sum())
    better = np.fmax if mdp.sense == "max" else np.fmin
    best = better.reduceat(said, mdp.pair_offsets[:-1])
    start = mdp.start_distribution > 0
    return QError(
        largest=float(np.abs(error).max()),
        where=mdp.where(worst),
        mean=float(error[asked].mean()),
        root_mean_square=float(np.sqrt((error[asked] ** 2).mean())),
        visited=float(np.sqrt(weight @ error**2 / total)) if total > 0 else 0.0,
        promised=float(mdp.start_distribution[start] @ best[start]),
    )
