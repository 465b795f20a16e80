"""An interval of the regret that holds for every model that the records allow, distribution-free.

Of the sets of `analysis.gate.data.sets` the two ends are those of `analysis.gate.data.bounds`. For
episodes that stop after N steps every such bound, with V_N = 0 and D_N = 0, is one backward step at
each time t, with the policy of that time, which may depend on it:

    L^π_t ≤ V^π_t ≤ U^π_t  from t + 1,        D_t(s) = max over l of  A_P,t(l) + γ P_l D_{t+1}.

The process has the same rows at every time. The sets let nature choose other ones at each, which
can only widen the interval; all rows are in their sets at once, whatever the time, so that no more
doubt is spread over the times. What rewards can add up to in the steps that are left bounds states
in which episodes were cut off, and no range of totals has to be stated at discount 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np
import tqdm

from exact_mdp.analysis.gate.data.bounds import RobustBounds
from exact_mdp.analysis.gate.data.interval import (
    Ends,
    RegretInterval,
    cut_off,
    named,
    observations_of,
    of_process,
    range_of,
)
from exact_mdp.analysis.gate.data.sets import Given, RowSets
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions import by_time
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.solution import Claim
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True)
class Robust:
    """An interval that assumes no distribution: it holds for every model that fits the records.

    Attributes
    ----------
    rewards : "known", or (low, high)
        Rewards that state, action and next state decide, and which are as seen; or a range in which
        rewards lie. It has to be stated: those that were seen do not prove that no other comes.
    returns : (low, high), optional
        Where the total reward from any state lies; needed at discount 1.

    Examples
    --------
    >>> import pandas as pd
    >>> names = ["episode", "state", "action", "reward", "next_state"]
    >>> rows = [(n, "ill", "wait", 0, None) for n in range(60)]
    >>> rows += [(n + 60, "ill", "treat", 1, None) for n in range(60)]
    >>> mdp = MDP.from_transitions(pd.DataFrame(rows, columns=names), discount="1/2")
    >>> chain = PolicyChain.of(mdp, "always:treat")
    >>> print(Robust(rewards="known").interval(mdp, chain, Fraction(19, 20)))
    [0, 0] at 95 % confidence, robust
    """

    rewards: Given = None
    returns: Ends | None = None
    by: ClassVar[str] = "robust"

    def interval(
        self, mdp: MDP, chain: PolicyChain, confidence: Fraction, horizon: int | None = None
    ) -> RegretInterval:
        """Return the interval; raises ModelError without counts or a range that is needed.

        With a horizon `chain` is the policy in `mdp.within(horizon)`.
        """
        sets = RowSets.of(mdp, float(1 - confidence), self.rewards)
        found = self.bounds(mdp, sets, chain, horizon)
        low, high = found.regret
        return RegretInterval(
            low=low,
            high=high,
            confidence=float(confidence),
            by=self.by,
            assumptions=self.assumptions(mdp, sets),
            found={
                "optimal_value": found.at_start(mdp, "best"),
                "learned_value": found.at_start(mdp, "own"),
            },
            claim=Claim.BOUNDED,
        )

    def bounds(
        self, mdp: MDP, sets: RowSets, chain: PolicyChain, horizon: int | None
    ) -> RobustBounds:
        """Return the bounds within the sets."""
        if horizon is None:
            return RobustBounds(sets=sets, own=chain.weights, returns=self.range(mdp))
        if self.returns is not None:
            raise ModelError(
                "with a horizon rewards bound what totals can be",
                where="returns",
                fix="leave it out (--returns, returns=)",
            )
        return staged(sets, by_time(mdp, chain.weights, horizon))

    def range(self, mdp: MDP) -> Ends | None:
        """Return where total rewards lie, of rewards even where the model is one of costs."""
        ends = range_of(self.returns, "returns")
        if ends is not None:
            _require_seen(mdp, ends)
        if ends is None or mdp.sense == "max":
            return ends
        return -ends[1], -ends[0]

    def assumptions(self, mdp: MDP, sets: RowSets) -> tuple[str, ...]:
        """Return what the sets rest on besides the records."""
        low, high = sets.rewards if mdp.sense == "max" else (-sets.rewards[1], -sets.rewards[0])
        told = list(of_process(mdp))
        if sets.known:
            told.append(
                "rewards are those seen for state, action and next state; where a next state was "
                f"never seen they lie from {low:g} to {high:g}, as all that were seen"
            )
        else:
            told.append(f"rewards lie from {low:g} to {high:g}, as stated")
        if self.returns is not None:
            told.append(f"total rewards lie from {self.returns[0]} to {self.returns[1]}, as stated")
        if sets.unknown.any():
            told.append(
                "what follows where episodes were cut off and no record leaves, "
                f"{named(mdp, sets.unknown)}, is worth whatever rewards allow"
            )
        if (sets.counted[~mdp.terminal[mdp.pair_state]] == 0).any():
            told.append("actions that nobody took are worth what the model says")
        return tuple(told)


def _require_seen(mdp: MDP, returns: Ends) -> None:
    """Raise ModelError where a recorded transition cannot have a total in the range stated."""
    table = mdp.table
    pair = np.repeat(np.arange(mdp.n_pairs), np.diff(table.offsets))
    kept = observations_of(mdp)[pair] > 0
    over = mdp.terminal & ~cut_off(mdp)
    gain, after = table.gains(), np.where(over[table.next], 0.0, mdp.discount)
    low, high = (gain + after * end for end in returns)
    outside = kept & ((low > returns[1]) | (high < returns[0]))
    if outside.any():
        first = int(np.flatnonzero(outside)[0])
        raise ModelError(
            f"a reward of {gain[first]:g} was seen, after which no total lies from "
            f"{returns[0]:g} to {returns[1]:g}",
            where=mdp.where(int(pair[first])),
            fix="state a range that holds all totals (--returns LOW,HIGH, returns=(low, high))",
        )


# ---- episodes of N steps -------------------------------------------------------------------------


def totals(sets: RowSets, steps: int) -> Ends:
    """Return where the total of some steps lies, in every model of the sets."""
    mdp = sets.mdp
    certain = mdp.reward[sets.counted == 0]
    each = min(0.0, sets.rewards[0], *certain), max(0.0, sets.rewards[1], *certain)
    weight = float(np.cumsum(mdp.discount ** np.arange(steps))[-1]) * SLACK
    return each[0] * weight * SLACK, each[1] * weight * SLACK


def staged(sets: RowSets, own: Floats) -> RobustBounds:
    """Return the bounds at time 0; `own` (N, L) are the policy's probabilities at each time."""
    names = ("own_low", "own_high", "best_low", "best_high", "least_regret", "most_regret")
    ahead = {name: np.zeros(sets.mdp.n_states) for name in names}
    steps = len(own)
    for time in tqdm.trange(steps - 1, -1, -1, desc="stages", disable=None, delay=2):
        now = RobustBounds(sets=sets, own=own[time], returns=totals(sets, steps - time))
        vars(now).update(ahead)  # the values that follow
        here = {}
        for most, side, sign in ((False, "low", -1), (True, "high", 1)):
            bound = now.under_policy(most)(ahead[f"own_{side}"]).bound
            mixed = 4 * UNIT * sets.mdp.n_actions * np.abs(bound)
            here[f"own_{side}"] = bound + sign * mixed
            here[f"best_{side}"] = now.optimum(most)(ahead[f"best_{side}"]).bound
        for most, name, best, other in (
            (False, "least_regret", "best_low", "own_high"),
            (True, "most_regret", "best_high", "own_low"),
        ):
            found = now.gaining(most, ahead[best], here[other])(ahead[name]).bound
            apart = here[best] - here[other]
            better = np.minimum(found, apart) if most else np.maximum(found, apart)
            here[name] = np.maximum(better, 0.0)
        ahead = here
    bounds = RobustBounds(sets=sets, own=own[0], returns=totals(sets, steps))
    vars(bounds).update(ahead)
    return bounds
