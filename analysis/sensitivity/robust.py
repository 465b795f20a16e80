"""How much a policy can lose where each row's probabilities may be off, and what hedging costs.

Uncertainty is (s, a)-rectangular: each row has a set of laws around the tables' one, and nature
picks from each on its own, against the agent or with it. An error in a table is something else:
many rows share one number; for that see `analysis.sensitivity.robust_box`. The sets are those of
Iyengar (Mathematics of Operations Research 30, 2005); what is made of the values under them is told
in `analysis.sensitivity.robust_result`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import MappingProxyType

import numpy as np

from analysis.sensitivity.robust_result import Robust, RobustCurve
from mdp.errors import ModelError, suggest
from mdp.model import MDP
from mdp.table import Floats
from solvers import evaluate, solve
from solvers.ambiguity import Intervals, L1Ball, radius_of
from solvers.divergence import Likelihood, RelativeEntropy
from solvers.policy_chain import PolicyChain
from solvers.robust import Nature, Objective, solve_robust
from solvers.robust_rows import Ambiguity
from solvers.solution import Bounded

SETS: MappingProxyType[str, Callable[[MDP, object], Ambiguity]] = MappingProxyType(
    {
        "interval": Intervals.relative,
        "absolute": Intervals.absolute,
        "l1": lambda mdp, radius: L1Ball(radius=radius),
        "kl": lambda mdp, radius: Likelihood(radius=radius),
        "entropy": lambda mdp, radius: RelativeEntropy(radius=radius),
    }
)
"""Sets by name and radius: p (1 ± x), p ± x, L1 distance, KL(p‖q) and KL(q‖p) in nats."""


def ambiguity_of(mdp: MDP, kind: str, radius: object) -> Ambiguity:
    """Return a set of laws by name (see `SETS`); raises ModelError for others."""
    if kind not in SETS:
        raise ModelError(f"unknown set {kind!r}", where="robust", fix=suggest(kind, [*SETS]))
    return SETS[kind](mdp, radius)


def robust(
    mdp: MDP,
    ambiguity: Ambiguity | None = None,
    *,
    policy: object = "optimal",
    objective: Objective = "max",
) -> Robust:
    """Return what nature can do to a policy, and to the best policy against it.

    Parameters
    ----------
    ambiguity : Ambiguity, optional
        Sets of laws; p ± 20 % of itself unless given.
    policy : "optimal", or anything that `solvers.evaluate` takes
        The nominal policy.
    objective : "max" or "min"

    Raises
    ------
    ModelError
        As `solvers.robust.solve_robust` does.

    Examples
    --------
    >>> from mdp import Scenario
    >>> found = robust(Scenario.load("yuan2025").compile())
    >>> print(f"{found.value.value:.4f} {found.worst.value:.4f} {found.robust.start.value:.4f}")
    146.2359 140.7817 140.7817
    """
    sets = Intervals.relative(mdp, "1/5") if ambiguity is None else ambiguity
    if isinstance(policy, str) and policy == "optimal":
        policy = _optimum(mdp, objective)
    chain = PolicyChain.of(mdp, policy)
    kept = chain.weights

    def held(weights: Floats, nature: Nature) -> Bounded:
        return solve_robust(mdp, sets, nature=nature, objective=objective, policy=weights).start

    best = solve_robust(mdp, sets, objective=objective)
    assert best.pairs is not None
    own = np.zeros(mdp.n_pairs)
    own[best.pairs] = 1.0
    return Robust(
        mdp=mdp,
        policy=kept,
        value=evaluate(mdp, chain).numbers["mean"],
        worst=held(kept, "worst"),
        best=held(kept, "best"),
        robust=best,
        optimistic=solve_robust(mdp, sets, nature="best", objective=objective),
        robust_value=evaluate(mdp, own).numbers["mean"],
        robust_best=held(own, "best"),
    )


def _optimum(mdp: MDP, objective: Objective) -> object:
    if objective == "max":
        return solve(mdp)
    # The least of all policies: nature has nothing to choose where every radius is 0.
    found = solve_robust(mdp, L1Ball(radius=0.0), objective="min")
    assert found.policy is not None
    return found.policy


def robust_curve(
    mdp: MDP, kind: str, radii: Iterable[object], *, policy: object = "optimal"
) -> RobustCurve:
    """Return `robust` at each radius of one kind of set.

    Examples
    --------
    >>> from mdp import Scenario
    >>> found = robust_curve(Scenario.load("yuan2025").compile(), "l1", [0, 0.1])
    >>> [round(each.robust.start.value, 3) for _, each in found.points]
    [146.236, 139.106]
    """
    numbers = [radius_of(radius, "a radius") for radius in radii]
    if not numbers:
        raise ModelError("no radius", where="robust curve", fix="give some")
    held = solve(mdp) if isinstance(policy, str) and policy == "optimal" else policy
    return RobustCurve(
        kind=kind,
        points=tuple(
            (radius, robust(mdp, ambiguity_of(mdp, kind, radius), policy=held))
            for radius in numbers
        ),
    )
