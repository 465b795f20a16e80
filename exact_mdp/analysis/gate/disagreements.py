"""Where a policy does not act optimally, and what each such state costs.

    cost(s) = d(s) gap(s, π(s)),    d the policy's discounted visits from the start

These sum to the regret of the policy π. Where it waits for ever, see `analysis.gate.waiting`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exact_mdp.analysis.gate.regret import LAST_CYCLE, Regret, cheap
from exact_mdp.analysis.gate.waiting import attaining, final_class, shares
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.solution import Certified, SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain

LISTED = 4  # actions that a text names in one state


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


def findings(chain: PolicyChain, regret: Regret) -> Findings:
    """Return the visits of the policy of `chain`, and the states that make up its regret.

    Visits are infinite where the policy stays for ever at discount 1, the end left out; and NaN
    where floats cannot bound them and rational arithmetic would be slow.
    """
    mdp = chain.mdp
    exact = isinstance(regret.at_start, Certified) or cheap(mdp, LAST_CYCLE)
    label = np.full(mdp.n_states, -1)
    if mdp.discount_exact == 1 and not chain.ends_from_start:
        label = np.where(chain.reached, final_class(chain), -1)
    stays = label >= 0
    leaving = chain.ended(stays) if stays.any() else chain
    try:
        came = leaving.exact_visits.floats() if exact else leaving.discounted.visits.value
    except SolverError:
        came = np.full(mdp.n_states, np.nan)
    came = np.where(chain.reached, came, 0.0)
    visited = np.where(stays, np.inf, came)
    first = mdp.pair_offsets[:-1]
    gap = np.add.reduceat(chain.weights * np.where(chain.weights > 0, regret.gap, 0.0), first)
    wrong = np.add.reduceat(chain.weights * ~regret.optimal_pairs, first) > 0
    cost = np.where(gap > 0, visited, 0.0) * np.where(visited > 0, gap, 0.0)
    if stays.any():
        waits = shares(label, came, regret.by_state, gap, wrong)
        gap, cost = np.where(waits > 0, regret.by_state, gap), cost + waits
    return visited, listed(chain, regret, np.stack([gap, visited, cost]), wrong & ~mdp.terminal)


def listed(
    chain: PolicyChain, named: Regret, numbers: Floats, wrong: Flags
) -> tuple[Disagreement, ...]:
    """Return the states marked, the costliest first, with gap, visits and cost (3, S)."""
    mdp, states = chain.mdp, np.flatnonzero(wrong)
    gap, _, cost = numbers
    disagreements = []
    for state in states[np.lexsort((states, -gap[states], -cost[states]))].tolist():
        right = [pair for pair in mdp.pairs_of(state) if named.optimal_pairs[pair]]
        if isinstance(named.optimum, Certificate):
            right = attaining(mdp, named.optimum, named.optimal_pairs, state)
        gap_here, visits_here, cost_here = numbers[:, state].tolist()
        disagreements.append(
            Disagreement(
                state=state,
                label=mdp.space.label(state),
                learned=action_of(chain, state),
                optimal=tuple(mdp.actions[mdp.pair_action[pair]] for pair in right),
                gap=gap_here,
                expected_visits=visits_here,
                cost=cost_here,
            )
        )
    return tuple(disagreements)


def action_of(chain: PolicyChain, state: int) -> str:
    """Return the action that a policy takes in a state, or what it draws from."""
    mdp = chain.mdp
    taken = [pair for pair in mdp.pairs_of(state) if chain.weights[pair] > 0]
    if len(taken) == 1:
        return str(mdp.actions[mdp.pair_action[taken[0]]])
    chances = {mdp.actions[mdp.pair_action[pair]]: chain.weights[pair] for pair in taken}
    names, each = list(chances), {f"{chance:.4g}" for chance in chances.values()}
    if len(names) > LISTED and len(each) == 1:
        return f"any of {len(names)}"
    if len(names) > LISTED:
        names = sorted(names, key=lambda name: -chances[name])[: LISTED - 1]
    shown = ", ".join(f"{chances[name]:.4g} {name}" for name in names)
    return shown + _others(len(taken) - len(names), ", ")


def either(names: Sequence[str]) -> str:
    """Return actions that are all optimal, in words."""
    shown = names if len(names) <= LISTED else names[: LISTED - 1]
    return " or ".join(shown) + _others(len(names) - len(shown), " or ")


def _others(count: int, before: str) -> str:
    return f"{before}{count} others" if count else ""
