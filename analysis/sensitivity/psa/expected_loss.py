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
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.sensitivity.base import digest, unit_of
from exact_mdp.analysis.sensitivity.draws.blocks import run, whole_number
from exact_mdp.analysis.sensitivity.draws.solver import DrawSolver, solver_of
from exact_mdp.analysis.sensitivity.psa.distributions import Uncertainty
from exact_mdp.analysis.sensitivity.psa.intervals import mean_loss
from exact_mdp.analysis.sensitivity.psa.uncertainty import EFFECTIVE_SAMPLE_SIZE, uncertainty
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric, placed
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.parallel.pieces import Arrays

if TYPE_CHECKING:
    from pandas import DataFrame

SAMPLE_SIZE = "effective_sample_size"
SIZES = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class LossCurve:
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
        from pandas import DataFrame

        count, many = self.loss.shape
        return DataFrame(
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
    source: Scenario | MDP | Parametric,
    policies: Mapping[str, object],
    points: Sequence[float] = SIZES,
    *,
    seed: int,
    along: str = SAMPLE_SIZE,
    samples: int = 2000,
    effective_sample_size: float = EFFECTIVE_SAMPLE_SIZE,
    stated: Mapping[str, Mapping[str, object]] | None = None,
    names: Sequence[str] | None = None,
    rows: Mapping[str, Sequence[str]] | None = None,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> LossCurve:
    """Return what each policy loses on average, at each point.

    Parameters
    ----------
    policies : {name: policy}
        "optimal" is the optimum at today's values; all are held fixed.
    points : sequence
        Effective sample sizes, or values of the parameter `along`.
    along : str
        "effective_sample_size", or a parameter's name, which is then not drawn.
    stated, names, rows
        As in `uncertainty`.
    folder : path, optional
        Where finished points are kept; the same call uses them again.

    Raises
    ------
    ModelError
        For no points or draws, and points outside the parameter's range.

    Examples
    --------
    >>> found = expected_loss(
    ...     Scenario.load("yuan2025"), {"today": "optimal"}, [20, 500], seed=0, samples=200
    ... )
    >>> bool(found.loss[0, 0] > found.loss[1, 0] >= 0)
    True
    """
    model = parametric(source)
    samples, seed = whole_number(samples, "samples", 0), whole_number(seed, "seed", 0)
    if len(points) == 0 or not policies or samples < 2:
        raise ModelError(
            f"{len(points)} points, {len(policies)} policies, {samples} draws",
            where="expected loss",
            fix="give at least one point, one policy and two draws",
        )
    solver = solver_of(model)
    weights = [solver.base.held(policy) for policy in policies.values()]
    pieces: list[Any] = []
    for point in points:
        if along == SAMPLE_SIZE:
            chosen = uncertainty(model, stated, default=float(point), names=names, rows=rows)
            held: dict[str, float] = {}
        else:
            placed(model, {along: float(point)})
            asked = [p.name for p in model.parameters] if names is None else names
            others = [name for name in asked if name != along]
            chosen = uncertainty(
                model, stated, default=effective_sample_size, names=others, rows=rows
            )
            held = {along: float(point)}
        if not chosen.parts:
            raise ModelError(
                "no parameter is uncertain", where=f"model {model.name}", fix="state what is drawn"
            )
        pieces.append((chosen, held, seed, samples))
    blocks = run(
        solver,
        "points",
        partial(_point, solver, weights),
        pieces,
        {
            "model": fingerprint(solver.base.mdp),
            "along": along,
            "seed": seed,
            "samples": samples,
            "policies": [digest(each) for each in weights],
            "points": [
                [float(point), *([*p.names, p.kind, p.size, *p.mean] for p in piece[0].parts)]
                for point, piece in zip(points, pieces, strict=True)
            ],
        },
        n_jobs=n_jobs,
        scheduler=scheduler,
        folder=folder,
        progress=progress,
    )
    unit = "observations" if along == SAMPLE_SIZE else unit_of(parameter_of(model, along))
    return LossCurve(
        along=along,
        unit=unit,
        points=np.asarray(points, dtype=float),
        policies=tuple(policies),
        draws=samples,
        **{name: np.stack([block[name] for block in blocks]) for name in blocks[0]},
    )


def _point(
    solver: DrawSolver,
    weights: Sequence[Floats],
    piece: tuple[Uncertainty, Mapping[str, float], int, int],
) -> Arrays:
    chosen, held, seed, samples = piece
    names = (*chosen.names, *held)
    drawn = chosen.draw(SeedSequence(seed), samples)
    draws = np.hstack([drawn, np.tile(list(held.values()), (samples, 1))])
    found, valued = solver.solved(names, draws), solver.values(names, draws, weights)
    gap = found["start"][:, None] - valued["value"]
    real = gap > found["error"][:, None] + valued["error"]
    gap = np.where(real, gap, 0.0)
    told = [mean_loss(column) for column in gap.T]
    return {
        "loss": np.array([each.value for each in told]),
        "standard_error": np.array([each.standard_error for each in told]),
        "low": np.array([each.low for each in told]),
        "high": np.array([each.high for each in told]),
        "carried": np.array([each.carried for each in told]),
        "optimal": 1 - real.mean(axis=0),
    }
