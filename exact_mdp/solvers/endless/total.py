"""The total reward at discount 1 where some policy never ends: where it is infinite, and the rest.

End components decide, each by the sign of its best mean reward g: positive is worth +∞ wherever it
can be reached without a risk of -∞; negative is never worth staying in; where g = 0 and no reward
is positive, the pairs without reward can be used forever. In any other model exact levels say
what the value is (`exact.find`). With a goal nothing else can be stayed in: a run that never
arrives is worth +∞ or -∞, and where that is -∞, costs may fall without end before it.

For finite values, parts that can be stayed in for nothing are merged, and pairs that lose clearly
in circles are left out (`quotient`), so that every policy ends. That these are none the better is
verified, for values V with errors e: V(s) - e(s) ≥ r + P (V + e) (de Alfaro, Formal Verification of
Probabilistic Systems, 1997, chapters 3 and 5; Bertsekas and Tsitsiklis, Mathematics of Operations
Research 16, 1991).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.gains import SLACK, compute_advantages
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.endless.average import AverageSolution, solve_average
from exact_mdp.solvers.endless.graph import Graph
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
from exact_mdp.solvers.solution import Solution, SolverError, Status


def solve_total(mdp: MDP, solved: Callable[[MDP], Solution]) -> Solution:
    """Return values, infinite ones included, with bounds, and a policy that attains them.

    `solved` solves a model in which every policy ends.

    Raises ModelError where the start mixes +∞ and -∞; SolverError where floats do not bound the
    values.
    """
    started = perf_counter()
    parts = Structure(mdp)
    if not parts.decided:
        return round_exact_solution(mdp)
    one_sign(mdp, parts.sign)
    whole = parts.build_finite_model()
    part = whole.without_losing()
    try:
        solution = solved(part.mdp)
    except SolverError as failed:
        failed.solution = None  # it has other states than the model
        raise
    if not _is_reduction_sound(whole, part, solution):
        closest = PolicyIteration().solve(part.mdp)
        if not _is_reduction_sound(whole, part, closest):
            raise SolverError(Status.NO_BOUND, "staying forever loses too little a step")
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
    """Return whether no pair that was left out is better, roundings counted."""
    left_out = ~np.isin(whole.source, part.source)
    if not left_out.any():
        return True
    gain, error = compute_advantages(whole.mdp, np.array(solution.value)), solution.state_error
    doubt = (whole.mdp.transition @ error + error[whole.mdp.pair_state]) * SLACK + gain.error
    return bool((gain.value + doubt <= 0)[left_out].all())


def round_exact_solution(mdp: MDP, criterion: str = "total") -> Solution:
    """Return exact values, of an average reward gain and bias, rounded once."""
    started, average = perf_counter(), criterion == "average"
    if mdp.goal is not None and not average:
        proof = prove_goal_total(mdp)
    else:
        proof = prove_gain_and_bias(mdp, criterion)
    value = proof.value_float
    one_sign(mdp, proof.infinite_sign)
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
    """What is known of a model's states before any finite value is.

    A rest is a part of an end component between whose states one moves at will and for nothing.
    With a goal it is not allowed to stay there.
    """

    def __init__(self, mdp: MDP) -> None:
        self.mdp, self.graph, goal = mdp, Graph(mdp), mdp.goal
        ends = self.ends = mdp.terminal if goal is None else goal  # (S,) where all is over
        graph, every = self.graph, np.ones(mdp.n_pairs, dtype=bool)
        # (S,) the end component of each state, ends left out, or -1; (L,) the pairs of these
        self.label, self.within = graph.end_components(~ends[mdp.pair_state])
        label, count = self.label, int(self.label.max(initial=-1)) + 1
        # (S,) 1 where the value is +∞, -1 where it is -∞, else 0
        self.sign = np.where(graph.compute_distance(label >= 0, every) >= 0, 1, 0)
        self.rest = np.full(mdp.n_states, -1)  # (S,) the number of each state's rest, or -1
        self.inside = ~every  # (L,) the pairs with which one moves inside a rest
        # The components where +∞ is earned, or a goal is missed if that is worth +∞.
        self.core = np.arange(count)
        self.decided = True  # False where signs do not say all
        if _missing_pays(mdp):
            return
        rewards, owner = np.sign(mdp.table.expected_gain_exact()[0]), label[mdp.pair_state]
        quiet, still = label, self.within
        if rewards[self.within].any():
            quiet, still = graph.end_components(self.within & (rewards == 0))

        def any_of(where: Mask, of: Integers) -> Mask:
            return np.bincount(of[where], minlength=count) > 0

        gain = any_of(self.within & (rewards > 0), owner)
        loss = any_of(self.within & (rewards < 0), owner)
        best = np.where(gain, 1, np.where(any_of(quiet >= 0, label), 0, -1))
        both = np.flatnonzero(gain & loss)
        best[both] = self._find_gain_signs(both)
        value_sign = np.append(best, -1)[label]  # the sign of each state's component
        safe = graph.compute_rounds(ends | (value_sign >= 0) if goal is None else ends, every) == 0
        win = safe & (
            graph.compute_distance((value_sign > 0) & safe, graph.find_pairs_within(safe)) >= 0
        )
        if goal is not None:
            no_falling(mdp, win)
        sign = self.sign = np.where(win, 1, np.where(safe, 0, -1))
        lost = goal is None and (graph.compute_distance(value_sign > 0, every) >= 0) & ~win
        cancels = np.isin(label, both[best[both] == 0]) & (sign == 0)
        self.decided = not (np.any(lost) or cancels.any())  # +∞ and -∞ together, or rewards cancel
        self.rest = np.where(sign == 0, quiet, -1)
        self.inside = still & (sign == 0)[mdp.pair_state] & graph.find_pairs_within(sign == 0)
        self.core = np.unique(label[win & (value_sign > 0)])

    def build_finite_model(self) -> Derived:
        """Return the model of the finite values, in which the value of a state is its label's.

        Rests are merged, each a state with a pair to the end where staying is allowed.
        """
        mdp, rest, finite, free = self.mdp, self.rest, self.sign == 0, self.mdp.goal is None
        pairs = (
            (finite & ~self.ends)[mdp.pair_state]
            & self.graph.find_pairs_within(finite)
            & ~self.inside
        )
        count = int(rest.max(initial=-1)) + 1
        merged = np.bincount(rest[rest >= 0], minlength=count) > 0
        if free:  # those that cannot be left are at an end
            leaving = self.graph.find_states_with(pairs) & (rest >= 0)
            merged &= np.bincount(rest[leaving], minlength=count) > 0
        label = np.append(np.where(merged, np.cumsum(merged) - 1, -1), -1)[rest]
        rests = []
        if free:
            rests = [(k, Fraction(0)) for k in range(int(merged.sum()))]
        single = finite & ~self.ends & (rest < 0)
        label[single] = int(merged.sum()) + np.arange(int(single.sum()))
        return build_derived_model(mdp, np.flatnonzero(pairs), label, rests=rests)

    def lift_policy(self, label: Integers, chosen: Integers) -> Integers:
        """Return the pairs (S,) of the model for the sources `chosen` (S',) in the finite one."""
        graph, mdp, rest = self.graph, self.mdp, self.rest
        pairs, target = mdp.pair_offsets[:-1].copy(), self.ends & (self.sign == 0)
        taken = chosen[label]  # of each state's merged one
        leaves = (taken >= 0) & (taken < mdp.n_pairs)
        single = (self.sign == 0) & leaves & (rest < 0)
        pairs[single] = taken[single]
        staying = self.inside & ((rest >= 0) & ~leaves)[mdp.pair_state]
        choose_first_pairs(graph, staying, pairs)
        target |= graph.find_states_with(staying)
        ways = taken[(rest >= 0) & leaves]
        pairs[mdp.pair_state[ways]] = ways
        target[mdp.pair_state[ways]] = True
        choose_nearer_pairs(graph, target, self.inside, pairs)
        if len(self.core):
            above = np.isin(self.label, self.core)
            if _missing_pays(mdp):
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
        """Return some end components as a model, whose end is far."""
        chosen = np.isin(self.label, numbers)
        names = np.where(chosen, np.cumsum(chosen) - 1, -1)
        pairs = np.flatnonzero(self.within & chosen[self.mdp.pair_state])
        return build_derived_model(self.mdp, pairs, names)

    def _find_gain_signs(self, numbers: Integers) -> Integers:
        """Return the signs of the best mean rewards of components (C,), 0 where floats cannot."""
        signs = np.zeros(len(numbers), dtype=np.int64)
        if (
            len(numbers)
            and (best := _solve_gain_in_floats(self._extract_components(numbers))) is not None
        ):
            own = self.label[np.isin(self.label, numbers)]  # all of a component earn alike
            above, below = (best.value > best.error)[:-1], (best.value < -best.error)[:-1]
            signs[np.searchsorted(numbers, own)] = above.astype(np.int64) - below
        return signs


def _missing_pays(mdp: MDP) -> bool:
    """Return whether a run that misses a goal is worth +∞."""
    return mdp.goal is not None and mdp.unreached == inf


def _solve_gain_in_floats(own: Derived) -> Solution | None:
    """Return the best average reward in floats; None where these do not bound it."""
    try:
        return solve_average(own.mdp, PolicyIteration())
    except SolverError:
        return None
