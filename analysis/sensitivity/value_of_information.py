"""What knowing the parameters would be worth: EVPI, and EVPPI of some of them, from a sample.

With V^c(θ) the value of candidate c at a draw θ, among a finite set of candidates,

    EVPI = E[max_c V^c] - max_c E[V^c],
    EVPPI(φ) = E_φ[max_c E[V^c | φ]] - max_c E[V^c].

E[V^c | φ] is estimated by regression on φ (Strong, Oakley and Brennan, Medical Decision Making 34,
2014): least squares of V^c less the best candidate's on cubic splines, whose knots grow with the
sample, and on pairwise products where φ has several parameters. Two estimates are given.

*regression* takes the maximum of the fitted values, as they do. Noise in a maximum pulls it
upwards, by an amount that falls as 1/D, and what the regression misses pulls it downwards. It is
cut at EVPI of the same candidates and draws, above which no EVPPI can be.

*lower* uses the fitted values of four fifths of the draws only to choose the candidate in the
others, averages what those choices are worth, and takes off the largest mean that a candidate has
over all draws. For candidates that are chosen beforehand its expectation is at most EVPPI: a choice
that has not seen the draw it is judged by is worth at most E_φ[max_c E[V^c | φ]], and the largest
of some sample means is on average at least the largest mean. It may be negative.

Where both are far apart, or few draws carry the value, the estimate says so (`doubts`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from analysis.sensitivity.intervals import MeanLoss, mean_loss, mean_of
from mdp.errors import ModelError
from mdp.table import Floats
from solvers.solution import Estimated

FOLDS = 5
MOST_TERMS = 400  # columns of a regression
FEWEST = 20  # draws


@dataclass(frozen=True, kw_only=True)
class PartialInformation:
    """EVPPI of some parameters.

    Attributes
    ----------
    names : tuple of str
    regression : Estimated
        The maximum of the fitted values, at most EVPI of the same candidates.
    lower : Estimated
        What choosing by the fit is worth in other draws; in expectation at most EVPPI.
    terms : int
        Columns of the regression.
    doubts : tuple of str
        Why the regression's estimate is not to be relied on; none where it is.
    """

    names: tuple[str, ...]
    regression: Estimated
    lower: Estimated
    terms: int
    doubts: tuple[str, ...] = ()

    @property
    def reliable(self) -> bool:
        """Whether nothing speaks against the regression's estimate."""
        return not self.doubts


def evpi(values: Floats) -> MeanLoss:
    """Return the EVPI of choosing among the N candidates of values (D, N).

    The largest of the N means is taken, which pulls the estimate down by less than its standard
    error.

    Examples
    --------
    >>> found = evpi(np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0]]))
    >>> found.value
    0.25
    """
    best = int(values.mean(axis=0).argmax())
    return mean_loss(values.max(axis=1) - values[:, best])


def evppi(values: Floats, draws: Floats, names: tuple[str, ...]) -> PartialInformation:
    """Return the EVPPI of the parameters in the columns of `draws`.

    Parameters
    ----------
    values : (D, N)
        Value of each candidate in each draw.
    draws : (D, q)
        The parameters that would be known.

    Raises
    ------
    ModelError
        For fewer than 20 draws.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> known = rng.normal(size=(4000, 1))
    >>> values = np.hstack([known + rng.normal(size=known.shape), 0 * known])
    >>> found = evppi(values, known, ("x",))  # E[max(x, 0)] = 0.3989
    >>> abs(found.regression.value - 0.3989) < 4 * found.regression.standard_error
    True
    """
    count, candidates = values.shape
    if count < FEWEST:
        raise ModelError(
            f"{count} draws for a regression", where="EVPPI", fix=f"ask for at least {FEWEST}"
        )
    best = int(values.mean(axis=0).argmax())
    ahead = values - values[:, best : best + 1]
    varies = draws.min(axis=0) < draws.max(axis=0)
    if candidates == 1 or not varies.any():
        zero = Estimated(value=0.0, standard_error=0.0)
        return PartialInformation(names=names, regression=zero, lower=zero, terms=0)
    basis = _basis(draws[:, varies])
    ends = np.linspace(0, count, FOLDS + 1).astype(int)
    folds = [slice(first, last) for first, last in pairwise(ends.tolist())]
    grams = [basis[fold].T @ basis[fold] for fold in folds]
    sides = [basis[fold].T @ ahead[fold] for fold in folds]
    gram, side = np.sum(grams, axis=0), np.sum(sides, axis=0)
    fitted = basis @ _solved(gram, side)
    rows = np.arange(count)
    chosen = fitted.argmax(axis=1)
    gain = fitted[rows, chosen] - fitted[:, int(fitted.mean(axis=0).argmax())]
    most = evpi(values).value
    earned = np.empty(count)
    for k, fold in enumerate(folds):
        rule = basis[fold] @ _solved(gram - grams[k], side - sides[k])
        some = ahead[fold]
        earned[fold] = some[np.arange(len(some)), rule.argmax(axis=1)]
    regression = Estimated(
        value=min(float(gain.mean()), most),
        standard_error=mean_of(ahead[rows, chosen]).standard_error,
    )
    lower = mean_of(earned)
    return PartialInformation(
        names=names,
        regression=regression,
        lower=lower,
        terms=basis.shape[1],
        doubts=tuple(_doubts(regression, lower, mean_loss(gain), float(gain.mean()) > most)),
    )


def _doubts(regression: Estimated, lower: Estimated, gain: MeanLoss, cut: bool) -> Iterator[str]:
    if regression.value == 0:
        yield "the fit changes the choice in no draw"
        return
    gap = regression.value - lower.value
    if gap > 2 * lower.standard_error or lower.value < regression.value / 2:
        yield "the fit's choices earn less in draws that it has not seen"
    if gain.few:
        yield f"{gain.carried:.0f} draws carry it"
    if cut:
        yield "cut at EVPI of the candidates"


def _basis(draws: Floats) -> Floats:
    """Return (D, p): 1, a cubic spline of each parameter, products of pairs of parameters."""
    count, known = draws.shape
    # Cubic splines with about D^(1/5) knots balance bias and noise of a smooth function.
    knots = max(1, min(10, round(count**0.2)))
    while known * (knots + 3) + 1 > min(MOST_TERMS, count // 10) and knots > 0:
        knots -= 1
    scaled = (draws - draws.mean(axis=0)) / draws.std(axis=0)
    columns = [np.ones(count)]
    for x in scaled.T:
        columns += [x, x * x, x * x * x] if known * 3 + 1 <= count // 10 else [x]
        if knots and known * 3 + 1 <= count // 10:
            places = np.quantile(x, np.arange(1, knots + 1) / (knots + 1))
            over = [np.maximum(x - place, 0.0) for place in places]
            columns += [beyond * beyond * beyond for beyond in over]
    pairs = list(combinations(range(known), 2))
    if len(columns) + len(pairs) <= min(MOST_TERMS, count // 10):
        columns += [scaled[:, i] * scaled[:, j] for i, j in pairs]
    return np.column_stack(columns)


def _solved(gram: Floats, side: Floats) -> Floats:
    """Return least-squares coefficients from normal equations, scaled, near-null directions out."""
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0, size, 1.0)
    found = np.linalg.lstsq(gram / size / size[:, None], side / size[:, None], rcond=1e-13)[0]
    return found / size[:, None]
