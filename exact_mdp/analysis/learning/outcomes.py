"""The policies that learning ends with, judged by exact values instead of experiments.

The final greedy policy of every run has an exact value, so its regret V* - V^π is known, and only
the seeds are a sample: over runs, intervals are Wilson's for shares (JASA 22, 1927) and BCa
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
from exact_mdp.analysis.vary.intervals import estimate_share, mean_interval
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import MOST_LISTED, Report, Shown, Table, format_number
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.claims import Bounded, compute_regrets
from exact_mdp.solvers.learning.q_learning import TrainingRun
from exact_mdp.solvers.learning.row_policies import common_rows, evaluate_row_policies
from exact_mdp.solvers.learning.sampler import QTableRows
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import QUANTILES, evaluate

CANDIDATES = 5  # of a run's last epochs: the policies that were greedy most often
Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Outcomes(Pictured):
    """Final policies of R runs, U of them distinct, with their exact values at the start."""

    mdp: MDP  # values are those at its discount
    rows: QTableRows
    policies: Numbers  # (U, K) final and selected greedy ones, the most frequent final one first
    value: Floats  # (U,) exact up to the error
    error: Floats
    final: Integers  # (R,) which of them each run ended with
    selected: Integers  # (R,) which it would select among its candidates
    distinct: Integers  # (R,) how many were greedy in each run's last episodes
    changed: NDArray[np.bool_]  # (R, K) rows in which these differ
    optimum: Bounded
    best: BestPolicy | None  # that reads what the learner reads; None if that is everything
    first_run: dict[
        str, Any
    ]  # the most frequent greedy policy in the last episodes of the first run
    steps: int  # in all runs together
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
        return self._compute_regrets(self.optimum)

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
        return self._compute_regrets(self.best_value)[self.final]

    def _compute_regrets(self, reference: Bounded) -> Floats:
        best = np.full_like(self.value, reference.value)
        return compute_regrets(best, self.value, self.error + reference.error, self.mdp.sense)

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

    def _estimate_share(self, count: int) -> dict[str, Any]:
        """Return the share of `count` runs, with Wilson's 95 % interval."""
        share = estimate_share(count, self.runs)
        return {"fraction": share.value, "interval": share.interval}

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
        """Return the final policies of the runs."""
        # Shares of runs without a loss, and the losses: against the optimum, against the best
        # policy that reads the same, and after a selection.
        best, ends = self.best, self.regret_interval
        losses = self.regret, self.learning_error, self.selected_regret
        optimal, good, chosen = (self._estimate_share(int((each == 0).sum())) for each in losses)
        lost, learning, selected = map(_summarise_losses, losses)
        shown = []
        for q, v in lost["quantiles"].items():
            shown.append(f"{float(q):.0%}: {format_number(v)}")
        quantiles = ", ".join(shown)
        apart = "" if ends is None else f" (95 %: {_format_percent_interval(ends, '.4g')})"
        mean = f"mean regret {format_number(lost['mean'])}{apart}; quantiles {quantiles}"
        # Each final policy with its share of the runs.
        rows = zip(self.frame().to_dict("records"), self.policies[self.counts > 0], strict=True)
        listed = []
        for row, rule in rows:
            choices = _name_choices(self.mdp, self.rows, rule)
            listed.append(row | self._estimate_share(row["count"]) | {"policy": choices})
        # How many policies the runs have in their last episodes, and where these differ.
        many, runs = np.unique(self.distinct, return_counts=True)
        distinct = {}
        for n, k in zip(many, runs.tolist(), strict=True):
            distinct[str(n)] = {"count": k} | self._estimate_share(k)
        shown_distinct = {}
        for number, each in distinct.items():
            shown_distinct[number] = {"count": each["count"], "interval": each["interval"]}
        labels = self.rows.space.labels(range(self.rows.space.size))
        changes = zip(labels, self.changed.sum(axis=0).tolist(), strict=True)
        changed = {row: self._estimate_share(count) for row, count in changes if count}
        facts = {
            "seeds": self.runs,
            "columns": self.rows.space.names,
            "claim": Shown("estimated"),
            "value_claim": Shown("bounded"),
            "optimal_value": Shown(self.optimum.value, self.optimum),
            "optimal_value_error": Shown(self.optimum.error),
            "random_value": evaluate(self.mdp, "random").mean,
            "best_value": Shown(self.best_value.value, self.best_value),
            "best_value_upper_bound": Shown(best.upper_bound if best else self.optimum.value),
            "best_value_proven": best.proven if best else True,
            "regret": Shown(lost | {"mean_interval": ends}, mean),
            "optimal_fraction": Shown(
                optimal["fraction"],
                f"{optimal['fraction']:.1%} of the runs end optimal "
                f"(95 %: {_format_percent_interval(optimal['interval'])})",
            ),
            "optimal_fraction_interval": Shown(optimal["interval"]),
            "learning_error": Shown(learning, f"mean {format_number(learning['mean'])}"),
            "best_fraction": Shown(good["fraction"], f"{good['fraction']:.1%}"),
            "best_fraction_interval": Shown(good["interval"]),
            "selected": Shown(
                {"regret": selected, "optimal_fraction": chosen["fraction"]},
                f"mean regret of the best of five {format_number(selected['mean'])}",
            ),
            "first_run": Shown(self.first_run),
            "policies": listed,
            "distinct_in_last": shown_distinct,
            "changed_in_last": changed,
            "steps": self.steps,
            "cut_short": self.cut_short,
            "written": [],
        }

        # For people, later policies are described by their difference from the most frequent one.
        usual = listed[0]["policy"]

        def apart_from_usual(policy: dict[str, str] | None) -> str:
            if policy is None or usual is None:
                return "as most runs"
            own = {r: a for r, a in policy.items() if policy is usual or a != usual[r]}
            return ", ".join(f"{row} {action}" for row, action in own.items())

        def rows_of(shares: dict[str, Any]) -> list[dict[str, Any]]:
            listed = []
            for k, s in shares.items():
                listed.append({"": k} | s | {"interval": _format_percent_interval(s["interval"])})
            return listed

        share = {"share of runs": "fraction:.1%", "95 %": "interval"}
        tables = {
            "policies": Table(
                title="final greedy policies, and where they differ from the first",
                rows=[each | {"policy": apart_from_usual(each["policy"])} for each in listed],
                columns={"runs": "count", "value": "value", "regret": "regret", "policy": "policy"},
                first=10,
            ),
            "distinct_in_last": Table(
                title="how many policies are greedy in the last episodes of a run",
                rows=rows_of(distinct),
                columns={"policies": "", "runs": "count"} | share,
            ),
            "changed_in_last": Table(
                title="where these policies differ",
                rows=sorted(rows_of(changed), key=lambda each: -each["fraction"]),
                columns={"row": ""} | share,
            ),
        }
        return Report(title="training", facts=facts, tables=tables)


def _name_choices(mdp: MDP, rows: QTableRows, choices: Numbers) -> dict[str, str] | None:
    """Return {row: action}, or None if there are too many rows to list."""
    space = rows.space
    if space.size > MOST_LISTED:
        return None
    label = space.columns[0].label if len(space.columns) == 1 and not space.extra else space.label
    return {label(row): mdp.actions[action] for row, action in enumerate(choices.tolist())}


def _format_percent_interval(interval: Interval, form: str = ".1%") -> str:
    return f"{interval[0]:{form}} to {interval[1]:{form}}"


def _summarise_losses(values: Floats) -> dict[str, Any]:
    quantiles = zip(map(str, QUANTILES), np.quantile(values, QUANTILES).tolist(), strict=True)
    return {
        "mean": float(values.mean()),
        "mean_interval": None,
        "quantiles": dict(quantiles),
        "greatest": float(values.max()),
    }


def outcomes(model: MDP, runs: Sequence[TrainingRun], *, bound: bool = True) -> Outcomes:
    """Return the final policies of runs on a model and their values at its discount.

    Parameters
    ----------
    model : MDP
    runs : sequence of TrainingRun
    bound : bool
        Also find the best policy that reads what the learner reads, unless that is everything.

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
    # Number the different policies: each is evaluated only once.
    mdp, rows = model, common_rows(model, runs)
    known: dict[tuple[int, ...], int] = {}

    def number(policy: Numbers) -> int:
        return known.setdefault(tuple(policy.tolist()), len(known))

    candidates = []
    for run in runs:
        candidates.append([number(run.policies[i]) for i in run.last_counts()][:CANDIDATES])
    final = np.array([number(run.final) for run in runs])
    values = evaluate_row_policies(mdp, rows, policies := np.array([*known]))
    # Each run selects the best of its candidates by exact value.
    reward = mdp.sense.sign * values.value
    selected = np.array([max(tried, key=lambda i: reward[i]) for tried in candidates])
    # Renumber the policies that are final or selected, the most frequent final one first.
    used = np.union1d(final, selected)
    used = used[np.argsort(-np.bincount(final, minlength=len(known))[used], kind="stable")]
    place = np.empty(len(known), dtype=np.int64)
    place[used] = np.arange(len(used))
    # The policies of the last episodes: of each run, and by frequency in the first run.
    recent, last = [run.policies[np.unique(run.last)] for run in runs], runs[0].last_counts()
    top = zip(last.values(), candidates[0], strict=False)
    partial = len(rows.space.columns) < len(mdp.space.columns)
    first = []
    for episodes, index in top:
        first.append(
            {
                "episodes": episodes,
                "value": float(values.value[index]),
                "error_bound": float(values.error[index]),
                "policy": _name_choices(mdp, rows, policies[index]),
            }
        )
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
        first_run={"episodes": sum(last.values()), "distinct": len(last), "top": first},
        steps=sum(run.steps for run in runs),
        cut_short=sum(run.cut_short for run in runs),
    )
