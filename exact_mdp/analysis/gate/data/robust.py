"""An interval of the regret that holds for every model that the records allow: see `bounds`."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np

from exact_mdp.analysis.gate.data.bounds import RobustBounds, robust_bounds
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
        bounds = self.bounds(mdp, sets, chain, horizon)
        low, high = bounds.regret
        return RegretInterval(
            low=low,
            high=high,
            confidence=float(confidence),
            by=self.by,
            assumptions=self.assumptions(mdp, sets),
            found={
                "optimal_value": bounds.at_start(mdp, bounds.best),
                "learned_value": bounds.at_start(mdp, bounds.own),
            },
            claim=Claim.BOUNDED,
        )

    def bounds(
        self, mdp: MDP, sets: RowSets, chain: PolicyChain, horizon: int | None
    ) -> RobustBounds:
        """Return the bounds within the sets."""
        returns = range_of(self.returns, "returns")
        if horizon is not None:
            if returns is not None:
                raise ModelError(
                    "with a horizon rewards bound what totals can be",
                    where="returns",
                    fix="leave it out (--returns, returns=)",
                )
            return robust_bounds(sets, by_time(mdp, chain.weights, horizon))
        if returns is not None:
            _require_seen(mdp, returns)
            if mdp.sense == "min":
                returns = -returns[1], -returns[0]
        return robust_bounds(sets, chain.weights, returns)

    def assumptions(self, mdp: MDP, sets: RowSets) -> tuple[str, ...]:
        """Return what the sets rest on besides the records."""
        low, high = sets.rewards if mdp.sense == "max" else (-sets.rewards[1], -sets.rewards[0])
        said = list(of_process(mdp))
        if sets.known:
            said.append(
                "rewards are those seen for state, action and next state; where a next state was "
                f"never seen they lie from {low:g} to {high:g}, as all that were seen"
            )
        else:
            said.append(f"rewards lie from {low:g} to {high:g}, as stated")
        if self.returns is not None:
            said.append(f"total rewards lie from {self.returns[0]} to {self.returns[1]}, as stated")
        if sets.unknown.any():
            said.append(
                "what follows where episodes were cut off and no record leaves, "
                f"{named(mdp, sets.unknown)}, is worth whatever rewards allow"
            )
        if (sets.counted[~mdp.terminal[mdp.pair_state]] == 0).any():
            said.append("actions that nobody took are worth what the model says")
        return tuple(said)


def _require_seen(mdp: MDP, returns: Ends) -> None:
    """Raise ModelError where a recorded transition cannot have a total in the range stated."""
    table = mdp.table
    pair = np.repeat(np.arange(mdp.n_pairs), np.diff(table.offsets))
    seen = observations_of(mdp)[pair] > 0
    over = mdp.terminal & ~cut_off(mdp)
    gain, after = table.gains(), np.where(over[table.next], 0.0, mdp.discount)
    low, high = (gain + after * end for end in returns)
    outside = seen & ((low > returns[1]) | (high < returns[0]))
    if outside.any():
        first = int(np.flatnonzero(outside)[0])
        raise ModelError(
            f"a reward of {gain[first]:g} was seen, after which no total lies from "
            f"{returns[0]:g} to {returns[1]:g}",
            where=mdp.where(int(pair[first])),
            fix="state a range that holds all totals (--returns LOW,HIGH, returns=(low, high))",
        )
