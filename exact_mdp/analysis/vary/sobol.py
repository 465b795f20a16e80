"""Global sensitivity: Sobol indices over the parameters' ranges.

Parameters are independent and uniform over their ranges. The outputs Y are the value of the
optimum, the value of a policy held fixed, and the policy's regret. The shares of the variance of Y
that are due to θ_i are

    S_i  = Var(E[Y | θ_i]) / Var(Y)   alone,    ST_i = E[Var(Y | θ_others)] / Var(Y)   with others.

A and B are two independent halves of the points of one scrambled Sobol sequence, and AB_i is A with
the column of θ_i from B: n (P + 2) draws for P parameters. Then

    S_i  ≈ mean of (B - mean of both) (AB_i - A) / Var,      ST_i ≈ mean of (AB_i - A)² / (2 Var)

(Saltelli et al., Computer Physics Communications 181, 2010, table 2, (b) and (f)). Intervals are
normal 95 % intervals, with the standard deviation of a bootstrap over the n points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.random import default_rng

from exact_mdp.analysis.vary.ranges import Range, Stated, spans_of, unit_of
from exact_mdp.analysis.vary.study import require_room_for_points, study
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, format_number
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import RNG, require_count, seed_of
from exact_mdp.solvers.claims import NORMAL
from exact_mdp.solvers.learning.sampler import spawn_child_seed
from exact_mdp.solvers.parallel import How

OUTPUTS = ("optimal", "fixed", "regret")
TITLES = {
    "optimal": "the start value, policy re-optimised",
    "regret": "the regret of the policy held fixed",
}
SHARES = {
    "parameter": "parameter",
    "first order": "first order (share of variance):.4f",
    "± first": "first order ±:± .4f",
    "total": "total (share of variance):.4f",
    "± total": "total ±:± .4f",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Indices:
    """Sobol indices (P,) of one output, NaN if it is constant, and half widths of intervals."""

    mean: float
    sd: float
    first: Floats
    first_half: Floats
    total: Floats
    total_half: Floats

    @property
    def constant(self) -> bool:
        """Whether the output is constant, up to rounding, at all points of A and B."""
        return bool(np.isnan(self.first).all())


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Sobol(Pictured):
    """Sobol indices of every parameter: of the optimum, the policy held fixed, and its regret."""

    model: str
    spans: Mapping[Parameter, Range]
    optimal: Indices
    fixed: Indices
    regret: Indices
    n: int
    seed: int
    criterion_facts: Mapping[str, Shown]  # none for a total reward

    def __repr__(self) -> str:
        mean, sd = self.optimal.mean, self.optimal.sd
        asked = "".join(f"; {each.text}" for each in self.criterion_facts.values())
        return (
            f"Sobol(parameters {len(self.names)}, n {self.n:,}{asked}; "
            f"optimum {mean:.6g}, sd {sd:.3g})"
        )

    @property
    def draws(self) -> int:
        """Number of models that were solved."""
        return self.n * (len(self.spans) + 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.name for parameter in self.spans)

    def of(self, output: str) -> Indices:
        """Return the indices of one output, by name."""
        indices: Indices = getattr(self, require_known_name(output, OUTPUTS, "output", "output"))
        return indices

    def report(self) -> Report:
        """Return the indices of the optimum's value and of the policy's regret."""
        lost = self.regret
        indices = self._list_indices(self.optimal)
        facts = {
            **self.criterion_facts,
            "claim": "estimated",
            "draws": self.draws,
            "seed": self.seed,
            "confidence": 0.95,
            "ranges": Shown({p.name: [float(r.low), float(r.high)] for p, r in self.spans.items()}),
            "samples": self.n,
            "mean": self.optimal.mean,
            "sd": self.optimal.sd,
            **{name: Shown(shares) for name, shares in indices.items()},
            "regret": Shown(
                {"mean": lost.mean, "sd": lost.sd, **self._list_indices(lost)},
                f"mean {format_number(lost.mean)}, sd {lost.sd:.4g}",
            ),
        }
        tables = {}
        for name, what in TITLES.items():
            title = f"shares of the variance of {what}, ± half an interval"
            # A constant output has no shares of variance.
            if self.of(name).constant:
                rows = ()
            else:
                rows = self.frame(name)
            tables[f"shares of {name}"] = Table(title=title, rows=rows, columns=SHARES)
        return Report(title="Sobol indices", facts=facts, tables=tables)

    def _list_indices(self, each: Indices) -> dict[str, dict[str, object]]:
        """Return the indices of an output for each parameter, and their intervals."""
        first, total = (each.first, each.first_half), (each.total, each.total_half)
        shares = {}
        for key, (index, half) in {"first_order": first, "total": total}.items():
            ends = np.stack([index - half, index + half], axis=1)
            shares[key] = dict(zip(self.names, index, strict=True))
            shares[f"{key}_interval"] = dict(zip(self.names, ends, strict=True))
        return shares

    def frame(self, output: str = "optimal") -> DataFrame:
        """Return one row for each parameter, the largest total index of an output first."""
        indices, spans = self.of(output), self.spans.items()
        rows = [(each.name, unit_of(each), float(r.low), float(r.high)) for each, r in spans]
        table = data_frame(rows, columns=["parameter", "unit", "low", "high"])
        table["first order (share of variance)"] = indices.first
        table["first order ±"] = indices.first_half
        table["total (share of variance)"] = indices.total
        table["total ±"] = indices.total_half
        table["claim"] = "estimated"
        order = np.argsort(-np.nan_to_num(indices.total), kind="stable")
        return table.iloc[order].reset_index(drop=True)


@named_options
def sobol(
    model: Scenario | MDP | Parametric,
    *,
    policy: PolicyLike = "optimal",
    names: Iterable[str] | None = None,
    ranges: Stated | None = None,
    relative: Fraction | None = None,
    n: int = 1024,
    criterion: str = "total",
    rng: RNG = 0,
    n_jobs: int | None = 1,
    folder: str | Path | None = None,
    progress: bool = False,
) -> Sobol:
    """Return first-order and total Sobol indices over the ranges of parameters.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        The policy whose regret is decomposed; "optimal" is the optimum at today's values.
    names, ranges, relative : optional
        As for `tornado`; the discount, and parameters of 0 today, vary only if ranges are stated.
    n : int
        A power of 2; the model is solved at n (P + 2) points.
    criterion : "total" or "average"
        As for `study`.
    rng : int or numpy.random.Generator
    n_jobs, folder, progress : optional
        See `solvers.parallel.run_pieces`.

    Returns
    -------
    Sobol

    Raises
    ------
    ModelError
        For unknown names, empty ranges, an `n` that is not a power of 2, and values that the model
        cannot have together.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [("1/2", 2, 1), ("1/2", 3, 0)])]
    >>> rows += [(2, 0, [(1, 2, 0)]), (3, 0, [(1, 3, 0)])]
    >>> model = moving(MDP.from_outcomes(rows, 1), {"p": [(0, 1)], "q": [(1, 2)]})
    >>> indices = sobol(model, ranges={"p": (0, 1), "q": (0, 1)}, n=64, rng=0)
    >>> indices.names, indices.draws, (indices.optimal.total > indices.optimal.first).tolist()
    (('p', 'q'), 256, [True, True])
    """
    n = require_count(n, "n", 2)
    if n & (n - 1):
        near = 1 << (n.bit_length() - 1)
        raise ModelError(
            f"{n} samples, which is not a power of 2, as a Sobol sequence needs",
            where="sobol",
            fix=f"ask for {near} or {2 * near}",
        )
    family, seed = parametric(model), seed_of(rng)
    spans = spans_of(family, names, ranges, relative)
    fewer = "ask for fewer samples, or vary fewer parameters"
    require_room_for_points(n * (len(spans) + 2), len(spans), fewer)
    how = How(n_jobs=n_jobs, folder=folder, progress=progress)
    draws = _build_design(list(spans.values()), n, default_rng(spawn_child_seed(seed, 0)))
    points = dict(zip((p.name for p in spans), draws.T, strict=True))
    table = study(family, points, [policy], criterion=criterion, **how)
    # 200 bootstrap resamples give a standard deviation to within 5 %, 1 / √(2 · 200).
    resamples = default_rng(spawn_child_seed(seed, 1)).integers(n, size=(200, n))
    # A regret within two error bounds counts as 0, and may be off by as much again.
    noise = 6 * float(table.error.max())
    every = (table.optimal, table.fixed, table.regret)
    indices = (_estimate_indices(each.reshape(n, -1), noise, resamples) for each in every)
    return Sobol(
        model=family.name,
        spans=spans,
        n=n,
        seed=seed,
        criterion_facts=table.criterion_facts,
        **dict(zip(OUTPUTS, indices, strict=True)),
    )


def _build_design(spans: Sequence[Range], n: int, rng: np.random.Generator) -> Floats:
    """Return the draws (n (P + 2), P): for each point its rows in A, in AB_1 … AB_P, and in B."""
    from scipy.stats import qmc

    count = len(spans)
    points = qmc.Sobol(2 * count, rng=rng).random_base2(n.bit_length() - 1)
    unit = np.repeat(points[:, None, :count], count + 2, axis=1)
    # Row i of a point, from 1 to P, has its i-th column from B; the last row is all of B.
    each = np.arange(count)
    unit[:, each + 1, each] = points[:, count:]
    unit[:, -1] = points[:, count:]
    low = np.array([float(span.low) for span in spans])
    high = np.array([float(span.high) for span in spans])
    # low + u (high - low) may round to a little more than high.
    draws: Floats = np.minimum(low + unit * (high - low), high).reshape(-1, count)
    return draws


def _estimate_indices(output: Floats, noise: float, resamples: Integers) -> Indices:
    """Return the indices of an output (n, P + 2), whose columns are A, AB_1 … AB_P, and B."""
    both = output[:, [0, -1]]
    mean, count = float(both.mean()), output.shape[1] - 2
    sd, shares, spread = 0.0, *np.full((2, 2, count), np.nan)
    if np.ptp(both) > noise:
        sd, shares = float(both.std(ddof=1)), _compute_indices(output)
        # A resample in which the output does not vary has no indices.
        again = [_compute_indices(output[each]) for each in resamples if np.ptp(both[each]) > 0]
        if len(again) > 1:
            spread = np.std(again, axis=0, ddof=1)
    (first, total), (one, other) = shares, NORMAL * spread
    return Indices(mean=mean, sd=sd, first=first, first_half=one, total=total, total_half=other)


def _compute_indices(output: Floats) -> Floats:
    """Return the first-order and the total indices (2, P)."""
    both, moved = output[:, [0, -1]], output[:, 1:-1] - output[:, :1]
    variance = both.var()
    first = (output[:, -1:] - both.mean()) * moved
    return np.array([first.mean(axis=0) / variance, (moved**2).mean(axis=0) / (2 * variance)])
