"""Whether the optimum depends on the status alone.

A policy that reads only the status is optimal wherever it may be needed exactly where, for every
status, one action is optimal in all states of that status that have a choice and that some policy
reaches from the start:  ⋂ over such states s of {a : a optimal in s}  is not empty. Ties count:
where two actions are equally good in one state, either serves.

An optimum by a solver in floating point, by exact arithmetic, or by both against each other.

Where both are asked for, |V_float(s) - V(s)| must be at most the bound that the solver states, in
every state, and the proof of the exact values must pass its checker: otherwise one of the two
programs is wrong, and neither is believed.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exact_mdp import solvers
from exact_mdp.mdp.chain import is_acyclic, reachable
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Integers

if TYPE_CHECKING:
    from exact_mdp.solvers.proof.certificate import Certificate


def status_policy(mdp: MDP, optimal: NDArray[np.bool_], *, column: str = "status") -> Policy | None:
    """Return an optimal policy that reads one column alone, or None where there is none.

    Parameters
    ----------
    mdp : MDP
    optimal : (L,) bool
        The optimal pairs.
    column : str
        Name of the column.

    Returns
    -------
    Policy or None
        The lowest action that serves, for each value of the column; a value without a reachable
        choice has none.

    Examples
    --------
    >>> import numpy as np
    >>> mdp = MDP.from_arrays(np.full((2, 2, 2), 0.5), [[1, 2], [3, 3]], discount=0.5)
    >>> policy = status_policy(mdp, np.array([False, True, True, True]), column="state")
    >>> policy.table.tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    values = mdp.space.values(column)
    size = mdp.space.column(column).size
    asked = reachable(mdp) & ~mdp.forced & (values >= 0)
    states = np.bincount(values[asked], minlength=size)
    counted = optimal & asked[mdp.pair_state]
    keys = values[mdp.pair_state[counted]] * mdp.n_actions + mdp.pair_action[counted]
    serves = np.bincount(keys, minlength=size * mdp.n_actions).reshape(size, -1) == states[:, None]
    if not serves.any(axis=1).all():
        return None
    table = np.eye(mdp.n_actions)[serves.argmax(axis=1)]
    table[states == 0] = np.nan
    return Policy.by(mdp, (column,), table)


def stationary(mdp: MDP, found: Optimum) -> bool | None:
    """Return whether the optimum depends on the status alone; None where bounds leave it open.

    Bounds rule actions out: where the others have none in common, no status policy is optimal.
    What is left is known to be optimal only where it is alone.
    """
    if status_policy(mdp, found.optimal) is None:
        return False
    if found.certificate is not None:
        return True
    left = np.add.reduceat(found.optimal.astype(np.int64), mdp.pair_offsets[:-1])
    alone = found.optimal & (left == 1)[mdp.pair_state]
    return True if status_policy(mdp, alone) is not None else None


class Contradiction(RuntimeError):
    """A solver and a proof that do not agree, or a proof that does not hold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Optimal values, a policy and every optimal pair, with what vouches for them.

    Attributes
    ----------
    value, state_error : (S,)
        State values, each within its error of the exact one.
    policy : (S,) int64
        Action numbers.
    optimal : (L,) bool
        The optimal pairs; up to the error bound where there is no certificate.
    start_value, error_bound : float
        The error bound holds for the start value and for every state.
    method : str
    solution : Solution or None
        None where the solver could not bound its error.
    certificate : Certificate or None
    """

    value: Floats
    state_error: Floats
    policy: Integers
    optimal: NDArray[np.bool_]
    start_value: float
    error_bound: float
    method: str
    solution: solvers.Solution | None
    certificate: Certificate | None

    @property
    def claim(self) -> solvers.Claim:
        """Bounded, or certified where there is a certificate."""
        return solvers.Claim.BOUNDED if self.certificate is None else solvers.Claim.CERTIFIED


def optimum(
    mdp: MDP, method: str = "auto", tol: float | None = None, *, certify: bool = False
) -> Optimum:
    """Solve a model in floating point and, where asked for, exactly.

    Parameters
    ----------
    method : str
        A name in `solvers.SOLVERS`, or "auto".
    tol : float, optional
        Greatest absolute error; a warning says where it is not met.

    Raises
    ------
    ModelError
        For a model that the method refuses, an unknown method, a tolerance that is not positive.
    SolverError
        Where the solver gives up, unless the exact answer was asked for.
    Contradiction

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [[1], [0]])
    >>> found = optimum(mdp, "policy-iteration")
    >>> round(found.start_value, 9), found.claim.value, found.optimal.tolist()
    (1.5, 'bounded', [True, True])
    """
    solver = _solver(mdp, method, tol)
    solution = None
    try:
        solution = solvers.solve(mdp, solver)
    except solvers.SolverError as error:
        if not certify:
            raise
        _warn(f"{error} (the exact values stand)")
    if tol is not None and solution is not None and solution.error_bound > tol:
        _warn(f"the error bound is {solution.error_bound:.2g}, above the tolerance {tol:g}")
    if certify or solution is None:
        return _certified(mdp, solution, solver.name)
    return Optimum(
        value=solution.value,
        state_error=solution.state_error,
        policy=solution.policy,
        optimal=solution.q >= solution.value[mdp.pair_state] - 2 * solution.error_bound,
        start_value=solution.start_value,
        error_bound=max(solution.error_bound, solution.start_error_bound),
        method=solution.method,
        solution=solution,
        certificate=None,
    )


def _certified(mdp: MDP, solution: solvers.Solution | None, method: str) -> Optimum:
    certificate = solvers.certify(mdp)
    faults = certificate.violations()
    if faults:
        raise Contradiction(f"the certificate does not hold: {faults[0]}")
    value = certificate.value_float
    error = np.spacing(np.abs(value))
    if solution is not None:
        apart = np.abs(solution.value - value)
        if not (apart <= solution.state_error + error).all():
            raise Contradiction(
                f"exact values differ from those of {solution.solver} by up to {apart.max():.3g}, "
                f"which states an error of at most {solution.error_bound:.3g}"
            )
    start = float(certificate.start_value)
    return Optimum(
        value=value,
        state_error=error,
        policy=certificate.policy,
        optimal=certificate.optimal_pairs,
        start_value=start,
        error_bound=max(float(error.max()), float(np.spacing(abs(start)))),
        method=method,
        solution=solution,
        certificate=certificate,
    )


def _solver(mdp: MDP, method: str, tol: float | None) -> solvers.Solver:
    """Return a named solver, with the tolerance where it has one to set."""
    if method == "auto":
        method = "backward-induction" if is_acyclic(mdp) else "modified-policy-iteration"
    if method not in solvers.SOLVERS:
        known = [*solvers.SOLVERS, "auto"]
        raise ModelError(f"unknown method {method!r}", where="method", fix=suggest(method, known))
    if tol is not None and not 0 < tol < np.inf:
        raise ModelError(f"the tolerance is {tol}", where="tol", fix="choose a positive number")
    kind = solvers.SOLVERS[method]
    return kind(**{"tol": tol} if tol is not None and hasattr(kind, "tol") else {})


def _warn(message: str) -> None:
    warnings.warn(message, solvers.PrecisionWarning, stacklevel=3)
