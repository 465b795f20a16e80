"""Global sensitivity: Sobol indices and elementary effects over the parameters' ranges.

Parameters are independent and uniform over their ranges. At each draw of a design the model is
solved again, and a policy held fixed is evaluated, which gives three outputs Y: the value of the
optimum, that of the policy, and the policy's regret. All results are estimates.

Sobol indices say which share of the variance of Y the parameter θ_i decides,

    S_i  = Var(E[Y | θ_i]) / Var(Y)          first order: alone,
    ST_i = E[Var(Y | θ_others)] / Var(Y)     total: alone and with others,

by Saltelli's scheme on a scrambled Sobol sequence, n (P + 2) draws for P parameters (Saltelli et
al., Computer Physics Communications 181, 2010).

Elementary effects are a screening with fewer draws. From a point of a grid over the ranges, each
parameter in turn is moved by Δ of its range; the effect of θ_i is the change of Y over Δ, so that
it is in units of reward for the whole range. Over n trajectories from random points,

    μ*_i = mean |EE_i|   (how much θ_i matters),   σ_i = sd EE_i   (with others, or not linearly),

for n (P + 1) draws (Morris, Technometrics 33, 1991; Campolongo, Cariboni and Saltelli,
Environmental Modelling & Software 22, 2007).

Sampling, indices, μ* and their bootstrap intervals are SALib's (Herman and Usher, Journal of Open
Source Software 2, 2017); the interval of σ is a bootstrap over trajectories.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, Unpack

import numpy as np
from numpy.random import default_rng

from exact_mdp.analysis.sensitivity.draws.blocks import How
from exact_mdp.analysis.sensitivity.draws.sampled import Sampled, sampled
from exact_mdp.analysis.sensitivity.ranges import Range, spans_of, unit_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.parametric.parameter import Parameter
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.learning.sampler import child

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")
sobol_sample, sobol_analyze = later("SALib.sample.sobol"), later("SALib.analyze.sobol")
morris_sample, morris_analyze = later("SALib.sample.morris"), later("SALib.analyze.morris")

OUTPUTS = ("optimal", "fixed", "regret")
SOBOL_RESAMPLES, MORRIS_RESAMPLES = 200, 1000


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
class Effects:
    """Elementary effects of one output; all (P,), units of reward for the whole range.

    Attributes
    ----------
    mu : (P,)
        Mean effect; its sign is the direction.
    mu_star, mu_star_half : (P,)
        Mean size of the effect, and half the width of its interval.
    sigma, sigma_half : (P,)
        Standard deviation of the effect, and half the width of its interval.
    """

    mu: Floats
    mu_star: Floats
    mu_star_half: Floats
    sigma: Floats
    sigma_half: Floats


Part = TypeVar("Part", Indices, Effects)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Global(Pictured, Generic[Part]):
    """What a design says of every parameter, output by output; see `Sobol` and `Morris`.

    Attributes
    ----------
    parameters : tuple of P Parameter
    ranges : {name: Range}
    optimal, fixed, regret : Indices or Effects
        Of the value with the policy re-optimised, of the value with it held fixed, and of the
        difference.
    n : int
        Points of the sequence, or trajectories.
    confidence : float
        Of the intervals.
    seed : int
    """

    parameters: tuple[Parameter, ...]
    ranges: Mapping[str, Range]
    optimal: Part
    fixed: Part
    regret: Part
    n: int
    confidence: float
    seed: int

    COLUMNS: ClassVar[Mapping[str, str]]  # headings of a table, and measures
    LARGEST: ClassVar[str]  # the measure by which a table is sorted
    POINTS: ClassVar[int]  # of a sequence's point or a trajectory, beside one for each parameter

    @property
    def draws(self) -> int:
        """Number of models that were solved."""
        return self.n * (len(self.parameters) + self.POINTS)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def of(self, output: str) -> Part:
        """Return the measures of one output; raises ModelError unless it has this name."""
        if output not in OUTPUTS:
            raise ModelError(
                f"unknown output {output!r}", fix=f"choose one of {', '.join(OUTPUTS)}"
            )
        part: Part = getattr(self, output)
        return part

    def frame(self, output: str = "optimal") -> DataFrame:
        """Return one row for each parameter, the largest total index or μ* first.

        Parameters
        ----------
        output : "optimal", "fixed" or "regret"

        Returns
        -------
        pandas.DataFrame
        """
        found = self.of(output)
        spans = [self.ranges[name] for name in self.names]
        table = pandas.DataFrame(
            {
                "parameter": list(self.names),
                "unit": [unit_of(parameter) for parameter in self.parameters],
                "low": [float(span.low) for span in spans],
                "high": [float(span.high) for span in spans],
                **{heading: getattr(found, name) for heading, name in self.COLUMNS.items()},
                "claim": "estimated",
            }
        )
        order = np.argsort(-np.nan_to_num(getattr(found, self.LARGEST)), kind="stable")
        table = table.iloc[order].reset_index(drop=True)
        table.attrs |= {"output": output, "confidence": self.confidence}
        table.attrs |= {"n": self.n, "seed": self.seed}
        if isinstance(found, Indices):
            table.attrs |= {"mean (reward)": found.mean, "sd (reward)": found.sd}
        return table


class Sobol(Global[Indices]):
    """Sobol indices of every parameter; see `Global`."""

    COLUMNS: ClassVar = {
        "first order (share of variance)": "first",
        "first order ±": "first_half",
        "total (share of variance)": "total",
        "total ±": "total_half",
    }
    LARGEST, POINTS = "total", 2
    picture = "exact_mdp.analysis.plots.sensitivity:plot_sobol"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Morris(Global[Effects]):
    """Elementary effects of every parameter, on a grid of `levels` points; see `Global`."""

    levels: int

    COLUMNS: ClassVar = {
        "mu (reward per range)": "mu",
        "mu* (reward per range)": "mu_star",
        "mu* ±": "mu_star_half",
        "sigma (reward per range)": "sigma",
        "sigma ±": "sigma_half",
    }
    LARGEST, POINTS = "mu_star", 1
    picture = "exact_mdp.analysis.plots.sensitivity:plot_morris"


class _Design:
    """A model, the parameters that vary over ranges, and where SALib's draws start from."""

    def __init__(
        self,
        model: Scenario | MDP | Parametric,
        names: Iterable[str] | None,
        ranges: Mapping[str, object] | None,
        relative: Fraction | None,
        n: int,
        confidence: float,
        rng: RNG,
    ) -> None:
        if not 0 < confidence < 1:
            raise ModelError(
                f"a confidence of {confidence}", where="confidence", fix="choose one from 0 to 1"
            )
        self.model, self.n, self.confidence = parametric(model), n, confidence
        self.spans = spans_of(self.model, None if names is None else list(names), ranges, relative)
        self.problem, self.seed = problem_of(self.spans), seed_of(rng)

    def draws(self, sample: Callable[..., Floats], **settings: Any) -> Floats:
        """Return (D, P) draws by a sampling method of SALib."""
        drawn = sample(self.problem, self.n, seed=self.whole_seed(0), **settings)
        return inside(drawn, self.spans)

    def whole_seed(self, number: int) -> int:
        """Return the seed of a child, never 0, which SALib takes for none at all."""
        # Below 2**31, as np.random.seed takes it.
        return int(child(self.seed, number).generate_state(1)[0] >> 1) + 1

    def result(self, found: Sampled, measure: Callable[[Floats], Any]) -> dict[str, Any]:
        """Return the fields of a result, with the measures of each output (D,)."""
        every = found.optimal, found.fixed[:, 0], found.regret[:, 0]
        return {
            "parameters": tuple(self.spans),
            "ranges": {parameter.name: span for parameter, span in self.spans.items()},
            "n": self.n,
            "confidence": self.confidence,
            "seed": self.seed,
            **{name: measure(output) for name, output in zip(OUTPUTS, every, strict=True)},
        }


def sobol(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: Fraction | None = None,
    n: int = 1024,
    rng: RNG,
    confidence: float = 0.95,
    **how: Unpack[How],
) -> Sobol:
    """Return first-order and total Sobol indices over the ranges of parameters.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        The policy whose regret is decomposed; "optimal" is the optimum at today's values.
    names : iterable of str, optional
    ranges : {name: (low, high)}, optional
    relative : Fraction, optional
        As for `analysis.sensitivity.one_way.tornado`: today's value ± 20 % unless given. Parameters
        that are 0 today are left out unless a range is stated, the discount unless it is named.
    n : int
        A power of 2; the model is solved at n (P + 2) points.
    rng : int or numpy.random.Generator
        0 is a seed like any other.
    confidence : float
        Of the bootstrap intervals.
    **how
        n_jobs, scheduler, folder and progress; see `solvers.parallel.many.many`.

    Returns
    -------
    Sobol

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
    >>> found = sobol(model, ranges={"p": (0, 1), "q": (0, 1)}, n=64, rng=0)
    >>> found.names, found.draws, (found.optimal.total > found.optimal.first).tolist()
    (('p', 'q'), 256, [True, True])
    """
    design = _Design(model, names, ranges, relative, n, confidence, rng)
    _check_count(n, "samples", "sobol")
    if n & (n - 1):
        near = 1 << (n.bit_length() - 1)
        raise ModelError(
            f"{n} samples, not a power of 2, of which Sobol sequences are made",
            where="sobol",
            fix=f"ask for {near} or {2 * near}",
        )
    draws = design.draws(sobol_sample.sample, calc_second_order=False)
    found = sampled(design.model, design.problem["names"], draws, [policy], **how)

    def indices(output: Floats) -> Indices:
        points = output.reshape(n, -1)[:, [0, -1]]  # the two independent samples
        mean, sd = float(points.mean()), float(points.std(ddof=1))
        if np.ptp(output) <= found.noise:
            nan = np.full(len(design.spans), np.nan)
            return Indices(mean=mean, sd=0.0, first=nan, first_half=nan, total=nan, total_half=nan)
        result = sobol_analyze.analyze(
            design.problem,
            output,
            calc_second_order=False,
            num_resamples=SOBOL_RESAMPLES,
            conf_level=confidence,
            seed=design.whole_seed(1),
        )
        return Indices(
            mean=mean,
            sd=sd,
            first=result["S1"],
            first_half=result["S1_conf"],
            total=result["ST"],
            total_half=result["ST_conf"],
        )

    return Sobol(**design.result(found, indices))


def morris(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    ranges: Mapping[str, object] | None = None,
    relative: Fraction | None = None,
    n: int = 64,
    levels: int = 4,
    rng: RNG,
    confidence: float = 0.95,
    **how: Unpack[How],
) -> Morris:
    """Return elementary effects over the ranges of parameters.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy, names, ranges, relative, rng, confidence, **how
        See `sobol`.
    n : int
        Trajectories; the model is solved at n (P + 1) points.
    levels : int
        Points of the grid along a range, an even number.

    Returns
    -------
    Morris

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
    >>> found = morris(model, ranges={"p": (0, 1)}, n=8, rng=0)
    >>> found.optimal.mu_star.round(9).tolist(), found.optimal.sigma.round(9).tolist()
    ([4.0], [0.0])
    """
    design = _Design(model, names, ranges, relative, n, confidence, rng)
    _check_count(n, "trajectories", "morris")
    _check_count(levels, "levels", "morris")
    if levels % 2:
        raise ModelError(f"{levels} levels", where="morris", fix="choose an even number")
    draws = design.draws(morris_sample.sample, num_levels=levels)
    found = sampled(design.model, design.problem["names"], draws, [policy], **how)
    low, high = np.array(design.problem["bounds"]).T
    unit = ((draws - low) / (high - low)).reshape(n, -1, len(design.spans))

    def effects(output: Floats) -> Effects:
        result = morris_analyze.analyze(
            design.problem,
            draws,
            output,
            num_levels=levels,
            num_resamples=MORRIS_RESAMPLES,
            conf_level=confidence,
            seed=design.whole_seed(1),
        )
        each = _effects(unit, output.reshape(n, -1))
        picks = default_rng(child(design.seed, 2)).integers(n, size=(MORRIS_RESAMPLES, n))
        spread = np.array([each[pick].std(axis=0, ddof=1) for pick in picks])
        return Effects(
            mu=np.asarray(result["mu"], dtype=float),
            mu_star=np.asarray(result["mu_star"], dtype=float),
            mu_star_half=np.asarray(result["mu_star_conf"], dtype=float),
            sigma=np.asarray(result["sigma"], dtype=float),
            sigma_half=NormalDist().inv_cdf(0.5 + confidence / 2) * spread.std(axis=0, ddof=1),
        )

    return Morris(**design.result(found, effects), levels=levels)


def _check_count(count: object, what: str, where: str) -> None:
    if isinstance(count, bool) or not isinstance(count, int) or count < 2:
        raise ModelError(f"{count!r} {what}", where=where, fix="ask for at least 2")


def _effects(unit: Floats, output: Floats) -> Floats:
    """Return (n, P) elementary effects: unit (n, P + 1, P) points in [0, 1], output (n, P + 1)."""
    step = np.diff(unit, axis=1)
    moved = np.abs(step).argmax(axis=2)  # (n, P) which parameter each step moves
    size = np.take_along_axis(step, moved[:, :, None], axis=2)[:, :, 0]
    effects = np.empty(moved.shape)
    np.put_along_axis(effects, moved, np.diff(output, axis=1) / size, axis=1)
    return effects


def problem_of(spans: Mapping[Parameter, Range]) -> dict[str, Any]:
    """Return the parameters and ranges as SALib states a problem."""
    return {
        "num_vars": len(spans),
        "names": [parameter.name for parameter in spans],
        "bounds": [[float(span.low), float(span.high)] for span in spans.values()],
    }


def inside(draws: Floats, spans: Mapping[Parameter, Range]) -> Floats:
    """Return draws of which rounding has pushed none beyond the end of its range.

    SALib computes low + u (high - low), which may exceed high by a few units in the last place.
    """
    low = np.array([float(span.low) for span in spans.values()])
    high = np.array([float(span.high) for span in spans.values()])
    slack = 1e-12 * (1 + np.abs(low) + np.abs(high))
    assert ((draws >= low - slack) & (draws <= high + slack)).all()
    return np.clip(draws, low, high)
