"""Where a policy does not act optimally, and what each such state costs.

    cost(s) = d(s) gap(s, π(s)),    d the policy's discounted visits from the start

These sum to the regret of the policy π. Where it waits for ever, see `analysis.gate.waiting`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exact_mdp.analysis.gate.regret import Regret
from exact_mdp.analysis.gate.waiting import attaining, final_class, shares
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.solution import Certified, SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain

LISTED = 4  # actions that a text names in one state
CLOSE = 2.0**-40  # errors of visits, as parts of the most, that are little but rounding


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
    label = np.full(mdp.n_states, -1)
    if mdp.discount_exact == 1 and not chain.ends_from_start:
        label = np.where(chain.reached, final_class(chain), -1)
    leaving = chain.ended(label >= 0) if (label >= 0).any() else chain
    came = _visits(leaving, exactly=isinstance(regret.at_start, Certified))
    return listed(chain, regret, np.where(chain.reached, came, 0.0), label)


def _visits(chain: PolicyChain, *, exactly: bool) -> Floats:
    """Return (S,) expected visits; `exactly` where the digits of floats are not all right."""
    try:
        visits = chain.discounted.visits
        if not exactly or visits.error.max() <= CLOSE * visits.value.max():
            return visits.value
    except SolverError:
        if not exactly:
            return np.full(chain.mdp.n_states, np.nan)
    return chain.exact_visits.floats()


def listed(chain: PolicyChain, regret: Regret, came: Floats, label: Integers) -> Findings:
    """Return visits (S,) and the states that make up the regret, the costliest first.

    `came` (S,) are visits, in the classes of `label`, which are never left, arrivals.
    """
    mdp, weights, first = chain.mdp, chain.weights, chain.mdp.pair_offsets[:-1]
    visits = np.where(label >= 0, np.inf, came)
    gap = np.add.reduceat(weights * np.where(weights > 0, regret.gap, 0.0), first)
    wrong = np.add.reduceat(weights * ~regret.optimal_pairs, first) > 0
    cost = np.where(gap > 0, visits, 0.0) * np.where(visits > 0, gap, 0.0)
    waits = shares(label, came, regret.by_state, gap, wrong)
    gap, cost = np.where(waits > 0, regret.by_state, gap), cost + waits
    states, disagreements = np.flatnonzero(wrong & ~mdp.terminal), []
    for state in states[np.lexsort((states, -gap[states], -cost[states]))].tolist():
        right = [pair for pair in mdp.pairs_of(state) if regret.optimal_pairs[pair]]
        if isinstance(regret.optimum, Certificate):
            right = attaining(mdp, regret.optimum, regret.optimal_pairs, state)
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
