"""The numbers of the reproduction: paper, exact, difference, and what kind of claim each is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdp import MDP, Policy, Scenario
from paper_repro import reported
from solvers import evaluate, solve
from solvers.evaluation import Evaluation


@dataclass(frozen=True, kw_only=True)
class Number:
    """One number of the paper beside the exact one.

    `difference` is exact - paper; `standard_error` is the exact one of the paper's average over
    `reported.EXPERIMENTS` runs; `lowest` and `highest` span what the paper leaves open.
    """

    name: str
    source: str
    paper: float | None
    exact: float
    claim: str
    approximate: bool = False
    sd: float | None = None
    standard_error: float | None = None
    lowest: float | None = None
    highest: float | None = None

    @property
    def difference(self) -> float | None:
        """Exact minus paper."""
        return None if self.paper is None else self.exact - self.paper

    @property
    def standard_errors(self) -> float | None:
        """The difference in standard errors, where the paper's number is an average of runs."""
        if self.difference is None or not self.standard_error or self.approximate:
            return None
        return self.difference / self.standard_error

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of `numbers.json`."""
        row = asdict(self)
        row |= {
            "difference": self.difference,
            "difference_in_standard_errors": self.standard_errors,
        }
        return row


@dataclass(frozen=True, kw_only=True)
class Study:
    """The default reading, its optimum and the policies that the paper speaks of."""

    scenario: Scenario
    mdp: MDP
    optimum: NDArray[np.int64]
    policies: dict[str, Policy]
    evaluations: dict[str, Evaluation]
    spread: dict[str, tuple[float, float]]
    completion: dict[str, str]


def study(scenario: Scenario) -> Study:
    """Solve the scenario and evaluate the policies that the paper speaks of."""
    mdp = scenario.compile()
    optimum = solve(mdp).policy
    completion, spread = _completed(mdp)
    policies = {
        "optimal": Policy.from_choices(mdp, optimum),
        "random": Policy.uniform(mdp),
        **{
            f"reported.{start}": Policy.of(mdp, reported.policy(start, completion))
            for start in reported.AVERAGE_RETURN
        },
    }
    return Study(
        scenario=scenario,
        mdp=mdp,
        optimum=optimum,
        policies=policies,
        evaluations={name: evaluate(mdp, policy) for name, policy in policies.items()},
        spread=spread,
        completion=completion,
    )


def _completed(mdp: MDP) -> tuple[dict[str, str], dict[str, tuple[float, float]]]:
    """Return the completion with the highest value, and the range over all of them."""
    choices = reported.completions()
    means: dict[str, NDArray[np.float64]] = {}
    for start in reported.AVERAGE_RETURN:
        columns = [
            Policy.of(mdp, reported.policy(start, filled)).weights(mdp) for filled in choices
        ]
        means[start] = _start_values(mdp, np.stack(columns, axis=1))
    final = max(reported.AVERAGE_RETURN, key=lambda start: reported.AVERAGE_RETURN[start])
    spread = {f"reported.{s}": (float(m.min()), float(m.max())) for s, m in means.items()}
    return choices[int(np.argmax(means[final]))], spread


def _start_values(mdp: MDP, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n,) start values of n policies at once, given as (L, n) pair probabilities."""
    value = np.zeros((mdp.n_states, weights.shape[1]))
    while True:
        q = mdp.reward[:, None] + mdp.discount * (mdp.transition @ value)
        following = np.add.reduceat(weights * q, mdp.pair_offsets[:-1], axis=0)
        if np.array_equal(following, value):  # acyclic: reached after as many sweeps as steps
            return np.asarray(mdp.start_distribution @ value)
        value = following


def all_numbers(result: Study) -> list[Number]:
    """Return every number of the paper that can be stated now, with the exact one."""
    return [*_returns(result), *_table_3(result), *_table_4(result)]


def _returns(result: Study) -> Iterator[Number]:
    where = "Section 4.1"
    stated = {
        "optimal": (reported.CONVERGED_RETURN, f"{where}, average after convergence, about", True),
        "random": (reported.RANDOM_RETURN, f"{where}, random strategy, around", True),
        **{
            f"reported.{start}": (mean, f"{where}, policy with {start} in 0000, 1,000 runs", False)
            for start, mean in reported.AVERAGE_RETURN.items()
        },
    }
    for name, (paper, source, approximate) in stated.items():
        found = result.evaluations[name]
        lowest, highest = result.spread.get(name, (None, None))
        yield Number(
            name=f"return.{name}",
            source=source,
            paper=paper,
            exact=found.mean,
            claim=str(found.claim),
            approximate=approximate,
            sd=found.sd,
            standard_error=found.sd / sqrt(reported.EXPERIMENTS),
            lowest=lowest,
            highest=highest,
        )


def _table_3(result: Study) -> Iterator[Number]:
    """Read Table 3 back out of the compiled rows: marginals of the next status."""
    statuses = result.scenario.statuses
    alone = [1 << (len(statuses) - 1 - i) for i in range(len(statuses))]
    base = [_marginal(result.mdp, 0, bit) for bit in alone]
    for i, status in enumerate(statuses):
        stated, row = reported.TABLE_3[status]
        yield _entry(f"table3.base.{status}", "Table 3", stated, base[i])
        for j, target in enumerate(statuses):
            found = _marginal(result.mdp, alone[i], alone[j])
            if i == j:
                yield _entry(f"table3.persistence.{status}", "Table 3", row[j], found)
            else:
                name = f"table3.influence.{status}.{target}"
                yield _entry(name, "Table 3", row[j], found - base[j])


def _marginal(mdp: MDP, vector: int, bit: int) -> Fraction:
    """Return the exact probability that a status is 1 next, without assistance."""
    pair = mdp.pair(mdp.space.index(subtask=0, trial=0, status=vector), 0)
    rows = mdp.table.row(pair)
    states = np.array([state for _, state, _ in rows])
    hit = mdp.space.values("status", states) & bit != 0
    return sum((row[0] for row, yes in zip(rows, hit, strict=True) if yes), Fraction(0))


def _table_4(result: Study) -> Iterator[Number]:
    held = {parameter.name: parameter.value for parameter in result.mdp.parameters}
    for weight, paper in reported.TABLE_4.items():
        exact = float(held[f"reward.{weight}"])
        yield Number(
            name=f"table4.{weight}", source="Table 4", paper=paper, exact=exact, claim="certified"
        )


def _entry(name: str, source: str, per_cent: int, exact: Fraction) -> Number:
    return Number(
        name=name, source=source, paper=per_cent / 100, exact=float(exact), claim="certified"
    )
