"""The sign of the best mean reward of end components, and a policy that earns for ever.

    r(l) + P_l h - h(s) < 0  for all pairs l of the component,   or > 0 along a policy

for any potential h shows that no policy earns something for ever, or that one does. Values V_γ with
a discount γ near 1 are such potentials, as r + P V_γ - V_γ = (1 - γ) P V_γ along an optimal policy
and no more elsewhere: so floats do, rounded. Where they leave the sign open, rational arithmetic
finds the best average (`solvers.exact.find`; Puterman, Markov Decision Processes, 1994, chapter 8).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.dynamic.methods import ModifiedPolicyIteration
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Mask
from exact_mdp.solvers.exact.certificate import exact_rows
from exact_mdp.solvers.exact.find import best_average
from exact_mdp.solvers.exact.levels import Level, surplus
from exact_mdp.solvers.solution import PrecisionWarning, Solution, SolverError

NEARNESS = (Fraction(1, 2**8), Fraction(1, 2**16), Fraction(1, 2**26))  # 1 - γ
BITS = 40  # of a potential, below its greatest absolute value


@dataclass(frozen=True, kw_only=True, eq=False)
class Components:
    """The end components of a model: the number (S,) of each state's, or -1, and all their pairs.

    Attributes
    ----------
    mdp : MDP
    label : (S,) int64
    inside : (L,) bool
    """

    mdp: MDP
    label: Integers
    inside: Mask

    def among(self, numbers: Sequence[int] | Integers) -> tuple[Integers, Derived]:
        """Return the states (K,) of some components, and these as a model whose end is far."""
        chosen = np.isin(self.label, numbers)
        states = np.flatnonzero(chosen)
        names = np.full(len(chosen), -1, dtype=np.int64)
        names[states] = np.arange(len(states))
        pairs = np.flatnonzero(self.inside & chosen[self.mdp.pair_state])
        return states, derived(self.mdp, pairs, names)

    def signs(self, numbers: Integers) -> Integers:
        """Return the signs of the best mean rewards of some components (C,)."""
        found = np.zeros(len(numbers), dtype=np.int64)
        if not len(numbers):
            return found
        states, own = self.among(numbers)
        place = np.searchsorted(numbers, self.label[states])
        for nearness in NEARNESS:
            near = _nearly(own, nearness)
            if near is None:
                continue
            low, high = np.full(len(numbers), np.inf), np.full(len(numbers), -np.inf)
            np.minimum.at(low, place, (near.value - near.error)[:-1])
            np.maximum.at(high, place, (near.value + near.error)[:-1])
            found = np.where(found, found, np.where(low > 0, 1, np.where(high < 0, -1, 0)))
            if found.all():
                break
        for i in np.flatnonzero(found == 0).tolist():
            _, (gain, _, _) = best_average(self.among(numbers[[i]])[1].mdp)
            found[i] = (gain.top[0] > 0) - (gain.top[0] < 0)
        return found

    def gaining(self, numbers: Integers) -> tuple[Integers, Integers]:
        """Return states (K,) of components of positive means, and pairs (K,) that earn for ever."""
        states, own = self.among(numbers)
        for nearness in NEARNESS:
            near = _nearly(own, nearness)
            if near is None or not near.value.any():
                continue
            step = Fraction(2) ** (int(np.ceil(np.log2(np.abs(near.value).max()))) - BITS)
            whole = np.rint(near.value / float(step)).tolist()
            potential = Level.of([int(number) * step for number in whole])
            ((tops, _),) = surplus(exact_rows(own.mdp), potential, pairs=near.pairs[:-1])
            if min(tops) > 0:
                return states, own.source[near.pairs[:-1]]
        return states, own.source[best_average(own.mdp)[0][:-1]]


def _nearly(own: Derived, nearness: Fraction) -> Solution | None:
    """Return the solution with discount 1 - `nearness`; None where floats do not bound it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            return ModifiedPolicyIteration().solve(own.mdp.with_(discount=1 - nearness))
        except SolverError:
            return None
