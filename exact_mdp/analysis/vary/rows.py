"""Any model as a parametric one: the probabilities of its random rows are its parameters.

Each row with more than one outcome is a distribution: all of its probabilities but the largest are
parameters, and what they leave is the largest one's. Drawn together, they are Dirichlet, as the
family's `rows` say.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from fractions import Fraction

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Family, moving

MOST_ROWS = 2000


def row_family(mdp: MDP) -> Family:
    """Return the family; its `rows` are the parameters of each row by the row's label.

    Raises
    ------
    ModelError
        Where no row is random, or more than 2,000 are.
    """
    entries: dict[str, list[tuple[int, str]]] = {}
    rows: dict[str, tuple[str, ...]] = {}
    labels = mdp.space.labels(range(mdp.n_states))
    for pair in range(mdp.n_pairs):
        chance: dict[int, Fraction] = defaultdict(Fraction)
        for probability, following, _ in mdp.table.row(pair):
            chance[following] += probability
        if len(chance) < 2:
            continue
        largest = max(chance, key=lambda state: (chance[state], -state))
        state, action = int(mdp.pair_state[pair]), int(mdp.pair_action[pair])
        label = f"({labels[state]}, {mdp.actions[action]})"
        names = {s: f"{label}: to {labels[s]}" for s in sorted(chance) if s != largest}
        entries |= {name: [(pair, labels[s])] for s, name in names.items()}
        rows[label] = tuple(names.values())
    if not 0 < len(rows) <= MOST_ROWS:
        raise ModelError(
            f"{len(rows):,} rows of the model are random",
            where="rows as parameters",
            fix=f"name the parameters that matter (mdp.parametric.moving), or take a model with 1 "
            f"to {MOST_ROWS:,} of them",
        )
    return replace(moving(mdp, entries), rows=rows)
