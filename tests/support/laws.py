"""The exact joint law of next state and reward after every pair of a model."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction

from exact_mdp import MDP


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
