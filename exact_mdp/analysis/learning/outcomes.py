"""What learning ends with, judged by exact values instead of experiments.

The final greedy policy of every run has an exact value, so that its regret V* - V^π is known and
only the seeds are a sample: over runs, intervals are Wilson's for shares (JASA 22, 1927) and BCa
bootstrap for means (Efron, JASA 82, 1987).

The authors choose their final policy among the five that were greedy most often in the last 100
episodes, by simulation (Yuan et al. 2025, "Evaluation Metrics"); `selected` does so by exact value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.columns import BestPolicy, best_policy
from exact_mdp.analysis.vary.intervals import wilson
from exact_mdp.mdp.errors import ModelError, listed
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.sampler import Rows, rows_of
from exact_mdp.solvers.solution import Bounded, regrets
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.layers import policy_values

if TYPE_CHECKING:
    from pandas import DataFrame


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
CANDIDATES = 5
Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Outcomes(Pictured):
    """Final policies of R runs, U of them distinct, with their exact values.

    Attributes
    ----------
    mdp : MDP
        Values are those at its discount.
    rows : Rows
    policies : (U, K) ints
        Final and selected greedy policies, the most frequent final one first.
    value, error : (U,)
        Their exact values at the start, up to rounding.
    final, selected : (R,) ints
        Which one each run ended with, and which it would select among its candidates.
    distinct : (R,) ints
        How many policies were greedy in each run's last episodes.
    changed : (R, K) bool
        Rows in which these policies differ.
    optimum : Bounded
        The optimal value at the start.
    best : BestPolicy or None
        The best policy that reads what the learner reads; None where that is everything.
    """

    mdp: MDP
    rows: Rows
    policies: Numbers
    value: Floats
    error: Floats
    final: Integers
    selected: Integers
    distinct: Integers
    changed: NDArray[np.bool_]
    optimum: Bounded
    best: BestPolicy | None

    def __repr__(self) -> str:
        return (
            f"Outcomes({self.runs} runs, {len(self.policies)} policies, mean regret "
            f"{self.regret.mean():.4g}, {self.optimal_fraction:.1%} optimal)"
        )

    @property
    def runs(self) -> int:
        """Number of runs, R."""
        return len(self.final)

    @property
    def counts(self) -> Integers:
        """(U,) how many runs ended with each policy."""
        return np.bincount(self.final, minlength=len(self.policies))

    @property
    def policy_regret(self) -> Floats:
        """(U,) exact regret of each policy; 0 where rounding can explain it."""
        return self._below(self.optimum)

    @property
    def regret(self) -> Floats:
        """(R,) exact regret of each run's final policy."""
        return self.policy_regret[self.final]

    @property
    def selected_regret(self) -> Floats:
        """(R,) exact regret of the policy that each run would select."""
        return self.policy_regret[self.selected]

    @property
    def best_value(self) -> Bounded:
        """Value of the best policy that reads what the learner reads."""
        return self.optimum if self.best is None else self.best.value

    @property
    def learning_error(self) -> Floats:
        """(R,) how far final policies are below the best that reads what the learner reads."""
        return self._below(self.best_value)[self.final]

    def _below(self, reference: Bounded) -> Floats:
        sign = -1.0 if self.mdp.sense == "min" else 1.0
        best = np.full_like(self.value, reference.value)
        return regrets(best, self.value, self.error + reference.error, sign)

    @cached_property
    def regret_interval(self) -> Interval | None:
        """95 % interval of the mean regret over seeds; None for fewer than ten runs."""
        return mean_interval(self.regret)

    @property
    def optimal_fraction(self) -> float:
        """Share of runs that end with an optimal policy."""
        return float((self.regret == 0).mean())

    @property
    def best_fraction(self) -> float:
        """Share of runs that end with the best policy that reads what the learner reads."""
        return float((self.learning_error == 0).mean())

    def choices(self, row: int) -> Integers:
        """Return (A,) how many runs end with each action in a row."""
        taken = self.policies[self.final, row]
        return np.bincount(taken, minlength=self.mdp.n_actions)

    @property
    def last_counts(self) -> dict[int, int]:
        """Runs by how many policies were greedy in their last episodes."""
        many, runs = np.unique(self.distinct, return_counts=True)
        return dict(zip(many.tolist(), runs.tolist(), strict=True))

    def interval_of(self, share: float) -> Interval:
        """Return Wilson's 95 % interval of a share of the runs."""
        low, high = wilson(round(share * self.runs), self.runs)
        return float(low), float(high)

    def frame(self) -> DataFrame:
        """Return one row for each final policy, the most frequent first."""
        import pandas

        shown = np.flatnonzero(self.counts)
        return pandas.DataFrame(
            {
                "count": self.counts[shown],
                "value": self.value[shown],
                "error_bound": self.error[shown],
                "regret": self.policy_regret[shown],
            }
        )


def outcomes(model: MDP, runs: Sequence[TrainingRun], *, bound: bool = True) -> Outcomes:
    """Return the final policies of runs on a model and their values at its discount.

    Parameters
    ----------
    model : MDP
    runs : sequence of TrainingRun
    bound : bool
        Also find the best policy that reads what the learner reads, where that is not everything.

    Returns
    -------
    Outcomes

    Raises
    ------
    ModelError
        Where there is no run, or runs on another model.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.solvers.learning.q_learning import QLearning
    >>> from exact_mdp.solvers.learning.training import train
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> found = outcomes(mdp, train(mdp, QLearning(epochs=300), 12, rng=0))
    >>> found.counts.sum(), bool((found.learning_error <= found.regret).all())
    (np.int64(12), True)
    """
    mdp, rows = model, common_rows(model, runs)
    known: dict[bytes, int] = {}
    listed: list[Numbers] = []

    def number(policy: Numbers) -> int:
        place = known.setdefault(policy.tobytes(), len(known))
        if place == len(listed):
            listed.append(policy)
        return place

    candidates = [[number(run.policies[i]) for i in run.last_counts()][:CANDIDATES] for run in runs]
    final = np.array([number(run.final) for run in runs])
    values = policy_values(mdp, rows, np.array(listed))
    worth = -values.value if mdp.sense == "min" else values.value
    selected = np.array([max(tried, key=lambda i: worth[i]) for tried in candidates])
    counts = np.bincount(final, minlength=len(listed))
    kept = np.union1d(final, selected)
    kept = kept[np.argsort(-counts[kept], kind="stable")]
    place = np.empty(len(listed), dtype=np.int64)
    place[kept] = np.arange(len(kept))
    changed = []
    for run in runs:
        recent = run.policies[np.unique(run.last)]
        changed.append((recent != recent[0]).any(axis=0))
    partial = len(rows.space.columns) < len(mdp.space.columns)
    return Outcomes(
        mdp=mdp,
        rows=rows,
        policies=np.array(listed)[kept],
        value=values.value[kept],
        error=values.error[kept],
        final=place[final],
        selected=place[selected],
        distinct=np.array([len(np.unique(run.last)) for run in runs]),
        changed=np.array(changed),
        optimum=solve(mdp).start,
        best=best_policy(mdp, rows.space.names) if partial and bound else None,
    )


# ---- intervals -----------------------------------------------------------------------------------


def mean_interval(values: Floats) -> Interval | None:
    """Return the BCa bootstrap 95 % interval of a mean; None for fewer than ten values."""
    from scipy import stats

    if len(values) < 10:
        return None
    if np.ptp(values) == 0:
        return float(values[0]), float(values[0])
    found = stats.bootstrap((values,), np.mean, n_resamples=2000, batch=500, rng=0)
    interval = found.confidence_interval
    return float(interval.low), float(interval.high)


def common_rows(model: MDP, runs: Sequence[TrainingRun]) -> Rows:
    """Return the rows that the runs read; raises ModelError for runs on another model."""
    if not listed(runs, "runs") or not all(isinstance(run, TrainingRun) for run in runs):
        fix = "give what train(model, QLearning(), …) returns"
        raise ModelError("no run of training", where="learning", fix=fix)
    rows = rows_of(model, runs[0].space.names)
    if any(run.space != rows.space or run.q.shape != rows.offered.shape for run in runs):
        raise ModelError(
            "the runs read other states than this model has",
            where="learning",
            fix="use the model that they were trained on, at any discount",
        )
    return rows
