"""How a problem is solved: one module per algorithm, one list of them, one verb.

>>> from exact_mdp import MDP
>>> from exact_mdp.solvers import PolicyIteration, solve
>>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [[1], [0]])
>>> solve(mdp, PolicyIteration()).value.tolist()
[2.0, 0.0]
>>> solve(mdp).method
'modified-policy-iteration'

A solver is whatever `solve` accepts: a name, or an object with a `name` and `solve(model)`; the
package `dynamic` says how to add one. A model is whatever `solve` accepts, too: an MDP, a Scenario,
or an object that brings its own algorithms as `solve_with(solver, tol)`, as robust models do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from exact_mdp.mdp.lazy import names_later
from exact_mdp.solvers.dynamic.backward_induction import BackwardInduction
from exact_mdp.solvers.dynamic.gauss_seidel import GaussSeidel
from exact_mdp.solvers.dynamic.linear_program import LinearProgram
from exact_mdp.solvers.dynamic.modified import ModifiedPolicyIteration
from exact_mdp.solvers.dynamic.policy_iteration import PolicyIteration
from exact_mdp.solvers.dynamic.stopping import Solver
from exact_mdp.solvers.dynamic.value_iteration import ValueIteration
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
    from exact_mdp.solvers.average.certificate import AverageCertificate
    from exact_mdp.solvers.average.evaluate import AverageEvaluation
    from exact_mdp.solvers.average.solve import AverageSolution
    from exact_mdp.solvers.proof.certificate import BoundedCertificate, Certificate
    from exact_mdp.solvers.proof.certify import certify
    from exact_mdp.solvers.robust.robust import RobustModel, solve_robust
    from exact_mdp.solvers.values.evaluate import Evaluation, evaluate
    from exact_mdp.solvers.values.returns import ReturnDistribution, return_distribution
    from exact_mdp.solvers.values.simulate import Simulation, simulate

__all__ = [
    "SOLVERS",
    "AverageCertificate",
    "AverageEvaluation",
    "AverageSolution",
    "BackwardInduction",
    "Bounded",
    "BoundedCertificate",
    "Certificate",
    "Certified",
    "Claim",
    "Estimated",
    "Evaluation",
    "GaussSeidel",
    "LinearProgram",
    "ModifiedPolicyIteration",
    "PolicyIteration",
    "PrecisionWarning",
    "ReturnDistribution",
    "RobustModel",
    "Simulation",
    "Solution",
    "Solver",
    "SolverError",
    "Status",
    "ValueIteration",
    "certify",
    "evaluate",
    "return_distribution",
    "simulate",
    "solve",
    "solve_robust",
]

__getattr__, __dir__ = names_later(
    __name__,
    {
        "exact_mdp.solvers.average.certificate": ["AverageCertificate"],
        "exact_mdp.solvers.average.evaluate": ["AverageEvaluation"],
        "exact_mdp.solvers.average.solve": ["AverageSolution"],
        "exact_mdp.solvers.proof.certificate": ["BoundedCertificate", "Certificate"],
        "exact_mdp.solvers.proof.certify": ["certify"],
        "exact_mdp.solvers.robust.robust": ["RobustModel", "solve_robust"],
        "exact_mdp.solvers.values.evaluate": ["Evaluation", "evaluate"],
        "exact_mdp.solvers.values.returns": ["ReturnDistribution", "return_distribution"],
        "exact_mdp.solvers.values.simulate": ["Simulation", "simulate"],
    },
)
