"""What the claims are compared with: the optimum, the policies the paper speaks of, their values.

The text of the paper leaves the actions of four statuses open, and the order of two (see
`paper_repro.reported`): 512 completions. Three of them are named. With the order as written the
open statuses are filled in so that the final policy has its highest exact value: this is the
policy that "reported" names. The same with the order swapped is the second. The third is the one
that fits the three reported averages best, which judges them:

    χ²(completion) = Σ (mean - reported average)² / (variance / n) over the three policies.

The range over all completions stands beside every number that depends on them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp import MDP, Policy, Scenario
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import as_discount
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.search import STARTS
from exact_mdp.paper_repro.readings.search import policies as policies_of
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.values.evaluate import Evaluation


@dataclass(frozen=True, kw_only=True, eq=False)
class Completions:
    """Every way to fill in what the text leaves open, for each action in status 0000.

    Attributes
    ----------
    choices : list of {status: action}
    mean, variance : {action in 0000: (n,)}
        Of the return under each; floats, for comparison only.
    error : float
        How far a mean may be from the exact one.
    """

    choices: list[dict[str, str]]
    mean: dict[str, Floats]
    variance: dict[str, Floats]
    error: float

    def best(self, order: str = "as written") -> int:
        """Return the one of an order under which the final policy has its highest value."""
        listed = [n for n, each in enumerate(self.choices) if reported.order(each) == order]
        return max(listed, key=lambda number: float(self.mean[FINAL][number]))

    def score(self, start: str) -> Floats:
        """Return (n,) exact less reported, in exact standard errors of the reported average."""
        spread = np.sqrt(self.variance[start] / reported.EXPERIMENTS)
        return np.asarray((self.mean[start] - reported.AVERAGE_RETURN[start]) / spread)

    @cached_property
    def chi_squared(self) -> Floats:
        """(n,) sum of the three squared scores."""
        squares = [self.score(start) ** 2 for start in reported.AVERAGE_RETURN]
        return np.asarray(np.sum(squares, axis=0))

    @property
    def fitting(self) -> int:
        """The one that fits the three reported averages best, taken together."""
        return int(np.argmin(self.chi_squared))

    @property
    def probability(self) -> float:
        """Chance of a χ² on three degrees of freedom above the least of all completions."""
        from scipy.stats import chi2

        least = float(self.chi_squared[self.fitting])
        return float(chi2.sf(least, len(reported.AVERAGE_RETURN)))

    def range(self, start: str) -> tuple[float, float]:
        """Return the lowest and highest mean."""
        return float(self.mean[start].min()), float(self.mean[start].max())


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """A reading, its optimum and the policies that the paper speaks of.

    Attributes
    ----------
    scenario : Scenario
    mdp : MDP
    optimum : (S,) ints
        An optimal action of each state.
    policies : {name: Policy}
        "optimal", "random" and "reported.ACTION", by the action in status 0000.
    evaluations : {name: Evaluation}
    completions : Completions
    """

    scenario: Scenario
    mdp: MDP
    optimum: NDArray[np.int64]
    policies: dict[str, Policy]
    evaluations: dict[str, Evaluation]
    completions: Completions

    @property
    def completion(self) -> dict[str, str]:
        """How the reported policies are filled in: as written, with the highest value."""
        return self.completions.choices[self.completions.best()]


FINAL = max(reported.AVERAGE_RETURN, key=lambda start: reported.AVERAGE_RETURN[start])


def study(scenario: Scenario) -> Study:
    """Solve the scenario and evaluate the policies that the paper speaks of.

    Examples
    --------
    >>> found = study(Scenario.load("yuan2025"))
    >>> print(f"{found.evaluations['reported.non-directive'].mean:.4f}")
    142.0746
    """
    mdp = scenario.compile()
    optimum = solve(mdp).policy
    completions = complete(scenario)
    best = completions.choices[completions.best()]
    policies = {
        "optimal": Policy.from_choices(mdp, optimum),
        "random": Policy.uniform(mdp),
        **{
            f"reported.{start}": Policy.of(mdp, reported.policy(start, best))
            for start in reported.AVERAGE_RETURN
        },
    }
    return Study(
        scenario=scenario,
        mdp=mdp,
        optimum=optimum,
        policies=policies,
        evaluations={name: evaluate(mdp, policy) for name, policy in policies.items()},
        completions=completions,
    )


def complete(scenario: Scenario) -> Completions:
    """Evaluate the three reported policies under every completion, side by side."""
    from exact_mdp.solvers.care import policy_values

    choices = reported.completions()
    rate = [[float(as_discount(scenario.discount))]]
    chosen = policies_of(choices)
    found = policy_values(scenario, ["discount"], rate, chosen, second_moment=True, threads=1)
    assert found.variance is not None
    mean, variance = (x[0].reshape(-1, len(STARTS)).T for x in (found.mean, found.variance))
    return Completions(
        choices=choices,
        mean=dict(zip(STARTS, mean, strict=True)),
        variance=dict(zip(STARTS, variance, strict=True)),
        error=float(found.error[0]),
    )
