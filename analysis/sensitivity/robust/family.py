"""A policy's value over a box of any model's parameters, where its rows are affine in them.

    P(θ) = P + Σ_j P_j (θ_j - today_j),      r(θ) = r + Σ_j r_j (θ_j - today_j)

Every entry then lies in an interval, and the robust values over these intervals, rows on their own,
bound the value from both sides. The derivative by θ_j is the value of the same policy where pairs
earn r_j + γ P_j V, of which intervals follow from those of V; its bounds are robust values, too.
Care scenarios have tighter ones (`analysis.sensitivity.robust.care`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
import scipy.sparse as sp

from exact_mdp.analysis.sensitivity.robust.care import BoxBounds
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of
from exact_mdp.mdp.parametric.row_change import (
    Entries,
    RowChange,
    pieces,
    reward_entries,
    row_change,
    transition_entries,
)
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.robust.robust import Nature, RobustSolution, solve_robust
from exact_mdp.solvers.robust.sets import Intervals

ROOM = 1e-14  # what rounding may do to an entry

Ends = Mapping[str, Fraction]


class FamilyBox:
    """One policy (L,) of a parametric model, and parameters that may move.

    `low` and `high` are the widest box that will be asked for. Raises ModelError where rows are not
    affine in the parameters together, and for the discount.
    """

    def __init__(self, model: Parametric, weights: Floats, low: Ends, high: Ends) -> None:
        self.names = tuple(low)
        self.base = base = model.at({})
        self.weights = weights
        self.today = {name: parameter_of(model, name).value for name in self.names}
        changes = [_change(model, name, low[name], high[name], base) for name in self.names]
        _check(model, base, changes, low, high)
        places = [change.transition.key for change in changes]
        keys, top, bottom = transition_entries(base)
        key: Integers = np.unique(np.concatenate([keys, *places]))
        self.pair, self.next = np.divmod(key, base.n_states)
        self.probability = np.zeros(len(key))
        self.probability[np.searchsorted(key, keys)] = (top / bottom).astype(np.float64)
        self.slope = np.zeros((len(changes), len(key)))
        self.reward_slope = np.zeros((len(changes), base.n_pairs))
        for j, change in enumerate(changes):
            at = np.searchsorted(key, change.transition.key)
            self.slope[j, at] = change.transition.slope.astype(np.float64)
            self.reward_slope[j, change.reward.key] = change.reward.slope.astype(np.float64)

    def bounds(self, low: Ends, high: Ends) -> BoxBounds:
        """Return bounds over {name: low} … {name: high}, both with all names."""
        moved = np.array([float((low[n] + high[n]) / 2 - self.today[n]) for n in self.names])
        half = np.array([float((high[n] - low[n]) / 2) for n in self.names])
        middle = self.probability + moved @ self.slope
        reach = half @ np.abs(self.slope)
        kept = np.flatnonzero((middle > ROOM) | (reach > 0))
        earned = self.base.reward + moved @ self.reward_slope
        apart = half @ np.abs(self.reward_slope) + ROOM * np.abs(earned)

        def solved(reward: Floats, nature: Nature) -> RobustSolution:
            return self._solved(middle[kept], reach[kept], kept, reward, nature)

        worst, best = solved(earned - apart, "worst"), solved(earned + apart, "best")
        least, most = worst.value - worst.state_error, best.value + best.state_error
        value, spread = (least + most) / 2, (most - least) / 2 * (1 + 1e-12)
        slopes = {}
        for j, name in enumerate(self.names):
            if low[name] == high[name]:
                continue
            step = self.base.discount * self.slope[j]
            gain = self._by_pair(step * value[self.next]) + self.reward_slope[j]
            doubt = self._by_pair(np.abs(step) * spread[self.next])
            doubt += ROOM * self._by_pair(np.abs(step * value[self.next]))
            below = solved(gain - doubt, "worst").start.interval[0]
            above = solved(gain + doubt, "best").start.interval[1]
            slopes[name] = below, above
        return BoxBounds(low=worst.start.interval[0], high=best.start.interval[1], slopes=slopes)

    def _by_pair(self, amounts: Floats) -> Floats:
        total = np.bincount(self.pair, weights=amounts, minlength=self.base.n_pairs)
        return np.asarray(total, dtype=np.float64)

    def _solved(
        self, middle: Floats, reach: Floats, kept: Numbers, reward: Floats, nature: Nature
    ) -> RobustSolution:
        """Return the policy's robust value where pairs earn (L,), entries within their reach."""
        base = self.base
        entries = (middle, (self.pair[kept], self.next[kept]))
        mdp = MDP.from_pairs(
            base.pair_state,
            base.pair_action,
            sp.csr_array(entries, (base.n_pairs, base.n_states)),
            reward,
            base.discount_exact,
            start=dict(base.start),
        )
        room = np.where(reach > 0, reach * (1 + 1e-12) + ROOM, ROOM)
        lower, upper = np.clip(middle - room, 0.0, 1.0), np.clip(middle + room, 0.0, 1.0)
        sets = Intervals(lower=lower, upper=upper)
        return solve_robust(mdp, sets, nature=nature, policy=self.weights)


def _change(model: Parametric, name: str, low: Fraction, high: Fraction, base: MDP) -> RowChange:
    if name == DISCOUNT:
        raise ModelError("the discount is in no row", where="robust box", fix="leave it out")
    cuts = [cut for cut in model.breakpoints(name) if low < cut < high]
    if model.degree(name) > 1 or cuts:
        raise ModelError(
            f"rows are not affine in {name} on its range",
            where=f"parameter {name}",
            fix="narrow its range, or leave it out",
        )
    today = parameter_of(model, name).value
    left, right = pieces(model, name, today)
    piece = left if right is None or (left is not None and high <= today) else right
    assert piece is not None
    return row_change(model, name, piece, base=base)


def _check(
    model: Parametric, base: MDP, changes: Sequence[RowChange], low: Ends, high: Ends
) -> None:
    """Raise ModelError unless rows at four points are what the changes add up to, exactly.

    Where rows are not affine in the parameters together, they may still agree at some of the
    corners: p q does where p or q is today's. Two corners that cross and a point inside find it.
    """
    names = list(low)
    inside = {n: low[n] + (high[n] - low[n]) * Fraction(k % 3 + 1, 5) for k, n in enumerate(names)}
    crossed = {n: (low if k % 2 else high)[n] for k, n in enumerate(names)}
    for point in (low, high, crossed, inside):
        there = model.at(dict(point))
        for part, entries in (("transition", transition_entries), ("reward", reward_entries)):
            expected = _numbers(entries(base))
            for change in changes:
                moved = point[change.name] - change.origin
                found = getattr(change, part)
                for key, slope in zip(found.key.tolist(), found.slope, strict=True):
                    expected[key] = expected.get(key, Fraction(0)) + slope * moved
            actual = _numbers(entries(there))
            for key in expected.keys() | actual.keys():
                if expected.get(key, 0) != actual.get(key, 0):
                    pair = key // base.n_states if part == "transition" else key
                    raise ModelError(
                        "rows are not affine in the parameters together",
                        where=base.where(pair),
                        fix="vary fewer of them at once",
                    )


def _numbers(entries: Entries) -> dict[int, Fraction]:
    keys, top, bottom = entries
    return {
        key: Fraction(int(a), int(b)) for key, a, b in zip(keys.tolist(), top, bottom, strict=True)
    }
