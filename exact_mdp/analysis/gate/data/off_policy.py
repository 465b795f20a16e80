"""Off-policy evaluation: the value of a policy from trajectories of another policy.

An episode of the behaviour b with return G = Σ γ^t r_t has the weight w = Π π(a_t | s_t) / b(a_t |
s_t), so that E_b[w G] = V^π, which Σ w G / Σ w estimates with an effective sample size of (Σ w)² /
Σ w² (Precup, Sutton and Singh, ICML 2000). V^π is bounded at half the doubt by the means of
w (G - least return) ≥ 0 and w (greatest return - G) ≥ 0 (`mean_at_least`); an episode that was cut
off may go on with any return. V* is bounded at the other half as in `analysis.gate.data.robust`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from exact_mdp.analysis.gate.data.interval import (
    Ends,
    RegretInterval,
    cut_off,
    observations_of,
)
from exact_mdp.analysis.gate.data.robust import Robust
from exact_mdp.analysis.gate.data.sets import Given
from exact_mdp.analysis.vary.intervals import mean_at_least, mean_of
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.io import transitions
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True)
class OffPolicy:
    """A confidence interval from the trajectories, reweighted to the policy.

    Attributes
    ----------
    records : DataFrame, path or iterable of DataFrames
        The trajectories, as `MDP.from_transitions` takes them.
    columns : mapping, optional
        The names of the table's columns, as `MDP.from_transitions` takes them.
    behaviour : PolicyLike, optional
        The policy that chose the recorded actions; an array, or a file with one, holds its
        probabilities, never action values. By default it is estimated from the model's counts, and
        the interval assumes the estimate to be true.
    rewards, returns
        As in `Robust`; the optimum needs `rewards` here, too.

    Examples
    --------
    >>> import pandas as pd
    >>> from exact_mdp import check
    >>> names = ["episode", "state", "action", "reward", "next_state"]
    >>> rows = [(n, "ill", ("wait", "treat")[n % 2], n % 2, None) for n in range(2000)]
    >>> table = pd.DataFrame(rows, columns=names)
    >>> mdp = MDP.from_transitions(table, discount="1/2")
    >>> by = OffPolicy(records=table, behaviour="random", rewards="known", returns=(0, 1))
    >>> interval = check(mdp, "always:wait", confidence=0.95, by=by).interval
    >>> interval.found["effective_sample_size"], interval.low > 0.7, round(interval.high, 9)
    (1000.0, True, 1.0)
    """

    records: Any = None
    columns: Mapping[str, str] | None = None
    behaviour: PolicyLike | None = None
    rewards: Given = None
    returns: Ends | None = None
    by: ClassVar[str] = "off-policy"

    def interval(self, mdp: MDP, own: Floats, confidence: Fraction) -> RegretInterval:
        """Return the interval; raise ModelError without records, or if they do not fit."""
        if self.records is None:
            raise ModelError(
                "no trajectories are given, and the model keeps only their counts",
                where="records",
                fix="name the records (--evidence records=FILE, by=OffPolicy(records=…))",
            )
        if mdp.episodes is None and len(mdp.start) > 1:
            raise ModelError(
                "the model has a start of its own, for which the returns of the recorded episodes "
                "say nothing",
                where="start",
                fix="make the model without start=, or audit by robust sets or the posterior",
            )
        # Half the doubt is for V*, bounded from the counts.
        doubt = float(1 - confidence)
        robust = Robust(rewards=self.rewards, returns=self.returns)
        bounds = robust.bounds(mdp, own, doubt / 2)
        # The probabilities of the behaviour: given, or as shares of the counts.
        seen = observations_of(mdp).astype(np.float64)
        if self.behaviour is not None:
            behaviour = PolicyChain.of(mdp, self.behaviour, kind="policy").weights
        else:
            total = np.add.reduceat(seen, mdp.pair_offsets[:-1])[mdp.pair_state]
            behaviour = np.divide(seen, total, out=np.ones_like(seen), where=total > 0)
        horizon = None
        if own.ndim > 1:
            horizon = len(own)
        own = np.atleast_2d(own)

        # The ratios π / b, which exist only if the behaviour takes all that the policy takes.
        never = ((own > 0) & (behaviour <= 0)).any(axis=0)
        if never.any():
            count = int(never.sum())
            raise ModelError(
                "the behaviour never takes an action that the policy takes, so its trajectories "
                f"say nothing about it (pairs of this kind: {count})",
                where=mdp.where(int(never.argmax())),
                fix="audit by robust sets or the posterior, or give the behaviour's true "
                "probabilities",
            )
        ratio = np.divide(own, behaviour, out=np.zeros_like(own), where=behaviour > 0)
        refuted = (behaviour <= 0) & (seen > 0)
        if refuted.any():
            raise ModelError(
                "the behaviour never takes an action that was recorded",
                where=mdp.where(int(refuted.argmax())),
                fix="state the policy that chose the recorded actions, or leave it to be estimated",
            )

        # Weight and return of each episode; returns must lie in the range that was stated.
        record = transitions.TransitionRecord(self.records, self.columns)
        w, returns, steps, cut, ended = _read_trajectories(mdp, ratio, record, horizon)
        lowest, highest = bounds.range
        ends = returns[~cut]
        if len(ends) and not lowest <= ends.min() <= ends.max() <= highest:
            low, high = mdp.sense.orient_interval(ends.min(), ends.max())
            raise ModelError(
                f"returns from {low:g} to {high:g} were recorded",
                where="returns",
                fix="state a range that holds them",
            )

        # Bounds of V^π from means of nonnegative terms, with any return after a cut.
        left = np.where(cut, mdp.discount**steps, 0.0)
        above = np.clip(returns + left * lowest, lowest, highest) - lowest
        below = highest - np.clip(returns + left * highest, lowest, highest)
        low = min(lowest + mean_at_least(w * above, doubt / 4), highest)
        high = max(highest - mean_at_least(w * below, doubt / 4), lowest)
        best = bounds.at_start(mdp.maximised, bounds.best)
        terms, whole = w * returns, float(w.sum())
        weighted, effective = float("nan"), 0.0
        if whole > 0:
            weighted = mdp.sense.sign * float(terms.sum()) / whole
            effective = whole**2 / float(w @ w)
        known = "the behaviour is as estimated from the counts: the confidence is approximate"
        if self.behaviour is not None:
            known = "the behaviour is as stated"
        return RegretInterval(
            low=max(best[0] - high, 0.0),
            high=max(best[1] - low, 0.0),
            confidence=float(confidence),
            by=self.by,
            assumptions=(
                *robust.assumptions(mdp, bounds.sets),
                "episodes are independent, and the policy was not learned from them",
                known,
            ),
            found={
                "optimal_value": bounds.at_start(mdp, bounds.best),
                "learned_value": mdp.sense.orient_interval(low, high),
                "weighted": weighted,
                "ordinary": mdp.sense.sign * float(terms.mean()),
                "standard_error": mean_of(terms).standard_error,
                "effective_sample_size": effective,
                "episodes": len(w),
                "cut_off": int(cut.sum()),
                "taken_for_ended": ended,
            },
        )


def _read_trajectories(
    mdp: MDP, ratio: Floats, record: transitions.TransitionRecord, horizon: int | None
) -> tuple[Floats, Floats, Integers, Flags, int]:
    """Return weight, return and length (E,) of each episode, and whether it was cut off.

    The last result is the number of episodes that stop in a state taken as terminal. `ratio` is
    (1, L), or (N, L) by time.
    """
    # The pair of each recorded step.
    parts = list(record.read_chunks())
    if not parts:
        raise ModelError("no transitions", where=record.where, fix="give at least one row")
    episode, keys = map(np.concatenate, zip(*parts, strict=True))
    with locate_errors(record.where):
        states = np.array([mdp.space.number(str(name)) for name in record.numbers["state"]])
        actions = np.array([mdp.action(str(name)) for name in record.numbers["action"]])
    pairs = mdp.by_action(np.arange(mdp.n_pairs), -1).astype(np.int64)
    pair = pairs[states[keys[:, 0]], actions[keys[:, 1]]]
    if (pair < 0).any():
        row = keys[int(np.flatnonzero(pair < 0)[0])]
        state, action = mdp.space.label(int(states[row[0]])), mdp.actions[actions[row[1]]]
        raise ModelError(
            f"action {action} was taken in ({state}), where the model does not offer it",
            where=record.where,
            fix="give the records that the model was made from",
        )

    # Each episode is a run of rows, from `first` on.
    first = np.flatnonzero(np.diff(episode, prepend=-1))
    new = states[keys[first, 0]]
    never = mdp.start_distribution[new] <= 0
    if never.any():
        raise ModelError(
            "an episode begins in a state in which the model never starts",
            where=mdp.space.label(int(new[never][0])),
            fix="make the model without start=, or audit by robust sets or the posterior",
        )
    steps = np.diff(first, append=len(episode))
    times = np.arange(len(episode)) - np.repeat(first, steps)
    most = len(episode) + 1
    if horizon is not None:
        most = horizon
    within = times < most
    factor = np.where(within, ratio[np.minimum(times, len(ratio) - 1), pair], 1.0)
    reward = mdp.sense.sign * np.array([float(value) for value in record.values])[keys[:, 3]]
    # The last state of each episode: -2 if it was cut off, -1 if it ended without a next state.
    last = np.append(states, [-2, -1])[keys[first + steps - 1, 2]]
    end = np.append(mdp.terminal & ~cut_off(mdp), [False, True])[last]
    regular = last < mdp.n_states - len(mdp.space.extra)
    return (
        np.multiply.reduceat(factor, first),
        np.add.reduceat(np.where(within, mdp.discount**times * reward, 0.0), first),
        np.minimum(steps, most),
        ~end & (steps < most),
        int((end & (last >= 0) & regular).sum()),
    )
