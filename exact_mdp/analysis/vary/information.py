"""The expected value of perfect information: EVPI, and EVPPI of some parameters, from a sample.

With V^c(θ) the value of candidate c at a draw θ, among a finite set of candidates,

    EVPI = E[max_c V^c] - max_c E[V^c],
    EVPPI(φ) = E_φ[max_c E[V^c | φ]] - max_c E[V^c].

E[V^c | φ] is estimated by regression (Strong, Oakley and Brennan, Medical Decision Making 34,
2014): least squares of V^c less the best candidate's value on cubic splines of φ, and on pairwise
products. The estimate *regression* takes the maximum of the fitted values, cut at EVPI. The
estimate *lower* uses the fit of four fifths of the draws only to choose in the others, so that its
expectation is at most EVPPI. If the fit is unreliable, the estimate says why (`doubts`); otherwise
the differences count in the standard error, whose 95 % interval held the truth in 97 % of 10,000
samples of 42 problems.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from exact_mdp.analysis.vary.intervals import MeanLoss, mean_loss, mean_of
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import RELATIVE_TOLERANCE
from exact_mdp.solvers.claims import Estimated

FEWEST = 20  # draws of a regression
# The draws that a regression uses: with more of them, its own error is far below sampling error.
REGRESSED = 20_000


@dataclass(frozen=True, kw_only=True, repr=False)
class PartialInformation:
    """EVPPI of some parameters: by `regression`, and a `lower` estimate.

    The standard error of the first includes the errors of the fit. `doubts` are the reasons why it
    is unreliable.
    """

    parameters: tuple[str, ...]
    regression: Estimated
    lower: Estimated
    doubts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        doubts = ""
        if self.doubts:
            doubts = f"; doubtful: {'; '.join(self.doubts)}"
        return f"PartialInformation({', '.join(self.parameters)}: {self.regression}{doubts})"

    @property
    def reliable(self) -> bool:
        """Whether nothing gives reason to doubt the regression's estimate."""
        return not self.doubts


def estimate_evpi(values: Floats) -> MeanLoss:
    """Return the EVPI of choosing among the N candidates of values (D, N).

    The largest mean is taken, which pulls the estimate down by less than its standard error.
    """
    best = int(values.mean(axis=0).argmax())
    return mean_loss(values.max(axis=1) - values[:, best])


def estimate_evppi(values: Floats, draws: Floats, names: tuple[str, ...]) -> PartialInformation:
    """Return the EVPPI of q parameters, from values (D, N) of the candidates in draws (D, q)."""
    values, draws = values[:REGRESSED], draws[:REGRESSED]
    count, candidates = values.shape
    if count < FEWEST:
        raise ModelError(
            f"{count} draws for a regression" if count != 1 else "1 draw for a regression",
            where="EVPPI",
            fix=f"ask for at least {FEWEST}",
        )
    # Values relative to the candidate that is best on average.
    best = int(values.mean(axis=0).argmax())
    ahead = values - values[:, best : best + 1]
    varies = draws.min(axis=0) < draws.max(axis=0)
    if candidates == 1 or not varies.any():
        zero = Estimated(value=0.0, standard_error=0.0)
        return PartialInformation(parameters=names, regression=zero, lower=zero)

    # Normal equations of five folds, whose sums give the whole fit and each fit without a fold.
    basis = _build_spline_basis(draws[:, varies])
    ends = np.linspace(0, count, 6).astype(int)
    folds = [slice(first, last) for first, last in pairwise(ends.tolist())]
    grams = [basis[fold].T @ basis[fold] for fold in folds]
    sides = [basis[fold].T @ ahead[fold] for fold in folds]
    gram, side = np.sum(grams, axis=0), np.sum(sides, axis=0)
    fitted = basis @ _solve_normal_equations(gram, side)
    rows, chosen = np.arange(count), fitted.argmax(axis=1)
    # The fit of the best candidate is 0, so the gain is never negative.
    gain = fitted[rows, chosen]
    most = estimate_evpi(values).value
    earned, promised = np.empty(count), float(gain.mean())
    for fold, inner, other in zip(folds, grams, sides, strict=True):
        rule = basis[fold] @ _solve_normal_equations(gram - inner, side - other)
        earned[fold] = ahead[rows[fold], rule.argmax(axis=1)]

    # Four checks of the fit: on draws that it has not seen (`apart`), of its promises against what
    # its choices earn (`astray`), for patterns in the residuals (`missed`), and whether few draws
    # carry the gain.
    taken = np.setdiff1d(chosen, best)
    total, surprising = _find_largest_sum(draws[:, varies], (ahead - fitted)[:, taken])
    own, lower, carried = mean_of(ahead[rows, chosen]), mean_of(earned), mean_loss(gain)
    value, missed = min(promised, most), total / count
    apart, astray = value - lower.value, promised - own.value
    # The limits, in standard errors, were chosen so that the intervals cover as the module's head
    # says; no estimate depends on them. Values are known up to the tolerance of the solvers.
    sure, noise, doubts = own.standard_error, RELATIVE_TOLERANCE * value, []
    if abs(apart) > max(sure, noise) or lower.value < value / 2:
        doubts.append("the fit's choices earn less or more in draws that it has not seen")
    if abs(astray) > max(0.5 * sure, noise):
        doubts.append("the fit promises less or more than its choices earn")
    if surprising and missed > max(0.1 * sure, noise):
        doubts.append("the fit misses a pattern along a parameter")
    if carried.few:
        doubts.append(f"few draws carry it: {carried.carried:.0f}")
    if promised > most * (1 + RELATIVE_TOLERANCE):
        doubts.append("cut at EVPI of the candidates")
    if not value:
        doubts = ["the fit changes the choice in no draw"]

    # What the checks leave open widens the interval.
    error = float(np.sqrt(sure**2 + apart**2 + missed**2 + (2 * astray) ** 2))
    return PartialInformation(
        parameters=names,
        regression=Estimated(value=value, standard_error=error),
        lower=lower,
        doubts=(*doubts, *too_wide(error, most, count)),
    )


def too_wide(error: float, evpi: float, count: int) -> list[str]:
    """Return a warning with its remedy if the standard error of an EVPPI is above EVPI."""
    if not error > evpi > 0:
        return []
    needed = float(f"{count * (2 * error / evpi) ** 2:.1g}")
    fix = f"take about n={needed:,.0f} to bring it to half of EVPI"
    if needed > REGRESSED:
        fix = f"take n={REGRESSED:,}, as a regression uses no more"
    return [
        f"the standard error is above EVPI ({evpi:.3g}), so EVPPI may be anything from 0 to EVPI; "
        f"it falls with the root of the number of draws: {fix}"
    ]


def _find_largest_sum(draws: Floats, residuals: Floats) -> tuple[float, bool]:
    """Return the greatest sum of neighbouring residuals (D, N) along a parameter.

    The second result says whether it is surprising: the greatest of n standard normal sums is
    hardly above √(2 ln n). There are about D windows of each length, and lengths double.
    """
    count = len(draws)
    spread = np.sqrt((residuals**2).mean(axis=0))
    varying = spread > 0
    lengths = [8 << k for k in range(count.bit_length()) if 8 << k <= count // 2]
    size, total = 0.0, 0.0
    for x in draws.T:
        # Sums over all windows of one length are differences of cumulative sums.
        sums = residuals[np.argsort(x, kind="stable")][:, varying].cumsum(axis=0)
        sums = np.vstack([np.zeros((1, sums.shape[1])), sums])
        for length in lengths:
            added = np.abs(sums[length:] - sums[:-length]).max(axis=0)
            scaled = added / (spread[varying] * np.sqrt(length))
            if scaled.size and scaled.max() > size:
                size, total = float(scaled.max()), float(added[scaled.argmax()])
    windows = max(count * len(lengths) * draws.shape[1] * int(varying.sum()), 2)
    return total, size > float(np.sqrt(2 * np.log(windows)))


def _build_spline_basis(draws: Floats) -> Floats:
    """Return (D, p): 1, a cubic spline of each parameter, products of pairs of parameters."""
    count, known = draws.shape
    # Cubic splines with about D^(1/5) knots balance bias and noise of a smooth function; fewer, if
    # the basis would have more than a tenth as many columns as draws.
    # 400 columns are enough: the cost grows with their square.
    knots, most = round(count**0.2), min(400, count // 10)
    while known * (knots + 3) + 1 > most and knots > 0:
        knots -= 1
    scaled = (draws - draws.mean(axis=0)) / draws.std(axis=0)
    columns = [np.ones(count)]
    for x in scaled.T:
        if known * 3 + 1 > count // 10:
            columns.append(x)
            continue
        columns += [x, x * x, x * x * x]
        for place in np.quantile(x, np.arange(1, knots + 1) / (knots + 1)):
            beyond = np.maximum(x - place, 0.0)
            columns.append(beyond * beyond * beyond)
    pairs = list(combinations(range(known), 2))
    if len(columns) + len(pairs) <= most:
        columns += [scaled[:, i] * scaled[:, j] for i, j in pairs]
    return np.column_stack(columns)


def _solve_normal_equations(gram: Floats, side: Floats) -> Floats:
    """Return least-squares coefficients from normal equations, without near-null directions."""
    # Scaled to a unit diagonal, so that one relative cut-off serves all columns.
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0, size, 1.0)
    solution = np.linalg.lstsq(gram / size / size[:, None], side / size[:, None], rcond=1e-13)[0]
    return solution / size[:, None]
