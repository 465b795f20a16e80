"""Policies that never end, at discount 1: those that come to rest, and the model of any other.

A policy has come to rest in states that it never leaves and in which nothing is earned, nor any
event happens. These count as ends for its return, of which nothing else is changed; only its steps
have no end. Where it goes round for ever and earns something else than 0 a step on average, its
return is +∞ or -∞; so it is where a run misses its goal. What any policy is worth, finite or not,
is the optimum of the model in which there is nothing else to do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf

import numpy as np

from exact_mdp.mdp.components import ComponentTable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.graph import strong_components, ways_out
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Numbers
from exact_mdp.solvers.average.chain import ExactAverages
from exact_mdp.solvers.average.evaluate import AverageEvaluation, evaluated
from exact_mdp.solvers.exact.find import best_average, expansion
from exact_mdp.solvers.solution import SolverError
from exact_mdp.solvers.values.policy_chain import Mask, PolicyChain, require_few, rounded


def arrives(chain: PolicyChain) -> bool:
    """Return whether every episode ends, and not beside a goal."""
    mdp = chain.mdp
    beside = mdp.goal is not None and bool((chain.reached & mdp.terminal & ~mdp.goal).any())
    return chain.ends_from_start and not beside


@dataclass(frozen=True, kw_only=True, eq=False)
class Parted:
    """A chain whose every run ends, comes to rest, or gains or loses for ever.

    Attributes
    ----------
    chain : PolicyChain
        With ends wherever one of these is certain.
    lost : {inf: (S,) bool, -inf: (S,) bool}
        The ends that stand for an infinite return, where there are some.
    worth : float
        The mean return where some are infinite: inf or -inf. Where returns of +∞ and -∞ come
        together, the mean reward of the whole decides.
    """

    chain: PolicyChain
    lost: dict[float, Mask]
    worth: float = 0.0

    @property
    def ends(self) -> Mask:
        """(S,) True at ends of finite returns."""
        ends = self.chain.mdp.terminal.copy()
        for each in self.lost.values():
            ends &= ~each
        return ends


def parted(chain: PolicyChain) -> Parted:
    """Return where a policy's runs end, rest, or gain or lose for ever.

    Raises ModelError where rewards cancel for ever, so that a return has no limit, and where
    gains and losses for ever have a mean of 0, so that the mean return has none.
    """
    mdp = chain.mdp
    if mdp.discount_exact != 1 or arrives(chain):
        return Parted(chain=chain, lost={})
    if mdp.goal is not None:
        astray = (chain.stuck | mdp.terminal) & ~mdp.goal
        lost, rest = {mdp.unreached: astray}, astray
    else:
        rest = _resting(chain)
        lost = _for_ever(chain, chain.reached & recurrent(chain) & ~rest & ~mdp.terminal)
    gone = np.logical_or.reduce([rest, *lost.values()])
    ending = PolicyChain(mdp=ended(mdp, gone), chosen=chain.chosen, policy=chain.policy)
    lost = {sign: each for sign, each in lost.items() if each.any()}
    value = sum(lost)
    if len(lost) == 2:
        limit = expansion(model_of(chain), "total").start_value
        if isinstance(limit, Fraction):
            raise ModelError(
                "gains and losses for ever have a mean of 0, and the mean return has no value",
                where="policy",
                fix=ways_out(mdp, "take evaluate(), which gives the limit of the discounted means"),
            )
        value = limit
    return Parted(chain=ending, lost=lost, worth=value)


def _for_ever(chain: PolicyChain, busy: Mask) -> dict[float, Mask]:
    """Return the `busy` states (S,), which earn for ever, that gain, and those that lose."""
    if not busy.any():
        return {}
    mdp, averages = chain.mdp, average(chain)
    gain, open_ = averages.value, busy & (np.abs(averages.value) <= averages.error)
    if open_.any():
        of_policy = model_of(chain)
        sign = 1 if of_policy.sense == "max" else -1
        _, (mean, _, _) = best_average(of_policy)
        gain = sign * np.array([(each > 0) - (each < 0) for each in mean.top])
        if (flat := busy & (gain == 0)).any():
            state = int(np.flatnonzero(flat)[0])
            raise ModelError(
                "rewards cancel for ever, and the return has no limit",
                where=f"policy, {mdp.space.place(state)}",
                fix=ways_out(mdp, 'take evaluate(), with criterion="average"'),
            )
    return {inf: busy & (gain > 0), -inf: busy & (gain < 0)}


def average(chain: PolicyChain) -> AverageEvaluation:
    """Return what a policy earns per step: in rationals where floats cannot bound it.

    Raises SolverError where that would take too long.
    """
    mdp = chain.mdp.undiscounted
    try:
        evaluation = evaluated(mdp, chain.weights, chain.roundings, chain.policy)
        if np.isfinite(evaluation.share.error).all():
            return evaluation
    except SolverError as error:
        require_few(mdp, error)
    exact = ExactAverages(bellman_rows(model_of(chain).undiscounted))
    gain, bias, _ = exact.expansion(exact.reward)
    at_base, label = exact.classes.at_base, exact.classes.label
    own = exact.classes.base[np.maximum(label, 0)]
    until = replace(chain.undiscounted, rate=Fraction(1), live=~at_base, turned=True)
    nothing = np.array([Fraction(0)] * mdp.n_states, dtype=object)
    start, onward = nothing.copy(), nothing.copy()
    for state, weight in mdp.start:
        start[state] = weight
    for number in np.flatnonzero(at_base[chain.source]).tolist():
        onward[chain.table.next[number]] += chain.odds[number]
    arrivals = np.array(until.exactly(start.tolist()), dtype=object)
    # What is met between two visits of a base, over the time between them.
    met = np.array(until.exactly(np.where(at_base, nothing, onward).tolist()), dtype=object)
    met[at_base] = Fraction(1)
    share = np.where(label < 0, nothing, arrivals[own] * met / exact.period[np.maximum(label, 0)])
    own_value, own_bias = rounded(gain), rounded(bias)
    return AverageEvaluation(
        mdp=mdp,
        weights=chain.weights,
        roundings=chain.roundings,
        policy=chain.policy,
        classes=exact.classes,
        value=own_value.value,
        error=own_value.error,
        bias=own_bias.value,
        bias_error=own_bias.error,
        exact=(rounded(share), rounded(arrivals)),
    )


def model_of(chain: PolicyChain) -> MDP:
    """Return the model in which the policy's choices are the only ones."""
    mdp = chain.mdp
    if len(chain.pairs) == mdp.n_states:
        return mdp.with_(
            table=mdp.table.of_pairs(chain.pairs),
            pair_state=mdp.pair_state[chain.pairs],
            pair_action=mdp.pair_action[chain.pairs],
        )
    earned, below = mdp.table.expected_gain_exact()
    rows = []
    for state in range(mdp.n_states):
        taken = chain.exact_weights(state).items()
        mean = sum((w * Fraction(int(earned[l]), int(below[l])) for l, w in taken), Fraction(0))
        rows.append(
            (state, 0, [(w * p, t, mean) for l, w in taken for p, t, _ in mdp.table.row(l)])
        )
    return replace(
        MDP.from_outcomes(rows, mdp.discount_exact, start=dict(mdp.start), actions=["mixed"]),
        space=mdp.space,
        sense=mdp.sense,
        goal=mdp.goal,
        unreached=mdp.unreached,
        float_probabilities=mdp.float_probabilities,
        float_rewards=mdp.float_rewards,
    )


def _resting(chain: PolicyChain) -> Mask:
    """Return (S,) True in recurrent classes without any reward or event."""
    busy = (chain.gain != 0) & ~chain.mdp.terminal[chain.source]
    if chain.table.event is not None:
        busy |= chain.table.event != 0
    return recurrent(chain, busy)


def recurrent(chain: PolicyChain, busy: Mask | None = None) -> Mask:
    """Return (S,) True in recurrent classes, or in those alone without a `busy` outcome (N,)."""
    label = strong_components(chain.graph)
    source, target = chain.source, chain.table.next
    leaves = label[source] != label[target]
    out = np.zeros(int(label.max()) + 1, dtype=bool)
    out[label[source[leaves if busy is None else busy | leaves]]] = True
    return np.asarray(~out[label])


def ended(mdp: MDP, rest: Mask) -> MDP:
    """Return the model with some states (S,) made terminal."""
    table, still = mdp.table, rest[mdp.pair_state]
    lengths = np.where(still, 1, np.diff(table.offsets))
    begin = np.cumsum(lengths) - lengths
    first = np.repeat(table.offsets[:-1], lengths)
    chosen = first + np.arange(int(lengths.sum())) - np.repeat(begin, lengths)
    inside = np.repeat(still, lengths)

    def of_outcome(name: str, values: Numbers) -> Numbers:
        chosen_values: Numbers = values[chosen].copy()
        chosen_values[inside] = 0
        if name == "weight":
            chosen_values[inside] = np.broadcast_to(table.denominator, len(still))[still]
        return chosen_values

    def of_pair(name: str, values: Numbers) -> Numbers:
        settled: Numbers = np.where(still, 0, values) if name == "gain" else values
        return settled

    following = table.next[chosen]
    following[inside] = mdp.pair_state[still]
    changed = replace(
        table.mapped(of_pair, of_outcome),
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=following,
    )
    parts = mdp.component_table
    if parts is not None:
        amount = np.where(still[:, None], 0, parts.amount)
        parts = ComponentTable(amount=amount, denominator=parts.denominator)
    return replace(mdp, table=changed, component_table=parts)
