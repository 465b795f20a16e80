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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.gate.columns import BestPolicy, best_policy
from exact_mdp.analysis.vary.intervals import mean_interval, wilson
from exact_mdp.mdp.errors import ModelError, listed
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Report, Shown, Table, number
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.sampler import Rows, rows_of
from exact_mdp.solvers.solution import Bounded, regrets
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.layers import policy_values

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
CANDIDATES = 5
LISTED_ROWS = 1000  # policies over more rows are left to files
SHOWN = 10  # policies in the table
Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Outcomes(Pictured):
    """Final policies of R runs, U of them distinct, with their exact values at the start."""

    mdp: MDP  # values are those at its discount
    rows: Rows
    policies: Numbers  # (U, K) final and selected greedy ones, the most frequent final one first
    value: Floats  # (U,) exact up to the error
    error: Floats
    final: Integers  # (R,) which of them each run ended with
    selected: Integers  # (R,) which it would select among its candidates
    distinct: Integers  # (R,) how many were greedy in each run's last episodes
    changed: NDArray[np.bool_]  # (R, K) rows in which these differ
    optimum: Bounded
    best: BestPolicy | None  # that reads what the learner reads; None where that is everything
    candidates: tuple[tuple[int, Numbers], ...]  # of the first run: episodes, the most first
    steps: int  # of all runs
    cut_short: int  # episodes that did not end

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
        best = np.full_like(self.value, reference.value)
        return regrets(best, self.value, self.error + reference.error, self.mdp.sign)

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
        shown = np.flatnonzero(self.counts)
        return data_frame(
            {
                "count": self.counts[shown],
                "value": self.value[shown],
                "error_bound": self.error[shown],
                "regret": self.policy_regret[shown],
            }
        )

    def report(self) -> Report:
        """Return what the runs ended with."""
        best, regret, runs = self.best, self.regret, self.runs
        optimal, ends = self.interval_of(self.optimal_fraction), self.regret_interval
        quantiles = ", ".join(
            f"{float(q):.0%}: {number(v)}" for q, v in _spread(regret)["quantiles"].items()
        )
        apart = "" if ends is None else f" (95 %: {_percent(ends, '.4g')})"
        rows = zip(self.frame().to_dict("records"), self.policies[self.counts > 0], strict=True)
        selected, learning = self.selected_regret, self.learning_error
        facts = {
            "seeds": runs,
            "columns": self.rows.space.names,
            "claim": Shown("estimated"),
            "value_claim": Shown("bounded"),
            "optimal_value": Shown(self.optimum.value, self.optimum),
            "optimal_value_error": Shown(self.optimum.error),
            "random_value": evaluate(self.mdp, "random").mean,
            "best_value": Shown(self.best_value.value, self.best_value),
            "best_value_upper_bound": Shown(best.upper_bound if best else self.optimum.value),
            "best_value_proven": best.proven if best else True,
            "regret": Shown(
                _spread(regret) | {"mean_interval": ends},
                f"mean regret {number(float(regret.mean()))}{apart}; quantiles {quantiles}",
            ),
            "optimal_fraction": Shown(
                self.optimal_fraction,
                f"{self.optimal_fraction:.1%} of the runs end optimal (95 %: {_percent(optimal)})",
            ),
            "optimal_fraction_interval": Shown(optimal),
            "learning_error": Shown(_spread(learning), f"mean {number(float(learning.mean()))}"),
            "best_fraction": Shown(self.best_fraction, f"{self.best_fraction:.1%}"),
            "best_fraction_interval": Shown(self.interval_of(self.best_fraction)),
            "selected": Shown(
                {"regret": _spread(selected), "optimal_fraction": float((selected == 0).mean())},
                f"mean regret of the best of five {number(float(selected.mean()))}",
            ),
            "first_run": Shown(self.first_run),
            "policies": [
                row | self._share(int(row["count"])) | {"policy": self._named(policy)}
                for row, policy in rows
            ],
            "distinct_in_last": {
                str(many): {"count": count, "interval": self.interval_of(count / runs)}
                for many, count in self.last_counts.items()
            },
            "changed_in_last": {
                self.rows.space.label(row): self._share(count)
                for row, count in enumerate(self.changed.sum(axis=0).tolist())
                if count
            },
            "steps": self.steps,
            "cut_short": self.cut_short,
            "written": [],
        }
        return Report(title="training", facts=facts, tables=_tables(facts, runs))

    @property
    def first_run(self) -> dict[str, Any]:
        """The policies that were greedy most often in the last episodes of the first run."""
        top = self.candidates[:CANDIDATES]
        policies = np.array([policy for _, policy in top])
        values = policy_values(self.mdp, self.rows, policies)
        each = zip(top, values.value.tolist(), values.error.tolist(), strict=True)
        return {
            "episodes": sum(count for count, _ in self.candidates),
            "distinct": len(self.candidates),
            "top": [
                {"episodes": n, "value": value, "error_bound": error, "policy": self._named(policy)}
                for (n, policy), value, error in each
            ],
        }

    def _share(self, count: int) -> dict[str, Any]:
        return {"fraction": count / self.runs, "interval": self.interval_of(count / self.runs)}

    def _named(self, choices: Numbers) -> dict[str, str] | None:
        """Return {row: action}, or None where there are too many rows to list."""
        space, names = self.rows.space, self.mdp.actions
        if space.size > LISTED_ROWS:
            return None
        alone = len(space.columns) == 1 and not space.extra
        label = space.columns[0].label if alone else space.label
        return {label(row): names[action] for row, action in enumerate(choices.tolist())}


def _percent(interval: Interval, form: str = ".1%") -> str:
    return f"{interval[0]:{form}} to {interval[1]:{form}}"


def _spread(values: Floats) -> dict[str, Any]:
    quantiles = zip(map(str, QUANTILES), np.quantile(values, QUANTILES).tolist(), strict=True)
    return {
        "mean": float(values.mean()),
        "mean_interval": None,
        "quantiles": dict(quantiles),
        "greatest": float(values.max()),
    }


def _tables(facts: dict[str, Any], runs: int) -> dict[str, Table]:
    most = facts["policies"][0]["policy"]

    def named(policy: dict[str, str] | None) -> str:
        if policy is None:
            return "as most runs"
        shown = {row: a for row, a in policy.items() if policy is most or a != most[row]}
        return ", ".join(f"{row} {action}" for row, action in shown.items())

    changed = [{"row": row} | each for row, each in facts["changed_in_last"].items()]
    changed.sort(key=lambda each: -each["fraction"])
    last = [
        {"many": int(many), "share": each["count"] / runs} | each
        for many, each in facts["distinct_in_last"].items()
    ]
    return {
        "policies": Table(
            title="final greedy policies, and where they differ from the first",
            rows=[each | {"policy": named(each["policy"])} for each in facts["policies"]],
            columns={"runs": "count", "value": "value", "regret": "regret", "policy": "policy"},
            first=SHOWN,
        ),
        "distinct_in_last": Table(
            title="how many policies are greedy in the last episodes of a run",
            rows=[each | {"interval": _percent(each["interval"])} for each in last],
            columns={"policies": "many", "runs": "count", "share": "share:.1%", "95 %": "interval"},
        ),
        "changed_in_last": Table(
            title="where these policies differ",
            rows=[each | {"interval": _percent(each["interval"])} for each in changed],
            columns={"row": "row", "share of runs": "fraction:.1%", "95 %": "interval"},
        ),
    }


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

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.solvers.learning.q_learning import QLearning
    >>> from exact_mdp.solvers.learning.training import train
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> runs = outcomes(mdp, train(mdp, QLearning(epochs=300), 12, rng=0))
    >>> runs.counts.sum(), bool((runs.learning_error <= runs.regret).all())
    (np.int64(12), True)
    """
    mdp, rows = model, common_rows(model, runs)
    known: dict[tuple[int, ...], int] = {}

    def number(policy: Numbers) -> int:
        return known.setdefault(tuple(policy.tolist()), len(known))

    candidates = [[number(run.policies[i]) for i in run.last_counts()][:CANDIDATES] for run in runs]
    final = np.array([number(run.final) for run in runs])
    values = policy_values(mdp, rows, policies := np.array([*known]))
    worth = mdp.sign * values.value
    selected = np.array([max(tried, key=lambda i: worth[i]) for tried in candidates])
    used = np.union1d(final, selected)
    used = used[np.argsort(-np.bincount(final, minlength=len(known))[used], kind="stable")]
    place = np.empty(len(known), dtype=np.int64)
    place[used] = np.arange(len(used))
    recent = [run.policies[np.unique(run.last)] for run in runs]
    partial = len(rows.space.columns) < len(mdp.space.columns)
    return Outcomes(
        mdp=mdp,
        rows=rows,
        policies=policies[used],
        value=values.value[used],
        error=values.error[used],
        final=place[final],
        selected=place[selected],
        distinct=np.array([len(each) for each in recent]),
        changed=np.array([(each != each[0]).any(axis=0) for each in recent]),
        optimum=solve(mdp).start,
        best=best_policy(mdp, rows.space.names) if partial and bound else None,
        candidates=tuple((n, runs[0].policies[k]) for k, n in runs[0].last_counts().items()),
        steps=sum(run.steps for run in runs),
        cut_short=sum(run.cut_short for run in runs),
    )


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
