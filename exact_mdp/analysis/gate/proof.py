"""The certificate of a verdict: the proofs of the optimum and of the policy's value.

Both are proven in the same way, so that both are the same total, or both an average: by values
alone where every policy of the model ends, else by gain and bias, or with a goal by the proof of
where values are infinite (`solvers.exact.find`).
"""

from __future__ import annotations

from fractions import Fraction
from functools import partial

import numpy as np

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import certify_and_check, prove_total, proven_optimum
from exact_mdp.solvers.exact.find import prove_gain_and_bias, prove_goal_total
from exact_mdp.solvers.exact.regret import DrawnPairs, RegretCertificate
from exact_mdp.solvers.solution import answer_maximised
from exact_mdp.solvers.values.policy_chain import PolicyChain


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
