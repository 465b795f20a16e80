"""What nature can do to a policy, and to the best policy against it, as it is told.

Four values at the start, the policy re-optimised against the sets (robust) or held as it is
(nominal), and

    price of robustness = nominal value of the nominal policy - nominal value of the robust one,
    worst-case gain     = worst case of the robust policy - worst case of the nominal one

(Bertsimas and Sim, Operations Research 52, 2004, for the price).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mdp.chain import reachable
from mdp.model import MDP
from mdp.table import Floats, Integers
from solvers.robust import RobustSolution
from solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class Robust:
    """Values at the start under nominal, worst and best laws, and the policies behind them.

    Attributes
    ----------
    mdp : MDP
    policy : (L,)
        Probability of each pair under the nominal policy: the optimum of the tables as they are,
        or one that was given.
    value, worst, best : Bounded
        The nominal policy's value with the tables as they are, and at nature's worst and best.
    robust : RobustSolution
        The best policy against nature's worst, and its worst case.
    optimistic : RobustSolution
        The best policy with nature's best.
    robust_value, robust_best : Bounded
        The robust policy's value with the tables as they are, and at nature's best.
    """

    mdp: MDP
    policy: Floats
    value: Bounded
    worst: Bounded
    best: Bounded
    robust: RobustSolution
    optimistic: RobustSolution
    robust_value: Bounded
    robust_best: Bounded

    @property
    def price(self) -> Bounded:
        """What the robust policy gives up where the tables are right."""
        return difference(self.value, self.robust_value)

    @property
    def gain(self) -> Bounded:
        """What the robust policy earns more in its worst case than the nominal one in its own."""
        return difference(self.robust.start, self.worst)

    @property
    def changed(self) -> Integers:
        """(K,) states in which the policies differ, of those that either of them reaches."""
        mdp, pairs = self.mdp, self.robust.pairs
        assert pairs is not None
        taken = np.zeros(mdp.n_pairs)
        taken[pairs] = 1.0
        apart = np.abs(taken - self.policy) > 1e-12
        differs = np.logical_or.reduceat(apart, mdp.pair_offsets[:-1])
        seen = reachable(mdp, pairs=taken > 0) | reachable(mdp, pairs=self.policy > 0)
        return np.flatnonzero(differs & seen & ~mdp.terminal)

    def frame(self) -> DataFrame:
        """Return values at the start (reward), one row for each policy and law."""
        from pandas import DataFrame

        rows = [
            ("nominal", "nominal", self.value),
            ("nominal", "worst", self.worst),
            ("nominal", "best", self.best),
            ("robust", "nominal", self.robust_value),
            ("robust", "worst", self.robust.start),
            ("robust", "best", self.robust_best),
            ("optimistic", "best", self.optimistic.start),
        ]
        return DataFrame(
            [
                {
                    "policy": policy,
                    "laws": laws,
                    "value (reward)": found.value,
                    "error bound (reward)": found.error,
                }
                for policy, laws, found in rows
            ]
        )

    def changes_frame(self) -> DataFrame:
        """Return the states in which the robust policy does something else."""
        from pandas import DataFrame

        mdp, pairs = self.mdp, self.robust.pairs
        assert pairs is not None
        return DataFrame(
            [
                {
                    "state": mdp.space.label(state),
                    "nominal": " or ".join(
                        mdp.actions[mdp.pair_action[pair]]
                        for pair in mdp.pairs_of(state)
                        if self.policy[pair] > 0
                    ),
                    "robust": mdp.actions[mdp.pair_action[pairs[state]]],
                }
                for state in self.changed.tolist()
            ],
            columns=["state", "nominal", "robust"],
        )


def difference(one: Bounded, other: Bounded) -> Bounded:
    """Return one number less the other, with both errors."""
    value = one.value - other.value
    return Bounded(value=value, error=one.error + other.error + 2.0**-52 * abs(value))


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustCurve:
    """How values move with the radius of the sets.

    Attributes
    ----------
    kind : str
        As in `SETS`.
    points : tuple of (radius, Robust)
    """

    kind: str
    points: tuple[tuple[float, Robust], ...]

    def frame(self) -> DataFrame:
        """Return values at the start (reward), one row for each radius."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "set": self.kind,
                    "radius": radius,
                    "nominal policy, nominal (reward)": found.value.value,
                    "nominal policy, worst (reward)": found.worst.value,
                    "robust policy, nominal (reward)": found.robust_value.value,
                    "robust policy, worst (reward)": found.robust.start.value,
                    "price of robustness (reward)": found.price.value,
                    "worst-case gain (reward)": found.gain.value,
                    "states changed": len(found.changed),
                }
                for radius, found in self.points
            ]
        )
