"""Exact expected totals of several objectives: best policies for weights, visits, proofs.

    V_w(s) = max over pairs l of s of  w · c(l) + γ Σ_s' P(l, s') V_w(s')

Further weights break ties, one after another. If the weights span all directions, a single vector
of totals remains: an extreme point of the set that policies attain (lexicographic optima: Isermann,
OR Spektrum 4, 1982). A randomised policy is represented by its occupancy measure, the expected
visits x(l) of pairs from the start; x(l) divided by the visits of the state is the probability of
pair l (Altman, Constrained Markov Decision Processes, 1999, chapter 3).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.graph import PairGraph, find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.advice import ways_out
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.bounds.gains import first_of
from exact_mdp.solvers.exact import codec, duals
from exact_mdp.solvers.exact.certificate import Proof, require_model
from exact_mdp.solvers.exact.levels import (
    Level,
    combine_levels,
    compute_surplus_signs,
    list_level_steps,
)
from exact_mdp.solvers.exact.linear import compute_expected_visits, evaluate_exactly
from exact_mdp.solvers.exact.optimise import optimise_exactly
from exact_mdp.solvers.objectives.amounts import STOPPED, Objectives
from exact_mdp.solvers.objectives.simplex import list_unit_vectors
from exact_mdp.solvers.values.policy_chain import PolicyChain

Point = tuple[Fraction, ...]
Weights = Sequence[int] | Sequence[Fraction]


@dataclass(frozen=True, kw_only=True, eq=False)
class OccupancyMeasure:
    """Expected visits from the start of pairs (K,), all above 0; other pairs are not visited."""

    pairs: Integers
    visits: Level

    @classmethod
    def of(cls, numbers: Mapping[int, Fraction]) -> OccupancyMeasure:
        """Return the occupancy measure of given visits {pair: number}."""
        pairs = sorted(numbers)
        visits = Level.of([numbers[pair] for pair in pairs])
        return cls(pairs=np.array(pairs, dtype=np.int64), visits=visits)

    def to_numbers(self) -> dict[int, Fraction]:
        """Return the visits of each pair."""
        return dict(zip(self.pairs.tolist(), self.visits.to_fractions(), strict=True))

    def compute_action_probabilities(self, of: Objectives) -> dict[int, dict[int, Fraction]]:
        """Return the probability of each pair {state: {pair: probability}} in states visited."""
        chances, state = dict[int, dict[int, Fraction]](), of.mdp.pair_state
        # Pairs are sorted by state.
        for own, some in groupby(
            sorted(self.to_numbers().items()), lambda each: int(state[each[0]])
        ):
            visits = dict(some)
            total = sum(visits.values())
            chances[own] = {pair: number / total for pair, number in visits.items()}
        return chances

    def compute_totals(self, of: Objectives) -> Point:
        """Return the expected total of each objective; more is better."""
        scale = of.rows.scale[of.mdp.pair_state[self.pairs]].tolist()

        def sum_earnings(amount: Numbers) -> Fraction:
            each = zip(amount[self.pairs].tolist(), scale, strict=True)
            return self.visits.compute_mean(enumerate(Fraction(top, below) for top, below in each))

        return tuple(map(sum_earnings, of.amounts))


@dataclass(frozen=True, kw_only=True, eq=False)
class Attained:
    """A deterministic policy, the values of each objective under it, and its totals at the start.

    More is better in all of them: the amounts of a model of costs are negated.
    """

    pairs: Integers
    values: tuple[Level, ...]
    total: Point

    def is_optimal(self, of: Objectives, weights: Weights) -> bool:
        """Return whether the policy is optimal in every state for these weights."""
        # No pair has a positive advantage over the weighted values.
        rows, unit = of.rows_for(weights)
        value = combine_levels(self.values, [unit * weight for weight in weights])
        steps, *_ = list_level_steps(rows, value)
        return not (compute_surplus_signs(rows, steps, self.pairs) > 0).any()


def flow_under(
    of: Objectives, pairs: Integers, start: Sequence[tuple[int, Fraction]] | None = None
) -> OccupancyMeasure:
    """Return the visits of the policy that takes one pair (S,) of each state, from any start."""
    states = ~of.rows.terminal
    if start is None:
        start = of.mdp.start
    level = compute_expected_visits(of.rows.of_pairs(pairs), states, start)
    taken = np.flatnonzero(states & (np.array(level.top, dtype=object) != 0))
    visits = Level.from_groups([level.top[s] for s in taken], level.below, level.group[taken])
    return OccupancyMeasure(pairs=pairs[taken], visits=visits)


def flow_of(of: Objectives, policy: PolicyLike) -> OccupancyMeasure:
    """Return the exact occupancy measure of a policy, from which totals are computed."""
    chain = replace(PolicyChain.of(of.given, policy), mdp=of.ending)
    if of.reduced:
        chain = _end_where_nothing_counts(of, chain)
    visits = chain.exact_visits.to_fractions()
    uses = {}
    for state in np.flatnonzero(chain.reached & ~chain.mdp.terminal).tolist():
        if visits[state]:
            for pair, share in chain.exact_weights(state).items():
                uses[pair] = share * visits[state]
    return OccupancyMeasure.of(of.restrict_visits(uses))


def _end_where_nothing_counts(of: Objectives, chain: PolicyChain) -> PolicyChain:
    """Return a chain that ends where it stays and nothing is counted, if its totals are finite."""
    ended = of.ending.ends.destination
    if of.given.goal is None:
        ended = ended | chain.stays_unrewarded
    stays = np.flatnonzero(chain.reached & chain.classes.recurrent & ~ended)
    if len(stays):
        raise ModelError(
            "the policy never ends, or misses the goal, and its totals are not finite",
            where=f"policy, {of.given.space.place(int(stays[0]))}",
            fix=ways_out(of.given, "take a policy that ends"),
        )
    return chain.make_terminal(ended)


def evaluate_objectives(of: Objectives, pairs: Integers) -> Attained:
    """Return the totals of the policy that takes one pair (S,) of each state."""
    values = tuple(evaluate_exactly(of.rows, pairs, of.amounts))
    return Attained(
        pairs=pairs,
        values=values,
        total=tuple(value.compute_mean(of.mdp.start) for value in values),
    )


def solve_weighted(
    of: Objectives, weights: Weights, first: Integers | None = None
) -> tuple[Integers, Level]:
    """Return pairs (S,) that are optimal for weights of at least 0, and the weighted values.

    The search begins with the pairs `first` (S,) and changes a pair only for a better one.
    """
    rows, unit = of.rows_for(weights)
    pairs, (value,), _ = optimise_exactly(rows, of.first if first is None else first)
    return pairs, combine_levels([value], [Fraction(1, unit)])


def find_extreme_policy(
    of: Objectives, weights: Weights, first: Integers | None = None
) -> Attained:
    """Return a policy that is optimal for weights of at least 0, in every state.

    Its totals are an extreme point: other policies neither dominate them nor mix to them. The
    search begins with the pairs `first` (S,).
    """
    # Break ties by the sum of all objectives, then by each of them.
    size = len(weights)
    ties = [[1] * size, *list_unit_vectors(size, 1)]
    _, _, sign = optimise_exactly(
        of.rows,
        of.first if first is None else first,
        [of.rows_for(each)[0].constant for each in (weights, *ties)],
    )
    return evaluate_objectives(of, first_of(of.mdp, sign == 0))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TotalsProof(Proof):
    """A proof about expected totals of a model."""

    objectives: tuple[str, ...]  # names, as `solvers.objectives.amounts` reads them
    rank: Integers | None  # (S,) proof that every policy ends, at discount 1

    @cached_property
    def of(self) -> Objectives:
        """The objectives of the model, by their names."""
        return self._read_objectives(require_model(None, self.mdp, self.kind))

    def _read_objectives(self, mdp: MDP) -> Objectives:
        return Objectives(mdp, self.objectives)

    def _find_violations(self, mdp: MDP) -> list[str]:
        if self.model != fingerprint(mdp):
            return ["the certificate belongs to another model"]
        proof = codec.rebuild_proof(self)
        of = proof._read_objectives(mdp)
        totals = of.to_totals()
        if not of.reduced:
            return duals.list_totals_violations(totals, proof)
        # Policies that never end are left out, so the policies of the proof have to end instead.
        return [*self._list_endless_policies(of), *duals.KINDS[self.kind](totals, proof)]

    def _list_endless_policies(self, of: Objectives) -> Iterator[str]:
        """Yield what does not end among the policies and visits that the proof gives.

        Visits that balance belong to a policy if it can reach all of them from the start.
        """
        graph = PairGraph.of(of.mdp)
        for pairs in self._list_policies():
            taken = np.isin(np.arange(of.mdp.n_pairs), pairs)
            if (graph.compute_distance(of.rows.terminal, taken) < 0).any():
                yield "a policy of the proof never ends"
        for flow in self._list_flows():
            reached = find_reachable_states(of.mdp, pairs=flow.pairs)
            if not reached[of.mdp.pair_state[flow.pairs]].all():
                yield "visits cannot be reached from the start"

    def _list_policies(self) -> Sequence[Integers]:
        """Return the pairs (S,) of each deterministic policy of the proof."""
        return ()

    def _list_flows(self) -> Sequence[OccupancyMeasure]:
        """Return all visits of the proof."""
        return ()

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON; see `Proof.save`.

        Raises ModelError if policies without finite totals were left out, and for averages, whose
        proof is about another model.
        """
        if self.mdp is not None and self.mdp.space.extra[-1:] == (STOPPED,):
            raise ModelError(
                "a checker of files does not know averages under limits, fronts or weights",
                where="certificate",
                fix="leave the certificate out: the answer itself is checked against the model",
            )
        if self.mdp is not None and self.of.reduced:
            raise ModelError(
                "a checker of files knows only models in which every policy ends, in the goal if "
                "there is one",
                where="certificate",
                fix="leave the certificate out: the answer itself is checked against the model",
            )
        super().save(path)


def list_proof_fields(of: Objectives, kind: str) -> dict[str, Any]:
    """Return the fields that all proofs about totals have."""
    parts = {"kind": kind, "model": fingerprint(of.given), "mdp": of.given}
    return parts | {"objectives": of.texts, "rank": of.rank}
