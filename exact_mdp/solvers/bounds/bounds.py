"""Two-sided bounds on the optimal values around any vector V, sound in floating point.

Let d(l) = r(l) + γ P_l V - V(s) be the advantage of pair l of state s over V. Let w be positive in
all states but the terminal ones, where V and w are 0, and let every other pair have a margin

    m(l) = w(s) - γ P_l w > 0.

If d(l) ≤ c m(l) for every pair, then U = V + c w satisfies U ≥ r + γ P U for every pair, and
therefore U ≥ V*. If d(l) ≥ c' m(l) for the pairs of a policy π, then V + c' w ≤ V^π ≤ V*. Both c
and c' may have either sign. With w = 1 and γ < 1 these are the bounds of MacQueen and Porteus
(Puterman, Markov Decision Processes, 1994, theorem 6.6.3); a positive margin also proves that T is
a contraction in the norm weighted by w (Bertsekas and Tsitsiklis, Neuro-Dynamic Programming, 1996,
proposition 2.2). The weights are the greatest discounted number of steps to the end, found by
backward induction in acyclic models and by policy iteration at γ = 1. In other models they are 1,
which has the margin 1 - γ. Margins are verified; every d and m has a bound on its rounding error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from exact_mdp.mdp.graph import find_least_successors
from exact_mdp.mdp.model import MDP, cache_on_model
from exact_mdp.mdp.questions.advice import require_termination
from exact_mdp.mdp.table import COMPILED, Floats, Integers, concatenate_ranges
from exact_mdp.solvers.bounds.gains import (
    FEW,
    POLICIES,
    SLACK,
    TINY,
    UNIT,
    Advantages,
    Weights,
    choose_greedy_pairs,
    compute_advantages,
    rounding_facts,
)
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.claims import SolverError, Status


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    """value + low · weight ≤ V^π ≤ V* ≤ value + high · weight, for the policy π of `pairs`."""

    value: Floats  # (S,)
    weight: Floats  # (S,)
    pairs: Integers  # (S,)
    low: float
    high: float

    @cached_property
    def state_error(self) -> Floats:
        """(S,) upper bounds on |value - V*| and |value - V^π|."""
        error = np.asarray(max(abs(self.low), abs(self.high)) * self.weight * SLACK)
        error.setflags(write=False)
        return error

    @property
    def error(self) -> float:
        """The greatest `state_error`."""
        return float(self.state_error.max())

    @property
    def regret(self) -> float:
        """An upper bound on V* - V^π in every state."""
        return float((self.high - self.low) * self.weight.max() * SLACK)

    def centre_bounds(self) -> Bounds:
        """Return the same bounds around their middle, widened by the rounding of that."""
        weight, centre = self.weight, self.low / 2 + self.high / 2
        middle, live = self.value + centre * weight, weight > 0
        lost = 2 * UNIT * (np.abs(middle) + 2 * abs(centre) * weight)[live] / weight[live]
        rounding = float(lost.max(initial=0.0)) + 8 * UNIT * abs(centre)
        return replace(
            self,
            value=middle,
            low=(self.low - centre) * SLACK - rounding,
            high=(self.high - centre) * SLACK + rounding,
        )


@np.errstate(over="ignore", invalid="ignore")
def bound_optimal_values(mdp: MDP, value: Floats, *, strict: bool = False) -> Bounds:
    """Return bounds on V* and on the values of a greedy policy, around any `value` (S,).

    Each state takes the first pair that no other beats by more than rounding. With `strict` this is
    the rounding of d alone; otherwise the rounding of values counts too, so that equally good
    actions tie.
    """
    weights, live = margin_weights(mdp), ~mdp.terminal
    if np.any(value[~live]):
        raise ValueError("terminal states are worth 0")
    gain = compute_advantages(mdp, value)
    compared = gain
    if strict:
        compared = replace(gain, noise=gain.error)
    pairs = choose_greedy_pairs(mdp, compared)
    # High is the least c with d ≤ c m for all pairs; low the greatest with d ≥ c m for π's pairs.
    low, high = 0.0, 0.0
    if live.any():
        above = weights.compute_ratios(gain.value + gain.error)
        high = float(above.max(where=live[mdp.pair_state], initial=-np.inf))
        low = -float(weights.compute_ratios(gain.error - gain.value)[pairs[live]].max())
    if not np.isfinite(high - low):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    # Outward by more than a few roundings.
    low, high = low - 4 * UNIT * abs(low), high + 4 * UNIT * abs(high)
    return Bounds(value=value, weight=weights.value, pairs=pairs, low=low, high=high)


def solve_backward(mdp: MDP, reward: Floats) -> Floats:
    """Return (S,) the optimal values of an acyclic model, for rewards (L,), by backward induction.

    Levels of states that do not depend on each other are computed at once.
    """
    value, level = np.zeros(mdp.n_states), None
    if not mdp.ends.numbered_in_order:
        level = mdp.ends.most_steps
    matrix, first, ends, ended = mdp.transition, mdp.pair_offsets, mdp.pair_offsets, mdp.terminal
    if level is None:
        order = np.arange(mdp.n_states)
    else:
        order = np.argsort(-level, kind="stable")
    if mdp.n_transitions >= COMPILED:
        from exact_mdp.solvers.kernels import bellman

        bellman.relax_states(
            order[::-1], bellman.build_compiled_model(mdp, reward, np.ones(1)), value, 0.0
        )
        return value
    # Without a compiled loop: cut the states into runs, with the pairs of a run side by side.
    if level is None:
        cuts = _cut_into_runs(mdp)
    else:
        cuts = np.flatnonzero(np.diff(level[order], prepend=-1, append=-1))
        rows = concatenate_ranges(first[order], first[order + 1])
        matrix, reward = matrix[rows], reward[rows]
        ends = np.concatenate([[0], np.cumsum(np.diff(first)[order])])
    # V(s) = max of r(l) + γ P_l V over the pairs of each state, from the last run to the first.
    for s, t in reversed([*pairwise(cuts.tolist())]):
        here, (l, m) = order[s:t], (ends[s], ends[t])
        if ended[here[0]]:
            continue
        i, j = matrix.indptr[l], matrix.indptr[m]
        flow = matrix.data[i:j] * value[matrix.indices[i:j]]
        q = reward[l:m] + mdp.discount * np.add.reduceat(flow, matrix.indptr[l:m] - i)
        value[here] = np.maximum.reduceat(q, ends[s:t] - l)
    return value


@cache_on_model
def _cut_into_runs(mdp: MDP) -> Integers:
    """Return the first states of runs whose states do not lead to each other; S comes last.

    All transitions lead to higher numbers, except in terminal states.
    """
    # Go backward, and cut as soon as a state leads into the run that would contain it.
    least, ends = find_least_successors(mdp).tolist(), mdp.terminal.tolist()
    cuts = [mdp.n_states]
    for state in range(mdp.n_states - 1, 0, -1):
        if least[state - 1] < cuts[-1] or ends[state] or ends[state - 1]:
            cuts.append(state)
    return np.array([0, *cuts[::-1]])


@cache_on_model
def margin_weights(mdp: MDP) -> Weights:
    """Return verified weights; computed once for each model."""
    require_termination(mdp)
    live = ~mdp.terminal
    # The greatest number of steps to the end; below discount 1 a constant does as well.
    if mdp.ends.is_acyclic:
        weight = solve_backward(mdp, np.ones(mdp.n_pairs))
    elif mdp.discount < 1:
        weight = live.astype(np.float64)
    else:
        weight = _expected_steps(mdp)
    # However the weights were found, they prove something only if all margins are positive.
    margin, error = _compute_margins(mdp, weight)
    weights = Weights(value=weight, margin=margin, error=error)
    if np.isfinite(weight).all() and (weight[live] > 0).all() and weights.smallest > 0:
        return weights
    why = "the end is too many steps away"
    if mdp.discount_exact < 1 and (weight[live] == 1).all():
        lost = float(1 - mdp.discount_exact)
        why = f"1 - γ is {lost:.2g}, of which rounding leaves too little"
    raise SolverError(Status.NO_BOUND, why)


def _expected_steps(mdp: MDP) -> Floats:
    """Estimate the greatest expected number of steps to the end."""
    one = np.where(mdp.terminal, 0.0, 1.0)[mdp.pair_state]
    # A pair that adds less than half a step leaves a margin of over a half.
    _, steps, gain = improve_policy(mdp, mdp.pair_offsets[:-1], one, enough=0.5)
    if gain.value.max() > 0.5:
        raise SolverError(Status.NO_BOUND, "the end is too many steps away")
    return steps


def improve_policy(
    mdp: MDP, pairs: Integers, reward: Floats | None = None, *, enough: float = -np.inf
) -> tuple[Integers, Floats, Advantages]:
    """Return pairs (S,) of a policy, its values (S,) and advantages over it, by policy iteration.

    The first policy takes `pairs`; no pair has an advantage over the last one, beyond rounding or
    `enough`.
    """
    # Rounding alone may make two policies take turns: stop at the first that comes back.
    before = set[int]()
    for _ in range(POLICIES):
        before.add(hash(pairs.tobytes()))
        value = evaluate_pairs(mdp, pairs, reward)
        gain = compute_advantages(mdp, value, reward=reward)
        better = choose_greedy_pairs(mdp, gain, keep=pairs)
        if gain.value.max() <= enough or hash(better.tobytes()) in before:
            break
        pairs = better
    return pairs, value, gain


def evaluate_pairs(mdp: MDP, pairs: Integers, reward: Floats | None = None) -> Floats:
    """Return the values (S,) of the policy that takes `pairs` (S,), without error bounds."""
    chain, earned = policy_chain(mdp, pairs, reward)
    system = LinearSystem(chain, mdp.discount, order=mdp.ends.most_steps)
    return np.where(mdp.terminal, 0.0, system.approximate(earned))


def _compute_margins(mdp: MDP, weight: Floats) -> tuple[Floats, float]:
    """Return the margins w - γ P w, in the form of `Weights`, and their error."""
    # If w is 1 and no state leads to an end, all margins are 1 - γ.
    if mdp.discount < 1 and _is_closed(mdp, weight):
        facts = rounding_facts(mdp)
        error = ((FEW + UNIT) * facts.leak + TINY) * SLACK
        return np.array([facts.leak]), error
    # Otherwise -m is the advantage over w of a model without rewards.
    open_pairs = ~mdp.terminal[mdp.pair_state]
    margin = compute_advantages(mdp, weight, reward=np.zeros(mdp.n_pairs))
    error = margin.error.max(where=open_pairs, initial=0.0)
    return np.where(open_pairs, -margin.value, 1.0), float(error)


def _is_closed(mdp: MDP, weight: Floats) -> bool:
    """Return whether weights are 1 in all states but terminal ones, and none leads to those."""
    if (weight == 1).all():
        return True
    matrix, ended = mdp.transition, mdp.terminal
    if ended.all() or not (weight[~ended] == 1).all():
        return False
    leading = np.logical_or.reduceat(ended[matrix.indices], matrix.indptr[:-1])
    return not leading[~ended[mdp.pair_state]].any()
