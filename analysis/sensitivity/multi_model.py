"""One policy for several weighted models of the same states: the weighted value problem.

    W* = max over deterministic policies π of  Σ_k λ_k V_k^π(start)

The policy does not know which model holds and does not learn it (non-adaptive; Steimle, Kaufman and
Denton, IISE Transactions 53, 2021). The problem is NP-hard. Lower bounds are policies: the optimum
of the mean model (mean-value problem), weight-select-update, which chooses backward by weighted
values to go, and improvements one decision at a time, exact where models are acyclic: a change in
state s is worth Σ λ_k d_k(s) (Q_k(s, a) - V_k(s)), d_k the visits to s. The upper bound is
Σ λ_k V_k*: whoever knew the model (wait and see). Branch and bound closes the distance: with some
decisions fixed, Σ λ_k V_k* over policies that keep them bounds what is left, and is attained where
the optima of all models agree in the states they visit (after Ahluwalia, Steimle and Denton,
European Journal of Operational Research 2021).

A decision belongs to a state, or to all states that share some columns (a policy by status).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.sensitivity.multi_model_heuristics import improved, weight_select_update
from analysis.sensitivity.multi_model_problem import Problem, weighted
from analysis.sensitivity.multi_model_search import search
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers import solve
from solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame

PARTS = 2000
GAP = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class MultiModel:
    """A policy for several models, and how far from the best such policy it may be.

    Attributes
    ----------
    weights : (K,)
        λ, with sum 1.
    policy : (S,) int64
        Action numbers.
    value : Bounded
        Its weighted value at the start: a lower bound of W*.
    upper : float
        No policy has a greater weighted value.
    by_model, optima : tuple of Bounded
        The policy's value in each model, and that model's own optimum.
    found_by : {method: Bounded}
        Weighted values of the policies that the heuristics found.
    parts : int
        Sets of policies that were bounded.
    """

    weights: Floats
    policy: Integers
    value: Bounded
    upper: float
    by_model: tuple[Bounded, ...]
    optima: tuple[Bounded, ...]
    found_by: Mapping[str, Bounded]
    parts: int

    @property
    def gap(self) -> float:
        """W* less the policy's weighted value is at most this."""
        return self.upper - self.value.interval[0]

    @property
    def wait_and_see(self) -> Bounded:
        """Σ λ_k V_k*, what knowing the model would be worth in all."""
        return weighted(self.weights, self.optima)

    @property
    def mean_value(self) -> Bounded:
        """The weighted value of the mean model's optimum."""
        return self.found_by["mean-value policy"]

    def frame(self) -> DataFrame:
        """Return one row for each model: values and regret at the start (reward)."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "model": number,
                    "weight": weight,
                    "value (reward)": mine.value,
                    "optimum (reward)": best.value,
                    "regret (reward)": best.value - mine.value,
                    "error bound (reward)": mine.error + best.error,
                }
                for number, (weight, mine, best) in enumerate(
                    zip(self.weights.tolist(), self.by_model, self.optima, strict=True)
                )
            ]
        )


def multi_model(
    models: Sequence[MDP],
    weights: Sequence[float] | None = None,
    *,
    columns: Sequence[str] | None = None,
    gap: float = GAP,
    parts: int = PARTS,
) -> MultiModel:
    """Return a policy for all models at once, with a bound on what the best one could add.

    Parameters
    ----------
    models : sequence of MDP
        With the same states and the same actions in each.
    weights : (K,), optional
        λ, at least 0; equal unless given. They are divided by their sum.
    columns : sequence of str, optional
        The policy reads these columns of the state alone, such as `["status"]`; the whole state
        unless given.
    gap : float
        Stop where the bounds are this close.
    parts : int
        Sets of policies to bound at most; 1 leaves out branch and bound.

    Raises
    ------
    ModelError
        For models that do not match, and weights that are no weights.

    Examples
    --------
    >>> rows = lambda a, b: [(0, 0, [(1, 1, a)]), (0, 1, [(1, 1, b)]), (1, 0, [(1, 1, 0)])]
    >>> found = multi_model([MDP.from_outcomes(rows(3, 0)), MDP.from_outcomes(rows(0, 2))])
    >>> found.policy.tolist(), found.value.value, found.wait_and_see.value
    ([0, 0], 1.5, 2.5)
    """
    problem = Problem(models, weights, columns)
    optima = tuple(solve(mdp).start for mdp in problem.models)
    found: dict[str, tuple[Bounded, Integers]] = {}

    def note(name: str, pairs: Integers) -> None:
        fitted = problem.fitted(pairs)
        found[name] = (problem.value(fitted), fitted)

    note("mean-value policy", solve(problem.mean).pairs)
    if problem.order is not None:
        note("weight-select-update", weight_select_update(problem))
    first = max(found.values(), key=lambda each: each[0].value)
    found["improved"] = improved(problem, *first)
    best = max(found.values(), key=lambda each: each[0].interval[0])
    upper, best, used = search(problem, best, gap, parts)
    found["branch and bound"] = best
    upper = max(upper, best[0].interval[0])
    pairs = best[1]
    return MultiModel(
        weights=problem.weights,
        policy=problem.models[0].pair_action[pairs],
        value=best[0],
        upper=upper,
        by_model=problem.values(pairs),
        optima=optima,
        found_by={name: each[0] for name, each in found.items()},
        parts=used,
    )
