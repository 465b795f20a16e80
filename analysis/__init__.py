"""What a solved model means: comparisons, returns, sensitivity, and the command line.

>>> from exact_mdp import check
>>> from exact_mdp import MDP
>>> check(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]), [1, 0]).passed
True
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.audit import Audit
    from exact_mdp.analysis.gate.check import assert_policy_optimal, check
    from exact_mdp.analysis.gate.column_policies import BestPolicy, best_policy, value_of_memory

__all__ = [
    "Audit",
    "BestPolicy",
    "assert_policy_optimal",
    "best_policy",
    "check",
    "value_of_memory",
]

# Imported when first asked for: `exact-mdp --help` needs none of it.
_LATER = {
    "Audit": "exact_mdp.analysis.gate.audit",
    "BestPolicy": "exact_mdp.analysis.gate.column_policies",
    "assert_policy_optimal": "exact_mdp.analysis.gate.check",
    "best_policy": "exact_mdp.analysis.gate.column_policies",
    "check": "exact_mdp.analysis.gate.check",
    "value_of_memory": "exact_mdp.analysis.gate.column_policies",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if __name__ == "analysis":
    from exact_mdp._checkout import alias

    alias(__name__)
