"""The best mean reward of end components: its sign, its exact value, and what proves either.

    r(l) + P_l h - h(s) ≤ g  for all pairs l of the component,   with equality along a policy

says that no policy earns more than g a step for ever, and that one does. h is a potential: what is
earned on the way from s to t is h(s) - h(t), g a step apart. The sign alone is shown by any h with
r + P h - h < 0 (or > 0 along a policy) everywhere. Values V_γ with a discount γ near 1 are such
potentials, as r + P V_γ - V_γ = (1 - γ) P V_γ along an optimal policy and no more elsewhere: so
floats do, rounded. Where they leave the sign open, g and h are found in rational arithmetic as any
best average (`solvers.average`; Puterman, Markov Decision Processes, 1994, chapter 8).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.average.certify import certify_average
from exact_mdp.solvers.dynamic.modified import ModifiedPolicyIteration
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Mask
from exact_mdp.solvers.proof.checker import policy_pairs
from exact_mdp.solvers.solution import PrecisionWarning, Solution, SolverError

NEARNESS = (Fraction(1, 2**8), Fraction(1, 2**16), Fraction(1, 2**26))  # 1 - γ
BITS = 40  # of a potential, below its greatest absolute value


@dataclass(frozen=True, kw_only=True, eq=False)
class Mean:
    """The best mean reward of a component, potentials (K,), and the pairs (K,) of a policy."""

    mean: Fraction
    potential: list[Fraction]
    pairs: Integers


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
            near = nearly(own, nearness)
            if near is None:
                continue
            low, high = np.full(len(numbers), np.inf), np.full(len(numbers), -np.inf)
            np.minimum.at(low, place, (near.value - near.error)[:-1])
            np.maximum.at(high, place, (near.value + near.error)[:-1])
            found = np.where(found, found, np.where(low > 0, 1, np.where(high < 0, -1, 0)))
            if found.all():
                break
        for i in np.flatnonzero(found == 0).tolist():
            mean = self.mean(int(numbers[i])).mean
            found[i] = (mean > 0) - (mean < 0)
        return found

    def mean(self, number: int) -> Mean:
        """Return the exact mean of one component."""
        return exact_mean(self.among([number])[1])

    def proof(self, numbers: Integers, sign: int) -> tuple[Integers, list[Fraction], Integers]:
        """Return states (K,), potentials (K,) that prove the sign of means, and pairs (K,)."""
        states, own = self.among(numbers)
        rows = bellman_rows(own.mdp)
        for nearness in NEARNESS:
            near = nearly(own, nearness)
            if near is None or not near.value.any():
                continue
            step = Fraction(2) ** (int(np.ceil(np.log2(np.abs(near.value).max()))) - BITS)
            whole = np.rint(near.value / float(step)).tolist()
            numerators = [int(x) * step for x in whole]
            pairs = near.pairs if sign > 0 else np.arange(own.mdp.n_pairs)
            if all(number * sign > 0 for number in surplus(rows, numerators, pairs[:-1])):
                return states, numerators[:-1], own.source[near.pairs[:-1]]
        if len(numbers) == 1:
            best = exact_mean(own)
            return states, best.potential, best.pairs
        parts = [self.proof(numbers[[i]], sign) for i in range(len(numbers))]
        return (
            np.concatenate([part[0] for part in parts]),
            [number for part in parts for number in part[1]],
            np.concatenate([part[2] for part in parts]),
        )


def nearly(own: Derived, nearness: Fraction) -> Solution | None:
    """Return the solution with discount 1 - `nearness`; None where floats do not bound it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            return ModifiedPolicyIteration().solve(own.mdp.with_(discount=1 - nearness))
        except SolverError:
            return None


def exact_mean(own: Derived) -> Mean:
    """Return the best mean reward of an end component, given as a model of its own."""
    found = certify_average(own.mdp)
    pairs = policy_pairs(own.mdp, found.policy)
    assert pairs is not None
    potential = found.bias[:-1].tolist()
    return Mean(mean=found.value[0], potential=potential, pairs=own.source[pairs[:-1]])


def surplus(rows: BellmanRows, value: Sequence[Any], pairs: Integers | None = None) -> list[Any]:
    """Return r + P V - V(s) for some pairs (K,), or all, in rationals of the kind that V has."""
    offsets, following, weight = rows.offsets.tolist(), rows.next.tolist(), rows.weight.tolist()
    owner, scale, constant = rows.pair_state.tolist(), rows.scale.tolist(), rows.constant.tolist()
    found, zero = [], value[0] * 0
    for pair in range(len(owner)) if pairs is None else pairs.tolist():
        state, here = owner[pair], range(offsets[pair], offsets[pair + 1])
        later = sum((weight[i] * value[following[i]] for i in here), zero + constant[pair])
        found.append(later / scale[state] - value[state])
    return found
