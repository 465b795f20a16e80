"""Averages of several amounts per step, as totals of another model.

If every policy visits one state b again and again, its gain g and relative values h satisfy

    g + h(s) = c(l) + Σ_{s' ≠ b} p(l, s') h(s'),     h(b) = 0.

With times μ(s) ≥ 1 + Σ_{s' ≠ b} p(l, s') μ(s') for all pairs, take the model at discount 1 that
starts in b, earns c(l) / μ(s), moves to s' ≠ b with probability p(l, s') μ(s') / μ(s), ends with
probability 1 / μ(s), and else moves to b. Its values are g + h(s) / μ(s): each policy, mixed ones
included, has its gain as the total from b (a reduction of this kind: Feinberg and Huang, On the
reduction of total-cost and average-cost MDPs to discounted MDPs, arXiv:1507.00664, 2015). So all
that is known of totals holds for averages, with its proofs. μ is the greatest expected time to b,
doubled and rounded up to whole numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import ceil

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.ending import make_terminal
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import make_ones
from exact_mdp.solvers.exact.optimise import optimise_exactly
from exact_mdp.solvers.objectives.amounts import STOPPED, read_objectives
from exact_mdp.solvers.objectives.improper import Column

Row = tuple[int, int, list[tuple[Fraction, int, Fraction]]]
"""State, action, and outcomes: probability, next state and reward."""


def reduce_to_totals(mdp: MDP, texts: Sequence[str]) -> tuple[MDP, tuple[str, ...]]:
    """Return a model, whose totals are averages per step, and the names of objectives in it.

    It keeps the reward, states and pairs of `mdp`, has the objectives as its components, and one
    more state, in which it has stopped. Raises ModelError unless there is a
    state that every policy visits again and again.
    """
    step = mdp.undiscounted
    names, columns = read_objectives(step, texts)
    base, met = _find_base(step), find_reachable_states(step)
    times, end = _bound_times(step, base), step.n_states
    rows = []
    for pair, state in enumerate(step.pair_state.tolist()):
        rows.append(_build_row(step, pair, times, base, met=bool(met[state])))
    rows.append((end, 0, [(Fraction(1), end, Fraction(0))]))
    components = {}
    for name, column in zip(names, columns, strict=True):
        components[name] = [*_share_amounts(step, column, times, met), Fraction(0)]
    total = MDP.from_outcomes(
        rows,
        start=[Fraction(state == base) for state in range(end + 1)],
        sense=mdp.sense,
        space=StateSpace(columns=mdp.space.columns, extra=(*mdp.space.extra, STOPPED)),
        actions=mdp.actions,
        components=components,
        name=mdp.name,
    )
    return total, names


def _share_amounts(step: MDP, column: Column, times: Sequence[int], met: Mask) -> list[Fraction]:
    """Return (L,) amounts over times; 0 in states that no policy reaches."""
    top, below = column
    shared = []
    for pair, state in enumerate(step.pair_state.tolist()):
        amount = Fraction(0)
        if met[state]:
            amount = Fraction(int(top[pair]), int(below[pair])) / times[state]
        shared.append(amount)
    return shared


def _build_row(step: MDP, pair: int, times: Sequence[int], base: int, *, met: bool) -> Row:
    """Return state, action and outcomes of a pair; a state that is not met stops at once."""
    state, end, law = int(step.pair_state[pair]), step.n_states, dict[int, Fraction]()
    reward = Fraction(0)
    if met:
        for p, following, gain in step.table.row(pair):
            reward += p * gain / times[state]
            if following != base:
                share = p * times[following] / times[state]
                law[following] = law.get(following, Fraction(0)) + share
        law[base] = 1 - Fraction(1, times[state]) - sum(law.values())
    law[end] = 1 - sum(law.values(), Fraction(0))
    outcomes = [(p, following, reward) for following, p in law.items() if p]
    return state, int(step.pair_action[pair]), outcomes


def _find_base(step: MDP) -> int:
    """Return a state that every policy visits again and again from the start."""
    base = PairGraph.of(step).find_base(find_reachable_states(step)[step.pair_state])
    if base is not None:
        return base
    raise ModelError(
        "no state is visited again and again by every policy, so that averages of several amounts "
        "are not totals of one model",
        where="criterion",
        fix="ask for the average of the reward alone, or choose a discount below 1",
    )


def _mark(step: MDP, state: int) -> Mask:
    marked = np.zeros(step.n_states, dtype=bool)
    marked[state] = True
    return marked


def _bound_times(step: MDP, base: int) -> list[int]:
    """Return (S,) whole numbers, of which each pair but for steps to the base loses 1 or more."""
    met = find_reachable_states(step)
    table = step.table.with_reward(make_ones(step.n_pairs), make_ones(step.n_pairs))
    # The greatest expected number of steps to the base; elsewhere, and at the base, none.
    timed = make_terminal(step.maximised.with_(table=table), _mark(step, base) | ~met)
    _, (longest,), _ = optimise_exactly(bellman_rows(timed))
    # Twice these are at least 2 + Σ p μ, and rounding up takes at most 1 away.
    times = [max(1, ceil(2 * each)) for each in longest.to_fractions()]
    most = Fraction(0)
    for pair in step.pairs_of(base):
        ahead = (p * times[to] for p, to, _ in step.table.row(pair) if to != base)
        most = max(most, sum(ahead, Fraction(0)))
    times[base] = 1 + ceil(most)
    return times
