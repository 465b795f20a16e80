"""The audit of a policy or Q-table from anywhere against the exact optimum.

    audit = check(mdp, learned, max_regret=…)   # how much it loses, where, and why
    assert_policy_optimal(mdp, learned)         # the same as an assertion

No number in a verdict is sampled: see `analysis.regret` for what is lost, `analysis.disagreements`
for the price of each state, `analysis.representation` for what the policy's columns cannot express,
`analysis.q_error` for the action values. Ties are known: an action as good as the best is optimal.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.audit import Audit
from analysis.disagreements import disagreements, own_visits
from analysis.q_error import pair_values
from analysis.regret import regret
from mdp.errors import ModelError
from mdp.model import MDP
from mdp.policy import Policy, by_time
from mdp.table import FLOAT_ROW_TOLERANCE, Floats, exact
from solvers.policy_chain import PolicyChain


def check(
    mdp: MDP,
    learned: object,
    *,
    max_regret: object | None = None,
    max_relative_regret: object | None = None,
    exact_values: bool | None = None,
    horizon: int | None = None,
) -> Audit:
    """Return how much a policy or Q-table loses against the optimum, where and why.

    Parameters
    ----------
    mdp : MDP
    learned : Policy, str, path, mapping, array, Solution or TrainingRun
        Whatever `Policy.of` takes, or a Q-table: a `.npy` or `.npz` file, or an array over the
        statuses or over all states that does not hold a distribution for every state with a choice.
        Of a Q-table the greedy policy counts, the lowest action number on a tie.
    max_regret, max_relative_regret : number or "p/q", optional
        Limits for the regret at the start and for its ratio to the absolute optimal value. Without
        either, the audit passes only where the regret is zero up to rounding.
    exact_values : bool, optional
        Rational arithmetic or bounds in floats; see `analysis.regret.regret`.
    horizon : int, optional
        Stop after so many steps, without a further reward: the audit is that of
        `mdp.within(horizon)`. What is learned over states is the same at every time there; tables
        (N, S, A) depend on time.

    Raises
    ------
    ModelError
        For a policy that does not fit the model; at discount 1 where not every policy ends.

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
    policy, said = _learned(mdp, learned)
    chain = PolicyChain.of(mdp, policy)
    lost = regret(mdp, chain, exact=exact_values)
    visits = own_visits(chain)
    return Audit(
        mdp=mdp,
        policy=policy,
        chain=chain,
        regret=lost,
        visits=visits,
        disagreements=disagreements(mdp, chain, lost, visits),
        said=said,
        max_regret=_limit("max_regret", max_regret),
        max_relative_regret=_limit("max_relative_regret", max_relative_regret),
    )


def assert_policy_optimal(
    mdp: MDP,
    policy: object,
    max_regret: object = 1e-9,
    *,
    max_relative_regret: object | None = None,
    horizon: int | None = None,
) -> Audit:
    """Raise AssertionError, naming the costly states, unless the regret is at most `max_regret`.

    Parameters
    ----------
    mdp : MDP
    policy : Policy, str, path, mapping, array, Solution or TrainingRun
        A policy or Q-table; see `check`.
    max_regret, max_relative_regret : number or "p/q"
        Limits at the start; both must hold.
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
    AssertionError: failed: the regret is at most 1e-09; it is 2 (certified)
    optimal value 3, learned 1; not optimal in 1 of 1 states with a choice
      (state 0): 0, not 1; gap 2 x 1 visits = 2
    """
    audit = check(
        mdp,
        policy,
        max_regret=max_regret,
        max_relative_regret=max_relative_regret,
        horizon=horizon,
    )
    if not audit.passed:
        raise AssertionError(audit.message())
    return audit


def _learned(mdp: MDP, learned: Any) -> tuple[Policy, Floats | None]:
    """Return a policy, and the action values (L,) where a Q-table was given."""
    if isinstance(learned, str | Path) and Path(learned).suffix.lower() in (".npy", ".npz"):
        from mdp.policy_file import read_array

        policy = Policy.of(mdp, learned)
        return policy, pair_values(mdp, policy, read_array(learned))
    if hasattr(learned, "q") and callable(getattr(learned, "policy", None)):
        policy = learned.policy(mdp)
        return policy, pair_values(mdp, policy, learned.q)
    if isinstance(getattr(learned, "policy", None), np.ndarray):
        return Policy.from_choices(mdp, learned.policy), None
    if not isinstance(learned, np.ndarray | list | tuple):
        return Policy.of(mdp, learned), None
    array = by_time(mdp, np.asarray(learned), 0, of_actions=True)
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        return Policy.of(mdp, array), None
    if _distributions(mdp, array):
        return Policy.of(mdp, np.asarray(learned).astype(np.float64)), None
    policy = Policy.from_q(mdp, array)
    return policy, pair_values(mdp, policy, array)


def _distributions(mdp: MDP, table: NDArray[Any]) -> bool:
    """Return whether the rows of an array are distributions, where there is a choice."""
    untimed = mdp.space.untimed
    timeless = untimed is not None and untimed.regular <= len(table) <= untimed.size
    if timeless or mdp.space.regular <= len(table) <= mdp.n_states:
        chosen = (~mdp.forced & ~mdp.terminal)[: untimed.regular if timeless else len(table)]
        table = table[: len(chosen)][chosen]
    near = np.abs(table.sum(axis=1) - 1) <= FLOAT_ROW_TOLERANCE
    return bool(near.all() and (table >= 0).all())


def _limit(name: str, limit: object | None) -> Fraction | None:
    if limit is None:
        return None
    try:
        found = exact(limit)
    except ModelError as error:
        raise ModelError(error.what, where=name, fix=error.fix) from error
    if found < 0:
        raise ModelError(f"{name} is {float(found):g}", where=name, fix="choose 0 or more")
    return found
