"""Krylov methods for x = c + γ P x, which fill no matrix: BiCGSTAB, and GMRES where that swings.

Large chains take the compiled loops of `solvers.kernels.krylov`; small ones SciPy's, preconditioned
by the diagonal, so that no compiler is loaded. Chains of many states are large, too: threads of a
library for linear algebra would wait for each other where other work goes on.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from mdp.table import Floats, Numbers
from solvers.elimination import matrix_of
from solvers.gains import COMPILED

STEPS = 400
PATIENT = 8000
LONG = 5000  # states from which on SciPy's inner products run on threads of their own
DIRECTIONS = 20
GMRES_STEPS = 400


def quickly(chain: sp.csr_array, discount: float, constant: Floats, rtol: float) -> Floats | None:
    """Return x (S,), or None where that takes more than `STEPS` steps.

    Parameters
    ----------
    chain : (S, S) csr array
    constant : (S,)
        c, of magnitude 1 or so.
    rtol : float
        The residual's norm is to be about this part of the constant's.

    Examples
    --------
    >>> walk = sp.csr_array([[0.5, 0.25], [0.0, 0.0]])
    >>> quickly(walk, 1.0, np.array([1.0, 1.0]), 1e-12).round(9).tolist()
    [2.5, 1.0]
    """
    return _bicgstab(chain, discount, constant, rtol, STEPS)


def patiently(chain: sp.csr_array, discount: float, constant: Floats, rtol: float) -> Floats | None:
    """Return x (S,), or None where neither GMRES nor `PATIENT` steps of BiCGSTAB lead there."""
    if chain.nnz >= COMPILED:
        from solvers.kernels import krylov

        value, basis = np.empty(len(constant)), np.empty((DIRECTIONS + 2, len(constant)))
        small = np.empty((DIRECTIONS + 4, DIRECTIONS + 1))
        rows = _rows(chain, discount)
        taken = krylov.gmres(*rows, constant, rtol, GMRES_STEPS, value, basis, small)
        if taken >= 0 and np.all(np.isfinite(value)):
            return value
    return _bicgstab(chain, discount, constant, rtol, PATIENT)


def _rows(chain: sp.csr_array, discount: float) -> tuple[Numbers, Numbers, Floats, float]:
    """Return the arrays of the chain, their columns sorted, and γ."""
    chain = chain if chain.has_sorted_indices else chain.sorted_indices()
    return chain.indptr, chain.indices, chain.data, float(discount)


def _bicgstab(
    chain: sp.csr_array, discount: float, constant: Floats, rtol: float, steps: int
) -> Floats | None:
    if chain.nnz >= COMPILED or chain.shape[0] >= LONG:
        from solvers.kernels import krylov

        value, room = np.empty(len(constant)), np.empty((6, len(constant)))
        rows = _rows(chain, discount)
        failed = krylov.bicgstab(*rows, constant, rtol, steps, value, room) < 0
    else:
        from scipy.sparse.linalg import bicgstab

        matrix = matrix_of(chain, discount)
        inverse = sp.diags_array(1 / matrix.diagonal())
        value, status = bicgstab(matrix, constant, rtol=rtol, maxiter=steps, M=inverse)
        failed = status != 0
    return None if failed or not np.all(np.isfinite(value)) else np.asarray(value)
