"""The certificate of a policy's regret: the optimum, the policy, its value, and the difference.

    exact-mdp check MODEL POLICY --certificate proof.json      check(model, policy).certificate

states an exact verdict, whether the policy passes or not. `exact-mdp verify proof.json MODEL` tells
later what the policy loses, without the file of the policy. The file has the kind "regret", model
and sense, and

    optimum   a certificate of an optimum, a total or an average, without format and version
    policy    `pairs`, the numbers of the pairs that the policy takes, in the order of states and
              actions; `weights`, a level with their probabilities, which sum to 1 in each state
    value     such a certificate of the policy's model
    regret    the loss at the start: a rational, or "inf"

In the policy's model each state has one pair, action 0, for the policy's draw: its row is
Σ weight · p(s'), its reward Σ weight · r. All else stays as it is. It has one policy,
so that the optimum is the value of the policy. Both certificates have the same kind, and the same
levels and ranks that are not null. The regret is the start value of the first less that of the
second; of costs, the other way round. If one of them is infinite and the other is not the same, it
is "inf".

A certificate says nothing of limits that a regret has to keep. In a model of floats `check`
forgives a loss that rounding can explain; the certificate is of the exact model and its regret.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import DataFrame
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.claims import Certified, Claim, in_float
from exact_mdp.solvers.exact.certificate import Certificate, Proof
from exact_mdp.solvers.exact.certify import certify_and_check, prove_total, proven_optimum
from exact_mdp.solvers.exact.find import prove_gain_and_bias, prove_goal_total
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.solution import answer_maximised, tabulate_by_state
from exact_mdp.solvers.values.policy_chain import PolicyChain


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

    sense: Sense
    optimum: Certificate
    policy: DrawnPairs
    value: Certificate
    regret: Fraction | float

    claim: ClassVar[Claim] = Claim.CERTIFIED
    kinds: ClassVar[tuple[str, ...]] = ("regret",)

    def __repr__(self) -> str:
        lost, own = in_float(self.regret), in_float(self.value.start_value)
        best = in_float(self.optimum.start_value)
        return (
            f"RegretCertificate(regret {lost:.12g}: worth {own:.12g} at the start, "
            f"the optimum {best:.12g})"
        )

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


# ---- finding one ---------------------------------------------------------------------------------

# Both proofs are made in the same way: by values alone where every policy of the model ends, else
# by gain and bias, or with a goal by the proof of where values are infinite (`solvers.exact.find`).


def certify_regret(chain: PolicyChain, *, average: bool) -> RegretCertificate:
    """Return the proof of a policy's regret; raises ModelError as `certify` does."""
    mdp = chain.mdp
    find_best = proven_optimum  # the proof that the audit has already found
    if average:
        find_best = partial(certify_and_check, criterion="average")
    best = answer_maximised(mdp, find_best)
    own = answer_maximised(_isolate_policy(chain), partial(_prove_value, best=best))
    weights = dict[int, Fraction]()
    for state in range(mdp.n_states):
        weights |= chain.exact_weights(state)
    return RegretCertificate(
        kind="regret",
        mdp=mdp,
        model=fingerprint(mdp),
        sense=mdp.sense,
        optimum=best,
        policy=DrawnPairs.of(weights),
        value=own,
        regret=_compute_loss(mdp, best.start_value, own.start_value),
    )


def _isolate_policy(chain: PolicyChain) -> MDP:
    """Return the model in which the policy's draw, number 0, is the only action of each state."""
    none = np.zeros(chain.mdp.n_states, dtype=np.int64)
    return chain.model.with_(pair_action=none, actions=("drawn",))


def _prove_value(alone: MDP, best: Certificate) -> Certificate:
    """Return the proof of a policy's value, by the same rules as the optimum."""
    if best.infinite is not None:
        return prove_goal_total(alone)
    if best.g is not None:
        return prove_gain_and_bias(alone, best.kind)
    return prove_total(alone)


def _compute_loss(mdp: MDP, best: Fraction | float, own: Fraction | float) -> Fraction | float:
    """Return the loss of a value against the best one; either may be infinite."""
    if isinstance(best, Fraction) != isinstance(own, Fraction):
        best, own = (0.0 if isinstance(x, Fraction) else x for x in (best, own))
    lost: Fraction | float = mdp.sense.loss(best, own)
    return lost
