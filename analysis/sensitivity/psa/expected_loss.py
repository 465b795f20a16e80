"""Expected loss curves: what each policy loses on average, by how much is known or what is wanted.

The loss of a policy in a draw is V* - V^π; its mean, drawn against something that varies, tells
which policy to take and how bad a mistake would be, which an acceptability curve does not
(Alarid-Escudero, Enns, Kuntz, Michaud and Jalal, Value in Health 22, 2019). Along the curve varies
either the effective sample size of every probability, or the value of one parameter, such as a
reward weight. All points use the same random numbers. The lowest curve bounds EVPI from above.
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
    EFFECTIVE_SAMPLE_SIZE,
    Settings,
    Uncertainty,
    uncertainty,
)
from exact_mdp.analysis.sensitivity.psa.intervals import mean_loss
from exact_mdp.analysis.sensitivity.ranges import unit_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric, placed
from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.parallel.pieces import Arrays

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

SAMPLE_SIZE = "effective_sample_size"
SPREAD = ("standard_error", "low", "high", "carried")
SIZES = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LossCurve(Pictured):
    """Expected losses of N policies at X points.

    Attributes
    ----------
    along, unit : str
    points : (X,)
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

    along: str
    unit: str
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
                f"{self.along} ({self.unit})": np.repeat(self.points, many),
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
    policies: Mapping[str, object],
    points: Sequence[float] = SIZES,
    *,
    rng: RNG,
    along: str = SAMPLE_SIZE,
    n: int = 2000,
    effective_sample_size: float = EFFECTIVE_SAMPLE_SIZE,
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
        Effective sample sizes, or values of the parameter `along`.
    rng : int or numpy.random.Generator
    along : str
        "effective_sample_size", or a parameter's name, which is then not drawn.
    n : int
        Draws at each point.
    effective_sample_size : float
        Of every probability of which nothing is stated, where that is not what varies.
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
        For no points or draws, and points outside the parameter's range.

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
    pieces: list[_Piece] = []
    for point in map(float, points):
        size, held = effective_sample_size, {along: point}
        asked = names
        if along == SAMPLE_SIZE:
            size, held = point, {}
        else:
            placed(family, held)
            asked = [p.name for p in family.parameters] if names is None else names
            asked = [name for name in asked if name != along]
        chosen = uncertainty(family, stated, default=size, names=asked).checked(family)
        pieces.append((chosen, held, seed, n))
    drawn = [[[*p.names, p.kind, p.size, *p.mean] for p in piece[0].parts] for piece in pieces]
    key = {
        "model": fingerprint(solver.base.mdp),
        "along": along,
        "seed": seed,
        "samples": n,
        "policies": [digest(each) for each in weights],
        "points": [[float(point), *parts] for point, parts in zip(points, drawn, strict=True)],
    }
    blocks = run(solver, "points", partial(_point, solver, weights), pieces, key, **how)
    unit = "observations" if along == SAMPLE_SIZE else unit_of(parameter_of(family, along))
    return LossCurve(
        along=along,
        unit=unit,
        points=np.asarray(points, dtype=float),
        policies=tuple(policies),
        draws=n,
        **{name: np.stack([block[name] for block in blocks]) for name in blocks[0]},
    )


_Piece = tuple[Uncertainty, Mapping[str, float], int, int]


def _point(solver: DrawSolver, weights: Sequence[Floats], piece: _Piece) -> Arrays:
    chosen, held, seed, n = piece
    names = (*chosen.names, *held)
    drawn = chosen.draw(SeedSequence(seed), n)
    draws = np.hstack([drawn, np.tile(list(held.values()), (n, 1))])
    found, valued = solver.solved(names, draws), solver.values(names, draws, weights)
    gap = found["start"][:, None] - valued["value"]
    real = gap > found["error"][:, None] + valued["error"]
    told = [mean_loss(column) for column in np.where(real, gap, 0.0).T]
    return {
        "loss": np.array([each.value for each in told]),
        **{part: np.array([getattr(each, part) for each in told]) for part in SPREAD},
        "optimal": 1 - real.mean(axis=0),
    }
