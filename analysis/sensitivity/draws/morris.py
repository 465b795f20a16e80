"""Global screening: elementary effects on the optimum's value and on a policy's regret.

From a point of a grid over the ranges, each parameter in turn is moved by Δ of its range; the
elementary effect of θ_i is the change of the output over Δ, so that it is in units of reward for
the whole range. Over R trajectories from random points,

    μ*_i = mean |EE_i|   (how much θ_i matters),   σ_i = sd EE_i   (with others, or not linearly),

for R (P + 1) models, each solved again (Morris, Technometrics 33, 1991; Campolongo, Cariboni and
Saltelli, Environmental Modelling & Software 22, 2007). Sampling and μ* are SALib's; the interval of
σ is a bootstrap over trajectories. All results are estimates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import default_rng

from exact_mdp.analysis.sensitivity.draws.design import (
    Design,
    check_confidence,
    check_output,
    frame_of,
    outputs_of,
    salib,
    whole_seed,
)
from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.learning.sampler import child

if TYPE_CHECKING:
    from pandas import DataFrame

RESAMPLES = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class Effects:
    """Elementary effects of one output; all (P,), units of reward for the whole range.

    Attributes
    ----------
    mu : mean effect; its sign tells the direction
    mu_star, mu_star_half : mean size of the effect, and half the width of its interval
    sigma, sigma_half : standard deviation of the effect, and half the width of its interval
    """

    mu: Floats
    mu_star: Floats
    mu_star_half: Floats
    sigma: Floats
    sigma_half: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Morris:
    """Elementary effects of every parameter.

    Attributes
    ----------
    parameters : tuple of Parameter
    ranges : {name: Range}
    optimal, fixed, regret : Effects
        On the value with the policy re-optimised, on the value with it held fixed, and on the
        difference.
    trajectories, levels : int
    confidence : float
        Of the intervals.
    """

    parameters: tuple[Parameter, ...]
    ranges: Mapping[str, Range]
    optimal: Effects
    fixed: Effects
    regret: Effects
    trajectories: int
    levels: int
    confidence: float
    seed: int

    @property
    def draws(self) -> int:
        """How many models were solved."""
        return self.trajectories * (len(self.parameters) + 1)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def frame(self, output: str = "optimal") -> DataFrame:
        """Return one row for each parameter, the largest μ* first.

        Parameters
        ----------
        output : "optimal", "fixed" or "regret"
        """
        found = effects_of(self, output)
        measures = {
            "mu (reward per range)": found.mu,
            "mu* (reward per range)": found.mu_star,
            "mu* ±": found.mu_star_half,
            "sigma (reward per range)": found.sigma,
            "sigma ±": found.sigma_half,
        }
        attrs = {
            "output": output,
            "confidence": self.confidence,
            "trajectories": self.trajectories,
            "levels": self.levels,
            "seed": self.seed,
        }
        return frame_of(self.ranges, self.parameters, measures, found.mu_star, attrs)


def morris(
    source: Scenario | MDP | Parametric,
    *,
    policy: object = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: Fraction | None = None,
    trajectories: int = 64,
    levels: int = 4,
    seed: int,
    confidence: float = 0.95,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> Morris:
    """Return elementary effects over the ranges of parameters.

    Parameters
    ----------
    trajectories : int
        R; the model is solved at R (P + 1) points.
    levels : int
        Points of the grid along a range, an even number.
    policy, names, ranges, relative, seed, confidence, n_jobs, scheduler, folder, progress
        See `analysis.sensitivity.draws.sobol.sobol`.

    Raises
    ------
    ModelError
        For unknown names, empty ranges, fewer than 2 trajectories, an odd number of levels, or
        values that the model cannot have together.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> rows = [(0, 0, [("1/2", 1, 4), ("1/2", 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    >>> model = moving(MDP.from_outcomes(rows, 1), {"p": [(0, 1)]})
    >>> found = morris(model, ranges={"p": (0, 1)}, trajectories=8, seed=0)
    >>> found.optimal.mu_star.round(9).tolist(), found.optimal.sigma.round(9).tolist()
    ([4.0], [0.0])
    """
    sample, analyze = salib("sample.morris").sample, salib("analyze.morris").analyze

    design = Design.of(source, names, ranges, relative)
    check_confidence(confidence)
    for what, count, least in (("trajectories", trajectories, 2), ("levels", levels, 2)):
        if isinstance(count, bool) or not isinstance(count, int) or count < least:
            raise ModelError(f"{count!r} {what}", where="morris", fix=f"ask for at least {least}")
    if levels % 2:
        raise ModelError(f"{levels} levels", where="morris", fix="choose an even number")
    first, second, third = (child(seed, number) for number in range(3))
    draws = design.draws(sample, trajectories, first, num_levels=levels)
    found = design.solved(
        draws, policy, n_jobs=n_jobs, scheduler=scheduler, folder=folder, progress=progress
    )
    low, high = np.array(design.problem["bounds"]).T
    unit = ((draws - low) / (high - low)).reshape(trajectories, -1, len(design.spans))

    def effects(output: Floats) -> Effects:
        result = analyze(
            design.problem,
            draws,
            output,
            num_levels=levels,
            num_resamples=RESAMPLES,
            conf_level=confidence,
            seed=whole_seed(second),
        )
        each = _effects(unit, output.reshape(trajectories, -1))
        picks = default_rng(third).integers(trajectories, size=(RESAMPLES, trajectories))
        spread = np.array([each[pick].std(axis=0, ddof=1) for pick in picks])
        return Effects(
            mu=np.asarray(result["mu"], dtype=float),
            mu_star=np.asarray(result["mu_star"], dtype=float),
            mu_star_half=np.asarray(result["mu_star_conf"], dtype=float),
            sigma=np.asarray(result["sigma"], dtype=float),
            sigma_half=NormalDist().inv_cdf(0.5 + confidence / 2) * spread.std(axis=0, ddof=1),
        )

    return Morris(
        parameters=design.parameters,
        ranges=design.ranges,
        **{name: effects(output) for name, output in outputs_of(found).items()},
        trajectories=trajectories,
        levels=levels,
        confidence=confidence,
        seed=seed,
    )


def effects_of(found: Morris, output: str) -> Effects:
    """Return the effects on an output by name."""
    check_output(output, "morris")
    return getattr(found, output)


def _effects(unit: Floats, output: Floats) -> Floats:
    """Return (R, P) elementary effects: unit (R, P + 1, P) points in [0, 1], output (R, P + 1)."""
    step = np.diff(unit, axis=1)
    moved = np.abs(step).argmax(axis=2)  # (R, P) which parameter each step moves
    size = np.take_along_axis(step, moved[:, :, None], axis=2)[:, :, 0]
    effects = np.empty(moved.shape)
    np.put_along_axis(effects, moved, np.diff(output, axis=1) / size, axis=1)
    return effects
