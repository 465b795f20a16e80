"""Exact analysis of finite Markov decision processes: models, solvers, proofs, audits.

The rooms are `exact_mdp.mdp` (what a problem is), `.solvers` (how it is solved), `.analysis` (what
it means) and `.paper_repro`. The public names are here, each loaded when it is first asked for.

Names from before stay, of which each is another name of something:

    mdp, solvers, analysis       in a checkout, exact_mdp.mdp and so on (`_checkout.py`)
    .start_value of a result     .start.value, the number without its claim
    .mean of an evaluation       the same
    .error_bound of a solution   .error, over all states

>>> from exact_mdp import MDP, check, solve
>>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
>>> solve(mdp).value.tolist(), check(mdp, [1, 0]).passed
([3.0, 0.0], True)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from exact_mdp.mdp.lazy import names_later

if TYPE_CHECKING:
    from exact_mdp.analysis import assert_policy_optimal, check, check_trainer, tradeoff
    from exact_mdp.mdp import (
        MDP,
        Family,
        ModelError,
        Parameter,
        Policy,
        PolicyLike,
        Scenario,
        moving,
    )
    from exact_mdp.solvers import (
        BackwardInduction,
        Certificate,
        GaussSeidel,
        LinearProgram,
        ModifiedPolicyIteration,
        PolicyIteration,
        Solution,
        SolverError,
        ValueIteration,
        certify,
        evaluate,
        return_distribution,
        simulate,
        solve,
        solve_robust,
    )

__all__ = [
    "MDP",
    "BackwardInduction",
    "Certificate",
    "Family",
    "GaussSeidel",
    "LinearProgram",
    "ModelError",
    "ModifiedPolicyIteration",
    "Parameter",
    "Policy",
    "PolicyIteration",
    "PolicyLike",
    "Scenario",
    "Solution",
    "SolverError",
    "ValueIteration",
    "assert_policy_optimal",
    "certify",
    "check",
    "check_trainer",
    "evaluate",
    "moving",
    "return_distribution",
    "simulate",
    "solve",
    "solve_robust",
    "tradeoff",
]

_MDP = ("MDP", "Family", "ModelError", "Parameter", "Policy", "PolicyLike", "Scenario", "moving")
_ANALYSIS = ("assert_policy_optimal", "check", "check_trainer", "tradeoff")
__getattr__, __dir__ = names_later(
    __name__,
    {
        "exact_mdp.mdp": _MDP,
        "exact_mdp.analysis": _ANALYSIS,
        "exact_mdp.solvers": [name for name in __all__ if name not in (*_MDP, *_ANALYSIS)],
    },
)
