"""Why a policy loses: what its columns cannot express, and what was learned wrongly on top.

    V*(start) - V^π(start) = [V*(start) - best] + [best - V^π(start)]

where `best` is the value of the best deterministic policy that reads the same columns as π
(`analysis.gate.column_policies`). The first bracket is the *representation loss*: no learner that
reads these columns can avoid it. The second is the *learning error*; it is negative where π mixes
and gains by that. What it would be worth to remember more is the value of the best policy that
reads further columns, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from exact_mdp.analysis.gate.column_policies import BestPolicy, best_policy, value_of_memory
from exact_mdp.analysis.gate.regret import Regret, regret
from exact_mdp.analysis.gate.relaxation import Relaxations, Rows, one_hot
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.solvers.bounds.gains import SLACK
from exact_mdp.solvers.solution import Bounded, Certified
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True)
class RowChange:
    """One row of a policy's table, changed alone.

    Attributes
    ----------
    row : str
        The row, such as "status 0100".
    learned, best : str
        The action in the table, and the one with which the policy is worth most at the start.
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
        return 0.0 if self.best.proven else self.best.upper_bound - self.best.value.value

    @cached_property
    def memory(self) -> tuple[BestPolicy, ...]:
        """The best policies that read more columns; see `value_of_memory`."""
        return value_of_memory(self.mdp, self.best.columns, known=(self.best,))

    @cached_property
    def rows(self) -> tuple[RowChange, ...]:
        """The rows of a deterministic policy's table whose change alone gains, the most first."""
        return row_changes(self.mdp, self.policy) if self.policy.deterministic else ()


def representation(
    mdp: MDP, policy: Policy, lost: Regret, *, node_limit: int | None = None
) -> Representation:
    """Return how much of a policy's regret its columns explain.

    Parameters
    ----------
    lost : Regret
        The policy's regret.
    node_limit : int, optional
        See `best_policy`.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.solvers.values.policy_chain import PolicyChain
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> policy = Policy.of(mdp, "always:directive")
    >>> found = representation(mdp, policy, regret(mdp, PolicyChain.of(mdp, policy)))
    >>> found.best.columns, round(float(found.loss.value), 4), found.uncertainty
    ((), 77.9004, 0.0)
    """
    best = best_policy(mdp, columns_read(mdp, policy), start=policy, node_limit=node_limit)
    optimum = lost.optimum
    loss = regret(mdp, PolicyChain.of(mdp, best.policy), optimum=optimum).at_start
    return Representation(
        mdp=mdp,
        policy=policy,
        best=best,
        loss=loss,
        learning_error=_difference(lost.at_start, loss),
    )


def _difference(all_of_it: Certified | Bounded, part: Certified | Bounded) -> Certified | Bounded:
    if isinstance(all_of_it, Certified) and isinstance(part, Certified):
        return Certified(value=all_of_it.value - part.value)
    low = all_of_it.interval[0] - part.interval[1]
    high = all_of_it.interval[1] - part.interval[0]
    value = float(all_of_it.value) - float(part.value)
    return Bounded(value=value, error=max(high - value, value - low) * SLACK)


def row_changes(mdp: MDP, policy: Policy) -> tuple[RowChange, ...]:
    """Return the rows of a deterministic policy's table whose change alone gains, the most first.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> changes = row_changes(mdp, Policy.of(mdp, "always:none"))
    >>> [(change.row, change.best, round(change.gain, 3)) for change in changes]
    [('all states', 'non-directive', 126.031)]
    """
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
