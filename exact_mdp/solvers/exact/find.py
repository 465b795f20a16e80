"""Find optimal levels in rational arithmetic, together with their proofs, for maximised rewards.

Policy iteration (`optimise`): every state takes the first pair with the greatest advantage over the
values of a policy, or over (d(g), r - g + d(h), d(w) - h) in this order, until no advantage is
positive. Each change raises the value at small interest rates, so no policy comes twice. The last
policy satisfies all conditions of the checker (Puterman, Markov Decision Processes, 1994, sections
9.2.1 and 10.3; Veinott, Annals of Mathematical Statistics 37, 1966).

With a goal, if missing it has the value -∞: states from which no policy reaches it with probability
1 have this value. Among the others, g shows where a cycle earns without bound. From the remaining
states all improved policies arrive, as a class of better pairs would have a positive gain
(Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991).
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import inf
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows, bellman_rows, fingerprint
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.advice import other_question, ways_out
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.bounds.gains import first_of
from exact_mdp.solvers.claims import SolverError
from exact_mdp.solvers.dynamic.methods import AveragePolicyIteration
from exact_mdp.solvers.endless.chain import ExactChain
from exact_mdp.solvers.endless.chain import compute_laurent_expansion as laurent
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.levels import (
    Level,
    Step,
    list_level_steps,
)
from exact_mdp.solvers.exact.optimise import iterate_policies, optimise_exactly


def build_certificate(
    mdp: MDP,
    pairs: Integers,
    optimal: Mask | None = None,
    *,
    kind: str = "total",
    **parts: Any,
) -> Certificate:
    """Return a certificate, with its start value and its uniqueness computed from the levels."""
    none: dict[str, Any] = dict.fromkeys(("g", "w", "rank", "infinite", "order"))
    draft = Certificate(
        mdp=mdp,
        model=fingerprint(mdp),
        sense=mdp.sense,
        policy=mdp.pair_action[pairs],
        start_value=Fraction(0),
        unique=True,
        kind=kind,
        **none | parts,
    )
    if optimal is None:
        optimal = draft.optimal_pairs
    infinite = one_sign(mdp, draft.infinite_sign)
    # The start value: the gain of an average, else the values h, or infinity.
    level = draft.h
    if kind == "average" and draft.g:
        level = draft.g
    start_value: Fraction | float = level.compute_mean(mdp.start)
    if infinite:
        start_value = inf * infinite
    return replace(draft, start_value=start_value, unique=one_optimum(mdp, optimal))


def one_sign(mdp: MDP, sign: Numbers) -> int:
    """Return the sign of the infinite values (S,) among the start states; 0 if all are finite.

    Raises ModelError if both signs occur.
    """
    signs = {int(sign[state]) for state, weight in mdp.start if weight} - {0}
    if len(signs) > 1:
        raise ModelError(
            "the value is +∞ from one state of the start and -∞ from another",
            where="start",
            fix="start in one state: --start, or mdp.with_(start=…)",
        )
    if signs:
        return signs.pop()
    return 0


def one_optimum(mdp: MDP, optimal: Mask) -> bool:
    """Return whether every state that optimal pairs (L,) reach has only one optimal pair."""
    # States with several optimal pairs, except ends, which only stay put without a reward.
    other = np.add.reduceat(optimal.astype(np.int64), mdp.pair_offsets[:-1]) != 1
    rows, own = bellman_rows(mdp), mdp.pair_state
    stays = np.logical_and.reduceat(mdp.table.next == own[mdp.table.pair], mdp.table.offsets[:-1])
    stays &= np.asarray(rows.constant == 0, dtype=bool)
    other &= ~np.logical_and.reduceat(stays, mdp.pair_offsets[:-1])
    return not (other.any() and (other & find_reachable_states(mdp, pairs=optimal)).any())


# ---- levels --------------------------------------------------------------------------------------


def prove_gain_and_bias(mdp: MDP, kind: str) -> Certificate:
    """Return the proof of gain and bias, which also proves a total at discount 1."""
    pairs, (g, h, w) = best_average(mdp)
    return build_certificate(mdp, pairs, g=g, h=h, w=w, kind=kind)


def best_average(mdp: MDP) -> tuple[Integers, list[Level]]:
    """Return the pairs (S,) of a policy of greatest gain and bias, and the levels g, h and w."""
    try:
        pairs, *_ = AveragePolicyIteration().run(mdp.undiscounted)
    except SolverError:  # floats only suggest a policy to begin with
        pairs = mdp.pair_offsets[:-1]
    return optimise_expansion(bellman_rows(mdp.undiscounted), pairs)


def optimise_expansion(rows: BellmanRows, pairs: Integers) -> tuple[Integers, list[Level]]:
    """Return the pairs (S,) of a policy of greatest gain and bias, and the levels g, h and w."""

    def evaluate(pairs: Integers) -> list[Step]:
        chain = ExactChain(rows.of_pairs(pairs))
        return list_level_steps(
            rows, *(Level.of(each.tolist()) for each in laurent(chain, chain.reward))
        )

    return iterate_policies(rows, pairs, evaluate)[:2]


# ---- a goal --------------------------------------------------------------------------------------


def prove_goal_total(mdp: MDP) -> Certificate:
    """Return the proof of a total until a goal that some policy never reaches."""
    prove = _prove_missing_costs
    if mdp.ends.missing_pays:
        prove = _prove_missing_pays
    return prove(mdp, bellman_rows(mdp), PairGraph.of(mdp), mdp.ends.destination)


def _prove_missing_pays(mdp: MDP, rows: BellmanRows, graph: PairGraph, goal: Mask) -> Certificate:
    """Return the proof for a model in which a run that misses the goal has the value +∞."""
    every, state = np.ones(mdp.n_pairs, dtype=bool), mdp.pair_state
    # A state has the value +∞ if some policy can reach an end component outside the goal and stay
    # there; its order is the distance to that component.
    label, staying = graph.end_components(~goal[state])
    order = graph.compute_distance(label >= 0, every)
    finite = order < 0
    part, number = _restrict_rows(rows, finite)
    # From the other states every policy reaches the goal: the optimum is found as for proper
    # policies.
    _, (values,), sign = optimise_exactly(part)
    optimal = np.zeros(mdp.n_pairs, dtype=bool)
    optimal[number[sign == 0]] = True
    # In infinite states the optimal pairs stay, or lead nearer to a place to stay.
    optimal[~finite[state]] = (staying | graph.find_falling_pairs(order))[~finite[state]]
    return build_certificate(
        mdp,
        first_of(mdp, optimal),
        h=values,
        rank=np.maximum(graph.compute_ranks(goal, finite[state]), 0),
        infinite=np.where(finite, 0, 1),
        order=np.maximum(order, 0),
    )


def _prove_missing_costs(mdp: MDP, rows: BellmanRows, graph: PairGraph, goal: Mask) -> Certificate:
    """Return the proof for a model in which a run that misses the goal has the value -∞."""
    every, state = np.ones(mdp.n_pairs, dtype=bool), mdp.pair_state
    # States with an order cannot be sure to reach the goal: their value is -∞.
    order = graph.compute_rounds(goal, every)
    arriving, every_pair = order == 0, np.arange(mdp.n_pairs)
    above, policy = np.zeros(mdp.n_states, dtype=bool), mdp.pair_offsets[:-1]
    bias = Level.of([Fraction(0)] * mdp.n_states)
    part, number = _restrict_rows(rows, arriving)
    _, staying = graph.end_components(
        graph.find_pairs_within(arriving & ~goal) & (arriving & ~goal)[state]
    )
    # Where a policy can stay in a cycle with a positive gain, and still reach the goal later,
    # values are +∞. This needs a positive reward in an end component.
    if (rows.constant[staying] > 0).any():
        pairs, (gain, bias, _) = optimise_expansion(part, part.pair_offsets[:-1])
        recurrent = ExactChain(part.of_pairs(pairs)).classes.recurrent
        above, policy = arriving & [mean > 0 for mean in gain.top], number[pairs]
        used = np.isin(every_pair, policy[above])
        order = np.where(above, graph.compute_distance(recurrent & above, used), order)
    no_falling(mdp, above)
    finite = arriving & ~above
    part, number = _restrict_rows(rows, finite)
    # The search needs a proper policy to begin with: pairs that lead nearer to the goal.
    among = np.isin(every_pair, number) & finite[state]
    nearer = among & graph.find_falling_pairs(graph.compute_distance(goal, among))
    nearer[mdp.pair_offsets[:-1][~finite | goal]] = True
    own, (values,), _ = optimise_exactly(part, np.searchsorted(number, first_of(mdp, nearer)))
    policy = np.where(finite, number[own], policy)
    used = np.isin(every_pair, policy[finite])
    # The level: the values of finite states, the bias where values are +∞, 0 where they are -∞.
    each = zip(values.top, bias.top, finite.tolist(), above.tolist(), strict=True)
    top = [x if inside else b * infinite for x, b, inside, infinite in each]
    group = np.where(finite, values.group, len(values.below))
    inside = graph.find_pairs_within(arriving) & arriving[state]
    return build_certificate(
        mdp,
        policy,
        h=Level.from_groups(top, [*values.below, *bias.below], group),
        rank=np.maximum(graph.compute_distance(goal, np.where(finite[state], used, inside)), 0),
        infinite=np.where(above, 1, np.where(finite, 0, -1)),
        order=order,
    )


def no_falling(mdp: MDP, states: Mask) -> None:
    """Raise ModelError if one of these states (S,), whose costs have no minimum, is a start."""
    bad = np.flatnonzero(states & (mdp.start_distribution > 0))
    if len(bad):
        raise ModelError(
            "at discount 1 no policy has the best value: costs fall without end before the goal",
            where=mdp.space.place(int(bad[0])),
            fix=ways_out(mdp, other_question(mdp)),
        )


def _restrict_rows(rows: BellmanRows, states: Mask) -> tuple[BellmanRows, Integers]:
    """Return the equations of some states (S,), with all others terminal, and their pairs (K,)."""
    # Pairs that stay among these states; other states keep their first pair.
    owner, inside = rows.pair_state, np.logical_and.reduceat(states[rows.next], rows.offsets[:-1])
    stays = states[owner] & inside
    stays[rows.pair_offsets[:-1][~states]] = True
    number = np.flatnonzero(stays)
    return replace(rows.of_pairs(number), terminal=rows.terminal | ~states), number
