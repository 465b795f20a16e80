"""Which actions are proven to be optimal, and which not, where V* is only bounded.

Around the values V of `solvers.bounds.bounds`, with low · w ≤ V* - V ≤ high · w,

    Q*(l) - V(s) = d(l) + γ Σ_s' P(l, s') (V*(s') - V(s')),    d(l) = r(l) + γ P_l V - V(s)

lies between two floats, rounding included. An action is optimal where no other one of its state may
be better; two actions with the same expected reward and the same row are equally good whatever V*
is. Where all that a policy does in each state that it reaches is optimal, so is the policy: V* then
solves its equations, which have one solution where it ends or γ < 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import inf

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.bounds import Bounds
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gains
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class ActionBounds:
    """What bounds on V* say of each pair.

    Attributes
    ----------
    low, high : (L,)
        Bounds of Q*(l) - V(s).
    gap, least_gap, most_gap : (L,)
        What the pair falls short of the optimum: the best guess, and bounds; 0 in `most_gap` where
        it is proven to be optimal.
    """

    mdp: MDP
    low: Floats
    high: Floats
    gap: Floats
    least_gap: Floats
    most_gap: Floats

    @classmethod
    def of(cls, mdp: MDP, optimum: Bounds) -> ActionBounds:
        """Return what is known of a model's actions.

        Examples
        --------
        >>> from exact_mdp.solvers.bounds.bounds import bounds
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]])
        >>> found = ActionBounds.of(mdp, bounds(mdp, np.array([3.0, 0.0])))
        >>> found.gap.tolist(), float(found.most_gap[1]), bool(found.least_gap[0] > 1.99)
        ([2.0, 0.0, 0.0, 0.0], 0.0, True)
        """
        # Q*(l) - V(s) = d(l) + γ P_l (V* - V), and low · w ≤ V* - V ≤ high · w.
        near = gains(mdp, optimum.value)
        flow = mdp.discount * (mdp.transition @ optimum.weight)
        off = near.error + 4 * UNIT * (np.abs(near.value) + near.error) + TINY
        low = near.value - off + _outward(optimum.low * flow, -1)
        high = near.value + off + _outward(optimum.high * flow, 1)
        low, high = _outward(low, -1, 4 * UNIT), _outward(high, 1, 4 * UNIT)
        first, state = mdp.pair_offsets[:-1], mdp.pair_state
        best = np.maximum.reduceat(near.value, first)[state]
        most = np.where(mdp.forced[state], low, _largest_other(mdp, high))
        return cls(
            mdp=mdp,
            low=low,
            high=high,
            gap=best - near.value,
            least_gap=_outward(np.maximum.reduceat(low, first)[state] - high, -1, 4 * UNIT),
            most_gap=np.maximum(_outward(most - low, 1, 4 * UNIT), 0.0),
        )

    def all_best(self, chain: PolicyChain) -> bool:
        """Return whether all that a policy does where it comes is proven to be optimal."""
        mdp = self.mdp
        live = (chain.reached & ~mdp.terminal)[mdp.pair_state]
        open_ = live & (chain.chosen > 0) & (self.most_gap > 0)
        return all(self._beats(int(pair)) for pair in np.flatnonzero(open_))

    def _beats(self, pair: int) -> bool:
        """Return whether all other pairs of the state are worse, or have the same outcomes."""
        mdp, own = self.mdp, None
        for other in mdp.pairs_of(int(mdp.pair_state[pair])):
            if other == pair or self.high[other] <= self.low[pair]:
                continue
            own = _outcomes(mdp, pair) if own is None else own
            if _outcomes(mdp, other) != own:
                return False
        return True


def _outcomes(mdp: MDP, pair: int) -> tuple[Fraction, dict[int, Fraction]]:
    """Return the exact expected reward and the exact row of a pair."""
    reward, row = Fraction(0), dict[int, Fraction]()
    for chance, following, gain in mdp.table.row(pair):
        reward += chance * gain
        row[following] = row.get(following, Fraction(0)) + chance
    return reward, row


def _largest_other(mdp: MDP, values: Floats) -> Floats:
    """Return (L,) the largest value among the other pairs of the state; -inf without any."""
    first, state = mdp.pair_offsets[:-1], mdp.pair_state
    best = np.maximum.reduceat(values, first)
    numbers = np.where(values == best[state], np.arange(mdp.n_pairs), mdp.n_pairs)
    leader = np.minimum.reduceat(numbers, first)
    rest = values.copy()
    rest[leader] = -inf
    found = best[state]
    found[leader] = np.maximum.reduceat(rest, first)
    return np.asarray(found)


def _outward(values: Floats, sign: int, share: float = SLACK - 1) -> Floats:
    return np.asarray(values + sign * (share * np.abs(values) + TINY))
