"""The derivatives of the average reward at the start for all parameters.

With gain g and bias h of a policy, y its share of time in each recurrent pair, and x its expected
visits of each transient pair,

    dg/dθ = Σ_l y(l) (∂r(l) + Σ_s' ∂P(l, s') h(s')) + Σ_l x(l) Σ_s' ∂P(l, s') g(s').

This follows from ∂P* = P* ∂P H + H ∂P P*, with P* the limiting matrix and H the deviation matrix,
as long as the number of recurrent classes stays the same nearby (Schweitzer, Journal of Applied
Probability 5, 1968). Where a transition appears that joins two classes, the average may jump, and
the derivative is refused.

If several policies have the best average, its derivative on one side is the best of theirs. A
policy keeps the gain by pairs with P g = g, and in the end stays in an end component of pairs that
keep the bias, too, where c(l) = ∂r + ∂P h is earned on average. So the derivative is the optimum of
a model in which an end component may be left by a pair that keeps the gain, which earns ∂P g, or
stopped in, which earns its best average of c (`solvers.endless.quotient`).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from exact_mdp.analysis.vary.curves.pair_slopes import (
    Pass,
    compute_pair_slopes,
    find_newly_live_states,
    list_slopes,
    make_tie_error,
    refuse_silence,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_nodes, find_start_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import RowChange, transition_entries
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats, Integers, Numbers, to_common_denominator, to_integer_array
from exact_mdp.solvers.arguments import require_average_applies
from exact_mdp.solvers.bounds.gains import SLACK, TINY, compute_advantages, gamma
from exact_mdp.solvers.claims import Bounded, Certified
from exact_mdp.solvers.endless.chain import Classes, compute_laurent_expansion
from exact_mdp.solvers.endless.quotient import build_quotient, of_pairs
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import certify_and_check
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.average import AverageEvaluation, evaluate_average
from exact_mdp.solvers.values.policy_chain import PolicyChain

OPTIMAL = "optimal"


class NearbyGraph:
    """The transitions that are possible next to today's value, on the side of a change.

    Nearby every transition of today is still possible, and some may be new.
    """

    def __init__(self, step: MDP, change: RowChange) -> None:
        self.step, self.name = step, change.name
        keys = change.transition.key
        new = keys[~np.isin(keys, transition_entries(step)[0])]
        self.new_pair, self.new_state = np.divmod(new, step.n_states)

    def find_reachable_states(self, pairs: Mask) -> Mask:
        """Return (S,) True for states that some pairs (L,) reach from the start."""
        return find_reachable_nodes(self._build_edges(pairs, nearby=True), self._start)

    def require_same_classes(self, used: Mask) -> None:
        """Raise ModelError if new transitions of a policy that uses pairs (L,) join its classes."""
        if not used[self.new_pair].any():
            return
        seen = self.find_reachable_states(used)
        count = []
        for nearby in (False, True):
            label = Classes(self._build_edges(used, nearby=nearby)).label[seen]
            count.append(len(np.unique(label[label >= 0])))
        if count[0] != count[1]:
            raise self._make_jump_error(int(self.new_pair[used[self.new_pair]][0]))

    def require_same_components(self, best: Mask) -> None:
        """Raise ModelError if new transitions may let the best average jump, or bend otherwise.

        They may not if their pairs are in no end component. Inside one, either no best policy uses
        the pair, or the pairs (L,) that are best keep all biases in one relation.
        """
        if not len(self.new_pair):
            return
        every = np.ones(self.step.n_pairs, dtype=bool)
        graph, seen = PairGraph.of(self.step), self.find_reachable_states(every)
        component, inside = graph.end_components(every)
        part, _ = graph.end_components(best)
        for pair, following in zip(self.new_pair.tolist(), self.new_state.tolist(), strict=True):
            state = int(self.step.pair_state[pair])
            if not (inside[pair] and seen[state]):
                continue
            parts = part[(component == component[state]) & (part >= 0)]
            stays = component[following] == component[state]
            if not stays or (best[pair] and len(np.unique(parts)) > 1):
                raise self._make_jump_error(pair)

    @property
    def _start(self) -> Mask:
        return find_start_states(self.step)

    def _build_edges(self, pairs: Mask, *, nearby: bool) -> sp.csr_array:
        """Return the graph (S, S) of some pairs (L,), today or nearby."""
        table, own = self.step.table, self.step.pair_state
        used = pairs[table.pair]
        sources, ends = own[table.pair[used]], table.next[used]
        if nearby:
            used = pairs[self.new_pair]
            sources = np.concatenate([sources, own[self.new_pair[used]]])
            ends = np.concatenate([ends, self.new_state[used]])
        shape = (self.step.n_states,) * 2
        graph = sp.csr_array((np.ones(len(sources)), (sources, ends)), shape)
        graph.sum_duplicates()
        return graph

    def _make_jump_error(self, pair: int) -> ModelError:
        return ModelError(
            "next to today's value a transition appears by which sets of states that were never "
            "left are left, and the average may jump",
            where=f"parameter {self.name}, {self.step.where(pair)}",
            fix="choose another value of the parameter, or leave it out (names=)",
        )


# ---- exactly -------------------------------------------------------------------------------------


def exact_average_pass(mdp: MDP, policy: PolicyLike) -> Pass:
    """Return the average at the start in rationals, and a function that gives its derivatives."""
    require_average_applies(mdp)
    certificate = None
    if isinstance(policy, str) and policy == OPTIMAL:
        certificate = certify_and_check(mdp, "average")
        policy = certificate.policy
    chain, undecided = PolicyChain.held_fixed(mdp, policy)
    step = mdp.undiscounted
    own = chain.exactly
    gain, bias, _ = compute_laurent_expansion(own, own.reward)
    share, arrivals = own.compute_limit_distribution(step.start)
    start = sum((weight * gain[state] for state, weight in step.start), Fraction(0))
    if certificate is not None:
        gain, bias = certificate.value, certificate.bias
    recurrent = own.classes.recurrent[step.pair_state]

    # The share of time of recurrent pairs, and the expected visits of transient ones.
    visits = np.where(own.classes.recurrent, share, arrivals)
    uses = np.array([to_flint(0)] * step.n_pairs)
    for state, seen in enumerate(visits):
        if seen:
            for pair, weight in chain.exact_weights(state).items():
                uses[pair] = to_flint(seen) * to_flint(weight)
    # An average does not depend on the discount: no row moves with it.
    rows = np.empty(0, dtype=np.int64), np.empty(0)
    flint_gain, flint_bias = (np.array([*map(to_flint, each)], object) for each in (gain, bias))
    best = None
    if certificate is not None:
        best = BestPolicies(step, certificate)

    def compute_slope(change: RowChange, sign: int) -> Certified:
        moves = list_slopes(step, change, lambda x: x, rows)
        once = compute_pair_slopes(*moves[:2], moves[2][:0], moves[3][:0], flint_gain, step.n_pairs)
        each = compute_pair_slopes(*moves, flint_bias, step.n_pairs)
        nearby = NearbyGraph(step, change)
        if best is None:
            begun = find_newly_live_states(mdp, change) & chain.reached & undecided
            refuse_silence(mdp, begun, change.name)
            used = np.zeros(step.n_pairs, dtype=bool)
            used[chain.pairs] = True
            nearby.require_same_classes(used)
        else:
            nearby.require_same_components(best.keeps_bias)
            if not best.is_unique(nearby):
                return Certified(value=best.compute_side(once, each, sign))
        earned = np.where(recurrent, each, once)
        return Certified(value=from_flint(to_flint(0) + uses @ earned))

    return Certified(value=start), compute_slope


@dataclass(frozen=True, eq=False)
class BestPolicies:
    """All policies with the best average of a model at discount 1, from its certificate."""

    step: MDP
    certificate: Certificate

    @cached_property
    def keeps_gain(self) -> Mask:
        """(L,) True for pairs after which the best average is as great as before."""
        return np.array([not lost for lost in self.certificate.losses[0]])

    @property
    def keeps_bias(self) -> Mask:
        """(L,) True for pairs that keep the gain and the bias."""
        return self.certificate.optimal_pairs

    @cached_property
    def staying(self) -> tuple[Integers, Mask]:
        """(S,) the end component of the best averages or -1, and (L,) its pairs."""
        return PairGraph.of(self.step).end_components(self.keeps_bias)

    def is_unique(self, nearby: NearbyGraph) -> bool:
        """Return whether all best policies spend their time alike from the start."""
        label, inside = self.staying
        met = nearby.find_reachable_states(self.keeps_gain) & (label >= 0)
        several = np.bincount(self.step.pair_state[inside], minlength=self.step.n_states) > 1
        return len(np.unique(label[met])) == 1 and not (met & several).any()

    def compute_side(self, once: Numbers, each: Numbers, sign: int) -> Fraction:
        """Return the best derivative on one side.

        A transient pair earns `once` (L,), and a recurrent pair `each` (L,) time.
        """
        step, model = self.step, self.step.maximised
        graph, turn = PairGraph.of(step), sign * step.sense.sign
        # The best average of c in each end component of best pairs.
        label, inside = self.staying
        kept = inside | (self.keeps_bias & (label < 0)[step.pair_state])
        average = certify_and_check(
            of_pairs(_with_reward(model, turn, each), np.flatnonzero(kept)), "average"
        ).value
        # States that the pairs of best gains connect are one state, with a stop for each of these.
        new_state, staying = graph.end_components(self.keeps_gain)
        bases = [int(np.argmax(label == number)) for number in range(int(label.max()) + 1)]
        stops = [(int(new_state[base]), average[base]) for base in bases]
        passed = new_state < 0
        new_state[passed] = int(new_state.max()) + 1 + np.arange(int(passed.sum()))
        leaving = np.flatnonzero(self.keeps_gain & ~staying)
        quotient = build_quotient(_with_reward(model, turn, once), leaving, new_state, stops=stops)
        value = certify_and_check(quotient.mdp).value
        here = quotient.new_state
        total = sum((weight * value[here[state]] for state, weight in step.start), Fraction(0))
        return turn * Fraction(total)


def _with_reward(model: MDP, sign: int, reward: Numbers) -> MDP:
    """Return a model with other rewards (L,), FLINT's rationals, times a sign."""
    top, bottom = to_common_denominator([sign * from_flint(to_flint(0) + x) for x in reward])
    table = model.table.with_reward(to_integer_array(top), to_integer_array([bottom] * len(top)))
    return model.with_(table=table)


# ---- in floats -----------------------------------------------------------------------------------


def bounded_average_pass(mdp: MDP, policy: PolicyLike) -> Pass:
    """Return the average at the start in floats, and a function that gives its derivatives.

    A best policy must be the only one: both sides then have the same derivative.
    """
    require_average_applies(mdp)
    optimum = isinstance(policy, str) and policy == OPTIMAL
    given: PolicyLike = policy
    if optimum:
        given = solve(mdp, criterion="average")
    held, undecided = PolicyChain.held_fixed(mdp, given)
    evaluation = evaluate_average(held)
    chain, step = evaluation.chain, evaluation.mdp
    used = np.zeros(step.n_pairs, dtype=bool)
    used[chain.pairs] = True
    rivals = np.zeros(step.n_states, dtype=bool)
    if optimum:
        rivals = _find_rivals(evaluation, used)

    # The share of time of recurrent pairs, and the expected visits of transient ones.
    here, inside = step.pair_state, evaluation.classes.recurrent
    off = np.where(inside, evaluation.share.error, evaluation.arrivals.error)
    uses = evaluation.visits[here] * chain.weights
    rounding = float(gamma(4 + chain.roundings))
    doubt = off[here] * chain.weights * SLACK + rounding * uses
    count, lengths = step.n_pairs, np.diff(step.transition.indptr)
    rows = np.empty(0, dtype=np.int64), np.empty(0)
    terms = int(lengths.max()) * 2 + count + 8
    recurrent = inside[here]

    def compute_slope(change: RowChange, _: int) -> Bounded:
        nearby = NearbyGraph(step, change)
        if optimum:
            nearby.require_same_components(used)
            met = nearby.find_reachable_states(np.ones(count, dtype=bool)) & rivals
            if met.any():
                raise make_tie_error(step.space.place(int(met.argmax())))
        else:
            begun = find_newly_live_states(mdp, change) & held.reached & undecided
            refuse_silence(mdp, begun, change.name)
            nearby.require_same_classes(used)
        moves = list_slopes(step, change, lambda x: float(from_flint(x)), rows)
        sizes = tuple(map(np.abs, moves))

        def combine(moved: tuple[Numbers, ...], bias: Floats, gain: Floats) -> Floats:
            """Return c (L,): of recurrent pairs from the bias, of transient ones from the gain."""
            keys, slopes, gain_keys, gains = moved
            each = compute_pair_slopes(keys, slopes, gain_keys, gains, bias, count)
            once = compute_pair_slopes(keys, slopes, gain_keys[:0], gains[:0], gain, count)
            return np.where(recurrent, each, once)

        # c, a bound on |c| with all terms positive, and the error of c by errors of h and g.
        earned = combine(moves, evaluation.bias, evaluation.value)
        size = combine(sizes, np.abs(evaluation.bias), np.abs(evaluation.value))
        still = (*sizes[:3], 0 * sizes[3])
        loose = combine(still, evaluation.bias_error, evaluation.error)
        most = uses + doubt
        error = doubt @ size + most @ loose + float(gamma(terms)) * (most @ size)
        return Bounded(value=float(uses @ earned), error=float(error * SLACK + TINY * terms))

    return evaluation.start, compute_slope


def _find_rivals(evaluation: AverageEvaluation, used: Mask) -> Mask:
    """Return (S,) True for states with a pair that may be as good as the policy's own (L,).

    Where there is none, the policy is the only best one: each other pair certainly loses gain, or
    certainly leads to the same gain and loses bias.
    """
    step, here = evaluation.mdp, evaluation.mdp.pair_state
    still = np.zeros(step.n_pairs)
    ahead = compute_advantages(step, evaluation.value, reward=still)
    unsure = ahead.noise + evaluation.error[here] + step.transition @ evaluation.error
    loses_gain = step.sense.sign * ahead.value < -unsure * SLACK
    # With one recurrent class all states have one gain; else only states of the same class do.
    own = evaluation.classes.label
    if len(evaluation.classes.base) == 1:
        own = np.zeros_like(own)
    graph = PairGraph.of(step)
    low, high = (
        each.reduceat(own[graph.next], graph.offsets[:-1]) for each in (np.minimum, np.maximum)
    )
    same = (low == high) & (low == own[here]) & (low >= 0)
    relative = compute_advantages(step, evaluation.bias)
    change = relative.value - evaluation.value[here]
    off = evaluation.bias_error
    doubt = relative.noise + evaluation.error[here] + off[here] + step.transition @ off
    doubt = doubt + gamma(2) * (np.abs(relative.value) + np.abs(evaluation.value[here]))
    loses_bias = same & (step.sense.sign * change < -doubt * SLACK)
    rivals = np.zeros(step.n_states, dtype=bool)
    rivals[here[~used & ~loses_gain & ~loses_bias]] = True
    return rivals
