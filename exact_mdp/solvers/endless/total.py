"""The total reward at discount 1 in models with improper policies: infinite and finite values.

The sign of the best mean reward g of each end component decides. If g > 0, the value is +∞ wherever
the component can be reached without a risk of -∞. If g < 0, no optimal policy stays in it. If g = 0
and no reward is positive, its pairs without reward can be used forever. In any other model exact
levels decide (`exact.find`). With a goal, a run that never arrives has the value +∞ or -∞, so that
staying elsewhere does not end it; if it is -∞, costs may fall without bound before the goal.

For finite values, components in which a policy can stay without any reward are merged, and pairs
that clearly lose in cycles are left out (`quotient`), so that every policy ends. That the omitted
pairs are not better is verified, for values V with errors e: V(s) - e(s) ≥ r + P (V + e) (de
Alfaro, Formal Verification of Probabilistic Systems, 1997, chapters 3 and 5; Bertsekas and
Tsitsiklis, Mathematics of Operations Research 16, 1991).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from exact_mdp.mdp.end_components import PairGraph
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import SLACK, compute_advantages
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.endless.average import AverageSolution, solve_average
from exact_mdp.solvers.endless.quotient import (
    Derived,
    build_derived_model,
    choose_first_pairs,
    choose_nearer_pairs,
)
from exact_mdp.solvers.exact.find import (
    best_average,
    no_falling,
    one_sign,
    prove_gain_and_bias,
    prove_goal_total,
)
from exact_mdp.solvers.solution import Solution


def solve_total(mdp: MDP, solved: Callable[[MDP], Solution]) -> Solution:
    """Return values, infinite ones included, with bounds, and a policy that attains them.

    `solved` solves a model in which every policy ends. Raises ModelError if the start mixes +∞ and
    -∞, and SolverError if floats cannot bound the values.
    """
    started = perf_counter()
    # Signs of rewards decide where values are infinite, or exact arithmetic does.
    parts = Structure(mdp)
    if not parts.decided:
        return round_exact_solution(mdp)
    one_sign(mdp, parts.sign)
    # Solve the model of the finite values without the pairs that lose in cycles.
    whole = parts.build_finite_model()
    part = whole.without_losing()
    try:
        solution = solved(part.mdp)
    except SolverError as failed:
        failed.solution = None  # its states are not the states of the model
        raise
    # If the omission cannot be verified with these values, try the closer ones of policy iteration.
    if not _is_reduction_sound(whole, part, solution):
        closest = PolicyIteration().solve_rewards(part.mdp)
        if not _is_reduction_sound(whole, part, closest):
            raise SolverError(Status.NO_BOUND, "staying forever loses too little a step")
    # Back to the states of the model.
    value, error = solution.value[whole.label], solution.state_error[whole.label]
    value[parts.sign > 0], value[parts.sign < 0] = inf, -inf
    return replace(
        solution,
        mdp=mdp,
        value=value,
        pairs=parts.lift_policy(whole.label, part.source[solution.pairs]),
        state_error=np.where(parts.sign == 0, error, 0.0),
        seconds=perf_counter() - started,
    )


def _is_reduction_sound(whole: Derived, part: Derived, solution: Solution) -> bool:
    """Return whether no omitted pair is better, with rounding errors counted."""
    left_out = ~np.isin(whole.source, part.source)
    if not left_out.any():
        return True
    # d ≤ 0 for the exact values, if the advantage over V, plus all errors, is at most 0.
    gain, error = compute_advantages(whole.mdp, np.array(solution.value)), solution.state_error
    doubt = (whole.mdp.transition @ error + error[whole.mdp.pair_state]) * SLACK + gain.error
    return bool((gain.value + doubt <= 0)[left_out].all())


def round_exact_solution(mdp: MDP, criterion: str = "total") -> Solution:
    """Return exact values, or exact gain and bias for an average reward, each rounded once."""
    # Solve and prove in rationals; values of +∞ and -∞ must not meet at the start.
    started, average = perf_counter(), criterion == "average"
    if mdp.ends.has_goal and not average:
        proof = prove_goal_total(mdp)
    else:
        proof = prove_gain_and_bias(mdp, criterion)
    value = proof.value_float
    one_sign(mdp, proof.infinite_sign)
    # Rounding moves a finite value by less than the spacing of floats.
    with np.errstate(invalid="ignore"):
        error = np.where(np.isfinite(value), np.spacing(np.abs(value)), 0.0)
    parts: dict[str, Any] = {
        "mdp": mdp,
        "value": value,
        "pairs": proof.pairs,
        "state_error": error,
        "regret_bound": float(2 * error.max()),
        "status": Status.DIRECT,
        "method": "policy-iteration",
        "solver": "policy iteration in rational arithmetic",
        "iterations": 1,
        "seconds": perf_counter() - started,
    }
    if not average:
        return Solution(**parts)
    # For an average reward the bias is rounded, too.
    try:
        bias = proof.bias.astype(np.float64)
    except OverflowError as error:
        raise ModelError(
            "the bias is too large for a float",
            where="the average reward per step",
            fix='ask for it exactly: certify(mdp, criterion="average"), --certify; or scale the '
            "rewards",
        ) from error
    return AverageSolution(**parts, bias=bias, bias_error=np.spacing(np.abs(bias)))


# ---- where values are infinite -------------------------------------------------------------------


class Structure:
    """The signs of infinite values, and the end components behind them.

    A zero component is a part of an end component in which a policy can move to any state without
    any reward. With a goal it must not stay there.
    """

    def __init__(self, mdp: MDP) -> None:
        self.mdp, self.graph, ends = mdp, PairGraph.of(mdp), mdp.ends.destination
        graph, every = self.graph, np.ones(mdp.n_pairs, dtype=bool)
        # (S,) the end component of each state, without ends, or -1; (L,) the pairs inside these.
        self.label, self.within = graph.end_components(~ends[mdp.pair_state])
        label, count = self.label, int(self.label.max(initial=-1)) + 1
        # (S,) 1 where the value is +∞, -1 where it is -∞, else 0. If missing the goal pays +∞, a
        # way to any end component is enough.
        self.sign = np.where(graph.compute_distance(label >= 0, every) >= 0, 1, 0)
        # (S,) the zero component of each state, or -1; (L,) the pairs inside these.
        self.zero_component, self.zero_pairs = np.full(mdp.n_states, -1), ~every
        # The components in which a run earns +∞, or misses a goal if that is worth +∞.
        self.core = np.arange(count)
        self.decided = True  # whether signs decide everything
        if mdp.ends.missing_pays:
            return
        # Zero components are the end components of the pairs without reward.
        rewards, owner = np.sign(mdp.table.expected_gain_exact[0]), label[mdp.pair_state]
        zero_component, zero_pairs = label, self.within
        if rewards[self.within].any():
            zero_component, zero_pairs = graph.end_components(self.within & (rewards == 0))

        def any_of(where: Mask, of: Integers) -> Mask:
            return np.bincount(of[where], minlength=count) > 0

        # The sign of the best mean reward of each component. Rewards of one sign decide it, and
        # a zero component makes it at least 0; with both signs the best gain is computed.
        gain = any_of(self.within & (rewards > 0), owner)
        loss = any_of(self.within & (rewards < 0), owner)
        best = np.where(gain, 1, np.where(any_of(zero_component >= 0, label), 0, -1))
        both = np.flatnonzero(gain & loss)
        best[both] = self._find_gain_signs(both)
        value_sign = np.append(best, -1)[label]  # the sign of each state's component
        # Safe states: some policy avoids -∞ with probability 1.
        havens = ends
        if not mdp.ends.has_goal:
            havens = ends | (value_sign >= 0)
        safe = graph.compute_rounds(havens, every) == 0
        # The value is +∞ if a component of positive gain can be reached along safe states.
        positive = (value_sign > 0) & safe
        win = safe & (graph.compute_distance(positive, graph.find_pairs_within(safe)) >= 0)
        if mdp.ends.has_goal:
            no_falling(mdp, win)
        sign = self.sign = np.where(win, 1, np.where(safe, 0, -1))
        # Signs do not decide if +∞ can be reached only at a risk of -∞, or if rewards may cancel.
        cancels = np.isin(label, both[best[both] == 0]) & (sign == 0)
        self.decided = not cancels.any()
        if not mdp.ends.has_goal:
            lost = (graph.compute_distance(value_sign > 0, every) >= 0) & ~win
            self.decided &= not lost.any()
        self.zero_component = np.where(sign == 0, zero_component, -1)
        self.zero_pairs = (
            zero_pairs & (sign == 0)[mdp.pair_state] & graph.find_pairs_within(sign == 0)
        )
        self.core = np.unique(label[win & (value_sign > 0)])

    def build_finite_model(self) -> Derived:
        """Return the model of the finite values, in which the value of a state is its label's.

        Each zero component becomes one state, with a pair to the end if staying is allowed.
        """
        mdp, zero, finite = self.mdp, self.zero_component, self.sign == 0
        # Pairs between states of finite values, without the pairs inside a zero component.
        pairs = (
            (finite & ~mdp.ends.destination)[mdp.pair_state]
            & self.graph.find_pairs_within(finite)
            & ~self.zero_pairs
        )
        count = int(zero.max(initial=-1)) + 1
        merged = np.bincount(zero[zero >= 0], minlength=count) > 0
        # Without a goal, a zero component that cannot be left is an end.
        may_stay = not mdp.ends.has_goal
        if may_stay:
            leaving = self.graph.find_states_with(pairs) & (zero >= 0)
            merged &= np.bincount(zero[leaving], minlength=count) > 0
        label = np.append(np.where(merged, np.cumsum(merged) - 1, -1), -1)[zero]
        stops = []
        if may_stay:
            stops = [(k, Fraction(0)) for k in range(int(merged.sum()))]
        single = finite & ~mdp.ends.destination & (zero < 0)
        label[single] = int(merged.sum()) + np.arange(int(single.sum()))
        return build_derived_model(mdp, np.flatnonzero(pairs), label, stops=stops)

    def lift_policy(self, label: Integers, chosen: Integers) -> Integers:
        """Return the policy (S,) of the model, given the finite model's source pairs (S',)."""
        graph, mdp, zero = self.graph, self.mdp, self.zero_component
        pairs, target = mdp.pair_offsets[:-1].copy(), mdp.ends.destination & (self.sign == 0)
        # States that were not merged take the pair itself.
        taken = chosen[label]
        leaves = (taken >= 0) & (taken < mdp.n_pairs)
        single = (self.sign == 0) & leaves & (zero < 0)
        pairs[single] = taken[single]
        # Stay in a zero component that is not left; in one that is, go to the state whose pair
        # leaves.
        staying = self.zero_pairs & ((zero >= 0) & ~leaves)[mdp.pair_state]
        choose_first_pairs(graph, staying, pairs)
        target |= graph.find_states_with(staying)
        ways = taken[(zero >= 0) & leaves]
        pairs[mdp.pair_state[ways]] = ways
        target[mdp.pair_state[ways]] = True
        choose_nearer_pairs(graph, target, self.zero_pairs, pairs)
        # Where the value is +∞, go safely to a component that earns it, and earn it there.
        if len(self.core):
            above = np.isin(self.label, self.core)
            if mdp.ends.missing_pays:
                choose_first_pairs(
                    graph, graph.find_pairs_within(above) & above[mdp.pair_state], pairs
                )
            else:
                own = self._extract_components(self.core)
                best = _solve_gain_in_floats(own)
                sure = best is not None and bool((best.value > best.error)[:-1].all())
                if best is not None and sure:
                    earning = best.pairs
                else:
                    earning = best_average(own.mdp)[0]
                pairs[above] = own.source[earning[:-1]]
            safe = graph.find_pairs_within(self.sign >= 0) & (self.sign > 0)[mdp.pair_state]
            choose_nearer_pairs(graph, above, safe, pairs)
        return pairs

    def _extract_components(self, numbers: Integers) -> Derived:
        """Return some end components as a model of their own, with an end that none reaches."""
        chosen = np.isin(self.label, numbers)
        names = np.where(chosen, np.cumsum(chosen) - 1, -1)
        pairs = np.flatnonzero(self.within & chosen[self.mdp.pair_state])
        return build_derived_model(self.mdp, pairs, names)

    def _find_gain_signs(self, numbers: Integers) -> Integers:
        """Return the signs of the best mean rewards of components (C,), 0 if floats cannot tell."""
        signs = np.zeros(len(numbers), dtype=np.int64)
        if not len(numbers):
            return signs
        best = _solve_gain_in_floats(self._extract_components(numbers))
        if best is not None:
            # All states of a component have the same gain.
            own = self.label[np.isin(self.label, numbers)]
            above, below = (best.value > best.error)[:-1], (best.value < -best.error)[:-1]
            signs[np.searchsorted(numbers, own)] = above.astype(np.int64) - below
        return signs


def _solve_gain_in_floats(own: Derived) -> Solution | None:
    """Return the best average reward in floats; None if floats cannot bound it."""
    try:
        return solve_average(own.mdp, PolicyIteration())
    except SolverError:
        return None
