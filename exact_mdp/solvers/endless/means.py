"""The sign of the best mean reward of end components, and a policy that earns for ever.

Floats bound the best average; where they leave its sign open, rational arithmetic finds it
(`solvers.average`, `solvers.exact.find`; Puterman, Markov Decision Processes, 1994, chapter 8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.average.solve import solve_average
from exact_mdp.solvers.dynamic.methods import PolicyIteration
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Mask
from exact_mdp.solvers.exact.find import best_average
from exact_mdp.solvers.solution import Solution, SolverError


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
        signs = np.zeros(len(numbers), dtype=np.int64)
        if not len(numbers):
            return signs
        states, own = self.among(numbers)
        best = _nearly(own)
        if best is not None:
            low, high = best.value - best.error, best.value + best.error
            place = np.searchsorted(numbers, self.label[states])  # all of a component earn alike
            signs[place] = (low > 0)[:-1].astype(np.int64) - (high < 0)[:-1]
        for i in np.flatnonzero(signs == 0).tolist():
            _, (gain, _, _) = best_average(self.among(numbers[[i]])[1].mdp)
            signs[i] = (gain.top[0] > 0) - (gain.top[0] < 0)
        return signs

    def gaining(self, numbers: Integers) -> tuple[Integers, Integers]:
        """Return states (K,) of components of positive means, and pairs (K,) that earn for ever."""
        states, own = self.among(numbers)
        best = _nearly(own)
        if best is not None and (best.value > best.error)[:-1].all():
            return states, own.source[best.pairs[:-1]]
        return states, own.source[best_average(own.mdp)[0][:-1]]


def _nearly(own: Derived) -> Solution | None:
    """Return the best average reward in floats; None where these do not bound it."""
    try:
        return solve_average(own.mdp, PolicyIteration())
    except SolverError:
        return None
