"""What a model says: its laws and cycles, and when two say the same in every exact number."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import fields
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


def assert_same(left: MDP, right: MDP, *, stored: bool = True) -> None:
    """Fail unless models agree in every field; where both are `stored`, in types of arrays, too."""
    both = {
        field.name: [getattr(mdp, field.name) for mdp in (left, right)] for field in fields(MDP)
    }
    tables, matrices = both.pop("table"), both.pop("transition")
    both["labels"] = [
        {name: on.tolist() for name, on in labels.items()} for labels in both["labels"]
    ]
    both["event"] = [table.event for table in tables]
    if stored:
        arrays = (*fields(tables[0].rows), *fields(tables[0]))
        for name in [field.name for field in arrays if field.name not in ("rows", "sound")]:
            both[name] = [getattr(table, name) for table in tables]
        names = ("data", "indices", "indptr")
        both |= {name: [getattr(matrix, name) for matrix in matrices] for name in names}
    else:
        both["rows"] = [list(map(mdp.table.row, range(mdp.n_pairs))) for mdp in (left, right)]
        both["floats"] = [[x.dtype.kind == "f" for x in (t.weight, t.gain)] for t in tables]
    for name, (ours, theirs) in both.items():
        if not isinstance(ours, np.ndarray):
            assert ours == theirs, name
            continue
        assert np.array_equal(ours, theirs), name
        if stored:
            assert ours.dtype == theirs.dtype, name
            assert ours.dtype != object or {type(value) for value in theirs.flat} == {int}, name


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
