"""The total reward at discount 1 in rational arithmetic, and all that proves it.

Policy iteration on the model of finite values (`solvers.endless.structure`): what floats find
optimal is kept, together with all pairs that are in no end component; so every policy of the part
ends, and its optimum is found as that of any such model. A pair left out that is better after all
takes the place of the last one, until there is none. That ends: a policy of better pairs ends
again, as a class that it stayed in would earn more than 0 a step (Bertsekas and Tsitsiklis,
Mathematics of Operations Research 16, 1991).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import NamedTuple

import flint
import numpy as np

from exact_mdp.mdp.exact import bellman_rows, fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.endless.derived import Derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.endless.means import surplus
from exact_mdp.solvers.endless.merged import ending_policy, lifted, without_losing
from exact_mdp.solvers.endless.structure import (
    Structure,
    finite,
    refusal,
    sign_at_start,
    structure,
)
from exact_mdp.solvers.proof.certificate import Certificate
from exact_mdp.solvers.proof.checker import one_optimum
from exact_mdp.solvers.proof.endless import EndlessClaims, optimal_infinite
from exact_mdp.solvers.proof.equations import judged
from exact_mdp.solvers.proof.exact import ExactValues, solve_exactly
from exact_mdp.solvers.solution import SolverError


@dataclass(frozen=True, kw_only=True, eq=False)
class _Optimum:
    """Exact values of a merged model, and which of its pairs are optimal (L')."""

    values: ExactValues
    optimal: Mask
    left_out: Mask  # (L',) what `values` does not count among the other pairs

    def of(self, state: int) -> Fraction:
        return Fraction(
            self.values.numerator[state], self.values.denominator[self.values.group[state]]
        )


class _Known(NamedTuple):
    """Exact values, as `solvers.proof.equations` reads them."""

    numerator: list[int]
    group: Integers
    denominator: list[int]


def certify_total(mdp: MDP) -> Certificate:
    """Return a proof of the optimal values, infinite ones included.

    Raises ModelError where the total swings for ever, or is +∞ from one start and -∞ from another.
    """
    found = structure(mdp)
    whole, swings = finite(found)
    best = _optimum(whole)
    chosen = _choice(found, whole, best.optimal & ~swings)
    pairs, stays = lifted(found, whole, chosen)
    proof = EndlessClaims(
        sign=found.sign,
        rank=_ranks(found, pairs, stays),
        order=_orders(found, whole, best),
        potential=_potentials(found),
        drift=None
        if found.drift is None
        else (_listed(found.drift.value), _listed(found.drift.bias)),
    )
    return _certificate(mdp, found, whole, best, pairs, proof)


def _optimum(whole: Derived) -> _Optimum:
    every = np.arange(whole.mdp.n_pairs)
    graph = Graph.of(whole.mdp)
    try:
        part = without_losing(whole)
    except SolverError:
        part = _around(whole, graph, ending_policy(graph, whole.mdp.terminal))
    rows = bellman_rows(whole.mdp)
    while True:
        values = solve_exactly(bellman_rows(part.mdp))
        left_out = ~np.isin(whole.source, part.source)
        optimal = np.zeros(len(every), dtype=bool)
        optimal[~left_out] = values.optimal
        if not left_out.any():
            return _Optimum(values=values, optimal=optimal, left_out=left_out)
        groups = values.group.tolist()
        value = [
            flint.fmpq(top, values.denominator[group])
            for top, group in zip(values.numerator, groups, strict=True)
        ]
        others = np.flatnonzero(left_out)
        gain = surplus(rows, value, others)
        optimal[others] = [number == 0 for number in gain]
        better: dict[int, tuple[object, int]] = {}
        for pair, number in zip(others.tolist(), gain, strict=True):
            state = int(whole.mdp.pair_state[pair])
            if number > 0 and (state not in better or number > better[state][0]):
                better[state] = number, pair
        if not better:
            return _Optimum(values=values, optimal=optimal, left_out=left_out)
        first = np.where(optimal & ~left_out, every, len(every))
        policy = np.minimum.reduceat(first, whole.mdp.pair_offsets[:-1])
        for state, (_, pair) in better.items():
            policy[state] = pair
        part = _around(whole, graph, policy)


def _around(whole: Derived, graph: Graph, policy: Integers) -> Derived:
    """Return the part with the policy's pairs (S',), and those that are in no end component."""
    _, inside = graph.end_components(~whole.mdp.terminal[whole.mdp.pair_state])
    inside[policy] = False
    return whole.only(np.flatnonzero(~inside))


def _choice(found: Structure, whole: Derived, allowed: Mask) -> Integers:
    """Return the source (S',) of the first pair allowed in each state of the merged model."""
    pairs = np.where(allowed, np.arange(len(allowed)), len(allowed))
    first = np.minimum.reduceat(pairs, whole.mdp.pair_offsets[:-1])
    without = np.flatnonzero(first == len(allowed))
    if len(without):
        bad = np.isin(whole.label, without) & (found.sign == 0)
        raise refusal(
            found.mdp,
            bad,
            "the total reward has no limit: going round for ever, rewards cancel, and that is best",
        )
    return whole.source[first]


def _ranks(found: Structure, pairs: Integers, stays: Mask) -> Integers:
    """Return how many steps the policy is from where it stays for ever, at least."""
    graph, sign = found.graph, found.sign
    taken = np.zeros(found.mdp.n_pairs, dtype=bool)
    taken[pairs] = True
    finite, above = (graph.distance(stays & (sign == s), taken) for s in (0, 1))
    return np.where(sign == 0, finite, np.maximum(above, 0))


def _orders(found: Structure, whole: Derived, best: _Optimum) -> Integers:
    """Return the orders (S,) that fall along all pairs but those of end components."""
    sign = found.sign
    missing = found.mdp.goal is not None and found.mdp.unreached == inf
    live = (best.optimal | missing) & ~whole.mdp.terminal[whole.mdp.pair_state]
    order = Graph.of(whole.mdp).ranks(whole.mdp.terminal, live)[whole.label]
    if found.drift is not None or not (sign < 0).any():
        return np.where(sign == 0, order, 0)
    graph, rounds, components = found.graph, found.given_up, found.components
    own = np.repeat(rounds[graph.pair_state], np.diff(graph.offsets))
    level = np.logical_and.reduceat(rounds[graph.next] == own, graph.offsets[:-1])
    level &= (sign < 0)[graph.pair_state] & ~components.inside
    below = graph.levels(components.label, level)
    return np.where(sign == 0, order, rounds * (int(below.max()) + 1) + below)


def _potentials(found: Structure) -> list[Fraction]:
    potential = [Fraction(0)] * found.mdp.n_states
    for each in found.tilted.values():
        for state, number in each.second.items():
            potential[state] = number
    for numbers, sign in ((found.core, 1), (found.losing, -1)):
        if len(numbers):
            proof = found.gaining if sign > 0 else found.components.proof(numbers, sign)
            for state, number in zip(proof[0].tolist(), proof[1], strict=True):
                potential[state] = number
    return potential


def _certificate(
    mdp: MDP,
    found: Structure,
    whole: Derived,
    best: _Optimum,
    pairs: Integers,
    proof: EndlessClaims,
) -> Certificate:
    values, label = best.values, whole.label
    rows = bellman_rows(found.mdp)
    denominator = [*values.denominator, 1]
    labels = label.tolist()
    numerator = [*map(values.numerator.__getitem__, labels)]
    group = values.group[label]
    gap: list[int | None] = [*map(values.gap.__getitem__, labels)]
    gap_scale = [*map(values.gap_scale.__getitem__, labels)]
    optimal = np.zeros(mdp.n_pairs, dtype=bool)
    own = (whole.source >= 0) & (whole.source < mdp.n_pairs)
    optimal[whole.source[own & best.optimal]] = True
    optimal |= found.mdp.terminal[mdp.pair_state] & (found.sign == 0)[mdp.pair_state]
    for state, height in found.height.items():
        value = best.of(int(label[state])) + height
        numerator[state], group[state] = value.numerator, len(denominator)
        denominator.append(value.denominator)
    for state in np.flatnonzero(found.sign != 0).tolist():
        numerator[state], group[state] = 0, len(values.denominator)
        gap[state], gap_scale[state] = None, 1
    # Of merged states, and where pairs were left out, the next best pair is not known yet.
    optimal |= found.inside
    apart = np.isin(label, whole.mdp.pair_state[best.left_out]) & (label < whole.mdp.n_states - 1)
    apart = (found.sign == 0) & ~found.over & (apart | (found.rest >= 0))
    some = np.flatnonzero(apart[mdp.pair_state] & found.kept & ~found.inside)
    for state in np.flatnonzero(apart).tolist():
        gap[state], gap_scale[state] = None, 1
    known = _Known(numerator, group, denominator)
    for block in judged(rows, known, some):
        optimal[block.pairs] = block.nothing
        for state, (loss, over) in block.least.items():
            gap[state], gap_scale[state] = loss, over
    infinite = (found.sign != 0)[mdp.pair_state]
    optimal[infinite] = optimal_infinite(proof, rows)[infinite]
    return Certificate(
        model=fingerprint(mdp),
        numerator=numerator,
        group=group,
        denominator=denominator,
        policy=mdp.pair_action[pairs],
        optimal_pairs=optimal,
        gap=gap,
        gap_scale=gap_scale,
        unique=one_optimum(mdp, optimal),
        start_value=_start_value(mdp, numerator, group, denominator, found.sign),
        endless=proof,
        mdp=mdp,
    )


def _start_value(
    mdp: MDP, numerator: list[int], group: Integers, below: list[int], sign: Integers
) -> Fraction | float:
    if infinite := sign_at_start(mdp, sign):
        return inf * infinite
    terms = (w * Fraction(numerator[s], below[group[s]]) for s, w in mdp.start)
    return sum(terms, Fraction(0))


def _listed(numbers: Numbers) -> list[Fraction]:
    return [Fraction(number) for number in numbers]
