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

from collections import defaultdict
from collections.abc import Sequence
from fractions import Fraction
from math import ceil

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.graph import Mask, PairGraph, find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.ending import make_terminal
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import make_ones
from exact_mdp.solvers.exact.optimise import optimise_exactly
from exact_mdp.solvers.objectives.amounts import STOPPED, read_objectives

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
    met, end = find_reachable_states(step), step.n_states
    base = _find_base(step, met)
    times = _bound_times(step, base, met)
    # The chance 1 / μ of stopping; a state that is not met leads to the base, and earns nothing.
    stops = [Fraction(int(inside), time) for inside, time in zip(met.tolist(), times, strict=True)]
    rows = [_build_row(step, pair, times, stops, base) for pair in range(step.n_pairs)]
    rows.append((end, 0, [(Fraction(1), end, Fraction(0))]))
    components = {}
    for name, column in zip(names, columns, strict=True):
        each = zip(*column, step.pair_state.tolist(), strict=True)
        amounts = [Fraction(int(top), int(below)) * stops[state] for top, below, state in each]
        components[name] = [*amounts, Fraction(0)]
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


def _build_row(
    step: MDP, pair: int, times: Sequence[int], stops: Sequence[Fraction], base: int
) -> Row:
    """Return state, action and outcomes of a pair."""
    state, law = int(step.pair_state[pair]), defaultdict[int, Fraction](Fraction)
    reward = Fraction(0)
    for p, following, gain in step.table.row(pair):
        reward += p * gain * stops[state]
        if following != base:
            law[following] += p * times[following] * stops[state]
    law[step.n_states] = stops[state]
    law[base] = 1 - sum(law.values(), Fraction(0))
    outcomes = [(p, following, reward) for following, p in law.items() if p]
    return state, int(step.pair_action[pair]), outcomes


def _find_base(step: MDP, met: Mask) -> int:
    """Return a state that every policy visits again and again from the start."""
    base = PairGraph.of(step).find_base(met[step.pair_state])
    if base is not None:
        return base
    raise ModelError(
        "no state is visited again and again by every policy, so that averages of several amounts "
        "are not totals of one model",
        where="criterion",
        fix="ask for the average of the reward alone, or choose a discount below 1",
    )


def _bound_times(step: MDP, base: int, met: Mask) -> list[int]:
    """Return (S,) whole numbers, of which each pair but for steps to the base loses 1 or more."""
    table = step.table.with_reward(make_ones(step.n_pairs), make_ones(step.n_pairs))
    # The greatest expected number of steps to the base; elsewhere, and at the base, none.
    elsewhere = ~met
    elsewhere[base] = True
    timed = make_terminal(step.maximised.with_(table=table), elsewhere)
    _, (longest,), _ = optimise_exactly(bellman_rows(timed))
    # Twice these are at least 2 + Σ p μ, and rounding up takes at most 1 away.
    times = [max(1, ceil(2 * each)) for each in longest.to_fractions()]
    most = Fraction(0)
    for pair in step.pairs_of(base):
        ahead = (p * times[to] for p, to, _ in step.table.row(pair) if to != base)
        most = max(most, sum(ahead, Fraction(0)))
    times[base] = 1 + ceil(most)
    return times
