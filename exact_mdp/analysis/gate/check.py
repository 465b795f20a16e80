"""The audit of a policy or Q-table from anywhere against the exact optimum.

An audit combines a criterion with evidence. The criterion is the loss that is measured: of total
reward, of reward per step, or of total reward under limits (`analysis.gate.criteria`). The evidence
is either the model, which gives the loss exactly or within bounds, or the records from which the
model was estimated (`analysis.gate.data`), which give a confidence interval. A policy passes only
by proof: if bounds or an interval leave a limit open, it fails. An action as good as the best is
optimal.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.criteria import Average, Total, UnderLimits
from exact_mdp.analysis.gate.data.off_policy import OffPolicy
from exact_mdp.analysis.gate.data.posterior import Posterior
from exact_mdp.analysis.gate.data.robust import Robust
from exact_mdp.analysis.gate.regret import LAST_CYCLE, is_cheap_to_certify, limit_of
from exact_mdp.analysis.vary.intervals import confidence_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.horizon import split_by_time
from exact_mdp.solvers.arguments import Criterion, is_average, mdp_of, require_no_horizon
from exact_mdp.solvers.claims import SolverError
from exact_mdp.solvers.values.policy_chain import PolicyChain, policy_of

Evidence = Robust | Posterior | OffPolicy
EVIDENCE: dict[str, type[Evidence]] = {kind.by: kind for kind in (Robust, Posterior, OffPolicy)}


@named_options
def check(
    model: MDP | Scenario,
    policy: PolicyLike,
    *,
    max_regret: object | None = None,
    max_relative_regret: object | None = None,
    exact_values: bool | None = None,
    kind: str = "auto",
    horizon: int | None = None,
    criterion: Criterion = "total",
    subject_to: Mapping[str, Any] | None = None,
    confidence: object | None = None,
    by: str | Evidence = "robust",
) -> Audit:
    """Compare a policy or Q-table with the optimum: how much it loses, where and why.

    Parameters
    ----------
    model : MDP or Scenario
    policy : PolicyLike
        "optimal", "random", "always:ACTION", a mapping, an array, a Policy, a Solution, a training
        run or a path. A Q-table stands for its greedy policy; ties go to the lowest action number.
    max_regret, max_relative_regret : number or "p/q", optional
        Limits for the regret at the start and for its ratio to the absolute optimal value; the
        ratio fails if that value is 0. Without either limit the regret has to be zero, or in a
        model of floats at most the rounding allowance (`Audit.forgiven`). A limit of 0 has no
        allowance.
    exact_values : bool, optional
        True for rational arithmetic, False for bounds in floats. By default, bounds that leave a
        verdict open are followed by rational arithmetic in models of up to 100,000 transitions
        without cycles of over 500 states.
    kind : "auto", "q" or "policy"
        How to read a two-dimensional array or a file with one: as action values or as a policy.
        `Audit.read_as` says how it was read.
    horizon : int, optional
        Stop after this many steps, as `mdp.within(horizon)` does. A policy over states does the
        same at every time; tables (N, S, A) depend on time.
    criterion : "total" or "average"
        The total reward, discounted as the model says, or the reward per step in the long run.
    subject_to : {name: ">= p/q" or "<= p/q"}, optional
        Limits on expected totals that the policy has to keep, as `solve` takes them. The regret is
        then against the optimum under these limits, exactly, without a rounding allowance.
    confidence : number, optional
        For a model estimated from records: the verdict rests on an interval, at this confidence,
        for the regret in the process behind them, `Audit.interval`.
    by : "robust", "posterior" or "off-policy", or one of these with settings
        The method of the interval: `Robust`, `Posterior` or `OffPolicy(records=…)`.

    Returns
    -------
    Audit

    Raises
    ------
    ModelError
        If the policy does not fit or may be read in two ways, if options exclude one another, if a
        total oscillates forever at discount 1, or if a confidence is given without counts.
    SolverError
        If floats cannot bound the answer in a model too large for rational arithmetic.

    Examples
    --------
    >>> wait, cut = [[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]], [[1, 0, 0]] * 3
    >>> forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
    >>> audit = check(forest, [0, 1, 1])
    >>> audit.passed, round(float(audit.regret.at_start.value), 3), round(audit.agreement, 3)
    (False, 63.062, 0.333)
    """
    # 1. Refuse options that exclude one another.
    average, limited = is_average(criterion), subject_to is not None
    if confidence is None and by != "robust":
        fix = "give confidence=0.95"
        raise ModelError("no confidence is given for the interval", where="by", fix=fix)
    if confidence is not None:
        evidence = _resolve_interval_method(by)
        others = {
            "max_relative_regret": max_relative_regret is not None,
            "subject_to": limited,
            "criterion": average,
        }
        without = " and ".join(name for name, given in others.items() if given)
        if without:
            fix = f"leave out {without}, or confidence; to limit the loss, give max_regret"
            raise ModelError("records bound the total regret alone", where="confidence", fix=fix)
    if average and limited:
        what = "limits apply to total rewards, not to an average"
        raise ModelError(what, where="subject_to", fix="leave criterion out")
    if average:
        require_no_horizon(horizon)

    # 2. The criterion: the loss to measure, with the policy and the model of the question.
    recorded = mdp = mdp_of(model)
    if horizon is not None:
        mdp = recorded.within(horizon)
    limits = {"max_regret": max_regret, "max_relative_regret": max_relative_regret}
    most: Any = {}
    for name, limit in limits.items():
        if limit is not None:
            most[name] = limit_of(name, limit)
    own = policy_of(mdp, policy, kind=kind, criterion=criterion)
    chain = PolicyChain.of_policy(mdp, own)
    about = Total(chain=chain)
    if average:
        about = Average(chain=chain)
    if subject_to is not None:
        about = UnderLimits.of(chain, subject_to)

    def make_audit(exactly: bool | None) -> Audit:
        return Audit(criterion=about, regret=about.compute_regret(exactly), **most)

    # 3. Bounds first; rational arithmetic if they fail or leave the verdict open.
    try:
        result = make_audit(exact_values)
    except SolverError:  # floats cannot bound the answer, but rational arithmetic may find it
        if exact_values is not None or not is_cheap_to_certify(mdp, LAST_CYCLE):
            raise
        result = make_audit(True)
    if exact_values is None and result.undecided and is_cheap_to_certify(mdp, LAST_CYCLE):
        with suppress(ModelError):  # a cycle that is too ill-conditioned leaves it undecided
            result = make_audit(True)
    if confidence is None:
        return result

    # 4. With records, the verdict rests on an interval for the process behind the model.
    level, weights = confidence_of(confidence), chain.weights
    if horizon is not None:
        weights = split_by_time(recorded, weights, horizon)
    return replace(result, interval=evidence.interval(recorded, weights, level))


def _resolve_interval_method(by: object) -> Evidence:
    """Return the method of an interval, from its name or as an object."""
    if isinstance(by, str):
        return EVIDENCE[require_known_name(by, EVIDENCE, "kind of interval", "by")]()
    if not isinstance(by, Evidence):
        fix = 'give "robust", "posterior" or "off-policy", or one of their classes'
        raise ModelError(f"{by!r} is not a kind of interval", where="by", fix=fix)
    return by


def assert_policy_optimal(
    model: MDP | Scenario,
    policy: PolicyLike,
    max_regret: object | None = None,
    **asked: Any,
) -> Audit:
    """Raise AssertionError, naming the costly states, unless the regret keeps its limits.

    Parameters
    ----------
    model : MDP or Scenario
    policy : PolicyLike
    max_regret : number or "p/q", optional
        Greatest regret at the start; without a limit it must be zero.
    **asked
        As `check` takes them.

    Returns
    -------
    Audit

    Raises
    ------
    AssertionError
        If a limit does not hold.
    ModelError
        As `check` raises it.


    Examples
    --------
    >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
    >>> assert_policy_optimal(mdp, [0, 0])
    Traceback (most recent call last):
    AssertionError: read as a policy, discount 1, start state 0
    failed: the regret is not zero: it is 2 (certified)
    optimal value 3, learned 1; not optimal in 1 of 1 states with a choice
      state 0: yours 0, optimal 1; loses 2 x 1 visits = 2
    """
    __tracebackhide__ = True  # pytest shows the line of the test, not this one
    audit = check(model, policy, max_regret=max_regret, **asked)
    if not audit.passed:
        raise AssertionError(audit.message())
    return audit
