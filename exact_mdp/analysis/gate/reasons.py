"""Where a policy does not act optimally, what each such state costs, and why.

    cost(s) = d(s) gap(s, π(s)),    d the policy's discounted visits from the start
    V*(start) - V^π(start) = [V*(start) - best] + [best - V^π(start)]
    error(s, a) = Q(row(s), a) - Q*(s, a)

Costs sum to the regret of the policy π; where it waits for ever, see `analysis.gate.waiting`. The
first bracket is what no policy that reads the same columns can avoid (`analysis.gate.columns`), the
second what was learned wrongly on top. Errors of a Q-table are those of all states with a choice
that any policy can reach, infinities left out; a greedy policy can be optimal under large ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.columns import BestPolicy, PolicyRows, best_policy
from exact_mdp.analysis.gate.regret import Regret, policy_regret
from exact_mdp.analysis.gate.waiting import charge_class_losses, final_class, find_attaining_pairs
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import rows_read
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Shown, format_cell
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.solution import Bounded, Certified, SolverError, in_float, subtract_numbers
from exact_mdp.solvers.values.policy_chain import PolicyChain

LISTED = 4  # actions that a text names in one state
CLOSE = 2.0**-40  # errors of visits, as parts of the most, that leave ten digits right


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """A state in which a policy does something that is not optimal."""

    state: int
    label: str
    learned: str  # the action taken, or those drawn from with their probabilities
    optimal: tuple[str, ...]  # all optimal actions
    gap: float  # what doing this once loses; where it waits for ever, what waiting loses
    expected_visits: float  # discounted, from the start
    cost: float  # expected_visits · gap, and what is lost by waiting; these sum to the regret


Findings = tuple[Floats, tuple[Disagreement, ...]]  # visits (S,), and where it is not optimal


def find_policy_disagreements(chain: PolicyChain, regret: Regret) -> Findings:
    """Return the visits of the policy of `chain`, and the states that make up its regret.

    Visits are infinite where the policy stays for ever at discount 1, the end left out; and NaN
    where floats cannot bound them and rational arithmetic would be slow.
    """
    mdp = chain.mdp
    label = np.full(mdp.n_states, -1)
    if mdp.discount_exact == 1 and not chain.ends_from_start:
        label = np.where(chain.reached, final_class(chain), -1)
    leaving = chain.make_terminal(label >= 0) if (label >= 0).any() else chain
    came = _compute_state_visits(leaving, exactly=isinstance(regret.at_start, Certified))
    return list_disagreements(chain, regret, np.where(chain.reached, came, 0.0), label)


def _compute_state_visits(chain: PolicyChain, *, exactly: bool) -> Floats:
    """Return (S,) expected visits; `exactly` where the digits of floats are not all right."""
    try:
        visits = chain.discounted.visits
        if not exactly or visits.error.max() <= CLOSE * visits.value.max():
            return visits.value
    except SolverError:
        if not exactly:
            return np.full(chain.mdp.n_states, np.nan)
    return chain.exact_visits.to_floats()


def list_disagreements(
    chain: PolicyChain, regret: Regret, came: Floats, label: Integers
) -> Findings:
    """Return visits (S,) and the states that make up the regret, the costliest first.

    `came` (S,) are visits, in the classes of `label`, which are never left, arrivals.
    """
    mdp, weights, first = chain.mdp, chain.weights, chain.mdp.pair_offsets[:-1]
    visits = np.where(label >= 0, np.inf, came)
    gap = np.add.reduceat(weights * np.where(weights > 0, regret.gap, 0.0), first)
    wrong = np.add.reduceat(weights * ~regret.optimal_pairs, first) > 0
    cost = np.where(gap > 0, visits, 0.0) * np.where(visits > 0, gap, 0.0)
    waits = charge_class_losses(label, came, regret.by_state, gap, wrong)
    gap, cost = np.where(waits > 0, regret.by_state, gap), cost + waits
    states, disagreements = np.flatnonzero(wrong & ~mdp.terminal), []
    for state in states[np.lexsort((states, -gap[states], -cost[states]))].tolist():
        right = [pair for pair in mdp.pairs_of(state) if regret.optimal_pairs[pair]]
        if isinstance(regret.optimum, Certificate):
            right = find_attaining_pairs(mdp, regret.optimum, regret.optimal_pairs, state)
        disagreements.append(
            Disagreement(
                state=state,
                label=mdp.space.label(state),
                learned=action_of(chain, state),
                optimal=tuple(mdp.actions[mdp.pair_action[pair]] for pair in right),
                gap=float(gap[state]),
                expected_visits=float(visits[state]),
                cost=float(cost[state]),
            )
        )
    return visits, tuple(disagreements)


def action_of(chain: PolicyChain, state: int) -> str:
    """Return the action that a policy takes in a state, or what it draws from."""
    mdp, weights = chain.mdp, chain.weights
    taken = [pair for pair in mdp.pairs_of(state) if weights[pair] > 0]
    names = {pair: str(mdp.actions[mdp.pair_action[pair]]) for pair in taken}
    if len(taken) == 1:
        return names[taken[0]]
    if len(taken) > LISTED:
        if len({f"{weights[pair]:.4g}" for pair in taken}) == 1:
            return f"any of {len(taken)}"
        taken.sort(key=lambda pair: -weights[pair])
    return _join_few([f"{weights[pair]:.4g} {names[pair]}" for pair in taken], ", ")


def format_alternatives(names: Sequence[str]) -> str:
    """Return actions that are all optimal, in words."""
    return _join_few(names, " or ")


def _join_few(texts: Sequence[str], between: str) -> str:
    more = 0 if len(texts) <= LISTED else len(texts) - LISTED + 1
    return between.join([*texts[: len(texts) - more], *[f"{more} others"] * bool(more)])


# ---- why -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Representation:
    """What the columns that a policy reads allow, and what was learned wrongly on top.

    Where the search for the best policy did not end, the loss may be smaller by `uncertainty`, and
    the learning error larger. That is below 0 where the policy mixes and gains by it.
    """

    best: BestPolicy  # of the columns that the policy reads
    loss: Certified | Bounded  # the first bracket
    learning_error: Certified | Bounded  # the second
    rows: tuple[dict[str, Any], ...]  # of a deterministic policy, whose change alone gains
    unseen: str  # the columns that it does not read

    @classmethod
    def of(cls, mdp: MDP, policy: Policy, lost: Regret) -> Representation:
        """Return how much of a policy's regret `lost` its columns explain."""
        read = tuple(name for name in mdp.space.names if name in policy.columns)
        best = best_policy(mdp, read, start=policy)
        loss = policy_regret(PolicyChain.of(mdp, best.policy)).at_start
        return cls(
            best=best,
            loss=loss,
            learning_error=subtract_numbers(lost.at_start, loss),
            rows=_find_row_changes(PolicyRows(mdp.maximised, read), policy)
            if policy.deterministic
            else (),
            unseen=", ".join(name for name in mdp.space.names if name not in read),
        )

    @property
    def uncertainty(self) -> float:
        """How much more than the best policy found another one may be worth."""
        return 0.0 if self.best.proven else abs(self.best.upper_bound - self.best.value.value)

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
        """Return what a report says of it."""
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
    """Return the rows of a deterministic policy whose change alone gains, the most first."""
    own, names = rows.choices_of(policy), rows.mdp.actions
    other = rows.available & rows.asked[:, None] & (own[:, None] != np.arange(len(names)))
    row, action = np.nonzero(other)
    choices = np.repeat(own[None], len(row) + 1, axis=0)
    choices[np.arange(len(row)), row] = action
    values = rows.evaluate_choices(choices)
    gain, changes = values.value[:-1] - values.value[-1], dict[str, dict[str, Any]]()
    for k in np.lexsort((action, -gain)).tolist():  # the best of each row first
        label = rows.space.label(int(row[k])) or "all states"
        if gain[k] > 2 * values.error.max() and label not in changes:
            taken = {"learned": names[own[row[k]]], "best": names[action[k]]}
            changes[label] = {"row": label, **taken, "gain": float(gain[k])}
    return tuple(changes.values())


@dataclass(frozen=True, kw_only=True)
class QError:
    """Errors of a Q-table against the optimal action values."""

    largest: float  # of |error|
    where: str  # state and action of that error
    mean: float  # above 0 where the table promises too much
    root_mean_square: float
    visited: float  # the same of the actions taken, each weighted by the policy's visits
    promised: float  # max_a Q at the start; of costs, min_a Q

    def __str__(self) -> str:
        return (
            f"promises {format_cell(self.promised)} at the start; "
            f"its error: mean {format_cell(self.mean)}, "
            f"root mean square {format_cell(self.root_mean_square)} "
            f"({format_cell(self.visited)} by visits), at "
            f"most {format_cell(self.largest)} in {self.where}"
        )


def q_error(mdp: MDP, policy: Policy, optimal: Floats, used: Floats) -> QError | None:
    """Return the errors of the table that a policy is greedy in; None where nothing is asked.

    By optimal action values (L,), and the expected uses of pairs (L,): where some are used for
    ever, only these have a weight, each the same.
    """
    assert policy.values is not None
    keys = rows_read(mdp, policy.space)[mdp.pair_state]
    named = [policy.actions.index(name) if name in policy.actions else -1 for name in mdp.actions]
    column = np.array(named)[mdp.pair_action]
    said, known = np.full(mdp.n_pairs, np.nan), column >= 0
    values = policy.values[keys[known], column[known]]
    with np.errstate(over="ignore"):
        exact = values.dtype == object
        said[known] = [in_float(x) for x in values] if exact else values.astype(np.float64)
    asked = (find_reachable_states(mdp) & ~mdp.forced & ~mdp.terminal)[mdp.pair_state]
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
