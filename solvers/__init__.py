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

from exact_mdp.mdp.chain import numbered_in_order
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.bounds.bounds import levels
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

if TYPE_CHECKING:
    from exact_mdp.mdp.care.operator import CareOperator
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

SOLVERS: dict[str, type[Solver]] = {
    "value-iteration": ValueIteration,
    "gauss-seidel": GaussSeidel,
    "modified-policy-iteration": ModifiedPolicyIteration,
    "policy-iteration": PolicyIteration,
    "backward-induction": BackwardInduction,
    "linear-program": LinearProgram,
}
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


def solve(
    mdp: MDP | CareOperator, solver: Solver | str | None = None, *, horizon: int | None = None
) -> Solution:
    """Return optimal values and a policy, with bounds on their error.

    Parameters
    ----------
    mdp : MDP or CareOperator
        An operator (`Scenario.operator`) is solved by backward induction.
    solver : Solver or str, optional
        A solver with its settings, or a name in `SOLVERS`; unless given (or "auto"), backward
        induction for models without cycles and modified policy iteration for others.
    horizon : int, optional
        Stop after so many steps, without a further reward: the solution is that of
        `mdp.within(horizon)`, whose states are times and states.

    Raises
    ------
    ModelError
        For an unknown name; at discount 1 where not every policy ends.
    SolverError
        Where a solver reaches a limit: of iterations, or of double precision.

    Examples
    --------
    >>> wait, go = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
    >>> mdp = MDP.from_arrays([wait, go], [[1, "3/2"], [0, 0]])
    >>> found = solve(mdp, horizon=3)
    >>> found.start_value, [found.mdp.actions[a] for a in found.policy[[0, 2, 4]]]
    (1.875, ['0', '0', '1'])
    """
    if not isinstance(mdp, MDP):
        if horizon is not None:
            raise ModelError(
                "an operator is solved until it ends",
                where="horizon",
                fix="compile the scenario, which stops after any number of steps",
            )
        return _solve_operator(mdp, solver)
    if horizon is not None:
        mdp = mdp.within(horizon)
    if solver is None or solver == "auto":
        acyclic = numbered_in_order(mdp) or levels(mdp) is not None
        solver = BackwardInduction() if acyclic else ModifiedPolicyIteration()
    if isinstance(solver, str):
        _check_name(solver)
        solver = SOLVERS[solver]()
    if isinstance(solver, type):
        name = solver.__name__
        raise ModelError(f"{name} is a class", where="solve", fix=f"write {name}()")
    return solver.solve(mdp)


def _check_name(solver: str) -> None:
    if solver not in SOLVERS and solver != "auto":
        fix = suggest(solver, [*SOLVERS, "auto"])
        raise ModelError(f"unknown solver {solver!r}", where="solve", fix=fix)


def _solve_operator(operator: CareOperator, solver: Solver | str | None) -> Solution:
    from exact_mdp.solvers.dynamic.operator import METHOD, solve_operator

    if isinstance(solver, str):
        _check_name(solver)
    if solver in (None, "auto", METHOD) or isinstance(solver, BackwardInduction):
        return solve_operator(operator)
    raise ModelError(
        "an operator is solved by backward induction alone",
        where=f"operator {operator.name}",
        fix="leave the solver out, or compile the scenario",
    )


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


if __name__ == "solvers":
    from exact_mdp._checkout import alias

    alias(__name__)
