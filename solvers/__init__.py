"""How a problem is solved: one module per algorithm, one list of them, one verb.

>>> from exact_mdp import MDP
>>> from exact_mdp.solvers import PolicyIteration, solve
>>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [[1], [0]])
>>> solve(mdp, PolicyIteration()).value.tolist()
[2.0, 0.0]
>>> solve(mdp).method
'modified-policy-iteration'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exact_mdp.solvers.dynamic.backward_induction import BackwardInduction
from exact_mdp.solvers.dynamic.gauss_seidel import GaussSeidel
from exact_mdp.solvers.dynamic.linear_program import LinearProgram
from exact_mdp.solvers.dynamic.modified import ModifiedPolicyIteration
from exact_mdp.solvers.dynamic.policy_iteration import PolicyIteration
from exact_mdp.solvers.dynamic.stopping import Solver
from exact_mdp.solvers.dynamic.value_iteration import ValueIteration
from exact_mdp.solvers.parallel import sources as sources
from exact_mdp.solvers.solution import (
    Bounded,
    Certified,
    Claim,
    Estimated,
    PrecisionWarning,
    Solution,
    SolverError,
    Status,
)
from exact_mdp.solvers.solver import SOLVERS, solve

if TYPE_CHECKING:
    from exact_mdp.solvers.dynamic.operator import operator_mean
    from exact_mdp.solvers.proof.certificate import BoundedCertificate, Certificate
    from exact_mdp.solvers.proof.certify import certify
    from exact_mdp.solvers.robust.robust import solve_robust
    from exact_mdp.solvers.values.evaluate import evaluate
    from exact_mdp.solvers.values.returns import return_distribution
    from exact_mdp.solvers.values.simulate import simulate

__all__ = [
    "SOLVERS",
    "BackwardInduction",
    "Bounded",
    "BoundedCertificate",
    "Certificate",
    "Certified",
    "Claim",
    "Estimated",
    "GaussSeidel",
    "LinearProgram",
    "ModifiedPolicyIteration",
    "PolicyIteration",
    "PrecisionWarning",
    "Solution",
    "Solver",
    "SolverError",
    "Status",
    "ValueIteration",
    "certify",
    "evaluate",
    "operator_mean",
    "return_distribution",
    "simulate",
    "solve",
    "solve_robust",
]

_LATER = {
    "BoundedCertificate": "exact_mdp.solvers.proof.certificate",
    "Certificate": "exact_mdp.solvers.proof.certificate",
    "certify": "exact_mdp.solvers.proof.certify",
    "evaluate": "exact_mdp.solvers.values.evaluate",
    "operator_mean": "exact_mdp.solvers.dynamic.operator",
    "return_distribution": "exact_mdp.solvers.values.returns",
    "simulate": "exact_mdp.solvers.values.simulate",
    "solve_robust": "exact_mdp.solvers.robust.robust",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if __name__ == "solvers":
    from exact_mdp._checkout import alias

    alias(__name__)
