"""Make a bounded certificate: widen a solution until floats prove that it holds.

Around the values V of a solution, upper = V + c w and lower = V - c' w with the weights w of
`solvers.bounds`, c and c' being the least that satisfy the inequalities of `bounded_checker`.
"""

from __future__ import annotations

import warnings

import numpy as np

from mdp.errors import ModelError
from mdp.fingerprint import fingerprint
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.backward_induction import BackwardInduction
from solvers.bounded_checker import UNIT, gains
from solvers.bounds import levels, margin_weights
from solvers.certificate import BoundedCertificate
from solvers.modified_policy_iteration import ModifiedPolicyIteration
from solvers.solution import PrecisionWarning, Solution, SolverError, Status

WIDER = (1.0, 4.0, 16.0, 64.0)  # times the rounding errors, tried one after the other


def certify_bounded(
    mdp: MDP, *, tol: float | None = None, solution: Solution | None = None
) -> BoundedCertificate:
    """Return bounds that floats prove; see `solvers.certificate.certify`."""
    if solution is None:
        solution = _solve(mdp, tol)
    elif len(solution.value) != mdp.n_states or solution.mdp.n_pairs != mdp.n_pairs:
        raise ModelError("the solution is of another model", where="certify", fix="solve this one")
    weight = np.where(mdp.terminal, 0.0, margin_weights(mdp).value)
    loss, error = gains(mdp, weight, earning=False)
    widen = _Widening(mdp, np.array(solution.value), weight, -(loss + error))
    live = ~mdp.terminal
    found = BoundedCertificate(
        model=fingerprint(mdp),
        lower=widen(solution.pairs[live], -1),
        upper=widen(np.flatnonzero(live[mdp.pair_state]), 1),
        policy=solution.policy,
        weight=weight,
        mdp=mdp,
    )
    if tol is not None and not found.error_bound <= tol:
        raise SolverError(Status.PRECISION, f"{found.error_bound:.2g} is the error bound")
    return found


class _Widening:
    """Moves values (S,) along weights (S,), of which each pair leaves a margin (L,)."""

    def __init__(self, mdp: MDP, value: Floats, weight: Floats, margin: Floats) -> None:
        self.mdp, self.value, self.weight, self.margin = mdp, value, weight, margin
        self.gain, error = gains(mdp, value)
        self.error = error + 8 * UNIT * np.abs(value).max()

    def __call__(self, pairs: Integers, sign: int) -> Floats:
        """Return values proven not to gain (1), or not to lose (-1), by any of the pairs."""
        for times in WIDER:
            surplus = sign * self.gain[pairs] + times * self.error[pairs]
            step = max(0.0, float((surplus / self.margin[pairs]).max(initial=0.0)))
            moved = self.value + sign * step * self.weight
            gain, error = gains(self.mdp, moved)
            if (sign * gain[pairs] <= -error[pairs]).all():
                return moved
        raise SolverError(Status.NO_BOUND)


def _solve(mdp: MDP, tol: float | None) -> Solution:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)  # the bounds tell what was reached
        if levels(mdp) is not None:
            return BackwardInduction().solve(mdp)
        return ModifiedPolicyIteration(tol=None if tol is None else tol / 4).solve(mdp)
