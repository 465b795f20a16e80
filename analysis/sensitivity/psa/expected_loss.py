"""Expected loss curves: what each policy loses on average, by how much is known.

The loss of a policy in a draw is V* - V^π (of costs, V^π - V*); its mean, drawn against something
that varies, tells which policy to take and how bad a mistake would be, which an acceptability curve
does not (Alarid-Escudero, Enns, Kuntz, Michaud and Jalal, Value in Health 22, 2019). Along the
curve varies the effective sample size of every probability of which nothing else is stated. All
points use the same random numbers. The lowest curve bounds EVPI from above.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Unpack

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.sensitivity.base_case import digest
from exact_mdp.analysis.sensitivity.draws.blocks import How, run, whole_number
from exact_mdp.analysis.sensitivity.draws.solver import DrawSolver, solver_of
from exact_mdp.analysis.sensitivity.psa.distributions import (
    Settings,
    Uncertainty,
    uncertainty,
)
from exact_mdp.analysis.sensitivity.psa.intervals import mean_loss
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.parallel.pieces import Arrays

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

SPREAD = ("standard_error", "low", "high", "carried")
SIZES = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LossCurve(Pictured):
    """Expected losses of N policies at X points.

    Attributes
    ----------
    points : (X,)
        Effective sample sizes, in observations.
    policies : tuple of N str
    draws : int
        At each point.
    loss, standard_error, low, high : (X, N)
        Mean of V* - V^π over the draws, with the ends of its 95 % interval; units of reward.
    carried : (X, N)
        Effective number of draws that carry the mean; below 50, the interval may be too short.
    optimal : (X, N)
        Share of draws in which the policy is optimal, up to rounding.
    """

    picture = "exact_mdp.analysis.plots.psa:plot_expected_loss"

    points: Floats
    policies: tuple[str, ...]
    draws: int
    loss: Floats
    standard_error: Floats
    low: Floats
    high: Floats
    carried: Floats
    optimal: Floats

    def frame(self) -> DataFrame:
        """Return a table with a row for each point and policy; losses in units of reward."""
        count, many = self.loss.shape
        return pandas.DataFrame(
            {
                "effective sample size (observations)": np.repeat(self.points, many),
                "policy": list(self.policies) * count,
                "expected loss (reward)": self.loss.reshape(-1),
                "standard error": self.standard_error.reshape(-1),
                "low": self.low.reshape(-1),
                "high": self.high.reshape(-1),
                "draws that carry it": self.carried.reshape(-1),
                "probability optimal": self.optimal.reshape(-1),
            }
        )


def expected_loss(
    model: Scenario | MDP | Parametric,
    policies: Mapping[str, PolicyLike],
    points: Sequence[float] = SIZES,
    *,
    rng: RNG,
    n: int = 2000,
    stated: Mapping[str, Settings] | None = None,
    names: Sequence[str] | None = None,
    **how: Unpack[How],
) -> LossCurve:
    """Return what each policy loses on average, at each point.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policies : {name: PolicyLike}
        "optimal" is the optimum at today's values; all are held fixed.
    points : sequence of X float
        Effective sample sizes.
    rng : int or numpy.random.Generator
    n : int
        Draws at each point.
    stated, names
        As in `uncertainty`.
    **how
        n_jobs, scheduler, folder and progress; see `solvers.parallel.many.many`.

    Returns
    -------
    LossCurve

    Raises
    ------
    ModelError
        For no points or draws, and sizes that are not above 0.

    Examples
    --------
    >>> found = expected_loss(
    ...     Scenario.load("yuan2025"), {"today": "optimal"}, [20, 500], rng=0, n=200
    ... )
    >>> bool(found.loss[0, 0] > found.loss[1, 0] >= 0)
    True
    """
    family = parametric(model)
    n, seed = whole_number(n, "draws", 0), seed_of(rng)
    if len(points) == 0 or not policies or n < 2:
        raise ModelError(
            f"{len(points)} points, {len(policies)} policies, {n} draws",
            where="expected loss",
            fix="give at least one point, one policy and two draws",
        )
    solver = solver_of(family)
    weights = [solver.base.held(policy) for policy in policies.values()]
    chosen = [
        uncertainty(family, stated, default=float(size), names=names).checked(family)
        for size in points
    ]
    drawn = [[[*p.names, p.kind, p.size, *p.mean] for p in each.parts] for each in chosen]
    key = {
        "model": fingerprint(solver.base.mdp),
        "along": "effective_sample_size",
        "seed": seed,
        "samples": n,
        "policies": [digest(each) for each in weights],
        "points": [[float(point), *parts] for point, parts in zip(points, drawn, strict=True)],
    }
    work = partial(_point, solver, weights, seed, n)
    blocks = run(solver, "points", work, chosen, key, **how)
    return LossCurve(
        points=np.asarray(points, dtype=float),
        policies=tuple(policies),
        draws=n,
        **{name: np.stack([block[name] for block in blocks]) for name in blocks[0]},
    )


def _point(
    solver: DrawSolver, weights: Sequence[Floats], seed: int, n: int, chosen: Uncertainty
) -> Arrays:
    draws = chosen.draw(SeedSequence(seed), n)
    found = solver.solved(chosen.names, draws)
    valued = solver.values(chosen.names, draws, weights)
    gap = solver.base.sign * (found["start"][:, None] - valued["value"])
    real = gap > found["error"][:, None] + valued["error"]
    told = [mean_loss(column) for column in np.where(real, gap, 0.0).T]
    return {
        "loss": np.array([each.value for each in told]),
        **{part: np.array([getattr(each, part) for each in told]) for part in SPREAD},
        "optimal": 1 - real.mean(axis=0),
    }
