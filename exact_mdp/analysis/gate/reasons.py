"""The reasons of a regret: what the columns that a policy reads cannot express, and errors.

    V*(start) - V^π(start) = [V*(start) - best] + [best - V^π(start)]
    error(s, a) = Q(row(s), a) - Q*(s, a)

The first bracket is the loss of every policy that reads the same columns (`analysis.gate.columns`),
the second the learning error on top. Errors of a Q-table are taken over all reachable states with a
choice, infinite ones excepted; a greedy policy can be optimal although its errors are large.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isinf
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.columns import BestPolicy, PolicyRows, best_policy
from exact_mdp.analysis.gate.regret import Regret, policy_regret
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import rows_read
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Shown, format_cell
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.claims import Bounded, Certified, in_float
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class Representation:
    """A regret split into the loss due to the columns that a policy reads, and a learning error.

    If the search for the best policy did not end, the loss may be smaller by `uncertainty`, and the
    learning error larger. The learning error is negative if the policy gains by mixing actions.
    """

    best: BestPolicy  # the best one that reads the same columns
    loss: Certified | Bounded  # the first bracket
    learning_error: Certified | Bounded  # the second
    rows: tuple[dict[str, Any], ...]  # rows of a deterministic policy whose change alone gains
    unseen: str  # the columns that it does not read

    @classmethod
    def of(cls, mdp: MDP, policy: Policy, lost: Regret) -> Representation:
        """Return the split of the regret `lost` of a policy."""
        read = tuple(name for name in mdp.space.names if name in policy.columns)
        best = best_policy(mdp, read, start=policy)
        loss = policy_regret(PolicyChain.of(mdp, best.policy)).at_start
        if isinf(float(loss)):
            raise ModelError(
                "every policy that reads the same columns loses an infinite amount, too",
                where="the regret at the start",
                fix="let the policy read more columns",
            )
        rows: tuple[dict[str, Any], ...] = ()
        if policy.deterministic:
            rows = _find_row_changes(PolicyRows.of(mdp.maximised, read), policy)
        return cls(
            best=best,
            loss=loss,
            learning_error=lost.at_start - loss,
            rows=rows,
            unseen=", ".join(name for name in mdp.space.names if name not in read),
        )

    @property
    def uncertainty(self) -> float:
        """How much better than the best policy found another one may be."""
        if self.best.proven:
            return 0.0
        return abs(self.best.upper_bound - self.best.value.value)

    def __str__(self) -> str:
        best = self.best
        proof = "proven" if best.proven else f"bound {format_cell(best.upper_bound)}"
        return (
            f"the best policy that reads {', '.join(best.columns) or 'nothing'} alone has "
            f"{format_cell(best.value)} ({proof}): {format_cell(self.loss)} is lost "
            "because it cannot see "
            f"{self.unseen}, {format_cell(self.learning_error)} because of what was learned"
        )

    def list_facts(self) -> dict[str, Any]:
        """Return the facts for a report."""
        best = self.best
        details = {
            "columns": best.columns,
            "best_value": best.value.value,
            "error_bound": best.error,
            "upper_bound": best.upper_bound,
            "mixed_upper_bound": best.mixed_upper_bound,
            "proven": best.proven,
            "loss": float(self.loss.value),
            "learning_error": float(self.learning_error.value),
            "uncertainty": self.uncertainty,
            "policy": best.actions,
        }
        return {"representation": Shown(details, str(self)), "rows": Shown(self.rows)}


def _find_row_changes(rows: PolicyRows, policy: Policy) -> tuple[dict[str, Any], ...]:
    """Return the rows of a deterministic policy whose change alone gains, greatest gain first."""
    # One policy for each row and other action, and the policy itself in the last place.
    own, names = rows.choices_of(policy), rows.mdp.actions
    other = rows.available & rows.must_choose[:, None] & (own[:, None] != np.arange(len(names)))
    row, action = np.nonzero(other)
    choices = np.repeat(own[None], len(row) + 1, axis=0)
    choices[np.arange(len(row)), row] = action
    values = rows.evaluate_choices(choices)
    gain, changes = values.value[:-1] - values.value[-1], dict[str, dict[str, Any]]()
    # In order of gain, the first change of a row is its best; gains within rounding are left out.
    for k in np.lexsort((action, -gain)).tolist():
        label = rows.space.label(int(row[k])) or "all states"
        if gain[k] > 2 * values.error.max() and label not in changes:
            taken = {"learned": names[own[row[k]]], "best": names[action[k]]}
            changes[label] = {"row": label, **taken, "gain": float(gain[k])}
    return tuple(changes.values())


@dataclass(frozen=True, kw_only=True)
class QError:
    """Errors of a Q-table against the optimal action values."""

    largest: float  # the greatest |error|
    where: str  # state and action of that error
    mean: float  # positive if the table promises too much
    root_mean_square: float
    visited: float  # the same over the actions taken, weighted by the policy's visits
    promised: float  # max_a Q at the start; min_a Q for costs

    def __str__(self) -> str:
        return (
            f"promises {format_cell(self.promised)} at the start; "
            f"its error: mean {format_cell(self.mean)}, "
            f"root mean square {format_cell(self.root_mean_square)} "
            f"({format_cell(self.visited)} by visits), at "
            f"most {format_cell(self.largest)} in {self.where}"
        )


def q_error(mdp: MDP, policy: Policy, optimal: Floats, used: Floats) -> QError | None:
    """Return the errors of a policy's Q-table; None if no reachable state has a choice.

    `optimal` (L,) are the optimal action values and `used` (L,) the expected uses of pairs; if some
    are used infinitely often, these alone have a weight, each the same.
    """
    # The table's value of each pair, NaN for actions that the table does not have.
    assert policy.values is not None
    keys = rows_read(mdp, policy.space)[mdp.pair_state]
    named = [policy.actions.index(name) if name in policy.actions else -1 for name in mdp.actions]
    column = np.array(named)[mdp.pair_action]
    said, known = np.full(mdp.n_pairs, np.nan), column >= 0
    values = policy.values[keys[known], column[known]]
    with np.errstate(over="ignore"):
        if values.dtype == object:  # fractions
            said[known] = [in_float(x) for x in values]
        else:
            said[known] = values.astype(np.float64)
    choosing = (find_reachable_states(mdp) & ~mdp.forced & ~mdp.terminal)[mdp.pair_state]
    choosing &= np.isfinite(said) & np.isfinite(optimal)
    if not choosing.any():
        return None
    error = np.where(choosing, said, 0.0) - np.where(choosing, optimal, 0.0)
    # Weights by visits; infinite visits outweigh all finite ones.
    infinite = np.isinf(used)
    if infinite.any():
        used = infinite.astype(np.float64)
    weight = np.where(choosing, used, 0.0)
    total = float(weight.sum())
    visited = 0.0
    if total > 0:
        visited = float(np.sqrt(weight @ error**2 / total))
    # The value that the table promises at the start.
    better = np.fmin if mdp.sense.costs else np.fmax
    best = better.reduceat(said, mdp.pair_offsets[:-1])
    start = mdp.start_distribution > 0
    return QError(
        largest=float(np.abs(error).max()),
        where=mdp.where(int(np.argmax(np.abs(error)))),
        mean=float(error[choosing].mean()),
        root_mean_square=float(np.sqrt((error[choosing] ** 2).mean())),
        visited=visited,
        promised=float(mdp.start_distribution[start] @ best[start]),
    )
