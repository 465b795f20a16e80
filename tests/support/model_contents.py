"""What a model says: its laws and cycles, and when two say the same in every exact number."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from typing import Any

import numpy as np

from exact_mdp import MDP


def negated(mdp: MDP) -> MDP:
    """The model of the other sense, every reward times -1."""
    other = "min" if mdp.sense == "max" else "max"
    return mdp.with_(sense="min").maximised.with_(sense=other)


def meant(row: Sequence[float | Fraction]) -> list[Fraction]:
    """The exact probabilities that a model has where it is given this row of positive numbers."""
    ends = [(k, 0, [(1, k, 0)]) for k in range(1, len(row))]
    mdp = MDP.from_outcomes([(0, 0, [(p, k, 0) for k, p in enumerate(row)]), *ends], "1/2")
    return [p for p, _, _ in mdp.table.row(0)]


def is_acyclic(mdp: MDP) -> bool:
    """Whether no state that is not absorbing can be visited twice."""
    before = {
        state: {t for pair in mdp.pairs_of(state) for _, t, _ in mdp.table.row(pair)}
        for state in range(mdp.n_states)
        if not mdp.terminal[state]
    }
    try:
        TopologicalSorter(before).prepare()
    except CycleError:
        return False
    return True


def assert_same(left: MDP, right: MDP) -> None:
    """Fail unless both models hold the same arrays, of the same types, and the same names."""
    for name in ("offsets", "next", "weight", "denominator", "gain", "gain_denominator", "event"):
        ours, theirs = getattr(left.table, name), getattr(right.table, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            same_array(ours, theirs, name)
    for name in ("pair_state", "pair_action", "reward", "components", "pair_offsets"):
        same_array(getattr(left, name), getattr(right, name), name)
    assert (left.observations is None) == (right.observations is None)
    if left.counts is not None and right.counts is not None:
        same_array(left.observations, right.observations, "observations")
        same_array(left.counts.toarray(), right.counts.toarray(), "counts")
    for name in ("data", "indices", "indptr"):
        same_array(getattr(left.transition, name), getattr(right.transition, name), name)
    for name in (
        "space", "actions", "discount_exact", "start", "component_names", "events", "name",
        "parameters", "time_limit", "episodes",
    ):  # fmt: skip
        assert getattr(left, name) == getattr(right, name), name


def same_array(ours: Any, theirs: Any, name: str) -> None:
    assert ours.dtype == theirs.dtype, name
    assert ours.shape == theirs.shape, name
    assert np.array_equal(ours, theirs), name
    if ours.dtype == object:
        assert {type(value) for value in theirs} == {int}, name


def outcomes_of(mdp: MDP, order: Iterable[int] | None = None) -> list[Any]:
    """The rows of a model as `MDP.from_outcomes` takes them, in any order."""
    pairs = range(mdp.n_pairs) if order is None else order
    return [(int(mdp.pair_state[l]), int(mdp.pair_action[l]), mdp.table.row(l)) for l in pairs]


def laws(mdp: MDP) -> dict[tuple[int, str], dict[tuple[int, Fraction], Fraction]]:
    """Every pair's exact joint law of next state and reward, outcomes merged."""
    result = {}
    for pair in range(mdp.n_pairs):
        law: dict[tuple[int, Fraction], Fraction] = defaultdict(Fraction)
        for probability, following, reward in mdp.table.row(pair):
            law[following, reward] += probability
        key = (int(mdp.pair_state[pair]), mdp.actions[mdp.pair_action[pair]])
        result[key] = dict(law)
    return result
