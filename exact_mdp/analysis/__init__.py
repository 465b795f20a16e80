"""What a solved model means: comparisons, returns, sensitivity, and the command line.

>>> from exact_mdp import check
>>> from exact_mdp import MDP
>>> check(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]), [1, 0]).passed
True
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from exact_mdp.mdp.lazy import names_later

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.check import Audit, assert_policy_optimal, check
    from exact_mdp.analysis.gate.column_policies import BestPolicy, best_policy
    from exact_mdp.analysis.gate.comparison import PolicyComparison, compare
    from exact_mdp.analysis.gate.data.off_policy import OffPolicy
    from exact_mdp.analysis.gate.data.posterior import Posterior
    from exact_mdp.analysis.gate.data.robust import Robust
    from exact_mdp.analysis.graph import dot
    from exact_mdp.analysis.learning.trainers import TrainerAudit, check_trainer
    from exact_mdp.analysis.pages.explorer import explore
    from exact_mdp.analysis.sensitivity.curves.curve import value_function
    from exact_mdp.analysis.tradeoffs.front import tradeoff
    from exact_mdp.analysis.tradeoffs.rationalize import rationalize

__all__ = [
    "Audit",
    "BestPolicy",
    "OffPolicy",
    "PolicyComparison",
    "Posterior",
    "Robust",
    "TrainerAudit",
    "assert_policy_optimal",
    "best_policy",
    "check",
    "check_trainer",
    "compare",
    "dot",
    "explore",
    "rationalize",
    "tradeoff",
    "value_function",
]

# Imported when first asked for: `exact-mdp --help` needs none of it.
__getattr__, __dir__ = names_later(
    __name__,
    {
        "exact_mdp.analysis.gate.check": ["Audit", "assert_policy_optimal", "check"],
        "exact_mdp.analysis.gate.column_policies": [
            "BestPolicy",
            "best_policy",
        ],
        "exact_mdp.analysis.sensitivity.curves.curve": ["value_function"],
        "exact_mdp.analysis.tradeoffs.front": ["tradeoff"],
        "exact_mdp.analysis.tradeoffs.rationalize": ["rationalize"],
        "exact_mdp.analysis.gate.comparison": ["PolicyComparison", "compare"],
        "exact_mdp.analysis.gate.data.off_policy": ["OffPolicy"],
        "exact_mdp.analysis.gate.data.posterior": ["Posterior"],
        "exact_mdp.analysis.gate.data.robust": ["Robust"],
        "exact_mdp.analysis.graph": ["dot"],
        "exact_mdp.analysis.learning.trainers": ["TrainerAudit", "check_trainer"],
        "exact_mdp.analysis.pages.explorer": ["explore"],
    },
)
