"""Global sensitivity by variance: Sobol indices of the optimum's value and of a policy's regret.

With parameters independent and uniform over their ranges, and Y the value at a draw,

    S_i  = Var(E[Y | θ_i]) / Var(Y)          first order: what θ_i decides alone,
    ST_i = E[Var(Y | θ_others)] / Var(Y)     total: what θ_i decides alone and with others,

by Saltelli's scheme on a scrambled Sobol sequence, N (P + 2) draws for P parameters, with the
estimators and bootstrap intervals of SALib (Saltelli et al., Computer Physics Communications 181,
2010; Herman and Usher, Journal of Open Source Software 2, 2017). At every draw the model is solved
again; the regret is that of a policy held fixed. All results are estimates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

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

CONFIDENCE = 0.95
RESAMPLES = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Indices:
    """Sobol indices of one output.

    Attributes
    ----------
    mean, sd : float
        Of the output over the ranges; units of reward.
    first, total : (P,)
        NaN where the output does not vary.
    first_half, total_half : (P,)
        Half the width of the intervals.
    """

    mean: float
    sd: float
    first: Floats
    first_half: Floats
    total: Floats
    total_half: Floats

    @property
    def constant(self) -> bool:
        """Whether the output is the same, up to rounding, at every draw."""
        return bool(np.isnan(self.first).all())


@dataclass(frozen=True, kw_only=True, eq=False)
class Sobol:
    """Sobol indices of every parameter.

    Attributes
    ----------
    parameters : tuple of Parameter
    ranges : {name: Range}
    optimal, fixed, regret : Indices
        Of the value with the policy re-optimised, of the value with it held fixed, and of the
        difference.
    samples : int
        N; the model was solved at `draws` = N (P + 2) points.
    confidence : float
        Of the intervals.
    """

    parameters: tuple[Parameter, ...]
    ranges: Mapping[str, Range]
    optimal: Indices
    fixed: Indices
    regret: Indices
    samples: int
    confidence: float
    seed: int

    @property
    def draws(self) -> int:
        """How many models were solved."""
        return self.samples * (len(self.parameters) + 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def frame(self, output: str = "optimal") -> DataFrame:
        """Return one row for each parameter, the largest total index first.

        Parameters
        ----------
        output : "optimal", "fixed" or "regret"
        """
        found = indices_of(self, output)
        measures = {
            "first order (share of variance)": found.first,
            "first order ±": found.first_half,
            "total (share of variance)": found.total,
            "total ±": found.total_half,
        }
        attrs = {
            "output": output,
            "mean (reward)": found.mean,
            "sd (reward)": found.sd,
            "confidence": self.confidence,
            "samples": self.samples,
            "seed": self.seed,
        }
        return frame_of(self.ranges, self.parameters, measures, np.nan_to_num(found.total), attrs)


def sobol(
    source: Scenario | MDP | Parametric,
    *,
    policy: object = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: Fraction | None = None,
    samples: int = 1024,
    seed: int,
    confidence: float = CONFIDENCE,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> Sobol:
    """Return first-order and total Sobol indices over the ranges of parameters.

    Parameters
    ----------
    policy : "optimal" at today's values, or anything that `solvers.evaluate` takes
        The policy whose regret is decomposed.
    names, ranges, relative
        As for `analysis.sensitivity.one_way.tornado`: today's value ± 20 % unless given. Parameters
        that are 0 today are left out unless a range is stated, the discount unless it is named.
    samples : int
        N, a power of 2; the model is solved at N (P + 2) points.
    seed : int
        0 is a seed like any other.
    confidence : float
        Of the bootstrap intervals.
    n_jobs, scheduler, folder, progress
        See `solvers.parallel.many.many`; the result does not depend on them.

    Raises
    ------
    ModelError
        For unknown names, empty ranges, a wrong number of samples, or values that the model
        cannot have together.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [("1/2", 2, 1), ("1/2", 3, 0)])]
    >>> rows += [(2, 0, [(1, 2, 0)]), (3, 0, [(1, 3, 0)])]
    >>> model = moving(MDP.from_outcomes(rows, 1), {"p": [(0, 1)], "q": [(1, 2)]})
    >>> found = sobol(model, ranges={"p": (0, 1), "q": (0, 1)}, samples=64, seed=0)
    >>> found.names, found.draws, (found.optimal.total > found.optimal.first).tolist()
    (('p', 'q'), 256, [True, True])
    """
    sample, analyze = salib("sample.sobol").sample, salib("analyze.sobol").analyze

    design = Design.of(source, names, ranges, relative)
    check_confidence(confidence)
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 2:
        raise ModelError(f"{samples!r} samples", where="sobol", fix="ask for at least 2")
    if samples & (samples - 1):
        near = 1 << (samples.bit_length() - 1)
        raise ModelError(
            f"{samples} samples, not a power of 2, of which Sobol sequences are made",
            where="sobol",
            fix=f"ask for {near} or {2 * near}",
        )
    first, second = child(seed, 0), child(seed, 1)
    draws = design.draws(sample, samples, first, calc_second_order=False)
    found = design.solved(
        draws, policy, n_jobs=n_jobs, scheduler=scheduler, folder=folder, progress=progress
    )

    def indices(output: Floats) -> Indices:
        points = output.reshape(samples, -1)[:, [0, -1]]  # the two independent samples
        mean, sd = float(points.mean()), float(points.std(ddof=1))
        if np.ptp(output) <= found.noise:
            nothing = np.full(len(design.spans), np.nan)
            parts = dict.fromkeys(("first", "first_half", "total", "total_half"), nothing)
            return Indices(mean=mean, sd=0.0, **parts)
        result = analyze(
            design.problem,
            output,
            calc_second_order=False,
            num_resamples=RESAMPLES,
            conf_level=confidence,
            seed=whole_seed(second),
        )
        return Indices(
            mean=mean,
            sd=sd,
            first=result["S1"],
            first_half=result["S1_conf"],
            total=result["ST"],
            total_half=result["ST_conf"],
        )

    return Sobol(
        parameters=design.parameters,
        ranges=design.ranges,
        **{name: indices(output) for name, output in outputs_of(found).items()},
        samples=samples,
        confidence=confidence,
        seed=seed,
    )


def indices_of(found: Sobol, output: str) -> Indices:
    """Return the indices of an output by name."""
    check_output(output, "sobol")
    return getattr(found, output)
