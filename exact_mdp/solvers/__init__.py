"""How a problem is solved: one module per algorithm, one list of them, one verb.

>>> from exact_mdp import MDP
>>> from exact_mdp.solvers import PolicyIteration, solve
>>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [[1], [0]])
>>> solve(mdp, PolicyIteration()).value.tolist()
[2.0, 0.0]
>>> solve(mdp).method
'modified-policy-iteration'

A solver is whatever `solve` accepts: a name, or an object with a `name` and `solve(model)`; the
package `dynamic` says how to add one.
"""

from exact_mdp import names_of

__all__, __getattr__ = names_of(__name__)


def __dir__() -> list[str]:
    return list(__all__)
