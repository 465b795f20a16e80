"""The audit of a policy or Q-table from anywhere against the exact optimum.

    audit = check(mdp, learned, max_regret=…)   # how much it loses, where, and why
    assert_policy_optimal(mdp, learned)         # the same as an assertion

No number in a verdict is sampled: see `analysis.gate.regret` for what is lost,
`analysis.gate.disagreements` for the price of each state, `analysis.gate.representation` for what
the policy's columns cannot express, `analysis.gate.q_error` for the action values. Ties are known:
an action as good as the best is optimal.
"""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.disagreements import disagreements, own_visits
from exact_mdp.analysis.gate.q_error import pair_values
from exact_mdp.analysis.gate.regret import LAST_CYCLE, Regret, cheap, regret
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import LARGEST, exact, shown
from exact_mdp.solvers.solution import Certified, SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain, policy_of


def check(
    mdp: MDP,
    learned: object,
    *,
    max_regret: object | None = None,
    max_relative_regret: object | None = None,
    exact_values: bool | None = None,
    kind: str = "auto",
    horizon: int | None = None,
) -> Audit:
    """Return how much a policy or Q-table loses against the optimum, where and why.

    Parameters
    ----------
    mdp : MDP
    learned : Policy, str, path, mapping, array, Solution or TrainingRun
        Whatever `Policy.of` takes, Q-tables included. Of these the greedy policy counts, the lowest
        action number on a tie.
    max_regret, max_relative_regret : number or "p/q", optional
        Limits for the regret at the start and for its ratio to the absolute optimal value, which is
        undefined where that is 0, and does not pass. Without either, the audit passes only where
        the regret is zero: in a model of floats, where it is at most what the rounding of the
        numbers given can move (`Audit.forgiven`). A limit of 0 forgives nothing.
    exact_values : bool, optional
        Rational arithmetic or bounds in floats; see `analysis.gate.regret.regret`. Unless given,
        bounds that leave a verdict open are followed by rational arithmetic in models of up to
        100,000 transitions without cycles of over 200 states.
    kind : "auto", "q" or "policy"
        What a two-dimensional array or a file of one holds; `mdp.policies.arrays` states the rule
        of "auto", and `Audit.read_as` says what was taken.
    horizon : int, optional
        Stop after so many steps, without a further reward: the audit is that of
        `mdp.within(horizon)`. What is learned over states is the same at every time there; tables
        (N, S, A) depend on time.

    Raises
    ------
    ModelError
        For a policy that does not fit the model, an array that may be read in two ways, or a limit
        that is no number of at least 0; at discount 1 where not every policy ends.

    Examples
    --------
    >>> wait, cut = [[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]], [[1, 0, 0]] * 3
    >>> forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
    >>> audit = check(forest, [0, 1, 1])
    >>> audit.passed, round(float(audit.regret.at_start.value), 3), round(audit.agreement, 3)
    (False, 63.062, 0.333)
    """
    if horizon is not None:
        mdp = mdp.within(horizon)
    limits = {
        "max_regret": _limit("max_regret", max_regret),
        "max_relative_regret": _limit("max_relative_regret", max_relative_regret),
    }
    policy = policy_of(mdp, learned, kind=kind)
    chain = PolicyChain.of(mdp, policy)
    said = None if policy.values is None else pair_values(mdp, policy, policy.values)

    def audit(lost: Regret) -> Audit:
        visits = own_visits(chain, exact=isinstance(lost.at_start, Certified))
        return Audit(
            mdp=mdp,
            policy=policy,
            chain=chain,
            regret=lost,
            visits=visits.value,
            disagreements=disagreements(mdp, chain, lost, visits),
            said=said,
            read_as=policy.read_as,
            source=policy.source,
            **limits,
        )

    try:
        result = audit(regret(mdp, chain, exact=exact_values))
    except SolverError:  # floats cannot bound the answer, which rational arithmetic may give
        if exact_values is not None or not cheap(mdp, LAST_CYCLE):
            raise
        return audit(regret(mdp, chain, exact=True))
    if exact_values is None and result.undecided and cheap(mdp, LAST_CYCLE):
        with suppress(ModelError):  # a cycle that is too ill-conditioned leaves it undecided
            return audit(regret(mdp, chain, exact=True))
    return result


def assert_policy_optimal(
    mdp: MDP,
    policy: object,
    max_regret: object | None = None,
    *,
    max_relative_regret: object | None = None,
    kind: str = "auto",
    horizon: int | None = None,
) -> Audit:
    """Raise AssertionError, naming the costly states, unless the regret keeps its limits.

    Parameters
    ----------
    mdp : MDP
    policy : Policy, str, path, mapping, array, Solution or TrainingRun
        A policy or Q-table; see `check`.
    max_regret, max_relative_regret : number or "p/q", optional
        Limits at the start; both must hold. Without either the regret must be zero; see `check`.
    kind : "auto", "q" or "policy"
        What a two-dimensional array holds; see `check`.
    horizon : int, optional
        Stop after so many steps; see `check`.

    Returns
    -------
    Audit
        For further checks.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> assert_policy_optimal(mdp, [0, 0])
    Traceback (most recent call last):
    AssertionError: failed: the regret is zero; it is 2 (certified)
    optimal value 3, learned 1; not optimal in 1 of 1 states with a choice
      (state 0): 0, not 1; gap 2 x 1 visits = 2
    """
    audit = check(
        mdp,
        policy,
        max_regret=max_regret,
        max_relative_regret=max_relative_regret,
        kind=kind,
        horizon=horizon,
    )
    if not audit.passed:
        raise AssertionError(audit.message())
    return audit


def _limit(name: str, limit: object | None) -> Fraction | None:
    if limit is None:
        return None
    try:
        found = exact(limit)
    except ModelError as error:
        raise ModelError(error.what, where=name, fix=error.fix) from error
    if found < 0:
        raise ModelError(f"{name} is {shown(found)}", where=name, fix="choose 0 or more")
    if found > LARGEST:
        raise ModelError(
            f"{name} is {shown(found)}, beyond the floats", where=name, fix="choose less"
        )
    return found
