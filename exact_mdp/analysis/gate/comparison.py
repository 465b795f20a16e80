"""Several policies of one model side by side: the exact value of each, and what it loses.

The optimum is found once; each policy's regret is then that of `analysis.gate.regret`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from exact_mdp.analysis.gate.regret import Regret, policy_regret
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.solvers.solution import Bounded, Certified, Claim
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import PolicyChain, policy_of

if TYPE_CHECKING:
    from fractions import Fraction

    from pandas import DataFrame

    from exact_mdp.mdp.model import MDP

LONGEST = 40  # letters of an exact number in a table


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PolicyComparison(Pictured):
    """What policies are worth at the start.

    Attributes
    ----------
    regrets : {name: Regret}
        In the order given; `.learned` is the policy's value, `.at_start` its regret.
    """

    regrets: dict[str, Regret]

    @property
    def value(self) -> Certified | Bounded:
        """The optimal value at the start."""
        return next(iter(self.regrets.values())).optimal

    @property
    def claim(self) -> Claim:
        """What the values claim."""
        return self.value.claim

    def frame(self) -> DataFrame:
        """Return a row for each policy; `exact` is a rational value of at most 40 letters.

        However long they are, certified values are the rationals `.regrets[NAME].learned.value`.
        """
        import pandas

        return pandas.DataFrame(
            [
                {
                    "policy": name,
                    "value": float(each.learned.value),
                    "regret": float(each.at_start.value),
                    "exact": _short(each.learned),
                    "claim": str(each.learned.claim),
                }
                for name, each in self.regrets.items()
            ]
        )

    def __repr__(self) -> str:
        return f"PolicyComparison({len(self.regrets)} policies; optimal value {self.value})"


def _short(value: Certified | Bounded) -> Fraction | float | None:
    """Return a certified value that a column of a table has room for."""
    if not isinstance(value, Certified) or len(str(value.value)) > LONGEST:
        return None
    return value.value


def compare(model: MDP | Scenario, policies: Mapping[str, PolicyLike]) -> PolicyComparison:
    """Return the start value and the loss of each of several policies.

    Parameters
    ----------
    model : MDP or Scenario
    policies : {name: PolicyLike}

    Returns
    -------
    PolicyComparison

    Raises
    ------
    ModelError
        Without policies, and for one that does not fit the model.

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> found = compare(mdp, {"mine": [0, 0], "coin": "random", "best": "optimal"})
    >>> found.frame()["exact"].tolist()
    [Fraction(1, 1), Fraction(2, 1), Fraction(3, 1)]
    """
    if not isinstance(policies, Mapping) or not policies:
        said = "no policies" if isinstance(policies, Mapping) else "policies without names"
        raise ModelError(said, where="compare", fix="give {name: policy}, at least one")
    mdp, regrets = mdp_of(model), dict[str, Regret]()
    optimum = None
    for name, policy in policies.items():
        chain = PolicyChain.of(mdp, policy_of(mdp, policy))
        regrets[name] = regret = policy_regret(chain, optimum=optimum)
        optimum = regret.optimum
    return PolicyComparison(regrets=regrets)
