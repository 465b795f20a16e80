"""Where a policy does not act optimally, and what each such state costs.

Three prices for a state s, each an expectation from the start (d: discounted visits):

    cost               d_π(s) gap(s, π(s))            these sum to the regret of the policy π
    gain if corrected  V^π' - V^π at the start        π' acts optimally in s and like π elsewhere
    loss if alone      V* - V^σ at the start          σ acts like π in s, and optimally elsewhere

The first two vanish where π never comes; the last one may not: it says what the state costs once
everything else is right. A gain is negative where the optimal action relies on others to come. To
change a policy in s alone changes the value at the start by

    δ d(s) / (1 - Δ N e_s),    N = (I - γ P)⁻¹

where δ is the advantage of the change under the policy's own values, Δ what it does to the row of s
of γ P, and N e_s how often s is visited from each state (Sherman and Morrison, Annals of
Mathematical Statistics 21, 1950). Without a way back to s the divisor is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from exact_mdp.analysis.gate.exact_policy import exact_visits
from exact_mdp.analysis.gate.regret import LAST_CYCLE, Regret, cheap, policy_taking
from exact_mdp.analysis.gate.waiting import arrivals, attaining, kept, shares
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.solution import Certified, SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits

PRICED = 50  # states in which changes are priced, in large models with cycles
NEARLY_CERTAIN = 2.0**-40  # chances of leaving a state for good that have no price
LARGE = 500  # states
LISTED = 4  # actions that a text names in one state


@dataclass(frozen=True, kw_only=True)
class Disagreement:
    """A state in which a policy does something that is not optimal.

    Attributes
    ----------
    state : int
    label : str
    learned : str
        The action taken; where the policy mixes, "P ACTION, …" with their probabilities; of more
        than LISTED the likeliest, or "any of N" where all are as likely.
    optimal : tuple of str
        All optimal actions.
    gap : float
        Optimal value of the state less that of doing this once and acting optimally from then on;
        where the policy waits for ever (`analysis.gate.waiting`), less that of waiting.
    expected_visits : float
        Discounted visits of the policy from the start; at discount 1 their expected number.
    cost : float
        expected_visits · gap, and what is lost by waiting; these sum to the regret.
    prices : Prices, optional
        Where `gain_if_corrected` and `loss_if_alone` are from. These are None beyond the 50
        costliest states of a model with cycles and over 500 states, in models where floating point
        cannot bound the visits, and where the changed policy would never end, or nearly never.
    """

    state: int
    label: str
    learned: str
    optimal: tuple[str, ...]
    gap: float
    expected_visits: float
    cost: float
    prices: Prices | None = field(default=None, repr=False, compare=False)

    @property
    def gain_if_corrected(self) -> float | None:
        """What the policy's value at the start gains if this state alone is corrected."""
        return self._price[0]

    @property
    def loss_if_alone(self) -> float | None:
        """What the optimal value at the start loses if this state alone is wrong."""
        return self._price[1]

    @property
    def _price(self) -> tuple[float | None, float | None]:
        known = {} if self.prices is None else self.prices.by_state
        return known.get(self.state, (None, None))


@dataclass(frozen=True, kw_only=True, eq=False)
class Prices:
    """What a policy's changes in single states are worth, found when the first is asked for.

    The policy of `chain` has the visits (S,) given; `states` (K,) are those to be priced.
    """

    chain: PolicyChain
    found: Regret
    visited: Floats
    states: Integers

    @cached_property
    def by_state(self) -> dict[int, tuple[float | None, float | None]]:
        """Gain if corrected and loss if alone of each state that has such prices."""
        found, best = self.found, policy_taking(self.chain.mdp, self.found.optimal_pairs)
        try:
            others, floats = own_visits(best, exact=isinstance(found.at_start, Certified))
        except SolverError:
            return {}
        if not floats:
            return {}
        corrected = _changes(self.chain, found.learned_value, self.visited, best, self.states)
        losses = -_changes(best, found.optimal_value, others, self.chain, self.states)
        return {
            state: (None if np.isnan(gain) else gain, None if np.isnan(loss) else loss)
            for state, gain, loss in zip(
                self.states.tolist(), corrected.tolist(), losses.tolist(), strict=True
            )
        }


Findings = tuple[Floats, tuple[Disagreement, ...]]
"""A policy's visits (S,), and where it does not act optimally."""


def findings(mdp: MDP, chain: PolicyChain, found: Regret) -> Findings:
    """Return the visits of the policy of `chain`, and the states that make up a regret `found`.

    Visits are NaN where floats cannot bound them and rational arithmetic would be slow: a verdict
    stands without them.
    """
    exact = isinstance(found.at_start, Certified) or cheap(mdp, LAST_CYCLE)
    try:
        visited, floats = own_visits(chain, exact=exact)
    except SolverError:
        visited, floats = np.where(chain.reached, np.nan, 0.0), False
    return visited, disagreements(mdp, chain, found, visited, priced=floats)


def own_visits(chain: PolicyChain, *, exact: bool) -> tuple[Floats, bool]:
    """Return the visits (S,) of a policy from the start, and whether they are from floats.

    They are exactly 0 in states that are not reached, and infinite where the policy stays for ever
    at discount 1, the end left out. Rational arithmetic takes over where floats
    cannot bound them, if `exact` allows it: where the regret is certified, it is quick enough.
    Otherwise this raises SolverError.
    """
    if chain.mdp.discount_exact == 1 and not chain.ends_from_start:
        label = kept(chain)
        return np.where(chain.reached & (label >= 0), np.inf, arrivals(chain, label)), False
    try:
        found = visits(chain.mdp, chain.discounted).value
    except SolverError:
        if not exact:
            raise
        return exact_visits(chain).value_float, False
    return np.where(chain.reached, found, 0.0), True


def disagreements(
    mdp: MDP, chain: PolicyChain, found: Regret, visited: Floats, *, priced: bool
) -> tuple[Disagreement, ...]:
    """Return every state with a choice in which the policy may not act optimally, costliest first.

    `found` is the regret of the policy of `chain`, and `visited` its visits; `priced` is whether
    these are from floats, with which changes can be priced.
    """
    first = mdp.pair_offsets[:-1]
    gap = np.add.reduceat(chain.weights * np.where(chain.weights > 0, found.gap, 0.0), first)
    wrong = np.add.reduceat(chain.weights * ~found.optimal_pairs, first) > 0
    states = np.flatnonzero(wrong & ~mdp.terminal)
    if not len(states):
        return ()
    cost = np.where(gap > 0, visited, 0.0) * np.where(visited > 0, gap, 0.0)
    if np.isinf(visited).any():
        waits = shares(chain, found.by_state, gap, wrong)
        gap, cost = np.where(waits > 0, found.by_state, gap), cost + waits
    states = states[np.lexsort((states, -gap[states], -cost[states]))]
    cheap = levels(mdp) is not None or mdp.n_states <= LARGE
    prices = None
    if priced:
        changed = states if cheap else states[:PRICED]
        prices = Prices(chain=chain, found=found, visited=visited, states=changed)
    listed = []
    for state in states.tolist():
        right = [pair for pair in mdp.pairs_of(state) if found.optimal_pairs[pair]]
        if isinstance(found.optimum, Certificate):
            right = attaining(mdp, found.optimum, found.optimal_pairs, state)
        listed.append(
            Disagreement(
                state=state,
                label=mdp.space.label(state),
                learned=action_of(chain, state),
                optimal=tuple(mdp.actions[mdp.pair_action[pair]] for pair in right),
                gap=float(gap[state]),
                expected_visits=float(visited[state]),
                cost=float(cost[state]),
                prices=prices,
            )
        )
    return tuple(listed)


def _changes(
    chain: PolicyChain, value: Floats, visited: Floats, other: PolicyChain, states: Integers
) -> Floats:
    """Return what the start gains if a policy does in one state as another does, state by state.

    The policy of `chain` has the values (S,) and visits (S,) given.
    """
    mdp = chain.mdp
    finite, used = np.isfinite(value), other.pairs
    known = np.where(finite, value, 0.0)
    shape = (mdp.n_states, mdp.n_pairs)
    mixing = sp.csr_array((other.weights[used], (mdp.pair_state[used], used)), shape)[states]
    gain = mixing @ gains(mdp, known).value  # Q - V without taking the difference of large numbers
    change = np.where(visited[states] > 0, visited[states] * gain, 0.0)
    # Where the change leads to states that the policy never leaves, it has no price.
    lost = (mixing @ (mdp.transition @ ~finite) > 0) & (visited[states] > 0)
    change[lost] = np.nan
    if levels(mdp) is not None:
        return change
    after = mixing @ mdp.transition - chain.transition[states]
    for place in np.flatnonzero((change != 0) & ~lost).tolist():
        unit = np.zeros(mdp.n_states)
        unit[states[place]] = 1.0
        returns = chain.discounted.approximate(unit)
        leaving = 1 - mdp.discount * float((after[[place]] @ returns)[0])
        # Floats cannot tell a return that is nearly certain from one that is.
        change[place] = change[place] / leaving if leaving > NEARLY_CERTAIN else np.nan
    return change


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
