"""Exact analysis of finite Markov decision processes: models, solvers, proofs, audits.

The rooms are `exact_mdp.mdp` (what a problem is), `.solvers` (how it is solved), `.analysis` (what
it means) and `.paper_repro`. The public names are here, each loaded when it is first asked for.

>>> from exact_mdp import MDP, check, solve
>>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
>>> solve(mdp).value.tolist(), check(mdp, [1, 0]).passed
([3.0, 0.0], True)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from exact_mdp.analysis import assert_policy_optimal, check
    from exact_mdp.mdp import MDP, ModelError, Policy, Scenario
    from exact_mdp.solvers import certify, evaluate, solve

__all__ = [
    "MDP",
    "ModelError",
    "Policy",
    "Scenario",
    "assert_policy_optimal",
    "certify",
    "check",
    "evaluate",
    "solve",
]

_ROOM = {
    "MDP": "mdp",
    "ModelError": "mdp",
    "Policy": "mdp",
    "Scenario": "mdp",
    "assert_policy_optimal": "analysis",
    "certify": "solvers",
    "check": "analysis",
    "evaluate": "solvers",
    "solve": "solvers",
}


def __getattr__(name: str) -> Any:
    if name in _ROOM:
        return getattr(import_module(f"{__name__}.{_ROOM[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
