"""What a solved model means: comparisons, returns, sensitivity, and the command line.

>>> from analysis import check
>>> from mdp import MDP
>>> check(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]), [1, 0]).passed
True
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from analysis.audit import Audit
    from analysis.compare import assert_policy_optimal, check
    from analysis.status_policies import BestPolicy, best_policy, value_of_memory

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
    "Audit": "analysis.audit",
    "BestPolicy": "analysis.status_policies",
    "assert_policy_optimal": "analysis.compare",
    "best_policy": "analysis.status_policies",
    "check": "analysis.compare",
    "value_of_memory": "analysis.status_policies",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
