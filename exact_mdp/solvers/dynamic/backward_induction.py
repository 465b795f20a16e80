"""Backward induction: one pass over an acyclic model, from the end to the start.

    V(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')

once V is known in all successors s' (Puterman, Markov Decision Processes, 1994, section 4.5). The
result is exact but for rounding, which `solvers.bounds.bounds.verify` bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import ClassVar

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.bounds.bounds import backward, is_acyclic, verify
from exact_mdp.solvers.dynamic.iterate import conclude, of_costs
from exact_mdp.solvers.solution import Solution, Status


@dataclass(frozen=True, kw_only=True)
class BackwardInduction:
    """Solve an acyclic model in one pass, at any discount.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [[3], [0]])
    >>> solution = BackwardInduction().solve(mdp)
    >>> solution.value.tolist(), solution.iterations
    ([3.0, 0.0], 1)
    """

    name: ClassVar[str] = "backward-induction"

    @of_costs
    def solve(self, model: MDP) -> Solution:
        """Return the optimum; raises ModelError where states come back to themselves."""
        started = perf_counter()
        if not is_acyclic(model):
            raise ModelError(
                "backward induction needs a model without cycles",
                where=f"model {model.name}".strip(),
                fix="use ModifiedPolicyIteration or PolicyIteration",
            )
        bounds = verify(model, backward(model, model.reward)).centred()
        return conclude(model, self, bounds, status=Status.DIRECT, iterations=1, started=started)
