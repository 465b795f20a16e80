"""The optimum of a model with a proof in rationals that an independent checker has accepted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mdp.model import MDP

if TYPE_CHECKING:
    from solvers.certificate import Certificate


def proven(mdp: MDP) -> Certificate:
    """Return a certificate that its checker has accepted.

    Examples
    --------
    >>> print(proven(MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])).start)
    2 (certified)
    """
    from solvers.certificate import certify

    found = certify(mdp)
    if faults := found.violations():
        raise RuntimeError(f"a certificate does not hold: {faults[0]}")
    return found
