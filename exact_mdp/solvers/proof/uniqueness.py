"""Proofs that the equations of every policy have one solution.

The discount is one where γ < 1; else a rank that falls along a transition of each pair (Bertsekas
and Tsitsiklis, Mathematics of Operations Research 16, 1991). `solvers.proof.checker.one_solution`
checks it.
"""

from __future__ import annotations

from exact_mdp.mdp.chain import require_termination, termination
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers


def uniqueness(mdp: MDP) -> Integers | None:
    """Return a rank that proves that values are unique; None where the discount does."""
    if mdp.discount_exact < 1:
        return None
    require_termination(mdp)
    return termination(mdp).rank
