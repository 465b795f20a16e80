"""The certificate of a verdict: the proofs of the optimum and of the policy's value.

Both are proven in the same way, so that both are the same total, or both an average: by values
alone where every policy of the model ends, else by gain and bias, or with a goal by the proof of
where values are infinite (`solvers.exact.find`).
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import certify, certify_and_check, proven_optimum
from exact_mdp.solvers.exact.find import prove_gain_and_bias, prove_goal_total
from exact_mdp.solvers.exact.regret import DrawnPairs, RegretCertificate
from exact_mdp.solvers.values.policy_chain import PolicyChain


def certify_regret(chain: PolicyChain, *, average: bool) -> RegretCertificate:
    """Return the proof of a policy's regret; raises ModelError as `certify` does."""
    mdp = chain.mdp
    if average:
        best = certify_and_check(mdp.maximised, "average")
    else:
        best = proven_optimum(mdp.maximised)  # the proof that the audit has already found
    best = _of_sense(best, mdp)
    own = _prove_value(_isolate_policy(chain), best)
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


def _of_sense(proof: Certificate, mdp: MDP) -> Certificate:
    """Return a model's proof, given that of the same model with rewards that are maximised."""
    if mdp.sense == "max":
        return proof
    return replace(
        proof, mdp=mdp, model=fingerprint(mdp), sense="min", start_value=-proof.start_value
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
    return certify(alone)


def _compute_loss(mdp: MDP, best: Fraction | float, own: Fraction | float) -> Fraction | float:
    """Return the loss of a value against the best one; either may be infinite."""
    if isinstance(best, Fraction) and isinstance(own, Fraction):
        return mdp.sign * (best - own)
    infinite = [0.0 if isinstance(x, Fraction) else x for x in (best, own)]
    return mdp.sign * (infinite[0] - infinite[1])
