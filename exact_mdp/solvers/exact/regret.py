"""The certificate of a policy's regret: the optimum, the policy, its value, and the difference.

A policy that draws its actions is the only policy of a model in which each state has one pair, its
draw, with the means of its pairs' rows and rewards. So the value of the policy is the optimum of
that model, and has a certificate by the same rules. The regret is the difference at the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Self

import numpy as np

from exact_mdp.mdp.result import DataFrame
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.exact.certificate import Certificate, Proof
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.solution import Certified, Claim, in_float, tabulate_by_state


@dataclass(frozen=True, eq=False)
class DrawnPairs:
    """The pairs (K,) that a policy takes, in rising order, with their probabilities."""

    pairs: Integers
    weights: Level

    @classmethod
    def of(cls, numbers: Mapping[int, Fraction]) -> Self:
        """Return the pairs of given probabilities {pair: probability}, all above 0."""
        pairs = sorted(numbers)
        weights = Level.of([numbers[pair] for pair in pairs])
        return cls(pairs=np.array(pairs, dtype=np.int64), weights=weights)

    def to_numbers(self) -> dict[int, Fraction]:
        """Return the probability of each pair."""
        return dict(zip(self.pairs.tolist(), self.weights.to_fractions(), strict=True))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RegretCertificate(Proof):
    """The regret of a policy at the start, with the proofs of the optimum and of its value.

    Attributes
    ----------
    kind : "regret"
    sense : "max" or "min"
        Whether the numbers of the model are rewards or costs.
    optimum : Certificate
        The optimum of the model, with its proof.
    policy : DrawnPairs
        The pairs that the policy takes, with their probabilities.
    value : Certificate
        The value of the policy, with its proof: the optimum of the model in which the draws of the
        policy are the only actions.
    regret : Fraction, or an infinite float
        The optimum less the value at the start; of costs, the value less the optimum.
    model, mdp
        See `Proof`.

    Examples
    --------
    >>> from exact_mdp import MDP, check
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> proof = check(mdp, [[0.5, 0.5], [1, 0]], kind="policy").certificate
    >>> proof.regret, proof.value.start_value, proof.optimum.start_value
    (Fraction(1, 1), Fraction(2, 1), Fraction(3, 1))
    >>> proof.violations()
    []
    """

    sense: str
    optimum: Certificate
    policy: DrawnPairs
    value: Certificate
    regret: Fraction | float

    claim: ClassVar[Claim] = Claim.CERTIFIED
    kinds: ClassVar[tuple[str, ...]] = ("regret",)

    def __repr__(self) -> str:
        lost, own, best = (
            f"{in_float(x):.12g}"
            for x in (self.regret, self.value.start_value, self.optimum.start_value)
        )
        return f"RegretCertificate(regret {lost}: worth {own} at the start, the optimum {best})"

    @property
    def start(self) -> Certified:
        """The regret at the start as a claim."""
        return Certified(value=self.regret)

    @property
    def criterion(self) -> str:
        """The criterion of optimality: "total" or "average"."""
        return self.optimum.kind

    def frame(self) -> DataFrame:
        """Return the optimal value of each state, and the value of the policy, exactly."""
        columns: dict[str, Any] = {"optimal": self.optimum.value, "learned": self.value.value}
        return tabulate_by_state(self.mdp, columns)
