"""Distributions of uncertain parameters: by mean and spread, by their own numbers, or a sample.

A parameter, or all parameters with a common beginning of their names, has one of these
distributions:

    beta          mean with effective_sample_size n, or sd, or relative_sd; or alpha, beta
    dirichlet     the probabilities of one row: effective_sample_size n; or alpha, a list
    gamma         mean with sd or relative_sd; or shape, scale; a negative mean keeps its sign
    lognormal     mean with sd or relative_sd; or meanlog, sdlog
    normal        mean with sd or relative_sd
    uniform       mean with sd or relative_sd; or low, high
    triangular    mean with sd or relative_sd, symmetric; or low, mode, high

Parameters that are jointly normal are listed as `names` beside a `covariance`, the rows of a
positive definite matrix, and perhaps a list `mean`; if they are `lognormal` that is the covariance
of their logarithms, beside a list `meanlog`.

`se`, the standard error of an estimate, may stand for sd, and a gamma's rate for 1/scale. In place
of all numbers, `interval = [low, high]` gives the 95 % interval (not of a triangular distribution).
The mean is today's value by default. Without a named distribution, a probability (from 0 to 1) is
beta, a number that may not be negative is gamma, and any other number is normal. A probability with
mean m that rests on n observations is Beta(m n, (1 - m) n), of variance m (1 - m) / (n + 1);
probabilities of one row are Dirichlet with the same n (Briggs, Weinstein, Fenwick et al., Medical
Decision Making 32, 2012). Probabilities for which nothing is stated rest on 100 observations; other
parameters for which nothing is stated, and the discount, do not vary. A TOML file:

    [default]
    effective_sample_size = 100

    [base]                                 # every parameter whose name begins so
    effective_sample_size = 40

    ["cost.sick"]
    distribution = "gamma"
    mean = 4000
    sd = 500

    [influence]
    fixed = true

    [regression]                           # a name for both together
    names = ["log.shape", "log.rate"]
    covariance = [[0.04, 0.01], [0.01, 0.09]]

Every part draws from a random stream of its own, seeded by its name, so that adding a part does not
change the draws of the others. Correlated parameters may also be given as a table of draws, with a
column for each; [table, settings] gives the others their distributions.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self, TypeAlias
from zlib import crc32

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.vary.interval_fits import (
    fit_beta,
    fit_gamma,
    fit_lognormal,
    fit_normal,
    fit_uniform,
)
from exact_mdp.analysis.vary.ranges import flatten_entries, is_probability, read_points, unit_of
from exact_mdp.mdp.errors import (
    ModelError,
    check_names,
    locate_errors,
    once_each,
    require_known_name,
    require_list,
    suggest_name,
)
from exact_mdp.mdp.forms.numbers import float_array
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Family, Parametric, moving, parameter_of, parametric
from exact_mdp.mdp.parametric.family import pose_questions
from exact_mdp.mdp.questions.horizon import repeats_in_time
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.result import Brief, DataFrame
from exact_mdp.mdp.table import Floats, float_of

Numbers = tuple[float, ...]
Settings = Mapping[str, object]

# The default effective sample size of probabilities: an assumption, which results name.
EFFECTIVE_SAMPLE_SIZE = 100.0
SIZE, SPREAD, DEFAULT = "effective_sample_size", "relative_sd", "default"
WITHIN = {  # ranges in which draws in floating point are sound
    SIZE: ("effective sample size", 1e-6, 1e15),
    SPREAD: ("relative standard deviation", 1e-9, 1e3),
    "sd": ("standard deviation", 1e-9, 1e3),  # times the mean
}
SAMPLE = "a sample as a pandas.DataFrame: a column for each parameter, a row for each draw"
MOST_ROWS = 2000  # random rows of a model; a draw of so many takes half a second


def _fit_beta(mean: float, size: float) -> Numbers:
    return mean * size, (1 - mean) * size


def _fit_lognormal(mean: float, sd: float) -> Numbers:
    if mean <= 0:
        return math.nan, math.nan
    square = math.log1p((sd / mean) ** 2)
    return math.log(mean) - square / 2, math.sqrt(square)


@dataclass(frozen=True)
class Kind:
    """A family of distributions, described by its own numbers or by mean and sd."""

    own: tuple[str, ...]  # names of its own numbers
    sound: Callable[..., bool]  # whether such numbers make a distribution
    moments: Callable[..., Numbers]  # from its own numbers to mean and sd
    of_moments: Callable[[float, float], Numbers]  # from mean and sd to its own numbers
    needs: str  # the condition, in words


KINDS = {
    "beta": Kind(
        ("alpha", "beta"),
        lambda a, b: a > 0 and b > 0,
        lambda a, b: (a / (a + b), math.sqrt(a * b / (a + b + 1)) / (a + b)),
        lambda mean, sd: _fit_beta(mean, mean * (1 - mean) / sd**2 - 1),
        "a mean between 0 and 1 and an sd that is small enough; or alpha and beta above 0",
    ),
    "gamma": Kind(
        ("shape", "scale"),
        lambda shape, scale: shape > 0 and scale != 0,
        lambda shape, scale: (shape * scale, math.sqrt(shape) * abs(scale)),
        lambda mean, sd: ((mean / sd) ** 2, sd**2 / mean if mean else 0.0),
        "a mean that is not 0; or a shape above 0 and a scale that is not 0",
    ),
    "lognormal": Kind(
        ("meanlog", "sdlog"),
        lambda mean, sd: sd > 0,
        lambda log, spread: (
            (mean := math.exp(log + spread * spread / 2)),
            mean * math.sqrt(math.expm1(spread * spread)),
        ),
        _fit_lognormal,
        "a mean above 0; or an sdlog above 0",
    ),
    "normal": Kind(
        ("mean", "sd"),
        lambda mean, sd: sd > 0,
        lambda *numbers: numbers,
        lambda *numbers: numbers,
        "a mean and an sd",
    ),
    "uniform": Kind(
        ("low", "high"),
        lambda low, high: low < high,
        lambda low, high: ((low + high) / 2, (high - low) / math.sqrt(12)),
        lambda mean, sd: (mean - sd * math.sqrt(3), mean + sd * math.sqrt(3)),
        "low below high",
    ),
    "triangular": Kind(
        ("low", "mode", "high"),
        lambda low, mode, high: low <= mode <= high and low < high,
        lambda low, mode, high: (
            (low + mode + high) / 3,
            math.hypot(low - mode, mode - high, low - high) / 6,
        ),
        lambda mean, sd: (mean - sd * math.sqrt(6), mean, mean + sd * math.sqrt(6)),
        "low below high, and the mode from low to high",
    ),
}
EVERY = (*KINDS, "dirichlet")
MOMENTS = ("mean", "sd", SPREAD, SIZE)
NUMBERS = {*MOMENTS}.union(*(kind.own for kind in KINDS.values()))
INTERVAL = "interval"
INTERVALS = {
    "normal": fit_normal,
    "lognormal": fit_lognormal,
    "uniform": fit_uniform,
    "gamma": fit_gamma,
    "beta": fit_beta,
}
"""The functions of a 95 % interval that give a distribution's own numbers."""
NAMES, COVARIANCE = "names", "covariance"
JOINT = {"normal": "mean", "lognormal": "meanlog"}
"""The joint distributions of several parameters, and the name of their list of means."""
SETTINGS = (*sorted(NUMBERS), COVARIANCE, "distribution", "fixed", INTERVAL, NAMES, "se", "rate")
ELSEWHERE = {  # other names of settings and distributions, each with the remedy
    "sem": "state sd, or se: the standard error of an estimate",
    "std": "state sd",
    "variance": "state sd, its square root",
    "n": f"state {SIZE}",
    "multinomial": 'the probabilities of a row are a "dirichlet"',
    "binomial": 'a probability is a "beta"',
    "bernoulli": 'a probability is a "beta"',
    "exponential": 'state a "gamma" of shape 1',
}


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """The distribution of one parameter, or the joint one of several.

    Attributes
    ----------
    names : tuple of k str
        One name, or several; for a Dirichlet the named probabilities of a row, without the
        remaining one.
    kind : str
        A distribution, or "sample".
    numbers : tuple of float
        Its own numbers, in the order of `KINDS`; for a Dirichlet k + 1 concentrations; of several
        parameters k means, then the covariance (k, k) row by row.
    mean, sd : tuple of k float
    label : str
    """

    names: tuple[str, ...]  # (k,)
    kind: str
    numbers: Numbers
    mean: Numbers  # (k,)
    sd: Numbers
    label: str

    @classmethod
    def of(cls, name: str, kind: str, **said: float) -> Uncertain:
        """Return the distribution of a parameter by its mean and spread, or by its own numbers.

        Parameters
        ----------
        name : str
            The parameter.
        kind : str
            The distribution.
        **said
            The numbers, as listed at the top of `analysis.vary.distributions`.

        Returns
        -------
        Uncertain

        Examples
        --------
        >>> Uncertain.of("p", "beta", mean=0.25, effective_sample_size=19).numbers
        (4.75, 14.25)
        """
        where = f"distribution of {name}"
        family = KINDS[require_known_name(kind, KINDS, "distribution", where)]
        # A normal distribution's own numbers are its moments.
        if kind != "normal" and set(said) == {*family.own}:
            numbers = tuple(said[name] for name in family.own)
        else:
            numbers = _of_moments(kind, said, where)
        if not (all(map(math.isfinite, numbers)) and family.sound(*numbers)):
            stated = ", ".join(f"{each} = {number:g}" for each, number in said.items())
            raise ModelError(f"a {kind} with {stated}", where=where, fix=f"give {family.needs}")
        # Moments that were given are kept as they are, without the rounding of a conversion.
        mean, sd = family.moments(*numbers)
        mean = said.get("mean", mean)
        if "sd" in said:
            sd = said["sd"]
        elif SPREAD in said:
            sd = abs(mean) * said[SPREAD]
        return cls(names=(name,), kind=kind, numbers=numbers, mean=(mean,), sd=(sd,), label=name)

    @classmethod
    def of_interval(cls, name: str, kind: str, low: float, high: float) -> Uncertain:
        """Return the distribution of a parameter whose 95 % interval is from low to high.

        Parameters
        ----------
        name, kind : str
            The parameter, and its distribution.
        low, high : float

        Returns
        -------
        Uncertain

        Raises
        ------
        ModelError
            If no distribution of this kind has the interval.

        Examples
        --------
        >>> Uncertain.of_interval("relative risk", "lognormal", 0.5, 0.72).numbers[1].__round__(3)
        0.093
        """
        where = f"distribution of {name}"
        fit = INTERVALS.get(require_known_name(kind, KINDS, "distribution", where))
        numbers: Numbers = (math.nan,)
        if fit is not None and math.isfinite(low) and low < high < math.inf:
            numbers = fit(low, high)
        if not all(map(math.isfinite, numbers)):
            fix = "give [low, high] within the range of a "
            fix += ", ".join(INTERVALS)
            what = f"no {kind} has the 95 % interval from {low!r} to {high!r}"
            raise ModelError(what, where=where, fix=fix)
        return cls.of(name, kind, **dict(zip(KINDS[kind].own, numbers, strict=True)))

    @classmethod
    def of_row(cls, label: str, names: Sequence[str], counts: Sequence[float]) -> Uncertain:
        """Return the Dirichlet distribution of the named probabilities of a row.

        Parameters
        ----------
        label : str
            The row.
        names : sequence of k str
        counts : sequence of k + 1 numbers
            The concentrations; the last one is for the remaining probability.

        Returns
        -------
        Uncertain

        Examples
        --------
        >>> Uncertain.of_row("from ill", ["recover", "die"], [3, 1, 6]).mean
        (0.3, 0.1)
        """
        where, row, (_, least, most) = f"distribution of {label}", tuple(names), WITHIN[SIZE]
        if len(counts) != len(names) + 1:
            raise ModelError(
                f"{len(counts)} concentrations for {len(names)} probabilities and the remaining "
                "one",
                where=where,
                fix="give one for each, and one more for the remaining probability of the row",
            )
        if not all(count > 0 and least <= sum(counts) <= most for count in counts):
            what = f"concentrations {', '.join(f'{count:g}' for count in counts)}"
            fix = "name probabilities above 0 whose sum is below 1"
            raise ModelError(what, where=where, fix=fix)
        size, numbers = math.fsum(counts), tuple(counts)
        mean = tuple(count / size for count in counts[:-1])
        sd = tuple(math.sqrt(m * (1 - m) / (size + 1)) for m in mean)
        return cls(names=row, kind="dirichlet", numbers=numbers, mean=mean, sd=sd, label=label)

    @classmethod
    def of_joint(
        cls, label: str, names: Sequence[str], kind: str, mean: object, covariance: object
    ) -> Uncertain:
        """Return the normal or lognormal distribution of several parameters together.

        Parameters
        ----------
        label : str
            The name of the distribution.
        names : sequence of k str
        kind : "normal" or "lognormal"
        mean, covariance : (k,) and (k, k) numbers
            Of the parameters, or of their logarithms.

        Returns
        -------
        Uncertain

        Raises
        ------
        ModelError
            If the covariance is not symmetric and positive definite.

        Examples
        --------
        >>> Uncertain.of_joint("fit", ["a", "b"], "normal", [1, 2], [[4, 1], [1, 9]]).sd
        (2.0, 3.0)
        """
        where, count = f"distribution of {label}", len(names)
        middle, square = float_array(mean, where), float_array(covariance, where)
        if (middle.shape, square.shape) != ((count,), (count, count)):
            what = f"means of shape {middle.shape}, and a covariance of shape {square.shape}"
            fix = f"give {count} means, and {count} rows of {count} numbers"
            raise ModelError(what, where=where, fix=fix)
        unlike = np.argwhere(~(square == square.T))
        if len(unlike):
            one, other = names[unlike[0][0]], names[unlike[0][1]]
            what = f"two covariances of {one} and {other}" if one != other else "not a variance"
            raise ModelError(what, where=where, fix="give a symmetric covariance")
        _factor_covariance(square, where)
        variance = square.diagonal()
        mean, sd = middle, np.sqrt(variance)
        if kind == "lognormal":
            with np.errstate(over="ignore"):  # refused below
                mean = np.exp(middle + variance / 2)
                sd = mean * np.sqrt(np.expm1(variance))
        if not (np.isfinite(mean).all() and np.isfinite(sd).all()):
            raise ModelError("a mean or sd is infinite", where=where, fix="give smaller numbers")
        moments: Any = {"mean": tuple(mean.tolist()), "sd": tuple(sd.tolist())}
        numbers = (*middle.tolist(), *square.ravel().tolist())
        return cls(names=tuple(names), kind=kind, numbers=numbers, label=label, **moments)

    @property
    def size(self) -> float | None:
        """Effective sample size of a beta or Dirichlet; for one parameter the relative spread."""
        if self.kind in ("beta", "dirichlet"):
            return math.fsum(self.numbers)
        if len(self.names) > 1 or not self.mean[0]:
            return None
        return self.sd[0] / abs(self.mean[0])

    def draw(self, sequence: SeedSequence, count: int) -> Floats:
        """Return the draws (count, k); the same seed gives the same draws."""
        # The stream depends on the seed and on the names, not on other parts.
        own = (*sequence.spawn_key, crc32(" ".join(self.names).encode()))
        rng = np.random.default_rng(SeedSequence(sequence.entropy, spawn_key=own))
        if self.kind == "dirichlet":
            shares: Floats = rng.dirichlet(self.numbers, size=count)[:, :-1]
            # Rounding may lift a sum above 1: scale such rows down, by twice its error bound.
            units = shares.shape[1] * 2.0**-52
            shares[shares.sum(axis=1) > 1 - units] *= 1 - 2 * units
            return shares
        if self.kind == "gamma":
            shape, scale = self.numbers
            return math.copysign(1.0, scale) * rng.gamma(shape, abs(scale), size=(count, 1))
        if (joint := len(self.names)) > 1:
            middle, square = np.split(np.array(self.numbers), [joint])
            factor = _factor_covariance(square.reshape(joint, joint), self.label)
            several = middle + rng.standard_normal((count, joint)) @ factor.T
            return np.exp(several) if self.kind == "lognormal" else several
        drawn: Floats = getattr(rng, self.kind)(*self.numbers, size=(count, 1))
        return drawn


def _factor_covariance(square: Floats, where: str) -> Floats:
    """Return the lower triangular L (k, k) with L Lᵀ = Σ; raise ModelError if there is none."""
    try:
        return np.asarray(np.linalg.cholesky(square))
    except np.linalg.LinAlgError:
        raise ModelError(
            "the covariance is not positive definite",
            where=where,
            fix="correct it; if one parameter follows from the others, leave it out, and let the "
            "function that builds the model compute it",
        ) from None


def _of_moments(kind: str, said: Mapping[str, float], where: str) -> Numbers:
    """Return the own numbers of a distribution, from its mean and one measure of spread."""
    ways = ["sd", SPREAD]
    if kind == "beta":
        ways.append(SIZE)
    spreads = [name for name in ways if name in said]
    if "mean" not in said or len(spreads) != 1 or len(said) != 2:
        fix = f"state a mean and one of {', '.join(ways)}"
        if kind != "normal":
            fix += f"; or {', '.join(KINDS[kind].own)} alone"
        raise ModelError(f"a {kind} with {', '.join(said) or 'no spread'}", where=where, fix=fix)
    mean, (spread,) = said["mean"], spreads
    if not math.isfinite(mean) or (spread == SPREAD and not mean):
        noun = "relative spread" if spread == SPREAD else "spread"
        what = f"a {noun} around {mean:g}"
        raise ModelError(what, where=where, fix="state a finite mean, and around 0 an sd")
    if spread == SIZE:
        return _fit_beta(mean, _check_within(said[SIZE], SIZE, where))
    # Limits of an sd are relative to the mean, or to 1 if the mean is 0.
    scale = abs(mean or 1.0)
    if spread == "sd":
        sd = _check_within(said["sd"], "sd", where, unit=scale)
    else:
        sd = _check_within(said[SPREAD], SPREAD, where) * scale
    return KINDS[kind].of_moments(mean, sd)


def _check_within(value: float, what: str, where: str, unit: float = 1.0) -> float:
    """Return a spread or sample size; raise ModelError if it is outside the range in `WITHIN`."""
    words, low, high = WITHIN[what]
    if not low * unit <= value <= high * unit:
        fix = f"choose a number above 0, from {low * unit:g} to {high * unit:g}"
        raise ModelError(f"{words} {value!r}", where=where, fix=fix)
    return value


@dataclass(frozen=True, kw_only=True, repr=False)
class Uncertainty(Brief):
    """The parameters that are drawn, with their distributions, and the parameters that are fixed.

    Attributes
    ----------
    parts : tuple of Uncertain
    fixed : {parameter name: reason}
    sample : (D, K) or None
        A given sample of the first K parameters in `names`.
    default : float
        Effective sample size of probabilities for which nothing is stated.
    assumed : tuple of str
        Labels of the parts for which nothing is stated, which rest on that size.
    """

    parts: tuple[Uncertain, ...]
    fixed: Mapping[str, str]
    sample: Floats | None = None
    default: float = EFFECTIVE_SAMPLE_SIZE
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_names(self.names, "drawn parameter", where="uncertainty")

    @classmethod
    def of_sample(
        cls, names: Sequence[str], sample: Floats, fixed: Mapping[str, str] = MappingProxyType({})
    ) -> Self:
        """Return the uncertainty of a given sample.

        Parameters
        ----------
        names : sequence of Q str
        sample : (D, Q) floats
        fixed : {parameter name: reason}, optional

        Returns
        -------
        Uncertainty

        Examples
        --------
        >>> Uncertainty.of_sample(["p"], np.array([[0.1], [0.3]])).parts[0].mean
        (0.2,)
        """
        spread = np.zeros(len(names))
        if len(sample) > 1:
            spread = sample.std(axis=0, ddof=1)
        parts = []
        for n, m, s in zip(names, sample.mean(axis=0).tolist(), spread.tolist(), strict=True):
            moments: Any = {"mean": (m,), "sd": (s,)}
            parts.append(Uncertain(names=(n,), kind="sample", numbers=(), label=n, **moments))
        return cls(parts=tuple(parts), fixed=fixed, sample=sample)

    @property
    def names(self) -> tuple[str, ...]:
        """The Q parameters that are drawn, in the order of the draws' columns."""
        names: list[str] = []
        for part in self.parts:
            names += part.names
        return tuple(names)

    @property
    def assumption(self) -> str:
        """The assumption on parts for which nothing is stated, in words; empty without any."""
        if not self.assumed:
            return ""
        return (
            f"{len(self.assumed):,} of {len(self.parts):,} distributions are not stated, and rest "
            f"on {self.default:g} observations each"
        )

    def draw(self, sequence: SeedSequence, count: int) -> Floats:
        """Return the draws (count, Q - K) of the parameters that are not in the sample."""
        drawn = [part.draw(sequence, count) for part in self.parts if part.kind != "sample"]
        return np.hstack([np.empty((count, 0)), *drawn])


Stated: TypeAlias = "Mapping[str, Settings] | DataFrame | Uncertainty | str | Path | Sequence[Any]"
"""Distributions by name, a sample, the .toml file of distributions, or [sample, distributions]."""


def uncertainty(
    model: Parametric,
    stated: Stated | None = None,
    *,
    default: float | None = None,
    names: Sequence[str] | None = None,
) -> Uncertainty:
    """Return the uncertainty of a model's parameters.

    Parameters
    ----------
    model : Parametric
        Parameters that share one of its `rows` are Dirichlet, instead of a Beta for each.
    stated : {name, beginning of names, or label of a row: settings}, DataFrame or file
        Settings describe a distribution, as at the top of `analysis.vary.distributions`, or are
        `fixed = True`. The longest beginning counts: `influence.anger` before `influence`. Settings
        must be the same for all entries of a row. Settings with a covariance have a name of their
        own and list their parameters as `names`. A table is a sample of your own, with a column
        for each parameter that is drawn and a row for each draw. Or the name of a .toml file of
        settings; or [table, settings], where the settings are of parameters without a column.
    default : float, optional
        Effective sample size of every probability for which nothing is stated; by default the
        file's, or 100.
    names : sequence of str, optional
        Draw only these: parameters, or labels of rows.

    Returns
    -------
    Uncertainty

    Raises
    ------
    ModelError
        For unknown names and settings, and for numbers without a distribution.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import Family
    >>> cost = Parameter(name="cost", value="4000", low=0)
    >>> model = Family(parameters=(cost,), build=lambda at: MDP.from_arrays([[[1]]], [0], 0))
    >>> (part,) = uncertainty(model, {"cost": {"relative_sd": 0.1}}).parts
    >>> part.kind, part.mean, part.sd
    ('gamma', (4000.0,), (400.0,))
    """
    if isinstance(stated, Uncertainty):
        return stated
    model = parametric(model)
    if isinstance(stated, str | Path):
        said, own = _read_distributions(stated)
        if default is None:
            default = own
        with locate_errors(str(stated)):
            return uncertainty(model, said, default=default, names=names)
    if isinstance(stated, list | tuple) and any(hasattr(each, "columns") for each in stated):
        return _of_both(model, stated, default)
    if stated is not None and not isinstance(stated, Mapping):
        return _of_sample(model, stated)

    # 1. Check the settings, and that each name is a parameter, a beginning or a row.
    stated = {name: _check_settings(name, settings) for name, settings in (stated or {}).items()}
    given = EFFECTIVE_SAMPLE_SIZE
    if default is not None:
        given = _parse_number(default, "default", DEFAULT)
    size = _check_within(given, SIZE, DEFAULT)
    parameters = {parameter.name: parameter for parameter in model.parameters}
    rows = {label: tuple(row) for label, row in getattr(model, "rows", {}).items()}
    for name, settings in stated.items():
        if NAMES in settings:
            if name in rows or name in parameters:
                what, fix = "a row or a parameter has this name", "name the several differently"
                raise ModelError(what, where=f"distribution of {name}", fix=fix)
            several: Any = settings[NAMES]
            rows[name] = tuple(require_list(several, NAMES))
            if len(rows[name]) < 2:
                fix = f"name two or more; one has an sd, without {COVARIANCE}"
                raise ModelError("too few names", where=f"distribution of {name}", fix=fix)
        if name not in rows and not any(_has_prefix(known, name) for known in parameters):
            parameter_of(model, name)
    with locate_errors("rows"):
        labelled = []
        for label, row in rows.items():
            labelled += [(parameter_of(model, name).name, label) for name in row]
        label_of = once_each(labelled)

    # 2. The parameters to draw.
    asked = [*parameters] if names is None else require_list(names, "names")
    chosen = set[str]()
    for name in asked:
        chosen.update(rows.get(name) or [parameter_of(model, name).name])

    # 3. For each row, and each parameter outside of rows, a distribution or a reason to fix it.
    parts, fixed, assumed = list[Uncertain](), dict[str, str](), list[str]()
    for label in dict.fromkeys(label_of.get(name, name) for name in parameters):
        members = rows.get(label, (label,))
        some = [name for name in members if name in chosen]
        if 0 < len(some) < len(members):
            what = f"{some[0]} is asked for without the others of {label}"
            fix = f"name {label}: its parameters are drawn together"
            raise ModelError(what, where="names", fix=fix)
        settings = _find_settings(label, members, stated) if some else {}
        if not some:
            part: Uncertain | str = "not among the names asked for"
        elif settings.get("fixed"):
            part = "stated to be fixed"
        elif NAMES in settings:
            part = _read_joint_distribution([parameters[n] for n in members], label, settings)
        elif label in rows:
            part = _read_row_distribution(
                [parameters[name] for name in members], label, settings, size
            )
        else:
            part = _read_parameter_distribution(parameters[label], settings, size)
        if isinstance(part, str):
            fixed |= dict.fromkeys(members, part)
            continue
        parts.append(part)
        if not set(settings) - {"distribution"}:
            assumed.append(label)
    return Uncertainty(parts=tuple(parts), fixed=fixed, default=size, assumed=tuple(assumed))


def _of_both(model: Parametric, given: Sequence[Any], default: float | None) -> Uncertainty:
    """Return the uncertainty of a table of some parameters, and settings of others."""
    tables = [each for each in given if hasattr(each, "columns")]
    said = [each for each in given if not hasattr(each, "columns")]
    if len(tables) != 1 or len(said) != 1:
        fix = "give [table, {name: settings}]: one table and the settings of other parameters"
        raise ModelError(f"{len(given)} things are given", where="uncertain", fix=fix)
    sampled = _of_sample(model, tables[0])
    others = [p.name for p in model.parameters if p.name not in sampled.names]
    if isinstance(said[0], Mapping):
        for name in said[0]:
            if name in sampled.names:
                fix = "leave it out of one of the two"
                raise ModelError("a column, and settings", where=f"parameter {name}", fix=fix)
    rest = uncertainty(model, said[0], default=default, names=others)
    fixed = {name: why for name, why in rest.fixed.items() if name not in sampled.names}
    return replace(rest, parts=(*sampled.parts, *rest.parts), fixed=fixed, sample=sampled.sample)


def _of_sample(model: Parametric, frame: Any) -> Uncertainty:
    """Return the uncertainty of a given sample, a table with a column for each parameter."""
    if not hasattr(frame, "columns"):
        fix = f"give {{name: settings}}, or {SAMPLE}"
        raise ModelError(f"{type(frame).__name__} is given", where="uncertain", fix=fix)
    names = tuple(frame.columns)
    fixed = {p.name: "not in the sample" for p in model.parameters if p.name not in names}
    return Uncertainty.of_sample(names, read_points(model, frame).astype(float), fixed)


def _read_parameter_distribution(
    parameter: Parameter, settings: Settings, default: float
) -> Uncertain | str:
    """Return the distribution of one parameter, or the reason why it is not drawn."""
    name, today, (low, high) = parameter.name, float(parameter.value), parameter.limits
    if not settings and not is_probability(parameter):
        if name == DISCOUNT:
            return "the discount is held unless stated otherwise"
        if unit_of(parameter) == "reward":
            return "reward weights are held unless stated otherwise"
        return f"{unit_of(parameter)}s are held unless stated otherwise"

    # The distribution that suits the parameter's limits, unless one is named.
    if low == 0 and high == 1:
        usual = "beta"
    elif low < 0:
        usual = "normal"
    else:
        usual = "gamma"
    kind = str(settings.get("distribution", usual))
    said = {key: _parse_number(settings[key], key, name) for key in settings if key in NUMBERS}
    if INTERVAL in settings:
        ends: Any = settings[INTERVAL]
        if said or not isinstance(ends, list | tuple) or len(ends) != 2:
            what = f"an interval {ends!r:.60}"
            if said:
                what += f" beside {' and '.join(said)}"
            fix = "write interval = [low, high] alone: it states the whole distribution"
            raise ModelError(what, where=f"parameter {name}", fix=fix)
        return Uncertain.of_interval(name, kind, *(_parse_number(x, INTERVAL, name) for x in ends))
    if not said and kind == "beta":
        said = {SIZE: default}

    # A spread alone is around today's value; a relative one cannot be around 0.
    if not set(said) - set(MOMENTS) and "mean" not in said:
        edges = (0, 1) if kind == "beta" else (0,)
        if "sd" not in said and today in edges:
            Uncertain.of(name, kind, mean=0.5, **said)  # only to check the settings
            return f"{today:g} today"
        said = {"mean": today} | said
    part = Uncertain.of(name, kind, **said)
    least, most = part.numbers[0], part.numbers[-1]
    if kind in ("uniform", "triangular") and (least < low or most > high):
        what = f"a {kind} from {least:g} to {most:g}, outside the parameter's limits"
        raise ModelError(what, where=f"distribution of {name}", fix="choose one within them")
    return part


def _read_row_distribution(
    row: Sequence[Parameter], label: str, settings: Settings, default: float
) -> Uncertain:
    """Return the joint distribution of a row's probabilities."""
    names, where = [p.name for p in row], f"row {label}"
    for parameter in row:
        if not is_probability(parameter):
            what = f"{parameter.name} is not a probability of a row"
            fix = "name all but one of its probabilities, each a Parameter(…, low=0, high=1)"
            raise ModelError(what, where=where, fix=fix)
    usual = settings.get("distribution", "dirichlet") == "dirichlet"
    if not usual or set(settings) - {"distribution", "alpha", SIZE}:
        fix = f"state its {SIZE}, or alpha, a list of one more than its parameters"
        raise ModelError("probabilities of a row are Dirichlet", where=where, fix=fix)
    if "alpha" in settings:
        alpha: Any = settings["alpha"]
        if not isinstance(alpha, list | tuple):
            raise ModelError(f"alpha is {alpha!r:.60}", where=where, fix="give a list of numbers")
        return Uncertain.of_row(label, names, [_parse_number(x, "alpha", label) for x in alpha])
    size = _check_within(_parse_number(settings.get(SIZE, default), SIZE, label), SIZE, where)
    means = [float(parameter.value) for parameter in row]
    return Uncertain.of_row(label, names, [size * m for m in (*means, 1.0 - math.fsum(means))])


def _read_joint_distribution(
    several: Sequence[Parameter], label: str, settings: Settings
) -> Uncertain:
    """Return the distribution of several parameters by their covariance."""
    where, kind = f"distribution of {label}", str(settings.get("distribution", "normal"))
    own = JOINT[require_known_name(kind, JOINT, "joint distribution", where)]
    others = sorted({*settings} - {"distribution", NAMES, COVARIANCE, own})
    if others:
        fix = f"state {NAMES}, {COVARIANCE}, and perhaps {own}, a list"
        raise ModelError(f"{others[0]} beside a covariance", where=where, fix=fix)
    if own == "meanlog" and own not in settings:
        fix = "state meanlog, the means of the logarithms"
        raise ModelError("a lognormal covariance without means", where=where, fix=fix)
    mean = settings.get(own, [parameter.value for parameter in several])
    names = [parameter.name for parameter in several]
    return Uncertain.of_joint(label, names, kind, mean, settings[COVARIANCE])


def _has_prefix(name: str, start: str) -> bool:
    return f"{name}.".startswith(f"{start}.")


def _find_settings(label: str, names: Sequence[str], stated: Mapping[str, Settings]) -> Settings:
    """Return the settings of a part: its own, or those for the longest beginning of its names.

    Raises ModelError unless they are the same for all names.
    """
    whole = stated.get(label, {})
    said = []
    for name in names:
        starts = [start for start in stated if _has_prefix(name, start)]
        if starts:
            said.append(dict(stated[max(starts, key=len)]))
        else:
            said.append(dict(whole))
    if any(each != said[0] for each in said) or (whole and whole != said[0]):
        fix = f'they are drawn together: state the settings once, for "{label}"'
        what = f"the parameters of {label} have different settings"
        raise ModelError(what, where=f"distribution of {label}", fix=fix)
    return said[0]


def _check_settings(name: str, settings: object) -> Settings:
    """Return settings, checked; raise ModelError for unknown or contradictory ones."""
    where = f"parameter {name}"
    if not isinstance(settings, Mapping):
        fix = 'state a distribution: {"distribution": "beta", "mean": 0.1, "sd": 0.02}; or give '
        fix += SAMPLE
        raise ModelError(f"{settings!r:.60} is stated", where=where, fix=fix)
    for key in settings:
        if key not in SETTINGS:
            # The remedy: the name here, a similar name, or the list of all.
            near = suggest_name(str(key), SETTINGS)
            if not near.startswith("did you"):
                near = f"choose one of {', '.join(SETTINGS)}"
            fix = ELSEWHERE.get(str(key), near)
            raise ModelError(f"unknown setting {key!r}", where=where, fix=fix)
    fixed, kind = settings.get("fixed", False), settings.get("distribution", "normal")
    if not isinstance(fixed, bool):
        fix = "write fixed = true, or leave it out"
        raise ModelError(f"fixed is {fixed!r}", where=where, fix=fix)
    if fixed and len(settings) > 1:
        raise ModelError("fixed, and a distribution", where=where, fix="state one of the two")
    if isinstance(kind, str) and kind in ELSEWHERE:
        raise ModelError(f"unknown distribution {kind!r}", where=where, fix=ELSEWHERE[kind])
    require_known_name(kind, EVERY, "distribution", where)
    if (NAMES in settings) != (COVARIANCE in settings):
        only = NAMES if NAMES in settings else COVARIANCE
        fix = f'write {NAMES} = ["a", "b"] and {COVARIANCE} = [[…, …], […, …]]'
        raise ModelError(f"{only} alone", where=where, fix=fix)
    return _translate_settings(settings, where)


def _translate_settings(settings: Settings, where: str) -> Settings:
    """Return settings with sd in place of se, and scale in place of rate."""
    plain = dict(settings)
    for other, own in (("se", "sd"), ("rate", "scale")):
        if other not in plain:
            continue
        if own in plain:
            raise ModelError(f"{other}, and {own}", where=where, fix="state one of the two")
        plain[own] = plain.pop(other)
        if other == "rate":
            rate = float_of(plain[own], f"{where}, rate")
            plain[own] = 1 / rate if rate else math.inf
    return plain


def _parse_number(value: object, key: str, name: str) -> float:
    """Return a stated number, also "p/q"; raise ModelError if it is not a number."""
    where = f"parameter {name}"
    if isinstance(value, float) and not math.isfinite(value):
        return value
    return float_of(value, f"{where}, {key}")


def _read_distributions(path: str | Path) -> tuple[dict[str, Settings], float | None]:
    """Return the distributions in a TOML file, and the default sample size."""
    if Path(path).suffix.lower() == ".csv":
        what = "a table is not a file of distributions, which ends in .toml"
        fix = f"in Python give {SAMPLE}"
        raise ModelError(what, where=str(path), fix=fix)
    stated: dict[str, dict[str, object]] = {}
    content = toml_of(read_text(path, most=SMALL), str(path), number=float)
    for prefix, key, value in flatten_entries(content):
        if not prefix:
            fix = f'psa takes distributions: write "{key}" = {{{SIZE} = 50}}'
            raise ModelError(f"{key} = {value!r:.60}", where=str(path), fix=fix)
        stated.setdefault(prefix, {})[key] = value
    if not stated:
        fix = f'write "NAME" = {{{SIZE} = 50}}'
        raise ModelError("nothing is stated in the file", where=str(path), fix=fix)
    general = stated.pop(DEFAULT, {})
    if set(general) - {SIZE}:
        what, fix = f"[default] states more than {SIZE}", "state the rest for each parameter"
        raise ModelError(what, where=f"{path}, {DEFAULT}", fix=fix)
    if not general:
        return {**stated}, None
    return {**stated}, _parse_number(general[SIZE], SIZE, DEFAULT)


def drawn_family(model: Any) -> Parametric:
    """Return a model with the parameters to draw, for an MDP including those in its random rows."""
    if not isinstance(model, MDP):
        return parametric(model)
    origin = origin_of(model)
    if origin is None:
        return row_family(model)
    return pose_questions(row_family(origin.model), origin)


def row_family(mdp: MDP) -> Family:
    """Return any model with the probabilities of its random rows as parameters; at most 2,000 rows.

    In each row these are all but the largest, which is 1 less the others; drawn together they are
    Dirichlet. Rewards and the discount are parameters, too.
    """
    if repeats_in_time(mdp):
        raise ModelError(
            "the rows of this model are alike at every time, and may be one row that is drawn once",
            where="rows as parameters",
            fix="ask about the model before it was unrolled, and give the number of steps: "
            "model.within(20) in Python, --horizon 20 on the command line",
        )
    # Each probability of a random row but the largest is a parameter.
    entries: dict[str, list[tuple[int, str]]] = {}
    rows: dict[str, tuple[str, ...]] = {}
    labels = mdp.space.labels(range(mdp.n_states))
    for pair in range(mdp.n_pairs):
        # The exact probabilities of the next states; a row with one of them is not random.
        chance: dict[int, Fraction] = defaultdict(Fraction)
        for probability, following, _ in mdp.table.row(pair):
            chance[following] += probability
        if len(chance) < 2:
            continue
        largest = max(chance, key=lambda state: (chance[state], -state))
        state, action = int(mdp.pair_state[pair]), int(mdp.pair_action[pair])
        label = f"({labels[state]}, {mdp.actions[action]})"
        names = {s: f"{label}: to {labels[s]}" for s in sorted(chance) if s != largest}
        entries |= {name: [(pair, labels[s])] for s, name in names.items()}
        rows[label] = tuple(names.values())
    if len(rows) > MOST_ROWS:
        raise ModelError(
            f"{len(rows):,} rows of the model are random",
            where="rows as parameters",
            fix='name the parameters that matter: moving(model, {"NAME": [((state, action), next '
            "state)]}); or draw no rows: parametric(model); or take a model with at most "
            f"{MOST_ROWS:,} of them",
        )
    rewards = {p.name: p.value for p in parametric(mdp).parameters if p.name != DISCOUNT}
    return replace(moving(mdp, entries, rewards), rows=rows)
